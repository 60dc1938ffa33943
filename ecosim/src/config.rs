//! What users write: the table `[ecosim]`.

use crate::clump::Clump;
use crate::disturbance::Disturbance;
use crate::self_thinning::SelfThinning;
use crate::species::Ecology;
use std::collections::{BTreeMap, BTreeSet};
use weald_contract::formula::Variable;
use weald_contract::source::nearest;
use weald_contract::table::{Json, Kind, Tagged};
use weald_contract::{
    Formula, FromToml, Input, InputKind, PLANT_COLUMNS, Problem, Problems, Species, Value, Written,
    choice, table, words,
};

table! {
    /// How plants come to stand on the terrain.
    pub struct Config {
        /// The steps, run in order; each takes the plants so far.
        step: Vec<Tagged<StepCommon, Step>> = Vec::new();
        /// Images that formulas may read, by the name of the file without its ending.
        images: Vec<Written<String>> = Vec::new();
        /// Distances that the plants of halftones keep.
        spacing: Vec<Spacing> = Vec::new();
        /// Most plants that the population may hold; a guard against a slip in a density.
        max_plants: u64 = 5000000, in 0.0..=4000000000.0;
    }
}

table! {
    /// What all steps share.
    pub struct StepCommon {
        /// A name; a named step keeps its random numbers and ids when steps are added before it.
        name: Option<String> = None;
        /// Whether it runs.
        enabled: bool = true;
    }
}

choice! {
    /// A step.
    pub enum Step by "kind" {
        /// Turns a density into plants.
        "halftone" => Halftone(Halftone),
        /// Lets species come, grow, compete and die for some years.
        "simulate" => Simulate(Simulate),
        /// Lets a stand of one species thin itself.
        "self_thinning" => SelfThinning(SelfThinning),
        /// Places single plants.
        "place" => Place(Place),
        /// Makes a density layer of sample plots.
        "plots" => Plots(Plots),
        /// Evens out the distances between plants.
        "relax" => Relax(RelaxStep),
        /// Takes some of the plants, evenly over the ground.
        "thin" => Thin(Thin),
        /// Removes plants.
        "clear" => Clear(Clear),
    }
}

table! {
    /// A distance that plants keep, in both directions.
    ///
    /// It binds the plants of `halftone` steps, which give way to all that stand already. Where
    /// several rules name a pair, the greatest distance counts.
    pub struct Spacing {
        /// The species. Without `from`, each pair of them, and each among its own.
        species: Vec<Written<String>>;
        /// Another species, from which they keep away.
        from: Option<Written<String>> = None;
        /// Between stems, m.
        stems: f64 = 0.0, in 0.0..=10000.0;
        /// Between stems, in sums of the two crown radii: at 1, crowns touch and do not overlap.
        crowns: f64 = 0.0, in 0.0..=100.0;
    }
}

words! {
    /// What the plants of another species do to a density.
    pub enum Effect {
        /// They drive it away.
        Repel = "repel",
        /// They draw it near.
        Attract = "attract",
    }
}

table! {
    /// How the plants of another species that stand already change a density.
    pub struct Neighbour {
        /// The other species.
        species: Written<String>;
        /// Whether it drives away or draws near.
        effect: Effect = Effect::Repel;
        /// Distance from the rim of its crowns up to which the effect is full, m.
        within: f64 = 0.0, in 0.0..=10000.0;
        /// Further distance over which the effect fades, m.
        transition: f64 = 1.0, in 0.001..=10000.0;
        /// Part of the density that is taken away at most.
        strength: f64 = 1.0, in 0.0..=1.0;
    }
}

table! {
    /// What happens at the edge of what is painted.
    pub struct Rim {
        /// Stems stand at least this far inside, m; the count stays what was painted.
        inset: f64 = 0.0, in 0.0..=10000.0;
        /// Distance from the edge over which plants become as old as they would be, m.
        falloff: f64 = 0.0, in 0.0..=10000.0;
        /// Age at the very edge, as a part of what it would be.
        least: f32 = 0.3, in 0.0..=1.0;
        /// Whether plants whose crown would reach over the edge are younger, so that it does not.
        crowns_inside: bool = false;
    }
}

