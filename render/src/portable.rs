//! The scene in plain data, for other renderers: what stands where, what it is made of, and the
//! light.
//!
//! Other renderers place meshes, but few place groups of groups, and none varies a colour from
//! plant to plant as ours does. So the tree of levels becomes one level of *pieces* and *places*:
//! a group is either made one mesh, or opened into places of what it holds, whichever takes less
//! memory there. Colours come finished: textures linear, the ground as a picture, materials with
//! the mean of their variation.

use crate::accel::{Content, Instance, Triangle};
use crate::bsdf::Material;
use crate::camera::{Camera, Filter};
use crate::ground::WATER_MATERIAL;
use crate::scene::{Scene, WATER_LEVEL};
use crate::{Config, Error, path, water};
use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use weald_contract::{Mesh, Picture, Projection, View};

/// Memory that other renderers take for a place, bytes: Mitsuba 3.9 took 2,700.
const PLACE_BYTES: u128 = 2700;

/// Memory that they take for a triangle with its vertices and its part of a tree, bytes.
const TRIANGLE_BYTES: u128 = 120;

/// Most places: more would take a hundred gigabytes elsewhere.
const MOST_PLACES: u64 = 40_000_000;

/// Ground around the terrain that is painted as finely as the terrain itself, m: its last vertices
/// stand at this distance, and colours of the surroundings begin nearer.
const MARGIN: f32 = 30.0;

/// Width of a texel of the ground where memory allows, m: that of its crumbs of soil.
const TEXEL: f32 = 0.03;

/// Most texels along a side of a picture of the ground.
const MOST_TEXELS: usize = 4096;

/// Most samples along a side of such a texel.
const MOST_SAMPLES: usize = 3;

/// Cosine of the way under water of a glance from the bank.
const GLANCE: f32 = 0.8;

/// A scene in plain data. Lengths are metres in scene-local coordinates: east, north and up of the
/// terrain's south-west corner at its lowest whole metre.
pub struct Portable<'a> {
    scene: &'a Scene,
    /// Levels of the pieces.
    levels: Vec<u32>,
    /// Where the pieces stand.
    pub places: Vec<Place>,
    /// What surfaces are made of; meshes name them by index.
    pub finishes: Vec<Finish>,
}

/// A placement of a piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index of the piece.
    pub piece: usize,
    /// The matrix that takes points of the piece to the scene, row by row: turn and scale in the
    /// first three columns, position in the fourth.
    pub scene_from_piece: [[f32; 4]; 3],
}

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Finish {
    /// Species and number, or what it is.
    pub name: String,
    /// Diffuse reflectance, linear Rec. 709, with the mean of its variation.
    pub reflectance: [f32; 3],
    /// Diffuse transmittance.
    pub transmittance: [f32; 3],
    /// Radiance of its own, kcd/m².
    pub emission: [f32; 3],
    /// The glossy coat, if it has one.
    pub coat: Option<Gloss>,
    /// What its colours are multiplied by, or come from.
    pub paint: Painted,
}

/// A dielectric coat of refractive index 1.5 over a diffuse surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gloss {
    /// Roughness of its GGX microfacets.
    pub alpha: f32,
    /// Part of diffuse light from above that it reflects; as much less reaches what lies below.
    pub albedo: f32,
    /// How much of that loss goes with the angle as that of a smooth coat does; the rest is the same
    /// at all angles.
    pub fading: f32,
}

/// Where the colours of a [`Finish`] come from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Painted {
    /// They are the same everywhere.
    Plain,
    /// They are multiplied by a texture; where its coverage is below `cutout`, there is nothing.
    Texture {
        /// For [`Portable::texture`] and [`Portable::opacity`].
        texture: u32,
        /// Least coverage.
        cutout: Option<f32>,
    },
    /// They are those of [`Portable::ground`].
    Ground(Reach),
    /// They are those of [`Portable::water`], below a surface of refractive index 1.333 with waves
    /// of this roughness.
    Water {
        /// Roughness of a Beckmann distribution with the slopes of the ripples.
        alpha: f32,
    },
}

