//! From labelled ends to the joints of a person: frame, sides, calibrated places.

use super::extremities::{End, Extremities};
use super::frame::Frame;
use super::hanging::{self, Standing};
use super::limbs::{self, Arm, Crotch, Leg};
use super::voxels::{Filled, Solid};
use super::{Arms, Body, Joint};
use crate::space::Axis;
use glam::DVec3;

/// The up axis is taken from the file when the body is within this angle of one of its axes: the raw direction errs by 2 to 7
/// degrees, and scans are nearly always stored upright.
const SNAP_DEGREES: f64 = 10.0;

/// What section centres miss, in per cent of stature outwards, upwards and forwards: the mean over 14 MakeHuman bodies (children to
/// old, thin to heavy) in six poses with arms from level to 72 degrees down.
const OFFSETS: [(Joint, Joint, [f64; 3]); 6] = [
    (Joint::LeftElbow, Joint::RightElbow, [0.3, -0.2, -0.8]),
    (Joint::LeftWrist, Joint::RightWrist, [0.5, -0.4, 0.5]),
    (Joint::LeftHip, Joint::RightHip, [0.7, 0.0, -1.1]),
    (Joint::LeftKnee, Joint::RightKnee, [-0.4, 1.3, 0.7]),
    (Joint::LeftAnkle, Joint::RightAnkle, [-1.3, 0.3, 2.3]),
    (Joint::LeftToe, Joint::RightToe, [-0.2, 0.4, -0.2]),
];
/// Height of the hips above the ankles in shares of stature, towards which the measured height is drawn by a share.
const HIP_HEIGHT: (f64, f64) = (0.503, 0.18);
const NECK_OFFSET: [f64; 3] = [0.0, 0.0, -0.9];
const HEAD_OFFSET: [f64; 3] = [0.0, 0.4, -0.5];
/// The same for the shoulder: constant, linear and quadratic in the sine of the arm's elevation.
const SHOULDER_OFFSET: [[f64; 3]; 3] = [[1.8, 0.5, 0.0], [-0.6, 4.7, 0.6], [-2.9, 5.7, 2.8]];
/// Sines of elevation for which that holds.
const SHOULDER_RANGE: [f64; 2] = [-0.95, 0.1];

/// How the arms are found.
pub(super) enum Reach<'a> {
    /// From the finger tips, when they are clear of the trunk.
    Apart(&'a [End; 2]),
    /// Along the sides of the trunk, in a finer filling of the shape.
    Hanging(&'a Filled),
}

/// All joints; `None` when a limb cannot be followed.
pub(super) fn body(solid: &Solid, ends: &Extremities, reach: &Reach<'_>, points: &[DVec3]) -> Option<Body> {
    let length = ends.length;
    let [f, g] = &ends.feet;
    let tip = |v: usize| solid.centres[v];
    let rough_up = (tip(ends.head.voxel) - (tip(f.voxel) + tip(g.voxel)) * 0.5).try_normalize()?;
    let crotch = Crotch::of(solid, ends, rough_up);
    let mut legs = [Leg::of(solid, f, g, &crotch, length)?, Leg::of(solid, g, f, &crotch, length)?];
    let (forward, facing_ratio) = facing(solid, &legs, rough_up)?;
    let rough = Frame::new(rough_up, forward)?;
    if (legs[0].ankle - legs[1].ankle).dot(rough.left) < 0.0 {
        legs.swap(0, 1);
    }
    let [neck, head] = limbs::neck_and_head(solid, &ends.head, length)?;
    let place = limbs::crotch_place(&crotch, [&legs[0], &legs[1]], rough_up, length)?;

    let up = (neck - (legs[0].ankle + legs[1].ankle) * 0.5).try_normalize()?;
    let axis = Axis::nearest(up).vector();
    let up = if up.dot(axis) > SNAP_DEGREES.to_radians().cos() { axis } else { up };
    let frame = Frame::new(up, forward)?;
    let (soles, top) = extent(solid, ends, points, up)?;
    let stature = top - soles;
    let arms = match reach {
        Reach::Apart(hands) => {
            let mut arms = [Arm::of(solid, &hands[0], length)?, Arm::of(solid, &hands[1], length)?];
            if (arms[0].shoulder - arms[1].shoulder).dot(rough.left) < 0.0 {
                arms.swap(0, 1);
            }
            arms
        }
        Reach::Hanging(filled) => hanging::arms(&Standing { filled, frame: &frame, soles, stature, middle: neck })?,
    };

    let mut joints = [DVec3::ZERO; Joint::COUNT];
    for side in 0..2 {
        let (arm, leg) = (&arms[side], &legs[side]);
        let aside = rough.left * [1.0, -1.0][side];
        let hip = leg.hip(place, rough_up, aside, length);
        let knee = leg.knee(hip, &crotch, length)?;
        let first = [Joint::LeftShoulder, Joint::RightShoulder][side] as usize;
        joints[first..first + 4].copy_from_slice(&[arm.shoulder, arm.elbow, arm.wrist, arm.tip]);
        let first = [Joint::LeftHip, Joint::RightHip][side] as usize;
        joints[first..first + 4].copy_from_slice(&[hip, knee, leg.ankle, leg.toe]);
    }
    joints[Joint::Neck as usize] = neck;
    joints[Joint::Head as usize] = head;

    joints[Joint::Crown as usize] = crown(solid, ends, up, top)?;
    let arms = if matches!(reach, Reach::Apart(_)) { Arms::Apart } else { Arms::Hanging };
    calibrate(&mut joints, &frame, stature, arms);
    let arm_elevation = [(Joint::LeftShoulder, Joint::LeftWrist), (Joint::RightShoulder, Joint::RightWrist)]
        .map(|arm| rise(&joints, &frame, arm).asin().to_degrees());
    let mid_hip = (joints[Joint::LeftHip as usize] + joints[Joint::RightHip as usize]) * 0.5;
    joints[Joint::MidHip as usize] = mid_hip;
    let Extremities { margin, cost, .. } = *ends;
    Some(Body { joints, up, forward: frame.forward, facing_ratio, margin, cost, stature, arm_elevation, arms, floor: None })
}

/// Where the feet stick out of the shanks, and how much more they do to the front than to the back.
fn facing(solid: &Solid, legs: &[Leg; 2], up: DVec3) -> Option<(DVec3, f64)> {
    let out = |leg: &Leg| leg.foot.iter().sum::<DVec3>() / leg.foot.len().max(1) as f64 + (leg.toe - leg.ankle) * 0.5;
    let forward = (out(&legs[0]) + out(&legs[1])).reject_from_normalized(up).try_normalize()?;
    let reach = |leg: &Leg, direction: DVec3| leg.foot.iter().map(|p| p.dot(direction)).fold(0.0, f64::max);
    let ratio = |leg: &Leg| reach(leg, forward) / reach(leg, -forward).max(solid.pitch);
    Some((forward, 0.5 * (ratio(&legs[0]) + ratio(&legs[1]))))
}

/// Heights of soles and crown: of the surface itself, where it belongs to feet and head.
fn extent(solid: &Solid, ends: &Extremities, points: &[DVec3], up: DVec3) -> Option<(f64, f64)> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in points.iter().filter(|p| p.is_finite()) {
        let Some(v) = solid.voxel_at(*p) else { continue };
        if ends.head.distance[v] < 0.16 * ends.length {
            high = high.max(p.dot(up));
        } else if ends.feet.iter().any(|foot| foot.distance[v] < 0.17 * ends.length) {
            low = low.min(p.dot(up));
        }
    }
    (high > low).then_some((low, high))
}