words! {
    /// How a halftone puts plants on the ground.
    pub enum Arrange {
        /// Evenly scattered, as many as the density says.
        Scatter = "scatter",
        /// On a square grid without gaps; the density is the probability that a cell is taken.
        Grid = "grid",
    }
}

words! {
    /// How a density chooses the cells that hold a plant.
    pub enum Method {
        /// Floyd and Steinberg's error diffusion.
        FloydSteinberg = "floyd_steinberg",
        /// Equal steps of expected number along a Hilbert curve.
        Hilbert = "hilbert",
    }
}

words! {
    /// What weighs the ground when a plant moves to the centre of its Voronoi polygon.
    pub enum Weight {
        /// Nothing: the middle of the polygon, the plain form.
        Even = "even",
        /// The density. Many passes drift towards its square root.
        Density = "density",
        /// The square of the density, which many passes keep to.
        Squared = "density_squared",
    }
}

table! {
    /// Turns a density into plants: chosen cells of a raster, then Lloyd's relaxation.
    ///
    /// Plants per m² are the product of `density`, `plots`, `per_m2` and `formula`, of which at
    /// least one is given; what is left out counts as 1. Neighbours, clumps and water take from it.
    pub struct Halftone {
        /// The species.
        species: Written<String>;
        /// Path of a density image; without a georeference it covers the whole terrain.
        density: Option<Written<String>> = None;
        /// Whether black means dense.
        invert: bool = false;
        /// Plants per m² where the image is full; float images hold plants per m² without it.
        per_m2: Option<f32> = None, in 0.0..=10000.0;
        /// Plants per m², or a factor to the image.
        formula: Option<Written<Formula>> = None;
        /// Path of a table of sample plots: x, y, species, area (m²), count.
        plots: Option<Written<String>> = None;
        /// How plants of other species change the density.
        neighbour: Vec<Neighbour> = Vec::new();
        /// Soft spots to which the density keeps.
        clump: Option<Clump> = None;
        /// What happens at the edge of what is painted.
        rim: Option<Rim> = None;
        /// Species whose plants, which stand already, take part in the relaxation as fixed points.
        around: Vec<Written<String>> = Vec::new();
        /// Name of a view; only what it sees is planted, with the ids of the whole planting.
        visible_from: Option<Written<String>> = None;
        /// Distance from what the view sees up to which plants are kept, m.
        visible_margin: f64 = 10.0, in 0.0..=100000.0;
        /// How plants are put on the ground.
        arrange: Arrange = Arrange::Scatter;
        /// How scattered plants are chosen before they relax.
        method: Method = Method::Hilbert;
        /// Side of the cells of which each holds at most one plant, m; chosen when left out.
        cell: Option<Written<f64>> = None, in 0.001..=10000.0;
        /// Iterations of Lloyd's relaxation.
        relax: u32 = 10, in 0.0..=1000.0;
        /// What weighs the ground in them.
        weight: Weight = Weight::Squared;
        /// Iterations of polish after them, which bring every plant to an equal share of the density.
        polish: u32 = 0, in 0.0..=1000.0;
        /// Age in years: a formula, or `[youngest, oldest]`; left out, 0.2 to 0.8 of the lifespan.
        age: Option<Attribute> = None;
        /// Largest random deviation from an age given by a formula, as a part of it.
        age_noise: f32 = 0.2, in 0.0..=1.0;
        /// Vigor: a formula, or `[least, greatest]`; left out, it follows from soil moisture.
        vigor: Option<Attribute> = None;
        /// Largest random deviation from a vigor given by a formula.
        vigor_noise: f32 = 0.1, in 0.0..=1.0;
        /// Height in m: a formula, or `[least, greatest]`; left out, it follows from age and vigor.
        height: Option<Attribute> = None;
        /// Turn about the plant's axis: a formula, or a range, degrees; left out, any.
        yaw_deg: Option<Attribute> = None;
        /// Weight of the vertical against the ground's normal in the axis, 0 to 1: a formula, or a
        /// range; left out, the species'.
        upright: Option<Attribute> = None;
        /// Further columns for its plants, as the members of a group may ask for.
        amount: Vec<Amount> = Vec::new();
    }
}

