//! Normals of several frames at once. Every normal vertex looks at the fan of corners around it, so nothing is scattered: any part of the surface can be
//! worked on by itself, and indices are read once for all frames.

use super::apply::{Avx2, Pool, chunks};
use super::side::{GROUP, Row, Side, Vector, cross, dot, gather, hand_out, minus, prefetch, vector};
use super::{BATCH, NormalVertices};
use crate::scan::{Faces, Scan};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// What a vertex gets that no face with an area uses.
const WITHOUT_FACE: [f32; 3] = [0.0, 0.0, 1.0];

/// Vertices per parallel task.
const CHUNK: usize = 256;

/// The points of a normal vertex are asked for while so many others are worked on.
const AHEAD: usize = 6;

/// The corners of a surface, sorted by normal vertex. Memory: about 48 bytes per vertex of a triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct Fans {
    vertices: usize,
    normals: usize,
    triangles: Rings,
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
    fn range(&self, v: usize) -> std::ops::Range<usize> {
        self.starts[v] as usize..self.starts[v + 1] as usize
    }

    #[inline(always)]
    fn of(&self, v: usize) -> &[[u32; K]] {
        &self.list[self.range(v)]
    }
}

/// Corners of triangles in the order in which they lie around their vertex, so that an edge between two of them is worked on once.
#[derive(Clone, Debug, Default)]
struct Rings {
    /// Normal vertex `v` has the rings from `of_normal[v]` to `of_normal[v + 1]`: one, where the surface is whole.
    of_normal: Vec<u32>,
    /// Ring `r` is `list[starts[r]..starts[r + 1]]`.
    starts: Vec<u32>,
    /// Scan vertices: the corners' own, then the other ends of their edges. A closed ring ends where it began.
    list: Vec<u32>,
}

impl Rings {
    /// From corners: their own vertex, the next and the previous.
    fn of(mut corners: Corners<3>) -> Self {
        let normals = corners.starts.len() - 1;
        let mut rings =
            Self { of_normal: Vec::with_capacity(normals + 1), starts: vec![0], list: Vec::with_capacity(normals * 8) };
        let (mut first, mut has_before) = (Vec::new(), Vec::new());
        for v in 0..normals {
            rings.of_normal.push(rings.starts.len() as u32 - 1);
            let range = corners.range(v);
            rings.add(&mut corners.list[range], &mut first, &mut has_before);
        }
        rings.of_normal.push(rings.starts.len() as u32 - 1);
        rings
    }

    /// The corners of one normal vertex, which are sorted. `first[k]`: where among those that begin with the edge of corner `k` the unused ones begin.
    fn add(&mut self, corners: &mut [[u32; 3]], first: &mut Vec<usize>, has_before: &mut Vec<bool>) {
        corners.sort_unstable();
        let corners = &*corners;
        let edge_of = |k: usize| [corners[k][0], corners[k][1]];
        let beginning_with = |edge: [u32; 2]| {
            let k = corners.partition_point(|c| [c[0], c[1]] < edge);
            (k < corners.len() && edge_of(k) == edge).then_some(k)
        };
        first.clear();
        first.extend(0..corners.len());
        has_before.clear();
        has_before.resize(corners.len(), false);
        corners.iter().filter_map(|c| beginning_with([c[0], c[2]])).for_each(|k| has_before[k] = true);
        // Of corners with the same first edge the first stands for all.
        let mut take = |edge: [u32; 2]| {
            let group = beginning_with(edge)?;
            let k = first[group];
            first[group] += 1;
            (k < corners.len() && edge_of(k) == edge).then_some(k)
        };
        let mut follow = |edge: [u32; 2]| {
            let Some(k) = take(edge) else { return false };
            self.list.extend(edge);
            let mut corner = corners[k];
            loop {
                self.list.push(corner[2]);
                let Some(k) = take([corner[0], corner[2]]) else { break };
                corner = corners[k];
            }
            self.starts.push(self.list.len() as u32);
            true
        };
        // Open rings from their ends, then what is left: closed ones.
        for k in (0..corners.len()).filter(|&k| !has_before[beginning_with(edge_of(k)).unwrap_or(k)]) {
            follow(edge_of(k));
        }
        for k in 0..corners.len() {
            while follow(edge_of(k)) {}
        }
    }

