//! The exact caches: MDD, USD and Alembic against the PC2 of the same run, and against scans with everything that scans have.

#![allow(clippy::unwrap_used)]

mod common;

use common::cache_readers::{Abc, AbcObject, Usda, Usdc, read_mdd, triples};
use common::{fixture, read_pc2, retarget, retarget_ok};
use glam::{DQuat, DVec3, Vec3};
use retarget::error::Kind;
use retarget::export::{Cancel, FrameBatch, FrameSink, Header, Written, alembic::Alembic, point_cache::PointCache, usd::Usd};
use retarget::proxy::{Proxy, rows::MapKind};
use retarget::scan::{Image, NONE, Scan, UnitBox};
use retarget::surface::{NormalVertices, SurfaceMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

const NAMES: [&str; 6] = ["a.pc2", "a.mdd", "a.usda", "a.abc", "a.usdc", "a.usdz"];

/// First frame and number of frames of the run on the fixture.
const FIRST: i64 = 5;
const FRAMES: usize = 12;

fn run(threads: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let [scan, take] = [fixture("scan.obj"), fixture("walk.c3d")].map(|p| p.to_string_lossy().into_owned());
    let mut arguments = vec![scan, take, "--frames".into(), "5..16".into(), "--threads".into(), threads.into()];
    NAMES.iter().for_each(|name| arguments.extend(["-o".to_owned(), (*name).to_owned()]));
    retarget_ok(folder.path(), arguments);
    folder
}

static ONE_RUN: LazyLock<tempfile::TempDir> = LazyLock::new(|| run("2"));

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(ONE_RUN.path().join(name)).unwrap()
}

/// Vertices of the PC2 by frame, which are `FIRST` and on.
fn truth() -> Vec<Vec<[f32; 3]>> {
    let frames = read_pc2(&ONE_RUN.path().join("a.pc2"));
    assert_eq!(frames.len(), FRAMES);
    frames
}

