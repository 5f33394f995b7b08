//! What is written against the motion: every vertex, every frame.

use super::PointMap;
use super::morphs::Morphs;
use super::skin::{FileSpace, Matrix, Skin};
use super::spool::Spool;
use crate::error::Result;
use crate::export::Cancel;
use crate::linalg::SparseRow;
use crate::linalg::lanes::for_each_instruction_set;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Frames that are mapped at a time: what the map takes in one call.
const BATCH: usize = 8;
/// Vertices of one piece of work.
const PIECE: usize = 2048;
/// Frames that are decoded side by side.
const LANES: usize = 4;

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
    #[inline(always)]
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
            for first in (0..batch.frames.len()).step_by(LANES) {
                let lanes = Lanes::new(batch, first);
                errors.par_chunks_mut(PIECE).enumerate().for_each(|(piece, errors)| {
                    let begin = piece * PIECE;
                    add_errors(&lanes, begin, &vertices[begin..begin + errors.len()], errors);
                });
            }
            Ok(())
        })?;
        Ok(errors)
    }

    /// Those of the given frames with a vertex farther off than `bound`, with all vertices farther off than `floor` in them; where that are more
    /// than `most` vertices in all, the frames that are least off are left out.
    pub fn bad_frames(
        &self,
        map: &impl PointMap,
        vertices: &[u32],
        spool: &Spool,
        frames: &[usize],
        (floor, bound, most): (f64, f64, usize),
        cancel: &Cancel,
    ) -> Result<Vec<BadFrame>> {
        let mut found: Vec<BadFrame> = Vec::new();
        let mut total = 0;
        self.each_batch(map, spool, frames, cancel, |batch| {
            for first in (0..batch.frames.len()).step_by(LANES) {
                let lanes = Lanes::new(batch, first);
                let far: Vec<Vec<(usize, usize)>> = vertices
                    .par_chunks(PIECE)
                    .enumerate()
                    .map(|(piece, vertices)| far_vertices(&lanes, piece * PIECE, vertices, floor * floor))
                    .collect();
                for lane in 0..lanes.frames.len() {
                    let g = first + lane;
                    let of_frame = far.iter().flatten().filter(|(l, _)| *l == lane).map(|(_, i)| *i);
                    let misses = of_frame.map(|i| Miss {
                        vertex: i as u32,
                        error: batch.miss(g, i, vertices[i]),
                        linear: self.linear(i, &batch.matrices[g]),
                    });
                    let bad = BadFrame { frame: batch.frames[g], misses: misses.collect() };
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
        self.each_path(rows, &mut errors, spool, cancel, VertexError::add)?;
        Ok(errors)
    }

    /// Frames in which one of some vertices is farther off than `bound` without morph targets.
    pub fn frames_over(&self, rows: &[(usize, SparseRow)], bound: f64, spool: &Spool, cancel: &Cancel) -> Result<Vec<usize>> {
        let mut over = vec![Vec::new(); rows.len()];
        self.each_path(rows, &mut over, spool, cancel, |over: &mut Vec<usize>, frame, square| {
            if square > bound * bound {
                over.push(frame);
            }
        })?;
        Ok(over.into_iter().flatten().collect::<BTreeSet<usize>>().into_iter().collect())
    }

    /// Tells `add` the squared distance of some vertices in every frame, each with a value of its own.
    fn each_path<T: Send>(
        &self,
        rows: &[(usize, SparseRow)],
        values: &mut [T],
        spool: &Spool,
        cancel: &Cancel,
        add: impl Fn(&mut T, usize, f64) + Sync,
    ) -> Result<()> {
        super::motion::in_batches(spool, cancel, |first, poses| {
            let matrices = (first..first + poses.len()).map(|f| self.flat_matrices(f)).collect::<Result<Vec<_>>>()?;
            values.par_iter_mut().zip(rows).for_each(|(value, (i, row))| {
                for (g, (pose, matrices)) in poses.iter().zip(&matrices).enumerate() {
                    let target = self.space.leave(row.apply(pose));
                    add(value, first + g, self.skinned(*i, self.at_rest(*i), matrices).distance_squared(target));
                }
            });
            Ok(())
        })
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

/// Some frames side by side: the same vertex is decoded in all of them at once. Lanes beyond the last frame repeat it.
struct Lanes<'a> {
    written: &'a Written<'a>,
    frames: &'a [usize],
    truth: [&'a [[f32; 3]]; LANES],
    /// Positions before the joints move them, if they are not those at rest in one of the frames.
    moved: Option<[Option<&'a [DVec3]>; LANES]>,
    /// Per node nine numbers of the linear part by columns, then the offset.
    matrices: Vec<[[f64; LANES]; 12]>,
}

impl<'a> Lanes<'a> {
    fn new(batch: &'a Decoding<'a>, first: usize) -> Self {
        let frames = &batch.frames[first..batch.frames.len().min(first + LANES)];
        let places: [usize; LANES] = std::array::from_fn(|lane| first + lane.min(frames.len() - 1));
        let nodes = places.map(|g| &batch.matrices[g]);
        let moved = places.map(|g| batch.moved[g].as_deref());
        Self {
            written: batch.written,
            frames,
            truth: places.map(|g| &batch.truth[g][..]),
            moved: moved.iter().any(Option::is_some).then_some(moved),
            matrices: (0..nodes[0].len()).map(|k| std::array::from_fn(|x| nodes.map(|n| n[k][x]))).collect(),
        }
    }

    /// Squared distances of a vertex from where it should be, in the file's unit.
    #[inline(always)]
    fn squares(&self, i: usize, in_map: u32) -> [f64; LANES] {
        let Written { skin, rest, space, .. } = *self.written;
        let step = 1.0 / f64::from(skin.levels);
        let mut blend = [[0.0; LANES]; 12];
        for (&node, &weight) in skin.joints[i].iter().zip(&skin.weights[i]) {
            let weight = f64::from(weight) * step;
            for (sum, m) in blend.iter_mut().zip(&self.matrices[usize::from(node)]) {
                for lane in 0..LANES {
                    sum[lane] += weight * m[lane];
                }
            }
        }
        let [x, y, z] = rest[i];
        let mut at_rest = [[f64::from(x); LANES], [f64::from(y); LANES], [f64::from(z); LANES]];
        if let Some(moved) = &self.moved {
            for (lane, moved) in moved.iter().enumerate() {
                if let Some(moved) = moved {
                    (0..3).for_each(|axis| at_rest[axis][lane] = moved[i][axis]);
                }
            }
        }
        let mut target = [[0.0; LANES]; 3];
        for (lane, points) in self.truth.iter().enumerate() {
            let point = &points[in_map as usize];
            (0..3).for_each(|axis| target[axis][lane] = f64::from(point[axis]));
        }
        let mut squares = [0.0; LANES];
        for axis in 0..3 {
            for lane in 0..LANES {
                let turned = blend[axis][lane] * at_rest[0][lane]
                    + blend[3 + axis][lane] * at_rest[1][lane]
                    + blend[6 + axis][lane] * at_rest[2][lane];
                let miss = target[axis][lane] * space.scale + space.shift[axis] - (turned + blend[9 + axis][lane]);
                squares[lane] += miss * miss;
            }
        }
        squares
    }
}

for_each_instruction_set! {
    /// Adds what consecutive vertices of the skin are off; `first` is the first of them, `vertices` are their indices in the map.
    fn add_errors(lanes: &Lanes<'_>, first: usize, vertices: &[u32], errors: &mut [VertexError]) {
        for (k, (error, &in_map)) in errors.iter_mut().zip(vertices).enumerate() {
            let squares = lanes.squares(first + k, in_map);
            for (&frame, &square) in lanes.frames.iter().zip(&squares) {
                error.add(frame, square);
            }
        }
    }
}

for_each_instruction_set! {
    /// Lanes and places of consecutive vertices of the skin whose squared distance passes `bound`, ascending in the vertices.
    fn far_vertices(lanes: &Lanes<'_>, first: usize, vertices: &[u32], bound: f64) -> Vec<(usize, usize)> {
        let mut far = Vec::new();
        for (i, &in_map) in (first..).zip(vertices) {
            let squares = lanes.squares(i, in_map);
            for (lane, &square) in squares[..lanes.frames.len()].iter().enumerate() {
                if square > bound {
                    far.push((lane, i));
                }
            }
        }
        far
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
