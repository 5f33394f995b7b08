//! Rigid motions with a scale between the capture's space and the scan's unit box.

use crate::linalg::eigen;
use glam::{DMat3, DQuat, DVec3};

/// Takes points of the capture into the unit box of the scan: `scale · rotation · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Whether the capture's x is negated first (captures stored with mirrored axes).
    pub mirror: bool,
    /// Unit-box lengths per unit of the capture.
    pub scale: f64,
    /// Turns the capture's axes into the scan's.
    pub rotation: DQuat,
    /// Added last, in the unit box.
    pub translation: DVec3,
}

impl Similarity {
    /// Nothing changes.
    pub const IDENTITY: Self = Self { mirror: false, scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// The image of a point.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        let p = if self.mirror { DVec3::new(-p.x, p.y, p.z) } else { p };
        self.rotation * p * self.scale + self.translation
    }

    /// The point whose image this is.
    pub fn undo(&self, image: DVec3) -> DVec3 {
        let p = self.rotation.inverse() * (image - self.translation) / self.scale;
        if self.mirror { DVec3::new(-p.x, p.y, p.z) } else { p }
    }
}

/// The shortest turn from one unit vector to another; opposite vectors turn about a fixed perpendicular.
pub(crate) fn turn_between(from: DVec3, to: DVec3) -> DQuat {
    if from.dot(to) < -1.0 + 1e-12 {
        return DQuat::from_axis_angle(from.any_orthonormal_vector(), std::f64::consts::PI);
    }
    DQuat::from_rotation_arc(from, to)
}

/// What of an upright placement is not to be solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Held {
    /// Turn about the up axis in radians, on top of the shortest turn of up onto up.
    pub yaw: Option<f64>,
    /// Unit-box lengths per unit of the capture.
    pub scale: Option<f64>,
}

/// An upright placement and how well it fits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Upright {
    pub placement: Similarity,
    /// Radians about the scan's up axis.
    pub yaw: f64,
    /// Root of the weighted mean squared distance, in the unit box.
    pub rms: f64,
}

/// Least-squares scale, turn about `up` and shift from `from` (capture, unmirrored already) to `to`; the up axes are made parallel exactly,
/// so that a floor stays a floor. `None` with fewer than three points or no extent.
pub(crate) fn upright(pairs: &[(DVec3, DVec3, f64)], capture_up: DVec3, up: DVec3, held: Held) -> Option<Upright> {
    let total: f64 = pairs.iter().map(|p| p.2).sum();
    if pairs.len() < 3 || total <= 0.0 {
        return None;
    }
    let tilt = turn_between(capture_up, up);
    let mean = |f: &dyn Fn(&(DVec3, DVec3, f64)) -> DVec3| pairs.iter().map(|p| f(p) * p.2).sum::<DVec3>() / total;
    let from = mean(&|p| tilt * p.0);
    let to = mean(&|p| p.1);
    let (mut along, mut across, mut vertical, mut size) = (0.0, 0.0, 0.0, 0.0);
    for &(m, target, w) in pairs {
        let (a, b) = (tilt * m - from, target - to);
        let (au, bu) = (a.dot(up), b.dot(up));
        vertical += w * au * bu;
        along += w * (a.dot(b) - au * bu);
        across += w * up.dot(a.cross(b));
        size += w * a.length_squared();
    }
    if size.is_nan() || size <= 0.0 {
        return None;
    }
    let yaw = held.yaw.unwrap_or_else(|| across.atan2(along));
    let scale = held.scale.unwrap_or((vertical + along * yaw.cos() + across * yaw.sin()) / size);
    if scale.is_nan() || scale <= 0.0 {
        return None;
    }
    let turn = DQuat::from_axis_angle(up, yaw);
    let rotation = turn * tilt;
    let placement = Similarity { mirror: false, scale, rotation, translation: to - turn * from * scale };
    let squared: f64 = pairs.iter().map(|p| p.2 * (placement.apply(p.0) - p.1).length_squared()).sum();
    Some(Upright { placement, yaw, rms: (squared / total).sqrt() })
}

