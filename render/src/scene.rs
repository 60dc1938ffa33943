//! The scene: ground, water, plants and objects put together for tracing.

#[cfg(test)]
use crate::accel::Triangle;
use crate::accel::{Bounds, Instance, Level, Levels, MAX_DEPTH, join_pairs};
use crate::bsdf::Material;
use crate::ground::{self, Colors, Crown};
use crate::model::{self, Brush, Gallery, Look, Shape};
use crate::nested::{Known, Nested};
use crate::paint::{Charts, MOST_CHARTS, Paints};
use crate::sky::Dome;
use crate::water::Ripples;
use crate::{Error, Sky, SkyPictures};
use glam::{Quat, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use weald_contract::{Instances, Layers, Palette, PlantModel, Problem, Progress, Representative};

/// Serves plant models; the caller grows them, or reads them from its cache.
pub trait PrototypeSource: Sync {
    /// The model of a representative. Called once for each that is used, from any thread.
    ///
    /// # Errors
    /// Whatever kept the caller from having it.
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem>;
}

/// Something that is not a plant: a house, a fence, a bench.
#[derive(Clone, Debug)]
pub struct Object {
    /// What it looks like.
    pub model: Arc<PlantModel>,
    /// Where its origin stands: map coordinates and altitude, m.
    pub position: [f64; 3],
    /// Turn about the vertical, radians counter-clockwise seen from above.
    pub yaw: f32,
    /// Uniform scale.
    pub scale: f32,
}

/// What a scene is made of.
pub struct Parts<'a> {
    /// The ground. Layer `altitude` is required; `water_depth` and `soil_moisture` are used.
    pub terrain: &'a Layers,
    /// Representatives and groups.
    pub palette: &'a Palette,
    /// Where they stand.
    pub instances: &'a Instances,
    /// What the representatives look like.
    pub prototypes: &'a dyn PrototypeSource,
    /// Other things.
    pub objects: &'a [Object],
    /// Names of species, sorted; number in the picture = index + 1.
    pub species: &'a [String],
    /// Pictures that `[sky]` names.
    pub sky_pictures: SkyPictures<'a>,
}

/// How large a scene is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Statistics {
    /// Different plant models and objects.
    pub prototypes: u64,
    /// Placements at all levels, also those in groups that are stored as one mesh.
    pub instances: u64,
    /// Plants that stand: each counted wherever it is placed, through all levels.
    pub plants: u128,
    /// Triangles that are stored.
    pub unique_primitives: u64,
    /// Triangles that rays can meet: each counted wherever it is placed, through all levels.
    pub instanced_primitives: u128,
    /// Memory of geometry, trees and placements, bytes.
    pub bytes: u64,
}

/// A scene ready for tracing.
pub struct Scene {
    pub(crate) levels: Levels,
    /// Level of everything but water.
    pub(crate) solid: u32,
    /// Level of the water's surface.
    pub(crate) water: u32,
    pub(crate) materials: Vec<Material>,
    /// Names of the materials for people: species and what the model calls it.
    pub(crate) material_names: Vec<String>,
    /// How the materials are painted.
    brushes: Vec<Option<Brush>>,
    /// Whether any material is a light.
    pub(crate) has_lights: bool,
    pub(crate) colors: Option<Colors>,
    pub(crate) ripples: Ripples,
    pub(crate) dome: Dome,
    /// Extinction of the air, 1/m.
    pub(crate) haze: f32,
    /// Map coordinates and altitude of the scene-local origin.
    pub(crate) origin: [f64; 3],
    /// Names of species; the number of one in a picture is its index here + 1.
    pub(crate) species: Vec<String>,
    /// Heights of ground and water, to stand on.
    pub(crate) footing: Layers,
    statistics: Statistics,
}

/// Memory that a scene will need, bytes, from its models by their id, where they are placed, and the
/// triangles of everything else.
///
/// Groups that will be stored as one mesh count as such, and organs that are kept once as one. A
/// triangle takes 70 B in a block that is half full and cut here and there, 20 B of normals and
/// material, and 14 B of tree; leaves that are parallelograms take half of it. A placement takes 72 B.
pub fn estimate_bytes(
    models: &BTreeMap<u32, Arc<PlantModel>>,
    instances: &Instances,
    other_triangles: u64,
) -> u64 {
    let known: Vec<Known> = models
        .values()
        .map(|model| (Arc::clone(model), (0..model.materials.len() as u16).collect()))
        .collect();
    let nested = Nested::find(&known);
    let organs = nested.originals.iter().map(|&(model, organ)| &known[model].0.organs[organ]);
    let shared: u64 = organs.map(model::triangles).sum();
    let (mut stored, mut placements) = (shared + other_triangles, instances.len() as u64);
    let mut seen: BTreeMap<u32, u64> = BTreeMap::new();
    for ((&id, model), nested) in models.iter().zip(&nested.of_model) {
        let organs = nested.keys().map(|organ| &model.organs[*organ]);
        let places = organs.map(|organ| (organ.placements.len() as u64, model::triangles(organ)));
        let (places, copies) = places
            .fold((0, 0), |(all, copies), (places, each)| (all + places, copies + places * each));
        seen.insert(id, model.instanced_triangles());
        stored += model.instanced_triangles() - copies;
        placements += places;
    }
    let mut groups: BTreeMap<u32, u64> = BTreeMap::new();
    for (&group, prototype) in instances.group.iter().zip(&instances.prototype) {
        if group != 0 {
            *groups.entry(group).or_default() += seen.get(prototype).copied().unwrap_or(0);
        }
    }
    let baked: u64 = groups.values().filter(|&&sum| u128::from(sum) <= BAKED).sum();
    104 * (stored + baked) + 72 * placements
}

