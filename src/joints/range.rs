//! How far a joint goes before its parts run into each other, and what remains of it then (Xu et al. 2009, §3.5).

use super::part::Part;
use super::{Joint, Kind};
use crate::spatial::PointTree;
use crate::statistics::middle;
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// Parts may run into each other by this much more than at rest, in diagonals of the model …
const TOLERANCE: f64 = 0.002;
/// … and by this much of the roughness of their contact, of which the highest bumps meet, but by no more than this in all.
const BUMPS: f64 = 6.0;
const ROUGHEST: f64 = 0.012;
/// Distance of the points that are tried, besides the vertices.
const SPACING: f64 = 0.02;
/// Steps of the search.
const TURN: f64 = 8.0 * PI / 180.0;
const SLIDE: f64 = 0.04;
/// Slides are tried this far.
const FARTHEST: f64 = 0.6;
const HALVINGS: u32 = 8;
/// Share of the contact that has to stay in touch while sliding.
const TOUCHING: f64 = 0.25;
/// Smaller ranges are play, not motion.
const LEAST_TURN: f64 = 2.0 * PI / 180.0;
const LEAST_SLIDE: f64 = 0.02;

/// Finds the limits of a joint of closed parts; motions without any range are dropped and change its kind. `reach`: within which parts touch.
pub fn limit(joint: &mut Joint, parts: &[Part], size: f64, reach: f64) {
    let (a, b) = (&parts[joint.a], &parts[joint.b]);
    if joint.kind == Kind::Fixed || !a.is_closed() || !b.is_closed() {
        return;
    }
    let trial = Trial::new(joint, a, b, size, reach);
    let [x, y, z] = [joint.frame.x_axis, joint.frame.y_axis, joint.frame.z_axis];
    let moves = |range: (f64, f64), least: f64| range.1 - range.0 >= least;
    let slides = |range: (f64, f64)| moves(range, LEAST_SLIDE * size);
    let turns = |range: (f64, f64)| moves(range, LEAST_TURN);
    let bound = |range: (f64, f64), most: f64| (range.0 > -most || range.1 < most).then_some(range);
    let farthest = FARTHEST * size * 0.999;
    match joint.kind {
        Kind::Revolute | Kind::Cylinder => {
            let angle = trial.turn(x);
            let slide = if joint.kind == Kind::Cylinder { trial.slide(x) } else { (0.0, 0.0) };
            joint.kind = match (turns(angle), slides(slide)) {
                (true, true) => Kind::Cylinder,
                (true, false) => Kind::Revolute,
                (false, true) => Kind::Prismatic,
                (false, false) => Kind::Fixed,
            };
            joint.angle = bound(angle, PI * 0.999).filter(|_| turns(angle));
            joint.slide = bound(slide, farthest).filter(|_| slides(slide));
        }
        Kind::Prismatic => {
            let slide = trial.slide(x);
            joint.slide = bound(slide, farthest).filter(|_| slides(slide));
            joint.kind = if slides(slide) { Kind::Prismatic } else { Kind::Fixed };
        }
        Kind::Plane => {
            let along = [trial.slide(x), trial.slide(y)];
            match [slides(along[0]), slides(along[1])] {
                [true, true] => {}
                [false, false] => {
                    let angle = trial.turn(z);
                    joint.turn_about(z, if turns(angle) { Kind::Revolute } else { Kind::Fixed });
                    joint.angle = bound(angle, PI * 0.999).filter(|_| turns(angle));
                }
                [first, _] => {
                    joint.turn_about(if first { x } else { y }, Kind::Prismatic);
                    joint.slide = bound(along[usize::from(!first)], farthest);
                }
            }
        }
        Kind::Ball => {
            let ranges = [x, y, z].map(|axis| trial.turn(axis));
            let free: Vec<usize> = (0..3).filter(|&k| turns(ranges[k])).collect();
            match free[..] {
                [] => joint.kind = Kind::Fixed,
                [only] => {
                    joint.turn_about([x, y, z][only], Kind::Revolute);
                    joint.angle = bound(ranges[only], PI * 0.999);
                }
                _ => {
                    // The stem turns farthest about itself; across it, the least is the cone.
                    let width = |k: &usize| ranges[*k].1 - ranges[*k].0;
                    let stem = (0..3).max_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or(0);
                    let across = (0..3).filter(|&k| k != stem).map(|k| (-ranges[k].0).min(ranges[k].1));
                    let cone = across.fold(PI, f64::min);
                    joint.turn_about([x, y, z][stem], Kind::Ball);
                    joint.cone = (cone < PI * 0.999).then_some(cone);
                }
            }
        }
        Kind::Fixed => {}
    }
}

impl Joint {
    /// Makes `axis`, one of the frame's own, its X.
    fn turn_about(&mut self, axis: DVec3, kind: Kind) {
        let f = self.frame;
        let other = if axis == f.z_axis { f.x_axis } else { f.z_axis };
        self.frame = super::frame(axis, other, true);
        self.kind = kind;
    }
}

/// Two parts and the points that are tried.
struct Trial<'a> {
    a: &'a Part,
    b: &'a Part,
    of_a: Vec<DVec3>,
    of_b: Vec<DVec3>,
    centre: DVec3,
    /// The contact on `b`, and the surface of `a`.
    contact: Vec<DVec3>,
    surface: PointTree,
    size: f64,
    reach: f64,
    /// By how much more they may be in each other than at rest.
    tolerance: f64,
    /// How deep they are in each other at rest, and how much of the contact touches.
    depth: f64,
    touching: f64,
}

