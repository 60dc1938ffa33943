//! Whole terrains, from a table and an elevation model to layers.

use std::collections::BTreeMap;
use weald_contract::{
    Crs, Frame, FromToml, Grid, Layers, Problem, Raster, Seed, Silent, Value, View,
};
use weald_terrain::{Config, Error, build};

const FRAME: Frame =
    Frame { width: 120, height: 100, cell: 1.0, west: 429_252.313, south: 5_150_485.425 };

/// A round bowl of radius 30 m and depth 4.5 m at (50, 60), in ground that falls 2 % to the east.
fn bowl(x: f64, y: f64) -> f32 {
    let (dx, dy) = (x - FRAME.west - 50.0, y - FRAME.south - 60.0);
    let depth = (4.5 - 0.005 * (dx * dx + dy * dy)).max(0.0);
    (100.0 - 0.02 * (x - FRAME.west) - depth) as f32
}

fn raster() -> Raster {
    Raster { grid: Grid::from_fn(FRAME, bowl), crs: Crs::default() }
}

fn config(text: &str) -> Config {
    let mut problems = Vec::new();
    let value = Value::parse(0, text).unwrap();
    let config = Config::from_toml(&value, &mut problems);
    assert_eq!(problems, []);
    config.unwrap()
}

fn view() -> View {
    let text = "name = \"bank\"\nstand_at = [70, 40]\nlook_at = [50, 60]";
    View::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
}

fn terrain(text: &str) -> Result<Layers, Error> {
    build(&config(text), &raster(), &BTreeMap::new(), &[view()], Seed(7), &Silent)
}

/// What is wrong, and the token it points at.
fn problem(text: &str, raster: &Raster) -> (String, String) {
    match build(&config(text), raster, &BTreeMap::new(), &[view()], Seed(7), &Silent) {
        Err(Error::Problem(problem)) => (token(text, &problem), problem.to_string()),
        other => panic!("expected a problem, found {:?}", other.map(|layers| layers.frame)),
    }
}

fn token(text: &str, problem: &Problem) -> String {
    let span = problem.span.unwrap();
    text[span.start as usize..span.end as usize].to_string()
}

const SCENE: &str = r#"
    source = "dem.tif"
    [[op]]
    op = "noise"
    amplitude = 0.3
    wavelength = 12
    mask = { slope_deg = [2, 90], falloff = 2 }
    [[op]]
    op = "smooth"
    radius = 0.8
    mask = { slope_deg = [0, 10], falloff = 5, disc = { at = [50, 60], radius = 40 }, feather = 9 }
    [[op]]
    op = "stream"
    points = [[10, 20], [30, 40], [47, 57]]
    width = 1
    depth = 0.3
    falloff = 1.5
    water_depth = 0.1
    [[op]]
    op = "lake"
    at = [50, 60]
    level = 96.2
    [[detail]]
    view = "bank"
    cell = 0.25
    radius = 20
"#;

#[test]
fn one_and_two_threads_give_the_same_bytes() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| terrain(SCENE).unwrap())
    };
    let (one, two) = (on(1), on(2));
    let bits = |layers: &Layers| -> Vec<Vec<u32>> {
        let all = layers.layers.values().chain(layers.detail[0].layers.values());
        all.map(|layer| layer.values.iter().map(|v| v.to_bits()).collect()).collect()
    };
    assert_eq!(one.detail.len(), 1);
    assert_eq!(bits(&one), bits(&two));
}

#[test]
fn every_layer_is_there_finite_and_described_on_every_grid() {
    let layers = terrain(SCENE).unwrap();
    let names = [
        "altitude",
        "aspect",
        "filled",
        "slope",
        "soil_moisture",
        "upslope_area",
        "water_depth",
        "wetness",
    ];
    for grid in [&layers, &layers.detail[0]] {
        assert_eq!(grid.layers.keys().collect::<Vec<_>>(), names);
        for (name, layer) in &grid.layers {
            assert!(layer.values.iter().all(|v| v.is_finite()), "{name}");
            assert!(!layer.unit.is_empty() && layer.definition.len() > 20, "{name}");
        }
        let moisture = grid.values("soil_moisture").unwrap();
        let depth = grid.values("water_depth").unwrap();
        assert!(moisture.iter().all(|m| (0.0..=1.0).contains(m)));
        assert!(depth.iter().zip(moisture).all(|(d, m)| *d == 0.0 || *m == 1.0));
        let (z, filled) = (grid.values("altitude").unwrap(), grid.values("filled").unwrap());
        assert!(layers.detail[0].frame == grid.frame || z.iter().zip(filled).all(|(z, f)| f >= z));
    }
}

