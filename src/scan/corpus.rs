//! Every mesh of the shared data reads with the counts of its README; skipped where the data is absent.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::{NONE, Scan, read};
use crate::error::Result;
use crate::space::Unit;
use std::path::{Path, PathBuf};

/// The folder of shared meshes.
pub(super) fn meshes() -> Option<PathBuf> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let folder = shared.join("data/meshes");
    if !folder.is_dir() {
        eprintln!("skipped: {} is absent", folder.display());
        return None;
    }
    Some(folder)
}

fn check(scan: &Scan) {
    let (mesh, look) = (&scan.mesh, &scan.look);
    assert_eq!(mesh.faces.corners.len(), *mesh.faces.starts.last().unwrap() as usize);
    assert!(mesh.faces.corners.iter().all(|&v| (v as usize) < mesh.positions.len()));
    let optional = |indices: &[u32], count: usize, values: usize| {
        assert!(indices.is_empty() || indices.len() == count);
        assert!(indices.iter().all(|&i| i == NONE || (i as usize) < values));
    };
    optional(&look.corner_uvs, mesh.faces.corners.len(), look.uvs.len());
    optional(&look.corner_normals, mesh.faces.corners.len(), usize::MAX);
    optional(&look.face_materials, mesh.faces.len(), look.materials.len());
    optional(&look.face_groups, mesh.faces.len(), look.groups.len());
    assert!(look.colors.is_empty() || look.colors.len() == mesh.positions.len());
    let triangles = mesh.triangulate();
    assert_eq!(triangles.corners.len(), mesh.faces.corners.len() - 2 * mesh.faces.len());
}

/// Name, vertices, triangles, quads.
const COUNTS: &str = "
bodies/makehuman_base_asis_quads.obj.gz 19158 0 18486
bodies/makehuman_base_body_apose_quads.obj.gz 13380 0 13378
bodies/makehuman_male_body_apose_quads.obj.gz 13380 0 13378
bodies/makehuman_female_body_apose_tri_m_zup.ply.gz 13380 26756 0
bodies/makehuman_male_body_tpose_quads_cm.obj.gz 13380 0 13378
bodies/makehuman_heavy_armsdown_soup_mm_zup.stl 6002 12000 0
bodies/makehuman_male_clothed_textured/makehuman_male_clothed.obj.gz 16650 0 15143
bodies/smpl_man_tpose.obj.gz 6890 13776 0
bodies/nbs_maynard_tpose.obj.gz 18453 36902 0
bodies/cheburashka_cartoon.obj.gz 6669 13334 0
bodies/armadillo.obj.gz 43243 86482 0
bodies/horse_quad.obj 2400 0 2398
bodies/spot_cow_uv.obj.gz 2930 5856 0
scans/synthetic_scan_male_apose_mm_zup.ply.gz 204712 405530 0
scans/synthetic_photogrammetry_fused_armsdown_m_yup.ply.gz 40967 81660 0
scans/laurana_statue_50k.ply.gz 27861 49954 0
scans/igea_head.ply.gz 134345 268686 0
scans/bunny_holes_raw.obj.gz 35947 69451 0
scans/rangemap_lato000.ply.gz 44461 86766 0
scans/many_small_holes.ply 2004 3524 0
benchmark/bar.obj 2602 5200 0
benchmark/bumpy_plane.obj.gz 10201 20000 0
benchmark/cylinder.obj.gz 5138 10272 0
benchmark/cactus.obj.gz 5202 10400 0
benchmark/decimated-max.obj.gz 5272 10540 0
examples/human_makehuman_male 7502 15000 0
examples/horse_sumner 8431 16843 0
examples/lion_sumner 5000 9996 0
examples/cat_sumner 7207 14410 0
jointed/piece_revolute.obj.gz 4711 9422 0
jointed/piece_cylinder.obj.gz 12646 25288 0
jointed/piece_prismatic.obj 3054 6104 0
jointed/piece_plane.obj 3432 6856 0
jointed/piece_ball.obj.gz 7154 14300 0
jointed/piece_fixed.obj 2814 5620 0
jointed/desk_lamp.obj.gz 20633 41262 0
jointed/parallel_gripper.obj.gz 8666 17316 0
jointed/office_chair.obj.gz 26267 52530 0
jointed/talos_humanoid.obj.gz 31342 59989 0
jointed/anymal_c_quadruped.obj.gz 20470 40003 0
jointed/panda_arm_gripper.obj.gz 16812 31992 0
jointed/ur5_arm.obj.gz 16035 31994 0
jointed/double_pendulum.obj.gz 4959 9996 0
jointed/finger_edu.obj.gz 4012 7996 0";

