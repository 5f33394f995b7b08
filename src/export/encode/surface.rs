//! Weights of the scan's vertices. Carried over from the proxy they miss by several tolerances; solved anew on each vertex's own path they do not.

use super::blend::{emphasis_target, emphasis_weight};
use super::fit::{Fit, WeightScratch, smallest};
use super::measure::VertexError;
use super::motion::Motion;
use super::sample::JointPlanes;
use super::select::CANDIDATES;
use super::tracks::Tracks;
use super::{Influences, PointMap, Tolerance};
use crate::error::Result;
use crate::linalg::SparseRow;
use glam::DVec3;
use rayon::prelude::*;

/// Candidates of an ordinary vertex: more bring nothing but time.
const FEW: usize = 6;
/// Numbers held while vertices are refitted on all frames.
const BUDGET: usize = 1 << 20;

/// Proxy vertices that some row of the map reads; the others are not seen in the result, and need no fit.
pub fn read_by_map(map: &impl PointMap, vertices: &[u32], proxy_vertices: usize) -> Vec<u32> {
    let mark = |mut seen: Vec<bool>, &v: &u32| {
        for &i in &map.row(v as usize).indices {
            seen[i as usize] = true;
        }
        seen
    };
    let none = || vec![false; proxy_vertices];
    let union = |a: Vec<bool>, b: Vec<bool>| a.iter().zip(&b).map(|(x, y)| x | y).collect();
    let seen: Vec<bool> = vertices.par_iter().with_min_len(4096).fold(none, mark).reduce(none, union);
    (0..proxy_vertices as u32).filter(|&i| seen[i as usize]).collect()
}

/// Weights of scan vertices through the rows of the map, over a fit of the proxy.
pub struct SurfaceWeights<'a, M> {
    map: &'a M,
    fit: &'a Fit,
    /// Fit point of each proxy vertex.
    points: Vec<u32>,
    /// The joints in the sample's frames.
    joints: JointPlanes,
}

impl<'a, M: PointMap> SurfaceWeights<'a, M> {
    /// Prepares the fit's joints on its sample.
    pub fn new(map: &'a M, fit: &'a Fit, proxy_vertices: usize) -> Result<Self> {
        let mut points = vec![u32::MAX; proxy_vertices];
        for (i, &v) in fit.points.vertices().iter().enumerate() {
            points[v as usize] = i as u32;
        }
        let joints = JointPlanes::read(&fit.tracks, &fit.sample.frames)?;
        Ok(Self { map, fit, points, joints })
    }

    /// Weights of all `vertices`, learned on the sample's frames. `rest`: positions of the scan's vertices in the unit box.
    pub fn solve(&self, vertices: &[u32], rest: &[DVec3]) -> Vec<Influences> {
        let solve = |scratch: &mut (WeightScratch, Vec<f32>), &v: &u32| {
            let row = self.map.row(v as usize);
            let candidates = self.candidates(&row, FEW);
            self.path(&row, &mut scratch.1);
            scratch.0.solve(&self.joints, rest[v as usize], &scratch.1, &candidates, false)
        };
        vertices.par_iter().map_init(Default::default, solve).collect()
    }

    /// Weights of a few vertices from all frames, each time with more emphasis on the frames that are badly met; the solution with the smallest
    /// worst frame counts.
    pub fn refine(&self, motion: &Motion<'_>, vertices: &[(DVec3, &SparseRow)], goal: Tolerance) -> Result<Vec<Influences>> {
        let frames = motion.frames();
        let mut solved = Vec::with_capacity(vertices.len());
        for group in vertices.chunks((BUDGET / (3 * frames)).max(1)) {
            let mut paths = vec![vec![0f32; 3 * frames]; group.len()];
            super::motion::in_batches(motion.spool, motion.cancel, |first, poses| {
                paths.par_iter_mut().zip(group).for_each(|(path, (_, row))| {
                    for (g, pose) in poses.iter().enumerate() {
                        let q = motion.roots[first + g].undo(row.apply(pose));
                        for axis in 0..3 {
                            path[axis * frames + first + g] = q[axis] as f32;
                        }
                    }
                });
                Ok(())
            })?;
            let refined: Result<Vec<Influences>> = group
                .par_iter()
                .zip(&paths)
                .map(|((rest, row), path)| {
                    let candidates = self.candidates(row, CANDIDATES);
                    refine_vertex(&self.fit.tracks, *rest, path, &candidates, goal)
                })
                .collect();
            solved.extend(refined?);
        }
        Ok(solved)
    }

