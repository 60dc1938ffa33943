//! Finding what a ray meets: trees of boxes over triangles and over placements, nested.
//!
//! A [`Level`] is a tree whose leaves are either blocks of triangles or placements of another
//! level. Levels nest to any depth up to [`MAX_DEPTH`]; the ray is taken into the space of each
//! instance it enters, with its parameter `t` unchanged, because directions are scaled along.
//!
//! Pairs of triangles that make a parallelogram are joined, and long ones aslant are cut into
//! several boxes (`split`). Trees are built as binary trees by binned surface-area heuristics
//! [Wald07], or, for meshes of many millions of triangles, by the faster agglomerative clustering
//! of `obvhs` [MB18], and are then collapsed to eight children a node [Ylitie17]. Where placements
//! crowd each other their parts go into the tree (`braid`).
//!
//! Each of these was measured against Embree 4.4 on eight sets of rays through a wood
//! (`benches/peers/ray_sets.rs`): 0.94 of its rate at first (geometric mean), 1.17 with
//! parallelograms and the nearest child kept in hand, 1.20 with the collapse by expected work,
//! 1.39 with cut triangles.
//!
//! Why not the walks of `obvhs` too: on the rays of [`probe`](crate::probe) through 500,000
//! random leaves, one thread, ours takes 0.66 million rays a second, its CWBVH 0.41 and its BVH2
//! 0.21 (medium build, its packed triangles), although ours enters an instance on the way. That
//! is 1.6 and 3.1 times as many; the ignored test `our_walk_outruns_that_of_obvhs_on_the_rays_of_probe`
//! measures it again.

mod bounds;
mod braid;
mod build;
mod lanes;
mod level;
mod split;
mod tight;
mod traverse;

pub(crate) use bounds::Bounds;
pub(crate) use level::{Content, Instance, Level, Triangle, join_pairs};
pub(crate) use traverse::{Hit, Levels, MAX_DEPTH, Place, Ray, Scratch};
