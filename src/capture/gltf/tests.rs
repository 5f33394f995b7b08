//! A small file, the real ones against another reader, and damage.
#![allow(clippy::unwrap_used, clippy::type_complexity)]

use super::*;
use crate::capture::skeleton_mutants::gltf as small;
use crate::capture::{self, Capture, Motion, ReadOptions, SkeletonTake, tests::real};
use glam::DVec3;

fn parse(bytes: &[u8], clip: Option<&str>) -> Result<SkeletonFile> {
    read_joints(bytes, &|name| Err(Error::new(Kind::Unreadable, format!("no {name}"))), clip)
}

fn said(notes: &Notes) -> String {
    notes.iter().collect::<Vec<_>>().join("\n")
}

fn skeleton(capture: &Capture) -> &SkeletonTake {
    match &capture.motion {
        Motion::Skeleton(take) => take,
        other => panic!("not a skeleton but {}", other.noun()),
    }
}

fn at(take: &SkeletonTake, joint: &str, frame: usize) -> DVec3 {
    let joint = take.joints.iter().position(|j| j.name == joint).unwrap_or_else(|| panic!("no joint {joint}"));
    take.origins.point(frame, joint).unwrap()
}

/// The document of a GLB file changed by a function.
fn changed(change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let bytes = small();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let mut document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    change(&mut document);
    crate::gltf::tests::glb(&document, &bytes[28 + length..])
}

#[test]
fn a_small_file_means_what_the_mathematics_says() {
    let file = parse(&small(), None).unwrap();
    let take = &file.take;
    let joints: Vec<(&str, Option<usize>)> = take.joints.iter().map(|j| (j.name.as_str(), j.parent)).collect();
    assert_eq!(joints, [("base", None), ("tip", Some(0))]);
    assert_eq!((file.rate, file.first_frame, take.origins.frames(), take.rest), (2.0, 1, 3, Rest::Bind));
    assert_eq!((take.joints[0].rest, take.joints[1].rest), (DVec3::ZERO, DVec3::Y));
    assert_eq!(file.name.as_deref(), Some("Bend"));
    assert_eq!(said(&file.notes), "2 clips: 'Bend' (1.0 s) is used, the longest; others (--clip): 'Stay' (0.0 s)");
    // The place of the armature, the half turn of the base, its doubled size.
    assert!(at(take, "base", 1).distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-6);
    assert!(at(take, "tip", 1).distance(DVec3::new(-1.0, 2.0, 3.0)) < 1e-6, "{}", at(take, "tip", 1));
    assert!(at(take, "tip", 2).distance(DVec3::new(2.0, 3.0, 6.0)) < 1e-6, "{}", at(take, "tip", 2));
    let turn = glam::DQuat::from_array(take.rotations[2].map(f64::from));
    assert!((turn.dot(glam::DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2)).abs() - 1.0).abs() < 1e-6);
    assert_eq!(file.space.unit.unwrap().value, Unit::Metre);
    assert_eq!(file.space.up.unwrap().value.vector(), DVec3::Y);
    let stay = parse(&small(), Some("stay")).unwrap();
    assert_eq!((stay.take.origins.frames(), stay.first_frame), (1, 15));
}

