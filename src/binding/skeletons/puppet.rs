//! The scan's body moved as the capture's: every part turns as its joint does, on the scan's own lengths.

use super::cast::Cast;
use super::neutral::Neutral;
use super::rig::{Pose, Rig};
use super::stance::{hips, shoulders};
use crate::binding::plant::{Leg, Planter};
use crate::binding::rig::FrozenJoints;
use crate::binding::segments::{Segment, Skeleton};
use glam::{DQuat, DVec3};

/// A part of the body that moves rigidly with a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// A stretch of the trunk, by joint of [`Cast::spine`].
    Spine(usize),
    Neck,
    Head,
    UpperArm(usize),
    Forearm(usize),
    /// The forearm near the wrist, which turns half as far as the hand about its axis.
    Cuff(usize),
    Hand(usize),
    Thigh(usize),
    Shank(usize),
    Foot(usize),
    Toes(usize),
}

/// Where a part has come to.
#[derive(Clone, Copy, Debug)]
struct Placed {
    /// Origin of the part at rest, in the unit box.
    from: DVec3,
    origin: DVec3,
    turn: DQuat,
}

impl Placed {
    fn apply(&self, p: DVec3) -> DVec3 {
        self.origin + self.turn * (p - self.from)
    }
}

/// How far a shoulder may leave its place on the chest, in statures.
const SHRUG: f64 = 0.08;
/// Where the trunk bends when the joints do not tell, as a share of the way from the hips to the neck.
const LUMBAR: f64 = 0.30;

/// A scan's body on a rig.
pub(super) struct Puppet<'a> {
    rig: Rig<'a>,
    cast: &'a Cast,
    body: &'a Skeleton,
    neutral: &'a Neutral,
    /// From the capture's axes into the scan's.
    pub turn: DQuat,
    /// Unit-box lengths per unit of the capture.
    pub scale: f64,
    /// Added last, in the unit box.
    pub shift: DVec3,
    /// Shares of the way from hips to neck at which the parts of the trunk begin.
    begins: Vec<f64>,
    /// Shoulders in the axes of the chest's joint, in the neutral pose.
    shoulders: [Option<DVec3>; 2],
}

impl<'a> Puppet<'a> {
    /// A puppet at the capture's own place. `pose`: that of `neutral`.
    pub(super) fn new(rig: Rig<'a>, pose: Pose, cast: &'a Cast, body: &'a Skeleton, neutral: &'a Neutral) -> Self {
        let shoulders = [0, 1].map(|side| shoulder(&rig, cast, pose, side));
        let begins = begins(&rig, cast, pose);
        Self { rig, cast, body, neutral, turn: DQuat::IDENTITY, scale: 1.0, shift: DVec3::ZERO, begins, shoulders }
    }

    /// How the joints carry the parts, to be kept; `rest`: the pose of `neutral` is the file's rest.
    pub(super) fn keep(&self, rest: bool) -> FrozenJoints {
        let neutral = self.neutral;
        let turn = |q: DQuat| q.to_array();
        FrozenJoints {
            rest,
            turn: turn(self.turn),
            scale: self.scale,
            shift: self.shift.to_array(),
            begins: self.begins.clone(),
            left_shoulder: self.shoulders[0].map(|p| p.to_array()),
            right_shoulder: self.shoulders[1].map(|p| p.to_array()),
            spine: neutral.spine.iter().copied().map(turn).collect(),
            neck: turn(neutral.neck),
            head: turn(neutral.head),
            arms: neutral.arms.map(|arm| arm.map(turn)),
            legs: neutral.legs.map(|leg| leg.map(turn)),
        }
    }

    /// The puppet that was kept. `neutral`: of the same, see [`Neutral::kept`].
    pub(super) fn again(rig: Rig<'a>, cast: &'a Cast, body: &'a Skeleton, neutral: &'a Neutral, kept: &FrozenJoints) -> Self {
        Self {
            rig,
            cast,
            body,
            neutral,
            turn: DQuat::from_array(kept.turn),
            scale: kept.scale,
            shift: DVec3::from(kept.shift),
            begins: kept.begins.clone(),
            shoulders: [kept.left_shoulder, kept.right_shoulder].map(|p| p.map(DVec3::from)),
        }
    }

