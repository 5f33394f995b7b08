//! The glTF document: scene, nodes, skin, mesh, animation.
//!
//! A motion without joints has no skin: the mesh hangs on the root's node, and morph targets do the rest. Nor has a rigid part: each is a mesh on a
//! node of its own, beside the skin of what bends.

use super::container::{Buffer, Pieces, Target, bounds, component, float_rows, numbers};
use super::geometry::{Geometry, Primitive};
use super::looks::{Looks, linear_color};
use super::morphs;
use crate::error::Notes;
use crate::export::encode::Encoded;
use crate::export::encode::skin::Key;
use crate::scan::Scan;
use glam::DVec3;
use serde_json::{Value, json};

/// Index of the node above the root joint; it carries the offset of scans far from the origin.
const RIG: usize = 0;
/// Index of the root joint's node; the other joints follow.
const ROOT: usize = 1;

/// What a file is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Content<'a> {
    /// Looks of the scan.
    pub(crate) scan: &'a Scan,
    /// Its triangles.
    pub(crate) geometry: &'a Geometry,
    /// Unit normals at rest, per normal vertex.
    pub(crate) normals: &'a [[f32; 3]],
    /// The motion.
    pub(crate) encoded: &'a Encoded,
    /// Place in the skin of each scan vertex.
    pub(crate) places: &'a [u32],
    /// Names of the root, the rigid parts and the joints.
    pub(crate) node_names: &'a [String],
    /// Where the file's coordinates begin in the scan's.
    pub(crate) offset: DVec3,
    /// Keys per second.
    pub(crate) rate: f64,
    /// Name of the mesh.
    pub(crate) name: &'a str,
    /// Name of the animation.
    pub(crate) animation: &'a str,
    /// Of normals.
    pub(crate) precision: Precision,
    /// Whether vertices carry the number of the scan's vertex.
    pub(crate) source_index: bool,
}

/// How normals are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Precision {
    /// As floats.
    Full,
    /// As bytes (KHR_mesh_quantization), off by at most a third of a degree.
    Compact,
}