table! {
    /// A column of the plants table, by which the number of some members of a group is multiplied.
    pub struct Amount {
        /// Name of the column.
        name: Written<String>;
        /// Its values, at least 0.
        formula: Written<Formula>;
    }
}

table! {
    /// Lets species come, grow, compete and die for some years.
    pub struct Simulate {
        /// The species that take part; plants of other species are left as they are.
        species: Vec<Written<String>>;
        /// Years to simulate.
        years: Written<u32>, in 1.0..=100000.0;
        /// Plants of each species sown at the start, wherever they can stand.
        initial: u32 = 0, in 0.0..=100000000.0;
        /// Youngest and oldest age of the plants sown at the start, years.
        initial_age: [f32; 2] = [1.0, 10.0], in 0.0..=10000.0;
        /// Chance that a seedling takes hold where it lands; left out, 1.
        chance: Option<Written<Formula>> = None;
        /// Whether all deaths of a year happen at once.
        order: Order = Order::Sync;
        /// What lies beyond the rim of the terrain.
        edge: Edge = Edge::Open;
        /// Years whose plants are kept in a table each, with the state in which they then stand; 0 is
        /// the start.
        keep: Vec<Written<u32>> = Vec::new();
        /// What kills plants besides age and shade.
        disturbance: Vec<Disturbance> = Vec::new();
    }
}

words! {
    /// Order of the deaths within a year.
    pub enum Order {
        /// All plants look at the same state; a plant that dies may still kill.
        Sync = "sync",
        /// Strongest first; only plants that live on kill.
        Greedy = "greedy",
    }
}

words! {
    /// What lies beyond the rim.
    pub enum Edge {
        /// Nothing.
        Open = "open",
        /// The opposite rim, so that the pattern tiles.
        Torus = "torus",
    }
}

table! {
    /// A species that a table calls otherwise.
    pub struct Naming {
        /// The word in the table, such as a code.
        word: String;
        /// The species that is meant.
        species: Written<String>;
    }
}

table! {
    /// Places single plants: a table of them, or points in the scene.
    pub struct Place {
        /// Path of a table of plants: Parquet, CSV, GeoJSON or GeoPackage.
        plants: Option<Written<String>> = None;
        /// Species that the table calls otherwise.
        names: Vec<Naming> = Vec::new();
        /// Scene coordinates of the table's 0, 0, m, where it counts from a corner of its own; left
        /// out, its places are map coordinates.
        origin: Option<[f64; 2]> = None, in -10000000.0..=10000000.0;
        /// Species of the points in `at` and `dots`.
        species: Option<Written<String>> = None;
        /// Path of an image in which every dark blob is one plant.
        dots: Option<Written<String>> = None;
        /// Points, scene coordinates, m.
        at: Vec<Written<[f64; 2]>> = Vec::new(), in -10000000.0..=10000000.0;
        /// Age in years of the points: a formula, or `[youngest, oldest]`.
        age: Option<Attribute> = None;
        /// Vigor of the points: a formula, or `[least, greatest]`.
        vigor: Option<Attribute> = None;
        /// Height of the points in m: a formula, or `[least, greatest]`.
        height: Option<Attribute> = None;
        /// Turn of the points about their axes: a formula, or a range, degrees; left out, any.
        yaw_deg: Option<Attribute> = None;
        /// Weight of the vertical against the ground's normal in the points' axes, 0 to 1: a
        /// formula, or a range; left out, the species'.
        upright: Option<Attribute> = None;
    }
}

table! {
    /// Makes a layer of plants per m² from counts on sample plots, for the formulas of later steps.
    pub struct Plots {
        /// Path of a table of sample plots: x, y, species, count, and area (m²), radius or width (m).
        plots: Written<String>;
        /// The species whose counts are meant.
        species: Written<String>;
        /// Name of the layer.
        layer: Written<String>;
    }
}

table! {
    /// Evens out the distances between plants by Lloyd's relaxation.
    pub struct RelaxStep {
        /// The species, all together; none named means all.
        species: Vec<Written<String>> = Vec::new();
        /// Iterations.
        iterations: u32 = 5, in 0.0..=1000.0;
        /// Where plants are wanted denser, as a formula; left out, evenly wherever they can stand.
        formula: Option<Written<Formula>> = None;
        /// What weighs the ground.
        weight: Weight = Weight::Squared;
    }
}

