//! A person in a thing made of parts: which part is the pelvis, and where hips, knees and wrists are, told by how the joints hang together.

use super::machine::Machine;
use crate::deform::joints::Side;
use glam::{DQuat, DVec3};

/// A joint of a body at rest: the part that it is bound to, and the place, in the unit box.
pub type Spot = (usize, DVec3);

/// The joints of a body of parts; left before right.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Robot {
    pub up: DVec3,
    pub forward: DVec3,
    /// Whether names of its parts told left from right, and so which way it faces.
    pub is_named: bool,
    pub pelvis: Spot,
    pub chest: usize,
    pub neck: Option<Spot>,
    /// The top of the head.
    pub crown: Option<Spot>,
    /// Shoulder, elbow, wrist.
    pub arms: [[Spot; 3]; 2],
    /// Hip, knee, ankle.
    pub legs: [[Spot; 3]; 2],
    pub toes: [Spot; 2],
    /// Height of the lowest point.
    pub floor: f64,
}

/// Joints this near to the end of a limb, in its length, belong to the joint at its end, as a hip has three axes.
const CLUSTER: f64 = 0.2;
/// How much farther feet reach ahead than behind, in their length, and how far ankles go when knees bend, in heights, at least.
const UNEVEN: f64 = 0.05;
/// Feet are this near to the floor, and heads this near to the top, in heights.
const LOW: f64 = 0.06;

/// Parts and the joints between them.
struct Graph<'a> {
    machine: &'a Machine,
    /// Neighbour and place of the joint.
    edges: Vec<Vec<(usize, DVec3)>>,
}

impl Graph<'_> {
    /// From one part to another, with the places of the joints passed.
    fn path(&self, from: usize, to: usize) -> Option<Vec<(usize, DVec3)>> {
        let mut before = vec![None; self.edges.len()];
        let mut queue = std::collections::VecDeque::from([from]);
        let mut seen = vec![false; self.edges.len()];
        seen[from] = true;
        while let Some(part) = queue.pop_front() {
            for &(next, place) in &self.edges[part] {
                if !std::mem::replace(&mut seen[next], true) {
                    before[next] = Some((part, place));
                    queue.push_back(next);
                }
            }
        }
        let mut path = Vec::new();
        let mut here = to;
        while here != from {
            let (part, place) = before[here]?;
            path.push((here, place));
            here = part;
        }
        path.reverse();
        Some(path)
    }

    /// The part where the ways between three parts meet.
    fn meeting(&self, a: usize, b: usize, c: usize) -> Option<usize> {
        let on = |x: usize, y: usize| -> Option<Vec<usize>> {
            Some(std::iter::once(x).chain(self.path(x, y)?.into_iter().map(|s| s.0)).collect())
        };
        let (ab, ac) = (on(a, b)?, on(a, c)?);
        ab.iter().zip(&ac).take_while(|(p, q)| p == q).last().map(|(p, _)| *p)
    }

    fn points(&self, part: usize) -> &[DVec3] {
        &self.machine.model.parts()[part].points
    }
}

