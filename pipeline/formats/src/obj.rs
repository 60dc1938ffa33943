//! Reading Wavefront OBJ: anyone's model as plain geometry.
//!
//! Faces become triangles, one mesh a material. Of the material library beside the file, diffuse
//! colour (`Kd`), its picture (`map_Kd`) and opacity below one half (a cut-out by the picture's
//! own coverage) are kept. The format names no axes; Y is taken as up, as most exporters write.

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::error::{Error, Result};
use crate::plant::{MAX_ITEMS, texture, z_up};
use std::collections::HashMap;
use std::path::Path;
use weald_contract::{Material, Mesh, Paint, PlantModel, Texture};

/// Reads an `.obj` with the material library beside it.
///
/// # Errors
/// When a line cannot be read (it is named), an index points nowhere, or the file is larger than
/// we read. A library or picture that is absent leaves grey.
pub fn read_obj(path: &Path) -> Result<PlantModel> {
    let bytes = read_bounded(path, MAX_FILE_BYTES)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    parse_obj(path, &bytes, &|name| read_bounded(&folder.join(name), MAX_FILE_BYTES).ok())
}

/// Reads an OBJ from bytes; `beside` gives the bytes of files that it names, if they are there.
///
/// # Errors
/// As [`read_obj`].
pub fn parse_obj(
    path: &Path,
    bytes: &[u8],
    beside: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Result<PlantModel> {
    let text = String::from_utf8_lossy(bytes);
    let mut reader = Reader { path, beside, ..Reader::new(path, beside) };
    for (number, line) in text.lines().enumerate() {
        reader.line(line).map_err(|message| {
            let hint = "an OBJ holds v, vt, vn, f, usemtl and mtllib lines";
            Error::invalid(path, format!("line {}: {message}", number + 1), hint)
        })?;
        if reader.items > MAX_ITEMS {
            let message = format!("the model has more than {MAX_ITEMS} vertices and triangles");
            return Err(Error::invalid(path, message, "simplify it"));
        }
    }
    Ok(reader.model())
}

/// Position, texture coordinate and normal of a corner, counted from 0.
type Corner = (u32, Option<u32>, Option<u32>);

struct Reader<'a> {
    path: &'a Path,
    beside: &'a dyn Fn(&str) -> Option<Vec<u8>>,
    positions: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    materials: Vec<Material>,
    textures: Vec<Texture>,
    /// Corners of each material's mesh so far, and where each stands in it.
    parts: Vec<Part>,
    current: usize,
    items: usize,
}