/// A part of the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// The terrain and a little around it.
    Near,
    /// The land beyond.
    Far,
}

/// The sun, if it shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Unit vector towards its middle.
    pub direction: [f32; 3],
    /// Radiance of its disc, kcd/m².
    pub radiance: [f32; 3],
    /// Half its apparent diameter, radians.
    pub radius: f64,
}

/// The eye of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// How directions become a picture.
    pub projection: Projection,
    /// Where it is.
    pub position: [f32; 3],
    /// Unit vector towards what it looks at.
    pub forward: [f32; 3],
    /// Unit vector to the top of the picture.
    pub up: [f32; 3],
    /// Horizontal angle of view of a perspective, radians.
    pub fov: f32,
    /// Half the width of the picture of a view without foreshortening, m.
    pub half_width: f32,
    /// Radius of the lens, m; 0 is a pinhole.
    pub lens_radius: f32,
    /// Distance along `forward` of what is sharp, m.
    pub focus: f32,
    /// Standard deviation of the filter over a pixel, pixels.
    pub filter: f32,
}

impl Scene {
    /// The scene in plain data, with the mean of the variation that `config` asks for.
    ///
    /// # Errors
    /// It has more than forty million places, however its groups are opened.
    pub fn portable(&self, config: &Config) -> Result<Portable<'_>, Error> {
        let opened = self.opened();
        let mut numbers = vec![usize::MAX; self.levels.len()];
        let mut levels = Vec::new();
        let mut places = Vec::new();
        let mut place = |level: u32, pose: &Pose| {
            let number = &mut numbers[level as usize];
            if *number == usize::MAX {
                *number = levels.len();
                levels.push(level);
            }
            places.push(Place { piece: *number, scene_from_piece: pose.rows() });
        };
        if self.levels.count(WATER_LEVEL) > 0 {
            place(self.water, &Pose::HERE);
        }
        self.walk(self.solid, &Pose::HERE, &opened, &mut place);
        Portable { scene: self, levels, places, finishes: finishes(self, config.variation) }
            .checked()
    }

    /// Which levels are opened into places of what they hold.
    fn opened(&self) -> Vec<bool> {
        let mut opened = vec![false; self.levels.len()];
        // How often each level is placed, from the outermost in: what is placed comes earlier.
        let mut counts = vec![0u128; self.levels.len()];
        counts[self.solid as usize] = 1;
        for level in (0..self.levels.len()).rev() {
            let Content::Group { instances, .. } = self.levels.content(level as u32) else {
                continue;
            };
            let count = counts[level];
            let apart = count * instances.len() as u128 * PLACE_BYTES;
            let as_one = self.levels.count(level as u32) * TRIANGLE_BYTES;
            opened[level] = level == self.solid as usize || apart < as_one;
            if opened[level] {
                instances.iter().for_each(|i| counts[i.level as usize] += count);
            }
        }
        opened
    }

    fn walk(&self, level: u32, pose: &Pose, opened: &[bool], place: &mut dyn FnMut(u32, &Pose)) {
        match self.levels.content(level) {
            Content::Group { instances, .. } if opened[level as usize] => {
                for instance in instances {
                    self.walk(instance.level, &pose.then(instance), opened, place);
                }
            }
            _ => place(level, pose),
        }
    }

    /// The eye of a view in a picture of a resolution.
    pub fn eye(&self, view: &View, config: &Config) -> Eye {
        let camera = path::camera(self, view, config);
        let Camera { eye, forward, projection, right, up, lens_radius, focus } = camera;
        Eye {
            projection,
            position: eye.to_array(),
            forward: forward.to_array(),
            up: up.normalize_or(Vec3::Z).to_array(),
            fov: 2.0 * libm::atanf(right.length()),
            half_width: right.length(),
            lens_radius,
            focus,
            filter: Filter::new().deviation(),
        }
    }
}