words! {
    /// Which of some plants that stand together stays.
    pub enum Favour {
        /// The one with the widest crown: thinning from below.
        Large = "large",
        /// The one with the narrowest crown: thinning from above.
        Small = "small",
        /// Any.
        Any = "any",
    }
}

table! {
    /// Takes some of the plants, so that as many as said stay, evenly over the ground.
    ///
    /// Of `keep`, `plants` and `stems` at least one is given.
    pub struct Thin {
        /// The species, all together; none named means all.
        species: Vec<Written<String>> = Vec::new();
        /// Part of the plants that stays, 0 to 1: a formula, or a number.
        keep: Option<Written<Formula>> = None;
        /// Number of plants that stay in all; `keep` then says only where more of them do.
        plants: Option<u64> = None, in 0.0..=4000000000.0;
        /// Least distance between the stems of those that stay, m.
        stems: f64 = 0.0, in 0.0..=10000.0;
        /// Which of some plants that stand together stays.
        favour: Favour = Favour::Large;
        /// Only inside this disc: x, y, radius in scene coordinates, m.
        disc: Option<[f64; 3]> = None, in -10000000.0..=10000000.0;
    }
}

table! {
    /// Removes plants.
    pub struct Clear {
        /// The species; none named means all.
        species: Vec<Written<String>> = Vec::new();
        /// Only inside this disc: x, y, radius in scene coordinates, m.
        disc: Option<[f64; 3]> = None, in -10000000.0..=10000000.0;
        /// Only where this is above 0.
        formula: Option<Written<Formula>> = None;
    }
}

/// A number for each plant: computed, or drawn evenly from a range.
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    /// Least and greatest value.
    Range([f32; 2]),
    /// A formula over terrain layers at the plant's place.
    Formula(Written<Formula>),
}

impl serde::Serialize for Attribute {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Range(range) => range.serialize(serializer),
            Self::Formula(formula) => formula.serialize(serializer),
        }
    }
}

impl FromToml for Attribute {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        if !matches!(value.kind, Kind::Array(_)) {
            return Written::from_toml(value, problems).map(Self::Formula);
        }
        let range = <[f32; 2]>::from_toml(value, problems)?;
        if range[0] <= range[1] && range[0] >= 0.0 {
            return Some(Self::Range(range));
        }
        problems.push(
            Problem::at(value.span, "a range must rise and not begin below 0")
                .hint("write `[least, greatest]`, or a formula in quotes"),
        );
        None
    }

    fn schema() -> Json {
        let pair = <[f32; 2]>::schema();
        let formula = Formula::schema();
        Json::Object([("oneOf".to_string(), vec![pair, formula].into())].into_iter().collect())
    }
}

impl Default for Config {
    fn default() -> Self {
        Self { step: Vec::new(), images: Vec::new(), spacing: Vec::new(), max_plants: 5_000_000 }
    }
}

impl Config {
    /// Returns the files that the steps name.
    pub fn inputs(&self) -> Vec<Input> {
        let image = |(index, path): (usize, &Written<String>)| Input {
            field: format!("ecosim.images[{index}]"),
            path: path.clone(),
            kind: InputKind::Image,
        };
        let mut inputs: Vec<Input> = self.images.iter().enumerate().map(image).collect();
        for (index, step) in self.step.iter().enumerate().filter(|(_, s)| s.common.enabled) {
            let files = match &step.variant {
                Step::Halftone(halftone) => [
                    (&halftone.density, "density", InputKind::Image),
                    (&halftone.plots, "plots", InputKind::Plants),
                ],
                Step::Place(place) => [
                    (&place.plants, "plants", InputKind::Plants),
                    (&place.dots, "dots", InputKind::Image),
                ],
                Step::Plots(plots) => {
                    let (field, path) =
                        (format!("ecosim.step[{index}].plots"), plots.plots.clone());
                    inputs.push(Input { field, path, kind: InputKind::Plants });
                    continue;
                }
                Step::Simulate(_)
                | Step::SelfThinning(_)
                | Step::Relax(_)
                | Step::Thin(_)
                | Step::Clear(_) => continue,
            };
            for (path, word, kind) in files {
                let field = format!("ecosim.step[{index}].{word}");
                let path = path.iter().cloned();
                inputs.extend(path.map(|path| Input { field: field.clone(), path, kind }));
            }
        }
        inputs
    }