/// Groups of at most this many triangles are copied into one mesh of their own: a few megabytes
/// for each *different* patch, against one ray transform and many overlapping boxes less on every
/// ray through grass.
const BAKED: u128 = 60_000;

/// Trees, as far as litter is concerned: what is higher than this, m.
const TREE_HEIGHT: f32 = 2.0;

impl Scene {
    /// Puts a scene together.
    ///
    /// # Errors
    /// A damaged model, instance or terrain, a prototype that cannot be had, or a wish to stop.
    pub fn build(parts: &Parts<'_>, sky: &Sky, progress: &dyn Progress) -> Result<Scene, Error> {
        check_ids(parts.palette)?;
        let origin = ground::origin(parts.terrain)?;
        let ground = ground::build(parts.terrain, origin)?;
        let mut assembly = Assembly::new(origin);
        for triangles in [&ground.triangles, &ground.water] {
            let level = Level::mesh(&join_pairs(triangles, &mut Charts::default()));
            assembly.push(level, 0);
        }
        let rows = rows_by_group(parts.instances);
        assembly.add_plants(parts, &rows, progress)?;
        assembly.add_groups(parts, &rows)?;
        if progress.is_cancelled() {
            return Err(Error::Cancelled);
        }
        let mut top = assembly.place_rows(parts.instances, rows.get(&0).map_or(&[], |r| r))?;
        top.push((standing_at([0.0; 3], 0.0, 1.0, GROUND_LEVEL), 0));
        assembly.add_objects(parts.objects, &mut top)?;
        assembly.push_group(&top, false);
        let paints = assembly.take_paints()?;
        let statistics = Statistics {
            bytes: assembly.statistics().bytes + paints.bytes(),
            ..assembly.statistics()
        };
        Ok(Scene {
            solid: assembly.levels.len() as u32 - 1,
            water: WATER_LEVEL,
            levels: Levels::new(assembly.levels).painted(paints),
            has_lights: has_lights(&assembly.materials),
            materials: assembly.materials,
            material_names: assembly.material_names,
            brushes: assembly.brushes,
            colors: Some(Colors::new(parts.terrain, &crowns(parts, rows.get(&0)))),
            ripples: Ripples::new(),
            dome: Dome::with_pictures(sky, parts.sky_pictures)?,
            haze: sky.haze / 1000.0,
            origin,
            species: parts.species.to_vec(),
            footing: footing(parts.terrain),
            statistics,
        })
    }

    /// How large it is.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Coverage of its texture below which a material is not there, if it is cut out.
    pub(crate) fn cutout(&self, material: usize) -> Option<f32> {
        self.brushes[material].and_then(|brush| brush.cutout)
    }

    /// The box around all plants, objects and ground, scene-local metres.
    pub(crate) fn bounds(&self) -> Bounds {
        self.levels.bounds(self.solid)
    }

    /// A closed world for tests: one mesh, no ground, no water.
    #[cfg(test)]
    pub(crate) fn of_mesh(triangles: &[Triangle], materials: Vec<Material>, dome: Dome) -> Self {
        let frame = weald_contract::Frame { width: 1, height: 1, cell: 1.0, west: 0.0, south: 0.0 };
        let mesh = Level::mesh(triangles);
        let water = Level::mesh(&[]);
        let top = Level::group(&[(standing_at([0.0; 3], 0.0, 1.0, 0), 1)], &[mesh]);
        Self {
            levels: Levels::new(vec![Level::mesh(triangles), water, top]),
            solid: 2,
            water: 1,
            has_lights: has_lights(&materials),
            material_names: vec!["test".to_string(); materials.len()],
            brushes: vec![None; materials.len()],
            materials,
            colors: None,
            ripples: Ripples::new(),
            dome,
            haze: 0.0,
            origin: [0.0; 3],
            species: vec!["leaf".to_string()],
            footing: Layers {
                frame,
                crs: Default::default(),
                layers: Default::default(),
                detail: vec![],
            },
            statistics: Statistics::default(),
        }
    }
}

fn has_lights(materials: &[Material]) -> bool {
    materials.iter().any(|material| material.emission != Vec3::ZERO)
}

/// Numbers of the levels that every scene begins with.
const GROUND_LEVEL: u32 = 0;
pub(crate) const WATER_LEVEL: u32 = 1;

/// Rows of the instance table by the group they belong to.
fn rows_by_group(instances: &Instances) -> BTreeMap<u32, Vec<usize>> {
    let mut rows: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (row, &group) in instances.group.iter().enumerate() {
        rows.entry(group).or_default().push(row);
    }
    rows
}

/// Refuses palettes in which an id could mean two things, or the scene itself.
fn check_ids(palette: &Palette) -> Result<(), Error> {
    let plants = palette.representatives.iter().map(|p| (p.id, format!("a {}", p.species)));
    let groups = palette.groups.iter().map(|g| (g.id, format!("a group of {}", g.species)));
    let mut known = BTreeMap::from([(0, "the scene".to_string())]);
    for (id, second) in plants.chain(groups) {
        if let Some(first) = known.insert(id, second.clone()) {
            return Err(Error::SharedId { id, first, second });
        }
    }
    Ok(())
}

