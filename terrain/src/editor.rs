//! A terrain that is being edited: changes, undoing them, and looking at a part.
//!
//! A state is a whole configuration, so undo and redo only choose another one; what they need has
//! mostly been computed before. Operators are found again by what they are and by the ground they
//! meet, and evaluation starts at the first one that is new.

use crate::config::Config;
use crate::import::{self, Ground};
use crate::lattice::Lattice;
use crate::mask::Map;
use crate::resample::by_row;
use crate::stack::{self, Cache, Shaped};
use crate::{Error, Parts, check_cancelled};
use std::collections::BTreeMap;
use weald_contract::{Frame, Grid, Image, Layers, Problem, Progress, Raster, Seed, View};

/// A terrain with its history.
pub struct Editor {
    elevation: Raster,
    images: BTreeMap<String, Image>,
    views: Vec<View>,
    seed: Seed,
    /// States, oldest first.
    history: Vec<Config>,
    current: usize,
    /// The ground before the first operator, with the state it was made for.
    ground: Option<(Config, Ground)>,
    cache: Cache,
}

impl Editor {
    /// Opens a terrain. `limit` bounds the bytes of results that are kept.
    ///
    /// # Errors
    /// The first thing that [`Config::check`] finds.
    pub fn new(
        config: Config,
        elevation: Raster,
        images: BTreeMap<String, Image>,
        views: Vec<View>,
        seed: Seed,
        limit: usize,
    ) -> Result<Self, Problem> {
        let cache = Cache::new(limit);
        check(&config, &views)?;
        let history = vec![config];
        let (current, ground) = (0, None);
        Ok(Self { elevation, images, views, seed, history, current, ground, cache })
    }

    /// The state that counts.
    pub fn config(&self) -> &Config {
        &self.history[self.current]
    }

    /// Makes another state the current one; what was undone is forgotten.
    ///
    /// # Errors
    /// The first thing that [`Config::check`] finds; the state stays as it was.
    pub fn apply(&mut self, config: Config) -> Result<(), Problem> {
        check(&config, &self.views)?;
        self.history.truncate(self.current + 1);
        self.history.push(config);
        self.current += 1;
        Ok(())
    }

    /// Goes back to the state before; whether there was one.
    pub fn undo(&mut self) -> bool {
        let is_possible = self.current > 0;
        self.current -= usize::from(is_possible);
        is_possible
    }

    /// Takes back the last undo; whether there was one.
    pub fn redo(&mut self) -> bool {
        let is_possible = self.current + 1 < self.history.len();
        self.current += usize::from(is_possible);
        is_possible
    }

    /// Replaces the images that masks and layers read: they were painted on.
    pub fn set_images(&mut self, images: BTreeMap<String, Image>) {
        self.images = images;
        self.cache.clear();
    }

    /// Number of operators whose results are kept.
    pub fn kept_steps(&self) -> usize {
        self.cache.len()
    }

    /// The ground after the last operator, without water.
    ///
    /// # Errors
    /// As [`crate::build`].
    pub fn altitude(&mut self, progress: &dyn Progress) -> Result<Grid, Error> {
        let config = &self.history[self.current];
        let ground =
            prepared(&mut self.ground, &mut self.cache, config, &self.elevation, progress)?;
        let map = Map { frame: ground.frame, images: &self.images };
        let shaped = stack::shape(config, ground, &map, self.seed, &mut self.cache, progress)?;
        Ok(Grid { frame: ground.frame, values: shaped.altitude })
    }

    /// The ground of a rectangle (west, south, east, north in scene coordinates, m), with the bytes
    /// that [`Self::altitude`] gives there; `None` where it holds no cell.
    ///
    /// # Errors
    /// As [`crate::build`].
    pub fn region(
        &mut self,
        rectangle: [f64; 4],
        progress: &dyn Progress,
    ) -> Result<Option<Grid>, Error> {
        let config = &self.history[self.current];
        let ground =
            prepared(&mut self.ground, &mut self.cache, config, &self.elevation, progress)?;
        let Some(part) = part(&ground.frame, rectangle) else { return Ok(None) };
        let map = Map { frame: ground.frame, images: &self.images };
        let cache = &mut self.cache;
        let values = stack::shape_part(config, ground, &map, self.seed, &part, cache, progress)?;
        let frame = part.frame((ground.frame.west, ground.frame.south));
        Ok(Some(Grid { frame, values }))
    }