#[test]
fn a_lake_in_a_paraboloid_has_the_volume_of_the_cap() {
    let text = "source = \"d\"\n[[op]]\nop = \"scale\"\nfactor = 1\n[[op]]\nop = \"lake\"\n\
                at = [50, 60]\nlevel = 97.0\n[[detail]]\nview = \"bank\"\nradius = 12";
    let layers = terrain(text).unwrap();
    let sum = |layers: &Layers| {
        let depth = layers.values("water_depth").unwrap();
        depth.iter().map(|d| f64::from(*d)).sum::<f64>() * layers.frame.cell_area()
    };
    // z = 94.5 + 0.005 r² - 0.02 (x - 50): a paraboloid about x = 52 with its floor at 94.48, so
    // the water at 97 has the depth h = 2.52 and the volume π h² / (2 · 0.005).
    let h: f64 = 97.0 - 94.48;
    let exact = std::f64::consts::PI * h * h / (2.0 * 0.005);
    assert!((sum(&layers) / exact - 1.0).abs() < 1e-3, "{} {exact}", sum(&layers));
    // The shore is found on the fine ground: inside the patch the same depth, to interpolation.
    let patch = &layers.detail[0];
    for (x, y) in [(62.3, 50.1), (60.0, 47.0), (66.1, 44.9)] {
        let (x, y) = (FRAME.west + x, FRAME.south + y);
        let fine = patch.frame.sample(patch.values("water_depth").unwrap(), x, y);
        let expected = (97.0 - bowl(x, y)).max(0.0);
        assert!((fine - expected).abs() < 5e-3, "{fine} {expected}");
    }
}

#[test]
fn water_a_lake_cannot_hold_is_refused_with_the_level_it_can() {
    let lake = |at: &str, level: &str| {
        format!("source = \"d\"\n[[op]]\nop = \"lake\"\nat = {at}\nlevel = {level}")
    };
    let (token, message) = problem(&lake("[50, 60]", "99.9"), &raster());
    assert_eq!(token, "99.9");
    let highest: f64 = message.rsplit(' ').next().unwrap().parse().unwrap();
    // The rim is lowest in the east, where the last cell centre lies 30.5 m from the middle.
    assert_eq!(highest, 98.38, "100 - 0.02 * 80.5, a hair below 98.39");
    assert!(terrain(&lake("[50, 60]", &highest.to_string())).is_ok(), "the level named works");
    assert_eq!(problem(&lake("[50, 60]", "90"), &raster()).0, "90");
    assert_eq!(problem(&lake("[110, 10]", "99"), &raster()).0, "[110, 10]");
    assert_eq!(problem(&lake("[500, 10]", "99"), &raster()).0, "[500, 10]");
}

#[test]
fn two_levels_in_one_hollow_are_refused_and_a_stream_may_enter_a_lake() {
    let lakes = "source = \"d\"\n[[op]]\nop = \"lake\"\nat = [50, 60]\nlevel = 97\n\
                 [[op]]\nop = \"lake\"\nat = [55, 60]\nlevel = 97.5";
    let (token, message) = problem(lakes, &raster());
    assert_eq!(token, "97.5");
    assert!(message.contains("97 m"), "{message}");
    let layers = terrain(SCENE).unwrap();
    let depth = |x, y| layers.sample("water_depth", FRAME.west + x, FRAME.south + y).unwrap();
    assert!((depth(30.0, 40.0) - 0.1).abs() < 0.05, "{}", depth(30.0, 40.0));
    assert!(depth(50.0, 60.0) > 1.0);
}

