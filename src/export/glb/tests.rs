#![allow(clippy::unwrap_used)]

use super::*;
use crate::error::Kind;
use crate::export::Cancel;
use crate::proxy::{Proxy, rows::MapKind};
use crate::scan::{Faces, Material, Scan, SurfaceMesh, UnitBox};
use crate::surface::SurfaceMap;
use glam::{DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const CELLS: [usize; 3] = [24, 3, 3];
pub(in crate::export) const FRAMES: usize = 24;
const RATE: f64 = 120.0;

/// A bar of 24 × 3 × 3 cubes of six tetrahedra each, three units long.
fn bar() -> (Vec<DVec3>, Vec<[u32; 4]>) {
    let node = |x: usize, y: usize, z: usize| ((x * (CELLS[1] + 1) + y) * (CELLS[2] + 1) + z) as u32;
    let mut points = Vec::new();
    let mut tets = Vec::new();
    for x in 0..=CELLS[0] {
        for y in 0..=CELLS[1] {
            for z in 0..=CELLS[2] {
                points.push(DVec3::new(x as f64, y as f64, z as f64) / 8.0);
                if x < CELLS[0] && y < CELLS[1] && z < CELLS[2] {
                    for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
                        let mut corner = [x, y, z];
                        let mut tet = [node(x, y, z); 4];
                        for (k, axis) in order.into_iter().enumerate() {
                            corner[axis] += 1;
                            tet[k + 1] = node(corner[0], corner[1], corner[2]);
                        }
                        tets.push(tet);
                    }
                }
            }
        }
    }
    for tet in &mut tets {
        let p = tet.map(|v| points[v as usize]);
        if (p[1] - p[0]).cross(p[2] - p[0]).dot(p[3] - p[0]) < 0.0 {
            tet.swap(2, 3);
        }
    }
    (points, tets)
}

fn boundary(tets: &[[u32; 4]]) -> Vec<([u32; 3], u32)> {
    let mut once = BTreeMap::new();
    for (t, tet) in tets.iter().enumerate() {
        for face in [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]] {
            let face = face.map(|k: usize| tet[k]);
            let mut key = face;
            key.sort_unstable();
            if once.remove(&key).is_none() {
                once.insert(key, (face, t as u32));
            }
        }
    }
    once.into_values().collect()
}

/// The bar as scan (its surface, with a seam, two materials and colours) and as proxy, `shift` away from the origin.
pub(in crate::export) fn header(shift: DVec3) -> Arc<Header> {
    let (points, tets) = bar();
    let outside = boundary(&tets);
    let mut faces = Faces::default();
    outside.iter().for_each(|(face, _)| faces.push(*face));
    let mut scan = Scan {
        mesh: SurfaceMesh { positions: points.iter().map(|&p| p + shift).collect(), faces },
        source: "folder/bar.obj".into(),
        ..Scan::default()
    };
    let count = outside.len();
    scan.look.materials = ["skin", "cloth"].map(|n| Material { name: n.to_owned(), ..Material::default() }).to_vec();
    scan.look.face_materials = (0..count).map(|f| if f < count / 3 { 1 } else { 0 }).collect();
    scan.look.uvs = vec![[0.25, 0.75], [0.5, 0.5]];
    scan.look.corner_uvs = (0..3 * count).map(|c| u32::from(c > 2 * count)).collect();
    scan.look.colors = points.iter().map(|p| [(p.x / 3.0) as f32, 0.5, 0.0, 1.0]).collect();
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let rest: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let proxy = Proxy {
        rest: rest.clone(),
        components: vec![0; tets.len()],
        tets,
        boundary: outside.iter().map(|f| f.0).collect(),
        boundary_tets: outside.iter().map(|f| f.1).collect(),
    };
    let map = SurfaceMap::build(&proxy, &rest, MapKind::Ring).unwrap();
    let places = [("left", 0.0), ("right", 3.0)];
    Arc::new(Header {
        places: places.map(|(n, x)| (n.to_owned(), unit_box.enter(DVec3::new(x, 0.2, 0.2) + shift))).to_vec(),
        scan: Arc::new(scan),
        unit_box,
        proxy: Arc::new(proxy),
        map: Arc::new(map),
        take: "walk".into(),
        rate: RATE,
        first_frame: 50,
        frames: FRAMES,
        up: Some(DVec3::Y),
        metres: None,
        cancel: Cancel::default(),
    })
}

