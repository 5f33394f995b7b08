//! The nearest point of the triangles.

use super::{Node, STACK, TriangleTree};
use glam::DVec3;

/// Distances nearer to each other than this share of the largest coordinate are the same: rounding leaves a tenth of it.
const ROUNDING: f64 = 1e-14;

/// The point of a set of triangles nearest to a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Index of the triangle.
    pub triangle: usize,
    /// The nearest point.
    pub point: DVec3,
    /// Its barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
    /// Distance from the query.
    pub distance: f64,
}

impl TriangleTree {
    /// Nearest point of the triangles; `None` when there is no triangle. Of triangles that are equally near but for rounding (over an edge that sticks
    /// out two of them always are) the one with the lowest index.
    pub fn closest(&self, query: DVec3) -> Option<Closest> {
        self.search(query, f64::INFINITY)
    }

    /// Nearest point of the triangles if it is no further than `distance`.
    pub fn closest_within(&self, query: DVec3, distance: f64) -> Option<Closest> {
        self.search(query, distance * distance)
    }

    fn search(&self, query: DVec3, limit: f64) -> Option<Closest> {
        if self.nodes.is_empty() || !query.is_finite() {
            return None;
        }
        let root = &self.nodes[0];
        let rounding = ROUNDING * root.lo.abs().max(root.hi.abs()).max(query.abs()).max_element();
        let mut best: Option<Closest> = None;
        let mut least = f64::INFINITY;
        // Squares: nearer than `sure` is nearer, up to `most` is as near.
        let (mut sure, mut most) = (f64::INFINITY, limit);
        let mut stack = [(0u32, 0.0f64); STACK];
        let mut height = 0;
        let mut here = (0u32, root.squared_distance(query));
        loop {
            if here.1 <= most {
                let node = &self.nodes[here.0 as usize];
                if node.count == 0 {
                    let (left, right) = (here.0 + 1, node.start);
                    let left = (left, self.nodes[left as usize].squared_distance(query));
                    let right = (right, self.nodes[right as usize].squared_distance(query));
                    let (near, far) = if right.1 < left.1 { (right, left) } else { (left, right) };
                    stack[height] = far;
                    height += 1;
                    here = near;
                    continue;
                }
                for k in node.start as usize..(node.start + node.count) as usize {
                    let (point, barycentric) = on_triangle(query, &self.corners[k]);
                    let squared = point.distance_squared(query);
                    let triangle = self.ids[k] as usize;
                    if squared < sure && squared <= limit || squared <= most && best.is_none_or(|b| triangle < b.triangle) {
                        let distance = squared.sqrt();
                        best = Some(Closest { triangle, point, barycentric, distance });
                        if squared < least {
                            least = squared;
                            sure = (distance - rounding).max(0.0).powi(2);
                            most = (distance + rounding).powi(2).min(limit);
                        }
                    }
                }
            }
            if height == 0 {
                return best;
            }
            height -= 1;
            here = stack[height];
        }
    }
}

impl Node {
    fn squared_distance(&self, p: DVec3) -> f64 {
        ((self.lo - p).max(p - self.hi).max(DVec3::ZERO)).length_squared()
    }
}

/// Nearest point of a triangle and its barycentric coordinates, by Voronoi regions (Ericson 2005, §5.1.5).
pub(super) fn on_triangle(p: DVec3, [a, b, c]: &[DVec3; 3]) -> (DVec3, [f64; 3]) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let longest = ab.length_squared().max(ac.length_squared());
    if ab.cross(ac).length_squared() <= 1e-24 * longest * longest {
        return on_segments(p, [*a, *b, *c]);
    }
    let weights = {
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        let (bp, cp) = (p - b, p - c);
        let (d3, d4) = (ab.dot(bp), ac.dot(bp));
        let (d5, d6) = (ab.dot(cp), ac.dot(cp));
        let va = d3 * d6 - d5 * d4;
        let vb = d5 * d2 - d1 * d6;
        let vc = d1 * d4 - d3 * d2;
        if d1 <= 0.0 && d2 <= 0.0 {
            [1.0, 0.0, 0.0]
        } else if d3 >= 0.0 && d4 <= d3 {
            [0.0, 1.0, 0.0]
        } else if d6 >= 0.0 && d5 <= d6 {
            [0.0, 0.0, 1.0]
        } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let t = d1 / (d1 - d3);
            [1.0 - t, t, 0.0]
        } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let t = d2 / (d2 - d6);
            [1.0 - t, 0.0, t]
        } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
            [0.0, 1.0 - t, t]
        } else {
            let (v, w) = (vb / (va + vb + vc), vc / (va + vb + vc));
            [1.0 - v - w, v, w]
        }
    };
    (a + ab * weights[1] + ac * weights[2], weights)
}

/// A flat triangle is its three edges.
fn on_segments(p: DVec3, corners: [DVec3; 3]) -> (DVec3, [f64; 3]) {
    let mut best = (corners[0], [1.0, 0.0, 0.0]);
    let mut least = corners[0].distance_squared(p);
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let along = corners[j] - corners[i];
        let squared = along.length_squared();
        let t = if squared > 0.0 { (along.dot(p - corners[i]) / squared).clamp(0.0, 1.0) } else { 0.0 };
        let point = corners[i] + along * t;
        if point.distance_squared(p) < least {
            least = point.distance_squared(p);
            let mut weights = [0.0; 3];
            weights[i] = 1.0 - t;
            weights[j] = t;
            best = (point, weights);
        }
    }
    best
}