#[test]
fn a_patch_meets_the_terrain_at_its_border_and_has_more_detail_inside() {
    let layers = terrain(SCENE).unwrap();
    let patch = &layers.detail[0];
    let Frame { width, height, .. } = patch.frame;
    assert_eq!((width, height), (160, 160));
    let coarse = layers.grid("altitude").unwrap();
    let fine = patch.grid("altitude").unwrap();
    let difference = |column: usize, row: usize| {
        let (x, y) = patch.frame.center(column, row);
        (fine.values[patch.frame.index(column, row)] - coarse.sample(x, y)).abs()
    };
    for i in 0..width {
        let border = [(i, 0), (i, height - 1), (0, i), (width - 1, i)];
        assert!(border.iter().all(|&(column, row)| difference(column, row) < 1e-4));
    }
    let inside = (20..140).flat_map(|row| (20..140).map(move |column| (column, row)));
    let largest = inside.map(|(column, row)| difference(column, row)).fold(0.0, f32::max);
    // Octaves of 0.75 m and 0.375 m have 1/16 and 1/32 of an amplitude of 0.3 m.
    assert!((0.002..0.1).contains(&largest), "{largest}");
}

#[test]
fn soil_is_wettest_at_the_shore_and_in_the_bowl() {
    let layers =
        terrain("source = \"d\"\n[[op]]\nop = \"lake\"\nat = [50, 60]\nlevel = 96").unwrap();
    let moisture =
        |x: f64, y: f64| layers.sample("soil_moisture", FRAME.west + x, FRAME.south + y).unwrap();
    // The shore lies near r = 17; the bowl's rim at 30.
    let out = [66.0, 71.5, 74.0, 78.0].map(|x| moisture(x, 60.0));
    assert!(out.windows(2).all(|pair| pair[0] > pair[1]), "{out:?}");
    assert!(out[0] == 1.0 && out[1] > 0.5);
}

#[test]
fn holes_take_their_nearest_neighbours_and_are_told() {
    let mut holed = raster();
    for i in 4000..4030 {
        holed.grid.values[i] = f32::NAN;
    }
    holed.grid.values[77] = f32::INFINITY;
    let layers =
        build(&config("source = \"d\""), &holed, &BTreeMap::new(), &[], Seed(7), &Silent).unwrap();
    let altitude = layers.values("altitude").unwrap();
    assert_eq!(altitude[77], altitude[76], "the first of equally near cells");
    assert_eq!(altitude[4010], altitude[4010 - 120]);
    assert!(layers.layers["altitude"].definition.contains("31 cells"));
}

#[test]
fn water_leaves_through_kept_holes() {
    // All ground falls toward a gap in the model: filled, it is a hollow; kept, the way out.
    let far = |x: f64, y: f64| (x - FRAME.west - 60.0).hypot(y - FRAME.south - 50.0);
    let funnel = |x, y| if far(x, y) < 5.0 { f32::NAN } else { 100.0 + far(x, y) as f32 };
    let raster = Raster { grid: Grid::from_fn(FRAME, funnel), crs: Crs::default() };
    let made = |holes: &str| {
        let config = config(&format!("source = \"d\"\nsource_holes = \"{holes}\""));
        build(&config, &raster, &BTreeMap::new(), &[], Seed(7), &Silent).unwrap()
    };
    let hollows = |layers: &Layers| {
        let pairs = layers.values("filled").unwrap().iter().zip(layers.values("altitude").unwrap());
        pairs.filter(|(filled, altitude)| filled > altitude).count()
    };
    assert!(hollows(&made("fill")) > 1000);
    let kept = made("keep");
    assert_eq!(hollows(&kept), 0);
    let area = kept.values("upslope_area").unwrap();
    let cells = (0..FRAME.len()).map(|i| (FRAME.center(i % FRAME.width, i / FRAME.width), area[i]));
    let gap = cells.filter(|&((x, y), _)| (5.0..6.5).contains(&far(x, y))).map(|(_, area)| area);
    let known = area.iter().filter(|area| !area.is_nan()).count();
    assert!(gap.sum::<f32>() >= known as f32, "all of it arrives around the gap");
}

/// Layers of water, which may leave through holes.
const DRAINAGE: [&str; 6] = [
    "filled",
    "height_above_drainage",
    "specific_catchment_area",
    "upslope_area",
    "wetness",
    "wetness_suction",
];

