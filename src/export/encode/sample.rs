//! Chosen frames in memory, laid out frame by frame within each point and joint, so that sums over frames run over neighbours.

use super::motion::{FitPoints, Motion};
use super::rigid::Rigid;
use super::tracks::Tracks;
use crate::error::Result;
use crate::linalg::lanes::for_each_instruction_set;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Positions of points in some frames.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The frames, ascending.
    pub frames: Vec<usize>,
    /// Per point: x in all frames, then y, then z.
    positions: Vec<f32>,
}

impl Sample {
    /// Reads the frames.
    pub fn read(motion: &Motion<'_>, points: &FitPoints, frames: Vec<usize>) -> Result<Self> {
        let count = frames.len();
        let mut positions = vec![0f32; points.len() * 3 * count];
        for (f, &frame) in frames.iter().enumerate() {
            motion.cancel.check()?;
            for (row, q) in positions.chunks_exact_mut(3 * count).zip(motion.frame(points, frame)?) {
                for axis in 0..3 {
                    row[axis * count + f] = q[axis] as f32;
                }
            }
        }
        Ok(Self { frames, positions })
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Number of points.
    pub fn points(&self) -> usize {
        self.positions.len() / (3 * self.len()).max(1)
    }

    /// One point: x in all frames, then y, then z.
    pub fn point(&self, point: usize) -> &[f32] {
        let width = 3 * self.len();
        &self.positions[point * width..(point + 1) * width]
    }

    /// All points in the `f`-th frame.
    pub fn pose(&self, f: usize) -> Vec<DVec3> {
        let m = self.len();
        let at = |row: &[f32]| DVec3::new(row[f].into(), row[m + f].into(), row[2 * m + f].into());
        self.positions.chunks_exact(3 * m).map(at).collect()
    }
}

/// Transforms of joints in the frames of a sample: per joint twelve rows of a 3 × 4 matrix, each over all frames.
#[derive(Clone, Debug, Default)]
pub struct JointPlanes {
    frames: usize,
    values: Vec<f32>,
}

impl JointPlanes {
    /// From transforms per joint and frame.
    pub fn new(frames: usize, joints: usize, at: impl Fn(usize, usize) -> Rigid) -> Self {
        let mut planes = Self { frames, values: vec![0.0; joints * 12 * frames] };
        for k in 0..joints {
            for f in 0..frames {
                planes.set(k, f, &at(k, f));
            }
        }
        planes
    }

    /// All joints in some frames.
    pub fn read(tracks: &Tracks, frames: &[usize]) -> Result<Self> {
        let motions = frames.iter().map(|&f| tracks.motions(f)).collect::<Result<Vec<_>>>()?;
        Ok(Self::new(frames.len(), tracks.joints(), |k, f| motions[f][k]))
    }

    /// Some joints in all frames.
    pub fn columns(tracks: &Tracks, joints: &[usize]) -> Result<Self> {
        let mut planes = Self { frames: tracks.frames(), values: vec![0.0; joints.len() * 12 * tracks.frames()] };
        for (k, &joint) in joints.iter().enumerate() {
            for (f, packed) in tracks.column(joint)?.iter().enumerate() {
                planes.set(k, f, &Rigid::unpack(packed));
            }
        }
        Ok(planes)
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.values.len() / (12 * self.frames)
    }

    /// Replaces a transform.
    pub fn set(&mut self, joint: usize, frame: usize, motion: &Rigid) {
        let m = self.frames;
        let rows = &mut self.values[joint * 12 * m..(joint + 1) * 12 * m];
        for axis in 0..3 {
            for column in 0..3 {
                rows[(axis * 4 + column) * m + frame] = motion.rotation.col(column)[axis] as f32;
            }
            rows[(axis * 4 + 3) * m + frame] = motion.translation[axis] as f32;
        }
    }

