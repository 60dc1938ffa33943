//! The turtle: reads a string of modules and draws axes and organs.
//!
//! | module | meaning |
//! |---|---|
//! | `F(s)`, `f(s)` | moves `s` metres ahead, drawing a line or not |
//! | `+(a)` `-(a)` | turns left or right by `a` degrees |
//! | `&(a)` `^(a)` | pitches down or up |
//! | `\(a)` `/(a)` | rolls to the left or right |
//! | `\|` | turns around |
//! | `$` | rolls until the upper side is as high as it can be |
//! | `[` `]` | remembers the state; takes it back |
//! | `!(d)` | sets the line's diameter, m; alone, thins it to 0.7 of what it was |
//! | `'` `'(i)` | takes the next stroke, or number i |
//! | `_(e)` | sets the elasticity, rad |
//! | `~name(l)` `~name(w, l)` | places an organ of this length, or width and length, m |
//! | `{` `.` `}` | begins a surface, adds a corner, ends it |
//! | `?E` `?P` `?H` `?L` `?U` | asks; see [`super::environment`] |
//!
//! Signs and turns are those of [Prus90] §1.5; the turtle begins at the origin and looks up.
//! Other letters mean nothing to it.

use super::grammar::QUESTIONS;
use super::rewrite::{Module, Word};
use super::{Lsystem, Styles};
use crate::Stature;
use crate::frame::{across, any_normal, frame_of, organ_rotation};
use crate::skeleton::{Axis, AxisKind, Node, PlacedOrgan, Skeleton, axis_id};
use glam::{Quat, Vec3};
use weald_contract::{Mesh, Problem};

/// Length of a move, diameter and size of an organ at most, m: no plant is larger, and sums of
/// a million moves stay finite.
const LARGEST: f32 = 200.0;

/// Organs and lines shorter than this are not drawn, m.
const SHORTEST: f32 = 1e-6;

/// Surfaces of one plant at most: each is a mesh of its own, unlike an organ.
const MOST_SURFACES: usize = 10_000;

/// Depth below the ground at which a stem begins, m: on a slope none may float.
const ROOT_DEPTH: f32 = 0.02;

/// Factor by which `!` alone thins a line: two branches of 0.7 of a stem's diameter have its
/// cross section together.
const THINNING: f32 = 0.707;

/// Where the turtle is and what it draws with.
#[derive(Clone, Copy)]
struct State {
    position: Vec3,
    heading: Vec3,
    left: Vec3,
    up: Vec3,
    diameter: f32,
    stroke: usize,
    elasticity: f32,
    /// The axis that is being drawn, or from which the next one grows.
    axis: Option<u32>,
    /// Whether the next line continues that axis.
    is_drawing: bool,
    /// Order of the axis.
    order: u8,
    /// Id of the bracket that began this branch.
    branch: u64,
    /// Axes drawn in this branch.
    axes: u32,
}

/// An axis while it grows.
struct Growing {
    axis: Axis,
    nodes: Vec<Node>,
    /// Length of the parent when this began; of itself once it is complete, m.
    begins: f32,
    length: f32,
}

struct Turtle<'a> {
    form: &'a Lsystem,
    styles: &'a Styles,
    state: State,
    stack: Vec<State>,
    growing: Vec<Growing>,
    skeleton: &'a mut Skeleton,
    /// Corners of the surfaces that are open.
    surfaces: Vec<Vec<Vec3>>,
    surface_count: usize,
    questions: Vec<Question>,
}

/// A module that asks, and where the turtle met it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Question {
    /// Its module.
    pub id: u64,
    /// Its letter.
    pub letter: char,
    /// Its first parameter.
    pub value: f32,
    /// Where it stands, m.
    pub position: Vec3,
    /// The turtle's heading, left and up.
    pub frame: [Vec3; 3],
}

/// Draws a string into a skeleton that holds its materials and prototypes, and returns what the
/// string asks.
///
/// # Errors
/// More surfaces than a plant may have.
pub fn draw(
    form: &Lsystem,
    word: &Word,
    styles: &Styles,
    stature: &Stature,
    skeleton: &mut Skeleton,
) -> Result<Vec<Question>, Problem> {
    let state = State {
        position: Vec3::ZERO,
        heading: Vec3::Z,
        left: Vec3::X,
        up: Vec3::Y,
        diameter: 2.0 * stature.stem_radius,
        stroke: 0,
        elasticity: form.elasticity,
        axis: None,
        is_drawing: false,
        order: 0,
        branch: axis_id(0, "root", 0),
        axes: 0,
    };
    let (stack, growing, surfaces, surface_count, questions) = Default::default();
    let mut turtle = Turtle {
        form,
        styles,
        state,
        stack,
        growing,
        skeleton,
        surfaces,
        surface_count,
        questions,
    };
    for module in &word.modules {
        turtle.read(module, word.values_of(module))?;
    }
    let questions = std::mem::take(&mut turtle.questions);
    turtle.finish(stature);
    Ok(questions)
}

