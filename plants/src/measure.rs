//! Measures of a grown plant, and whether they are those of real ones.
//!
//! Trees are measured as foresters and botanists do: diameter at breast height, leaf area, and
//! the ratios of Horton and Strahler's stream orders [Strahler57]. Heights and leaf areas are held
//! against the 5 to 95 % range of trees of their diameter [Falster15].

use crate::mesh::organ_area;
use crate::skeleton::{Axis, AxisKind, Node, Skeleton};
use std::ops::RangeInclusive;
use weald_contract::Surface;

/// Height at which a trunk is measured, m.
pub const BREAST: f32 = 1.3;

/// Measures of one plant.
#[derive(Clone, Debug, PartialEq)]
pub struct Measures {
    /// Height, m.
    pub height: f32,
    /// Trunk diameter at breast height, m: that of one trunk with the cross section of all.
    /// `None` for what is lower.
    pub diameter: Option<f32>,
    /// One-sided area of leaves, blades and petals, m².
    pub leaf_area: f32,
    /// Orders of the branches, thinnest first.
    pub orders: Vec<Order>,
}

/// The branches of one Strahler order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// How many there are.
    pub count: usize,
    /// Mean length, m.
    pub length: f64,
    /// Mean diameter, m.
    pub diameter: f64,
}

/// One measure beside the range that real trees have.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What was measured.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Where real trees lie.
    pub band: RangeInclusive<f64>,
}

impl Finding {
    /// Whether it lies where real trees do.
    pub fn is_natural(&self) -> bool {
        self.band.contains(&self.value)
    }
}

/// What kind of plants a plant is held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Trees, by the diameter of their trunk.
    Tree,
    /// Herbs and low shrubs.
    Herb,
}

/// Leaf area over the ground that a plant covers: grassland 0.3 to 5.0, shrubs 0.4 to 4.5, crops
/// 0.2 to 8.7, wetlands 2.5 to 8.4 [Asner03] table 3; the whole range.
const LEAF_AREA_INDEX: RangeInclusive<f64> = 0.2..=8.7;

/// Heights of herbs and dwarf shrubs of temperate Europe, from seedlings to giant reeds, m.
const HERB_HEIGHT: RangeInclusive<f64> = 0.005..=4.0;

/// Trees by trunk diameter: diameters, m; heights, m; leaf areas, m². The 5 and 95 % points of
/// the measured trees of each class [Falster15].
const CLASSES: [([f64; 2], [f64; 2], [f64; 2]); 4] = [
    ([0.05, 0.10], [4.2, 13.3], [1.7, 52.0]),
    ([0.10, 0.20], [5.5, 21.1], [6.0, 135.0]),
    ([0.20, 0.40], [9.5, 28.4], [28.0, 367.0]),
    ([0.40, 0.80], [13.6, 40.2], [155.0, 988.0]),
];

/// Height over diameter of trunks above 5 cm, 5 and 95 % points [Falster15].
const SLENDERNESS: RangeInclusive<f64> = 37.0..=157.0;

/// Ratios of successive orders: a little wider than those of nine laser-scanned trees whose
/// cylinder models we measured, which had 2.5 to 4.1, 1.5 to 2.7 and 1.4 to 2.0.
const RATIOS: [(&str, RangeInclusive<f64>); 3] =
    [("bifurcation ratio", 2.5..=5.0), ("length ratio", 1.4..=3.0), ("diameter ratio", 1.3..=2.3)];

impl Measures {
    /// Measures a plant.
    pub fn of(skeleton: &Skeleton) -> Self {
        Self {
            height: skeleton.height(),
            diameter: diameter_at(skeleton, BREAST),
            leaf_area: leaf_area(skeleton),
            orders: orders(skeleton),
        }
    }

    /// Bifurcation, length and diameter ratio: by how much the number falls and lengths and
    /// diameters rise from one order to the next, from the slope of the logarithms.
    ///
    /// `None` where there are fewer than two orders.
    pub fn ratios(&self) -> Option<[f64; 3]> {
        let slope = |of: fn(&Order) -> f64| {
            let points: Vec<f64> = self.orders.iter().map(|order| libm::log(of(order))).collect();
            slope(&points).filter(|slope| slope.is_finite()).map(libm::exp)
        };
        let counts = slope(|order| order.count as f64)?;
        Some([1.0 / counts, slope(|order| order.length)?, slope(|order| order.diameter)?])
    }

    /// The measures of a plant beside those of real ones of its kind.
    pub fn beside(&self, kind: Kind, skeleton: &Skeleton) -> Vec<Finding> {
        if kind == Kind::Tree {
            return self.findings();
        }
        let height = f64::from(self.height);
        // The ground under the outline of all that grows, seen from above.
        let covered = std::f64::consts::PI * f64::from(skeleton.reach()).powi(2);
        let index = f64::from(self.leaf_area) / covered.max(1e-9);
        vec![
            Finding { name: "height, m", value: height, band: HERB_HEIGHT },
            Finding { name: "leaf area index", value: index, band: LEAF_AREA_INDEX },
        ]
    }

