//! The energies (Xu et al. 2009, §4), as rows of a Gauss–Newton step.
//!
//! Cells are rigid by construction, so there is no rigidity energy; joints hold by anchors and directions instead of the distances of eight corners, which
//! converges in a third of the steps and leaves a cylinder joint free to slide, which (6) as printed does not.

use super::coordinates::{Coordinates, Limits};
use super::model::{Link, Model, Strain};
use super::system::{Part, System};
use super::told::Axis;
use crate::joints::Kind;
use glam::{DMat3, DQuat, DVec3};

/// Lengths count in tenths of the model's diagonal, so that the weights mean the same for every size.
pub(super) const UNIT: f64 = 10.0;

/// Arms by which a variable holds its turn, in diagonals.
const LEVER: f64 = 0.05;

/// How much the energies count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Joints.
    pub joint: f64,
    /// Their limits.
    pub limit: f64,
    /// Differences between neighbouring cells.
    pub strain: f64,
    /// Handles.
    pub position: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { joint: 1e5, limit: 1e5, strain: 1e3, position: 1e2 }
    }
}

/// A handle: share and arm of each variable that carries it.
pub(super) type Hold = Vec<(usize, f64, DVec3)>;

/// A pose of all variables.
#[derive(Clone, Debug, Default)]
pub(super) struct Pose {
    pub(super) turns: Vec<DMat3>,
    pub(super) places: Vec<DVec3>,
}

impl Pose {
    /// Where a point at rest is as part of a variable.
    pub(super) fn point(&self, model: &Model, variable: usize, rest: DVec3) -> DVec3 {
        self.places[variable] + self.turns[variable] * (rest - model.origins[variable])
    }

    /// Where a handle is.
    pub(super) fn hold(&self, hold: &Hold) -> DVec3 {
        hold.iter().map(|&(v, share, arm)| self.places[v] * share + self.turns[v] * arm).sum()
    }

    /// Without allocation.
    pub(super) fn set(&mut self, other: &Pose) {
        self.turns.clone_from(&other.turns);
        self.places.clone_from(&other.places);
    }
}

