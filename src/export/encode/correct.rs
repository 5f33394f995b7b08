//! What a skin misses in single frames → corrective morph targets.
//!
//! Where a fold turns over, the pose itself jumps, and no joint is worth adding for a frame. The worst frame gives a target of the vertices that
//! are off in it; other frames take as much of it as brings them nearer; and so on until all frames are near enough (a greedy pursuit). What is
//! added at rest is turned by the joints: `e = L d`, solved for `d` with a bound where the blended `L` of a fold is nearly singular.

use super::measure::{BadFrame, Miss, VertexError, Written};
use super::morphs::{Morphs, Target};
use super::skin::Skin;
use super::surface::worst_vertices;
use super::{Job, PointMap};
use crate::error::Result;
use glam::{DMat3, DVec3};

/// Targets at most in a file.
const MOST_TARGETS: usize = 64;
/// Vertices of all bad frames together at most: what is held in memory.
const MOST_MISSES: usize = 1 << 20;
/// So few vertices are followed one by one to find the frames in which they are off.
const FEW: usize = 2000;
/// Passes over the whole motion at most.
const PASSES: usize = 3;
/// Shares of the tolerance: below the first nothing is corrected, from the second on all of it, and a frame within the third is good.
const FLOOR: f64 = 0.5;
const WHOLE: f64 = 0.8;
const GOOD: f64 = 0.95;
/// Singular values of `L` below this are not inverted.
const SINGULAR: f64 = 0.05;

/// Targets that bring the skin within the job's tolerance, or as near as their number allows, and the errors that are left.
pub fn correct<M: PointMap>(job: &Job<'_, M>, skin: &Skin, mut errors: Vec<VertexError>) -> Result<(Morphs, Vec<VertexError>)> {
    let rest = job.rest_as_written();
    let tolerance = job.tolerance.worst * job.space.scale;
    let all: Vec<usize> = (0..job.spool.frames()).collect();
    let worst = |errors: &[VertexError]| errors.iter().fold(0.0, |a: f64, e| a.max(e.worst_square)).sqrt();
    let mut morphs = Morphs::none(all.len());
    for _ in 0..PASSES {
        if worst(&errors) <= tolerance || morphs.targets.len() == MOST_TARGETS {
            break;
        }
        let written = Written { skin, morphs: &morphs, rest: &rest, space: job.space };
        let suspects = worst_vertices(&errors, GOOD * tolerance, FEW + 1);
        let frames = if morphs.targets.is_empty() && suspects.len() <= FEW {
            let rows: Vec<_> = suspects.iter().map(|&i| (i, job.map.row(job.vertices[i] as usize))).collect();
            written.frames_over(&rows, GOOD * tolerance, job.spool, job.cancel)?
        } else {
            all.clone()
        };
        let bounds = (FLOOR * tolerance, GOOD * tolerance, MOST_MISSES);
        let mut bad = written.bad_frames(job.map, job.vertices, job.spool, &frames, bounds, job.cancel)?;
        let (targets, weights) = pursue(&mut bad, tolerance, MOST_TARGETS - morphs.targets.len());
        let row = |frame: usize| {
            let place = bad.iter().position(|b| b.frame == frame);
            place.map_or_else(|| vec![0.0; targets.len()], |b| weights.iter().map(|w| w[b]).collect())
        };
        let more = morphs.clone().with(targets.clone(), job.spool.folder(), row)?;
        let written = Written { skin, morphs: &more, rest: &rest, space: job.space };
        let now = written.measure(job.map, job.vertices, job.spool, &all, job.cancel)?;
        if worst(&now) >= worst(&errors) {
            break;
        }
        (morphs, errors) = (more, now);
    }
    Ok((morphs, errors))
}

/// Targets, and for each its weights in the bad frames, whose errors become those that are left.
fn pursue(bad: &mut [BadFrame], tolerance: f64, most: usize) -> (Vec<Target>, Vec<Vec<f32>>) {
    let (mut targets, mut weights) = (Vec::new(), Vec::new());
    let mut hopeless = vec![false; bad.len()];
    while targets.len() < most {
        let worst: Vec<f64> = bad.iter().map(BadFrame::worst).collect();
        let open = (0..bad.len()).filter(|&b| !hopeless[b] && worst[b] > GOOD * tolerance);
        let Some(at) = open.reduce(|a, b| if worst[b] > worst[a] { b } else { a }) else { break };
        let target = target_of(&bad[at].misses, tolerance);
        let taken: Vec<f32> = (0..bad.len()).map(|b| share(&bad[b].misses, &target, b == at, worst[b], tolerance)).collect();
        for (frame, &w) in bad.iter_mut().zip(&taken).filter(|(_, w)| **w != 0.0) {
            take_off(&mut frame.misses, &target, w.into());
        }
        hopeless[at] = bad[at].worst() > 0.9 * worst[at];
        targets.push(target);
        weights.push(taken);
    }
    (targets, weights)
}

