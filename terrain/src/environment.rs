//! Layers that are made only when somebody asks: light, warmth, soil, and where water gathers.
//!
//! [`CATALOGUE`] lists all layers of a terrain with unit and definition. Eight of them later stages
//! read, and they are always made; the others when `[terrain] layers` names them.

use crate::config::Config;
use crate::derive;
use crate::disperse::{self, Dispersion, MULTIPLE_EXPONENT};
use crate::flow::{self, OUT};
use crate::lattice::Lattice;
use crate::stack::{Shaped, sample};
use crate::suction;
use crate::sun::{self, Relief, Season};
use crate::water::{BARE_SLOPE_DEG, Hydrology};
use crate::{Error, check_cancelled};
use std::collections::BTreeSet;
use weald_contract::{Layers, Problem, Problems, Progress, Span, Written, table, words};

/// A layer that a terrain can have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerKind {
    /// File stem, and the name in formulas.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// How its values are defined.
    pub definition: &'static str,
    /// Whether later stages read it, so that it is always made.
    pub is_usual: bool,
}

const fn usual(name: &'static str, unit: &'static str, definition: &'static str) -> LayerKind {
    LayerKind { name, unit, definition, is_usual: true }
}

const fn on_demand(name: &'static str, unit: &'static str, definition: &'static str) -> LayerKind {
    LayerKind { name, unit, definition, is_usual: false }
}

/// All layers, by name.
pub const CATALOGUE: [LayerKind; 24] = [
    usual("altitude", "m", "Altitude of the ground, in the source's vertical datum"),
    usual(
        "aspect",
        "degree",
        "Direction in which the ground falls, clockwise from north; 0 where level",
    ),
    on_demand(
        "curvature_plan",
        "m-1",
        "Bend of the ground across its slope, positive on ridges (Zevenbergen and Thorne)",
    ),
    on_demand(
        "curvature_profile",
        "m-1",
        "Bend of the ground along its slope, positive where it steepens downwards",
    ),
    on_demand("eastness", "1", "Sine of aspect times sine of slope: 1 for a wall that faces east"),
    usual("filled", "m", "Lowest level from which water can leave the cell: hollows filled"),
    on_demand(
        "heat_load",
        "MJ cm-2 a-1",
        "Heat load index of McCune and Keon (2002), equation 1, aspect folded about south-west",
    ),
    on_demand(
        "height_above_drainage",
        "m",
        "Height above the stream, open water or edge that the cell drains to, at least 0",
    ),
    on_demand(
        "insolation",
        "MJ m-2 d-1",
        "Clear-sky energy of sun and sky on the ground's slope behind its horizon, mean of the days",
    ),
    on_demand("normal_east", "1", "East part of the ground's unit normal"),
    on_demand("normal_north", "1", "North part of the ground's unit normal"),
    on_demand("normal_up", "1", "Upward part of the ground's unit normal: the cosine of slope"),
    on_demand(
        "northness",
        "1",
        "Cosine of aspect times sine of slope: 1 for a wall that faces north",
    ),
    on_demand(
        "sky_view",
        "1",
        "Cosine-weighted share of the sky that the ground's slope sees past its horizon",
    ),
    usual("slope", "degree", "Steepness of the ground, 3 x 3 cells (Horn)"),
    on_demand(
        "soil_depth",
        "m",
        "Depth of soil: that of level ground, thinning with slope to nothing at 60 degrees",
    ),
    usual("soil_moisture", "1", "Water in the soil over what level soil holds, under open water 1"),
    on_demand(
        "soil_water",
        "kg m-2",
        "Water in the soil: soil moisture times the capacity of level soil",
    ),
    on_demand(
        "specific_catchment_area",
        "m",
        "Area above per metre of contour, by the flow routing that was chosen",
    ),
    on_demand(
        "temperature",
        "degree_C",
        "Mean air temperature from altitude and, where asked, sun",
    ),
    usual(
        "upslope_area",
        "m2",
        "Area that drains through the cell by steepest descent (D8), hollows included",
    ),
    usual("water_depth", "m", "Depth of open water above the ground"),
    usual(
        "wetness",
        "1",
        "Topographic wetness index ln(a / tan b): a area above per metre of contour, tan b >= 0.001",
    ),
    on_demand(
        "wetness_suction",
        "1",
        "Wetness index with areas drawn up from wet neighbours over gentle slopes (Boehner and Selige)",
    ),
];

/// `normal` stands for its three parts.
const NORMAL: [&str; 3] = ["normal_east", "normal_north", "normal_up"];

