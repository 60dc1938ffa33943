//! Textures of bark and leaves, made from noise and from the pattern of veins.
//!
//! A texture holds shades, not colours: the material's own reflectance is divided by the mean of
//! the texture, so that a painted plant reflects as much light as a plain one. All textures
//! repeat without a seam: their noise lives on a lattice that closes on itself.

use libm::{cosf, expf, powf};
use std::f32::consts::TAU;
use weald_contract::plant_model::{linear, srgb};
use weald_contract::{Material, Paint, Surface, Texture, seed, table, words};

words! {
    /// How bark looks.
    pub enum Pattern {
        /// Nearly even, as of beeches.
        Smooth = "smooth",
        /// Long ridges with dark furrows between them, as of oaks and willows.
        Furrowed = "furrowed",
        /// Plates between cracks, as of pines and old larches.
        Plated = "plated",
        /// Even and pale with dark dashes across, as of birches and aspens.
        Lenticels = "lenticels",
        /// Rings of old leaf bases, as of palms and horsetails.
        Ringed = "ringed",
        /// Fine lengthwise lines, as of reeds and herbs.
        Striped = "striped",
    }
}

words! {
    /// How the veins of a leaf run.
    pub enum Veins {
        /// None to be seen.
        None = "none",
        /// A midrib with side veins.
        Pinnate = "pinnate",
        /// Several main veins from the foot.
        Palmate = "palmate",
        /// Many veins along the blade, as of grasses.
        Parallel = "parallel",
    }
}

table! {
    /// The pattern of bark or stems.
    pub struct Bark {
        /// How it looks.
        pattern: Pattern = Pattern::Furrowed;
        /// What one copy of it covers around and along the stem, m.
        size: [f32; 2] = [0.5, 1.0], in 0.001..=50.0;
        /// How dark its darkest parts are, 0 to 1.
        contrast: f32 = 0.6, in 0.0..=1.0;
    }
}

/// Texels across and along a texture of bark.
const BARK: [u32; 2] = [96, 192];

/// Texels across and along a texture of a leaf.
const LEAF: [u32; 2] = [64, 96];

/// Shades of one copy of a pattern of bark.
pub fn bark(pattern: Pattern, contrast: f32) -> Texture {
    let shade = |u: f32, v: f32| match pattern {
        Pattern::Smooth => 1.0 - 0.35 * contrast * turbulence(u, v, [3, 4], 4, 1),
        Pattern::Furrowed => furrowed(u, v, contrast),
        Pattern::Plated => plated(u, v, contrast),
        Pattern::Lenticels => lenticels(u, v, contrast),
        Pattern::Ringed => ringed(u, v, contrast),
        Pattern::Striped => 1.0 - 0.6 * contrast * turbulence(u, v, [24, 2], 3, 6),
    };
    drawn("bark", BARK, |u, v| [shade(u, v); 3])
}

/// Ridges that part and join again: lengthwise stripes bent by noise, dark where they meet.
fn furrowed(u: f32, v: f32, contrast: f32) -> f32 {
    let bend = 0.6 * (noise(u, v, [3, 5], 2) - 0.5) + 0.25 * (noise(u, v, [6, 12], 3) - 0.5);
    let ridge = 0.5 + 0.5 * cosf(TAU * (7.0 * u + 4.0 * bend));
    let broken = turbulence(u, v, [14, 9], 3, 4);
    let furrow = powf(1.0 - ridge, 2.0) * (0.5 + broken);
    let grain = turbulence(u, v, [24, 12], 3, 5);
    1.0 - contrast * (0.75 * furrow.min(1.0) + 0.3 * grain).min(0.95)
}

/// Plates: cells of a bent lattice, dark where two are equally near [Worley96].
fn plated(u: f32, v: f32, contrast: f32) -> f32 {
    let bend = 0.05 * (noise(u, v, [8, 12], 7) - 0.5);
    let [first, second] = nearest_cells(u + bend, v + bend, [5, 8], 8);
    let crack = expf(-14.0 * (second - first));
    let tone = 0.4 * turbulence(u, v, [12, 20], 3, 9);
    1.0 - contrast * (0.9 * crack + tone).min(0.95)
}