/// Where something is placed: scaled, turned, moved.
#[derive(Clone, Copy)]
struct Pose {
    turn: Quat,
    scale: f32,
    position: Vec3,
}

impl Pose {
    const HERE: Self = Self { turn: Quat::IDENTITY, scale: 1.0, position: Vec3::ZERO };

    /// The pose of what an instance places, where the instance itself stands in this one.
    fn then(&self, instance: &Instance) -> Self {
        let (turn, scale, position) = instance.pose();
        Self {
            turn: (self.turn * turn).normalize(),
            scale: self.scale * scale,
            position: self.position + self.turn * (self.scale * position),
        }
    }

    fn rows(&self) -> [[f32; 4]; 3] {
        let matrix = Mat3::from_quat(self.turn) * self.scale;
        [0, 1, 2].map(|axis| {
            let row = matrix.row(axis);
            [row.x, row.y, row.z, self.position[axis]]
        })
    }
}

/// Finishes of all materials, and after them that of the far ground.
fn finishes(scene: &Scene, variation: f32) -> Vec<Finish> {
    let finish = |(number, material): (usize, &Material)| {
        let mean = 1.0 - 0.5 * variation * material.variation;
        let is_water = number == usize::from(WATER_MATERIAL) && scene.colors.is_some();
        let paint = match material.texture {
            _ if material.is_ground => Painted::Ground(Reach::Near),
            _ if is_water => Painted::Water { alpha: scene.ripples.roughness() },
            Some(texture) => Painted::Texture { texture, cutout: scene.cutout(number) },
            None => Painted::Plain,
        };
        Finish {
            name: scene.material_names[number].clone(),
            reflectance: (material.reflectance * mean).to_array(),
            transmittance: (material.transmittance * mean).to_array(),
            emission: material.emission.to_array(),
            coat: crate::coat::Coat::new(material.roughness).map(|coat| Gloss {
                alpha: coat.alpha(),
                albedo: coat.mean_albedo(),
                fading: coat.fading().clamp(0.0, 1.0),
            }),
            paint,
        }
    };
    let mut finishes: Vec<Finish> = scene.materials.iter().enumerate().map(finish).collect();
    let ground = finishes.iter().find(|finish| finish.paint == Painted::Ground(Reach::Near));
    if let Some(ground) = ground.cloned() {
        let (name, paint) = ("land-beyond".to_string(), Painted::Ground(Reach::Far));
        finishes.push(Finish { name, paint, ..ground });
    }
    finishes
}

