//! Points on and off the body as rows over proxy vertices: for handles, and face by face for the surface map.

mod around;
mod paper;
mod ring;

pub use around::Surroundings;
pub use paper::TetMaps;
pub(crate) use paper::wendland;
pub use ring::RingMaps;

use super::Proxy;
use crate::linalg::SparseRow;
use crate::spatial::{Closest, TriangleTree};
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
#[derive(Clone, Debug)]
pub struct HandleRows {
    vertices: usize,
    boundary: Vec<[u32; 3]>,
    tree: TriangleTree,
    maps: Maps,
}

#[derive(Clone, Debug)]
enum Maps {
    Ring(ring::VertexMaps),
    Paper(TetMaps),
}

impl HandleRows {
    /// Prepares the queries against the boundary of `proxy`.
    pub fn new(proxy: &Proxy, kind: MapKind) -> Self {
        Self {
            vertices: proxy.rest.len(),
            boundary: proxy.boundary.clone(),
            tree: TriangleTree::new(&proxy.rest, &proxy.boundary),
            maps: match kind {
                MapKind::Ring => Maps::Ring(ring::VertexMaps::new(proxy)),
                MapKind::Paper => Maps::Paper(TetMaps::new(proxy)),
            },
        }
    }

    /// The same, with only the boundary whose vertices are among `keep`; all of it where none is.
    #[must_use]
    pub fn among(&self, proxy: &Proxy, keep: impl Fn(u32) -> bool) -> Self {
        let boundary: Vec<[u32; 3]> = proxy.boundary.iter().filter(|t| t.iter().all(|&v| keep(v))).copied().collect();
        if boundary.is_empty() {
            return self.clone();
        }
        Self { vertices: self.vertices, tree: TriangleTree::new(&proxy.rest, &boundary), boundary, maps: self.maps.clone() }
    }

    /// Row of a point on, inside or outside the body; applied to the rest pose it gives `point`. Sums to 1.
    /// Empty if the proxy has no boundary.
    ///
    /// [`MapKind::Ring`]: the closest boundary point by its barycentric coordinates, and from there along the mean gradients of the
    /// tetrahedra at its corners, blended likewise: exact on affine maps, continuous over edges, and slivers get no say.
    pub fn row(&self, point: DVec3) -> SparseRow {
        let mut sum = RowSum::new(self.vertices);
        match &self.maps {
            Maps::Paper(maps) => maps.row(point, &mut sum),
            Maps::Ring(maps) => {
                if let Some(foot) = self.tree.closest(point) {
                    let offset = point - foot.point;
                    for (corner, share) in self.boundary[foot.triangle].into_iter().zip(foot.barycentric) {
                        sum.add(corner, share);
                        if share != 0.0 {
                            maps.along(corner, offset * share).for_each(|(v, c)| sum.add(v, c));
                        }
                    }
                }
            }
        }
        sum.take()
    }

    /// Nearest point of the boundary; of rows for the whole of it, the triangle is an index into [`Proxy::boundary`]. `None` if the proxy has none.
    pub fn closest(&self, point: DVec3) -> Option<Closest> {
        self.tree.closest(point)
    }

    /// Distance from the boundary, negative inside the body. Infinite if the proxy has no boundary.
    pub fn distance(&self, point: DVec3) -> f64 {
        let distance = self.tree.closest(point).map_or(f64::INFINITY, |c| c.distance);
        if distance.is_finite() && self.tree.winding(point) > 0.5 { -distance } else { distance }
    }
}

/// Sums up coefficients by vertex, in the order in which they come.
#[derive(Clone, Debug)]
pub struct RowSum {
    values: Vec<f64>,
    touched: Vec<u32>,
    is_touched: Vec<bool>,
}

impl RowSum {
    /// An empty sum over so many vertices.
    pub fn new(vertices: usize) -> Self {
        Self { values: vec![0.0; vertices], touched: Vec::new(), is_touched: vec![false; vertices] }
    }

    /// Adds a coefficient.
    pub fn add(&mut self, vertex: u32, value: f64) {
        let v = vertex as usize;
        if !self.is_touched[v] {
            self.is_touched[v] = true;
            self.touched.push(vertex);
        }
        self.values[v] += value;
    }

    /// The row so far; the sum is empty afterwards.
    pub fn take(&mut self) -> SparseRow {
        self.touched.sort_unstable();
        let indices = std::mem::take(&mut self.touched);
        let mut values = Vec::with_capacity(indices.len());
        for &v in &indices {
            values.push(std::mem::take(&mut self.values[v as usize]));
            self.is_touched[v as usize] = false;
        }
        SparseRow { indices, values }
    }
}

/// Gradients of the four hat functions of a tetrahedron times its signed volume, and that volume.
///
/// V ∇φ is minus a third of the area vector of the face opposite: free of division, so slivers lose nothing.
fn gradients_by_volume(rest: &[DVec3], tet: &[u32; 4]) -> ([DVec3; 4], f64) {
    let [a, b, c, d] = tet.map(|v| rest[v as usize]);
    let sixth = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p) / -6.0;
    let gradients = [sixth(b, c, d), sixth(a, d, c), sixth(a, b, d), sixth(a, c, b)];
    (gradients, (b - a).cross(c - a).dot(d - a) / 6.0)
}

#[cfg(test)]
pub(crate) mod bodies;
#[cfg(test)]
mod tests;
