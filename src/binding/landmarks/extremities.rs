//! Which ends of a solid are head, hands and feet.

use super::geodesic::distances;
use super::voxels::Solid;
use glam::DVec3;

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

/// An end of the solid and the distances of all voxels from it.
pub(super) struct End {
    pub(super) voxel: usize,
    pub(super) distance: Vec<f64>,
}

/// Head, hands and feet.
pub(super) struct Extremities {
    pub(super) head: End,
    pub(super) hands: [End; 2],
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

/// The labelling that is most like a person: sides alike, distances in proportion. `None` with fewer than five ends.
pub(super) fn label(mut ends: Vec<End>) -> Option<Extremities> {
    let n = ends.len();
    let between: Vec<Vec<f64>> = ends.iter().map(|a| ends.iter().map(|b| a.distance[b.voxel]).collect()).collect();
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
    let mut take = |i: usize| std::mem::replace(&mut ends[i], End { voxel: 0, distance: Vec::new() });
    Some(Extremities { head: take(head), hands: hands.map(&mut take), feet: feet.map(&mut take), length, cost, margin })
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
