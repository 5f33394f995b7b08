//! The written skin against the motion: every vertex, every frame.

use super::PointMap;
use super::skin::{FileSpace, Matrix, Skin};
use super::spool::Spool;
use crate::error::Result;
use crate::export::Cancel;
use crate::linalg::SparseRow;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Frames that are mapped at a time: what the map takes in one call.
const BATCH: usize = 8;
/// Vertices of one piece of work.
const PIECE: usize = 2048;

/// Distance of one vertex from its motion, in the file's unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VertexError {
    /// Largest squared distance over the frames.
    pub worst_square: f64,
    /// Its first frame.
    pub frame: usize,
    /// Sum of squared distances over the frames.
    pub squares: f64,
}

impl VertexError {
    fn add(&mut self, frame: usize, square: f64) {
        self.squares += square;
        if square > self.worst_square {
            self.worst_square = square;
            self.frame = frame;
        }
    }
}

/// Errors of all vertices together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Distance at the worst vertex of the worst frame.
    pub worst: f64,
    /// Root mean square over vertices and frames.
    pub rms: f64,
    /// Index of the worst vertex.
    pub vertex: usize,
    /// Its frame.
    pub frame: usize,
}

/// Summary over vertices in their order.
pub fn summary(errors: &[VertexError], frames: usize) -> Summary {
    let worst = errors.iter().enumerate().fold(0, |b, (i, e)| if e.worst_square > errors[b].worst_square { i } else { b });
    let sum: f64 = errors.iter().map(|e| e.squares).sum();
    Summary {
        worst: errors.get(worst).map_or(0.0, |e| e.worst_square.sqrt()),
        rms: (sum / (errors.len() * frames).max(1) as f64).sqrt(),
        vertex: worst,
        frame: errors.get(worst).map_or(0, |e| e.frame),
    }
}

/// What is compared.
#[derive(Clone, Copy, Debug)]
pub struct Written<'a> {
    /// The skin as written.
    pub skin: &'a Skin,
    /// Positions of its vertices at rest, as written.
    pub rest: &'a [[f32; 3]],
    /// Between the motion's unit box and the file.
    pub space: FileSpace,
}

impl Written<'_> {
    /// Errors of all vertices over the given frames; `vertices` are their indices in the map.
    pub fn measure(
        &self,
        map: &impl PointMap,
        vertices: &[u32],
        spool: &Spool,
        frames: &[usize],
        cancel: &Cancel,
    ) -> Result<Vec<VertexError>> {
        let mut errors = vec![VertexError::default(); vertices.len()];
        let mut truth: Vec<Vec<[f32; 3]>> = vec![Vec::new(); BATCH.min(frames.len())];
        for frames in frames.chunks(BATCH) {
            cancel.check()?;
            let poses = frames.iter().map(|&f| spool.read_one(f)).collect::<Result<Vec<_>>>()?;
            let poses: Vec<&[DVec3]> = poses.iter().map(Vec::as_slice).collect();
            map.apply(&poses, &mut truth[..frames.len()]);
            let matrices = frames.iter().map(|&f| self.flat_matrices(f)).collect::<Result<Vec<_>>>()?;
            errors.par_chunks_mut(PIECE).enumerate().for_each(|(piece, errors)| {
                for ((&frame, matrices), truth) in frames.iter().zip(&matrices).zip(&truth) {
                    for (k, error) in errors.iter_mut().enumerate() {
                        let i = piece * PIECE + k;
                        let [x, y, z] = truth[vertices[i] as usize];
                        let target = self.space.leave(DVec3::new(x.into(), y.into(), z.into()));
                        error.add(frame, self.skinned(i, matrices).distance_squared(target));
                    }
                }
            });
        }
        Ok(errors)
    }

    /// Errors of some vertices over all frames, given by their places in the skin and their rows.
    pub fn measure_rows(&self, rows: &[(usize, SparseRow)], spool: &Spool, cancel: &Cancel) -> Result<Vec<VertexError>> {
        let mut errors = vec![VertexError::default(); rows.len()];
        super::motion::in_batches(spool, cancel, |first, poses| {
            let matrices = (first..first + poses.len()).map(|f| self.flat_matrices(f)).collect::<Result<Vec<_>>>()?;
            errors.par_iter_mut().zip(rows).for_each(|(error, (i, row))| {
                for (g, (pose, matrices)) in poses.iter().zip(&matrices).enumerate() {
                    let target = self.space.leave(row.apply(pose));
                    error.add(first + g, self.skinned(*i, matrices).distance_squared(target));
                }
            });
            Ok(())
        })?;
        Ok(errors)
    }

    fn flat_matrices(&self, frame: usize) -> Result<Vec<[f64; 12]>> {
        let flat = |m: &Matrix| {
            let mut flat = [0.0; 12];
            flat[..9].copy_from_slice(&m.linear.to_cols_array());
            flat[9..].copy_from_slice(&m.offset.to_array());
            flat
        };
        Ok(self.skin.matrices(frame)?.iter().map(flat).collect())
    }

    fn skinned(&self, i: usize, matrices: &[[f64; 12]]) -> DVec3 {
        let mut blend = [0.0; 12];
        for (&node, &weight) in self.skin.joints[i].iter().zip(&self.skin.weights[i]) {
            let weight = f64::from(weight) / 65535.0;
            for (sum, m) in blend.iter_mut().zip(&matrices[node as usize]) {
                *sum += weight * m;
            }
        }
        let [x, y, z] = self.rest[i].map(f64::from);
        let linear = DMat3::from_cols_slice(&blend[..9]);
        linear * DVec3::new(x, y, z) + DVec3::from_slice(&blend[9..])
    }
}