fn same_bits(a: &[[f32; 3]], b: &[[f32; 3]]) -> bool {
    a.len() == b.len() && a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// The mesh object of an archive.
fn mesh(abc: &Abc) -> AbcObject {
    let mut top = abc.top();
    let mut transform = top.children.remove("scan").unwrap();
    assert!(transform.metadata.starts_with("schema=AbcGeom_Xform_v3;") && top.children.is_empty());
    assert_eq!(transform.properties[".xform"].properties[".inherits"].sample(0), [1]);
    let mesh = transform.children.remove("mesh").unwrap();
    assert_eq!(
        mesh.metadata,
        "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1;schemaObjTitle=AbcGeom_PolyMesh_v1:.geom"
    );
    mesh
}

/// Values of corners with every face the other way round, as Alembic has them.
fn reversed(scan: &Scan, values: &[u32]) -> Vec<u32> {
    let faces = &scan.mesh.faces;
    (0..faces.len()).flat_map(|f| values[faces.range(f)].iter().rev().copied().collect::<Vec<_>>()).collect()
}

#[test]
fn mdd_holds_the_pc2_bit_for_bit_with_the_time_of_every_frame() {
    let (times, frames) = read_mdd(&bytes("a.mdd"));
    let expected: Vec<f32> = (FIRST..FIRST + FRAMES as i64).map(|frame| (frame as f64 / 120.0) as f32).collect();
    assert_eq!(times, expected);
    assert!(frames.len() == FRAMES && frames.iter().zip(truth()).all(|(a, b)| same_bits(a, &b)));
}

#[test]
fn usd_holds_the_pc2_bit_for_bit_with_the_scan_once() {
    let text = String::from_utf8(bytes("a.usda")).unwrap();
    let usd = Usda(&text);
    let scan = retarget::scan::read(&fixture("scan.obj")).unwrap();
    for (name, value) in [
        ("startTimeCode", "5"),
        ("endTimeCode", "16"),
        ("timeCodesPerSecond", "120"),
        ("framesPerSecond", "120"),
        ("metersPerUnit", "1"),
        ("upAxis", "\"Y\""),
        ("defaultPrim", "\"scan\""),
        ("uniform token subdivisionScheme", "\"none\""),
    ] {
        assert_eq!(usd.value(name), value, "{name}");
    }
    let samples = usd.samples("point3f[] points");
    let codes: Vec<i64> = samples.iter().map(|s| s.0).collect();
    assert_eq!(codes, (FIRST..FIRST + FRAMES as i64).collect::<Vec<_>>());
    let truth = truth();
    for ((code, values), expected) in samples.iter().zip(&truth) {
        assert!(same_bits(&triples(values), expected), "frame {code}");
    }
    let integers = |name: &str| usd.numbers(name).into_iter().map(|x| x as u32).collect::<Vec<_>>();
    assert_eq!(integers("int[] faceVertexIndices"), scan.mesh.faces.corners);
    let counts: Vec<u32> = scan.mesh.faces.iter().map(|f| f.len() as u32).collect();
    assert_eq!(integers("int[] faceVertexCounts"), counts);
    let flat: Vec<f32> = usd.numbers("texCoord2f[] primvars:st").into_iter().map(|x| x as f32).collect();
    let uvs = flat.strip_suffix(&[0.0, 0.0]).filter(|_| scan.look.corner_uvs.contains(&NONE)).unwrap_or(&flat);
    assert_eq!(uvs, scan.look.uvs.as_flattened());
    assert_eq!(integers("int[] primvars:st:indices").len(), scan.look.corner_uvs.len());
    let normals = usd.samples("normal3f[] normals");
    assert_eq!(normals.len(), FRAMES);
    for (_, values) in &normals {
        let all = triples(values);
        assert!(all.len() == scan.mesh.positions.len());
        assert!(all.iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-5));
    }
    for ((_, extent), points) in usd.samples("float3[] extent").iter().zip(&truth) {
        let low = points.iter().fold(Vec3::INFINITY, |m, &p| m.min(p.into()));
        let high = points.iter().fold(Vec3::NEG_INFINITY, |m, &p| m.max(p.into()));
        assert_eq!(extent[..], [low.to_array(), high.to_array()].concat());
    }
    for (m, material) in scan.look.materials.iter().enumerate() {
        let identifier = material.name.replace(' ', "_");
        let subset = usd.prim("GeomSubset", &identifier);
        let faces: Vec<f64> =
            (0..scan.look.face_materials.len()).filter(|&f| scan.look.face_materials[f] == m as u32).map(|f| f as f64).collect();
        assert_eq!(subset.numbers("int[] indices"), faces, "{identifier}");
        assert_eq!(subset.value("uniform token familyName"), "\"materialBind\"");
        assert_eq!(subset.value("rel material:binding"), format!("</scan/materials/{identifier}>"));
        let surface = usd.prim("Material", &identifier);
        assert_eq!(surface.value("custom string userProperties:name"), format!("\"{}\"", material.name));
    }
    // The texture is found from where the file is.
    let named = usd.prim("Material", "skin").value("asset inputs:file").trim_matches('@').to_owned();
    let found = ONE_RUN.path().join(named).canonicalize().unwrap();
    assert_eq!(found, fixture("scan_skin.png").canonicalize().unwrap());
    assert_eq!(usd.prim("GeomSubset", "body_head").value("uniform token familyName"), "\"group\"");
}

