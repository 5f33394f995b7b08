//! Queries against triangles: closest point, ray, winding number. Imports nobody.

use glam::DVec3;

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

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle.
    pub triangle: usize,
    /// Distance along the unit direction.
    pub distance: f64,
}

/// A bounding volume hierarchy over triangles.
#[derive(Clone, Debug)]
pub struct TriangleTree {}

impl TriangleTree {
    /// Builds the hierarchy; points and triangles are copied.
    pub fn new(points: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let _ = (points, triangles);
        unimplemented!()
    }

    /// Nearest point of the triangles; `None` when there is no triangle.
    pub fn closest(&self, query: DVec3) -> Option<Closest> {
        let _ = query;
        unimplemented!()
    }

    /// All hits of a ray from `origin` along `direction` (any length but zero), nearest first.
    pub fn hits(&self, origin: DVec3, direction: DVec3) -> Vec<Hit> {
        let _ = (origin, direction);
        unimplemented!()
    }

    /// Generalized winding number at a point: 1 inside a closed surface, 0 outside.
    pub fn winding(&self, query: DVec3) -> f64 {
        let _ = query;
        unimplemented!()
    }
}
