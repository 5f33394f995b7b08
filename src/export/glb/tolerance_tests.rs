//! Encodings and tolerances, on the bar of the other tests.

use super::reader::Read;
use super::tests::{encode_as, header, pose, pose_at, worst_of};
use super::*;
use crate::error::Kind;
use crate::export::encode::{Encode, Tolerance};
use glam::DVec3;

fn options(percent: f64, encode: Encode) -> Options {
    Options { tolerance: Tolerance::of_worst(percent / 100.0), encode, source_index: false }
}

#[test]
fn a_smaller_tolerance_takes_more_joints_and_is_met() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = header(DVec3::ZERO);
    let mut joints = Vec::new();
    for percent in [2.0, 0.25, 0.05] {
        let written = encode_as(&header, &path, options(percent, Encode::Skin), |f| pose(&header, f)).unwrap();
        let worst = worst_of(&header, &path, |f| pose(&header, f)).0 / header.unit_box.diagonal;
        assert!(worst <= percent / 100.0, "{worst} of {percent} %");
        assert!((written.max_error / header.unit_box.diagonal - worst).abs() < 1e-6);
        joints.push(Read::open(&path).document.skins().next().unwrap().joints().count());
    }
    assert!(joints.is_sorted_by(|a, b| a < b), "{joints:?}");
}

#[test]
fn what_cannot_be_met_is_an_error_with_the_frame_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    for encode in [Encode::Skin, Encode::Auto, Encode::Morph] {
        let path = folder.path().join("out.glb");
        let error = encode_as(&header, &path, options(1e-9, encode), |f| pose(&header, f)).unwrap_err();
        assert_eq!((error.kind, error.exit_code()), (Kind::Unreached, 1));
        let frame: i64 = error.place.as_ref().unwrap().strip_prefix("worst in frame ").unwrap().parse().unwrap();
        assert!((50..50 + header.frames as i64).contains(&frame), "{error}");
        assert!(error.found.contains("% worst") && error.hint.as_ref().unwrap().contains("--tolerance"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn where_joints_no_longer_help_morph_targets_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = header(DVec3::ZERO);
    let mut corrected = 0;
    // Finer and finer, until the file has no more to give.
    for percent in (0..30).map(|k| 5e-3 * 0.85_f64.powi(k)) {
        let written = match encode_as(&header, &path, options(percent, Encode::Auto), |f| pose(&header, f)) {
            Err(error) if error.kind == Kind::Unreached && percent < 3e-3 => break,
            written => written.unwrap(),
        };
        let (worst, _) = worst_of(&header, &path, |f| pose(&header, f));
        assert!(written.max_error <= percent / 100.0 * header.unit_box.diagonal, "{percent}: {}", written.max_error);
        assert!((worst - written.max_error).abs() < 1e-7, "{percent}: {worst} {}", written.max_error);
        let read = Read::open(&path);
        assert!(read.weights.iter().all(|w| (0.0..=1.0).contains(w)), "as Blender's sliders");
        let count = read.weights.len() / header.frames;
        assert_eq!(written.encoding.ends_with(&format!("{count} morphs")), count > 0, "{}", written.encoding);
        corrected += count;
    }
    assert!(corrected > 0, "no morph target was ever needed");
}

#[test]
fn morph_targets_alone_carry_the_motion() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let mut counts = Vec::new();
    for (shift, percent) in [(DVec3::ZERO, 1.0), (DVec3::new(3e6, -2e6, 5e5), 0.25)] {
        let header = header(shift);
        let written = encode_as(&header, &path, options(percent, Encode::Morph), |f| pose(&header, f)).unwrap();
        let (worst, at) = worst_of(&header, &path, |f| pose(&header, f));
        assert!(worst <= percent / 100.0 * header.unit_box.diagonal, "{worst}");
        assert!((worst - written.max_error).abs() < 1e-6 * header.unit_box.diagonal, "{worst} {}", written.max_error);
        assert_eq!(written.worst_frame, Some(50 + at as i64));
        let read = Read::open(&path);
        assert_eq!(read.document.skins().count(), 0);
        assert!(read.weights.iter().all(|w| (0.0..=1.0).contains(w)), "as Blender's sliders");
        let count = read.weights.len() / header.frames;
        assert_eq!(written.encoding, format!("{count} morphs"));
        let rest = read.rest();
        for (p, r) in read.at_rest().iter().zip(&rest) {
            assert!((*p - *r - header_offset(&read)).length() < 1e-5, "the file at rest is the scan");
        }
        counts.push(count);
    }
    assert!(counts[0] < counts[1] && counts[1] <= 20, "{counts:?}");
}

fn header_offset(read: &Read) -> DVec3 {
    let rig = read.document.nodes().next().unwrap();
    DVec3::from_array(rig.transform().decomposed().0.map(f64::from))
}

#[test]
fn between_keys_the_file_stays_near() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let mut header = header(DVec3::ZERO);
    Arc::get_mut(&mut header).unwrap().frames = 96;
    for encode in [Encode::Auto, Encode::Morph] {
        encode_as(&header, &path, options(0.25, encode), |f| pose(&header, f)).unwrap();
        let read = Read::open(&path);
        for f in 0..header.frames - 1 {
            let time = f as f64 + 0.5;
            let worst = read.distance(&header, time, &pose_at(&header, time)) / header.unit_box.diagonal;
            assert!(worst <= 0.01, "{worst} at {time}");
        }
    }
}

