//! Painted surfaces: what colour a place on a triangle has, and whether the surface is there.
//!
//! A texture is kept as a pyramid of ever smaller copies [Williams83]; rays carry the width of
//! the cone that they stand for [Akenine19] and read the copies whose texels are as wide. Where a
//! material is cut out, each chart has a map of 16 × 16 cells that says where the surface is all
//! there or not there at all, so that rays read texels only along outlines [Gruen20].

use crate::accel::Place;
use glam::Vec3;
use std::collections::BTreeMap;
use std::sync::LazyLock;
use weald_contract::Texture;
use weald_contract::plant_model::{linear, srgb};

/// Linear light of each sRGB code.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| linear(code as u8)));

/// Texture coordinates at the corners of a triangle, in copies of the texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Chart {
    /// u and v of each corner.
    pub corners: [[f32; 2]; 3],
    /// Index into [`Paints::outlines`], or [`NO_OUTLINE`].
    pub outline: u32,
}

/// Most charts that faces can name.
pub(crate) const MOST_CHARTS: usize = (1 << 31) - 2;

/// Value of [`Chart::outline`] where nothing is cut out.
pub(crate) const NO_OUTLINE: u32 = u32::MAX;

/// Cells along a side of an outline's map.
const CELLS: usize = 16;

/// Where a chart is cut out.
#[derive(Clone, Debug)]
pub(crate) struct Outline {
    /// Two bits a cell of the square of barycentric weights `u` and `v`, rows along `v`.
    cells: [u32; CELLS],
    /// Index into [`Paints::textures`].
    texture: u32,
    /// Coverage below which there is nothing.
    least: f32,
}

/// What a part of a surface is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Presence {
    /// Nothing of it is there.
    Absent,
    /// All of it is there.
    Whole,
    /// The texture must be asked.
    Mixed,
}

/// Everything that surfaces are painted with.
#[derive(Debug, Default)]
pub(crate) struct Paints {
    pub textures: Vec<Pyramid>,
    pub charts: Vec<Chart>,
    pub outlines: Vec<Outline>,
}

/// A texture in ever smaller copies.
#[derive(Debug)]
pub(crate) struct Pyramid {
    /// The texture itself first, a single texel last.
    levels: Vec<Copy>,
}

/// A texture at one size: sRGB and coverage.
#[derive(Debug)]
struct Copy {
    width: usize,
    height: usize,
    texels: Vec<[u8; 4]>,
}

impl Chart {
    /// Texture coordinates at barycentric weights of the second and third corner.
    pub fn at(&self, u: f32, v: f32) -> [f32; 2] {
        let [a, b, c] = self.corners;
        [0, 1].map(|i| a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i]))
    }

    /// Copies of the texture on the parallelogram of which the triangle is half.
    pub fn area(&self) -> f32 {
        let [a, b, c] = self.corners;
        ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
    }

    /// The same chart counted from another corner.
    fn turned(&self, by: usize) -> Self {
        Self { corners: [0, 1, 2].map(|i| self.corners[(by + i) % 3]), ..*self }
    }
}

/// The charts of one model while it is put together.
#[derive(Debug, Default)]
pub(crate) struct Charts {
    pub list: Vec<Chart>,
    /// Charts by the one that they are turned from, and by how much.
    turned: BTreeMap<(u32, usize), u32>,
}

impl Charts {
    /// The number of a chart counted from another corner.
    pub fn turn(&mut self, chart: u32, by: usize) -> u32 {
        if by == 0 {
            return chart;
        }
        *self.turned.entry((chart, by)).or_insert_with(|| {
            self.list.push(self.list[chart as usize].turned(by));
            self.list.len() as u32 - 1
        })
    }

    /// Whether a chart, drawn on beyond its second and third corner, has there what `other` has at
    /// its first, and both are one where they meet.
    pub fn continues(&self, chart: u32, other: u32) -> bool {
        let [chart, other] = [chart, other].map(|number| &self.list[number as usize]);
        let is_near = |a: [f32; 2], b: [f32; 2]| {
            // A thousandth of a copy is less than a texel of most textures.
            (a[0] - b[0]).abs() < 1e-3 && (a[1] - b[1]).abs() < 1e-3
        };
        let [_, b, c] = chart.corners;
        let [d, e, f] = other.corners;
        is_near(chart.at(1.0, 1.0), d) && is_near(e, c) && is_near(f, b)
    }
}

