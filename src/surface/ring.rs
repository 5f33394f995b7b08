//! The map by faces: pairs (face, weight) per scan vertex, one affine map per face and pose.

mod sheets;
mod weights;

use super::Apart;
use super::apply::{Avx2, Indices, Pool, chunks, pack};
use super::pieces::loose_pieces;
use super::side::{GROUP, Side, hand_out};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::{RingMaps, RowSum};
use crate::scan::Faces;
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Faces per parallel task.
const FACES: usize = 256;

/// See [`super::SurfaceMap`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct RingMap {
    maps: RingMaps,
    boundary: Vec<[u32; 3]>,
    proxy_vertices: usize,
    points: Vec<[f32; 3]>,
    pairs: Pairs,
    #[serde(skip)]
    poses: Pool<f64>,
    #[serde(skip)]
    affine: Pool<f32>,
}

/// Weights of faces: vertex `v` has the entries `starts[v]..starts[v + 1]`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Pairs {
    starts: Vec<u32>,
    faces: Indices,
    weights: Vec<f32>,
}

impl RingMap {
    pub(super) fn build(proxy: &Proxy, points: &[DVec3], faces: Option<&Faces>, apart: Option<&Apart>) -> Self {
        let maps = RingMaps::new(proxy);
        let mut feet = apart.map_or_else(|| weights::feet(proxy, points), |apart| weights::feet_apart(proxy, points, apart));
        if let Some(faces) = faces {
            sheets::keep_to_own_part(proxy, maps.centres(), points, faces, &mut feet);
            for piece in loose_pieces(points, faces, |v| feet[v].distance) {
                let nearest = piece.iter().map(|&v| feet[v as usize]).reduce(|a, b| if b.distance < a.distance { b } else { a });
                let Some(nearest) = nearest else { continue };
                piece.iter().for_each(|&v| feet[v as usize] = nearest);
            }
        }
        Self {
            pairs: weights::pairs(proxy, maps.centres(), &feet),
            boundary: proxy.boundary.clone(),
            proxy_vertices: proxy.rest.len(),
            points: points.iter().map(|p| p.as_vec3().to_array()).collect(),
            maps,
            poses: Pool::default(),
            affine: Pool::default(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    pub(super) fn bytes(&self) -> usize {
        let Pairs { starts, faces, weights } = &self.pairs;
        size_of_val(&starts[..]) + faces.bytes() + size_of_val(&weights[..]) + size_of_val(&self.points[..])
    }

    pub(super) fn row(&self, vertex: usize) -> SparseRow {
        let point = DVec3::from_array(self.points[vertex].map(f64::from));
        let range = self.pairs.starts[vertex] as usize..self.pairs.starts[vertex + 1] as usize;
        let total: f64 = self.pairs.weights[range.clone()].iter().map(|&w| f64::from(w)).sum();
        let mut sum = RowSum::new(self.proxy_vertices);
        for k in range {
            let face = self.pairs.faces.get(k);
            let weight = f64::from(self.pairs.weights[k]) / total;
            self.boundary[face].iter().for_each(|&v| sum.add(v, weight / 3.0));
            self.maps.along(face, (point - self.maps.centres()[face]) * weight).for_each(|(v, c)| sum.add(v, c));
        }
        sum.take()
    }

    pub(super) fn reads(&self, vertices: &[u32]) -> Vec<bool> {
        let mut faces = vec![false; self.boundary.len()];
        for &v in vertices {
            let range = self.pairs.starts[v as usize] as usize..self.pairs.starts[v as usize + 1] as usize;
            range.for_each(|k| faces[self.pairs.faces.get(k)] = true);
        }
        let mut reads = vec![false; self.proxy_vertices];
        for face in (0..faces.len()).filter(|&face| faces[face]) {
            self.boundary[face].iter().chain(self.maps.ring(face).0).for_each(|&v| reads[v as usize] = true);
        }
        reads
    }

    /// `W` lanes for at most `W` frames.
    pub(super) fn apply<const W: usize>(&self, avx2: Option<Avx2>, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        self.affine.with(self.maps.len() * 12 * W, |affine| {
            let affine = affine.as_chunks_mut::<W>().0.as_chunks_mut::<12>().0;
            let origins = self.poses.with(self.proxy_vertices * 3 * W, |packed| {
                let packed = packed.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
                let origins = pack(poses, packed);
                self.face_maps(avx2, packed, affine);
                origins
            });
            match &self.pairs.faces {
                Indices::Narrow(faces) => self.map_vertices(avx2, faces, affine, &origins, out),
                Indices::Wide(faces) => self.map_vertices(avx2, faces, affine, &origins, out),
            }
        });
    }

    /// Affine map of each face: columns of A, then c′ − A c.
    fn face_maps<const W: usize>(&self, avx2: Option<Avx2>, packed: &[[[f64; W]; 3]], affine: &mut [[[f32; W]; 12]]) {
        affine.par_chunks_mut(FACES).enumerate().for_each(|(chunk, affine)| {
            let first = chunk * FACES;
            match avx2 {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor has AVX2.
                Some(Avx2 { .. }) => unsafe { face_maps_avx2(self, packed, first, affine) },
                _ => face_maps(self, packed, first, affine),
            }
        });
    }

    fn map_vertices<const W: usize, I: Copy + Into<u32> + Sync>(
        &self,
        avx2: Option<Avx2>,
        faces: &[I],
        affine: &[[[f32; W]; 12]],
        origins: &[[f32; W]; 3],
        out: &mut [Vec<[f32; 3]>],
    ) {
        chunks(out, &|first, out| {
            let blend = Blend { avx2, map: self, faces, affine, origins };
            match avx2 {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor has AVX2.
                Some(Avx2 { .. }) => unsafe { blend_avx2(&blend, first, out) },
                _ => blend.vertices(first, out),
            }
        });
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn face_maps_avx2<const W: usize>(map: &RingMap, packed: &[[[f64; W]; 3]], first: usize, affine: &mut [[[f32; W]; 12]]) {
    face_maps(map, packed, first, affine);
}

#[inline(always)]
fn face_maps<const W: usize>(map: &RingMap, packed: &[[[f64; W]; 3]], first: usize, affine: &mut [[[f32; W]; 12]]) {
    for (face, affine) in (first..).zip(affine) {
        let (vertices, gradients) = map.maps.ring(face);
        let corners = map.boundary[face].map(|v| &packed[v as usize]);
        let centre = map.maps.centres()[face];
        // The posed centre, from which the columns times the rest centre are taken off.
        let mut shift = [[0.0f64; W]; 3];
        for axis in 0..3 {
            for lane in 0..W {
                shift[axis][lane] = (corners[0][axis][lane] + corners[1][axis][lane] + corners[2][axis][lane]) / 3.0;
            }
        }
        for column in 0..3 {
            let mut sum = [[0.0f64; W]; 3];
            for (&v, gradient) in vertices.iter().zip(gradients) {
                let (p, g) = (&packed[v as usize], gradient[column]);
                for axis in 0..3 {
                    for lane in 0..W {
                        sum[axis][lane] += p[axis][lane] * g;
                    }
                }
            }
            for axis in 0..3 {
                for lane in 0..W {
                    shift[axis][lane] -= sum[axis][lane] * centre[column];
                    affine[3 * column + axis][lane] = sum[axis][lane] as f32;
                }
            }
        }
        for axis in 0..3 {
            for lane in 0..W {
                affine[9 + axis][lane] = shift[axis][lane] as f32;
            }
        }
    }
}

/// The inner loop over pairs.
struct Blend<'a, const W: usize, I> {
    avx2: Option<Avx2>,
    map: &'a RingMap,
    faces: &'a [I],
    affine: &'a [[[f32; W]; 12]],
    origins: &'a [[f32; W]; 3],
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn blend_avx2<const W: usize, I: Copy + Into<u32>>(blend: &Blend<'_, W, I>, first: usize, out: &mut [&mut [[f32; 3]]; W]) {
    blend.vertices(first, out);
}

impl<const W: usize, I: Copy + Into<u32>> Blend<'_, W, I> {
    #[inline(always)]
    fn vertices(&self, first: usize, out: &mut [&mut [[f32; 3]]; W]) {
        let count = out[0].len();
        let mut mapped: [Side<W>; GROUP] = [[[0.0; W]; 3]; GROUP];
        for begin in (0..count).step_by(GROUP) {
            let end = count.min(begin + GROUP);
            for (vertex, mapped) in (first + begin..first + end).zip(&mut mapped) {
                self.vertex(vertex, mapped);
            }
            hand_out(self.avx2, &mapped[..end - begin], begin, out);
        }
    }

    #[inline(always)]
    fn vertex(&self, vertex: usize, mapped: &mut Side<W>) {
        let Pairs { starts, weights, .. } = &self.map.pairs;
        let range = starts[vertex] as usize..starts[vertex + 1] as usize;
        let mut sum = [[0.0f32; W]; 12];
        for (&face, &weight) in self.faces[range.clone()].iter().zip(&weights[range]) {
            let face: u32 = face.into();
            let affine = &self.affine[face as usize];
            for k in 0..12 {
                for lane in 0..W {
                    sum[k][lane] += weight * affine[k][lane];
                }
            }
        }
        let [x, y, z] = self.map.points[vertex];
        for axis in 0..3 {
            for lane in 0..W {
                let turned = sum[axis][lane] * x + sum[3 + axis][lane] * y + sum[6 + axis][lane] * z;
                mapped[axis][lane] = turned + sum[9 + axis][lane] + self.origins[axis][lane];
            }
        }
    }
}