#[test]
fn a_usd_crate_holds_the_pc2_bit_for_bit_and_what_the_text_says() {
    let usd = Usdc::read(bytes("a.usdc"));
    let text = String::from_utf8(bytes("a.usda")).unwrap();
    let scan = retarget::scan::read(&fixture("scan.obj")).unwrap();
    for (name, value) in [
        ("startTimeCode", 5.0),
        ("endTimeCode", 16.0),
        ("timeCodesPerSecond", 120.0),
        ("framesPerSecond", 120.0),
        ("metersPerUnit", 1.0),
    ] {
        assert_eq!(usd.double("/", name), value, "{name}");
    }
    assert_eq!((usd.text("/", "upAxis"), usd.text("/", "defaultPrim")), ("Y", "scan"));
    assert_eq!((usd.text("/scan", "typeName"), usd.text("/scan/mesh", "typeName")), ("Xform", "Mesh"));
    let samples = usd.samples("/scan/mesh.points");
    assert_eq!(samples.len(), FRAMES);
    for (k, ((code, points), expected)) in samples.iter().zip(truth()).enumerate() {
        assert!(*code == (FIRST + k as i64) as f64 && same_bits(points, &expected), "frame {code}");
    }
    for (path, name) in [("normals", "normal3f[] normals"), ("extent", "float3[] extent")] {
        let of_text = Usda(&text).samples(name);
        let samples = usd.samples(&format!("/scan/mesh.{path}"));
        assert_eq!(samples.len(), FRAMES);
        assert!(samples.iter().zip(&of_text).all(|(a, b)| a.0 == b.0 as f64 && same_bits(&a.1, &triples(&b.1))), "{path}");
    }
    assert_eq!(usd.integers("/scan/mesh.faceVertexIndices"), scan.mesh.faces.corners);
    let counts: Vec<u32> = scan.mesh.faces.iter().map(|f| f.len() as u32).collect();
    assert_eq!(usd.integers("/scan/mesh.faceVertexCounts"), counts);
    assert_eq!(usd.text("/scan/mesh.normals", "interpolation"), "vertex");
    for (m, material) in scan.look.materials.iter().enumerate() {
        let identifier = material.name.replace(' ', "_");
        let subset = format!("/scan/mesh/{identifier}");
        let faces: Vec<u32> =
            (0..scan.look.face_materials.len() as u32).filter(|&f| scan.look.face_materials[f as usize] == m as u32).collect();
        assert_eq!(usd.integers(&format!("{subset}.indices")), faces);
        assert_eq!(usd.target(&format!("{subset}.material:binding"), "targetPaths"), format!("/scan/materials/{identifier}"));
        assert_eq!(usd.text(&format!("{subset}.userProperties:name"), "default"), material.name);
    }
    let skin = |rest: &str| format!("/scan/materials/skin/{rest}");
    assert_eq!(usd.target(&skin("surface.inputs:diffuseColor"), "connectionPaths"), skin("base_color.outputs:rgb"));
    let named = usd.text(&skin("base_color.inputs:file"), "default");
    assert_eq!(ONE_RUN.path().join(named).canonicalize().unwrap(), fixture("scan_skin.png").canonicalize().unwrap());
    assert_eq!(usd.text("/scan/mesh/body_head.familyName", "default"), "group");
}