    /// The measures of a tree beside those of real ones.
    ///
    /// Empty for what has no trunk above 5 cm: the ranges know nothing of smaller plants.
    pub fn findings(&self) -> Vec<Finding> {
        let Some(diameter) = self.diameter.map(f64::from).filter(|d| *d >= CLASSES[0].0[0]) else {
            return Vec::new();
        };
        let height = f64::from(self.height);
        let finding = |name, value, band| Finding { name, value, band };
        let mut findings = vec![finding("height over diameter", height / diameter, SLENDERNESS)];
        let class = CLASSES.iter().find(|(class, ..)| (class[0]..class[1]).contains(&diameter));
        if let Some((_, heights, areas)) = class {
            findings.push(finding("height, m", height, heights[0]..=heights[1]));
            let area = f64::from(self.leaf_area);
            findings.push(finding("leaf area, m²", area, areas[0]..=areas[1]));
        }
        let ratios = self.ratios().into_iter().flatten();
        findings.extend(ratios.zip(RATIOS).map(|(value, (name, band))| finding(name, value, band)));
        findings
    }
}

/// Least-squares slope of values at 0, 1, 2 ...
fn slope(values: &[f64]) -> Option<f64> {
    let middle = (values.len() as f64 - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (mut square, mut product) = (0.0, 0.0);
    for (i, value) in values.iter().enumerate() {
        let x = i as f64 - middle;
        square += x * x;
        product += x * (value - mean);
    }
    (square > 0.0).then(|| product / square)
}

/// Diameter of one trunk that has the cross section of all stems at a height, m.
pub fn diameter_at(skeleton: &Skeleton, height: f32) -> Option<f32> {
    let trunks = skeleton.axes.iter().filter(|axis| axis.order == 0 && axis.kind == AxisKind::Stem);
    let crosses = |axis: &Axis| {
        let mut pairs = skeleton.nodes_of(axis).windows(2);
        let pair = pairs.find(|p| p[0].position.z <= height && p[1].position.z > height)?;
        let t = (height - pair[0].position.z) / (pair[1].position.z - pair[0].position.z);
        Some(pair[0].radius + t * (pair[1].radius - pair[0].radius))
    };
    let square: f32 = trunks.filter_map(crosses).map(|radius| radius * radius).sum();
    (square > 0.0).then(|| 2.0 * square.sqrt())
}

/// One-sided area of all thin sheets, m²: leaves and petals, and blades by their widths.
pub fn leaf_area(skeleton: &Skeleton) -> f32 {
    let is_sheet = |material: u32| {
        let material = skeleton.materials.get(material as usize);
        material.is_some_and(|m| matches!(m.surface, Surface::Leaf { .. }))
    };
    let organs = skeleton.organs.iter().map(|organ| {
        let meshes = skeleton.prototypes[organ.prototype as usize].meshes.iter();
        let sheets = meshes.filter(|mesh| is_sheet(mesh.material));
        sheets.map(|mesh| f64::from(organ_area(mesh, organ.scale))).sum::<f64>()
    });
    let blades = skeleton.axes.iter().filter(|axis| axis.kind == AxisKind::Blade).map(|axis| {
        let strip =
            |p: &[Node]| (p[0].radius + p[1].radius) * p[0].position.distance(p[1].position);
        f64::from(skeleton.nodes_of(axis).windows(2).map(strip).sum::<f32>())
    });
    organs.chain(blades).sum::<f64>() as f32
}

/// A run of branch segments of one order.
struct Stream {
    order: usize,
    length: f64,
    /// Diameter times length, m².
    weighed: f64,
}

/// Numbers, lengths and diameters of the branches by Strahler order.
///
/// A tip has order 1; where two branches of one order meet, the next order begins; a branch of
/// lower order joins without effect.
fn orders(skeleton: &Skeleton) -> Vec<Order> {
    let mut streams: Vec<Stream> = Vec::new();
    let mut children: Vec<Vec<(f32, usize)>> = vec![Vec::new(); skeleton.axes.len()];
    // Parents stand before their children: backwards, every child is known when it is met.
    for (index, axis) in skeleton.axes.iter().enumerate().rev() {
        if axis.kind != AxisKind::Stem {
            continue;
        }
        let mut joining = std::mem::take(&mut children[index]);
        joining.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let foot = follow(skeleton.nodes_of(axis), &joining, &mut streams);
        if let Some(parent) = axis.parent {
            children[parent as usize].push((axis.at, foot));
        }
    }
    let highest = streams.iter().map(|stream| stream.order).max().unwrap_or(0);
    let order = |order: usize| {
        let of_order = || streams.iter().filter(|s| s.order == order && s.length > 0.0);
        let count = of_order().count();
        let length: f64 = of_order().map(|s| s.length).sum();
        let weighed: f64 = of_order().map(|s| s.weighed).sum();
        let diameter = weighed / length;
        Order { count, length: length / count as f64, diameter }
    };
    (1..=highest).map(order).filter(|order| order.count > 0).collect()
}

/// Follows an axis from its tip to its foot past what joins it; gives the stream at its foot.
fn follow(nodes: &[Node], joining: &[(f32, usize)], streams: &mut Vec<Stream>) -> usize {
    let total: f32 = nodes.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
    let mut above = 1.0_f32;
    let mut current = streams.len();
    streams.push(Stream { order: 1, length: 0.0, weighed: 0.0 });
    for (at, child) in joining.iter().copied().chain([(0.0, usize::MAX)]) {
        let length = f64::from((above - at).max(0.0) * total);
        let thick = 2.0 * f64::from(radius_at(nodes, total, 0.5 * (above + at)));
        streams[current].length += length;
        streams[current].weighed += length * thick;
        above = at.min(above);
        let Some(order) = streams.get(child).map(|stream| stream.order) else { break };
        let own = streams[current].order;
        // A fork at the very tip: the axis has no shoot of its own there.
        if streams[current].length == 0.0 || order > own {
            current = child;
        } else if order == own {
            current = streams.len();
            streams.push(Stream { order: order + 1, length: 0.0, weighed: 0.0 });
        }
    }
    current
}

/// Radius at a fraction of an axis' length.
fn radius_at(nodes: &[Node], total: f32, at: f32) -> f32 {
    let mut rest = at * total;
    for pair in nodes.windows(2) {
        let length = pair[0].position.distance(pair[1].position);
        if rest <= length && length > 0.0 {
            return pair[0].radius + (pair[1].radius - pair[0].radius) * rest / length;
        }
        rest -= length;
    }
    nodes.last().map_or(0.0, |node| node.radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;
    use glam::Vec3;

    /// A tree that forks in two at each tip; lengths and radii fall by given factors.
    fn forking(depth: u32, shorter: f32, thinner: f32) -> Skeleton {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let mut tips = vec![(None, Vec3::ZERO, 0)];
        let (mut length, mut radius) = (8.0_f32, 0.2_f32);
        let mut id = 0;
        for _ in 0..depth {
            let mut next = Vec::new();
            for (parent, from, side) in tips {
                let to = from + Vec3::new(side as f32 * 0.3, 0.0, 1.0).normalize() * length;
                let node = |position| Node { position, radius };
                let axis = Axis::new(id, AxisKind::Stem, 0);
                id += 1;
                let axis = match parent {
                    Some(parent) => axis.on(parent, 1.0, 0),
                    None => axis,
                };
                let index = skeleton.push(axis, [node(from), node(to)]);
                next.extend([(Some(index), to, -1), (Some(index), to, 1)]);
            }
            tips = next;
            length /= shorter;
            radius /= thinner;
        }
        skeleton
    }

    #[test]
    fn a_tree_that_always_forks_in_two_has_the_ratios_it_is_built_with() {
        let measures = Measures::of(&forking(6, 1.5, 1.4));
        let counts: Vec<usize> = measures.orders.iter().map(|order| order.count).collect();
        assert_eq!(counts, [32, 16, 8, 4, 2, 1]);
        let [fork, length, diameter] = measures.ratios().unwrap();
        assert!((fork - 2.0).abs() < 1e-6, "{fork}");
        assert!((length - 1.5).abs() < 1e-5 && (diameter - 1.4).abs() < 1e-5);
    }

    #[test]
    fn side_branches_of_lower_order_do_not_raise_the_trunk() {
        let mut skeleton = forking(1, 1.0, 1.0);
        for i in 0..5_u32 {
            let at = 0.15 * (i + 1) as f32;
            let from = Vec3::Z * (8.0 * at);
            let node = |position| Node { position, radius: 0.02 };
            let axis = Axis::new(100 + u64::from(i), AxisKind::Stem, 0).on(0, at, 1);
            skeleton.push(axis, [node(from), node(from + Vec3::X)]);
        }
        // The first twig meets the trunk's own tip: order 2 begins; the others join it.
        let orders = Measures::of(&skeleton).orders;
        assert_eq!([orders[0].count, orders[1].count], [6, 1]);
        assert!((orders[1].length - 0.75 * 8.0).abs() < 1e-5);
    }

    #[test]
    fn trunks_are_measured_at_breast_height_by_their_cross_sections() {
        let mut skeleton = forking(1, 1.0, 1.0);
        assert!((Measures::of(&skeleton).diameter.unwrap() - 0.4).abs() < 1e-6);
        let node = |z| Node { position: Vec3::new(1.0, 0.0, z), radius: 0.2 };
        skeleton.push(Axis::new(9, AxisKind::Stem, 0), [node(0.0), node(3.0)]);
        let both = Measures::of(&skeleton).diameter.unwrap();
        assert!((both - 0.4 * 2_f32.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn findings_tell_what_lies_outside() {
        let orders = Vec::new();
        let tree = Measures { height: 12.0, diameter: Some(0.15), leaf_area: 500.0, orders };
        let names = |natural: bool| {
            let found = tree.findings().into_iter().filter(|f| f.is_natural() == natural);
            found.map(|f| f.name).collect::<Vec<_>>()
        };
        assert_eq!(names(true), ["height over diameter", "height, m"]);
        assert_eq!(names(false), ["leaf area, m²"]);
        assert!(Measures { diameter: None, ..tree }.findings().is_empty());
    }
}