/// Both ends of the bar, up to and from some places along it, in two groups.
fn two_pieces(left: f64, right: f64) -> Arc<Header> {
    let mut header = header(DVec3::ZERO);
    let own = Arc::get_mut(&mut header).unwrap();
    let scan = Arc::make_mut(&mut own.scan);
    let of_face: Vec<Option<u32>> = scan
        .mesh
        .faces
        .iter()
        .map(|face| {
            let x = face.iter().map(|&v| scan.mesh.positions[v as usize].x);
            let (low, high) = x.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
            (high < left).then_some(0).or((low > right).then_some(1))
        })
        .collect();
    let kept = |values: &[u32], each: usize| -> Vec<u32> {
        let rows = values.chunks_exact(each).zip(&of_face).filter(|(_, piece)| piece.is_some());
        rows.flat_map(|(row, _)| row.to_vec()).collect()
    };
    let corners = kept(&scan.mesh.faces.corners, 3);
    scan.look.corner_uvs = kept(&scan.look.corner_uvs, 3);
    scan.look.face_materials = kept(&scan.look.face_materials, 1);
    scan.look.face_groups = of_face.iter().copied().flatten().collect();
    scan.look.groups = ["lid", "lid"].map(|name| crate::scan::Group { object: None, group: Some(name.to_owned()) }).to_vec();
    scan.mesh.faces = crate::scan::Faces::default();
    corners.chunks_exact(3).for_each(|f| scan.mesh.faces.push([f[0], f[1], f[2]]));
    header
}

