//! Principal axes of points.

use crate::linalg::eigen;
use glam::{DMat3, DVec3};

/// Unit eigenvectors of a symmetric matrix as columns, largest eigenvalue first; right-handed.
pub(super) fn principal_axes(symmetric: DMat3) -> DMat3 {
    let (_, [_, second, first]) = eigen::symmetric(symmetric.to_cols_array_2d());
    let first = DVec3::from_array(first).normalize_or(DVec3::X);
    let second = DVec3::from_array(second).normalize_or(DVec3::Y);
    DMat3::from_cols(first, second, first.cross(second))
}

/// A straight line fitted to points by least squares: centre and unit direction from the first to the last point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) centre: DVec3,
    pub(super) direction: DVec3,
}

impl Line {
    /// `None` for fewer than two points or points without extent.
    pub(super) fn through(points: &[DVec3]) -> Option<Self> {
        let (first, last) = (points.first()?, points.last()?);
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let mut spread = DMat3::ZERO;
        for p in points {
            let d = *p - centre;
            spread += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        }
        if first == last || spread == DMat3::ZERO {
            return None;
        }
        let direction = principal_axes(spread).x_axis;
        let direction = if direction.dot(*last - *first) < 0.0 { -direction } else { direction };
        Some(Self { centre, direction })
    }

    /// The place on the line at a signed distance from its centre.
    pub(super) fn at(&self, distance: f64) -> DVec3 {
        self.centre + self.direction * distance
    }

    /// Signed distance along the line of the point's foot.
    pub(super) fn along(&self, p: DVec3) -> f64 {
        (p - self.centre).dot(self.direction)
    }

    /// Squared distance of a point from the line.
    pub(super) fn distance_squared(&self, p: DVec3) -> f64 {
        (p - self.at(self.along(p))).length_squared()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn axes_of_a_turned_ellipsoid_are_its_own() {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.1);
        let spread = turn * DMat3::from_diagonal(DVec3::new(2.0, 5.0, 1.0)) * turn.transpose();
        let axes = principal_axes(spread);
        for (axis, expected) in [(axes.x_axis, turn.y_axis), (axes.y_axis, turn.x_axis), (axes.z_axis, turn.z_axis)] {
            assert!(axis.dot(expected).abs() > 1.0 - 1e-12, "{axis} against {expected}");
        }
        assert!((axes.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_line_runs_from_first_to_last() {
        let line = Line::through(&[DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 0.0, 0.0), DVec3::new(1.0, -4.0, 0.0)]).unwrap();
        assert!(line.direction.dot(DVec3::NEG_Y) > 1.0 - 1e-12);
        assert!((line.along(DVec3::new(7.0, -1.0, 3.0))).abs() < 1e-12);
        assert!((line.distance_squared(DVec3::new(4.0, 9.0, 4.0)) - 25.0).abs() < 1e-9);
    }
}
