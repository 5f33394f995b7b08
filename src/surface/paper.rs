//! The map as Stoll et al. 2007 print it: one sparse row per scan vertex, in double precision since its coefficients are large.

use super::apply::{Indices, Pool, chunks, pack};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::{RowSum, TetMaps};
use glam::DVec3;
use rayon::prelude::*;

/// See [`super::SurfaceMap`].
#[derive(Clone, Debug)]
pub(super) struct PaperMap {
    proxy_vertices: usize,
    starts: Vec<usize>,
    indices: Indices,
    values: Vec<f64>,
    poses: Pool<f64>,
}

impl PaperMap {
    pub(super) fn build(proxy: &Proxy, points: &[DVec3]) -> Self {
        let maps = TetMaps::new(proxy);
        let n = proxy.rest.len();
        let rows: Vec<SparseRow> = points
            .par_iter()
            .with_min_len(256)
            .map_init(
                || RowSum::new(n),
                |sum, &point| {
                    maps.row(point, sum);
                    sum.take()
                },
            )
            .collect();
        let mut starts = vec![0];
        let (mut indices, mut values) = (Vec::new(), Vec::new());
        for row in rows {
            indices.extend(row.indices);
            values.extend(row.values);
            starts.push(values.len());
        }
        Self { proxy_vertices: n, starts, indices: Indices::new(indices, n), values, poses: Pool::default() }
    }

    pub(super) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    pub(super) fn row(&self, vertex: usize) -> SparseRow {
        let range = self.starts[vertex]..self.starts[vertex + 1];
        SparseRow { indices: range.clone().map(|k| self.indices.get(k) as u32).collect(), values: self.values[range].to_vec() }
    }

    /// `W` lanes for at most `W` frames.
    pub(super) fn apply<const W: usize>(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        self.poses.with(self.proxy_vertices * 3 * W, |packed| {
            let packed = packed.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
            let origins = pack(poses, packed);
            match &self.indices {
                Indices::Narrow(indices) => self.map_vertices(indices, packed, &origins, out),
                Indices::Wide(indices) => self.map_vertices(indices, packed, &origins, out),
            }
        });
    }

    fn map_vertices<const W: usize, I: Copy + Into<u32> + Sync>(
        &self,
        indices: &[I],
        packed: &[[[f64; W]; 3]],
        origins: &[[f32; W]; 3],
        out: &mut [Vec<[f32; 3]>],
    ) {
        chunks(out, &|first, out| {
            #[cfg(target_arch = "x86_64")]
            if super::apply::has_avx2() {
                // SAFETY: the processor has AVX2.
                unsafe { multiply_avx2(self, indices, packed, origins, first, out) };
                return;
            }
            multiply(self, indices, packed, origins, first, out);
        });
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn multiply_avx2<const W: usize, I: Copy + Into<u32>>(
    map: &PaperMap,
    indices: &[I],
    packed: &[[[f64; W]; 3]],
    origins: &[[f32; W]; 3],
    first: usize,
    out: &mut [&mut [[f32; 3]]; W],
) {
    multiply(map, indices, packed, origins, first, out);
}

#[inline(always)]
fn multiply<const W: usize, I: Copy + Into<u32>>(
    map: &PaperMap,
    indices: &[I],
    packed: &[[[f64; W]; 3]],
    origins: &[[f32; W]; 3],
    first: usize,
    out: &mut [&mut [[f32; 3]]; W],
) {
    for i in 0..out[0].len() {
        let range = map.starts[first + i]..map.starts[first + i + 1];
        let mut sum = [[0.0f64; W]; 3];
        for (&vertex, &value) in indices[range.clone()].iter().zip(&map.values[range]) {
            let vertex: u32 = vertex.into();
            let p = &packed[vertex as usize];
            for axis in 0..3 {
                for lane in 0..W {
                    sum[axis][lane] += value * p[axis][lane];
                }
            }
        }
        for (lane, frame) in out.iter_mut().enumerate() {
            if let Some(to) = frame.get_mut(i) {
                *to = [0, 1, 2].map(|axis| (sum[axis][lane] + f64::from(origins[axis][lane])) as f32);
            }
        }
    }
}
