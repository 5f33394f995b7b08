//! Joints along legs, arms and neck, from medial curves. Lengths are shares of the body's length from head to feet through the solid.

use super::axes::Line;
use super::extremities::{End, Extremities};
use super::medial::{Curve, Section};
use super::voxels::Solid;
use glam::DVec3;

/// Ankle above the sole.
const ANKLE: f64 = 0.040;
/// Knee on the way from ankle to hip (Winter, Biomechanics and Motor Control of Human Movement: 0.49).
const KNEE: f64 = 0.50;
const KNEE_BELOW_NARROW: f64 = 0.01;
/// Elbow on the way from wrist to shoulder (Winter: forearm 0.146, upper arm 0.186 of stature).
pub(super) const ELBOW: f64 = 0.455;
/// Shoulder joint beyond the level of the armpit.
const SHOULDER: f64 = 0.030;
/// Hip joint above the crotch and to the side of it.
const HIP_UP: f64 = 0.045;
const HIP_ASIDE: f64 = 0.055;
/// Distance from foot to crotch: where it may be measured, and what it is otherwise (robes and long coats).
const CROTCH_RANGE: [f64; 2] = [0.44, 0.60];
const CROTCH: f64 = 0.497;
/// Up to this height above the toes, and this distance from the feet, the halves of the body are compared.
const PELVIS_HEIGHT: f64 = 0.60;
const PELVIS_LEVEL: f64 = 0.62;
/// The halves meet at the crotch in this share of the most that they meet in.
const CROTCH_DEPTH: f64 = 0.2;
/// A limb bent by more degrees than this shows its joint.
const CLEAR_BEND: f64 = 25.0;

/// A leg from the toes to the thigh.
pub(super) struct Leg {
    pub(super) ankle: DVec3,
    pub(super) toe: DVec3,
    thigh: Line,
    curve: Curve,
    /// Voxels of the foot near the sole, seen from the ankle, across the shank.
    pub(super) foot: Vec<DVec3>,
}

/// The crotch: how far it is from the feet, and where.
pub(super) struct Crotch {
    level: f64,
    place: Option<DVec3>,
}

impl Crotch {
    /// Where the halves of the body, told apart by the nearer foot, meet in a good share of the depth of the pelvis: thighs that
    /// touch, or that the voxels join, meet in less.
    pub(super) fn of(solid: &Solid, body: &Extremities, up: DVec3) -> Self {
        let [f, g] = &body.feet;
        let (h, length) = (solid.pitch, body.length);
        let floor = 0.5 * (solid.centres[f.voxel] + solid.centres[g.voxel]).dot(up);
        let slabs = (PELVIS_HEIGHT * length / h) as usize;
        let mut meeting = vec![Vec::new(); slabs];
        for v in 0..solid.len() {
            let slab = ((solid.centres[v].dot(up) - floor) / h) as usize;
            let level = 0.5 * (f.distance[v] + g.distance[v]);
            if slab < slabs && (f.distance[v] - g.distance[v]).abs() < h && level < PELVIS_LEVEL * length {
                meeting[slab].push(v);
            }
        }
        let none = Self { level: CROTCH * length, place: None };
        let count: Vec<f64> = meeting.windows(3).map(|w| (w[0].len() + w[1].len() + w[2].len()) as f64).collect();
        let least = CROTCH_DEPTH * count.iter().copied().fold(0.0, f64::max);
        let widest = count.iter().position(|n| CROTCH_DEPTH * n >= least).unwrap_or(0);
        let Some(i) = (0..widest).rev().find(|&i| count[i] < least) else { return none };
        let part = (least - count[i]) / (count[i + 1] - count[i]);
        let height = floor + (i as f64 + 1.5 + part) * h;
        let around: Vec<usize> = meeting[i..i + 3].iter().flatten().copied().collect();
        if around.is_empty() {
            return none;
        }
        let mean = around.iter().map(|&v| solid.centres[v]).sum::<DVec3>() / around.len() as f64;
        let level = around.iter().map(|&v| f.distance[v] + g.distance[v]).sum::<f64>() * 0.5 / around.len() as f64;
        if level < CROTCH_RANGE[0] * length || level > CROTCH_RANGE[1] * length {
            return none;
        }
        Self { level, place: Some(mean + up * (height - mean.dot(up))) }
    }
}

impl Leg {
    pub(super) fn of(solid: &Solid, foot: &End, other: &End, crotch: &Crotch, length: f64) -> Option<Self> {
        let curve = Curve::follow(solid, &foot.distance, 0.75 * length, |v| foot.distance[v] <= other.distance[v]);
        let shank = Line::through(&curve.centres(0.20 * length, 0.34 * length))?;
        let near: Vec<DVec3> = (0..solid.len()).filter(|&v| foot.distance[v] < 0.17 * length).map(|v| solid.centres[v]).collect();
        let sole = near.iter().map(|p| shank.along(*p)).fold(f64::INFINITY, f64::min) - 0.5 * solid.pitch;
        let ankle = shank.at(sole + ANKLE * length);
        let across = |p: DVec3| p - ankle - shank.direction * (p - ankle).dot(shank.direction);
        let flat: Vec<DVec3> =
            near.iter().filter(|p| (shank.along(**p) - sole).abs() < 0.045 * length).map(|p| across(*p)).collect();
        let top = (crotch.level - 0.01 * length).min(0.56 * length);
        let thigh = Line::through(&curve.centres(0.42 * length, top)).unwrap_or(shank);
        Some(Self { ankle, toe: solid.centres[foot.voxel], thigh, curve, foot: flat })
    }