/// What to add at rest so that the vertices of a frame are where they should be; less of it the nearer they are.
fn target_of(misses: &[Miss], tolerance: f64) -> Target {
    let mut vertices = Vec::new();
    let mut offsets = Vec::new();
    for miss in misses {
        let used = miss.error.length() / tolerance;
        let share = ((used - FLOOR) / (WHOLE - FLOOR)).clamp(0.0, 1.0);
        let transposed = miss.linear.transpose();
        let normal = transposed * miss.linear + DMat3::IDENTITY * (SINGULAR * SINGULAR);
        let offset = normal.inverse() * (transposed * miss.error) * share;
        if share > 0.0 && offset.is_finite() {
            vertices.push(miss.vertex);
            offsets.push(offset.as_vec3().to_array());
        }
    }
    Target::Sparse(vertices, offsets)
}

/// How much of a target a frame takes, from 0 to 1: all, if it is its own; else what leaves the smallest squares, if its worst vertex gains and no
/// vertex that was near gets far.
fn share(misses: &[Miss], target: &Target, own: bool, worst: f64, tolerance: f64) -> f32 {
    let Target::Sparse(vertices, offsets) = target else { return 0.0 };
    if own {
        return 1.0;
    }
    let offset = |k: usize| DVec3::from_array(offsets[k].map(f64::from));
    let (mut along, mut square) = (0.0, 0.0);
    let mut places = Vec::with_capacity(vertices.len());
    for (k, vertex) in vertices.iter().enumerate() {
        let place = misses.binary_search_by_key(vertex, |m| m.vertex).ok();
        let moved = place.map_or(offset(k), |m| misses[m].linear * offset(k));
        along += place.map_or(0.0, |m| moved.dot(misses[m].error));
        square += moved.length_squared();
        places.push((place, moved));
    }
    // Blender cuts weights off outside of this range.
    let weight = (along / square).min(1.0) as f32;
    if !weight.is_finite() || weight < 0.1 {
        return 0.0;
    }
    let w = f64::from(weight);
    let left = |(place, moved): &(Option<usize>, DVec3)| match place {
        Some(m) => (misses[*m].error - *moved * w).length(),
        None => FLOOR * tolerance + moved.length() * w,
    };
    let of_target = places.iter().map(left).fold(0.0, f64::max);
    let mut touched = places.iter().filter_map(|p| p.0).peekable();
    let mut others = 0f64;
    for (m, miss) in misses.iter().enumerate() {
        if touched.next_if_eq(&m).is_none() {
            others = others.max(miss.error.length());
        }
    }
    if of_target.max(others) < worst { weight } else { 0.0 }
}

/// Takes off the errors what a target adds.
fn take_off(misses: &mut [Miss], target: &Target, weight: f64) {
    let Target::Sparse(vertices, offsets) = target else { return };
    for (vertex, offset) in vertices.iter().zip(offsets) {
        if let Ok(m) = misses.binary_search_by_key(vertex, |m| m.vertex) {
            misses[m].error -= misses[m].linear * DVec3::from_array(offset.map(f64::from)) * weight;
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn frame(frame: usize, errors: &[(u32, DVec3)], linear: DMat3) -> BadFrame {
        BadFrame { frame, misses: errors.iter().map(|&(vertex, error)| Miss { vertex, error, linear }).collect() }
    }

    #[test]
    fn frames_with_the_same_fault_share_a_target_and_others_do_not() {
        let turn = DMat3::from_rotation_z(1.0);
        let mut bad = [
            frame(3, &[(1, DVec3::X * 1.5), (4, DVec3::Y * 0.6)], DMat3::IDENTITY),
            // The same offsets at rest, turned by the joints, at two thirds.
            frame(4, &[(1, turn * DVec3::X), (4, turn * DVec3::Y * 0.1)], turn),
            frame(9, &[(2, DVec3::Z * 1.2)], DMat3::IDENTITY),
        ];
        let (targets, weights) = pursue(&mut bad, 1.0, 10);
        assert_eq!(targets.len(), 2);
        assert_eq!(targets[0].vertices(), Some(&[1, 4][..]));
        assert_eq!(weights[0][0], 1.0);
        assert!((weights[0][1] - 0.67).abs() < 0.02 && weights[0][2] == 0.0, "{weights:?}");
        assert_eq!(weights[1], [0.0, 0.0, 1.0]);
        assert!(bad.iter().all(|b| b.worst() <= 0.95));
    }

    #[test]
    fn what_the_joints_press_flat_is_not_blown_up() {
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 1e-6));
        let target = target_of(&frame(0, &[(7, DVec3::new(1.0, 0.0, 1.0))], flat).misses, 0.5);
        let [x, y, z] = target.offset(7);
        assert!((x - 1.0).abs() < 0.01 && y == 0.0 && z.abs() < 1.0, "{x} {y} {z}");
    }

    #[test]
    fn the_number_of_targets_is_bounded_and_the_worst_frames_come_first() {
        let mut bad: Vec<BadFrame> =
            (0..20).map(|f| frame(f, &[(f as u32, DVec3::X * (2.0 + f as f64))], DMat3::IDENTITY)).collect();
        let (targets, _) = pursue(&mut bad, 1.0, 5);
        let firsts: Vec<u32> = targets.iter().map(|t| t.vertices().unwrap()[0]).collect();
        assert_eq!(firsts, [19, 18, 17, 16, 15]);
    }
}
