//! Read, write, read again: the same scan, moved.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::obj::ObjFrames;
use super::ply::PlyFrames;
use super::point_cache::{PointCache, Times};
use super::{Cancel, FrameBatch, FrameSink, Written};
use crate::error::Kind;
use crate::scan::{Image, Material, Scan, UnitBox, read};
use crate::surface::NormalVertices;
use glam::{DVec3, Vec3};
use std::fs;
use std::path::{Path, PathBuf};

/// Two quads and a concave pentagon with all looks, an unused vertex, a group without a name, and corners without uv.
const SCAN: &str = "# mm, Z up\nmtllib my looks.mtl\no thing\ng left side\n\
    v 0 0 0 1 0 0.2\nv 10 0 0 0 1 0\nv 10 10 1 0 0 1\nv 0 10 0 0 0 0\nv 20 0 0 1 1 1\nv 20 10 0 1 1 1\nv 99 9 9 1 1 1\nv 15 20 0.125 1 1 1\n\
    vt 0 0\nvt 1 0\nvt 1 0.1\nvt 0.3333 1\nvn 0 0 1\nvn 0 1 0\n\
    usemtl skin tone\nf 1/1/1 2/2/1 3/3/1 4/4/1\ng\nusemtl\nf 2//2 5//2 6//2 3//2\ng right side\nusemtl cloth\nf 3/1 6/2 8/3\no other\nf 1 2 3 4 8\n";

fn sample(folder: &Path) -> Scan {
    fs::write(folder.join("my looks.mtl"), "newmtl skin tone\nKd 0.5 0.25 0\nmap_Kd a b.png\nnewmtl cloth\nKd 0 0 1\nd 0.5\n")
        .unwrap();
    fs::write(folder.join("a b.png"), "").unwrap();
    fs::write(folder.join("scan.obj"), SCAN).unwrap();
    read(&folder.join("scan.obj")).unwrap()
}

struct Motion {
    unit_box: UnitBox,
    points: Vec<Vec<[f32; 3]>>,
    normals: Vec<Vec<[f32; 3]>>,
}

impl Motion {
    fn of(scan: &Scan, frames: usize) -> Self {
        let unit_box = UnitBox::of(&scan.mesh).unwrap();
        let pose = |frame: usize| {
            let turn = glam::DQuat::from_rotation_z(0.1 * frame as f64);
            scan.mesh.positions.iter().map(|&p| (turn * unit_box.enter(p)).as_vec3().to_array()).collect()
        };
        // All different, so that reading them back tells which is which.
        let normals: Vec<[f32; 3]> = (0..NormalVertices::of(scan).vertices.len()).map(|i| [i as f32 * 1e-3, 0.6, -0.8]).collect();
        let normals = vec![normals; frames];
        Self { unit_box, points: (0..frames).map(pose).collect(), normals }
    }

    fn feed(&self, sink: &mut dyn FrameSink) {
        for (first, (points, normals)) in self.points.chunks(2).zip(self.normals.chunks(2)).enumerate() {
            sink.frames(&FrameBatch { first: 2 * first, proxy: &[], points, normals }).unwrap();
        }
    }

    fn expected(&self, frame: usize) -> Vec<DVec3> {
        self.points[frame].iter().map(|&p| self.unit_box.leave(Vec3::from(p).as_dvec3())).collect()
    }
}

fn path_of(image: &Image) -> PathBuf {
    let Image::File(path) = image else { panic!("no file") };
    path.canonicalize().unwrap()
}

/// The materials with their textures by one name, from wherever they are seen.
fn canonical_materials(scan: &Scan) -> Vec<Material> {
    let mut materials = scan.look.materials.clone();
    for texture in materials.iter_mut().filter_map(|m| m.base_color_texture.as_mut()) {
        *texture = Image::File(path_of(texture));
    }
    materials
}

fn write_obj(scan: &Scan, motion: &Motion, pattern: &Path, first_frame: i64) -> Written {
    let mut sink = Box::new(ObjFrames::new(pattern));
    sink.open(scan, &NormalVertices::of(scan), motion.unit_box, first_frame, &Cancel::default()).unwrap();
    motion.feed(&mut *sink);
    sink.finish().unwrap()
}

fn write_ply(scan: &Scan, motion: &Motion, pattern: &Path, first_frame: i64) -> Written {
    let mut sink = Box::new(PlyFrames::new(pattern));
    sink.open(scan, motion.unit_box, first_frame, &Cancel::default()).unwrap();
    motion.feed(&mut *sink);
    sink.finish().unwrap()
}

