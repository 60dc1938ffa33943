//! Readers and writers of every file that passes between the stages.
//!
//! All are standards that other people's programs open: GeoTIFF for fields, Parquet or CSV for
//! tables of plants, TOML for palettes, GLB for plant models, OpenEXR and PNG for pictures.
//! `docs/formats.md` lists their columns, layers and channels. Every file carries its
//! [`Provenance`]; every writer writes a temporary file beside the target and renames it, so a
//! file that has its final name is whole; no reader trusts a size before checking it.

pub mod ascii_grid;
mod bytes;
mod cells;
mod csv_table;
mod elevation;
pub mod error;
mod geo;
mod geojson;
mod geopackage;
pub mod geotiff;
mod hgt;
mod inventory;
mod npy;
mod parquet_table;
pub mod picture;
pub mod plant;
pub mod population;
pub mod provenance;
mod sqlite;
pub mod table;
pub mod terrain;
mod utm;
pub mod whole;

pub mod obj;

mod image;
mod instances;
mod palette;
mod ply;
mod png;
mod png_bands;
mod prj;

pub use elevation::{HeightScale, read_elevation};
pub use error::{Error, Result};
pub use image::{companion, read_image, read_raster};
pub use instances::{check_instances, read_instances, write_instances};
pub use obj::read_obj;
pub use palette::{parse_palette, read_palette, write_palette};
pub use parquet_table::{RowGroups, is_panic_contained};
pub use picture::{read_picture, write_picture};
pub use plant::{flatten, read_model, read_plant, write_plant};
pub use ply::write_ply;
pub use png::{Preview, read_png, write_gray_png, write_png};
pub use population::{read_population, write_population};
pub use provenance::{Parent, Provenance, hash_file, provenance};
pub use table::{Column, Table, read_table, write_table};
pub use terrain::{read_terrain, write_layers, write_terrain};
pub use whole::write_atomically;
