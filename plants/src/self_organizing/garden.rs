//! The cycle of growth: one tree, or several that compete in one space.

use super::fate::{self, Sprout};
use super::markers::{MarkerSet, Seeker};
use super::plant::{Bears, Metamer, Plant, Slot};
use super::script::Script;
use super::shadow::ShadowGrid;
use super::{Competition, Fate, Seeking, SelfOrganizing, script};
use crate::Error;
use crate::frame::{across, any_normal};
use crate::volume::{Bounds, Solid};
use glam::{Quat, Vec3};
use weald_contract::Seed;

/// What trees compete for.
pub(super) enum Environment {
    /// Light.
    Light(ShadowGrid),
    /// Space.
    Space(MarkerSet),
}

/// A tree and what it is grown by.
pub(super) struct Member<'a> {
    pub(super) form: &'a SelfOrganizing,
    pub(super) vigor: f32,
    pub(super) plant: Plant,
    seed: Seed,
}

/// A plant that stands in the way without growing: an ellipsoid crown that touches the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbor {
    /// Where it stands, in internodes.
    pub foot: Vec3,
    /// Height, internodes.
    pub height: f32,
    /// Crown radius, internodes.
    pub radius: f32,
    /// Whether it only shades, and shoots may grow into it.
    pub shades_only: bool,
}

/// What has grown so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Cycles done.
    pub cycles: u32,
    /// Metamers of each tree.
    pub metamers: Vec<usize>,
    /// Metamers that fell with shed or pruned branches, of all trees.
    pub fallen: usize,
    /// Markers that are still free.
    pub free_markers: usize,
    /// Whether growth ended because a tree reached its most metamers.
    pub is_full: bool,
    /// Bytes of trees and space.
    pub bytes: usize,
}

/// Trees in one space.
pub struct Garden<'a> {
    pub(super) members: Vec<Member<'a>>,
    pub(super) environment: Environment,
    /// Where nothing may grow; with light also solid voxels.
    obstacles: Vec<Solid>,
    script: Script,
    pub(super) cycle: u32,
    /// How much of the last cycle's shoots has grown.
    pub(super) fraction: f32,
    fallen: usize,
    is_full: bool,
    seed: Seed,
}

impl<'a> Garden<'a> {
    /// Seedlings of one form at places, each with its vigor.
    ///
    /// # Errors
    /// The form's script cannot be read.
    pub fn new(form: &'a SelfOrganizing, feet: &[(Vec3, f32)], seed: Seed) -> Result<Self, Error> {
        let members: Vec<_> = feet.iter().map(|(foot, vigor)| (form, *foot, *vigor)).collect();
        Self::of(&members, seed)
    }

