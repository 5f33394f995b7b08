//! What is written against the motion: every vertex, every frame.

use super::PointMap;
use super::morphs::Morphs;
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
    /// What is added to the positions at rest.
    pub morphs: &'a Morphs,
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
        self.each_batch(map, spool, frames, cancel, |batch| {
            errors.par_chunks_mut(PIECE).enumerate().for_each(|(piece, errors)| {
                for g in 0..batch.frames.len() {
                    for (k, error) in errors.iter_mut().enumerate() {
                        let i = piece * PIECE + k;
                        error.add(batch.frames[g], batch.miss(g, i, vertices[i]).length_squared());
                    }
                }
            });
            Ok(())
        })?;
        Ok(errors)
    }

    /// Frames with a vertex farther off than `bound`, with all vertices farther off than `floor` in them; where that are more than `most`
    /// vertices in all, the frames that are least off are left out.
    pub fn bad_frames(
        &self,
        map: &impl PointMap,
        vertices: &[u32],
        spool: &Spool,
        (floor, bound, most): (f64, f64, usize),
        cancel: &Cancel,
    ) -> Result<Vec<BadFrame>> {
        let all: Vec<usize> = (0..spool.frames()).collect();
        let mut found: Vec<BadFrame> = Vec::new();
        let mut total = 0;
        self.each_batch(map, spool, &all, cancel, |batch| {
            for g in 0..batch.frames.len() {
                let miss = |i: usize| {
                    let error = batch.miss(g, i, vertices[i]);
                    (error.length_squared() > floor * floor).then(|| Miss {
                        vertex: i as u32,
                        error,
                        linear: self.linear(i, &batch.matrices[g]),
                    })
                };
                let misses: Vec<Miss> = (0..vertices.len()).into_par_iter().with_min_len(PIECE).filter_map(miss).collect();
                let bad = BadFrame { frame: batch.frames[g], misses };
                if bad.worst() > bound {
                    total += bad.misses.len();
                    found.push(bad);
                }
                while total > most && found.len() > 1 {
                    let worst: Vec<f64> = found.iter().map(BadFrame::worst).collect();
                    let least = (0..worst.len()).fold(0, |b, i| if worst[i] < worst[b] { i } else { b });
                    total -= found.remove(least).misses.len();
                }
            }
            Ok(())
        })?;
        Ok(found)
    }

    /// Maps some frames at a time and gives them to `work` with what is needed to decode the file there.
    fn each_batch(
        &self,
        map: &impl PointMap,
        spool: &Spool,
        frames: &[usize],
        cancel: &Cancel,
        mut work: impl FnMut(&Decoding<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut truth: Vec<Vec<[f32; 3]>> = vec![Vec::new(); BATCH.min(frames.len())];
        for frames in frames.chunks(BATCH) {
            cancel.check()?;
            let poses = frames.iter().map(|&f| spool.read_one(f)).collect::<Result<Vec<_>>>()?;
            let poses: Vec<&[DVec3]> = poses.iter().map(Vec::as_slice).collect();
            map.apply(&poses, &mut truth[..frames.len()]);
            let matrices = frames.iter().map(|&f| self.flat_matrices(f)).collect::<Result<Vec<_>>>()?;
            let moved = frames.iter().map(|&f| self.morphs.apply(f, self.rest)).collect::<Result<Vec<_>>>()?;
            work(&Decoding { written: self, frames, truth: &truth, matrices, moved })?;
        }
        Ok(())
    }

    /// Errors of some vertices over all frames without morph targets, given by their places in the skin and their rows.
    pub fn measure_rows(&self, rows: &[(usize, SparseRow)], spool: &Spool, cancel: &Cancel) -> Result<Vec<VertexError>> {
        let mut errors = vec![VertexError::default(); rows.len()];
        super::motion::in_batches(spool, cancel, |first, poses| {
            let matrices = (first..first + poses.len()).map(|f| self.flat_matrices(f)).collect::<Result<Vec<_>>>()?;
            errors.par_iter_mut().zip(rows).for_each(|(error, (i, row))| {
                for (g, (pose, matrices)) in poses.iter().zip(&matrices).enumerate() {
                    let target = self.space.leave(row.apply(pose));
                    error.add(first + g, self.skinned(*i, self.at_rest(*i), matrices).distance_squared(target));
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

    /// Where a vertex is that is at `rest` before the joints move it.
    fn skinned(&self, i: usize, rest: DVec3, matrices: &[[f64; 12]]) -> DVec3 {
        let blend = self.blend(i, matrices);
        DMat3::from_cols_slice(&blend[..9]) * rest + DVec3::from_slice(&blend[9..])
    }

    /// How the joints turn what is added to a vertex at rest.
    fn linear(&self, i: usize, matrices: &[[f64; 12]]) -> DMat3 {
        DMat3::from_cols_slice(&self.blend(i, matrices)[..9])
    }

    fn blend(&self, i: usize, matrices: &[[f64; 12]]) -> [f64; 12] {
        let step = 1.0 / f64::from(self.skin.levels);
        let mut blend = [0.0; 12];
        for (&node, &weight) in self.skin.joints[i].iter().zip(&self.skin.weights[i]) {
            let weight = f64::from(weight) * step;
            for (sum, m) in blend.iter_mut().zip(&matrices[node as usize]) {
                *sum += weight * m;
            }
        }
        blend
    }

    fn at_rest(&self, i: usize) -> DVec3 {
        DVec3::from_array(self.rest[i].map(f64::from))
    }
}

/// Some frames with what it takes to decode them.
struct Decoding<'a> {
    written: &'a Written<'a>,
    frames: &'a [usize],
    truth: &'a [Vec<[f32; 3]>],
    matrices: Vec<Vec<[f64; 12]>>,
    /// Positions before the joints move them, where they are not those at rest.
    moved: Vec<Option<Vec<DVec3>>>,
}

impl Decoding<'_> {
    /// From the decoded vertex to where it should be, in the file's unit.
    fn miss(&self, g: usize, i: usize, in_map: u32) -> DVec3 {
        let [x, y, z] = self.truth[g][in_map as usize];
        let target = self.written.space.leave(DVec3::new(x.into(), y.into(), z.into()));
        let rest = self.moved[g].as_ref().map_or_else(|| self.written.at_rest(i), |moved| moved[i]);
        target - self.written.skinned(i, rest, &self.matrices[g])
    }
}

/// A frame with the vertices that are off in it, ascending.
#[derive(Clone, Debug)]
pub struct BadFrame {
    /// The frame.
    pub frame: usize,
    /// Its vertices.
    pub misses: Vec<Miss>,
}

impl BadFrame {
    /// The largest distance.
    pub fn worst(&self) -> f64 {
        self.misses.iter().fold(0.0, |a: f64, m| a.max(m.error.length_squared())).sqrt()
    }
}

/// A vertex that is off.
#[derive(Clone, Copy, Debug)]
pub struct Miss {
    /// Its place in the skin.
    pub vertex: u32,
    /// From where it is to where it should be, in the file's unit.
    pub error: DVec3,
    /// From what is added to it at rest to how much that moves it.
    pub linear: DMat3,
}
