//! The body as fifteen segments on joints.

use super::landmarks::{Body, Joint};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A side of the body, the body's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Side {
    #[default]
    Middle,
    Left,
    Right,
}

impl Side {
    pub(crate) fn other(self) -> Self {
        match self {
            Side::Middle => Side::Middle,
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        }
    }
}

/// A rigid part of the body. Parents come before their children.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Segment {
    Pelvis,
    Trunk,
    Head,
    LeftUpperArm,
    LeftForearm,
    LeftHand,
    RightUpperArm,
    RightForearm,
    RightHand,
    LeftThigh,
    LeftShank,
    LeftFoot,
    RightThigh,
    RightShank,
    RightFoot,
}

impl Segment {
    /// Number of segments; `segment as usize` is its index.
    pub const COUNT: usize = 15;

    /// All segments in order.
    pub const ALL: [Segment; Self::COUNT] = [
        Segment::Pelvis,
        Segment::Trunk,
        Segment::Head,
        Segment::LeftUpperArm,
        Segment::LeftForearm,
        Segment::LeftHand,
        Segment::RightUpperArm,
        Segment::RightForearm,
        Segment::RightHand,
        Segment::LeftThigh,
        Segment::LeftShank,
        Segment::LeftFoot,
        Segment::RightThigh,
        Segment::RightShank,
        Segment::RightFoot,
    ];

    /// The segment that this one hangs on.
    pub fn parent(self) -> Option<Segment> {
        use Segment::*;
        Some(match self {
            Pelvis => return None,
            Trunk | LeftThigh | RightThigh => Pelvis,
            Head | LeftUpperArm | RightUpperArm => Trunk,
            LeftForearm => LeftUpperArm,
            LeftHand => LeftForearm,
            RightForearm => RightUpperArm,
            RightHand => RightForearm,
            LeftShank => LeftThigh,
            LeftFoot => LeftShank,
            RightShank => RightThigh,
            RightFoot => RightShank,
        })
    }

    /// Its counterpart on the other side; itself where it has none.
    pub fn opposite(self) -> Segment {
        use Segment::*;
        match self {
            Pelvis | Trunk | Head => self,
            LeftUpperArm => RightUpperArm,
            LeftForearm => RightForearm,
            LeftHand => RightHand,
            RightUpperArm => LeftUpperArm,
            RightForearm => LeftForearm,
            RightHand => LeftHand,
            LeftThigh => RightThigh,
            LeftShank => RightShank,
            LeftFoot => RightFoot,
            RightThigh => LeftThigh,
            RightShank => LeftShank,
            RightFoot => LeftFoot,
        }
    }

    /// Its name in words.
    pub fn name(self) -> &'static str {
        use Segment::*;
        match self {
            Pelvis => "pelvis",
            Trunk => "trunk",
            Head => "head",
            LeftUpperArm => "left upper arm",
            LeftForearm => "left forearm",
            LeftHand => "left hand",
            RightUpperArm => "right upper arm",
            RightForearm => "right forearm",
            RightHand => "right hand",
            LeftThigh => "left thigh",
            LeftShank => "left shank",
            LeftFoot => "left foot",
            RightThigh => "right thigh",
            RightShank => "right shank",
            RightFoot => "right foot",
        }
    }

    /// Whether it hardly bends inside: hands, feet, head and pelvis keep their own distances.
    pub fn is_stiff(self) -> bool {
        use Segment::*;
        matches!(self, Pelvis | Head | LeftHand | RightHand | LeftFoot | RightFoot)
    }

    /// Arms and legs, left before right, from the trunk outward.
    pub(crate) const ARMS: [[Self; 3]; 2] =
        [[Self::LeftUpperArm, Self::LeftForearm, Self::LeftHand], [Self::RightUpperArm, Self::RightForearm, Self::RightHand]];
    pub(crate) const LEGS: [[Self; 3]; 2] =
        [[Self::LeftThigh, Self::LeftShank, Self::LeftFoot], [Self::RightThigh, Self::RightShank, Self::RightFoot]];

    /// Whether it belongs to an arm.
    pub fn is_arm(self) -> bool {
        (Segment::LeftUpperArm..=Segment::RightHand).contains(&self)
    }

    /// Whether it belongs to a leg.
    pub fn is_leg(self) -> bool {
        (Segment::LeftThigh..=Segment::RightFoot).contains(&self)
    }
}

