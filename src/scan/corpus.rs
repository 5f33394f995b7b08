//! Every mesh of the shared data reads with the counts of its README; skipped where the data is absent.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::{Image, Scan, fuzz, read};
use crate::disjoint::DisjointSets;
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
    fuzz::check(scan, usize::MAX / 20);
}

/// As in the README: name, vertices, triangles, quads, components, boundary edges, non-manifold edges; least and most x, y, z of the first of
/// a set. The STL file is there with its corners unwelded, but for the words on what welding gives.
const TRUTH: &str = "
bodies/makehuman_base_asis_quads.obj.gz 19158 0 18486 154 784 0 -4.973 4.973 -8.449 8.497 -1.103 3.256
bodies/makehuman_base_body_apose_quads.obj.gz 13380 0 13378 1 0 0 -4.963 4.963 -8.168 8.491 -1.015 3.215
bodies/makehuman_male_body_apose_quads.obj.gz 13380 0 13378 1 0 0 -5.686 5.686 -8.181 9.3 -0.976 3.779
bodies/makehuman_female_body_apose_tri_m_zup.ply.gz 13380 26756 0 1 0 0 -0.509 0.509 -0.307 0.096 0 1.67
bodies/makehuman_male_body_tpose_quads_cm.obj.gz 13380 0 13378 1 0 0 -90.783 90.783 0 175.385 -9.779 19.543
bodies/makehuman_heavy_armsdown_soup_mm_zup.stl 6002 12000 0 1 0 0 -255.481 255.481 -156.599 233.184 0 1600.92
bodies/makehuman_male_rigged_apose.glb 13380 26756 0 1 0 0 -0.569 0.569 -0 1.748 -0.098 0.378
bodies/makehuman_male_clothed_textured/makehuman_male_clothed.obj.gz 16650 0 15143 222 2586 0 -0.569 0.569 0 1.781 -0.106 0.378
bodies/cesium_man_rigged.glb 3273 4672 0 138 1894 0 -0.569 0.569 -0 1.507 -0.131 0.181
bodies/kaykit_mannequin_cartoon_rigged.glb 6578 6756 0 409 5742 0 -0.989 0.989 -0 2.207 -0.474 0.538
bodies/smpl_man_tpose.obj.gz 6890 13776 0 1 0 0 -0.885 0.898 -1.331 0.583 -0.133 0.162
bodies/nbs_maynard_tpose.obj.gz 18453 36902 0 1 0 0 -0.911 0.911 -1.212 0.56 -0.152 0.208
bodies/cheburashka_cartoon.obj.gz 6669 13334 0 1 0 0 0.05 0.95 0.079 0.921 0.338 0.662
bodies/armadillo.obj.gz 43243 86482 0 1 0 0 -0.435 0.403 -0.573 0.426 -0.38 0.383
bodies/horse_quad.obj 2400 0 2398 1 0 0 -0.092 0.091 -0.076 0.076 -0.042 0.042
bodies/spot_cow_uv.obj.gz 2930 5856 0 1 0 0 -0.472 0.472 -0.737 0.954 -0.669 1.049
bodies/fox_rigged.glb 1728 576 0 576 1728 0 -12.593 12.593 -0.122 78.907 -88.095 66.625
scans/synthetic_scan_male_apose_mm_zup.ply.gz 204712 405530 0 15 5100 0 -113.861 1016.27 -698.451 107.448 24.262 1809.82
scans/synthetic_photogrammetry_fused_armsdown_m_yup.ply.gz 40967 81660 0 1 276 0 0.904 1.496 -0.015 1.601 -0.202 0.278
scans/laurana_statue_50k.ply.gz 27861 49954 0 1 302 0 -256.461 210.769 -400.394 101.182 -1732.28 -1472.79
scans/igea_head.ply.gz 134345 268686 0 1 0 0 -0.035 0.035 -0.05 0.05 -0.05 0.05
scans/bunny_holes_raw.obj.gz 35947 69451 0 1 223 0 -0.095 0.061 0.033 0.187 -0.062 0.059
scans/rangemap_lato000.ply.gz 44461 86766 0 9 1774 0 -40.599 56.625 -72.51 33.934 -800.04 -724.794
scans/many_small_holes.ply 2004 3524 0 1 556 0 -0.054 -0.009 -0.06 0.011 1.579 1.629
benchmark/bar.obj 2602 5200 0 1 0 0 -0.5 0.5 -0.5 0.5 0 6
benchmark/bumpy_plane.obj.gz 10201 20000 0 1 400 0 0 10 0 10 0 0.42
benchmark/cylinder.obj.gz 5138 10272 0 1 0 0 -0.75 0.75 -0.75 0.75 0 8
benchmark/cactus.obj.gz 5202 10400 0 1 0 0 -1.391 1.46 -0.439 0.439 0.03 4.42
benchmark/decimated-knight.off 502 1000 0 1 0 0 0.228 0.772 0.051 0.95 0.36 0.635
benchmark/decimated-max.obj.gz 5272 10540 0 1 0 0 -65.796 126.921 -195.658 144.479 -39.812 204.407
benchmark/bumpy.off 1250 2496 0 1 0 0 -4.378 4.378 -4.378 4.378 -4.378 4.378
examples/human_makehuman_male/00_rest_apose.obj.gz 7502 15000 0 1 0 0 -0.569 0.569 0 1.748 -0.098 0.378
examples/horse_sumner/horse-reference.obj.gz 8431 16843 0 1 19 0 -0.125 0.125 -0.005 0.899 -0.547 0.484
examples/lion_sumner/lion-reference.obj.gz 5000 9996 0 1 0 0 -0.13 0.13 0.007 0.462 -0.574 0.386
examples/cat_sumner/cat-reference.obj.gz 7207 14410 0 1 0 0 -0.073 0.071 0.001 0.382 -0.462 0.35
jointed/piece_revolute.obj.gz 4711 9422 0 2 0 0 -0.025 0.082 -0.025 0.025 -0.003 0.087
jointed/piece_cylinder.obj.gz 12646 25288 0 2 0 0 -0.02 0.02 -0.02 0.02 -0.05 0.07
jointed/piece_prismatic.obj 3054 6104 0 2 0 0 -0.025 0.025 -0.02 0.02 -0.05 0.07
jointed/piece_plane.obj 3432 6856 0 2 0 0 -0.06 0.06 -0.05 0.05 -0.012 0.02
jointed/piece_ball.obj.gz 7154 14300 0 2 0 0 -0.025 0.025 -0.025 0.025 -0.045 0.07
jointed/piece_fixed.obj 2814 5620 0 2 0 0 -0.03 0.03 -0.03 0.03 -0.04 0.03
jointed/desk_lamp.obj.gz 20633 41262 0 5 0 0 -0.257 0.101 -0.09 0.09 0 0.517
jointed/parallel_gripper.obj.gz 8666 17316 0 4 0 0 -0.06 0.06 -0.035 0.035 0 0.126
jointed/office_chair.obj.gz 26267 52530 0 16 0 0 -0.335 0.33 -0.302 0.302 0.005 1.06
jointed/talos_humanoid.obj.gz 31342 59989 0 531 6059 1988 -0.214 0.118 -0.379 0.379 -1.083 0.673
jointed/anymal_c_quadruped.obj.gz 20470 40003 0 52 823 84 -0.526 0.526 -0.326 0.326 -0.632 0.284
jointed/panda_arm_gripper.obj.gz 16812 31992 0 82 1603 58 -0.173 0.484 -0.129 0.13 0 0.891
jointed/ur5_arm.obj.gz 16035 31994 0 23 0 0 -0.074 0.856 -0.11 0.204 -0.049 0.157
jointed/double_pendulum.obj.gz 4959 9996 0 52 0 0 -0.04 0.034 -0.025 0.025 0 0.355
jointed/finger_edu.obj.gz 4012 7996 0 7 0 0 -0.204 0.025 -0.07 0.031 -0.046 0.363";

