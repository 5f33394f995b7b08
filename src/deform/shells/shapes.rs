//! Shapes for the tests: closed tubes and an arm that bends.

use glam::{DMat3, DVec3};

/// A tube of rings around centres, with two unit vectors across each; closed by fans.
pub(crate) fn tube(
    segments: usize,
    centres: &[DVec3],
    frames: &[[DVec3; 2]],
    radius: impl Fn(usize, f64) -> f64,
) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for (i, (centre, [u, v])) in centres.iter().zip(frames).enumerate() {
        for j in 0..segments {
            let angle = std::f64::consts::TAU * j as f64 / segments as f64;
            points.push(*centre + radius(i, angle) * (*u * angle.cos() + *v * angle.sin()));
        }
    }
    let at = |i: usize, j: usize| (i * segments + j % segments) as u32;
    let mut faces = Vec::new();
    for i in 0..centres.len() - 1 {
        for j in 0..segments {
            let (p, q, u, v) = (at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1));
            faces.extend(if (i + j) % 2 == 0 { [[p, q, u], [q, v, u]] } else { [[p, q, v], [p, v, u]] });
        }
    }
    let (first, last) = (points.len() as u32, points.len() as u32 + 1);
    points.extend([centres[0], centres[centres.len() - 1]]);
    for j in 0..segments {
        faces.push([at(0, j + 1), at(0, j), first]);
        faces.push([at(centres.len() - 1, j), at(centres.len() - 1, j + 1), last]);
    }
    (points, faces)
}

/// A straight tube along z.
pub(crate) fn straight(length: f64, radius: f64, rings: usize, segments: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let centres: Vec<DVec3> = (0..rings).map(|i| DVec3::Z * (length * i as f64 / (rings - 1) as f64)).collect();
    tube(segments, &centres, &vec![[DVec3::X, DVec3::Y]; rings], |_, _| radius)
}

/// How an arm is bent, in degrees, and by how much that swells it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Bend {
    pub shoulder: f64,
    pub elbow: f64,
    pub bulge: f64,
}

/// An arm of length 3 along x with a stub of a trunk: shoulder at 0.85, elbow at 1.8, each bent about z over a stretch of 0.8.
pub(crate) fn arm(rings: usize, segments: usize, bend: Bend) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let along: Vec<f64> = (0..rings).map(|i| 3.0 * i as f64 / (rings - 1) as f64).collect();
    let smooth = |s: f64, at: f64| {
        let t = ((s - at) / 0.8 + 0.5).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let turn = |s: f64| DMat3::from_rotation_z((bend.shoulder * smooth(s, 0.85) + bend.elbow * smooth(s, 1.8)).to_radians());
    let (mut centre, mut centres, mut frames) = (DVec3::ZERO, Vec::new(), Vec::new());
    for (i, &s) in along.iter().enumerate() {
        if i > 0 {
            centre += (s - along[i - 1]) * 0.5 * (turn(s) * DVec3::X + turn(along[i - 1]) * DVec3::X);
        }
        centres.push(centre);
        frames.push([turn(s) * DVec3::Y, turn(s) * DVec3::Z]);
    }
    let radius = |i: usize, angle: f64| {
        let s = along[i];
        let plain = 0.30 + (0.18 - 0.30) * smooth(s, 1.9);
        let end = (s.min(3.0 - s) / 0.11).clamp(0.0, 1.0);
        let muscle = bend.bulge * (-((s - 1.25) / 0.25).powi(2)).exp() * angle.cos().max(0.0);
        plain * (1.0 + muscle) * (1.0 - (1.0 - end).powi(2)).clamp(0.02, 1.0).sqrt()
    };
    tube(segments, &centres, &frames, radius)
}

/// Numbers from 0 to 1 that look random.
pub(crate) fn dice(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}
