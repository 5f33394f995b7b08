//! Pose transfer as Stoll et al. 2007 print it: (2.9)–(2.12).

use super::ring::centre;
use super::{Proxy, RowSum, gradients_by_volume};
use crate::spatial::{Neighbour, PointTree};
use glam::DVec3;

/// Radius r, as a fraction of the diagonal of the rest pose's box.
const RADIUS: f64 = 0.05;
/// Below this sum of weights a point counts as having no centre within r.
const NOTHING: f64 = 1e-12;

/// The tetrahedron behind each boundary face, found by the centre of the face.
///
/// One term per boundary face: a tetrahedron with two of them enters twice. (2.9) prints cᵢ(k), where cᵢ(j) is meant.
/// The paper says nothing of points without a centre within r: they take twice the distance of the nearest centre as their radius.
#[derive(Clone, Debug)]
pub struct TetMaps {
    centres: PointTree,
    radius: f64,
    tets: Vec<Barycentric>,
}

/// cₖ(x) = value at the tetrahedron's first corner + gradientₖ · (x − corner).
#[derive(Clone, Debug)]
struct Barycentric {
    vertices: [u32; 4],
    corner: DVec3,
    gradients: [DVec3; 4],
}

impl Barycentric {
    fn new(rest: &[DVec3], tet: &[u32; 4]) -> Self {
        let (gradients, volume) = gradients_by_volume(rest, tet);
        Self { vertices: *tet, corner: rest[tet[0] as usize], gradients: gradients.map(|g| g / volume) }
    }

    fn coordinates(&self, point: DVec3) -> [f64; 4] {
        let offset = point - self.corner;
        let [_, b, c, d] = self.gradients.map(|g| g.dot(offset));
        [1.0 - b - c - d, b, c, d]
    }
}

impl TetMaps {
    /// Prepares the search for face centres.
    pub fn new(proxy: &Proxy) -> Self {
        let (lo, hi) = proxy.rest.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)));
        let centres: Vec<DVec3> = proxy.boundary.iter().map(|face| centre(&proxy.rest, face)).collect();
        Self {
            centres: PointTree::new(&centres),
            radius: RADIUS * (hi - lo).length(),
            tets: proxy.boundary_tets.iter().map(|&t| Barycentric::new(&proxy.rest, &proxy.tets[t as usize])).collect(),
        }
    }

    /// Adds the row of (2.12) for one point to `sum`; nothing if there is no boundary face.
    pub fn row(&self, point: DVec3, sum: &mut RowSum) {
        let mut near = Vec::new();
        let mut weights = self.weigh(point, self.radius, &mut near);
        if weights.iter().sum::<f64>() < NOTHING {
            self.centres.nearest(point, 1, &mut near);
            let Some(nearest) = near.first() else { return };
            weights = self.weigh(point, 2.0 * nearest.distance, &mut near);
        }
        let total: f64 = weights.iter().sum();
        for (face, weight) in near.iter().zip(weights) {
            let tet = &self.tets[face.point];
            for (vertex, c) in tet.vertices.into_iter().zip(tet.coordinates(point)) {
                sum.add(vertex, c * (weight / total));
            }
        }
    }

    fn weigh(&self, point: DVec3, radius: f64, near: &mut Vec<Neighbour>) -> Vec<f64> {
        self.centres.within(point, radius, near);
        near.iter().map(|n| wendland(n.distance / radius)).collect()
    }
}

/// (2.10): smooth, 1 at 0, and 0 from 1 on.
pub(crate) fn wendland(t: f64) -> f64 {
    let t = t.min(1.0);
    (1.0 - t).powi(4) * (4.0 * t + 1.0)
}
