//! Limbs that have grown together with what they touch: arms with the trunk, thigh with thigh, as photogrammetry melts them.
//!
//! There is no skin between such parts, so nothing can tell them apart by ways along the surface (that is the proxy's own parting of parts
//! that touch). The joints do: a seam is drawn on the skin where a limb's round ends, the faces on it are left out, and each side of the cut is
//! closed over the scan's own vertices.

use super::landmarks::{Arms, Body, Joint};
use crate::scan::Faces;
use glam::DVec3;
use std::collections::{BTreeMap, VecDeque};

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
/// Rounds in which rims and arms are smoothed while they are apart: a seam follows the faces in steps, and thin arms with ragged rims are lost
/// when the proxy's surface is simplified (a left forearm 45 mm thick was).
const SMOOTHING: usize = 5;
/// Seams that reach less far down are creases.
const LEAST: f64 = 0.04;
/// How far the parts are held apart while the proxy is made, per way down from where they part: arms and legs.
const SWING: [f64; 2] = [0.25, 0.12];

/// Cuts between limbs and what they have grown together with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cuts {
    /// Whether each face stays.
    pub keep: Vec<bool>,
    /// What closes the cuts, over the same vertices.
    pub added: Vec<[u32; 3]>,
    /// How far each vertex moves for the parts to be apart, with smooth rims.
    pub shift: Vec<DVec3>,
    /// What was cut off, in words.
    pub limbs: Vec<&'static str>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    /// Above where the two part, or on another limb.
    Neither,
    Limb,
    Rest,
}

/// Finds and cuts what has grown together; `None` where nothing has.
///
/// Shapes: `points`: the scan's vertices, in the space of `body`; `faces` over them. Only bodies whose arms hang along the trunk are looked at.
/// An arm that has grown on over a part of its length, with skin of its own along the rest, is left as it is.
pub fn cut(body: &Body, points: &[DVec3], faces: &Faces) -> Option<Cuts> {
    if body.arms != Arms::Hanging {
        return None;
    }
    let mut mesh = Mesh::new(points, faces);
    let mut shift = vec![DVec3::ZERO; points.len()];
    let mut limbs = Vec::new();
    let mut arms = vec![false; points.len()];
    for (side, name) in [(0, "left arm"), (1, "right arm")] {
        let Some(arm) = Arm::new(body, side, points) else { continue };
        // An arm that was cut off hangs together with nothing.
        let side = |(&p, cut): (&DVec3, &bool)| if *cut { Side::Neither } else { arm.side(p) };
        let mut sides: Vec<Side> = points.iter().zip(&arms).map(side).collect();
        mesh.tidy(&mut sides);
        if !arm.has_grown_on(points, &sides) || !mesh.part(&sides, body.up, LEAST * body.stature) {
            continue;
        }
        for v in (0..points.len()).filter(|&v| sides[v] == Side::Limb) {
            arms[v] = true;
            shift[v] = arm.outwards * (SWING[0] * (arm.armpit - points[v].dot(body.up)).max(0.0));
        }
        limbs.push(name);
    }
    // A skirt or a coat closes the gap between the legs as well: only a scan that has melted elsewhere is taken to have melted there.
    if limbs.is_empty() {
        return None;
    }
    let legs = Legs::new(body);
    let mut sides: Vec<Side> =
        points.iter().zip(&arms).map(|(&p, arm)| if *arm { Side::Neither } else { legs.side(p) }).collect();
    mesh.tidy(&mut sides);
    if mesh.part(&sides, body.up, LEAST * body.stature) {
        // The feet go with their legs.
        mesh.spread(&mut sides, |v| points[v].dot(body.up) < legs.crotch && !arms[v]);
        for v in (0..points.len()).filter(|&v| sides[v] != Side::Neither) {
            let away = if sides[v] == Side::Limb { legs.left } else { -legs.left };
            shift[v] = away * (SWING[1] * (legs.crotch - points[v].dot(body.up)).max(0.0));
        }
        limbs.push("legs");
    }
    let moving: Vec<bool> = arms.iter().zip(&mesh.rims).map(|(arm, rim)| *arm || *rim).collect();
    mesh.smooth(&moving, &mut shift);
    Some(Cuts { keep: mesh.keep, added: mesh.added, shift, limbs })
}

