//! Proxy pose → scan pose: the smooth local map, and normals.

mod apply;
mod fans;
mod fitted;
mod normals;
mod paper;
mod pieces;
mod ring;
mod side;

pub use fans::Fans;
pub use normals::NormalVertices;

use crate::error::{Error, Result};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::MapKind;
use crate::scan::Faces;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Poses that one [`SurfaceMap::apply`] takes at most.
pub const BATCH: usize = 8;

/// The map `B` from proxy vertices to scan vertices (Stoll et al. 2007, §2.4), stored as faces with weights.
///
/// [`MapKind::Ring`]: every boundary face of the proxy carries an affine map, its posed centre and the mean gradient of the tetrahedra
/// around it; a scan vertex blends the maps of the faces around its foot point on the boundary. [`MapKind::Paper`]: one sparse row per
/// vertex. Both are exact on affine maps. Memory: about 75 and 4,000 bytes per vertex.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SurfaceMap {
    kind: Kind,
}

/// Proxy and scan at rest with parts that touch held apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Apart {
    /// Vertices of the proxy.
    pub proxy: Vec<DVec3>,
    /// Vertices of the scan.
    pub points: Vec<DVec3>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Kind {
    Ring(ring::RingMap),
    Paper(paper::PaperMap),
}

impl SurfaceMap {
    /// Builds the map for points in the unit box.
    ///
    /// Errors: a proxy without boundary; a point that is not finite.
    pub fn build(proxy: &Proxy, points: &[DVec3], kind: MapKind) -> Result<Self> {
        Self::build_with(proxy, points, None, None, kind)
    }

    /// Builds the map so that small loose pieces (hair, lashes, debris: smaller than 5 % of the diagonal and off the body) move as one:
    /// all their vertices follow the place where the piece is nearest. Where parts touch or overlap at rest (an arm against the trunk), vertices
    /// follow the part that the skin around them follows ([`MapKind::Ring`]). `faces` are the scan's, over `points`.
    pub fn build_by_pieces(proxy: &Proxy, points: &[DVec3], faces: &Faces, kind: MapKind) -> Result<Self> {
        Self::build_with(proxy, points, Some(faces), None, kind)
    }

    /// The same where it is known how parts that touch are held apart: each vertex follows what it is nearest to then ([`MapKind::Ring`]).
    pub fn build_apart(proxy: &Proxy, points: &[DVec3], faces: &Faces, apart: &Apart, kind: MapKind) -> Result<Self> {
        Self::build_with(proxy, points, Some(faces), Some(apart), kind)
    }

    fn build_with(proxy: &Proxy, points: &[DVec3], faces: Option<&Faces>, apart: Option<&Apart>, kind: MapKind) -> Result<Self> {
        if proxy.boundary.is_empty() {
            return Err(Error::refused("the proxy has no boundary"));
        }
        if let Some(v) = points.iter().position(|p| !p.is_finite()) {
            return Err(Error::malformed("a coordinate that is not a finite number").at(format!("vertex {}", v + 1)));
        }
        let kind = match kind {
            MapKind::Ring => Kind::Ring(ring::RingMap::build(proxy, points, faces, apart)),
            MapKind::Paper => Kind::Paper(paper::PaperMap::build(proxy, points)),
        };
        Ok(Self { kind })
    }

    /// The map of given rows, one per scan vertex, over so many points of a proxy.
    pub fn of_rows(proxy_vertices: usize, rows: impl IntoIterator<Item = SparseRow>) -> Self {
        Self { kind: Kind::Paper(paper::PaperMap::of_rows(proxy_vertices, rows)) }
    }

    /// Number of scan vertices.
    pub fn len(&self) -> usize {
        match &self.kind {
            Kind::Ring(map) => map.len(),
            Kind::Paper(map) => map.len(),
        }
    }

    /// Whether there is no scan vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of pairs and points (rows) that an application reads, faces and poses besides.
    pub fn bytes(&self) -> usize {
        match &self.kind {
            Kind::Ring(map) => map.bytes(),
            Kind::Paper(map) => map.bytes(),
        }
    }

    /// Maps up to eight proxy poses; `out[f]` receives the scan vertices of `poses[f]` (resized where needed, else nothing is allocated).
    ///
    /// Shapes: `poses`: ≤ 8 × n; `out`: as many × [`SurfaceMap::len`]. Unit box. The bits of a frame depend neither on the frames beside
    /// it nor on the number of threads nor on the vector instructions of the processor. Panics when the shapes differ.
    /// Cost: eight frames together cost about as much as three alone.
    pub fn apply(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        assert!(poses.len() <= BATCH && poses.len() == out.len(), "{} poses, {} outputs", poses.len(), out.len());
        for points in out.iter_mut() {
            points.resize(self.len(), [0.0; 3]);
        }
        self.apply_with(apply::Avx2::detect(), poses, out);
    }

    fn apply_with(&self, avx2: Option<apply::Avx2>, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        match (&self.kind, poses.len()) {
            (_, 0) => {}
            (Kind::Ring(map), 1) => map.apply::<1>(avx2, poses, out),
            (Kind::Ring(map), 2..=4) => map.apply::<4>(avx2, poses, out),
            (Kind::Ring(map), _) => map.apply::<BATCH>(avx2, poses, out),
            (Kind::Paper(map), 1) => map.apply::<1>(avx2, poses, out),
            (Kind::Paper(map), 2..=4) => map.apply::<4>(avx2, poses, out),
            (Kind::Paper(map), _) => map.apply::<BATCH>(avx2, poses, out),
        }
    }

    /// The row of one scan vertex over proxy vertices. Sums to 1; applied to the rest pose it gives the vertex to the precision of f32.
    pub fn row(&self, vertex: usize) -> SparseRow {
        match &self.kind {
            Kind::Ring(map) => map.row(vertex),
            Kind::Paper(map) => map.row(vertex),
        }
    }

    /// Which vertices of the proxy the rows of the given scan vertices may have coefficients for.
    pub fn reads(&self, vertices: &[u32]) -> Vec<bool> {
        match &self.kind {
            Kind::Ring(map) => map.reads(vertices),
            Kind::Paper(map) => map.reads(vertices),
        }
    }
}

/// Points in single precision, as the outputs want them; `out` is resized where needed, else nothing is allocated.
pub fn single_precision(points: &[DVec3], out: &mut Vec<[f32; 3]>) {
    out.clear();
    out.extend(points.iter().map(|p| p.as_vec3().to_array()));
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod touching;
