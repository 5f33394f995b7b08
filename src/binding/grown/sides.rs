//! Which side of a cut the skin belongs to, by the joints.

use crate::binding::landmarks::{Body, Joint};
use glam::DVec3;

// Lengths are shares of stature, stations count the bones of an arm from the shoulder: 1 is the elbow, 2 the wrist, 3 the finger tips.

/// Where an arm that hangs leaves the trunk.
const ARMPIT: f64 = 0.35;
/// Stations at which an arm's radius is measured, per bone.
const PER_BONE: usize = 10;
/// How far along the arm the skin belongs to a station, and how far off the bone.
const WINDOW: f64 = 0.08;
const REACH: f64 = 0.09;
/// The skin runs this much farther than its radius before the arm's round ends in a crease.
const ROUND: f64 = 1.2;
/// Half the breadth of a hand that lies against the thigh, and where the forearm goes over into it.
const HALF_HAND: f64 = 0.045;
const WRIST: [f64; 2] = [1.7, 2.15];
/// How far beyond the finger tips a hand may end.
const TIP: f64 = 0.02;
/// Skin between an arm and the trunk as a share of the arm's, above which the arm has a skin of its own there and only touches.
const OWN_SKIN: f64 = 0.02;
/// Depth of the crotch under the hip joints.
const CROTCH: f64 = 0.03;
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// Above where the two part, or on another limb.
    Neither,
    Limb,
    Rest,
}

/// An arm along the trunk.
pub(super) struct Arm {
    bones: [DVec3; 4],
    up: DVec3,
    pub(super) outwards: DVec3,
    forward: DVec3,
    stature: f64,
    /// Distance of the outer skin from the bones, by station.
    radius: Vec<f64>,
    /// Height of the armpit along `up`.
    pub(super) armpit: f64,
}

impl Arm {
    pub(super) fn new(body: &Body, side: usize, points: &[DVec3]) -> Option<Self> {
        use Joint::{LeftElbow, LeftHandTip, LeftShoulder, LeftWrist, RightElbow, RightHandTip, RightShoulder, RightWrist};
        let joints =
            [[LeftShoulder, LeftElbow, LeftWrist, LeftHandTip], [RightShoulder, RightElbow, RightWrist, RightHandTip]][side];
        let bones = joints.map(|j| body.joints[j as usize]);
        let left = body.up.cross(body.forward);
        let mut arm = Self {
            bones,
            up: body.up,
            outwards: if side == 0 { left } else { -left },
            forward: body.forward,
            stature: body.stature,
            radius: Vec::new(),
            armpit: bones[0].lerp(bones[1], ARMPIT).dot(body.up),
        };
        let seen: Vec<Seen> = points.iter().map(|&p| arm.seen(p)).collect();
        let outer = |s: &&Seen| s.out > 0.0 && s.front.abs() < 0.5 * s.out && s.distance < REACH * arm.stature;
        let outer: Vec<&Seen> = seen.iter().filter(outer).collect();
        let at = |station: f64| {
            let mut near: Vec<f64> = outer.iter().filter(|s| (s.station - station).abs() < WINDOW).map(|s| s.out).collect();
            near.sort_by(f64::total_cmp);
            near.get(near.len() / 2).copied()
        };
        let found: Vec<Option<f64>> = (0..=3 * PER_BONE).map(|k| at(k as f64 / PER_BONE as f64)).collect();
        // Where no skin is seen, the nearest station that has some.
        let nearest = |k: usize| (0..found.len()).filter(|&j| found[j].is_some()).min_by_key(|&j| j.abs_diff(k));
        arm.radius = (0..found.len()).map(|k| nearest(k).and_then(|j| found[j])).collect::<Option<_>>()?;
        Some(arm)
    }

    fn seen(&self, p: DVec3) -> Seen {
        let on = |k: usize| {
            let (a, b) = (self.bones[k], self.bones[k + 1]);
            let most = if k == 2 { 1.5 } else { 1.0 };
            let along = ((p - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, most);
            let off = p - (a + (b - a) * along);
            Seen { station: k as f64 + along, distance: off.length(), out: off.dot(self.outwards), front: off.dot(self.forward) }
        };
        [on(1), on(2)].into_iter().fold(on(0), |best, next| if next.distance < best.distance { next } else { best })
    }

    fn radius(&self, station: f64) -> f64 {
        let at = (station * PER_BONE as f64).clamp(0.0, (self.radius.len() - 1) as f64);
        let (k, t) = (at as usize, at.fract());
        self.radius[k] * (1.0 - t) + self.radius[(k + 1).min(self.radius.len() - 1)] * t
    }

    pub(super) fn side(&self, p: DVec3) -> Side {
        if p.dot(self.up) > self.armpit {
            return Side::Neither;
        }
        let s = self.seen(p);
        let radius = self.radius(s.station);
        let hand = ((s.station - WRIST[0]) / (WRIST[1] - WRIST[0])).clamp(0.0, 1.0);
        let breadth = (ROUND * radius) * (1.0 - hand) + HALF_HAND * self.stature * hand;
        let lowest = self.bones[3].dot(self.up) - TIP * self.stature;
        let own = s.station > ARMPIT && s.out > -radius && s.front.abs() < breadth && s.distance < REACH * self.stature;
        if own && p.dot(self.up) > lowest { Side::Limb } else { Side::Rest }
    }

    /// Whether next to no skin lies between the arm and the trunk, as much as an arm with a skin of its own has there.
    pub(super) fn has_grown_on(&self, points: &[DVec3], sides: &[Side]) -> bool {
        let own = sides.iter().filter(|side| **side == Side::Limb).count() as f64;
        let between = |&&p: &&DVec3| {
            let s = self.seen(p);
            let radius = self.radius(s.station);
            let along = (ARMPIT..WRIST[0]).contains(&s.station) && s.distance < REACH * self.stature;
            along && s.out < -0.3 * radius && s.front.abs() < 0.5 * radius
        };
        let inner = points.iter().filter(between).count() as f64;
        own > 0.0 && inner < OWN_SKIN * own
    }
}

/// A point against the bones of an arm: nearest station, distance from it, and how far it lies out and in front.
pub(super) struct Seen {
    station: f64,
    distance: f64,
    out: f64,
    front: f64,
}

pub(super) struct Legs {
    hips: DVec3,
    knees: DVec3,
    pub(super) left: DVec3,
    up: DVec3,
    pub(super) crotch: f64,
    /// Height of the lower ankle.
    ankles: f64,
}

impl Legs {
    pub(super) fn new(body: &Body) -> Self {
        let joint = |j: Joint| body.joints[j as usize];
        let hips = (joint(Joint::LeftHip) + joint(Joint::RightHip)) * 0.5;
        let knees = (joint(Joint::LeftKnee) + joint(Joint::RightKnee)) * 0.5;
        Self {
            hips,
            knees,
            left: body.up.cross(body.forward),
            up: body.up,
            crotch: hips.dot(body.up) - CROTCH * body.stature,
            ankles: joint(Joint::LeftAnkle).dot(body.up).min(joint(Joint::RightAnkle).dot(body.up)),
        }
    }

    pub(super) fn side(&self, p: DVec3) -> Side {
        let height = p.dot(self.up);
        if height > self.crotch || height < self.ankles {
            return Side::Neither;
        }
        let down = self.knees - self.hips;
        let middle = self.hips + down * ((height - self.hips.dot(self.up)) / down.dot(self.up));
        if (p - middle).dot(self.left) > 0.0 { Side::Limb } else { Side::Rest }
    }
}