/// Altitude and water of a terrain and its patches.
fn footing(terrain: &Layers) -> Layers {
    let is_needed = |name: &str| name == "altitude" || name == "water_depth";
    let kept = terrain.layers.iter().filter(|(name, _)| is_needed(name));
    Layers {
        frame: terrain.frame,
        crs: Default::default(),
        layers: kept.map(|(name, layer)| (name.clone(), layer.clone())).collect(),
        detail: terrain.detail.iter().map(footing).collect(),
    }
}

/// Crowns of all trees of the scene.
fn crowns(parts: &Parts<'_>, rows: Option<&Vec<usize>>) -> Vec<Crown> {
    let plants: BTreeMap<u32, &Representative> =
        parts.palette.representatives.iter().map(|plant| (plant.id, plant)).collect();
    let crown = |&row: &usize| {
        let row = parts.instances.row(row);
        let plant = plants.get(&row.prototype)?;
        (plant.height * row.scale > TREE_HEIGHT).then_some(Crown {
            x: row.position[0],
            y: row.position[1],
            radius: f64::from(plant.radius * row.scale),
        })
    };
    rows.into_iter().flatten().filter_map(crown).collect()
}

/// Something that stands upright.
fn standing_at(position: [f32; 3], yaw: f32, scale: f32, level: u32) -> Instance {
    let (sin, cos) = libm::sincosf(0.5 * yaw);
    Instance::new([0.0, 0.0, sin, cos], scale, position, level)
}

/// A scene while it is put together.
struct Assembly {
    origin: [f64; 3],
    levels: Vec<Level>,
    /// Plants in each level.
    plants: Vec<u128>,
    /// Placements so far.
    placements: u64,
    materials: Vec<Material>,
    material_names: Vec<String>,
    /// How each of the materials is painted, if it is.
    brushes: Vec<Option<Brush>>,
    /// Materials by species and name, with their numbers.
    known: BTreeMap<(u32, String), Vec<(weald_contract::Material, u16)>>,
    gallery: Gallery,
    /// Charts and outlines of all models, in the order in which threads came by, which shows
    /// nowhere.
    paints: Mutex<Paints>,
    /// Level and nesting depth of each representative and group.
    by_id: BTreeMap<u32, (u32, usize)>,
    models: u64,
}

impl Assembly {
    fn new(origin: [f64; 3]) -> Self {
        let plain = Material {
            reflectance: Vec3::splat(0.2),
            transmittance: Vec3::ZERO,
            emission: Vec3::ZERO,
            roughness: 1.0,
            variation: 0.0,
            is_ground: false,
            texture: None,
            species: 0,
        };
        // In the order of GROUND_MATERIAL and WATER_MATERIAL.
        let materials = vec![Material { is_ground: true, ..plain }, plain];
        Self {
            origin,
            levels: Vec::new(),
            plants: Vec::new(),
            placements: 0,
            brushes: vec![None; materials.len()],
            material_names: ["ground", "water"].map(str::to_string).to_vec(),
            known: BTreeMap::new(),
            materials,
            gallery: Gallery::default(),
            paints: Mutex::default(),
            by_id: BTreeMap::new(),
            models: 0,
        }
    }

    /// Adds a level in which this many plants stand.
    fn push(&mut self, level: Level, plants: u128) -> u32 {
        self.levels.push(level);
        self.plants.push(plants);
        self.levels.len() as u32 - 1
    }

    /// Adds a level of placements; those of at most [`BAKED`] triangles become one mesh if
    /// `may_bake` is set.
    fn push_group(&mut self, placed: &[(Instance, u64)], may_bake: bool) -> u32 {
        self.placements += placed.len() as u64;
        let plants = placed.iter().map(|(instance, _)| self.plants[instance.level as usize]).sum();
        let group = Level::group(placed, &self.levels);
        let level = if may_bake && group.triangle_count(&self.levels) <= BAKED {
            Level::mesh(&group.triangles(&self.levels))
        } else {
            group
        };
        self.push(level, plants)
    }

    /// Adds the mesh of every representative that is placed anywhere.
    fn add_plants(
        &mut self,
        parts: &Parts<'_>,
        rows: &BTreeMap<u32, Vec<usize>>,
        progress: &dyn Progress,
    ) -> Result<(), Error> {
        let used = used_prototypes(parts.instances, rows);
        let plants: Vec<&Representative> =
            parts.palette.representatives.iter().filter(|plant| used.contains(&plant.id)).collect();
        progress.begin("plant models", plants.len() as u64, "plants");
        let models = self.known_models(&plants, parts)?;
        let nested = Nested::find(&models);
        let organs = self.add_organs(&models, &nested)?;
        let named: Vec<_> = plants.iter().zip(&models).zip(&nested.of_model).collect();
        let flat: Vec<Result<Level, Error>> = named
            .par_iter()
            .map(|((plant, (model, materials)), nested)| {
                if progress.is_cancelled() {
                    return Err(Error::Cancelled);
                }
                let is_nested = |organ: usize| nested.contains_key(&organ);
                let shape =
                    model::shape(model, &named_plant(plant), &self.look(materials), &is_nested);
                let level = self.level_of(shape?);
                progress.advance(1);
                Ok(level)
            })
            .collect();
        for (((plant, (model, _)), nested), level) in named.into_iter().zip(flat) {
            let (number, depth) = if nested.is_empty() {
                (self.push(level?, 1), 0)
            } else {
                let rest = self.push(level?, 0);
                (self.push_nested(rest, model, nested, &organs, &named_plant(plant))?, 1)
            };
            self.by_id.insert(plant.id, (number, depth));
        }
        Ok(())
    }