/// The matrix of `v ×`.
fn cross(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// How `R x` changes with a turn of `R`: ω × R x.
fn turned(x: DVec3) -> DMat3 {
    cross(x) * -1.0
}

/// A handle at its target.
pub(super) fn handle(system: &mut System, weight: f64, pose: &Pose, hold: &Hold, target: DVec3, parts: &mut Vec<Part<DMat3>>) {
    parts.clear();
    parts.extend(hold.iter().map(|&(variable, share, arm)| Part {
        variable,
        turn: turned(pose.turns[variable] * arm) * UNIT,
        shift: DMat3::from_diagonal(DVec3::splat(UNIT * share)),
    }));
    system.add(weight, (pose.hold(hold) - target) * UNIT, parts);
}

/// Neighbouring cells.
pub(super) fn strain(system: &mut System, weight: f64, pose: &Pose, model: &Model, strain: &Strain) {
    let Strain { a, b, stiffness, count, mean, arms } = *strain;
    let weight = weight * stiffness;
    let (p, q) = (mean - model.origins[a], mean - model.origins[b]);
    let parts = [
        Part { variable: a, turn: turned(pose.turns[a] * p) * UNIT, shift: DMat3::from_diagonal(DVec3::splat(UNIT)) },
        Part { variable: b, turn: turned(pose.turns[b] * q) * -UNIT, shift: DMat3::from_diagonal(DVec3::splat(-UNIT)) },
    ];
    system.add(weight * count, (pose.point(model, a, mean) - pose.point(model, b, mean)) * UNIT, &parts);
    for arm in arms {
        let (x, y) = (pose.turns[a] * arm, pose.turns[b] * arm);
        system.add_turns(weight, (x - y) * UNIT, &[(a, turned(x) * UNIT), (b, turned(y) * -UNIT)]);
    }
}

/// A turn stays near that of the frame before: what handles and joints leave open does not wander.
pub(super) fn stay(system: &mut System, weight: f64, pose: &Pose, before: &Pose, variable: usize) {
    for axis in DVec3::AXES {
        let arm = axis * (LEVER * UNIT);
        let x = pose.turns[variable] * arm;
        system.add_turns(weight, x - before.turns[variable] * arm, &[(variable, turned(x))]);
    }
}

/// A joint is turned as in the frame before: a drag that a motion of the whole does not feel, with a share of its own about each axis.
pub(super) fn drag(system: &mut System, weight: f64, pose: &Pose, before: &Pose, link: &Link, axes: &[Axis], free: f64) {
    let Link { a, b, .. } = *link;
    let last = before.turns[a].transpose() * before.turns[b];
    let turned = DQuat::from_mat3(&(pose.turns[a].transpose() * pose.turns[b] * last.transpose())).to_scaled_axis();
    // As two arms that are turned.
    let weight = weight * 2.0 * (LEVER * UNIT).powi(2);
    for &(axis, share) in axes.iter().filter(|a| a.1 > 0.0) {
        let (about, angle) = (pose.turns[a] * axis, axis.dot(turned));
        turn(system, weight * share, link, about, angle);
        let beyond = angle - angle.clamp(-free, free);
        if share < 1.0 && beyond != 0.0 {
            turn(system, weight * (1.0 - share), link, about, beyond);
        }
    }
}

/// A joint slides as in the frame before: what nothing drives goes along.
pub(super) fn slide(system: &mut System, weight: f64, pose: &Pose, before: &Pose, model: &Model, link: &Link) {
    let axes = match link.kind {
        Kind::Prismatic | Kind::Cylinder => &[link.frame.x_axis][..],
        Kind::Plane => &[link.frame.x_axis, link.frame.y_axis],
        _ => return,
    };
    let offset = |pose: &Pose| pose.point(model, link.b, link.centre) - pose.point(model, link.a, link.centre);
    for &axis in axes {
        let last = (before.turns[link.a] * axis).dot(offset(before));
        along(system, weight, pose, model, link, axis, last);
    }
}

/// The offset of the centre in `b` from that in `a`, along a direction of `a`.
fn along(system: &mut System, weight: f64, pose: &Pose, model: &Model, link: &Link, axis: DVec3, wanted: f64) {
    let Link { a, b, centre, .. } = *link;
    let (arm_a, arm_b) = (pose.turns[a] * (centre - model.origins[a]), pose.turns[b] * (centre - model.origins[b]));
    let offset = pose.places[b] + arm_b - pose.places[a] - arm_a;
    let d = pose.turns[a] * axis;
    let parts = [
        Part { variable: b, turn: arm_b.cross(d) * UNIT, shift: d * UNIT },
        Part { variable: a, turn: (d.cross(offset) - arm_a.cross(d)) * UNIT, shift: d * -UNIT },
    ];
    system.add_scalar(weight, (offset.dot(d) - wanted) * UNIT, &parts);
}

/// A joint and the limits that are met.
pub(super) fn joint(
    system: &mut System,
    weights: &Weights,
    pose: &Pose,
    model: &Model,
    link: &Link,
    at: &Coordinates,
    limits: &Limits,
) {
    let Link { kind, a, b, centre, frame, .. } = *link;
    let [x, y, z] = [frame.x_axis, frame.y_axis, frame.z_axis];
    let same = |system: &mut System, weight: f64, of_b: DVec3, of_a: DVec3| {
        let (p, q) = (pose.turns[b] * of_b, pose.turns[a] * of_a);
        system.add_turns(weight, p - q, &[(b, turned(p)), (a, turned(q) * -1.0)]);
    };
    let (arm_a, arm_b) = (pose.turns[a] * (centre - model.origins[a]), pose.turns[b] * (centre - model.origins[b]));
    let offset = pose.places[b] + arm_b - pose.places[a] - arm_a;
    let along = |system: &mut System, weight: f64, axis: DVec3, wanted: f64| {
        along(system, weight, pose, model, link, axis, wanted);
    };
    let w = weights.joint;
    if matches!(kind, Kind::Ball | Kind::Revolute) {
        let shift = DMat3::from_diagonal(DVec3::splat(UNIT));
        let parts = [
            Part { variable: b, turn: turned(arm_b) * UNIT, shift },
            Part { variable: a, turn: turned(arm_a) * -UNIT, shift: shift * -1.0 },
        ];
        system.add(w, offset * UNIT, &parts);
    }
    match kind {
        Kind::Ball | Kind::Fixed => {}
        Kind::Revolute => same(system, w, x, x),
        Kind::Cylinder => {
            same(system, w, x, x);
            along(system, w, y, 0.0);
            along(system, w, z, 0.0);
        }
        Kind::Prismatic => {
            same(system, w, x, x);
            same(system, w, y, y);
            along(system, w, y, 0.0);
            along(system, w, z, 0.0);
        }
        Kind::Plane => {
            same(system, w, z, z);
            along(system, w, z, 0.0);
        }
    }
    let w = weights.limit;
    if let Some(angle) = limits.angle {
        // Twice, as the turn of two directions.
        turn(system, 2.0 * w, link, pose.turns[a] * x, at.angle - angle);
    }
    if let Some(slide) = limits.slide {
        along(system, w, x, slide);
    }
    if let Some(cone) = limits.cone {
        turn(system, w, link, at.swings(pose.turns[a], x), at.swing - cone);
    }
}

/// A point that is carried by variables, on a plane.
pub(super) fn on_plane(
    system: &mut System,
    weight: f64,
    pose: &Pose,
    hold: &Hold,
    up: DVec3,
    height: f64,
    parts: &mut Vec<Part<DVec3>>,
) {
    parts.clear();
    parts.extend(hold.iter().map(|&(variable, share, arm)| Part {
        variable,
        turn: (pose.turns[variable] * arm).cross(up) * UNIT,
        shift: up * (share * UNIT),
    }));
    system.add_scalar(weight, (pose.hold(hold).dot(up) - height) * UNIT, parts);
}

/// A turn of `b` against `a` about an axis.
fn turn(system: &mut System, weight: f64, link: &Link, axis: DVec3, residual: f64) {
    let part = |variable: usize, turn: DVec3| Part { variable, turn, shift: DVec3::ZERO };
    system.add_scalar(weight, residual, &[part(link.b, axis), part(link.a, -axis)]);
}
