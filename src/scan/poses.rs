//! Other poses of a scan: files of the same mesh, and the morph targets of a glTF.

use super::{Scan, gltf, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::words;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Extent of a pose against that of the scan within which it is the same thing.
const EXTENT: std::ops::RangeInclusive<f64> = 0.2..=5.0;
/// Change of the median length of edges from which a pose has another scale.
const SCALE: f64 = 0.02;

/// A pose of a scan.
#[derive(Clone, Debug)]
pub struct Pose {
    /// Name of its file or morph target.
    pub name: String,
    /// Where the vertices of the scan are, in its unit and axes.
    pub positions: Vec<DVec3>,
    /// Median length of its edges against those of the scan.
    pub scale: f64,
}

/// Reads poses of `scan` from meshes with the same vertices and faces: files as [`super::read`] takes them, folders of such (by name), and glTF files
/// with morph targets, of which each is a pose.
///
/// # Errors
/// A file that cannot be read, or holds another mesh: which vertex or face differs first.
pub fn read_poses(scan: &Scan, paths: &[PathBuf], notes: &mut Notes) -> Result<Vec<Pose>> {
    let mut poses = Vec::new();
    for path in paths {
        if path.is_dir() {
            let files = files_of(path)?;
            if files.is_empty() {
                return Err(Error::new(Kind::Usage, "a folder without meshes")
                    .file(path)
                    .expected("OBJ, PLY, OFF or glTF files"));
            }
            for file in files {
                read_file(scan, &file, &mut poses)?;
            }
        } else {
            read_file(scan, path, &mut poses)?;
        }
    }
    for pose in &poses {
        if (pose.scale - 1.0).abs() > SCALE {
            notes.warn(format!(
                "the edges of example {} are {} times as long as those of the scan: taken as they are (--example-scale auto makes them alike)",
                pose.name,
                words::digits(pose.scale)
            ));
        }
    }
    Ok(poses)
}

/// Meshes in a folder, by name.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::unreadable(folder, &e))?.path();
        let extension = source::extension(&path);
        if path.is_file() && ["obj", "ply", "off", "gltf", "glb"].contains(&extension.as_str()) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn read_file(scan: &Scan, path: &Path, poses: &mut Vec<Pose>) -> Result<()> {
    let stem = |p: &Path| p.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let content = source::load(path)?;
    if matches!(source::format(&content.name, &content.bytes)?, source::Format::Gltf) {
        let targets = gltf::read_targets(&content.bytes, path, &content.beside)?;
        if !targets.is_empty() {
            for (name, target) in targets {
                poses.push(pose(scan, &target, format!("{}:{name}", stem(path)), path)?);
            }
            return Ok(());
        }
    }
    let other = super::read(path)?;
    poses.push(pose(scan, &other, stem(path), path)?);
    Ok(())
}

fn pose(scan: &Scan, other: &Scan, name: String, path: &Path) -> Result<Pose> {
    let of_scan = scan.source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (here, there) = (&scan.mesh, &other.mesh);
    let refused = |found: String| Error::refused(found).file(path);
    if there.positions.len() != here.positions.len() {
        let counts = (words::count(there.positions.len()), words::count(here.positions.len()));
        return Err(refused(format!("{} vertices where {of_scan} has {}", counts.0, counts.1))
            .expected("the scan's own vertices, in the same order, in another pose")
            .hint("export every pose from the same mesh, without merging or splitting vertices"));
    }
    if let Some(v) = there.positions.iter().position(|p| !p.is_finite()) {
        return Err(Error::malformed("a coordinate that is not a finite number").file(path).at(format!("vertex {}", v + 1)));
    }
    let (mine, theirs) = (canonical(here), canonical(there));
    if mine != theirs {
        let f = mine.iter().zip(&theirs).position(|(a, b)| a != b).unwrap_or(mine.len().min(theirs.len()));
        let words = |face: Option<&Vec<u32>>| {
            face.map_or("nothing more".into(), |f| {
                format!("({})", f.iter().map(|v| (v + 1).to_string()).collect::<Vec<_>>().join(", "))
            })
        };
        let sorted = |mut faces: Vec<Vec<u32>>| {
            faces.sort_unstable();
            faces
        };
        let found = format!("face {} is {}, where {of_scan} has {}", f + 1, words(theirs.get(f)), words(mine.get(f)));
        if sorted(mine) != sorted(theirs) {
            return Err(refused(found)
                .at(format!("face {}", f + 1))
                .expected("the scan's own faces, in another pose")
                .hint("export every pose from the same mesh"));
        }
    }
    let extent = |mesh: &super::SurfaceMesh| super::UnitBox::of(mesh).map_or(0.0, |b| b.diagonal);
    let ratio = extent(there) / extent(here);
    if !EXTENT.contains(&ratio) {
        return Err(refused(format!("{} times as large as {of_scan}", words::digits(ratio)))
            .expected("the scan in another pose, in the same unit")
            .hint("export it in the unit of the scan"));
    }
    let scale = median(edges(there)) / median(edges(here)).max(f64::MIN_POSITIVE);
    Ok(Pose { name, positions: there.positions.clone(), scale })
}

/// Faces that begin with their least vertex, in the order of the file.
fn canonical(mesh: &super::SurfaceMesh) -> Vec<Vec<u32>> {
    mesh.faces
        .iter()
        .map(|face| {
            let mut face = face.to_vec();
            let least = face.iter().enumerate().min_by_key(|(_, v)| **v).map_or(0, |(k, _)| k);
            face.rotate_left(least);
            face
        })
        .collect()
}

fn edges(mesh: &super::SurfaceMesh) -> Vec<f64> {
    let around = |face: &[u32]| -> Vec<f64> {
        let at = |k: usize| mesh.positions[face[k % face.len()] as usize];
        (0..face.len()).map(|k| at(k).distance(at(k + 1))).collect()
    };
    mesh.faces.iter().flat_map(around).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}