    /// Returns the species that the steps name, in the order in which they are written.
    ///
    /// Those that a formula names in `crown_shadow` are not listed: they cast shadow only if a
    /// step plants them.
    pub fn species(&self) -> Vec<&Written<String>> {
        self.enabled().flat_map(Step::species).collect()
    }

    /// Returns the species that the words of a table mean which some `place` step reads.
    ///
    /// Tables of sample plots bring none: of theirs only those are planted that a step names.
    pub fn species_of_table(&self, path: &str, words: &[String]) -> Vec<String> {
        let mut meant = Vec::new();
        for step in self.enabled() {
            let Step::Place(place) = step else { continue };
            if place.plants.as_ref().is_some_and(|table| table.value == path) {
                meant.extend(words.iter().map(|word| place.species_meant(word).to_string()));
            }
        }
        meant
    }

    /// Returns the steps that run.
    pub(crate) fn enabled(&self) -> impl Iterator<Item = &Step> {
        self.step.iter().filter(|step| step.common.enabled).map(|step| &step.variant)
    }

    /// Finds what is wrong before any work: species that do not exist or have no ecology, steps
    /// without what they need, and layers that formulas name but the terrain will not have.
    pub fn check(
        &self,
        species: &BTreeMap<String, (Species, Ecology)>,
        layers: &[&str],
    ) -> Problems {
        let mut problems = Problems::new();
        let named: BTreeSet<&str> = self.species().iter().map(|name| name.value.as_str()).collect();
        for (_, ecology) in named.iter().filter_map(|name| species.get(*name)) {
            ecology.check(layers, &mut problems);
        }
        let mut layers = layers.to_vec();
        for path in &self.images {
            let stem = stem(&path.value);
            if layers.contains(&stem) {
                let message = format!("formulas know another layer or image as `{stem}`");
                problems.push(Problem::at(path.span, message).hint("give the file another name"));
            }
            layers.push(stem);
        }
        for step in self.enabled() {
            let Step::Plots(Plots { layer, .. }) = step else { continue };
            problems.extend(wrong_name(layer, &layers));
            layers.push(&layer.value);
        }
        let layers = &layers;
        for rule in &self.spacing {
            for name in rule.species.iter().chain(&rule.from) {
                check_species(name, species, &mut problems);
            }
        }
        for step in self.enabled() {
            for name in step.species() {
                check_species(name, species, &mut problems);
            }
            for formula in step.formulas() {
                check_formula(formula, species, layers, &mut problems);
            }
            step.check(species, layers, &mut problems);
        }
        problems
    }
}

impl Step {
    /// Returns the species that the step's own fields name.
    pub(crate) fn species(&self) -> Vec<&Written<String>> {
        match self {
            Self::Halftone(halftone) => {
                let others = halftone.neighbour.iter().map(|neighbour| &neighbour.species);
                std::iter::once(&halftone.species).chain(others).chain(&halftone.around).collect()
            }
            Self::Simulate(simulate) => simulate.species.iter().collect(),
            Self::Plots(plots) => vec![&plots.species],
            Self::SelfThinning(thinning) => vec![&thinning.species],
            Self::Place(place) => {
                place.species.iter().chain(place.names.iter().map(|name| &name.species)).collect()
            }
            Self::Relax(relax) => relax.species.iter().collect(),
            Self::Thin(thin) => thin.species.iter().collect(),
            Self::Clear(clear) => clear.species.iter().collect(),
        }
    }

    fn formulas(&self) -> Vec<&Written<Formula>> {
        match self {
            Self::Halftone(h) => {
                let attributes = [&h.age, &h.vigor, &h.height, &h.yaw_deg, &h.upright];
                let attributes = attributes.into_iter().flat_map(attribute_formula);
                let amounts = h.amount.iter().map(|amount| &amount.formula);
                h.formula.iter().chain(attributes).chain(amounts).collect()
            }
            Self::Simulate(simulate) => {
                let of_disturbances = simulate.disturbance.iter().flat_map(|d| &d.mortality);
                simulate.chance.iter().chain(of_disturbances).collect()
            }
            Self::SelfThinning(_) => Vec::new(),
            Self::Place(p) => {
                let attributes = [&p.age, &p.vigor, &p.height, &p.yaw_deg, &p.upright];
                attributes.into_iter().flat_map(attribute_formula).collect()
            }
            Self::Relax(relax) => relax.formula.iter().collect(),
            Self::Thin(thin) => thin.keep.iter().collect(),
            Self::Plots(_) => Vec::new(),
            Self::Clear(clear) => clear.formula.iter().collect(),
        }
    }

