//! How each joint of the capture is turned when its part of the body is as in the scan.
//!
//! In one pose — the file's rest where that is a standing person, else the frame nearest to the scan's — every segment of the scan is
//! turned onto the capture's by the least rotation after that of its parent. Bone directions are exact then in every frame, and twist
//! follows the capture's own joints, whatever axes they have. Of feet the sole tells: what is level while they stand.

use super::cast::Cast;
use super::rig::{Pose, Rig};
use super::stance::{hips, leftwards, shoulders};
use crate::binding::rig::FrozenJoints;
use crate::binding::segments::{Segment, Skeleton};
use crate::binding::similarity::turn_between;
use crate::statistics::quantile;
use glam::{DMat3, DQuat, DVec3};

/// Turns of the scan's parts at rest into the axes of the joints that carry them.
#[derive(Clone, Debug)]
pub(super) struct Neutral {
    /// By joint of [`Cast::spine`].
    pub spine: Vec<DQuat>,
    pub neck: DQuat,
    pub head: DQuat,
    /// Upper arm, forearm, hand; left and right.
    pub arms: [[DQuat; 3]; 2],
    /// Thigh, shank, foot, toes.
    pub legs: [[DQuat; 4]; 2],
}

/// How far a pose is from the scan's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearness {
    pub pose: Pose,
    /// Root mean square of the angles between the segments of capture and scan, in degrees.
    pub angle: f64,
}

/// Frames looked at.
const SAMPLES: usize = 300;
/// Say of hands and feet in the choice of a frame.
const ENDS: f64 = 0.3;
/// Cosine up to which legs and trunk of a rest pose are one line.
const LINE: f64 = 0.8;
/// Cosine of the bend of an elbow in a rest pose.
const STRAIGHT: f64 = 0.6;

/// Left, up and front as a turn from the axes of those names.
fn frame(left: DVec3, up: DVec3) -> Option<DQuat> {
    let up = up.try_normalize()?;
    let left = (left - up * left.dot(up)).try_normalize()?;
    Some(DQuat::from_mat3(&DMat3::from_cols(left, up, left.cross(up))).normalize())
}

/// Unit vectors along the segments of the arms (upper arm, forearm, hand) in a pose; a hand without a joint beyond the wrist has none.
fn arm(rig: &Rig<'_>, cast: &Cast, pose: Pose, side: usize) -> Option<[Option<DVec3>; 3]> {
    let arm = &cast.arms[side];
    let [s, e, w] = [arm.shoulder, arm.elbow, arm.wrist].map(|j| rig.place(pose, j));
    let (s, e, w) = (s?, e?, w?);
    let hand = arm.hand.and_then(|h| rig.place(pose, h)).map(|h| h - w).filter(|h| h.length() > 0.08 * (w - e).length());
    Some([(e - s).try_normalize(), (w - e).try_normalize(), hand.and_then(DVec3::try_normalize)])
}

/// The same of thigh, shank, foot.
fn leg(rig: &Rig<'_>, cast: &Cast, pose: Pose, side: usize) -> Option<[Option<DVec3>; 3]> {
    let leg = &cast.legs[side];
    let [h, k, a] = [leg.hip, leg.knee, leg.ankle].map(|j| rig.place(pose, j));
    let (h, k, a) = (h?, k?, a?);
    let foot = leg.toe.and_then(|t| rig.place(pose, t)).map(|t| t - a).filter(|f| f.length() > 0.05 * (a - k).length());
    Some([(k - h).try_normalize(), (a - k).try_normalize(), foot.and_then(DVec3::try_normalize)])
}

/// Least angle in degrees between shank and foot that tells where the foot points.
const POINTING: f64 = 30.0;