impl Outline {
    /// The outline of a chart where a texture's coverage is below `least`.
    pub fn new(chart: &Chart, textures: &[Pyramid], texture: u32, least: f32) -> Self {
        let pyramid = &textures[texture as usize];
        let mut cells = [0; CELLS];
        for (row, bits) in cells.iter_mut().enumerate() {
            for column in 0..CELLS {
                let at = |i: usize| i as f32 / CELLS as f32;
                let corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .map(|(x, y)| chart.at(at(column + x), at(row + y)));
                *bits |= (pyramid.presence(&corners, least) as u32) << (2 * column);
            }
        }
        Self { cells, texture, least }
    }

    /// What there is at barycentric weights.
    #[inline(always)]
    fn presence(&self, u: f32, v: f32) -> Presence {
        let cell = |weight: f32| ((weight * CELLS as f32) as usize).min(CELLS - 1);
        match self.cells[cell(v)] >> (2 * cell(u)) & 3 {
            0 => Presence::Absent,
            1 => Presence::Whole,
            _ => Presence::Mixed,
        }
    }

    /// Forgets the map, so that the texture is asked everywhere.
    #[cfg(test)]
    pub fn forget(&mut self) {
        self.cells = [0xaaaa_aaaa; CELLS];
    }

    /// What there is of a whole triangle, or of the parallelogram that it is half of.
    pub fn of_all(&self, is_half: bool) -> Presence {
        let mut counts = [0; 3];
        for row in 0..CELLS {
            let columns = if is_half { CELLS } else { CELLS - row };
            for column in 0..columns {
                counts[(self.cells[row] >> (2 * column) & 3) as usize] += 1;
            }
        }
        match counts {
            [_, 0, 0] => Presence::Absent,
            [0, _, 0] => Presence::Whole,
            _ => Presence::Mixed,
        }
    }
}

impl Paints {
    /// Whether the surface is there at a place on a chart.
    #[inline]
    pub fn is_there(&self, chart: u32, u: f32, v: f32) -> bool {
        let chart = &self.charts[chart as usize];
        let Some(outline) = self.outlines.get(chart.outline as usize) else { return true };
        match outline.presence(u, v) {
            Presence::Absent => false,
            Presence::Whole => true,
            Presence::Mixed => {
                let pyramid = &self.textures[outline.texture as usize];
                pyramid.coverage(chart.at(u, v)) >= outline.least
            }
        }
    }

    /// Linear colour of a texture at a place, seen through a window of a width, m; white where the
    /// place lies on no chart.
    pub fn color(&self, texture: u32, place: &Place, width: f32) -> Vec3 {
        let Some(chart) = place.face.chart() else { return Vec3::ONE };
        let (pyramid, chart) = (&self.textures[texture as usize], &self.charts[chart as usize]);
        // Texels a metre, from areas: mean of both directions.
        let texels = chart.area() * pyramid.texel_count() as f32;
        let density = (texels / place.area.max(f32::MIN_POSITIVE)).sqrt();
        let [u, v] = place.weights;
        pyramid.color(chart.at(u, v), width * density)
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> u64 {
        let texels: usize = self.textures.iter().map(Pyramid::bytes).sum();
        (texels + size_of_val(&self.charts[..]) + size_of_val(&self.outlines[..])) as u64
    }
}

impl Pyramid {
    /// A pyramid over a sound texture. Where the surface can be cut out, uncovered texels take
    /// the colour of covered ones around, which would else show along outlines.
    pub fn new(texture: &Texture, is_cut_out: bool) -> Self {
        let first = Copy {
            width: texture.width as usize,
            height: texture.height as usize,
            texels: texture.texels.clone(),
        };
        let mut levels = vec![first];
        while let Some(last) = levels.last()
            && last.texels.len() > 1
        {
            levels.push(last.halved(is_cut_out));
        }
        if is_cut_out {
            for coarse in (1..levels.len()).rev() {
                let (fine, coarse) = levels.split_at_mut(coarse);
                if let (Some(fine), Some(coarse)) = (fine.last_mut(), coarse.first()) {
                    fine.fill_from(coarse);
                }
            }
        }
        Self { levels }
    }

