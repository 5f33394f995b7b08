//! Principal axes of points.

use glam::{DMat3, DVec3};

/// Unit eigenvectors of a symmetric matrix as columns, largest eigenvalue first; right-handed.
///
/// Cyclic Jacobi rotations, which converge for every symmetric matrix (Golub and Van Loan, Matrix Computations, §8.5).
/// Not [`crate::linalg::eigen`]: the last digits of every landmark, and so of every take, hang on the rounding of these lines.
pub(super) fn principal_axes(symmetric: DMat3) -> DMat3 {
    let mut a = symmetric.to_cols_array_2d();
    let mut v = DMat3::IDENTITY.to_cols_array_2d();
    for _ in 0..24 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
            let c = 1.0 / t.hypot(1.0);
            let s = t * c;
            for row in &mut a {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            for k in 0..3 {
                (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
                (v[p][k], v[q][k]) = (c * v[p][k] - s * v[q][k], s * v[p][k] + c * v[q][k]);
            }
            (a[p][q], a[q][p]) = (0.0, 0.0);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[j][j].total_cmp(&a[i][i]));
    let first = DVec3::from_array(v[order[0]]).normalize_or(DVec3::X);
    let second = DVec3::from_array(v[order[1]]).normalize_or(DVec3::Y);
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