/// Pale bark with dashes: short dark lenses across the stem at chance places.
fn lenticels(u: f32, v: f32, contrast: f32) -> f32 {
    const ROWS: u32 = 22;
    let row = (v * ROWS as f32) as u32 % ROWS;
    let mut dark = 0.0_f32;
    for neighbor in [row + ROWS - 1, row, row + 1] {
        let row = neighbor % ROWS;
        let centre =
            [chance(row, 0, 11), (row as f32 + 0.2 + 0.6 * chance(row, 1, 11)) / ROWS as f32];
        let length = 0.02 + 0.10 * powf(chance(row, 2, 11), 2.0);
        let (x, y) = (apart(u, centre[0]) / length, apart(v, centre[1]) * 260.0);
        dark = dark.max(expf(-x * x - y * y));
    }
    let peel = turbulence(u, v, [3, 26], 3, 12);
    1.0 - contrast * (0.85 * dark + 0.35 * peel).min(0.95)
}

/// Rings of leaf bases with a ragged lower rim.
fn ringed(u: f32, v: f32, contrast: f32) -> f32 {
    const RINGS: f32 = 9.0;
    let ragged = 0.25 * (noise(u, v, [9, 9], 13) - 0.5);
    let place = v * RINGS + ragged;
    let within = place - libm::floorf(place);
    let fibre = turbulence(u, v, [28, 6], 2, 14);
    1.0 - contrast * (0.8 * powf(1.0 - within, 6.0) + 0.3 * fibre).min(0.95)
}

/// Shades of a leaf: veins a little lighter than the flesh, the flesh mottled.
pub fn leaf(veins: Veins) -> Texture {
    drawn("leaf", LEAF, |u, v| {
        let across = (2.0 * u - 1.0).abs();
        let mottle = 0.16 * turbulence(u, v, [6, 9], 3, 21);
        let vein = vein(veins, across, v);
        // Veins hold less green: more red light comes back than green.
        let flesh = 0.80 - mottle;
        [flesh + 0.20 * vein, flesh + 0.17 * vein, flesh + 0.12 * vein]
    })
}

/// How much of a vein there is at `across` (0 midrib, 1 margin) and `along` the leaf.
fn vein(veins: Veins, across: f32, along: f32) -> f32 {
    let line = |distance: f32, width: f32| expf(-(distance / width) * (distance / width));
    let midrib = line(across, 0.035 + 0.03 * (1.0 - along));
    let side = |count: f32, rise: f32| {
        // Side veins leave the midrib at intervals and rise towards the margin.
        let place = (along - rise * powf(across, 0.85)) * count;
        let off = (place - libm::roundf(place)).abs() / count;
        0.7 * line(off, 0.010) * (1.0 - across * across)
    };
    let fan = |count: i32| {
        let angle = libm::atan2f(across, along.max(1e-3));
        let spread = (0..count).map(|i| (angle - 0.42 * i as f32).abs());
        line(spread.fold(f32::INFINITY, f32::min) * along.max(0.05), 0.03)
    };
    match veins {
        Veins::None => 0.0,
        Veins::Pinnate => midrib.max(side(9.0, 0.28)),
        Veins::Palmate => fan(4).max(side(6.0, 0.4) * 0.6),
        Veins::Parallel => 0.5 + 0.5 * cosf(TAU * 5.5 * across),
    }
}

/// Shades the materials of a plant: opaque ones with bark, sheets with veins.
///
/// Materials that have a texture already keep it. Reflectance and transmittance are raised by
/// what the texture takes away, as far as they stay below 1.
pub fn paint(
    materials: &mut [Material],
    textures: &mut Vec<Texture>,
    bark: Option<&Bark>,
    veins: Veins,
) {
    let mut place = [None; 2];
    for material in materials.iter_mut().filter(|material| material.paint.is_none()) {
        let (slot, size) = match (&material.surface, bark) {
            (Surface::Opaque, Some(bark)) if material.name.starts_with("bark") => (0, bark.size),
            (Surface::Leaf { .. }, _) if veins != Veins::None && is_green(material) => {
                (1, [1.0; 2])
            }
            _ => continue,
        };
        let index = *place[slot].get_or_insert_with(|| {
            textures.push(match (slot, bark) {
                (0, Some(found)) => self::bark(found.pattern, found.contrast),
                _ => leaf(veins),
            });
            textures.len() as u32 - 1
        });
        let mean = mean(&textures[index as usize]);
        shade(material, mean);
        material.paint = Some(Paint { texture: index, size });
    }
}