/// The kind of layer with a name.
pub fn kind(name: &str) -> Option<&'static LayerKind> {
    CATALOGUE.iter().find(|kind| kind.name == name)
}

words! {
    /// How water divides on its way down, for `specific_catchment_area`.
    pub enum Routing {
        /// All to the steepest neighbour.
        D8 = "d8",
        /// Between two neighbours along the steepest way.
        Infinite = "d_infinity",
        /// Among all lower neighbours.
        Multiple = "multiple",
    }
}

table! {
    /// `[terrain.environment]`: what the layers made on demand need to know.
    pub struct Environment {
        /// Latitude, degrees, north positive.
        latitude_deg: f64 = 45.0, in -90.0..=90.0;
        /// Days of the year whose mean insolation is, 1 for the first of January.
        days: Written<Vec<f64>> = middle_of_months(), in 1.0..=366.0;
        /// Share of the sun's beam that passes the air when it stands overhead.
        transmissivity: f64 = 0.7, in 0.05..=1.0;
        /// Places of the sun in a day.
        sun_steps: u32 = 24, in 4.0..=1440.0;
        /// Mean air temperature at `temperature_altitude`, degrees Celsius.
        temperature: f64 = 10.0, in -100.0..=100.0;
        /// Altitude to which `temperature` belongs, m; without it the mean of the terrain.
        temperature_altitude: Option<f64> = None, in -100000.0..=100000.0;
        /// Cooling with height, K per km.
        lapse_per_km: f64 = 6.5, in -50.0..=50.0;
        /// Warming by sun, K for each MJ m-2 d-1 more than the terrain's mean.
        warming: f64 = 0.0, in -10.0..=10.0;
        /// Depth of soil on level ground, m.
        soil_depth: f64 = 1.0, in 0.0..=1000.0;
        /// Area above which water runs in a channel, m2.
        channel_area: f64 = 10000.0, in 0.0..=1e15;
        /// How water divides on its way.
        routing: Routing = Routing::Infinite;
        /// Strength with which gentle slopes draw up water, for `wetness_suction`.
        suction: f64 = 10.0, in 1.0..=1000.0;
    }
}

/// The 15th day of each month of a common year.
fn middle_of_months() -> Written<Vec<f64>> {
    let days = [15, 46, 74, 105, 135, 166, 196, 227, 258, 288, 319, 349].map(f64::from);
    Written { value: days.to_vec(), span: Span::default() }
}

impl Default for Environment {
    fn default() -> Self {
        Self {
            latitude_deg: 45.0,
            days: middle_of_months(),
            transmissivity: 0.7,
            sun_steps: 24,
            temperature: 10.0,
            temperature_altitude: None,
            lapse_per_km: 6.5,
            warming: 0.0,
            soil_depth: 1.0,
            channel_area: 10_000.0,
            routing: Routing::Infinite,
            suction: 10.0,
        }
    }
}

impl Environment {
    pub(crate) fn check(&self, problems: &mut Problems) {
        if self.days.value.is_empty() {
            let problem = Problem::at(self.days.span, "`days` names no day");
            problems.push(problem.hint("for instance [80, 172, 266, 355]"));
        }
    }

    fn season(&self) -> Season {
        Season {
            latitude: self.latitude_deg.to_radians(),
            days: self.days.value.clone(),
            transmissivity: self.transmissivity,
            steps: self.sun_steps as usize,
        }
    }
}

/// Notes names that are no layer's.
pub(crate) fn check_names(names: &[Written<String>], problems: &mut Problems) {
    let allowed: Vec<&str> =
        std::iter::once("normal").chain(CATALOGUE.map(|kind| kind.name)).collect();
    for name in names.iter().filter(|name| !allowed.contains(&name.value.as_str())) {
        weald_contract::table::report_unknown_word(name, "layer", &allowed, problems);
    }
}

/// Names of the layers that a configuration makes, sorted.
pub(crate) fn wanted(config: &Config) -> BTreeSet<&'static str> {
    let usual = CATALOGUE.iter().filter(|kind| kind.is_usual).map(|kind| kind.name);
    usual.chain(named(config)).chain(expand(config.edited_layers())).collect()
}

/// Names of the layers that `layers` lists, sorted.
pub(crate) fn named(config: &Config) -> BTreeSet<&'static str> {
    expand(config.layers.iter().map(|name| name.value.as_str())).collect()
}

