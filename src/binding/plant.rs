//! Feet that stand in the capture stand on the scan.
//!
//! A body of other proportions that turns its joints as the actor does lets its feet slide by some centimetres. While the heel or the ball
//! of a foot rests on the floor it is held where it came down, by the two bones of the leg; when it leaves, the leg goes back to its own
//! way within a tenth of a second. Later frames change nothing.

use super::Slip;
use super::segments::{Segment, Skeleton};
use super::similarity::turn_between;
use crate::statistics::quantile;
use glam::{DQuat, DVec3};

/// A foot rests below this speed (statures per second) and height over the floor (statures), and until it has more than the second of each.
const SPEED: (f64, f64) = (0.15, 0.25);
const HEIGHT: (f64, f64) = (0.03, 0.045);
/// Farther than this, in statures, no foot is held back: it is carried (a treadmill, a board with wheels).
const FARTHEST: f64 = 0.06;
/// Seconds within which a leg that was held goes back to its own way.
const RETURN: f64 = 0.1;
/// Contacts shorter than this, in seconds, do not count in the tally.
const SHORTEST: f64 = 0.1;
/// Share of its length to which a leg is stretched at most.
const STRETCHED: f64 = 0.9995;
/// Bends of the knee below this, as a share of the thigh, have no direction.
const STRAIGHT: f64 = 1e-4;
/// Where the ball of a foot is on the way from ankle to tip.
const BALL: f64 = 0.68;

/// A leg of the scan in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Leg {
    pub hip: DVec3,
    pub knee: DVec3,
    pub ankle: DVec3,
    /// Turns of thigh, shank and foot against the rest.
    pub thigh: DQuat,
    pub shank: DQuat,
    pub foot: DQuat,
}

/// Heel and ball of a foot at rest, counted from its ankle.
pub(super) fn sole(body: &Skeleton, side: usize) -> [DVec3; 2] {
    let bone = body.bone(if side == 0 { Segment::LeftFoot } else { Segment::RightFoot });
    let floor = floor(body);
    let down = |p: DVec3| p + body.up * (floor - p.dot(body.up)) - bone.origin;
    [down(bone.origin - bone.forward * (0.2 * bone.length)), down(bone.origin.lerp(bone.end, BALL))]
}

/// Height of the floor under the scan.
pub(super) fn floor(body: &Skeleton) -> f64 {
    body.bone(Segment::Head).end.dot(body.up) - body.stature
}

#[derive(Clone, Copy, Debug)]
struct Contact {
    /// 0 the heel, 1 the ball.
    point: usize,
    /// Where it is held.
    at: DVec3,
    /// Where its own way began.
    from: DVec3,
    frames: usize,
    slid: f64,
    left: f64,
}

#[derive(Clone, Debug, Default)]
struct Foot {
    before: Option<[DVec3; 2]>,
    contact: Option<Contact>,
    /// What the ankle is moved by.
    shift: DVec3,
    /// Whether what it rests on has carried it away.
    carried: bool,
}

/// Holds the feet of a take, frame after frame.
#[derive(Clone, Debug)]
pub(super) struct Planter {
    up: DVec3,
    forward: DVec3,
    floor: f64,
    stature: f64,
    rate: f64,
    soles: [[DVec3; 2]; 2],
    feet: [Foot; 2],
    slid: Vec<f64>,
    left: Vec<f64>,
}

impl Planter {
    /// `floor`: its height along up in the space of the legs; `rate`: frames per second.
    pub(super) fn new(body: &Skeleton, floor: f64, rate: f64) -> Self {
        Self {
            up: body.up,
            forward: body.forward,
            floor,
            stature: body.stature,
            rate,
            soles: [sole(body, 0), sole(body, 1)],
            feet: Default::default(),
            slid: Vec::new(),
            left: Vec::new(),
        }
    }

    fn level(&self, v: DVec3) -> DVec3 {
        v - self.up * v.dot(self.up)
    }