#[test]
fn holes_that_are_kept_are_holes_in_every_layer_and_change_drainage_alone() {
    let mut holed = raster();
    holed.grid.values[4000..4030].fill(f32::NAN);
    let made = |holes: &str, rest: &str| {
        let text = format!("source = \"d\"\nsource_holes = \"{holes}\"\n{rest}");
        build(&config(&text), &holed, &BTreeMap::new(), &[view()], Seed(7), &Silent).unwrap()
    };
    let patch = "detail = [{ view = \"bank\", cell = 0.5, radius = 60 }]";
    let all: Vec<&str> = weald_terrain::CATALOGUE.iter().map(|kind| kind.name).collect();
    let all = format!("layers = {all:?}");
    for rest in [patch, &all, "cell = 0.5"] {
        let (filled, kept) = (made("fill", rest), made("keep", rest));
        let patches = filled.detail.iter().zip(&kept.detail);
        for (filled, kept) in std::iter::once((&filled, &kept)).chain(patches) {
            for (name, layer) in &kept.layers {
                let pairs = layer.values.iter().zip(filled.values(name).unwrap());
                let (gone, left): (Vec<_>, Vec<_>) = pairs.partition(|(kept, _)| kept.is_nan());
                // Thirty cells of a square metre.
                assert_eq!(gone.len() as f64 * kept.frame.cell_area(), 30.0, "{name}, {rest}");
                let is_drainage = DRAINAGE.contains(&name.as_str());
                assert!(left.iter().all(|(kept, _)| kept.is_finite()), "{name}, {rest}");
                let is_same = left.iter().all(|(kept, filled)| kept == filled);
                assert!(is_same || is_drainage, "{name}, {rest}");
            }
        }
    }
}

#[test]
fn local_operators_shape_coarse_and_fine_grids_alike() {
    // Smooth ground, 200 m by 150 m, on a metre; its cells of 0.5 m and 5 m are interpolated.
    let frame = Frame { width: 200, height: 150, cell: 1.0, west: 3000.0, south: 9000.0 };
    let hills = |x: f64, y: f64| (100.0 + 4.0 * (x * 0.04).sin() + 3.0 * (y * 0.05).cos()) as f32;
    let raster = Raster { grid: Grid::from_fn(frame, hills), crs: Crs::default() };
    let operators = [
        "op = \"offset\"\nby = 3\nmask = { disc = { at = [100, 70], radius = 30 }, feather = 30 }",
        "op = \"scale\"\nfactor = 1.5\nabout = 100",
        "op = \"clamp\"\nlow = 98\nhigh = 103",
        "op = \"curve\"\npoints = [[90, 90], [100, 97], [110, 110]]",
        "op = \"terrace\"\nstep = 4\nsharpness = 0.3",
        "op = \"translate\"\nby = [20, -15]",
        "op = \"flatten\"\naltitude = 101\nmask = { line = { points = [[20, 20], [150, 110]], \
         width = 20 }, feather = 25 }",
        "op = \"noise\"\namplitude = 3\nwavelength = 80\noctaves = 1",
        "op = \"hill\"\nat = [90, 80]\nradius = 50\nheight = 6",
        "op = \"crater\"\nat = [90, 80]\nradius = 40\ndepth = 5\nrim = 1\nfalloff = 30",
        "op = \"stream\"\npoints = [[30, 75], [170, 75]]\nwidth = 20\ndepth = 2\nfalloff = 25",
        "op = \"road\"\npoints = [[30, 75], [170, 75]]\nwidth = 20\nfalloff = 25\nmax_grade = 0.3",
        "op = \"smooth\"\nradius = 12",
    ];
    for operator in operators {
        let made = |cell: f64| {
            let text = format!("source = \"d\"\ncell = {cell}\n[[op]]\n{operator}");
            build(&config(&text), &raster, &BTreeMap::new(), &[], Seed(7), &Silent).unwrap()
        };
        let (fine, coarse) = (made(0.5), made(5.0));
        let heights = coarse.values("altitude").unwrap();
        let apart = |index: usize| {
            let (x, y) =
                coarse.frame.center(index % coarse.frame.width, index / coarse.frame.width);
            (fine.sample("altitude", x, y).unwrap() - heights[index]).abs()
        };
        // What is uncovered, and the rim, follow the outermost cells, which lie elsewhere.
        let inside = |index: &usize| {
            let (column, row) = (index % coarse.frame.width, index / coarse.frame.width);
            (6..coarse.frame.width - 6).contains(&column)
                && (6..coarse.frame.height - 6).contains(&row)
        };
        let worst = (0..heights.len()).filter(inside).map(apart).fold(0.0, f32::max);
        // Interpolation of this ground on 5 m errs by at most h² z″ / 8.
        assert!(worst < 5.0 * 5.0 * 0.0139 / 8.0, "{worst} m by {operator}");
    }
}

