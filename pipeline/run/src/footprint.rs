//! Outlines of meshes from above, which terrain masks take as images.

use weald_contract::{Frame, Image, Mesh, PlantModel};

/// Pixels along the longer side of an outline.
const SIDE: f64 = 512.0;

/// An image that is 1 where a model covers the ground, in the model's own metres.
///
/// A pixel is covered where its middle is; a model that covers none has an image of one empty
/// pixel.
pub(crate) fn of(model: &PlantModel) -> Image {
    let triangles = triangles(model);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in triangles.iter().flatten() {
        for axis in 0..2 {
            low[axis] = low[axis].min(corner[axis]);
            high[axis] = high[axis].max(corner[axis]);
        }
    }
    let extent = (high[0] - low[0]).max(high[1] - low[1]);
    if !(extent > 0.0 && extent.is_finite()) {
        let frame = Frame { width: 1, height: 1, cell: 1.0, west: 0.0, south: 0.0 };
        return Image {
            width: 1,
            height: 1,
            values: vec![0.0],
            is_float: false,
            frame: Some(frame),
        };
    }
    let cell = extent / SIDE;
    let side = |axis: usize| (((high[axis] - low[axis]) / cell).ceil() as usize).max(1);
    let frame = Frame { width: side(0), height: side(1), cell, west: low[0], south: low[1] };
    let mut values = vec![0.0; frame.len()];
    triangles.iter().for_each(|triangle| cover(&frame, &mut values, triangle));
    let (width, height) = (frame.width, frame.height);
    Image { width, height, values, is_float: false, frame: Some(frame) }
}

type Triangle = [[f64; 2]; 3];

/// All triangles of a model, from above.
fn triangles(model: &PlantModel) -> Vec<Triangle> {
    let of_mesh = |mesh: &Mesh, place: &dyn Fn([f32; 3]) -> [f64; 2]| -> Vec<Triangle> {
        let corners = |triangle: &[u32; 3]| triangle.map(|i| place(mesh.positions[i as usize]));
        mesh.triangles.iter().map(corners).collect()
    };
    let mut found = Vec::new();
    for mesh in &model.wood {
        found.extend(of_mesh(mesh, &|[x, y, _]| [f64::from(x), f64::from(y)]));
    }
    for organ in &model.organs {
        for placement in &organ.placements {
            let rotation = glam::Quat::from_array(placement.rotation);
            let place = |position: [f32; 3]| {
                let scaled = glam::Vec3::from(position) * glam::Vec3::from(placement.scale);
                let at = rotation * scaled + glam::Vec3::from(placement.position);
                [f64::from(at.x), f64::from(at.y)]
            };
            organ.meshes.iter().for_each(|mesh| found.extend(of_mesh(mesh, &place)));
        }
    }
    found
}

/// Marks the pixels whose middles lie in a triangle.
fn cover(frame: &Frame, values: &mut [f32], triangle: &Triangle) {
    let pixel = |value: f64, start: f64, count: usize| {
        (((value - start) / frame.cell).floor().max(0.0) as usize).min(count - 1)
    };
    let bounds = |axis: usize| {
        let [a, b, c] = triangle.map(|corner| corner[axis]);
        (a.min(b).min(c), a.max(b).max(c))
    };
    let ((west, east), (south, north)) = (bounds(0), bounds(1));
    // Rows run from the north.
    let rows = frame.height - 1 - pixel(north, frame.south, frame.height)
        ..=frame.height - 1 - pixel(south, frame.south, frame.height);
    let columns = pixel(west, frame.west, frame.width)..=pixel(east, frame.west, frame.width);
    for row in rows {
        for column in columns.clone() {
            let (x, y) = frame.center(column, row);
            let turns = [0, 1, 2].map(|k| {
                let ([x0, y0], [x1, y1]) = (triangle[k], triangle[(k + 1) % 3]);
                (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
            });
            let is_in = turns.iter().all(|t| *t >= 0.0) || turns.iter().all(|t| *t <= 0.0);
            let has_area = turns.iter().any(|t| *t != 0.0);
            if is_in && has_area {
                values[frame.index(column, row)] = 1.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_l_shaped_roof_covers_its_arms_and_not_its_yard() {
        // Two rectangles: 10 x 2 along x, 2 x 6 along y, both from the origin.
        let rectangle = |width: f32, depth: f32| Mesh {
            positions: vec![
                [0.0, 0.0, 3.0],
                [width, 0.0, 3.0],
                [width, depth, 3.0],
                [0.0, depth, 4.0],
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let wood = vec![rectangle(10.0, 2.0), rectangle(2.0, 6.0)];
        let image = of(&PlantModel { wood, ..PlantModel::default() });
        let frame = image.frame.unwrap();
        let at = |x: f64, y: f64| {
            let (column, row) = frame.cell_at(x, y).unwrap();
            image.values[frame.index(column, row)]
        };
        assert_eq!([at(9.0, 1.0), at(1.0, 5.0), at(5.0, 3.0)], [1.0, 1.0, 0.0]);
        let area = image.values.iter().sum::<f32>() as f64 * frame.cell_area();
        // Pixels are 2 cm wide, and 32 m of rim are rounded to them.
        assert!((area - 28.0).abs() < 0.32, "{area}");
    }

    #[test]
    fn a_wall_without_roof_covers_nothing() {
        let wall = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 2.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let image = of(&PlantModel { wood: vec![wall], ..PlantModel::default() });
        assert!(image.values.iter().all(|value| *value == 0.0));
        assert_eq!(of(&PlantModel::default()).values, [0.0]);
    }
}