#[test]
fn alembic_holds_the_pc2_bit_for_bit_with_the_scan_once() {
    let abc = Abc::read(bytes("a.abc"));
    let scan = retarget::scan::read(&fixture("scan.obj")).unwrap();
    assert!(abc.description.contains("FramesPerTimeUnit=120.000000"), "{}", abc.description);
    assert!(abc.description.ends_with("walk, unit m, up +Y"), "{}", abc.description);
    assert_eq!(abc.times[0], (1.0, 0.0));
    assert_eq!(abc.times[1], (1.0 / 120.0, 5.0 / 120.0));
    let mesh = mesh(&abc);
    let geometry = &mesh.properties[".geom"].properties;
    for (name, pod, extent, constant) in [
        ("P", 10, 3, false),
        ("N", 10, 3, false),
        (".selfBnds", 11, 6, false),
        (".faceIndices", 6, 1, true),
        (".faceCounts", 6, 1, true),
    ] {
        let p = &geometry[name];
        assert_eq!((p.pod, p.extent, p.constant), (pod, extent, constant), "{name}");
        assert_eq!((p.samples, p.times), (FRAMES as u32, 1), "{name}");
    }
    for (frame, expected) in truth().iter().enumerate() {
        let points = triples(&geometry["P"].floats(frame));
        assert!(same_bits(&points, expected), "frame {frame}");
        let low = points.iter().fold(Vec3::INFINITY, |m, &p| m.min(p.into()));
        let high = points.iter().fold(Vec3::NEG_INFINITY, |m, &p| m.max(p.into()));
        assert_eq!(geometry[".selfBnds"].doubles(frame), [low.as_dvec3().to_array(), high.as_dvec3().to_array()].concat());
        let normals = triples(&geometry["N"].floats(frame));
        assert!(normals.len() == points.len() && normals.iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-5));
    }
    assert!(geometry["P"].metadata.contains("interpretation=point") && geometry["N"].metadata.contains("geoScope=vtx"));
    assert_eq!(geometry[".faceIndices"].integers(FRAMES - 1), reversed(&scan, &scan.mesh.faces.corners));
    let counts: Vec<u32> = scan.mesh.faces.iter().map(|f| f.len() as u32).collect();
    assert_eq!(geometry[".faceCounts"].integers(0), counts);
    let uv = &geometry["uv"].properties;
    let (values, indices) = (uv[".vals"].floats(0), uv[".indices"].integers(0));
    let at = reversed(&scan, &scan.look.corner_uvs);
    assert_eq!(indices.len(), at.len());
    for (&index, &expected) in indices.iter().zip(&at) {
        let uv = if expected == NONE { [0.0; 2] } else { scan.look.uvs[expected as usize] };
        assert_eq!(values[2 * index as usize..][..2], uv);
    }
    assert_eq!(mesh.children.len(), scan.look.materials.len());
    for (m, material) in scan.look.materials.iter().enumerate() {
        let set = &mesh.children[&material.name];
        assert!(set.metadata.starts_with("schema=AbcGeom_FaceSet_v1;"));
        let faces = set.properties[".faceset"].properties[".faces"].integers(0);
        assert!(faces.iter().all(|&f| scan.look.face_materials[f as usize] == m as u32));
        assert_eq!(faces.len(), scan.look.face_materials.iter().filter(|&&x| x == m as u32).count());
    }
}

#[test]
fn caches_are_the_same_bytes_for_any_number_of_threads() {
    let other = run("1");
    for name in NAMES {
        // What a USD file says of textures is a path from where it is, and both are equally deep.
        assert!(bytes(name) == std::fs::read(other.path().join(name)).unwrap(), "{name} depends on the number of threads");
    }
}

#[test]
fn caches_hold_a_whole_take_in_one_file_and_replace_nothing_unasked() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["mdd", "usda", "usdc", "usdz", "abc"] {
        let name = format!("a.{ending}");
        let run = |name: &str| {
            retarget(folder.path(), [fixture("scan.obj").to_str().unwrap(), fixture("walk.c3d").to_str().unwrap(), "-o", name])
        };
        let output = run(&format!("a_##.{ending}"));
        assert_eq!(output.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&output.stderr).contains("without #"));
        std::fs::write(folder.path().join(&name), "precious").unwrap();
        assert_eq!(run(&name).status.code(), Some(1));
        assert_eq!(std::fs::read(folder.path().join(&name)).unwrap(), b"precious");
    }
}

/// A prism on five sides with a hard edge around its top, in mm with Z up: polygons, corners without uv, faces without material, names that are no
/// identifiers, a vertex without face.
const ODD: &str = "# mm, Z up\nmtllib odd.mtl\no thing\ng left side\n\
    v 10 0 0\nv 3.1 9.5 0\nv -8.1 5.9 0\nv -8.1 -5.9 0\nv 3.1 -9.5 0\nv 10 0 30\nv 3.1 9.5 30\nv -8.1 5.9 30\nv -8.1 -5.9 30\nv 3.1 -9.5 30\nv 99 9 9\n\
    vt 0 0\nvt 1 0\nvt 1 0.1\nvt 0.3333 1\nvn 0 0 1\nvn 1 0 0\n\
    usemtl skin tone\nf 6/1/1 7/2/1 8/3/1 9/4/1 10/1/1\nusemtl skin-tone\nf 5//2 4//2 3//2 2//2 1//2\n\
    g 2nd/side\nf 1//2 2//2 7//2 6//2\nf 2//2 3//2 8//2 7//2\nusemtl\nf 3//2 4//2 9//2 8//2\nf 4//2 5//2 10//2 9//2\nf 5//2 1//2 6//2\nf 5//2 6//2 10//2\n";