impl Portable<'_> {
    fn checked(self) -> Result<Self, Error> {
        let count = self.places.len();
        if count as u64 <= MOST_PLACES {
            return Ok(self);
        }
        let what = "places, for a renderer that knows no groups of groups".to_string();
        Err(Error::TooMany { what, count, limit: MOST_PLACES as usize })
    }

    /// Number of different things that are placed.
    pub fn piece_count(&self) -> usize {
        self.levels.len()
    }

    /// Number of triangles of a piece.
    pub fn triangle_count(&self, piece: usize) -> u64 {
        self.scene.levels.count(self.levels[piece]) as u64
    }

    /// The meshes of a piece, one for each finish that it has, in the order of finishes. Vertices
    /// that agree in all are one.
    ///
    /// Texture coordinates count copies of the texture; the second grows with the rows. Those of
    /// ground and water go over their picture, its north row first.
    pub fn meshes(&self, piece: usize) -> Vec<Mesh> {
        let levels = &self.scene.levels;
        let mut gathered: Vec<Gathered> = Vec::new();
        gathered.resize_with(self.finishes.len(), Gathered::default);
        for triangle in levels.triangles(self.levels[piece]) {
            self.gather(&triangle, &mut gathered);
        }
        let finished = gathered
            .into_iter()
            .zip(0..)
            .map(|(gathered, material)| Mesh { material, ..gathered.mesh });
        finished.filter(|mesh| !mesh.triangles.is_empty()).collect()
    }

    fn gather(&self, triangle: &Triangle, gathered: &mut [Gathered]) {
        let [a, b, c] = triangle.corners;
        let material = usize::from(triangle.face.material);
        let is_ground = self.finishes[material].paint == Painted::Ground(Reach::Near);
        let is_far = is_ground && !self.is_near([a, b, c]);
        let finish = if is_far { self.finishes.len() - 1 } else { material };
        let paint = self.finishes[finish].paint;
        let chart = triangle.face.chart().map(|n| &self.scene.levels.paints.charts[n as usize]);
        let vertex = |position: Vec3, u: f32, v: f32| {
            let uv = match (paint, chart) {
                (Painted::Ground(reach), _) => self.on_ground(reach, position),
                (Painted::Water { .. }, _) => self.on_ground(Reach::Near, position),
                (_, Some(chart)) => chart.at(u, v),
                _ => [0.0; 2],
            };
            Vertex { position, normal: triangle.face.normal(u, v), uv }
        };
        let corners = [vertex(a, 0.0, 0.0), vertex(b, 1.0, 0.0), vertex(c, 0.0, 1.0)];
        let gathered = &mut gathered[finish];
        let [first, second, third] = corners.map(|vertex| gathered.number(vertex));
        gathered.mesh.triangles.push([first, second, third]);
        if triangle.is_half {
            let far = gathered.number(vertex(b + c - a, 1.0, 1.0));
            gathered.mesh.triangles.push([far, third, second]);
        }
    }

    /// South-west and north-east corner of a picture of the ground.
    fn rectangle(&self, reach: Reach) -> [[f32; 2]; 2] {
        let frame = &self.scene.footing.frame;
        let side = |cells: usize| (cells as f64 * frame.cell) as f32;
        let margin = match reach {
            Reach::Near => MARGIN,
            Reach::Far => crate::ground::REACH,
        };
        [[-margin; 2], [side(frame.width) + margin, side(frame.height) + margin]]
    }

    fn is_near(&self, corners: [Vec3; 3]) -> bool {
        let [[west, south], [east, north]] = self.rectangle(Reach::Near);
        let is_in = |p: Vec3| (west..=east).contains(&p.x) && (south..=north).contains(&p.y);
        corners.into_iter().all(is_in)
    }

    fn on_ground(&self, reach: Reach, at: Vec3) -> [f32; 2] {
        let [[west, south], [east, north]] = self.rectangle(reach);
        [(at.x - west) / (east - west), (north - at.y) / (north - south)]
    }

    /// The colours of a part of the ground from above, linear, north up, over its meshes' texture
    /// coordinates.
    pub fn ground(&self, reach: Reach) -> Picture {
        let color = |x: f32, y: f32| match &self.scene.colors {
            Some(colors) => colors.reflectance(x, y),
            None => self.scene.materials.first().map_or(Vec3::ZERO, |ground| ground.reflectance),
        };
        self.map_of(reach, MOST_TEXELS, &color)
    }

    /// The colour of the water's body and bed from above, over the same texture coordinates as the
    /// near ground: a surface that reflects diffusely what the water returns.
    ///
    /// Light that reaches depth d and comes back is weakened by τ = exp(-c d (1/µ + 1/µ₀)), with
    /// the extinction c and the cosines of the ways up and down. The bed of reflectance ρ shows
    /// ρ τ; the water itself, once scattered and again [Hapke81] eq. 16, adds
    /// w H(µ) H(µ₀) / (4 (µ + µ₀)) (1 - τ).
    pub fn water(&self) -> Picture {
        let frame = &self.scene.footing.frame;
        let sun = self.lamp().map_or(GLANCE, |lamp| lamp.direction[2].max(0.1));
        let body = water::SCATTERING_ALBEDO.to_array().map(|w| {
            let h = |cos: f32| (1.0 + 2.0 * cos) / (1.0 + 2.0 * cos * (1.0 - w).sqrt());
            w * h(GLANCE) * h(sun) / (4.0 * (GLANCE + sun))
        });
        let color = |x: f32, y: f32| {
            let (map_x, map_y) = (frame.west + f64::from(x), frame.south + f64::from(y));
            let depth = self.scene.footing.sample("water_depth", map_x, map_y).unwrap_or(0.0);
            let passes = water::transmittance(depth * (1.0 / GLANCE + 1.0 / sun));
            let bed = self.scene.colors.as_ref().map_or(Vec3::ZERO, |c| c.reflectance(x, y));
            Vec3::from(body).lerp(bed, passes)
        };
        self.map_of(Reach::Near, MOST_TEXELS / 2, &color)
    }

    fn map_of(
        &self,
        reach: Reach,
        most: usize,
        color: &(dyn Fn(f32, f32) -> Vec3 + Sync),
    ) -> Picture {
        let [[west, south], [east, north]] = self.rectangle(reach);
        let count = |extent: f32| ((extent / TEXEL).ceil() as usize).clamp(16, most);
        let (width, height) = (count(east - west), count(north - south));
        let cell = [(east - west) / width as f32, (north - south) / height as f32];
        let parts = ((cell[0].max(cell[1]) / TEXEL).ceil() as usize).clamp(1, MOST_SAMPLES);
        let texel = |index: usize| {
            let (column, row) = ((index % width) as f32, (index / width) as f32);
            let part = |i: usize| (i as f32 + 0.5) / parts as f32;
            let sample = |i: usize| {
                let x = west + (column + part(i % parts)) * cell[0];
                let y = north - (row + part(i / parts)) * cell[1];
                color(x, y)
            };
            (0..parts * parts).map(sample).sum::<Vec3>() / (parts * parts) as f32
        };
        colored(width, height, (0..width * height).into_par_iter().map(texel).collect())
    }

    /// A texture times a colour, linear.
    pub fn texture(&self, texture: u32, by: [f32; 3]) -> Picture {
        let pyramid = &self.scene.levels.paints.textures[texture as usize];
        let (width, height, colors) = pyramid.linear();
        colored(width, height, colors.into_iter().map(|c| c * Vec3::from(by)).collect())
    }

    /// Where a texture's coverage is at least `least`, `times` as fine as the texture: width, height
    /// and, row by row, whether there is anything.
    pub fn opacity(&self, texture: u32, least: f32, times: usize) -> (usize, usize, Vec<bool>) {
        self.scene.levels.paints.textures[texture as usize].opacity(least, times)
    }

    /// The sun, unless it is part of the sky's picture.
    pub fn lamp(&self) -> Option<Lamp> {
        self.scene.dome.sun.map(|sun| Lamp {
            direction: sun.direction.to_array(),
            radiance: sun.radiance.to_array(),
            radius: crate::sky::SUN_RADIUS,
        })
    }

    /// Radiance of sky and clouds, and of the land below the horizon, from a direction, without the
    /// sun; kcd/m².
    pub fn sky(&self, direction: [f32; 3]) -> [f32; 3] {
        self.scene.dome.radiance(direction.into()).to_array()
    }

    /// Columns of the table of the sky: a picture of it needs no more.
    pub fn sky_columns(&self) -> usize {
        self.scene.dome.columns()
    }

    /// Extinction of the air, 1/m.
    pub fn haze(&self) -> f32 {
        self.scene.haze
    }

    /// Whether a finish shines.
    pub fn shines(&self, finish: u32) -> bool {
        self.finishes[finish as usize].emission != [0.0; 3]
    }
}

