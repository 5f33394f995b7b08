//! Normals of posed surfaces, weighted by the angles at the corners (Thürmer, Wüthrich 1998).

use crate::scan::{Faces, NONE, Scan};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// What a vertex gets that no face with an area uses.
const WITHOUT_FACE: [f32; 3] = [0.0, 0.0, 1.0];

/// Normal vertices: one per scan vertex, or more where the file has a hard edge (corners of a vertex with different normal indices).
#[derive(Clone, Debug, Default)]
pub struct NormalVertices {
    /// Scan vertex of each normal vertex.
    pub vertices: Vec<u32>,
    /// Normal vertex of each face corner.
    pub corners: Vec<u32>,
    /// Normal vertices that take the normal of another one: they are the same point of a smooth surface.
    pub twins: Vec<[u32; 2]>,
}

impl NormalVertices {
    /// One normal vertex per scan vertex first (index = vertex), further ones for hard edges after them, in the order of their first corner.
    /// Corners without a normal index count with the first index at their vertex.
    pub fn of(scan: &Scan) -> Self {
        let count = scan.mesh.positions.len();
        let corners = &scan.mesh.faces.corners;
        let mut all = Self { vertices: (0..count as u32).collect(), corners: corners.clone(), twins: Vec::new() };
        if scan.look.twins.len() == count {
            let first = |v: u32| scan.look.twins[v as usize];
            all.corners.iter_mut().for_each(|corner| *corner = first(*corner));
            all.twins = all.vertices.iter().map(|&v| [v, first(v)]).filter(|[v, first]| v != first).collect();
        }
        let normals = &scan.look.corner_normals;
        if normals.len() != corners.len() {
            return all;
        }
        // Normal vertices of one vertex form a chain, which begins at the vertex itself.
        let mut normal_of = vec![NONE; count];
        let mut next = vec![NONE; count];
        for ((&vertex, &normal), corner) in corners.iter().zip(normals).zip(&mut all.corners) {
            if normal == NONE {
                continue;
            }
            let mut at = vertex as usize;
            if normal_of[at] == NONE {
                normal_of[at] = normal;
            }
            while normal_of[at] != normal {
                if next[at] == NONE {
                    next[at] = all.vertices.len() as u32;
                    all.vertices.push(vertex);
                    normal_of.push(normal);
                    next.push(NONE);
                }
                at = next[at] as usize;
            }
            *corner = at as u32;
        }
        all
    }

    /// Angle-weighted unit normals of the posed surface. Shapes: `points`: scan vertices; `out`: normal vertices.
    ///
    /// Polygons count as flat, with the normal of their area vector; faces without an area contribute nothing. A vertex without any such
    /// face gets +Z. Cost: 17 ns per triangle; see [`NormalVertices::compute_frames`] for several threads.
    pub fn compute(&self, scan: &Scan, points: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
        let faces = &scan.mesh.faces;
        out.clear();
        out.resize(self.vertices.len(), [0.0; 3]);
        let mut face = 0;
        while face < faces.len() {
            let range = faces.range(face);
            if let Some(block) = triangles(faces, face) {
                let corners = &self.corners[block.clone()];
                add_triangles(&faces.corners[block], corners, points, out);
                face += BLOCK;
            } else {
                add_polygon(&faces.corners[range.clone()], &self.corners[range], points, out);
                face += 1;
            }
        }
        for normal in out.iter_mut() {
            let length = dot(*normal, *normal).sqrt();
            // Not written as a division by zero: cancelled and missing normals alike.
            *normal = if length > 1e-12 && length.is_finite() { normal.map(|x| x / length) } else { WITHOUT_FACE };
        }
        self.twins.iter().for_each(|&[vertex, first]| out[vertex as usize] = out[first as usize]);
    }

    /// [`NormalVertices::compute`] for several frames in parallel; the bits are the same.
    pub fn compute_frames(&self, scan: &Scan, frames: &[Vec<[f32; 3]>], out: &mut [Vec<[f32; 3]>]) {
        assert_eq!(frames.len(), out.len(), "one output per frame");
        frames.par_iter().zip(out).for_each(|(points, out)| self.compute(scan, points, out));
    }
}

/// Triangles that are worked on side by side.
const BLOCK: usize = 8;

/// The corners of the next [`BLOCK`] faces if all of them are triangles.
fn triangles(faces: &Faces, face: usize) -> Option<std::ops::Range<usize>> {
    let starts = faces.starts.get(face..=face + BLOCK)?;
    starts.windows(2).all(|w| w[1] - w[0] == 3).then(|| starts[0] as usize..starts[BLOCK] as usize)
}

