//! The map as Stoll et al. 2007 print it, and any other of one sparse row per scan vertex: in double precision since its coefficients are large.

use super::apply::{Avx2, Indices, Pool, chunks, pack};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::{RowSum, TetMaps};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows that are built before they are packed: all at once would take the memory twice.
const AT_ONCE: usize = 1 << 14;

/// See [`super::SurfaceMap`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct PaperMap {
    proxy_vertices: usize,
    starts: Vec<usize>,
    indices: Indices,
    values: Vec<f64>,
    #[serde(skip)]
    poses: Pool<f64>,
}

impl PaperMap {
    pub(super) fn build(proxy: &Proxy, points: &[DVec3]) -> Self {
        let maps = TetMaps::new(proxy);
        let n = proxy.rest.len();
        let mut map = Self::of_rows(n, []);
        let row = |sum: &mut RowSum, &point: &DVec3| {
            maps.row(point, sum);
            sum.take()
        };
        for points in points.chunks(AT_ONCE) {
            let rows: Vec<SparseRow> = points.par_iter().with_min_len(256).map_init(|| RowSum::new(n), row).collect();
            map.extend(rows);
        }
        map
    }

    pub(super) fn of_rows(proxy_vertices: usize, rows: impl IntoIterator<Item = SparseRow>) -> Self {
        let indices = Indices::new(proxy_vertices);
        let mut map = Self { proxy_vertices, starts: vec![0], indices, values: Vec::new(), poses: Pool::default() };
        map.extend(rows);
        map
    }

    fn extend(&mut self, rows: impl IntoIterator<Item = SparseRow>) {
        for row in rows {
            self.indices.extend(&row.indices);
            self.values.extend(row.values);
            self.starts.push(self.values.len());
        }
    }

    pub(super) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.starts[..]) + self.indices.bytes() + size_of_val(&self.values[..])
    }

    pub(super) fn row(&self, vertex: usize) -> SparseRow {
        let range = self.starts[vertex]..self.starts[vertex + 1];
        SparseRow { indices: range.clone().map(|k| self.indices.get(k) as u32).collect(), values: self.values[range].to_vec() }
    }

    pub(super) fn reads(&self, vertices: &[u32]) -> Vec<bool> {
        let mut reads = vec![false; self.proxy_vertices];
        for &v in vertices {
            (self.starts[v as usize]..self.starts[v as usize + 1]).for_each(|k| reads[self.indices.get(k)] = true);
        }
        reads
    }

    /// `W` lanes for at most `W` frames.
    pub(super) fn apply<const W: usize>(&self, avx2: Option<Avx2>, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        self.poses.with(self.proxy_vertices * 3 * W, |packed| {
            let packed = packed.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
            let origins = pack(poses, packed);
            match &self.indices {
                Indices::Narrow(indices) => self.map_vertices(avx2, indices, packed, &origins, out),
                Indices::Wide(indices) => self.map_vertices(avx2, indices, packed, &origins, out),
            }
        });
    }

    fn map_vertices<const W: usize, I: Copy + Into<u32> + Sync>(
        &self,
        avx2: Option<Avx2>,
        indices: &[I],
        packed: &[[[f64; W]; 3]],
        origins: &[[f32; W]; 3],
        out: &mut [Vec<[f32; 3]>],
    ) {
        chunks(out, &|first, out| {
            match avx2 {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor has AVX2.
                Some(Avx2 { .. }) => unsafe { multiply_avx2(self, indices, packed, origins, first, out) },
                _ => multiply(self, indices, packed, origins, first, out),
            }
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
        let sum = product(map, indices, packed, first + i);
        for (lane, frame) in out.iter_mut().enumerate() {
            if let Some(to) = frame.get_mut(i) {
                *to = [0, 1, 2].map(|axis| (sum[axis][lane] + f64::from(origins[axis][lane])) as f32);
            }
        }
    }
}

#[inline(always)]
fn product<const W: usize, I: Copy + Into<u32>>(
    map: &PaperMap,
    indices: &[I],
    packed: &[[[f64; W]; 3]],
    vertex: usize,
) -> [[f64; W]; 3] {
    let range = map.starts[vertex]..map.starts[vertex + 1];
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
    sum
}