/// Layers by what people call them: `normal` is three.
fn expand<'a>(names: impl Iterator<Item = &'a str>) -> impl Iterator<Item = &'static str> {
    names.flat_map(|name| match name {
        "normal" => NORMAL.to_vec(),
        name => kind(name).map(|kind| kind.name).into_iter().collect(),
    })
}

/// What the layers on demand are made from.
pub(crate) struct Source<'a> {
    pub config: &'a Config,
    pub shaped: &'a Shaped<'a>,
    pub water: &'a Hydrology,
}

impl Source<'_> {
    /// Adds every layer that is wanted and not there yet.
    pub fn extend(&self, layers: &mut Layers, progress: &dyn Progress) -> Result<(), Error> {
        let names = wanted(self.config);
        let missing: Vec<&str> =
            names.into_iter().filter(|name| !layers.layers.contains_key(*name)).collect();
        if missing.is_empty() {
            return Ok(());
        }
        progress.begin("environment", missing.len() as u64, "layers");
        self.add_light(&missing, layers);
        for name in missing {
            check_cancelled(progress)?;
            if !layers.layers.contains_key(name) {
                let values = self.values(name, layers);
                insert(layers, name, values);
            }
            progress.advance(1);
        }
        Ok(())
    }

    /// Insolation and sky share their horizons.
    fn add_light(&self, missing: &[&str], layers: &mut Layers) {
        let warmth = missing.contains(&"temperature") && self.config.environment.warming != 0.0;
        let is_lit = missing.contains(&"insolation") || warmth;
        if !is_lit && !missing.contains(&"sky_view") {
            return;
        }
        let Lattice { width, height, cell, .. } = self.shaped.lattice;
        let relief = Relief { width, height, cell, altitude: &self.shaped.altitude };
        let season = is_lit.then(|| self.config.environment.season());
        let light = sun::light(&relief, season.as_ref());
        if is_lit {
            insert(layers, "insolation", light.insolation);
        }
        if missing.contains(&"sky_view") {
            insert(layers, "sky_view", light.sky_view);
        }
    }

    fn values(&self, name: &str, layers: &Layers) -> Vec<f32> {
        let lattice = &self.shaped.lattice;
        let altitude = &self.shaped.altitude;
        match name {
            "specific_catchment_area" => self.specific_area(self.config.environment.routing),
            "wetness_suction" => self.wetness_suction(),
            "height_above_drainage" => self.height_above_drainage(),
            "soil_water" => {
                // A metre of water weighs 1000 kg on a square metre.
                let capacity = 1000.0 * self.config.water.capacity as f32;
                self.water.soil_moisture.iter().map(|moisture| moisture * capacity).collect()
            }
            "temperature" => self.temperature(layers),
            name => local(name, &self.config.environment, lattice, altitude).unwrap_or_default(),
        }
    }

    /// Area above each cell over a cell's side, m.
    fn specific_area(&self, routing: Routing) -> Vec<f32> {
        let Lattice { width, height, cell, .. } = self.shaped.lattice;
        let flood = &self.water.flood;
        let ones = || vec![1.0; flood.level.len()];
        let spread = |dispersion| disperse::accumulate(width, height, flood, dispersion, ones());
        let cells = match routing {
            Routing::D8 => {
                return self.water.upslope_area.iter().map(|area| area / cell as f32).collect();
            }
            Routing::Infinite => spread(Dispersion::Infinite),
            Routing::Multiple => spread(Dispersion::Multiple { exponent: MULTIPLE_EXPONENT }),
        };
        cells.into_iter().map(|cells| (cells * cell) as f32).collect()
    }

    fn wetness_suction(&self) -> Vec<f32> {
        let Lattice { width, height, cell, .. } = self.shaped.lattice;
        let relief = Relief { width, height, cell, altitude: &self.shaped.altitude };
        let mut area = self.specific_area(Routing::Multiple);
        // Nothing is drawn up through a hole.
        for (area, _) in
            area.iter_mut().zip(&self.water.flood.level).filter(|(_, level)| level.is_nan())
        {
            *area = f32::NAN;
        }
        suction::wetness(&relief, area, self.config.environment.suction)
    }

    /// Height of the ground above that of the channel, water or edge it drains to [Renno08].
    fn height_above_drainage(&self) -> Vec<f32> {
        let Lattice { width, height, .. } = self.shaped.lattice;
        let altitude = &self.shaped.altitude;
        let directions = flow::directions(width, height, &self.water.flood);
        let threshold = self.config.environment.channel_area as f32;
        let is_channel = |cell: usize| {
            self.water.upslope_area[cell] >= threshold
                || !self.water.level[cell].is_nan()
                || directions[cell] >= OUT
        };
        let mut base = vec![f32::NAN; altitude.len()];
        let mut way = Vec::new();
        for start in 0..base.len() {
            let mut cell = start;
            while base[cell].is_nan() {
                way.push(cell);
                if is_channel(cell) {
                    // The level of open water counts, and not its bed.
                    base[cell] = altitude[cell].max(self.water.level[cell]);
                } else {
                    cell = flow::neighbor(cell, directions[cell], width);
                }
            }
            let found = base[cell];
            way.drain(..).for_each(|cell| base[cell] = found);
        }
        base.iter().zip(altitude).map(|(base, z)| (z - base).max(0.0)).collect()
    }

    fn temperature(&self, layers: &Layers) -> Vec<f32> {
        let environment = &self.config.environment;
        let altitude = &self.shaped.altitude;
        let reference = environment.temperature_altitude.unwrap_or_else(|| mean(altitude));
        let sun = layers.values("insolation").filter(|_| environment.warming != 0.0);
        let mean_sun = sun.map_or(0.0, mean);
        let at = |(index, z): (usize, &f32)| {
            let cooling = environment.lapse_per_km * (f64::from(*z) - reference) / 1000.0;
            let more = sun.map_or(0.0, |sun| f64::from(sun[index]) - mean_sun);
            (environment.temperature - cooling + environment.warming * more) as f32
        };
        altitude.iter().enumerate().map(at).collect()
    }

    /// Adds to a patch what the terrain has beyond the usual: local layers from the patch's own
    /// ground, others from the terrain's grid.
    pub fn extend_patch(&self, patch: &mut Layers, lattice: &Lattice, layers: &Layers) {
        let whole = &self.shaped.lattice;
        let altitude = patch.values("altitude").unwrap_or_default().to_vec();
        for (name, layer) in &layers.layers {
            if patch.layers.contains_key(name) {
                continue;
            }
            let environment = &self.config.environment;
            let mut values = local(name, environment, lattice, &altitude)
                .unwrap_or_else(|| sample(whole, &layer.values, lattice));
            if name == "temperature" {
                let coarse = sample(whole, &self.shaped.altitude, lattice);
                let per_meter = (environment.lapse_per_km / 1000.0) as f32;
                for ((value, coarse), z) in values.iter_mut().zip(coarse).zip(&altitude) {
                    *value -= per_meter * (z - coarse);
                }
            }
            patch.insert(name, &layer.unit, &layer.definition, values);
        }
    }
}