    fn check(
        &self,
        species: &BTreeMap<String, (Species, Ecology)>,
        layers: &[&str],
        problems: &mut Problems,
    ) {
        match self {
            Self::Halftone(halftone) => halftone.check(species, problems),
            Self::Simulate(simulate) => simulate.check(species, layers, problems),
            Self::SelfThinning(thinning) => thinning.check(problems),
            Self::Place(place) => place.check(problems),
            Self::Plots(_) | Self::Relax(_) | Self::Thin(_) | Self::Clear(_) => {}
        }
    }
}

impl Halftone {
    fn check(&self, species: &BTreeMap<String, (Species, Ecology)>, problems: &mut Problems) {
        let sources = [self.density.is_some(), self.plots.is_some(), self.formula.is_some()];
        if self.per_m2.is_none() && !sources.contains(&true) {
            problems.push(
                Problem::at(self.species.span, "this halftone says nowhere how dense it is")
                    .hint("give `density` (an image), `plots`, `per_m2` or `formula`"),
            );
        }
        for (index, Amount { name, .. }) in self.amount.iter().enumerate() {
            let others: Vec<&str> =
                self.amount[..index].iter().map(|other| other.name.value.as_str()).collect();
            problems.extend(wrong_column(name, &others));
        }
        let is_group = species.get(&self.species.value).is_some_and(|s| s.0.group.is_some());
        if self.arrange == Arrange::Grid && self.cell.is_none() && !is_group {
            problems.push(
                Problem::at(self.species.span, "a grid needs the side of its cells")
                    .hint("give `cell`, or a species with a `[group]`, whose `side` counts"),
            );
        }
    }
}

impl Simulate {
    fn check(
        &self,
        species: &BTreeMap<String, (Species, Ecology)>,
        layers: &[&str],
        problems: &mut Problems,
    ) {
        if self.species.is_empty() {
            let problem = Problem::at(self.years.span, "this simulation has no species");
            problems.push(problem.hint("name at least one in `species`"));
        }
        for (index, name) in self.species.iter().enumerate() {
            if self.species[..index].contains(name) {
                let message = format!("species `{}` is named twice", name.value);
                problems.push(Problem::at(name.span, message));
            }
            let lacks = species.get(&name.value).is_some_and(|(s, _)| s.ecology.is_none());
            if lacks {
                let message = format!("species `{}` has no `[ecology]` to simulate", name.value);
                let hint = "add an `[ecology]` table to its species file";
                problems.push(Problem::at(name.span, message).hint(hint));
            }
        }
        check_kept(&self.keep, self.years.value, "year", problems);
        for disturbance in &self.disturbance {
            disturbance.check(&self.species, self.years.value, problems);
        }
        if !layers.contains(&"soil_moisture") {
            let message = "the terrain has no layer `soil_moisture`, from which vigor follows";
            problems.push(Problem::at(self.years.span, message));
        }
    }
}

impl Place {
    /// Returns the species that a word of the table means.
    pub(crate) fn species_meant<'a>(&'a self, word: &'a str) -> &'a str {
        let naming = self.names.iter().find(|naming| naming.word == word);
        naming.map_or(word, |naming| &naming.species.value)
    }

    fn check(&self, problems: &mut Problems) {
        if let (Some(first), None) = (self.at.first(), &self.species) {
            let problem = Problem::at(first.span, "these points have no species");
            problems.push(problem.hint("add `species = \"…\"`"));
        }
        if let (Some(dots), None) = (&self.dots, &self.species) {
            let problem = Problem::at(dots.span, "these dots have no species");
            problems.push(problem.hint("add `species = \"…\"`"));
        }
        let has_places = !self.at.is_empty() || self.dots.is_some();
        if let (Some(species), false) = (&self.species, has_places) {
            let problem = Problem::at(species.span, "this species is placed nowhere");
            problems.push(problem.hint("add `at = [[x, y], …]` or `dots`, an image"));
        }
    }
}

