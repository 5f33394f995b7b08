//! The joints of a human scan, found from its shape alone.
//!
//! A solid graph of voxels, its five ends told apart by their distances through the body, medial curves from the ends inwards, and
//! joints on these curves by section area, bends and the proportions of people (Winter, Biomechanics and Motor Control of Human
//! Movement). Nothing is learnt and no axis need be known; the arms have to be clear of the trunk.

mod axes;
mod extremities;
mod geodesic;
mod limbs;
mod medial;
mod pieces;
mod voxels;

use crate::space::Axis;
use extremities::Extremities;
use glam::DVec3;
use limbs::{Arm, Crotch, Leg};
use voxels::Solid;

/// The places of a body that the binding needs. Left and right are the body's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Joint {
    MidHip,
    Neck,
    Head,
    Crown,
    LeftShoulder,
    LeftElbow,
    LeftWrist,
    LeftHandTip,
    RightShoulder,
    RightElbow,
    RightWrist,
    RightHandTip,
    LeftHip,
    LeftKnee,
    LeftAnkle,
    LeftToe,
    RightHip,
    RightKnee,
    RightAnkle,
    RightToe,
}

impl Joint {
    /// Number of joints; `joint as usize` is its index.
    pub const COUNT: usize = 20;
}

/// A human body as its scan shows it, in the unit box of the scan.
#[derive(Clone, Debug)]
pub struct Body {
    /// Positions by `Joint as usize`.
    pub joints: [DVec3; Joint::COUNT],
    /// Unit vector from the feet to the neck; snapped to a file axis when within 10 degrees.
    pub up: DVec3,
    /// Unit vector across `up` that the body faces.
    pub forward: DVec3,
    /// How far the toes stick out against the heels; below 2 the facing is weak.
    pub facing_ratio: f64,
    /// Second-best labelling minus best: 0.25 is sure, below 0.15 is not a person as far as can be told.
    pub margin: f64,
    /// Cost of the best labelling.
    pub cost: f64,
    /// Height from soles to crown, in diagonals.
    pub stature: f64,
    /// Elevation of the arms against the horizontal in degrees, negative below, left and right.
    pub arm_elevation: [f64; 2],
}

/// Margins below this are no person as far as can be told.
const LEAST_MARGIN: f64 = 0.15;
/// Costs above this are no person, however clear the labelling.
const MOST_COST: f64 = 0.45;
/// The up axis is taken from the file when the body is within this angle of one of its axes.
const SNAP_DEGREES: f64 = 10.0;

