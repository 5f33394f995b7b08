//! Where a joint is in its range, and which of its limits hold.

use super::model::{Link, Model};
use super::rows::Pose;
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// Coordinates of a joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coordinates {
    /// Turn of `b` against `a`.
    pub(super) turn: DMat3,
    /// Offset of the centre of `b` in the frame of `a`, in the axes of rest.
    pub(super) offset: DVec3,
    /// About X, nearest to the last one known.
    pub(super) angle: f64,
    /// Along X.
    pub(super) slide: f64,
    /// Of X.
    pub(super) swing: f64,
}

impl Coordinates {
    /// Of a joint in a pose; `last`: its angle before.
    pub(super) fn of(link: &Link, model: &Model, pose: &Pose, last: f64) -> Self {
        let back = pose.turns[link.a].transpose();
        let turn = back * pose.turns[link.b];
        let offset = back * (pose.point(model, link.b, link.centre) - pose.point(model, link.a, link.centre));
        let [x, y, z] = [link.frame.x_axis, link.frame.y_axis, link.frame.z_axis];
        let angle = (z.dot(turn * y) - y.dot(turn * z)).atan2(y.dot(turn * y) + z.dot(turn * z));
        let angle = angle + TAU * ((last - angle) / TAU).round();
        let along = turn * x;
        Self { turn, offset, angle, slide: offset.dot(x), swing: along.cross(x).length().atan2(along.dot(x)) }
    }

    /// The axis about which X swings farther, with `a` turned so.
    pub(super) fn swings(&self, a: DMat3, x: DVec3) -> DVec3 {
        a * x.cross(self.turn * x).normalize_or(x.any_orthonormal_vector())
    }

    /// Angle, slide and swing after a step by its linear model. `turn` and `shift`: of a variable.
    pub(super) fn ahead(&self, link: &Link, model: &Model, pose: &Pose, step: impl Fn(usize) -> (DVec3, DVec3)) -> [f64; 3] {
        let x = link.frame.x_axis;
        let turn_a = pose.turns[link.a];
        let ((turn, shift), (turn_b, shift_b)) = (step(link.a), step(link.b));
        let relative = turn_b - turn;
        let arm = |v: usize| pose.turns[v] * (link.centre - model.origins[v]);
        let offset = shift_b + turn_b.cross(arm(link.b)) - shift - turn.cross(arm(link.a)) - turn.cross(turn_a * self.offset);
        [
            self.angle + relative.dot(turn_a * x),
            self.slide + offset.dot(turn_a * x),
            self.swing + relative.dot(self.swings(turn_a, x)),
        ]
    }
}

/// The values at which limits hold: an active set, carried from step to step and from frame to frame.
///
/// A limit that is passed holds until it would have to pull: until the step that it takes part in, by its linear model, ends on the inner side. Where the
/// step really ends does not count, since turns bend it: limits would be left and met again for ever. A limit that held on its own account while the joint is
/// near it would catch the joint, and let go of it with a jump.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Limits {
    pub(super) angle: Option<f64>,
    pub(super) slide: Option<f64>,
    pub(super) cone: Option<f64>,
}

impl Limits {
    /// Adds those that are passed.
    pub(super) fn meet(&mut self, link: &Link, at: &Coordinates) {
        self.angle = passed(at.angle, link.angle).or(self.angle);
        self.slide = passed(at.slide, link.slide).or(self.slide);
        self.cone = passed(at.swing, to(link.cone)).or(self.cone);
    }

    /// Lets go of those that the linear model of a step does not pass; whether there are any. `ahead`: angle, slide and swing by that model.
    pub(super) fn release(&mut self, link: &Link, ahead: [f64; 3]) -> bool {
        let before = *self;
        self.angle = self.angle.and_then(|_| passed(ahead[0], link.angle));
        self.slide = self.slide.and_then(|_| passed(ahead[1], link.slide));
        self.cone = self.cone.and_then(|_| passed(ahead[2], to(link.cone)));
        *self != before
    }

    pub(super) fn hold(&self) -> bool {
        *self != Self::default()
    }
}

fn to(cone: Option<f64>) -> Option<(f64, f64)> {
    cone.map(|c| (f64::NEG_INFINITY, c))
}

/// The end of a range beyond which a value is.
fn passed(value: f64, range: Option<(f64, f64)>) -> Option<f64> {
    let (lo, hi) = range?;
    if value < lo { Some(lo) } else { (value > hi).then_some(hi) }
}

/// How far a joint is from what it allows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Violation {
    /// Of the anchor, in diagonals.
    pub gap: f64,
    /// Of the axis or the normal, radians.
    pub axis: f64,
    /// Of angle and swing beyond their limits, radians.
    pub limit: f64,
    /// Of the slide beyond its limits, in diagonals.
    pub slide: f64,
}

