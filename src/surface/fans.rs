//! Normals of several frames at once. Every normal vertex looks at the fan of corners around it, so nothing is scattered: any part of the surface can be
//! worked on by itself, and indices are read once for all frames.

use super::apply::{Avx2, Pool, chunks};
use super::{BATCH, NormalVertices};
use crate::scan::{Faces, Scan};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// What a vertex gets that no face with an area uses.
const WITHOUT_FACE: [f32; 3] = [0.0, 0.0, 1.0];

/// Vertices per parallel task.
const CHUNK: usize = 256;

/// Corners of a fan that are worked on together.
const AT_ONCE: usize = 8;

/// Normals whose lanes are then handed out to the frames together.
const GROUP: usize = 32;

/// The corners of a surface, sorted by normal vertex. Memory: about 75 bytes per vertex of a triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct Fans {
    vertices: usize,
    normals: usize,
    /// Scan vertices: the corner's, the next, the previous.
    triangles: Corners<3>,
    /// The corner's, the next, the opposite, the previous.
    quads: Corners<4>,
    /// The corner's, the next, the previous; then which of `polygons`.
    others: Corners<4>,
    /// Vertices of the faces with more corners.
    polygons: Faces,
    twins: Vec<[u32; 2]>,
    points: Pool<f32>,
    units: Pool<f32>,
}

/// Corners of one kind of face: normal vertex `v` has those from `starts[v]` to `starts[v + 1]`.
#[derive(Clone, Debug, Default)]
struct Corners<const K: usize> {
    starts: Vec<u32>,
    list: Vec<[u32; K]>,
}

impl<const K: usize> Corners<K> {
    /// From (normal vertex, corner) as they come.
    fn sorted(normals: usize, found: impl Iterator<Item = (u32, [u32; K])> + Clone) -> Self {
        let mut starts = vec![0_u32; normals + 1];
        found.clone().for_each(|(v, _)| starts[v as usize + 1] += 1);
        for v in 0..normals {
            starts[v + 1] += starts[v];
        }
        let mut next = starts.clone();
        let mut list = vec![[0; K]; starts[normals] as usize];
        for (v, corner) in found {
            list[next[v as usize] as usize] = corner;
            next[v as usize] += 1;
        }
        Self { starts, list }
    }

    #[inline(always)]
    fn of(&self, v: usize) -> &[[u32; K]] {
        &self.list[self.starts[v] as usize..self.starts[v + 1] as usize]
    }
}

impl Fans {
    /// The fans of a scan.
    pub fn new(scan: &Scan, normals: &NormalVertices) -> Self {
        let faces = &scan.mesh.faces;
        let count = normals.vertices.len();
        let of_size = |size: usize| (0..faces.len()).map(|f| faces.range(f)).filter(move |range| range.len() == size);
        // The corner `k` of a face and the ones after it.
        let around = |range: &std::ops::Range<usize>, k: usize| range.start + k % range.len();
        let vertex = |range: &std::ops::Range<usize>, k: usize| faces.corners[around(range, k)];
        let triangles = of_size(3).flat_map(|range| {
            (0..3).map(move |k| (normals.corners[range.start + k], [0, 1, 2].map(|step| vertex(&range, k + step))))
        });
        let quads = of_size(4).flat_map(|range| {
            (0..4).map(move |k| (normals.corners[range.start + k], [0, 1, 2, 3].map(|step| vertex(&range, k + step))))
        });
        let larger = || (0..faces.len()).map(|f| faces.range(f)).filter(|range| range.len() > 4);
        let others = larger().enumerate().flat_map(|(polygon, range)| {
            (0..range.len()).map(move |k| {
                let [own, next, previous] = [0, 1, range.len() - 1].map(|step| vertex(&range, k + step));
                (normals.corners[range.start + k], [own, next, previous, polygon as u32])
            })
        });
        let mut polygons = Faces::default();
        larger().for_each(|range| polygons.push(faces.corners[range].iter().copied()));
        Self {
            vertices: scan.mesh.positions.len(),
            normals: count,
            triangles: Corners::sorted(count, triangles),
            quads: Corners::sorted(count, quads),
            others: Corners::sorted(count, others),
            polygons,
            twins: normals.twins.clone(),
            points: Pool::default(),
            units: Pool::default(),
        }
    }