fn add_triangles(vertices: &[u32], corners: &[u32], points: &[[f32; 3]], out: &mut [[f32; 3]]) {
    // x, y, z of the edges that leave corner 0, 1, 2; lanes are faces.
    let mut edges = [[[0.0f32; BLOCK]; 3]; 3];
    for lane in 0..BLOCK {
        let p = [0, 1, 2].map(|k| points[vertices[3 * lane + k] as usize]);
        for k in 0..3 {
            for axis in 0..3 {
                edges[k][axis][lane] = p[(k + 1) % 3][axis] - p[k][axis];
            }
        }
    }
    let [e0, e1, e2] = &edges;
    let mut unit = [[0.0f32; BLOCK]; 3];
    let mut angles = [[0.0f32; BLOCK]; 3];
    for lane in 0..BLOCK {
        let at = |e: &[[f32; BLOCK]; 3]| [e[0][lane], e[1][lane], e[2][lane]];
        let (a, b, c) = (at(e0), at(e1), at(e2));
        let normal = cross(a, b);
        let area = dot(normal, normal).sqrt();
        let scale = if area > 0.0 && area.is_finite() { 1.0 / area } else { 0.0 };
        for axis in 0..3 {
            unit[axis][lane] = if scale > 0.0 { normal[axis] * scale } else { 0.0 };
        }
        angles[0][lane] = angle(area, -dot(a, c));
        angles[1][lane] = angle(area, -dot(a, b));
        angles[2][lane] = angle(area, -dot(b, c));
    }
    for lane in 0..BLOCK {
        for k in 0..3 {
            let normal = &mut out[corners[3 * lane + k] as usize];
            for axis in 0..3 {
                normal[axis] += unit[axis][lane] * angles[k][lane];
            }
        }
    }
}

fn add_polygon(vertices: &[u32], corners: &[u32], points: &[[f32; 3]], out: &mut [[f32; 3]]) {
    let count = vertices.len();
    if count < 3 {
        return;
    }
    let at = |k: usize| points[vertices[k % count] as usize];
    // Newell's area vector, from the first corner.
    let mut area = [0.0f32; 3];
    for k in 1..count - 1 {
        let part = cross(minus(at(k), at(0)), minus(at(k + 1), at(0)));
        for axis in 0..3 {
            area[axis] += part[axis];
        }
    }
    let length = dot(area, area).sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return;
    }
    let unit = area.map(|x| x / length);
    for (k, &corner) in corners.iter().enumerate() {
        let (to, from) = (minus(at(k + 1), at(k)), minus(at(k + count - 1), at(k)));
        let turn = cross(to, from);
        let sine = dot(turn, turn).sqrt();
        let inner = angle(sine, dot(to, from));
        // Beyond half a turn at a concave corner.
        let inner = if dot(turn, unit) < 0.0 { 2.0 * PI - inner } else { inner };
        for (sum, x) in out[corner as usize].iter_mut().zip(unit) {
            *sum += x * inner;
        }
    }
}