#[test]
fn every_mesh_has_the_counts_of_the_readme() -> Result<()> {
    let Some(folder) = meshes() else { return Ok(()) };
    for line in COUNTS.lines().filter(|l| !l.is_empty()) {
        let words: Vec<&str> = line.split(' ').collect();
        let expected: Vec<usize> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
        let path = folder.join(words[0]);
        let files: Vec<PathBuf> = if path.is_dir() {
            path.read_dir().unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "gz")).collect()
        } else {
            vec![path]
        };
        assert!(!files.is_empty());
        for file in files {
            let scan = read(&file)?;
            check(&scan);
            let sides = |n: usize| scan.mesh.faces.iter().filter(|f| f.len() == n).count();
            assert_eq!([scan.mesh.positions.len(), sides(3), sides(4)], expected[..], "{}", file.display());
            assert_eq!(sides(3) + sides(4), scan.mesh.faces.len());
        }
    }
    Ok(())
}

#[test]
fn every_mesh_file_of_these_formats_is_in_the_table() {
    let Some(folder) = meshes() else { return };
    for part in ["bodies", "scans", "benchmark", "examples", "jointed"] {
        let mut folders = vec![folder.join(part)];
        while let Some(folder_here) = folders.pop() {
            for path in folder_here.read_dir().unwrap().map(|e| e.unwrap().path()) {
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                let name = path.strip_prefix(&folder).unwrap().to_string_lossy().into_owned();
                let mesh = [".obj", ".ply", ".stl", ".obj.gz", ".ply.gz", ".stl.gz"].iter().any(|e| name.ends_with(e));
                let listed = COUNTS.lines().filter(|l| !l.is_empty()).any(|l| name.starts_with(l.split(' ').next().unwrap()));
                assert!(!mesh || listed, "{name}");
            }
        }
    }
}

#[test]
fn the_looks_of_real_files_are_kept() -> Result<()> {
    let Some(folder) = meshes() else { return Ok(()) };
    let clothed = read(&folder.join("bodies/makehuman_male_clothed_textured/makehuman_male_clothed.obj.gz"))?;
    assert_eq!((clothed.look.materials.len(), clothed.look.groups.len()), (8, 8));
    assert!(clothed.look.materials.iter().all(|m| m.base_color_texture.as_ref().is_some_and(|p| p.is_file())));
    assert!(clothed.look.materials.iter().any(|m| m.name == "suit cloth" && !m.blend));
    assert_eq!(clothed.look.corner_uvs.len(), clothed.mesh.faces.corners.len());
    assert!(clothed.notes.is_empty(), "{:?}", clothed.notes);
    let base = read(&folder.join("bodies/makehuman_base_asis_quads.obj.gz"))?;
    assert_eq!(base.look.groups.len(), 139);
    let statue = read(&folder.join("scans/laurana_statue_50k.ply.gz"))?;
    assert!(statue.look.colors_have_alpha && statue.look.colors.len() == 27861);
    let scan = read(&folder.join("scans/synthetic_scan_male_apose_mm_zup.ply.gz"))?;
    assert_eq!(scan.space.unit.map(|u| u.value), Some(Unit::Millimetre));
    assert_eq!(scan.space.up.map(|u| u.value), "Z".parse().ok());
    assert!(!scan.look.colors_have_alpha && scan.look.colors.len() == 204712);
    Ok(())
}

#[test]
fn bounding_boxes_are_those_of_the_readme() -> Result<()> {
    let Some(folder) = meshes() else { return Ok(()) };
    let cases = [
        ("scans/igea_head.ply.gz", [-0.035, -0.05, -0.05], [0.035, 0.05, 0.05]),
        ("bodies/makehuman_heavy_armsdown_soup_mm_zup.stl", [-255.481, -156.599, 0.0], [255.481, 233.184, 1600.92]),
        ("jointed/panda_arm_gripper.obj.gz", [-0.173, -0.129, 0.0], [0.484, 0.13, 0.891]),
    ];
    for (name, lo, hi) in cases {
        let mesh = read(&folder.join(name))?.mesh;
        for axis in 0..3 {
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for &v in &mesh.faces.corners {
                least = least.min(mesh.positions[v as usize][axis]);
                most = most.max(mesh.positions[v as usize][axis]);
            }
            // The README rounds to three decimals or six digits.
            let near = |a: f64, b: f64| (a - b).abs() < 6e-4 + 5e-6 * b.abs();
            assert!(near(least, lo[axis]) && near(most, hi[axis]), "{name}: {least} {most}");
        }
    }
    Ok(())
}

/// The OBJ files of the corpus as another reader sees them.
#[test]
fn positions_and_faces_are_those_of_tobj() -> Result<()> {
    let Some(folder) = meshes() else { return Ok(()) };
    for name in ["bodies/horse_quad.obj", "benchmark/bar.obj", "jointed/piece_fixed.obj"] {
        let scan = read(&folder.join(name))?;
        super::obj::compare_with_tobj(&scan, &std::fs::read(folder.join(name)).unwrap());
    }
    Ok(())
}