/// A segment in the scan's rest pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bone {
    pub origin: DVec3,
    pub end: DVec3,
    pub length: f64,
    /// Unit vector from origin to end.
    pub axis: DVec3,
    /// Away from the mid plane.
    pub out: DVec3,
    /// To the front.
    pub forward: DVec3,
}

/// The segments of a scan in its rest pose, in the unit box.
#[derive(Clone, Debug)]
pub(crate) struct Skeleton {
    pub bones: [Bone; Segment::COUNT],
    pub shoulders: [DVec3; 2],
    pub neck: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
    pub left: DVec3,
    pub stature: f64,
}

/// Share of the way from mid hip to neck where the trunk begins to turn against the pelvis.
const LUMBAR: f64 = 0.30;

impl Skeleton {
    pub(crate) fn of(body: &Body) -> Self {
        let joint = |j: Joint| body.joints[j as usize];
        let (up, forward) = (body.up, body.forward);
        let left = up.cross(forward);
        let hips = (joint(Joint::LeftHip) + joint(Joint::RightHip)) * 0.5;
        let neck = joint(Joint::Neck);
        let bone = |segment: Segment, origin: DVec3, end: DVec3| {
            let length = (end - origin).length().max(1e-9);
            let axis = (end - origin) / length;
            let lateral = match segment {
                s if s >= Segment::RightUpperArm && s <= Segment::RightHand || s >= Segment::RightThigh => -left,
                _ => left,
            };
            let across = |v: DVec3, axis: DVec3| (v - axis * v.dot(axis)).try_normalize();
            let (out, forward) = if segment.is_arm() {
                let fwd = across(forward, axis).unwrap_or(up);
                // Of a hanging arm, away from the mid plane; of a level one, up.
                let out = fwd.cross(axis);
                let outward = out.dot(up) + 0.3 * out.dot(lateral);
                (if outward >= 0.0 { out } else { -out }, fwd)
            } else if matches!(segment, Segment::LeftFoot | Segment::RightFoot) {
                (lateral, across(axis, up).unwrap_or(forward))
            } else {
                (lateral, across(forward, axis).unwrap_or(forward))
            };
            Bone { origin, end, length, axis, out, forward }
        };
        let ends = |segment: Segment| {
            use Joint::*;
            let (a, b) = match segment {
                Segment::Pelvis => return (hips, neck),
                Segment::Trunk => return (hips.lerp(neck, LUMBAR), neck),
                Segment::Head => (Head, Crown),
                Segment::LeftUpperArm => (LeftShoulder, LeftElbow),
                Segment::LeftForearm => (LeftElbow, LeftWrist),
                Segment::LeftHand => (LeftWrist, LeftHandTip),
                Segment::RightUpperArm => (RightShoulder, RightElbow),
                Segment::RightForearm => (RightElbow, RightWrist),
                Segment::RightHand => (RightWrist, RightHandTip),
                Segment::LeftThigh => (LeftHip, LeftKnee),
                Segment::LeftShank => (LeftKnee, LeftAnkle),
                Segment::LeftFoot => (LeftAnkle, LeftToe),
                Segment::RightThigh => (RightHip, RightKnee),
                Segment::RightShank => (RightKnee, RightAnkle),
                Segment::RightFoot => (RightAnkle, RightToe),
            };
            (joint(a), joint(b))
        };
        Self {
            bones: Segment::ALL.map(|s| {
                let (a, b) = ends(s);
                bone(s, a, b)
            }),
            shoulders: [joint(Joint::LeftShoulder), joint(Joint::RightShoulder)],
            neck,
            up,
            forward,
            left,
            stature: body.stature,
        }
    }

    pub(crate) fn bone(&self, segment: Segment) -> &Bone {
        &self.bones[segment as usize]
    }
}

/// The same body facing the other way: left and right change places.
pub(crate) fn turned(body: &Body) -> Body {
    use Joint::*;
    let mut out = body.clone();
    for (a, b) in [
        (LeftShoulder, RightShoulder),
        (LeftElbow, RightElbow),
        (LeftWrist, RightWrist),
        (LeftHandTip, RightHandTip),
        (LeftHip, RightHip),
        (LeftKnee, RightKnee),
        (LeftAnkle, RightAnkle),
        (LeftToe, RightToe),
    ] {
        out.joints.swap(a as usize, b as usize);
    }
    out.arm_elevation.swap(0, 1);
    out.forward = -body.forward;
    out
}