    /// Angle-weighted unit normals of up to eight frames; `out` is resized where needed, else nothing is allocated.
    ///
    /// Shapes: `frames`: ≤ 8 × scan vertices; `out`: as many × normal vertices. Polygons count as flat, with the normal of their area vector; faces
    /// without an area contribute nothing. A vertex without any such face gets +Z. The bits of a frame depend neither on the frames beside it nor on
    /// the number of threads nor on the vector instructions of the processor. Panics when the shapes differ.
    pub fn compute(&self, frames: &[&[[f32; 3]]], out: &mut [Vec<[f32; 3]>]) {
        assert!(frames.len() <= BATCH && frames.len() == out.len(), "{} frames, {} outputs", frames.len(), out.len());
        assert!(frames.iter().all(|f| f.len() == self.vertices), "one point per scan vertex");
        for normals in out.iter_mut() {
            normals.resize(self.normals, WITHOUT_FACE);
        }
        self.compute_with(Avx2::detect(), frames, out);
    }

    #[cfg(test)]
    pub(super) fn compute_with_baseline(&self, frames: &[&[[f32; 3]]], out: &mut [Vec<[f32; 3]>]) {
        for normals in out.iter_mut() {
            normals.resize(self.normals, WITHOUT_FACE);
        }
        self.compute_with(None, frames, out);
    }

    fn compute_with(&self, avx2: Option<Avx2>, frames: &[&[[f32; 3]]], out: &mut [Vec<[f32; 3]>]) {
        match frames.len() {
            0 => {}
            1 => self.lanes::<1>(avx2, frames, out),
            2..=4 => self.lanes::<4>(avx2, frames, out),
            _ => self.lanes::<BATCH>(avx2, frames, out),
        }
    }

    fn lanes<const W: usize>(&self, avx2: Option<Avx2>, frames: &[&[[f32; 3]]], out: &mut [Vec<[f32; 3]>]) {
        self.points.with(self.vertices * 3 * W, |points| {
            let points = points.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
            points.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, points)| side_by_side(frames, chunk * CHUNK, points));
            let points: &[Points<W>] = points;
            self.units.with(self.polygons.len() * 3 * W, |units| {
                let units = units.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
                for (unit, face) in units.iter_mut().zip(self.polygons.iter()) {
                    *unit = area_direction(face, points);
                }
                let fans = Posed { fans: self, points, units };
                chunks(out, &|first, out| match avx2 {
                    #[cfg(target_arch = "x86_64")]
                    // SAFETY: the processor has AVX2.
                    Some(Avx2 { .. }) => unsafe { normals_avx2(&fans, first, out) },
                    _ => fans.normals(first, out),
                });
            });
        });
        for normals in out {
            self.twins.iter().for_each(|&[vertex, first]| normals[vertex as usize] = normals[first as usize]);
        }
    }
}

/// A point or vector of each frame: axis by axis.
type Points<const W: usize> = [[f32; W]; 3];

/// Lanes without a frame repeat the last one.
fn side_by_side<const W: usize>(frames: &[&[[f32; 3]]], first: usize, points: &mut [Points<W>]) {
    for lane in 0..W {
        let frame = &frames[lane.min(frames.len() - 1)][first..];
        for (point, p) in points.iter_mut().zip(frame) {
            for axis in 0..3 {
                point[axis][lane] = p[axis];
            }
        }
    }
}

/// Fans with the points of some frames.
struct Posed<'a, const W: usize> {
    fans: &'a Fans,
    points: &'a [Points<W>],
    units: &'a [Points<W>],
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn normals_avx2<const W: usize>(posed: &Posed<'_, W>, first: usize, out: &mut [&mut [[f32; 3]]; W]) {
    posed.normals(first, out);
}