#[test]
fn joints_are_found_without_skin_and_rest_without_bind_matrices() {
    let file = parse(&changed(|d| d["skins"] = serde_json::json!([])), None).unwrap();
    let names: Vec<&str> = file.take.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!((names, file.take.rest), (vec!["armature", "base", "tip"], Rest::Nodes));
    assert!(at(&file.take, "tip", 1).distance(DVec3::new(-1.0, 2.0, 3.0)) < 1e-6);
    let file = parse(&changed(|d| d["skins"][0]["inverseBindMatrices"].take().as_null().unwrap_or_default()), None).unwrap();
    assert_eq!((file.take.rest, file.take.joints[1].rest), (Rest::Nodes, DVec3::Y));
    // Bound elsewhere than the nodes stand: the highest joint stays, the others lie as they were bound to it.
    let moved = changed(|d| d["nodes"][1]["translation"] = serde_json::json!([5.0, 0.0, 0.0]));
    assert_eq!(parse(&moved, None).unwrap().take.joints[1].rest, DVec3::Y);
    let raised = changed(|d| d["nodes"][0]["translation"] = serde_json::json!([0.0, 0.0, 7.0]));
    assert_eq!(parse(&raised, None).unwrap().take.joints[1].rest, DVec3::new(0.0, 1.0, 7.0));
    // The mesh may lie anywhere when it is bound, here a unit lower in z.
    let mut lower = small();
    let matrices = lower.len() - 128;
    [14, 30].iter().for_each(|k| lower[matrices + 4 * k..][..4].copy_from_slice(&(-1f32).to_le_bytes()));
    let joints = parse(&lower, None).unwrap().take.joints;
    assert_eq!((joints[0].rest, joints[1].rest), (DVec3::ZERO, DVec3::Y));
    // What an earlier skin has placed stays, whatever a later one says.
    let twice = changed(|d| {
        let accessor = d["accessors"][5].clone();
        d["accessors"].as_array_mut().unwrap().push(accessor);
        d["skins"].as_array_mut().unwrap().push(serde_json::json!({ "joints": [2, 1], "inverseBindMatrices": 6 }));
    });
    assert_eq!(parse(&twice, None).unwrap().take.joints[1].rest, DVec3::Y);
    let large = parse(&changed(|d| d["nodes"][0]["scale"] = serde_json::json!([50.0, 50.0, 50.0])), None).unwrap();
    assert!(large.space.unit.is_none() && said(&large.notes).contains("the unit is left open"), "{}", said(&large.notes));
}

/// A chain of nodes, of which only the last is a joint; node `moved` goes by three keys at uneven times.
fn chain(nodes: usize, moved: usize) -> Vec<u8> {
    let numbers = [0.0f32, 0.004, 40.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0];
    let binary: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    let node = |n: usize| if n + 1 < nodes { serde_json::json!({ "children": [n + 1] }) } else { serde_json::json!({}) };
    let document = serde_json::json!({
        "asset": { "version": "2.0" },
        "nodes": (0..nodes).map(node).collect::<Vec<_>>(),
        "skins": [{ "joints": [nodes - 1] }],
        "animations": [{
            "channels": [{ "sampler": 0, "target": { "node": moved, "path": "translation" } }],
            "samplers": [{ "input": 0, "output": 1 }],
        }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "SCALAR" },
            { "bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3" },
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 12 }, { "buffer": 0, "byteOffset": 12, "byteLength": 36 }],
        "buffers": [{ "byteLength": binary.len() }],
    });
    crate::gltf::tests::glb(&document, &binary)
}

#[test]
fn nodes_above_the_joints_are_work_in_every_frame_only_if_they_move() {
    let deep = parse(&chain(60_000, 59_999), None).unwrap();
    assert_eq!(deep.take.origins.frames(), 9601);
    assert!(at(&deep.take, "node 59999", 9600).distance(DVec3::X * 2.0) < 1e-6);
    let error = parse(&chain(60_000, 0), None).unwrap_err();
    assert!(error.kind == Kind::Refused && error.found.contains("9601 frames of 60000 nodes"), "{error:?}");
    let file = parse(&chain(5, 2), None).unwrap();
    assert!(at(&file.take, "node 4", 9600).distance(DVec3::X * 2.0) < 1e-6);
}

