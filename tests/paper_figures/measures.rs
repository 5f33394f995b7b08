//! Measures of what a pose did to a surface.

use glam::{DMat3, DQuat, DVec3};
use retarget::linalg::nearest_rotation;
use retarget::spatial::TriangleTree;
use std::collections::BTreeMap;

pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    // A value that is not a number is the worst of all.
    values.into_iter().fold(0.0, |m, x| if x <= m { m } else { x })
}

pub fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    largest(a.iter().zip(b).map(|(a, b)| a.distance(*b)))
}

pub fn volume(points: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let sixth = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        a.dot(b.cross(c)) / 6.0
    };
    triangles.iter().map(sixth).sum()
}

fn middle(points: &[DVec3]) -> DVec3 {
    points.iter().sum::<DVec3>() / points.len() as f64
}

/// The best turn from one set of points to another, and how far they are apart after it (root of the mean square).
pub fn fit(from: &[DVec3], to: &[DVec3]) -> (DQuat, f64) {
    let (turn, _, difference) = fit_with_scale(from, to, false);
    (turn, difference)
}

fn fit_with_scale(from: &[DVec3], to: &[DVec3], scaled: bool) -> (DQuat, f64, f64) {
    let (a, b) = (middle(from), middle(to));
    let mut covariance = DMat3::ZERO;
    for (p, q) in from.iter().zip(to) {
        let (p, q) = (*p - a, *q - b);
        covariance += DMat3::from_cols(q * p.x, q * p.y, q * p.z);
    }
    let turn = nearest_rotation(covariance, DMat3::IDENTITY);
    let (mut along, mut square) = (0.0, 0.0);
    for (p, q) in from.iter().zip(to) {
        along += (turn * (*p - a)).dot(*q - b);
        square += (*p - a).length_squared();
    }
    let scale = if scaled { along / square } else { 1.0 };
    let error = from.iter().zip(to).map(|(p, q)| (turn * (*p - a) * scale).distance_squared(*q - b)).sum::<f64>();
    (DQuat::from_mat3(&turn), scale, (error / from.len() as f64).sqrt())
}

/// Where a plane z = `height` cuts the edges of a surface: the longest closed loop, each point between two vertices.
pub fn cut(points: &[DVec3], triangles: &[[u32; 3]], height: f64) -> Vec<([u32; 2], f64)> {
    let above = |v: u32| points[v as usize].z > height;
    let mut next: BTreeMap<[u32; 2], [u32; 2]> = BTreeMap::new();
    for t in triangles {
        let sides = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        // From where the boundary of the triangle leaves the upper half to where it enters it: loops keep their direction.
        let leaves = sides.iter().find(|[a, b]| above(*a) && !above(*b));
        let enters = sides.iter().find(|[a, b]| !above(*a) && above(*b));
        if let (Some(&[a, b]), Some(&[c, d])) = (leaves, enters) {
            next.insert([a.min(b), a.max(b)], [c.min(d), c.max(d)]);
        }
    }
    let mut longest = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let (mut edges, mut edge) = (Vec::new(), start);
        while let Some(following) = next.remove(&edge) {
            edges.push(edge);
            edge = following;
        }
        let around = |edges: &[[u32; 2]]| -> f64 {
            let at = |e: &[u32; 2]| points[e[0] as usize].midpoint(points[e[1] as usize]);
            edges.windows(2).map(|w| at(&w[0]).distance(at(&w[1]))).sum()
        };
        if edge == start && around(&edges) > around(&longest) {
            longest = edges;
        }
    }
    let share = |e: [u32; 2]| (height - points[e[0] as usize].z) / (points[e[1] as usize].z - points[e[0] as usize].z);
    longest.into_iter().map(|e| (e, share(e))).collect()
}

/// Points of the surface that lie on a plane across the axis at rest.
pub struct Section {
    points: Vec<DVec3>,
}

