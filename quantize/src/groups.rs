//! Patches of plants: quantized by vigor, grown in a few variants, filled with drawn members.
//!
//! A lawn is a few patches a thousand times [Deussen98, section "Approximate instancing"]. Group
//! species are worked from the outermost inwards, so that a patch inside patches is known, with
//! the number of times it will be seen, before it is quantized itself.

use crate::codebook::{Mode, cluster};
use crate::features::Traits;
use crate::neighbours::{Spot, vary};
use crate::palette::{Place, Standing};
use crate::table::Table;
use crate::{Config, Error, Weights};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use weald_contract::source::nearest;
use weald_contract::{
    GroupMember, GroupRecipe, Population, Problem, Problems, Seed, Span, Species, Stream,
};

/// Most members of all patches together: about 2 GB of plants and instances.
const MOST_MEMBERS: f64 = 2e7;

/// One patch to build.
pub(crate) struct Patch {
    pub species: String,
    /// Mean age of the patches it stands for, years.
    pub age: f32,
    pub vigor: f32,
    /// Values of the columns that its members, or theirs, are multiplied by.
    pub amounts: BTreeMap<String, f64>,
    /// Rows of instances that refer to it.
    pub rows: u64,
    /// Times it is seen in the scene, through all levels.
    pub seen: f64,
    /// Sum over those times of the inverse squared distance from the eye, 1/m².
    pub nearness: f64,
    pub members: Vec<Member>,
}

/// A plant or patch inside a patch.
pub(crate) struct Member {
    /// From the patch's centre, m.
    pub position: [f64; 2],
    /// Radians counter-clockwise.
    pub yaw: f64,
}

/// All patches, and which patch stands at each place of a group species.
#[derive(Default)]
pub(crate) struct Patches {
    pub patches: Vec<Patch>,
    pub placed: Vec<(Place, usize)>,
}

/// Members that are no species, and groups that contain themselves.
pub(crate) fn problems(species: &BTreeMap<String, Species>) -> Problems {
    let mut problems = unknown_members(species);
    if let Err(cycle) = outermost_first(species) {
        problems.push(cycle);
    }
    problems
}

fn unknown_members(species: &BTreeMap<String, Species>) -> Problems {
    let mut problems = Vec::new();
    for (name, kind) in species {
        for member in kind.group.iter().flat_map(|group| &group.member) {
            let wanted = &member.species;
            if !species.contains_key(&wanted.value) {
                let message = format!(
                    "group `{name}` has the member `{}`, which is no species",
                    wanted.value
                );
                let problem = Problem::at(wanted.span, message);
                let near = nearest(&wanted.value, species.keys().map(String::as_str));
                problems.push(match near {
                    Some(near) => problem.hint(format!("did you mean `{near}`?")),
                    None => problem.hint("add a species file of that name"),
                });
            }
        }
    }
    problems
}

/// Names of group species, each before the groups that it contains.
fn outermost_first(species: &BTreeMap<String, Species>) -> Result<Vec<&str>, Problem> {
    let mut search = Search { species, is_done: BTreeMap::new(), finished: Vec::new() };
    for (name, kind) in species {
        if kind.group.is_some() && !search.is_done.contains_key(name.as_str()) {
            search.visit(name)?;
        }
    }
    search.finished.reverse();
    Ok(search.finished)
}

/// Depth-first search through groups.
struct Search<'a> {
    species: &'a BTreeMap<String, Species>,
    /// False while a group's members are being visited, true afterwards.
    is_done: BTreeMap<&'a str, bool>,
    /// Groups after all groups that they contain.
    finished: Vec<&'a str>,
}

impl<'a> Search<'a> {
    fn visit(&mut self, name: &'a str) -> Result<(), Problem> {
        self.is_done.insert(name, false);
        let species = self.species;
        let group = species.get(name).and_then(|kind| kind.group.as_ref());
        for member in group.iter().flat_map(|group| &group.member) {
            let inner = member.species.value.as_str();
            if species.get(inner).is_none_or(|kind| kind.group.is_none()) {
                continue;
            }
            match self.is_done.get(inner) {
                Some(true) => {}
                Some(false) => return Err(cycle(name, member)),
                None => self.visit(inner)?,
            }
        }
        self.is_done.insert(name, true);
        self.finished.push(name);
        Ok(())
    }
}

fn cycle(name: &str, member: &GroupMember) -> Problem {
    let inner = &member.species.value;
    let message = if name == inner {
        format!("group `{name}` contains itself")
    } else {
        format!("group `{name}` contains `{inner}`, which contains `{name}`")
    };
    Problem::at(member.species.span, message).hint("a group may hold other groups, but not itself")
}

