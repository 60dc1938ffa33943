//! How a stage says how far it is, and hears that it should stop.

/// Receives progress; the caller decides what to show.
///
/// Calls may come from any thread and must not change what the stage computes.
pub trait Progress: Sync {
    /// A part of the work begins; it will take `total` steps of unit `unit`.
    fn begin(&self, what: &str, total: u64, unit: &str);
    /// `steps` more of the current part are done.
    fn advance(&self, steps: u64);
    /// A figure of the current part beside its steps, shown as it changes.
    fn figure(&self, _name: &str, _figure: Figure) {}
    /// Something the user should know before the next part begins.
    fn say(&self, _what: &str) {}
    /// Whether the user asked to stop. Stages look at it at least every few seconds.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// A number that tells more of the work than its steps do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Figure {
    /// So many more of something, for instance rays: the caller may show them by the second.
    Counted(u64),
    /// Where something stands, for instance the noise that is left.
    Level(f64),
}

/// Progress that nobody watches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
}
