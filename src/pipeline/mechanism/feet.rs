//! Feet that stand in the capture stand on the machine's ground: as high over it as the actor's, as flat, and held where they came down.

use super::drive::{Drive, Stand};
use crate::binding::person::{Joints, Person};
use crate::deform::joints::{Ground, Model};
use glam::{DQuat, DVec3};

/// A foot rests below this speed, in lengths of a leg per second, and height over its lowest, in lengths of a leg, and until it has more than the second
/// of each.
const SPEED: (f64, f64) = (0.3, 0.5);
const HEIGHT: (f64, f64) = (0.06, 0.09);
/// Farther than this, in lengths of a leg, no foot is held back: it is carried (a treadmill, a board with wheels).
const FARTHEST: f64 = 0.12;
/// Seconds in which a foot that lifts off goes back to its own way.
const RELEASE: f64 = 0.25;
/// Share of frames in which a foot is at its lowest.
const LOWEST: f64 = 0.05;
/// A sole is known by the points on which the foot would stand if it were tilted so, in degrees, in so many directions.
const TILTS: [f64; 4] = [2.0, 15.0, 40.0, 70.0];
const DIRECTIONS: usize = 12;

/// A point of a foot that rests.
#[derive(Clone, Copy, Debug)]
struct Contact {
    /// 0 the ankle, 1 the toe.
    point: usize,
    /// Where it is held, and where it came down in the capture.
    at: DVec3,
    from: DVec3,
}

/// A foot of the take and what it drives.
#[derive(Clone, Debug)]
pub(super) struct Foot {
    /// Drives of ankle and toe.
    points: [Option<usize>; 2],
    /// Their heights in the capture when the foot stands, and on the machine, both in the unit box.
    rest: [f64; 2],
    home: [f64; 2],
    /// By how much steeper the machine's foot goes down from the ankle to the toe when both stand flat.
    steeper: f64,
    before: [DVec3; 2],
    contact: Option<Contact>,
    /// Whether what it rests on has carried it away.
    carried: bool,
    /// By how much the targets are moved, level; when it was let go, and the share of the release that is over.
    shift: DVec3,
    gone: f64,
}

impl Foot {
    /// The feet of a person that drive something.
    pub(super) fn all(joints: &Joints<'_>, drives: &[Drive], stand: &Stand, person: &Person, frames: usize) -> Vec<Self> {
        let capture_up = stand.axes.inverse() * stand.up;
        let lowest = |joint: usize| {
            let step = frames.div_ceil(2000).max(1);
            let places = (0..frames).step_by(step).filter_map(|f| joints.place(Some(f), joint));
            let mut heights: Vec<f64> = places.map(|p| p.dot(capture_up) * stand.scale).collect();
            heights.sort_by(f64::total_cmp);
            heights.get((heights.len() as f64 * LOWEST) as usize).copied().unwrap_or(0.0)
        };
        let drive_of = |joint: usize| drives.iter().position(|d| d.joint == joint && !d.turns);
        let mut feet = Vec::new();
        for side in 0..2 {
            let ankle = person.legs[side][2];
            let Some(at) = drive_of(ankle) else { continue };
            let toe = person.toes[side].filter(|toe| drive_of(*toe).is_some());
            let points = [Some(at), toe.and_then(drive_of)];
            let rest = [lowest(ankle), toe.map_or(0.0, lowest)];
            let home = points.map(|d| d.map_or(0.0, |d| drives[d].spot.1.dot(stand.up)));
            let bone =
                toe.and_then(|toe| Some(joints.place(Some(0), toe)?.distance(joints.place(Some(0), ankle)?) * stand.scale));
            let on_machine = points[1].map(|d| drives[d].spot.1.distance(drives[at].spot.1));
            let slope = |[ankle, toe]: [f64; 2], length: f64| ((ankle - toe) / length).clamp(-1.0, 1.0).asin();
            let steeper = bone.zip(on_machine).map_or(0.0, |(own, machine)| slope(home, machine) - slope(rest, own));
            feet.push(Self {
                points,
                rest,
                home,
                steeper: if steeper.is_finite() { steeper } else { 0.0 },
                before: [DVec3::NAN; 2],
                contact: None,
                carried: false,
                shift: DVec3::ZERO,
                gone: 1.0,
            });
        }
        feet
    }

    /// Height of the ankle in the capture when the foot stands, and on the machine.
    pub(super) fn levels(&self) -> (f64, f64) {
        (self.rest[0], self.home[0])
    }

    /// By how much steeper the bone to this drive goes on the machine than in the capture, with the foot flat.
    pub(super) fn steeper(&self, drive: usize) -> Option<f64> {
        (self.points[1] == Some(drive)).then_some(self.steeper)
    }