#[test]
fn obj_keeps_everything() {
    let dir = tempfile::tempdir().unwrap();
    let scan = sample(dir.path());
    assert_eq!(scan.look.groups.len(), 4);
    let motion = Motion::of(&scan, 3);
    let written = write_obj(&scan, &motion, &dir.path().join("out/f_###.obj"), -1);
    let sizes: u64 =
        ["-001", "000", "001"].iter().map(|n| fs::metadata(dir.path().join(format!("out/f_{n}.obj"))).unwrap().len()).sum();
    assert_eq!(written.bytes, sizes);
    for (frame, name) in ["-001", "000", "001"].iter().enumerate() {
        let back = read(&dir.path().join(format!("out/f_{name}.obj"))).unwrap();
        assert_eq!(back.mesh.positions, motion.expected(frame));
        assert_eq!(back.mesh.faces, scan.mesh.faces);
        let (ours, theirs) = (&back.look, &scan.look);
        assert_eq!((&ours.uvs, &ours.corner_uvs), (&theirs.uvs, &theirs.corner_uvs));
        assert_eq!(ours.corner_normals, NormalVertices::of(&scan).corners);
        assert_eq!(ours.colors, theirs.colors);
        assert_eq!(ours.face_groups, theirs.face_groups);
        assert_eq!(ours.groups, theirs.groups);
        assert_eq!(ours.face_materials, theirs.face_materials);
        assert_eq!(ours.material_libraries, ["../my looks.mtl"]);
        assert_eq!(back.space, scan.space);
        assert_eq!(canonical_materials(&back), canonical_materials(&scan));
        assert!(back.notes.is_empty(), "{:?}", back.notes);
    }
    let text = fs::read_to_string(dir.path().join("out/f_000.obj")).unwrap();
    assert!(text.contains("\nvn 0.00000 0.60000 -0.80000\nvn 0.00100 0.60000 -0.80000\n"));
}

#[test]
fn ply_keeps_shape_and_colours() {
    let dir = tempfile::tempdir().unwrap();
    let scan = sample(dir.path());
    let motion = Motion::of(&scan, 3);
    let written = write_ply(&scan, &motion, &dir.path().join("f_####.ply"), 9998);
    assert!(written.notes.iter().any(|n| n.contains("texture coordinates")));
    for (frame, name) in ["9998", "9999", "10000"].iter().enumerate() {
        let path = dir.path().join(format!("f_{name}.ply"));
        let back = read(&path).unwrap();
        let expected: Vec<DVec3> = motion.expected(frame).iter().map(|p| p.as_vec3().as_dvec3()).collect();
        assert_eq!(back.mesh.positions, expected);
        assert_eq!(back.mesh.faces, scan.mesh.faces);
        assert_eq!(back.look.colors, scan.look.colors);
        assert_eq!(back.space, scan.space);
        let head = String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
        assert!(head.contains("property float x") && head.contains("property uchar red") && !head.contains("alpha"));
    }
}

#[test]
fn ply_far_from_the_origin_is_in_double_precision() {
    let dir = tempfile::tempdir().unwrap();
    let mut scan = sample(dir.path());
    scan.mesh.positions.iter_mut().for_each(|p| *p += DVec3::splat(3e7));
    scan.look.colors[0][0] = 0.12345;
    let motion = Motion::of(&scan, 1);
    let written = write_ply(&scan, &motion, &dir.path().join("f_#.ply"), 0);
    assert!(written.encoding.contains("double"));
    let back = read(&dir.path().join("f_0.ply")).unwrap();
    assert_eq!(back.mesh.positions, motion.expected(0));
    assert_eq!(back.look.colors, scan.look.colors);
}

#[test]
fn vertex_uvs_and_a_texture_survive_in_ply_and_in_obj() {
    let dir = tempfile::tempdir().unwrap();
    let head = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\n";
    let properties: String = ["x", "y", "z", "s", "t"].map(|p| format!("property float {p}\n")).concat();
    let body =
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0.5 0.25\n3 0 1 2\n";
    fs::write(dir.path().join("a.ply"), format!("{head}{properties}{body}")).unwrap();
    fs::write(dir.path().join("skin.png"), "").unwrap();
    let scan = read(&dir.path().join("a.ply")).unwrap();
    let motion = Motion::of(&scan, 1);
    write_ply(&scan, &motion, &dir.path().join("frames/p_#.ply"), 0);
    write_obj(&scan, &motion, &dir.path().join("frames/o_#.obj"), 0);
    for name in ["p_0.ply", "o_0.obj"] {
        let back = read(&dir.path().join("frames").join(name)).unwrap();
        assert_eq!((&back.look.uvs, &back.look.corner_uvs), (&scan.look.uvs, &scan.look.corner_uvs));
        let texture = back.look.materials[0].base_color_texture.as_ref().unwrap();
        assert_eq!(path_of(texture), dir.path().join("skin.png").canonicalize().unwrap());
        assert!(back.notes.is_empty());
    }
}

