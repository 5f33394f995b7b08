//! Captured surfaces as captures, through the program: sequences of meshes and rigid segments against the truth that they are.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, read_pc2, retarget, retarget_ok, shared};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
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
fn the_rig_file_of_a_sequence_fed_back_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for (name, angle) in [("bend_001.obj", 0.1), ("bend_002.obj", 0.4), ("bend_003.obj", 0.9), ("scan.obj", 0.0)] {
        write(&folder.path().join(name), &bar(angle), if name == "scan.obj" { 2.0 } else { 1.0 });
    }
    let first = ["scan.obj", "bend_001.obj", "-o", "first.pc2", "--save-rig", "first.toml"];
    retarget_ok(folder.path(), first);
    retarget_ok(
        folder.path(),
        ["scan.obj", "bend_001.obj", "-o", "again.pc2", "--rig", "first.toml", "--save-rig", "again.toml"],
    );
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("first.toml"), bytes("again.toml"));
    assert!(bytes("first.pc2") == bytes("again.pc2"), "other bytes after a round trip of the rig file");
    // Frames that move, so that sameness says something.
    let frames = read_pc2(&folder.path().join("again.pc2"));
    assert!(frames[0].iter().zip(&frames[2]).any(|(a, b)| (a[1] - b[1]).abs() > 1.0));
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
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("is not that of the scan") && said.contains("--ref N"), "{said}");
}

#[test]
fn vertices_off_the_scan_hold_nothing() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("scan.obj"), &bar(0.0), 1.0);
    // The bar with other faces, and beside it a flap that is not of the scan.
    for (number, angle) in [(1, 0.0), (2, 0.3)] {
        let mut text = String::new();
        let flap = [[4.0, 1.4, 0.0], [5.0, 1.4, 0.0], [4.5, 1.4, 0.3]];
        bar(angle).iter().chain(&flap).for_each(|[x, y, z]| writeln!(text, "v {x} {y} {z}").unwrap());
        let beside = [bar(0.0).len(), bar(0.0).len() + 1, bar(0.0).len() + 2];
        for face in faces().into_iter().chain([beside.to_vec()]) {
            (1..face.len() - 1).for_each(|k| writeln!(text, "f {} {} {}", face[0] + 1, face[k] + 1, face[k + 1] + 1).unwrap());
        }
        std::fs::write(folder.path().join(format!("bend_{number}.obj")), text).unwrap();
    }
    for more in [&[][..], &["--align", "none"]] {
        let arguments = ["scan.obj", "bend_1.obj", "-o", "out.pc2", "--force"].into_iter().chain(more.iter().copied());
        let said = retarget_ok(folder.path(), arguments);
        assert!(said.contains("400 of 659 vertices bound, median 0.000 off the surface, worst 0.000 "), "{said}");
    }
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

/// The body of the fixtures, whose faces belong to rigid parts.
struct Parts {
    points: Vec<DVec3>,
    faces: Vec<(Vec<usize>, usize)>,
}

