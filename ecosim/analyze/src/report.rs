//! A pattern in a few numbers.

use crate::nearest::{ClarkEvans, clark_evans};
use crate::pattern::{Error, Pattern};
use crate::size::Sizes;
use serde::Serialize;
use std::fmt;

/// What can be said of a pattern without a function of distance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Number of points.
    pub points: usize,
    /// Area of the window.
    pub area: f64,
    /// Points per unit of area.
    pub intensity: f64,
    /// Spread of the points against randomness.
    pub clark_evans: ClarkEvans,
    /// The sizes, where there are any.
    pub sizes: Option<Sizes>,
}

impl Report {
    /// Describes a pattern and, if given, the size of each point.
    ///
    /// # Errors
    /// Fewer than two points; another number of sizes than points; see [`Sizes::of`].
    pub fn of(pattern: &Pattern, sizes: Option<&[f64]>) -> Result<Self, Error> {
        if let Some(sizes) = sizes.filter(|sizes| sizes.len() != pattern.len()) {
            return Err(Error::Unmatched { sizes: sizes.len(), points: pattern.len() });
        }
        Ok(Self {
            points: pattern.len(),
            area: pattern.window().area(),
            intensity: pattern.intensity(),
            clark_evans: clark_evans(pattern)?,
            sizes: sizes.map(Sizes::of).transpose()?,
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "points                {}", self.points)?;
        writeln!(f, "area                  {}", self.area)?;
        writeln!(f, "points per area       {:.6}", self.intensity)?;
        writeln!(f, "mean nearest distance {:.6}", self.clark_evans.mean_distance)?;
        writeln!(f, "Clark-Evans           {:.4}", self.clark_evans.naive)?;
        write!(f, "  for this window     {:.4}", self.clark_evans.donnelly)?;
        if let Some(sizes) = &self.sizes {
            writeln!(f)?;
            writeln!(f, "mean size             {:.6}", sizes.mean)?;
            writeln!(f, "coefficient of var.   {:.4}", sizes.variation)?;
            writeln!(f, "skewness              {:.4}", sizes.skewness)?;
            write!(f, "Gini                  {:.4}", sizes.gini)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;

    #[test]
    fn a_report_tells_of_sizes_only_where_there_are_any() {
        let window = Window { x: [0.0, 2.0], y: [0.0, 2.0] };
        let pattern = Pattern::new(vec![[0.5, 1.0], [1.5, 1.0]], window).unwrap();
        let without = Report::of(&pattern, None).unwrap();
        assert_eq!((without.intensity, without.sizes), (0.5, None));
        let with = Report::of(&pattern, Some(&[1.0, 3.0])).unwrap();
        assert!(with.to_string().contains("Gini                  0.2500"));
        let error = Report::of(&pattern, Some(&[1.0])).unwrap_err();
        assert_eq!(error, Error::Unmatched { sizes: 1, points: 2 });
    }
}
