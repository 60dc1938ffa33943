//! Numbers of plants: stable, unique, and small enough to survive a spreadsheet.
//!
//! An id is `tag · 2³⁷ + counter`, where the tag belongs to a step. Ids stay below 2⁵², so that
//! programs which hold all numbers as doubles (R, spreadsheets, JSON) read them exactly. A step's
//! tag comes from its name, or else from its place in the list, so that plants keep their ids
//! when other steps change.

use std::collections::BTreeSet;
use weald_contract::Seed;

/// Bits of an id that count within a step.
const COUNTER_BITS: u32 = 37;
/// Number of tags; 2¹⁵ of them keep ids below 2⁵².
const TAGS: u64 = 1 << 15;
/// Tags below this one belong to steps without a name.
const FIRST_NAMED: u64 = 1 << 12;
/// Seed of the hash that turns names into tags; any fixed number does.
const NAMES: Seed = Seed(0);

/// Hands out tags, each once.
#[derive(Debug, Default)]
pub(crate) struct Tags {
    taken: BTreeSet<u64>,
}

impl Tags {
    /// Begins with the tags that these ids use already.
    pub(crate) fn beside(ids: impl Iterator<Item = u64>) -> Self {
        Self { taken: ids.map(|id| id >> COUNTER_BITS).collect() }
    }

    /// Takes the tag of the step with this name and place in the list, or the next free one.
    pub(crate) fn take(&mut self, name: Option<&str>, ordinal: usize) -> IdSource {
        let named = |name| FIRST_NAMED + NAMES.stream(name, 0).below(TAGS - FIRST_NAMED);
        let wanted = name.map_or((ordinal as u64 + 1) % FIRST_NAMED, named);
        // The ids of a scene use a handful of tags, so that a free one is always near.
        let tag = (0..TAGS).map(|step| (wanted + step) % TAGS).find(|t| !self.taken.contains(t));
        let tag = tag.unwrap_or(wanted);
        self.taken.insert(tag);
        IdSource { tag }
    }
}

/// The ids of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct IdSource {
    /// Number of the step in ids; also the index of its random streams.
    pub(crate) tag: u64,
}

impl IdSource {
    /// Number of ids that a step has.
    pub(crate) const MOST: u64 = 1 << COUNTER_BITS;

    /// Returns the id with this counter.
    pub(crate) fn id(self, counter: u64) -> u64 {
        debug_assert!(counter < 1 << COUNTER_BITS, "a step counts no further than 2^37");
        (self.tag << COUNTER_BITS) | counter
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_exact_as_doubles() {
        let mut tags = Tags::default();
        for name in ["wood", "reeds", "meadow"] {
            let id = tags.take(Some(name), 0).id((1 << COUNTER_BITS) - 1);
            assert_eq!(id as f64 as u64, id);
        }
    }

    #[test]
    fn a_named_step_keeps_its_tag_wherever_it_stands() {
        let mut first = Tags::default();
        let mut second = Tags::default();
        second.take(None, 0);
        assert_eq!(first.take(Some("wood"), 0), second.take(Some("wood"), 1));
    }

    #[test]
    fn equal_names_and_used_ids_lead_to_fresh_tags() {
        let mut tags = Tags::default();
        let first = tags.take(Some("wood"), 0);
        assert_ne!(tags.take(Some("wood"), 1), first);
        let mut later = Tags::beside([first.id(7)].into_iter());
        assert_ne!(later.take(Some("wood"), 0), first);
    }
}