    /// The part of the trunk at a share of the way from hips to neck.
    pub(super) fn trunk_at(&self, share: f64) -> Part {
        let above = self.begins.iter().take_while(|&&b| b <= share).count();
        Part::Spine(above.saturating_sub(1))
    }

    fn carried(&self, pose: Pose, joint: usize, neutral: DQuat) -> Option<DQuat> {
        Some((self.turn * self.rig.turn(pose, joint)? * neutral).normalize())
    }

    /// Direction that the body faces in a frame, and the middle of its hips.
    pub(super) fn facing(&self, frame: usize) -> Option<(DVec3, DVec3)> {
        let pose = Pose::Frame(frame);
        let pelvis = self.carried(pose, self.cast.pelvis(), self.neutral.spine[0])?;
        Some((pelvis * self.body.forward, self.hips(pose)?))
    }

    /// Name of the joint that a part moves with.
    pub(super) fn joint(&self, part: Part) -> &'a str {
        let (arms, legs) = (&self.cast.arms, &self.cast.legs);
        let toe = |side: usize| legs[side].toe.filter(|&t| !self.rig.take.joints[t].end);
        let joint = match part {
            Part::Spine(i) => self.cast.spine[i],
            Part::Neck => self.cast.neck.unwrap_or(self.cast.chest()),
            Part::Head => self.cast.head.or(self.cast.neck).unwrap_or(self.cast.chest()),
            Part::UpperArm(side) => arms[side].shoulder,
            Part::Forearm(side) | Part::Cuff(side) => arms[side].elbow,
            Part::Hand(side) => arms[side].wrist,
            Part::Thigh(side) => legs[side].hip,
            Part::Shank(side) => legs[side].knee,
            Part::Foot(side) => legs[side].ankle,
            Part::Toes(side) => toe(side).unwrap_or(legs[side].ankle),
        };
        &self.rig.take.joints[joint].name
    }

    fn hips(&self, pose: Pose) -> Option<DVec3> {
        Some(self.turn * hips(&self.rig, self.cast, pose)? * self.scale + self.shift)
    }

    /// All parts in a frame. Parts whose joint is missing are missing, with those that hang on them.
    pub(super) fn frame(&self, frame: usize) -> Posture {
        let pose = Pose::Frame(frame);
        let body = self.body;
        let mut posture = Posture { spine: Vec::new(), rest: [None; Posture::FIXED] };
        let pelvis = body.bone(Segment::Pelvis).origin;
        let along = body.neck - pelvis;
        let mut at = self.hips(pose);
        for (i, (&joint, &neutral)) in self.cast.spine.iter().zip(&self.neutral.spine).enumerate() {
            let turn = self.carried(pose, joint, neutral);
            let ends = self.begins.get(i + 1).copied().unwrap_or(1.0);
            let placed = at.zip(turn).map(|(origin, turn)| Placed { from: pelvis + along * self.begins[i], origin, turn });
            posture.spine.push(placed);
            at = placed.map(|p| p.apply(pelvis + along * ends));
        }
        let chest = posture.spine[posture.spine.len() - 1];
        let of = |joint: Option<usize>, neutral: DQuat| joint.and_then(|j| self.carried(pose, j, neutral));
        let hung = |above: Option<Placed>, from: DVec3, turn: Option<DQuat>| {
            above.zip(turn).map(|(above, turn)| Placed { from, origin: above.apply(from), turn })
        };
        let chest_turn = chest.map(|c| c.turn);
        let neck_turn = of(self.cast.neck, self.neutral.neck).or(chest_turn);
        let neck = hung(chest, body.neck, neck_turn);
        let head = hung(neck, body.bone(Segment::Head).origin, of(self.cast.head, self.neutral.head).or(neck_turn));
        posture.set(Part::Neck, neck);
        posture.set(Part::Head, head);
        for side in 0..2 {
            let segment = |left, right| body.bone(if side == 0 { left } else { right });
            let (joints, neutral) = (&self.cast.arms[side], &self.neutral.arms[side]);
            let bone = segment(Segment::LeftUpperArm, Segment::RightUpperArm);
            let mut upper = hung(chest, bone.origin, of(Some(joints.shoulder), neutral[0]));
            if let Some(upper) = &mut upper {
                upper.origin += self.shrug(pose, side);
            }
            let bone = segment(Segment::LeftForearm, Segment::RightForearm);
            let fore = hung(upper, bone.origin, of(Some(joints.elbow), neutral[1]));
            let hand_turn = of(Some(joints.wrist), neutral[2]);
            let cuff = fore.map(|fore| Placed { turn: fore.turn * half_twist(fore.turn, hand_turn, bone.axis), ..fore });
            let hand = hung(fore, bone.end, hand_turn);
            for (part, placed) in
                [(Part::UpperArm(side), upper), (Part::Forearm(side), fore), (Part::Cuff(side), cuff), (Part::Hand(side), hand)]
            {
                posture.set(part, placed);
            }
            let (joints, neutral) = (&self.cast.legs[side], &self.neutral.legs[side]);
            let bone = segment(Segment::LeftThigh, Segment::RightThigh);
            let thigh = hung(posture.spine[0], bone.origin, of(Some(joints.hip), neutral[0]));
            let shank = hung(thigh, bone.end, of(Some(joints.knee), neutral[1]));
            let bone = segment(Segment::LeftFoot, Segment::RightFoot);
            let foot = hung(shank, bone.origin, of(Some(joints.ankle), neutral[2]));
            let toe = joints.toe.filter(|&t| !self.rig.take.joints[t].end);
            let ball = bone.origin.lerp(bone.end, BALL);
            let toes = hung(foot, ball, of(toe, neutral[3]).or(foot.map(|f| f.turn)));
            for (part, placed) in
                [(Part::Thigh(side), thigh), (Part::Shank(side), shank), (Part::Foot(side), foot), (Part::Toes(side), toes)]
            {
                posture.set(part, placed);
            }
        }
        posture
    }

    /// How far a shoulder has left its place on the chest, in the unit box.
    fn shrug(&self, pose: Pose, side: usize) -> DVec3 {
        let now = shoulder(&self.rig, self.cast, pose, side);
        let chest = self.rig.turn(pose, self.cast.chest());
        match (now, self.shoulders[side], chest) {
            (Some(now), Some(then), Some(chest)) => {
                (self.turn * (chest * (now - then)) * self.scale).clamp_length_max(SHRUG * self.body.stature)
            }
            _ => DVec3::ZERO,
        }
    }
}

