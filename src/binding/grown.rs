//! Limbs that have grown together with what they touch: arms with the trunk, thigh with thigh, as photogrammetry melts them.
//!
//! There is no skin between such parts, so nothing can tell them apart by ways along the surface (that is the proxy's own parting of parts
//! that touch). The joints do: a seam is drawn on the skin where a limb's round ends, the faces on it are left out, and each side of the cut is
//! closed over the scan's own vertices.

mod seam;
mod sides;

use super::landmarks::{Arms, Body};
use crate::scan::Faces;
use glam::DVec3;
use seam::Mesh;
use sides::{Arm, Legs, Side};

// Lengths are shares of stature.

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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::landmarks::Joint;
    use crate::binding::tests::{Person, person};
    use crate::scan::UnitBox;
    use std::collections::BTreeMap;
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