/// Builds the patches of all group species; members join `standing`.
pub(crate) fn fill(
    config: &Config,
    population: &Population,
    species: &BTreeMap<String, Species>,
    standing: &mut BTreeMap<String, Vec<Standing>>,
    seed: Seed,
) -> Result<Patches, Error> {
    let mut patches = Patches::default();
    let mut member_count = 0.0;
    for name in outermost_first(species)? {
        let group = species.get(name).and_then(|kind| kind.group.as_ref());
        let (Some(recipe), Some(places)) = (group, standing.remove(name)) else { continue };
        let first = patches.patches.len();
        let columns = amount_columns(species, name);
        let wanted = Wanted { config, population, name, recipe, columns: &columns };
        patches.choose(&wanted, &places, seed)?;
        let new = &patches.patches[first..];
        member_count += new.iter().map(|patch| expected_members(recipe, patch)).sum::<f64>();
        if member_count > MOST_MEMBERS {
            return Err(too_many(name).into());
        }
        for patch in first..patches.patches.len() {
            let stream_seed = seed.part(name, (patch - first) as u64);
            patches.draw(patch, recipe, species, standing, stream_seed);
        }
    }
    Ok(patches)
}

fn too_many(name: &str) -> Problem {
    Problem::new(format!(
        "the patches of group `{name}` and the groups before it have more than {MOST_MEMBERS} members"
    ))
    .hint("lower its `side` or `per_m2`, or `quantize.group_variants`")
}

fn expected_members(recipe: &GroupRecipe, patch: &Patch) -> f64 {
    recipe.member.iter().map(|member| expected(recipe, member, patch)).sum()
}

/// Mean number of plants of one member species in a patch.
fn expected(recipe: &GroupRecipe, member: &GroupMember, patch: &Patch) -> f64 {
    let amount = member.amount.as_ref().and_then(|column| patch.amounts.get(&column.value));
    let full = f64::from(member.per_m2) * f64::from(recipe.side).powi(2);
    full * f64::from(patch.vigor) * amount.copied().unwrap_or(1.0)
}

/// Columns that the members of a group are multiplied by, and those of the groups in it.
fn amount_columns<'a>(
    species: &'a BTreeMap<String, Species>,
    name: &str,
) -> BTreeMap<&'a str, Span> {
    let mut columns = BTreeMap::new();
    let group = species.get(name).and_then(|kind| kind.group.as_ref());
    for member in group.iter().flat_map(|group| &group.member) {
        columns.extend(member.amount.iter().map(|column| (column.value.as_str(), column.span)));
        columns.extend(amount_columns(species, &member.species.value));
    }
    columns
}

/// The patches of one group species.
struct Wanted<'a> {
    config: &'a Config,
    population: &'a Population,
    name: &'a str,
    recipe: &'a GroupRecipe,
    /// See [`amount_columns`].
    columns: &'a BTreeMap<&'a str, Span>,
}

/// Patches nearer than this many sides are neighbours: the eight around one on a grid.
const NEIGHBOURS: f64 = 1.5;

impl Wanted<'_> {
    /// Gives other variants to patches of the scene that would stand beside themselves; those
    /// inside patches are repeated with them anyway. A choice is a kind and a variant.
    fn part_neighbours(&self, places: &[Standing], choices: &mut [(usize, u64)]) {
        let spot = |(at, place): (usize, &Standing)| {
            let Place::Scene { index, id } = place.place else { return None };
            let plant = self.population.plants.get(index)?;
            let (kind, wish) = choices[at];
            let position = [plant.x, plant.y];
            Some((at, Spot { id, position, yaw: plant.yaw.into(), kind, wish }))
        };
        let (rows, spots): (Vec<usize>, Vec<Spot>) =
            places.iter().enumerate().filter_map(spot).unzip();
        let variants = u64::from(self.config.group_variants.max(1));
        let chosen = vary(&spots, NEIGHBOURS * f64::from(self.recipe.side), variants);
        for (at, variant) in rows.into_iter().zip(chosen) {
            choices[at].1 = variant;
        }
    }
}