/// The first joint from the cast's toe on that lies in front of the ankle and not under it, as stubs on the floor do.
pub(super) fn pointing_toe(rig: &Rig<'_>, cast: &Cast, side: usize) -> Option<usize> {
    let leg = &cast.legs[side];
    let points = |toe: usize| {
        let angle = |frame: usize| {
            let [k, a, t] = [leg.knee, leg.ankle, toe].map(|j| rig.place(Pose::Frame(frame), j));
            let (shank, foot) = (a? - k?, t? - a?);
            (foot.length() > 0.05 * shank.length()).then(|| foot.angle_between(shank).to_degrees())
        };
        let mut angles: Vec<f64> = rig.sample(60).into_iter().filter_map(angle).collect();
        quantile(&mut angles, 0.5).is_some_and(|angle| angle > POINTING)
    };
    let onward = |&toe: &usize| rig.take.joints.iter().position(|j| j.parent == Some(toe));
    std::iter::successors(leg.toe, onward).find(|&toe| points(toe))
}

/// From the scan's rest to the capture's body in a pose. `up` of the capture is for bodies that stand; of others the trunk tells.
fn body_turn(rig: &Rig<'_>, cast: &Cast, body: &Skeleton, pose: Pose) -> Option<DQuat> {
    let trunk = (shoulders(rig, cast, pose)? - hips(rig, cast, pose)?).try_normalize()?;
    let left = leftwards(rig, cast, pose, trunk)?;
    Some(frame(left, trunk)? * frame(body.left, body.up)?.inverse())
}

/// How far the pose of a rig is from the scan's; `None` where joints are missing.
fn nearness(rig: &Rig<'_>, cast: &Cast, body: &Skeleton, pose: Pose) -> Option<Nearness> {
    let turn = body_turn(rig, cast, body, pose)?;
    let (mut sum, mut total) = (0.0, 0.0);
    let mut add = |segment: Segment, direction: Option<DVec3>, weight: f64| {
        if let Some(d) = direction {
            let angle = (turn * body.bone(segment).axis).angle_between(d).to_degrees();
            sum += weight * angle * angle;
            total += weight;
        }
    };
    for side in 0..2 {
        let (arm, leg) = (arm(rig, cast, pose, side)?, leg(rig, cast, pose, side)?);
        for k in 0..3 {
            let weight = if k < 2 { 1.0 } else { ENDS };
            add(Segment::ARMS[side][k], arm[k], weight);
            add(Segment::LEGS[side][k], leg[k], weight);
        }
    }
    Some(Nearness { pose, angle: (sum / total).sqrt() })
}

/// Frames whose poses are this much alike, in degrees, are equally near: the first of them is taken.
const ALIKE: f64 = 0.5;

/// The frame nearest to the scan's pose.
pub(super) fn nearest_frame(rig: &Rig<'_>, cast: &Cast, body: &Skeleton) -> Option<Nearness> {
    let all: Vec<Nearness> = rig.sample(SAMPLES).into_iter().filter_map(|f| nearness(rig, cast, body, Pose::Frame(f))).collect();
    let least = all.iter().map(|n| n.angle).reduce(f64::min)?;
    all.into_iter().find(|n| n.angle <= least + ALIKE)
}

/// The same for one frame.
pub(super) fn nearness_of(rig: &Rig<'_>, cast: &Cast, body: &Skeleton, frame: usize) -> Option<Nearness> {
    nearness(rig, cast, body, Pose::Frame(frame))
}

/// The file's rest, where it shows a standing person: legs below the trunk, arms to the sides or down, elbows hardly bent; and where
/// hips and shoulders keep their directions against the pelvis and the chest in the frames, as they do unless turns are arbitrary.
pub(super) fn rest(rig: &Rig<'_>, cast: &Cast, body: &Skeleton) -> Option<Nearness> {
    let near = nearness(rig, cast, body, Pose::Rest)?;
    let [left, right] = cast.arms.map(|arm| arm.shoulder);
    if drift(rig, cast.chest(), left, right)? > GIRDLE {
        return None;
    }
    let [left, right] = cast.legs.map(|leg| leg.hip);
    if drift(rig, cast.pelvis(), left, right)? > GIRDLE {
        return None;
    }
    let turn = body_turn(rig, cast, body, Pose::Rest)?;
    let (up, forward) = (turn * body.up, turn * body.forward);
    for side in 0..2 {
        let [thigh, shank, foot] = leg(rig, cast, Pose::Rest, side)?;
        let [upper, fore, _] = arm(rig, cast, Pose::Rest, side)?;
        let (upper, fore) = (upper?, fore?);
        let outward = turn * if side == 0 { body.left } else { -body.left };
        let stands = thigh?.dot(up) < -LINE && shank?.dot(up) < -LINE && foot.is_none_or(|f| f.dot(up) < 0.5);
        let rests = upper.dot(forward).abs() < 0.6 && upper.dot(up) < 0.6 && upper.dot(outward) > -0.2;
        if !stands || !rests || upper.dot(fore) < STRAIGHT {
            return None;
        }
    }
    Some(near)
}

