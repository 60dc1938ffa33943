//! The program behind a formula: steps without jumps, run over blocks of values.
//!
//! [`Builder`] takes operations in the order the parser meets them, folds those on constants, and
//! gives equal operations one node, so the formula becomes a graph whose operands precede their
//! users. [`Builder::finish`] drops what the result does not need and assigns each remaining node
//! a slot, reused once its last reader has run.

use std::collections::HashMap;

use noise::{NoiseFn, Perlin};

/// Values a step handles before the next step begins.
///
/// 4 KiB a slot: a handful of slots and inputs together stay within a 32 KiB first-level cache,
/// and decoding a step costs little against 1,024 values.
const BLOCK: usize = 1024;

/// Slots that a scalar evaluation keeps on the stack; most formulas written by hand need under ten.
const STACK_SLOTS: usize = 32;

/// Lattice coordinates beyond this, 2^24, have no fraction left in single precision.
const LARGEST_LATTICE: f32 = 16_777_216.0;

/// Lattice cells after which the noise repeats, as its table has 256 entries.
const NOISE_PERIOD: f32 = 256.0;

/// Operations on one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Unary {
    Identity,
    Negate,
    Not,
    Sqrt,
    Exp,
    Ln,
    Log10,
    Sin,
    Cos,
    Tan,
    Abs,
    Floor,
    Ceil,
    Round,
    Sign,
    /// t²(3 - 2t), the cubic with flat ends: the second half of `smoothstep`.
    Hermite,
}

/// Operations on two values. Greater-than is less-than with its operands exchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Less,
    LessOrEqual,
    Equal,
    NotEqual,
    And,
    Or,
    /// The smaller; the other one if one is NaN.
    Min,
    /// The larger; the other one if one is NaN.
    Max,
    /// The first, raised to the second if below it; NaN passes. Lower half of `clamp`.
    AtLeast,
    /// The first, lowered to the second if above it; NaN passes. Upper half of `clamp`.
    AtMost,
    /// The quotient within 0 to 1, with 0/0 taken as 1: the first half of `smoothstep`.
    Ramp,
    Atan2,
}

fn truth(value: bool) -> f32 {
    if value { 1.0 } else { 0.0 }
}

fn at_least(v: f32, low: f32) -> f32 {
    if low > v { low } else { v }
}

fn at_most(v: f32, high: f32) -> f32 {
    if high < v { high } else { v }
}

impl Unary {
    /// The operation on one value: the one definition that folding, scalars and blocks share.
    #[inline(always)]
    fn apply(self, v: f32) -> f32 {
        match self {
            Unary::Identity => v,
            Unary::Negate => -v,
            Unary::Not => truth(v == 0.0),
            // IEEE 754 fixes every bit of these five, so the processor's own serve.
            Unary::Sqrt => v.sqrt(),
            Unary::Abs => v.abs(),
            Unary::Floor => v.floor(),
            Unary::Ceil => v.ceil(),
            Unary::Round => v.round(),
            Unary::Exp => libm::expf(v),
            Unary::Ln => libm::logf(v),
            Unary::Log10 => libm::log10f(v),
            Unary::Sin => libm::sinf(v),
            Unary::Cos => libm::cosf(v),
            Unary::Tan => libm::tanf(v),
            // The last case returns 0 for 0 and NaN for NaN.
            Unary::Sign if v > 0.0 => 1.0,
            Unary::Sign if v < 0.0 => -1.0,
            Unary::Sign => v,
            Unary::Hermite => v * v * (3.0 - 2.0 * v),
        }
    }
}

impl Binary {
    /// The operation on two values: the one definition that folding, scalars and blocks share.
    ///
    /// Minimum and its kin spell out their comparison: std leaves the sign of a zero open, and
    /// each of these is one or two SIMD instructions. No case may call `apply` again: a recursive
    /// function is never inlined, and every loop over a block would then call it value by value.
    #[inline(always)]
    fn apply(self, a: f32, b: f32) -> f32 {
        match self {
            Binary::Add => a + b,
            Binary::Subtract => a - b,
            Binary::Multiply => a * b,
            Binary::Divide => a / b,
            Binary::Power => libm::powf(a, b),
            Binary::Less => truth(a < b),
            Binary::LessOrEqual => truth(a <= b),
            Binary::Equal => truth(a == b),
            Binary::NotEqual => truth(a != b),
            Binary::And => truth((a != 0.0) & (b != 0.0)),
            Binary::Or => truth((a != 0.0) | (b != 0.0)),
            Binary::Min => {
                if (a < b) | b.is_nan() {
                    a
                } else {
                    b
                }
            }
            Binary::Max => {
                if (a > b) | b.is_nan() {
                    a
                } else {
                    b
                }
            }
            Binary::AtLeast => at_least(a, b),
            Binary::AtMost => at_most(a, b),
            Binary::Ramp => {
                let ratio = if (a == 0.0) & (b == 0.0) { 1.0 } else { a / b };
                at_most(at_least(ratio, 0.0), 1.0)
            }
            Binary::Atan2 => libm::atan2f(a, b),
        }
    }
}

