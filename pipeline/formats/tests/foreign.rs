//! Files that other programs wrote: GDAL, pandas, GeoPandas and OpenEXR, through their Python packages.

use std::path::{Path, PathBuf};
use weald_contract::Frame;
use weald_formats::{
    Column, read_image, read_picture, read_population, read_raster, read_table, read_terrain,
};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// 5 x 4 cells of 2 m whose north-west corner is (99, 208).
const FRAME: Frame = Frame { width: 5, height: 4, cell: 2.0, west: 99.0, south: 200.0 };

#[test]
fn points_of_gdal_become_cells_and_its_missing_value_nan() {
    let raster = read_raster(&data("point_i16_lzw.tif")).unwrap();
    assert_eq!(raster.grid.frame, FRAME);
    assert_eq!(raster.crs.epsg, Some(32633));
    assert_eq!(raster.grid.values[..5], [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(raster.grid.values[7].is_nan());
    assert_eq!(raster.grid.values.iter().filter(|value| value.is_nan()).count(), 1);
}

#[test]
fn a_big_endian_bigtiff_of_doubles_is_read() {
    let raster = read_raster(&data("big_f64_strips.tif")).unwrap();
    assert_eq!(raster.grid.frame, FRAME);
    assert!(raster.grid.values[7].is_nan());
    assert_eq!(raster.grid.values[19], 20.0);
}

#[test]
fn an_integer_geotiff_is_an_image_of_code_over_maximum() {
    let image = read_image(&data("u8_density.tif")).unwrap();
    assert_eq!(image.values, [0.0, 0.2, 0.4, 1.0]);
    assert!(!image.is_float && image.frame.is_some());
}

#[test]
fn several_bands_and_feet_are_refused_with_a_way_out() {
    let error = read_raster(&data("three_bands.tif")).unwrap_err().to_string();
    assert!(error.contains("3 bands") && error.contains("gdal_translate"), "{error}");
    let error = read_raster(&data("feet.tif")).unwrap_err().to_string();
    assert!(error.contains("9003") && error.contains("metres"), "{error}");
}

#[test]
fn a_geoparquet_inventory_of_geopandas_is_a_population() {
    let plants = read_population(&data("geopandas_plants.parquet")).unwrap();
    assert_eq!(plants.species, ["oak", "ash"]);
    assert_eq!(plants.crs.epsg, Some(25833));
    let ids: Vec<u64> = plants.plants.iter().map(|plant| plant.id).collect();
    assert_eq!(ids, [3, 4, 5]);
    assert!(plants.plants[1].height.is_nan() && plants.plants[2].height == 12.5);
    assert_eq!(plants.extra["count"], [1.0, 2.0, 3.0]);
    let table = read_table(&data("geopandas_plants.parquet")).unwrap();
    assert!(table.column("when").is_none(), "dates are left out");
    assert!(
        matches!(table.column("alive"), Some(Column::Integer(alive)) if alive[..] == [1, 0, 1])
    );
}

#[test]
fn points_of_gdal_are_a_population_from_geopackage_and_geojson() {
    for name in ["gdal_trees.gpkg", "gdal_trees.geojson"] {
        let plants = read_population(&data(name)).unwrap();
        assert_eq!((plants.len(), plants.crs.epsg), (40, Some(32633)), "{name}");
        assert_eq!(plants.species, ["ash", "oak"]);
        for (row, plant) in plants.plants.iter().enumerate() {
            let step = row as f64;
            assert_eq!((plant.x, plant.y), (500_000.0 + 1.5 * step, 4_649_776.0 + step));
            // `height_m` and `crown width (m)`
            assert_eq!(f64::from(plant.height), 5.0 + step / 4.0);
            assert_eq!(f64::from(plant.radius), 1.0 + step / 16.0);
        }
    }
}

#[test]
fn whole_numbers_of_pandas_stay_whole_unless_one_is_missing() {
    let table = read_table(&data("pandas_integers.parquet")).unwrap();
    // 2^53 + 1 has no double: a detour over floats would lose it.
    let ids = table.column("id");
    assert!(matches!(ids, Some(Column::Unsigned(ids)) if ids[..] == [3, (1 << 53) + 1]));
    let counts = table.column("count");
    assert!(matches!(counts, Some(Column::Integer(counts)) if counts[..] == [-4, 7]));
    let gaps = table.column("gap");
    assert!(matches!(gaps, Some(Column::Float(gaps)) if gaps[0] == 1.0 && gaps[1].is_nan()));
}

#[test]
fn a_picture_of_openexr_is_read_and_serves_as_a_band() {
    let picture = read_picture(&data("luminance.exr")).unwrap();
    assert_eq!(picture.channel("Y"), Some(&[0.5, 1.5, 2.5][..]));
    assert_eq!(read_image(&data("luminance.exr")).unwrap().values, [0.5, 1.5, 2.5]);
}

#[test]
fn the_wrong_file_is_told_from_the_missing_one() {
    let error = read_terrain(&data("")).unwrap_err().to_string();
    assert!(error.contains("altitude.tif"), "{error}");
    let error = read_raster(&data("luminance.exr")).unwrap_err().to_string();
    assert!(error.contains(".exr") && error.contains("source_cell"), "{error}");
    let error = read_raster(&data("none.tif")).unwrap_err().to_string();
    assert!(error.contains("none.tif") && error.contains("cannot open"), "{error}");
}
