//! Functions of distance: tables, figures and verdicts of one pattern.

use super::points::Points;
use super::{OfPattern, Output, Request};
use crate::error::{Error, Result};
use std::path::Path;
use weald_analyze::envelope::{of_labels, of_marks, of_patterns, of_randomness};
use weald_analyze::nearest::{continuous_g_table, cross_g_table};
use weald_analyze::ripley::{cross_k_table, cross_l_table, cross_pcf_table, inhomogeneous_k_table};
use weald_analyze::{Envelope, Figure, Pattern, Statistic, Table, mark_correlation, statistics};
use weald_contract::{Progress, Seed};

/// What is computed, of what.
pub struct Work<'a> {
    pub request: &'a Request,
    pub points: &'a Points,
    pub pattern: &'a Pattern,
    pub progress: &'a dyn Progress,
}

/// Expected neighbours of a random point within the default largest radius, as in spatstat: more
/// take long and tell nothing new.
const NEIGHBOURS: f64 = 1000.0;

impl Work<'_> {
    /// Computes and writes all that was asked for.
    ///
    /// Without a folder only verdicts are computed, and only if simulations were asked for.
    pub fn run(&self, wanted: &[Statistic], found: &mut OfPattern) -> Result<()> {
        let radii = self.radii()?;
        let mut output = match &self.request.output {
            Some(folder) => Some(Output::new(folder, self.request)?),
            None => None,
        };
        if let Some(output) = &mut output {
            self.univariate(wanted, &radii, output)?;
        }
        let mut write = |name: &str, envelope: Envelope| {
            if let Some(output) = &mut output {
                output.envelope(name, &envelope)?;
            }
            found.verdicts.push((envelope.to_string(), envelope.verdict));
            Ok(())
        };
        self.envelopes(wanted, &radii, &mut write)?;
        if let Some(column) = &self.request.marks {
            self.marks(column, &radii, &mut output, found)?;
        }
        if let Some(column) = &self.request.types {
            self.types(column, wanted, &radii, &mut output, found)?;
        }
        found.files = output.map(|output| output.files).unwrap_or_default();
        Ok(())
    }

    /// The distances: of a file, or even ones from 0.
    fn radii(&self) -> Result<Vec<f64>> {
        if let Some(path) = &self.request.radii {
            return Points::read(path)?.radii();
        }
        if let Some(radius) =
            self.request.radius.filter(|radius| !(radius.is_finite() && *radius > 0.0))
        {
            return Err(Error::plain(
                format!("the largest distance is {radius} m"),
                "a positive length is right",
            ));
        }
        let window = self.pattern.window();
        let quarter = window.width().min(window.height()) / 4.0;
        let crowded = (NEIGHBOURS / (std::f64::consts::PI * self.pattern.intensity())).sqrt();
        let radius = self.request.radius.unwrap_or(quarter.min(crowded));
        let last = self.request.steps.max(2) - 1;
        Ok((0..=last).map(|step| radius * step as f64 / last as f64).collect())
    }

    fn univariate(
        &self,
        wanted: &[Statistic],
        radii: &[f64],
        output: &mut Output<'_>,
    ) -> Result<()> {
        let refused = |error| self.points.refused(None, error);
        for table in statistics(self.pattern, wanted, radii).map_err(refused)? {
            write(output, table.name, &table)?;
        }
        if wanted.contains(&Statistic::G) {
            let table = continuous_g_table(self.pattern, radii).map_err(refused)?;
            output.table(table.name, &table)?;
        }
        if let Some(intensity) = &self.request.intensity {
            let column = Some(intensity.as_str());
            let values = self.intensity(intensity)?;
            let table = inhomogeneous_k_table(self.pattern, &values, radii);
            let table = table.map_err(|error| self.points.refused(column, error))?;
            write(output, table.name, &table)?;
        }
        Ok(())
    }

    /// Intensity at each point: from a column of this name, else from a raster.
    fn intensity(&self, named: &str) -> Result<Vec<f64>> {
        let path = Path::new(named);
        if self.points.table.column(named).is_some() || !path.is_file() {
            return self.points.numbers(named);
        }
        let grid = weald_formats::read_raster(path)?.grid;
        let at = |point: &[f64; 2]| f64::from(grid.sample(point[0], point[1]));
        Ok(self.pattern.points().iter().map(at).collect())
    }

    /// Envelopes under points spread at random, or over given patterns.
    fn envelopes(
        &self,
        wanted: &[Statistic],
        radii: &[f64],
        write: &mut dyn FnMut(&str, Envelope) -> Result<()>,
    ) -> Result<()> {
        let given = self.given_patterns()?;
        let simulations = self.request.simulations;
        if given.is_empty() && simulations == 0 {
            return Ok(());
        }
        for statistic in wanted {
            let envelope = match given.as_slice() {
                [] => of_randomness(
                    self.pattern,
                    *statistic,
                    radii,
                    simulations,
                    self.seed(statistic.word()),
                    self.progress,
                ),
                given => of_patterns(self.pattern, *statistic, radii, given, self.progress),
            };
            let envelope = envelope.map_err(|error| self.points.refused(None, error))?;
            write(statistic.word(), envelope)?;
        }
        Ok(())
    }

    fn seed(&self, name: &str) -> Seed {
        Seed(self.request.seed).part(name, 0)
    }

    /// The patterns of the null model, in the window of the observed one.
    fn given_patterns(&self) -> Result<Vec<Pattern>> {
        let window = self.pattern.window();
        let sides = [window.x[0], window.y[0], window.x[1], window.y[1]];
        let read = |path: &std::path::PathBuf| {
            let mut points = Points::read(path)?;
            if let Some(species) = &self.request.species {
                points.keep_species(species)?;
            }
            points.pattern(Some(sides))
        };
        self.request.patterns.iter().map(read).collect()
    }

    fn marks(
        &self,
        column: &str,
        radii: &[f64],
        output: &mut Option<Output<'_>>,
        found: &mut OfPattern,
    ) -> Result<()> {
        let marks = self.points.numbers(column)?;
        let refused = |error| self.points.refused(Some(column), error);
        if let Some(output) = output {
            let table = mark_correlation(self.pattern, &marks, radii).map_err(refused)?;
            write(output, table.name, &table)?;
        }
        if self.request.simulations > 0 {
            let (simulations, seed) = (self.request.simulations, self.seed("markcorr"));
            let envelope = of_marks(self.pattern, &marks, radii, simulations, seed, self.progress)
                .map_err(refused)?;
            if let Some(output) = output {
                output.envelope("markcorr", &envelope)?;
            }
            found.verdicts.push((envelope.to_string(), envelope.verdict));
        }
        Ok(())
    }

    /// Statistics from each type to each other one, as `K.pine-birch.csv`.
    fn types(
        &self,
        column: &str,
        wanted: &[Statistic],
        radii: &[f64],
        output: &mut Option<Output<'_>>,
        found: &mut OfPattern,
    ) -> Result<()> {
        let types = self.points.types(column, self.pattern)?;
        let words = file_words(&types)?;
        for ((from_name, from), from_word) in types.iter().zip(&words) {
            for ((to_name, to), to_word) in types.iter().zip(&words) {
                if from_name == to_name {
                    continue;
                }
                let stem =
                    |statistic: &Statistic| format!("{}.{from_word}-{to_word}", statistic.word());
                for statistic in wanted {
                    let Some(table) = self.cross(*statistic, from, to, radii)? else { continue };
                    if let Some(output) = output {
                        write(output, &stem(statistic), &table)?;
                    }
                }
                // Dealing types out tests both directions at once.
                let by_labels = [Statistic::K, Statistic::L, Statistic::Pcf];
                let tested = wanted.iter().filter(|statistic| by_labels.contains(statistic));
                if self.request.simulations == 0 || from_name > to_name {
                    continue;
                }
                for statistic in tested {
                    let name = stem(statistic);
                    let (simulations, seed) = (self.request.simulations, self.seed(&name));
                    let pair = [from, to];
                    let envelope =
                        of_labels(pair, *statistic, radii, simulations, seed, self.progress)
                            .map_err(|error| self.points.refused(None, error))?;
                    if let Some(output) = output {
                        output.envelope(&name, &envelope)?;
                    }
                    let words = format!("{from_name} and {to_name}, {envelope}");
                    found.verdicts.push((words, envelope.verdict));
                }
            }
        }
        Ok(())
    }

    /// The table of a statistic from one type to another, if it has such a form.
    fn cross(
        &self,
        statistic: Statistic,
        from: &Pattern,
        to: &Pattern,
        radii: &[f64],
    ) -> Result<Option<Table>> {
        let table = match statistic {
            Statistic::K => cross_k_table(from, to, radii),
            Statistic::L => cross_l_table(from, to, radii),
            Statistic::G => cross_g_table(from, to, radii),
            Statistic::Pcf => cross_pcf_table(from, to, radii),
            // F of a type is that of its own points.
            Statistic::F | Statistic::J => return Ok(None),
        };
        table.map(Some).map_err(|error| self.points.refused(None, error))
    }
}

fn write(output: &mut Output<'_>, name: &str, table: &Table) -> Result<()> {
    output.table(name, table)?;
    output.figure(name, &Figure::of_table(name, table))
}

/// Names of types as parts of file names; what may trouble a file system becomes `_`.
fn file_words(types: &[(String, Pattern)]) -> Result<Vec<String>> {
    let letter = |c: char| if c.is_alphanumeric() || c == '_' { c } else { '_' };
    let words: Vec<String> =
        types.iter().map(|(name, _)| name.chars().map(letter).collect()).collect();
    let mut sorted = words.clone();
    sorted.sort_unstable();
    match sorted.array_windows().find(|[a, b]| a == b) {
        None => Ok(words),
        Some([word, _]) => Err(Error::plain(
            format!("two types would both write files called `{word}`"),
            "types must differ in letters or digits",
        )),
    }
}