#[inline(always)]
fn select(condition: f32, yes: f32, no: f32) -> f32 {
    if condition != 0.0 { yes } else { no }
}

/// Gradient noise [Perlin02] at lattice coordinates; NaN where either is not finite.
///
/// The crate scales as for gradients of length 1 but its diagonal ones have length √2, and cuts
/// what exceeds ±1: flat tops on 1.0 % of the plane (5 million samples of 20 seeds, rms 0.43).
fn perlin(table: &Perlin, x: f32, y: f32) -> f32 {
    if !(x.is_finite() && y.is_finite()) {
        return f32::NAN;
    }
    // The crate adds 1 to the integer part, which must not overflow.
    let wrap = |v: f32| if v.abs() < LARGEST_LATTICE { v } else { v % NOISE_PERIOD };
    table.get([f64::from(wrap(x)), f64::from(wrap(y))]) as f32
}

/// What a node or a step computes from operands of type `T`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Action<T> {
    Unary(Unary, T),
    Binary(Binary, T, T),
    /// The second where the first is true, else the third.
    Select(T, T, T),
    /// Noise of the table with this index at lattice coordinates.
    Noise(usize, T, T),
}

impl<T: Copy> Action<T> {
    /// The same action on other operands.
    fn map<U>(self, mut f: impl FnMut(T) -> U) -> Action<U> {
        match self {
            Action::Unary(op, a) => Action::Unary(op, f(a)),
            Action::Binary(op, a, b) => Action::Binary(op, f(a), f(b)),
            Action::Select(c, a, b) => Action::Select(f(c), f(a), f(b)),
            Action::Noise(table, x, y) => Action::Noise(table, f(x), f(y)),
        }
    }

    fn for_each_operand(self, f: impl FnMut(T)) {
        self.map(f);
    }
}

/// A node of the graph under construction; an index into [`Builder::nodes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Id(usize);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Node {
    /// Bits of the number: unlike numbers, bits of NaN equal themselves and those of 0 and -0 differ.
    Constant(u32),
    /// A variable by its index.
    Input(usize),
    Compute(Action<Id>),
}

/// Collects a formula's operations and turns them into a [`Program`].
#[derive(Default)]
pub(super) struct Builder {
    /// Operands precede their users.
    nodes: Vec<Node>,
    /// Where each node already stands; only looked up, never iterated.
    known: HashMap<Node, Id>,
    /// Seed of each noise table.
    seeds: Vec<u32>,
}

impl Builder {
    fn node(&mut self, node: Node) -> Id {
        let nodes = &mut self.nodes;
        *self.known.entry(node).or_insert_with(|| {
            nodes.push(node);
            Id(nodes.len() - 1)
        })
    }

    pub(super) fn constant(&mut self, value: f32) -> Id {
        self.node(Node::Constant(value.to_bits()))
    }

    /// The value of the variable with this index.
    pub(super) fn input(&mut self, index: usize) -> Id {
        self.node(Node::Input(index))
    }

    /// The number that `id` is known to be, if it depends on no variable.
    pub(super) fn known_value(&self, id: Id) -> Option<f32> {
        match self.nodes[id.0] {
            Node::Constant(bits) => Some(f32::from_bits(bits)),
            _ => None,
        }
    }

    pub(super) fn unary(&mut self, op: Unary, a: Id) -> Id {
        match self.known_value(a) {
            Some(v) => self.constant(op.apply(v)),
            None => self.node(Node::Compute(Action::Unary(op, a))),
        }
    }

    pub(super) fn binary(&mut self, op: Binary, a: Id, b: Id) -> Id {
        match (self.known_value(a), self.known_value(b)) {
            (Some(u), Some(v)) => self.constant(op.apply(u, v)),
            // A square is one multiplication, rounded correctly where `powf` is only nearly so.
            (None, Some(2.0)) if op == Binary::Power => self.binary(Binary::Multiply, a, a),
            _ => self.node(Node::Compute(Action::Binary(op, a, b))),
        }
    }