    /// Everything that a normal vertex reads; nothing beyond the last.
    #[inline(always)]
    fn of_normals(&self, v: usize) -> &[u32] {
        let Some(&[begin, end]) = self.of_normal.get(v..v + 2).and_then(<[u32]>::first_chunk) else { return &[] };
        &self.list[self.starts[begin as usize] as usize..self.starts[end as usize] as usize]
    }

    #[inline(always)]
    fn of_normal(&self, v: usize) -> impl Iterator<Item = &[u32]> {
        let rings = self.of_normal[v] as usize..self.of_normal[v + 1] as usize;
        rings.map(|r| &self.list[self.starts[r] as usize..self.starts[r + 1] as usize])
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
            triangles: Rings::of(Corners::sorted(count, triangles)),
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

    fn has_polygons(&self) -> bool {
        !(self.quads.list.is_empty() && self.others.list.is_empty())
    }

    fn lanes<const W: usize>(&self, avx2: Option<Avx2>, frames: &[&[[f32; 3]]], out: &mut [Vec<[f32; 3]>]) {
        self.points.with(self.vertices * 3 * W, |points| {
            let points = points.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
            points.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, points)| gather(avx2, frames, chunk * CHUNK, points));
            let points: &[Side<W>] = points;
            self.units.with(self.polygons.len() * 3 * W, |units| {
                let units = units.as_chunks_mut::<W>().0.as_chunks_mut::<3>().0;
                for (unit, face) in units.iter_mut().zip(self.polygons.iter()) {
                    *unit = area_direction(face, points).map(|row| row.0);
                }
                let fans = Posed { avx2, fans: self, points, units };
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

/// Fans with the points of some frames.
struct Posed<'a, const W: usize> {
    avx2: Option<Avx2>,
    fans: &'a Fans,
    points: &'a [Side<W>],
    units: &'a [Side<W>],
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
        let mut group: [Side<W>; GROUP] = [[[0.0; W]; 3]; GROUP];
        for begin in (0..count).step_by(GROUP) {
            let end = count.min(begin + GROUP);
            let group = &mut group[..end - begin];
            let vertices = first + begin..first + end;
            for (v, sum) in vertices.clone().zip(group.iter_mut()) {
                for &soon in self.fans.triangles.of_normals(v + AHEAD) {
                    prefetch(&self.points[soon as usize]);
                }
                *sum = self.of_triangles::<false>(v);
            }
            if group.as_flattened().as_flattened().iter().fold(0, |all, x| all | not_finite(*x)) != 0 {
                for (v, sum) in vertices.clone().zip(group.iter_mut()) {
                    self.without_placeless(v, sum);
                }
            }
            if self.fans.has_polygons() {
                for (v, sum) in vertices.zip(group.iter_mut()) {
                    self.add_polygons(v, sum);
                }
            }
            finish(group);
            hand_out(self.avx2, group, begin, out);
        }
    }

    #[inline(always)]
    fn at(&self, v: u32) -> Vector<W> {
        vector(&self.points[v as usize])
    }

    #[inline(always)]
    fn of_triangles<const CHOOSY: bool>(&self, v: usize) -> Side<W> {
        let mut sum = [Row::ZERO; 3];
        for ring in self.fans.triangles.of_normal(v) {
            self.add_ring::<CHOOSY>(ring, &mut sum);
        }
        sum.map(|row| row.0)
    }

    /// The sum again where a triangle has no place.
    #[cold]
    #[inline(never)]
    fn without_placeless(&self, v: usize, sum: &mut Side<W>) {
        *sum = self.of_triangles::<true>(v);
    }

    #[inline(always)]
    fn add_polygons(&self, v: usize, sum: &mut Side<W>) {
        let mut all = vector(sum);
        for &[own, next, opposite, previous] in self.fans.quads.of(v) {
            let [own, next, opposite, previous] = [own, next, opposite, previous].map(|v| self.at(v));
            let area = cross(minus(opposite, own), minus(previous, next));
            add_corner(&mut all, minus(next, own), minus(previous, own), unit(area));
        }
        for &[own, next, previous, polygon] in self.fans.others.of(v) {
            let [own, next, previous] = [own, next, previous].map(|v| self.at(v));
            add_corner(&mut all, minus(next, own), minus(previous, own), vector(&self.units[polygon as usize]));
        }
        *sum = all.map(|row| row.0);
    }

    /// Adds the unit normals of triangles times their angles: cross products of edges times θ / sin θ over the lengths. `CHOOSY`: but for
    /// triangles that have no place.
    #[inline(always)]
    fn add_ring<const CHOOSY: bool>(&self, ring: &[u32], sum: &mut Vector<W>) {
        let [own, first, others @ ..] = ring else { return };
        let own = self.at(*own);
        let (mut last, mut last_inverse) = edge(own, self.at(*first));
        for &v in others {
            let (next, inverse) = edge(own, self.at(v));
            let inverses = last_inverse * inverse;
            let weight = angle_over_sine(dot(last, next) * inverses) * inverses;
            let turn = cross(last, next);
            for axis in 0..3 {
                let mut part = turn[axis] * weight;
                if CHOOSY {
                    part.0 = part.0.map(|x| if x.is_finite() { x } else { 0.0 });
                }
                sum[axis] += part;
            }
            (last, last_inverse) = (next, inverse);
        }
    }
}

/// From one point to the other, and one over its length; that of an edge without length, which counts for nothing since its cross products are
/// zero, is finite.
#[inline(always)]
fn edge<const W: usize>(from: Vector<W>, to: Vector<W>) -> (Vector<W>, Row<W>) {
    let edge = minus(to, from);
    (edge, (dot(edge, edge) + 1e-30).inverse_root())
}

/// θ / sin θ of a cosine, to 2e-5 of it; bounded towards θ = π.
///
/// With u = cos(θ/2) = √((1 + cos θ) / 2) it is acos(u) / √(1 − u²) / u, of which the first two factors are a polynomial of u in [0, 1] (minimax).
#[inline(always)]
fn angle_over_sine<const W: usize>(cosine: Row<W>) -> Row<W> {
    let square = (cosine * 0.5 + 0.5).at_least(1e-7);
    let inverse = square.inverse_root();
    let u = square * inverse;
    let lowest = u * -0.998_010_94 + 1.570_77;
    let middle = u * -0.541_735_05 + 0.760_116_74;
    let highest = u * -0.066_890_95 + 0.275_733_5;
    (lowest + middle * square + highest * (square * square)) * inverse
}

/// Brings vectors to unit length, cancelled and missing ones alike to what a vertex without a face has.
#[inline(always)]
fn finish<const W: usize>(normals: &mut [Side<W>]) {
    let (mut squares, mut whole) = ([[0.0f32; W]; GROUP], [[0_u32; W]; GROUP]);
    let count = normals.len();
    for (square, normal) in squares.iter_mut().zip(normals.iter()) {
        *square = dot(vector(normal), vector(normal)).0;
    }
    // Over all vertices and lanes in one loop of unknown length: only such a loop becomes vector instructions, choices included.
    for (square, whole) in squares[..count].as_flattened_mut().iter_mut().zip(whole[..count].as_flattened_mut()) {
        *whole = if (*square > 1e-24) & (*square < f32::INFINITY) { u32::MAX } else { 0 };
        *square = 1.0 / square.sqrt();
    }
    for ((normal, inverse), whole) in normals.iter_mut().zip(&squares).zip(&whole) {
        for axis in 0..3 {
            for lane in 0..W {
                let unit = normal[axis][lane] * inverse[lane];
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

/// Not zero where the number is infinite or none.
#[inline(always)]
fn not_finite(x: f32) -> u32 {
    // The exponent alone is all ones then.
    (x.to_bits() & 0x7f80_0000) / 0x7f80_0000
}

/// Adds the unit normal of a polygon times its inner angle; nothing where it has none.
#[inline(always)]
fn add_corner<const W: usize>(sum: &mut Vector<W>, to: Vector<W>, from: Vector<W>, unit: Vector<W>) {
    let turn = cross(to, from);
    let (square, along, side) = (dot(turn, turn), dot(to, from), dot(turn, unit));
    let mut inner = Row::ZERO;
    for lane in 0..W {
        let smaller = angle(square.0[lane].sqrt(), along.0[lane]);
        // Beyond half a turn at a concave corner.
        inner.0[lane] = if side.0[lane] < 0.0 { 2.0 * PI - smaller } else { smaller };
    }
    for (sum, unit) in sum.iter_mut().zip(unit) {
        *sum += unit * inner;
    }
}

/// Newell's area vector, from the first corner, at unit length.
fn area_direction<const W: usize>(face: &[u32], points: &[Side<W>]) -> Vector<W> {
    let at = |k: usize| vector(&points[face[k] as usize]);
    let mut area = [Row::ZERO; 3];
    for k in 1..face.len() - 1 {
        let part = cross(minus(at(k), at(0)), minus(at(k + 1), at(0)));
        area.iter_mut().zip(part).for_each(|(area, part)| *area += part);
    }
    unit(area)
}

/// Zero where there is no direction.
#[inline(always)]
fn unit<const W: usize>(v: Vector<W>) -> Vector<W> {
    let lengths = dot(v, v).0.map(f32::sqrt);
    v.map(|mut row| {
        for (x, length) in row.0.iter_mut().zip(lengths) {
            *x = if has_size(length) { *x / length } else { 0.0 };
        }
        row
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splitmix::Sequence;

    /// What the rings of a normal vertex say of its corners, sorted.
    fn corners_of(rings: &Rings, v: usize) -> Vec<[u32; 3]> {
        let corners = |ring: &[u32]| ring[1..].windows(2).map(|w| [ring[0], w[0], w[1]]).collect::<Vec<_>>();
        let mut all: Vec<[u32; 3]> = rings.of_normal(v).flat_map(corners).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn rings_have_every_corner_once_whatever_the_surface() {
        let mut dice = Sequence(5);
        let found: Vec<(u32, [u32; 3])> = (0..900)
            .map(|_| {
                let p = dice.point(1.0).to_array().map(|x| (x.abs() * 10.0) as u32);
                (p[0], [p[0] + p[2] % 2, p[1], p[2]])
            })
            .collect();
        let corners = Corners::sorted(5, found.iter().copied());
        let rings = Rings::of(corners.clone());
        for v in 0..5 {
            let mut expected = corners.of(v).to_vec();
            expected.sort_unstable();
            assert!(expected.len() > 50 && corners_of(&rings, v) == expected, "{v}");
            assert_eq!(rings.of_normals(v).len(), rings.of_normal(v).map(<[u32]>::len).sum::<usize>());
        }
        assert!(rings.of_normals(5).is_empty());
    }

    #[test]
    fn a_whole_fan_is_one_ring() {
        let fan = |others: &[u32]| others.windows(2).rev().map(|w| (0, [9, w[0], w[1]])).collect::<Vec<_>>();
        for others in [&[1, 2, 3, 4, 5, 1][..], &[4, 2, 3, 1]] {
            let rings = Rings::of(Corners::sorted(1, fan(others).into_iter()));
            assert_eq!(rings.of_normal(0).count(), 1);
            assert_eq!(rings.of_normals(0).len(), others.len() + 1);
        }
    }

    #[test]
    fn angles_over_sines_are_right_to_2e_5() {
        for k in 0..=1700 {
            let a = f64::from(k) * std::f64::consts::PI / 1800.0;
            let expected = if k == 0 { 1.0 } else { a / a.sin() };
            let [found] = angle_over_sine(Row([a.cos() as f32])).0;
            // Near half a turn the cosine itself knows no better.
            assert!((f64::from(found) / expected - 1.0).abs() < if k < 1600 { 2e-5 } else { 2e-4 }, "{k}: {found} {expected}");
        }
        assert!(angle_over_sine(Row([-1.5])).0[0].is_finite());
    }

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
