//! Every body and scan of the shared meshes: printed as a table, held to what a proxy promises.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::edges::{Edges, double_area};
use super::tests::assert_consistent;
use super::tetrahedra::volume;
use super::weld::weld;
use super::*;
use crate::scan::{self, UnitBox};
use crate::spatial::TriangleTree;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Largest mean distance of the vertices of a body from its proxy. Bodies under skirts and slabs under the feet come near to it.
const MEAN_DISTANCE: f64 = 0.006;
/// The same where the surface is closed, in one piece, and not inside itself.
const CLEAN_MEAN_DISTANCE: f64 = 0.0006;
/// A volume below this share is a lost limb: feet, the smallest limbs that matter, are 2 % of a person.
const VOLUME: f64 = 0.985;

/// `None`, with a word, where there are no shared files.
pub(crate) fn shared(folder: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let folder = shared.join("data/meshes").join(folder);
    if !folder.is_dir() {
        eprintln!("skipped: {} is absent", folder.display());
        return None;
    }
    Some(folder)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            found.extend(files(&entry));
        } else {
            let name = entry.to_string_lossy();
            let name = name.strip_suffix(".gz").unwrap_or(&name);
            if [".obj", ".ply", ".stl"].iter().any(|e| name.ends_with(e)) {
                found.push(entry);
            }
        }
    }
    found.sort();
    found
}

#[test]
fn bodies_and_scans_get_sound_proxies() {
    let folders = ["bodies", "scans"].map(shared);
    for path in folders.iter().flatten().flat_map(|folder| files(folder)) {
        check(&path);
    }
}

fn check(path: &Path) {
    let scan = scan::read(path).unwrap();
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|p| unit_box.enter(*p)).collect();
    let triangles = scan.mesh.vertex_triangles();
    let start = Instant::now();
    let Built { proxy, summary, notes, .. } = build(&points, &triangles, &BuildOptions::default(), &|| Ok(())).unwrap();
    let time = start.elapsed();
    let name = path.file_name().unwrap().to_string_lossy();
    let (mean, largest) = distances(&proxy, &points, &triangles);
    eprintln!(
        "{name}: {} · {} · mean {:.3} %, largest {:.2} % · {} ms",
        summary.size(),
        summary.remarks(),
        100.0 * mean,
        100.0 * largest,
        time.as_millis()
    );
    assert_consistent(&proxy);
    // Limbs touch, and a floor has grown to the feet, where the shared files say so and nowhere else.
    assert_eq!(summary.touching > 0, name.starts_with("makehuman_heavy"), "{name}");
    assert_eq!(notes.iter().any(|n| n.contains("a flat ground")), name.contains("photogrammetry"), "{name}");
    assert!(proxy.rest.len() < 4000 && (7000..16000).contains(&proxy.tets.len()), "{name}");
    let sheet = name.starts_with("many_small_holes") || name.starts_with("rangemap");
    assert_eq!(summary.form, if sheet { Form::Coat } else { Form::Body }, "{name}");
    if sheet {
        return;
    }
    assert_eq!(summary.pieces, 1, "{name}");
    assert!(mean < MEAN_DISTANCE, "{name}: {mean}");
    if let Some(expected) = clean_volume(&points, &triangles, &summary) {
        let filled: f64 = proxy.tets.iter().map(|t| volume(&proxy.rest, *t)).sum();
        assert!((VOLUME..1.001).contains(&(filled / expected)), "{name}: {}", filled / expected);
        assert!(mean < CLEAN_MEAN_DISTANCE, "{name}: {mean}");
    }
}

/// Mean and largest distance of the used vertices from the boundary.
fn distances(proxy: &Proxy, points: &[DVec3], triangles: &[[u32; 3]]) -> (f64, f64) {
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let tree = TriangleTree::new(&proxy.rest, &proxy.boundary);
    let found: Vec<f64> = used.par_iter().map(|&v| tree.closest(points[v as usize]).unwrap().distance).collect();
    (found.iter().sum::<f64>() / found.len() as f64, found.iter().copied().fold(0.0, f64::max))
}

/// The volume of a closed surface in one piece that does not overlap itself.
fn clean_volume(points: &[DVec3], triangles: &[[u32; 3]], summary: &Summary) -> Option<f64> {
    let surface = weld(points, triangles, 1e-6);
    let closed = Edges::of(&surface.triangles, surface.points.len()).open_sides(&surface.triangles).is_empty();
    let third = |t: &[u32; 3]| surface.points[t[0] as usize].dot(double_area(&surface.points, *t)) / 6.0;
    (closed && summary.body_pieces == 1 && summary.loose_pieces == 0 && summary.buried < 0.01)
        .then(|| surface.triangles.iter().map(third).sum::<f64>().abs())
}

#[test]
fn broken_files_give_a_sound_proxy_or_a_word() {
    let Some(folder) = shared("broken") else { return };
    for path in files(&folder) {
        let Ok(scan) = scan::read(&path) else { continue };
        let Some(unit_box) = UnitBox::of(&scan.mesh) else { continue };
        let points: Vec<DVec3> = scan.mesh.positions.iter().map(|p| unit_box.enter(*p)).collect();
        let name = path.file_name().unwrap().to_string_lossy();
        let options = BuildOptions { surface_vertices: 500 };
        match build(&points, &scan.mesh.vertex_triangles(), &options, &|| Ok(())) {
            Ok(built) => {
                eprintln!("{name}: {} · {}", built.summary.size(), built.summary.remarks());
                assert_consistent(&built.proxy);
            }
            Err(error) => eprintln!("{name}: {error}"),
        }
    }
}

#[test]
fn tetrahedral_meshes_of_others_are_read() {
    let Some(folder) = shared("proxies") else { return };
    let expected = [("bar_850.mesh", 850, 3168), ("bunny.mesh.gz", 5433, 34055), ("hand.mesh.gz", 7234, 29998)];
    let expected = expected.into_iter().chain([("male_apose_voxel_proxy.mesh", 1543, 4992), ("octopus-low.mesh", 452, 1140)]);
    for (name, vertices, tets) in expected {
        let huge = UnitBox { centre: DVec3::ZERO, diagonal: 4.0 };
        let unit_box = if name.starts_with("bunny") { UnitBox { centre: DVec3::ZERO, diagonal: 0.25 } } else { huge };
        let unit_box = if name.starts_with("bar") { UnitBox { centre: DVec3::Z * 3.0, diagonal: 6.2 } } else { unit_box };
        let (proxy, notes) = medit::read(&folder.join(name), &unit_box).unwrap();
        eprintln!("{name}: {} {} {:?}", proxy.rest.len(), proxy.tets.len(), notes.iter().collect::<Vec<_>>());
        assert_eq!(proxy.components.iter().max(), Some(&0));
        assert!(proxy.rest.len() <= vertices && proxy.rest.len() * 50 > vertices * 49);
        assert!(proxy.tets.len() <= tets && proxy.tets.len() * 10 > tets * 9);
        assert_eq!((proxy.rest.len(), proxy.tets.len()) == (vertices, tets), notes.is_empty());
        assert_consistent(&proxy);
    }
}
