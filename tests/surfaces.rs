//! Captured surfaces as captures, through the program: sequences of meshes against the truth that they are.

#![allow(clippy::unwrap_used)]

mod common;

use common::{read_pc2, retarget, retarget_ok, shared};
use std::fmt::Write;
use std::path::Path;

type Point = [f64; 3];

const RINGS: usize = 40;
const SIDES: usize = 16;

/// A round bar along x from 0 to 10, bent to an arc of `angle` radians.
fn bar(angle: f64) -> Vec<Point> {
    let mut points = Vec::new();
    for ring in 0..=RINGS {
        for side in 0..SIDES {
            let turn = side as f64 / SIDES as f64 * std::f64::consts::TAU;
            let (x, y, z) = (ring as f64 / RINGS as f64 * 10.0, turn.cos(), turn.sin());
            let bent = if angle == 0.0 {
                [x, y, z]
            } else {
                let radius = 10.0 / angle;
                let (sin, cos) = (x / radius).sin_cos();
                [(radius - y) * sin, radius - (radius - y) * cos, z]
            };
            points.push(bent);
        }
    }
    points
}

fn faces() -> Vec<Vec<usize>> {
    let at = |r: usize, s: usize| r * SIDES + s % SIDES;
    let mut faces: Vec<Vec<usize>> = Vec::new();
    for ring in 0..RINGS {
        for side in 0..SIDES {
            faces.push(vec![at(ring, side), at(ring, side + 1), at(ring + 1, side + 1), at(ring + 1, side)]);
        }
    }
    faces.push((0..SIDES).rev().collect());
    faces.push((0..SIDES).map(|s| at(RINGS, s)).collect());
    faces
}

fn write(path: &Path, points: &[Point], scale: f64) {
    let mut text = String::new();
    for [x, y, z] in points {
        writeln!(text, "v {} {} {}", x * scale, y * scale, z * scale).unwrap();
    }
    for face in faces() {
        let corners: Vec<String> = face.iter().map(|v| (v + 1).to_string()).collect();
        writeln!(text, "f {}", corners.join(" ")).unwrap();
    }
    std::fs::write(path, text).unwrap();
}

/// Root mean square and largest distance from the truth, in per cent of `size`.
fn errors(found: &[[f32; 3]], truth: &[Point], size: f64) -> (f64, f64) {
    assert_eq!(found.len(), truth.len());
    let far = |(a, b): (&[f32; 3], &Point)| (0..3).map(|k| (f64::from(a[k]) - b[k]).powi(2)).sum::<f64>().sqrt() / size * 100.0;
    let all: Vec<f64> = found.iter().zip(truth).map(far).collect();
    let squared: f64 = all.iter().map(|d| d * d).sum();
    ((squared / all.len() as f64).sqrt(), all.into_iter().fold(0.0, f64::max))
}

#[test]
fn a_sequence_of_meshes_moves_the_scan_of_the_same_thing() {
    let folder = tempfile::tempdir().unwrap();
    let angle = |number: usize| 0.25 * (number - 2) as f64;
    // The sequence begins bent; numbers 4 and 6 are not there.
    for number in [3, 5, 7] {
        write(&folder.path().join(format!("bend_{number:03}.obj")), &bar(angle(number)), 1.0);
    }
    write(&folder.path().join("scan.obj"), &bar(0.0), 1.0);
    let said = retarget_ok(folder.path(), ["scan.obj", "bend_005.obj", "-o", "out.pc2", "--rate", "12"]);
    assert!(said.contains("vertices, 5 frames at 12 Hz"), "{said}");
    assert!(said.contains("400 of 656 vertices bound"), "{said}");
    let frames = read_pc2(&folder.path().join("out.pc2"));
    assert_eq!(frames.len(), 5);
    for (k, number) in [(0, 3), (2, 5), (4, 7)] {
        let (rms, worst) = errors(&frames[k], &bar(angle(number)), 10.4);
        assert!(rms < 0.3 && worst < 1.5, "frame {number}: {rms:.3} % {worst:.3} %");
    }
    // The frame between two files lies on their way.
    let (rms, _) = errors(&frames[1], &bar(angle(4)), 10.4);
    assert!(rms < 1.0, "{rms:.3} %");
}

#[test]
fn a_scan_of_another_size_scales_the_sequence_and_another_thing_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for number in [1, 2] {
        write(&folder.path().join(format!("bend_{number}.obj")), &bar(0.4 * number as f64), 1.0);
    }
    write(&folder.path().join("large.obj"), &bar(0.0), 3.0);
    let said = retarget_ok(folder.path(), ["large.obj", "bend_1.obj", "-o", "out.pc2", "--clip", "Walk"]);
    // What nobody says is said.
    assert!(said.contains("2 frames at 30 Hz") && said.contains("30 Hz is assumed"), "{said}");
    assert!(said.contains("--clip is given but not used: it says nothing of a sequence of meshes"), "{said}");
    assert!(said.contains("3.0") && said.contains("times the size of the captured surface"), "{said}");
    let frames = read_pc2(&folder.path().join("out.pc2"));
    let length = |p: &[[f32; 3]]| {
        let middle = |ring: usize| -> Point {
            let points = &p[ring * SIDES..(ring + 1) * SIDES];
            [0, 1, 2].map(|k| points.iter().map(|q| f64::from(q[k])).sum::<f64>() / SIDES as f64)
        };
        (1..=RINGS).map(|r| (0..3).map(|k| (middle(r)[k] - middle(r - 1)[k]).powi(2)).sum::<f64>().sqrt()).sum::<f64>()
    };
    assert!((length(&frames[1]) / 30.0 - 1.0).abs() < 0.03, "{}", length(&frames[1]));

    let elsewhere = "v 100 0 0\nv 130 0 0\nv 100 30 0\nv 100 0 30\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
    std::fs::write(folder.path().join("other.obj"), elsewhere).unwrap();
    let refused = retarget(folder.path(), ["other.obj", "bend_1.obj", "-o", "no.pc2"]);
    assert_eq!(refused.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("is not that of the scan"));
}

#[test]
fn the_running_cat_moves_its_own_reference() {
    let Some(data) = shared() else { return };
    let folder = tempfile::tempdir().unwrap();
    let cat = data.join("motion/objseq_cat");
    let arguments = [cat.join("cat_reference.obj"), cat.join("cat_000001.obj"), "-o".into(), "out.pc2".into()];
    let said = retarget_ok(folder.path(), arguments);
    assert!(said.contains("16 frames at 30 Hz"), "{said}");
    let frames = read_pc2(&folder.path().join("out.pc2"));
    for number in [1, 4, 7, 10, 13, 16] {
        let text = std::fs::read_to_string(cat.join(format!("cat_{number:06}.obj"))).unwrap();
        let truth: Vec<Point> = text
            .lines()
            .filter_map(|line| line.strip_prefix("v "))
            .map(|line| {
                let xyz: Vec<f64> = line.split_whitespace().map(|x| x.parse().unwrap()).collect();
                // The reference is ten times as large.
                [10.0 * xyz[0], 10.0 * xyz[1], 10.0 * xyz[2]]
            })
            .collect();
        let size = (0..3)
            .map(|k| {
                let (lo, hi) = truth.iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[k]), hi.max(p[k])));
                (hi - lo).powi(2)
            })
            .sum::<f64>()
            .sqrt();
        let (rms, worst) = errors(&frames[number - 1], &truth, size);
        assert!(rms < 0.5 && worst < 3.0, "frame {number}: {rms:.3} % {worst:.3} %");
    }
}