/// The bar bends, twists and wanders.
pub(in crate::export) fn pose(header: &Header, frame: usize) -> Vec<DVec3> {
    pose_at(header, frame as f64)
}

/// The same between frames.
pub(super) fn pose_at(header: &Header, frame: f64) -> Vec<DVec3> {
    let phase = frame / (header.frames - 1) as f64;
    let (bend, twist) = (1.6 * (6.0 * phase).sin() + 1e-3, 1.2 * phase);
    let wander = DQuat::from_rotation_y(2.0 * phase);
    let place = |p: &DVec3| {
        let along = p.x / 0.98;
        let p = DQuat::from_rotation_x(twist * along) * *p;
        let radius = 0.98 / bend;
        let (s, c) = (along * bend).sin_cos();
        let bent = DVec3::new((radius - p.y) * s, radius - (radius - p.y) * c, p.z);
        wander * bent + DVec3::new(phase, 0.3 * phase, 0.0)
    };
    header.proxy.rest.iter().map(place).collect()
}

fn encode(header: &Arc<Header>, path: &Path, pose: impl Fn(usize) -> Vec<DVec3>) -> Written {
    encode_as(header, path, Options::default(), pose).unwrap()
}

pub(super) fn encode_as(
    header: &Arc<Header>,
    path: &Path,
    options: Options,
    pose: impl Fn(usize) -> Vec<DVec3>,
) -> Result<Written> {
    let mut sink: Box<dyn FrameSink> = Box::new(GlbSink::of(path, &Recording::new(options)));
    sink.begin(header)?;
    for first in (0..header.frames).step_by(8) {
        let poses: Vec<Vec<DVec3>> = (first..header.frames.min(first + 8)).map(&pose).collect();
        sink.frames(&FrameBatch { first, proxy: &poses, points: &[], normals: &[] })?;
    }
    sink.finish()
}

use super::reader::Read;

/// The largest distance between what a reader sees and the motion, and its frame.
pub(super) fn worst_of(header: &Header, path: &Path, pose: impl Fn(usize) -> Vec<DVec3>) -> (f64, usize) {
    let read = Read::open(path);
    (0..header.frames)
        .map(|f| (read.distance(header, f as f64, &pose(f)), f))
        .fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a })
}

#[test]
fn a_bar_that_bends_and_twists_comes_back_within_the_measured_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    for shift in [DVec3::ZERO, DVec3::new(3e6, -2e6, 5e5)] {
        let header = header(shift);
        let written = encode(&header, &path, |f| pose(&header, f));
        // The inner nodes of the bar; nothing is said about the tolerance.
        assert_eq!(written.notes.iter().collect::<Vec<_>>(), ["92 vertices that no face uses are not in the GLB"]);
        let diagonal = header.unit_box.diagonal;
        assert!(written.max_error <= 0.0025 * diagonal && written.rms_error <= 0.0005 * diagonal);
        assert!(written.rms_error > 0.0);
        let (worst, at) = worst_of(&header, &path, |f| pose(&header, f));
        assert!((worst - written.max_error).abs() < 1e-6 * diagonal, "{worst} {}", written.max_error);
        assert_eq!(written.worst_frame, Some(50 + at as i64));
    }
}