/// A picture of colours.
fn colored(width: usize, height: usize, colors: Vec<Vec3>) -> Picture {
    let mut picture = Picture::new(width, height);
    for (axis, name) in ["R", "G", "B"].into_iter().enumerate() {
        picture.add(name, false, colors.iter().map(|color| color[axis]).collect());
    }
    picture
}

/// A corner of a triangle.
struct Vertex {
    position: Vec3,
    normal: Vec3,
    uv: [f32; 2],
}

/// A mesh while it is gathered.
#[derive(Default)]
struct Gathered {
    mesh: Mesh,
    /// Numbers of the vertices by their bits; only looked up, never walked through.
    known_unsorted: HashMap<[u32; 8], u32>,
}

impl Gathered {
    /// The number of a vertex, which is added if it is new.
    fn number(&mut self, vertex: Vertex) -> u32 {
        let Vertex { position: p, normal: n, uv: [u, v] } = vertex;
        // Adding 0 makes -0 one with 0.
        let key = [p.x, p.y, p.z, n.x, n.y, n.z, u, v].map(|value| (value + 0.0).to_bits());
        let mesh = &mut self.mesh;
        *self.known_unsorted.entry(key).or_insert_with(|| {
            mesh.positions.push(p.to_array());
            mesh.normals.push(n.to_array());
            mesh.uvs.push([u, v]);
            mesh.positions.len() as u32 - 1
        })
    }
}