    /// All layers, with the bytes that [`crate::build`] gives.
    ///
    /// # Errors
    /// As [`crate::build`].
    pub fn layers(&mut self, progress: &dyn Progress) -> Result<Layers, Error> {
        let config = &self.history[self.current];
        let ground =
            prepared(&mut self.ground, &mut self.cache, config, &self.elevation, progress)?;
        let (crs, images, views) = (&self.elevation.crs, &self.images, &self.views);
        let parts = Parts { ground, crs, images, views, seed: self.seed };
        parts.layers(config, &mut self.cache, progress)
    }

    /// All layers for a view that waits: `show` gets them on cells [`COARSE`] times as wide first,
    /// without patches, and then as [`Self::layers`] gives them.
    ///
    /// The ground is shaped once, on its own cells; water and light, which cost most, run on its
    /// means first. A terrain that has too few cells for that is shown once, and so is one with a
    /// lake whose hollow the coarse ground lost.
    ///
    /// # Errors
    /// As [`crate::build`]; [`Error::Cancelled`] as soon as `progress` says so, between the two as
    /// well as within them.
    pub fn layers_in_steps(
        &mut self,
        show: &mut dyn FnMut(Layers),
        progress: &dyn Progress,
    ) -> Result<(), Error> {
        let config = &self.history[self.current];
        let ground =
            prepared(&mut self.ground, &mut self.cache, config, &self.elevation, progress)?;
        let (crs, images, views) = (&self.elevation.crs, &self.images, &self.views);
        let parts = Parts { ground, crs, images, views, seed: self.seed };
        let shaped = parts.shape(config, &mut self.cache, progress)?;
        if let Some((ground, shaped)) = coarse(ground, &shaped) {
            let plain = Config { detail: Vec::new(), ..config.clone() };
            match parts.settle(&plain, &ground, &shaped, progress) {
                Ok(layers) => show(layers),
                Err(Error::Cancelled) => return Err(Error::Cancelled),
                // The fine ground has the last word.
                Err(Error::Problem(_)) => {}
            }
        }
        check_cancelled(progress)?;
        show(parts.settle(config, ground, &shaped, progress)?);
        Ok(())
    }
}

/// Width of a cell of the first, coarse look at water, in cells of the terrain.
pub const COARSE: usize = 4;

/// Fewest coarse cells along a side that show anything.
const FEWEST: usize = 8;

/// The shaped ground in means over squares of [`COARSE`] cells; cells left over in the north and
/// east fall away.
fn coarse<'a>(ground: &Ground, shaped: &Shaped<'a>) -> Option<(Ground, Shaped<'a>)> {
    let whole = &shaped.lattice;
    let (width, height) = (whole.width / COARSE, whole.height / COARSE);
    if width < FEWEST || height < FEWEST {
        return None;
    }
    let lattice = Lattice { west: 0, south: 0, width, height, cell: whole.cell * COARSE as f64 };
    // Rows run from the north, where the rest falls away.
    let first = whole.height - height * COARSE;
    let altitude = by_row(width, height, |row, out| {
        for (column, mean) in out.iter_mut().enumerate() {
            let rows = (0..COARSE).map(|k| (first + row * COARSE + k) * whole.width);
            let sum = |row: usize| -> f32 {
                shaped.altitude[row + column * COARSE..][..COARSE].iter().sum()
            };
            *mean = rows.map(sum).sum::<f32>() / (COARSE * COARSE) as f32;
        }
    });
    let frame = lattice.frame((ground.frame.west, ground.frame.south));
    let (mended, holes) = (ground.mended, ground.holes.clone());
    let ground = Ground { frame, altitude: Vec::new(), source: None, mended, holes };
    let (lakes, layers) = (shaped.lakes.clone(), shaped.layers.clone());
    Some((ground, Shaped { lattice, altitude, lakes, layers }))
}

/// The ground before the first operator: the one at hand if it lies on the state's cells, else a
/// new one, for which nothing that is kept holds.
fn prepared<'a>(
    at_hand: &'a mut Option<(Config, Ground)>,
    cache: &mut Cache,
    config: &Config,
    elevation: &Raster,
    progress: &dyn Progress,
) -> Result<&'a Ground, Error> {
    let fits = |made_for: &Config| {
        made_for.cell == config.cell
            && made_for.crop == config.crop
            && made_for.source_holes == config.source_holes
    };
    let made = match at_hand.take() {
        Some((made_for, ground)) if fits(&made_for) => (made_for, ground),
        _ => {
            cache.clear();
            (config.clone(), import::ground(config, elevation, progress)?)
        }
    };
    Ok(&at_hand.insert(made).1)
}

fn check(config: &Config, views: &[View]) -> Result<(), Problem> {
    config.check(views).into_iter().next().map_or(Ok(()), Err)
}