    /// Holds the foot of a leg in the next frame. A leg that is missing is called for with `None`.
    pub(super) fn plant(&mut self, side: usize, leg: Option<&mut Leg>) {
        let Some(leg) = leg else {
            self.end(side);
            self.feet[side] = Foot::default();
            return;
        };
        let points = self.soles[side].map(|p| leg.ankle + leg.foot * p);
        let before = self.feet[side].before.replace(points);
        let rests = |point: usize, speed: f64, height: f64| {
            let moved = before.map_or(0.0, |b| self.level(points[point] - b[point]).length());
            let high = points[point].dot(self.up) - self.floor;
            moved * self.rate <= speed * self.stature && high <= height * self.stature
        };
        let held = self.feet[side].contact.filter(|c| rests(c.point, SPEED.1, HEIGHT.1));
        // The heel where it rests; from the heel to the ball where it rises.
        let point = match held {
            Some(contact) => Some(contact.point),
            None => (0..2).find(|&point| rests(point, SPEED.0, HEIGHT.0)),
        };
        if self.feet[side].contact.is_some_and(|c| Some(c.point) != point || held.is_none()) {
            self.end(side);
        }
        if self.feet[side].carried && point.is_some() {
            // Until it rises.
            self.let_go(leg, side);
        } else if let Some(point) = point {
            let own = points[point];
            let shift = self.feet[side].shift;
            let contact = self.feet[side].contact.get_or_insert(Contact {
                point,
                at: own + shift,
                from: own,
                frames: 0,
                slid: 0.0,
                left: 0.0,
            });
            let wanted = contact.at - own;
            contact.frames += 1;
            let from = contact.from;
            let level = wanted - self.up * wanted.dot(self.up);
            let far = level.length() > FARTHEST * self.stature;
            let slid = self.level(own - from).length();
            if far {
                if let Some(contact) = &mut self.feet[side].contact {
                    (contact.slid, contact.left) = (contact.slid.max(slid), contact.left.max(slid - shift.length()));
                }
                self.end(side);
                self.feet[side].carried = true;
                self.let_go(leg, side);
                return;
            }
            self.feet[side].shift = level;
            let reached = self.reach(leg, side);
            let left = (level - self.level(reached)).length();
            if let Some(contact) = &mut self.feet[side].contact {
                (contact.slid, contact.left) = (contact.slid.max(slid), contact.left.max(left));
            }
        } else {
            self.feet[side].carried = false;
            self.let_go(leg, side);
        }
    }

    /// Brings a leg that is not held back to its own way.
    fn let_go(&mut self, leg: &mut Leg, side: usize) {
        let step = FARTHEST * self.stature / (RETURN * self.rate).max(1.0);
        let shift = self.feet[side].shift;
        self.feet[side].shift = if shift.length() <= step { DVec3::ZERO } else { shift - shift.normalize() * step };
        self.reach(leg, side);
    }

    fn end(&mut self, side: usize) {
        if let Some(contact) = self.feet[side].contact.take()
            && contact.frames as f64 >= SHORTEST * self.rate
        {
            self.slid.push(contact.slid);
            self.left.push(contact.left);
        }
    }

    /// Moves the ankle by the foot's shift; gives what was reached.
    fn reach(&self, leg: &mut Leg, side: usize) -> DVec3 {
        let shift = self.feet[side].shift;
        if shift == DVec3::ZERO {
            return shift;
        }
        let ankle = leg.ankle;
        leg.bend_to(ankle + shift, self.forward);
        leg.ankle - ankle
    }

    /// How far the feet slid over the frames so far; `length`: of the unit box in the unit of the tally.
    pub(super) fn slip(mut self, length: f64) -> Option<Slip> {
        (0..2).for_each(|side| self.end(side));
        let of =
            |values: &mut Vec<f64>| Some((quantile(values, 0.5)? * length, values.iter().copied().fold(0.0, f64::max) * length));
        let contacts = self.slid.len();
        Some(Slip { contacts, before: of(&mut self.slid)?, after: of(&mut self.left)? })
    }
}