/// Leaves have veins, petals have not.
fn is_green(material: &Material) -> bool {
    material.name.starts_with("leaf")
}

/// Raises a material's colours by what a texture of this mean takes away.
fn shade(material: &mut Material, mean: [f32; 3]) {
    let brightest = |rgb: &[f32; 3]| rgb.iter().copied().fold(0.0, f32::max);
    let through = match &material.surface {
        Surface::Leaf { transmittance } => *transmittance,
        _ => [0.0; 3],
    };
    let sums: [f32; 3] =
        std::array::from_fn(|c| (material.reflectance[c] + through[c]) / mean[c].max(0.05));
    // A texel of 1 must not give back more light than it receives.
    let dim = (0.95 / brightest(&sums).max(1e-6)).min(1.0);
    let raise = |rgb: &mut [f32; 3]| {
        for (value, mean) in rgb.iter_mut().zip(mean) {
            *value *= dim / mean.max(0.05);
        }
    };
    raise(&mut material.reflectance);
    if let Surface::Leaf { transmittance } = &mut material.surface {
        raise(transmittance);
    }
}

/// Mean linear colour of a texture.
pub fn mean(texture: &Texture) -> [f32; 3] {
    let mut sums = [0.0_f64; 3];
    for texel in &texture.texels {
        for (sum, code) in sums.iter_mut().zip(texel) {
            *sum += f64::from(linear(*code));
        }
    }
    sums.map(|sum| (sum / texture.texels.len().max(1) as f64) as f32)
}

/// A texture whose texels are a function of their middles in [0, 1).
fn drawn(name: &str, [width, height]: [u32; 2], at: impl Fn(f32, f32) -> [f32; 3]) -> Texture {
    let mut texels = Vec::with_capacity((width * height) as usize);
    for row in 0..height {
        for column in 0..width {
            let u = (column as f32 + 0.5) / width as f32;
            let v = (row as f32 + 0.5) / height as f32;
            // In steps of 4: what nobody sees need not be stored.
            let [r, g, b] = at(u, v).map(|value| srgb(value) & !3 | 2);
            texels.push([r, g, b, 255]);
        }
    }
    Texture { name: name.into(), width, height, texels }
}

/// Distance of two places on a circle of length 1.
fn apart(a: f32, b: f32) -> f32 {
    let distance = (a - b).abs();
    distance.min((1.0 - distance).abs())
}

/// A chance in [0, 1) that belongs to a lattice point.
fn chance(x: u32, y: u32, salt: u32) -> f32 {
    let mixed = seed::mix(u64::from(x) << 40 ^ u64::from(y) << 16 ^ u64::from(salt));
    (mixed >> 40) as f32 / (1_u64 << 24) as f32
}

/// Smooth noise in [0, 1] on a lattice of so many points around the texture.
fn noise(u: f32, v: f32, [across, along]: [u32; 2], salt: u32) -> f32 {
    let split = |coordinate: f32, count: u32| {
        let place = (coordinate - libm::floorf(coordinate)) * count as f32;
        let cell = (place as u32).min(count - 1);
        let t = place - cell as f32;
        (cell, (cell + 1) % count, t * t * (3.0 - 2.0 * t))
    };
    let ((x0, x1, s), (y0, y1, t)) = (split(u, across), split(v, along));
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let low = mix(chance(x0, y0, salt), chance(x1, y0, salt), s);
    let high = mix(chance(x0, y1, salt), chance(x1, y1, salt), s);
    mix(low, high, t)
}

/// Noise at doubled frequencies and halved strengths, in [0, 1].
fn turbulence(u: f32, v: f32, [across, along]: [u32; 2], octaves: u32, salt: u32) -> f32 {
    let (mut sum, mut weight, mut all) = (0.0, 1.0, 0.0);
    for octave in 0..octaves {
        let lattice = [across << octave, along << octave];
        sum += weight * noise(u, v, lattice, salt + 100 * octave);
        all += weight;
        weight *= 0.5;
    }
    sum / all
}