/// Least-squares rotation and shift from the first points of `pairs` to the second: `q · a + t`. `None` with fewer than three.
///
/// Source: Horn 1987, closed form with quaternions; the largest eigenvector of a 4×4 matrix.
pub(crate) fn rigid(pairs: &[(DVec3, DVec3)]) -> Option<(DQuat, DVec3)> {
    if pairs.len() < 3 {
        return None;
    }
    let n = pairs.len() as f64;
    let ca = pairs.iter().map(|p| p.0).sum::<DVec3>() / n;
    let cb = pairs.iter().map(|p| p.1).sum::<DVec3>() / n;
    let mut s = DMat3::ZERO;
    for &(a, b) in pairs {
        let (a, b) = (a - ca, b - cb);
        // Column j holds a · b[j]: s.col(j)[i] = Σ a_i b_j.
        s += DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    }
    let e = |i: usize, j: usize| s.col(j)[i];
    let trace = e(0, 0) + e(1, 1) + e(2, 2);
    let mut m = [[0.0; 4]; 4];
    m[0] = [trace, e(1, 2) - e(2, 1), e(2, 0) - e(0, 2), e(0, 1) - e(1, 0)];
    for i in 0..3 {
        m[i + 1][0] = m[0][i + 1];
        for j in 0..3 {
            m[i + 1][j + 1] = e(i, j) + e(j, i) - if i == j { trace } else { 0.0 };
        }
    }
    let (_, q) = eigen::largest(m);
    let q = DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    q.is_finite().then(|| (q, cb - q * ca))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn cloud() -> Vec<DVec3> {
        (0..12)
            .map(|i| {
                let x = f64::from(i);
                DVec3::new((x * 1.7).sin(), (x * 2.3).cos(), (x * 0.9).sin() * 0.5)
            })
            .collect()
    }

    #[test]
    fn the_rigid_motion_of_a_cloud_is_recovered() {
        let q = DQuat::from_scaled_axis(DVec3::new(2.0, -1.0, 0.7));
        let t = DVec3::new(3.0, -4.0, 5.0);
        let pairs: Vec<_> = cloud().iter().map(|&p| (p, q * p + t)).collect();
        let (found, shift) = rigid(&pairs).unwrap();
        assert!(found.dot(q).abs() > 1.0 - 1e-12);
        assert!((shift - t).length() < 1e-10);
    }

    #[test]
    fn an_upright_placement_is_recovered_across_up_axes() {
        let up = DVec3::Y;
        let truth = DQuat::from_axis_angle(up, 2.2) * turn_between(DVec3::Z, up);
        let pairs: Vec<_> = cloud().iter().map(|&p| (p, truth * p * 0.03 + DVec3::new(1.0, 2.0, 3.0), 1.0)).collect();
        let found = upright(&pairs, DVec3::Z, up, Held::default()).unwrap();
        assert!((found.yaw - 2.2).abs() < 1e-10);
        assert!((found.placement.scale - 0.03).abs() < 1e-12);
        assert!(found.rms < 1e-12);
    }

    #[test]
    fn two_points_and_points_in_one_place_place_nothing() {
        let pair = |p: DVec3| (p, p * 2.0, 1.0);
        let of =
            |points: &[DVec3]| upright(&points.iter().map(|p| pair(*p)).collect::<Vec<_>>(), DVec3::Y, DVec3::Y, Held::default());
        assert!(of(&[DVec3::X, DVec3::Z]).is_none() && of(&[DVec3::X; 4]).is_none() && of(&[]).is_none());
        assert!((of(&[DVec3::X, DVec3::Z, DVec3::Y]).unwrap().placement.scale - 2.0).abs() < 1e-12);
        let unseen: Vec<_> = [DVec3::X, DVec3::Z, DVec3::Y].iter().map(|p| (*p, *p, 0.0)).collect();
        assert!(upright(&unseen, DVec3::Y, DVec3::Y, Held::default()).is_none());
    }

    #[test]
    fn a_capture_upside_down_is_turned_over() {
        let q = turn_between(DVec3::Z, -DVec3::Z);
        assert!((q * DVec3::Z + DVec3::Z).length() < 1e-12);
    }
}
