//! Point statistics: how plants are spread, how large they are, and how a stand thins.
//!
//! Serves people who never simulate as well: a [`Pattern`] is any set of points in a rectangle.
//! Estimators are those of the R package spatstat, whose conventions [Baddeley16] describes, and
//! agree with it to 1e-9 where distances do not tie with radii.
//!
//! - [`ripley`]: Ripley's K, Besag's L and the pair correlation g;
//! - [`nearest`]: the distributions G and F of distances to the nearest point, J, Clark and Evans;
//! - [`marks`]: how sizes depend on those of neighbours;
//! - [`quadrats`]: counts in rectangles, Morisita's index;
//! - [`envelope`]: the range of a statistic under a null model, and a verdict;
//! - [`figure`]: figures of all these, as SVG;
//! - [`size`]: inequality and moments of sizes;
//! - [`thinning`]: lines through a stand's density and mean size, Reineke's density index;
//! - [`plateau`]: the part of a stand's history that such a line may be fitted to;
//! - [`regression`]: lines of quantile regression.

pub mod envelope;
pub mod figure;
pub mod marks;
pub mod nearest;
mod neighbors;
mod pattern;
pub mod plateau;
pub mod quadrats;
pub mod regression;
mod report;
pub mod ripley;
pub mod size;
mod student;
pub mod thinning;

pub use envelope::{Envelope, Verdict};
pub use figure::Figure;
pub use marks::mark_correlation;
pub use nearest::{ClarkEvans, clark_evans};
pub use pattern::{Error, Pattern, Table, Window};
pub use plateau::{EarlyStart, Plateau, plateau};
pub use quadrats::Quadrats;
pub use regression::{QuantileLine, quantile_line};
pub use report::Report;
pub use ripley::{Correction, Divisor, pair_correlation, ripley_k};
pub use size::{SizeClass, Sizes, gini, quantile, size_classes};
pub use thinning::{Line, StandDensity, StandState, ThinningLine, thinning_line};

weald_contract::words! {
    /// A function of distance.
    pub enum Statistic {
        /// Ripley's K: expected further points within r of a point, over the density.
        K = "K",
        /// Besag's L: `sqrt(K / π)`, which is r for points spread at random.
        L = "L",
        /// Distribution of the distance to the nearest neighbour.
        G = "G",
        /// Distribution of the distance from any place to the nearest point.
        F = "F",
        /// `(1 - G) / (1 - F)`.
        J = "J",
        /// Pair correlation: density of points at distance r of a point, over the mean density.
        Pcf = "pcf",
    }
}

impl Statistic {
    /// All of them, in the order in which they are listed to people.
    pub const ALL: [Self; 6] = [Self::K, Self::L, Self::G, Self::F, Self::J, Self::Pcf];
}

/// Computes a table for each statistic, with a row for each radius.
///
/// `K` and `L` have the columns `r, theo, un, border, trans, iso`; `G` has
/// `r, theo, raw, rs, km, han`; `F` has `r, theo, raw, rs, km, cs`; `J` has
/// `r, theo, un, rs, km, han`; `pcf` has `r, theo, trans`. `theo` is the value for points spread
/// at random. Numbers that do not exist, such as those of the border method once no point is that
/// far from the rim, are NaN.
///
/// # Errors
/// Fewer than two points; radii that are not finite, negative or not rising.
pub fn statistics(
    pattern: &Pattern,
    wanted: &[Statistic],
    radii: &[f64],
) -> Result<Vec<Table>, Error> {
    // L is K in other words: the pairs are summed once.
    let of_pairs = wanted.iter().any(|one| matches!(one, Statistic::K | Statistic::L));
    let k = of_pairs.then(|| ripley::k_table(pattern, radii)).transpose()?;
    let k_table = || k.clone().map_or_else(|| ripley::k_table(pattern, radii), Ok);
    let table = |statistic: &Statistic| match statistic {
        Statistic::K => k_table(),
        Statistic::L => k_table().map(ripley::l_of),
        Statistic::G => nearest::g_table(pattern, radii),
        Statistic::F => nearest::f_table(pattern, radii),
        Statistic::J => nearest::j_table(pattern, radii),
        Statistic::Pcf => ripley::pcf_table(pattern, radii),
    };
    wanted.iter().map(table).collect()
}