impl Patches {
    /// Decides which patches exist, and which of them stands at each place.
    ///
    /// Places are quantized by vigor. Each then takes one of the variants of its kind by a
    /// number that hangs on its plant alone, or another where a neighbour has that one.
    fn choose(
        &mut self,
        wanted: &Wanted<'_>,
        places: &[Standing],
        seed: Seed,
    ) -> Result<(), Error> {
        let Wanted { config, name, .. } = *wanted;
        let amounts = self.amounts(wanted, places)?;
        let table = kind_table(wanted, places, &amounts)?;
        let book = cluster(&table, config.group_representatives as usize, config.mode);
        let mut by_vigor: Vec<usize> = (0..book.len()).collect();
        let order = |a: &f64, b: &f64| a.total_cmp(b);
        by_vigor.sort_by(|a, b| {
            let pairs = book.centre(*a).iter().zip(book.centre(*b));
            pairs.map(|(a, b)| order(a, b)).find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
        });
        let mut rank = vec![0; book.len()];
        by_vigor.iter().enumerate().for_each(|(place, label)| rank[*label] = place);

        // A patch of its own has no others of its kind.
        let variants = match config.mode {
            Mode::Exact => 1,
            _ => u64::from(config.group_variants.max(1)),
        };
        let choice = |(place, label): (&Standing, &u32)| {
            (rank[*label as usize], place.place.stream(seed, name).below(variants))
        };
        let mut choices: Vec<_> = places.iter().zip(&book.labels).map(choice).collect();
        wanted.part_neighbours(places, &mut choices);
        let mut numbers: BTreeMap<_, usize> = choices.iter().map(|key| (*key, 0)).collect();
        let mean_ages = mean_ages(&book.labels, book.len(), places);
        for ((rank, _), number) in &mut numbers {
            let label = by_vigor[*rank];
            *number = self.patches.len();
            self.patches.push(Patch {
                species: name.to_owned(),
                age: mean_ages[label],
                vigor: book.centre(label)[0] as f32,
                amounts: mean_amounts(wanted.columns, &amounts, &book.centre(label)[1..]),
                rows: 0,
                seen: 0.0,
                nearness: 0.0,
                members: Vec::new(),
            });
        }
        for (place, choice) in places.iter().zip(&choices) {
            let patch = numbers[choice];
            self.patches[patch].rows += 1;
            self.patches[patch].seen += place.seen;
            self.patches[patch].nearness += place.nearness;
            self.placed.push((place.place, patch));
        }
        Ok(())
    }

    /// Amounts at each place, column after column.
    fn amounts(&self, wanted: &Wanted<'_>, places: &[Standing]) -> Result<Vec<Vec<f64>>, Problem> {
        let Wanted { population, name, .. } = *wanted;
        let column = |(column, span): (&&str, &Span)| {
            let Some(values) = population.extra.get(*column) else {
                let known = population.extra.keys().map(String::as_str);
                return Err(lacks_column(name, column, *span, known));
            };
            let of = |place: &Standing| match place.place {
                Place::Scene { index, id } => {
                    let amount = values.get(index).copied().unwrap_or(f32::NAN);
                    if amount.is_nan() {
                        return Ok(1.0);
                    }
                    if !(amount.is_finite() && amount >= 0.0) {
                        let message = format!("plant {id}: `{column}` is {amount}");
                        let hint = "a finite number of at least 0 is right";
                        return Err(Problem::new(message).hint(hint));
                    }
                    Ok(f64::from(amount))
                }
                Place::Patch { patch, .. } => {
                    Ok(self.patches[patch].amounts.get(*column).copied().unwrap_or(1.0))
                }
            };
            places.iter().map(of).collect()
        };
        wanted.columns.iter().map(column).collect()
    }

    /// Draws the members of a patch: a new patch or plant each in `standing`.
    fn draw(
        &mut self,
        index: usize,
        recipe: &GroupRecipe,
        species: &BTreeMap<String, Species>,
        standing: &mut BTreeMap<String, Vec<Standing>>,
        seed: Seed,
    ) {
        let patch = &mut self.patches[index];
        for (number, member) in recipe.member.iter().enumerate() {
            let Some(kind) = species.get(&member.species.value) else { continue };
            let mut random = seed.stream("member", number as u64);
            let count = (expected(recipe, member, patch) + random.unit()).floor() as usize;
            let stand = standing.entry(member.species.value.clone()).or_default();
            for position in positions(count, f64::from(recipe.side), &mut random) {
                let [youngest, oldest] = member.age.map(f64::from);
                let age = random.range(youngest, oldest) as f32;
                let vigor = random.around(patch.vigor.into(), member.vigor_spread.into());
                let yaw = match kind.group {
                    // Square patches stay aligned, as in the scene.
                    Some(_) => TAU / 4.0 * random.below(4) as f64,
                    None => random.range(0.0, TAU),
                };
                let place = Place::Patch { patch: index, ordinal: patch.members.len() };
                let traits = Traits::of_age(&kind.size, age, vigor.clamp(0.0, 1.0) as f32);
                let Patch { seen, nearness, .. } = *patch;
                stand.push(Standing { place, traits, seen, nearness });
                patch.members.push(Member { position, yaw });
            }
        }
    }
}

fn lacks_column<'a>(
    name: &str,
    column: &str,
    span: Span,
    known: impl Iterator<Item = &'a str>,
) -> Problem {
    let message =
        format!("a member of group `{name}` is multiplied by `{column}`, which no plant has");
    let problem = Problem::at(span, message);
    match nearest(column, known) {
        Some(near) => problem.hint(format!("did you mean `{near}`?")),
        None => problem
            .hint(format!("the step that plants it may have `amount = [{{ name = \"{column}\", …")),
    }
}

