//! Layers that are made when asked for, edited layers, and the operators that change whole grounds.

use std::collections::BTreeMap;
use weald_contract::{
    Crs, Frame, FromToml, Grid, Image, Layers, Problems, Raster, Seed, Silent, Value, View,
};
use weald_terrain::{CATALOGUE, Config, build};

const FRAME: Frame = Frame { width: 60, height: 50, cell: 2.0, west: 1000.0, south: 2000.0 };

/// Ground that falls to the east with a valley along y = 50 m.
fn valley(x: f64, y: f64) -> f32 {
    (200.0 - 0.1 * (x - FRAME.west) + 0.3 * (y - FRAME.south - 50.0).abs()) as f32
}

fn view() -> View {
    let text = "name = \"bank\"\nstand_at = [70, 40]\nlook_at = [50, 60]";
    View::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
}

fn read(text: &str) -> Result<Config, Problems> {
    let mut problems = Vec::new();
    let config = Config::from_toml(&Value::parse(0, text)?, &mut problems).ok_or(problems)?;
    let problems = config.check(&[view()]);
    if problems.is_empty() { Ok(config) } else { Err(problems) }
}

fn terrain(text: &str) -> Layers {
    let raster = Raster { grid: Grid::from_fn(FRAME, valley), crs: Crs::default() };
    let image = Image {
        width: 60,
        height: 50,
        values: (0..3000).map(|i| if i % 60 < 30 { 1.0 } else { 0.0 }).collect(),
        is_float: false,
        frame: None,
    };
    let images = BTreeMap::from([("west.png".to_string(), image)]);
    build(&read(text).unwrap(), &raster, &images, &[view()], Seed(7), &Silent).unwrap()
}

fn at(layers: &Layers, name: &str, x: f64, y: f64) -> f32 {
    layers.frame.sample(layers.values(name).unwrap(), FRAME.west + x, FRAME.south + y)
}

const EVERYTHING: &str = "layers = [\"normal\", \"northness\", \"eastness\", \"curvature_plan\", \
    \"curvature_profile\", \"specific_catchment_area\", \"wetness_suction\", \"soil_water\", \
    \"height_above_drainage\", \"soil_depth\", \"insolation\", \"sky_view\", \"heat_load\", \
    \"temperature\"]\n";

#[test]
fn every_layer_of_the_catalogue_can_be_asked_for_and_is_finite_on_every_grid() {
    let text =
        format!("source = \"d\"\n{EVERYTHING}[[detail]]\nview = \"bank\"\ncell = 0.5\nradius = 9");
    let layers = terrain(&text);
    let names: Vec<&str> = CATALOGUE.iter().map(|kind| kind.name).collect();
    assert_eq!(read(&text).unwrap().layer_names(), names);
    for grid in [&layers, &layers.detail[0]] {
        assert_eq!(grid.layers.keys().collect::<Vec<_>>(), names);
        for (name, layer) in &grid.layers {
            assert!(layer.values.iter().all(|v| v.is_finite()), "{name}");
        }
    }
    assert_eq!(terrain("source = \"d\"").layers.len(), 8, "nobody asked for more");
}

#[test]
fn layers_of_a_valley_are_what_its_form_says() {
    let text = format!(
        "source = \"d\"\n{EVERYTHING}[environment]\nlapse_per_km = 6.5\ntemperature = 10\n\
         temperature_altitude = 0\nchannel_area = 500\nsoil_depth = 2"
    );
    let layers = terrain(&text);
    // The southern side of the valley falls to the north: gradient (-0.1, -0.3).
    let up = 1.0 / (1.0 + 0.01f32 + 0.09).sqrt();
    let at = |name, x, y| at(&layers, name, x, y);
    assert!((at("normal_up", 61.0, 21.0) - up).abs() < 1e-5);
    assert!((at("northness", 61.0, 21.0) - 0.3 * up).abs() < 1e-5);
    assert!((at("eastness", 61.0, 21.0) - 0.1 * up).abs() < 1e-5);
    let z = f64::from(valley(FRAME.west + 61.0, FRAME.south + 21.0));
    assert!((f64::from(at("temperature", 61.0, 21.0)) - (10.0 - 0.0065 * z)).abs() < 1e-4);
    let slope = f64::hypot(0.1, 0.3).atan().to_degrees() / 60.0;
    assert!((f64::from(at("soil_depth", 61.0, 21.0)) - 2.0 * (1.0 - slope)).abs() < 1e-4);
    // The south-facing side has more sun than the north-facing one, and the valley's floor is wet.
    assert!(at("insolation", 61.0, 79.0) > 1.05 * at("insolation", 61.0, 21.0));
    assert!(at("heat_load", 61.0, 79.0) > at("heat_load", 61.0, 21.0));
    assert!(at("sky_view", 61.0, 51.0) < 1.0);
    assert!(at("height_above_drainage", 61.0, 49.5) < 0.7);
    assert!(at("height_above_drainage", 61.0, 21.0) > 4.0);
    let area = |y| at("specific_catchment_area", 101.0, y);
    assert!(area(50.0) > 10.0 * area(30.0));
    let suction = layers.values("wetness_suction").unwrap();
    assert!(suction.iter().zip(layers.values("slope").unwrap()).all(|(w, _)| *w > 0.0));
}