#[test]
fn extensions_that_only_meshes_and_looks_need_do_not_matter() {
    let with = |name: &str| parse(&changed(|d| d["extensionsRequired"] = serde_json::json!([name])), None);
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_materials_variants", "VRMC_vrm"] {
        assert_eq!(with(name).unwrap().take.origins.frames(), 3, "{name}");
    }
    assert!(with("EXT_of_the_moon").unwrap_err().found.contains("EXT_of_the_moon"));
    // Packed keys cannot be had.
    let packed = changed(|d| {
        d["buffers"].as_array_mut().unwrap().push(serde_json::json!({ "byteLength": 12 }));
        d["bufferViews"][0] =
            serde_json::json!({ "buffer": 1, "byteLength": 12, "extensions": { "EXT_meshopt_compression": { "buffer": 0 } } });
        d["extensionsRequired"] = serde_json::json!(["EXT_meshopt_compression"]);
    });
    assert!(parse(&packed, None).unwrap_err().found.contains("meshopt"));
}

#[test]
fn defects_are_told() {
    let error = |change: &dyn Fn(&mut serde_json::Value)| parse(&changed(change), None).unwrap_err().to_string();
    assert!(error(&|d| d["animations"] = serde_json::json!([])).contains("the file has no animation"));
    assert!(error(&|d| d["animations"][0]["channels"][0]["target"]["node"] = 9.into()).contains("node 9 does not exist"));
    assert!(error(&|d| d["animations"][0]["channels"][0]["sampler"] = 9.into()).contains("sampler 9 does not exist"));
    assert!(error(&|d| d["animations"][0]["samplers"][0]["output"] = 2.into()).contains("accessor 2"));
    assert!(error(&|d| d["accessors"][1]["count"] = 4_294_967_295u32.into()).contains("more numbers than the file has bytes"));
    assert!(error(&|d| d["accessors"][1]["count"] = 8.into()).contains("8 values for 3 times"));
    assert!(
        error(&|d| d["animations"][0]["samplers"][0]["input"] = 3.into()).contains("do not rise")
            || error(&|d| d["animations"][0]["samplers"][0]["input"] = 3.into()).contains("accessor")
    );
    assert!(
        error(&|d| {
            d["skins"] = serde_json::json!([]);
            d["animations"] = serde_json::json!([{}])
        })
        .contains("neither a skin nor nodes that move")
    );
    assert!(parse(&small(), Some("Walk")).unwrap_err().to_string().contains("'Bend' (1.0 s)"));
}

#[test]
fn real_files_have_the_places_that_another_reader_found() {
    let cases: [(&str, Option<&str>, f64, &str, [f64; 3]); 4] = [
        ("Fox.glb", Some("Walk"), 0.0, "b_Hip_01", [0.2232, 40.0512, -24.5518]),
        ("Fox.glb", Some("Walk"), 0.5, "b_Head_05", [-0.2443, 53.1247, 39.4332]),
        ("Fox.glb", Some("Run"), 0.5, "b_Tail03_014", [0.0, 65.7485, -73.1952]),
        ("kaykit_MovementBasic.glb", Some("Jump_Full_Long"), 0.5, "hand.l", [0.6604, 1.1445, 0.0979]),
    ];
    for (file, clip, time, joint, place) in cases {
        let Some(path) = real(&format!("gltf/{file}")) else { continue };
        let options = ReadOptions { clip: clip.map(str::to_owned), ..ReadOptions::default() };
        let capture = capture::read(&path, &options).unwrap();
        let frame = time * capture.rate - capture.first_frame as f64;
        assert!((frame - frame.round()).abs() < 1e-3, "{file} {clip:?}: frame {frame} at {} Hz", capture.rate);
        let found = at(skeleton(&capture), joint, frame.round() as usize);
        assert!(found.distance(place.into()) < 2e-4 * found.length().max(1.0), "{file} {joint}: {found}");
    }
    // The joints of this file have no names that say anything: the third and the last of the skin.
    let Some(path) = real("gltf/BrainStem.glb") else { return };
    let capture = capture::read(&path, &ReadOptions::default()).unwrap();
    let file = File::open(&std::fs::read(&path).unwrap(), &|_| unreachable!()).unwrap();
    assert!((capture.rate - 37.5).abs() < 1e-3, "{}", capture.rate);
    let joints = &file.gltf.document.skins[0].joints;
    let mut play = Play::start(&mut Accessors::new(&file.gltf), &file, joints, None, &mut Notes::default()).unwrap();
    // Half a second lies between two keys: 18.75.
    for (time, joint, place) in
        [(0.0, 2, [-0.0165, 1.5412, 0.0542]), (0.5, 2, [0.0308, 1.5437, 0.0571]), (0.5, 17, [0.0232, 0.0693, 0.0518])]
    {
        play.stand(time);
        let found = play.worlds[joints[joint] as usize].translation;
        assert!(found.distance(place.into()) < 1.5e-4, "{joint} at {time}: {found}");
        let name = file.gltf.document.nodes[joints[joint] as usize].name.as_deref().unwrap();
        assert!(time > 0.0 || at(skeleton(&capture), name, 0).distance(found) < 1e-6);
    }
}

