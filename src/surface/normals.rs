//! Normals of posed surfaces, weighted by the angles at the corners (Thürmer, Wüthrich 1998).

use super::Fans;
use crate::scan::{NONE, Scan};

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

    /// Angle-weighted unit normals of the posed surface, see [`Fans::compute`]; for one frame. Shapes: `points`: scan vertices; `out`: normal vertices.
    pub fn compute(&self, scan: &Scan, points: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
        Fans::new(scan, self).compute(&[points], std::slice::from_mut(out));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::splitmix::Sequence;
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
        let mut dice = Sequence(3);
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
    fn faces_without_area_or_place_do_not_spoil_their_neighbours() {
        let points = [DVec3::ZERO, DVec3::Y, DVec3::Z, DVec3::Y * 2.0, DVec3::NAN];
        for worthless in [&[0, 1, 3][..], &[0, 0, 1], &[0, 1, 4], &[0, 1, 3, 3], &[0, 4, 1, 3], &[0, 1, 3, 3, 1]] {
            let n = normals(&scan(&points, &[&[0, 1, 2], worthless]));
            assert!(n[..3].iter().all(|n| n.distance(Vec3::X) < 1e-6), "{worthless:?}: {n:?}");
        }
    }

    /// Triangles, quads and pentagons at random, some without area, with frames that move by themselves.
    fn mixed() -> (Scan, Vec<Vec<[f32; 3]>>) {
        let mut dice = Sequence(4);
        let points: Vec<DVec3> = (0..3000).map(|_| dice.point(1.0)).collect();
        let face = |k: u32| (0..3 + k % 3).map(|i| (k * 7 + i * (k % 11)) % 3000).collect::<Vec<_>>();
        let faces: Vec<Vec<u32>> = (0..5000).map(face).collect();
        let scan = scan(&points, &faces.iter().map(|f| &f[..]).collect::<Vec<_>>());
        let frames = (0..8).map(|_| (0..3000).map(|_| dice.point(1.0).as_vec3().to_array()).collect()).collect();
        (scan, frames)
    }

    #[test]
    fn neither_neighbours_nor_threads_nor_instructions_change_bits() {
        let (scan, frames) = mixed();
        let fans = Fans::new(&scan, &NormalVertices::of(&scan));
        let alone: Vec<Vec<[f32; 3]>> = frames
            .iter()
            .map(|points| {
                let mut out = vec![Vec::new()];
                fans.compute_with_baseline(&[points], &mut out);
                out.remove(0)
            })
            .collect();
        for count in 0..=8 {
            let batch: Vec<&[[f32; 3]]> = frames[..count].iter().map(|f| &f[..]).collect();
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let mut out = vec![vec![[9.0; 3]; 7]; count];
                pool.install(|| fans.compute(&batch, &mut out));
                assert!(out == alone[..count], "{count} {threads}");
            }
        }
    }
}