/// Where the toes begin on the way from ankle to tip.
pub(super) const BALL: f64 = 0.68;

/// Half of the turn of a hand about the axis of its forearm.
fn half_twist(fore: DQuat, hand: Option<DQuat>, axis: DVec3) -> DQuat {
    let Some(hand) = hand else { return DQuat::IDENTITY };
    let relative = fore.inverse() * hand;
    let along = DVec3::new(relative.x, relative.y, relative.z).dot(axis);
    // Of the two quaternions of one turn, the one that turns less than half round.
    let (along, w) = if relative.w < 0.0 { (-along, -relative.w) } else { (along, relative.w) };
    DQuat::from_axis_angle(axis, along.atan2(w))
}

/// A shoulder in the axes of the chest's joint.
fn shoulder(rig: &Rig<'_>, cast: &Cast, pose: Pose, side: usize) -> Option<DVec3> {
    let chest = cast.chest();
    let offset = rig.place(pose, cast.arms[side].shoulder)? - rig.place(pose, chest)?;
    Some(rig.turn(pose, chest)?.inverse() * offset)
}

/// Shares of the way from hips to neck at which the joints of the spine lie.
fn begins(rig: &Rig<'_>, cast: &Cast, pose: Pose) -> Vec<f64> {
    let joints = cast.spine.len();
    let even = |joints: usize| -> Vec<f64> {
        let step = if joints > 1 { (1.0 - LUMBAR) / (joints - 1) as f64 } else { 0.0 };
        (0..joints).map(|i| if i == 0 { 0.0 } else { LUMBAR + step * (i - 1) as f64 }).collect()
    };
    if rig.is_flat() {
        return even(joints);
    }
    let mut points = vec![hips(rig, cast, pose)];
    points.extend(cast.spine[1..].iter().map(|&j| rig.place(pose, j)));
    points.push(cast.neck.map_or_else(|| shoulders(rig, cast, pose), |j| rig.place(pose, j)));
    let Some(points) = points.into_iter().collect::<Option<Vec<DVec3>>>() else { return even(joints) };
    let mut sums = vec![0.0];
    for pair in points.windows(2) {
        sums.push(sums[sums.len() - 1] + (pair[1] - pair[0]).length());
    }
    let total = sums[sums.len() - 1];
    if total.is_nan() || total <= 0.0 {
        return even(joints);
    }
    sums[..joints].iter().map(|s| s / total).collect()
}