#[test]
fn pc2_holds_every_sample_in_vertex_order() {
    let dir = tempfile::tempdir().unwrap();
    let scan = sample(dir.path());
    let motion = Motion::of(&scan, 5);
    let path = dir.path().join("a.pc2");
    let mut sink = Box::new(PointCache::pc2(&path));
    sink.open(scan.mesh.positions.len(), motion.unit_box, Times { first: 12, frames: 5, rate: 30.0 }, &Cancel::default())
        .unwrap();
    motion.feed(&mut *sink);
    assert!(!path.exists());
    let written = sink.finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    assert_eq!((bytes.len(), written.bytes, written.max_error), (32 + 5 * 8 * 12, bytes.len() as u64, 0.0));
    assert_eq!(&bytes[..12], b"POINTCACHE2\0");
    let int = |at: usize| i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((int(12), int(16), float(20), float(24), int(28)), (1, 8, 12.0, 1.0, 5));
    for frame in 0..5 {
        for (v, p) in motion.expected(frame).iter().enumerate() {
            let at = 32 + (frame * 8 + v) * 12;
            assert_eq!([float(at), float(at + 4), float(at + 8)], p.as_vec3().to_array());
        }
    }
}

#[test]
fn pc2_far_from_the_origin_states_its_error() {
    let dir = tempfile::tempdir().unwrap();
    let mut scan = sample(dir.path());
    scan.mesh.positions.iter_mut().for_each(|p| *p += DVec3::new(3e7, 0.0, 0.0));
    let motion = Motion::of(&scan, 2);
    let mut sink = Box::new(PointCache::pc2(&dir.path().join("a.pc2")));
    sink.open(scan.mesh.positions.len(), motion.unit_box, Times { first: 12, frames: 2, rate: 30.0 }, &Cancel::default())
        .unwrap();
    motion.feed(&mut *sink);
    let written = sink.finish().unwrap();
    assert!(written.max_error > 0.01 && written.max_error < 2.0 && written.rms_error <= written.max_error, "{written:?}");
    assert!(written.worst_frame.is_some_and(|f| f == 12 || f == 13));
}

#[test]
fn an_interrupted_run_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let scan = sample(dir.path());
    let motion = Motion::of(&scan, 2);
    let cancel = Cancel::default();
    let mut ply = PlyFrames::new(&dir.path().join("new/f_#.ply"));
    ply.open(&scan, motion.unit_box, 0, &cancel).unwrap();
    motion.feed(&mut ply);
    cancel.cancel();
    let batch = FrameBatch { first: 2, proxy: &[], points: &motion.points, normals: &motion.normals };
    assert_eq!(ply.frames(&batch).unwrap_err().kind, Kind::Interrupted);
    drop(ply);
    assert!(!dir.path().join("new").exists());
}

/// Every scan of the shared data survives a round trip through both formats.
#[test]
fn real_scans_survive() {
    let shared =
        std::env::var_os("RETARGET_SHARED").map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), Into::into);
    let meshes = shared.join("data/meshes");
    if !meshes.is_dir() {
        eprintln!("skipped: {} is absent", meshes.display());
        return;
    }
    for name in [
        "bodies/makehuman_male_clothed_textured/makehuman_male_clothed.obj.gz",
        "scans/laurana_statue_50k.ply.gz",
        "bodies/horse_quad.obj",
    ] {
        let dir = tempfile::tempdir().unwrap();
        let scan = read(&meshes.join(name)).unwrap();
        let motion = Motion::of(&scan, 1);
        write_obj(&scan, &motion, &dir.path().join("f_#.obj"), 0);
        write_ply(&scan, &motion, &dir.path().join("f_#.ply"), 0);
        let obj = read(&dir.path().join("f_0.obj")).unwrap();
        let ply = read(&dir.path().join("f_0.ply")).unwrap();
        assert_eq!((&obj.mesh.faces, &ply.mesh.faces), (&scan.mesh.faces, &scan.mesh.faces));
        assert_eq!(obj.mesh.positions, motion.expected(0));
        let rounding = 1e-7 * motion.unit_box.diagonal * 3f64.sqrt();
        assert!(ply.mesh.positions.iter().zip(motion.expected(0)).all(|(a, b)| a.distance(b) <= rounding));
        assert_eq!((&obj.look.corner_uvs, &obj.look.uvs), (&scan.look.corner_uvs, &scan.look.uvs));
        assert_eq!(canonical_materials(&obj), canonical_materials(&scan), "{name}");
        assert_eq!(obj.look.corner_normals, NormalVertices::of(&scan).corners);
        assert_eq!(obj.look.face_groups, scan.look.face_groups);
        assert_eq!(ply.look.colors, scan.look.colors);
    }
}

#[test]
fn names_of_other_formats_stay_on_their_line() {
    let dir = tempfile::tempdir().unwrap();
    let mut scan = sample(dir.path());
    scan.look.groups[0].object = Some("a\nv 9 9 9".to_owned());
    scan.look.materials[0].name = "skin\r\nKd 9 9 9".to_owned();
    scan.look.material_libraries.clear();
    let motion = Motion::of(&scan, 1);
    write_obj(&scan, &motion, &dir.path().join("f_##.obj"), 0);
    let again = read(&dir.path().join("f_00.obj")).unwrap();
    assert_eq!(again.mesh.positions.len(), scan.mesh.positions.len());
    assert_eq!(again.look.groups[0].object.as_deref(), Some("a_v 9 9 9"));
    assert_eq!(again.look.materials[0].name, "skin__Kd 9 9 9");
    assert_eq!(again.look.materials[0].base_color, scan.look.materials[0].base_color);
}
