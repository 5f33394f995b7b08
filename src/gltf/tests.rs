//! Documents in every packing, and what is refused.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::error::Kind;
use glam::DVec3;
use serde_json::{Value, json};

fn nothing(name: &str) -> Result<Vec<u8>> {
    Err(Error::new(Kind::Unreadable, format!("no '{name}'")))
}

/// A GLB file of these chunks.
pub(crate) fn glb(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = (12 + 8 + json.len() + 8 + binary.len()) as u32;
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend(length.to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

/// Two rows of VEC3 f32 from byte 4, interleaved with 4 bytes each; three u16; a sparse replacement.
fn sample() -> (Value, Vec<u8>) {
    let mut binary = vec![0; 4];
    for row in 0..3 {
        [1.0f32, 2.0, 3.0].iter().for_each(|x| binary.extend((x + row as f32 * 10.0).to_le_bytes()));
        binary.extend([0, 128, 255, 7]);
    }
    binary.extend([0, 0, 0xff, 0xff, 0, 128]);
    binary.extend([1, 0]);
    [7.0f32, 8.0, 9.0].iter().for_each(|x| binary.extend(x.to_le_bytes()));
    let document = json!({
        "asset": { "version": "2.0" },
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 4, "byteLength": 48, "byteStride": 16 },
            { "buffer": 0, "byteOffset": 52, "byteLength": 6 },
            { "buffer": 0, "byteOffset": 58, "byteLength": 2 },
            { "buffer": 0, "byteOffset": 60, "byteLength": 12 },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 0, "byteOffset": 12, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC3" },
            { "bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR" },
            { "bufferView": 1, "componentType": 5122, "normalized": true, "count": 3, "type": "SCALAR" },
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
              "sparse": { "count": 1, "indices": { "bufferView": 2, "componentType": 5123 }, "values": { "bufferView": 3 } } },
            { "componentType": 5126, "count": 2, "type": "VEC3",
              "sparse": { "count": 1, "indices": { "bufferView": 2, "componentType": 5121 }, "values": { "bufferView": 3 } } },
        ],
    });
    (document, binary)
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    bytes
        .chunks(3)
        .map(|c| {
            let all = c.iter().fold(0u32, |sum, &b| sum << 8 | u32::from(b)) << (8 * (3 - c.len()));
            let letter = |k: usize| if k <= c.len() { char::from(LETTERS[(all >> (18 - 6 * k)) as usize & 63]) } else { '=' };
            (0..4).map(letter).collect::<String>()
        })
        .collect()
}

fn check_sample(gltf: &Gltf) {
    assert_eq!(gltf.floats::<3>(0).unwrap(), [[1.0, 2.0, 3.0], [11.0, 12.0, 13.0], [21.0, 22.0, 23.0]]);
    assert_eq!(gltf.floats::<3>(1).unwrap(), [[0.0, 128.0 / 255.0, 1.0]; 3]);
    assert_eq!(gltf.integers::<1>(2).unwrap(), [[0], [65535], [32768]]);
    // −32768 stands for −1 too.
    assert_eq!(gltf.floats::<1>(3).unwrap(), [[0.0], [-1.0 / 32767.0], [-1.0]]);
    assert_eq!(gltf.floats::<3>(4).unwrap(), [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0], [21.0, 22.0, 23.0]]);
    assert_eq!(gltf.floats::<3>(5).unwrap(), [[0.0; 3], [7.0, 8.0, 9.0]]);
}

#[test]
fn every_packing_gives_the_same_numbers() {
    let (mut document, binary) = sample();
    check_sample(&parse(&glb(&document, &binary), &nothing).unwrap());
    for media in ["application/octet-stream", "application/gltf-buffer"] {
        document["buffers"][0]["uri"] = json!(format!("data:{media};base64,{}", base64(&binary)));
        check_sample(&parse(format!("\u{feff}{document:#}").as_bytes(), &nothing).unwrap());
    }
    document["buffers"][0]["uri"] = json!("with%20blank.bin");
    let files = |name: &str| if name == "with blank.bin" { Ok(binary.clone()) } else { nothing(name) };
    check_sample(&parse(document.to_string().as_bytes(), &files).unwrap());
}

#[test]
fn lies_are_errors_and_name_their_place() {
    let (document, binary) = sample();
    let with = |pointer: &str, value: Value| {
        let mut changed = document.clone();
        *changed.pointer_mut(pointer).unwrap() = value;
        parse(&glb(&changed, &binary), &nothing).unwrap()
    };
    for (pointer, value, accessor) in [
        ("/accessors/0/count", json!(4), 0),
        ("/accessors/0/count", json!(1u64 << 31), 0),
        ("/accessors/0/count", json!(u64::MAX), 0),
        ("/accessors/1/byteOffset", json!(u64::MAX), 1),
        ("/accessors/0/bufferView", json!(9), 0),
        ("/accessors/0/componentType", json!(5124), 0),
        ("/accessors/0/type", json!("VEC2"), 0),
        ("/bufferViews/0/byteStride", json!(8), 0),
        ("/bufferViews/0/byteLength", json!(u64::MAX), 0),
        ("/bufferViews/0/byteOffset", json!(1u64 << 62), 0),
        ("/bufferViews/0/buffer", json!(1), 0),
        ("/accessors/4/sparse/count", json!(2), 4),
        ("/accessors/5/count", json!(1u64 << 31), 5),
        ("/accessors/5/count", json!(1), 5),
    ] {
        let error = with(pointer, value.clone()).floats::<3>(accessor).expect_err(&format!("{pointer} {value}"));
        assert!(error.place.is_some(), "{error}");
    }
    assert!(with("/accessors/2/componentType", json!(5122)).integers::<1>(2).is_err());
    let mut packed = document.clone();
    packed["bufferViews"][0]["buffer"] = json!(1);
    packed["bufferViews"][0]["extensions"]["EXT_meshopt_compression"] = json!({ "buffer": 0 });
    packed["buffers"] = json!([packed["buffers"][0], { "byteLength": 9 }]);
    let error = parse(&glb(&packed, &binary), &nothing).unwrap().floats::<3>(0).unwrap_err();
    assert!(error.kind == Kind::Unsupported && error.hint.unwrap().contains("gltf-transform"));
}