#[test]
fn the_file_keeps_the_rules_of_players() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = header(DVec3::ZERO);
    let written = encode(&header, &path, |f| pose(&header, f));
    assert_eq!(written.bytes, std::fs::metadata(&path).unwrap().len());
    let read = Read::open(&path);
    let keys = read.keys();
    for (f, t) in read.times.iter().enumerate() {
        assert!((f64::from(*t) - f as f64 / RATE).abs() < 1e-6);
    }
    let skin = read.document.skins().next().unwrap();
    let joints: Vec<_> = skin.joints().collect();
    assert_eq!(written.encoding, format!("skin, {} joints", joints.len() - 1));
    for pair in keys.windows(2) {
        for joint in &joints {
            assert!(pair[0][joint.index()].1.dot(pair[1][joint.index()].1) > 0.0, "signs of quaternions are continuous");
        }
    }
    let names: BTreeSet<&str> = joints.iter().map(|j| j.name().unwrap()).collect();
    assert_eq!(names.len(), joints.len());
    assert!(names.contains("root") && names.contains("left_01") && names.contains("right_01"), "{names:?}");
    let top: Vec<_> = read.document.default_scene().unwrap().nodes().collect();
    assert_eq!(top.len(), 2);
    assert!(top[1].mesh().is_some() && top[1].skin().is_some() && top[1].name() == Some("bar"));
    assert_eq!(top[0].children().next().unwrap().children().count(), joints.len() - 1, "joints are flat under the root");

    let mesh = top[1].mesh().unwrap();
    let materials: Vec<_> = mesh.primitives().map(|p| p.material().name().unwrap().to_owned()).collect();
    assert_eq!(materials, ["skin", "cloth"]);
    assert!(mesh.primitives().all(|p| !p.material().double_sided()), "the bar is closed");
    let mut triangles = 0;
    for primitive in mesh.primitives() {
        let reader = primitive.reader(|_| Some(&read.blob));
        let gltf::mesh::util::ReadJoints::U8(bytes) = reader.read_joints(0).unwrap() else { panic!("few joints fit bytes") };
        let gltf::mesh::util::ReadWeights::U16(words) = reader.read_weights(0).unwrap() else { panic!("weights have 16 bits") };
        for (joints, weights) in bytes.zip(words) {
            assert_eq!(weights.iter().map(|&w| u32::from(w)).sum::<u32>(), 65535);
            for k in 0..4 {
                assert!(weights[k] > 0 || joints[k] == 0);
                assert!(weights[k] == 0 || !joints[..k].contains(&joints[k]), "no joint twice");
            }
        }
        let vertices = reader.read_positions().unwrap().len();
        assert!(reader.read_indices().unwrap().into_u32().all(|i| (i as usize) < vertices));
        triangles += reader.read_indices().unwrap().into_u32().len() / 3;
        for normal in reader.read_normals().unwrap() {
            assert!((DVec3::from_array(normal.map(f64::from)).length() - 1.0).abs() < 1e-5);
        }
        let uvs: BTreeSet<[u32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().map(|uv| uv.map(f32::to_bits)).collect();
        assert!(uvs.iter().all(|uv| [[0.25f32, 0.25], [0.5, 0.5]].contains(&uv.map(f32::from_bits))), "v is flipped");
        assert!(reader.read_colors(0).unwrap().into_rgba_u16().all(|c| c[1] == 14027), "colours are linear");
    }
    assert_eq!(triangles, header.scan.mesh.faces.len());

    // The pose of binding is the scan itself.
    for (p, r) in read.at_rest().iter().zip(&read.rest()) {
        assert!((*p - *r).length() < 1e-5);
    }
}

#[test]
fn threads_do_not_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let files = [1, 2, 3].map(|threads| {
        let path = folder.path().join("out.glb");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| encode(&header, &path, |f| pose(&header, f)));
        std::fs::read(path).unwrap()
    });
    assert!(files[0] == files[1] && files[0] == files[2]);
}

#[test]
fn what_moves_as_one_needs_one_joint() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let turn = |f: usize| DQuat::from_rotation_z(f as f64 * 0.2);
    let rigid = |f: usize| header.proxy.rest.iter().map(|&p| turn(f) * p + DVec3::X).collect();
    let written = encode(&header, &folder.path().join("out.glb"), rigid);
    assert_eq!(written.encoding, "skin, 1 joints");
    assert!(written.max_error < 1e-4 * header.unit_box.diagonal, "{}", written.max_error);
}

#[test]
fn nothing_stays_behind_without_a_finish_or_after_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/out.glb");
    let header = header(DVec3::ZERO);
    let begin = || {
        let mut sink: Box<dyn FrameSink> = Box::new(GlbSink::new(&path));
        sink.begin(&header).unwrap();
        sink.frames(&FrameBatch { first: 0, proxy: &[pose(&header, 0)], points: &[], normals: &[] }).unwrap();
        sink
    };
    drop(begin());
    let sink = begin();
    header.cancel.cancel();
    assert_eq!(sink.finish().unwrap_err().kind, Kind::Interrupted);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