/// Finds the body in a scan, or says why not.
///
/// Shapes: `points` in the unit box; `triangles` over them (holes, flipped faces and several shells do not matter).
pub fn find(points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Body, NotHuman> {
    let triangles = pieces::without_debris(points, triangles);
    let solid = Solid::of(points, &triangles).ok_or_else(|| NotHuman {
        reason: "looked for a person; the mesh has no surface with an inside".into(),
        margin_and_cost: None,
    })?;
    let ends = extremities::ends(&solid);
    let found = ends.len();
    let body = extremities::label(ends).ok_or_else(|| NotHuman {
        reason: format!("looked for head, two hands and two feet; the shape has {found} ends"),
        margin_and_cost: None,
    })?;
    let refuse = |reason: String| NotHuman { reason, margin_and_cost: Some((body.margin, body.cost)) };
    if body.cost > MOST_COST || body.margin < LEAST_MARGIN {
        return Err(refuse(format!("margin {:.2} cost {:.2}", body.margin, body.cost)));
    }
    joints(&solid, &body, points).ok_or_else(|| refuse("a limb could not be followed".into()))
}

fn joints(solid: &Solid, body: &Extremities, points: &[DVec3]) -> Option<Body> {
    let length = body.length;
    let crotch = Crotch::of(solid, body);
    let [f, g] = &body.feet;
    let mut legs = [Leg::of(solid, f, g, &crotch, length)?, Leg::of(solid, g, f, &crotch, length)?];
    let tip = |v: usize| solid.centres[v];
    let rough_up = (tip(body.head.voxel) - (tip(f.voxel) + tip(g.voxel)) * 0.5).try_normalize()?;
    let out = legs.iter().map(|l| l.foot.iter().sum::<DVec3>() / l.foot.len() as f64 + (l.toe - l.ankle) * 0.5).sum::<DVec3>();
    let forward = out.reject_from_normalized(rough_up).try_normalize()?;
    let facing_ratio = legs.iter().map(|l| {
        let reach = |direction: DVec3| l.foot.iter().map(|p| p.dot(direction)).fold(0.0, f64::max);
        reach(forward) / reach(-forward).max(solid.pitch)
    });
    let facing_ratio = facing_ratio.sum::<f64>() * 0.5;
    let left = rough_up.cross(forward);
    if (legs[0].ankle - legs[1].ankle).dot(left) < 0.0 {
        legs.swap(0, 1);
    }
    let place = limbs::crotch_place(&crotch, [&legs[0], &legs[1]], rough_up, length)?;
    let mut arms = [Arm::of(solid, &body.hands[0], length)?, Arm::of(solid, &body.hands[1], length)?];
    if (arms[0].shoulder - arms[1].shoulder).dot(left) < 0.0 {
        arms.swap(0, 1);
    }
    let [neck, head] = limbs::neck_and_head(solid, &body.head, length)?;
    let mut j = [DVec3::ZERO; Joint::COUNT];
    let hips = [legs[0].hip(place, rough_up, left, length), legs[1].hip(place, rough_up, -left, length)];
    for side in 0..2 {
        let arm = &arms[side];
        let first = [Joint::LeftShoulder as usize, Joint::RightShoulder as usize][side];
        j[first..first + 4].copy_from_slice(&[arm.shoulder, arm.elbow, arm.wrist, arm.tip]);
        let leg = &legs[side];
        let first = [Joint::LeftHip as usize, Joint::RightHip as usize][side];
        j[first..first + 4].copy_from_slice(&[hips[side], leg.knee(hips[side], &crotch, length)?, leg.ankle, leg.toe]);
    }
    j[Joint::Neck as usize] = neck;
    j[Joint::Head as usize] = head;
    j[Joint::Crown as usize] = tip(body.head.voxel);
    j[Joint::MidHip as usize] = (hips[0] + hips[1]) * 0.5;
    let up = (neck - (legs[0].ankle + legs[1].ankle) * 0.5).try_normalize()?;
    let axis = Axis::nearest(up).vector();
    let up = if up.dot(axis) > SNAP_DEGREES.to_radians().cos() { axis } else { up };
    let forward = forward.reject_from_normalized(up).try_normalize()?;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in points.iter().filter(|p| p.is_finite()) {
        let Some(v) = solid.voxel_at(*p) else { continue };
        if body.head.distance[v] < 0.16 * length {
            high = high.max(p.dot(up));
        } else if f.distance[v].min(g.distance[v]) < 0.17 * length {
            low = low.min(p.dot(up));
        }
    }
    let elevation = |shoulder: Joint, wrist: Joint| {
        let arm = j[wrist as usize] - j[shoulder as usize];
        arm.normalize_or_zero().dot(up).clamp(-1.0, 1.0).asin().to_degrees()
    };
    let arm_elevation = [elevation(Joint::LeftShoulder, Joint::LeftWrist), elevation(Joint::RightShoulder, Joint::RightWrist)];
    Some(Body { joints: j, up, forward, facing_ratio, margin: body.margin, cost: body.cost, stature: high - low, arm_elevation })
}

/// Why no body was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NotHuman {
    /// In words: what was looked for and what was found instead.
    pub reason: String,
    /// Margin and cost of the best labelling, if there was one.
    pub margin_and_cost: Option<(f64, f64)>,
}
