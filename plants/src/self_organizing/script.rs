//! Commands that change the space or the trees while they grow, one a line.
//!
//! ```text
//! # cycle, command
//! at 0 brush add ball 0,0,30 12 markers 4000
//! at 0 brush add tube 0,0,0 0,0,20 5,0,30 radius 3 markers 2000
//! at 4 brush erase box -50,-50,0 0,50,60
//! at 2 light 1,0,2
//! at 0 obstacle box 4,-30,0 6,30,40 opaque
//! at 6 bend 0,3,12 toward 0,0,-1 by 30
//! at 8 prune near 0,3,12
//! at 9 prune outside ball 0,0,20 12
//! ```
//!
//! Places are in internodes from the foot of the first tree, as `x,y,z`. `at 3` means before the
//! shoots of the fourth cycle; `every 2` means before each second cycle, from the first on.

use super::garden::{Environment, Garden};
use super::markers::scattered;
use super::plant::Plant;
use crate::Error;
use crate::volume::{self, Ball, Block, Cylinder, Solid, Tube};
use glam::Vec3;
use std::str::FromStr;
use weald_contract::source::nearest;
use weald_contract::{Problem, Problems, Written};

/// Commands by the order of their lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    lines: Vec<(When, Command)>,
}

/// When a command is carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Before one cycle, counted from 0.
    At(u32),
    /// Before each cycle whose number can be divided.
    Every(u32),
}

/// What is done.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Scatters so many markers over a solid.
    Add(Solid, u32),
    /// Removes the markers in a solid.
    Erase(Solid),
    /// Lets light come from a direction.
    Light(Vec3),
    /// Puts up a solid in which nothing grows; an opaque one also casts shadow.
    Obstacle(Solid, bool),
    /// Turns the branch at a place towards a direction by an angle, rad.
    Bend(Vec3, Vec3, f32),
    /// Cuts the metamer nearest to a place and all beyond it.
    PruneNear(Vec3),
    /// Cuts all that is inside a solid, or all that is outside.
    Prune(Solid, bool),
}

impl Script {
    /// Reads a script.
    ///
    /// # Errors
    /// Every line that is no command, with its number and what would be right.
    pub fn read(text: &Written<String>) -> Result<Self, Problems> {
        let (mut lines, mut problems) = (Vec::new(), Vec::new());
        for (number, line) in text.value.lines().enumerate() {
            let words: Vec<&str> =
                line.split('#').next().unwrap_or("").split_whitespace().collect();
            if words.is_empty() {
                continue;
            }
            match (Words { words: &words }).line() {
                Ok(line) => lines.push(line),
                Err(Wrong { message, hint }) => {
                    let what = format!("line {} of the script: {message}", number + 1);
                    problems.push(Problem::at(text.span, what).hint(hint));
                }
            }
        }
        if problems.is_empty() { Ok(Self { lines }) } else { Err(problems) }
    }

    /// Commands of a cycle, in their order.
    pub fn of(&self, cycle: u32) -> impl Iterator<Item = (usize, &Command)> {
        let is_due = move |when: &When| match when {
            When::At(at) => *at == cycle,
            When::Every(step) => cycle.is_multiple_of(*step),
        };
        let lines = self.lines.iter().enumerate();
        lines.filter(move |(_, (when, _))| is_due(when)).map(|(i, (_, command))| (i, command))
    }
}

/// What is wrong with a line.
struct Wrong {
    message: String,
    hint: String,
}

fn wrong(message: impl Into<String>, hint: impl Into<String>) -> Wrong {
    Wrong { message: message.into(), hint: hint.into() }
}

/// The words of a line that are still to be read.
struct Words<'a> {
    words: &'a [&'a str],
}

