//! A small file, the real ones against another reader, and damage.
#![allow(clippy::unwrap_used, clippy::type_complexity)]

use super::*;
use crate::capture::skeleton_mutants::gltf as small;
use crate::capture::{self, Capture, Motion, ReadOptions, SkeletonTake, tests::real};
use glam::DVec3;

fn parse(bytes: &[u8], clip: Option<&str>) -> Result<SkeletonFile> {
    read(bytes, &|name| Err(Error::new(Kind::Unreadable, format!("no {name}"))), clip)
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
    let gltf = gltf::parse(&std::fs::read(&path).unwrap(), &|_| unreachable!()).unwrap();
    assert!((capture.rate - 37.5).abs() < 1e-3, "{}", capture.rate);
    let (tree, joints) = (gltf.hierarchy().unwrap(), &gltf.document.skins[0].joints);
    let order = with_ancestors(&tree, joints);
    let curves = Curves::read(&mut Accessors::new(&gltf), &gltf.document.animations[0], &|_| true).unwrap();
    let mut worlds = vec![DAffine3::IDENTITY; gltf.document.nodes.len()];
    // Half a second lies between two keys: 18.75.
    for (time, joint, place) in
        [(0.0, 2, [-0.0165, 1.5412, 0.0542]), (0.5, 2, [0.0308, 1.5437, 0.0571]), (0.5, 17, [0.0232, 0.0693, 0.0518])]
    {
        stand(&gltf, &tree, &order, &curves, time, &mut worlds);
        let found = worlds[joints[joint] as usize].translation;
        assert!(found.distance(place.into()) < 1.5e-4, "{joint} at {time}: {found}");
        let name = gltf.document.nodes[joints[joint] as usize].name.as_deref().unwrap();
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
        let capture = capture::read(&path, &ReadOptions::default()).unwrap();
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