/// Mean reflectance of light from everywhere of a smooth surface of refractive index 1.5 in air, by
/// Fresnel's equations: what a renderer's smooth dielectric keeps from the diffuse surface below.
pub const SMOOTH_MEAN: f32 = 0.0918;

/// Mean over the hemisphere of a value of the cosine, for tests.
#[cfg(test)]
fn hemisphere(value: impl Fn(f64) -> f64) -> f64 {
    let n = 20_000;
    (0..n).map(|i| value(((f64::from(i) + 0.5) / f64::from(n)).sqrt())).sum::<f64>() / f64::from(n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::Dome;

    #[test]
    fn a_smooth_dielectric_reflects_nine_per_cent_of_light_from_everywhere() {
        let fresnel = |cos: f64| {
            let inner = (1.0 - (1.0 - cos * cos) / 2.25).sqrt();
            let across = (cos - 1.5 * inner) / (cos + 1.5 * inner);
            let along = (1.5 * cos - inner) / (1.5 * cos + inner);
            0.5 * (across * across + along * along)
        };
        assert!((hemisphere(fresnel) - f64::from(SMOOTH_MEAN)).abs() < 1e-4);
    }

    #[test]
    fn poses_compose_as_instances_do() {
        let unit = |q: [f32; 4]| Quat::from_array(q).normalize().to_array();
        let outer = Instance::new(unit([0.1, 0.2, -0.4, 0.8]), 1.3, [5.0, -2.0, 1.0], 0);
        let inner = Instance::new(unit([-0.6, 0.1, 0.3, 0.5]), 0.4, [0.5, 0.7, 2.0], 0);
        let rows = Pose::HERE.then(&outer).then(&inner).rows();
        let point = Vec3::new(0.3, -1.2, 0.9);
        let expected = outer.carry_point(inner.carry_point(point));
        let got = Vec3::from(rows.map(|[x, y, z, w]| Vec3::new(x, y, z).dot(point) + w));
        assert!(got.abs_diff_eq(expected, 1e-5), "{got} {expected}");
    }

    fn config() -> Config {
        let value = weald_contract::Value::parse(0, "").unwrap();
        weald_contract::FromToml::from_toml(&value, &mut Vec::new()).unwrap()
    }

    #[test]
    fn the_sky_of_a_plain_scene_is_its_dome() {
        let scene = Scene::of_mesh(&[], vec![], Dome::constant(0.7));
        let portable = scene.portable(&config()).unwrap();
        assert!(portable.places.is_empty() && portable.lamp().is_none());
        assert!(portable.sky([0.6, 0.0, 0.8]).iter().all(|l| (l - 0.7).abs() < 1e-6));
    }
}
