//! Point statistics of anyone's table: `weald analyze`.

mod functions;
pub(crate) mod plot;
mod points;
mod thinning;

use crate::error::{Error, Result};
use points::Points;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use weald_analyze::thinning::StandDensity;
use weald_analyze::{Envelope, Figure, Quadrats, Report, Statistic, Verdict};
use weald_contract::Progress;
use weald_formats::{Column, Provenance, Table};

pub use thinning::Thinning;

/// What to compute, of what.
#[derive(Clone, Debug)]
pub struct Request {
    /// A table with columns `x` and `y` in metres, the summary of a simulation, or a stand's
    /// history with columns `density` and `mean_area` or `mean_mass`.
    pub table: PathBuf,
    /// Only rows whose `species` is this.
    pub species: Option<String>,
    /// West, south, east and north side, m; without it, the extent of the points.
    pub window: Option<[f64; 4]>,
    /// Statistics by name; without any, K, L, G and pcf.
    pub statistics: Vec<String>,
    /// Largest distance, m; without it, a quarter of the window's shorter side or the distance
    /// within which a random point has 1,000 neighbours, whichever is less.
    pub radius: Option<f64>,
    /// Number of distances.
    pub steps: usize,
    /// A table whose column `r` holds the distances.
    pub radii: Option<PathBuf>,
    /// Column of types, between which cross statistics are computed.
    pub types: Option<String>,
    /// Column of marks, such as diameters.
    pub marks: Option<String>,
    /// Plants per unit of area for the inhomogeneous K: a column, or a raster's path.
    pub intensity: Option<String>,
    /// Simulations for envelopes; 0 for none.
    pub simulations: usize,
    /// Tables of points of a null model, in place of points spread at random.
    pub patterns: Vec<PathBuf>,
    /// Seed of the simulations.
    pub seed: u64,
    /// Lowest and highest density of a thinning line; without it, the plateau of cover.
    pub densities: Option<[f64; 2]>,
    /// Folder for tables and figures.
    pub output: Option<PathBuf>,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Found {
    /// Of a table of points.
    Pattern(Box<OfPattern>),
    /// Of a stand's history: a line for each species.
    Thinning {
        /// Species and its self-thinning line.
        lines: Vec<(String, Thinning)>,
        /// Tables and figures that were written.
        files: Vec<PathBuf>,
    },
}

/// What was found in a table of points.
#[derive(Clone, Debug, Serialize)]
pub struct OfPattern {
    /// The pattern in a few numbers.
    pub report: Report,
    /// Morisita's index and the variance-mean ratio, from ten by ten quadrats.
    pub quadrats: Quadrats,
    /// Reineke's density, where a column names diameters and their unit.
    pub density: Option<StandDensity>,
    /// Tests against a null model, in words and numbers.
    pub verdicts: Vec<(String, Verdict)>,
    /// What the user should know.
    pub notes: Vec<String>,
    /// Tables and figures that were written.
    pub files: Vec<PathBuf>,
}

/// Quadrats along each side for the indices in the report.
const QUADRATS: usize = 10;

/// Computes the statistics of a table.
///
/// # Errors
/// The table is damaged, has too few rows or not the columns; a value in it makes no sense, named
/// by row and column; the disk refuses; the caller asked to stop.
pub fn analyze(request: &Request, progress: &dyn Progress) -> Result<Found> {
    let statistics = statistics(&request.statistics)?;
    let mut points = Points::read(&request.table)?;
    if let Some(species) = &request.species {
        points.keep_species(species)?;
    }
    if thinning::is_history(&points.table) {
        return thinning::analyze(request, &points.table);
    }
    let pattern = points.pattern(request.window)?;
    let sizes = points.sizes();
    let refused = |error| points.refused(sizes.as_ref().map(|(column, _)| *column), error);
    let values = sizes.as_ref().map(|(_, values)| values.as_slice());
    let mut found = OfPattern {
        report: Report::of(&pattern, values).map_err(refused)?,
        quadrats: Quadrats::of(&pattern, QUADRATS, QUADRATS).map_err(refused)?,
        density: points.stand_density(pattern.window().area())?,
        verdicts: Vec::new(),
        notes: points.notes(),
        files: Vec::new(),
    };
    let work = functions::Work { request, points: &points, pattern: &pattern, progress };
    work.run(&statistics, &mut found)?;
    Ok(Found::Pattern(Box::new(found)))
}

/// The statistics of these names; the four that all know, if there are none.
fn statistics(names: &[String]) -> Result<Vec<Statistic>> {
    if names.is_empty() {
        return Ok(vec![Statistic::K, Statistic::L, Statistic::G, Statistic::Pcf]);
    }
    let known = Statistic::ALL.map(Statistic::word).join(", ");
    let named = |name: &String| {
        Statistic::ALL.into_iter().find(|known| known.word() == name).ok_or_else(|| {
            Error::plain(format!("no statistic is called `{name}`"), format!("there are: {known}"))
        })
    };
    names.iter().map(named).collect()
}

/// Where tables and figures go, and the story that they carry.
struct Output<'a> {
    folder: &'a Path,
    story: Provenance,
    files: Vec<PathBuf>,
}

