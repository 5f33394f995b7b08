//! Meshes for the laws: made here, the fixture scan in three poses, and real ones where they are present.

use super::cases::TAKES;
use super::common;
use glam::DVec3;
use retarget::scan;

/// What a mesh stands for: the suite counts them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    WholeBody,
    Quadruped,
    Thin,
    Parts,
    Other,
}

/// A named mesh in the unit box.
pub struct Shape {
    pub name: &'static str,
    pub kind: Kind,
    pub points: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Whether no edge has more than two triangles, as a shell needs.
    pub is_surface: bool,
}

impl Shape {
    fn new(name: &'static str, kind: Kind, points: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Self {
        let (lo, hi) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)));
        let (centre, diagonal) = ((lo + hi) * 0.5, (hi - lo).length());
        Self { name, kind, points: points.into_iter().map(|p| (p - centre) / diagonal).collect(), triangles, is_surface: true }
    }

    /// Other poses, as two of the takes have them half way.
    pub fn examples(&self) -> Vec<Vec<DVec3>> {
        TAKES[..2].iter().map(|take| self.points.iter().map(|p| (take.motion)(0.5, *p)).collect()).collect()
    }

    /// The longest side of its box.
    pub fn height(&self) -> f64 {
        let (lo, hi) = self.points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)));
        (hi - lo).max_element()
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

/// Points and triangles of a tube of rings between two caps: `ring(t)` gives centre and two axes of the cross-section for t from 0 to 1.
fn tube(rings: usize, sides: usize, ring: impl Fn(f64) -> (DVec3, DVec3, DVec3)) -> (Vec<DVec3>, Vec<[u32; 3]>) {
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
    (points, triangles)
}

/// A capsule-like limb from `a` to `b`.
fn limb(a: DVec3, b: DVec3, radii: [f64; 2]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let axis = (b - a).normalize();
    let (u, v) = axis.any_orthonormal_pair();
    tube(24, 16, move |t| {
        let radius = (radii[0] + (radii[1] - radii[0]) * t) * (1.0 - (2.0 * t - 1.0).powi(8) * 0.6);
        (a.lerp(b, t), u * radius, v * radius)
    })
}

/// Several surfaces as one mesh.
fn together(pieces: impl IntoIterator<Item = (Vec<DVec3>, Vec<[u32; 3]>)>) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (p, t) in pieces {
        let first = points.len() as u32;
        points.extend(p);
        triangles.extend(t.into_iter().map(|t| t.map(|v| v + first)));
    }
    (points, triangles)
}

/// A straight round bar, four times as long as wide.
pub fn bar() -> Shape {
    let (points, triangles) = tube(60, 24, |t| (DVec3::X * t * 4.0, DVec3::Y * 0.5, DVec3::Z * 0.5));
    Shape::new("bar", Kind::Other, points, triangles)
}

/// A bent horn that tapers, far from the origin of its own space.
fn horn() -> Shape {
    let (points, triangles) = tube(80, 28, |t| {
        let angle = t * 2.2;
        let radius = 0.35 - 0.2 * t;
        let outward = DVec3::new(angle.cos(), angle.sin(), 0.0);
        (DVec3::new(3e4, -1e4, 0.0) + outward * 1.5, outward * radius, DVec3::Z * radius)
    });
    Shape::new("horn", Kind::Other, points, triangles)
}

/// A dumb-bell: two bulbs on a thin neck, a little bent.
fn bells() -> Shape {
    let (points, triangles) = tube(90, 30, |t| {
        let radius =
            0.18 + 0.5 * (1.0 - (t * 2.0 - 1.0).powi(2) * 4.0 / 3.0).abs().min(0.5) * (t * std::f64::consts::TAU).cos().abs();
        (DVec3::new(0.1 * t * t, 3.0 * t, 0.05 * t), DVec3::Z * radius, DVec3::X * radius)
    });
    Shape::new("bells", Kind::Other, points, triangles)
}

/// A blade, twenty times as wide as thick.
fn blade() -> Shape {
    let (points, triangles) = tube(60, 48, |t| {
        let width = 0.4 * (1.0 - (2.0 * t - 1.0).powi(6) * 0.5);
        (DVec3::X * t * 2.0, DVec3::Y * width, DVec3::Z * 0.02)
    });
    Shape::new("blade", Kind::Thin, points, triangles)
}

/// Trunk, neck, head, tail and four legs, each a closed surface that runs into the trunk.
fn beast() -> Shape {
    let at = DVec3::new;
    let mut limbs = vec![
        limb(at(-0.75, 0.9, 0.0), at(0.75, 0.95, 0.0), [0.30, 0.32]),
        limb(at(0.40, 0.9, 0.0), at(1.10, 1.60, 0.0), [0.24, 0.20]),
        limb(at(0.80, 1.45, 0.0), at(1.45, 1.40, 0.0), [0.22, 0.16]),
        limb(at(-0.40, 0.95, 0.0), at(-1.20, 0.75, 0.0), [0.18, 0.12]),
    ];
    for (x, z) in [(0.5, 0.17), (0.5, -0.17), (-0.5, 0.17), (-0.5, -0.17)] {
        limbs.push(limb(at(x, 1.0, z), at(x, 0.0, z), [0.16, 0.13]));
    }
    let (points, triangles) = together(limbs);
    Shape::new("beast", Kind::Quadruped, points, triangles)
}

/// Three bodies that do not touch.
fn parts() -> Shape {
    let (points, triangles) = together([
        limb(DVec3::new(0.0, 0.0, 0.0), DVec3::new(0.0, 1.2, 0.0), [0.3, 0.2]),
        limb(DVec3::new(0.9, 0.1, 0.0), DVec3::new(1.6, 0.8, 0.0), [0.2, 0.2]),
        limb(DVec3::new(0.3, 0.3, 1.0), DVec3::new(1.3, 0.3, 1.0), [0.25, 0.15]),
    ]);
    Shape::new("parts", Kind::Parts, points, triangles)
}

/// The fixture scan, or its faces over other points.
fn person(name: &'static str, points: Option<&str>) -> Shape {
    let scan = scan::read(&common::fixture("scan.obj")).unwrap();
    let triangles = scan.mesh.vertex_triangles();
    let points = points.map_or(scan.mesh.positions, |file| common::read_ply_points(&common::fixture(file)));
    // Where it touches itself, its sheets have grown together.
    Shape { is_surface: false, ..Shape::new(name, Kind::WholeBody, points, triangles) }
}

/// A mesh of the shared data, where it is present.
fn real(name: &'static str, kind: Kind, file: &str) -> Option<Shape> {
    let mesh = scan::read(&common::shared()?.join("meshes/bodies").join(file)).unwrap().mesh;
    let triangles = mesh.vertex_triangles();
    Some(Shape::new(name, kind, mesh.positions, triangles))
}

/// The meshes that are always there.
pub fn own() -> Vec<Shape> {
    vec![
        bar(),
        horn(),
        bells(),
        blade(),
        beast(),
        parts(),
        person("person", None),
        person("walking person", Some("true_0111.ply")),
        person("squatting person", Some("true_0307.ply")),
    ]
}

/// All of them.
pub fn all() -> Vec<Shape> {
    let real = [
        real("smpl", Kind::WholeBody, "smpl_man_tpose.obj.gz"),
        real("male", Kind::WholeBody, "makehuman_male_body_apose_quads.obj.gz"),
        real("horse", Kind::Quadruped, "horse_quad.obj"),
        real("cow", Kind::Quadruped, "spot_cow_uv.obj.gz"),
    ];
    own().into_iter().chain(real.into_iter().flatten()).collect()
}