    /// Adds a level for each organ that is kept once; returns their numbers.
    fn add_organs(&mut self, models: &[Known], nested: &Nested) -> Result<Vec<u32>, Error> {
        let level = |&(model, organ): &(usize, usize)| {
            let (plant, materials) = &models[model];
            let organ = &plant.organs[organ];
            let shape = model::organ_shape(plant, organ, &plant.name, &self.look(materials))?;
            Ok(self.level_of(shape))
        };
        let levels: Vec<Result<Level, Error>> = nested.originals.par_iter().map(level).collect();
        levels.into_iter().map(|level| Ok(self.push(level?, 0))).collect()
    }

    /// Adds the level of a plant: the rest of it, and its nested organs at their places.
    fn push_nested(
        &mut self,
        rest: u32,
        model: &PlantModel,
        nested: &BTreeMap<usize, usize>,
        organs: &[u32],
        what: &str,
    ) -> Result<u32, Error> {
        let mut placed = vec![(standing_at([0.0; 3], 0.0, 1.0, rest), 0)];
        for (&organ, &original) in nested {
            let organ = &model.organs[organ];
            for place in &organ.placements {
                let (turn, scale, position) = model::checked(place, organ)
                    .map_err(|why| Error::BadModel { what: what.to_string(), why })?;
                let (turn, position) = (turn.to_array(), position.to_array());
                placed.push((Instance::new(turn, scale.x, position, organs[original]), 0));
            }
        }
        self.placements += placed.len() as u64;
        let group = Level::group(&placed, &self.levels);
        Ok(self.push(group, 1))
    }

    /// Fetches all models and numbers their materials.
    fn known_models(
        &mut self,
        plants: &[&Representative],
        parts: &Parts<'_>,
    ) -> Result<Vec<Known>, Error> {
        let models: Vec<Result<Arc<PlantModel>, Problem>> =
            plants.par_iter().map(|plant| parts.prototypes.model(plant.id)).collect();
        models
            .into_iter()
            .zip(plants)
            .map(|(model, plant)| {
                let model = model?;
                let species = parts.species.binary_search(&plant.species);
                let species = species.map_or(0, |i| i as u32 + 1);
                let materials = self.add_materials(&model, &named_plant(plant), species)?;
                Ok((model, materials))
            })
            .collect()
    }

    /// Takes over a model's materials; returns their numbers. Those that are there already, as of
    /// another plant of the species, are not added again.
    fn add_materials(
        &mut self,
        model: &PlantModel,
        what: &str,
        species: u32,
    ) -> Result<Vec<u16>, Error> {
        self.models += 1;
        let mut numbers = Vec::with_capacity(model.materials.len());
        for source in &model.materials {
            let brush = self.gallery.brush(source, model).map_err(|why| Error::BadModel {
                what: what.to_string(),
                why: format!("material `{}` {why}", source.name),
            })?;
            let alike = self.known.entry((species, source.name.clone())).or_default();
            let same = alike.iter().find(|(known, number)| {
                let brushes = (self.brushes[usize::from(*number)], brush);
                brushes.0 == brushes.1 && is_same(known, source)
            });
            if let Some((_, number)) = same {
                numbers.push(*number);
                continue;
            }
            let count = self.materials.len();
            if count >= usize::from(u16::MAX) {
                let what = "materials of all models".to_string();
                return Err(Error::TooMany { what, count, limit: usize::from(u16::MAX) });
            }
            alike.push((source.clone(), count as u16));
            numbers.push(count as u16);
            let texture = brush.map(|brush| brush.texture);
            self.materials.push(Material { texture, ..model::material(source, species) });
            self.brushes.push(brush);
            self.material_names.push(format!("{} {}", model.name, source.name));
        }
        Ok(numbers)
    }

    /// What surfaces of a model are made of whose materials have these numbers.
    fn look<'a>(&'a self, materials: &'a [u16]) -> Look<'a> {
        Look { materials, brushes: &self.brushes, textures: &self.gallery.textures }
    }

    /// The level of a shape, whose charts join those of all models.
    fn level_of(&self, mut shape: Shape) -> Level {
        {
            let mut all = self.paints.lock().unwrap_or_else(PoisonError::into_inner);
            shape.join(&mut all);
        }
        Level::mesh(&shape.triangles)
    }

    /// Adds the group levels, inner ones first.
    fn add_groups(
        &mut self,
        parts: &Parts<'_>,
        rows: &BTreeMap<u32, Vec<usize>>,
    ) -> Result<(), Error> {
        let mut waiting: Vec<u32> = rows.keys().copied().filter(|&group| group != 0).collect();
        // A group without rows is an empty patch.
        let known = parts.palette.groups.iter().map(|group| group.id);
        waiting.extend(known.filter(|id| !rows.contains_key(id)));
        // Each round adds the groups whose members are all there; a round that adds none has met
        // a circle or an unknown id.
        while !waiting.is_empty() {
            let (ready, later): (Vec<u32>, Vec<u32>) = waiting.iter().partition(|&group| {
                let rows = rows.get(group).map_or(&[][..], |rows| rows);
                rows.iter().all(|&row| self.by_id.contains_key(&parts.instances.prototype[row]))
            });
            if ready.is_empty() {
                return Err(unresolved(parts, rows, &later, &self.by_id));
            }
            for group in ready {
                self.add_group(parts.instances, group, rows.get(&group).map_or(&[], |r| r))?;
            }
            waiting = later;
        }
        Ok(())
    }

