//! Plants by parametric L-systems: strings of modules that rewrite themselves [Prus90].
//!
//! An axiom is rewritten step by step: every module is replaced at once by the successor of the
//! first production that fits its letter, its parameters and its neighbours. What results is read
//! by a turtle that draws axes and places organs. [`grammar`] reads the productions, [`rewrite`]
//! applies them, [`turtle`] turns the string into a skeleton.
//!
//! ```text
//! define plastochron = 2
//! A(n) : n < 14 -> I(time) [ &(55) ~leaf(0.08 * smoothstep(0, 6, time - n)) ] /(137.5) A(n + 1)
//! B < C > D(x) : x > 0.5 -> C [ B ] : 0.7
//! ```
//!
//! Growth is continuous and nested. A plant of a given maturity has lived `time` = `steps` times
//! maturity; whole steps rewrite the string, and formulas may subtract from `time` the step at
//! which a module was born, so that it comes in from nothing. Every module carries a hash of the
//! path of successors it descends from. Axes take their identity from it, and so does chance:
//! neither changes when the plant grows on.
//!
//! Formulas are those of [`weald_contract::Formula`], whose names stand for parameters here; its
//! power operator binds as there, and logic is written `and`, `or`, `not`. Functions of age are
//! written as tables, `define opening(t) = curve(t, 0, 0, 3, 0.7, 8, 1)`, or with `smoothstep`,
//! `lerp` and `clamp`.
//!
//! A plant can ask what surrounds it (an *open* L-system [Mech96]): [`environment`] answers `?E`
//! with the light that reaches the module or with its neighbours, and `?P`, `?H`, `?L` and `?U`
//! with the turtle's place and frame.

pub mod environment;
pub mod grammar;
pub mod rewrite;
pub mod turtle;

use crate::Stature;
use crate::material::{LeafColor, opaque, petal};
use crate::organ::{self, LeafShape};
use crate::skeleton::{AxisKind, Skeleton};
use environment::Environment;
use glam::Vec3;
use grammar::{Grammar, Texts};
use weald_contract::table::Tagged;
use weald_contract::{Problem, Problems, Seed, Span, Written, choice, table, words};

table! {
    /// A plant that rewrites itself.
    pub struct Lsystem {
        /// Steps of rewriting for a mature plant; a smaller one makes the part of its maturity.
        steps: f32 = 12.0, in 0.0..=400.0;
        /// The string to begin with.
        axiom: Written<String>;
        /// Productions, one a line: `left < A(x) > right : condition -> successor : weight`.
        rules: Written<String> = Written::default();
        /// Productions applied over and over to what a step has made.
        decomposition: Written<String> = Written::default();
        /// Productions applied over and over to what the turtle reads.
        interpretation: Written<String> = Written::default();
        /// Letters that contexts do not see; they never see the turtle's signs.
        ignore: String = String::new();
        /// Angle of a turn that is written without one, degrees.
        angle_deg: f32 = 30.0, in -360.0..=360.0;
        /// Length of a move that is written without one, m.
        step: f32 = 0.02, in 0.0..=100.0;
        /// Direction towards which stems bend while they grow.
        tropism: [f32; 3] = [0.0, 0.0, -1.0], in -1.0..=1.0;
        /// How far they bend: radians a segment at right angles to it; `_(e)` changes it.
        elasticity: f32 = 0.0, in -3.0..=3.0;
        /// Whether the plant is stretched to the crown radius asked for.
        fit_crown: bool = true;
        /// What answers `?E`.
        environment: Environment = Environment::default();
        /// What lines are drawn with: the first, until `'` takes the next or `'(i)` number i.
        stroke: Written<Vec<Stroke>> = Written { value: vec![Stroke::green()], span: Span::default() };
        /// What `~name(length)` or `~name(width, length)` places.
        organ: Vec<Tagged<OrganName, OrganKind>> = Vec::new();
    }
}

words! {
    /// How a line is swept.
    pub enum Sweep {
        /// As a round stem.
        Stem = "stem",
        /// As a flat blade, as wide as the line.
        Blade = "blade",
    }
}

table! {
    /// Shape and colour of lines.
    pub struct Stroke {
        /// Round or flat.
        sweep: Sweep = Sweep::Stem;
        /// Reflectance of stems.
        color: [f32; 3] = [0.10, 0.14, 0.05], in 0.0..=0.9;
        /// Colour of blades.
        leaf: LeafColor = LeafColor::default();
    }
}

impl Stroke {
    /// A green stem.
    fn green() -> Self {
        Self { sweep: Sweep::Stem, color: [0.10, 0.14, 0.05], leaf: LeafColor::default() }
    }
}

table! {
    /// The word by which an organ is placed.
    pub struct OrganName {
        /// Letters, digits and underscores, a letter first.
        name: Written<String>;
    }
}