impl Section {
    pub fn of(cut: &[([u32; 2], f64)], points: &[DVec3]) -> Self {
        assert!(cut.len() > 8, "a section of {} points", cut.len());
        Self { points: cut.iter().map(|([a, b], t)| points[*a as usize].lerp(points[*b as usize], *t)).collect() }
    }

    pub fn centre(&self) -> DVec3 {
        middle(&self.points)
    }

    pub fn area(&self) -> f64 {
        let centre = self.centre();
        let next = self.points.iter().cycle().skip(1);
        0.5 * self.points.iter().zip(next).map(|(a, b)| (*a - centre).cross(*b - centre)).sum::<DVec3>().length()
    }

    pub fn turn(&self, rest: &Section) -> DQuat {
        fit(&rest.points, &self.points).0
    }

    /// Distance from the section at rest after the best turn, shift and scale, relative to the radius of a disc of the same area.
    pub fn difference(&self, rest: &Section) -> f64 {
        fit_with_scale(&rest.points, &self.points, true).2 / (rest.area() / std::f64::consts::PI).sqrt()
    }
}

/// What a pose did to the sides and edges of a surface.
pub struct Surface {
    /// Points with the body on one side and air on the other at rest.
    pub asked: usize,
    /// Those of them with anything else in the pose.
    pub inverted: usize,
    /// Largest growth of the angle between the normals of neighbouring triangles, degrees; needles, whose normals mean nothing, are left out.
    pub sharpest: f64,
}

impl Surface {
    pub fn compare(rest: &[DVec3], posed: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        // Where another part of the surface is very near at rest, nothing is asked.
        let [near, before, after] =
            [sides(rest, triangles, 0.006), sides(rest, triangles, 0.001), sides(posed, triangles, 0.001)];
        let plain: Vec<bool> = near.iter().zip(&before).map(|(n, b)| *n == [1, 0] && *b == [1, 0]).collect();
        let asked = plain.iter().filter(|plain| **plain).count();
        let inverted = plain.iter().zip(&after).filter(|(plain, after)| **plain && **after != [1, 0]).count();
        let mut edges: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
        for (i, t) in triangles.iter().enumerate() {
            for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
                edges.entry([a.min(b), a.max(b)]).or_default().push(i);
            }
        }
        let normal = |points: &[DVec3], i: usize| area(points, triangles[i]).normalize_or_zero();
        let angle = |points: &[DVec3], a: usize, b: usize| normal(points, a).dot(normal(points, b)).clamp(-1.0, 1.0).acos();
        let growth = |faces: &Vec<usize>| match faces[..] {
            [a, b] if ![a, b].iter().any(|&t| is_needle(rest, triangles[t])) => {
                (angle(posed, a, b) - angle(rest, a, b)).to_degrees()
            }
            _ => 0.0,
        };
        Self { asked, inverted, sharpest: largest(edges.values().map(growth)) }
    }
}

/// Whether a triangle is less than a twentieth as high as long.
fn is_needle(points: &[DVec3], t: [u32; 3]) -> bool {
    let [a, b, c] = t.map(|v| points[v as usize]);
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    area(points, t).length() < 0.05 * longest
}

fn area(points: &[DVec3], t: [u32; 3]) -> DVec3 {
    let [a, b, c] = t.map(|v| points[v as usize]);
    (b - a).cross(c - a)
}

/// How often the surface goes round a place below each point, and above it; `step`: how far, in diagonals.
fn sides(points: &[DVec3], triangles: &[[u32; 3]], step: f64) -> Vec<[i32; 2]> {
    let tree = TriangleTree::new(points, triangles);
    let (lo, hi) = tree.bounds().unwrap();
    let step = step * (hi - lo).length();
    let mut normals = vec![DVec3::ZERO; points.len()];
    for t in triangles {
        t.iter().for_each(|&v| normals[v as usize] += area(points, *t));
    }
    let at = |p: DVec3| tree.winding(p).round() as i32;
    points.iter().zip(&normals).map(|(p, n)| [-1.0, 1.0].map(|side| at(*p + n.normalize_or_zero() * (side * step)))).collect()
}