impl Leg {
    /// Brings the ankle to a place, as far as the leg reaches: the whole leg turns about the hip and the knee bends in its plane, that of a straight
    /// leg to where the body at rest has its front.
    fn bend_to(&mut self, target: DVec3, forward: DVec3) {
        let (upper, lower) = ((self.knee - self.hip).length(), (self.ankle - self.knee).length());
        let way = target - self.hip;
        let (least, most) = ((upper - lower).abs() / STRETCHED, (upper + lower) * STRETCHED);
        if least.is_nan() || most.is_nan() || least >= most {
            return;
        }
        let reach = way.length().clamp(least, most);
        let (Some(along), Some(old)) = (way.try_normalize(), (self.ankle - self.hip).try_normalize()) else { return };
        let turn = turn_between(old, along);
        let knee = turn * (self.knee - self.hip);
        let across = |v: DVec3| v - along * v.dot(along);
        let bend = across(knee);
        let bend = if bend.length() < STRAIGHT * upper { across(self.thigh * forward) } else { bend };
        let Some(aside) = bend.try_normalize() else { return };
        let cosine = ((upper * upper + reach * reach - lower * lower) / (2.0 * upper * reach)).clamp(-1.0, 1.0);
        let knee_to = (along * cosine + aside * (1.0 - cosine * cosine).sqrt()) * upper;
        let ankle_to = along * reach;
        let shank = turn * (self.ankle - self.knee);
        let toward = |from: DVec3, to: DVec3| turn_between(from.normalize(), to.normalize());
        self.thigh = (toward(knee, knee_to) * turn * self.thigh).normalize();
        self.shank = (toward(shank, ankle_to - knee_to) * turn * self.shank).normalize();
        self.knee = self.hip + knee_to;
        self.ankle = self.hip + ankle_to;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::binding::tests::person;

    const RATE: f64 = 100.0;

    fn standing(body: &Skeleton) -> Leg {
        let bone = |s: Segment| body.bone(s).origin;
        Leg {
            hip: bone(Segment::LeftThigh),
            knee: bone(Segment::LeftShank) + body.forward * 0.02,
            ankle: bone(Segment::LeftFoot),
            thigh: DQuat::IDENTITY,
            shank: DQuat::IDENTITY,
            foot: DQuat::IDENTITY,
        }
    }

    #[test]
    fn a_leg_bends_to_a_place_with_its_lengths_kept() {
        let body = Skeleton::of(&person(0.7).body);
        let before = standing(&body);
        let mut leg = before;
        let target = leg.ankle + body.forward * 0.05 + body.up * 0.03;
        leg.bend_to(target, body.forward);
        assert!(leg.ankle.distance(target) < 1e-12, "{}", leg.ankle.distance(target));
        let lengths = |l: &Leg| [(l.knee - l.hip).length(), (l.ankle - l.knee).length()];
        for (a, b) in lengths(&before).into_iter().zip(lengths(&leg)) {
            assert!((a - b).abs() < 1e-12);
        }
        assert!(
            (leg.thigh * (before.knee - before.hip) - (leg.knee - leg.hip)).length() < 1e-12,
            "the thigh turns with its bone"
        );
        assert!((leg.shank * (before.ankle - before.knee) - (leg.ankle - leg.knee)).length() < 1e-12);
        let knee = leg.knee - leg.hip.lerp(leg.ankle, 0.5);
        assert!(knee.dot(body.forward) > 0.0, "the knee stays in front");
        leg.bend_to(leg.hip - body.up * 5.0, body.forward);
        let whole: f64 = lengths(&before).iter().sum();
        assert!((leg.ankle - leg.hip).length() < whole, "no farther than the leg is long");
    }

    #[test]
    fn a_sliding_foot_is_held_and_let_go_without_a_jump() {
        let body = Skeleton::of(&person(0.7).body);
        let mut planter = Planter::new(&body, floor(&body), RATE);
        let mut ankles: Vec<DVec3> = Vec::new();
        let own = |k: usize| {
            // Slides by 0.6 % of stature in half a second, rises, and swings on.
            let (slide, swing) = (k.min(50) as f64, k.saturating_sub(50) as f64);
            let lift = (swing * 0.006).min(0.08);
            body.forward * (slide * 0.00012 + swing * 0.004) * body.stature + body.up * lift * body.stature
        };
        for k in 0..90 {
            let mut leg = standing(&body);
            (leg.ankle, leg.knee, leg.hip) = (leg.ankle + own(k), leg.knee + own(k), leg.hip + own(k));
            planter.plant(0, Some(&mut leg));
            ankles.push(leg.ankle);
        }
        let moved = |a: usize, b: usize| ankles[a].distance(ankles[b]) / body.stature;
        assert!(moved(0, 50) < 1e-6, "{}", moved(0, 50));
        for k in 1..90 {
            let natural = (own(k) - own(k - 1)).length() / body.stature;
            assert!(moved(k - 1, k) < natural + 0.0065, "frame {k}: {}", moved(k - 1, k));
        }
        let last = standing(&body).ankle + own(89);
        assert!(ankles[89].distance(last) < 1e-12, "the leg is back on its own way");
        let slip = planter.slip(1.0).map(|s| (s.contacts, s.before.0 / body.stature, s.after.0 / body.stature));
        assert!(slip.is_some_and(|(contacts, before, after)| contacts == 1 && before > 0.0055 && after < 1e-6), "{slip:?}");
    }

    #[test]
    fn what_carries_the_feet_is_no_floor() {
        let body = Skeleton::of(&person(0.7).body);
        let mut planter = Planter::new(&body, floor(&body), RATE);
        let mut run = |speed: f64| -> Vec<bool> {
            let mut free = |k: usize| {
                let own = body.forward * (speed * k as f64 / RATE) * body.stature;
                let mut leg = standing(&body);
                (leg.ankle, leg.knee, leg.hip) = (leg.ankle + own, leg.knee + own, leg.hip + own);
                let alone = leg;
                planter.plant(0, Some(&mut leg));
                leg == alone
            };
            (0..200).map(&mut free).collect()
        };
        assert!(run(0.3)[1..].iter().all(|&free| free), "too fast to rest");
        let slow = run(0.1);
        assert!(!slow[40], "held at first");
        assert!(slow[100..].iter().all(|&free| free), "carried away by more than {FARTHEST} of stature");
    }
}
