//! Broken and odd files, kind by kind: what is read with a warning, and what is refused with a message that helps.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;

use common::c3d_writer::C3dFile;
use common::{fixture, retarget, shared};
use glam::{DQuat, DVec3};
use retarget::error::Error;
use std::fmt::Write as _;
use std::path::Path;

/// What must happen with a file.
enum Expect {
    /// It is animated; each of the words is in a warning. No words: no warning about the file.
    Works(&'static [&'static str]),
    /// It is read; no C3D file reaches its place, since it holds single precision only.
    Read,
    /// It is refused; the words are in the message.
    Refused(&'static [&'static str]),
    /// It is refused at a place in the file.
    RefusedAt(&'static str, &'static [&'static str]),
}
use Expect::{Read, Refused, RefusedAt, Works};

/// Tries all kinds before it fails, so that one run tells of all that are wrong.
#[derive(Default)]
struct Tried {
    kinds: usize,
    wrong: Vec<String>,
}

impl Tried {
    fn one(&mut self, name: &str, check: impl FnOnce() + std::panic::UnwindSafe) {
        self.kinds += 1;
        if std::panic::catch_unwind(check).is_err() {
            self.wrong.push(name.to_owned());
        }
    }

    fn close(self, least: usize) {
        assert!(self.wrong.is_empty(), "not as the table says: {:?}", self.wrong);
        assert!(self.kinds >= least, "{} kinds", self.kinds);
    }
}

/// Markers on a mesh that turn it a little.
fn capture_on(points: &[DVec3], count: usize) -> Vec<u8> {
    let mut chosen = vec![points[0]];
    while chosen.len() < count {
        let away = |p: &DVec3| chosen.iter().map(|c| c.distance_squared(*p)).fold(f64::INFINITY, f64::min);
        let next = points.iter().copied().max_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
        chosen.push(next);
    }
    let centre = points.iter().sum::<DVec3>() / points.len() as f64;
    let turned = |k: usize, p: DVec3| DQuat::from_rotation_y(0.05 * k as f64) * (p - centre) + centre;
    C3dFile {
        labels: (0..count).map(|i| format!("M{i:02}")).collect(),
        points: (0..3).flat_map(|k| chosen.iter().map(move |&p| Some(turned(k, p).to_array().map(|c| c as f32)))).collect(),
        unit: String::new(),
        up: String::new(),
        right: String::new(),
        ..C3dFile::default()
    }
    .bytes()
}

/// An error of the library says what, and what to do.
fn helps(name: &str, error: &Error) {
    assert!(error.file.as_ref().is_some_and(|f| f.ends_with(name)), "{name}: no file in {error:?}");
    assert!(!error.found.is_empty(), "{name}: {error:?}");
    assert!(error.expected.is_some() || error.hint.is_some(), "{name}: neither what was expected nor what to do: {error:?}");
}

/// Runs the program on a file in `folder`, and checks what comes of it.
fn check(folder: &Path, name: &str, arguments: &[&str], expect: &Expect) {
    let before = std::fs::read_dir(folder).unwrap().count();
    let output = retarget(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("panicked") && output.status.code().is_some(), "{name}: {said}");
    let written = folder.join("out.pc2");
    match expect {
        Works(words) => {
            assert!(output.status.success(), "{name}: {said}");
            let warnings: Vec<&str> = said.lines().filter(|l| l.starts_with("warning")).collect();
            for word in *words {
                assert!(warnings.iter().any(|w| w.contains(word)), "{name}: no warning with '{word}' in\n{said}");
            }
            let frames = common::read_pc2(&written);
            assert!(
                !frames.is_empty() && frames.iter().flatten().flatten().all(|c| c.is_finite()),
                "{name}: not a finite animation"
            );
            std::fs::remove_file(&written).unwrap();
        }
        Read => {}
        Refused(words) | RefusedAt(_, words) => {
            assert!(matches!(output.status.code(), Some(1 | 3)), "{name}: {:?} {said}", output.status.code());
            assert!(said.starts_with("error") || said.contains("\nerror"), "{name}: {said}");
            assert!(said.contains(name), "{name} is not named: {said}");
            for word in *words {
                assert!(said.contains(word), "{name}: no '{word}' in\n{said}");
            }
        }
    }
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), before, "{name}: something was left behind");
}