/// An arm along the trunk.
struct Arm {
    bones: [DVec3; 4],
    up: DVec3,
    outwards: DVec3,
    forward: DVec3,
    stature: f64,
    /// Distance of the outer skin from the bones, by station.
    radius: Vec<f64>,
    /// Height of the armpit along `up`.
    armpit: f64,
}

impl Arm {
    fn new(body: &Body, side: usize, points: &[DVec3]) -> Option<Self> {
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

    fn side(&self, p: DVec3) -> Side {
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
    fn has_grown_on(&self, points: &[DVec3], sides: &[Side]) -> bool {
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
struct Seen {
    station: f64,
    distance: f64,
    out: f64,
    front: f64,
}

struct Legs {
    hips: DVec3,
    knees: DVec3,
    left: DVec3,
    up: DVec3,
    crotch: f64,
    /// Height of the lower ankle.
    ankles: f64,
}

impl Legs {
    fn new(body: &Body) -> Self {
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

    fn side(&self, p: DVec3) -> Side {
        let height = p.dot(self.up);
        if height > self.crotch || height < self.ankles {
            return Side::Neither;
        }
        let down = self.knees - self.hips;
        let middle = self.hips + down * ((height - self.hips.dot(self.up)) / down.dot(self.up));
        if (p - middle).dot(self.left) > 0.0 { Side::Limb } else { Side::Rest }
    }
}

/// The surface that is cut. Vertices in the same place are one.
struct Mesh<'a> {
    points: &'a [DVec3],
    faces: &'a Faces,
    place: Vec<u32>,
    keep: Vec<bool>,
    added: Vec<[u32; 3]>,
    /// Vertices at the cuts.
    rims: Vec<bool>,
}

impl<'a> Mesh<'a> {
    fn new(points: &'a [DVec3], faces: &'a Faces) -> Self {
        let mut first = BTreeMap::new();
        let key = |p: &DVec3| p.to_array().map(|x| (x + 0.0).to_bits());
        let place = (0u32..).zip(points).map(|(v, p)| *first.entry(key(p)).or_insert(v)).collect();
        Self { points, faces, place, keep: vec![true; faces.len()], added: Vec::new(), rims: vec![false; points.len()] }
    }

    fn corners(&self) -> impl Iterator<Item = (usize, &'a [u32])> {
        let kept = self.faces.iter().enumerate();
        kept.filter(|(f, _)| self.keep[*f])
    }

    /// What does not hang together with the most of its side goes to the other.
    fn tidy(&self, sides: &mut [Side]) {
        for (own, other) in [(Side::Limb, Side::Rest), (Side::Rest, Side::Limb)] {
            let mut parent: Vec<u32> = self.place.clone();
            fn root(parent: &mut [u32], mut v: u32) -> u32 {
                while parent[v as usize] != v {
                    parent[v as usize] = parent[parent[v as usize] as usize];
                    v = parent[v as usize];
                }
                v
            }
            for (_, face) in self.corners() {
                for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                    if sides[a as usize] == own && sides[b as usize] == own {
                        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                        parent[a.max(b) as usize] = a.min(b);
                    }
                }
            }
            let mut sizes = vec![0u32; sides.len()];
            let roots: Vec<u32> = (0..sides.len() as u32).map(|v| root(&mut parent, v)).collect();
            (0..sides.len()).filter(|&v| sides[v] == own).for_each(|v| sizes[roots[v] as usize] += 1);
            let most = (0..sides.len()).max_by_key(|&v| (sizes[v], std::cmp::Reverse(v)));
            for (side, &root) in sides.iter_mut().zip(&roots) {
                if *side == own && Some(root as usize) != most {
                    *side = other;
                }
            }
        }
    }

    /// Cuts along the seam between the sides and closes both; whether there is one, all in one piece from front to back. Nothing is changed
    /// otherwise. `least`: how far down along `up` it has to reach.
    fn part(&mut self, sides: &[Side], up: DVec3, least: f64) -> bool {
        let across = |face: &[u32]| {
            let has = |side: Side| face.iter().any(|&v| sides[v as usize] == side);
            has(Side::Limb) && has(Side::Rest)
        };
        let seam: Vec<usize> = self.corners().filter(|(_, face)| across(face)).map(|(f, _)| f).collect();
        if seam.is_empty() {
            return false;
        }
        let mut at_seam = vec![false; sides.len()];
        for &f in &seam {
            self.keep[f] = false;
            self.faces
                .face(f)
                .iter()
                .filter(|&&v| sides[v as usize] != Side::Neither)
                .for_each(|&v| at_seam[self.place[v as usize] as usize] = true);
        }
        let before = self.added.len();
        let (mut rims, mut parted) = (0, 0);
        for rim in self.holes().into_iter().filter(|rim| rim.iter().any(|&v| at_seam[v as usize])) {
            let heights = rim.iter().map(|&v| self.points[v as usize].dot(up));
            let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(h), b.max(h)));
            // Specks stay holes.
            if high - low < least {
                continue;
            }
            rims += 1;
            if let Some([limb, rest]) = halves(&rim, sides) {
                self.close(&limb);
                self.close(&rest);
                parted += 1;
            }
        }
        if (parted, rims) == (1, 1) {
            self.rims.iter_mut().enumerate().for_each(|(v, rim)| *rim |= at_seam[self.place[v] as usize]);
            return true;
        }
        self.added.truncate(before);
        seam.iter().for_each(|&f| self.keep[f] = true);
        false
    }

    /// Edges of what stays, both ways, in their order.
    fn edges(&self) -> Vec<(u32, u32)> {
        let mut edges: Vec<(u32, u32)> = Vec::new();
        for face in self.corners().map(|(_, face)| face).chain(self.added.iter().map(|t| &t[..])) {
            for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                let (a, b) = (self.place[a as usize], self.place[b as usize]);
                edges.extend([(a, b), (b, a)]);
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Gives the side of their neighbours to those of neither side that pass, the nearest first.
    fn spread(&self, sides: &mut [Side], passes: impl Fn(usize) -> bool) {
        let edges = self.edges();
        let mut open: VecDeque<u32> = (0..sides.len() as u32).filter(|&v| sides[v as usize] != Side::Neither).collect();
        while let Some(v) = open.pop_front() {
            let first = edges.partition_point(|e| e.0 < v);
            for &(_, w) in edges[first..].iter().take_while(|e| e.0 == v) {
                if sides[w as usize] == Side::Neither && passes(w as usize) {
                    sides[w as usize] = sides[v as usize];
                    open.push_back(w);
                }
            }
        }
        (0..sides.len()).for_each(|v| sides[v] = sides[self.place[v] as usize]);
    }

    /// Moves some vertices half way to the mean of their neighbours, again and again.
    fn smooth(&self, moving: &[bool], shift: &mut [DVec3]) {
        let edges = self.edges();
        let around: Vec<&[(u32, u32)]> =
            edges.chunk_by(|a, b| a.0 == b.0).filter(|around| moving[around[0].0 as usize]).collect();
        for _ in 0..SMOOTHING {
            let at = |v: u32| self.points[v as usize] + shift[v as usize];
            let mean = |around: &&[(u32, u32)]| around.iter().map(|e| at(e.1)).sum::<DVec3>() / around.len() as f64;
            let halves: Vec<DVec3> = around.iter().map(|around| (mean(around) - at(around[0].0)) * 0.5).collect();
            around.iter().zip(halves).for_each(|(around, half)| shift[around[0].0 as usize] += half);
        }
        (0..shift.len()).for_each(|v| shift[v] = shift[self.place[v] as usize]);
    }

    /// Rims of the holes, each in the order that faces which close it have.
    fn holes(&self) -> Vec<Vec<u32>> {
        let mut sides: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        let kept = self.corners().map(|(_, face)| face);
        for face in kept.chain(self.added.iter().map(|t| &t[..])) {
            for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                let (a, b) = (self.place[a as usize], self.place[b as usize]);
                *sides.entry((a, b)).or_default() += 1;
                *sides.entry((b, a)).or_default() -= 1;
            }
        }
        let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        sides.iter().filter(|side| *side.1 > 0).for_each(|(&(a, b), _)| next.entry(b).or_default().push(a));
        let mut rims = Vec::new();
        while let Some((&start, _)) = next.first_key_value() {
            let mut rim = vec![start];
            loop {
                let last = rim[rim.len() - 1];
                let Some(to) = next.get_mut(&last).and_then(Vec::pop) else { break };
                if next[&last].is_empty() {
                    next.remove(&last);
                }
                if to == start {
                    break;
                }
                rim.push(to);
            }
            rims.push(rim);
        }
        rims
    }

    /// Closes a rim whose ends are the front and the back of where the parts meet: from there on by the shorter of the two next edges.
    fn close(&mut self, rim: &[u32]) {
        let (mut i, mut j) = (0, rim.len() - 1);
        let length = |a: usize, b: usize| self.points[rim[a] as usize].distance_squared(self.points[rim[b] as usize]);
        while j - i > 1 {
            if length(i + 1, j) <= length(i, j - 1) {
                self.added.push([rim[i], rim[i + 1], rim[j]]);
                i += 1;
            } else {
                self.added.push([rim[i], rim[j - 1], rim[j]]);
                j -= 1;
            }
        }
    }
}

/// The rim of each side, from one place where they meet to the other; `None` unless there are two such places.
fn halves(rim: &[u32], sides: &[Side]) -> Option<[Vec<u32>; 2]> {
    let at = |i: usize| sides[rim[i % rim.len()] as usize];
    let mut first = None;
    let mut runs = 0;
    let mut before = (0..rim.len()).rev().map(at).find(|s| *s != Side::Neither)?;
    for i in 0..rim.len() {
        let own = at(i);
        if own != Side::Neither && own != before {
            runs += 1;
            if own == Side::Limb {
                first = Some(i);
            }
            before = own;
        }
    }
    let first = first.filter(|_| runs == 2)?;
    let turned: Vec<u32> = (0..rim.len()).map(|i| rim[(first + i) % rim.len()]).collect();
    let is = |side: Side| move |v: &u32| sides[*v as usize] == side;
    let (last_limb, rest) = (turned.iter().rposition(is(Side::Limb))?, turned.iter().position(is(Side::Rest))?);
    let last_rest = turned.iter().rposition(is(Side::Rest))?;
    // Where no vertex lies between the sides, the last of one is the place.
    let middle = |from: usize, to: usize| if to > from + 1 { from.midpoint(to) } else { from };
    let (one, other) = (middle(last_limb, rest), middle(last_rest, turned.len()));
    let limb = turned[other..].iter().chain(&turned[..=one]).copied().collect();
    Some([limb, turned[one..=other].to_vec()])
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::tests::{Person, person};
    use crate::scan::UnitBox;
    use std::f64::consts::FRAC_PI_2;

    const COLUMNS: usize = 60;
    const STEP: f64 = 0.02;

    /// A person in one skin from the knees to the neck: arms of radius 0.045 m beside a trunk that reaches into them, no gap between the legs.
    fn melted() -> (Body, UnitBox, Vec<DVec3>, Faces) {
        let Person { mut body, unit_box, .. } = person(FRAC_PI_2);
        body.arms = Arms::Hanging;
        let (mut points, mut faces) = (Vec::new(), Faces::default());
        let rows = 51;
        for row in 0..rows {
            let y = 0.5 + STEP * row as f64;
            let arms = (0.69..1.4).contains(&y);
            let round = |x: f64, c: f64, a: f64, b: f64| b * (1.0 - ((x - c) / a).powi(2)).max(0.0).sqrt();
            let depth = |x: f64| {
                let arm = if arms { round(x.abs(), 0.18, 0.045, 0.045) } else { 0.0 };
                round(x, 0.0, 0.15, 0.11).max(arm)
            };
            let width = if arms { 0.225 } else { 0.15 };
            for k in 0..2 * COLUMNS {
                // Once around, from the left end over the front to the right end.
                let x = width * (std::f64::consts::PI * k as f64 / COLUMNS as f64).cos();
                points.push(DVec3::new(x, y, depth(x) * if k < COLUMNS { 1.0 } else { -1.0 }));
            }
        }
        let at = |row: usize, k: usize| (row * 2 * COLUMNS + k % (2 * COLUMNS)) as u32;
        for row in 0..rows - 1 {
            (0..2 * COLUMNS).for_each(|k| faces.push([at(row, k), at(row + 1, k), at(row + 1, k + 1), at(row, k + 1)]));
        }
        for (row, centre) in [(0, 0.5), (rows - 1, 0.5 + STEP * (rows - 1) as f64)] {
            let middle = points.len() as u32;
            points.push(DVec3::new(0.0, centre, 0.0));
            for k in 0..2 * COLUMNS {
                let (a, b) = (at(row, k), at(row, k + 1));
                faces.push(if row == 0 { [middle, a, b] } else { [middle, b, a] });
            }
        }
        let points = points.into_iter().map(|p| unit_box.enter(p)).collect();
        (body, unit_box, points, faces)
    }

    /// Whether faces below a height join two vertices.
    fn joined(points: &[DVec3], faces: &[Vec<u32>], below: f64, (a, b): (usize, usize)) -> bool {
        let mut reached = vec![false; points.len()];
        reached[a] = true;
        loop {
            let before = reached.iter().filter(|r| **r).count();
            for face in faces.iter().filter(|f| f.iter().all(|&v| points[v as usize].y < below)) {
                if face.iter().any(|&v| reached[v as usize]) {
                    face.iter().for_each(|&v| reached[v as usize] = true);
                }
            }
            if reached.iter().filter(|r| **r).count() == before {
                return reached[b];
            }
        }
    }

    #[test]
    fn limbs_that_have_melted_into_one_skin_are_cut_apart_and_closed() {
        let (body, unit_box, points, faces) = melted();
        let cuts = cut(&body, &points, &faces).unwrap();
        assert_eq!(cuts.limbs, ["left arm", "right arm", "legs"]);
        let kept = faces.iter().zip(&cuts.keep).filter(|(_, keep)| **keep).map(|(face, _)| face.to_vec());
        let all: Vec<Vec<u32>> = kept.chain(cuts.added.iter().map(|t| t.to_vec())).collect();
        let mut sides = BTreeMap::new();
        for face in &all {
            for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                *sides.entry((a.min(b), a.max(b))).or_insert(0) += if a < b { 1 } else { -1 };
            }
        }
        assert!(sides.values().all(|&n| n == 0), "open or turned over");
        let nearest = |p: DVec3| {
            let p = unit_box.enter(p);
            (0..points.len()).min_by(|&a, &b| points[a].distance(p).total_cmp(&points[b].distance(p))).unwrap()
        };
        let whole: Vec<Vec<u32>> = faces.iter().map(<[u32]>::to_vec).collect();
        let (arm, belly) = (nearest(DVec3::new(0.225, 1.0, 0.0)), nearest(DVec3::new(0.0, 1.0, 0.11)));
        let level = |y: f64| unit_box.enter(DVec3::Y * y).y;
        assert!(joined(&points, &whole, level(1.28), (arm, belly)) && !joined(&points, &all, level(1.28), (arm, belly)));
        let legs = (nearest(DVec3::new(0.1, 0.6, 0.1)), nearest(DVec3::new(-0.1, 0.6, 0.1)));
        assert!(joined(&points, &whole, level(0.85), legs) && !joined(&points, &all, level(0.85), legs));
        // Apart, each to its own side.
        assert!(cuts.shift[arm].x > 0.0 && cuts.shift[belly] == DVec3::ZERO);
        assert!(cuts.shift[legs.0].x > 0.0 && cuts.shift[legs.1].x < 0.0);
        assert_eq!(cuts.shift[nearest(DVec3::new(0.225, 1.38, 0.0))], DVec3::ZERO);
    }

    #[test]
    fn what_hangs_on_a_side_goes_with_it() {
        use Side::{Limb, Neither, Rest};
        // Two strips; the last vertex of each may not pass.
        let points: Vec<DVec3> = (0..10).map(|v| DVec3::new(f64::from(v % 5), f64::from(v / 5), 0.0)).collect();
        let mut faces = Faces::default();
        for strip in [0, 5] {
            (strip..strip + 3).for_each(|v| faces.push([v, v + 1, v + 2]));
        }
        let mut sides = [Limb, Neither, Neither, Neither, Neither, Rest, Rest, Neither, Neither, Neither];
        Mesh::new(&points, &faces).spread(&mut sides, |v| v % 5 != 4);
        assert!(sides == [Limb, Limb, Limb, Limb, Neither, Rest, Rest, Rest, Rest, Neither]);
    }

    #[test]
    fn bodies_with_arms_apart_and_arms_with_a_skin_of_their_own_stay_whole() {
        let (mut body, _, points, faces) = melted();
        body.arms = Arms::Apart;
        assert_eq!(cut(&body, &points, &faces), None);
        // The same arms as tubes beside the trunk.
        let person = person(FRAC_PI_2);
        let body = Body { arms: Arms::Hanging, ..person.body };
        let (mut points, mut faces) = (Vec::new(), Faces::default());
        let (joint, unit) = (|j: Joint| body.joints[j as usize], 1.0 / person.unit_box.diagonal);
        for [from, to, ..] in [[Joint::LeftShoulder, Joint::LeftHandTip], [Joint::MidHip, Joint::Neck]] {
            // The bones lie to the outside of the arm's middle: its inner skin is as far off as the trunk's.
            let (radius, aside) = if from == Joint::MidHip { (0.14 * unit, 0.0) } else { (0.05 * unit, 0.02 * unit) };
            let first = points.len() as u32;
            for ring in 0..=20 {
                let middle = joint(from).lerp(joint(to), f64::from(ring) / 20.0);
                let around = (0..16).map(|k| (std::f64::consts::TAU * f64::from(k) / 16.0).sin_cos());
                points.extend(around.map(|(s, c)| middle + DVec3::new(s * radius - aside, 0.0, c * radius)));
            }
            for ring in 0..20 {
                let at = |ring: u32, k: u32| first + 16 * ring + k % 16;
                (0..16).for_each(|k| faces.push([at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)]));
            }
        }
        // Below the armpit the skin of both hangs together.
        let at = |tube: u32, ring: u32, k: u32| 16 * (21 * tube + ring) + k;
        faces.push([at(0, 4, 12), at(0, 5, 12), at(1, 13, 4)]);
        let arms = cut(&body, &points, &faces).is_some_and(|cuts| cuts.limbs.contains(&"left arm"));
        assert!(!arms);
    }
}
