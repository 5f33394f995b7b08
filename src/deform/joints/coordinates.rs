//! Where a joint is in its range, and which of its limits hold.

use super::model::{Link, Model};
use super::rows::Pose;
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

/// A limit that was met holds for the rest of the frame while the joint is within this of it (radians; diagonals for slides): otherwise steps leave it and
/// meet it again for ever.
const STICKY_ANGLE: f64 = 0.1;
const STICKY_SLIDE: f64 = 0.05;

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

    /// The direction of X at a swing of `cone` towards where it is.
    pub(super) fn swung(&self, x: DVec3, cone: f64) -> DVec3 {
        let axis = x.cross(self.turn * x).normalize_or(x.any_orthonormal_vector());
        DQuat::from_axis_angle(axis, cone) * x
    }
}

/// The values at which limits hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Limits {
    pub(super) angle: Option<f64>,
    pub(super) slide: Option<f64>,
    pub(super) cone: Option<f64>,
}

impl Limits {
    /// Those that are met in a pose, and those of before that still hold.
    pub(super) fn of(link: &Link, at: &Coordinates, before: &Limits) -> Self {
        Self {
            angle: met(at.angle, link.angle, before.angle, STICKY_ANGLE),
            slide: met(at.slide, link.slide, before.slide, STICKY_SLIDE),
            cone: met(at.swing, link.cone.map(|c| (f64::NEG_INFINITY, c)), before.cone, STICKY_ANGLE),
        }
    }
}

fn met(value: f64, range: Option<(f64, f64)>, before: Option<f64>, sticky: f64) -> Option<f64> {
    let (lo, hi) = range?;
    if value < lo {
        Some(lo)
    } else if value > hi {
        Some(hi)
    } else {
        before.filter(|limit| (value - limit).abs() < sticky)
    }
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
