//! Meshes for the laws: made here, and the fixture scan.

use super::common;
use glam::DVec3;
use retarget::scan::{self, UnitBox};

/// A named mesh in the unit box.
pub struct Shape {
    pub name: &'static str,
    pub points: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    fn new(name: &'static str, points: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Self {
        let (lo, hi) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)));
        let (centre, diagonal) = ((lo + hi) * 0.5, (hi - lo).length());
        Self { name, points: points.into_iter().map(|p| (p - centre) / diagonal).collect(), triangles }
    }

    /// Vertices far from each other, starting at the first.
    pub fn spread(&self, count: usize) -> Vec<DVec3> {
        let mut chosen = vec![self.points[0]];
        while chosen.len() < count {
            let away = |p: &DVec3| chosen.iter().map(|c| c.distance_squared(*p)).fold(f64::INFINITY, f64::min);
            let next = self.points.iter().copied().max_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
            chosen.push(next);
        }
        chosen
    }
}

/// A tube of rings between two caps: `ring(i)` gives centre, two axes of the cross-section.
fn tube(name: &'static str, rings: usize, sides: usize, ring: impl Fn(f64) -> (DVec3, DVec3, DVec3)) -> Shape {
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    for i in 0..=rings {
        let (centre, a, b) = ring(i as f64 / rings as f64);
        for s in 0..sides {
            let angle = s as f64 / sides as f64 * std::f64::consts::TAU;
            points.push(centre + a * angle.cos() + b * angle.sin());
        }
    }
    let at = |i: usize, s: usize| (i * sides + s % sides) as u32;
    for i in 0..rings {
        for s in 0..sides {
            triangles.push([at(i, s), at(i, s + 1), at(i + 1, s + 1)]);
            triangles.push([at(i, s), at(i + 1, s + 1), at(i + 1, s)]);
        }
    }
    for (i, flip) in [(0, true), (rings, false)] {
        let centre = points.len() as u32;
        points.push(ring(i as f64 / rings as f64).0);
        for s in 0..sides {
            let (a, b) = if flip { (at(i, s + 1), at(i, s)) } else { (at(i, s), at(i, s + 1)) };
            triangles.push([centre, a, b]);
        }
    }
    Shape::new(name, points, triangles)
}

/// A straight round bar, four times as long as wide.
pub fn bar() -> Shape {
    tube("bar", 60, 24, |t| (DVec3::X * t * 4.0, DVec3::Y * 0.5, DVec3::Z * 0.5))
}

/// A bent horn that tapers, far from the origin of its own space.
fn horn() -> Shape {
    tube("horn", 80, 28, |t| {
        let angle = t * 2.2;
        let radius = 0.35 - 0.2 * t;
        let outward = DVec3::new(angle.cos(), angle.sin(), 0.0);
        (DVec3::new(3e4, -1e4, 0.0) + outward * 1.5, outward * radius, DVec3::Z * radius)
    })
}

/// A dumb-bell: two bulbs on a thin neck.
fn bells() -> Shape {
    tube("bells", 90, 30, |t| {
        let radius =
            0.18 + 0.5 * (1.0 - (t * 2.0 - 1.0).powi(2) * 4.0 / 3.0).abs().min(0.5) * (t * std::f64::consts::TAU).cos().abs();
        (DVec3::Y * t * 3.0, DVec3::Z * radius, DVec3::X * radius)
    })
}

/// All of them.
pub fn all() -> Vec<Shape> {
    let scan = scan::read(&common::fixture("scan.obj")).unwrap();
    let unit = UnitBox::of(&scan.mesh).unwrap();
    let points = scan.mesh.positions.iter().map(|&p| unit.enter(p)).collect();
    vec![bar(), horn(), bells(), Shape { name: "fixture scan", points, triangles: scan.mesh.vertex_triangles() }]
}
