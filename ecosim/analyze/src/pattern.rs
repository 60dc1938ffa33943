//! Points in a rectangle, checked, and the tables that statistics give back.

/// A rectangle, sides along the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// West and east side.
    pub x: [f64; 2],
    /// South and north side.
    pub y: [f64; 2],
}

impl Window {
    /// Length from west to east.
    pub fn width(&self) -> f64 {
        self.x[1] - self.x[0]
    }

    /// Length from south to north.
    pub fn height(&self) -> f64 {
        self.y[1] - self.y[0]
    }

    /// Area.
    pub fn area(&self) -> f64 {
        self.width() * self.height()
    }

    /// Length of the rim.
    pub fn perimeter(&self) -> f64 {
        2.0 * (self.width() + self.height())
    }

    /// Distance of a point inside to the nearest side.
    pub fn border_distance(&self, [x, y]: [f64; 2]) -> f64 {
        let to_x = (x - self.x[0]).min(self.x[1] - x);
        let to_y = (y - self.y[0]).min(self.y[1] - y);
        to_x.min(to_y)
    }

    /// Whether a point is inside or on the rim.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.x[0]..=self.x[1]).contains(&x) && (self.y[0]..=self.y[1]).contains(&y)
    }
}

/// Points observed in a rectangle: all that are there, and none outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    points: Vec<[f64; 2]>,
    window: Window,
}

/// Why a statistic cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A window without area, or with bounds that are not finite.
    #[error("the window {x0}, {y0} to {x1}, {y1} has no area; x0 < x1 and y0 < y1 are right")]
    BadWindow {
        /// West side.
        x0: f64,
        /// South side.
        y0: f64,
        /// East side.
        x1: f64,
        /// North side.
        y1: f64,
    },
    /// A point that is not finite or not in the window.
    #[error("point {row} at {x}, {y} is outside the window; give the whole area that was surveyed")]
    Outside {
        /// Row of the point, from 0.
        row: usize,
        /// Its place.
        x: f64,
        /// Its place.
        y: f64,
    },
    /// Too few points or values.
    #[error("{found} {what} are too few; at least {needed} are needed")]
    TooFew {
        /// What was counted.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there must be.
        needed: usize,
    },
    /// Radii out of order.
    #[error("radius {row} is {value}; radii must be finite, at least 0, and rise")]
    BadRadius {
        /// Row of the radius, from 0.
        row: usize,
        /// Its value.
        value: f64,
    },
    /// A value that the statistic has no meaning for.
    #[error("{what} in row {row} is {value}; {right}")]
    BadValue {
        /// What was read.
        what: &'static str,
        /// Row, from 0.
        row: usize,
        /// The value.
        value: f64,
        /// What would be right.
        right: &'static str,
    },
    /// Another number of sizes than of points.
    #[error("{sizes} sizes belong to {points} points; one a point is right")]
    Unmatched {
        /// Sizes given.
        sizes: usize,
        /// Points there are.
        points: usize,
    },
    /// Two patterns that were not observed in the same place.
    #[error("the two patterns have different windows; one window for both is right")]
    Windows,
    /// A statistic for which types cannot be dealt out anew.
    #[error("{statistic} has no envelope by types; K, L and pcf have")]
    NotByLabels {
        /// Its name.
        statistic: &'static str,
    },
    /// The caller asked to stop.
    #[error("stopped before it was done")]
    Cancelled,
    /// A stand whose cover does not level off.
    #[error(
        "cover does not level off (it ends at {last:.4}); a thinning line begins where crowns have \
         closed: watch the stand longer, or give the window"
    )]
    NoPlateau {
        /// Cover of the last state.
        last: f64,
    },
    /// All values equal where a line or a spread needs two.
    #[error("all {what} are equal")]
    NoSpread {
        /// What was looked at.
        what: &'static str,
    },
}

impl Pattern {
    /// Makes a pattern of points that all lie in the window or on its rim.
    ///
    /// # Errors
    /// A window without area; a point outside it, named by its row.
    pub fn new(points: Vec<[f64; 2]>, window: Window) -> Result<Self, Error> {
        let Window { x: [x0, x1], y: [y0, y1] } = window;
        let has_area = window.width() > 0.0 && window.height() > 0.0;
        if !(has_area && window.area().is_finite() && window.area() > 0.0) {
            return Err(Error::BadWindow { x0, y0, x1, y1 });
        }
        match points.iter().position(|point| !window.contains(*point)) {
            Some(row) => Err(Error::Outside { row, x: points[row][0], y: points[row][1] }),
            None => Ok(Self { points, window }),
        }
    }

    /// The points.
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }

    /// The window.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Points per unit of area.
    pub fn intensity(&self) -> f64 {
        self.points.len() as f64 / self.window.area()
    }

    /// Refuses patterns without a pair.
    pub(crate) fn check_pairs(&self) -> Result<(), Error> {
        match self.len() {
            0 | 1 => Err(Error::TooFew { what: "points", found: self.len(), needed: 2 }),
            _ => Ok(()),
        }
    }
}

/// Refuses radii that are not finite, negative or not rising.
pub(crate) fn check_radii(radii: &[f64]) -> Result<(), Error> {
    let mut before = None;
    for (row, value) in radii.iter().copied().enumerate() {
        let rises = before.is_none_or(|before| before < value);
        if !(value.is_finite() && value >= 0.0 && rises) {
            return Err(Error::BadRadius { row, value });
        }
        before = Some(value);
    }
    Ok(())
}

/// Named columns of equal length.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Name, the stem of the file that it goes to.
    pub name: &'static str,
    /// Columns in order.
    pub columns: Vec<(&'static str, Vec<f64>)>,
}

impl Table {
    /// The column of this name.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        let found = self.columns.iter().find(|(known, _)| *known == name);
        found.map(|(_, values)| values.as_slice())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: Window = Window { x: [0.0, 1.0], y: [0.0, 1.0] };

    #[test]
    fn a_point_outside_is_named_by_its_row() {
        for bad in [[1.5, 0.5], [f64::NAN, 0.5]] {
            let error = Pattern::new(vec![[0.5, 0.5], bad], UNIT).unwrap_err();
            assert!(matches!(error, Error::Outside { row: 1, .. }));
        }
    }

    #[test]
    fn a_window_without_area_is_refused() {
        for x in [[0.0, 0.0], [1.0, 0.0], [0.0, f64::INFINITY], [f64::NAN, 1.0]] {
            let window = Window { x, ..UNIT };
            assert!(matches!(Pattern::new(vec![], window), Err(Error::BadWindow { .. })));
        }
    }

    #[test]
    fn radii_must_rise() {
        assert_eq!(check_radii(&[0.0, 1.0, 2.0]), Ok(()));
        for bad in [[0.0, 1.0, 1.0], [0.0, -1.0, 2.0], [0.0, f64::NAN, 2.0]] {
            assert!(check_radii(&bad).is_err());
        }
    }
}
