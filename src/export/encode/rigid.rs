//! Rigid motions and their fit to points.

use crate::linalg::eigen;
use glam::{DMat3, DQuat, DVec3};

/// `p ↦ rotation · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// A proper rotation.
    pub rotation: DMat3,
    /// Added after the rotation.
    pub translation: DVec3,
}

/// A [`Rigid`] in storage: quaternion x, y, z, w, then the translation. Single precision is a ten-thousandth of the encoder's tolerance.
pub type Packed = [f32; 7];

impl Rigid {
    /// No motion.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// The moved point.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * p + self.translation
    }

    /// The point that this motion moves to `q`.
    pub fn undo(&self, q: DVec3) -> DVec3 {
        self.rotation.transpose() * (q - self.translation)
    }

    /// For storage.
    pub fn pack(&self) -> Packed {
        let q = DQuat::from_mat3(&self.rotation).normalize();
        let t = self.translation;
        [q.x as f32, q.y as f32, q.z as f32, q.w as f32, t.x as f32, t.y as f32, t.z as f32]
    }

    /// From storage.
    pub fn unpack(p: &Packed) -> Self {
        let q = DQuat::from_xyzw(p[0].into(), p[1].into(), p[2].into(), p[3].into()).normalize();
        Self { rotation: DMat3::from_quat(q), translation: DVec3::new(p[4].into(), p[5].into(), p[6].into()) }
    }

    /// [`Self::fit`] of those points that `some` names.
    pub fn fit_some(rest: &[DVec3], pose: &[DVec3], some: &[u32]) -> Option<Self> {
        Self::fit(some.iter().map(|&i| (rest[i as usize], pose[i as usize])))
    }

    /// The motion nearest in the least-squares sense to `pairs` of rest and moved points (Kabsch 1976); `None` for fewer than four pairs.
    pub fn fit(pairs: impl Iterator<Item = (DVec3, DVec3)> + Clone) -> Option<Self> {
        let (count, p, q) = pairs.clone().fold((0usize, DVec3::ZERO, DVec3::ZERO), |(n, a, b), (p, q)| (n + 1, a + p, b + q));
        if count < 4 {
            return None;
        }
        let (p_mean, q_mean) = (p / count as f64, q / count as f64);
        let mut covariance = DMat3::ZERO;
        let mut spread = 0.0;
        for (p, q) in pairs {
            covariance += outer(q - q_mean, p - p_mean);
            spread += (p - p_mean).length_squared();
        }
        // A hair of the identity decides what points on a plane or a line leave open.
        covariance += DMat3::IDENTITY * (1e-6 * spread);
        let rotation = nearest_rotation(&covariance, &DMat3::IDENTITY);
        Some(Self { rotation, translation: q_mean - rotation * p_mean })
    }
}

/// `a bᵀ`.
pub fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// The rotation `R` that maximises `trace(Rᵀ h)`.
///
/// Newton's method from `start`, which from a neighbouring pose takes two or three steps. A maximum of this function on the rotations is the
/// global one, so convergence with a positive definite Hessian is proof; otherwise the answer comes from Horn's quaternion matrix (Horn 1987).
pub fn nearest_rotation(h: &DMat3, start: &DMat3) -> DMat3 {
    let mut rotation = *start;
    for _ in 0..8 {
        let s = *h * rotation.transpose();
        let torque = DVec3::new(s.y_axis.z - s.z_axis.y, s.z_axis.x - s.x_axis.z, s.x_axis.y - s.y_axis.x);
        let Some(step) = solve_hessian(&s, torque) else { return horn(h) };
        let angle = step.length();
        if !angle.is_finite() || angle > 2.0 {
            return horn(h);
        }
        // As good as the exponential map for a step that is small, and it costs no sine.
        rotation = DMat3::from_quat(DQuat::from_xyzw(0.5 * step.x, 0.5 * step.y, 0.5 * step.z, 1.0).normalize()) * rotation;
        if angle < 3e-5 {
            // The next step would be the square of this one.
            return DMat3::from_quat(DQuat::from_mat3(&rotation).normalize());
        }
    }
    horn(h)
}