impl<'a> Trial<'a> {
    fn new(joint: &Joint, a: &'a Part, b: &'a Part, size: f64, reach: f64) -> Self {
        let points = |part: &Part| {
            let (lo, hi) = part.bounds;
            let mut points = part.samples(lo, hi, 1, SPACING * size).points;
            points.extend_from_slice(&part.points);
            points
        };
        let (of_a, of_b) = (points(a), points(b));
        let contact = &joint.contact;
        let mut surface = of_a.clone();
        surface.extend_from_slice(&contact.surface.points[..contact.of_first]);
        let mut trial = Self {
            a,
            b,
            of_a,
            of_b,
            centre: joint.centre,
            contact: contact.surface.points[contact.of_first..].iter().copied().step_by(8).collect(),
            surface: PointTree::new(&surface),
            size,
            reach,
            tolerance: (BUMPS * roughness(joint, a, b)).clamp(TOLERANCE * size, ROUGHEST * size),
            depth: 0.0,
            touching: 1.0,
        };
        trial.depth = trial.deepest(&|p| p, &|p| p).max(0.0);
        trial.touching = trial.share_touching(&|p| p);
        trial
    }

    /// How deep the parts are in each other with `b` moved.
    fn deepest(&self, there: &dyn Fn(DVec3) -> DVec3, back: &dyn Fn(DVec3) -> DVec3) -> f64 {
        let most = self.depth + self.tolerance;
        let mut deepest = f64::NEG_INFINITY;
        let in_a = self.of_b.iter().map(|&p| self.a.depth(there(p)));
        for depth in in_a.chain(self.of_a.iter().map(|&p| self.b.depth(back(p)))) {
            deepest = deepest.max(depth);
            if self.depth > 0.0 && deepest > most {
                break;
            }
        }
        deepest
    }

    fn share_touching(&self, there: &dyn Fn(DVec3) -> DVec3) -> f64 {
        let mut found = Vec::new();
        let mut touches = |p: DVec3| {
            self.surface.nearest(p, 1, &mut found);
            found.first().is_some_and(|n| n.distance <= self.reach + SPACING * self.size)
        };
        let count = self.contact.iter().filter(|&&p| touches(there(p))).count();
        if self.contact.is_empty() { 1.0 } else { count as f64 / self.contact.len() as f64 }
    }

    fn turn(&self, axis: DVec3) -> (f64, f64) {
        let about = |p: DVec3, angle: f64| self.centre + DMat3::from_axis_angle(axis, angle) * (p - self.centre);
        let fits = |x: f64| self.fits(&|p| about(p, x), &|p| about(p, -x));
        (-farthest(TURN, PI, |x| fits(-x)), farthest(TURN, PI, fits))
    }

    fn slide(&self, axis: DVec3) -> (f64, f64) {
        let fits = |x: f64| {
            let there = |p: DVec3| p + axis * x;
            self.share_touching(&there) >= TOUCHING * self.touching && self.fits(&there, &|p| p - axis * x)
        };
        // A stop that is met head-on is passed by the tolerance.
        let most = FARTHEST * self.size;
        let reached = |x: f64| if x >= most { x } else { (x - self.tolerance).max(0.0) };
        (-reached(farthest(SLIDE * self.size, most, |x| fits(-x))), reached(farthest(SLIDE * self.size, most, fits)))
    }

    fn fits(&self, there: &dyn Fn(DVec3) -> DVec3, back: &dyn Fn(DVec3) -> DVec3) -> bool {
        self.deepest(there, back) <= self.depth + self.tolerance
    }
}

/// How rough a contact is for the motions of its joint: how far it goes up or down along them within a triangle. A surface that slips is level along them,
/// coarse or curved as it may be; noise of its vertices is not.
fn roughness(joint: &Joint, a: &Part, b: &Part) -> f64 {
    let [x, y, z] = [joint.frame.x_axis, joint.frame.y_axis, joint.frame.z_axis];
    let (turns, slides): (&[DVec3], &[DVec3]) = match joint.kind {
        Kind::Revolute => (&[x], &[]),
        Kind::Cylinder => (&[x], &[x]),
        Kind::Prismatic => (&[], &[x]),
        Kind::Plane => (&[], &[x, y]),
        Kind::Ball => (&[x, y, z], &[]),
        Kind::Fixed => (&[], &[]),
    };
    let contact = &joint.contact;
    let mut heights = Vec::new();
    for (k, (p, n, _)) in contact.surface.iter().enumerate() {
        let part = if k < contact.of_first { a } else { b };
        let Some(near) = part.tree.closest(p) else { continue };
        let corners = part.triangles[near.triangle].map(|v| part.points[v as usize]);
        let ways = turns.iter().map(|axis| axis.cross(p - joint.centre)).chain(slides.iter().copied());
        heights.extend(ways.filter_map(DVec3::try_normalize).map(|way| {
            let along = corners.map(|c| c.dot(way));
            let length = along.into_iter().fold(f64::NEG_INFINITY, f64::max) - along.into_iter().fold(f64::INFINITY, f64::min);
            (n.dot(way) * length).abs()
        }));
    }
    // The middle one: chamfers and rims in the contact are no noise.
    middle(&mut heights).unwrap_or(0.0)
}

/// The largest value up to `most` that is reached by steps that fit.
fn farthest(step: f64, most: f64, fits: impl Fn(f64) -> bool) -> f64 {
    let mut x = 0.0;
    while x < most {
        let next = (x + step).min(most);
        if !fits(next) {
            let (mut good, mut bad) = (x, next);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (good + bad);
                if fits(middle) { good = middle } else { bad = middle }
            }
            return good;
        }
        x = next;
    }
    most
}