#[derive(Default)]
struct Part {
    corners: Vec<Corner>,
    places: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path, beside: &'a dyn Fn(&str) -> Option<Vec<u8>>) -> Self {
        Self {
            path,
            beside,
            positions: Vec::new(),
            uvs: Vec::new(),
            normals: Vec::new(),
            materials: vec![grey("plain")],
            textures: Vec::new(),
            parts: vec![Part::default()],
            current: 0,
            items: 0,
        }
    }

    fn line(&mut self, line: &str) -> std::result::Result<(), String> {
        let mut words = line.split('#').next().unwrap_or("").split_whitespace();
        let Some(keyword) = words.next() else { return Ok(()) };
        match keyword {
            "v" => {
                let [x, y, z] = numbers(words)?;
                self.positions.push(z_up([x, y, z]));
                self.items += 1;
            }
            // Pictures begin at their lower left in OBJ, at their upper left with us.
            "vt" => {
                let [u, v] = numbers(words)?;
                self.uvs.push([u, 1.0 - v]);
                self.items += 1;
            }
            "vn" => {
                let normal = z_up(numbers(words)?);
                self.normals.push(glam::Vec3::from(normal).normalize_or(glam::Vec3::Z).into());
                self.items += 1;
            }
            "f" => self.face(words)?,
            "usemtl" => self.use_material(words.next().unwrap_or("plain")),
            "mtllib" => words.for_each(|name| self.library(name)),
            // Groups, smoothing, lines and curves carry nothing that we keep.
            _ => {}
        }
        Ok(())
    }

    fn face<'t>(
        &mut self,
        words: impl Iterator<Item = &'t str>,
    ) -> std::result::Result<(), String> {
        let mut corners = Vec::new();
        for word in words {
            let corner = self.corner(word)?;
            let part = &mut self.parts[self.current];
            let next = part.corners.len() as u32;
            let place = *part.places.entry(corner).or_insert(next);
            if place == next {
                part.corners.push(corner);
                self.items += 1;
            }
            corners.push(place);
        }
        if corners.len() < 3 {
            return Err(format!("a face of {} corners", corners.len()));
        }
        let part = &mut self.parts[self.current];
        for pair in corners[1..].windows(2) {
            part.triangles.push([corners[0], pair[0], pair[1]]);
            self.items += 1;
        }
        Ok(())
    }

    fn corner(&self, word: &str) -> std::result::Result<Corner, String> {
        let mut parts = word.split('/');
        let mut index = |count: usize, what: &str| match parts.next() {
            None | Some("") => Ok(None),
            Some(text) => {
                let number: i64 = text.parse().map_err(|_| format!("`{word}` is no corner"))?;
                // Negative ones count back from the last.
                let from_zero = if number < 0 { count as i64 + number } else { number - 1 };
                if (0..count as i64).contains(&from_zero) {
                    Ok(Some(from_zero as u32))
                } else {
                    Err(format!("`{word}` names {what} {number} of {count}"))
                }
            }
        };
        let position = index(self.positions.len(), "vertex")?;
        let uv = index(self.uvs.len(), "texture coordinate")?;
        let normal = index(self.normals.len(), "normal")?;
        Ok((position.ok_or_else(|| format!("`{word}` is no corner"))?, uv, normal))
    }

    fn use_material(&mut self, name: &str) {
        let found = self.materials.iter().position(|material| material.name == name);
        self.current = found.unwrap_or_else(|| self.add(grey(name)));
    }

    fn add(&mut self, material: Material) -> usize {
        self.materials.push(material);
        self.parts.push(Part::default());
        self.materials.len() - 1
    }

    /// Reads a material library; one that is absent leaves its materials grey.
    fn library(&mut self, name: &str) {
        let Some(bytes) = (self.beside)(name) else { return };
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let mut current = None;
        for line in text.lines() {
            let mut words = line.split('#').next().unwrap_or("").split_whitespace();
            match (words.next(), current) {
                (Some("newmtl"), _) => {
                    let name = words.next().unwrap_or_default();
                    let known = self.materials.iter().position(|m| m.name == name);
                    current = Some(known.unwrap_or_else(|| self.add(grey(name))));
                }
                (Some("Kd"), Some(index)) => {
                    if let Ok(rgb) = numbers::<3>(words) {
                        self.materials[index].reflectance = rgb.map(|c| c.clamp(0.0, 1.0));
                    }
                }
                (Some("map_Kd"), Some(index)) => {
                    // Options come first, the name last.
                    if let Some(name) = words.last() {
                        self.picture(index, name);
                    }
                }
                _ => {}
            }
        }
    }

    fn picture(&mut self, material: usize, name: &str) {
        let Some(bytes) = (self.beside)(name) else { return };
        let Ok(texture) = texture::from_bytes(self.path, name.into(), &bytes) else { return };
        self.items += texture.texels.len();
        let has_holes = texture.texels.iter().any(|texel| texel[3] < 128);
        let material = &mut self.materials[material];
        material.paint = Some(Paint { texture: self.textures.len() as u32, size: [1.0; 2] });
        material.cutout = has_holes.then_some(0.5);
        self.textures.push(texture);
    }

    fn model(self) -> PlantModel {
        let name = self.path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let mut model = PlantModel {
            name: name.unwrap_or_default(),
            textures: self.textures,
            ..PlantModel::default()
        };
        for (part, material) in self.parts.into_iter().zip(self.materials) {
            if part.triangles.is_empty() {
                continue;
            }
            let has_uvs = part.corners.iter().all(|corner| corner.1.is_some());
            let has_normals = part.corners.iter().all(|corner| corner.2.is_some());
            let at = |index: Option<u32>| index.unwrap_or(0) as usize;
            let corners = || part.corners.iter();
            model.wood.push(Mesh {
                positions: corners().map(|c| self.positions[c.0 as usize]).collect(),
                uvs: corners().filter(|_| has_uvs).map(|c| self.uvs[at(c.1)]).collect(),
                normals: corners().filter(|_| has_normals).map(|c| self.normals[at(c.2)]).collect(),
                triangles: part.triangles,
                material: model.materials.len() as u32,
                branches: Vec::new(),
            });
            model.materials.push(material);
        }
        model
    }
}