    fn add_group(
        &mut self,
        instances: &Instances,
        group: u32,
        rows: &[usize],
    ) -> Result<(), Error> {
        let placed = self.place_rows(instances, rows)?;
        let depths = rows.iter().filter_map(|&row| self.by_id.get(&instances.prototype[row]));
        let depth = depths.map(|&(_, depth)| depth + 1).max().unwrap_or(0);
        if depth >= MAX_DEPTH {
            return Err(Error::Nesting { group, limit: MAX_DEPTH - 1 });
        }
        let number = self.push_group(&placed, true);
        self.by_id.insert(group, (number, depth));
        Ok(())
    }

    /// Placements of some rows of the table. Rows of the scene are brought from map coordinates
    /// to local ones.
    fn place_rows(
        &self,
        instances: &Instances,
        rows: &[usize],
    ) -> Result<Vec<(Instance, u64)>, Error> {
        let place = |&index: &usize| {
            let row = instances.row(index);
            let Some(&(level, _)) = self.by_id.get(&row.prototype) else {
                return Err(Error::UnknownPrototype { row: index, prototype: row.prototype });
            };
            let origin = if row.group == 0 { self.origin } else { [0.0; 3] };
            let position = [0, 1, 2].map(|axis| (row.position[axis] - origin[axis]) as f32);
            let damaged = |why| Err(Error::BadInstance { row: index, why });
            if position.iter().any(|c| !c.is_finite() || c.abs() > 1e7) {
                return damaged("its position is no number or farther than 10,000 km");
            }
            if !(row.scale > 0.0 && row.scale < 1e6) {
                return damaged("its scale is not between 0 and a million");
            }
            let turn = Quat::from_array(row.rotation);
            if !(turn.length() > 0.5 && turn.length() < 2.0) {
                return damaged("its rotation is no unit quaternion");
            }
            let rotation = turn.normalize().to_array();
            Ok((Instance::new(rotation, row.scale, position, level), row.plant_id))
        };
        rows.iter().map(place).collect()
    }

    fn add_objects(
        &mut self,
        objects: &[Object],
        top: &mut Vec<(Instance, u64)>,
    ) -> Result<(), Error> {
        for (number, object) in objects.iter().enumerate() {
            let what = format!("object {number} ({})", object.model.name);
            let position = [0, 1, 2].map(|axis| (object.position[axis] - self.origin[axis]) as f32);
            let is_placed = position.iter().all(|c| c.is_finite()) && object.yaw.is_finite();
            if !(is_placed && object.scale > 0.0 && object.scale < 1e6) {
                let why = "its place, turn or scale is no sensible number".to_string();
                return Err(Error::BadModel { what, why });
            }
            let materials = self.add_materials(&object.model, &what, 0)?;
            let shape = model::shape(&object.model, &what, &self.look(&materials), &|_| false)?;
            let level = self.push(self.level_of(shape), 0);
            top.push((standing_at(position, object.yaw, object.scale, level), 0));
        }
        Ok(())
    }

    /// Everything that faces are painted with.
    fn take_paints(&mut self) -> Result<Paints, Error> {
        let textures = std::mem::take(&mut self.gallery.textures);
        let all = std::mem::take(self.paints.get_mut().unwrap_or_else(PoisonError::into_inner));
        let count = all.charts.len();
        if count > MOST_CHARTS {
            let what = "triangles with texture coordinates of their own".to_string();
            return Err(Error::TooMany { what, count, limit: MOST_CHARTS });
        }
        Ok(Paints { textures, ..all })
    }

    fn statistics(&self) -> Statistics {
        use crate::accel::Content;
        let mut statistics = Statistics {
            prototypes: self.models,
            instances: self.placements,
            plants: self.plants.last().copied().unwrap_or(0),
            ..Statistics::default()
        };
        let mut seen: Vec<u128> = Vec::with_capacity(self.levels.len());
        for level in &self.levels {
            statistics.bytes += level.bytes();
            match &level.content {
                Content::Mesh { count, .. } => {
                    statistics.unique_primitives += count;
                    seen.push(u128::from(*count));
                }
                Content::Group { instances, .. } => {
                    seen.push(instances.iter().map(|i| seen[i.level as usize]).sum());
                }
            }
        }
        // The top level holds everything but the water, which stands beside it.
        let top = seen.last().copied().unwrap_or(0);
        let water = seen.get(WATER_LEVEL as usize).copied().unwrap_or(0);
        statistics.instanced_primitives = top + water;
        statistics
    }
}

/// A representative as errors name it.
fn named_plant(plant: &Representative) -> String {
    format!("prototype {} ({})", plant.id, plant.species)
}

/// Whether two materials are alike but for the place of their texture, which brushes tell.
fn is_same(a: &weald_contract::Material, b: &weald_contract::Material) -> bool {
    (a.reflectance, a.roughness, a.surface, a.cutout)
        == (b.reflectance, b.roughness, b.surface, b.cutout)
}

