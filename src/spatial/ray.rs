//! Rays through the triangles.

use super::{Node, STACK, TriangleTree};
use glam::DVec3;

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle.
    pub triangle: usize,
    /// Distance along the unit direction.
    pub distance: f64,
}

impl TriangleTree {
    /// All hits of a ray from `origin` along `direction` (any length but zero), nearest first.
    ///
    /// Edges belong to both of their triangles: no ray slips between two triangles, and one that meets a shared edge exactly hits both.
    /// Triangles seen edge-on are not hit.
    pub fn hits(&self, origin: DVec3, direction: DVec3) -> Vec<Hit> {
        let mut found = Vec::new();
        let Some(ray) = Ray::new(origin, direction) else { return found };
        if self.nodes.is_empty() {
            return found;
        }
        let mut stack = [0u32; STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let here = stack[height];
            let node = &self.nodes[here as usize];
            if !ray.meets(node) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.start;
                stack[height + 1] = here + 1;
                height += 2;
                continue;
            }
            for k in node.start as usize..(node.start + node.count) as usize {
                if let Some(distance) = ray.distance(&self.corners[k]) {
                    found.push(Hit { triangle: self.ids[k] as usize, distance });
                }
            }
        }
        found.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.triangle.cmp(&b.triangle)));
        found
    }
}

/// A ray in the frame of Woop, Benthin, Wald 2013 (watertight intersection): sheared so that it runs along one axis.
struct Ray {
    origin: DVec3,
    inverse: DVec3,
    axes: [usize; 3],
    shear: DVec3,
}

impl Ray {
    fn new(origin: DVec3, direction: DVec3) -> Option<Self> {
        // First by the largest component, so that neither a tiny nor a huge length leaves the range of numbers.
        let direction = (direction / direction.abs().max_element()).try_normalize()?;
        if !origin.is_finite() {
            return None;
        }
        let z = direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = DVec3::new(direction[x], direction[y], 1.0) / direction[z];
        Some(Self { origin, inverse: direction.recip(), axes: [x, y, z], shear })
    }

    fn meets(&self, node: &Node) -> bool {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for k in 0..3 {
            let a = (node.lo[k] - self.origin[k]) * self.inverse[k];
            let b = (node.hi[k] - self.origin[k]) * self.inverse[k];
            // 0 · ∞ is not a number, which min and max pass over: a ray inside a face of the box counts as a hit.
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        // Widened by the rounding of the three slabs (Ize 2013).
        near <= far * (1.0 + 4.0 * f64::EPSILON)
    }

    fn distance(&self, corners: &[DVec3; 3]) -> Option<f64> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|p| {
            let p = p - self.origin;
            DVec3::new(p[x] - self.shear.x * p[z], p[y] - self.shear.y * p[z], self.shear.z * p[z])
        });
        let u = c.x * b.y - c.y * b.x;
        let v = a.x * c.y - a.y * c.x;
        let w = b.x * a.y - b.y * a.x;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let distance = (u * a.z + v * b.z + w * c.z) / determinant;
        (distance >= 0.0 && distance.is_finite()).then_some(distance)
    }
}