#[test]
fn rigid_parts_leave_as_nodes_with_tracks_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = two_pieces(0.8, 2.2);
    // The halves turn about different axes.
    let turning = |f: usize| -> Vec<DVec3> {
        let angle = f as f64 * 0.1;
        let half = |p: &DVec3| match p.x < 0.0 {
            true => glam::DQuat::from_rotation_z(angle) * *p,
            false => glam::DQuat::from_rotation_y(-2.0 * angle) * *p + DVec3::Z * (0.01 * f as f64),
        };
        header.proxy.rest.iter().map(half).collect()
    };
    let written = encode_as(&header, &path, Options::default(), turning).unwrap();
    assert_eq!(written.encoding, "2 rigid parts");
    let read = Read::open(&path);
    assert_eq!((read.document.skins().count(), read.document.meshes().count()), (0, 2));
    let names: Vec<&str> = read.document.nodes().map(|n| n.name().unwrap()).collect();
    assert_eq!(names, ["rig", "root", "lid", "lid_01"]);
    let moving: Vec<usize> = read.document.animations().next().unwrap().channels().map(|c| c.target().node().index()).collect();
    assert_eq!(moving, [1, 1, 2, 2, 3, 3]);
    let (worst, _) = worst_of(&header, &path, turning);
    assert!(worst <= 1e-4 * header.unit_box.diagonal, "{worst}");
    assert!((worst - written.max_error).abs() < 1e-6 * header.unit_box.diagonal);
    // Pieces that both bend are a skin, and so is one that is asked for.
    let bent = encode_as(&header, &path, Options::default(), |f| pose(&header, f)).unwrap();
    assert!(bent.encoding.starts_with("skin, "), "{}", bent.encoding);
    let asked = encode_as(&header, &path, options(0.25, Encode::Skin), turning).unwrap();
    assert!(asked.encoding.starts_with("skin, "), "{}", asked.encoding);
    // Pieces that move alike are one part, and one part is no reason to do without a skin.
    let whole = |f: usize| header.proxy.rest.iter().map(|&p| glam::DQuat::from_rotation_z(0.1 * f as f64) * p).collect();
    assert_eq!(encode_as(&header, &path, Options::default(), whole).unwrap().encoding, "skin, 1 joints");
}

/// The left half turns, the right one does what the whole bar does elsewhere.
fn half_bent(header: &Header, f: usize) -> Vec<DVec3> {
    let turn = glam::DQuat::from_rotation_z(f as f64 * 0.1);
    let bent = pose(header, f);
    header.proxy.rest.iter().zip(bent).map(|(p, bent)| if p.x < 0.0 { turn * *p } else { bent }).collect()
}

#[test]
fn what_bends_is_a_skin_beside_the_nodes_of_rigid_parts() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    for shift in [DVec3::ZERO, DVec3::new(3e6, -2e6, 5e5)] {
        let mut header = two_pieces(0.8, 2.2);
        let own = Arc::get_mut(&mut header).unwrap();
        own.unit_box.centre += shift;
        Arc::make_mut(&mut own.scan).mesh.positions.iter_mut().for_each(|p| *p += shift);
        let written = encode_as(&header, &path, Options::default(), |f| half_bent(&header, f)).unwrap();
        let read = Read::open(&path);
        let joints = read.document.skins().next().unwrap().joints().count() - 1;
        assert_eq!(written.encoding, format!("1 rigid part, skin, {joints} joints"));
        let names: Vec<&str> = read.document.nodes().map(|n| n.name().unwrap()).collect();
        assert_eq!(names[..3], ["rig", "root", "lid"]);
        assert!(names[3..3 + joints].iter().all(|name| name.starts_with("right_")), "{names:?}");
        assert_eq!(names[3 + joints..], ["bar"]);
        let (worst, _) = worst_of(&header, &path, |f| half_bent(&header, f));
        assert!((worst - written.max_error).abs() < 1e-6 * header.unit_box.diagonal, "{worst} {}", written.max_error);
        assert!(worst <= 0.0025 * header.unit_box.diagonal);
    }
    let lone = two_pieces(0.8, 2.2);
    let rigid = |f: usize| -> Vec<DVec3> {
        let pose = half_bent(&lone, f);
        pose.iter().zip(&lone.proxy.rest).map(|(q, p)| if p.x < 0.0 { *q } else { *p }).collect()
    };
    assert_eq!(encode_as(&lone, &path, Options::default(), rigid).unwrap().encoding, "2 rigid parts");
}

#[test]
fn a_part_that_bends_in_one_frame_is_no_rigid_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = two_pieces(0.8, 2.2);
    for bent in 8..14 {
        let turning = |f: usize| -> Vec<DVec3> {
            let turn = glam::DQuat::from_rotation_z(f as f64 * 0.1);
            let place = |p: &DVec3| match p.x < 0.0 {
                true if f == bent => turn * (*p + DVec3::Y * (0.02 * p.x * p.x)),
                true => turn * *p,
                false => glam::DQuat::from_rotation_y(-0.2 * f as f64) * *p,
            };
            header.proxy.rest.iter().map(place).collect()
        };
        let written = encode_as(&header, &path, Options::default(), turning).unwrap();
        assert!(written.encoding.starts_with("1 rigid part, skin, "), "{bent}: {}", written.encoding);
        assert!(worst_of(&header, &path, turning).0 <= 0.0025 * header.unit_box.diagonal);
    }
}