#[test]
fn real_files_have_their_counts() {
    let cases: [(&str, usize, f64, usize, Rest); 5] = [
        ("Fox.glb", 24, 24.0, 83, Rest::Bind),
        ("kaykit_MovementBasic.glb", 23, 30.0, 0, Rest::Bind),
        ("SimpleSkin.gltf", 2, 2.0, 12, Rest::Bind),
        ("BrainStem.glb", 18, 37.5, 1309, Rest::Bind),
        ("CesiumMilkTruck.glb", 2, 24.0, 31, Rest::Nodes),
    ];
    for (file, joints, rate, frames, rest) in cases {
        let Some(path) = real(&format!("gltf/{file}")) else { continue };
        let capture = capture::read(&path, &ReadOptions { bodies: true, ..ReadOptions::default() }).unwrap();
        let take = skeleton(&capture);
        assert_eq!((take.joints.len(), take.rest), (joints, rest), "{file}");
        assert!((capture.rate - rate).abs() < 1e-3, "{file}: {}", capture.rate);
        assert!(frames == 0 || take.origins.frames() == frames, "{file}: {}", take.origins.frames());
    }
    let Some(path) = real("gltf/kaykit_MovementBasic.glb") else { return };
    let capture = capture::read(&path, &ReadOptions::default()).unwrap();
    assert!(said(&capture.notes).contains("11 clips"), "{}", said(&capture.notes));
    let across = skeleton(&capture).joints.iter().fold((f64::MAX, f64::MIN), |(a, b), j| (a.min(j.rest.x), b.max(j.rest.x)));
    assert!((across.0 + 0.883).abs() < 1e-3 && (across.1 - 0.883).abs() < 1e-3, "{across:?}");
}

/// A hand under an arm that turns by a right angle about z, and a floor: three nodes that show one triangle.
fn segments() -> (serde_json::Value, Vec<u8>) {
    let (s, c) = (0.5f32.sqrt(), 0.5f32.sqrt());
    let (s8, c8) = (std::f32::consts::FRAC_PI_8.sin(), std::f32::consts::FRAC_PI_8.cos());
    let numbers = [
        &[0.0, 0.5, 1.0][..],
        &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, s8, c8, 0.0, 0.0, s, c],
        &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ];
    let mut binary: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    for numbers in numbers {
        views.push(serde_json::json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": 4 * numbers.len() }));
        numbers.iter().for_each(|x: &f32| binary.extend(x.to_le_bytes()));
    }
    let document = serde_json::json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0, 2] }],
        "nodes": [
            { "name": "arm", "translation": [1.0, 0.0, 0.0], "mesh": 0, "children": [1] },
            { "name": "hand", "translation": [2.0, 0.0, 0.0], "mesh": 0 },
            { "name": "floor", "mesh": 0 },
        ],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 2 } }] }],
        "animations": [{
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "rotation" } }],
            "samplers": [{ "input": 0, "output": 1 }],
        }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "SCALAR" },
            { "bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC4" },
            { "bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC3" },
        ],
        "bufferViews": views,
        "buffers": [{ "byteLength": binary.len() }],
    });
    (document, binary)
}