impl Violation {
    /// Of a joint.
    pub(super) fn of(link: &Link, at: &Coordinates) -> Self {
        use crate::joints::Kind;
        let [x, y, z] = [link.frame.x_axis, link.frame.y_axis, link.frame.z_axis];
        let free: &[DVec3] = match link.kind {
            Kind::Cylinder | Kind::Prismatic => &[x],
            Kind::Plane => &[x, y],
            Kind::Ball | Kind::Revolute | Kind::Fixed => &[],
        };
        let offset = free.iter().fold(at.offset, |o, d| o - *d * o.dot(*d));
        let angle_between = |d: DVec3| (at.turn * d).cross(d).length().atan2((at.turn * d).dot(d));
        let axis = match link.kind {
            Kind::Ball | Kind::Fixed => 0.0,
            Kind::Plane => angle_between(z),
            Kind::Prismatic => angle_between(x).max(angle_between(y)),
            Kind::Cylinder | Kind::Revolute => angle_between(x),
        };
        let beyond = |value: f64, range: Option<(f64, f64)>| range.map_or(0.0, |(lo, hi)| (lo - value).max(value - hi).max(0.0));
        Self {
            gap: offset.length(),
            axis,
            limit: beyond(at.angle, link.angle).max(link.cone.map_or(0.0, |c| (at.swing - c).max(0.0))),
            slide: beyond(at.slide, link.slide),
        }
    }

    /// The larger of each.
    pub(super) fn max(self, other: Self) -> Self {
        Self {
            gap: self.gap.max(other.gap),
            axis: self.axis.max(other.axis),
            limit: self.limit.max(other.limit),
            slide: self.slide.max(other.slide),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::model::{Body, JointSpec, Part, Side};
    use super::*;
    use crate::joints::Kind;
    use glam::DQuat;

    #[test]
    fn the_linear_model_of_a_step_tells_where_a_small_one_ends() {
        let block = |name: &str, at: DVec3| Part {
            name: name.into(),
            points: (0..8).map(|k| at + DVec3::from([k & 1, k >> 1 & 1, k >> 2].map(f64::from)) * 0.2).collect(),
            body: Body::Rigid,
        };
        let x = DVec3::new(0.2, 0.4, 1.0).normalize();
        let z = x.any_orthonormal_vector();
        let joint = JointSpec {
            name: "joint".into(),
            kind: Kind::Cylinder,
            a: Side::Part(0),
            b: Side::Part(1),
            centre: DVec3::new(0.1, 0.05, 0.2),
            frame: DMat3::from_cols(x, z.cross(x), z),
            angle: None,
            slide: None,
            cone: None,
            region: None,
        };
        let model = Model::new(vec![block("a", DVec3::ZERO), block("b", DVec3::Z * 0.3)], &[], &[joint]).unwrap();
        let link = &model.links[0];
        let turn = |seed: f64, size: f64| DVec3::new(seed.sin(), (2.0 * seed).cos(), (3.0 * seed).sin()) * size;
        // Turned about X alone, so that its angle is the turn's, and swung.
        for swing in [0.0, 0.4] {
            let a = DMat3::from_quat(DQuat::from_scaled_axis(turn(1.0, 0.8)));
            let b = a * DMat3::from_axis_angle(z, swing) * DMat3::from_axis_angle(x, 0.6);
            let pose = Pose { turns: vec![a, b], places: vec![turn(4.0, 0.3), turn(5.0, 0.5)] };
            let at = Coordinates::of(link, &model, &pose, 0.0);
            let step = |v: usize| (turn(6.0 + v as f64, 1e-6), turn(8.0 + v as f64, 1e-6));
            let moved = |v: usize| DMat3::from_quat(DQuat::from_scaled_axis(step(v).0)) * pose.turns[v];
            let there = Pose { turns: vec![moved(0), moved(1)], places: (0..2).map(|v| pose.places[v] + step(v).1).collect() };
            let (ahead, real) = (at.ahead(link, &model, &pose, step), Coordinates::of(link, &model, &there, 0.0));
            assert!((ahead[1] - real.slide).abs() < 1e-10, "slide: {} and {}", ahead[1], real.slide);
            if swing > 0.0 {
                assert!((ahead[2] - real.swing).abs() < 1e-10, "swing: {} and {}", ahead[2], real.swing);
            } else {
                assert!((ahead[0] - real.angle).abs() < 1e-10, "angle: {} and {}", ahead[0], real.angle);
            }
        }
    }
}
