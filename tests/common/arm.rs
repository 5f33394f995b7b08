//! An arm whose elbow and shoulder have been bent, with a take of handles: for shells, which need a surface.

use glam::{DMat3, DVec3};
use std::fmt::Write;
use std::path::Path;

pub const RINGS: usize = 61;
pub const SEGMENTS: usize = 24;
/// Length of the diagonal of the arm at rest, nearly.
pub const DIAGONAL: f64 = 3.1;

/// An arm of length 3 along x, with shoulder and elbow bent by so many degrees; the muscle swells with the elbow.
pub fn arm(shoulder: f64, elbow: f64) -> Vec<DVec3> {
    let smooth = |s: f64, at: f64| {
        let t = ((s - at) / 0.8 + 0.5).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let turn = |s: f64| DMat3::from_rotation_z((shoulder * smooth(s, 0.85) + elbow * smooth(s, 1.8)).to_radians());
    let (mut points, mut centre, mut before) = (Vec::new(), DVec3::ZERO, 0.0);
    for ring in 0..RINGS {
        let s = 3.0 * ring as f64 / (RINGS - 1) as f64;
        centre += (s - before) * 0.5 * (turn(s) * DVec3::X + turn(before) * DVec3::X);
        before = s;
        for segment in 0..SEGMENTS {
            let angle = std::f64::consts::TAU * segment as f64 / SEGMENTS as f64;
            let muscle = 0.0025 * elbow * (-((s - 1.25) / 0.25).powi(2)).exp() * angle.cos().max(0.0);
            let radius = (0.3 - 0.1 * smooth(s, 1.9)) * (1.0 + muscle) * (1.0 + 0.02 * (9.0 * angle).sin() * (20.0 * s).sin());
            points.push(centre + radius * (turn(s) * (DVec3::Y * angle.cos() + DVec3::Z * angle.sin())));
        }
    }
    points.push(DVec3::ZERO);
    points.push(centre);
    points
}

pub fn faces() -> Vec<[usize; 3]> {
    let at = |ring: usize, segment: usize| ring * SEGMENTS + segment % SEGMENTS;
    let mut faces = Vec::new();
    for ring in 0..RINGS - 1 {
        for segment in 0..SEGMENTS {
            let (p, q, u, v) = (at(ring, segment), at(ring, segment + 1), at(ring + 1, segment), at(ring + 1, segment + 1));
            faces.extend(if (ring + segment) % 2 == 0 { [[p, q, u], [q, v, u]] } else { [[p, q, v], [p, v, u]] });
        }
    }
    let end = RINGS * SEGMENTS;
    for segment in 0..SEGMENTS {
        faces.push([at(0, segment + 1), at(0, segment), end]);
        faces.push([at(RINGS - 1, segment), at(RINGS - 1, segment + 1), end + 1]);
    }
    faces
}

pub fn write_obj(path: &Path, points: &[DVec3], faces: &[[usize; 3]]) {
    let mut text = String::new();
    points.iter().for_each(|p| writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap());
    faces.iter().for_each(|[a, b, c]| writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1).unwrap());
    std::fs::write(path, text).unwrap();
}

/// Angles of shoulder and elbow in each frame; the first is at rest.
pub fn path() -> Vec<(f64, f64)> {
    (0..=20).map(|t| f64::from(t) / 10.0).map(|t| (70.0 * t.min(1.0), 100.0 * (t - 1.0).max(0.0))).collect()
}

/// A folder with the arm, its examples (the elbow's turned and moved), and the table of handles that are led along the path.
pub fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let faces = faces();
    write_obj(&at("arm.obj"), &arm(0.0, 0.0), &faces);
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 2.3);
    let turned: Vec<DVec3> = arm(0.0, 100.0).iter().map(|p| turn * *p + DVec3::new(3.0, -2.0, 1.0)).collect();
    write_obj(&at("elbow.obj"), &arm(0.0, 100.0), &faces);
    write_obj(&at("turned.obj"), &turned, &faces);
    write_obj(&at("shoulder.obj"), &arm(70.0, 0.0), &faces);
    let mut table = "frame,name,x,y,z\n".to_owned();
    for (frame, (shoulder, elbow)) in path().into_iter().enumerate() {
        let points = arm(shoulder, elbow);
        for (ring, segment) in
            [(0, 0), (0, 8), (0, 16), (4, 4), (4, 16), (30, 3), (36, 2), (36, 14), (44, 8), (50, 20), (57, 0), (57, 12)]
        {
            let p = points[ring * SEGMENTS + segment];
            writeln!(table, "{frame},h{ring}_{segment},{},{},{}", p.x, p.y, p.z).unwrap();
        }
    }
    std::fs::write(at("take.csv"), table).unwrap();
    folder
}
