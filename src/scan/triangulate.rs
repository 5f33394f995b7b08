//! Polygons → triangles.

use super::SurfaceMesh;
use glam::{DVec2, DVec3};
use robust::{Coord, orient2d};
use std::ops::Range;

/// Polygons with more corners than this are cut as fans: ear clipping grows with the square of the corners.
const LARGEST_EARS: usize = 4096;

/// The triangles of all faces, in the order of the faces; a face of `n` corners has `n − 2` of them, also where it is degenerate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Triangles {
    /// Three indices into [`super::Faces::corners`] per triangle, turning like the face.
    pub corners: Vec<[u32; 3]>,
    /// The face of each triangle.
    pub faces: Vec<u32>,
}

impl SurfaceMesh {
    /// Cuts every face into triangles.
    ///
    /// Quads are cut along the shorter of the diagonals that lie inside; larger polygons by ear clipping in the plane of their Newell
    /// normal, which is right for concave ones too. Faces without a plane, and what is left where no ear can be found (self-crossing
    /// outlines), become fans.
    pub fn triangulate(&self) -> Triangles {
        let mut triangles = Triangles::default();
        let count = self.faces.corners.len().saturating_sub(2 * self.faces.len());
        triangles.corners.reserve(count);
        triangles.faces.reserve(count);
        let mut ears = Ears::default();
        for f in 0..self.faces.len() {
            let range = self.faces.range(f);
            let before = triangles.corners.len();
            match range.len() {
                0..3 => {}
                3 => triangles.corners.push([0, 1, 2].map(|k| range.start as u32 + k)),
                4 => triangles.corners.extend(self.quad(range)),
                _ => ears.cut(self, range, &mut triangles.corners),
            }
            triangles.faces.resize(triangles.faces.len() + triangles.corners.len() - before, f as u32);
        }
        triangles
    }

    /// The vertices of the triangles of [`SurfaceMesh::triangulate`].
    pub fn vertex_triangles(&self) -> Vec<[u32; 3]> {
        self.triangulate().corners.iter().map(|t| t.map(|corner| self.faces.corners[corner as usize])).collect()
    }

    fn corner_position(&self, corner: usize) -> DVec3 {
        self.positions[self.faces.corners[corner] as usize]
    }

    fn quad(&self, range: Range<usize>) -> [[u32; 3]; 2] {
        let p = [0, 1, 2, 3].map(|k| self.corner_position(range.start + k));
        let (ac, bd) = (p[2] - p[0], p[3] - p[1]);
        let normal = ac.cross(bd);
        let turn = |a: usize, b: usize, c: usize| (p[b] - p[a]).cross(p[c] - p[a]).dot(normal);
        // A diagonal lies inside if both triangles turn like the quad; the product of a reflex corner's diagonal is negative.
        let worst_ac = turn(0, 1, 2).min(turn(0, 2, 3));
        let worst_bd = turn(0, 1, 3).min(turn(1, 2, 3));
        let along_bd = match (worst_ac > 0.0, worst_bd > 0.0) {
            (true, false) => false,
            (false, true) => true,
            (true, true) => bd.length_squared() < ac.length_squared(),
            (false, false) => worst_bd > worst_ac,
        };
        let s = range.start as u32;
        if along_bd { [[s, s + 1, s + 3], [s + 1, s + 2, s + 3]] } else { [[s, s + 1, s + 2], [s, s + 2, s + 3]] }
    }
}

/// Ear clipping, with its buffers.
#[derive(Default)]
struct Ears {
    /// Corners in the plane.
    points: Vec<DVec2>,
    /// Corners that are left, as a ring.
    next: Vec<usize>,
    previous: Vec<usize>,
    /// Corners that are not convex: only they can lie in an ear.
    reflex: Vec<usize>,
}

impl Ears {
    fn cut(&mut self, mesh: &SurfaceMesh, range: Range<usize>, out: &mut Vec<[u32; 3]>) {
        let n = range.len();
        let start = range.start as u32;
        let fan = |out: &mut Vec<[u32; 3]>| out.extend((1..n as u32 - 1).map(|k| [start, start + k, start + k + 1]));
        if n > LARGEST_EARS || !self.project(mesh, range) {
            return fan(out);
        }
        self.next.clear();
        self.previous.clear();
        self.next.extend((0..n).map(|i| (i + 1) % n));
        self.previous.extend((0..n).map(|i| (i + n - 1) % n));
        self.reflex.clear();
        let mut reflex = std::mem::take(&mut self.reflex);
        reflex.extend((0..n).filter(|&i| self.turn(i) <= 0.0));
        self.reflex = reflex;
        let mut at = 0;
        let mut left = n;
        let mut tried = 0;
        while left > 3 {
            // After a full round without an ear the outline crosses itself: any corner goes, and the count of triangles stays right.
            if self.is_ear(at) || tried >= left {
                let (before, after) = (self.previous[at], self.next[at]);
                out.push([before, at, after].map(|k| start + k as u32));
                self.next[before] = after;
                self.previous[after] = before;
                self.reflex.retain(|&i| i != at);
                for corner in [before, after] {
                    if self.turn(corner) > 0.0 {
                        self.reflex.retain(|&i| i != corner);
                    }
                }
                left -= 1;
                tried = 0;
                // Going on two corners further spreads the ears, where one corner after the other would make a fan of slivers.
                at = self.next[after];
            } else {
                at = self.next[at];
                tried += 1;
            }
        }
        out.push([self.previous[at], at, self.next[at]].map(|k| start + k as u32));
    }