/// Trunk, head, arms and legs: where they turn, about which axis, and how far from one frame to the next.
const PARTS: [(&str, [f64; 3], [f64; 3], f64); 6] = [
    ("trunk", [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 0.0),
    ("head", [0.0, 1.5, 0.0], [0.0, 1.0, 0.0], 0.1),
    ("left arm", [0.19, 1.4, 0.0], [0.0, 0.0, 1.0], 0.08),
    ("right arm", [-0.19, 1.4, 0.0], [0.0, 0.0, 1.0], -0.08),
    ("left leg", [0.1, 0.92, 0.0], [1.0, 0.0, 0.0], 0.06),
    ("right leg", [-0.1, 0.92, 0.0], [1.0, 0.0, 0.0], -0.06),
];
/// Frames of the segments; in the middle one they stand like the scan.
const FRAMES: usize = 9;
const MIDDLE: usize = 4;

impl Parts {
    fn of_fixture() -> Self {
        let text = std::fs::read_to_string(fixture("scan.obj")).unwrap();
        let mut body = Self { points: Vec::new(), faces: Vec::new() };
        let mut group = "";
        for line in text.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let xyz: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
                    body.points.push(DVec3::new(xyz[0], xyz[1], xyz[2]));
                }
                Some("g") => group = words.next().unwrap(),
                Some("f") => {
                    let corner = |w: &str| w.split('/').next().unwrap().parse::<usize>().unwrap() - 1;
                    let face: Vec<usize> = words.map(corner).collect();
                    let middle = face.iter().map(|&v| body.points[v]).sum::<DVec3>() / face.len() as f64;
                    let right = usize::from(middle.x < 0.0);
                    let part = match group {
                        "head" => 1,
                        "sleeves" | "hands" => 2 + right,
                        _ if middle.y < 0.88 => 4 + right,
                        _ => 0,
                    };
                    body.faces.push((face, part));
                }
                _ => {}
            }
        }
        body
    }

    /// How a part moves from where it is in the middle frame.
    fn motion(part: usize, frame: usize) -> (DQuat, DVec3) {
        let (_, pivot, axis, step) = PARTS[part];
        let k = frame as f64 - MIDDLE as f64;
        let turn = DQuat::from_axis_angle(axis.into(), step * k);
        (turn, DVec3::from(pivot) - turn * DVec3::from(pivot) + DVec3::new(0.0, 0.0, 0.1 * k))
    }

    /// Vertices well inside of their parts.
    fn inner(&self) -> Vec<(usize, usize)> {
        let mut of_vertex = vec![None; self.points.len()];
        self.faces.iter().for_each(|(face, part)| face.iter().for_each(|&v| of_vertex[v] = Some(*part)));
        let parts = (0..).zip(of_vertex).filter_map(|(v, part)| Some((v, part?)));
        let far = |(v, part): &(usize, usize)| {
            *part > 1 && self.points[*v].distance(PARTS[*part].1.into()) > 0.25
                || *part == 1 && self.points[*v].y > 1.62
                || *part == 0 && (1.0..1.3).contains(&self.points[*v].y) && self.points[*v].x.abs() < 0.1
        };
        parts.filter(far).collect()
    }

    /// Writes the parts as meshes of nodes under one node, which `size` and `turn` bring elsewhere.
    fn write(&self, folder: &Path, size: f64, turn: DQuat) {
        let mut binary: Vec<u8> = Vec::new();
        let (mut views, mut accessors) = (Vec::<Value>::new(), Vec::<Value>::new());
        let mut add = |bytes: Vec<u8>, count: usize, component: u32, kind: &str| {
            views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() }));
            accessors.push(json!({ "bufferView": views.len() - 1, "componentType": component, "count": count, "type": kind }));
            binary.extend(bytes);
            accessors.len() - 1
        };
        let mut floats = |rows: &[f64], columns: usize, kind: &str| {
            add(rows.iter().flat_map(|x| (*x as f32).to_le_bytes()).collect(), rows.len() / columns, 5126, kind)
        };
        let times = floats(&(0..FRAMES).map(|k| 0.25 * k as f64).collect::<Vec<_>>(), 1, "SCALAR");
        let at = DVec3::new(7e3, -2e3, 4e3);
        let walk: Vec<f64> = (0..FRAMES)
            .flat_map(|k| (at + turn * DVec3::new(0.0, 0.0, 0.1 * size * (k as f64 - MIDDLE as f64))).to_array())
            .collect();
        let walk = floats(&walk, 3, "VEC3");
        let mut nodes = vec![json!({
            "name": "world", "scale": [size, size, size], "rotation": turn.to_array(), "children": (1..=PARTS.len()).collect::<Vec<_>>(),
        })];
        let mut meshes = Vec::new();
        let mut samplers = vec![json!({ "input": times, "output": walk })];
        let mut channels = vec![json!({ "sampler": 0, "target": { "node": 0, "path": "translation" } })];
        for (part, (name, pivot, ..)) in PARTS.iter().enumerate() {
            let mut numbers = vec![None; self.points.len()];
            let (mut points, mut indices) = (Vec::new(), Vec::<f64>::new());
            for (face, _) in self.faces.iter().filter(|f| f.1 == part) {
                let mut number = |v: usize| {
                    *numbers[v].get_or_insert_with(|| {
                        points.extend((self.points[v] - DVec3::from(*pivot)).to_array());
                        points.len() / 3 - 1
                    })
                };
                let corners: Vec<usize> = face.iter().map(|&v| number(v)).collect();
                (1..corners.len() - 1).for_each(|k| indices.extend([corners[0], corners[k], corners[k + 1]].map(|v| v as f64)));
            }
            let position = floats(&points, 3, "VEC3");
            let turns: Vec<f64> = (0..FRAMES).flat_map(|k| Self::motion(part, k).0.to_array()).collect();
            let turns = floats(&turns, 4, "VEC4");
            meshes.push(json!({ "primitives": [{ "attributes": { "POSITION": position }, "indices": indices }] }));
            nodes.push(json!({ "name": name, "translation": pivot, "mesh": part }));
            samplers.push(json!({ "input": times, "output": turns }));
            channels.push(json!({ "sampler": part + 1, "target": { "node": part + 1, "path": "rotation" } }));
        }
        for mesh in &mut meshes {
            let indices = &mut mesh["primitives"][0]["indices"];
            let list: Vec<u8> =
                indices.as_array().unwrap().iter().flat_map(|x| (x.as_f64().unwrap() as u32).to_le_bytes()).collect();
            let count = list.len() / 4;
            *indices = json!(add(list, count, 5125, "SCALAR"));
        }
        let document = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": nodes, "meshes": meshes,
            "animations": [{ "channels": channels, "samplers": samplers }], "accessors": accessors, "bufferViews": views,
            "buffers": [{ "uri": "parts.bin", "byteLength": binary.len() }],
        });
        std::fs::write(folder.join("parts.gltf"), document.to_string()).unwrap();
        std::fs::write(folder.join("parts.bin"), binary).unwrap();
    }

    /// Root mean square and largest distance of the inner vertices from where the parts take them, in per cent of the diagonal.
    fn errors(&self, found: &[[f32; 3]], frame: usize) -> (f64, f64) {
        let inner = self.inner();
        let truth = inner.iter().map(|&(v, part)| {
            let (turn, shift) = Self::motion(part, frame);
            (turn * self.points[v] + shift).to_array()
        });
        let found: Vec<[f32; 3]> = inner.iter().map(|&(v, _)| found[v]).collect();
        errors(&found, &truth.collect::<Vec<_>>(), 2.25)
    }
}