#[test]
fn a_crumb_beside_a_large_piece_that_bends_is_in_its_skin() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = two_pieces(0.05, 0.8);
    let crumb = header.unit_box.enter(DVec3::X * 0.6).x;
    let still = |f: usize| -> Vec<DVec3> {
        let bent = pose(&header, f);
        header.proxy.rest.iter().zip(bent).map(|(p, bent)| if p.x < crumb { *p } else { bent }).collect()
    };
    let written = encode_as(&header, &path, Options::default(), still).unwrap();
    assert!(written.encoding.starts_with("skin, "), "{}", written.encoding);
}

#[test]
fn vertices_know_the_scan_s_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let header = header(DVec3::ZERO);
    encode_as(&header, &path, Options::default(), |f| pose(&header, f)).unwrap();
    let has = |read: &Read| {
        read.document
            .meshes()
            .next()
            .unwrap()
            .primitives()
            .all(|p| p.attributes().any(|(s, _)| s.to_string().contains("SOURCE_INDEX")))
    };
    assert!(!has(&Read::open(&path)));
    encode_as(&header, &path, Options { source_index: true, ..Options::default() }, |f| pose(&header, f)).unwrap();
    let text = std::fs::read(&path).unwrap();
    let length = u32::from_le_bytes(text[12..16].try_into().unwrap()) as usize;
    let json: serde_json::Value = serde_json::from_slice(&text[20..20 + length]).unwrap();
    let bin = &text[28 + length..];
    let read = Read::open(&path);
    let mut rest = read.rest().into_iter();
    for primitive in json["meshes"][0]["primitives"].as_array().unwrap() {
        let accessor = &json["accessors"][primitive["attributes"]["_SOURCE_INDEX"].as_u64().unwrap() as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let start = (accessor["byteOffset"].as_u64().unwrap() + view["byteOffset"].as_u64().unwrap()) as usize;
        for k in 0..accessor["count"].as_u64().unwrap() as usize {
            let number = f32::from_le_bytes(bin[start + 4 * k..][..4].try_into().unwrap());
            let p = rest.next().unwrap();
            assert!((header.scan.mesh.positions[number as usize] - p).length() < 1e-6);
        }
    }
    assert!(rest.next().is_none());
}

#[test]
fn sinks_of_one_recording_write_the_same_file() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let recording = Recording::new(Options::default());
    let paths = ["a.glb", "b.glb"].map(|n| folder.path().join(n));
    let mut sinks: Vec<Box<dyn FrameSink>> =
        paths.iter().map(|p| Box::new(GlbSink::of(p, &recording)) as Box<dyn FrameSink>).collect();
    sinks.iter_mut().for_each(|s| s.begin(&header).unwrap());
    for first in (0..header.frames).step_by(8) {
        let poses: Vec<Vec<DVec3>> = (first..header.frames.min(first + 8)).map(|f| pose(&header, f)).collect();
        let batch = FrameBatch { first, proxy: &poses, points: &[], normals: &[] };
        sinks.iter_mut().for_each(|s| s.frames(&batch).unwrap());
    }
    let sizes: Vec<u64> = sinks.into_iter().map(|s| s.finish().unwrap().bytes).collect();
    assert_eq!(sizes[0], sizes[1]);
    assert!(std::fs::read(&paths[0]).unwrap() == std::fs::read(&paths[1]).unwrap());
    let alone = folder.path().join("c.glb");
    encode_as(&header, &alone, Options::default(), |f| pose(&header, f)).unwrap();
    assert!(std::fs::read(&paths[0]).unwrap() == std::fs::read(&alone).unwrap());
}