/// Components over shared vertices, edges of one face, edges of more than two.
fn topology(scan: &Scan) -> [usize; 3] {
    let faces = &scan.mesh.faces;
    let mut sets = DisjointSets::new(scan.mesh.positions.len());
    let mut edges = Vec::new();
    for face in faces.iter() {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            edges.push((a.min(b), a.max(b)));
            sets.unite(a, b);
        }
    }
    edges.sort_unstable();
    let mut roots: Vec<u32> = faces.corners.iter().map(|&v| sets.find(v)).collect();
    roots.sort_unstable();
    roots.dedup();
    let with = |test: fn(usize) -> bool| edges.chunk_by(|a, b| a == b).filter(|c| test(c.len())).count();
    [roots.len(), with(|n| n == 1), with(|n| n > 2)]
}

fn bounds(scan: &Scan) -> [f64; 6] {
    let mut bounds = [f64::INFINITY, f64::NEG_INFINITY].repeat(3);
    for &v in &scan.mesh.faces.corners {
        for axis in 0..3 {
            let x = scan.mesh.positions[v as usize][axis];
            bounds[2 * axis] = bounds[2 * axis].min(x);
            bounds[2 * axis + 1] = bounds[2 * axis + 1].max(x);
        }
    }
    bounds.try_into().unwrap()
}