    /// The joints with the largest carried weight.
    fn candidates(&self, row: &SparseRow, count: usize) -> Vec<usize> {
        let mut carried = vec![0.0; self.fit.tracks.joints()];
        for (&v, &b) in row.indices.iter().zip(&row.values) {
            for (k, w) in self.fit.influences[self.points[v as usize] as usize].iter() {
                carried[k] += b * w;
            }
        }
        for c in &mut carried {
            *c = -c.abs();
        }
        let mut candidates = smallest(&carried, count);
        let first = candidates[0];
        candidates.retain(|&k| k == first || carried[k] < 0.0);
        candidates
    }

    /// Where the row is in the sample's frames, the root's motion taken out.
    fn path(&self, row: &SparseRow, out: &mut Vec<f32>) {
        out.clear();
        out.resize(3 * self.fit.sample.len(), 0.0);
        for (&v, &b) in row.indices.iter().zip(&row.values) {
            let b = b as f32;
            let path = self.fit.sample.point(self.points[v as usize] as usize);
            for (o, q) in out.iter_mut().zip(path) {
                *o += b * q;
            }
        }
    }
}

fn refine_vertex(tracks: &Tracks, rest: DVec3, path: &[f32], candidates: &[usize], goal: Tolerance) -> Result<Influences> {
    let frames = path.len() / 3;
    let joints = JointPlanes::columns(tracks, candidates)?;
    let places: Vec<usize> = (0..candidates.len()).collect();
    let mut scratch = WeightScratch::default();
    let mut logs = vec![0f64; frames];
    let mut best: Option<(f64, Influences)> = None;
    let unit = 1.0 / (goal.rms * goal.rms);
    for _ in 0..6 {
        let influences = scratch.solve(&joints, rest, path, &places, true);
        let squares = squares(&joints, rest, path, &influences);
        let worst = squares.iter().fold(0.0, |a: f64, &b| a.max(b));
        if best.as_ref().is_none_or(|(b, _)| worst < *b) {
            best = Some((worst, influences));
        }
        scratch.emphasis.clear();
        for (log, square) in logs.iter_mut().zip(&squares) {
            *log += 0.6 * (emphasis_target(square * unit) - *log);
            scratch.emphasis.push(emphasis_weight(*log).sqrt() as f32);
        }
    }
    let mut influences = best.map_or_else(Influences::default, |(_, influences)| influences);
    influences.joints = influences.joints.map(|place| candidates[place as usize] as u16);
    Ok(influences)
}

/// Squared error in each frame.
fn squares(joints: &JointPlanes, rest: DVec3, path: &[f32], influences: &Influences) -> Vec<f64> {
    let frames = path.len() / 3;
    let mut blend = vec![0f64; path.len()];
    let mut miss = vec![0f32; path.len()];
    for (k, w) in influences.iter() {
        joints.miss(k, rest, path, &mut miss);
        blend.iter_mut().zip(&miss).for_each(|(b, &m)| *b += w * f64::from(m));
    }
    (0..frames).map(|f| (0..3).map(|axis| blend[axis * frames + f].powi(2)).sum()).collect()
}

/// Places of the vertices whose worst error passes `bound`, worst first, at most `most`.
pub fn worst_vertices(errors: &[VertexError], bound: f64, most: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..errors.len()).filter(|&i| errors[i].worst_square > bound * bound).collect();
    order.sort_by(|&a, &b| errors[b].worst_square.total_cmp(&errors[a].worst_square).then(a.cmp(&b)));
    order.truncate(most);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_come_first_and_ties_keep_their_order() {
        let errors = [1.0, 4.0, 9.0, 4.0, 0.1].map(|worst_square| VertexError { worst_square, ..VertexError::default() });
        assert_eq!(worst_vertices(&errors, 1.0, 3), [2, 1, 3]);
    }
}
