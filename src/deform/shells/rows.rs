//! Rows of points on, off and inside a body of triangles.

use super::body::Body;
use crate::linalg::SparseRow;
use crate::proxy::rows::{HandleRows, MapKind};
use glam::{DMat4, DVec3, DVec4};

/// Depth below the surface, in diagonals, from which a point is held by what lies around it on all sides: a joint inside of a limb.
const DEEP: f64 = 0.012;
/// Least distance in the weights, in diagonals.
const NEAR: f64 = 1e-3;
/// A solution that is worse than this share of the row is none.
const EXACT: f64 = 1e-9;

/// Builds rows over [`Body::proxy`].
#[derive(Clone, Debug)]
pub struct SurfaceRows {
    rows: HandleRows,
    vertices: Vec<DVec3>,
}

impl SurfaceRows {
    /// Prepares the queries.
    pub fn new(body: &Body) -> Self {
        Self { rows: HandleRows::new(&body.proxy, MapKind::Ring), vertices: body.proxy.rest[..body.vertices()].to_vec() }
    }

    /// Row of a point; applied to the rest pose it gives the point. Sums to 1.
    ///
    /// Deep inside: the nearest vertex in each of the eight directions around the point, the nearer the heavier. Else as [`HandleRows::row`]: the point of
    /// the surface that is nearest, and from there along the surface and its normal.
    pub fn row(&self, point: DVec3) -> SparseRow {
        if self.rows.distance(point) < -DEEP
            && let Some(row) = self.around(point)
        {
            return row;
        }
        self.rows.row(point)
    }

    fn around(&self, point: DVec3) -> Option<SparseRow> {
        let mut nearest: [Option<(f64, u32)>; 8] = [None; 8];
        for (v, p) in self.vertices.iter().enumerate() {
            let away = *p - point;
            let octant = usize::from(away.x > 0.0) + 2 * usize::from(away.y > 0.0) + 4 * usize::from(away.z > 0.0);
            let square = away.length_squared();
            if nearest[octant].is_none_or(|(least, _)| square < least) {
                nearest[octant] = Some((square, v as u32));
            }
        }
        let mut members: Vec<u32> = nearest.iter().flatten().map(|(_, v)| *v).collect();
        members.sort_unstable();
        // Of all rows that give the point the one with the least sum of squares, each against the inverse square of its distance.
        let ease = |v: u32| 1.0 / self.vertices[v as usize].distance_squared(point).max(NEAR * NEAR);
        let arm = |v: u32| (self.vertices[v as usize] - point).extend(1.0);
        let mut normal = DMat4::ZERO;
        for &v in &members {
            let (a, w) = (arm(v), ease(v));
            normal += DMat4::from_cols(a * (a.x * w), a * (a.y * w), a * (a.z * w), a * (a.w * w));
        }
        let solution = normal.inverse() * DVec4::W;
        let values: Vec<f64> = members.iter().map(|&v| arm(v).dot(solution) * ease(v)).collect();
        let row = SparseRow { indices: members, values };
        let sum: f64 = row.values.iter().sum();
        let is_exact = (sum - 1.0).abs() < EXACT && row.apply(&self.vertices).distance(point) < EXACT;
        (is_exact && row.values.iter().all(|c| c.abs() < 1.0)).then_some(row)
    }
}