fn grey(name: &str) -> Material {
    Material { name: name.into(), reflectance: [0.5; 3], roughness: 1.0, ..Material::default() }
}

/// The first `N` numbers of a line; those that are missing at its end are 0.
fn numbers<'t, const N: usize>(
    mut words: impl Iterator<Item = &'t str>,
) -> std::result::Result<[f32; N], String> {
    let mut found = [0.0; N];
    for (index, number) in found.iter_mut().enumerate() {
        let Some(word) = words.next() else {
            // One texture coordinate alone is allowed.
            if index > 0 && N == 2 {
                break;
            }
            return Err(format!("{index} numbers where {N} are needed"));
        };
        *number = word
            .parse()
            .ok()
            .filter(|x: &f32| x.is_finite())
            .ok_or_else(|| format!("`{word}` is no number"))?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SQUARE: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
        vt 0 1\nvn 0 0 1\nusemtl leaf\nf 1/1/1 2/2/1 3/3/1 4/4/1\nusemtl bark # none\nf -4 -3 -2\n";

    fn read(text: &str, library: Option<&str>) -> Result<PlantModel> {
        let beside =
            |name: &str| library.filter(|_| name == "a.mtl").map(|text| text.as_bytes().to_vec());
        parse_obj(Path::new("square.obj"), text.as_bytes(), &beside)
    }

    #[test]
    fn faces_become_triangles_by_material_and_stand_upright() {
        let library = "newmtl leaf\nKd 0.1 0.4 0.05\nmap_Kd absent.png\nd 0.5\n";
        let model = read(SQUARE, Some(library)).unwrap();
        assert_eq!(model.name, "square");
        assert_eq!(model.materials[0].reflectance, [0.1, 0.4, 0.05]);
        assert_eq!(model.materials[1].reflectance, [0.5; 3]);
        assert_eq!(model.wood[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(model.wood[0].positions[2], [1.0, -0.0, 2.0]);
        assert_eq!(
            (model.wood[0].uvs[0], model.wood[0].normals[0]),
            ([0.0, 1.0], [0.0, -1.0, 0.0])
        );
        assert_eq!(model.wood[1].triangles.len(), 1);
        assert!(model.wood[1].uvs.is_empty() && model.wood[1].is_sound(2));
        assert_eq!(model.height(), 2.0);
    }

    #[test]
    fn mistakes_name_their_line() {
        let error = |text: &str| read(text, None).unwrap_err().to_string();
        assert!(error("v 0 0 0\nv 0 zero 0").contains("line 2: `zero` is no number"));
        let far = error("v 0 0 0\nf 1 2 3");
        assert!(far.contains("line 2: `2` names vertex 2 of 1"), "{far}");
        assert!(error("v 0 0 0\nf 1 1").contains("a face of 2 corners"));
        assert!(error("v 0 0").contains("2 numbers where 3 are needed"));
    }

    proptest! {
        #[test]
        fn damaged_files_never_panic(text in "[vtnf 0-9/.#e\\-\n]{0,200}") {
            if let Ok(model) = read(&text, None) {
                prop_assert!(model.wood.iter().all(|mesh| mesh.is_sound(model.materials.len())));
            }
        }
    }
}