/// Ids that the scene reaches through its groups.
fn used_prototypes(
    instances: &Instances,
    rows: &BTreeMap<u32, Vec<usize>>,
) -> std::collections::BTreeSet<u32> {
    let mut used = std::collections::BTreeSet::new();
    // Every group that has rows is built, so whatever stands in a row is used.
    for row in rows.values().flatten() {
        used.insert(instances.prototype[*row]);
    }
    used
}

/// Why these groups cannot be built: an id that nobody knows, or a circle.
fn unresolved(
    parts: &Parts<'_>,
    rows: &BTreeMap<u32, Vec<usize>>,
    groups: &[u32],
    known: &BTreeMap<u32, (u32, usize)>,
) -> Error {
    let members = groups.iter().filter_map(|group| rows.get(group)).flatten();
    let unknown = members.copied().find(|&row| {
        let prototype = parts.instances.prototype[row];
        !known.contains_key(&prototype) && !groups.contains(&prototype)
    });
    match unknown {
        Some(row) => Error::UnknownPrototype { row, prototype: parts.instances.prototype[row] },
        None => {
            Error::Nesting { group: groups.first().copied().unwrap_or(0), limit: MAX_DEPTH - 1 }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::instances::Instance as Row;
    use weald_contract::{Frame, Group, Mesh, Silent};

    struct Models(PlantModel);

    impl PrototypeSource for Models {
        fn model(&self, _: u32) -> Result<Arc<PlantModel>, Problem> {
            Ok(Arc::new(self.0.clone()))
        }
    }

    fn plant() -> PlantModel {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 3.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let material = weald_contract::Material {
            name: "bark".into(),
            reflectance: [0.3; 3],
            roughness: 1.0,
            ..weald_contract::Material::default()
        };
        PlantModel {
            name: "stick".into(),
            materials: vec![material],
            wood: vec![mesh],
            ..PlantModel::default()
        }
    }

    fn terrain() -> Layers {
        let frame = Frame { width: 4, height: 4, cell: 10.0, west: 500.0, south: 700.0 };
        let mut layers =
            Layers { frame, crs: Default::default(), layers: Default::default(), detail: vec![] };
        layers.insert("altitude", "m", "Height.", vec![100.0; 16]);
        layers
    }

    fn palette() -> Palette {
        let species = "stick".to_string();
        let representative = Representative {
            id: 1,
            species: species.clone(),
            age: 1.0,
            vigor: 1.0,
            height: 3.0,
            radius: 1.0,
            weight: 1.0,
            count: 1,
        };
        let group = |id| Group { id, species: species.clone(), age: 1.0, vigor: 1.0, count: 1 };
        Palette { representatives: vec![representative], groups: vec![group(2), group(3)] }
    }

    fn row(group: u32, prototype: u32) -> Row {
        let position = if group == 0 { [520.0, 720.0, 100.0] } else { [0.5, 0.0, 0.0] };
        let rotation = [0.0, 0.0, 0.0, 1.0];
        Row { group, prototype, plant_id: 9, position, rotation, scale: 1.0 }
    }

    fn scene(model: PlantModel, rows: &[Row]) -> Result<Scene, Error> {
        let mut instances = Instances::default();
        rows.iter().for_each(|&row| instances.push(row));
        let parts = Parts {
            terrain: &terrain(),
            palette: &palette(),
            instances: &instances,
            prototypes: &Models(model),
            objects: &[],
            species: &["stick".to_string()],
            sky_pictures: SkyPictures::default(),
        };
        Scene::build(&parts, &Sky::clear_day(), &Silent)
    }

    fn error(model: PlantModel, rows: &[Row]) -> Error {
        scene(model, rows).err().expect("the scene is damaged")
    }

    #[test]
    fn triangles_are_counted_through_all_levels() {
        let bare = scene(plant(), &[]).unwrap();
        let ground = bare.statistics().instanced_primitives;
        assert_eq!(ground, u128::from(bare.statistics().unique_primitives));
        // Patch 2 holds three plants, patch 3 two patches and a plant, the scene two patches 3.
        let rows = [
            row(2, 1),
            row(2, 1),
            row(2, 1),
            row(3, 2),
            row(3, 2),
            row(3, 1),
            row(0, 3),
            row(0, 3),
        ];
        let scene = scene(plant(), &rows).unwrap();
        assert_eq!(scene.statistics().instanced_primitives, ground + 2 * 7);
        let statistics = scene.statistics();
        assert_eq!(statistics.prototypes, 1);
        // Seven sticks in each patch 3; the rows and the ground are placements, though the
        // patches are so small that each is one mesh.
        assert_eq!((statistics.plants, statistics.instances), (14, 9));
    }

    #[test]
    fn a_plant_is_met_where_its_row_puts_it() {
        use crate::accel::{Ray, Scratch};
        let scene = scene(plant(), &[row(2, 1), row(3, 2), row(0, 3)]).unwrap();
        // Two groups shift it by 0.5 m each: its foot is at 21, 20 in scene coordinates.
        let ray = Ray { origin: Vec3::new(21.2, 10.0, 0.5), direction: Vec3::Y };
        let hit = scene.levels.nearest(scene.solid, &ray, f32::INFINITY, &mut Scratch::default());
        assert!((hit.t - 10.0).abs() < 1e-4, "{}", hit.t);
        let place = scene.levels.place(scene.solid, &hit);
        assert_eq!(place.plant, 9);
        assert_eq!(scene.materials[usize::from(place.face.material)].species, 1);
    }

    #[test]
    fn unknown_prototypes_and_circles_are_refused_by_row_and_group() {
        assert!(matches!(
            error(plant(), &[row(0, 77)]),
            Error::UnknownPrototype { row: 0, prototype: 77 }
        ));
        assert!(matches!(
            error(plant(), &[row(0, 1), row(2, 77)]),
            Error::UnknownPrototype { row: 1, prototype: 77 }
        ));
        let circle = [row(0, 2), row(2, 3), row(3, 2)];
        assert!(matches!(error(plant(), &circle), Error::Nesting { .. }));
    }

    #[test]
    fn an_id_that_means_two_things_is_refused() {
        assert!(check_ids(&palette()).is_ok());
        let mut shared = palette();
        shared.groups[1].id = 1;
        let message = check_ids(&shared).unwrap_err().to_string();
        assert!(message.contains("id 1 to both a stick and a group of stick"), "{message}");
        let mut zero = palette();
        zero.representatives[0].id = 0;
        assert!(check_ids(&zero).unwrap_err().to_string().contains("the scene"));
    }

    #[test]
    fn geometry_that_is_no_number_is_refused() {
        let mut broken = plant();
        broken.wood[0].positions[2][1] = f32::NAN;
        let message = error(broken, &[row(0, 1)]).to_string();
        assert!(message.contains("stick") && message.contains("vertex 2"), "{message}");
        let mut broken = plant();
        broken.wood[0].triangles[0][2] = 3;
        assert!(matches!(error(broken, &[row(0, 1)]), Error::BadModel { .. }));
        let mut nowhere = row(0, 1);
        nowhere.position[0] = f64::NAN;
        assert!(matches!(error(plant(), &[nowhere]), Error::BadInstance { row: 0, .. }));
        let mut flat = row(0, 1);
        flat.scale = 0.0;
        assert!(matches!(error(plant(), &[flat]), Error::BadInstance { row: 0, .. }));
    }

    /// A pond in a wood, with patches of sticks in patches.
    fn wood() -> (Layers, Instances) {
        let frame = Frame { width: 9, height: 9, cell: 5.0, west: 500.0, south: 700.0 };
        let mut layers =
            Layers { frame, crs: Default::default(), layers: Default::default(), detail: vec![] };
        let distance = |i: usize| ((i % 9).abs_diff(4) + (i / 9).abs_diff(4)) as f32;
        let heights: Vec<f32> = (0..81).map(|i| 100.0 + 0.4 * distance(i)).collect();
        let depths = heights.iter().map(|height| (100.9 - height).max(0.0)).collect();
        let moisture = (0..81).map(|i| 1.0 - 0.1 * distance(i)).collect();
        layers.insert("altitude", "m", "Height.", heights);
        layers.insert("water_depth", "m", "Depth.", depths);
        layers.insert("soil_moisture", "1", "Moisture.", moisture);
        let mut instances = Instances::default();
        let mut chance = weald_contract::Seed(3).stream("wood", 0);
        for number in 0..60 {
            let position =
                [500.0 + chance.range(2.0, 38.0), 700.0 + chance.range(2.0, 38.0), 100.5];
            let yaw = 0.5 * chance.range(0.0, 6.0);
            let rotation = [0.0, 0.0, yaw.sin() as f32, yaw.cos() as f32];
            let prototype = 1 + number % 3;
            let plant_id = u64::from(number);
            instances.push(Row { group: 0, prototype, plant_id, position, rotation, scale: 0.8 });
        }
        [row(2, 1), row(2, 1), row(3, 2), row(3, 1)].into_iter().for_each(|r| instances.push(r));
        (layers, instances)
    }

    #[test]
    fn a_scene_in_plain_data_has_every_triangle_where_it_stands() {
        let (terrain, instances) = wood();
        let parts = Parts {
            terrain: &terrain,
            palette: &palette(),
            instances: &instances,
            prototypes: &Models(plant()),
            objects: &[],
            species: &["stick".to_string()],
            sky_pictures: SkyPictures::default(),
        };
        let scene = Scene::build(&parts, &Sky::clear_day(), &Silent).unwrap();
        let portable = scene.portable(&table("")).unwrap();
        let mut found = Vec::new();
        for place in &portable.places {
            let rows = place.scene_from_piece.map(glam::Vec4::from);
            let carried =
                |p: [f32; 3]| Vec3::from_array(rows.map(|row| row.dot(Vec3::from(p).extend(1.0))));
            for mesh in portable.meshes(place.piece) {
                assert!(mesh.is_sound(portable.finishes.len()));
                let corner = |&i: &u32| carried(mesh.positions[i as usize]);
                found.extend(mesh.triangles.iter().map(|t| t.iter().map(corner).sum::<Vec3>()));
            }
        }
        let levels = [scene.solid, scene.water].map(|level| scene.levels.triangles(level));
        let mut expected = Vec::new();
        for triangle in levels.concat() {
            let [a, b, c] = triangle.corners;
            expected.push(a + b + c);
            expected.extend(triangle.is_half.then_some(b + c - a + b + c));
        }
        assert_eq!(found.len() as u128, scene.statistics().instanced_primitives);
        let sorted = |mut list: Vec<Vec3>| {
            let key = |p: &Vec3| p.to_array().map(|c| (16.0 * c).round() as i64);
            list.sort_by_key(key);
            list
        };
        let far = |(a, b): (&Vec3, &Vec3)| !a.abs_diff_eq(*b, 0.2);
        let (found, expected) = (sorted(found), sorted(expected));
        assert_eq!(found.len(), expected.len());
        assert!(found.iter().zip(&expected).filter(|pair| far(*pair)).count() < found.len() / 100);
    }

    #[test]
    fn a_scene_of_parts_has_the_same_bits_on_one_and_two_threads() {
        let (terrain, instances) = wood();
        let species = ["stick".to_string()];
        let text = "name = \"shore\"\nstand_at = [6, 6]\nlook_at = [20, 20]";
        let view: weald_contract::View = table(text);
        let config: crate::Config = table("view = \"shore\"\nresolution = [48, 32]\nsamples = 4");
        let make = || {
            let parts = Parts {
                terrain: &terrain,
                palette: &palette(),
                instances: &instances,
                prototypes: &Models(plant()),
                objects: &[],
                species: &species,
                sky_pictures: SkyPictures::default(),
            };
            let scene = Scene::build(&parts, &Sky::clear_day(), &Silent).unwrap();
            let seed = weald_contract::Seed(5);
            let film = crate::render(&scene, &view, &config, seed, &Silent).unwrap();
            let channels = film.picture().channels.into_iter();
            let bits: Vec<u32> = channels.flat_map(|c| c.values).map(f32::to_bits).collect();
            (bits, film.statistics(), *scene.statistics())
        };
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(make)
        };
        let alone = with(1);
        assert!(alone.2.plants > 60);
        assert!(alone == with(2), "two threads gave other bits than one");
    }

    /// A stick with a crown of bristles at many places; the scales of its axes decide whether it may
    /// be a level.
    fn bristly(stretch: f32) -> PlantModel {
        let mut bristles = Mesh { material: 0, ..Mesh::default() };
        for number in 0..70u32 {
            let angle = 0.09 * number as f32;
            let (sin, cos) = (0.3 * angle.sin(), 0.3 * angle.cos());
            bristles.positions.extend([[0.0; 3], [sin, cos, 0.1], [sin, cos, 0.15]]);
            bristles.triangles.push([0, 1, 2].map(|corner| 3 * number + corner));
        }
        let place = |number: u32| weald_contract::Placement {
            position: [0.1 * number as f32, -0.05 * number as f32, 1.0 + 0.02 * number as f32],
            rotation: Quat::from_rotation_y(0.3 * number as f32).to_array(),
            scale: [
                1.0 + 0.01 * number as f32,
                1.0 + 0.01 * number as f32,
                1.0 + 0.01 * number as f32 + stretch,
            ],
        };
        let organ = weald_contract::Organ {
            name: "crown".into(),
            meshes: vec![bristles],
            placements: (0..20).map(place).collect(),
            ..weald_contract::Organ::default()
        };
        PlantModel { organs: vec![organ], ..plant() }
    }

    #[test]
    fn rays_meet_an_organ_that_is_kept_once_where_they_meet_its_copies() {
        let rows = [Row { plant_id: 7, ..row(0, 1) }];
        let [kept, copied] =
            [0.0, 1e-6].map(|stretch| scene(bristly(stretch), &rows).expect("it is sound"));
        let triangles = |scene: &Scene| scene.statistics().unique_primitives;
        assert_eq!(triangles(&copied) - triangles(&kept), 19 * 70);
        assert_eq!(kept.statistics().plants, 1);
        assert_eq!(
            kept.statistics().instanced_primitives,
            copied.statistics().instanced_primitives
        );
        let mut scratch = crate::accel::Scratch::default();
        let mut chance = weald_contract::Seed(7).stream("rays", 0);
        let foot = [0, 1, 2].map(|axis| (rows[0].position[axis] - kept.origin[axis]) as f32);
        let mut met = 0;
        for _ in 0..4000 {
            let mut point = || {
                let aside = Vec3::from_array([0; 3].map(|_| chance.range(-3.0, 3.0) as f32));
                Vec3::from(foot) + Vec3::Z + aside
            };
            let (origin, target) = (point(), point());
            let direction = (target - origin).normalize_or(Vec3::X);
            let ray = crate::accel::Ray { origin, direction };
            let [a, b] = [&kept, &copied].map(|scene| {
                let hit = scene.levels.nearest(scene.solid, &ray, f32::INFINITY, &mut scratch);
                let place = hit.is_some().then(|| scene.levels.place(scene.solid, &hit));
                (hit.t, place.map(|place| (place.plant, place.geometric)))
            });
            assert!(a.0 == b.0 || (a.0 - b.0).abs() < 1e-3, "{a:?} {b:?}");
            if let (Some(a), Some(b)) = (a.1, b.1) {
                assert_eq!(a.0, b.0);
                assert!(a.1.dot(b.1).abs() > 0.999);
                met += usize::from(a.0 != 0);
            }
        }
        assert!(met > 100, "{met}");
    }

    fn table<T: weald_contract::FromToml>(text: &str) -> T {
        let value = weald_contract::Value::parse(0, text).unwrap();
        T::from_toml(&value, &mut Vec::new()).unwrap()
    }
}