#[test]
fn ground_that_cannot_be_used_is_refused_with_the_way_out() {
    let text = "source = \"dem.tif\"";
    let changed = |change: &dyn Fn(&mut Raster)| {
        let mut raster = raster();
        change(&mut raster);
        let (token, message) = problem(text, &raster);
        assert_eq!(token, "\"dem.tif\"", "{message}");
        message
    };
    assert!(changed(&|r| r.crs.is_geographic = true).contains("UTM"));
    assert!(changed(&|r| r.grid.values[..6001].fill(f32::NAN)).contains("50 %"));
    assert!(changed(&|r| r.grid.values[5] = -3.4e38).contains("no data"));
    assert!(changed(&|r| r.grid.frame.cell = f64::NAN).contains("finite"));
    let one_pixel = |r: &mut Raster| {
        r.grid = Grid::filled(Frame { width: 1, height: 1, ..FRAME }, 3.0);
    };
    assert!(changed(&one_pixel).contains("at least 3 × 3"));
    assert!(changed(&|r| r.grid.frame.width = 7).contains("do not fit"));
    let (token, message) = problem("source = \"d\"\ncell = 0.005", &raster());
    assert_eq!(token, "0.005");
    assert!(message.contains("GB") && message.contains("set `cell` to at least"), "{message}");
}

#[test]
fn other_cells_keep_the_ground_where_it_is() {
    for cell in [0.5, 2.0] {
        let layers = terrain(&format!("source = \"d\"\ncell = {cell}")).unwrap();
        assert_eq!(layers.frame.width, (120.0 / cell) as usize);
        let (x, y) = (FRAME.west + 80.3, FRAME.south + 20.7);
        let z = layers.sample("altitude", x, y).unwrap();
        assert!((z - bowl(x, y)).abs() < 1e-3, "cell {cell}: {z} {}", bowl(x, y));
    }
}

#[test]
fn ponds_fill_hollows_with_rain_and_dry_ones_stay_dry() {
    let wet =
        "source = \"d\"\nwater = { rain = 0.9, absorbed = 0, seepage = 1000000, ponds = true }";
    let layers = terrain(wet).unwrap();
    let depth = layers.values("water_depth").unwrap();
    let volume: f64 = depth.iter().map(|d| f64::from(*d)).sum();
    assert!(volume > 1000.0, "{volume}");
    let levels = depth.iter().zip(layers.values("altitude").unwrap());
    let levels: Vec<f32> = levels.filter(|(d, _)| **d > 0.0).map(|(d, z)| d + z).collect();
    let range = levels.iter().fold((f32::MAX, f32::MIN), |(a, b), l| (a.min(*l), b.max(*l)));
    assert!(range.1 - range.0 < 1e-3, "the pond is level: {range:?}");
    let dry = terrain("source = \"d\"").unwrap();
    assert!(dry.values("water_depth").unwrap().iter().all(|d| *d == 0.0));
}

#[test]
fn a_wish_to_stop_is_heard() {
    struct Impatient;
    impl weald_contract::Progress for Impatient {
        fn begin(&self, _: &str, _: u64, _: &str) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let stopped =
        build(&config(SCENE), &raster(), &BTreeMap::new(), &[view()], Seed(7), &Impatient);
    assert!(matches!(stopped, Err(Error::Cancelled)));
}

#[test]
fn a_view_off_the_terrain_gets_no_patch_but_an_error_at_its_name() {
    let text = "source = \"d\"\n[[detail]]\nview = \"bank\"\nradius = 5";
    let mut far = view();
    far.stand_at = [500.0, 40.0];
    match build(&config(text), &raster(), &BTreeMap::new(), &[far], Seed(7), &Silent) {
        Err(Error::Problem(problem)) => assert_eq!(token(text, &problem), "\"bank\""),
        other => panic!("expected a problem, found {:?}", other.map(|layers| layers.frame)),
    }
}