fn surface(capture: &Capture) -> &crate::capture::VertexTake {
    match &capture.motion {
        Motion::Vertices(take) => take,
        other => panic!("not a surface but {}", other.noun()),
    }
}

fn vertex(capture: &Capture, number: u32, frame: usize) -> DVec3 {
    let take = surface(capture);
    let k = take.vertices.iter().position(|&v| v == number).unwrap_or_else(|| panic!("vertex {number} was not kept"));
    assert_eq!(take.points.labels[k], format!("v{number}"));
    take.points.point(frame, k).unwrap()
}

fn captured(document: &serde_json::Value, binary: &[u8], options: &ReadOptions) -> Result<Capture> {
    capture::read_bytes(crate::gltf::tests::glb(document, binary), Path::new("robot.glb"), options)
}

#[test]
fn meshes_that_nodes_move_are_a_surface_unless_joints_are_wanted() {
    let (document, binary) = segments();
    let capture = captured(&document, &binary, &ReadOptions::default()).unwrap();
    let take = surface(&capture);
    assert_eq!((take.count, take.faces.len(), take.points.markers(), take.points.frames()), (9, 3, 9, 3));
    assert_eq!((capture.name.as_str(), capture.rate, capture.first_frame), ("robot", 2.0, 0));
    assert_eq!(said(&capture.notes), "1 mesh of the surface not moved: 'floor'");
    // Along the arm, across it, at the wrist, beyond it, on the floor.
    let d = 0.5f64.sqrt();
    for (number, places) in [
        (1, [[2.0, 0.0, 0.0], [1.0 + d, d, 0.0], [1.0, 1.0, 0.0]]),
        (2, [[1.0, 1.0, 0.0], [1.0 - d, d, 0.0], [0.0, 0.0, 0.0]]),
        (3, [[3.0, 0.0, 0.0], [1.0 + 2.0 * d, 2.0 * d, 0.0], [1.0, 2.0, 0.0]]),
        (5, [[3.0, 1.0, 0.0], [1.0 + d, 3.0 * d, 0.0], [0.0, 2.0, 0.0]]),
        (7, [[1.0, 0.0, 0.0]; 3]),
    ] {
        for (frame, place) in places.into_iter().enumerate() {
            let found = vertex(&capture, number, frame);
            assert!(found.distance(place.into()) < 1e-6, "{number} in {frame}: {found}");
        }
    }
    let joints = captured(&document, &binary, &ReadOptions { bodies: true, ..ReadOptions::default() }).unwrap();
    assert_eq!(skeleton(&joints).origins.labels, ["arm", "hand"]);
    // A node that moves without a mesh is a joint.
    let mut bare = document.clone();
    bare["nodes"][0]["mesh"].take();
    bare["nodes"][1]["mesh"].take();
    assert_eq!(skeleton(&captured(&bare, &binary, &ReadOptions::default()).unwrap()).joints.len(), 2);
    let wanted = ReadOptions { surface: true, ..ReadOptions::default() };
    let error = captured(&bare, &binary, &wanted).unwrap_err().to_string();
    assert!(error.contains("no animation of the file moves"), "{error}");
    // Packed meshes cannot be had, but their nodes.
    let mut packed = document;
    packed["accessors"][2]["bufferView"].take();
    packed["meshes"][0]["primitives"][0]["extensions"] = serde_json::json!({ "KHR_draco_mesh_compression": {} });
    packed["extensionsRequired"] = serde_json::json!(["KHR_draco_mesh_compression"]);
    let error = captured(&packed, &binary, &ReadOptions::default()).unwrap_err();
    assert!(error.hint.unwrap().ends_with("--bodies takes the nodes alone, as joints"));
}