fn check_mesh(folder: &Path, name: &str, expect: &Expect) {
    let read = retarget::scan::read(&folder.join(name));
    match (&read, expect) {
        (Ok(scan), Works(_)) => {
            let used: Vec<DVec3> = scan.mesh.faces.corners.iter().map(|&v| scan.mesh.positions[v as usize]).collect();
            std::fs::write(folder.join("take.c3d"), capture_on(&used, 12)).unwrap();
        }
        (Ok(_), Read) => return,
        (Err(error), Refused(_)) => helps(name, error),
        (Err(error), RefusedAt(place, _)) => {
            helps(name, error);
            assert!(error.place.as_ref().is_some_and(|p| p.contains(place)), "{name}: not at {place}: {error:?}");
        }
        // Read, and refused later.
        (Ok(_), Refused(_)) => {}
        _ => panic!("{name}: {:?}", read.err()),
    }
    check(folder, name, &[name, "take.c3d", "--align", "none", "--proxy-vertices", "300", "-o", "out.pc2"], expect);
}

const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n";
const SIDES: &str = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn cube(more: &str) -> Vec<u8> {
    format!("{CUBE}{SIDES}{more}").into_bytes()
}

/// A ball with `map` applied to its vertices, and `flip` saying which faces are turned over.
fn ball(map: impl Fn(DVec3) -> DVec3, flip: impl Fn(usize) -> bool) -> Vec<u8> {
    let (rings, sides) = (12, 18);
    let mut text = String::new();
    let mut vertex = |p: DVec3| {
        let p = map(p);
        let _ = writeln!(text, "v {:?} {:?} {:?}", p.x, p.y, p.z);
    };
    for i in 1..rings {
        for s in 0..sides {
            let (a, b) = (i as f64 / rings as f64 * std::f64::consts::PI, s as f64 / sides as f64 * std::f64::consts::TAU);
            vertex(DVec3::new(a.sin() * b.cos(), a.cos(), -a.sin() * b.sin()));
        }
    }
    vertex(DVec3::Y);
    vertex(-DVec3::Y);
    let at = |i: usize, s: usize| (i - 1) * sides + s % sides + 1;
    let poles = ((rings - 1) * sides + 1, (rings - 1) * sides + 2);
    let mut faces = Vec::new();
    for s in 0..sides {
        faces.push(vec![poles.0, at(1, s), at(1, s + 1)]);
        faces.push(vec![poles.1, at(rings - 1, s + 1), at(rings - 1, s)]);
        faces.extend((1..rings - 1).map(|i| vec![at(i, s), at(i + 1, s), at(i + 1, s + 1), at(i, s + 1)]));
    }
    for (f, mut face) in faces.into_iter().enumerate() {
        if flip(f) {
            face.reverse();
        }
        let corners: Vec<String> = face.iter().map(usize::to_string).collect();
        let _ = writeln!(text, "f {}", corners.join(" "));
    }
    text.into_bytes()
}

fn ply(vertices: &str, faces: &str, header: (usize, usize)) -> Vec<u8> {
    format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}",
        header.0, header.1
    )
    .into_bytes()
}

fn stl(triangles: u32, announced: u32) -> Vec<u8> {
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let sides = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let mut out = b"solid but binary".to_vec();
    out.resize(80, b' ');
    out.extend(announced.to_le_bytes());
    for t in 0..triangles {
        out.extend([0; 12]);
        for v in sides[t as usize % 4] {
            corners[v].iter().for_each(|c| out.extend(c.to_le_bytes()));
        }
        out.extend([0; 2]);
    }
    out
}

