//! One part of a thing: its welded surface, with normals that respect creases and samples spread evenly by area.

use super::samples::Samples;
use crate::spatial::TriangleTree;
use crate::splitmix::{mix, unit};
use glam::DVec3;
use std::collections::HashMap;

/// Vertices nearer to each other than this share of the whole model are one.
const WELD: f64 = 1e-6;

/// Faces that meet at a larger angle do not share a normal (cosine of 40°).
const CREASE: f64 = 0.766;

/// Samples of a part at most, about: a large part of a small spacing would have millions.
const MOST: f64 = 1e5;

/// A part at rest.
#[derive(Debug)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Welded vertices.
    pub points: Vec<DVec3>,
    /// Triangles over `points`, none of them flat.
    pub triangles: Vec<[u32; 3]>,
    /// Unit normal of each triangle.
    pub normals: Vec<DVec3>,
    /// Normals at the corners of each triangle: the mean, weighted by angle, of the faces around the vertex that are within the crease angle. Facet
    /// normals would make a round bore a prism, which does not slip.
    pub corner_normals: Vec<[DVec3; 3]>,
    /// Area of each triangle.
    pub areas: Vec<f64>,
    /// Its triangles, for queries.
    pub tree: TriangleTree,
    /// Corners of its box.
    pub bounds: (DVec3, DVec3),
}

impl Part {
    /// A part from triangles over `points`; a closed one that is inside out is turned round. `size`: diagonal of the whole model.
    pub fn new(name: &str, points: &[DVec3], triangles: &[[u32; 3]], size: f64) -> Self {
        let (points, mut triangles) = weld(points, triangles, WELD * size);
        let cross = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            (b - a).cross(c - a)
        };
        triangles.retain(|t| cross(t).length() > 1e-14 * size * size);
        // What is closed has its faces outwards.
        let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
        let volume: f64 = triangles.iter().map(|t| (points[t[0] as usize] - middle).dot(cross(t))).sum();
        if volume < 0.0 && is_closed(&triangles) {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let areas: Vec<f64> = triangles.iter().map(|t| 0.5 * cross(t).length()).collect();
        let normals: Vec<DVec3> = triangles.iter().map(|t| cross(t).normalize_or_zero()).collect();
        let corner_normals = corner_normals(&points, &triangles, &normals);
        let tree = TriangleTree::new(&points, &triangles);
        let bounds = triangles
            .iter()
            .flatten()
            .map(|&v| points[v as usize])
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        Self { name: name.to_owned(), points, triangles, normals, corner_normals, areas, tree, bounds }
    }

    /// Whether the surface encloses something: hardly any edge belongs to one triangle alone.
    pub fn is_closed(&self) -> bool {
        is_closed(&self.triangles)
    }

    /// Diagonal of its box.
    pub fn diagonal(&self) -> f64 {
        if self.triangles.is_empty() { 0.0 } else { (self.bounds.1 - self.bounds.0).length() }
    }

    /// Samples of the surface within a box, evenly by area: about `count` of them, more where they would be farther
    /// than `spacing` apart, and never more than about a hundred thousand.
    pub fn samples(&self, lo: DVec3, hi: DVec3, count: usize, spacing: f64) -> Samples {
        let mut pieces: Vec<(usize, [DVec3; 3], f64)> = Vec::new();
        for (t, corners) in self.triangles.iter().enumerate() {
            let corners = corners.map(|v| self.points[v as usize]);
            for [a, b, c] in clipped(corners, lo, hi) {
                let area = 0.5 * (b - a).cross(c - a).length();
                if area > 0.0 {
                    pieces.push((t, [a, b, c], area));
                }
            }
        }
        let area: f64 = pieces.iter().map(|piece| piece.2).sum();
        let each = (spacing * spacing).min(area / count as f64).max(area / MOST);
        let mut samples = Samples::default();
        // Systematic by area: the next sample is due whenever another `each` has been passed.
        let mut due = 0.5;
        for (key, (t, corners, area)) in pieces.iter().enumerate() {
            due += area / each;
            let number = due.floor();
            due -= number;
            for k in 0..number as u64 {
                let p = spread(corners, hash(key as u64, k));
                samples.push(p, self.normal_at(*t, p), each);
            }
        }
        samples
    }

    /// The interpolated normal at a point of a triangle.
    fn normal_at(&self, triangle: usize, p: DVec3) -> DVec3 {
        let corners = self.triangles[triangle].map(|v| self.points[v as usize]);
        let n = self.normals[triangle];
        let weight = |k: usize| (corners[(k + 1) % 3] - p).cross(corners[(k + 2) % 3] - p).dot(n).max(0.0);
        let sum: DVec3 = self.corner_normals[triangle].iter().enumerate().map(|(k, normal)| *normal * weight(k)).sum();
        sum.normalize_or(n)
    }

    /// Depth of a point inside the part: distance to the surface, negative infinity outside. Small holes do not matter.
    pub fn depth(&self, p: DVec3) -> f64 {
        if !(p.cmpge(self.bounds.0).all() && p.cmple(self.bounds.1).all()) || self.tree.winding(p) <= 0.5 {
            return f64::NEG_INFINITY;
        }
        self.tree.closest(p).map_or(f64::NEG_INFINITY, |c| c.distance)
    }
}

fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let mut edges: Vec<(u32, u32)> =
        triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).map(|(a, b)| (a.min(b), a.max(b))).collect();
    edges.sort_unstable();
    let open = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).count();
    open * 100 <= edges.len()
}

