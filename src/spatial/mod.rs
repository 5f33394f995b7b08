//! Queries against triangles (closest point, ray, winding number) and against points. Imports nobody.

mod build;
mod closest;
mod points;
mod ray;
mod winding;

pub use closest::Closest;
pub use points::{Neighbour, PointTree};
pub use ray::Hit;

use glam::DVec3;

/// A bounding volume hierarchy over triangles.
///
/// Degenerate triangles (a segment, a point) are found by [`TriangleTree::closest`] and are invisible to rays and to the winding number;
/// triangles with a coordinate that is not finite are left out.
#[derive(Clone, Debug, Default)]
pub struct TriangleTree {
    /// Depth first: the left child follows its parent, and every child comes after its parent.
    nodes: Vec<Node>,
    /// One far-field dipole per node.
    dipoles: Vec<winding::Dipole>,
    /// Corners in the order of the leaves.
    corners: Vec<[DVec3; 3]>,
    /// The caller's index of each entry of `corners`.
    ids: Vec<u32>,
}

/// A box around some triangles.
#[derive(Clone, Copy, Debug)]
struct Node {
    lo: DVec3,
    hi: DVec3,
    /// Leaf: first entry of `corners`. Inner node: index of the right child.
    start: u32,
    /// Number of triangles of a leaf; 0 for an inner node.
    count: u32,
}

/// More than the depth of any tree: after [`build::DEPTH_OF_MEDIANS`] levels every split halves the at most 2³² triangles.
const STACK: usize = build::DEPTH_OF_MEDIANS + 34;

impl TriangleTree {
    /// Number of triangles in the tree.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether no triangle is in the tree.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Lower and upper corner of the box around all triangles; `None` when there is no triangle.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.nodes.first().map(|root| (root.lo, root.hi))
    }
}

#[cfg(test)]
pub(crate) mod tests;
