//! The glTF document: scene, nodes, skin, mesh, animation.

use super::container::{Buffer, Pieces, Target, bounds, component, float_rows, numbers};
use super::geometry::{Geometry, Primitive};
use super::looks::{Looks, linear_color};
use crate::error::Notes;
use crate::export::encode::skin::{Key, Skin};
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
    pub(crate) skin: &'a Skin,
    /// Positions of the skin's vertices at rest.
    pub(crate) rest: &'a [[f32; 3]],
    /// Place in the skin of each scan vertex.
    pub(crate) places: &'a [u32],
    /// Names of the skin's nodes.
    pub(crate) joint_names: &'a [String],
    /// Where the file's coordinates begin in the scan's.
    pub(crate) offset: DVec3,
    /// Keys per second.
    pub(crate) rate: f64,
    /// Name of the mesh.
    pub(crate) name: &'a str,
    /// Name of the animation.
    pub(crate) animation: &'a str,
}

impl Content<'_> {
    /// The document and its buffer.
    pub(crate) fn build(&self, notes: &mut Notes) -> (Value, Buffer) {
        let mut buffer = Buffer::default();
        let looks = Looks::of(self.scan, self.geometry, &mut buffer, notes);
        let primitives = self.primitives(&mut buffer);
        let bind = buffer.view(float_rows(self.skin.pivots.iter().map(inverse_bind)), Target::Other);
        let bind = buffer.accessor(bind, 0, component::F32, self.skin.nodes(), "MAT4", json!({}));
        let animation = self.animation(&mut buffer);
        let mesh_node = ROOT + self.skin.nodes();
        let mut document = json!({
            "asset": { "version": "2.0", "generator": concat!("retarget ", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{ "nodes": [RIG, mesh_node] }],
            "nodes": self.nodes(),
            "meshes": [{ "name": self.name, "primitives": primitives }],
            "skins": [{
                "inverseBindMatrices": bind,
                "skeleton": ROOT,
                "joints": (ROOT..mesh_node).collect::<Vec<_>>(),
            }],
            "animations": [animation],
            "materials": looks.materials,
        });
        if !looks.images.is_empty() {
            document["images"] = Value::Array(looks.images);
            document["textures"] = Value::Array(looks.textures);
        }
        (document, buffer)
    }

    fn nodes(&self) -> Vec<Value> {
        let joints = self.skin.nodes();
        let mut rig = json!({ "name": "rig", "children": [ROOT] });
        if self.offset != DVec3::ZERO {
            rig["translation"] = json!(self.offset.to_array());
        }
        let mut nodes = vec![rig];
        for (k, translation) in self.skin.rest_translations.iter().enumerate() {
            let mut node = json!({ "name": self.joint_names[k], "translation": numbers(translation) });
            if k == 0 && joints > 1 {
                node["children"] = json!((ROOT + 1..ROOT + joints).collect::<Vec<_>>());
            }
            nodes.push(node);
        }
        // Outside the tree of joints, at the top: a player ignores the place of a skinned mesh.
        nodes.push(json!({ "name": self.name, "mesh": 0, "skin": 0 }));
        nodes
    }

    fn primitives(&self, buffer: &mut Buffer) -> Vec<Value> {
        let of = |g: &u32| self.places[*g as usize] as usize;
        let vertices = &self.geometry.vertices;
        let position = |g: &u32| self.rest[of(g)];
        let positions = buffer.view(float_rows(vertices.iter().map(position)), Target::Attributes(12));
        let normals = self.geometry.normals.iter().map(|&n| unit(self.normals[n as usize]));
        let normals = buffer.view(float_rows(normals), Target::Attributes(12));
        let weights = vertices.iter().flat_map(|g| self.skin.weights[of(g)]).flat_map(u16::to_le_bytes).collect();
        let weights = buffer.view(weights, Target::Attributes(8));
        let joints = vertices.iter().flat_map(|g| self.skin.joints[of(g)]);
        let wide = self.skin.nodes() > 256;
        let (joints, joint_type, joint_size) = if wide {
            (joints.flat_map(u16::to_le_bytes).collect(), component::U16, 8)
        } else {
            (joints.map(|j| j as u8).collect(), component::U8, 4)
        };
        let joints = buffer.view(joints, Target::Attributes(joint_size));
        let textured = self.geometry.primitives.iter().any(|p| p.textured);
        let uvs = textured.then(|| buffer.view(float_rows(self.geometry.uvs.iter().copied()), Target::Attributes(8)));
        let colors = &self.scan.look.colors;
        let colors = (!colors.is_empty()).then(|| {
            let rows = vertices.iter().flat_map(|&g| linear_color(colors[g as usize]));
            buffer.view(rows.flat_map(u16::to_le_bytes).collect(), Target::Attributes(8))
        });
        let indices: Vec<(usize, u32, usize)> = self.geometry.primitives.iter().map(|p| self.index_view(p, buffer)).collect();
        let mut values = Vec::new();
        for (k, p) in self.geometry.primitives.iter().enumerate() {
            let (first, count) = (p.vertices.start, p.vertices.len());
            let mut add = |view: usize, size: usize, component: u32, kind: &str, more: Value| {
                buffer.accessor(view, first * size, component, count, kind, more)
            };
            let mut attributes = json!({
                "POSITION": add(positions, 12, component::F32, "VEC3", bounds(vertices[p.vertices.clone()].iter().map(position))),
                "NORMAL": add(normals, 12, component::F32, "VEC3", json!({})),
                "JOINTS_0": add(joints, joint_size, joint_type, "VEC4", json!({})),
                "WEIGHTS_0": add(weights, 8, component::U16, "VEC4", json!({ "normalized": true })),
            });
            if let Some(uvs) = uvs.filter(|_| p.textured) {
                attributes["TEXCOORD_0"] = json!(add(uvs, 8, component::F32, "VEC2", json!({})));
            }
            if let Some(colors) = colors {
                attributes["COLOR_0"] = json!(add(colors, 8, component::U16, "VEC4", json!({ "normalized": true })));
            }
            let (view, component, count) = indices[k];
            let indices = buffer.accessor(view, 0, component, count, "SCALAR", json!({}));
            values.push(json!({ "attributes": attributes, "indices": indices, "material": k, "mode": 4 }));
        }
        values
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
        let keys = self.skin.keys.clone();
        Box::new((0..keys.columns()).map(move |k| {
            let mut bytes = Vec::new();
            keys.column(k)?.iter().for_each(|key| part(key, &mut bytes));
            Ok(bytes)
        }))
    }

    /// One key per frame and node, from time 0.
    fn animation(&self, buffer: &mut Buffer) -> Value {
        let (nodes, frames) = (self.skin.nodes(), self.skin.frames());
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
        json!({ "name": self.animation, "samplers": samplers, "channels": channels })
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