/// Solves `(trace(s) I − sym(s)) x = b` by Cholesky; `None` unless clearly positive definite.
fn solve_hessian(s: &DMat3, b: DVec3) -> Option<DVec3> {
    let trace = s.x_axis.x + s.y_axis.y + s.z_axis.z;
    let (a00, a11, a22) = (trace - s.x_axis.x, trace - s.y_axis.y, trace - s.z_axis.z);
    let (a10, a20, a21) = (-0.5 * (s.x_axis.y + s.y_axis.x), -0.5 * (s.x_axis.z + s.z_axis.x), -0.5 * (s.y_axis.z + s.z_axis.y));
    let floor = 1e-10 * (a00.abs() + a11.abs() + a22.abs());
    if a00 <= floor {
        return None;
    }
    let (l10, l20) = (a10 / a00, a20 / a00);
    let d1 = a11 - l10 * a10;
    if d1 <= floor {
        return None;
    }
    let l21 = (a21 - l20 * a10) / d1;
    let d2 = a22 - l20 * a20 - l21 * l21 * d1;
    if d2 <= floor {
        return None;
    }
    let y = DVec3::new(b.x, b.y - l10 * b.x, b.z - l20 * b.x - l21 * (b.y - l10 * b.x));
    let z = y.z / d2;
    let yy = y.y / d1 - l21 * z;
    Some(DVec3::new(y.x / a00 - l10 * yy - l20 * z, yy, z))
}

/// The quaternion of the largest eigenvalue of Horn's symmetric matrix.
fn horn(h: &DMat3) -> DMat3 {
    let m = h.transpose();
    let (xx, xy, xz) = (m.x_axis.x, m.y_axis.x, m.z_axis.x);
    let (yx, yy, yz) = (m.x_axis.y, m.y_axis.y, m.z_axis.y);
    let (zx, zy, zz) = (m.x_axis.z, m.y_axis.z, m.z_axis.z);
    let a = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    let (_, q) = eigen::largest(a);
    let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    if quaternion.is_finite() { DMat3::from_quat(quaternion.normalize()) } else { DMat3::IDENTITY }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn cloud() -> Vec<DVec3> {
        (0..20).map(|i| DVec3::new((i as f64 * 0.7).sin(), (i as f64 * 1.3).cos(), (i as f64 * 0.31).sin() * 0.5)).collect()
    }

    #[test]
    fn a_rigid_motion_is_found_for_any_angle() {
        for step in 0..40 {
            let angle = step as f64 * std::f64::consts::PI / 20.0;
            let truth = Rigid {
                rotation: DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), angle),
                translation: DVec3::new(3.0, -1.0, 0.25),
            };
            let points = cloud();
            let found = Rigid::fit(points.iter().map(|&p| (p, truth.apply(p)))).unwrap();
            for p in points {
                assert!((found.apply(p) - truth.apply(p)).length() < 1e-5 * (1.0 + angle), "{angle}");
                assert!((found.undo(found.apply(p)) - p).length() < 1e-12);
            }
        }
    }

    #[test]
    fn newton_and_horn_agree_and_a_reflection_gives_a_rotation() {
        for seed in 0..50 {
            let x = |k: f64| (seed as f64 * 1.7 + k).sin();
            let h = DMat3::from_cols(
                DVec3::new(x(0.0), x(1.0), x(2.0)),
                DVec3::new(x(3.1), x(4.7), x(5.9)),
                DVec3::new(x(7.3), x(9.2), x(11.9)),
            );
            let (a, b) = (nearest_rotation(&h, &DMat3::IDENTITY), horn(&h));
            assert!((a.determinant() - 1.0).abs() < 1e-12);
            let value = |r: &DMat3| (r.transpose() * h).to_cols_array().iter().step_by(4).sum::<f64>();
            assert!((value(&a) - value(&b)).abs() < 1e-10, "{seed}");
        }
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 0.9, -0.8));
        assert!((nearest_rotation(&mirror, &DMat3::IDENTITY).determinant() - 1.0).abs() < 1e-12);
    }
}