    /// Hip: up the thigh from the crotch, half drawn to its usual distance from the middle.
    pub(super) fn hip(&self, crotch: DVec3, up: DVec3, aside: DVec3, length: f64) -> DVec3 {
        let rise = (crotch - self.thigh.centre).dot(up) + HIP_UP * length;
        let hip = self.thigh.at(rise / self.thigh.direction.dot(up).max(0.3));
        let out = (hip - crotch).dot(aside);
        hip + aside * (0.5 * (HIP_ASIDE * length - out))
    }

    pub(super) fn knee(&self, hip: DVec3, crotch: &Crotch, length: f64) -> Option<DVec3> {
        let sections = self.curve.between(0.19 * length, crotch.level - 0.01 * length);
        // Between calf and thigh the leg is narrowest a little above the knee.
        let way = |s: &Section| s.centre.distance(self.ankle) / (s.centre.distance(self.ankle) + s.centre.distance(hip));
        let narrow = sections.windows(3).filter(|w| (way(&w[1]) - KNEE).abs() < 0.10);
        let area = |w: &[Section]| w.iter().map(|s| s.area).sum::<f64>();
        let narrow = narrow.min_by(|v, w| area(v).total_cmp(&area(w))).map_or(KNEE, |w| way(&w[1]) - KNEE_BELOW_NARROW);
        hinge(sections, self.ankle, hip, 0.5 * (KNEE + narrow), 0.12, 0.5)
    }
}

/// The crotch itself, or the place between the legs where it should be.
pub(super) fn crotch_place(crotch: &Crotch, legs: [&Leg; 2], up: DVec3, length: f64) -> Option<DVec3> {
    crotch.place.or_else(|| {
        let level = crotch.level - 0.02 * length;
        Some((legs[0].curve.at(level)? + legs[1].curve.at(level)?) * 0.5 + up * (0.03 * length))
    })
}

/// An arm from the finger tips to the shoulder.
pub(super) struct Arm {
    pub(super) tip: DVec3,
    pub(super) wrist: DVec3,
    pub(super) elbow: DVec3,
    pub(super) shoulder: DVec3,
}

impl Arm {
    pub(super) fn of(solid: &Solid, hand: &End, length: f64) -> Option<Self> {
        let curve = Curve::follow(solid, &hand.distance, 0.62 * length, |_| true);
        let narrowest = curve.narrowest(0.085 * length, 0.20 * length)?;
        let armpit = armpit(&curve, length);
        let upper = Line::through(&curve.centres(armpit - 0.13 * length, armpit - 0.01 * length))?;
        let shoulder = upper.at(upper.along(curve.at(armpit - 0.01 * length)?) + SHOULDER * length);
        let wrist = narrowest.centre;
        let sections = curve.between(narrowest.level, armpit - 0.005 * length);
        let elbow = hinge(sections, wrist, shoulder, ELBOW, 0.14, 0.6)?;
        Some(Self { tip: solid.centres[hand.voxel], wrist, elbow, shoulder })
    }
}

/// Where the arm opens into the trunk.
fn armpit(curve: &Curve, length: f64) -> f64 {
    let mut areas: Vec<f64> = curve.between(0.26 * length, 0.34 * length).iter().map(|s| s.area).collect();
    areas.sort_by(f64::total_cmp);
    let usual = areas.get(areas.len() / 2).copied().unwrap_or(f64::INFINITY);
    let open = curve.between(0.30 * length, 0.62 * length).iter().find(|s| s.area > 1.6 * usual);
    open.map_or(0.40 * length, |s| s.level)
}

/// Neck and head joints, from the crown down.
pub(super) fn neck_and_head(solid: &Solid, head: &End, length: f64) -> Option<[DVec3; 2]> {
    let curve = Curve::follow(solid, &head.distance, 0.36 * length, |_| true);
    let level = curve.narrowest(0.10 * length, 0.22 * length)?.level;
    Some([curve.at(level + 0.010 * length)?, curve.at(level - 0.035 * length)?])
}

/// The joint between two ends of a limb: at its usual share of the way, drawn by `pull` to a clear bend when that is within `reach`.
pub(super) fn hinge(sections: &[Section], low: DVec3, high: DVec3, share: f64, reach: f64, pull: f64) -> Option<DVec3> {
    let way = |p: DVec3| p.distance(low) / (p.distance(low) + p.distance(high));
    let usual = sections.iter().map(|s| s.centre).min_by(|p, q| {
        let off = |p: DVec3| (way(p) - share).abs();
        off(*p).total_cmp(&off(*q))
    })?;
    match sharpest_bend(sections) {
        Some((place, degrees)) if degrees > CLEAR_BEND && (way(place) - share).abs() < reach => Some(usual.lerp(place, pull)),
        _ => Some(usual),
    }
}

/// Where two straight lines fit a curve best, and the angle between them in degrees.
fn sharpest_bend(sections: &[Section]) -> Option<(DVec3, f64)> {
    let points: Vec<DVec3> = sections.iter().map(|s| s.centre).collect();
    let fits = (4..points.len().saturating_sub(4)).filter_map(|i| {
        let (a, b) = (Line::through(&points[..=i])?, Line::through(&points[i..])?);
        let error: f64 = points[..=i].iter().map(|p| a.distance_squared(*p)).sum::<f64>()
            + points[i..].iter().map(|p| b.distance_squared(*p)).sum::<f64>();
        Some((error, points[i], a.direction.dot(b.direction).clamp(-1.0, 1.0).acos().to_degrees()))
    });
    fits.min_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, place, degrees)| (place, degrees))
}