impl<'a> Output<'a> {
    fn new(folder: &'a Path, request: &Request) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|error| Error::system(folder, error))?;
        Ok(Self { folder, story: story(request)?, files: Vec::new() })
    }

    fn table(&mut self, name: &str, table: &weald_analyze::Table) -> Result<()> {
        let columns = table.columns.iter();
        let columns =
            columns.map(|(name, values)| (name.to_string(), Column::Float(values.clone())));
        let path = self.folder.join(format!("{name}.csv"));
        weald_formats::write_table(&path, &Table { columns: columns.collect() }, &self.story)?;
        self.files.push(path);
        Ok(())
    }

    /// Writes a figure as SVG and as PNG.
    fn figure(&mut self, name: &str, figure: &Figure) -> Result<()> {
        let path = self.folder.join(format!("{name}.svg"));
        let text = figure.svg();
        weald_formats::write_atomically(&path, |file| {
            Ok(std::io::Write::write_all(file, text.as_bytes())?)
        })?;
        self.files.push(path);
        let sketch = plot::draw(figure);
        let path = self.folder.join(format!("{name}.png"));
        weald_formats::write_png(&path, sketch.width, sketch.height, &sketch.rgb, &self.story)?;
        self.files.push(path);
        Ok(())
    }

    fn envelope(&mut self, name: &str, envelope: &Envelope) -> Result<()> {
        let name = format!("{name}.envelope");
        self.table(&name, &envelope.table())?;
        self.figure(&name, &Figure::of_envelope(envelope))
    }
}

fn story(request: &Request) -> Result<Provenance> {
    let mut inputs = vec![crate::make::parent(&request.table)?];
    // A raster of densities, unless a column is meant.
    let raster = request.intensity.as_ref().map(PathBuf::from).filter(|path| path.is_file());
    for path in request.radii.iter().chain(&request.patterns).chain(&raster) {
        inputs.push(crate::make::parent(path)?);
    }
    Ok(Provenance {
        stage: "analyze".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: 2,
        parameters: serde_json::json!({
            "species": request.species, "window": request.window,
            "statistics": request.statistics, "radius": request.radius, "steps": request.steps,
            "types": request.types, "marks": request.marks, "intensity": request.intensity,
            "simulations": request.simulations, "densities": request.densities,
        }),
        seed: request.seed,
        inputs,
    })
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Found::Pattern(found) => found.fmt(f),
            Found::Thinning { lines, files } => {
                thinning::write_lines(f, lines)?;
                files.iter().try_for_each(|file| writeln!(f, "wrote {}", file.display()))
            }
        }
    }
}

impl fmt::Display for OfPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.report)?;
        writeln!(f, "Morisita (10 x 10)    {:.4}", self.quadrats.morisita)?;
        writeln!(f, "variance / mean       {:.4}", self.quadrats.variance_mean_ratio)?;
        if let Some(density) = &self.density {
            writeln!(f, "stems per hectare     {:.1}", density.stems_per_hectare)?;
            writeln!(f, "quadratic mean dbh    {:.2} cm", density.quadratic_mean_cm)?;
            writeln!(f, "basal area            {:.2} m2/ha", density.basal_area)?;
            writeln!(f, "Reineke SDI           {:.1}", density.index)?;
        }
        self.verdicts.iter().try_for_each(|(words, _)| writeln!(f, "{words}"))?;
        self.notes.iter().try_for_each(|note| writeln!(f, "note: {note}"))?;
        self.files.iter().try_for_each(|file| writeln!(f, "wrote {}", file.display()))
    }
}