    pub(super) fn select(&mut self, condition: Id, yes: Id, no: Id) -> Id {
        match self.known_value(condition) {
            Some(c) if c != 0.0 => yes,
            Some(_) => no,
            None => self.node(Node::Compute(Action::Select(condition, yes, no))),
        }
    }

    /// Noise with the given seed at lattice coordinates `x` and `y`.
    pub(super) fn noise(&mut self, seed: u32, x: Id, y: Id) -> Id {
        let table = self.seeds.iter().position(|&s| s == seed).unwrap_or_else(|| {
            self.seeds.push(seed);
            self.seeds.len() - 1
        });
        self.node(Node::Compute(Action::Noise(table, x, y)))
    }

    /// For each node, the last node that reads it; `None` if the result does not need it.
    /// The root counts as its own reader.
    fn last_readers(&self, root: Id) -> Vec<Option<usize>> {
        let mut last = vec![None; self.nodes.len()];
        last[root.0] = Some(root.0);
        // Readers follow what they read, so going backwards every reader is decided first.
        for index in (0..=root.0).rev() {
            if let (Some(_), Node::Compute(action)) = (last[index], self.nodes[index]) {
                action.for_each_operand(|operand| {
                    last[operand.0].get_or_insert(index);
                });
            }
        }
        last
    }

    /// Returns the program that computes `root`.
    pub(super) fn finish(self, root: Id) -> Program {
        let last_readers = self.last_readers(root);
        // Where each node's value is found; a node is placed before any reads it.
        let mut places = vec![Operand::Constant(0.0); self.nodes.len()];
        let (mut steps, mut slots) = (vec![], Slots::default());
        for (index, &node) in self.nodes.iter().enumerate().take(root.0) {
            if last_readers[index].is_none() {
                continue;
            }
            places[index] = match node {
                Node::Constant(bits) => Operand::Constant(f32::from_bits(bits)),
                Node::Input(input) => Operand::Input(input),
                Node::Compute(action) => {
                    // Taken before those read here are freed: no step overwrites its input.
                    let slot = slots.take();
                    steps.push(Step { action: action.map(|id| places[id.0]), slot });
                    action.for_each_operand(|id| {
                        if last_readers[id.0] == Some(index) {
                            slots.free(places[id.0]);
                        }
                    });
                    Operand::Slot(slot)
                }
            };
        }
        let identity = |operand| Action::Unary(Unary::Identity, operand);
        let result = match self.nodes[root.0] {
            Node::Constant(bits) => identity(Operand::Constant(f32::from_bits(bits))),
            Node::Input(input) => identity(Operand::Input(input)),
            Node::Compute(action) => action.map(|id| places[id.0]),
        };
        let tables = self.seeds.into_iter().map(Perlin::new).collect();
        Program { steps, result, slot_count: slots.count, tables }
    }
}

/// Which slots hold a value that a later step reads.
#[derive(Default)]
struct Slots {
    count: usize,
    free: Vec<usize>,
}

impl Slots {
    fn take(&mut self) -> usize {
        self.free.pop().unwrap_or_else(|| {
            self.count += 1;
            self.count - 1
        })
    }

    /// Gives back the operand's slot, if it is one; twice does no harm, as in `a * a`.
    fn free(&mut self, operand: Operand) {
        if let Operand::Slot(slot) = operand
            && !self.free.contains(&slot)
        {
            self.free.push(slot);
        }
    }
}

/// Where a step finds a value.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operand {
    Constant(f32),
    Input(usize),
    Slot(usize),
}

#[derive(Clone, Copy, Debug)]
struct Step {
    action: Action<Operand>,
    /// Where the result goes: never a slot that the action reads.
    slot: usize,
}

/// A compiled formula.
#[derive(Clone, Debug)]
pub(super) struct Program {
    steps: Vec<Step>,
    /// What the whole formula is, once all steps have run.
    result: Action<Operand>,
    slot_count: usize,
    /// Noise tables, one a seed.
    tables: Vec<Perlin>,
}

impl Program {
    pub(super) fn constant(value: f32) -> Program {
        let mut builder = Builder::default();
        let root = builder.constant(value);
        builder.finish(root)
    }

    /// The value for one set of inputs.
    pub(super) fn eval(&self, inputs: &[f32]) -> f32 {
        if self.slot_count <= STACK_SLOTS {
            self.eval_in(inputs, &mut [0.0; STACK_SLOTS])
        } else {
            self.eval_in(inputs, &mut vec![0.0; self.slot_count])
        }
    }

