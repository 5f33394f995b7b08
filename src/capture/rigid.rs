//! The rigid motion that carries a few points onto others in the least-squares sense.

use crate::linalg::eigen;
use glam::{DMat3, DQuat, DVec3};

/// Rotation about the centroid of the source, then a shift to the centroid of the target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    rotation: DMat3,
    from: DVec3,
    to: DVec3,
}

impl Motion {
    /// Least-squares rigid motion from `source` to `target`, both of one length.
    ///
    /// Source: B. Horn, Closed-form solution of absolute orientation using unit quaternions, 1987.
    pub(super) fn fit(source: &[DVec3], target: &[DVec3]) -> Self {
        let (from, to) = (centroid(source), centroid(target));
        let mut s = [[0.0; 3]; 3];
        for (a, b) in source.iter().zip(target) {
            let (a, b) = ((*a - from).to_array(), (*b - to).to_array());
            for i in 0..3 {
                for j in 0..3 {
                    s[i][j] += a[i] * b[j];
                }
            }
        }
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
        let (_, q) = eigen::largest([
            [xx + yy + zz, yz - zy, zx - xz, xy - yx],
            [yz - zy, xx - yy - zz, xy + yx, zx + xz],
            [zx - xz, xy + yx, yy - xx - zz, yz + zy],
            [xy - yx, zx + xz, yz + zy, zz - xx - yy],
        ]);
        Self { rotation: DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize()), from, to }
    }

    /// Where a point goes.
    pub(super) fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * (p - self.from) + self.to
    }
}

/// Root mean square extent along the second principal axis: how far points are from lying on one line.
pub(super) fn width(points: &[DVec3]) -> f64 {
    let c = centroid(points);
    let mut m = [[0.0; 3]; 3];
    for p in points {
        let d = (*p - c).to_array();
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] += d[i] * d[j] / points.len() as f64;
            }
        }
    }
    let trace = m[0][0] + m[1][1] + m[2][2];
    eigen::symmetric(m).0[1].clamp(0.0, trace).sqrt()
}

fn centroid(points: &[DVec3]) -> DVec3 {
    points.iter().sum::<DVec3>() / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_of_three_points_is_found() {
        let source = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, -1.0, 0.5), DVec3::new(0.0, 1.0, -2.0)];
        for (axis, angle) in [(DVec3::X, 3.1), (DVec3::new(0.6, 0.0, 0.8), -1.2), (DVec3::Z, 0.0)] {
            let q = DQuat::from_axis_angle(axis, angle);
            let shift = DVec3::new(1000.0, -20.0, 7.0);
            let motion = Motion::fit(&source, &source.map(|p| q * p + shift));
            let other = DVec3::new(9.0, 9.0, -9.0);
            assert!(motion.apply(other).distance(q * other + shift) < 1e-10);
        }
    }

    #[test]
    fn width_is_zero_on_a_line() {
        let line = [DVec3::ZERO, DVec3::new(1.0, 2.0, 2.0), DVec3::new(3.0, 6.0, 6.0)];
        assert!(width(&line) < 1e-7);
        let square = [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0, DVec3::new(2.0, 2.0, 0.0)];
        assert!((width(&square) - 1.0).abs() < 1e-12);
    }
}