fn odd(folder: &Path) -> Scan {
    std::fs::write(folder.join("odd.obj"), ODD).unwrap();
    std::fs::write(
        folder.join("odd.mtl"),
        "newmtl skin tone\nKd 0.5 0.25 0\nmap_Kd a b.png\nnewmtl skin-tone\nKd 0 0 1\nd 0.5\n",
    )
    .unwrap();
    std::fs::write(folder.join("a b.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    let mut scan = retarget::scan::read(&folder.join("odd.obj")).unwrap();
    scan.look.colors = (0..11).map(|k| [k as f32 / 20.0, 0.5, 1.0, 1.0 - k as f32 / 40.0]).collect();
    scan.look.colors_have_alpha = true;
    scan
}

/// A header for a scan whose motion is made up: its proxy is a single tetrahedron.
fn header(scan: Scan, frames: usize, cancel: &Cancel) -> Arc<Header> {
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let proxy = Proxy {
        rest: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        tets: vec![[0, 1, 2, 3]],
        components: vec![0],
        boundary: vec![[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]],
        boundary_tets: vec![0; 4],
    };
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let map = SurfaceMap::build(&proxy, &points, MapKind::Ring).unwrap();
    let (up, metres) = (Some(DVec3::Z), Some(0.001));
    Arc::new(Header {
        scan: Arc::new(scan),
        unit_box,
        proxy: Arc::new(proxy),
        map: Arc::new(map),
        take: "a;b=c".into(),
        rate: 59.94,
        first_frame: -1,
        frames,
        places: Vec::new(),
        up,
        metres,
        cancel: cancel.clone(),
    })
}

type Frames = Vec<Vec<[f32; 3]>>;

/// Points and normals of made-up frames.
fn motion(header: &Header) -> (Frames, Frames) {
    let pose = |frame: usize| {
        let turn = DQuat::from_rotation_z(0.1 * frame as f64);
        let posed = |&p: &DVec3| (turn * header.unit_box.enter(p)).as_vec3().to_array();
        header.scan.mesh.positions.iter().map(posed).collect::<Vec<_>>()
    };
    let points: Vec<Vec<[f32; 3]>> = (0..header.frames).map(pose).collect();
    let mut normals = vec![Vec::new(); header.frames];
    let all = NormalVertices::of(&header.scan);
    points.iter().zip(&mut normals).for_each(|(points, normals)| all.compute(&header.scan, points, normals));
    (points, normals)
}

fn sinks(folder: &Path) -> Vec<(PathBuf, Box<dyn FrameSink>)> {
    let path = |name: &str| folder.join(name);
    vec![
        (path("a.pc2"), Box::new(PointCache::pc2(&path("a.pc2")))),
        (path("a.mdd"), Box::new(PointCache::mdd(&path("a.mdd")))),
        (path("a.usda"), Box::new(Usd::new(&path("a.usda")))),
        (path("a.abc"), Box::new(Alembic::new(&path("a.abc")))),
        (path("a.usdc"), Box::new(Usd::new(&path("a.usdc")))),
        (path("a.usdz"), Box::new(Usd::new(&path("a.usdz")))),
    ]
}

fn write(folder: &Path, header: &Arc<Header>) -> Vec<Written> {
    let (points, normals) = motion(header);
    let mut written = Vec::new();
    for (path, mut sink) in sinks(folder) {
        sink.begin(header).unwrap();
        for (k, (points, normals)) in points.chunks(2).zip(normals.chunks(2)).enumerate() {
            sink.frames(&FrameBatch { first: 2 * k, proxy: &[], points, normals }).unwrap();
        }
        assert!(!path.exists(), "nothing is there before it is whole");
        written.push(sink.finish().unwrap());
        assert_eq!(written.last().unwrap().bytes, path.metadata().unwrap().len());
    }
    written
}

#[test]
fn an_odd_scan_keeps_everything_in_every_cache() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(odd(folder.path()), 3, &Cancel::default());
    let scan = &*header.scan;
    let written = write(folder.path(), &header);
    let notes: Vec<&str> = written.iter().flat_map(|w| w.notes.iter()).collect();
    assert!(notes.is_empty(), "{notes:?}");
    let truth = read_pc2(&folder.path().join("a.pc2"));
    let (_, normals) = motion(&header);
    let split = NormalVertices::of(scan);
    assert_eq!(split.vertices.len(), 11 + 5, "the top has normals of its own");

    let text = std::fs::read_to_string(folder.path().join("a.usda")).unwrap();
    let usd = Usda(&text);
    assert_eq!((usd.value("startTimeCode"), usd.value("endTimeCode"), usd.value("timeCodesPerSecond")), ("-1", "1", "59.94"));
    assert_eq!((usd.value("upAxis"), usd.value("metersPerUnit")), ("\"Z\"", "0.001"));
    for (k, (code, values)) in usd.samples("point3f[] points").iter().enumerate() {
        assert!(*code == k as i64 - 1 && same_bits(&triples(values), &truth[k]));
    }
    for ((_, values), normals) in usd.samples("normal3f[] primvars:normals").iter().zip(&normals) {
        assert!(same_bits(&triples(values), normals));
    }
    let integers = |name: &str| usd.numbers(name).into_iter().map(|x| x as u32).collect::<Vec<_>>();
    assert_eq!(integers("int[] primvars:normals:indices"), split.corners);
    assert_eq!(integers("int[] primvars:st:indices")[..6], [0, 1, 2, 3, 0, 4]);
    assert_eq!(usd.numbers("texCoord2f[] primvars:st")[8..], [0.0, 0.0]);
    let colors = usd.numbers("color3f[] primvars:displayColor");
    assert!(colors.len() == 33 && (colors[1] - 0.21404).abs() < 1e-5, "linear light: {}", colors[1]);
    let opacity: Vec<f32> = usd.numbers("float[] primvars:displayOpacity").into_iter().map(|x| x as f32).collect();
    assert_eq!(opacity, scan.look.colors.iter().map(|c| c[3]).collect::<Vec<_>>());
    for (name, faces) in [("skin_tone", vec![0.0]), ("skin_tone_2", vec![1.0, 2.0, 3.0]), ("thing_left_side", vec![0.0, 1.0])] {
        assert_eq!(usd.prim("GeomSubset", name).numbers("int[] indices"), faces, "{name}");
    }
    assert_eq!(usd.prim("Material", "skin_tone_2").value("float inputs:opacity"), "0.5");
    assert_eq!(usd.value("asset inputs:file"), "@./a b.png@");
    assert!(!usd.has("uniform bool doubleSided"), "it is closed");

    let usd = Usdc::read(std::fs::read(folder.path().join("a.usdc")).unwrap());
    assert_eq!((usd.double("/", "metersPerUnit"), usd.double("/", "startTimeCode"), usd.text("/", "upAxis")), (0.001, -1.0, "Z"));
    for (k, (code, points)) in usd.samples("/scan/mesh.points").iter().enumerate() {
        assert!(*code == k as f64 - 1.0 && same_bits(points, &truth[k]));
    }
    assert_eq!(usd.integers("/scan/mesh.primvars:normals:indices"), split.corners);
    assert_eq!(usd.integers("/scan/mesh/skin_tone_2.indices"), [1, 2, 3]);

    let abc = Abc::read(std::fs::read(folder.path().join("a.abc")).unwrap());
    assert!(abc.description.ends_with("a_b_c, unit mm, up +Z"), "{}", abc.description);
    assert_eq!(abc.times[1], (1.0 / 59.94, -1.0 / 59.94));
    let mesh = mesh(&abc);
    let geometry = &mesh.properties[".geom"].properties;
    for frame in 0..3 {
        assert!(same_bits(&triples(&geometry["P"].floats(frame)), &truth[frame]));
        assert!(same_bits(&triples(&geometry["N"].properties[".vals"].floats(frame)), &normals[frame]));
    }
    assert_eq!(geometry["N"].properties[".indices"].integers(2), reversed(scan, &split.corners));
    let colors = &geometry[".arbGeomParams"].properties["Cd"];
    assert_eq!((colors.extent, colors.floats(0)), (4, scan.look.colors.as_flattened().to_vec()));
    let faces = |name: &str| mesh.children[name].properties[".faceset"].properties[".faces"].integers(0);
    assert_eq!((faces("skin tone"), faces("skin-tone")), (vec![0], vec![1, 2, 3]));
}

#[test]
fn a_single_frame_of_a_plain_scan_says_what_it_does_not_know() {
    let folder = tempfile::tempdir().unwrap();
    let mut scan = odd(folder.path());
    scan.look = retarget::scan::Appearance { groups: scan.look.groups, face_groups: scan.look.face_groups, ..Default::default() };
    let mut header = Arc::unwrap_or_clone(header(scan, 1, &Cancel::default()));
    (header.up, header.metres) = (Some(-DVec3::Y), None);
    let written = write(folder.path(), &Arc::new(header));
    let notes: Vec<&str> = written[2].notes.iter().collect();
    assert!(notes.len() == 2 && notes[0].contains("unit") && notes[1].contains("\u{2212}Y"), "{notes:?}");
    let truth = read_pc2(&folder.path().join("a.pc2"));
    let text = std::fs::read_to_string(folder.path().join("a.usda")).unwrap();
    let usd = Usda(&text);
    assert!(!usd.has("upAxis") && !usd.has("metersPerUnit") && !text.contains("Material") && !text.contains("primvars"));
    assert!(same_bits(&triples(&usd.samples("point3f[] points")[0].1), &truth[0]));
    let abc = Abc::read(std::fs::read(folder.path().join("a.abc")).unwrap());
    assert!(abc.description.ends_with("unit not known, up -Y"), "{}", abc.description);
    let mesh = mesh(&abc);
    let geometry = &mesh.properties[".geom"].properties;
    assert!(geometry["P"].constant && same_bits(&triples(&geometry["P"].floats(0)), &truth[0]));
    // Groups stand for the materials that are not there.
    assert_eq!(mesh.children.keys().collect::<Vec<_>>(), ["thing 2nd_side", "thing left side"]);
}

#[test]
fn far_from_the_origin_every_cache_states_its_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut scan = odd(folder.path());
    scan.mesh.positions.iter_mut().for_each(|p| *p += DVec3::X * 1e9);
    for written in write(folder.path(), &header(scan, 2, &Cancel::default())) {
        assert!(written.max_error > 1.0 && written.worst_frame.is_some() && !written.notes.is_empty(), "{written:?}");
    }
}