#[test]
fn a_layer_is_replaced_or_blended_under_a_mask_after_the_water() {
    let edit = |more: &str| {
        terrain(&format!(
            "source = \"d\"\n[[op]]\nop = \"layer\"\nlayer = \"soil_moisture\"\n{more}"
        ))
    };
    let masked = edit("value = 0.75\nmask = { rectangle = [0, 0, 40, 100] }");
    let plain = terrain("source = \"d\"");
    assert_eq!(at(&masked, "soil_moisture", 21.0, 31.0), 0.75);
    assert_eq!(at(&masked, "soil_moisture", 81.0, 31.0), at(&plain, "soil_moisture", 81.0, 31.0));
    assert!(masked.layers["soil_moisture"].definition.ends_with("edited in the scene"));
    let painted = edit("image = \"west.png\"\nrange = [0.2, 0.6]");
    assert_eq!(at(&painted, "soil_moisture", 21.0, 31.0), 0.6);
    assert_eq!(at(&painted, "soil_moisture", 101.0, 31.0), 0.2);
    let doubled = edit("formula = \"soil_moisture\"\nblend = \"add\"");
    let (once, twice) =
        (at(&plain, "soil_moisture", 81.0, 31.0), at(&doubled, "soil_moisture", 81.0, 31.0));
    assert!((twice - 2.0 * once).abs() < 1e-6);
    // The floor of the valley, by the flow that runs there.
    let wet = edit("value = 1\nmask = { upslope_area = [1000, 1e9] }");
    assert_eq!(
        at(&wet, "soil_moisture", 101.0, 51.0).max(at(&wet, "soil_moisture", 101.0, 49.0)),
        1.0
    );
}

#[test]
fn mistakes_in_layers_are_told_before_any_work() {
    let complaint = |text: &str| {
        let problems = read(&format!("source = \"d\"\n{text}")).unwrap_err();
        problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    };
    assert!(complaint("layers = [\"insolatoin\"]").contains("did you mean `insolation`?"));
    let edit = "[[op]]\nop = \"layer\"\n";
    assert!(
        complaint(&format!("{edit}layer = \"altitude\"\nvalue = 1")).contains("other operators")
    );
    assert!(complaint(&format!("{edit}layer = \"wetness\"")).contains("write one of"));
    let formula = format!("{edit}layer = \"wetness\"\nformula = \"insolation\"");
    assert!(complaint(&formula).contains("no layer of this name"));
    assert!(complaint("crop = [50, 0, 10, 20]").contains("no inside"));
    assert!(
        complaint("[[op]]\nop = \"curve\"\npoints = [[3, 1], [2, 1]]").contains("rising order")
    );
    assert!(complaint("[environment]\ndays = []").contains("names no day"));
}

#[test]
fn a_crop_keeps_the_map_and_moves_the_scene_to_its_corner() {
    let layers = terrain("source = \"d\"\ncrop = [20, 30, 80, 90]");
    let Frame { width, height, west, south, .. } = layers.frame;
    assert_eq!((width, height, west, south), (30, 30, 1020.0, 2030.0));
    let z = layers.sample("altitude", 1041.0, 2051.0).unwrap();
    assert!((z - valley(1041.0, 2051.0)).abs() < 1e-4);
}

#[test]
fn operators_that_need_the_whole_ground_change_a_patch_alike() {
    let text = "source = \"d\"\n[[op]]\nop = \"noise\"\namplitude = 2\nwavelength = 30\noctaves = 2\n\
        [[op]]\nop = \"erode\"\nyears = 20000\nsteps = 4\n[[op]]\nop = \"thermal\"\npasses = 5\n\
        [[op]]\nop = \"translate\"\nby = [3, -2]\n[[op]]\nop = \"hill\"\nat = [60, 40]\nradius = 9\nheight = 2\n\
        [[op]]\nop = \"crater\"\nat = [75, 45]\nradius = 5\ndepth = 1\n[[op]]\nop = \"curve\"\n\
        points = [[180, 180], [200, 199], [220, 221]]\n[[op]]\nop = \"road\"\n\
        points = [[40, 30], [70, 40], [100, 35]]\nwidth = 3\n[[detail]]\nview = \"bank\"\ncell = 0.5\nradius = 20";
    let layers = terrain(text);
    let (coarse, fine) =
        (layers.grid("altitude").unwrap(), layers.detail[0].grid("altitude").unwrap());
    let frame = fine.frame;
    for (column, row) in (0..frame.width).flat_map(|x| (0..frame.height).map(move |y| (x, y))) {
        let (x, y) = frame.center(column, row);
        let difference = (fine.values[frame.index(column, row)] - coarse.sample(x, y)).abs();
        assert!(difference < 0.6, "{x} {y}: {difference}");
    }
}

#[test]
fn soil_is_where_its_map_is_white() {
    let text = "source = \"d\"\n[water]\nspread = 0\nsoil = \"west.png\"";
    let inputs = read(text).unwrap().inputs();
    assert!(inputs.iter().any(|input| input.field == "terrain.water.soil"));
    let (mapped, plain) = (terrain(text), terrain("source = \"d\"\n[water]\nspread = 0"));
    for row in 0..50 {
        let y = 2.0 * f64::from(row) + 1.0;
        assert_eq!(at(&mapped, "soil_moisture", 91.0, y), 0.0, "bare rock in the east");
        // Water comes from the west alone, where nothing else is different.
        assert_eq!(at(&mapped, "soil_moisture", 31.0, y), at(&plain, "soil_moisture", 31.0, y));
    }
}

#[test]
fn a_breached_dam_lets_the_valley_drain() {
    let dam = "source = \"d\"\n[[op]]\nop = \"road\"\npoints = [[60, 0], [60, 100]]\nwidth = 4\n\
        falloff = 2\nraise = 3\n";
    let stands = |text: &str| {
        let layers = terrain(text);
        let filled = layers.values("filled").unwrap().iter();
        filled.zip(layers.values("altitude").unwrap()).filter(|(a, b)| a > b).count()
    };
    assert!(stands(dam) > 50, "the road dams the valley");
    let opened = format!("{dam}[[op]]\nop = \"breach\"\nmax_depth = 50\n");
    assert_eq!(stands(&opened), 0);
}
