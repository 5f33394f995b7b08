//! Points on and off the body as rows over proxy vertices: for handles, and face by face for the surface map.

use super::Proxy;
use crate::linalg::SparseRow;
use glam::DVec3;

/// How a point follows the tetrahedra.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapKind {
    /// Closest boundary point and gradients averaged over the ring of tetrahedra at its face.
    #[default]
    Ring,
    /// Stoll et al. 2007, (2.9)–(2.12) to the letter: Wendland-weighted barycentric coordinates, radius 5 % of the diagonal.
    Paper,
}

/// Builds rows for handles.
pub struct HandleRows {}

impl HandleRows {
    /// Prepares the queries against the boundary of `proxy`.
    pub fn new(proxy: &Proxy, kind: MapKind) -> Self {
        let _ = (proxy, kind);
        unimplemented!()
    }

    /// Row of a point on, inside or outside the body; applied to the rest pose it gives `point`. Sums to 1.
    pub fn row(&self, point: DVec3) -> SparseRow {
        let _ = point;
        unimplemented!()
    }
}