#[test]
fn a_skinned_mesh_is_a_surface_where_it_is_wanted() {
    let (mut document, mut binary) = segments();
    // Joints 0 and 1 for all vertices, by weights that do not sum to one; bound half a unit along x before where they stand.
    let first = binary.len();
    (0..3).for_each(|_| binary.extend([0u8, 1, 0, 0]));
    [[1.5f32, 0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.25, 0.0, 0.0]]
        .iter()
        .flatten()
        .for_each(|x| binary.extend(x.to_le_bytes()));
    for x in [-0.5f32, -2.5] {
        let matrix = glam::Mat4::from_translation(glam::Vec3::new(x, 0.0, 0.0)).to_cols_array();
        matrix.iter().for_each(|x| binary.extend(x.to_le_bytes()));
    }
    for (at, length) in [(0, 12), (12, 48), (60, 128)] {
        document["bufferViews"]
            .as_array_mut()
            .unwrap()
            .push(serde_json::json!({ "buffer": 0, "byteOffset": first + at, "byteLength": length }));
    }
    for (view, component, count, shape) in [(3, 5121, 3, "VEC4"), (4, 5126, 3, "VEC4"), (5, 5126, 2, "MAT4")] {
        document["accessors"]
            .as_array_mut()
            .unwrap()
            .push(serde_json::json!({ "bufferView": view, "componentType": component, "count": count, "type": shape }));
    }
    document["buffers"][0]["byteLength"] = binary.len().into();
    document["meshes"] =
        serde_json::json!([{ "primitives": [{ "attributes": { "POSITION": 2, "JOINTS_0": 3, "WEIGHTS_0": 4 } }] }]);
    document["skins"] = serde_json::json!([{ "joints": [0, 1], "inverseBindMatrices": 5 }]);
    document["nodes"][0]["mesh"].take();
    document["nodes"][1]["mesh"].take();
    document["nodes"][2]["skin"] = 0.into();
    let mut carried = document.clone();
    carried["nodes"][0]["children"] = serde_json::json!([1, 2]);
    carried["scenes"][0]["nodes"] = serde_json::json!([0]);
    for document in [&document, &carried] {
        assert_eq!(skeleton(&captured(document, &binary, &ReadOptions::default()).unwrap()).joints.len(), 2);
    }
    let wanted = ReadOptions { surface: true, ..ReadOptions::default() };
    let capture = captured(&document, &binary, &wanted).unwrap();
    assert!(!said(&capture.notes).contains("not moved"), "{}", said(&capture.notes));
    // Where a joint takes a vertex: from its place against the joint when it was bound. Joints move rigidly together.
    for (number, local, moved) in [(0, DVec3::ZERO, true), (1, DVec3::X, false), (2, DVec3::Y, true)] {
        for (frame, angle) in [0.0f64, 45.0, 90.0].into_iter().enumerate() {
            let turn = glam::DQuat::from_rotation_z(angle.to_radians());
            let place = if moved { DVec3::X + turn * (local - DVec3::X * 0.5) } else { local };
            let found = vertex(&capture, number, frame);
            assert!(found.distance(place) < 1e-6, "{number} in {frame}: {found} {place}");
        }
    }
}

#[test]
fn a_long_clip_of_meshes_keeps_fewer_vertices_and_an_endless_one_is_refused() {
    let (mut document, mut binary) = segments();
    // Three thousand triangles in one mesh, and two keys an hour apart with one soon after the first.
    let first = binary.len();
    (0..9000u32).for_each(|v| [v as f32, (v * v % 97) as f32, 0.0].iter().for_each(|x| binary.extend(x.to_le_bytes())));
    document["bufferViews"]
        .as_array_mut()
        .unwrap()
        .push(serde_json::json!({ "buffer": 0, "byteOffset": first, "byteLength": 108_000 }));
    document["accessors"]
        .as_array_mut()
        .unwrap()
        .push(serde_json::json!({ "bufferView": 3, "componentType": 5126, "count": 9000, "type": "VEC3" }));
    document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 3.into();
    document["buffers"][0]["byteLength"] = binary.len().into();
    let kept = |seconds: f32, binary: &mut Vec<u8>| {
        binary[4..8].copy_from_slice(&0.0333f32.to_le_bytes());
        binary[8..12].copy_from_slice(&seconds.to_le_bytes());
        captured(&document, binary, &ReadOptions::default())
    };
    assert_eq!(surface(&kept(1.0, &mut binary).unwrap()).points.markers(), 2000);
    let long = kept(150.0, &mut binary).unwrap();
    let frames = surface(&long).points.frames();
    assert_eq!(surface(&long).points.markers(), (4 << 20) / frames);
    assert_eq!(kept(4000.0, &mut binary).unwrap_err().kind, Kind::Refused);
}