    /// Brings the targets of the foot to its height over the ground, and holds them while it rests. `own`: places of all drives in the capture.
    pub(super) fn place(&mut self, own: &[DVec3], targets: &mut [DVec3], stand: &Stand, leg: f64, rate: f64) {
        let up = stand.up;
        let level = |v: DVec3| v - up * v.dot(up);
        let seen: Vec<(usize, usize)> = (0..2)
            .filter_map(|w| Some((w, self.points[w]?)))
            .filter(|&(_, d)| own[d].is_finite() && targets[d].is_finite())
            .collect();
        if self.points.iter().flatten().count() > seen.len() || seen.is_empty() {
            // What is not a number would stay in the hold for ever.
            (self.contact, self.shift, self.carried, self.before) = (None, DVec3::ZERO, false, [DVec3::NAN; 2]);
            return;
        }
        let mut clear = [f64::INFINITY; 2];
        let mut slow = [f64::INFINITY; 2];
        for &(w, d) in &seen {
            let here = own[d] * stand.scale;
            clear[w] = (here.dot(up) - self.rest[w]).max(0.0);
            let moved = level(here - self.before[w]).length() * rate;
            slow[w] = if moved.is_nan() { 0.0 } else { moved };
            self.before[w] = here;
        }
        // As high as the lower of the actor's two points, with the foot turned as it is.
        let over = seen.iter().map(|&(w, d)| targets[d].dot(up) - self.home[w]).fold(f64::INFINITY, f64::min);
        let rise = up * (clear[0].min(clear[1]) - over);
        seen.iter().for_each(|&(_, d)| targets[d] += rise);

        let rests = |w: usize, speed: f64, height: f64| slow[w] <= speed * leg && clear[w] <= height * leg;
        let held = self.contact.filter(|c| rests(c.point, SPEED.1, HEIGHT.1)).map(|c| c.point);
        // The ball where it rests, on which a foot turns; the heel before it comes down.
        let point = held.or_else(|| [1, 0].into_iter().find(|&w| rests(w, SPEED.0, HEIGHT.0)));
        self.carried &= point.is_some();
        let point = point.filter(|_| !self.carried);
        let Some((w, d)) = seen.into_iter().find(|s| Some(s.0) == point) else { return self.let_go(targets, rate) };
        let own_way = level(targets[d]);
        let from = level(self.before[w]);
        let new = Contact { point: w, at: own_way + self.left(), from };
        let contact = self.contact.filter(|c| c.point == w).unwrap_or(new);
        if contact.from.distance(from) > FARTHEST * leg {
            self.carried = true;
            return self.let_go(targets, rate);
        }
        self.contact = Some(contact);
        let wanted = contact.at - own_way;
        (self.shift, self.gone) = (wanted, 0.0);
        self.points.iter().flatten().for_each(|&d| targets[d] += wanted);
    }

    /// What is left of the shift.
    fn left(&self) -> DVec3 {
        let t = self.gone;
        self.shift * (1.0 - t * t * (3.0 - 2.0 * t))
    }

    /// Brings a foot that is not held back to its own way.
    fn let_go(&mut self, targets: &mut [DVec3], rate: f64) {
        self.contact = None;
        self.gone = (self.gone + 1.0 / (RELEASE * rate).max(1.0)).min(1.0);
        let left = self.left();
        self.points.iter().flatten().for_each(|&d| targets[d] += left);
    }
}

/// A bone of the capture, as steep as the machine's: turned towards the bone before it.
pub(super) fn tilted(bone: DVec3, before: DVec3, steeper: f64) -> DVec3 {
    let across = bone.cross(before);
    // A foot in line with the shank, or without any length, has no direction down.
    let axis = across.try_normalize().filter(|_| across.length() > 1e-6 * bone.length() * before.length());
    axis.map_or(bone, |axis| DQuat::from_axis_angle(axis, steeper) * bone)
}

/// The ground under the soles of a machine, whose feet are the parts that ankles and toes drive.
pub fn ground(model: &Model, drives: &[Drive], person: &Person, stand: &Stand) -> Ground {
    let up = stand.up;
    let is_foot = |d: &&Drive| !d.turns && (person.legs.iter().any(|l| l[2] == d.joint) || person.toes.contains(&Some(d.joint)));
    let mut parts: Vec<usize> = drives.iter().filter(is_foot).map(|d| d.spot.0).collect();
    parts.sort_unstable();
    parts.dedup();
    let (x, y) = up.any_orthonormal_pair();
    let mut points = Vec::new();
    for part in parts {
        let all = &model.parts()[part].points;
        for tilt in TILTS {
            let (sin, cos) = tilt.to_radians().sin_cos();
            for k in 0..DIRECTIONS {
                let (v, u) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
                let down = (x * u + y * v) * sin - up * cos;
                let lowest = all.iter().max_by(|p, q| p.dot(down).total_cmp(&q.dot(down)));
                points.extend(lowest.map(|&p| (part, p)));
            }
        }
    }
    points.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.to_array().partial_cmp(&b.1.to_array()).unwrap_or(std::cmp::Ordering::Equal)));
    points.dedup();
    Ground { up, height: stand.floor, points }
}
