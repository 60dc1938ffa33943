//! PLY: triangle meshes for other programs [Turk94].

use crate::error::{Error, Result};
use crate::whole::write_atomically;
use std::io::Write;
use std::path::Path;
use weald_contract::Mesh;

/// Writes a mesh: binary, little-endian, with normals and texture coordinates (`s` and `t`) where it
/// has them. Axes stay as they are, Z up.
///
/// # Errors
/// Columns of unequal length or an index out of range; the disk refuses.
pub fn write_ply(path: &Path, mesh: &Mesh) -> Result<()> {
    if !mesh.is_sound(mesh.material as usize + 1) {
        let message = "a mesh with an index out of range or columns of unequal length".to_string();
        return Err(Error::invalid(path, message, "every corner needs a vertex"));
    }
    let (has_normals, has_uvs) = (!mesh.normals.is_empty(), !mesh.uvs.is_empty());
    let mut bytes = header(mesh, has_normals, has_uvs).into_bytes();
    bytes.reserve(mesh.positions.len() * 32 + mesh.triangles.len() * 13);
    let mut put = |values: &[f32]| {
        values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    };
    for vertex in 0..mesh.positions.len() {
        put(&mesh.positions[vertex]);
        if has_normals {
            put(&mesh.normals[vertex]);
        }
        if has_uvs {
            put(&mesh.uvs[vertex]);
        }
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        triangle.iter().for_each(|index| bytes.extend(index.to_le_bytes()));
    }
    write_atomically(path, |file| Ok(file.write_all(&bytes)?))
}

fn header(mesh: &Mesh, has_normals: bool, has_uvs: bool) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    let mut add = |line: &str| {
        text.push_str(line);
        text.push('\n');
    };
    add(&format!("element vertex {}", mesh.positions.len()));
    let names = [("x y z", true), ("nx ny nz", has_normals), ("s t", has_uvs)];
    for name in names.iter().filter(|(_, is_there)| *is_there).flat_map(|(n, _)| n.split(' ')) {
        add(&format!("property float {name}"));
    }
    add(&format!("element face {}", mesh.triangles.len()));
    add("property list uchar int vertex_indices");
    add("end_header");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> Mesh {
        Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 0.0]],
            uvs: vec![[0.0; 2], [1.0, 0.0], [1.0; 2], [0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn vertices_and_faces_stand_where_the_header_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("quad.ply");
        write_ply(&path, &quad()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = std::str::from_utf8(&bytes[..start]).unwrap();
        assert!(header.contains("element vertex 4\nproperty float x\n"), "{header}");
        assert!(!header.contains("nx") && header.contains("property float t\nelement face 2\n"));
        let float = |at: usize| {
            f32::from_le_bytes(bytes[start + 4 * at..start + 4 * at + 4].try_into().unwrap())
        };
        // The third vertex: x, y, z, s, t.
        assert_eq!([10, 11, 12, 13, 14].map(float), [1.0, 2.0, 0.0, 1.0, 1.0]);
        let faces = &bytes[start + 4 * 20..];
        assert_eq!(faces.len(), 26);
        assert_eq!(faces[13..], [3, 0, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0]);
    }

    #[test]
    fn a_damaged_mesh_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut mesh = quad();
        mesh.triangles[1][2] = 4;
        assert!(write_ply(&folder.path().join("x.ply"), &mesh).is_err());
    }
}
