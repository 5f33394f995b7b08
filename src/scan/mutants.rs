//! Damaged files end in a scan or an error, soon and within bounded memory.

#![allow(clippy::unwrap_used)]

use super::archive::tests::zip;
use super::{fuzz, read};
use crate::gltf::tests::glb;
use crate::splitmix::Sequence;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// A grid of quads as OBJ with everything that the format offers.
pub(super) fn obj_sample() -> Vec<u8> {
    let mut text = String::from("# metres, Y up\nmtllib none.mtl\no thing\n");
    for k in 0..36 {
        let _ = writeln!(text, "v {} {} {:.3} 0.5 0.25 1\nvt {} 0.5\nvn 0 {} 1", k % 6, k / 6, f64::from(k).sin(), k % 6, k % 2);
    }
    for k in (0..30).filter(|k| k % 6 < 5) {
        let c = [k + 1, k + 2, k + 8, k + 7];
        let _ = match k % 3 {
            0 => writeln!(text, "g row {k}\nf {0}/{0}/{0} {1}/{1}/{1} \\\n {2}/{2}/{2} {3}/{3}/{3}", c[0], c[1], c[2], c[3]),
            1 => writeln!(text, "usemtl m {k}\nf {}//{} {} {} {}", c[0], c[0], c[1], c[2], c[3]),
            _ => writeln!(text, "f {} {} {}/{}", c[0] - 37, c[1] - 37, c[2] - 37, c[2] - 37),
        };
    }
    text.into_bytes()
}