    /// Seedlings of several forms; space, script and what is competed for are those of the first.
    ///
    /// # Errors
    /// The first form's script cannot be read, or there is no seedling.
    pub fn of(members: &[(&'a SelfOrganizing, Vec3, f32)], seed: Seed) -> Result<Self, Error> {
        let nobody = || weald_contract::Problem::new("no seedling was planted");
        let (form, ..) = *members.first().ok_or_else(nobody)?;
        let feet = members.iter().fold(Bounds::NONE, |sum, (_, foot, _)| sum.with_point(*foot));
        let first = |problems: Vec<weald_contract::Problem>| problems.into_iter().next();
        let script = Script::read(&form.script)
            .map_err(|problems| first(problems).unwrap_or_else(nobody))?;
        let environment = match form.competition {
            Competition::Shadow => Environment::Light(ShadowGrid::new(&form.shadow, feet, seed)),
            Competition::Markers => {
                let markers = &form.markers;
                Environment::Space(MarkerSet::scatter(markers, &markers.space, seed))
            }
        };
        let mut garden = Self {
            members: Vec::new(),
            environment,
            obstacles: Vec::new(),
            script,
            cycle: 0,
            fraction: 1.0,
            fallen: 0,
            is_full: false,
            seed,
        };
        for (index, (form, foot, vigor)) in members.iter().enumerate() {
            let plant = Plant::seedling(*foot, 1.0, form.buds);
            garden.cast_shadow(plant.metamers[0].tip);
            let seed = seed.part("tree", index as u64);
            garden.members.push(Member { form, vigor: *vigor, plant, seed });
        }
        Ok(garden)
    }

    fn cast_shadow(&mut self, tip: Vec3) {
        if let Environment::Light(grid) = &mut self.environment {
            grid.add(tip);
        }
    }

    /// Lets the trees grow for so many cycles; of the last, a fraction of the shoots' length.
    ///
    /// # Errors
    /// A command of the script cannot be carried out.
    pub fn grow_to(&mut self, cycles: f32) -> Result<(), Error> {
        while (self.cycle as f32) < cycles && !self.is_full {
            self.grow_cycle()?;
        }
        let whole = libm::ceilf(cycles) - 1.0;
        self.fraction =
            if self.cycle as f32 > whole { (cycles - whole).clamp(0.0, 1.0) } else { 1.0 };
        self.members.iter_mut().for_each(|member| member.plant.gather_pipes());
        Ok(())
    }

    /// One cycle of all trees.
    ///
    /// # Errors
    /// A command of the script cannot be carried out.
    pub fn grow_cycle(&mut self) -> Result<(), Error> {
        script::carry_out(self)?;
        self.cycle += 1;
        // All buds sense before any grows, so that no tree is favoured by its number.
        self.sense();
        for index in 0..self.members.len() {
            let sprouts = self.share_out(index);
            for sprout in sprouts {
                self.shoot(index, sprout);
            }
            self.shed(index);
        }
        Ok(())
    }

    /// Step 1: light or space of all buds.
    fn sense(&mut self) {
        for Member { form, plant, .. } in &mut self.members {
            wait(plant, form.bud_life);
        }
        match &mut self.environment {
            Environment::Light(grid) => {
                self.members.iter_mut().for_each(|member| sense_light(&mut member.plant, grid));
            }
            Environment::Space(markers) => {
                let newest = self.cycle - 1;
                for Member { form, plant, .. } in &self.members {
                    let fresh = plant.metamers.iter().rev();
                    for metamer in fresh.take_while(|metamer| u32::from(metamer.born) >= newest) {
                        markers.occupy(metamer.tip, form.markers.occupied);
                    }
                }
                sense_space(&mut self.members, markers);
            }
        }
        self.members.iter_mut().for_each(|member| member.plant.gather());
    }

    /// Step 2: the buds of a tree that grow in this cycle.
    fn share_out(&self, index: usize) -> Vec<Sprout> {
        let Member { form, plant, vigor, .. } = &self.members[index];
        let [weak, strong] = form.alpha;
        let alpha = weak + (strong - weak) * vigor;
        let resource = alpha * plant.gathered.first().copied().unwrap_or(0.0);
        let mut sprouts = Vec::new();
        match form.fate {
            Fate::BorchertHonda => {
                let lambda = form.lambda.at(self.cycle as f32);
                fate::borchert_honda(plant, lambda, resource, &mut sprouts);
            }
            Fate::Priority => {
                let weights = &form.priority;
                let ended = weights.apical_until.is_some_and(|cycle| self.cycle >= cycle);
                let leads = weights.apical_first && !ended;
                fate::priority(plant, weights, leads, resource, &mut sprouts);
            }
        }
        sprouts
    }

    /// Step 3: a bud's shoot.
    fn shoot(&mut self, index: usize, sprout: Sprout) {
        let member = &mut self.members[index];
        let (form, plant) = (member.form, &mut member.plant);
        let Sprout { metamer, place, resource } = sprout;
        let slot = metamer as usize * plant.stride + place as usize;
        let from = plant.metamers[metamer as usize];
        let metamers = (resource as u32).min(form.longest_shoot);
        // The paper's v/n; a shoot that is kept short keeps its internodes below 2 as well.
        let length = (resource / metamers as f32).min(2.0);
        let cycle = self.cycle as f32;
        let angle = form.branch_angle_deg.to_radians();
        let direction = plant.bud_direction(metamer as usize, place as usize, angle);
        let open = open_direction(&self.environment, plant, form, slot, from.tip, direction);
        let steady = Vec3::from_array(form.tropism_toward.value).normalize_or(Vec3::Z);
        let pull = open * form.seek.at(cycle) + steady * form.tropism.at(cycle);
        let mut shoot = if place == 0 {
            Shoot { axis: from.axis, place: from.place + 1, order: from.order, ..Shoot::at(&from) }
        } else {
            let name = from.place * 8 + place - 1;
            let axis = crate::skeleton::axis_id(from.axis, "shoot", name);
            let order = from.order.saturating_add(1);
            Shoot { axis, place: 0, order, ..Shoot::at(&from) }
        };
        shoot.heading = direction;
        if place > 0 {
            // Shoots in two ranks lie level.
            shoot.normal = direction.cross(Vec3::Z).try_normalize().unwrap_or(Vec3::X);
        }
        let mut parent = metamer;
        for _ in 0..metamers {
            if plant.metamers.len() >= form.most_metamers as usize {
                self.is_full = true;
                return;
            }
            shoot.grow(length, pull, form, member.seed);
            let open = match &self.environment {
                Environment::Light(grid) => grid.is_open(shoot.tip),
                Environment::Space(_) => true,
            };
            // Nothing that grows above the ground grows into it.
            let open = open && shoot.tip.z >= plant.foot.z;
            if !open || self.obstacles.iter().any(|solid| solid.contains(shoot.tip)) {
                return;
            }
            let grown = plant.push(shoot.metamer(parent, self.cycle as u16));
            let slot = if parent == metamer { slot } else { parent as usize * plant.stride };
            plant.slots[slot] = Slot::metamer(grown);
            parent = grown;
            if let Environment::Light(grid) = &mut self.environment {
                grid.add(shoot.tip);
            }
        }
    }

    /// Step 4: branches that have gathered too little for their internodes fall.
    fn shed(&mut self, index: usize) {
        let form = self.members[index].form;
        if form.shed <= 0.0 {
            return;
        }
        let cycle = self.cycle;
        let plant = &mut self.members[index].plant;
        let mut marked = vec![false; plant.metamers.len()];
        let mut any = false;
        // What has grown in this cycle has not been weighed.
        for (metamer, mark) in marked.iter_mut().enumerate().take(plant.gathered.len()) {
            if !plant.begins_branch(metamer) {
                continue;
            }
            let ratio = plant.gathered[metamer] / plant.count[metamer] as f32;
            let base = &mut plant.metamers[metamer];
            let is_young = u32::from(base.born) + 1 >= cycle;
            base.starving =
                if ratio < form.shed && !is_young { base.starving.saturating_add(1) } else { 0 };
            if u32::from(base.starving) >= form.shed_after {
                *mark = true;
                any = true;
            }
        }
        if any {
            // What fell in the year of its growth counts as well.
            plant.gather_pipes();
            self.fell(index, marked);
        }
    }

    /// Removes the branches that begin with marked metamers.
    pub(super) fn fell(&mut self, index: usize, marked: Vec<bool>) {
        let Member { form, plant, .. } = &mut self.members[index];
        let (environment, fallen) = (&mut self.environment, &mut self.fallen);
        plant.shed(marked, form.pipe_memory, |tip| {
            *fallen += 1;
            if let Environment::Light(grid) = environment {
                grid.remove(tip);
            }
        });
    }

    /// Puts up a solid in which nothing grows; an `opaque` one also darkens what is below it.
    pub fn obstruct(&mut self, solid: Solid, opaque: bool) {
        match &mut self.environment {
            Environment::Light(grid) => {
                grid.block(solid.bounds(), opaque, |p| solid.contains(p));
            }
            Environment::Space(markers) => {
                let sight = self.members[0].form.markers.sight;
                markers.erase(|p| solid.contains(p), sight);
            }
        }
        self.obstacles.push(solid);
    }

    /// Lets the trees grow beside plants that stand already.
    pub fn stand_beside(&mut self, neighbors: &[Neighbor]) {
        for neighbor in neighbors {
            let half = 0.5 * neighbor.height.max(1e-3);
            let radius = neighbor.radius.max(1e-3);
            let crown = Solid::Ellipsoid(crate::volume::Ellipsoid {
                center: (neighbor.foot + Vec3::Z * half).to_array(),
                radii: [radius, radius, half],
            });
            match &mut self.environment {
                Environment::Light(grid) if neighbor.shades_only => grid.shade(&crown),
                _ => self.obstruct(crown, true),
            }
        }
    }

    /// Lets all buds look for markers again, after some were added.
    pub(super) fn look_again(&mut self) {
        for Member { plant, .. } in &mut self.members {
            plant.slots.iter_mut().for_each(|slot| *slot = slot.seeing(true));
        }
    }

    /// Lets light come from another direction.
    pub(super) fn turn_light(&mut self, light: Vec3) -> Result<(), Error> {
        let tips = self.members.iter().flat_map(|member| &member.plant.metamers);
        match &mut self.environment {
            Environment::Light(grid) => grid.turn_light(light, tips.map(|metamer| metamer.tip)),
            Environment::Space(_) => {
                let what = "light has no direction where trees compete for markers";
                Err(weald_contract::Problem::new(what).into())
            }
        }
    }

    /// Turns a branch by `angle` (rad) towards a direction, about where it begins.
    pub(super) fn bend(&mut self, index: usize, branch: usize, toward: Vec3, angle: f32) {
        let plant = &mut self.members[index].plant;
        let pivot = plant.start(branch);
        let heading = plant.metamers[branch].heading;
        let axis = heading.cross(toward).try_normalize().unwrap_or(any_normal(heading));
        let (sin, cos) = libm::sincosf(0.5 * angle);
        let rotation = Quat::from_xyzw(axis.x * sin, axis.y * sin, axis.z * sin, cos);
        let mut is_beyond = vec![false; plant.metamers.len()];
        for metamer in branch..plant.metamers.len() {
            let parent = plant.metamers[metamer].parent;
            is_beyond[metamer] =
                metamer == branch || (parent != Plant::NOTHING && is_beyond[parent as usize]);
            if !is_beyond[metamer] {
                continue;
            }
            let metamer = &mut plant.metamers[metamer];
            let tip = pivot + rotation * (metamer.tip - pivot);
            if let Environment::Light(grid) = &mut self.environment {
                grid.remove(metamer.tip);
                grid.add(tip);
            }
            metamer.tip = tip;
            metamer.heading = (rotation * metamer.heading).normalize();
            let normal = across(rotation * metamer.normal, metamer.heading);
            metamer.normal = normal.unwrap_or_else(|| any_normal(metamer.heading));
        }
        plant.slots.iter_mut().for_each(|slot| *slot = slot.seeing(true));
    }

    /// The seed for a command's chance.
    pub(super) fn seed_of(&self, name: &str, index: u64) -> Seed {
        self.seed.part(name, index)
    }

    pub(super) fn script(&self) -> &Script {
        &self.script
    }

    /// The tree of this number.
    pub fn plant(&self, index: usize) -> &Plant {
        &self.members[index].plant
    }

    /// The free markers, where trees compete for them.
    pub fn free_markers(&self) -> Vec<Vec3> {
        match &self.environment {
            Environment::Space(markers) => markers.free().collect(),
            Environment::Light(_) => Vec::new(),
        }
    }

    /// What has grown so far.
    pub fn report(&self) -> Report {
        let plants = || self.members.iter().map(|member| &member.plant);
        let (free_markers, bytes) = match &self.environment {
            Environment::Light(grid) => (0, grid.bytes()),
            Environment::Space(markers) => (markers.len(), markers.bytes()),
        };
        Report {
            cycles: self.cycle,
            metamers: plants().map(|plant| plant.metamers.len()).collect(),
            fallen: self.fallen,
            free_markers,
            is_full: self.is_full,
            bytes: bytes + plants().map(Plant::bytes).sum::<usize>(),
        }
    }
}

/// Makes lateral buds a cycle older; a terminal bud lives as long as its axis.
fn wait(plant: &mut Plant, life: u32) {
    for node in plant.slots.chunks_exact_mut(plant.stride) {
        node[1..].iter_mut().for_each(|slot| *slot = slot.waited(life));
    }
}

fn sense_light(plant: &mut Plant, grid: &ShadowGrid) {
    plant.light.resize(plant.slots.len(), 0.0);
    let nodes = plant.slots.chunks_exact(plant.stride);
    let lights = plant.light.chunks_exact_mut(plant.stride);
    for ((node, lights), metamer) in nodes.zip(lights).zip(&plant.metamers) {
        if !node.iter().any(|slot| slot.is_bud()) {
            continue;
        }
        // All buds of a node sit in one voxel.
        lights.fill(grid.exposure(metamer.tip));
    }
}

fn sense_space(members: &mut [Member<'_>], markers: &mut MarkerSet) {
    let mut seekers = Vec::new();
    let mut seats = Vec::new();
    for (member, Member { form, plant, .. }) in members.iter_mut().enumerate() {
        let angle = form.branch_angle_deg.to_radians();
        for metamer in 0..plant.metamers.len() {
            for place in 0..plant.stride {
                let slot = metamer * plant.stride + place;
                if let Bears::Bud { is_blind: false, .. } = plant.slots[slot].bears() {
                    let direction = plant.bud_direction(metamer, place, angle);
                    seekers.push(Seeker { at: plant.metamers[metamer].tip, direction });
                    seats.push((member as u32, slot as u32));
                }
            }
        }
        plant.light.clear();
        plant.light.resize(plant.slots.len(), 0.0);
        plant.toward.clear();
        plant.toward.resize(plant.slots.len(), Vec3::ZERO);
    }
    let Some(Member { form, .. }) = members.first() else { return };
    let half_angle = 0.5 * form.markers.aperture_deg.to_radians();
    let given = markers.compete(&seekers, form.markers.sight, half_angle);
    for (given, (member, slot)) in given.iter().zip(seats) {
        let (plant, slot) = (&mut members[member as usize].plant, slot as usize);
        plant.light[slot] = if given.count > 0 { 1.0 } else { 0.0 };
        plant.toward[slot] = given.toward;
        plant.slots[slot] = plant.slots[slot].seeing(given.sees);
    }
}

/// Direction of free space or light for a bud that grows.
fn open_direction(
    environment: &Environment,
    plant: &Plant,
    form: &SelfOrganizing,
    slot: usize,
    at: Vec3,
    direction: Vec3,
) -> Vec3 {
    match environment {
        Environment::Space(_) => plant.toward[slot],
        Environment::Light(grid) => match form.shadow.seeking {
            Seeking::Gradient => grid.against_gradient(at),
            Seeking::Lightest => {
                let half_angle = 0.5 * form.markers.aperture_deg.to_radians();
                grid.to_lightest(at, direction, half_angle, form.shadow.reach as i32)
            }
        },
    }
}

/// A shoot while it grows: its newest metamer.
struct Shoot {
    tip: Vec3,
    heading: Vec3,
    normal: Vec3,
    axis: u64,
    place: u32,
    order: u8,
}

impl Shoot {
    fn at(from: &Metamer) -> Self {
        let Metamer { tip, heading, normal, axis, place, order, .. } = *from;
        Self { tip, heading, normal, axis, place, order }
    }

    /// The next internode: heading bent by the pull, the normal carried along without twist and
    /// then turned by the divergence.
    fn grow(&mut self, length: f32, pull: Vec3, form: &SelfOrganizing, seed: Seed) {
        let [bend, turn] = jitter(form.jitter_deg, self.axis, self.place, seed);
        let side = self.heading.cross(self.normal);
        let shaken = self.heading + side * bend;
        self.heading = (shaken + pull).try_normalize().unwrap_or(self.heading);
        let carried = across(self.normal, self.heading);
        let carried = carried.unwrap_or_else(|| any_normal(self.heading));
        let (sin, cos) = libm::sincosf(form.divergence_deg.to_radians() + turn);
        self.normal = carried * cos + self.heading.cross(carried) * sin;
        self.tip += self.heading * length;
    }

    fn metamer(&mut self, parent: u32, born: u16) -> Metamer {
        let Self { tip, heading, normal, axis, place, order } = *self;
        self.place += 1;
        Metamer { tip, heading, normal, parent, place, axis, born, order, starving: 0 }
    }
}

/// Chance of a node: a bend and a turn, rad. They hang on the node's name, not on the order of
/// growth.
fn jitter(jitter_deg: f32, axis: u64, place: u32, seed: Seed) -> [f32; 2] {
    if jitter_deg == 0.0 {
        return [0.0; 2];
    }
    let bits = weald_contract::seed::mix(axis ^ seed.0.rotate_left(17) ^ (u64::from(place) << 40));
    let part = |bits: u64| (bits & 0xFFFF_FFFF) as f32 / 4_294_967_296.0 * 2.0 - 1.0;
    [bits, bits >> 32].map(|bits| part(bits) * jitter_deg.to_radians())
}