choice! {
    /// What an organ looks like.
    pub enum OrganKind by "kind" {
        /// A leaf, petal or leaflet.
        "leaf" => Leaf(Leaf),
        /// A head of petals around a disc; its scale is its radius.
        "flower" => Flower(Flower),
        /// A closed body: bud, blossom, berry, grain.
        "bead" => Bead(Bead),
    }
}

table! {
    /// A leaf of length 1.
    pub struct Leaf {
        /// Outline.
        shape: LeafShape = LeafShape::Elliptic;
        /// Width over length, where only the length is given.
        width: f32 = 0.5, in 0.005..=5.0;
        /// Rise of the margin over the midrib, relative to length.
        fold: f32 = 0.1, in -1.0..=1.0;
        /// Drop of the tip, relative to length.
        bend: f32 = 0.25, in -1.0..=1.0;
        /// Kinds that differ in colour.
        hues: u32 = 3, in 1.0..=8.0;
        /// Colour.
        color: LeafColor = LeafColor::default();
    }
}

table! {
    /// A flower head of radius 1.
    pub struct Flower {
        /// Petals.
        petals: u32 = 13, in 3.0..=120.0;
        /// Radius of the disc relative to the head.
        disc: f32 = 0.3, in 0.02..=0.9;
        /// Height of the disc relative to its radius.
        disc_height: f32 = 0.5, in 0.05..=4.0;
        /// Rise of the petals' tips relative to their length; negative ones hang.
        petal_rise: f32 = 0.1, in -2.0..=2.0;
        /// Colour of the petals.
        petal_color: [f32; 3] = [0.6, 0.6, 0.55], in 0.0..=0.9;
        /// Colour of the disc.
        disc_color: [f32; 3] = [0.5, 0.32, 0.02], in 0.0..=0.9;
    }
}

table! {
    /// A closed body of length 1, pointed at both ends.
    pub struct Bead {
        /// Width over length, where only the length is given.
        width: f32 = 0.6, in 0.005..=5.0;
        /// Sides.
        sides: u32 = 5, in 3.0..=16.0;
        /// Colour.
        color: [f32; 3] = [0.3, 0.2, 0.1], in 0.0..=0.9;
    }
}

impl Lsystem {
    /// Everything wrong with the form that its types could not tell.
    pub fn check(&self) -> Problems {
        let mut problems = Vec::new();
        for organ in &self.organ {
            problems.extend(match &organ.variant {
                OrganKind::Leaf(leaf) => leaf.color.check(),
                _ => Vec::new(),
            });
        }
        if self.stroke.value.is_empty() {
            problems.push(Problem::at(self.stroke.span, "at least one stroke is needed"));
        }
        problems.extend(self.stroke.value.iter().flat_map(|stroke| stroke.leaf.check()));
        if let Err(more) = self.grammar() {
            problems.extend(more);
        }
        problems
    }

    /// The productions, read.
    ///
    /// # Errors
    /// Every mistake in them, each at its token.
    pub fn grammar(&self) -> Result<Grammar, Problems> {
        Grammar::read(&Texts {
            axiom: &self.axiom,
            rules: &self.rules,
            decomposition: &self.decomposition,
            interpretation: &self.interpretation,
            ignore: &self.ignore,
            organs: self.organ.iter().map(|organ| &organ.common.name).collect(),
        })
    }

    /// Grows a plant.
    ///
    /// # Errors
    /// The first of [`Lsystem::check`], or the production that makes the string too long.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        let grammar = self.grammar().map_err(first)?;
        let time = self.steps * stature.maturity;
        let mut skeleton = Skeleton::default();
        let styles = self.styles(&mut skeleton, stature.vigor);
        let string = rewrite::derive(&grammar, time, stature, seed, &mut |word| {
            let mut sketch = skeleton.clone();
            let questions = turtle::draw(self, word, &styles, stature, &mut sketch)?;
            Ok(self.environment.answers(&questions))
        })?;
        turtle::draw(self, &string, &styles, stature, &mut skeleton)?;
        self.fit(&mut skeleton, stature);
        Ok(skeleton)
    }

    /// Scales the whole drawing, organs included, to the height asked for, and its places to the
    /// crown radius as far as that does not spoil its shape.
    fn fit(&self, skeleton: &mut Skeleton, stature: &Stature) {
        let [reach, height] = extent(skeleton);
        // What lies on the ground stays lower than asked for.
        let up = if height > 0.02 * stature.height { stature.height / height } else { 1.0 };
        let wanted = if self.fit_crown { stature.radius / reach.max(1e-6) } else { up };
        // Lines are not made thicker than they were drawn: a seedling would turn into a stump.
        skeleton.stretch(wanted.clamp(0.6 * up, 1.6 * up), up, up.min(1.0));
        skeleton.organs.iter_mut().for_each(|organ| organ.scale *= up);
    }

    /// Materials and organs of a plant of this vigor.
    fn styles(&self, skeleton: &mut Skeleton, vigor: f32) -> Styles {
        let strokes = self.stroke.value.iter().zip(0..).map(|(stroke, i)| {
            let (kind, material) = match stroke.sweep {
                Sweep::Stem => (AxisKind::Stem, opaque(&format!("stem-{i}"), stroke.color)),
                Sweep::Blade => {
                    (AxisKind::Blade, stroke.leaf.material(&format!("blade-{i}"), vigor, 0, 1))
                }
            };
            (kind, skeleton.add_material(material))
        });
        let strokes = strokes.collect();
        let organs = self.organ.iter().map(|organ| {
            let name = organ.common.name.value.as_str();
            match &organ.variant {
                OrganKind::Leaf(leaf) => leaf.style(name, skeleton, vigor),
                OrganKind::Flower(flower) => flower.style(name, skeleton),
                OrganKind::Bead(bead) => bead.style(name, skeleton),
            }
        });
        Styles { organs: organs.collect(), strokes }
    }
}