fn ply_sample(binary: bool) -> Vec<u8> {
    let format = if binary { "binary_big_endian" } else { "ascii" };
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment metres\ncomment TextureFile x.png\nelement camera 2\nproperty float a\nproperty list uchar int k\n\
         element vertex 25\nproperty double x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face 16\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n\
         element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let mut put = |kinds: &str, values: &[f64]| {
        for (kind, value) in kinds.chars().zip(values) {
            match (binary, kind) {
                (false, _) => bytes.extend(format!("{value} ").bytes()),
                (_, 'd') => bytes.extend(value.to_be_bytes()),
                (_, 'f') => bytes.extend((*value as f32).to_be_bytes()),
                (_, 'i') => bytes.extend((*value as i32).to_be_bytes()),
                _ => bytes.push(*value as u8),
            }
        }
        if !binary {
            bytes.push(b'\n');
        }
    };
    for _ in 0..2 {
        put("fbii", &[0.5, 2.0, 7.0, 9.0]);
    }
    for k in 0..25 {
        put("dffbbb", &[f64::from(k % 5), f64::from(k / 5), 0.25, 10.0, 20.0, f64::from(k)]);
    }
    for k in 0..16 {
        let v = f64::from(k / 4 * 5 + k % 4);
        put("biiiibffffffff", &[4.0, v, v + 1.0, v + 6.0, v + 5.0, 8.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
    }
    put("iiiiiiii", &[7.0, 0.0, 1.0, 5.0, -1.0, 6.0, 7.0, 8.0]);
    bytes
}

fn stl_sample(binary: bool) -> Vec<u8> {
    let corner = |k: u32, c: u32| [f64::from(k % 4 + c % 2), f64::from(k / 4 + c / 2), 0.5];
    let mut bytes = if binary { [&[b' '; 80][..], &20u32.to_le_bytes()].concat() } else { b"solid a thing\n".to_vec() };
    for k in 0..20 {
        if binary {
            bytes.extend([0; 12]);
            (0..3).flat_map(|c| corner(k, c)).for_each(|x| bytes.extend((x as f32).to_le_bytes()));
            bytes.extend([0; 2]);
        } else {
            bytes.extend(b"facet normal 0 0 0\nouter loop\n");
            (0..3).map(|c| corner(k, c)).for_each(|[x, y, z]| bytes.extend(format!("vertex {x} {y} {z}\n").bytes()));
            bytes.extend(b"endloop\nendfacet\n");
        }
    }
    bytes
}

fn mtl_sample() -> Vec<u8> {
    b"# x\nnewmtl skin\nKd 0.5 0.25 0\nKs 1 1 1\nNs 96.5\nd 0.5\nTr 0.5\nKe 1 0 0\nPm 0.5\nPr 0.25\nmap_Kd -s 2 2 1 -o 0 0 0 a b.png\nbump -bm 1 n.png\n\
      newmtl cloth\nKd spectral x.rfl\nmap_d -imfchan r c.png\nnorm n.png\nTf xyz 1 1 1\n"
        .to_vec()
}

fn off_sample(binary: bool) -> Vec<u8> {
    if binary {
        let mut bytes = b"STCN4OFF BINARY\n".to_vec();
        let mut put = |values: &[u32]| values.iter().for_each(|v| bytes.extend(v.to_be_bytes()));
        put(&[16, 9, 0]);
        for k in 0..16u16 {
            let row = [f32::from(k % 4), f32::from(k / 4), 0.5, 1.0, 0.0, 0.0, 1.0, 0.5, 0.25, 1.0, 1.0, 0.5, 0.25];
            put(&row.map(f32::to_bits));
        }
        for k in [0, 1, 2, 4, 5, 6, 8, 9, 10] {
            put(&[4, k, k + 1, k + 5, k + 4, 0]);
        }
        return bytes;
    }
    let mut text = "# metres\nSTCN4OFF\n16 12 0 # counts\n".to_owned();
    for k in 0..16 {
        let _ = writeln!(text, "{} {} 0.5 1  0 0 1  0.5 0.25 1 1  0.5 0.25", k % 4, k / 4);
    }
    for k in [0, 1, 2, 4, 5, 6, 8, 9, 10] {
        let _ = writeln!(text, "4 {} {} {} {} {}", k, k + 1, k + 5, k + 4, if k % 2 == 0 { "" } else { "1 0 0" });
    }
    (text + "3 0 1 5\n3 0 1 6\n3 0 5 6\n").into_bytes()
}

/// A scene with two instances, one of them skinned, sparse and normalized accessors, strips, a texture and a material.
fn gltf_sample() -> (Value, Vec<u8>) {
    let mut binary = Vec::new();
    let mut views = Vec::new();
    let mut view = |bytes: &[u8]| {
        binary.resize(binary.len() + binary.len().next_multiple_of(4) - binary.len(), 0);
        views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() }));
        binary.extend(bytes);
    };
    let floats = |rows: &[f32]| rows.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let grid: Vec<f32> = (0..16u8).flat_map(|k| [f32::from(k % 4), f32::from(k / 4), 0.5]).collect();
    view(&floats(&grid));
    let quads = [0u16, 1, 2, 4, 5, 6, 8, 9, 10].iter().flat_map(|&k| [k, k + 1, k + 5, k, k + 5, k + 4]);
    view(&quads.flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
    view(&(0..16u8).flat_map(|k| [k % 2, 0, 1, 0]).collect::<Vec<u8>>());
    view(&[255, 0, 0, 0].repeat(16));
    view(&floats(&[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.].repeat(2)));
    view(&floats(&grid[..32]));
    view(&[0, 5, 7]);
    view(&floats(&grid[..9]));
    view(b"\x89PNG\r\n\x1a\nrest");
    let accessor = |view: usize, component: u32, shape: &str, count: usize| json!({ "bufferView": view, "componentType": component, "type": shape, "count": count });
    let mut accessors = vec![
        accessor(0, 5126, "VEC3", 16),
        accessor(1, 5123, "SCALAR", 54),
        accessor(2, 5121, "VEC4", 16),
        accessor(3, 5121, "VEC4", 16),
        accessor(4, 5126, "MAT4", 2),
        accessor(5, 5126, "VEC2", 16),
        accessor(0, 5126, "VEC3", 16),
    ];
    accessors[3]["normalized"] = json!(true);
    accessors[6]["sparse"] =
        json!({ "count": 3, "indices": { "bufferView": 6, "componentType": 5121 }, "values": { "bufferView": 7 } });
    let document = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0, 1] }],
        "nodes": [
            { "mesh": 0, "name": "body", "skin": 0 }, { "children": [2, 3], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1] },
            { "rotation": [0, 0, 0.5, 0.5], "translation": [1, 2, 3] }, { "mesh": 1, "scale": [1, -1, 1] },
        ],
        "skins": [{ "joints": [1, 2], "inverseBindMatrices": 4 }],
        "meshes": [
            { "primitives": [{ "attributes": { "POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3, "TEXCOORD_0": 5 }, "indices": 1, "material": 0 }] },
            { "primitives": [{ "attributes": { "POSITION": 6, "COLOR_0": 3 }, "mode": 5 }, { "attributes": { "POSITION": 6, "COLOR_0": 3 }, "mode": 6 }] },
        ],
        "materials": [{ "name": "m", "pbrMetallicRoughness": { "baseColorFactor": [1, 0.5, 0, 1], "baseColorTexture": { "index": 0 } } }],
        "textures": [{ "source": 0 }], "images": [{ "bufferView": 8, "mimeType": "image/png" }],
        "accessors": accessors, "bufferViews": views, "buffers": [{ "byteLength": binary.len() }],
    });
    (document, binary)
}

/// The same as one text.
fn gltf_text_sample() -> Vec<u8> {
    let (mut document, binary) = gltf_sample();
    let escaped: String = binary.iter().map(|b| format!("%{b:02x}")).collect();
    document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream,{escaped}"));
    // Numbers in front, where half of the damage goes.
    let text = document.to_string();
    let buffers = document["buffers"].to_string();
    let without = text.replacen(&format!("\"buffers\":{buffers},"), "", 1);
    format!("{},\"buffers\":{buffers}}}", without.strip_suffix('}').unwrap()).into_bytes()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zip_sample() -> Vec<u8> {
    zip(&[("a/a.obj", &obj_sample(), true), ("a/none.mtl", &mtl_sample(), true), ("a/a b.png", b"\x89PNG\r\n\x1a\n", false)])
}

fn damage(random: &mut Sequence, sample: &[u8]) -> Vec<u8> {
    let mut bytes = sample.to_vec();
    if random.below(4) == 0 {
        bytes.truncate(random.below(sample.len()));
    }
    if random.below(3) == 0 {
        lie(random, &mut bytes);
    }
    // Half of the damage goes to the first quarter, where the headers are.
    let reach = if random.below(2) == 0 { bytes.len() / 4 } else { bytes.len() };
    for _ in 0..random.below(5) * reach.min(1) {
        let at = random.below(reach);
        bytes[at] = match random.below(4) {
            0 => b"0123456789-+./ \n\\#"[random.below(18)],
            1 => 0xff,
            2 => bytes[at] ^ (1 << random.below(8)),
            _ => random.below(256) as u8,
        };
    }
    bytes
}

/// Another number in place of one that is written in digits, or another word of four bytes.
fn lie(random: &mut Sequence, bytes: &mut Vec<u8>) {
    const NUMBERS: [&[u8]; 10] =
        [b"0", b"1", b"-1", b"3", b"255", b"65535", b"2147483648", b"4294967295", b"18446744073709551615", b"1e308"];
    if bytes.is_empty() {
        return;
    }
    let from = random.below(bytes.len());
    let begin = bytes[from..].iter().position(u8::is_ascii_digit).map(|d| from + d);
    if let (Some(begin), 0..2) = (begin, random.below(3)) {
        let end = bytes[begin..].iter().position(|b| !b.is_ascii_digit()).map_or(bytes.len(), |d| begin + d);
        let number = NUMBERS[random.below(NUMBERS.len())];
        bytes.splice(begin..end, number.iter().copied());
    } else if bytes.len() >= 4 {
        let at = random.below(bytes.len() - 3);
        let word = [0u32, 1, 1 << 31, u32::MAX, 0x7f80_0000, 0x0000_0080][random.below(6)];
        bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
    }
}

/// A body with the samples that it is run over.
type Case = (&'static str, fn(&[u8]) -> bool, Vec<Vec<u8>>);

fn cases() -> Vec<Case> {
    let (document, binary) = gltf_sample();
    let packed = vec![gzip(&obj_sample()), gzip(&ply_sample(true)), gzip(&gltf_text_sample()), zip_sample()];
    vec![
        ("obj", fuzz::obj, vec![obj_sample()]),
        ("mtl", fuzz::materials, vec![mtl_sample()]),
        ("ply", fuzz::ply, vec![ply_sample(false), ply_sample(true)]),
        ("stl", fuzz::stl, vec![stl_sample(false), stl_sample(true), [stl_sample(true), stl_sample(true)].concat()]),
        ("off", fuzz::off, vec![off_sample(false), off_sample(true)]),
        ("gltf", fuzz::gltf, vec![glb(&document, &binary), gltf_text_sample()]),
        ("packed", fuzz::packed, packed),
    ]
}

#[test]
fn samples_are_read() {
    for (name, body, samples) in cases() {
        for (k, sample) in samples.iter().enumerate() {
            assert!(body(sample), "{name}, sample {k}");
        }
    }
}

#[test]
fn damaged_files_never_panic() {
    const MUTANTS: usize = 6000;
    let mut random = Sequence(7);
    for (name, body, samples) in cases() {
        for (k, sample) in samples.iter().enumerate() {
            let read = (0..MUTANTS / samples.len()).filter(|_| body(&damage(&mut random, sample))).count();
            let refused = MUTANTS / samples.len() - read;
            // Packed data and JSON seldom survive.
            assert!(read > 4 && refused > 4, "{name}, sample {k}: {read} read, {refused} refused");
        }
    }
}

#[test]
fn files_cut_at_any_byte_never_panic() {
    for (_, body, samples) in cases() {
        for sample in samples {
            // Some are still read: ascii facets, for one.
            let read = (0..sample.len()).filter(|&cut| body(&sample[..cut])).count();
            assert!(read < sample.len());
        }
    }
}

#[test]
fn seeds_of_the_fuzzer() {
    let Some(folder) = std::env::var_os("RETARGET_FUZZ_SEEDS") else { return };
    for (name, _, samples) in cases() {
        let folder = Path::new(&folder).join(format!("scan_{name}"));
        std::fs::create_dir_all(&folder).unwrap();
        for (k, sample) in samples.iter().enumerate() {
            std::fs::write(folder.join(format!("{k}")), sample).unwrap();
        }
    }
}

#[test]
fn counts_of_two_to_the_31_are_refused_at_once() {
    let vertex = "property float x\nproperty float y\nproperty float z\n";
    let ply = |format: &str, vertices: u64, faces: u64| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {vertices}\n{vertex}element face {faces}\nproperty list uint int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        )
    };
    for count in [1u64 << 31, u64::from(u32::MAX), u64::MAX] {
        for format in ["ascii", "binary_little_endian"] {
            assert!(!fuzz::ply(ply(format, count, 1).as_bytes()) && !fuzz::ply(ply(format, 3, count).as_bytes()));
        }
        assert!(
            !fuzz::off(format!("OFF\n{count} 1 0\n0 0 0\n").as_bytes())
                && !fuzz::off(format!("OFF\n1 {count} 0\n0 0 0\n").as_bytes())
        );
    }
    // A list of 2^31 corners, and one of a binary OFF face.
    let mut list = ply("binary_little_endian", 0, 1).into_bytes();
    list.truncate(list.len() - 28);
    list.extend((1u32 << 31).to_le_bytes());
    assert!(!fuzz::ply(&list));
    let mut off = b"OFF BINARY\n".to_vec();
    [0u32, 1, 0, 1 << 31].iter().for_each(|v| off.extend(v.to_be_bytes()));
    off.extend([0; 8]);
    assert!(!fuzz::off(&off));
    assert!(!fuzz::obj(b"v 0 0 0\nf 1 2147483648 4294967296\nf -2147483648 1 1\n"));
}

#[test]
fn nesting_ends_soon() {
    let deep = |open: &str| format!("{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{}", open.repeat(200_000));
    assert!(!fuzz::gltf(deep("[").as_bytes()) && !fuzz::gltf(deep("{\"a\":").as_bytes()));
    // Archives in archives, and gzip in gzip, are not gone into.
    let mut nested = obj_sample();
    assert!(fuzz::packed(&gzip(&nested)));
    for _ in 0..3 {
        nested = zip(&[("a.zip", &nested, true)]);
    }
    assert!(!fuzz::packed(&nested));
    assert!(!fuzz::packed(&zip(&[("a.obj", &zip(&[("a.obj", &obj_sample(), true)]), true)])));
    assert!(!fuzz::packed(&gzip(&gzip(&obj_sample()))));
    // A chain of nodes as deep as there are nodes.
    let count = 50_000;
    let nodes: Vec<Value> =
        (1..=count).map(|k| if k < count { json!({ "children": [k] }) } else { json!({ "mesh": 0 }) }).collect();
    let (mut document, binary) = gltf_sample();
    document["nodes"] = Value::Array(nodes);
    document["skins"] = json!([]);
    document["scenes"] = json!([{ "nodes": (0..count).collect::<Vec<_>>() }]);
    assert!(fuzz::gltf(&glb(&document, &binary)));
}

#[test]
fn far_from_the_origin_nothing_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let (far, step) = (3e7, 2f64.powi(-20));
    let text = |x: f64| format!("{:?}", far + x * step);
    let rows = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[x, y]| format!("{} {} {far:?}", text(f64::from(x)), text(f64::from(y))));
    let facet = |k: [usize; 3]| {
        format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", k.map(|i| format!("vertex {}\n", rows[i])).concat())
    };
    let vertex: String = ["x", "y", "z"].map(|p| format!("property double {p}\n")).concat();
    let (mut document, binary) = gltf_sample();
    document["nodes"] = json!([{ "mesh": 1, "translation": [far, far + step, far], "scale": [step, step, step] }]);
    document["scenes"] = json!([{ "nodes": [0] }]);
    let files: [(&str, Vec<u8>); 5] = [
        ("a.obj", format!("v {}\nf 1 2 3 4\n", rows.join("\nv ")).into_bytes()),
        ("a.off", format!("OFF\n4 1 0\n{}\n4 0 1 2 3\n", rows.join("\n")).into_bytes()),
        ("a.stl", format!("solid\n{}{}", facet([0, 1, 2]), facet([0, 2, 3])).into_bytes()),
        (
            "a.ply",
            format!("ply\nformat ascii 1.0\nelement vertex 4\n{vertex}element face 1\nproperty list uchar int vertex_indices\nend_header\n{}\n4 0 1 2 3\n", rows.join("\n"))
                .into_bytes(),
        ),
        ("a.glb", glb(&document, &binary)),
    ];
    for (name, bytes) in files {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let positions = read(&path).unwrap().mesh.positions;
        let first = if name == "a.glb" { far + step } else { far };
        assert_eq!((positions[0].x, positions[0].y), (far, first), "{name}");
        assert_eq!(positions[1].x, far + step, "{name}");
    }
}