/// Kinds of meshes, each made here: name, bytes, what must happen.
fn meshes() -> Vec<(&'static str, Vec<u8>, Expect)> {
    let same = |p: DVec3| p;
    let never = |_: usize| false;
    let cube_ply: String = CUBE.replace("v ", "");
    let sides_ply = "4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
    let text = |s: &str| s.as_bytes().to_vec();
    let mut boxes = String::new();
    for i in 0..5 {
        let shifted: String = CUBE
            .lines()
            .map(|l| {
                let c: Vec<f64> = l[2..].split(' ').map(|x| x.parse().unwrap()).collect();
                format!("v {} {} {}\n", c[0] + 2.0 * f64::from(i), c[1], c[2])
            })
            .collect();
        let faces: String = SIDES
            .lines()
            .map(|l| {
                let c: Vec<i32> = l[2..].split(' ').map(|x| x.parse::<i32>().unwrap() + 8 * i).collect();
                format!("f {} {} {} {}\n", c[0], c[1], c[2], c[3])
            })
            .collect();
        boxes += &(shifted + &faces);
    }
    let mut cut = ball(same, never);
    cut.pop();
    cut.truncate(cut.iter().rposition(|b| *b == b'\n').unwrap() + 1);
    cut.extend(b"f 1 2");
    let mut binary = ball(same, never);
    binary.splice(0..0, [0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a]);
    let sheet: String = (0..49).map(|k| format!("v {} {} {}\n", k % 7, k / 7, 0.2 * f64::from(k % 3))).collect::<String>()
        + &(0..42).filter(|k| k % 7 < 6).map(|k| format!("f {} {} {} {}\n", k + 1, k + 2, k + 9, k + 8)).collect::<String>();
    vec![
        ("empty.obj", vec![], Refused(&["no vertices"])),
        ("comment.obj", text("# nothing\n"), Refused(&["no vertices"])),
        ("points.obj", text(CUBE), Refused(&["nothing to animate", "no faces"])),
        ("lines.obj", text(&format!("{CUBE}l 1 2\np 3\n")), Refused(&["nothing to animate", "line elements"])),
        ("noise.obj", (0..900u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect(), Refused(&[])),
        ("picture.obj", binary, Refused(&["PNG"])),
        ("nan.obj", cube("v nan 0 0\nf 1 2 9\n"), RefusedAt("15", &["not a finite number"])),
        ("beyond.obj", cube("f 1 2 99\n"), RefusedAt("15", &["99"])),
        ("commas.obj", text("v 0,5 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), RefusedAt("1", &["0,5"])),
        ("cut.obj", cut, Works(&["cut short"])),
        (
            "relative.obj",
            text(&format!("{CUBE}f -8 -5 -6 -7\nf -4 -3 -2 -1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n")),
            Works(&[]),
        ),
        ("flat_faces.obj", cube("f 1 1 2\nf 1 2 2\n"), Works(&[])),
        ("twice.obj", cube(SIDES), Works(&[])),
        ("fin.obj", cube("v 0.5 -0.5 0\nf 1 2 9\nf 2 1 9\n"), Works(&[])),
        ("inside_out.obj", ball(same, |_| true), Works(&[])),
        ("mixed.obj", ball(same, |f| f % 3 == 0), Works(&[])),
        ("sheet.obj", text(&sheet), Works(&["encloses no body"])),
        ("boxes.obj", text(&boxes), Works(&["5 pieces"])),
        ("far.obj", ball(|p| p * 0.5 + 3e7, never), Read),
        ("tiny.obj", ball(|p| p * 1e-6, never), Works(&[])),
        ("no_materials.obj", [b"mtllib not there.mtl\nusemtl\n".to_vec(), cube("")].concat(), Works(&["missing"])),
        (
            "bom.obj",
            [b"\xef\xbb\xbf".to_vec(), String::from_utf8(cube("")).unwrap().replace('\n', "\r\n").into_bytes()].concat(),
            Works(&[]),
        ),
        ("latin1.obj", [b"g K\xf6rper\n".to_vec(), cube("")].concat(), Works(&[])),
        ("unfinished.obj", cube("f 1 2 3"), Works(&[])),
        ("plain.ply", ply(&cube_ply, sides_ply, (8, 6)), Works(&[])),
        ("points.ply", ply(&cube_ply, "", (8, 0)), Refused(&["nothing to animate"])),
        ("too_many_vertices.ply", ply(&cube_ply, sides_ply, (12, 6)), RefusedAt("line", &["vertex"])),
        ("four_billion.ply", ply(&cube_ply, sides_ply, (4_000_000_000, 6)), Refused(&["4000000000"])),
        ("negative.ply", ply(&cube_ply, &sides_ply.replacen("4 0", "4 -1", 1), (8, 6)), RefusedAt("line", &["-1"])),
        ("short.ply", ply(&cube_ply, "4 0 3 2 1\n", (8, 6)), Refused(&["face"])),
        ("header_only.ply", text("ply\nformat ascii 1.0\nelement vertex 8\n"), Refused(&[])),
        ("solid.stl", stl(4, 4), Works(&[])),
        ("count_lies.stl", stl(4, 1004), Works(&["announces 1004"])),
        ("no_facets.stl", text("solid x\nendsolid x\n"), Refused(&["nothing to animate"])),
    ]
}

#[test]
fn every_kind_of_broken_mesh_is_read_with_a_warning_or_refused_with_help() {
    let mut tried = Tried::default();
    for (name, bytes, expect) in meshes() {
        let work = tempfile::tempdir().unwrap();
        std::fs::write(work.path().join(name), bytes).unwrap();
        std::fs::write(work.path().join("take.c3d"), capture_on(&[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], 4)).unwrap();
        tried.one(name, || check_mesh(work.path(), name, &expect));
    }
    tried.close(30);
}

/// Six markers over ten frames in millimetres.
fn take() -> C3dFile {
    let labels = ["LFHD", "RFHD", "LASI", "RASI", "LANK", "RANK"].map(String::from).to_vec();
    let places = [
        [80.0, 0.0, 1700.0],
        [-80.0, 0.0, 1700.0],
        [120.0, 0.0, 1000.0],
        [-120.0, 0.0, 1000.0],
        [100.0, 0.0, 90.0],
        [-100.0, 0.0, 90.0f32],
    ];
    let points = (0..10).flat_map(|k| places.map(|[x, y, z]| Some([x, y + k as f32, z]))).collect();
    C3dFile { labels, points, ..C3dFile::default() }
}

/// What must come of a capture: the notes of a capture that is read have these words.
fn captures() -> Vec<(&'static str, Vec<u8>, Expect)> {
    let with = |change: &dyn Fn(&mut C3dFile)| {
        let mut file = take();
        change(&mut file);
        file.bytes()
    };
    let whole = take().bytes();
    let patched = |at: usize, bytes: &[u8]| {
        let mut out = whole.clone();
        out[at..at + bytes.len()].copy_from_slice(bytes);
        out
    };
    let data = whole.len() - (10 * 6 * 16usize).next_multiple_of(512);
    vec![
        ("plain.c3d", whole.clone(), Works(&[])),
        ("empty.c3d", vec![], Refused(&[])),
        ("zeros.c3d", vec![0; 512], Refused(&[])),
        ("text.c3d", b"HIERARCHY\nROOT Hips\n{\n".to_vec(), Refused(&["BVH"])),
        ("head.c3d", whole[..300].to_vec(), Refused(&[])),
        ("no_data.c3d", whole[..data].to_vec(), Refused(&[])),
        ("mid_frame.c3d", whole[..data + 6 * 16 * 7 + 40].to_vec(), Works(&["7"])),
        ("header_says_500.c3d", patched(8, &500u16.to_le_bytes()), Works(&["500"])),
        ("header_rate.c3d", patched(20, &120f32.to_le_bytes()), Works(&["120"])),
        ("many_points.c3d", patched(2, &60_000u16.to_le_bytes()), Refused(&["whole frame"])),
        ("no_parameters.c3d", patched(0, &[200]), Works(&["numbered"])),
        ("no_rate.c3d", with(&|f| f.rate = 0.0), Works(&["rate"])),
        ("nan_rate.c3d", with(&|f| f.rate = f32::NAN), Works(&["rate"])),
        ("same_label.c3d", with(&|f| f.labels[1] = "LFHD".into()), Works(&["LFHD"])),
        ("nothing_seen.c3d", with(&|f| f.points.fill(None)), Refused(&["no"])),
        ("only_angles.c3d", with(&|f| f.labels = (0..6).map(|i| format!("Joint{i}Angles")).collect()), Refused(&[])),
        ("metres_of_millimetres.c3d", with(&|f| f.unit = "m".into()), Works(&["unit is doubtful"])),
        ("unknown_unit.c3d", with(&|f| f.unit = "furlong".into()), Works(&["furlong"])),
        ("gaps_of_nan.c3d", with(&|f| f.points[6 * 4] = Some([f32::NAN; 3])), Works(&[])),
        ("gaps_far_away.c3d", with(&|f| f.points[6 * 4] = Some([1e9; 3])), Works(&[])),
        (
            "two_subjects.c3d",
            with(&|f| f.labels.iter_mut().enumerate().for_each(|(i, l)| *l = format!("{}:{l}", ["A", "B"][usize::from(i > 3)]))),
            Works(&["--subject"]),
        ),
        ("table.trc", b"PathFileType\t4\t(X/Y/Z)\ta.trc\n".to_vec(), Refused(&["marker names", "line 1", "TRC"])),
        ("skeleton.bvh", b"HIERARCHY\nROOT Hips\n".to_vec(), Refused(&["MOTION"])),
    ]
}

fn check_capture(folder: &Path, name: &str, expect: &Expect) {
    let read = retarget::capture::read(&folder.join(name), &retarget::capture::ReadOptions::default());
    match (&read, expect) {
        (Ok(capture), Works(words)) => {
            for word in *words {
                assert!(capture.notes.iter().any(|n| n.contains(word)), "{name}: no '{word}' in {:?}", capture.notes);
            }
            let take = capture.motion.points();
            assert!(take.frames() > 0 && take.markers() > 0, "{name}");
            assert!(take.points.iter().all(|p| p[0].is_nan() || p.iter().all(|c| c.is_finite())), "{name}: an infinite point");
        }
        (Err(error), Refused(_)) => {
            helps(name, error);
            // Text of another format comes without a C3D's first byte, so its own name says enough to the program too.
            check(folder, name, &[&fixture("scan.obj").to_string_lossy(), name, "-o", "out.pc2"], expect);
        }
        _ => panic!("{name}: {:?}", read.map(|c| c.summary())),
    }
}

#[test]
fn every_kind_of_broken_capture_is_read_with_a_warning_or_refused_with_help() {
    let mut tried = Tried::default();
    for (name, bytes, expect) in captures() {
        let work = tempfile::tempdir().unwrap();
        std::fs::write(work.path().join(name), bytes).unwrap();
        tried.one(name, || check_capture(work.path(), name, &expect));
    }
    tried.close(20);
}

/// The shared broken meshes.
const MESHES: [(&str, Expect); 43] = [
    ("comment_only.obj", Refused(&["no vertices"])),
    ("crlf_bom_utf8.obj", Works(&[])),
    ("duplicate_vertices_faces.obj", Works(&[])),
    ("empty.obj", Refused(&["no vertices"])),
    ("exponents_commas.obj", RefusedAt("lines 3 and 4", &["1.d0"])),
    ("flipped_orientation.obj", Works(&[])),
    ("glb_bad_length.glb", Refused(&["GLB"])),
    ("huge_offset.obj", Read),
    ("index_out_of_range.obj", RefusedAt("lines 15 and 16", &["99"])),
    ("latin1_names.obj", Works(&[])),
    ("lines_only.obj", Refused(&["line elements"])),
    ("many_components.obj", Works(&["separate parts of the scan without a marker"])),
    ("missing_mtl.obj", Works(&["missing"])),
    ("mixed_orientation.obj", Works(&[])),
    ("nan_inf.obj", RefusedAt("lines 6, 18 and 31", &["not a finite number"])),
    ("negative_indices.obj", Works(&[])),
    ("ngons_concave.obj", Works(&[])),
    ("no_newline_at_end.obj", Works(&[])),
    ("nonmanifold_edge.obj", Works(&[])),
    ("nonmanifold_vertex.obj", Works(&[])),
    ("not_a_mesh.obj", Refused(&[])),
    ("open_surface.obj", Works(&["encloses no body"])),
    ("ply_ascii_extra_elements.ply", Works(&[])),
    ("ply_big_endian_double_extra.ply", Works(&[])),
    ("ply_count_lie_huge.ply", Refused(&["4000000000"])),
    ("ply_count_lie_vertices.ply", RefusedAt("line 138", &["vertex"])),
    ("ply_crlf_header_binary.ply", Works(&[])),
    ("ply_negative_index.ply", RefusedAt("line 23", &["-1"])),
    ("ply_points_only.ply", Refused(&["nothing to animate"])),
    ("ply_tristrips.ply", Works(&["encloses no body"])),
    ("ply_truncated_binary.ply", Refused(&["ends within row"])),
    ("png_named.obj", Refused(&["PNG"])),
    ("points_only.obj", Refused(&["nothing to animate"])),
    ("self_intersecting.obj", Works(&[])),
    ("stl_ascii_short.stl", Works(&[])),
    ("stl_binary_count_lie.stl", Works(&["announces 1252"])),
    ("stl_binary_solid_header.stl", Works(&[])),
    ("stl_empty_ascii.stl", Refused(&["nothing to animate"])),
    ("tiny_scale.obj", Works(&[])),
    ("truncated.obj", Works(&["cut short"])),
    ("weird_syntax.obj", Works(&["fewer than 3 corners"])),
    ("zero_area_faces.obj", Works(&["twice"])),
    ("crlf_bom_utf8.mtl", Refused(&[])),
];

/// The shared C3D files, sound and odd, and the broken files of BVH.
const CAPTURES: [(&str, Expect); 72] = [
    ("broken/bvh_channels_6_lists_5.bvh", Refused(&["line 5", "CHANNELS says 6"])),
    ("broken/bvh_comments.bvh", Works(&[])),
    ("broken/bvh_cr_only.bvh", Works(&[])),
    ("broken/bvh_crlf.bvh", Works(&[])),
    ("broken/bvh_decimal_commas.bvh", Works(&[])),
    ("broken/bvh_exponents.bvh", Works(&[])),
    ("broken/bvh_frame_time_zero.bvh", Works(&["30 frames per second"])),
    ("broken/bvh_header_says_10_has_5.bvh", Works(&["says 10, 5 rows"])),
    ("broken/bvh_header_says_3_has_5.bvh", Works(&["says 3, 5 rows"])),
    ("broken/bvh_hierarchy_one_line.bvh", Works(&[])),
    ("broken/bvh_inf_value.bvh", Works(&["not finite"])),
    ("broken/bvh_long_row3.bvh", Refused(&["row 3", "62", "line 122"])),
    ("broken/bvh_lowercase_keywords.bvh", Works(&[])),
    ("broken/bvh_missing_brace.bvh", Refused(&["'Hips' is closed", "line 117"])),
    ("broken/bvh_namespace_colons.bvh", Works(&[])),
    ("broken/bvh_nan_value.bvh", Works(&["not finite"])),
    ("broken/bvh_no_end_sites.bvh", Works(&[])),
    ("broken/bvh_no_motion.bvh", Refused(&["MOTION", "line 116"])),
    ("broken/bvh_ok_5frames.bvh", Works(&[])),
    ("broken/bvh_rows_wrapped.bvh", Works(&[])),
    ("broken/bvh_short_row3.bvh", Refused(&["row 3", "56", "line 122"])),
    ("broken/bvh_spaces_in_names.bvh", Works(&[])),
    ("broken/bvh_two_roots.bvh", Works(&["2 roots"])),
    ("broken/bvh_utf8_bom.bvh", Works(&[])),
    ("broken/bvh_zero_frames.bvh", Refused(&["no rows of motion"])),
    ("broken/duplicate_labels.c3d", Works(&["LFHD"])),
    ("broken/empty.c3d", Refused(&[])),
    ("broken/gap_kinds.c3d", Works(&[])),
    ("broken/header_rate_disagrees.c3d", Works(&["120"])),
    ("broken/header_says_500_frames.c3d", Works(&["500"])),
    ("broken/labels2_380points.c3d", Works(&[])),
    ("broken/not_a_c3d.c3d", Refused(&["BVH"])),
    ("broken/truncated_mid_frame.c3d", Works(&["44"])),
    ("broken/two_subjects_one_unprefixed.c3d", Works(&["--subject"])),
    ("broken/units_m_values_mm.c3d", Works(&["unit is doubtful"])),
    ("broken/zeros_512.c3d", Refused(&[])),
    ("c3d/Eb015pi.c3d", Works(&[])),
    ("c3d/Eb015pr.c3d", Works(&[])),
    ("c3d/Eb015si.c3d", Works(&[])),
    ("c3d/Eb015sr.c3d", Works(&[])),
    ("c3d/Eb015vi.c3d", Works(&[])),
    ("c3d/Eb015vr.c3d", Works(&[])),
    ("c3d/TESTDPI.c3d", Works(&[])),
    ("c3d/art_human_2persons_integer.c3d", Works(&["2 subjects"])),
    ("c3d/art_human_tools_integer.c3d", Works(&["2 subjects"])),
    ("c3d/bad_parameter_offset.c3d", Works(&[])),
    ("c3d/bad_parameter_section.c3d", Works(&[])),
    ("c3d/bts_dynamic.c3d", Works(&["label of another", "too long to fill"])),
    ("c3d/bts_standing.c3d", Works(&["label of another"])),
    ("c3d/cmu_01_01.c3d", Works(&["RBAC-1"])),
    ("c3d/cube_1frame.c3d", Works(&[])),
    ("c3d/emg_only.c3d", Refused(&["analog"])),
    ("c3d/facial_sing.c3d", Works(&[])),
    ("c3d/ist_static_metres.c3d", Works(&[])),
    ("c3d/kyowadengyo.c3d", Works(&["POINT:USED"])),
    ("c3d/mac_gait_dec.c3d", Works(&["label of another", "1–133"])),
    ("c3d/mac_jump2.c3d", Works(&["label of another"])),
    ("c3d/mac_mips.c3d", Works(&["POINT:SCALE"])),
    ("c3d/mocap36.c3d", Works(&["trimmed"])),
    ("c3d/mvn_basketball.c3d", Works(&[])),
    ("c3d/optotrak_truncated.c3d", Works(&["29"])),
    ("c3d/parameter_overflow.c3d", Refused(&["position in any frame"])),
    ("c3d/phasespace_noparams.c3d", Works(&["numbered"])),
    ("c3d/phoenix_dance_bad.c3d", Works(&["POINT:FRAMES"])),
    ("c3d/pig_antom_static.c3d", Works(&[])),
    ("c3d/pig_antom_static_1frame.c3d", Works(&[])),
    ("c3d/pig_antom_walk.c3d", Works(&[])),
    ("c3d/pycgm_rom_static.c3d", Works(&[])),
    ("c3d/qualisys_2frames.c3d", Works(&[])),
    ("c3d/simi_giant.c3d", Works(&["beyond any room"])),
    ("c3d/sub_labels.c3d", Works(&["Matt:"])),
    ("c3d/theia_rotations.c3d", Works(&[])),
];

#[test]
fn every_shared_broken_file_is_read_or_refused_as_the_table_says() {
    let Some(data) = shared() else { return };
    let mut tried = Tried::default();
    for (name, expect) in &MESHES {
        let work = tempfile::tempdir().unwrap();
        std::fs::copy(data.join("meshes/broken").join(name), work.path().join(name)).unwrap();
        std::fs::write(work.path().join("take.c3d"), capture_on(&[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], 4)).unwrap();
        tried.one(name, || check_mesh(work.path(), name, expect));
    }
    for (path, expect) in &CAPTURES {
        let work = tempfile::tempdir().unwrap();
        let name = path.split('/').next_back().unwrap();
        std::fs::copy(data.join("motion").join(path), work.path().join(name)).unwrap();
        tried.one(name, || check_capture(work.path(), name, expect));
    }
    tried.close(MESHES.len() + CAPTURES.len());
    let listed = |name: &str, table: &[(&str, Expect)]| table.iter().any(|(l, _)| l.ends_with(name));
    for file in std::fs::read_dir(data.join("meshes/broken")).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        assert!(name == "CASES.md" || listed(&name, &MESHES), "{name} is not in the table");
    }
    for file in ["motion/broken", "motion/c3d"].iter().flat_map(|folder| std::fs::read_dir(data.join(folder)).unwrap()) {
        let name = file.unwrap().file_name().into_string().unwrap();
        let formats = [".c3d", ".bvh"].iter().any(|end| name.ends_with(end));
        assert!(!formats || listed(&name, &CAPTURES), "{name} is not in the table");
    }
}
