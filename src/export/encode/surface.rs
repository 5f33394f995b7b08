//! Weights of the scan's vertices. Carried over from the proxy they miss by several tolerances; solved anew on each vertex's own path they do not.

use super::blend::followed;
use super::fit::{Fit, WeightScratch, smallest};
use super::measure::VertexError;
use super::motion::Motion;
use super::sample::JointPlanes;
use super::select::{CANDIDATES, Gram};
use super::tracks::Tracks;
use super::{Influences, PointMap, Tolerance};
use crate::error::Result;
use crate::linalg::SparseRow;
use crate::linalg::lanes::for_each_instruction_set;
use glam::DVec3;
use rayon::prelude::*;

/// Candidates of an ordinary vertex: more bring nothing but time.
const FEW: usize = 6;
/// Pairs of them, each with itself too.
const PAIRS: usize = FEW * (FEW + 1) / 2;
/// A carried weight below this is rounding.
const NOTHING: f32 = 1e-6;
/// Poses that the map takes in one call.
const BATCH: usize = 8;
/// Vertices of one piece of work.
const PIECE: usize = 1024;
/// Numbers held while vertices are refitted on all frames.
const BUDGET: usize = 1 << 20;

/// Proxy vertices that some row of the map reads; the others are not seen in the result, and need no fit.
pub fn read_by_map(map: &impl PointMap, vertices: &[u32]) -> Vec<u32> {
    let reads = map.reads(vertices);
    (0..reads.len() as u32).filter(|&i| reads[i as usize]).collect()
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
    ///
    /// What is carried and where the vertices are comes from applications of the map, which cost far less than rows.
    pub fn solve(&self, vertices: &[u32], rest: &[DVec3]) -> Vec<Influences> {
        let candidates = self.carried(vertices);
        let products = self.products(vertices, rest, &candidates);
        let choose = |(candidates, products): (&Candidates, &[f32; PAIRS])| {
            let joints: Vec<usize> = candidates.joints().collect();
            Gram::new(joints.len(), products).choose(false).influences(&joints)
        };
        candidates.par_iter().zip(&products).map(choose).collect()
    }

    /// The joints with the largest carried weights: the map is applied to the proxy's weights, three joints at a time in place of x, y and z.
    fn carried(&self, vertices: &[u32]) -> Vec<Candidates> {
        let mut found = vec![Candidates::default(); vertices.len()];
        let joints: Vec<usize> = (0..self.fit.tracks.joints()).collect();
        for group in joints.chunks(3 * BATCH) {
            let mut fields = vec![vec![DVec3::ZERO; self.points.len()]; group.len().div_ceil(3)];
            for (&v, influences) in self.fit.points.vertices().iter().zip(&self.fit.influences) {
                for (k, w) in influences.iter().filter(|(k, _)| group.contains(k)) {
                    fields[(k - group[0]) / 3][v as usize][(k - group[0]) % 3] = w;
                }
            }
            let carried = self.mapped(&fields);
            found.par_iter_mut().zip(vertices).for_each(|(found, &v)| {
                let weights = carried.iter().flat_map(|field| field[v as usize]);
                group.iter().zip(weights).for_each(|(&k, w)| found.add(k as u16, w.abs()));
            });
        }
        found
    }

    /// Scalar products of the candidates' errors over the sample's frames, row by row of the lower triangle.
    fn products(&self, vertices: &[u32], rest: &[DVec3], candidates: &[Candidates]) -> Vec<[f32; PAIRS]> {
        let mut products = vec![[0f32; PAIRS]; vertices.len()];
        let sample = &self.fit.sample;
        for first in (0..sample.len()).step_by(BATCH) {
            let frames: Vec<usize> = (first..sample.len().min(first + BATCH)).collect();
            let mut poses = vec![vec![DVec3::ZERO; self.points.len()]; frames.len()];
            for (i, &v) in self.fit.points.vertices().iter().enumerate() {
                let path = sample.point(i);
                for (pose, &f) in poses.iter_mut().zip(&frames) {
                    pose[v as usize] = DVec3::from_array([0, 1, 2].map(|axis| path[axis * sample.len() + f].into()));
                }
            }
            let (mapped, joints) = (self.mapped(&poses), self.joints.lanes::<BATCH>(first));
            products.par_chunks_mut(PIECE).enumerate().for_each(|(piece, products)| {
                let range = piece * PIECE..piece * PIECE + products.len();
                add_products(&joints, &mapped, &vertices[range.clone()], rest, &candidates[range], products);
            });
        }
        products
    }

    fn mapped(&self, poses: &[Vec<DVec3>]) -> Vec<Vec<[f32; 3]>> {
        let mut out = vec![Vec::new(); poses.len()];
        self.map.apply(&poses.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut out);
        out
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
        let mut carried = vec![0f32; self.fit.tracks.joints()];
        for (&v, &b) in row.indices.iter().zip(&row.values) {
            for (k, w) in self.fit.influences[self.points[v as usize] as usize].iter() {
                carried[k] += (b * w) as f32;
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
}

/// The joints with the largest carried weights of a vertex, the largest first.
#[derive(Clone, Copy, Debug)]
struct Candidates {
    joints: [u16; FEW],
    /// 0 where there is none.
    weights: [f32; FEW],
}

impl Default for Candidates {
    fn default() -> Self {
        Self { joints: [0; FEW], weights: [0.0; FEW] }
    }
}

impl Candidates {
    fn add(&mut self, joint: u16, weight: f32) {
        if weight <= self.weights[FEW - 1].max(NOTHING) {
            return;
        }
        let place = self.weights.iter().position(|&w| weight > w).unwrap_or(FEW - 1);
        self.joints.copy_within(place..FEW - 1, place + 1);
        self.weights.copy_within(place..FEW - 1, place + 1);
        (self.joints[place], self.weights[place]) = (joint, weight);
    }

    /// At least one: the weights of a row sum to 1.
    fn joints(&self) -> impl Iterator<Item = usize> {
        self.joints.iter().zip(self.weights).enumerate().filter(|(k, (_, w))| *k == 0 || *w > 0.0).map(|(_, (&j, _))| j.into())
    }
}

for_each_instruction_set! {
    /// Adds the scalar products of a batch of frames for consecutive vertices.
    fn add_products(
        joints: &[[[f32; BATCH]; 12]],
        mapped: &[Vec<[f32; 3]>],
        vertices: &[u32],
        rest: &[DVec3],
        candidates: &[Candidates],
        products: &mut [[f32; PAIRS]],
    ) {
        for ((&v, candidates), products) in vertices.iter().zip(candidates).zip(products) {
            let p = rest[v as usize].as_vec3();
            // Lanes without a frame have joints of zero, and nothing to miss.
            let mut target = [[0f32; BATCH]; 3];
            for (lane, points) in mapped.iter().enumerate() {
                (0..3).for_each(|axis| target[axis][lane] = points[v as usize][axis]);
            }
            let mut misses = [[[0f32; BATCH]; 3]; FEW];
            let mut pair = 0;
            for (a, k) in candidates.joints().enumerate() {
                let joint = &joints[k];
                for axis in 0..3 {
                    for lane in 0..BATCH {
                        let turned = joint[4 * axis][lane] * p.x + joint[4 * axis + 1][lane] * p.y + joint[4 * axis + 2][lane] * p.z;
                        misses[a][axis][lane] = turned + (joint[4 * axis + 3][lane] - target[axis][lane]);
                    }
                }
                for b in 0..=a {
                    let mut sums = [0f32; BATCH];
                    for (x, y) in misses[a].iter().zip(&misses[b]) {
                        for lane in 0..BATCH {
                            sums[lane] += x[lane] * y[lane];
                        }
                    }
                    products[pair] += sums.iter().sum::<f32>();
                    pair += 1;
                }
            }
        }
    }
}

fn refine_vertex(tracks: &Tracks, rest: DVec3, path: &[f32], candidates: &[usize], goal: Tolerance) -> Result<Influences> {
    let frames = path.len() / 3;
    let joints = JointPlanes::columns(tracks, candidates)?;
    let places: Vec<usize> = (0..candidates.len()).collect();
    let mut scratch = WeightScratch::default();
    let mut logs = vec![0f32; frames];
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
            let weight;
            (*log, weight) = followed(*log, (square * unit) as f32, 0.6);
            scratch.emphasis.push(weight.sqrt());
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
    fn the_joints_with_the_largest_weights_are_kept_in_order() {
        let mut found = Candidates::default();
        let weights = [0.05, 0.3, 1e-7, 0.3, 0.01, 0.2, 0.1, 0.06, 0.02];
        weights.iter().enumerate().for_each(|(k, &w)| found.add(k as u16, w));
        assert_eq!(found.joints().collect::<Vec<_>>(), [1, 3, 5, 6, 7, 0]);
        let mut one = Candidates::default();
        one.add(9, 1.0);
        one.add(3, 1e-7);
        assert_eq!(one.joints().collect::<Vec<_>>(), [9]);
    }

    #[test]
    fn the_worst_come_first_and_ties_keep_their_order() {
        let errors = [1.0, 4.0, 9.0, 4.0, 0.1].map(|worst_square| VertexError { worst_square, ..VertexError::default() });
        assert_eq!(worst_vertices(&errors, 1.0, 3), [2, 1, 3]);
    }
}