    /// The texture itself: columns, rows and linear colours.
    pub fn linear(&self) -> (usize, usize, Vec<Vec3>) {
        let Copy { width, height, texels } = &self.levels[0];
        (*width, *height, texels.iter().copied().map(decoded).collect())
    }

    /// Where coverage is at least `least`, `times` as fine as the texture: columns, rows, and row by
    /// row whether there is anything.
    pub fn opacity(&self, least: f32, times: usize) -> (usize, usize, Vec<bool>) {
        let Copy { width, height, .. } = self.levels[0];
        let (width, height) = (width * times, height * times);
        let is_there = |i: usize| {
            let middle = |at: usize, count: usize| (at as f32 + 0.5) / count as f32;
            self.coverage([middle(i % width, width), middle(i / width, height)]) >= least
        };
        (width, height, (0..width * height).map(is_there).collect())
    }

    /// Texels of the texture itself.
    pub fn texel_count(&self) -> usize {
        self.levels[0].texels.len()
    }

    /// Linear colour at a place, seen through a window as wide as `texels` texels.
    pub fn color(&self, at: [f32; 2], texels: f32) -> Vec3 {
        let top = (self.levels.len() - 1) as f32;
        let level = libm::log2f(texels.max(1.0)).min(top);
        let (low, part) = (level as usize, level.fract());
        let color = self.levels[low].color(at);
        match self.levels.get(low + 1) {
            Some(above) if part > 0.0 => color.lerp(above.color(at), part),
            _ => color,
        }
    }

    /// Coverage at a place, in [0, 1].
    fn coverage(&self, at: [f32; 2]) -> f32 {
        self.levels[0].mix(at, |texel| f32::from(texel[3])) / 255.0
    }

    /// What there is between four places that span a parallelogram.
    fn presence(&self, corners: &[[f32; 2]; 4], least: f32) -> Presence {
        let copy = &self.levels[0];
        // Texels that bilinear interpolation reads anywhere inside.
        let range = |axis: usize, count: usize| {
            let along = corners.map(|corner| corner[axis] * count as f32 - 0.5);
            let low = along.into_iter().fold(f32::INFINITY, f32::min).floor();
            let high = along.into_iter().fold(f32::NEG_INFINITY, f32::max).floor() + 1.0;
            let is_part = high - low < count as f32;
            if is_part { low as i64..=high as i64 } else { 0..=count as i64 - 1 }
        };
        let (mut is_some, mut is_none) = (false, false);
        for row in range(1, copy.height) {
            for column in range(0, copy.width) {
                let texel = copy.texel(column, row);
                let is_there = f32::from(texel[3]) / 255.0 >= least;
                is_some |= is_there;
                is_none |= !is_there;
            }
            if is_some && is_none {
                return Presence::Mixed;
            }
        }
        if is_none { Presence::Absent } else { Presence::Whole }
    }

    fn bytes(&self) -> usize {
        self.levels.iter().map(|level| size_of_val(&level.texels[..])).sum()
    }
}

impl Copy {
    /// A texel, counted in repeated copies.
    fn texel(&self, column: i64, row: i64) -> [u8; 4] {
        let column = column.rem_euclid(self.width as i64) as usize;
        let row = row.rem_euclid(self.height as i64) as usize;
        self.texels[row * self.width + column]
    }

    /// Bilinear mean of something of the four texels around a place.
    #[inline]
    fn mix<T>(&self, at: [f32; 2], of: impl Fn([u8; 4]) -> T) -> T
    where
        T: std::ops::Add<Output = T> + std::ops::Mul<f32, Output = T>,
    {
        // Whole copies go first: what is left keeps its digits. A copy is never 1 itself.
        let place = |coordinate: f32, count: usize| {
            let x = (coordinate - coordinate.floor()) * count as f32 - 0.5;
            let low = x.floor();
            let wrap = |i: i64| if i < 0 { count - 1 } else { i as usize % count };
            (wrap(low as i64), wrap(low as i64 + 1), x - low)
        };
        let (left, right, across) = place(at[0], self.width);
        let (top, bottom, down) = place(at[1], self.height);
        let texel = |column: usize, row: usize| of(self.texels[row * self.width + column]);
        let line = |row| texel(left, row) * (1.0 - across) + texel(right, row) * across;
        line(top) * (1.0 - down) + line(bottom) * down
    }

