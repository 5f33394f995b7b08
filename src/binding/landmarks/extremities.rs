//! Which ends of a solid are head, hands and feet.

use super::geodesic::distances;
use super::medial::Curve;
use super::voxels::Solid;
use glam::DVec3;
use std::cell::LazyCell;

/// Ends looked at; a body has five, the rest are ears, tails, cuffs and folds.
const ENDS: usize = 9;
/// Two ends nearer than this share of the size are one.
const SAME_END: f64 = 0.06;

/// Expected distances between ends, in shares of the distance from head to feet.
const HEAD_HAND: f64 = 0.60;
const HAND_FOOT: f64 = 1.10;
const FOOT_FOOT: f64 = 1.04;
const HAND_HAND: f64 = 0.87;
/// Weight of a wrong proportion against a difference between the sides.
const PROPORTION: f64 = 0.7;
/// Where the neck is looked for from the crown, and how far inwards it is compared, in the same shares.
const NECK: [f64; 2] = [0.10, 0.24];
const NECK_REACH: f64 = 0.36;
/// Weight of a wide neck against a difference between the sides.
const NARROW: f64 = 0.6;
/// Farthest place of the head under the top, of a foot over the bottom and of anything from the axis, in heights.
const ON_TOP: f64 = 0.06;
const AT_BOTTOM: f64 = 0.10;
const SLENDER: f64 = 0.35;

/// An end of the solid and the distances of all voxels from it.
#[derive(Clone)]
pub(super) struct End {
    pub(super) voxel: usize,
    pub(super) distance: Vec<f64>,
}

/// Head and feet.
pub(super) struct Extremities {
    pub(super) head: End,
    pub(super) feet: [End; 2],
    /// Mean distance through the body from head to feet.
    pub(super) length: f64,
    /// How unlike a person the best labelling is.
    pub(super) cost: f64,
    /// How much more the next best labelling costs.
    pub(super) margin: f64,
}

/// The ends of the solid: farthest points in turn, without those that are not farther from the middle than what is around them.
pub(super) fn ends(solid: &Solid) -> Vec<End> {
    let mean = solid.centres.iter().sum::<DVec3>() / solid.len() as f64;
    let Some(start) = (0..solid.len()).min_by(|&i, &j| {
        let squared = |i: usize| solid.centres[i].distance_squared(mean);
        squared(i).total_cmp(&squared(j))
    }) else {
        return Vec::new();
    };
    let mut nearest = distances(solid, start);
    let mut ends: Vec<End> = Vec::with_capacity(ENDS);
    let mut squares = vec![0.0; solid.len()];
    for n in 0..ENDS {
        let voxel = farthest(&nearest);
        let distance = distances(solid, voxel);
        for (near, d) in nearest.iter_mut().zip(&distance) {
            *near = if n == 0 { *d } else { near.min(*d) };
        }
        for (sum, d) in squares.iter_mut().zip(&distance) {
            *sum += d * d;
        }
        ends.push(End { voxel, distance });
    }
    let middle = (0..solid.len()).min_by(|&i, &j| squares[i].total_cmp(&squares[j])).unwrap_or(start);
    let depth = distances(solid, middle);
    let size = 2.0 * depth[farthest(&depth)];
    ends.retain(|end| {
        let around = end.distance.iter().zip(&depth).filter(|(d, _)| **d < SAME_END * size).map(|(_, depth)| *depth);
        depth[end.voxel] >= around.fold(0.0, f64::max) - 3.5 * solid.pitch
    });
    ends
}

fn farthest(distance: &[f64]) -> usize {
    let mut best = 0;
    for (i, d) in distance.iter().enumerate() {
        if *d > distance[best] {
            best = i;
        }
    }
    best
}

/// The labelling of head, feet and hands that is most like a person: sides alike, distances in proportion. `None` with fewer than five
/// ends.
pub(super) fn label(ends: &[End]) -> Option<(Extremities, [End; 2])> {
    let n = ends.len();
    let between = distances_between(ends);
    let mut labellings = Vec::new();
    for head in 0..n {
        for (a, b) in pairs(n) {
            for (f, g) in pairs(n) {
                if [a, b].contains(&head) || [f, g].contains(&head) || [a, b].contains(&f) || [a, b].contains(&g) {
                    continue;
                }
                labellings.push((cost(&between, head, [a, b], [f, g]), head, [a, b], [f, g]));
            }
        }
    }
    labellings.sort_by(|x, y| x.0.total_cmp(&y.0));
    let &(cost, head, hands, feet) = labellings.first()?;
    let margin = labellings.get(1).map_or(1.0, |next| next.0) - cost;
    let length = 0.5 * (between[head][feet[0]] + between[head][feet[1]]);
    let take = |i: usize| ends[i].clone();
    Some((Extremities { head: take(head), feet: feet.map(take), length, cost, margin }, hands.map(take)))
}

