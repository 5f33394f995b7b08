//! A file read by another program's eyes: nodes, skin, morph targets and tracks by the letter of the specification.

use crate::export::Header;
use glam::{DMat4, DQuat, DVec3};
use std::path::Path;

/// A file.
pub(super) struct Read {
    pub(super) document: gltf::Document,
    pub(super) blob: Vec<u8>,
    pub(super) times: Vec<f32>,
    /// Weights of all targets, frame by frame.
    pub(super) weights: Vec<f32>,
}

/// Translation and rotation of each node.
type Places = Vec<(DVec3, DQuat)>;

fn wide(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

impl Read {
    pub(super) fn open(path: &Path) -> Self {
        let mut file = gltf::Gltf::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let blob = file.blob.take().unwrap();
        let mut read = Self { document: file.document, blob, times: Vec::new(), weights: Vec::new() };
        let animation = read.document.animations().next().unwrap();
        for channel in animation.channels() {
            assert_eq!(channel.sampler().interpolation(), gltf::animation::Interpolation::Linear);
            let reader = channel.reader(|_| Some(&read.blob));
            read.times = reader.read_inputs().unwrap().collect();
            if let gltf::animation::util::ReadOutputs::MorphTargetWeights(values) = reader.read_outputs().unwrap() {
                read.weights = values.into_f32().collect();
            }
        }
        read
    }

    fn resting(&self) -> Places {
        let place = |node: gltf::Node<'_>| {
            let (translation, rotation, _) = node.transform().decomposed();
            (wide(translation), DQuat::from_array(rotation.map(f64::from)).normalize())
        };
        self.document.nodes().map(place).collect()
    }

    /// Translation and rotation of each node in each frame.
    pub(super) fn keys(&self) -> Vec<Places> {
        let frames = self.times.len();
        let mut keys = vec![self.resting(); frames];
        for channel in self.document.animations().next().unwrap().channels() {
            let node = channel.target().node().index();
            let reader = channel.reader(|_| Some(&self.blob));
            assert_eq!(reader.read_inputs().unwrap().count(), frames);
            match reader.read_outputs().unwrap() {
                gltf::animation::util::ReadOutputs::Translations(values) => {
                    assert_eq!(values.len(), frames);
                    values.enumerate().for_each(|(f, t)| keys[f][node].0 = wide(t));
                }
                gltf::animation::util::ReadOutputs::Rotations(values) => {
                    for (f, q) in values.into_f32().enumerate() {
                        let q = DQuat::from_array(q.map(f64::from));
                        assert!((q.length() - 1.0).abs() < 1e-4);
                        keys[f][node].1 = q.normalize();
                    }
                }
                gltf::animation::util::ReadOutputs::MorphTargetWeights(values) => {
                    assert_eq!(values.into_f32().count() % frames, 0);
                }
                gltf::animation::util::ReadOutputs::Scales(_) => panic!("no scales are written"),
            }
        }
        keys
    }

    /// Positions in the file, primitive after primitive.
    pub(super) fn rest(&self) -> Vec<DVec3> {
        let primitives = self.document.meshes().flat_map(|m| m.primitives().collect::<Vec<_>>());
        primitives.flat_map(|p| p.reader(|_| Some(&self.blob)).read_positions().unwrap().map(wide).collect::<Vec<_>>()).collect()
    }

    /// All vertices with the nodes and weights of the file itself.
    pub(super) fn at_rest(&self) -> Vec<DVec3> {
        let weights = self.document.meshes().last().unwrap().weights().map_or(Vec::new(), <[f32]>::to_vec);
        assert!(weights.iter().all(|&w| w == 0.0));
        self.posed(&self.resting(), &weights)
    }

    /// All vertices at a time in frames, interpolated as the specification says.
    pub(super) fn at(&self, keys: &[Places], time: f64) -> Vec<DVec3> {
        let f = (time as usize).min(keys.len() - 1);
        let (g, s) = ((f + 1).min(keys.len() - 1), time - f as f64);
        let between = |(a, b): (&(DVec3, DQuat), &(DVec3, DQuat))| (a.0.lerp(b.0, s), a.1.slerp(b.1, s));
        let places: Places = keys[f].iter().zip(&keys[g]).map(between).collect();
        let count = self.weights.len() / keys.len();
        let weight = |k: usize| {
            let (a, b) = (f64::from(self.weights[f * count + k]), f64::from(self.weights[g * count + k]));
            (a + (b - a) * s) as f32
        };
        self.posed(&places, &(0..count).map(weight).collect::<Vec<_>>())
    }

    /// The largest distance at a time from the scan that a proxy pose makes.
    pub(super) fn distance(&self, header: &Header, time: f64, pose: &[DVec3]) -> f64 {
        let normals = crate::surface::NormalVertices::of(&header.scan);
        let parts = self.parts_by_vertex(header);
        let used =
            super::geometry::Geometry::of_parts(&header.scan, &normals, |v| parts.get(v as usize).copied().unwrap_or(0)).vertices;
        let mut exact = vec![Vec::new()];
        header.map.apply(&[pose], &mut exact);
        let posed = self.at(&self.keys(), time);
        assert_eq!(posed.len(), used.len());
        let distance = |(p, &v): (&DVec3, &u32)| (*p - header.unit_box.leave(wide(exact[0][v as usize]))).length();
        posed.iter().zip(&used).map(distance).fold(0.0, f64::max)
    }

    /// The mesh of each of the scan's vertices, found by where it is at rest; empty where the file has one.
    fn parts_by_vertex(&self, header: &Header) -> Vec<u16> {
        if self.document.meshes().count() == 1 {
            return Vec::new();
        }
        let mut part_at = std::collections::BTreeMap::new();
        let key = |p: DVec3| (p * 1e3).round().to_array().map(|x| x as i64);
        let mut rest = self.at_rest().into_iter();
        for mesh in self.document.meshes() {
            let count: usize = mesh.primitives().map(|p| p.get(&gltf::Semantic::Positions).unwrap().count()).sum();
            part_at.extend(rest.by_ref().take(count).map(|p| (key(p), mesh.index() as u16)));
        }
        header.scan.mesh.positions.iter().map(|&p| part_at.get(&key(p)).copied().unwrap_or(0)).collect()
    }

    fn posed(&self, places: &Places, weights: &[f32]) -> Vec<DVec3> {
        let mut world = vec![DMat4::IDENTITY; places.len()];
        let mut stack: Vec<(gltf::Node<'_>, DMat4)> =
            self.document.default_scene().unwrap().nodes().map(|n| (n, DMat4::IDENTITY)).collect();
        let mut node_of_mesh = vec![0; self.document.meshes().count()];
        while let Some((node, parent)) = stack.pop() {
            let (translation, rotation) = places[node.index()];
            world[node.index()] = parent * DMat4::from_rotation_translation(rotation, translation);
            if let Some(mesh) = node.mesh() {
                node_of_mesh[mesh.index()] = node.index();
            }
            stack.extend(node.children().map(|c| (c, world[node.index()])));
        }
        let matrices: Option<Vec<DMat4>> = self.document.skins().next().map(|skin| {
            let bind = skin.reader(|_| Some(&self.blob)).read_inverse_bind_matrices().unwrap();
            let matrix = |(joint, b): (gltf::Node<'_>, [[f32; 4]; 4])| {
                world[joint.index()] * DMat4::from_cols_array_2d(&b.map(|c| c.map(f64::from)))
            };
            skin.joints().zip(bind).map(matrix).collect()
        });
        let has_skin = |mesh: usize| self.document.nodes().nth(node_of_mesh[mesh]).unwrap().skin().is_some();
        let mut posed = Vec::new();
        for (mesh, primitive) in self.document.meshes().flat_map(|m| m.primitives().map(|p| (m.index(), p)).collect::<Vec<_>>()) {
            let reader = primitive.reader(|_| Some(&self.blob));
            let mut positions: Vec<DVec3> = reader.read_positions().unwrap().map(wide).collect();
            let targets: Vec<_> = reader.read_morph_targets().collect();
            let last = mesh + 1 == node_of_mesh.len();
            assert_eq!(targets.len(), if last { weights.len() } else { 0 }, "rigid parts have no targets");
            for ((offsets, _, _), &w) in targets.into_iter().zip(weights) {
                positions.iter_mut().zip(offsets.unwrap()).for_each(|(p, o)| *p += wide(o) * f64::from(w));
            }
            let Some(matrices) = matrices.as_ref().filter(|_| has_skin(mesh)) else {
                assert!(reader.read_joints(0).is_none());
                posed.extend(positions.iter().map(|p| world[node_of_mesh[mesh]].transform_point3(*p)));
                continue;
            };
            let joints = reader.read_joints(0).unwrap().into_u16();
            let weights = reader.read_weights(0).unwrap().into_u16();
            for ((p, joints), weights) in positions.iter().zip(joints).zip(weights) {
                let moved = |k: usize| matrices[joints[k] as usize].transform_point3(*p) * (f64::from(weights[k]) / 65535.0);
                posed.push((0..4).map(moved).sum());
            }
        }
        posed
    }
}