/// The body in a machine whose up is known; in words what is missing where there is none. `forward`: where the user says so.
pub fn robot(machine: &Machine, up: DVec3, forward: Option<DVec3>) -> Result<Robot, String> {
    let count = machine.model.parts().len();
    let mut edges = vec![Vec::new(); count];
    for joint in &machine.joints {
        if let (Side::Part(a), Side::Part(b)) = (joint.a, joint.b) {
            edges[a].push((b, joint.centre));
            edges[b].push((a, joint.centre));
        }
    }
    let graph = Graph { machine, edges };
    let height = |part: usize| {
        let heights = graph.points(part).iter().map(|p| p.dot(up));
        heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), h| (lo.min(h), hi.max(h)))
    };
    let heights: Vec<(f64, f64)> = (0..count).map(height).collect();
    let floor = heights.iter().map(|h| h.0).fold(f64::INFINITY, f64::min);
    let top = heights.iter().map(|h| h.1).fold(f64::NEG_INFINITY, f64::max);
    let tall = top - floor;
    let centre = |part: usize| graph.points(part).iter().sum::<DVec3>() / graph.points(part).len() as f64;
    let flat = |v: DVec3| v - up * v.dot(up);

    // Feet: the two parts on the floor that are farthest from each other along the joints.
    let low: Vec<usize> = (0..count).filter(|&p| heights[p].0 < floor + LOW * tall && !graph.edges[p].is_empty()).collect();
    let steps = |a: usize, b: usize| graph.path(a, b).map_or(0, |p| p.len());
    let pairs = low.iter().flat_map(|&a| low.iter().map(move |&b| (a, b))).filter(|(a, b)| a < b);
    let feet = pairs.max_by_key(|&(a, b)| steps(a, b)).filter(|&(a, b)| steps(a, b) >= 4).ok_or("no two feet")?;
    let head = (0..count)
        .filter(|&p| !graph.edges[p].is_empty() && steps(feet.0, p) > 0)
        .max_by(|&a, &b| heights[a].1.total_cmp(&heights[b].1))
        .ok_or("no head")?;
    let pelvis = graph.meeting(feet.0, feet.1, head).ok_or("no pelvis")?;
    let side = flat(centre(feet.0) - centre(feet.1)).normalize_or_zero();
    // Hands: the leaves above the knees that reach farthest to the sides.
    let mut hands = [None, None];
    for leaf in (0..count).filter(|&p| graph.edges[p].len() == 1 && p != head && p != feet.0 && p != feet.1) {
        let path = graph.path(pelvis, leaf).unwrap_or_default();
        let on_leg = [feet.0, feet.1]
            .iter()
            .any(|&f| graph.path(pelvis, f).and_then(|leg| Some(leg.first()?.0 == path.first()?.0)).unwrap_or(false));
        if on_leg || path.len() < 3 {
            continue;
        }
        let across = (centre(leaf) - centre(pelvis)).dot(side);
        let slot = usize::from(across < 0.0);
        if hands[slot].is_none_or(|(far, _)| across.abs() > far) {
            hands[slot] = Some((across.abs(), leaf));
        }
    }
    let [Some((_, hand_a)), Some((_, hand_b))] = hands else { return Err("no two hands".into()) };
    let chest = graph.meeting(hand_a, hand_b, pelvis).ok_or("no chest")?;

    let limb = |from: usize, end: usize| -> Option<[Spot; 3]> {
        let path = graph.path(from, end)?;
        if path.len() < 2 {
            return None;
        }
        let places: Vec<DVec3> = path.iter().map(|s| s.1).collect();
        let (first, last) = (places[0], places[places.len() - 1]);
        let length = places.windows(2).map(|w| w[0].distance(w[1])).sum::<f64>();
        let near = |p: DVec3, q: DVec3| p.distance(q) < CLUSTER * length;
        let hip = places.iter().take_while(|p| near(**p, first)).count() - 1;
        let ankle = places.len() - places.iter().rev().take_while(|p| near(**p, last)).count();
        let ends = |k: &usize| places[*k].distance(places[hip]).min(places[*k].distance(places[ankle]));
        let knee = (hip + 1..ankle).max_by(|a, b| ends(a).total_cmp(&ends(b)))?;
        Some([(from, places[hip]), (path[knee].0, places[knee]), (path[path.len() - 1].0, places[ankle])])
    };
    let leg = |foot: usize| limb(pelvis, foot).ok_or("a leg without a knee");
    let feet = [feet.0, feet.1];
    // A hand of fingers: the arm ends where the ways to all of them part.
    let palm = |hand: usize| {
        let path = graph.path(chest, hand).unwrap_or_default();
        path.iter().map(|s| s.0).find(|&p| graph.edges[p].len() > 2).unwrap_or(hand)
    };
    let arm = |hand: usize| limb(chest, palm(hand)).or_else(|| limb(chest, hand)).ok_or("an arm without an elbow");
    let mut legs = [leg(feet[0])?, leg(feet[1])?];
    let mut arms = [arm(hand_a)?, arm(hand_b)?];
    // Knees bend the shank backwards; where their ranges say nothing, a foot reaches farther ahead of the ankle than behind it.
    let across = side.cross(up);
    let bends: f64 = legs.iter().filter_map(|leg| knee_bends(machine, leg)).map(|back| -back.dot(across)).sum();
    let reach = |k: usize| {
        let along = graph.points(legs[k][2].0).iter().map(|p| (*p - legs[k][2].1).dot(across));
        along.fold((0.0_f64, 0.0_f64), |(behind, ahead), d| (behind.max(-d), ahead.max(d)))
    };
    let (behind, ahead) = [0, 1].map(reach).into_iter().fold((0.0, 0.0), |sum, r| (sum.0 + r.0, sum.1 + r.1));
    let named = sides_by_names(machine, [&legs, &arms].map(|limbs| limbs.each_ref()));
    let is_named = forward.is_none() && named != 0.0;
    let forward = match forward {
        Some(forward) => flat(forward).try_normalize().ok_or("no front: scan_forward points up or down")?,
        // The first is the left one where this goes ahead.
        None if is_named => across * named,
        None if bends.abs() > UNEVEN * tall => across * bends.signum(),
        None if (ahead - behind).abs() > UNEVEN * (ahead + behind) => across * (ahead - behind).signum(),
        None => {
            return Err("no front: the feet reach as far back as ahead; scan_forward in [space] of the rig file says it".into());
        }
    };
    // Left is up × forward.
    if up.cross(forward).dot(side) < 0.0 {
        legs.swap(0, 1);
        arms.swap(0, 1);
    }
    let toes = [0, 1].map(|k| {
        let part = legs[k][2].0;
        let ankle = legs[k][2].1;
        let ahead = |p: &DVec3| (*p - ankle).dot(forward);
        let tip = graph.points(part).iter().map(ahead).fold(0.0, f64::max);
        let lowest = heights[part].0;
        (part, ankle + forward * (0.8 * tip) + up * (lowest - ankle.dot(up)))
    });
    let hips = (legs[0][0].1 + legs[1][0].1) * 0.5;
    let neck = if head == chest { None } else { graph.path(chest, head).and_then(|p| Some((chest, p.first()?.1))) };
    let crown = neck.and_then(|(_, base)| {
        let above = base + up * (heights[head].1 - base.dot(up));
        (heights[head].1 > base.dot(up)).then_some((head, above))
    });
    Ok(Robot { up, forward, is_named, pelvis: (pelvis, hips), chest, neck, crown, arms, legs, toes, floor })
}