/// The labelling of head and feet alone that is most like a person who stands with the arms down: feet alike, a narrow neck, head on top
/// and feet at the bottom of a slender shape. `None` where no three ends are like that.
pub(super) fn label_slender(ends: &[End], solid: &Solid) -> Option<Extremities> {
    let n = ends.len();
    let between = distances_between(ends);
    let mut labellings = Vec::new();
    for head in 0..n {
        let farthest = between[head].iter().copied().fold(0.0, f64::max);
        let neck = LazyCell::new(|| Curve::follow(solid, &ends[head].distance, NECK_REACH * farthest, |_| true));
        for (f, g) in pairs(n).filter(|&(f, g)| f != head && g != head) {
            let d = |i: usize, j: usize| between[i][j];
            let length = 0.5 * (d(head, f) + d(head, g));
            if !stands(solid, [head, f, g].map(|i| solid.centres[ends[i].voxel])) {
                continue;
            }
            let narrow = neck.narrowest(NECK[0] * length, NECK[1] * length).map(|s| s.area);
            let wide = neck.between(NECK[1] * length, NECK_REACH * length).iter().map(|s| s.area).fold(0.0, f64::max);
            let Some(narrow) = narrow.filter(|_| wide > 0.0) else { continue };
            let cost = ((d(head, f) - d(head, g)).abs() + PROPORTION * (d(f, g) - FOOT_FOOT * length).abs()) / length;
            labellings.push((cost + NARROW * narrow / wide, head, [f, g], length));
        }
    }
    labellings.sort_by(|x, y| x.0.total_cmp(&y.0));
    let &(cost, head, feet, length) = labellings.first()?;
    let margin = labellings.get(1).map_or(1.0, |next| next.0) - cost;
    Some(Extremities { head: ends[head].clone(), feet: feet.map(|i| ends[i].clone()), length, cost, margin })
}

/// Whether the head is on top and the feet are at the bottom of a slender shape.
fn stands(solid: &Solid, [head, f, g]: [DVec3; 3]) -> bool {
    let foot = (f + g) * 0.5;
    let Some(up) = (head - foot).try_normalize() else { return false };
    let (mut low, mut high, mut wide) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
    for p in &solid.centres {
        low = low.min(p.dot(up));
        high = high.max(p.dot(up));
        wide = wide.max((*p - foot).reject_from_normalized(up).length());
    }
    let height = high - low;
    high - head.dot(up) < ON_TOP * height && f.dot(up).max(g.dot(up)) - low < AT_BOTTOM * height && wide < SLENDER * height
}

fn distances_between(ends: &[End]) -> Vec<Vec<f64>> {
    ends.iter().map(|a| ends.iter().map(|b| a.distance[b.voxel]).collect()).collect()
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |i| (i + 1..n).map(move |j| (i, j)))
}

fn cost(between: &[Vec<f64>], head: usize, [a, b]: [usize; 2], [f, g]: [usize; 2]) -> f64 {
    let d = |i: usize, j: usize| between[i][j];
    let length = 0.5 * (d(head, f) + d(head, g));
    // Which foot is on the side of which hand is not known yet: straight and crossed pairs are compared each with its own kind.
    let sides =
        (d(head, a) - d(head, b)).abs() + (d(head, f) - d(head, g)).abs() + (d(a, f) - d(b, g)).abs() + (d(a, g) - d(b, f)).abs();
    let proportions = (0.5 * (d(head, a) + d(head, b)) - HEAD_HAND * length).abs()
        + (0.25 * (d(a, f) + d(a, g) + d(b, f) + d(b, g)) - HAND_FOOT * length).abs()
        + (d(f, g) - FOOT_FOOT * length).abs()
        + (d(a, b) - HAND_HAND * length).abs();
    (sides + PROPORTION * proportions) / length
}