#[test]
fn every_mesh_has_the_figures_of_the_readme() -> Result<()> {
    let Some(folder) = meshes() else { return Ok(()) };
    for line in TRUTH.lines().filter(|l| !l.is_empty()) {
        let words: Vec<&str> = line.split(' ').collect();
        let expected: Vec<usize> = words[1..7].iter().map(|w| w.parse().unwrap()).collect();
        let path = folder.join(words[0]);
        // Further members of a set of poses have the same counts.
        let set: Vec<PathBuf> = match path.parent().filter(|_| words[0].starts_with("examples/")) {
            Some(set) => {
                set.read_dir().unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "gz")).collect()
            }
            None => vec![path.clone()],
        };
        for file in set {
            let scan = read(&file)?;
            check(&scan);
            let sides = |n: usize| scan.mesh.faces.iter().filter(|f| f.len() == n).count();
            let counts = [vec![scan.mesh.positions.len(), sides(3), sides(4)], topology(&scan).to_vec()].concat();
            assert_eq!(counts, expected, "{}", file.display());
            assert_eq!(sides(3) + sides(4), scan.mesh.faces.len());
            if file == path {
                let stated = words[7..].iter().map(|w| w.parse::<f64>().unwrap());
                // The README rounds to three decimals or six digits.
                let near = |(a, b): (&f64, f64)| (a - b).abs() < 6e-4 + 5e-6 * b.abs();
                assert!(bounds(&scan).iter().zip(stated).all(near), "{}: {:?}", file.display(), bounds(&scan));
            }
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
                let mesh =
                    [".obj", ".ply", ".stl", ".off", ".glb", ".gltf"].iter().any(|e| name.trim_end_matches(".gz").ends_with(e));
                let stem = |l: &str| l.split(' ').next().unwrap().to_owned();
                let in_set = |l: &str| l.starts_with("examples/") && Path::new(&stem(l)).parent() == Path::new(&name).parent();
                let listed = TRUTH.lines().filter(|l| !l.is_empty()).any(|l| name == stem(l) || in_set(l));
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
    assert!(clothed.look.materials.iter().all(|m| m.base_color_texture.as_ref().is_some_and(|i| i.read().is_ok())));
    assert!(clothed.look.materials.iter().any(|m| m.name == "suit cloth" && !m.blend));
    assert_eq!(clothed.look.corner_uvs.len(), clothed.mesh.faces.corners.len());
    assert!(clothed.notes.is_empty(), "{:?}", clothed.notes);
    let base = read(&folder.join("bodies/makehuman_base_asis_quads.obj.gz"))?;
    assert_eq!(base.look.groups.len(), 139);
    let statue = read(&folder.join("scans/laurana_statue_50k.ply.gz"))?;
    assert!(statue.look.colors_have_alpha && statue.look.colors.len() == 27861);
    let cesium = read(&folder.join("bodies/cesium_man_rigged.glb"))?;
    assert!(
        matches!(&cesium.look.materials[0].base_color_texture, Some(Image::Embedded { bytes, .. }) if bytes.starts_with(&[0xff, 0xd8]))
    );
    assert_eq!((cesium.look.uvs.len(), cesium.space.unit.map(|u| u.value)), (3273, Some(Unit::Metre)));
    let scan = read(&folder.join("scans/synthetic_scan_male_apose_mm_zup.ply.gz"))?;
    assert_eq!(scan.space.unit.map(|u| u.value), Some(Unit::Millimetre));
    assert_eq!(scan.space.up.map(|u| u.value), "Z".parse().ok());
    assert!(!scan.look.colors_have_alpha && scan.look.colors.len() == 204712);
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

/// Speed of reading from memory, on one core; printed, since it depends on the machine.
#[test]
#[ignore = "a measurement"]
fn speed_of_reading() {
    use std::fmt::Write as _;
    let Some(folder) = meshes() else { return };
    let scan = read(&folder.join("scans/synthetic_scan_male_apose_mm_zup.ply.gz")).unwrap();
    let (points, faces) = (&scan.mesh.positions, &scan.mesh.faces);
    let mut obj = String::new();
    points.iter().for_each(|p| writeln!(obj, "v {:.6} {:.6} {:.6}", p.x, p.y, p.z).unwrap());
    faces.iter().for_each(|f| {
        writeln!(obj, "f {}//{} {}//{} {}//{}", f[0] + 1, f[0] + 1, f[1] + 1, f[1] + 1, f[2] + 1, f[2] + 1).unwrap()
    });
    points.iter().for_each(|_| obj.push_str("vn 0.123456 0.654321 0.5\n"));
    let mut off = format!("OFF\n{} {} 0\n", points.len(), faces.len());
    points.iter().for_each(|p| writeln!(off, "{:.6} {:.6} {:.6}", p.x, p.y, p.z).unwrap());
    faces.iter().for_each(|f| writeln!(off, "3 {} {} {}", f[0], f[1], f[2]).unwrap());
    let floats: Vec<u8> = points.iter().flat_map(|p| p.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect();
    let ply_head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
            points.len(),
            faces.len()
        )
    };
    let mut ply = ply_head("binary_little_endian").into_bytes();
    ply.extend(&floats);
    faces.iter().for_each(|f| ply.extend([3].into_iter().chain(f.iter().flat_map(|v| v.to_le_bytes()))));
    let ply_text = ply_head("ascii") + off.splitn(3, '\n').nth(2).unwrap();
    let mut stl = vec![b' '; 80];
    stl.extend((faces.len() as u32).to_le_bytes());
    for f in faces.iter() {
        stl.extend([0; 12]);
        f.iter().for_each(|&v| stl.extend(&floats[12 * v as usize..][..12]));
        stl.extend([0; 2]);
    }
    let mut stl_text = "solid\n".to_owned();
    for f in faces.iter() {
        stl_text.push_str("facet normal 0 0 0\nouter loop\n");
        f.iter()
            .map(|&v| points[v as usize])
            .for_each(|p| writeln!(stl_text, "vertex {:.6} {:.6} {:.6}", p.x, p.y, p.z).unwrap());
        stl_text.push_str("endloop\nendfacet\n");
    }
    let indices: Vec<u8> = faces.corners.iter().flat_map(|v| v.to_le_bytes()).collect();
    let glb = crate::gltf::tests::glb(
        &serde_json::json!({
            "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0 }], "buffers": [{ "byteLength": floats.len() + indices.len() }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
            "bufferViews": [{ "buffer": 0, "byteLength": floats.len() }, { "buffer": 0, "byteOffset": floats.len(), "byteLength": indices.len() }],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "count": points.len(), "type": "VEC3" },
                { "bufferView": 1, "componentType": 5125, "count": faces.corners.len(), "type": "SCALAR" },
            ],
        }),
        &[floats, indices].concat(),
    );
    let files: [(&str, Vec<u8>); 7] = [
        ("obj", obj.into()),
        ("off", off.into()),
        ("ply", ply),
        ("ply ascii", ply_text.into()),
        ("stl", stl),
        ("stl ascii", stl_text.into()),
        ("glb", glb),
    ];
    for (name, bytes) in files {
        let path = Path::new("a").with_extension(name.split(' ').next().unwrap());
        let best = (0..5)
            .map(|_| {
                let start = std::time::Instant::now();
                let read = super::parse_bytes(&bytes, &path, &super::beside::Beside::Nothing).unwrap();
                assert_eq!(read.mesh.faces.len(), faces.len());
                start.elapsed().as_secs_f64()
            })
            .fold(f64::INFINITY, f64::min);
        eprintln!("{name:10} {:6.1} MB  {:6.0} MB/s", bytes.len() as f64 / 1e6, bytes.len() as f64 / 1e6 / best);
    }
}
