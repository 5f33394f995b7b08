//! Other poses of a scan: files of the same mesh, and the morph targets of a glTF.

use super::{Scan, gltf, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::statistics::middle;
use crate::words;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Extent of a pose against that of the scan within which it is the same thing.
const EXTENT: std::ops::RangeInclusive<f64> = 0.2..=5.0;
/// Change of the length of edges, the median of all, from which a pose has another scale.
const SCALE: f64 = 0.02;
/// Lengths of edges change within this factor, but for a share of them; else the vertices are those of another order.
const STRETCH: f64 = 3.0;
const STRETCHED: f64 = 0.25;
/// A surface encloses something where its volume is this share of its area to the power of 3/2 (a sphere: 0.094, a person: 0.03).
const SOLID: f64 = 0.005;
/// Its holes are smaller than this share of its area.
const OPENING: f64 = 0.05;

/// A pose of a scan.
#[derive(Clone, Debug)]
pub struct Pose {
    /// Name of its file or morph target.
    pub name: String,
    /// Where the vertices of the scan are, in its unit and axes.
    pub positions: Vec<DVec3>,
    /// Length of its edges against that of the same edges of the scan, the median of all.
    pub scale: f64,
}

/// Reads poses of `scan` from meshes with the same vertices and faces: files as [`super::read`] takes them, folders of such (by name), and glTF files
/// with morph targets, of which each is a pose. `any_size`: in any unit.
///
/// # Errors
/// A file that cannot be read, or holds another mesh: which vertex or face differs first; one that is mirrored, or whose vertices are in another order.
pub fn read_poses(scan: &Scan, paths: &[PathBuf], any_size: bool, notes: &mut Notes) -> Result<Vec<Pose>> {
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
                read_file(scan, &file, any_size, &mut poses)?;
            }
        } else {
            read_file(scan, path, any_size, &mut poses)?;
        }
    }
    for pose in poses.iter().filter(|_| !any_size) {
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

fn read_file(scan: &Scan, path: &Path, any_size: bool, poses: &mut Vec<Pose>) -> Result<()> {
    let stem = |p: &Path| p.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let content = source::load(path)?;
    if matches!(source::format(&content.name, &content.bytes)?, source::Format::Gltf) {
        let targets = gltf::read_targets(&content.bytes, path, &content.beside)?;
        if !targets.is_empty() {
            for (name, target) in targets {
                poses.push(pose(scan, &target, format!("{}:{name}", stem(path)), path, any_size)?);
            }
            return Ok(());
        }
    }
    let other = super::read(path)?;
    poses.push(pose(scan, &other, stem(path), path, any_size)?);
    Ok(())
}

fn pose(scan: &Scan, other: &Scan, name: String, path: &Path, any_size: bool) -> Result<Pose> {
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
    let (at_rest, posed) = (edges(&here.faces, &here.positions), edges(&here.faces, &there.positions));
    let mut ratios: Vec<f64> =
        at_rest.iter().zip(&posed).filter(|(rest, _)| **rest > 0.0).map(|(rest, posed)| posed / rest).collect();
    let scale = middle(&mut ratios).unwrap_or(0.0);
    let stretched = ratios.iter().filter(|&&r| !(scale / STRETCH..=scale * STRETCH).contains(&r)).count();
    if stretched as f64 > STRETCHED * ratios.len() as f64 {
        let share = 100.0 * stretched as f64 / ratios.len() as f64;
        return Err(refused(format!(
            "{share:.0} % of its edges are more than {STRETCH} times longer or shorter than those of {of_scan}"
        ))
        .expected("the scan's own vertices, in the same order, in another pose")
        .hint("export every pose from the same mesh with its vertices in the same order"));
    }
    let extent = |mesh: &super::SurfaceMesh| super::UnitBox::of(mesh).map_or(0.0, |b| b.diagonal);
    let size = if any_size { scale } else { 1.0 };
    let ratio = extent(there) / (extent(here) * size);
    if !EXTENT.contains(&ratio) {
        let times = format!("{} times as large as {of_scan}", words::digits(ratio));
        return Err(refused(times)
            .expected("the scan in another pose, in the same unit")
            .hint("--example-scale auto, or export it in the unit of the scan"));
    }
    if handedness(here, &here.positions) * handedness(here, &there.positions) < 0.0 {
        return Err(refused(format!("it is mirrored: what is outside in {of_scan} is inside here"))
            .expected("the scan in another pose")
            .hint("export it without a mirrored axis"));
    }
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

/// Lengths of the edges around each face.
fn edges(faces: &super::Faces, positions: &[DVec3]) -> Vec<f64> {
    let around = |face: &[u32]| -> Vec<f64> {
        let at = |k: usize| positions[face[k % face.len()] as usize];
        (0..face.len()).map(|k| at(k).distance(at(k + 1))).collect()
    };
    faces.iter().flat_map(around).collect()
}

/// 1 where the faces enclose a volume, −1 where they do so inside out, 0 where they enclose hardly any.
fn handedness(mesh: &super::SurfaceMesh, positions: &[DVec3]) -> f64 {
    let middle = positions.iter().sum::<DVec3>() / positions.len().max(1) as f64;
    let (mut volume, mut area, mut opening) = (0.0, 0.0, DVec3::ZERO);
    for face in mesh.faces.iter() {
        let at = |k: usize| positions[face[k] as usize] - middle;
        for k in 1..face.len().saturating_sub(1) {
            let cross = (at(k) - at(0)).cross(at(k + 1) - at(0));
            volume += at(0).dot(cross) / 6.0;
            area += cross.length() / 2.0;
            opening += cross / 2.0;
        }
    }
    // Areas of what is closed cancel.
    let is_closed = opening.length() <= OPENING * area;
    if is_closed && f64::abs(volume) > SOLID * area.powf(1.5) { volume.signum() } else { 0.0 }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const CUBE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    const FACES: &str = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

    fn obj(size: f64, faces: &str) -> String {
        CUBE.iter().map(|p| format!("v {} {} {}\n", size * p[0], size * p[1], size * p[2])).collect::<String>() + faces
    }

    /// The scan, and the poses of a file beside it.
    fn read_text(text: &str) -> (Result<Vec<Pose>>, Notes) {
        read_of_size(text, false)
    }

    fn read_of_size(text: &str, any_size: bool) -> (Result<Vec<Pose>>, Notes) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scan.obj"), obj(1.0, FACES)).unwrap();
        std::fs::write(folder.path().join("pose.obj"), text).unwrap();
        let scan = super::super::read(&folder.path().join("scan.obj")).unwrap();
        let mut notes = Notes::default();
        (read_poses(&scan, &[folder.path().join("pose.obj")], any_size, &mut notes), notes)
    }

    fn parsed(text: &str) -> Scan {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scan.obj"), text).unwrap();
        super::super::read(&folder.path().join("scan.obj")).unwrap()
    }

    #[test]
    fn faces_may_come_in_any_order_and_begin_anywhere() {
        let (poses, notes) = read_text(&obj(1.0, "f 2 3 4\nf 4 1 2\nf 3 1 4\nf 3 2 1\n"));
        let poses = poses.unwrap();
        assert_eq!((poses.len(), poses[0].name.as_str(), poses[0].scale), (1, "pose.obj", 1.0));
        assert!(notes.is_empty());
        let (poses, notes) = read_text(&obj(1.5, FACES));
        assert!((poses.unwrap()[0].scale - 1.5).abs() < 1e-12);
        assert!(notes.iter().any(|t| t.contains("pose.obj") && t.contains("1.5")), "{notes:?}");
    }

    #[test]
    fn a_part_that_is_shorter_in_a_pose_is_no_other_size() {
        let (poses, notes) = read_text(&obj(1.0, FACES).replace("v 0 0 1", "v 0 0 0.5"));
        assert_eq!((poses.unwrap()[0].scale, notes), (1.0, Notes::default()));
    }

    #[test]
    fn another_mesh_is_refused_with_what_differs_first() {
        let text = |text: &str| read_text(text).0.unwrap_err().to_string();
        let more = text(&(obj(1.0, "") + "v 1 1 1\n" + FACES));
        assert!(more.contains("pose.obj") && more.contains("5 vertices where scan.obj has 4"), "{more}");
        let turned = text(&obj(1.0, "f 1 3 2\nf 1 2 4\nf 2 4 3\nf 3 1 4\n"));
        assert!(turned.contains("face 3 is (2, 4, 3), where scan.obj has (2, 3, 4)"), "{turned}");
        let fewer = text(&obj(1.0, "f 1 3 2\nf 1 2 4\nf 2 3 4\n"));
        assert!(fewer.contains("face 4 is nothing more"), "{fewer}");
        let giant = text(&obj(1000.0, FACES));
        assert!(giant.contains("1000 times as large") || giant.contains("1,000 times as large"), "{giant}");
        let (poses, notes) = read_of_size(&obj(1000.0, FACES), true);
        assert!((poses.unwrap()[0].scale - 1000.0).abs() < 1e-9 && notes.is_empty());
        // A sheet may bulge either way.
        let sheet = |bulge: f64| format!("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 {bulge}\n");
        let faces = "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
        let (here, there) = (parsed(&(sheet(0.3) + faces)), parsed(&(sheet(-0.3) + faces)));
        assert_eq!([&here, &there].map(|s| handedness(&s.mesh, &s.mesh.positions)), [0.0, 0.0]);
        let mirrored = text(&obj(1.0, FACES).replace("v 1 0 0", "v -1 0 0"));
        assert!(mirrored.contains("it is mirrored"), "{mirrored}");
    }

    #[test]
    fn a_folder_is_read_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, size) in [("b.obj", 1.01), ("a.obj", 1.0), ("scan.txt", 1.0)] {
            std::fs::write(folder.path().join(name), obj(size, FACES)).unwrap();
        }
        let scan = super::super::read(&folder.path().join("a.obj")).unwrap();
        let poses = read_poses(&scan, &[folder.path().to_owned()], false, &mut Notes::default()).unwrap();
        assert_eq!(poses.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["a.obj", "b.obj"]);
        std::fs::remove_file(folder.path().join("a.obj")).unwrap();
        std::fs::remove_file(folder.path().join("b.obj")).unwrap();
        assert!(read_poses(&scan, &[folder.path().to_owned()], false, &mut Notes::default()).is_err());
    }
}