impl<const W: usize> Posed<'_, W> {
    #[inline(always)]
    fn normals(&self, first: usize, out: &mut [&mut [[f32; 3]]; W]) {
        let count = out[0].len();
        let mut group = [[[0.0f32; W]; 3]; GROUP];
        let mut scratch = Scratch::new();
        for begin in (0..count).step_by(GROUP) {
            let end = count.min(begin + GROUP);
            for (v, normal) in (first + begin..first + end).zip(&mut group) {
                self.normal(v, &mut scratch, normal);
            }
            finish(&mut group[..end - begin]);
            for (lane, frame) in out.iter_mut().enumerate() {
                for (to, normal) in frame.get_mut(begin..end).into_iter().flatten().zip(&group) {
                    *to = [normal[0][lane], normal[1][lane], normal[2][lane]];
                }
            }
        }
    }

    #[inline(always)]
    fn normal(&self, v: usize, scratch: &mut Scratch<W>, normal: &mut Points<W>) {
        let at = |v: u32| &self.points[v as usize];
        let mut sum = [[0.0f32; W]; 3];
        for corners in self.fans.triangles.of(v).chunks(AT_ONCE) {
            let count = corners.len();
            let Scratch { turns, squares, along, counts } = &mut *scratch;
            for (k, &[own, next, previous]) in corners.iter().enumerate() {
                let (to, from) = (minus(at(next), at(own)), minus(at(previous), at(own)));
                turns[k] = cross(&to, &from);
                squares[k] = dot(&turns[k], &turns[k]);
                along[k] = dot(&to, &from);
            }
            // Over all corners and lanes in one loop of unknown length: only such a loop becomes vector instructions, choices included.
            let (weights, counts) = (&mut squares[..count], &mut counts[..count]);
            let lanes = weights.as_flattened_mut().iter_mut().zip(along[..count].as_flattened());
            for ((weight, along), counts) in lanes.zip(counts.as_flattened_mut()) {
                let area = weight.sqrt();
                *weight = angle(area, *along) / area;
                *counts = if has_size(area) { u32::MAX } else { 0 };
            }
            for ((turn, weight), counts) in turns.iter().zip(weights.iter()).zip(counts.iter()) {
                for axis in 0..3 {
                    for lane in 0..W {
                        sum[axis][lane] += masked(turn[axis][lane] * weight[lane], counts[lane]);
                    }
                }
            }
        }
        for &[own, next, opposite, previous] in self.fans.quads.of(v) {
            let (to, from) = (minus(at(next), at(own)), minus(at(previous), at(own)));
            let area = cross(&minus(at(opposite), at(own)), &minus(at(previous), at(next)));
            add_corner(&mut sum, &to, &from, &unit(&area));
        }
        for &[own, next, previous, polygon] in self.fans.others.of(v) {
            let (to, from) = (minus(at(next), at(own)), minus(at(previous), at(own)));
            add_corner(&mut sum, &to, &from, &self.units[polygon as usize]);
        }
        *normal = sum;
    }
}

/// What is known of some corners of a fan: the cross product of their edges, its square, then the weight, the edges' scalar product, and whether they count.
struct Scratch<const W: usize> {
    turns: [Points<W>; AT_ONCE],
    squares: [[f32; W]; AT_ONCE],
    along: [[f32; W]; AT_ONCE],
    counts: [[u32; W]; AT_ONCE],
}

impl<const W: usize> Scratch<W> {
    #[inline(always)]
    fn new() -> Self {
        let zeros = [[0.0; W]; AT_ONCE];
        Self { turns: [[[0.0; W]; 3]; AT_ONCE], squares: zeros, along: zeros, counts: [[0; W]; AT_ONCE] }
    }
}

/// Brings vectors to unit length, cancelled and missing ones alike to what a vertex without a face has.
#[inline(always)]
fn finish<const W: usize>(normals: &mut [Points<W>]) {
    let (mut lengths, mut whole) = ([[0.0f32; W]; GROUP], [[0_u32; W]; GROUP]);
    let count = normals.len();
    for (square, normal) in lengths.iter_mut().zip(normals.iter()) {
        *square = dot(normal, normal);
    }
    for (length, whole) in lengths[..count].as_flattened_mut().iter_mut().zip(whole[..count].as_flattened_mut()) {
        *length = length.sqrt();
        *whole = if (*length > 1e-12) & (*length < f32::INFINITY) { u32::MAX } else { 0 };
    }
    for ((normal, length), whole) in normals.iter_mut().zip(&lengths).zip(&whole) {
        for axis in 0..3 {
            for lane in 0..W {
                let unit = normal[axis][lane] / length[lane];
                normal[axis][lane] = masked(unit, whole[lane]) + masked(WITHOUT_FACE[axis], !whole[lane]);
            }
        }
    }
}

