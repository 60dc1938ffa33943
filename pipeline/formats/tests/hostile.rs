//! Damaged and hostile files: a reader may refuse them, it may not panic or fill the memory.

use proptest::prelude::*;
use proptest::sample::Index;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use weald_contract::{Picture, Plant, Population, State};
use weald_formats::{Column, Error, Provenance, Table};

type Reader = fn(&Path) -> Result<(), Error>;

/// A good file in bytes, its ending, and all readers that may meet it.
struct Specimen {
    ending: &'static str,
    bytes: Vec<u8>,
    readers: &'static [Reader],
}

fn provenance() -> Provenance {
    Provenance {
        stage: "test".into(),
        version: "0".into(),
        output_version: 1,
        parameters: serde_json::json!({ "a": [1, 2, 3] }),
        seed: 1,
        inputs: Vec::new(),
    }
}

fn data(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)).unwrap()
}

fn written(name: &str, write: impl FnOnce(&Path) -> Result<(), Error>) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    write(&path).unwrap();
    std::fs::read(path).unwrap()
}

const TIFF: &[Reader] = &[
    |path| weald_formats::read_raster(path).map(drop),
    |path| weald_formats::read_image(path).map(drop),
    |path| weald_formats::provenance(path).map(drop),
];
const PARQUET: &[Reader] = &[
    |path| weald_formats::read_population(path).map(drop),
    |path| weald_formats::read_instances(path).map(drop),
    |path| weald_formats::read_table(path).map(drop),
    |path| weald_formats::provenance(path).map(drop),
];
const MAPS: &[Reader] = &[
    |path| weald_formats::read_population(path).map(drop),
    |path| weald_formats::read_table(path).map(drop),
];
const EXR: &[Reader] = &[
    |path| weald_formats::read_picture(path).map(drop),
    |path| weald_formats::read_image(path).map(drop),
    |path| weald_formats::provenance(path).map(drop),
];
const PNG: &[Reader] = &[
    |path| weald_formats::read_png(path).map(drop),
    |path| weald_formats::read_image(path).map(drop),
    |path| weald_formats::provenance(path).map(drop),
];
const HEIGHTS: &[Reader] = &[
    |path| weald_formats::read_image(path).map(drop),
    |path| {
        let scale = weald_formats::HeightScale { cell: Some(1.0), heights: None };
        weald_formats::read_elevation(path, &scale).map(drop)
    },
];
const GLB: &[Reader] = &[
    |path| weald_formats::read_plant(path).map(drop),
    |path| weald_formats::provenance(path).map(drop),
];

/// Made once: writers wait for the disk.
static SPECIMENS: LazyLock<Vec<Specimen>> = LazyLock::new(specimens);

fn specimens() -> Vec<Specimen> {
    let population = written("p.parquet", |path| {
        weald_formats::write_population(path, &population(), &provenance())
    });
    let table = Table::default().with("a", Column::Float(vec![1.0; 50]));
    let table =
        written("t.parquet", |path| weald_formats::write_table(path, &table, &provenance()));
    let mut picture = Picture::new(20, 18);
    picture.add("R", false, vec![0.5; 360]);
    picture.add("Z", true, (0..360).map(|i| i as f32).collect());
    let picture =
        written("p.exr", |path| weald_formats::write_picture(path, &picture, &provenance()));
    let png =
        written("p.png", |path| weald_formats::write_png(path, 8, 8, &[7; 192], &provenance()));
    let header: &[u8] = b"{'descr': '<f4', 'fortran_order': True, 'shape': (4, 5), }\n";
    let length = [header.len() as u8, 0];
    let array = [&b"\x93NUMPY\x01\x00"[..], &length, header, &[7; 80]].concat();
    let specimen = |ending, bytes, readers| Specimen { ending, bytes, readers };
    vec![
        specimen("tif", data("point_i16_lzw.tif"), TIFF),
        specimen("tif", data("big_f64_strips.tif"), TIFF),
        specimen("exr", picture, EXR),
        specimen("exr", data("luminance.exr"), EXR),
        specimen("png", png, PNG),
        specimen("npy", array, HEIGHTS),
        specimen("glb", b"glTF\x02\0\0\0".to_vec(), GLB),
        specimen("parquet", table, PARQUET),
        specimen("parquet", population, PARQUET),
        specimen("parquet", data("geopandas_plants.parquet"), PARQUET),
        specimen("gpkg", data("trees.gpkg"), MAPS),
        specimen("geojson", data("gdal_trees.geojson"), MAPS),
    ]
}

fn population() -> Population {
    let plant = |id| Plant {
        id,
        species: (id % 2) as u16,
        state: State::Old,
        x: id as f64,
        y: 0.5,
        z: 1.0,
        radius: 2.0,
        height: 3.0,
        age: 4.0,
        vigor: 0.5,
        yaw: 1.0,
        lean: 0.1,
        lean_azimuth: 2.0,
    };
    let species = vec!["oak".to_string(), "ash".to_string()];
    Population { species, plants: (0..60).map(plant).collect(), ..Population::default() }
}

/// Writes the bytes and runs every reader; errors must name the file.
fn read_all(specimen: &Specimen, bytes: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(format!("hostile.{}", specimen.ending));
    std::fs::write(&path, bytes).unwrap();
    for reader in specimen.readers {
        if let Err(error) = reader(&path) {
            assert!(error.to_string().contains("hostile."), "{error}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_bytes_never_panic(which in any::<Index>(), flips in prop::collection::vec((any::<Index>(), any::<u8>()), 1..6)) {
        let specimen = which.get(&SPECIMENS);
        let mut bytes = specimen.bytes.clone();
        for (index, value) in flips {
            let index = index.index(bytes.len());
            bytes[index] = value;
        }
        read_all(specimen, &bytes);
    }

    #[test]
    fn cut_files_never_panic(which in any::<Index>(), cut in any::<Index>()) {
        let specimen = which.get(&SPECIMENS);
        read_all(specimen, &specimen.bytes[..cut.index(specimen.bytes.len())]);
    }

    #[test]
    fn random_bytes_never_panic(which in any::<Index>(), bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let specimen = which.get(&SPECIMENS);
        read_all(specimen, &bytes);
        // And behind the first bytes that make a reader believe.
        let head = specimen.bytes.len().min(16);
        read_all(specimen, &[&specimen.bytes[..head], &bytes].concat());
    }
}

#[test]
#[ignore = "damage at every byte takes minutes; run by hand or nightly"]
fn every_byte_may_be_wrong() {
    for specimen in SPECIMENS.iter() {
        for index in 0..specimen.bytes.len() {
            for value in [0x00, 0xFF] {
                let mut bytes = specimen.bytes.clone();
                bytes[index] = value;
                read_all(specimen, &bytes);
            }
        }
    }
}

#[test]
fn a_picture_that_promises_a_trillion_samples_is_refused_before_they_are_allocated() {
    let specimen = SPECIMENS.iter().find(|specimen| specimen.ending == "exr").unwrap();
    let mut bytes = specimen.bytes.clone();
    // The data window stands behind its name and type: four numbers, the last two its far corner.
    let mark = b"dataWindow\0box2i\0";
    let at = bytes.windows(mark.len()).position(|window| window == mark).unwrap();
    let corner = at + mark.len() + 4 + 8;
    bytes[corner..corner + 8].copy_from_slice(&[0xFF, 0xFF, 0x0F, 0, 0xFF, 0xFF, 0x0F, 0]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.exr");
    std::fs::write(&path, bytes).unwrap();
    let error = weald_formats::read_picture(&path).unwrap_err().to_string();
    assert!(error.contains("huge.exr"), "{error}");
}
