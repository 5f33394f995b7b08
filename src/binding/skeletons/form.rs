//! The parts of joints whose names say nothing: by the form of the tree, as a body is told by its five ends.

use super::cast::{Arm, Cast, Leg};
use super::rig::{Pose, Rig};
use glam::DVec3;

/// Ends that are looked at.
const ENDS: usize = 8;
/// Lengths along the bones between the ends of a person, in those from head to foot: head to hand, hand to hand, hand to foot, foot to
/// foot; the middle of eight families of skeletons.
const PROPORTIONS: [f64; 4] = [0.68, 0.96, 1.28, 1.26];
/// Mean deviation from these up to which a tree is a person.
const LIKE: f64 = 0.14;
/// How much worse the second-best reading must be.
const MARGIN: f64 = 0.02;
/// Say of the difference between the two sides.
const SYMMETRY: f64 = 2.0;
/// Cosine of the votes for the front up to which it is unclear.
const FRONT: f64 = 0.3;
/// Joints in a chain beyond which it is no limb: hands have ten, ropes and hair hundreds.
const LIMB: usize = 64;
/// Frames looked at for the front.
const SAMPLES: usize = 40;

/// A tree of joints with the lengths of its bones.
struct Tree<'a> {
    rig: &'a Rig<'a>,
    places: Vec<DVec3>,
    /// Along the bones from the root.
    depth: Vec<f64>,
}

impl Tree<'_> {
    fn between(&self, a: usize, b: usize) -> Option<f64> {
        let common = if self.rig.is_above(a, b) {
            a
        } else if self.rig.is_above(b, a) {
            b
        } else {
            self.rig.common(a, b)?
        };
        Some(self.depth[a] + self.depth[b] - 2.0 * self.depth[common])
    }

    /// From below `top` down to `end`.
    fn chain(&self, top: usize, end: usize) -> Vec<usize> {
        let mut chain = vec![end];
        chain.extend(self.rig.ancestors(end).take_while(|&j| j != top));
        chain.reverse();
        chain
    }

    fn length(&self, a: usize, b: usize) -> f64 {
        (self.places[a] - self.places[b]).length()
    }

    /// The joints of a limb below `top`: three of the chain to `end`, and what lies beyond them, nearest to the shares of a limb: from
    /// `top` to the first, first to second, second to third, third to the end.
    fn limb(&self, top: usize, end: usize, shares: [f64; 4]) -> Option<[usize; 3]> {
        let chain = self.chain(top, end);
        if chain.len() > LIMB {
            return None;
        }
        let mut best: Option<(f64, [usize; 3])> = None;
        for (i, &a) in chain.iter().enumerate() {
            for (k, &b) in chain.iter().enumerate().skip(i + 1) {
                for &c in &chain[k + 1..] {
                    let (upper, lower) = (self.length(a, b), self.length(b, c));
                    if upper <= 0.0 || lower <= 0.0 || [a, b, c].iter().any(|&j| self.rig.take.joints[j].end && j != c) {
                        continue;
                    }
                    let cost = (upper / lower * shares[2] / shares[1]).ln().abs()
                        + 0.5 * (self.length(top, a) / upper - shares[0] / shares[1]).abs()
                        + 0.3 * (self.length(c, end) / lower - shares[3] / shares[2]).abs();
                    if best.is_none_or(|(least, _)| cost < least) {
                        best = Some((cost, [a, b, c]));
                    }
                }
            }
        }
        best.map(|b| b.1)
    }
}

