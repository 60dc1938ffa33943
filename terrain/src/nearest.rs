//! The nearest marked cell of every cell, exactly, in two sweeps [Felzenszwalb12].

use rayon::prelude::*;

/// No cell is marked.
pub const NONE: u32 = u32::MAX;

/// For every cell the index of the nearest marked one, [`NONE`] if there is none at all.
///
/// Distances are between centres; of equally near cells one is chosen the same way each time.
pub fn nearest_marked(width: usize, height: usize, marked: &[bool]) -> Vec<u32> {
    let vertical = nearest_rows(width, height, marked);
    let mut nearest = vec![NONE; width * height];
    nearest.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        let rows = &vertical[row * width..][..width];
        sweep_row(row, rows, line);
    });
    nearest
}

/// For every cell the row of the nearest marked cell in its column, or [`NONE`].
fn nearest_rows(width: usize, height: usize, marked: &[bool]) -> Vec<u32> {
    let mut rows = vec![NONE; width * height];
    for row in 0..height {
        for column in 0..width {
            let i = row * width + column;
            rows[i] = match (marked[i], row) {
                (true, _) => row as u32,
                (false, 0) => NONE,
                (false, _) => rows[i - width],
            };
        }
    }
    for row in (0..height.saturating_sub(1)).rev() {
        for column in 0..width {
            let i = row * width + column;
            let (above, below) = (rows[i], rows[i + width]);
            let distance = |from: u32| (from != NONE).then(|| from.abs_diff(row as u32));
            let is_nearer = match (distance(below), distance(above)) {
                (Some(below), Some(above)) => below < above,
                (Some(_), None) => true,
                _ => false,
            };
            if is_nearer {
                rows[i] = below;
            }
        }
    }
    rows
}

/// Lower envelope of the parabolas `(x - column)² + (row - rows[column])²` along one row.
fn sweep_row(row: usize, rows: &[u32], nearest: &mut [u32]) {
    let width = rows.len();
    // Columns of the envelope's parabolas, and where each begins to be lowest.
    let (mut columns, mut starts): (Vec<usize>, Vec<f64>) = (Vec::new(), Vec::new());
    let height_of = |column: usize| {
        let rise = f64::from(rows[column]) - row as f64;
        rise * rise + (column * column) as f64
    };
    for column in (0..width).filter(|&column| rows[column] != NONE) {
        let mut start = f64::NEG_INFINITY;
        while let (Some(&last), Some(&last_start)) = (columns.last(), starts.last()) {
            start = (height_of(column) - height_of(last)) / (2 * (column - last)) as f64;
            if start > last_start {
                break;
            }
            columns.pop();
            starts.pop();
            start = f64::NEG_INFINITY;
        }
        columns.push(column);
        starts.push(start);
    }
    let mut current = 0;
    for (x, out) in nearest.iter_mut().enumerate() {
        while starts.get(current + 1).is_some_and(|&start| start < x as f64) {
            current += 1;
        }
        if let Some(&column) = columns.get(current) {
            *out = rows[column] * width as u32 + column as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn the_nearest_cell_is_that_of_a_search_through_all() {
        for (index, share) in [(0, 0.002), (1, 0.02), (2, 0.3)] {
            let (width, height) = (37, 23);
            let mut stream = Seed(5).stream("marks", index);
            let mut marked: Vec<bool> =
                (0..width * height).map(|_| stream.unit() < share).collect();
            marked[400] = true;
            let nearest = nearest_marked(width, height, &marked);
            let squared = |a: usize, b: usize| {
                let dx = (a % width).abs_diff(b % width);
                let dy = (a / width).abs_diff(b / width);
                dx * dx + dy * dy
            };
            for (i, &found) in nearest.iter().enumerate() {
                let least = (0..marked.len()).filter(|&j| marked[j]).map(|j| squared(i, j)).min();
                assert!(marked[found as usize]);
                assert_eq!(Some(squared(i, found as usize)), least);
            }
        }
    }

    #[test]
    fn without_marks_there_is_no_nearest() {
        assert!(nearest_marked(4, 3, &[false; 12]).iter().all(|&i| i == NONE));
    }
}
