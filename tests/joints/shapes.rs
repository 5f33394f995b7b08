//! Pieces of two parts with known joints: outlines turned about an axis. With four or six corners around they are square or hexagonal.

use glam::{DMat3, DQuat, DVec3};
use retarget::glam;
use retarget::joints::{Kind, Part};

/// A closed surface over an outline of (radius, height), counter-clockwise, with so many corners around the axis Z.
pub fn turned(outline: &[(f64, f64)], around: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for &(r, h) in outline {
        for k in 0..around {
            let angle = (k as f64 + 0.5) * std::f64::consts::TAU / around as f64;
            points.push(DVec3::new(r * angle.cos(), r * angle.sin(), h));
        }
    }
    let mut triangles = Vec::new();
    let at = |i: usize, k: usize| ((i % outline.len()) * around + k % around) as u32;
    for i in 0..outline.len() {
        for k in 0..around {
            let quad = [at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)];
            triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        }
    }
    (points, triangles)
}

/// A closed surface over a convex outline, swept by a part of a turn, from the axis X on.
fn swept(outline: &[(f64, f64)], steps: usize, angle: f64) -> Mesh {
    let mut points = Vec::new();
    for k in 0..=steps {
        let (sin, cos) = (angle * k as f64 / steps as f64).sin_cos();
        points.extend(outline.iter().map(|&(r, h)| DVec3::new(r * cos, r * sin, h)));
    }
    let n = outline.len();
    let at = |i: usize, k: usize| (k * n + i % n) as u32;
    let mut triangles = Vec::new();
    for k in 0..steps {
        for i in 0..n {
            triangles.extend([[at(i, k), at(i, k + 1), at(i + 1, k + 1)], [at(i, k), at(i + 1, k + 1), at(i + 1, k)]]);
        }
    }
    for i in 1..n - 1 {
        triangles.extend([[at(0, 0), at(i, 0), at(i + 1, 0)], [at(0, steps), at(i + 1, steps), at(i, steps)]]);
    }
    (points, triangles)
}

pub type Mesh = (Vec<DVec3>, Vec<[u32; 3]>);

/// A piece: what stays, what moves, and the joint between them, about the axis Z through the origin.
pub struct Piece {
    pub name: &'static str,
    pub base: Mesh,
    pub moving: Mesh,
    pub kind: Kind,
    /// Whether the axis of the joint is Z.
    pub has_axis: bool,
    /// Range along Z, where it is known.
    pub slide: Option<f64>,
}

/// Clearance of all pieces.
pub const GAP: f64 = 0.002;

fn tube(inner: f64, outer: f64, half: f64) -> Vec<(f64, f64)> {
    vec![(inner, -half), (outer, -half), (outer, half), (inner, half)]
}

fn rod(radius: f64, half: f64, collar: f64, collar_at: f64) -> Vec<(f64, f64)> {
    vec![
        (0.0, -half),
        (collar, -half),
        (collar, -collar_at),
        (radius, -collar_at),
        (radius, collar_at),
        (collar, collar_at),
        (collar, half),
        (0.0, half),
    ]
}

/// All pieces.
pub fn pieces() -> Vec<Piece> {
    let round = 30;
    let ball = |radius: f64, from: f64, to: f64| -> Vec<(f64, f64)> {
        let steps = 24;
        let angle = |k: usize| (from + (to - from) * k as f64 / steps as f64).to_radians();
        (0..=steps).map(|k| (radius * angle(k).cos(), radius * angle(k).sin())).collect()
    };
    let socket = {
        let mut outline = vec![(0.0, -0.4), (0.35, -0.4), (0.35, 0.12)];
        outline.extend(ball(0.2 + GAP, 30.0, -90.0));
        outline
    };
    let mut knob = ball(0.2, -90.0, 70.0);
    knob.extend([(0.0684, 0.6), (0.0, 0.6)]);
    let piece = |name, base: &[(f64, f64)], moving: &[(f64, f64)], around, kind, has_axis, slide| Piece {
        name,
        base: turned(base, around),
        moving: turned(moving, around),
        kind,
        has_axis,
        slide,
    };
    let cradle = Piece {
        name: "cradle",
        base: swept(&tube(0.1 + GAP, 0.25, 0.2), 24, 200.0_f64.to_radians()),
        moving: turned(&rod(0.1, 0.3, 0.18, 0.2 + GAP), round),
        kind: Kind::Revolute,
        has_axis: true,
        slide: None,
    };
    vec![
        cradle,
        piece("hinge", &tube(0.1 + GAP, 0.25, 0.2), &rod(0.1, 0.3, 0.18, 0.2 + GAP), round, Kind::Revolute, true, None),
        piece("rod", &tube(0.1 + GAP, 0.25, 0.2), &rod(0.1, 0.6, 0.18, 0.45), round, Kind::Cylinder, true, Some(0.25)),
        piece("slider", &tube(0.1 + GAP, 0.25, 0.2), &rod(0.1, 0.6, 0.18, 0.4), 4, Kind::Prismatic, true, Some(0.2)),
        piece("bolted", &tube(0.1 + GAP, 0.25, 0.2), &rod(0.1, 0.3, 0.18, 0.2 + GAP), 6, Kind::Fixed, false, None),
        piece("ball", &socket, &knob, round, Kind::Ball, false, None),
        piece(
            "table",
            &[(0.0, -0.2), (0.6, -0.2), (0.6, 0.0), (0.0, 0.0)],
            &[(0.0, GAP), (0.15, GAP), (0.15, 0.2), (0.0, 0.2)],
            4,
            Kind::Plane,
            true,
            None,
        ),
    ]
}

/// A motion and a size that nothing is aligned with.
#[derive(Clone, Copy)]
pub struct Place {
    pub turn: DMat3,
    pub shift: DVec3,
    pub scale: f64,
}

impl Place {
    pub fn odd(scale: f64) -> Self {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize());
        Self { turn, shift: DVec3::new(0.3, -0.2, 0.7), scale }
    }

    pub fn apply(&self, p: DVec3) -> DVec3 {
        (self.turn * p + self.shift) * self.scale
    }

    /// The two parts of a piece there, and the diagonal of both.
    pub fn parts(&self, piece: &Piece, shuffled: bool) -> (Vec<Part>, f64) {
        let moved = |mesh: &Mesh| mesh.0.iter().map(|&p| self.apply(p)).collect::<Vec<_>>();
        let (base, moving) = (moved(&piece.base), moved(&piece.moving));
        let (lo, hi) =
            base.iter().chain(&moving).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        let size = (hi - lo).length();
        let order = |triangles: &[[u32; 3]]| {
            let mut triangles = triangles.to_vec();
            if shuffled {
                triangles.reverse();
                let half = triangles.len() / 3;
                triangles.rotate_left(half);
                triangles.iter_mut().for_each(|t| t.rotate_left(1));
            }
            triangles
        };
        let part = |name, points: &[DVec3], mesh: &Mesh| Part::new(name, points, &order(&mesh.1), size);
        (vec![part("base", &base, &piece.base), part("moving", &moving, &piece.moving)], size)
    }
}
