#![allow(clippy::unwrap_used)]

use super::*;
use crate::error::Kind;
use crate::export::Cancel;
use crate::proxy::{Proxy, rows::MapKind};
use crate::scan::{Faces, Material, Scan, SurfaceMesh};
use crate::surface::SurfaceMap;
use glam::{DMat4, DQuat};
use std::collections::{BTreeMap, BTreeSet};

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
    let phase = frame as f64 / (FRAMES - 1) as f64;
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
    let mut sink: Box<dyn FrameSink> = Box::new(GlbSink::new(path));
    sink.begin(header).unwrap();
    for first in (0..FRAMES).step_by(8) {
        let poses: Vec<Vec<DVec3>> = (first..FRAMES.min(first + 8)).map(&pose).collect();
        sink.frames(&FrameBatch { first, proxy: &poses, points: &[], normals: &[] }).unwrap();
    }
    sink.finish().unwrap()
}

/// A file read by another program's eyes.
struct Read {
    document: gltf::Document,
    blob: Vec<u8>,
}

impl Read {
    fn open(path: &Path) -> Self {
        let mut file = gltf::Gltf::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let blob = file.blob.take().unwrap();
        Self { document: file.document, blob }
    }

    /// Translation and rotation of each node in each frame, and the times.
    fn keys(&self) -> (Vec<f32>, Vec<Vec<(DVec3, DQuat)>>) {
        let nodes = self.document.nodes().len();
        let mut keys = vec![vec![(DVec3::ZERO, DQuat::IDENTITY); nodes]; FRAMES];
        let mut times = Vec::new();
        for node in self.document.nodes() {
            let (translation, rotation, _) = node.transform().decomposed();
            let at_rest = (DVec3::from_array(translation.map(f64::from)), DQuat::from_array(rotation.map(f64::from)).normalize());
            keys.iter_mut().for_each(|k| k[node.index()] = at_rest);
        }
        let animation = self.document.animations().next().unwrap();
        for channel in animation.channels() {
            assert_eq!(channel.sampler().interpolation(), gltf::animation::Interpolation::Linear);
            let node = channel.target().node().index();
            let reader = channel.reader(|_| Some(&self.blob));
            times = reader.read_inputs().unwrap().collect();
            assert_eq!(times.len(), FRAMES);
            match reader.read_outputs().unwrap() {
                gltf::animation::util::ReadOutputs::Translations(values) => {
                    assert_eq!(values.len(), FRAMES);
                    values.enumerate().for_each(|(f, t)| keys[f][node].0 = DVec3::from_array(t.map(f64::from)));
                }
                gltf::animation::util::ReadOutputs::Rotations(values) => {
                    for (f, q) in values.into_f32().enumerate() {
                        let q = DQuat::from_array(q.map(f64::from));
                        assert!((q.length() - 1.0).abs() < 1e-4);
                        keys[f][node].1 = q.normalize();
                    }
                }
                _ => panic!("only translations and rotations are written"),
            }
        }
        (times, keys)
    }

    /// Positions of all vertices in a frame, primitive after primitive, and where they are at rest in the file.
    fn skinned(&self, keys: &[(DVec3, DQuat)]) -> (Vec<DVec3>, Vec<DVec3>) {
        let mut world = vec![DMat4::IDENTITY; keys.len()];
        let mut stack: Vec<(gltf::Node<'_>, DMat4)> =
            self.document.default_scene().unwrap().nodes().map(|n| (n, DMat4::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            let (translation, rotation) = keys[node.index()];
            world[node.index()] = parent * DMat4::from_rotation_translation(rotation, translation);
            stack.extend(node.children().map(|c| (c, world[node.index()])));
        }
        let skin = self.document.skins().next().unwrap();
        let bind = skin.reader(|_| Some(&self.blob)).read_inverse_bind_matrices().unwrap();
        let matrices: Vec<DMat4> = skin
            .joints()
            .zip(bind)
            .map(|(joint, b)| world[joint.index()] * DMat4::from_cols_array_2d(&b.map(|c| c.map(f64::from))))
            .collect();
        let (mut posed, mut rest) = (Vec::new(), Vec::new());
        for primitive in self.document.meshes().next().unwrap().primitives() {
            let reader = primitive.reader(|_| Some(&self.blob));
            let joints = reader.read_joints(0).unwrap().into_u16();
            let weights = reader.read_weights(0).unwrap().into_u16();
            for ((p, joints), weights) in reader.read_positions().unwrap().zip(joints).zip(weights) {
                let p = DVec3::from_array(p.map(f64::from));
                let moved = |k: usize| matrices[joints[k] as usize].transform_point3(p) * (f64::from(weights[k]) / 65535.0);
                posed.push((0..4).map(moved).sum());
                rest.push(p);
            }
        }
        (posed, rest)
    }
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
        let read = Read::open(&path);
        let (_, keys) = read.keys();
        let used = Geometry::of(&header.scan, &NormalVertices::of(&header.scan)).vertices;
        let (mut worst, mut at) = (0f64, 0);
        let mut exact = vec![Vec::new()];
        for (f, keys) in keys.iter().enumerate() {
            let (posed, _) = read.skinned(keys);
            assert_eq!(posed.len(), used.len());
            header.map.apply(&[&pose(&header, f)], &mut exact);
            for (p, &v) in posed.iter().zip(&used) {
                let truth = DVec3::from_array(exact[0][v as usize].map(f64::from));
                let distance = (*p - header.unit_box.leave(truth)).length();
                if distance > worst {
                    (worst, at) = (distance, f as i64);
                }
            }
        }
        assert!((worst - written.max_error).abs() < 1e-6 * diagonal, "{worst} {}", written.max_error);
        assert_eq!(written.worst_frame, Some(50 + at));
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
    let (times, keys) = read.keys();
    for (f, t) in times.iter().enumerate() {
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
    let at_rest: Vec<(DVec3, DQuat)> = read
        .document
        .nodes()
        .map(|n| (DVec3::from_array(n.transform().decomposed().0.map(f64::from)), DQuat::IDENTITY))
        .collect();
    let (posed, rest) = read.skinned(&at_rest);
    for (p, r) in posed.iter().zip(&rest) {
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