/// Distance from the vertical through the foot and height that nodes and organs reach, m.
fn extent(skeleton: &Skeleton) -> [f32; 2] {
    let nodes = skeleton.nodes.iter().map(|node| node.position);
    let corners = skeleton.organs.iter().flat_map(|organ| {
        let meshes = &skeleton.prototypes[organ.prototype as usize].meshes;
        let corners = meshes.iter().flat_map(|mesh| &mesh.positions);
        corners.map(|p| organ.position + organ.rotation * (organ.scale * Vec3::from_array(*p)))
    });
    nodes.chain(corners).fold([0.0; 2], |[reach, height], p| {
        [f32::max(reach, p.truncate().length()), f32::max(height, p.z)]
    })
}

/// The first of several problems; a list of problems is never empty.
fn first(problems: Problems) -> Problem {
    problems.into_iter().next().unwrap_or_else(|| Problem::new("the L-system cannot be read"))
}

/// What the turtle draws with.
#[derive(Clone, Debug, PartialEq)]
pub struct Styles {
    /// Sweep and material of each stroke.
    pub strokes: Vec<(AxisKind, u32)>,
    /// Prototypes of each organ.
    pub organs: Vec<OrganStyle>,
}

/// The prototypes of one organ.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganStyle {
    /// First of its prototypes.
    pub prototype: u32,
    /// How many there are; they differ in colour.
    pub hues: u32,
    /// Width over length where only one scale is given.
    pub slim: f32,
    /// Whether it is as deep as wide; the depth of leaves goes with their length.
    pub is_round: bool,
}

impl Leaf {
    fn style(&self, name: &str, skeleton: &mut Skeleton, vigor: f32) -> OrganStyle {
        let prototype = skeleton.prototypes.len() as u32;
        for hue in 0..self.hues {
            let name = format!("{name}-{hue}");
            let material = self.color.material(&name, vigor, hue, self.hues);
            let material = skeleton.add_material(material);
            let mesh = organ::leaf(self.shape, self.fold, self.bend, material);
            skeleton.add_prototype(&name, vec![mesh]);
        }
        OrganStyle { prototype, hues: self.hues, slim: self.width, is_round: false }
    }
}

impl Flower {
    fn style(&self, name: &str, skeleton: &mut Skeleton) -> OrganStyle {
        let petals = skeleton.add_material(petal(&format!("{name}-petal"), self.petal_color, 0.35));
        let disc = skeleton.add_material(opaque(&format!("{name}-disc"), self.disc_color));
        let long = 1.0 - 0.8 * self.disc;
        let inner = 0.8 * self.disc / long;
        // Petals touch each other where they are widest.
        let girth = 1.5 * std::f32::consts::PI * (0.8 * self.disc + 0.62 * long);
        let width = girth / (self.petals as f32 * long);
        let ring = organ::petals(self.petals, inner, width, self.petal_rise, petals);
        let meshes = vec![
            organ::scaled(ring, long, [0.0; 3]),
            organ::scaled(organ::dome(6, self.disc_height, disc), self.disc, [0.0; 3]),
        ];
        let prototype = skeleton.add_prototype(name, meshes);
        OrganStyle { prototype, hues: 1, slim: 1.0, is_round: true }
    }
}

impl Bead {
    fn style(&self, name: &str, skeleton: &mut Skeleton) -> OrganStyle {
        let material = skeleton.add_material(opaque(name, self.color));
        let mesh = organ::bead(self.sides, material);
        let prototype = skeleton.add_prototype(name, vec![mesh]);
        OrganStyle { prototype, hues: 1, slim: self.width, is_round: true }
    }
}

#[cfg(test)]
mod tests;