#[test]
fn rigid_segments_of_another_unit_and_facing_find_their_place_and_move_the_scan() {
    let body = Parts::of_fixture();
    let folder = tempfile::tempdir().unwrap();
    let scan = fixture("scan.obj");
    let run = |out: &str, more: &[&str]| {
        let arguments = [scan.to_str().unwrap(), "parts.gltf", "-o", out].into_iter().chain(more.iter().copied());
        retarget_ok(folder.path(), arguments)
    };
    // A hundred and thirty degrees about up, and lying on its side: what is up is then told by the shapes alone.
    let facing = DQuat::from_rotation_y(130f64.to_radians());
    for (turn, yaw) in [(facing, Some("yaw -130")), (DQuat::from_rotation_x(1.5) * facing, None)] {
        body.write(folder.path(), 1000.0, turn);
        let said = run("out.pc2", &["--force"]);
        assert!(said.contains("vertices, 9 frames at 4 Hz") && said.contains("400 of 2,000 vertices bound"), "{said}");
        assert!(said.contains("scale 0.001") && yaw.is_none_or(|yaw| said.contains(yaw)), "{said}");
        assert_eq!(yaw.is_none(), said.contains("only if it is not upright"), "{said}");
        let frames = read_pc2(&folder.path().join("out.pc2"));
        assert_eq!(frames.len(), FRAMES);
        for frame in [0, MIDDLE, FRAMES - 1] {
            let (rms, worst) = body.errors(&frames[frame], frame);
            assert!(rms < 0.5 && worst < 2.0, "frame {frame}: {rms:.3} % {worst:.3} %\n{said}");
        }
    }
    // The nodes alone are joints.
    let arguments = [scan.to_str().unwrap(), "parts.gltf", "-o", "joints.pc2", "--bodies"];
    let said = String::from_utf8(retarget(folder.path(), arguments).stderr).unwrap();
    assert!(said.contains("joint") && !said.contains("surface"), "{said}");
}