#[test]
fn what_is_interrupted_leaves_nothing_and_replaces_nothing() {
    let (folder, inputs) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let cancel = Cancel::default();
    let header = header(odd(inputs.path()), 4, &cancel);
    let (points, normals) = motion(&header);
    let batch = |range: std::ops::Range<usize>| FrameBatch {
        first: range.start,
        proxy: &[],
        points: &points[range.clone()],
        normals: &normals[range],
    };
    let mut open = sinks(folder.path());
    for (path, sink) in &mut open {
        std::fs::write(&*path, "before").unwrap();
        sink.begin(&header).unwrap();
        sink.frames(&batch(0..2)).unwrap();
    }
    cancel.cancel();
    for (_, sink) in &mut open {
        assert_eq!(sink.frames(&batch(2..4)).unwrap_err().kind, Kind::Interrupted);
    }
    drop(open);
    let mut left: Vec<String> =
        std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    left.sort();
    assert_eq!(left, ["a.abc", "a.mdd", "a.pc2", "a.usda", "a.usdc", "a.usdz"]);
    assert!(left.iter().all(|name| std::fs::read(folder.path().join(name)).unwrap() == b"before"));
}

#[test]
fn a_texture_inside_the_scan_is_left_out_of_usd_with_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let mut scan = odd(folder.path());
    scan.look.materials[0].base_color = [0.5, 0.25, 0.0, 1.0];
    scan.look.materials[0].base_color_texture = Some(Image::Embedded { name: "inner".into(), bytes: Arc::new([1, 2]) });
    let written = write(folder.path(), &header(scan, 1, &Cancel::default()));
    assert!(written[2].notes.iter().any(|n| n.contains("'inner'")), "{:?}", written[2].notes);
    let text = std::fs::read_to_string(folder.path().join("a.usda")).unwrap();
    assert_eq!(Usda(&text).prim("Material", "skin_tone").value("color3f inputs:diffuseColor"), "(0.5, 0.25, 0)");
}