/// The parts by form; `None` where the tree is not that of a person.
pub(super) fn cast(rig: &Rig<'_>, swap: bool) -> Option<Cast> {
    let frames = rig.sample(SAMPLES);
    let poses = frames.iter().map(|&f| Pose::Frame(f)).chain([Pose::Rest]);
    if rig.take.depth() > 3 * LIMB {
        return None;
    }
    let joints = rig.take.joints.len();
    let places = poses.map(|pose| (0..joints).map(|j| rig.place(pose, j)).collect::<Option<Vec<_>>>()).find_map(|p| p)?;
    let mut depth = vec![0.0; joints];
    for j in 0..joints {
        if let Some(parent) = rig.take.joints[j].parent {
            depth[j] = depth[parent] + (places[j] - places[parent]).length();
        }
    }
    let tree = Tree { rig, places, depth };
    let ends = ends(&tree)?;
    let [head, hands @ .., left, right] = label(&tree, &ends)?;
    let feet = [left, right];
    let (pelvis, chest) = (rig.common(feet[0], feet[1])?, rig.common(hands[0], hands[1])?);
    let mut arms = hands.map(|hand| {
        tree.limb(chest, hand, [0.13, 0.186, 0.146, 0.10]).map(|[shoulder, elbow, wrist]| (hand, shoulder, elbow, wrist))
    });
    let mut legs =
        feet.map(|foot| tree.limb(pelvis, foot, [0.06, 0.245, 0.246, 0.12]).map(|[hip, knee, ankle]| (foot, hip, knee, ankle)));
    let front = front(rig, &frames, [legs[0]?, legs[1]?], head)?;
    let sideways = |a: usize, b: usize| -> f64 {
        let votes = front.iter().filter_map(|&(pose, left)| Some((rig.place(pose, a)? - rig.place(pose, b)?).dot(left)));
        votes.sum()
    };
    let exchanged = |gap: f64| (gap < 0.0) != swap;
    if exchanged(sideways(arms[0]?.1, arms[1]?.1)) {
        arms.swap(0, 1);
    }
    if exchanged(sideways(legs[0]?.1, legs[1]?.1)) {
        legs.swap(0, 1);
    }
    let beyond = |end: usize, last: usize| (end != last).then_some(end);
    let arm = |a: (usize, usize, usize, usize)| Arm { shoulder: a.1, elbow: a.2, wrist: a.3, hand: beyond(a.0, a.3) };
    let leg = |l: (usize, usize, usize, usize)| {
        // The joint after the ankle is the ball of the foot; the end is the tip of the toes.
        let toe = tree.chain(l.3, l.0).first().copied();
        Leg { hip: l.1, knee: l.2, ankle: l.3, toe: if l.0 == l.3 { None } else { toe } }
    };
    let skull: Vec<usize> = tree.chain(chest, head).into_iter().filter(|&j| !rig.take.joints[j].end).collect();
    let spine = rig.spine(pelvis, chest);
    Some(Cast {
        spine,
        neck: skull.first().copied().filter(|_| skull.len() > 1),
        head: skull.last().copied(),
        arms: [arm(arms[0]?), arm(arms[1]?)],
        legs: [leg(legs[0]?), leg(legs[1]?)],
        named: 0,
        family: None,
        by_form: true,
    })
}

/// The leaves farthest from each other.
fn ends(tree: &Tree<'_>) -> Option<Vec<usize>> {
    let joints = tree.rig.take.joints.len();
    let mut leaf = vec![true; joints];
    tree.rig.take.joints.iter().filter_map(|j| j.parent).for_each(|p| leaf[p] = false);
    let mut left: Vec<usize> = (0..joints).filter(|&j| leaf[j]).collect();
    let first = left.iter().copied().reduce(|a, b| if tree.depth[b] > tree.depth[a] { b } else { a })?;
    let mut ends = vec![first];
    left.retain(|&j| j != first);
    while ends.len() < ENDS && !left.is_empty() {
        let gap = |j: usize| ends.iter().filter_map(|&e| tree.between(e, j)).fold(f64::INFINITY, f64::min);
        let next = left.iter().copied().filter(|&j| gap(j).is_finite()).reduce(|a, b| if gap(b) > gap(a) { b } else { a })?;
        ends.push(next);
        left.retain(|&j| j != next);
    }
    (ends.len() >= 5).then_some(ends)
}