impl Content<'_> {
    /// The document and its buffer.
    pub(crate) fn build(&self, notes: &mut Notes) -> (Value, Buffer) {
        let mut buffer = Buffer::default();
        let looks = Looks::of(self.scan, self.geometry, &mut buffer, notes);
        let primitives = self.primitives(&mut buffer);
        let animation = self.animation(&mut buffer);
        let meshes = self.meshes(primitives);
        let mut document = json!({
            "asset": { "version": "2.0", "generator": concat!("retarget ", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{ "nodes": if self.is_skinned() { vec![RIG, self.mesh_node()] } else { vec![RIG] } }],
            "nodes": self.nodes(),
            "meshes": meshes,
            "animations": [animation],
            "materials": looks.materials,
        });
        if self.is_skinned() {
            // The root, which no vertex hangs on, is the first.
            let joints: Vec<usize> = std::iter::once(ROOT).chain(ROOT + 1 + self.rigid()..self.mesh_node()).collect();
            let bind = float_rows(joints.iter().map(|&node| inverse_bind(&self.encoded.skin.pivots[node - ROOT])));
            let bind = buffer.view(bind, Target::Other);
            let bind = buffer.accessor(bind, 0, component::F32, joints.len(), "MAT4", json!({}));
            document["skins"] = json!([{ "inverseBindMatrices": bind, "skeleton": ROOT, "joints": joints }]);
        }
        if self.precision == Precision::Compact {
            document["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
            document["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        }
        if !looks.images.is_empty() {
            document["images"] = Value::Array(looks.images);
            document["textures"] = Value::Array(looks.textures);
        }
        (document, buffer)
    }

    fn is_skinned(&self) -> bool {
        self.encoded.joints() > 0
    }

    /// Number of rigid parts.
    fn rigid(&self) -> usize {
        self.encoded.rigid_parts()
    }

    /// Whether there is a mesh besides the rigid parts.
    fn has_rest(&self) -> bool {
        self.is_skinned() || self.rigid() == 0
    }

    /// One mesh per rigid part, and one of the rest.
    fn meshes(&self, primitives: Vec<Value>) -> Vec<Value> {
        let of_part = |k: usize| -> Vec<&Value> {
            let pairs = self.geometry.primitives.iter().zip(&primitives);
            pairs.filter(|(p, _)| usize::from(p.part) == k).map(|(_, value)| value).collect()
        };
        let rigid = self.rigid();
        let mut meshes: Vec<Value> =
            (0..rigid).map(|k| json!({ "name": self.node_names[k + 1], "primitives": of_part(k) })).collect();
        if self.has_rest() {
            let mut mesh = json!({ "name": self.name, "primitives": of_part(rigid) });
            let targets = &self.encoded.morphs.targets;
            if !targets.is_empty() {
                mesh["weights"] = json!(vec![0; targets.len()]);
                mesh["extras"] = json!({ "targetNames": morphs::names(&self.encoded.morphs) });
            }
            meshes.push(mesh);
        }
        meshes
    }

    /// Index of the node of the mesh that is no rigid part: after the parts and the joints.
    fn mesh_node(&self) -> usize {
        ROOT + self.encoded.skin.nodes()
    }

    fn nodes(&self) -> Vec<Value> {
        let (skin, rigid) = (&self.encoded.skin, self.rigid());
        let mut rig = json!({ "name": "rig", "children": [ROOT] });
        if self.offset != DVec3::ZERO {
            rig["translation"] = json!(self.offset.to_array());
        }
        let mut nodes = vec![rig];
        for (k, translation) in skin.rest_translations.iter().enumerate() {
            let mut node = json!({ "name": self.node_names[k], "translation": numbers(translation) });
            if (1..=rigid).contains(&k) {
                node["mesh"] = json!(k - 1);
            }
            if k == 0 {
                let last = self.mesh_node() + usize::from(self.has_rest() && !self.is_skinned());
                node["children"] = json!((ROOT + 1..last).collect::<Vec<_>>());
            }
            nodes.push(node);
        }
        if self.has_rest() {
            let mut mesh = json!({ "name": self.name, "mesh": rigid });
            if self.is_skinned() {
                // Outside the tree of joints, at the top: a player ignores the place of a skinned mesh.
                mesh["skin"] = json!(0);
            } else {
                mesh["translation"] = numbers(&skin.pivots[0].map(|x| 0.0 - x));
            }
            nodes.push(mesh);
        }
        nodes
    }

    fn primitives(&self, buffer: &mut Buffer) -> Vec<Value> {
        let vertices = &self.geometry.vertices;
        let positions: Vec<[f32; 3]> = self.geometry.primitives.iter().flat_map(|p| self.positions(p)).collect();
        let mut streams = vec![
            Stream::new("POSITION", component::F32, "VEC3", 12, float_rows(positions.iter().copied()), buffer),
            self.normals(buffer),
        ];
        if self.is_skinned() {
            streams.extend(self.hooks(buffer));
        }
        if !self.scan.look.colors.is_empty() {
            let colors = &self.scan.look.colors;
            let rows = vertices.iter().flat_map(|&g| linear_color(colors[g as usize])).flat_map(u16::to_le_bytes);
            streams.push(Stream::new("COLOR_0", component::U16, "VEC4", 8, rows.collect(), buffer).normalized());
        }
        if self.source_index {
            let numbers = float_rows(vertices.iter().map(|&g| [g as f32]));
            streams.push(Stream::new("_SOURCE_INDEX", component::F32, "SCALAR", 4, numbers, buffer));
        }
        let textured = self.geometry.primitives.iter().any(|p| p.textured);
        let uvs = float_rows(self.geometry.uvs.iter().copied());
        let uvs = textured.then(|| Stream::new("TEXCOORD_0", component::F32, "VEC2", 8, uvs, buffer));
        let indices: Vec<(usize, u32, usize)> = self.geometry.primitives.iter().map(|p| self.index_view(p, buffer)).collect();
        let mut values = Vec::new();
        for (k, p) in self.geometry.primitives.iter().enumerate() {
            let mut attributes = json!({});
            let usable = |stream: &&Stream| stream.first <= p.vertices.start;
            for stream in streams.iter().filter(usable).chain(uvs.iter().filter(|_| p.textured)) {
                let more = match stream.name {
                    "POSITION" => bounds(positions[p.vertices.clone()].iter().copied()),
                    _ if stream.normalized => json!({ "normalized": true }),
                    _ => json!({}),
                };
                let offset = (p.vertices.start - stream.first) * stream.size;
                attributes[stream.name] =
                    json!(buffer.accessor(stream.view, offset, stream.component, p.vertices.len(), stream.kind, more));
            }
            let (view, component, count) = indices[k];
            let indices = buffer.accessor(view, 0, component, count, "SCALAR", json!({}));
            let mut value = json!({ "attributes": attributes, "indices": indices, "material": k, "mode": 4 });
            if !self.encoded.morphs.targets.is_empty() && !self.is_rigid(p) {
                value["targets"] = json!(morphs::targets(&self.encoded.morphs, self.geometry, p, self.places, buffer));
            }
            values.push(value);
        }
        values
    }

    /// Where the vertices of a primitive are at rest: in the file, or from the pivot of their rigid part.
    fn positions(&self, primitive: &Primitive) -> impl Iterator<Item = [f32; 3]> {
        let part = self.is_rigid(primitive).then(|| usize::from(primitive.part) + 1);
        let pivot = part.map_or([0.0; 3], |k| self.encoded.skin.pivots[k].map(f64::from));
        let of = |&g: &u32| self.encoded.rest[self.places[g as usize] as usize];
        let from = move |p: [f32; 3]| std::array::from_fn(|k| (f64::from(p[k]) - pivot[k]) as f32);
        self.geometry.vertices[primitive.vertices.clone()].iter().map(of).map(from)
    }

    fn is_rigid(&self, primitive: &Primitive) -> bool {
        usize::from(primitive.part) < self.rigid()
    }

    fn normals(&self, buffer: &mut Buffer) -> Stream {
        let normals = self.geometry.normals.iter().map(|&n| unit(self.normals[n as usize]));
        match self.precision {
            Precision::Full => Stream::new("NORMAL", component::F32, "VEC3", 12, float_rows(normals), buffer),
            Precision::Compact => {
                // The fourth byte is padding.
                let bytes = normals.flat_map(|[x, y, z]| [x, y, z, 0.0].map(|c| (c * 127.0).round() as i8 as u8));
                Stream::new("NORMAL", component::I8, "VEC3", 4, bytes.collect(), buffer).normalized()
            }
        }
    }

    /// Joints and weights of what bends, which comes after the rigid parts.
    fn hooks(&self, buffer: &mut Buffer) -> [Stream; 2] {
        let (skin, rigid) = (&self.encoded.skin, self.rigid() as u16);
        let first = self.geometry.primitives.iter().filter(|p| self.is_rigid(p)).map(|p| p.vertices.end).max().unwrap_or(0);
        let of = |g: &u32| self.places[*g as usize] as usize;
        let rows = |narrow: bool, values: &dyn Fn(usize) -> [u16; 4]| -> Vec<u8> {
            let values = self.geometry.vertices[first..].iter().flat_map(|g| values(of(g)));
            if narrow { values.map(|x| x as u8).collect() } else { values.flat_map(u16::to_le_bytes).collect() }
        };
        let width = |narrow: bool| if narrow { (component::U8, 4) } else { (component::U16, 8) };
        let few = self.encoded.joints() < 256;
        let (kind, size) = width(few);
        let joint = |i: usize| skin.joints[i].map(|node| node.saturating_sub(rigid));
        let joints = Stream::new("JOINTS_0", kind, "VEC4", size, rows(few, &joint), buffer);
        let coarse = skin.levels == 255;
        let (kind, size) = width(coarse);
        let weights = Stream::new("WEIGHTS_0", kind, "VEC4", size, rows(coarse, &|i| skin.weights[i]), buffer);
        [joints, weights.normalized()].map(|stream| Stream { first, ..stream })
    }

    fn index_view(&self, primitive: &Primitive, buffer: &mut Buffer) -> (usize, u32, usize) {
        let indices = &self.geometry.indices[primitive.indices.clone()];
        // 65535 restarts a strip and is not an index.
        let narrow = primitive.vertices.len() < 65535;
        let (bytes, component): (Vec<u8>, u32) = if narrow {
            (indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect(), component::U16)
        } else {
            (indices.iter().flat_map(|&i| i.to_le_bytes()).collect(), component::U32)
        };
        (buffer.view(bytes, Target::Indices), component, indices.len())
    }

    /// A part of all keys, node by node.
    fn keys(&self, part: fn(&Key, &mut Vec<u8>)) -> Pieces {
        let keys = self.encoded.skin.keys.clone();
        Box::new((0..keys.columns()).map(move |k| {
            let mut bytes = Vec::new();
            keys.column(k)?.iter().for_each(|key| part(key, &mut bytes));
            Ok(bytes)
        }))
    }

    /// One key per frame and node, from time 0.
    fn animation(&self, buffer: &mut Buffer) -> Value {
        let (nodes, frames) = (self.encoded.skin.nodes(), self.encoded.skin.frames());
        let times: Vec<[f32; 1]> = (0..frames).map(|f| [(f as f64 / self.rate) as f32]).collect();
        let view = buffer.view(float_rows(times.iter().copied()), Target::Other);
        let input = buffer.accessor(view, 0, component::F32, frames, "SCALAR", bounds(times.iter().copied()));
        let rotation = |key: &Key, out: &mut Vec<u8>| out.extend(key.rotation.map(i16::to_le_bytes).as_flattened());
        let translation = |key: &Key, out: &mut Vec<u8>| out.extend(key.translation.map(f32::to_le_bytes).as_flattened());
        let rotations = buffer.pieces(self.keys(rotation), nodes * frames * 8);
        let translations = buffer.pieces(self.keys(translation), nodes * frames * 12);
        let mut samplers = Vec::new();
        let mut channels = Vec::new();
        for k in 0..nodes {
            let rotation =
                buffer.accessor(rotations, k * frames * 8, component::I16, frames, "VEC4", json!({ "normalized": true }));
            let translation = buffer.accessor(translations, k * frames * 12, component::F32, frames, "VEC3", json!({}));
            for (path, output) in [("rotation", rotation), ("translation", translation)] {
                channels.push(json!({ "sampler": samplers.len(), "target": { "node": ROOT + k, "path": path } }));
                samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
            }
        }
        let targets = self.encoded.morphs.targets.len();
        if targets > 0 {
            let view = buffer.pieces(morphs::weights(&self.encoded.morphs), frames * targets * 4);
            let output = buffer.accessor(view, 0, component::F32, frames * targets, "SCALAR", json!({}));
            channels.push(json!({ "sampler": samplers.len(), "target": { "node": self.mesh_node(), "path": "weights" } }));
            samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        }
        json!({ "name": self.animation, "samplers": samplers, "channels": channels })
    }
}

/// One attribute of all vertices, or of those from one on.
struct Stream {
    name: &'static str,
    view: usize,
    component: u32,
    kind: &'static str,
    /// Bytes of a vertex.
    size: usize,
    normalized: bool,
    /// The vertex that it begins with.
    first: usize,
}

impl Stream {
    fn new(name: &'static str, component: u32, kind: &'static str, size: usize, bytes: Vec<u8>, buffer: &mut Buffer) -> Self {
        Self { name, view: buffer.view(bytes, Target::Attributes(size)), component, kind, size, normalized: false, first: 0 }
    }

    /// Integers that stand for −1 to 1 or 0 to 1.
    fn normalized(self) -> Self {
        Self { normalized: true, ..self }
    }
}

/// Moves a joint's place at rest to the origin.
fn inverse_bind(pivot: &[f32; 3]) -> [f32; 16] {
    let mut matrix = [0.0; 16];
    for k in 0..4 {
        matrix[5 * k] = 1.0;
    }
    for axis in 0..3 {
        matrix[12 + axis] = 0.0 - pivot[axis];
    }
    matrix
}

/// A normal of length 1 also where the surface has none.
fn unit(normal: [f32; 3]) -> [f32; 3] {
    let n = DVec3::from_array(normal.map(f64::from));
    n.try_normalize().unwrap_or(DVec3::Z).as_vec3().to_array()
}
