//! Scenes made here, with what they must become.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::error::Kind;
use crate::gltf::tests::glb;
use crate::scan::Image;
use serde_json::{Value, json};

/// A buffer with its views and accessors.
#[derive(Default)]
struct Builder {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Builder {
    fn view(&mut self, bytes: Vec<u8>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend(bytes);
        self.views.len() - 1
    }

    fn accessor(&mut self, component: u32, shape: &str, count: usize, bytes: Vec<u8>) -> usize {
        let view = self.view(bytes);
        self.accessors.push(json!({ "bufferView": view, "componentType": component, "type": shape, "count": count }));
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, rows: &[[f32; N]]) -> usize {
        let shape = ["", "SCALAR", "VEC2", "VEC3", "VEC4"].get(N).copied().unwrap_or("MAT4");
        self.accessor(5126, shape, rows.len(), rows.iter().flatten().flat_map(|x| x.to_le_bytes()).collect())
    }

    fn indices(&mut self, indices: &[u16]) -> usize {
        self.accessor(5123, "SCALAR", indices.len(), indices.iter().flat_map(|i| i.to_le_bytes()).collect())
    }

    /// The file with these nodes, meshes and more.
    fn file(&self, nodes: Value, meshes: Value, more: Value) -> Vec<u8> {
        let mut document = json!({
            "asset": { "version": "2.0" },
            "buffers": [{ "byteLength": self.bytes.len() }],
            "bufferViews": self.views,
            "accessors": self.accessors,
            "nodes": nodes,
            "meshes": meshes,
        });
        more.as_object().into_iter().flatten().for_each(|(key, value)| document[key] = value.clone());
        glb(&document, &self.bytes)
    }
}

fn parse(bytes: &[u8]) -> Result<Scan> {
    read(bytes, Path::new("a.glb"), &Beside::Nothing)
}

const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

#[test]
fn meshes_stand_where_their_nodes_are_and_far_ones_lose_nothing() {
    let mut b = Builder::default();
    let (square, indices) = (b.floats(&SQUARE), b.indices(&[0, 1, 2]));
    let more = b.indices(&[0, 2, 3]);
    let primitive = |i: usize| json!({ "attributes": { "POSITION": square }, "indices": i });
    let nodes = json!([
        { "mesh": 0, "name": "left", "translation": [30000000.25, 0, 0] },
        { "mesh": 0, "name": "right", "scale": [-1, 1, 1] },
        { "children": [0, 1], "rotation": [0, 0, 1, 1] },
        { "mesh": 0, "name": "hidden" },
    ]);
    let file =
        b.file(nodes, json!([{ "primitives": [primitive(indices), primitive(more)] }]), json!({ "scenes": [{ "nodes": [2] }] }));
    let scan = parse(&file).unwrap();
    // Two primitives over one table of vertices share it; each instance has its own.
    assert_eq!(scan.mesh.positions.len(), 8);
    assert!(scan.mesh.positions[1].abs_diff_eq(DVec3::new(0.0, 30000001.25, 0.0), 1e-8), "{}", scan.mesh.positions[1]);
    assert!(scan.mesh.positions[6].abs_diff_eq(DVec3::new(-1.0, -1.0, 0.0), 1e-15));
    // A mirror turns the triangles too, so that they keep their outside.
    assert_eq!(scan.mesh.faces.corners, [0, 1, 2, 0, 2, 3, 4, 6, 5, 4, 7, 6]);
    let names: Vec<_> = scan.look.groups.iter().map(|g| g.object.as_deref().unwrap()).collect();
    assert_eq!((names, &scan.look.face_groups[..]), (vec!["left", "right"], &[0, 0, 1, 1][..]));
    assert_eq!(scan.space.unit, Some(Known::new(Unit::Metre, Evidence::File)));
    assert_eq!(scan.space.up.unwrap().value, "+Y".parse().unwrap());
    assert!(scan.notes.is_empty());
}

#[test]
fn strips_fans_and_lists_with_and_without_indices() {
    let mut b = Builder::default();
    let points = b.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
    let repeated = b.indices(&[0, 1, 2, 2, 2, 3, 4]);
    let faces = |mode: u32, indices: Option<usize>| {
        let primitive = json!({ "attributes": { "POSITION": points }, "mode": mode, "indices": indices });
        parse(&b.file(json!([{ "mesh": 0 }]), json!([{ "primitives": [primitive] }]), json!({})))
    };
    assert_eq!(faces(5, None).unwrap().mesh.faces.corners, [0, 1, 2, 2, 1, 3, 2, 3, 4]);
    assert_eq!(faces(6, None).unwrap().mesh.faces.corners, [0, 1, 2, 0, 2, 3, 0, 3, 4]);
    let list = faces(4, None).unwrap();
    assert_eq!((list.mesh.faces.corners, list.notes.iter().count()), (vec![0, 1, 2], 1));
    // Repeated vertices move the strip on without a triangle; the turning goes on.
    assert_eq!(faces(5, Some(repeated)).unwrap().mesh.faces.corners, [0, 1, 2, 2, 3, 4]);
    assert!(faces(1, None).unwrap_err().found.contains("1 primitives of lines"));
    assert!(faces(7, None).is_err());
}

#[test]
fn skinned_meshes_stand_as_their_joints_hold_them_at_rest() {
    let mut b = Builder::default();
    let points = b.floats(&SQUARE);
    let joints = b.accessor(5121, "VEC4", 4, [[0, 1, 0, 0]; 4].as_flattened().to_vec());
    let weights = b.floats(&[[0.25, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]]);
    let mut inverse = [[0.0f32; 16]; 2];
    inverse.iter_mut().for_each(|m| [0, 5, 10, 15].into_iter().for_each(|k| m[k] = 1.0));
    inverse[1][13] = -1.0;
    let inverse = b.floats(&inverse);
    let primitive = json!({ "attributes": { "POSITION": points, "JOINTS_0": joints, "WEIGHTS_0": weights } });
    let nodes = json!([
        { "mesh": 0, "skin": 0, "translation": [100, 0, 0] },
        { "translation": [0, 0, 1], "children": [2] },
        { "translation": [0, 1, 0], "rotation": [0, 0, 1, 0] },
    ]);
    let file = |joints: Value| {
        b.file(
            nodes.clone(),
            json!([{ "primitives": [primitive] }]),
            json!({ "skins": [{ "joints": joints, "inverseBindMatrices": inverse }] }),
        )
    };
    let scan = parse(&file(json!([1, 2]))).unwrap();
    // Joint 0 lifts; joint 1 turns half about (0, 1, 1); the mean of both; no joint.
    let expected = [[0.0, 0.0, 1.0], [-1.0, 2.0, 1.0], [0.0, 1.0, 1.0], [100.0, 1.0, 0.0]];
    for (p, e) in scan.mesh.positions.iter().zip(expected) {
        assert!(p.abs_diff_eq(e.into(), 1e-12), "{p} {e:?}");
    }
    assert_eq!(scan.notes.iter().filter(|n| n.contains("without a weight, left where the mesh is: 1")).count(), 1);
    assert!(parse(&file(json!([1]))).unwrap_err().found.contains("joint 1 does not exist"));
    assert!(parse(&file(json!([1, 2, 0]))).is_err());
    assert!(parse(&file(json!([1, 9]))).is_err());
}

#[test]
fn quantized_positions_and_every_look_are_kept() {
    let mut b = Builder::default();
    let points = b.accessor(
        5122,
        "VEC3",
        4,
        [[0i16, 0, 0], [32767, 0, 0], [32767, 32767, 0], [-32768, 0, 0]]
            .as_flattened()
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect(),
    );
    b.accessors[points]["normalized"] = json!(true);
    let uvs = b.floats(&[[0.0, 0.0], [1.0, 0.25], [0.5, f32::NAN], [0.5, 1.0]]);
    let colors = b.accessor(5121, "VEC4", 4, vec![0, 255, 0, 255, 55, 55, 55, 128, 0, 0, 0, 255, 0, 0, 0, 255]);
    b.accessors[colors]["normalized"] = json!(true);
    let indices = b.indices(&[0, 1, 2, 0, 2, 3]);
    let png = b.view(b"\x89PNG\r\n\x1a\nrest".to_vec());
    let attributes = json!({ "POSITION": points, "TEXCOORD_1": uvs, "COLOR_0": colors });
    let transform = json!({ "KHR_texture_transform": { "offset": [0.5, 0], "scale": [2, 1], "texCoord": 1 } });
    let more = json!({
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization", "KHR_texture_transform"],
        "materials": [{
            "name": "skin", "alphaMode": "BLEND", "emissiveFactor": [0, 0.5, 0],
            "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 1, 0.5], "metallicFactor": 0.25, "baseColorTexture": { "index": 0, "extensions": transform } },
            "normalTexture": { "index": 0 },
        }],
        "textures": [{ "source": 0 }],
        "images": [{ "bufferView": png, "mimeType": "image/png", "name": "face" }],
    });
    let nodes = json!([{ "mesh": 0, "scale": [2, 2, 2] }, { "mesh": 1 }]);
    let meshes = json!([
        { "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] },
        { "primitives": [{ "attributes": { "POSITION": points }, "targets": [{ "POSITION": points }] }] },
    ]);
    let scan = parse(&b.file(nodes, meshes, more)).unwrap();
    assert_eq!(scan.mesh.positions[2], DVec3::new(2.0, 2.0, 0.0));
    assert_eq!(scan.mesh.positions[3], DVec3::new(-2.0, 0.0, 0.0));
    let look = &scan.look;
    assert_eq!(look.corner_uvs, [0, 1, NONE, 0, NONE, 3, NONE, NONE, NONE]);
    assert_eq!((look.uvs[0], look.uvs[1]), ([0.5, 1.0], [2.5, 0.75]));
    assert_eq!(look.colors[0], [0.0, 1.0, 0.0, 1.0]);
    // 55 of 255 in linear light is 128 in sRGB.
    assert!((look.colors[1][0] * 255.0 - 128.0).abs() < 0.4 && (look.colors[1][3] - 128.0 / 255.0).abs() < 1e-6);
    assert_eq!((look.colors[4], look.colors_have_alpha), ([1.0; 4], true));
    assert_eq!((look.face_materials.as_slice(), look.materials.len()), (&[0, 0, NONE][..], 1));
    let material = &look.materials[0];
    assert_eq!(
        (material.name.as_str(), material.base_color, material.metallic, material.roughness),
        ("skin", [0.5, 0.25, 1.0, 0.5], 0.25, 1.0)
    );
    assert_eq!((material.emissive, material.blend), ([0.0, 0.5, 0.0], true));
    assert!(
        matches!(&material.base_color_texture, Some(Image::Embedded { name, bytes }) if name == "face" && bytes.ends_with(b"rest"))
    );
    assert_eq!(material.normal_texture, None);
    let notes: Vec<_> = scan.notes.iter().collect();
    assert!(
        notes.iter().any(|n| n.contains("morph targets")) && notes.iter().any(|n| n.contains("normal textures")),
        "{notes:?}"
    );
}

#[test]
fn packed_and_unknown_geometry_is_refused_with_the_remedy() {
    let mut b = Builder::default();
    let square = b.floats(&SQUARE);
    b.accessors.push(json!({ "componentType": 5126, "type": "VEC3", "count": 4 }));
    let file = |primitive: Value, required: Value| {
        parse(&b.file(json!([{ "mesh": 0 }]), json!([{ "primitives": [primitive] }]), json!({ "extensionsRequired": required })))
    };
    let draco = json!({ "attributes": { "POSITION": 1 }, "extensions": { "KHR_draco_mesh_compression": { "bufferView": 0, "attributes": {} } } });
    let error = file(draco.clone(), json!(["KHR_draco_mesh_compression"])).unwrap_err();
    assert!(error.kind == Kind::Unsupported && error.hint.as_ref().unwrap().contains("Compression"), "{error}");
    // With data of its own beside the packed ones it is read.
    let mut both = draco;
    both["attributes"]["POSITION"] = json!(square);
    assert!(file(both, json!([])).is_ok());
    let error = file(json!({ "attributes": { "POSITION": square } }), json!(["EXT_made_up"])).unwrap_err();
    assert!(error.kind == Kind::Unsupported && error.found.contains("EXT_made_up"));
}

#[test]
fn flaws_of_the_scene_are_errors() {
    let mut b = Builder::default();
    let (square, wrong, far) = (b.floats(&SQUARE), b.indices(&[0, 1, 4]), b.floats(&[[f32::INFINITY, 0.0, 0.0]; 3]));
    let scene = |node: Value, primitive: Value| parse(&b.file(json!([node]), json!([{ "primitives": [primitive] }]), json!({})));
    let mesh = json!({ "mesh": 0 });
    assert!(scene(mesh.clone(), json!({ "attributes": { "POSITION": square } })).is_ok());
    for (node, primitive) in [
        (mesh.clone(), json!({ "attributes": { "POSITION": square }, "indices": wrong })),
        (mesh.clone(), json!({ "attributes": { "POSITION": far } })),
        (mesh.clone(), json!({ "attributes": { "POSITION": 9 } })),
        (mesh.clone(), json!({ "attributes": {} })),
        (mesh.clone(), json!({ "attributes": { "POSITION": square }, "material": 3 })),
        (json!({ "mesh": 7 }), json!({ "attributes": { "POSITION": square } })),
        (json!({ "mesh": 0, "skin": 2 }), json!({ "attributes": { "POSITION": square } })),
        (
            json!({ "mesh": 0, "scale": [1e300, 1e300, 1e300], "translation": [1e308, 1e308, 1e308] }),
            json!({ "attributes": { "POSITION": far } }),
        ),
        (json!({}), json!({ "attributes": { "POSITION": square } })),
    ] {
        let error = scene(node.clone(), primitive.clone()).expect_err(&format!("{node} {primitive}"));
        assert!(error.file.is_some());
    }
}

#[test]
fn a_scene_that_repeats_itself_without_end_is_refused() {
    let mut b = Builder::default();
    let points = b.floats(&vec![[0.5f32; 3]; 3000]);
    let nodes = Value::Array(vec![json!({ "mesh": 0 }); 3000]);
    let file = b.file(nodes, json!([{ "primitives": [{ "attributes": { "POSITION": points } }] }]), json!({}));
    assert_eq!(parse(&file).unwrap_err().kind, Kind::Refused);
}

#[test]
fn vertices_that_seams_repeat_are_twins() {
    let mut b = Builder::default();
    let points = b.floats(&[SQUARE[0], SQUARE[1], SQUARE[2], SQUARE[2], SQUARE[0], SQUARE[3]]);
    let normals =
        b.floats(&[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, -0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]);
    let mesh = |attributes: Value| json!([{ "primitives": [{ "attributes": attributes }] }]);
    let nodes = json!([{ "mesh": 0 }, { "mesh": 0 }]);
    let scan = parse(&b.file(nodes.clone(), mesh(json!({ "POSITION": points, "NORMAL": normals })), json!({}))).unwrap();
    // Corner 0 is a hard edge, corner 2 is not; another node's vertices are others.
    assert_eq!(scan.look.twins, [0, 1, 2, 2, 4, 5, 6, 7, 8, 8, 10, 11]);
    assert!(parse(&b.file(nodes, mesh(json!({ "POSITION": points })), json!({}))).unwrap().look.twins.is_empty());
}

#[test]
fn morph_targets_are_poses_where_the_node_shows_them() {
    let mut b = Builder::default();
    let positions = b.floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let up = b.floats(&[[0.0, 0.0, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.25]]);
    let aside = b.floats(&[[0.5, 0.0, 0.0]; 3]);
    let short = b.floats(&[[0.5, 0.0, 0.0]; 2]);
    let mesh = |targets: Value, names: Value| json!([{ "primitives": [{ "attributes": { "POSITION": positions }, "targets": targets }], "extras": names }]);
    let nodes = json!([{ "mesh": 0, "translation": [0.0, 10.0, 0.0] }]);
    let read = |meshes: Value| {
        let more = json!({ "scenes": [{ "nodes": [0] }], "scene": 0 });
        read_targets(&b.file(nodes.clone(), meshes, more), Path::new("a.glb"), &Beside::Nothing)
    };
    let targets = read(mesh(
        json!([{ "POSITION": up }, { "NORMAL": aside }, { "POSITION": aside }]),
        json!({ "targetNames": ["up", "none"] }),
    ))
    .unwrap();
    let names: Vec<&str> = targets.iter().map(|t| t.0.as_str()).collect();
    assert_eq!(names, ["up", "none", "target 3"]);
    assert_eq!(targets[0].1.mesh.positions[2], DVec3::new(0.0, 11.0, 0.25));
    assert_eq!(targets[1].1.mesh.positions[2], DVec3::new(0.0, 11.0, 0.0));
    assert_eq!(targets[2].1.mesh.positions[0], DVec3::new(0.5, 10.0, 0.0));
    assert!(read(mesh(json!([]), json!("free text"))).unwrap().is_empty());
    let error = read(mesh(json!([{ "POSITION": short }]), json!(7))).unwrap_err();
    assert!(error.to_string().contains("2 vertices where there are 3"), "{error}");
}
