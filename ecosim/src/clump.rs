//! Clumps: soft spots at random places that several species may share.

use weald_contract::{Frame, Seed, Stream};

weald_contract::table! {
    /// Soft spots at random places; a density keeps to them.
    pub struct Clump {
        /// Name of the spots; species with the same name and size share them.
        name: String = String::new();
        /// Distance between the places where spots may be, m.
        size: f64, in 0.01..=100000.0;
        /// Part of these places that have a spot.
        share: f64 = 0.5, in 0.0..=1.0;
        /// Density between the spots, as a part of that inside them.
        between: f64 = 0.0, in 0.0..=1.0;
    }
}

/// Spot radii, as parts of the distance between places.
const RADII: [f64; 2] = [0.3, 0.6];
/// Part of a spot's radius over which it fades.
const FADING: f64 = 0.5;

/// Clumps laid over a terrain.
#[derive(Clone, Debug)]
pub(crate) struct Clumps {
    clump: Clump,
    seed: Seed,
    corner: [f64; 2],
}

impl Clumps {
    /// Lays clumps over a terrain. `seed` must be the scene's, not the step's, so that steps
    /// share them.
    pub(crate) fn new(clump: &Clump, seed: Seed, terrain: &Frame) -> Self {
        let seed = seed.part(&format!("clump {}", clump.name), 0);
        Self { clump: clump.clone(), seed, corner: [terrain.west, terrain.south] }
    }

    /// Returns the factor to a density at a place: 1 in a spot, `between` between them.
    pub(crate) fn at(&self, x: f64, y: f64) -> f64 {
        let size = self.clump.size;
        let [u, v] = [(x - self.corner[0]) / size, (y - self.corner[1]) / size];
        let mut most = 0.0f64;
        // A spot reaches less than one square beyond its own.
        for row in -1..=1 {
            for column in -1..=1 {
                let square = [u.floor() as i64 + column, v.floor() as i64 + row];
                most = most.max(self.spot(square, [u, v]));
            }
        }
        self.clump.between + (1.0 - self.clump.between) * most
    }

    /// Returns how deep in the spot of a square a place lies, 0 to 1.
    fn spot(&self, [column, row]: [i64; 2], [u, v]: [f64; 2]) -> f64 {
        // Scenes reach no further than 2^31 squares from their corner.
        let index = ((column as u64) << 32) ^ (row as u64 & 0xFFFF_FFFF);
        let mut stream: Stream = self.seed.stream("spot", index);
        if stream.unit() >= self.clump.share {
            return 0.0;
        }
        let center = [column as f64 + stream.unit(), row as f64 + stream.unit()];
        let radius = stream.range(RADII[0], RADII[1]);
        let distance = ((u - center[0]).powi(2) + (v - center[1]).powi(2)).sqrt();
        1.0 - crate::distance::rise(distance, radius * (1.0 - FADING), radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { width: 10, height: 10, cell: 10.0, west: 0.0, south: 0.0 };

    fn clump(name: &str, share: f64) -> Clump {
        Clump { name: name.into(), size: 5.0, share, between: 0.1 }
    }

    #[test]
    fn species_share_the_spots_of_one_name() {
        let at = |name: &str, x: f64| Clumps::new(&clump(name, 0.5), Seed(4), &FRAME).at(x, 33.0);
        let places: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.5).collect();
        assert!(places.iter().all(|x| at("a", *x) == at("a", *x)));
        assert!(places.iter().any(|x| at("a", *x) != at("b", *x)));
    }

    #[test]
    fn factors_run_from_between_to_one_without_steps() {
        let clumps = Clumps::new(&clump("a", 0.6), Seed(4), &FRAME);
        let line: Vec<f64> = (0..10_000).map(|i| clumps.at(f64::from(i) * 0.01, 41.0)).collect();
        assert!(line.iter().all(|v| (0.1..=1.0).contains(v)));
        assert!(line.contains(&1.0) && line.contains(&0.1));
        // A smoothstep over a quarter of 0.3 to 0.6 of 5 m rises at most 1.5 / 0.75 m.
        assert!(line.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.03));
    }
}