#[test]
fn the_segments_of_real_files_are_where_another_reader_has_them() {
    // Vertices of the body and of both wheels, of the first and the last part.
    let truck = [
        (0, [[1.54247, 1.6458, -1.2074]; 3]),
        (3563, [[-1.427742, 0.006621, -0.8], [-1.314479, 0.853844, -0.8], [-1.35233, -0.000078, -0.8]]),
        (2977, [[1.357258, 0.006621, -0.8], [1.470521, 0.853844, -0.8], [1.43267, -0.000078, -0.8]]),
    ];
    let robot = [
        (0, [[0.074422, 1.085032, 0.053367], [0.011282, 1.104759, 0.065294], [0.040214, 1.10634, 0.054088]]),
        (2977, [[-0.14354, 0.486161, 0.211599], [-0.258262, 0.483737, 0.05777], [-0.221281, 0.463961, 0.101271]]),
        (34158, [[-0.187267, 1.666794, 0.013296], [-0.360504, 1.469046, -0.059158], [-0.263255, 1.468069, 0.12502]]),
    ];
    for (file, frames, vertices) in [("CesiumMilkTruck.glb", [0, 15, 30], truck), ("BrainStem.glb", [0, 654, 1308], robot)] {
        let Some(path) = real(&format!("gltf/{file}")) else { continue };
        let file = File::open(&std::fs::read(&path).unwrap(), &|_| unreachable!()).unwrap();
        let nodes = surface::holding(&file).unwrap();
        let mut play = Play::start(&mut Accessors::new(&file.gltf), &file, &nodes, None, &mut Notes::default()).unwrap();
        let shapes = crate::scan::Shapes::of(&file.gltf, &file.tree.shown, &play.worlds, file.size).unwrap();
        for (number, places) in vertices {
            let holds = &shapes.holds(&file.gltf, &[number]).unwrap()[0];
            for (frame, place) in frames.into_iter().zip(places) {
                play.go(frame);
                let found = surface::place(holds, &play.worlds);
                assert!(found.distance(place.into()) < 1e-5, "{path:?} {number} in {frame}: {found}");
            }
        }
    }
    let Some(path) = real("gltf/BrainStem.glb") else { return };
    let capture = capture::read(&path, &ReadOptions { surface: true, ..ReadOptions::default() }).unwrap();
    let take = surface(&capture);
    assert_eq!((take.count, take.points.markers(), take.points.frames()), (34159, 2000, 1309));
    assert!(matches!(capture::read(&path, &ReadOptions::default()).unwrap().motion, Motion::Skeleton(_)));
}

#[test]
fn broken_files_are_refused_for_their_reason() {
    for (file, words) in
        [("gltf_channel_node_out_of_range", "does not exist"), ("gltf_no_animation", "the file has no animation")]
    {
        let Some(path) = real(&format!("broken/{file}.gltf")) else { return };
        let error = capture::read(&path, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    // A length that nothing needs may be wrong.
    let read = |name: &str| capture::read(&real(name).unwrap(), &ReadOptions::default()).unwrap();
    let (long, control) = (read("broken/gltf_buffer_too_long.gltf"), read("gltf/SimpleSkin.gltf"));
    assert_eq!(skeleton(&long).rotations, skeleton(&control).rotations);
}
