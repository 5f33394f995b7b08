//! Scan → [`Proxy`]: the coarse tetrahedral body that the deformer poses.

use glam::DVec3;
use serde::{Deserialize, Serialize};

mod apart;
mod build;
pub(crate) mod canonical;
mod caps;
mod carve;
mod components;
mod contacts;
#[cfg(test)]
pub(crate) mod corpus;
mod decimate;
mod delaunay;
mod edges;
#[cfg(test)]
pub(crate) mod figure;
mod ground;
mod lattice;
pub mod medit;
mod parting;
mod pieces;
mod refine;
pub mod rows;
mod shell;
#[cfg(test)]
mod tests;
mod tetrahedra;
mod weld;

pub use apart::carry_back;
pub use build::{BuildOptions, Built, Form, Summary, build};

/// A tetrahedral body around or inside a scan, in the unit box of the scan (see [`crate::scan::UnitBox`]).
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Proxy {
    /// Rest positions; every vertex belongs to a tetrahedron.
    pub rest: Vec<DVec3>,
    /// Tetrahedra of positive volume (flat ones are removed from this list once the boundary is known).
    pub tets: Vec<[u32; 4]>,
    /// Triangles that bound the body, seen from outside counter-clockwise.
    pub boundary: Vec<[u32; 3]>,
    /// Tetrahedron behind each boundary triangle (index into `tets`); where that one was flat, a counted neighbour.
    pub boundary_tets: Vec<u32>,
    /// Component of each tetrahedron, numbered from 0. Components have no vertex in common, so each needs handles of its own.
    pub components: Vec<u32>,
}