/// The number where the mask is all ones, zero where it is zero: a choice that stays one instruction.
#[inline(always)]
fn masked(x: f32, mask: u32) -> f32 {
    f32::from_bits(x.to_bits() & mask)
}

/// Adds the unit normal of a polygon times its inner angle; nothing where it has none.
#[inline(always)]
fn add_corner<const W: usize>(sum: &mut Points<W>, to: &Points<W>, from: &Points<W>, unit: &Points<W>) {
    let turn = cross(to, from);
    let (square, along, side) = (dot(&turn, &turn), dot(to, from), dot(&turn, unit));
    for lane in 0..W {
        let inner = angle(square[lane].sqrt(), along[lane]);
        // Beyond half a turn at a concave corner.
        let inner = if side[lane] < 0.0 { 2.0 * PI - inner } else { inner };
        for axis in 0..3 {
            sum[axis][lane] += unit[axis][lane] * inner;
        }
    }
}

/// Newell's area vector, from the first corner, at unit length.
fn area_direction<const W: usize>(face: &[u32], points: &[Points<W>]) -> Points<W> {
    let at = |k: usize| &points[face[k] as usize];
    let mut area = [[0.0f32; W]; 3];
    for k in 1..face.len() - 1 {
        let part = cross(&minus(at(k), at(0)), &minus(at(k + 1), at(0)));
        for axis in 0..3 {
            for lane in 0..W {
                area[axis][lane] += part[axis][lane];
            }
        }
    }
    unit(&area)
}

/// Zero where there is no direction.
#[inline(always)]
fn unit<const W: usize>(v: &Points<W>) -> Points<W> {
    let square = dot(v, v);
    let mut out = [[0.0f32; W]; 3];
    for lane in 0..W {
        let length = square[lane].sqrt();
        for axis in 0..3 {
            out[axis][lane] = if has_size(length) { v[axis][lane] / length } else { 0.0 };
        }
    }
    out
}

#[inline(always)]
fn has_size(x: f32) -> bool {
    (x > 0.0) & (x < f32::INFINITY)
}

/// atan2 for `y` ≥ 0 to 1e-5, in plain arithmetic: vector lanes, and the same bits on every machine. 0 where both are 0.
#[inline(always)]
pub(super) fn angle(y: f32, x: f32) -> f32 {
    let across = x.abs();
    let (small, large) = if y < across { (y, across) } else { (across, y) };
    let t = if large > 0.0 { small / large } else { 0.0 };
    let s = t * t;
    let mut p = -0.011_721_2;
    for c in [0.052_653_32, -0.116_432_87, 0.193_543_46, -0.332_623_47, 0.999_977_26] {
        p = p * s + c;
    }
    let first = p * t;
    let quarter = if y > across { FRAC_PI_2 - first } else { first };
    if x < 0.0 { PI - quarter } else { quarter }
}

#[inline(always)]
fn minus<const W: usize>(a: &Points<W>, b: &Points<W>) -> Points<W> {
    let mut out = [[0.0f32; W]; 3];
    for axis in 0..3 {
        for lane in 0..W {
            out[axis][lane] = a[axis][lane] - b[axis][lane];
        }
    }
    out
}

#[inline(always)]
fn cross<const W: usize>(a: &Points<W>, b: &Points<W>) -> Points<W> {
    let mut out = [[0.0f32; W]; 3];
    for (axis, out) in out.iter_mut().enumerate() {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        for lane in 0..W {
            out[lane] = a[i][lane] * b[j][lane] - a[j][lane] * b[i][lane];
        }
    }
    out
}

#[inline(always)]
fn dot<const W: usize>(a: &Points<W>, b: &Points<W>) -> [f32; W] {
    let mut out = [0.0f32; W];
    for lane in 0..W {
        out[lane] = a[0][lane] * b[0][lane] + a[1][lane] * b[1][lane] + a[2][lane] * b[2][lane];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_is_right_to_1e_5() {
        let worst = (0..=100_000)
            .map(|k| std::f64::consts::PI * f64::from(k) / 100_000.0)
            .map(|a| (f64::from(angle(a.sin().max(0.0) as f32 * 3.0, a.cos() as f32 * 3.0)) - a).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1.3e-5, "{worst}");
        assert_eq!(angle(0.0, 0.0), 0.0);
    }
}