    fn color(&self, at: [f32; 2]) -> Vec3 {
        if let [texel] = self.texels[..] {
            return decoded(texel);
        }
        self.mix(at, decoded)
    }

    /// A copy half as wide and high: each texel is the mean of what it covers, weighed by
    /// coverage where that counts.
    fn halved(&self, is_cut_out: bool) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let across = shares(self.width, width);
        let down = shares(self.height, height);
        let mut texels = Vec::with_capacity(width * height);
        for rows in &down {
            for columns in &across {
                let (mut color, mut weight, mut coverage) = (Vec3::ZERO, 0.0, 0.0);
                for &(row, high) in rows {
                    for &(column, wide) in columns {
                        let texel = self.texels[row * self.width + column];
                        let covered = f32::from(texel[3]) / 255.0;
                        let share = high * wide;
                        let part = if is_cut_out { share * covered } else { share };
                        color += part * decoded(texel);
                        weight += part;
                        coverage += share * covered;
                    }
                }
                let [r, g, b] = (color / f32::max(weight, f32::MIN_POSITIVE)).to_array().map(srgb);
                texels.push([r, g, b, (255.0 * coverage + 0.5) as u8]);
            }
        }
        Self { width, height, texels }
    }

    /// Gives uncovered texels the colour of a coarser copy.
    fn fill_from(&mut self, coarse: &Self) {
        let across = shares(self.width, coarse.width);
        let down = shares(self.height, coarse.height);
        for (coarse_row, rows) in down.iter().enumerate() {
            for (coarse_column, columns) in across.iter().enumerate() {
                let [r, g, b, _] = coarse.texels[coarse_row * coarse.width + coarse_column];
                for &(row, _) in rows {
                    for &(column, _) in columns {
                        let texel = &mut self.texels[row * self.width + column];
                        if texel[3] == 0 {
                            *texel = [r, g, b, 0];
                        }
                    }
                }
            }
        }
    }
}

fn decoded([r, g, b, _]: [u8; 4]) -> Vec3 {
    Vec3::from_array([r, g, b].map(|code| LINEAR[usize::from(code)]))
}