/// Vigor and amounts of each place, these as parts of the greatest, weighted by the ground of the
/// patches or alike.
fn kind_table(
    wanted: &Wanted<'_>,
    places: &[Standing],
    amounts: &[Vec<f64>],
) -> Result<Table, Problem> {
    let area = f64::from(wanted.recipe.side).powi(2);
    let weight = |place: &Standing| match wanted.config.weights {
        Weights::Area => place.seen * area,
        Weights::Uniform => 1.0,
        Weights::View => place.nearness * area,
    };
    let greatest: Vec<f64> = amounts.iter().map(|column| greatest(column)).collect();
    let row = |(index, place): (usize, &Standing)| {
        let parts = amounts.iter().zip(&greatest).map(move |(column, most)| column[index] / most);
        std::iter::once(f64::from(place.traits.vigor)).chain(parts).collect::<Vec<f64>>()
    };
    let values = places.iter().enumerate().flat_map(row).collect();
    Table::new(values, 1 + amounts.len(), places.iter().map(weight).collect())
        .map_err(|error| Problem::new(error.to_string()))
}

/// The greatest amount; 1 where all are 0.
fn greatest(column: &[f64]) -> f64 {
    let most = column.iter().copied().fold(0.0, f64::max);
    if most > 0.0 { most } else { 1.0 }
}

/// What the parts of a cluster's centre are in each column.
fn mean_amounts(
    columns: &BTreeMap<&str, Span>,
    amounts: &[Vec<f64>],
    parts: &[f64],
) -> BTreeMap<String, f64> {
    let named = columns.keys().zip(amounts).zip(parts);
    named.map(|((name, column), part)| ((*name).to_owned(), part * greatest(column))).collect()
}

fn mean_ages(labels: &[u32], count: usize, places: &[Standing]) -> Vec<f32> {
    let mut sums = vec![[0.0, 0.0]; count];
    for (label, place) in labels.iter().zip(places) {
        let sum = &mut sums[*label as usize];
        *sum = [sum[0] + f64::from(place.traits.age), sum[1] + 1.0];
    }
    sums.into_iter().map(|[sum, count]| (sum / count) as f32).collect()
}

/// `count` places in a square of side `side` about the origin, on a jittered grid.
///
/// The grid has as many cells as places, rounded up to a square; the empty ones are drawn.
fn positions(count: usize, side: f64, random: &mut Stream) -> Vec<[f64; 2]> {
    let across = count.isqrt() + usize::from(count.isqrt().pow(2) < count);
    let mut cells: Vec<usize> = (0..across * across).collect();
    let mut place = |chosen: usize| {
        // Fisher and Yates: the chosen cells move to the front.
        let other = chosen + random.below((cells.len() - chosen) as u64) as usize;
        cells.swap(chosen, other);
        let [column, row] = [cells[chosen] % across, cells[chosen] / across];
        [column, row].map(|cell| ((cell as f64 + random.unit()) / across as f64 - 0.5) * side)
    };
    (0..count).map(&mut place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_comes_before_the_groups_that_it_contains_once() {
        let size = "[size]\nheight = 1\ncrown_radius = 1\n[group]\nside = 1\n";
        let group = |members: &[&str]| {
            let member =
                |name: &&str| format!("[[group.member]]\nspecies = '{name}'\nper_m2 = 1\n");
            let text = size.to_string() + &members.iter().map(member).collect::<String>();
            let value = weald_contract::Value::parse(0, &text).unwrap();
            Species::read(&value, &mut Vec::new()).unwrap()
        };
        // Deeper names stand both before and after the groups that hold them.
        let pairs = [("b", group(&["z", "a"])), ("z", group(&["a"])), ("a", group(&["tuft"]))];
        let species = pairs.map(|(name, kind)| (name.to_string(), kind)).into_iter().collect();
        assert_eq!(outermost_first(&species).unwrap(), ["b", "z", "a"]);
    }

    #[test]
    fn every_number_of_places_fits_inside_the_square_one_a_cell() {
        for count in [0, 1, 2, 4, 5, 99, 100] {
            let places = positions(count, 2.0, &mut Seed(1).stream("places", 0));
            assert_eq!(places.len(), count);
            assert!(places.iter().flatten().all(|x| (-1.0..1.0).contains(x)));
            let across = (count as f64).sqrt().ceil();
            let cell = |x: f64| ((x / 2.0 + 0.5) * across) as i64;
            let mut cells: Vec<_> = places.iter().map(|p| (cell(p[0]), cell(p[1]))).collect();
            cells.sort_unstable();
            cells.dedup();
            assert_eq!(cells.len(), count);
        }
    }
}