/// atan2 for `y` ≥ 0 to 1e-5, in plain arithmetic: vector lanes, and the same bits on every machine. 0 where both are 0.
fn angle(y: f32, x: f32) -> f32 {
    let (small, large) = (y.min(x.abs()), y.max(x.abs()));
    let t = if large > 0.0 { small / large } else { 0.0 };
    let s = t * t;
    let mut p = -0.011_721_2;
    for c in [0.052_653_32, -0.116_432_87, 0.193_543_46, -0.332_623_47, 0.999_977_26] {
        p = p * s + c;
    }
    let first = p * t;
    let quarter = if y > x.abs() { FRAC_PI_2 - first } else { first };
    if x < 0.0 { PI - quarter } else { quarter }
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::spatial::tests::Dice;
    use glam::{DVec3, Vec3};

    fn scan(points: &[DVec3], faces: &[&[u32]]) -> Scan {
        let mut scan = Scan::default();
        scan.mesh.positions = points.to_vec();
        faces.iter().for_each(|f| scan.mesh.faces.push(f.iter().copied()));
        scan
    }

    fn normals(scan: &Scan) -> Vec<Vec3> {
        let points: Vec<[f32; 3]> = scan.mesh.positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let mut out = vec![[7.0; 3]; 3];
        NormalVertices::of(scan).compute(scan, &points, &mut out);
        out.into_iter().map(Vec3::from_array).collect()
    }

    fn cube() -> Vec<DVec3> {
        (0..8).map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2))).collect()
    }

    const QUADS: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

    #[test]
    fn corners_of_a_cube_point_along_its_diagonals_however_it_is_split() {
        let quads: Vec<&[u32]> = QUADS.iter().map(|q| &q[..]).collect();
        let halves: Vec<Vec<u32>> = QUADS.iter().flat_map(|&[a, b, c, d]| [vec![a, b, c], vec![a, c, d]]).collect();
        let halves: Vec<&[u32]> = halves.iter().map(|f| &f[..]).collect();
        let mixed = [&halves[..10], &quads[5..]].concat();
        for faces in [quads, halves, mixed] {
            for (n, p) in normals(&scan(&cube(), &faces)).iter().zip(cube()) {
                let expected = (p - DVec3::splat(0.5)).normalize().as_vec3();
                assert!(n.distance(expected) < 2e-5, "{n} {expected}");
            }
        }
    }

    #[test]
    fn hard_edges_split_and_smooth_ones_do_not() {
        let quads: Vec<&[u32]> = QUADS.iter().map(|q| &q[..]).collect();
        let mut hard = scan(&cube(), &quads);
        // The top alone has its own normal index; the last face has none.
        hard.look.corner_normals = (0..24)
            .map(|c| {
                if c / 4 == 1 {
                    5
                } else if c / 4 == 5 {
                    NONE
                } else {
                    3
                }
            })
            .collect();
        let split = NormalVertices::of(&hard);
        assert_eq!(split.vertices[..8], [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(split.vertices.len(), 12);
        let n = normals(&hard);
        let (bottom, top): (Vec<usize>, Vec<usize>) = (0..12).partition(|&k| split.vertices[k] < 4);
        assert!(bottom.iter().all(|&k| n[k].z < -0.5));
        // The side without indices joins the top at two vertices.
        let up = top.iter().filter(|&&k| n[k].distance(Vec3::Z) < 1e-6).count();
        let across = top.iter().filter(|&&k| n[k].z.abs() < 1e-6).count();
        assert_eq!((up, across), (2, 4));
        for (c, &normal_vertex) in split.corners.iter().enumerate() {
            assert_eq!(split.vertices[normal_vertex as usize], hard.mesh.faces.corners[c]);
        }
    }

    #[test]
    fn a_seam_between_repeated_vertices_is_smooth() {
        // Two triangles at a right angle over one edge, whose ends the second repeats.
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::ZERO, DVec3::Z];
        let mut scan = scan(&points, &[&[0, 1, 2], &[3, 4, 5]]);
        let apart = normals(&scan);
        assert!(apart[0].distance(Vec3::Z) < 1e-6 && apart[4].distance(Vec3::Y) < 1e-6);
        scan.look.twins = vec![0, 1, 2, 1, 0, 5];
        let together = normals(&scan);
        let mean = (Vec3::Y + Vec3::Z).normalize();
        assert!([0, 1, 3, 4].iter().all(|&v: &usize| together[v].distance(mean) < 1e-4), "{together:?}");
        assert!(together[2] == apart[2] && together[5] == apart[5]);
    }

    #[test]
    fn triangles_agree_with_exact_angles() {
        let mut dice = Dice(3);
        let points: Vec<DVec3> = (0..60).map(|_| dice.point(1.0)).collect();
        let faces: Vec<Vec<u32>> = (0..203u32).map(|k| [k * 7, k * 11 + 1, k * 13 + 2].map(|v| v % 60).to_vec()).collect();
        let scan = scan(&points, &faces.iter().map(|f| &f[..]).collect::<Vec<_>>());
        let mut sums = vec![DVec3::ZERO; 60];
        for f in &faces {
            let p = [0, 1, 2].map(|k| points[f[k] as usize]);
            let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for k in 0..3 {
                let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                if a.length() * b.length() > 0.0 {
                    sums[f[k] as usize] += normal * a.angle_between(b);
                }
            }
        }
        for (n, sum) in normals(&scan).iter().zip(sums) {
            assert!((n.as_dvec3() * sum.length()).distance(sum) < 2e-4);
        }
    }

    #[test]
    fn concave_corners_count_with_their_reflex_angle() {
        // An arrow head in the plane z = 0, and an upright triangle at its concave corner.
        let points = [DVec3::ZERO, DVec3::new(1.0, -1.0, 0.0), DVec3::new(0.0, 2.0, 0.0), DVec3::new(-1.0, -1.0, 0.0)];
        let upright = [DVec3::new(0.0, 1.0, 0.0), DVec3::new(0.0, 0.0, 1.0)];
        let scan = scan(&[&points[..], &upright[..]].concat(), &[&[0, 1, 2, 3], &[0, 4, 5]]);
        let n = normals(&scan);
        // Angles: 270 degrees in the plane z, 90 in the plane x.
        assert!(n[0].distance(Vec3::new(1.0, 0.0, 3.0).normalize()) < 1e-5, "{}", n[0]);
    }

    #[test]
    fn faces_without_area_and_lone_vertices_are_survived() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 2.0, DVec3::splat(9.0), DVec3::NAN];
        let faces: [&[u32]; 6] = [&[0, 1, 2], &[0, 1, 3], &[0, 0, 1], &[1], &[], &[0, 1, 5]];
        let n = normals(&scan(&points, &faces));
        assert!(n[..4].iter().all(|n| n.distance(Vec3::Z) < 1e-6));
        assert_eq!(n[4], Vec3::Z);
        assert_eq!(n[5], Vec3::Z);
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

    #[test]
    fn frames_in_parallel_have_the_same_bits() {
        let scan = scan(&cube(), &QUADS.iter().map(|q| &q[..]).collect::<Vec<_>>());
        let mut dice = Dice(4);
        let frames: Vec<Vec<[f32; 3]>> = (0..5).map(|_| (0..8).map(|_| dice.point(1.0).as_vec3().to_array()).collect()).collect();
        let all = NormalVertices::of(&scan);
        let mut out = vec![Vec::new(); 5];
        all.compute_frames(&scan, &frames, &mut out);
        for (points, out) in frames.iter().zip(&out) {
            let mut alone = Vec::new();
            all.compute(&scan, points, &mut alone);
            assert_eq!(&alone, out);
        }
    }
}