/// 1 where names of parts say that the first leg and arm are the left ones, −1 where they say the right ones, 0 where they say neither or both.
fn sides_by_names(machine: &Machine, limbs: [[&[Spot; 3]; 2]; 2]) -> f64 {
    // The first spot of a limb is on the trunk.
    let parts =
        limbs.iter().flat_map(|pair| pair.iter().enumerate().flat_map(|(k, limb)| limb[1..].iter().map(move |spot| (k, spot.0))));
    let said: Vec<f64> = parts
        .filter_map(|(k, part)| {
            let left = is_left(&machine.model.parts()[part].name)?;
            Some(if left == (k == 0) { 1.0 } else { -1.0 })
        })
        .collect();
    if said.len() > 1 && said.iter().all(|&x| x == said[0]) { said[0] } else { 0.0 }
}

/// Which side the name of a part says, by a word of it: `arm_left_4_link`, `LeftShank`, `thigh.R`; `None` without or with both.
fn is_left(name: &str) -> Option<bool> {
    let (mut words, mut before) = (vec![String::new()], ' ');
    for c in name.chars() {
        if !c.is_alphabetic() || (c.is_uppercase() && before.is_lowercase()) {
            words.push(String::new());
        }
        if let (true, Some(word)) = (c.is_alphabetic(), words.last_mut()) {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    let has = |sides: [&str; 2]| words.iter().any(|w| sides.contains(&w.as_str()));
    match (has(["left", "l"]), has(["right", "r"])) {
        (true, false) => Some(true),
        (false, true) => Some(false),
        _ => None,
    }
}

/// Where the ankle of a leg goes when the knee bends to the middle of its range; `None` where that is not known.
fn knee_bends(machine: &Machine, leg: &[Spot; 3]) -> Option<DVec3> {
    let [_, (shank, knee), (_, ankle)] = *leg;
    let joint = machine.joints.iter().find(|j| {
        j.centre.distance(knee) < 1e-9 && (j.a == Side::Part(shank) || j.b == Side::Part(shank)) && j.angle.is_some()
    })?;
    let (lo, hi) = joint.angle?;
    // The range is that of b against a.
    let middle = 0.5 * (lo + hi) * if joint.b == Side::Part(shank) { 1.0 } else { -1.0 };
    let arm = ankle - knee;
    Some(DQuat::from_axis_angle(joint.frame.x_axis, middle) * arm - arm)
}

#[cfg(test)]
mod tests {
    use super::is_left;

    #[test]
    fn sides_are_words_of_names() {
        for name in ["arm_left_4_link", "LeftShank", "left", "thigh.L", "l_foot", "leg_l"] {
            assert_eq!(is_left(name), Some(true), "{name}");
            let other = name
                .replace("left", "right")
                .replace("Left", "Right")
                .replace(".L", ".R")
                .replace("l_foot", "r_foot")
                .replace("leg_l", "leg_r");
            assert_eq!(is_left(&other), Some(false), "{other}");
        }
        for name in ["base_link", "cleft", "lever", "bright", "left_to_right", "part_1", ""] {
            assert_eq!(is_left(name), None, "{name}");
        }
    }
}