/// Inserts a layer of the catalogue.
fn insert(layers: &mut Layers, name: &str, values: Vec<f32>) {
    if let Some(kind) = kind(name) {
        layers.insert(name, kind.unit, kind.definition, values);
    }
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len().max(1) as f64
}

/// Layers that follow from the altitudes around a cell, on any lattice; `None` for others.
fn local(
    name: &str,
    environment: &Environment,
    lattice: &Lattice,
    altitude: &[f32],
) -> Option<Vec<f32>> {
    let Lattice { width, height, cell, .. } = *lattice;
    let from_gradient = |value: &(dyn Fn(derive::Gradient) -> f32 + Sync)| {
        derive::from_gradient(width, height, cell, altitude, |_, gradient| value(gradient))
    };
    Some(match name {
        // The horizontal part of the normal points downhill and is as long as the sine of slope.
        "normal_east" | "eastness" => from_gradient(&|g| g.normal()[0]),
        "normal_north" | "northness" => from_gradient(&|g| g.normal()[1]),
        "normal_up" => from_gradient(&|g| g.normal()[2]),
        "curvature_plan" => derive::from_curvature(width, height, cell, altitude, |c| c.plan),
        "curvature_profile" => derive::from_curvature(width, height, cell, altitude, |c| c.profile),
        "heat_load" => {
            let latitude = environment.latitude_deg.to_radians();
            from_gradient(&|g| derive::heat_load(g, latitude))
        }
        "soil_depth" => {
            let depth = environment.soil_depth as f32;
            from_gradient(&|g| depth * (1.0 - g.slope_deg() / BARE_SLOPE_DEG).max(0.0))
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_catalogue_is_sorted_and_names_units() {
        assert!(CATALOGUE.windows(2).all(|pair| pair[0].name < pair[1].name));
        assert!(CATALOGUE.iter().all(|kind| !kind.unit.is_empty() && kind.definition.len() > 20));
        assert_eq!(CATALOGUE.iter().filter(|kind| kind.is_usual).count(), 8);
    }
}