/// Head, hands and feet among the ends.
fn label(tree: &Tree<'_>, ends: &[usize]) -> Option<[usize; 5]> {
    let mut readings: Vec<(f64, [usize; 5])> = Vec::new();
    for &head in ends {
        for (i, &a) in ends.iter().enumerate() {
            for &b in &ends[i + 1..] {
                for (k, &c) in ends.iter().enumerate() {
                    for &d in &ends[k + 1..] {
                        let all = [head, a, b, c, d];
                        if all.iter().enumerate().all(|(n, j)| !all[..n].contains(j)) {
                            readings.extend(cost(tree, all).map(|cost| (cost, all)));
                        }
                    }
                }
            }
        }
    }
    readings.sort_by(|x, y| x.0.total_cmp(&y.0));
    let (least, best) = *readings.first()?;
    // Fingers and toes of one hand or foot stand for each other.
    let rival = readings.iter().skip(1).find(|(_, other)| {
        let hands = |r: &[usize; 5]| tree.rig.common(r[1], r[2]);
        let feet = |r: &[usize; 5]| tree.rig.common(r[3], r[4]);
        hands(other) != hands(&best) || feet(other) != feet(&best)
    });
    (least < LIKE && rival.is_none_or(|r| r.0 > least + MARGIN)).then_some(best)
}

fn cost(tree: &Tree<'_>, [head, a, b, c, d]: [usize; 5]) -> Option<f64> {
    let both = |x: usize, y: usize, z: usize| Some([tree.between(x, y)?, tree.between(x, z)?]);
    let feet = both(head, c, d)?;
    let whole = 0.5 * (feet[0] + feet[1]);
    if whole.is_nan() || whole <= 0.0 {
        return None;
    }
    let hands = both(head, a, b)?;
    let across = [both(a, c, d)?, both(b, d, c)?];
    let mean = |pair: [f64; 2]| 0.5 * (pair[0] + pair[1]) / whole;
    let found =
        [mean(hands), tree.between(a, b)? / whole, 0.5 * (mean(across[0]) + mean(across[1])), tree.between(c, d)? / whole];
    let off: f64 = found.iter().zip(PROPORTIONS).map(|(x, y)| (x - y).abs()).sum::<f64>() / 4.0;
    let uneven = ((hands[0] - hands[1]).abs() + (feet[0] - feet[1]).abs()) / whole;
    Some(off + SYMMETRY * 0.5 * uneven)
}

/// Left in each frame: across what is up and where toes and knees point. `None` where these disagree.
fn front(rig: &Rig<'_>, frames: &[usize], legs: [(usize, usize, usize, usize); 2], head: usize) -> Option<Vec<(Pose, DVec3)>> {
    let mut out = Vec::new();
    let mut agreement = 0.0;
    for &frame in frames {
        let pose = Pose::Frame(frame);
        let at = |j: usize| rig.place(pose, j);
        let [Some(top), Some(a), Some(b)] = [at(head), at(legs[0].3), at(legs[1].3)] else { continue };
        let Some(up) = (top - (a + b) * 0.5).try_normalize() else { continue };
        let mut sum = DVec3::ZERO;
        let mut total = 0.0;
        for (tip, hip, knee, ankle) in legs {
            if let [Some(tip), Some(hip), Some(knee), Some(ankle)] = [tip, hip, knee, ankle].map(at) {
                for vote in [tip - ankle, knee - (hip + ankle) * 0.5] {
                    let level = vote - up * vote.dot(up);
                    sum += level;
                    total += level.length();
                }
            }
        }
        let Some(forward) = sum.try_normalize() else { continue };
        agreement += sum.length() / total;
        out.push((pose, up.cross(forward)));
    }
    (!out.is_empty() && agreement > FRONT * out.len() as f64).then_some(out)
}