    /// Puts the corners into the plane of the Newell normal; false if there is none.
    fn project(&mut self, mesh: &SurfaceMesh, range: Range<usize>) -> bool {
        let origin = mesh.corner_position(range.start);
        let at = |k: usize| mesh.corner_position(range.start + k % range.len()) - origin;
        let normal: DVec3 = (0..range.len()).map(|k| at(k).cross(at(k + 1))).sum();
        let Some(normal) = normal.try_normalize() else { return false };
        let (right, up) = normal.any_orthonormal_pair();
        // `right × up = normal`, so that the outline turns left.
        let sign = if right.cross(up).dot(normal) < 0.0 { -1.0 } else { 1.0 };
        self.points.clear();
        self.points.extend((0..range.len()).map(|k| DVec2::new(at(k).dot(right), sign * at(k).dot(up))));
        true
    }

    /// Positive if the outline turns left at `corner`; exact.
    fn turn(&self, corner: usize) -> f64 {
        let (a, c) = (self.previous[corner], self.next[corner]);
        self.side(a, corner, c)
    }

    fn side(&self, a: usize, b: usize, c: usize) -> f64 {
        let coord = |i: usize| Coord { x: self.points[i].x, y: self.points[i].y };
        orient2d(coord(a), coord(b), coord(c))
    }

    fn is_ear(&self, corner: usize) -> bool {
        if self.turn(corner) <= 0.0 {
            return false;
        }
        let (a, c) = (self.previous[corner], self.next[corner]);
        let ends = [self.points[a], self.points[corner], self.points[c]];
        // Corners at the very place of one of the ear's do not block it: outlines with holes run along a bridge twice.
        !self.reflex.iter().any(|&i| {
            i != a
                && i != c
                && !ends.contains(&self.points[i])
                && self.side(a, corner, i) >= 0.0
                && self.side(corner, c, i) >= 0.0
                && self.side(c, a, i) >= 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Faces;
    use std::f64::consts::TAU;

    fn polygon(points: &[DVec3]) -> SurfaceMesh {
        let mut faces = Faces::default();
        faces.push(0..points.len() as u32);
        SurfaceMesh { positions: points.to_vec(), faces }
    }

    /// Sum of the signed areas along the polygon's own normal, and of the absolute ones.
    fn areas(mesh: &SurfaceMesh, normal: DVec3) -> (f64, f64) {
        let p = |v: u32| mesh.positions[v as usize];
        let signed = |t: &[u32; 3]| (p(t[1]) - p(t[0])).cross(p(t[2]) - p(t[0])).dot(normal) / 2.0;
        mesh.vertex_triangles().iter().map(signed).fold((0.0, 0.0), |(s, a), x| (s + x, a + x.abs()))
    }

    #[test]
    fn a_star_is_covered_without_overlap_wherever_it_lies() {
        let star = |n: usize, offset: DVec3, scale: f64| -> Vec<DVec3> {
            let tilt = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
            let point = |k: usize| {
                let (r, angle) = (if k % 2 == 0 { 1.0 } else { 0.3 }, TAU * k as f64 / n as f64);
                tilt * DVec3::new(r * angle.cos(), r * angle.sin(), 0.0) * scale + offset
            };
            (0..n).map(point).collect()
        };
        for (offset, scale) in [(DVec3::ZERO, 1.0), (DVec3::splat(3e5), 1.0), (DVec3::ZERO, 1e-6)] {
            let points = star(12, offset, scale);
            let normal = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7) * DVec3::Z;
            let expected = 12.0 * 0.5 * 0.3 * (TAU / 12.0).sin() * scale * scale;
            let (signed, absolute) = areas(&polygon(&points), normal);
            assert!(
                (signed / expected - 1.0).abs() < 1e-8 && (absolute / expected - 1.0).abs() < 1e-8,
                "{signed} {absolute} {expected}"
            );
        }
    }

    #[test]
    fn a_hole_with_a_bridge_is_left_open() {
        let xy = [(0., 0.), (4., 0.), (4., 4.), (0., 4.), (0., 0.), (1., 1.), (1., 3.), (3., 3.), (3., 1.), (1., 1.)];
        let points: Vec<DVec3> = xy.iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect();
        let (signed, absolute) = areas(&polygon(&points), DVec3::Z);
        assert_eq!((signed, absolute), (12.0, 12.0));
    }

    #[test]
    fn a_concave_quad_is_cut_at_its_reflex_corner() {
        let dart = [DVec3::ZERO, DVec3::new(4.0, 1.0, 0.0), DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 4.0, 0.0)];
        for turn in 0..4 {
            let mut points = dart;
            points.rotate_left(turn);
            let (signed, absolute) = areas(&polygon(&points), DVec3::Z);
            assert!((signed - absolute).abs() < 1e-12 && (signed - 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn degenerate_and_crossing_faces_still_give_all_their_triangles() {
        let line: Vec<DVec3> = (0..7).map(|k| DVec3::splat(f64::from(k))).collect();
        assert_eq!(polygon(&line).triangulate().corners.len(), 5);
        let bow: Vec<DVec3> =
            [(0., 0.), (4., 4.), (4., 0.), (0., 4.), (2., 9.), (1., -3.)].iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect();
        assert_eq!(polygon(&bow).triangulate().corners.len(), 4);
        let point = vec![DVec3::ONE; 6];
        assert_eq!(polygon(&point).triangulate().faces, [0; 4]);
    }
}