/// Angle in degrees by which the line of the shoulders or hips may typically leave its direction of the rest.
const GIRDLE: f64 = 35.0;

/// Median angle between the line from `right` to `left` in a joint's axes and the same at rest, in degrees.
fn drift(rig: &Rig<'_>, joint: usize, left: usize, right: usize) -> Option<f64> {
    let line = |pose: Pose| Some(rig.turn(pose, joint)?.inverse() * (rig.place(pose, left)? - rig.place(pose, right)?));
    let rest = line(Pose::Rest)?;
    let frames = rig.sample(SAMPLES).into_iter();
    let mut angles: Vec<f64> = frames.filter_map(|f| Some(line(Pose::Frame(f))?.angle_between(rest).to_degrees())).collect();
    quantile(&mut angles, 0.5)
}

impl Neutral {
    /// Reads the turns in a pose. `up` is that of the capture's frames.
    pub(super) fn read(rig: &Rig<'_>, cast: &Cast, body: &Skeleton, pose: Pose, up: DVec3) -> Option<Self> {
        let whole = body_turn(rig, cast, body, pose)?;
        let into = |joint: usize, turn: DQuat| rig.turn(pose, joint).map(|q| q.inverse() * turn);
        let spine = cast.spine.iter().map(|&j| into(j, whole)).collect::<Option<Vec<_>>>()?;
        let chest = spine[spine.len() - 1];
        let neck = cast.neck.map_or(Some(chest), |j| into(j, whole))?;
        let head = cast.head.map_or(Some(neck), |j| into(j, whole))?;
        let mut arms = [[DQuat::IDENTITY; 3]; 2];
        let mut legs = [[DQuat::IDENTITY; 4]; 2];
        for side in 0..2 {
            let joints = &cast.arms[side];
            let directions = arm(rig, cast, pose, side)?;
            let mut turn = whole;
            for (k, joint) in [joints.shoulder, joints.elbow, joints.wrist].into_iter().enumerate() {
                turn = onto(turn, body.bone(Segment::ARMS[side][k]).axis, directions[k]);
                if k == 0 && pose != Pose::Rest {
                    turn = hinged(turn, body, Segment::ARMS[side][0], directions, 1.0);
                }
                arms[side][k] = into(joint, turn)?;
            }
            let joints = &cast.legs[side];
            let directions = leg(rig, cast, pose, side)?;
            let mut turn = whole;
            for (k, joint) in [joints.hip, joints.knee, joints.ankle].into_iter().enumerate() {
                turn = onto(turn, body.bone(Segment::LEGS[side][k]).axis, directions[k]);
                if k == 0 && pose != Pose::Rest {
                    turn = hinged(turn, body, Segment::LEGS[side][0], directions, -1.0);
                }
                legs[side][k] = into(joint, turn)?;
            }
            if let Some(foot) = standing_foot(rig, cast, body, side, up)
                && foot.angle_between(legs[side][2]).to_degrees() < SOLE
            {
                legs[side][2] = foot;
            }
            // Toes lie along the foot at rest.
            let foot = rig.turn(pose, joints.ankle)? * legs[side][2];
            legs[side][3] = joints.toe.map_or(Some(legs[side][2]), |j| into(j, foot))?;
        }
        Some(Self { spine, neck, head, arms, legs })
    }

