//! What both kinds of map share when they are applied: lanes of frames, chunks of vertices, vector instructions, buffers that are kept.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::sync::Mutex;

/// Vertices per parallel task.
const CHUNK: usize = 1024;

/// Indices in the narrowest type that holds them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum Indices {
    Narrow(Vec<u16>),
    Wide(Vec<u32>),
}

impl Indices {
    /// None yet. `below`: larger than every index to come.
    pub(super) fn new(below: usize) -> Self {
        if below <= 1 << 16 { Indices::Narrow(Vec::new()) } else { Indices::Wide(Vec::new()) }
    }

    pub(super) fn extend(&mut self, more: &[u32]) {
        match self {
            Indices::Narrow(indices) => indices.extend(more.iter().map(|&i| i as u16)),
            Indices::Wide(indices) => indices.extend(more),
        }
    }

    pub(super) fn get(&self, k: usize) -> usize {
        match self {
            Indices::Narrow(indices) => indices[k] as usize,
            Indices::Wide(indices) => indices[k] as usize,
        }
    }
}

/// Buffers that outlive a call: one per caller that works at the same time.
#[derive(Debug)]
pub(super) struct Pool<T>(Mutex<Vec<Vec<T>>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::new(Vec::new()))
    }
}

impl<T> Clone for Pool<T> {
    /// Buffers are not shared: the clone starts without.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<T: Copy + Default> Pool<T> {
    /// Calls `work` with a buffer of `len` entries, of which nothing is known, that begins on a cache line.
    pub(super) fn with<R>(&self, len: usize, work: impl FnOnce(&mut [T]) -> R) -> R {
        let mut buffer = self.lock().pop().unwrap_or_default();
        let line = 64 / size_of::<T>();
        if buffer.len() < len + line {
            buffer.resize(len + line, T::default());
        }
        let skip = buffer.as_ptr().align_offset(64).min(line);
        let result = work(&mut buffer[skip..skip + len]);
        self.lock().push(buffer);
        result
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Vec<T>>> {
        // The list of buffers is whole at every moment, whatever another caller's panic interrupted.
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

/// Puts poses side by side: `packed[v][axis][frame]`, relative to the mean vertex of each pose, which is returned in single precision.
/// Lanes without a pose repeat the last one.
pub(super) fn pack<const W: usize>(poses: &[&[DVec3]], packed: &mut [[[f64; W]; 3]]) -> [[f32; W]; 3] {
    let mut origins = [[0.0f32; W]; 3];
    for lane in 0..W {
        let pose = poses[lane.min(poses.len() - 1)];
        assert_eq!(pose.len(), packed.len(), "the pose belongs to another proxy");
        let mean = (pose.iter().sum::<DVec3>() / pose.len() as f64).as_vec3();
        for axis in 0..3 {
            origins[axis][lane] = mean[axis];
        }
        for (entry, p) in packed.iter_mut().zip(pose) {
            let p = *p - mean.as_dvec3();
            entry[0][lane] = p.x;
            entry[1][lane] = p.y;
            entry[2][lane] = p.z;
        }
    }
    origins
}

/// Calls `work(first vertex, outputs)` for chunks of vertices in parallel; the outputs of lanes without a frame are empty.
pub(super) fn chunks<const W: usize>(out: &mut [Vec<[f32; 3]>], work: &(impl Fn(usize, &mut [&mut [[f32; 3]]; W]) + Sync)) {
    let vertices = out.first().map_or(0, Vec::len);
    let mut frames = out.iter_mut();
    let outputs = std::array::from_fn(|_| frames.next().map_or(&mut [][..], |v| &mut v[..]));
    halve(0, vertices, outputs, work);
}

fn halve<const W: usize>(
    first: usize,
    count: usize,
    mut out: [&mut [[f32; 3]]; W],
    work: &(impl Fn(usize, &mut [&mut [[f32; 3]]; W]) + Sync),
) {
    if count <= CHUNK {
        work(first, &mut out);
        return;
    }
    let left = (count / 2).next_multiple_of(CHUNK);
    let mut right: [&mut [[f32; 3]]; W] = std::array::from_fn(|_| &mut [][..]);
    for (out, right) in out.iter_mut().zip(&mut right) {
        let whole = std::mem::take(out);
        (*out, *right) = whole.split_at_mut(left.min(whole.len()));
    }
    rayon::join(|| halve(first, left, out, work), || halve(first + left, count - left, right, work));
}

/// Proof that the processor has AVX2. The kernels are plain loops, compiled once for any processor and once for these; they round alike,
/// since nothing is fused.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(());

impl Avx2 {
    pub(super) fn detect() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        return is_x86_feature_detected!("avx2").then_some(Self(()));
        #[cfg(not(target_arch = "x86_64"))]
        None
    }
}