/// All parts of the body in a frame.
#[derive(Clone, Debug)]
pub(super) struct Posture {
    spine: Vec<Option<Placed>>,
    rest: [Option<Placed>; Posture::FIXED],
}

impl Posture {
    const FIXED: usize = 18;

    fn slot(part: Part) -> Option<usize> {
        Some(match part {
            Part::Spine(_) => return None,
            Part::Neck => 0,
            Part::Head => 1,
            Part::UpperArm(side) => 2 + side,
            Part::Forearm(side) => 4 + side,
            Part::Cuff(side) => 6 + side,
            Part::Hand(side) => 8 + side,
            Part::Thigh(side) => 10 + side,
            Part::Shank(side) => 12 + side,
            Part::Foot(side) => 14 + side,
            Part::Toes(side) => 16 + side,
        })
    }

    fn set(&mut self, part: Part, placed: Option<Placed>) {
        if let Some(slot) = Self::slot(part) {
            self.rest[slot] = placed;
        }
    }

    /// Holds a foot while it rests on the floor.
    pub(super) fn hold(&mut self, planter: &mut Planter, side: usize) {
        let at = |part: Part| Self::slot(part).and_then(|slot| self.rest[slot]);
        let (Some(thigh), Some(shank), Some(foot)) = (at(Part::Thigh(side)), at(Part::Shank(side)), at(Part::Foot(side))) else {
            return planter.plant(side, None);
        };
        let mut leg = Leg {
            hip: thigh.origin,
            knee: shank.origin,
            ankle: foot.origin,
            thigh: thigh.turn,
            shank: shank.turn,
            foot: foot.turn,
        };
        planter.plant(side, Some(&mut leg));
        let shift = leg.ankle - foot.origin;
        self.set(Part::Thigh(side), Some(Placed { turn: leg.thigh, ..thigh }));
        self.set(Part::Shank(side), Some(Placed { origin: leg.knee, turn: leg.shank, ..shank }));
        self.set(Part::Foot(side), Some(Placed { origin: leg.ankle, ..foot }));
        let toes = Self::slot(Part::Toes(side)).and_then(|slot| self.rest[slot]);
        self.set(Part::Toes(side), toes.map(|toes| Placed { origin: toes.origin + shift, ..toes }));
    }

    /// Where a point of the scan's rest has come to with its part.
    pub(super) fn apply(&self, part: Part, p: DVec3) -> Option<DVec3> {
        let placed = match part {
            Part::Spine(i) => self.spine[i],
            part => Self::slot(part).and_then(|slot| self.rest[slot]),
        };
        placed.map(|placed| placed.apply(p))
    }
}