/// The cells that touch a rectangle.
fn part(frame: &Frame, [west, south, east, north]: [f64; 4]) -> Option<Lattice> {
    let whole = Lattice::of(frame);
    let range = |low: f64, high: f64, count: usize| {
        let low = (low / whole.cell).floor().clamp(0.0, count as f64) as usize;
        let high = (high / whole.cell).ceil().clamp(0.0, count as f64) as usize;
        (high > low).then(|| (low, high - low))
    };
    let (west, width) = range(west, east, whole.width)?;
    let (south, height) = range(south, north, whole.height)?;
    Some(Lattice { west, south, width, height, ..whole })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use weald_contract::{Crs, FromToml, Silent, Value};

    const FRAME: Frame = Frame { width: 48, height: 40, cell: 1.0, west: 500.0, south: 70.0 };

    /// Operators of every kind, to be put together at random.
    const OPERATORS: [&str; 11] = [
        "op = \"noise\"\nname = \"hills\"\namplitude = 2\nwavelength = 15",
        "op = \"smooth\"\nradius = 1.2\nmask = { slope_deg = [2, 90], falloff = 3 }",
        "op = \"stream\"\npoints = [[5, 30], [20, 18], [40, 10]]\nwidth = 2\ndepth = 1",
        "op = \"terrace\"\nstep = 2\nstrength = 0.5",
        "op = \"erode\"\nyears = 2000\nsteps = 2",
        "op = \"hill\"\nat = [20, 20]\nradius = 8\nheight = 3",
        "op = \"flatten\"\naltitude = 101\nmask = { upslope_area = [9, 1e6] }",
        "op = \"translate\"\nby = [2.5, -1]",
        "op = \"noise\"\namplitude = 1\nwavelength = 9",
        "op = \"breach\"",
        "op = \"road\"\npoints = [[4, 4], [30, 20]]\nwidth = 2\nfalloff = 2",
    ];

    fn raster() -> Raster {
        let z = |x: f64, y: f64| (100.0 + 0.1 * (x - 500.0) + libm::sin(0.3 * y)) as f32;
        Raster { grid: Grid::from_fn(FRAME, z), crs: Crs::default() }
    }

    fn config(operators: &[usize]) -> Config {
        let ops: String = operators
            .iter()
            .map(|i| format!("\n[[op]]\n{}", OPERATORS[i % OPERATORS.len()]))
            .collect();
        let value = Value::parse(0, &format!("source = \"d\"{ops}")).unwrap();
        Config::from_toml(&value, &mut Vec::new()).unwrap()
    }

    fn editor(operators: &[usize]) -> Editor {
        Editor::new(config(operators), raster(), BTreeMap::new(), vec![], Seed(5), 1 << 24).unwrap()
    }

    fn cold(config: &Config) -> Layers {
        crate::build(config, &raster(), &BTreeMap::new(), &[], Seed(5), &Silent).unwrap()
    }

    /// Two lists that may share a name are refused; the tests take each operator once.
    fn once(mut operators: Vec<usize>) -> Vec<usize> {
        let mut seen = [false; OPERATORS.len()];
        operators.retain(|&i| !std::mem::replace(&mut seen[i], true));
        operators
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn any_walk_through_the_history_gives_the_bytes_of_a_cold_build(
            lists in prop::collection::vec(prop::collection::vec(0usize..OPERATORS.len(), 0..6), 1..5),
            moves in prop::collection::vec(0u8..3, 1..8),
            corner in (0.0f64..40.0, 0.0f64..30.0),
        ) {
            let mut lists = lists.into_iter().map(once);
            let mut editor = editor(&lists.next().unwrap_or_default());
            for step in moves {
                match step {
                    0 => { editor.undo(); }
                    1 => { editor.redo(); }
                    _ => if let Some(list) = lists.next() {
                        editor.apply(config(&list)).unwrap();
                    },
                }
                // The part first, so that it may not lean on the whole.
                let (west, south) = corner;
                let rectangle = [west, south, west + 11.0, south + 9.5];
                let region = editor.region(rectangle, &Silent).unwrap().unwrap();
                let expected = cold(editor.config());
                let altitude = editor.altitude(&Silent).unwrap();
                prop_assert_eq!(&altitude.values[..], expected.values("altitude").unwrap());
                let Frame { width, height, .. } = region.frame;
                for (column, row) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                    let (x, y) = region.frame.center(column, row);
                    let value = region.values[region.frame.index(column, row)];
                    prop_assert_eq!(Some(value), altitude.nearest(x, y));
                }
                prop_assert_eq!(editor.layers(&Silent).unwrap(), expected);
            }
        }
    }

    #[test]
    fn only_what_follows_the_first_change_is_computed_again_and_undo_is_free() {
        let mut editor = editor(&[0, 1, 3]);
        editor.altitude(&Silent).unwrap();
        assert_eq!(editor.kept_steps(), 3);
        editor.apply(config(&[0, 1, 5])).unwrap();
        editor.altitude(&Silent).unwrap();
        assert_eq!(editor.kept_steps(), 4, "one operator was new");
        assert!(editor.undo() && !editor.undo());
        editor.altitude(&Silent).unwrap();
        assert!(editor.redo() && !editor.redo());
        editor.layers(&Silent).unwrap();
        assert_eq!(editor.kept_steps(), 4, "nothing was new");
    }

    #[test]
    fn layers_are_shown_coarse_first_and_then_as_they_are() {
        let mut editor = editor(&[0, 5]);
        let mut shown = Vec::new();
        editor.layers_in_steps(&mut |layers| shown.push(layers), &Silent).unwrap();
        let [first, last] = shown.as_slice() else { panic!("{} looks", shown.len()) };
        assert_eq!(*last, cold(editor.config()));
        let Frame { width, height, cell, west, south } = first.frame;
        assert_eq!((width, height, cell, west, south), (12, 10, 4.0, FRAME.west, FRAME.south));
        // A mean of 4 x 4 cells about each coarse one.
        let (coarse, fine) = (first.values("altitude").unwrap(), last.values("altitude").unwrap());
        let mean: f32 = (0..4).flat_map(|row| &fine[row * 48 + 44..][..4]).sum::<f32>() / 16.0;
        assert!((coarse[11] - mean).abs() < 1e-4);
        assert_eq!(first.layers.keys().collect::<Vec<_>>(), last.layers.keys().collect::<Vec<_>>());
    }

    #[test]
    fn what_is_no_longer_wanted_stops_after_the_first_look() {
        struct Once(std::sync::atomic::AtomicBool);
        impl Progress for Once {
            fn begin(&self, _: &str, _: u64, _: &str) {}
            fn advance(&self, _: u64) {}
            fn is_cancelled(&self) -> bool {
                self.0.load(std::sync::atomic::Ordering::Relaxed)
            }
        }
        let (mut editor, stop) = (editor(&[0]), Once(false.into()));
        let mut looks = 0;
        let mut show = |_| {
            looks += 1;
            stop.0.store(true, std::sync::atomic::Ordering::Relaxed);
        };
        let stopped = editor.layers_in_steps(&mut show, &stop);
        assert!(matches!(stopped, Err(Error::Cancelled)));
        assert_eq!(looks, 1);
    }

    #[test]
    fn a_state_that_cannot_be_is_refused_and_nothing_changes() {
        let mut editor = editor(&[0]);
        let mut wrong = config(&[0]);
        wrong.op.push(wrong.op[0].clone());
        assert!(editor.apply(wrong).unwrap_err().to_string().contains("named `hills`"));
        assert_eq!(editor.config(), &config(&[0]));
    }

    #[test]
    fn memory_that_does_not_suffice_only_costs_time() {
        let tight = 48 * 40 * 4 * 2;
        let list = [0, 1, 3, 5];
        let mut editor =
            Editor::new(config(&list), raster(), BTreeMap::new(), vec![], Seed(5), tight).unwrap();
        let first = editor.altitude(&Silent).unwrap();
        assert!(editor.kept_steps() <= 2);
        assert_eq!(editor.altitude(&Silent).unwrap(), first);
        assert_eq!(first.values, cold(editor.config()).values("altitude").unwrap());
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_one_edit() {
        for side in [1024, 4096] {
            let frame = Frame { width: side, height: side, ..FRAME };
            let grid = Grid { frame, values: crate::flow::rough_hills(side) };
            let raster = Raster { grid, crs: Crs::default() };
            let mut editor =
                Editor::new(config(&[0, 1, 3]), raster, BTreeMap::new(), vec![], Seed(5), 1 << 30)
                    .unwrap();
            editor.altitude(&Silent).unwrap();
            editor.apply(config(&[0, 1, 5])).unwrap();
            let start = std::time::Instant::now();
            editor.region([100.0, 100.0, 356.0, 356.0], &Silent).unwrap();
            let part = start.elapsed().as_secs_f64();
            editor.altitude(&Silent).unwrap();
            let whole = start.elapsed().as_secs_f64();
            let mut looks = Vec::new();
            let mut show = |_| looks.push(start.elapsed().as_secs_f64() - whole);
            editor.layers_in_steps(&mut show, &Silent).unwrap();
            println!(
                "{side}²: part {part:.3} s, whole {whole:.3} s; water coarse {:.3} s, fine {:.3} s",
                looks[0], looks[1]
            );
        }
    }
}
