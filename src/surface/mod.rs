//! Proxy pose → scan pose: the smooth local map, and normals.

use crate::error::Result;
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::MapKind;
use crate::scan::Scan;
use glam::DVec3;

/// The map `B` from proxy vertices to scan vertices (Stoll et al. 2007, §2.4), stored as faces with weights.
#[derive(Clone, Debug)]
pub struct SurfaceMap {}

impl SurfaceMap {
    /// Builds the map for points in the unit box.
    pub fn build(proxy: &Proxy, points: &[DVec3], kind: MapKind) -> Result<Self> {
        let _ = (proxy, points, kind);
        unimplemented!()
    }

    /// Number of scan vertices.
    pub fn len(&self) -> usize {
        unimplemented!()
    }

    /// Whether there is no scan vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Maps up to eight proxy poses; `out[f]` receives the scan vertices of `poses[f]` (resized where needed, else nothing is allocated).
    /// Shapes: `poses`: ≤ 8 × n; `out`: as many × [`SurfaceMap::len`]. Unit box.
    pub fn apply(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        let _ = (poses, out);
        unimplemented!()
    }

    /// The row of one scan vertex over proxy vertices.
    pub fn row(&self, vertex: usize) -> SparseRow {
        let _ = vertex;
        unimplemented!()
    }
}

/// Normal vertices: one per scan vertex, or more where the file has a hard edge (corners of a vertex with different normal indices).
#[derive(Clone, Debug, Default)]
pub struct NormalVertices {
    /// Scan vertex of each normal vertex.
    pub vertices: Vec<u32>,
    /// Normal vertex of each face corner.
    pub corners: Vec<u32>,
}

impl NormalVertices {
    /// One normal vertex per scan vertex first (index = vertex), further ones for hard edges after them.
    pub fn of(scan: &Scan) -> Self {
        let _ = scan;
        unimplemented!()
    }

    /// Angle-weighted unit normals of the posed surface. Shapes: `points`: scan vertices; `out`: normal vertices.
    pub fn compute(&self, scan: &Scan, points: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
        let _ = (scan, points, out);
        unimplemented!()
    }
}