/// Complains of steps or years to be kept that a simulation does not reach.
pub(crate) fn check_kept(kept: &[Written<u32>], last: u32, unit: &str, problems: &mut Problems) {
    for step in kept.iter().filter(|step| step.value > last) {
        let message = format!("{unit} {} is never reached", step.value);
        let hint = format!("the simulation ends with {unit} {last}");
        problems.push(Problem::at(step.span, message).hint(hint));
    }
}

/// Says why a layer cannot have its name, if it cannot.
fn wrong_name(layer: &Written<String>, others: &[&str]) -> Option<Problem> {
    if !is_word(&layer.value) {
        let problem = Problem::at(layer.span, format!("`{}` is no name of a layer", layer.value));
        return Some(problem.hint("lower-case letters, digits and `_` make one: `oak_density`"));
    }
    others.contains(&layer.value.as_str()).then(|| {
        let message = format!("formulas know another layer or image as `{}`", layer.value);
        Problem::at(layer.span, message).hint("give this one another name")
    })
}

/// Says why a column cannot have its name, if it cannot.
fn wrong_column(name: &Written<String>, others: &[&str]) -> Option<Problem> {
    let column = name.value.as_str();
    if !is_word(column) {
        let problem = Problem::at(name.span, format!("`{column}` is no name of a column"));
        return Some(problem.hint("lower-case letters, digits and `_` make one: `daisies`"));
    }
    (others.contains(&column) || PLANT_COLUMNS.contains(&column)).then(|| {
        let message = format!("plants have another column `{column}`");
        Problem::at(name.span, message).hint("give this one another name")
    })
}

fn is_word(name: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_lowercase() || c == '_';
    name.starts_with(is_letter) && name.chars().all(|c| is_letter(c) || c.is_ascii_digit())
}

/// Returns a file's name without folders and ending: its name in formulas.
pub(crate) fn stem(path: &str) -> &str {
    let name = path.rsplit(['/', '\\']).next().unwrap_or(path);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

fn attribute_formula(attribute: &Option<Attribute>) -> impl Iterator<Item = &Written<Formula>> {
    attribute.iter().filter_map(|attribute| match attribute {
        Attribute::Formula(formula) => Some(formula),
        Attribute::Range(_) => None,
    })
}

fn check_species(
    name: &Written<String>,
    species: &BTreeMap<String, (Species, Ecology)>,
    problems: &mut Problems,
) {
    if species.contains_key(&name.value) {
        return;
    }
    let problem = Problem::at(name.span, format!("unknown species `{}`", name.value));
    problems.push(suggest(problem, &name.value, species.keys().map(String::as_str)));
}

/// Notes the layers and species that a formula reads but nobody has.
fn check_formula(
    formula: &Written<Formula>,
    species: &BTreeMap<String, (Species, Ecology)>,
    layers: &[&str],
    problems: &mut Problems,
) {
    let reads = formula.value.variables().iter().zip(formula.value.spans());
    for (variable, range) in reads {
        let (what, name, known): (_, _, Vec<&str>) = match variable {
            Variable::Layer(name) => ("layer", name, layers.to_vec()),
            Variable::CrownShadow(name) => {
                ("species", name, species.keys().map(String::as_str).collect())
            }
            Variable::X | Variable::Y => continue,
        };
        if !known.contains(&name.as_str()) {
            // The span of a text begins with its quotation mark.
            let span = formula.span.narrow(range.start + 1..range.end + 1);
            let problem = Problem::at(span, format!("unknown {what} `{name}`"));
            problems.push(suggest(problem, name, known.into_iter()));
        }
    }
}

fn suggest<'a>(problem: Problem, word: &str, known: impl Iterator<Item = &'a str>) -> Problem {
    let known: Vec<&str> = known.collect();
    match nearest(word, known.iter().copied()) {
        Some(near) => problem.hint(format!("did you mean `{near}`?")),
        None if known.is_empty() => problem,
        None => problem.hint(format!("known here: {}", known.join(", "))),
    }
}