/// What of a triangle lies in a box, as triangles (Sutherland, Hodgman 1974).
fn clipped(corners: [DVec3; 3], lo: DVec3, hi: DVec3) -> Vec<[DVec3; 3]> {
    let [a, b, c] = corners;
    let (least, most) = (a.min(b).min(c), a.max(b).max(c));
    if least.cmpgt(hi).any() || most.cmplt(lo).any() {
        return Vec::new();
    }
    if least.cmpge(lo).all() && most.cmple(hi).all() {
        return vec![corners];
    }
    let mut polygon = corners.to_vec();
    for axis in 0..3 {
        for (sign, limit) in [(1.0, hi[axis]), (-1.0, -lo[axis])] {
            let beyond = |p: DVec3| sign * p[axis] - limit;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (k, &p) in polygon.iter().enumerate() {
                let q = polygon[(k + 1) % polygon.len()];
                let (from, to) = (beyond(p), beyond(q));
                if from <= 0.0 {
                    kept.push(p);
                }
                if (from < 0.0 && to > 0.0) || (from > 0.0 && to < 0.0) {
                    kept.push(p.lerp(q, from / (from - to)));
                }
            }
            polygon = kept;
            if polygon.len() < 3 {
                return Vec::new();
            }
        }
    }
    (1..polygon.len() - 1).map(|k| [polygon[0], polygon[k], polygon[k + 1]]).collect()
}

/// A point of a triangle from two numbers in 0 to 1.
fn spread([a, b, c]: &[DVec3; 3], (u, v): (f64, f64)) -> DVec3 {
    let s = u.sqrt();
    *a * (1.0 - s) + *b * (s * (1.0 - v)) + *c * (s * v)
}

/// Two numbers in 0 to 1 that depend on nothing but the keys.
fn hash(a: u64, b: u64) -> (f64, f64) {
    let first = mix(a.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ mix(b));
    (unit(first), unit(mix(first)))
}

/// Merges vertices that lie in one cell of a grid or across its borders, by position to `tolerance`; drops triangles that collapse.
fn weld(points: &[DVec3], triangles: &[[u32; 3]], tolerance: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut of_cell: HashMap<[i64; 3], u32> = HashMap::new();
    let mut of_vertex: HashMap<u32, u32> = HashMap::new();
    let mut kept: Vec<DVec3> = Vec::new();
    let mut place = |v: u32| {
        *of_vertex.entry(v).or_insert_with(|| {
            let p = points[v as usize];
            let cell = |shift: DVec3| ((p + shift) / tolerance).floor().to_array().map(|x| x as i64);
            let near = (0..8).map(|k| {
                let sign = |bit: i32| if k & bit == 0 { -0.5 } else { 0.5 };
                cell(DVec3::new(sign(1), sign(2), sign(4)) * tolerance)
            });
            let found = near.filter_map(|c| of_cell.get(&c)).copied().find(|&w| kept[w as usize].distance(p) <= tolerance);
            found.unwrap_or_else(|| {
                kept.push(p);
                let new = kept.len() as u32 - 1;
                of_cell.entry(cell(DVec3::ZERO)).or_insert(new);
                new
            })
        })
    };
    let welded: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(&mut place)).collect();
    (kept, welded.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect())
}

fn corner_normals(points: &[DVec3], triangles: &[[u32; 3]], normals: &[DVec3]) -> Vec<[DVec3; 3]> {
    let mut around: Vec<Vec<(u32, f64)>> = vec![Vec::new(); points.len()];
    for (t, corners) in triangles.iter().enumerate() {
        for k in 0..3 {
            let [p, q, r] = [0, 1, 2].map(|i| points[corners[(k + i) % 3] as usize]);
            around[corners[k] as usize].push((t as u32, (q - p).angle_between(r - p)));
        }
    }
    let normal = |t: usize, v: u32| {
        let own = normals[t];
        let sum: DVec3 = around[v as usize]
            .iter()
            .map(|&(other, angle)| (normals[other as usize], angle))
            .filter(|(n, angle)| n.dot(own) >= CREASE && angle.is_finite())
            .map(|(n, angle)| n * angle)
            .sum();
        sum.normalize_or(own)
    };
    triangles.iter().enumerate().map(|(t, corners)| corners.map(|v| normal(t, v))).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A box with a corner in the origin, every triangle with vertices of its own.
    fn soup() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let corner = |k: usize| DVec3::new((k & 1) as f64, (k >> 1 & 1) as f64 * 2.0, (k >> 2) as f64 * 3.0);
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let points: Vec<DVec3> = quads.iter().flat_map(|&[a, b, c, d]| [a, b, c, a, c, d]).map(corner).collect();
        let triangles = (0..points.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (points, triangles)
    }

    #[test]
    fn vertices_in_one_place_are_one_on_either_side_of_zero() {
        let (points, triangles) = soup();
        for shift in [0.0, -0.5, -1.0, 1e3] {
            let shifted: Vec<DVec3> = points.iter().map(|p| *p + shift).collect();
            let part = Part::new("box", &shifted, &triangles, 4.0);
            assert_eq!((part.points.len(), part.triangles.len()), (8, 12), "{shift}");
            assert!(part.is_closed());
        }
    }

    #[test]
    fn what_is_inside_out_is_turned_round() {
        let (points, triangles) = soup();
        let turned: Vec<[u32; 3]> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let depth = |triangles: &[[u32; 3]]| Part::new("box", &points, triangles, 4.0).depth(DVec3::new(0.5, 1.0, 1.5));
        assert_eq!((depth(&triangles), depth(&turned)), (0.5, 0.5));
        // An open one has no inside: it stays as it is.
        let open = Part::new("box", &points, &turned[2..], 4.0);
        assert_eq!(open.normals[0], -Part::new("box", &points, &triangles[2..], 4.0).normals[0]);
    }
}
