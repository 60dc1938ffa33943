//! Finding what a ray meets: trees of boxes over triangles and over placements, nested.
//!
//! A [`Level`] is a tree whose leaves are either blocks of triangles or placements of another
//! level. Levels nest to any depth up to [`MAX_DEPTH`]; the ray is taken into the space of each
//! instance it enters, with its parameter `t` unchanged, because directions are scaled along.
//!
//! Trees are built as binary trees by binned surface-area heuristics [Wald07], or, for meshes of
//! many millions of triangles, by the faster agglomerative clustering of `obvhs` [MB18], and
//! are then collapsed to eight children a node [Ylitie17].

mod bounds;
mod build;
mod lanes;
mod level;
mod traverse;

pub(crate) use bounds::Bounds;
pub(crate) use level::{Content, Instance, Level, Triangle};
pub(crate) use traverse::{Hit, Levels, MAX_DEPTH, Place, Ray, Scratch};