    /// The turns that were kept.
    pub(super) fn kept(kept: &FrozenJoints) -> Self {
        let turn = DQuat::from_array;
        Self {
            spine: kept.spine.iter().copied().map(turn).collect(),
            neck: turn(kept.neck),
            head: turn(kept.head),
            arms: kept.arms.map(|arm| arm.map(turn)),
            legs: kept.legs.map(|leg| leg.map(turn)),
        }
    }
}

/// The least turn after `turn` that brings the scan's axis onto a direction.
fn onto(turn: DQuat, axis: DVec3, direction: Option<DVec3>) -> DQuat {
    direction.map_or(turn, |d| (turn_between((turn * axis).normalize(), d) * turn).normalize())
}

/// Bend from which the plane of a joint's bend tells the twist of the segment above it, as a sine.
const BENT: f64 = 0.45;

/// Twists an upper arm or thigh so that the next segment bends to the front (`sign` 1) or the back (−1) of it, as elbows and knees do.
fn hinged(turn: DQuat, body: &Skeleton, segment: Segment, directions: [Option<DVec3>; 3], sign: f64) -> DQuat {
    let (Some(along), Some(next)) = (directions[0], directions[1]) else { return turn };
    let bend = next - along * next.dot(along);
    if bend.length() < BENT {
        return turn;
    }
    let expected = turn * body.bone(segment).forward * sign;
    let expected = expected - along * expected.dot(along);
    let angle = expected.cross(bend).dot(along).atan2(expected.dot(bend));
    (DQuat::from_axis_angle(along, angle) * turn).normalize()
}

/// Angle in degrees beyond which the sole that standing frames tell is no sole (skates, dancing on toes).
const SOLE: f64 = 40.0;
/// Standing frames that it takes to tell a sole.
const STANDING: usize = 5;

/// Turn of the scan's foot into the axes of the ankle: what points up while the foot stands, and where the toes are.
fn standing_foot(rig: &Rig<'_>, cast: &Cast, body: &Skeleton, side: usize, up: DVec3) -> Option<DQuat> {
    let leg = &cast.legs[side];
    let toe = leg.toe?;
    let frames: Vec<usize> = rig.sample(SAMPLES);
    let heights = |joint: usize| -> Vec<f64> {
        frames.iter().map(|&f| rig.place(Pose::Frame(f), joint).map_or(f64::INFINITY, |p| p.dot(up))).collect()
    };
    let (ankles, toes) = (heights(leg.ankle), heights(toe));
    let low = |values: &[f64]| quantile(&mut values.iter().copied().filter(|h| h.is_finite()).collect::<Vec<_>>(), 0.1);
    let (ankle, ball) = (low(&ankles)?, low(&toes)?);
    let length = (rig.place(Pose::Frame(frames[0]), leg.knee)? - rig.place(Pose::Frame(frames[0]), leg.ankle)?).length();
    let near = 0.03 * length;
    let mut normal = DVec3::ZERO;
    let mut forward = DVec3::ZERO;
    let mut count = 0;
    for (i, &f) in frames.iter().enumerate() {
        let pose = Pose::Frame(f);
        if (ankles[i] - ankle).abs() > near || (toes[i] - ball).abs() > near {
            continue;
        }
        if let (Some(q), Some(a), Some(t)) = (rig.turn(pose, leg.ankle), rig.place(pose, leg.ankle), rig.place(pose, toe)) {
            normal += q.inverse() * up;
            forward += q.inverse() * (t - a);
            count += 1;
        }
    }
    if count < STANDING || normal.length() < 0.97 * count as f64 {
        return None;
    }
    let rest = body.bone(Segment::LEGS[side][2]);
    let level = |forward: DVec3, up: DVec3| {
        let up = up.try_normalize()?;
        let forward = (forward - up * forward.dot(up)).try_normalize()?;
        Some(DQuat::from_mat3(&DMat3::from_cols(up.cross(forward), up, forward)).normalize())
    };
    Some((level(forward, normal)? * level(rest.axis, body.up)?.inverse()).normalize())
}