#[test]
fn packed_files_read_like_plain_ones() {
    let dir = tempfile::tempdir().unwrap();
    let (document, binary) = gltf_sample();
    for (name, sample) in [
        ("a.obj", obj_sample()),
        ("b.ply", ply_sample(true)),
        ("c.stl", stl_sample(true)),
        ("d.off", off_sample(false)),
        ("e.glb", glb(&document, &binary)),
        ("f.gltf", gltf_text_sample()),
    ] {
        let plain = dir.path().join(name);
        std::fs::write(&plain, &sample).unwrap();
        std::fs::write(dir.path().join(format!("{name}.gz")), gzip(&sample)).unwrap();
        std::fs::write(
            dir.path().join(format!("{name}.zip")),
            zip(&[("sub/", b"", false), (&format!("sub/{name}"), &sample, true), ("__MACOSX/sub/._a.obj", b"x", false)]),
        )
        .unwrap();
        let expected = read(&plain).unwrap();
        for ending in ["gz", "zip"] {
            let packed = read(&dir.path().join(format!("{name}.{ending}"))).unwrap();
            assert_eq!(expected.mesh.positions, packed.mesh.positions);
            assert_eq!(expected.mesh.faces, packed.mesh.faces);
            assert_eq!(expected.look.face_groups, packed.look.face_groups);
        }
    }
}

