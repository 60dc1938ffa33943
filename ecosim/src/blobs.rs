//! Dot images: every dark blob on light paper is one plant.

use weald_contract::Image;

/// A pixel darker than this belongs to a blob.
const DARK: f32 = 0.5;

/// Returns the middle of each blob as a part of the image's width and height, from its west and
/// south edges, in the order of the blobs' first pixels.
///
/// Pixels that touch at a side or a corner belong to one blob.
pub(crate) fn middles(image: &Image) -> Vec<[f64; 2]> {
    let (width, height) = (image.width, image.height);
    let mut is_open: Vec<bool> = image.values.iter().map(|value| *value < DARK).collect();
    let mut middles = Vec::new();
    let mut reached = Vec::new();
    for first in 0..is_open.len() {
        if !std::mem::take(&mut is_open[first]) {
            continue;
        }
        reached.push(first);
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        while let Some(pixel) = reached.pop() {
            let (column, row) = (pixel % width, pixel / width);
            sum = [sum[0] + column as f64 + 0.5, sum[1] + row as f64 + 0.5];
            count += 1.0;
            for r in row.saturating_sub(1)..(row + 2).min(height) {
                for c in column.saturating_sub(1)..(column + 2).min(width) {
                    if std::mem::take(&mut is_open[r * width + c]) {
                        reached.push(r * width + c);
                    }
                }
            }
        }
        let [x, y] = [sum[0] / count / width as f64, sum[1] / count / height as f64];
        middles.push([x, 1.0 - y]);
    }
    middles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_blob_is_one_plant_in_its_middle() {
        let rows = [
            "##......", //
            "##...#..", "......#.", "........", ".####...",
        ];
        let values = rows.concat().bytes().map(|b| if b == b'#' { 0.0 } else { 1.0 }).collect();
        let image = Image { width: 8, height: 5, values, is_float: false, frame: None };
        let middles = middles(&image);
        assert_eq!(middles.len(), 3);
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-12;
        assert!(near(middles[0], [1.0 / 8.0, 1.0 - 1.0 / 5.0]));
        // Two pixels that touch at a corner.
        assert!(near(middles[1], [6.0 / 8.0, 1.0 - 2.0 / 5.0]));
        assert!(near(middles[2], [3.0 / 8.0, 1.0 - 4.5 / 5.0]));
    }
}
