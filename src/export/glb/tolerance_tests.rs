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

/// A take of 200 frames in which a few vertices jump aside in one.
fn jumping() -> (Arc<Header>, impl Fn(usize) -> Vec<DVec3>) {
    let mut header = header(DVec3::ZERO);
    Arc::get_mut(&mut header).unwrap().frames = 200;
    let shared = header.clone();
    let aside = move |f: usize| {
        let mut pose = pose(&shared, f);
        if f == 90 {
            for (p, rest) in pose.iter_mut().zip(&shared.proxy.rest) {
                let near = 1.0 - ((rest.x - 0.1) / 0.06).abs();
                *p += DVec3::Z * (0.004 * near.max(0.0));
            }
        }
        pose
    };
    (header, aside)
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
        let error = encode_as(&header, &path, options(1e-6, encode), |f| pose(&header, f)).unwrap_err();
        assert_eq!((error.kind, error.exit_code()), (Kind::Unreached, 1));
        let frame: i64 = error.place.as_ref().unwrap().strip_prefix("worst in frame ").unwrap().parse().unwrap();
        assert!((50..50 + header.frames as i64).contains(&frame), "{error}");
        assert!(error.found.contains("% worst") && error.hint.as_ref().unwrap().contains("--tolerance"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn a_jump_is_corrected_by_a_morph_target_of_a_few_vertices_in_its_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.glb");
    let (header, pose) = jumping();
    let written = encode_as(&header, &path, Options::default(), &pose).unwrap();
    assert!(written.encoding.ends_with(" morphs"), "{}", written.encoding);
    let (worst, _) = worst_of(&header, &path, &pose);
    assert!(worst <= 0.0025 * header.unit_box.diagonal, "{worst}");
    assert!((worst - written.max_error).abs() < 1e-6 * header.unit_box.diagonal);
    let read = Read::open(&path);
    let count = read.weights.len() / header.frames;
    let moved: Vec<usize> = (0..header.frames).filter(|f| read.weights[f * count..][..count].iter().any(|w| *w != 0.0)).collect();
    assert_eq!(moved, [90]);
    let targets = read.document.accessors().filter(|a| a.sparse().is_some()).map(|a| a.sparse().unwrap().count());
    let touched: usize = targets.sum();
    assert!(touched > 0 && touched < read.rest().len() / 4, "{touched} of {}", read.rest().len());
    // Without them joints alone have to do it.
    let alone = encode_as(&header, &path, options(0.25, Encode::Skin), &pose);
    assert!(alone.map_or_else(|e| e.kind == Kind::Unreached, |w| !w.encoding.contains("morph")));
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
        assert!(read.weights.iter().all(|w| w.abs() <= 1.0));
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