#[test]
fn broken_containers_are_errors() {
    let (document, binary) = sample();
    let whole = glb(&document, &binary);
    for cut in 0..whole.len() {
        assert!(parse(&whole[..cut], &nothing).is_err(), "{cut}");
    }
    let mut longer = whole.clone();
    longer.extend([1; 9]);
    check_sample(&parse(&longer, &nothing).unwrap());
    for (at, byte) in [(4, 1), (11, 1), (15, 1)] {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        assert!(parse(&bytes, &nothing).is_err(), "{at}");
    }
    let parse_text = |text: &str| parse(text.as_bytes(), &nothing).unwrap_err();
    assert_eq!(parse_text("{\"asset\":{\"version\":\"1.0\"},\"nodes\":{}}").kind, Kind::Unsupported);
    assert_eq!(
        parse_text("{\n\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":-1}]}").place.unwrap().split(',').next(),
        Some("line 2")
    );
    assert!(parse_text("{}").found.contains("asset"));
    let nested = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{}", "[".repeat(1 << 20));
    assert!(parse_text(&nested).found.contains("JSON"));
    let many = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{}{{}}]}}", "{},".repeat(1 << 20));
    assert!(parse_text(&many).found.contains("more than 1048576"));
}

fn nodes(list: Value, scenes: Value) -> Result<Hierarchy> {
    let document = json!({ "asset": { "version": "2.0" }, "nodes": list, "scenes": scenes });
    parse(document.to_string().as_bytes(), &nothing).unwrap().hierarchy()
}

#[test]
fn worlds_go_down_the_tree() {
    let half = 0.5f64.sqrt();
    let tree = nodes(
        json!([
            { "translation": [1, 0, 0] },
            { "children": [0, 3], "rotation": [0, 0, half * 2.0, half * 2.0], "scale": [2, 2, 2], "translation": [0, 0, 30000000.25] },
            { "children": [1] },
            { "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1] },
            {},
        ]),
        json!([{ "nodes": [2, 1] }]),
    )
    .unwrap();
    assert_eq!(tree.shown, [2, 1, 0, 3]);
    assert_eq!(tree.parents, [Some(1), Some(2), None, Some(1), None]);
    let at = |n: usize, p: DVec3| tree.worlds[n].transform_point3(p);
    assert!(at(0, DVec3::ZERO).abs_diff_eq(DVec3::new(0.0, 2.0, 30000000.25), 1e-8));
    // The matrix turns x to y, moves by (5, 6, 7); then a quarter turn about z, twice the size.
    assert!(at(3, DVec3::X).abs_diff_eq(DVec3::new(-14.0, 10.0, 30000014.25), 1e-8));
    let turn =
        Node { matrix: Some(Box::new([0., 2., 0., 0., -2., 0., 0., 0., 0., 0., 2., 0., 5., 6., 7., 1.])), ..Node::default() }
            .turn();
    assert!(turn.scale.abs_diff_eq(DVec3::splat(2.0), 1e-12) && (turn.rotation * DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
    assert_eq!(nodes(json!([{}, {}]), json!([])).unwrap().shown, [0, 1]);
}

#[test]
fn what_is_no_tree_is_an_error() {
    for list in [
        json!([{ "children": [0] }]),
        json!([{ "children": [1] }, { "children": [0] }, {}]),
        json!([{ "children": [2] }, { "children": [2] }, {}]),
        json!([{ "children": [1] }]),
        json!([{ "children": [1, 1] }, {}]),
    ] {
        assert!(nodes(list.clone(), json!([])).is_err(), "{list}");
    }
    assert!(nodes(json!([{}]), json!([{ "nodes": [1] }])).is_err());
}

#[test]
fn pictures_are_embedded_or_files() {
    let document = json!({
        "asset": { "version": "2.0" },
        "buffers": [{ "uri": "data:,0123" }],
        "bufferViews": [{ "buffer": 0, "byteOffset": 1, "byteLength": 2 }],
        "images": [{ "bufferView": 0, "mimeType": "image/png" }, { "uri": "data:image/png;base64,Zm8=" }, { "uri": "a%20b.png" }, {}],
    });
    let gltf = parse(document.to_string().as_bytes(), &nothing).unwrap();
    let of = |k: u32| gltf.picture(k).unwrap();
    assert!(matches!(of(0), Some(Picture::Embedded(b)) if b[..] == *b"12"));
    assert!(matches!(of(1), Some(Picture::Embedded(b)) if b[..] == *b"fo"));
    assert!(matches!(of(2), Some(Picture::File(f)) if f == "a b.png"));
    assert!(of(3).is_none() && gltf.picture(4).is_err());
}
