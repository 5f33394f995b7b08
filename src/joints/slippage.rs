//! Slippage analysis (Xu et al. 2009, §3.2–3.3; Gelfand, Guibas 2004): the rigid motions that leave a surface in itself, read as a joint.

use super::Kind;
use super::samples::Samples;
use crate::linalg::eigen;
use glam::{DMat3, DVec3};

/// A motion slips when the next eigenvalue is this much larger …
const GAP: f64 = 8.0;
/// … and the largest this much larger. Both are the same for 4 to 12 and 10 to 20 on the parametric pieces.
const CUT: f64 = 20.0;
/// Slipping motions that turn at most this much (as singular values of their turns) only shift.
const TURNS: f64 = 0.35;
/// Pitch of a screw, in mean distances per radian, up to which it is a turn.
const PITCH: f64 = 0.25;

/// Eigenvalues of how fast a surface leaves itself.
#[derive(Clone, Debug)]
pub struct Slippage {
    /// Mean squared normal speeds, ascending.
    pub values: [f64; 6],
    /// Turn and shift of each, about `centre`, in units of `scale`.
    motions: [(DVec3, DVec3); 6],
    centre: DVec3,
    scale: f64,
}

/// What slipping motions say of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The type of the joint; [`Kind::Fixed`] where nothing slips.
    pub kind: Kind,
    /// Unit axis of turning or sliding, normal of a plane; zero where there is none.
    pub axis: DVec3,
    /// A point of the axis, the centre of a ball, a point of the plane.
    pub centre: DVec3,
    /// How many motions slip.
    pub slipping: usize,
    /// How clearly they do: the gap to the next eigenvalue. 1 where nothing slips.
    pub gap: f64,
    /// The largest eigenvalue against the smallest.
    pub spread: f64,
    /// Pitch of the screw that slips, in lengths per radian, where that is what was found (read as fixed).
    pub pitch: Option<f64>,
}

impl Slippage {
    /// Of a surface. Places count from their mean and in mean distances from it, so that turns and shifts are commensurable; weighted by area.
    /// `None` where the points have no extent.
    pub fn of(surface: &Samples) -> Option<Self> {
        let area = surface.area();
        let centre = surface.centre();
        let scale = surface.iter().map(|(p, _, w)| w * p.distance(centre)).sum::<f64>() / area;
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let mut matrix = [[0.0; 6]; 6];
        for (p, n, w) in surface.iter() {
            let turn = ((p - centre) / scale).cross(n);
            let row = [turn.x, turn.y, turn.z, n.x, n.y, n.z];
            for i in 0..6 {
                for j in 0..6 {
                    matrix[i][j] += w / area * row[i] * row[j];
                }
            }
        }
        let (values, vectors) = eigen::symmetric(matrix);
        let floor = 1e-9 * values[5];
        Some(Self {
            values: values.map(|v| v.max(floor)),
            motions: vectors.map(|v| (DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5]))),
            centre,
            scale,
        })
    }

    /// The joint that allows the slipping motions: as many as stand apart by a gap of the spectrum, fewer where these form no joint.
    pub fn read(&self) -> Reading {
        let v = &self.values;
        let slipping = (1..=3).rev().find(|&k| v[5] / v[k - 1] > CUT && v[k] / v[k - 1] > GAP).unwrap_or(0);
        let reading = (1..=slipping).rev().find_map(|k| self.as_joint(k));
        reading.unwrap_or(Reading {
            kind: Kind::Fixed,
            axis: DVec3::ZERO,
            centre: self.centre,
            slipping: 0,
            gap: 1.0,
            spread: self.values[5] / self.values[0],
            pitch: None,
        })
    }

    /// The `count` slowest motions as a subalgebra (Table 1 of the paper).
    fn as_joint(&self, count: usize) -> Option<Reading> {
        let motions = &self.motions[..count];
        let gap = self.values[count] / self.values[count - 1];
        let spread = self.values[5] / self.values[0];
        // Left singular vectors of the turns.
        let mut outer = [[0.0; 3]; 3];
        for (r, _) in motions {
            let r = r.to_array();
            for i in 0..3 {
                for j in 0..3 {
                    outer[i][j] += r[i] * r[j];
                }
            }
        }
        let (squares, axes) = eigen::symmetric(outer);
        let turns = squares.iter().filter(|s| s.max(0.0).sqrt() > TURNS).count();
        let main = DVec3::from(axes[2]);
        let reading = |kind, axis, centre| Some(Reading { kind, axis, centre, slipping: count, gap, spread, pitch: None });
        match (count, turns) {
            (3, 3) => {
                // r × q + t = 0 for all three, in the sense of least squares.
                let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
                for (r, t) in motions {
                    let k = skew(*r);
                    normal += k.transpose() * k;
                    right -= k.transpose() * *t;
                }
                let q = normal.inverse() * right;
                let rest: f64 = motions.iter().map(|(r, t)| (r.cross(q) + *t).length_squared()).sum();
                (rest.sqrt() < 0.5).then(|| reading(Kind::Ball, DVec3::ZERO, self.centre + q * self.scale))?
            }
            (3, 1) => reading(Kind::Plane, main, self.centre),
            (2, 1) => {
                // Within the two: the one that turns most, and the one across it, which shifts.
                let along = |(r, _): &(DVec3, DVec3)| r.dot(main);
                let (a, b) = (along(&motions[0]), along(&motions[1]));
                let length = a.hypot(b);
                let (a, b) = (a / length, b / length);
                let turning = (motions[0].0 * a + motions[1].0 * b, motions[0].1 * a + motions[1].1 * b);
                let shift = (motions[1].1 * a - motions[0].1 * b).normalize_or_zero();
                let axis = turning.0.normalize_or_zero();
                if axis.dot(shift).abs() < 0.9 {
                    return None;
                }
                reading(Kind::Cylinder, axis, self.axis_point(turning.0, turning.1))
            }
            (1, 0) => reading(Kind::Prismatic, motions[0].1.normalize_or_zero(), self.centre),
            (1, _) => {
                let (r, t) = motions[0];
                let axis = r.normalize_or_zero();
                let pitch = r.dot(t) / r.length_squared();
                if pitch.abs() > PITCH {
                    let screw = Some(pitch * self.scale);
                    return Some(Reading {
                        kind: Kind::Fixed,
                        axis,
                        centre: self.centre,
                        slipping: 1,
                        gap,
                        spread,
                        pitch: screw,
                    });
                }
                reading(Kind::Revolute, axis, self.axis_point(r, t))
            }
            _ => None,
        }
    }

    /// The point of the axis of a turn nearest to the centre.
    fn axis_point(&self, r: DVec3, t: DVec3) -> DVec3 {
        self.centre + r.cross(t) / r.length_squared() * self.scale
    }
}

/// The matrix of `r ×`.
fn skew(r: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, r.z, -r.y), DVec3::new(-r.z, 0.0, r.x), DVec3::new(r.y, -r.x, 0.0))
}