/// For each of `few` cells along a line, those of `many` that it covers, and the part of it that
/// each makes up.
fn shares(many: usize, few: usize) -> Vec<Vec<(usize, f32)>> {
    let wide = many as f64 / few as f64;
    let cell = |index: usize| {
        let (from, to) = (index as f64 * wide, (index + 1) as f64 * wide);
        let covered = from as usize..(to.ceil() as usize).min(many);
        covered
            .map(|i| {
                let part = to.min(i as f64 + 1.0) - from.max(i as f64);
                (i, (part / wide) as f32)
            })
            .filter(|&(_, part)| part > 1e-6)
            .collect()
    };
    (0..few).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    fn texture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Texture {
        let places = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        let texels = places.map(|(column, row)| texel(column, row)).collect();
        Texture { name: "t".into(), width, height, texels }
    }

    fn whole() -> Chart {
        Chart { corners: [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], outline: NO_OUTLINE }
    }

    #[test]
    fn texels_have_their_colour_at_their_middle_and_repeat() {
        let texture = texture(5, 3, |column, row| [50 * column as u8, 80 * row as u8, 7, 255]);
        let pyramid = Pyramid::new(&texture, false);
        for (column, row) in [(0, 0), (4, 2), (2, 1)] {
            let at = [(column as f32 + 0.5) / 5.0 - 3.0, (row as f32 + 0.5) / 3.0 + 2.0];
            let expected = Vec3::new(linear(50 * column), linear(80 * row), linear(7));
            assert!(pyramid.color(at, 1.0).abs_diff_eq(expected, 1e-4));
        }
        // Halfway between the last and the first column, at the seam.
        let seam = pyramid.color([1.0, 0.5 / 3.0], 0.3);
        assert!((seam.x - 0.5 * linear(200)).abs() < 1e-4, "{seam}");
    }

    #[test]
    fn every_copy_has_the_mean_of_the_texture() {
        let mut chance = Seed(3).stream("texels", 0);
        let noisy: Vec<u8> = (0..37 * 20).map(|_| (chance.unit() * 255.0) as u8).collect();
        let texture = texture(37, 20, |column, row| {
            let grey = noisy[(row * 37 + column) as usize];
            [grey, grey, 255 - grey, 255]
        });
        let pyramid = Pyramid::new(&texture, false);
        assert_eq!(pyramid.levels.len(), 6);
        let mean = |copy: &Copy| {
            copy.texels.iter().map(|&texel| decoded(texel)).sum::<Vec3>() / copy.texels.len() as f32
        };
        let all = mean(&pyramid.levels[0]);
        for copy in &pyramid.levels {
            // Codes of 8 bits round by up to a half.
            assert!(mean(copy).abs_diff_eq(all, 6e-3), "{} {all}", mean(copy));
        }
        // A window as wide as the texture, or wider, sees the mean.
        assert!(pyramid.color([0.3, 0.8], 1e9).abs_diff_eq(all, 6e-3));
    }

    #[test]
    fn uncovered_texels_lend_no_colour() {
        // A green leaf on a magenta ground that nobody should see.
        let texture = texture(16, 16, |column, row| {
            let is_leaf = (4..12).contains(&column) && (3..9).contains(&row);
            if is_leaf { [0, 200, 0, 255] } else { [255, 0, 255, 0] }
        });
        let pyramid = Pyramid::new(&texture, true);
        for copy in &pyramid.levels {
            assert!(copy.texels.iter().all(|texel| texel[0] < 2 && texel[1] > 198));
        }
        let coverage = |copy: &Copy| {
            copy.texels.iter().map(|texel| f32::from(texel[3])).sum::<f32>()
                / (255 * copy.texels.len()) as f32
        };
        assert!(pyramid.levels.iter().all(|copy| (coverage(copy) - 0.1875).abs() < 2e-3));
    }

    #[test]
    fn outlines_say_what_texels_would() {
        let mut chance = Seed(4).stream("outlines", 0);
        // A disc with a soft rim, on charts of any shape and size.
        let texture = texture(40, 40, |column, row| {
            let distance = (column as f32 - 20.0).hypot(row as f32 - 20.0);
            [9, 9, 9, (255.0 * (14.5 - distance).clamp(0.0, 1.0)) as u8]
        });
        let textures = vec![Pyramid::new(&texture, true)];
        for number in 0..40 {
            let size = if number == 0 { 0.0 } else { chance.range(0.1, 3.0) };
            let corners = [0; 3].map(|_| [0; 2].map(|_| (chance.range(-2.0, 2.0) * size) as f32));
            let chart = if number == 1 { whole() } else { Chart { corners, outline: 0 } };
            let outline = Outline::new(&chart, &textures, 0, 0.4);
            for _ in 0..500 {
                let (u, v) = (chance.unit() as f32, chance.unit() as f32);
                let truth = textures[0].coverage(chart.at(u, v)) >= 0.4;
                match outline.presence(u, v) {
                    Presence::Absent => assert!(!truth),
                    Presence::Whole => assert!(truth),
                    Presence::Mixed => {}
                }
            }
        }
        // A disc's rim is all that is left to look up: some 50 of 256 cells.
        let outline = Outline::new(&whole(), &textures, 0, 0.4);
        let is_mixed = |cell: usize| outline.cells[cell / CELLS] >> (2 * (cell % CELLS)) & 3 == 2;
        let mixed = (0..CELLS * CELLS).filter(|&cell| is_mixed(cell)).count();
        assert!((40..80).contains(&mixed), "{mixed}");
        assert_eq!(outline.of_all(true), Presence::Mixed);
    }

    #[test]
    fn charts_of_a_parallelogram_continue_each_other() {
        let first = whole();
        let second = Chart { corners: [[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]], outline: NO_OUTLINE };
        let mut charts = Charts { list: vec![first, second], ..Charts::default() };
        assert!(charts.continues(0, 1));
        let turned = charts.turn(1, 1);
        assert_eq!((turned, charts.turn(1, 1), charts.turn(1, 0)), (2, 2, 1));
        assert!(!charts.continues(0, turned));
        assert_eq!(charts.list[2].corners, [[0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]);
    }
}
