//! How a stage says how far it is, and hears that it should stop.

/// Receives progress; the caller decides what to show.
///
/// Calls may come from any thread and must not change what the stage computes.
pub trait Progress: Sync {
    /// A part of the work begins; it will take `total` steps of unit `unit`.
    fn begin(&self, what: &str, total: u64, unit: &str);
    /// `steps` more of the current part are done.
    fn advance(&self, steps: u64);
    /// Whether the user asked to stop. Stages look at it at least every few seconds.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Progress that nobody watches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
}