/// Distances to the nearest and second nearest of points spread one a cell, in cells.
fn nearest_cells(u: f32, v: f32, [across, along]: [u32; 2], salt: u32) -> [f32; 2] {
    let place = [u * across as f32, v * along as f32].map(|p| p + 2.0 * across.max(along) as f32);
    let mut found = [f32::INFINITY; 2];
    for dy in 0..3_u32 {
        for dx in 0..3_u32 {
            let (x, y) = (place[0] as u32 + dx - 1, place[1] as u32 + dy - 1);
            let wrapped = [x % across, y % along];
            let point = [0, 1].map(|axis| chance(wrapped[0], wrapped[1], salt + 1000 * axis));
            let (far_x, far_y) = (x as f32 + point[0] - place[0], y as f32 + point[1] - place[1]);
            let distance = (far_x * far_x + far_y * far_y).sqrt();
            if distance < found[0] {
                found = [distance, found[0]];
            } else if distance < found[1] {
                found[1] = distance;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERNS: [Pattern; 6] = [
        Pattern::Smooth,
        Pattern::Furrowed,
        Pattern::Plated,
        Pattern::Lenticels,
        Pattern::Ringed,
        Pattern::Striped,
    ];

    #[test]
    fn textures_meet_their_own_edges() {
        for texture in PATTERNS.map(|pattern| bark(pattern, 0.8)) {
            let (w, h) = (texture.width as usize, texture.height as usize);
            let red = |x: usize, y: usize| f32::from(texture.texels[y * w + x][0]);
            let step = |pairs: &mut dyn Iterator<Item = (f32, f32)>| {
                let steps: Vec<f32> = pairs.map(|(a, b)| (a - b).abs()).collect();
                steps.iter().sum::<f32>() / steps.len() as f32
            };
            // Across the seam neighbours differ about as much as anywhere.
            let seam = step(&mut (0..h).map(|y| (red(w - 1, y), red(0, y))));
            let inside = step(&mut (0..h).map(|y| (red(w / 2, y), red(w / 2 + 1, y))));
            assert!(seam < 3.0 * inside + 6.0, "{seam} {inside}");
            let seam = step(&mut (0..w).map(|x| (red(x, h - 1), red(x, 0))));
            assert!(seam < 60.0, "{seam}");
        }
    }

    #[test]
    fn bark_is_darker_with_more_contrast_but_never_black() {
        for pattern in PATTERNS {
            let shades = [0.1, 0.5, 1.0].map(|contrast| mean(&bark(pattern, contrast))[0]);
            assert!(shades.windows(2).all(|pair| pair[0] > pair[1]), "{pattern:?} {shades:?}");
            assert!(shades[2] > 0.15, "{pattern:?} {shades:?}");
        }
    }

    #[test]
    fn a_painted_material_reflects_as_much_as_a_plain_one() {
        let plain = crate::material::opaque("bark-0", [0.2, 0.15, 0.1]);
        let (mut materials, mut textures) = (vec![plain.clone()], Vec::new());
        let look = Bark { pattern: Pattern::Furrowed, size: [0.4, 0.8], contrast: 0.7 };
        paint(&mut materials, &mut textures, Some(&look), Veins::None);
        let shade = mean(&textures[0]);
        let seen = materials[0].reflectance.iter().zip(shade).map(|(r, s)| r * s);
        assert!(seen.zip(plain.reflectance).all(|(seen, plain)| (seen - plain).abs() < 1e-4));
        assert_eq!(materials[0].paint, Some(Paint { texture: 0, size: [0.4, 0.8] }));
    }

    #[test]
    fn the_midrib_is_lighter_than_the_flesh_beside_it() {
        let texture = leaf(Veins::Pinnate);
        let middle = texture.at(0.5, 0.5)[1];
        assert!(middle > texture.at(0.62, 0.47)[1] && middle > texture.at(0.38, 0.53)[1]);
    }
}