    fn eval_in(&self, inputs: &[f32], slots: &mut [f32]) -> f32 {
        for step in &self.steps {
            slots[step.slot] = self.act(step.action, inputs, slots);
        }
        self.act(self.result, inputs, slots)
    }

    fn act(&self, action: Action<Operand>, inputs: &[f32], slots: &[f32]) -> f32 {
        let values = action.map(|operand| match operand {
            Operand::Constant(v) => v,
            Operand::Input(i) => inputs[i],
            Operand::Slot(s) => slots[s],
        });
        match values {
            Action::Unary(op, a) => op.apply(a),
            Action::Binary(op, a, b) => op.apply(a, b),
            Action::Select(c, a, b) => select(c, a, b),
            Action::Noise(table, x, y) => perlin(&self.tables[table], x, y),
        }
    }

    /// The values for many sets of inputs; `inputs[variable]` is as long as `out`.
    pub(super) fn eval_block(&self, inputs: &[&[f32]], out: &mut [f32]) {
        let mut slots = vec![vec![0.0; out.len().min(BLOCK)]; self.slot_count];
        for (index, out) in out.chunks_mut(BLOCK).enumerate() {
            let first = index * BLOCK;
            let block = Block { inputs, first, count: out.len(), tables: &self.tables };
            for step in &self.steps {
                // Out of the list while written, so that the other slots can be read beside it.
                let mut target = std::mem::take(&mut slots[step.slot]);
                block.act(step.action, &slots, &mut target[..out.len()]);
                slots[step.slot] = target;
            }
            block.act(self.result, &slots, out);
        }
    }
}

/// The part of the inputs that is in work.
struct Block<'a> {
    inputs: &'a [&'a [f32]],
    first: usize,
    count: usize,
    tables: &'a [Perlin],
}

/// An operand of a whole block: one value for all, or one each.
#[derive(Clone, Copy)]
enum Lane<'a> {
    All(f32),
    Each(&'a [f32]),
}

/// Runs `$fill` with the operation as a constant, so that each has a loop of its own that the
/// compiler can turn into SIMD; it would not reliably hoist a `match` out of one shared loop.
macro_rules! loop_of_its_own {
    ($op:expr, $fill:ident, $kind:ident: $($name:ident)*) => {
        match $op { $($kind::$name => $fill!($kind::$name),)* }
    };
}

impl Block<'_> {
    fn act(&self, action: Action<Operand>, slots: &[Vec<f32>], out: &mut [f32]) {
        let lanes = action.map(|operand| match operand {
            Operand::Constant(v) => Lane::All(v),
            Operand::Input(i) => Lane::Each(&self.inputs[i][self.first..self.first + self.count]),
            Operand::Slot(s) => Lane::Each(&slots[s][..self.count]),
        });
        match lanes {
            Action::Unary(op, a) => unary_lanes(op, a, out),
            Action::Binary(op, a, b) => binary_lanes(op, a, b, out),
            Action::Select(c, a, b) => select_lanes(c, a, b, out),
            Action::Noise(table, x, y) => {
                let table = &self.tables[table];
                fill_from_two(out, x, y, |x, y| perlin(table, x, y));
            }
        }
    }
}

fn unary_lanes(op: Unary, a: Lane<'_>, out: &mut [f32]) {
    macro_rules! fill {
        ($op:expr) => {
            fill_from_one(out, a, |v| $op.apply(v))
        };
    }
    loop_of_its_own!(op, fill, Unary: Identity Negate Not Sqrt Exp Ln Log10 Sin Cos Tan Abs Floor
        Ceil Round Sign Hermite);
}

fn binary_lanes(op: Binary, a: Lane<'_>, b: Lane<'_>, out: &mut [f32]) {
    macro_rules! fill {
        ($op:expr) => {
            fill_from_two(out, a, b, |u, v| $op.apply(u, v))
        };
    }
    loop_of_its_own!(op, fill, Binary: Add Subtract Multiply Divide Power Less LessOrEqual Equal
        NotEqual And Or Min Max AtLeast AtMost Ramp Atan2);
}

fn fill_from_one(out: &mut [f32], a: Lane<'_>, f: impl Fn(f32) -> f32) {
    match a {
        Lane::All(a) => out.fill(f(a)),
        Lane::Each(a) => zip_one(out, a, f),
    }
}