/// The files of a stored zip archive: name, place of the first byte, bytes. By the central directory; checksums and local headers have to agree.
fn stored(zip: &[u8]) -> Vec<(String, usize, Vec<u8>)> {
    let short = |at: usize| usize::from(u16::from_le_bytes(zip[at..at + 2].try_into().unwrap()));
    let long = |at: usize| u32::from_le_bytes(zip[at..at + 4].try_into().unwrap()) as usize;
    let tail = zip.len() - 22;
    assert_eq!(&zip[tail..tail + 4], b"PK\x05\x06");
    let (count, mut at) = (short(tail + 10), long(tail + 16));
    assert_eq!(at + long(tail + 12), tail);
    let mut files = Vec::new();
    for _ in 0..count {
        assert_eq!(&zip[at..at + 4], b"PK\x01\x02");
        let (crc, length, name, local) = (long(at + 16), long(at + 24), short(at + 28), long(at + 42));
        assert_eq!((short(at + 10), long(at + 20)), (0, length), "stored");
        assert_eq!(&zip[local..local + 4], b"PK\x03\x04");
        assert_eq!((long(local + 14), long(local + 18), long(local + 22)), (crc, length, length));
        let start = local + 30 + short(local + 26) + short(local + 28);
        let bytes = zip[start..start + length].to_vec();
        let mut sum = flate2::Crc::new();
        sum.update(&bytes);
        assert_eq!(sum.sum() as usize, crc);
        files.push((String::from_utf8(zip[at + 46..at + 46 + name].to_vec()).unwrap(), start, bytes));
        at += 46 + name;
    }
    files
}

