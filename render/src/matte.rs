//! Cryptomatte: which things cover each pixel, and how much of it [FJ15].
//!
//! A thing's name is hashed to 32 bits, which are stored as a float; a pixel keeps its most
//! covering things with their shares, two to a layer of four channels. Compositors pick things by
//! clicking on them, and find their names in the manifest.

use std::collections::BTreeMap;

/// Things that a pixel keeps.
pub(crate) const RANKS: usize = 6;

/// Samples of one pixel by what they saw.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ballots {
    seen: Vec<(u32, u64, u32)>,
}

/// The things that cover most of a pixel, with the samples that saw them; 0 samples for none.
pub(crate) type Ranked<T> = [(T, u32); RANKS];

impl Ballots {
    /// Counts a sample that saw a plant of a species.
    pub fn cast(&mut self, species: u32, plant: u64) {
        match self.seen.iter_mut().find(|ballot| (ballot.0, ballot.1) == (species, plant)) {
            Some(ballot) => ballot.2 += 1,
            None => self.seen.push((species, plant, 1)),
        }
    }

    /// Species by the samples that saw them.
    pub fn species(&self) -> Ranked<u32> {
        let mut sums: BTreeMap<u32, u32> = BTreeMap::new();
        self.seen
            .iter()
            .for_each(|&(species, _, count)| *sums.entry(species).or_default() += count);
        ranked(sums.into_iter().collect())
    }

    /// Plants, with their species, by the samples that saw them.
    pub fn plants(&self) -> Ranked<(u32, u64)> {
        ranked(self.seen.iter().map(|&(species, plant, count)| ((species, plant), count)).collect())
    }
}

fn ranked<T: Copy + Default + Ord>(mut list: Vec<(T, u32)>) -> Ranked<T> {
    list.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
    let mut ranks = [(T::default(), 0); RANKS];
    ranks.iter_mut().zip(list).for_each(|(rank, thing)| *rank = thing);
    ranks
}

/// The hash of a name, 32-bit MurmurHash3 of seed 0, made a float that is a finite number: where
/// the bits of its exponent are all equal, one is turned over [FJ15].
pub(crate) fn name_hash(name: &str) -> u32 {
    let mut hash = murmur3(name.as_bytes());
    if matches!(hash >> 23 & 255, 0 | 255) {
        hash ^= 1 << 23;
    }
    hash
}

/// MurmurHash3, its variant of 32 bits, with seed 0 [Appleby11].
fn murmur3(bytes: &[u8]) -> u32 {
    let scrambled = |k: u32| k.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let mut hash = 0u32;
    let mut blocks = bytes.chunks_exact(4);
    for block in &mut blocks {
        let k = u32::from_le_bytes([block[0], block[1], block[2], block[3]]);
        hash = (hash ^ scrambled(k)).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    let rest = blocks.remainder();
    if !rest.is_empty() {
        let k = rest.iter().rev().fold(0u32, |k, &byte| k << 8 | u32::from(byte));
        hash ^= scrambled(k);
    }
    hash ^= bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// The attributes that tell a compositor of a cryptomatte and the names in it.
pub(crate) fn attributes(
    layer: &str,
    names: &BTreeMap<u32, String>,
) -> impl Iterator<Item = (String, String)> {
    // The specification keys the attributes of a layer by seven digits of its name's hash.
    let key = format!("cryptomatte/{:07x}", murmur3(layer.as_bytes()) >> 4);
    let manifest: Vec<String> =
        names.iter().map(|(hash, name)| format!("{}:\"{hash:08x}\"", quoted(name))).collect();
    [
        ("name", layer.to_string()),
        ("hash", "MurmurHash3_32".into()),
        ("conversion", "uint32_to_float32".into()),
        ("manifest", format!("{{{}}}", manifest.join(","))),
    ]
    .map(|(field, text)| (format!("{key}/{field}"), text))
    .into_iter()
}

/// A text in JSON, all in ASCII.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            ' '..='~' => quoted.push(character),
            other => {
                let mut units = [0; 2];
                for unit in other.encode_utf16(&mut units) {
                    quoted.push_str(&format!("\\u{unit:04x}"));
                }
            }
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_reference_implementation() {
        // Widely published values of MurmurHash3_x86_32 with seed 0.
        assert_eq!(murmur3(b""), 0);
        assert_eq!(murmur3(b"test"), 0xba6b_d213);
        assert_eq!(murmur3(b"Hello, world!"), 0xc036_3e43);
        assert_eq!(murmur3(b"The quick brown fox jumps over the lazy dog"), 0x2e4f_f723);
    }

    #[test]
    fn every_hash_is_a_number() {
        for number in 0..20_000 {
            let value = f32::from_bits(name_hash(&format!("oak {number}")));
            assert!(value.is_normal());
        }
    }

    #[test]
    fn the_things_that_cover_most_come_first() {
        let mut ballots = Ballots::default();
        for (species, plant) in [(1, 5), (2, 7), (2, 8), (2, 8), (1, 5), (1, 5), (0, 0)] {
            ballots.cast(species, plant);
        }
        assert_eq!(ballots.species()[..4], [(1, 3), (2, 3), (0, 1), (0, 0)]);
        assert_eq!(ballots.plants()[..2], [((1, 5), 3), ((2, 8), 2)]);
    }

    #[test]
    fn the_manifest_is_json_of_plain_characters() {
        let names = BTreeMap::from([(0x1234_abcd, "hêtre \"a\"".to_string())]);
        let all: BTreeMap<String, String> = attributes("species", &names).collect();
        let (_, manifest) = all.iter().find(|(key, _)| key.ends_with("/manifest")).unwrap();
        assert_eq!(manifest, "{\"h\\u00eatre \\\"a\\\"\":\"1234abcd\"}");
    }
}