impl<'a> Words<'a> {
    fn next(&mut self, wanted: &str) -> Result<&'a str, Wrong> {
        let (first, rest) =
            self.words.split_first().ok_or_else(|| wrong("the line ends too early", wanted))?;
        self.words = rest;
        Ok(first)
    }

    /// One of some words.
    fn word(&mut self, known: &[&'static str]) -> Result<&'static str, Wrong> {
        let list = format!("allowed here: {}", known.join(", "));
        let found = self.next(&list)?;
        known.iter().find(|word| **word == found).copied().ok_or_else(|| {
            let hint = match nearest(found, known.iter().copied()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => list,
            };
            wrong(format!("unknown word `{found}`"), hint)
        })
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, Wrong> {
        let found = self.next(what)?;
        found.parse().map_err(|_| wrong(format!("`{found}` is not {what}"), "write a number"))
    }

    /// A number of a length or an angle, within bounds.
    fn size(&mut self, what: &str, low: f32, high: f32) -> Result<f32, Wrong> {
        let number: f32 = self.number(what)?;
        if (low..=high).contains(&number) {
            return Ok(number);
        }
        Err(wrong(format!("{what} is {number}"), format!("allowed: {low} to {high}")))
    }

    fn point(&mut self) -> Result<Vec3, Wrong> {
        let found = self.next("a place as x,y,z")?;
        point(found).ok_or_else(|| {
            wrong(format!("`{found}` is no place"), "write x,y,z without spaces: 0,0,12.5")
        })
    }

    /// All places that follow, at least `least`.
    fn points(&mut self, least: usize) -> Result<Vec<[f32; 3]>, Wrong> {
        let mut points = Vec::new();
        while let Some(next) = self.words.first().and_then(|word| point(word)) {
            points.push(next.to_array());
            self.words = &self.words[1..];
        }
        if points.len() < least {
            let what = format!("a line of {} places", points.len());
            return Err(wrong(what, format!("it needs {least} or more, each as x,y,z")));
        }
        Ok(points)
    }

    fn direction(&mut self) -> Result<Vec3, Wrong> {
        let direction = self.point()?;
        direction.try_normalize().ok_or_else(|| wrong("0,0,0 has no direction", "up is 0,0,1"))
    }

    fn line(mut self) -> Result<(When, Command), Wrong> {
        let when = match self.word(&["at", "every"])? {
            "at" => When::At(self.number("the number of a cycle")?),
            _ => match self.number("a number of cycles")? {
                0 => return Err(wrong("every 0 cycles", "1 or more")),
                step => When::Every(step),
            },
        };
        let command = self.command()?;
        match self.words {
            [] => Ok((when, command)),
            [extra, ..] => Err(wrong(format!("`{extra}` is too much"), "one command a line")),
        }
    }

    fn command(&mut self) -> Result<Command, Wrong> {
        match self.word(&["brush", "light", "obstacle", "bend", "prune"])? {
            "brush" => match self.word(&["add", "erase"])? {
                "add" => {
                    let solid = self.solid()?;
                    self.word(&["markers"])?;
                    let count: u32 = self.number("a number of markers")?;
                    if count > 20_000_000 {
                        return Err(wrong(format!("{count} markers"), "at most 20000000"));
                    }
                    Ok(Command::Add(solid, count))
                }
                _ => Ok(Command::Erase(self.solid()?)),
            },
            "light" => {
                let light = self.direction()?;
                if light.z < 0.1 {
                    let hint = "z must be at least a tenth of the length: light comes from above";
                    return Err(wrong("light from below", hint));
                }
                Ok(Command::Light(light))
            }
            "obstacle" => {
                let solid = self.solid()?;
                let is_opaque = !self.words.is_empty();
                if is_opaque {
                    self.word(&["opaque"])?;
                }
                Ok(Command::Obstacle(solid, is_opaque))
            }
            "bend" => {
                let place = self.point()?;
                self.word(&["toward"])?;
                let toward = self.direction()?;
                self.word(&["by"])?;
                let angle = self.size("an angle in degrees", -180.0, 180.0)?;
                Ok(Command::Bend(place, toward, angle.to_radians()))
            }
            _ => match self.word(&["near", "inside", "outside"])? {
                "near" => Ok(Command::PruneNear(self.point()?)),
                side => Ok(Command::Prune(self.solid()?, side == "inside")),
            },
        }
    }

    fn solid(&mut self) -> Result<Solid, Wrong> {
        match self.word(&["ball", "box", "cylinder", "tube", "sketch"])? {
            "ball" => {
                let center = self.point()?.to_array();
                Ok(Solid::Ball(Ball { center, radius: self.radius()? }))
            }
            "box" => {
                let (a, b) = (self.point()?, self.point()?);
                let (low, high) = (a.min(b).to_array(), a.max(b).to_array());
                Ok(Solid::Block(Block { low, high }))
            }
            "cylinder" => {
                let (from, to) = (self.point()?.to_array(), self.point()?.to_array());
                Ok(Solid::Cylinder(Cylinder { from, to, radius: self.radius()? }))
            }
            "tube" => {
                let points = self.points(2)?;
                self.word(&["radius"])?;
                self.tube(points)
            }
            // A line drawn on the view from the south: x,z.
            _ => {
                let mut points = Vec::new();
                while let Some(at) = self.words.first().and_then(|word| pair(word)) {
                    points.push([at[0], 0.0, at[1]]);
                    self.words = &self.words[1..];
                }
                if points.len() < 2 {
                    return Err(wrong("a sketch of fewer than two places", "write them as x,z"));
                }
                self.word(&["radius"])?;
                self.tube(points)
            }
        }
    }

    fn tube(&mut self, points: Vec<[f32; 3]>) -> Result<Solid, Wrong> {
        let points = Written { value: points, span: Default::default() };
        Ok(Solid::Tube(Tube { points, radius: self.radius()? }))
    }

    fn radius(&mut self) -> Result<f32, Wrong> {
        self.size("a radius", 1e-3, 1e5)
    }
}

/// Coordinates further out than this are typing mistakes, and lose digits.
const FARTHEST: f32 = 1e5;

fn coordinates<const N: usize>(text: &str) -> Option<[f32; N]> {
    let numbers: Vec<f32> = text.split(',').map(str::parse).collect::<Result<_, _>>().ok()?;
    // A number that is none compares false as well.
    let is_near = numbers.iter().all(|number| number.abs() <= FARTHEST);
    if is_near { numbers.try_into().ok() } else { None }
}

fn point(text: &str) -> Option<Vec3> {
    coordinates::<3>(text).map(Vec3::from_array)
}

fn pair(text: &str) -> Option<[f32; 2]> {
    coordinates::<2>(text)
}

/// Carries out the commands that are due before the next cycle.
pub(super) fn carry_out(garden: &mut Garden<'_>) -> Result<(), Error> {
    let due: Vec<(usize, Command)> =
        garden.script().of(garden.cycle).map(|(i, command)| (i, command.clone())).collect();
    for (number, command) in due {
        one(garden, number, command)?;
    }
    Ok(())
}

fn one(garden: &mut Garden<'_>, number: usize, command: Command) -> Result<(), Error> {
    match command {
        Command::Add(solid, count) => {
            let chance = (u64::from(garden.cycle) << 32) | number as u64;
            let seed = garden.seed_of("brush", chance);
            let places = scattered(&[solid], count, seed);
            let sight = sight(garden);
            markers(garden)?.add(places, sight);
            occupy_again(garden);
        }
        Command::Erase(solid) => {
            let sight = sight(garden);
            markers(garden)?.erase(|p| solid.contains(p), sight);
        }
        Command::Light(light) => garden.turn_light(light)?,
        Command::Obstacle(solid, is_opaque) => garden.obstruct(solid, is_opaque),
        Command::Bend(place, toward, angle) => {
            if let Some((tree, metamer)) = nearest_metamer(garden, place) {
                garden.bend(tree, metamer, toward, angle);
            }
        }
        Command::PruneNear(place) => {
            if let Some((tree, metamer)) = nearest_metamer(garden, place) {
                let mut marked = vec![false; garden.plant(tree).metamers.len()];
                marked[metamer] = true;
                cut(garden, tree, marked);
            }
        }
        Command::Prune(solid, inside) => {
            for tree in 0..garden.members.len() {
                let metamers = &garden.plant(tree).metamers;
                let marked = metamers.iter().map(|m| solid.contains(m.tip) == inside).collect();
                cut(garden, tree, marked);
            }
        }
    }
    Ok(())
}

fn sight(garden: &Garden<'_>) -> f32 {
    garden.members[0].form.markers.sight
}

fn markers<'a>(garden: &'a mut Garden<'_>) -> Result<&'a mut super::markers::MarkerSet, Error> {
    match &mut garden.environment {
        Environment::Space(markers) => Ok(markers),
        Environment::Light(_) => {
            let problem = Problem::new("a brush paints markers, but the trees compete for light");
            Err(problem.hint("set competition = \"markers\"").into())
        }
    }
}

/// Uses up the new markers around all that has grown already.
fn occupy_again(garden: &mut Garden<'_>) {
    if let Environment::Space(markers) = &mut garden.environment {
        for member in &garden.members {
            let radius = member.form.markers.occupied;
            member.plant.metamers.iter().for_each(|m| markers.occupy(m.tip, radius));
        }
    }
    garden.look_again();
}

/// Cuts marked metamers and all beyond them; what a knife takes leaves no memory in the stem,
/// which keeps the width it has.
fn cut(garden: &mut Garden<'_>, tree: usize, mut marked: Vec<bool>) {
    // The first metamer is the stump.
    if let Some(first) = marked.first_mut() {
        *first = false;
    }
    garden.members[tree].plant.gather_pipes();
    garden.fell(tree, marked);
}

/// The metamer whose internode is nearest to a place, not the stump.
fn nearest_metamer(garden: &Garden<'_>, place: Vec3) -> Option<(usize, usize)> {
    let trees = garden.members.iter().enumerate();
    let all = trees.flat_map(|(tree, member)| {
        (1..member.plant.metamers.len()).map(move |metamer| (tree, metamer))
    });
    let distance = |(tree, metamer): &(usize, usize)| {
        let plant: &Plant = garden.plant(*tree);
        volume::to_segment(place, plant.start(*metamer), plant.metamers[*metamer].tip)
    };
    all.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<Script, Problems> {
        Script::read(&Written { value: text.into(), span: Default::default() })
    }

    #[test]
    fn the_commands_of_the_manual_are_read() {
        let manual = include_str!("script.rs");
        let lines = manual.lines().filter_map(|line| line.strip_prefix("//! at "));
        let text: String = lines.map(|line| format!("at {line}\n")).collect();
        let script = read(&text).unwrap();
        assert_eq!(script.lines.len(), 8);
        assert_eq!(script.of(0).count(), 3);
        assert!(matches!(script.of(2).next(), Some((3, Command::Light(_)))));
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line_and_a_remedy() {
        for (text, words) in [
            ("at 1 brsh add ball 0,0,0 1", ["line 1", "brsh", "did you mean `brush`"]),
            ("\nat x light 0,0,1", ["line 2", "`x`", "number"]),
            ("at 1 light 0,0,-1", ["below", "tenth", "above"]),
            ("at 1 obstacle ball 0,0 3", ["0,0", "no place", "x,y,z"]),
            ("at 1 prune near 0,0,1 extra", ["extra", "too much", "one command"]),
            ("at 1 brush add ball 0,0,0 -2 markers 3", ["radius", "-2", "allowed"]),
            ("at 1 bend 0,0,1 toward 0,0,0 by 3", ["no direction", "up is", "0,0,1"]),
            ("every 0 light 0,0,1", ["every 0", "1 or more", "line 1"]),
            ("at 1 brush add tube 0,0,1 radius 1 markers 1", ["1 places", "2 or more", "x,y,z"]),
        ] {
            let problem = read(text).unwrap_err()[0].to_string();
            assert!(words.iter().all(|word| problem.contains(word)), "{text}: {problem}");
        }
    }

    #[test]
    fn every_second_cycle_is_the_first_the_third_and_so_on() {
        let script = read("every 2 light 0,0,1 # with a remark").unwrap();
        let due: Vec<u32> = (0..6).filter(|cycle| script.of(*cycle).count() > 0).collect();
        assert_eq!(due, [0, 2, 4]);
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in "[a-z0-9,.#\\- \n]{0,120}") {
            let _ = read(&text);
        }

        #[test]
        fn what_is_nearly_a_command_is_read_or_refused(
            words in proptest::collection::vec(
                prop_oneof![
                    Just("at"), Just("every"), Just("3"), Just("brush"), Just("add"), Just("ball"),
                    Just("0,0,1"), Just("2"), Just("markers"), Just("prune"), Just("near"),
                    Just("tube"), Just("radius"), Just("sketch"), Just("1,2"), Just("nan,0,0"),
                    Just("inf,1"), Just("light"), Just("toward"), Just("by"), Just("bend"),
                    Just("-1e39"), Just("outside"), Just("obstacle"), Just("opaque"), Just("box"),
                ],
                0..12,
            )
        ) {
            let text = words.join(" ");
            if let Err(problems) = read(&text) {
                prop_assert!(problems.iter().all(|problem| problem.hint.is_some()));
            }
        }
    }
}