#[test]
fn a_usd_package_holds_the_crate_first_and_every_file_at_64_bytes() {
    let files = stored(&bytes("a.usdz"));
    assert_eq!(files[0].0, "a.usdc");
    assert!(files.iter().all(|(_, start, _)| start % 64 == 0));
    let (packed, beside) = (Usdc::read(files[0].2.clone()), Usdc::read(bytes("a.usdc")));
    for (f, points) in truth().iter().enumerate() {
        assert!(same_bits(&packed.samples("/scan/mesh.points")[f].1, points), "frame {f}");
    }
    assert_eq!(packed.samples("/scan/mesh.points").len(), beside.samples("/scan/mesh.points").len());
}

#[test]
fn a_usd_package_takes_textures_along() {
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\nrest";
    let folder = tempfile::tempdir().unwrap();
    let mut scan = odd(folder.path());
    let inner = Image::Embedded { name: "inner".into(), bytes: PNG.into() };
    scan.look.materials[0].base_color_texture = Some(inner.clone());
    scan.look.materials[0].normal_texture = Some(inner);
    let other = Image::Embedded { name: "odd".into(), bytes: Arc::new([1, 2]) };
    scan.look.materials[1].base_color_texture = Some(other);
    let written = write(folder.path(), &header(scan, 1, &Cancel::default()));
    let notes: Vec<&str> = written[5].notes.iter().filter(|n| n.contains("texture")).collect();
    assert_eq!(notes, ["odd: texture left out: neither PNG nor JPEG"]);
    let files = stored(&std::fs::read(folder.path().join("a.usdz")).unwrap());
    assert_eq!(files.iter().map(|f| f.0.as_str()).collect::<Vec<_>>(), ["a.usdc", "textures/1.png"]);
    assert_eq!((files[1].1 % 64, files[1].2.as_slice()), (0, PNG));
    assert!(files[0].2.windows(16).any(|w| w == b"./textures/1.png"));
}