    /// A transform.
    pub fn get(&self, joint: usize, frame: usize) -> Rigid {
        let m = self.frames;
        let rows = &self.values[joint * 12 * m..(joint + 1) * 12 * m];
        let at = |axis: usize, column: usize| f64::from(rows[(axis * 4 + column) * m + frame]);
        let column = |c: usize| DVec3::new(at(0, c), at(1, c), at(2, c));
        Rigid { rotation: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
    }

    /// Some consecutive frames side by side: per joint the twelve rows; zero in lanes beyond the last frame.
    pub fn lanes<const W: usize>(&self, first: usize) -> Vec<[[f32; W]; 12]> {
        let count = W.min(self.frames - first);
        let rows: Vec<[f32; W]> = self
            .values
            .chunks_exact(self.frames)
            .map(|row| std::array::from_fn(|lane| if lane < count { row[first + lane] } else { 0.0 }))
            .collect();
        rows.as_chunks::<12>().0.to_vec()
    }

    /// Adds the joints of another table over the same frames.
    pub fn extend(&mut self, other: &Self) {
        self.values.extend_from_slice(&other.values);
    }

    /// How far a joint carries a point past its positions: `out` = x in all frames, then y, then z.
    pub fn miss(&self, joint: usize, rest: DVec3, positions: &[f32], out: &mut [f32]) {
        let m = self.frames;
        let p = rest.as_vec3();
        let joint_rows = self.values[joint * 12 * m..(joint + 1) * 12 * m].chunks_exact(4 * m);
        for ((rows, q), out) in joint_rows.zip(positions.chunks_exact(m)).zip(out.chunks_exact_mut(m)) {
            let (a, rest) = rows.split_at(m);
            let (b, rest) = rest.split_at(m);
            let (c, t) = rest.split_at(m);
            for f in 0..m {
                out[f] = a[f] * p.x + b[f] * p.y + c[f] * p.z + (t[f] - q[f]);
            }
        }
    }

    /// Sum over frames of the squared miss of every joint at a point.
    pub fn costs(&self, rest: DVec3, positions: &[f32], out: &mut Vec<f32>) {
        out.clear();
        out.resize(self.joints(), 0.0);
        add_costs(&self.values, self.frames, rest.as_vec3().to_array(), positions, out);
    }

    /// The joint of least cost for each point, with its cost.
    pub fn nearest_joints(&self, points: &[DVec3], sample: &Sample) -> Vec<(usize, f64)> {
        let nearest = |costs: &mut Vec<f32>, (i, &p): (usize, &DVec3)| {
            self.costs(p, sample.point(i), costs);
            let least = costs.iter().enumerate().fold((0, f32::INFINITY), |best, (k, &c)| if c < best.1 { (k, c) } else { best });
            (least.0, f64::from(least.1))
        };
        points.par_iter().enumerate().map_init(Vec::new, nearest).collect()
    }
}

/// Running sums of a scalar product: a fixed order that vectorises.
const SUMS: usize = 8;

for_each_instruction_set! {
    fn add_costs(values: &[f32], frames: usize, p: [f32; 3], positions: &[f32], out: &mut [f32]) {
        for (rows, cost) in values.chunks_exact(12 * frames).zip(out) {
            let mut sums = [0f32; SUMS];
            let mut tail = 0.0;
            for (rows, q) in rows.chunks_exact(4 * frames).zip(positions.chunks_exact(frames)) {
                let (a, rest) = rows.split_at(frames);
                let (b, rest) = rest.split_at(frames);
                let (c, t) = rest.split_at(frames);
                let whole = frames / SUMS * SUMS;
                for f in (0..whole).step_by(SUMS) {
                    let at = |row: &[f32], k: usize| row[f..f + SUMS][k];
                    for (k, sum) in sums.iter_mut().enumerate() {
                        let miss = at(a, k) * p[0] + at(b, k) * p[1] + at(c, k) * p[2] + (at(t, k) - at(q, k));
                        *sum += miss * miss;
                    }
                }
                for f in whole..frames {
                    let miss = a[f] * p[0] + b[f] * p[1] + c[f] * p[2] + (t[f] - q[f]);
                    tail += miss * miss;
                }
            }
            *cost = sums.iter().sum::<f32>() + tail;
        }
    }
}

for_each_instruction_set! {
    /// Scalar products of rows of so many numbers, row by row of the lower triangle.
    pub fn products(rows: &[f32], width: usize, out: &mut [f32]) {
        let mut out = out.iter_mut();
        for a in 0..rows.len() / width {
            for (b, product) in (0..=a).zip(&mut out) {
                let (x, x_tail) = rows[a * width..(a + 1) * width].as_chunks::<SUMS>();
                let (y, y_tail) = rows[b * width..(b + 1) * width].as_chunks::<SUMS>();
                let mut sums = [0f32; SUMS];
                for (x, y) in x.iter().zip(y) {
                    for (sum, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
                        *sum += x * y;
                    }
                }
                let tail: f32 = x_tail.iter().zip(y_tail).map(|(x, y)| x * y).sum();
                *product = sums.iter().sum::<f32>() + tail;
            }
        }
    }
}