impl Turtle<'_> {
    fn read(&mut self, module: &Module, values: &[f32]) -> Result<(), Problem> {
        let value = values.first().map(|v| if v.is_finite() { *v } else { 0.0 });
        let angle = value.unwrap_or(self.form.angle_deg).to_radians();
        match module.symbol.mark {
            'F' if module.symbol.number == 0 => self.forward(value, true),
            'f' if module.symbol.number == 0 => self.forward(value, false),
            '+' => self.turn(self.state.up, angle),
            '-' => self.turn(self.state.up, -angle),
            '&' => self.turn(self.state.left, angle),
            '^' => self.turn(self.state.left, -angle),
            '\\' => self.turn(self.state.heading, angle),
            '/' => self.turn(self.state.heading, -angle),
            '|' => self.turn(self.state.up, std::f32::consts::PI),
            '$' => self.level(),
            '[' => self.open(module.id),
            ']' => self.state = self.stack.pop().unwrap_or(self.state),
            '!' => {
                let thinner = THINNING * self.state.diameter;
                self.state.diameter = value.unwrap_or(thinner).clamp(2.0 * SHORTEST, LARGEST);
            }
            '\'' => self.stroke(value),
            '_' => self.state.elasticity = value.unwrap_or(self.form.elasticity).clamp(-3.0, 3.0),
            '~' => self.organ(module, values),
            '{' => self.surfaces.push(Vec::new()),
            '.' => self.surfaces.last_mut().into_iter().for_each(|s| s.push(self.state.position)),
            '}' => self.surface()?,
            '?' => self.questions.push(Question {
                id: module.id,
                letter: QUESTIONS.get(module.symbol.number as usize).copied().unwrap_or('E'),
                value: value.unwrap_or(0.0),
                position: self.state.position,
                frame: [self.state.heading, self.state.left, self.state.up],
            }),
            _ => {}
        }
        Ok(())
    }

    /// Rotates heading, left and up about an axis by the right hand.
    fn turn(&mut self, axis: Vec3, angle: f32) {
        let (sin, cos) = libm::sincosf(0.5 * angle);
        let rotation = Quat::from_vec4((axis * sin).extend(cos));
        self.orient(rotation * self.state.heading, rotation * self.state.up);
    }

    /// Sets the frame; `up` need not be quite at right angles.
    fn orient(&mut self, heading: Vec3, up: Vec3) {
        let heading = heading.normalize_or(Vec3::Z);
        let up = across(up, heading).unwrap_or_else(|| any_normal(heading));
        (self.state.heading, self.state.up, self.state.left) = (heading, up, up.cross(heading));
    }

    fn level(&mut self) {
        if let Some(up) = across(Vec3::Z, self.state.heading) {
            self.orient(self.state.heading, up);
        }
    }

    fn open(&mut self, id: u64) {
        self.stack.push(self.state);
        let order = self.state.order.saturating_add(u8::from(self.state.axis.is_some()));
        self.state = State { is_drawing: false, order, branch: id, axes: 0, ..self.state };
    }

    fn stroke(&mut self, value: Option<f32>) {
        let last = self.styles.strokes.len().saturating_sub(1);
        let chosen = value.map_or(self.state.stroke + 1, |v| v.max(0.0) as usize);
        let chosen = chosen.min(last);
        self.state.is_drawing &= chosen == self.state.stroke;
        self.state.stroke = chosen;
    }

    fn forward(&mut self, length: Option<f32>, draws: bool) {
        let length = length.unwrap_or(self.form.step).clamp(-LARGEST, LARGEST);
        let from = self.state.position;
        self.state.position += self.state.heading * length;
        if !draws {
            // What is drawn beyond a gap grows from nothing that could be seen.
            if length.abs() > SHORTEST {
                self.state = State { axis: None, is_drawing: false, ..self.state };
            }
            return;
        }
        if length.abs() > SHORTEST {
            self.line(from);
            self.bend();
        }
    }

    fn line(&mut self, from: Vec3) {
        let radius = 0.5 * self.state.diameter;
        if !self.state.is_drawing {
            self.begin(from, radius);
        }
        let Some(growing) = self.state.axis.and_then(|axis| self.growing.get_mut(axis as usize))
        else {
            return;
        };
        growing.length += from.distance(self.state.position);
        growing.nodes.push(Node { position: self.state.position, radius });
    }

    /// Begins an axis where the turtle stood.
    fn begin(&mut self, from: Vec3, radius: f32) {
        let State { up, branch, axes, order, axis: parent, .. } = self.state;
        let (kind, material) =
            self.styles.strokes.get(self.state.stroke).copied().unwrap_or((AxisKind::Stem, 0));
        let id = axis_id(branch, "axis", axes);
        let mut axis = Axis::new(id, kind, material).facing(up);
        axis.order = order;
        axis.parent = parent;
        let begins = parent.and_then(|p| self.growing.get(p as usize)).map_or(0.0, |p| p.length);
        let mut nodes = vec![Node { position: from, radius }];
        if parent.is_none() && from.z <= SHORTEST {
            nodes.insert(0, Node { position: from - Vec3::Z * ROOT_DEPTH, radius });
        }
        let length = 0.0;
        self.growing.push(Growing { axis, nodes, begins, length });
        self.state.axis = Some((self.growing.len() - 1) as u32);
        self.state.is_drawing = true;
        self.state.axes += 1;
    }

    /// Turns the heading towards the tropism, [Prus90] §2.1: by the elasticity times the length of
    /// `heading x tropism`.
    fn bend(&mut self) {
        let torque = self.state.heading.cross(Vec3::from_array(self.form.tropism));
        if let Some(axis) = torque.try_normalize().filter(|_| self.state.elasticity != 0.0) {
            self.turn(axis, self.state.elasticity * torque.length());
        }
    }

    fn organ(&mut self, module: &Module, values: &[f32]) {
        let Some(style) = self.styles.organs.get(module.symbol.number as usize) else { return };
        let slim = style.slim;
        let (width, length) = match *values {
            [width, length] => (width, length),
            [length] => (slim * length, length),
            _ => (slim * self.form.step, self.form.step),
        };
        let is_drawn = |size: f32| size.is_finite() && size > SHORTEST;
        if !is_drawn(width) || !is_drawn(length) {
            return;
        }
        let (width, length) = (width.min(LARGEST), length.min(LARGEST));
        let depth = if style.is_round { width } else { length };
        let hue = (module.id % u64::from(style.hues.max(1))) as u32;
        self.skeleton.organs.push(PlacedOrgan {
            prototype: style.prototype + hue,
            axis: self.state.axis.unwrap_or(0),
            position: self.state.position,
            rotation: organ_rotation(frame_of(self.state.heading, self.state.up)),
            scale: Vec3::new(width, length, depth),
        });
    }

    /// Ends a surface: a fan of triangles from its first corner, as an organ there.
    fn surface(&mut self) -> Result<(), Problem> {
        let Some(corners) = self.surfaces.pop().filter(|corners| corners.len() >= 3) else {
            return Ok(());
        };
        self.surface_count += 1;
        if self.surface_count > MOST_SURFACES {
            let what = format!("the plant has more than {MOST_SURFACES} surfaces");
            let hint = "an organ, placed by `~name(length)`, is stored once for all its places";
            return Err(Problem::at(self.form.axiom.span, what).hint(hint));
        }
        let (_, material) =
            self.styles.strokes.get(self.state.stroke).copied().unwrap_or((AxisKind::Stem, 0));
        let foot = corners[0];
        let mesh = fan(&corners, foot, material);
        let prototype = self.skeleton.add_prototype("surface", vec![mesh]);
        let axis = self.state.axis.unwrap_or(0);
        let (rotation, scale) = (Quat::IDENTITY, Vec3::ONE);
        self.skeleton.organs.push(PlacedOrgan { prototype, axis, position: foot, rotation, scale });
        Ok(())
    }

    /// Hands the axes over to the skeleton.
    fn finish(mut self, stature: &Stature) {
        if self.growing.is_empty() {
            // Organs need an axis: a plant without one gets a stub in the ground.
            let radius = stature.stem_radius;
            let node = |z| Node { position: Vec3::Z * z, radius };
            let nodes = vec![node(-ROOT_DEPTH), node(0.0)];
            let axis = Axis::new(axis_id(0, "stub", 0), AxisKind::Stem, 0);
            self.growing.push(Growing { axis, nodes, begins: 0.0, length: 0.0 });
        }
        let lengths: Vec<f32> = self.growing.iter().map(|growing| growing.length).collect();
        for Growing { mut axis, nodes, begins, .. } in self.growing {
            if let Some(parent) = axis.parent {
                axis.at = (begins / lengths[parent as usize].max(SHORTEST)).min(1.0);
            }
            self.skeleton.push(axis, nodes);
        }
    }
}

/// Triangles from the first corner to each edge, around `origin`.
fn fan(corners: &[Vec3], origin: Vec3, material: u32) -> Mesh {
    let positions: Vec<[f32; 3]> = corners.iter().map(|c| (*c - origin).to_array()).collect();
    let edges = corners.windows(2).map(|edge| (edge[0] - origin).cross(edge[1] - origin));
    let normal = edges.sum::<Vec3>().normalize_or(Vec3::Z).to_array();
    let uvs = positions.iter().map(|p| [p[0], p[1]]).collect();
    let normals = vec![normal; positions.len()];
    let triangles = (1..corners.len() as u32 - 1).map(|i| [0, i, i + 1]).collect();
    Mesh { material, positions, normals, uvs, triangles, ..Mesh::default() }
}