fn fill_from_two(out: &mut [f32], a: Lane<'_>, b: Lane<'_>, f: impl Fn(f32, f32) -> f32) {
    match (a, b) {
        (Lane::All(a), Lane::All(b)) => out.fill(f(a, b)),
        (Lane::All(a), Lane::Each(b)) => zip_one(out, b, move |b| f(a, b)),
        (Lane::Each(a), Lane::All(b)) => zip_one(out, a, move |a| f(a, b)),
        (Lane::Each(a), Lane::Each(b)) => zip_two(out, a, b, f),
    }
}

fn zip_one(out: &mut [f32], a: &[f32], f: impl Fn(f32) -> f32) {
    for (out, &a) in out.iter_mut().zip(a) {
        *out = f(a);
    }
}

fn zip_two(out: &mut [f32], a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32) {
    for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
        *out = f(a, b);
    }
}

fn select_lanes(condition: Lane<'_>, yes: Lane<'_>, no: Lane<'_>, out: &mut [f32]) {
    match (condition, yes, no) {
        (Lane::All(c), yes, no) => {
            fill_from_two(out, yes, no, move |yes, no| select(c, yes, no));
        }
        (c, Lane::All(yes), no) => fill_from_two(out, c, no, move |c, no| select(c, yes, no)),
        (c, yes, Lane::All(no)) => fill_from_two(out, c, yes, move |c, yes| select(c, yes, no)),
        (Lane::Each(c), Lane::Each(yes), Lane::Each(no)) => {
            let conditions = out.iter_mut().zip(c);
            conditions.zip(yes.iter().zip(no)).for_each(|((out, &c), (&yes, &no))| {
                *out = select(c, yes, no);
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_on_constants_leave_no_step() {
        let mut b = Builder::default();
        let (two, three) = (b.constant(2.0), b.constant(3.0));
        let five = b.binary(Binary::Add, two, three);
        let root = b.unary(Unary::Sqrt, five);
        let program = b.finish(root);
        assert!(program.steps.is_empty());
        assert_eq!(
            program.result,
            Action::Unary(Unary::Identity, Operand::Constant(5.0_f32.sqrt()))
        );
    }

    #[test]
    fn equal_operations_run_once() {
        let mut b = Builder::default();
        let v = b.input(0);
        let first = b.unary(Unary::Exp, v);
        let second = b.unary(Unary::Exp, v);
        assert_eq!(first, second);
        let root = b.binary(Binary::Add, first, second);
        assert_eq!(b.finish(root).steps.len(), 1);
    }

    #[test]
    fn steps_that_the_result_does_not_need_are_dropped() {
        let mut b = Builder::default();
        let v = b.input(0);
        let unused = b.unary(Unary::Sin, v);
        let one = b.constant(1.0);
        let root = b.select(one, v, unused);
        assert!(b.finish(root).steps.is_empty());
    }

    #[test]
    fn a_long_chain_needs_two_slots() {
        let mut b = Builder::default();
        let mut value = b.input(0);
        for i in 0..100 {
            let term = b.constant(i as f32);
            value = b.binary(Binary::Add, value, term);
        }
        let program = b.finish(value);
        assert_eq!((program.steps.len(), program.slot_count), (99, 2));
        assert_eq!(program.eval(&[0.5]), (0..100).fold(0.5, |sum, i| sum + i as f32));
    }

    #[test]
    fn no_step_overwrites_what_it_reads() {
        let mut b = Builder::default();
        let (u, v) = (b.input(0), b.input(1));
        let sum = b.binary(Binary::Add, u, v);
        let square = b.binary(Binary::Multiply, sum, sum);
        let root = b.unary(Unary::Sqrt, square);
        let root = b.binary(Binary::Divide, root, sum);
        for step in &b.finish(root).steps {
            step.action.for_each_operand(|o| assert_ne!(o, Operand::Slot(step.slot)));
        }
    }

    #[test]
    fn programs_too_wide_for_the_stack_still_run() {
        // Terms all made before the first is added must all be kept.
        let mut b = Builder::default();
        let v = b.input(0);
        let terms: Vec<Id> = (0..3 * STACK_SLOTS)
            .map(|i| {
                let factor = b.constant(i as f32);
                b.binary(Binary::Multiply, v, factor)
            })
            .collect();
        let root = terms.into_iter().reduce(|sum, term| b.binary(Binary::Add, sum, term)).unwrap();
        let program = b.finish(root);
        assert!(program.slot_count > STACK_SLOTS);
        assert_eq!(program.eval(&[1.0]), (0..3 * STACK_SLOTS).sum::<usize>() as f32);
    }
}