/// The top of the head, over the middle of its uppermost part.
fn crown(solid: &Solid, ends: &Extremities, up: DVec3, top: f64) -> Option<DVec3> {
    let depth = 0.06 * ends.length;
    let upper = |v: &usize| ends.head.distance[*v] < 0.16 * ends.length && solid.centres[*v].dot(up) > top - depth;
    let (count, sum) = (0..solid.len()).filter(upper).fold((0, DVec3::ZERO), |(n, sum), v| (n + 1, sum + solid.centres[v]));
    let middle = sum / f64::from(count);
    (count > 0).then(|| middle + up * (top - middle.dot(up)))
}

/// Moves the joints by the constant offsets; those of hanging arms are found without.
fn calibrate(joints: &mut [DVec3; Joint::COUNT], frame: &Frame, stature: f64, arms: Arms) {
    let percent = 0.01 * stature;
    for (hip, ankle) in [(Joint::LeftHip, Joint::LeftAnkle), (Joint::RightHip, Joint::RightAnkle)] {
        let height = (joints[hip as usize] - joints[ankle as usize]).dot(frame.up);
        joints[hip as usize] += frame.up * (HIP_HEIGHT.1 * (HIP_HEIGHT.0 * stature - height));
    }
    let hangs = |joint: Joint| arms == Arms::Hanging && matches!(joint, Joint::LeftElbow | Joint::LeftWrist);
    for (left, right, offset) in OFFSETS.into_iter().filter(|(left, ..)| !hangs(*left)) {
        joints[left as usize] += frame.vector(1.0, offset) * percent;
        joints[right as usize] += frame.vector(-1.0, offset) * percent;
    }
    joints[Joint::Neck as usize] += frame.vector(1.0, NECK_OFFSET) * percent;
    joints[Joint::Head as usize] += frame.vector(1.0, HEAD_OFFSET) * percent;
    if arms == Arms::Hanging {
        return;
    }
    for (shoulder, wrist, side) in [(Joint::LeftShoulder, Joint::LeftWrist, 1.0), (Joint::RightShoulder, Joint::RightWrist, -1.0)]
    {
        let s = rise(joints, frame, (shoulder, wrist)).clamp(SHOULDER_RANGE[0], SHOULDER_RANGE[1]);
        let [a, b, c] = SHOULDER_OFFSET;
        let offset = [0, 1, 2].map(|i| a[i] + b[i] * s + c[i] * s * s);
        joints[shoulder as usize] += frame.vector(side, offset) * percent;
    }
}

/// Sine of the elevation of an arm.
fn rise(joints: &[DVec3; Joint::COUNT], frame: &Frame, (shoulder, wrist): (Joint, Joint)) -> f64 {
    let arm = joints[wrist as usize] - joints[shoulder as usize];
    arm.normalize_or_zero().dot(frame.up).clamp(-1.0, 1.0)
}