#[test]
fn an_archive_gives_a_mesh_its_materials_and_textures() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("body.zip");
    let obj = b"mtllib mat/Looks.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl skin\nf 1/1 2/1 3/1\n";
    let mtl = b"newmtl skin\nKd 0 0 0\nmap_Kd ..\\mat\\Face.PNG\nmap_bump gone.png\n";
    std::fs::write(
        &path,
        zip(&[("m/body.obj", obj, true), ("m/mat/looks.mtl", mtl, true), ("m/mat/face.png", b"\x89PNG\r\n\x1a\n", true)]),
    )
    .unwrap();
    let scan = read(&path).unwrap();
    assert_eq!(scan.source, path);
    let texture = scan.look.materials[0].base_color_texture.clone().unwrap();
    assert_eq!((texture.name().as_str(), texture.read().unwrap().as_slice()), ("m/mat/face.png", &b"\x89PNG\r\n\x1a\n"[..]));
    assert_eq!(scan.notes.iter().collect::<Vec<_>>(), ["textures are missing: 'gone.png'"]);
    assert!(scan.look.material_libraries.is_empty());

    let (mut document, binary) = gltf_sample();
    document["buffers"][0]["uri"] = json!("data/part%201.bin");
    document["images"] = json!([{ "uri": "face.png" }]);
    let text = document.to_string();
    std::fs::write(
        &path,
        zip(&[
            ("g/body.gltf", text.as_bytes(), true),
            ("g/data/part 1.bin", &binary, true),
            ("g/face.png", b"\x89PNG\r\n\x1a\n", false),
        ]),
    )
    .unwrap();
    assert_eq!(read(&path).unwrap().look.materials[0].base_color_texture.as_ref().unwrap().name(), "g/face.png");

    std::fs::write(&path, zip(&[("a.obj", obj, true), ("b.stl", obj, true)])).unwrap();
    let error = read(&path).unwrap_err();
    assert!(error.kind == crate::error::Kind::Ambiguous && error.found.contains("'b.stl'"));
    std::fs::write(&path, zip(&[("a.txt", obj, true)])).unwrap();
    assert!(read(&path).unwrap_err().found.contains("'a.txt'"));
    std::fs::write(&path, zip(&[("sub/a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 3\n", true)])).unwrap();
    assert_eq!(read(&path).unwrap_err().file.as_deref(), Some(&*path.join("sub/a.obj")));
}
