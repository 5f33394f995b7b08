//! Numbered sequences of meshes with one connectivity: `cat_000001.obj`, `cat_000004.obj`, … → trajectories of vertices.

use super::{Capture, Cleaning, MarkerTake, Motion, VertexTake, number, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::scan::{self, Scan, SurfaceMesh};
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Vertices that are kept, evenly spread: what a binding needs at the most.
pub(super) const MOST: usize = 2000;
/// Frames per second where nobody says any.
const RATE: f64 = 30.0;
/// Numbers between two files up to which the frames between are filled in.
const LONGEST_GAP: i64 = 10;
/// Meshes read at a time.
const BATCH: usize = 16;

/// Reads the sequence that a file belongs to: the files of its folder with the same name but for the number. `rate`: its frames per
/// second, where they are known.
///
/// # Errors
/// A file without a number or without siblings; a sibling that cannot be read or has another connectivity.
pub(super) fn read(path: &Path, rate: Option<f64>) -> Result<Capture> {
    let files = siblings(path)?;
    let mut notes = Notes::default();
    let first = scan::read(&files[0].1)?;
    let vertices = spread(&first.mesh, MOST);
    let mut keys: Vec<Vec<DVec3>> = Vec::with_capacity(files.len());
    keys.push(pick(&first, &vertices));
    for batch in files[1..].chunks(BATCH) {
        let read: Vec<Result<Vec<DVec3>>> =
            batch.par_iter().map(|(_, file)| same(&first, file).map(|s| pick(&s, &vertices))).collect();
        for frame in read {
            keys.push(frame?);
        }
    }
    let numbers = numbering(&files, &mut notes);
    // Places far from the origin would lose digits in single precision.
    let origin = keys[0].iter().sum::<DVec3>() / keys[0].len().max(1) as f64;
    keys.iter_mut().flatten().for_each(|p| *p -= origin);
    let points = fill(&numbers, &keys, &mut notes);
    if rate.is_none() {
        notes.warn(format!("meshes say no frame rate: {RATE} Hz is assumed (--rate sets it)"));
    }
    let labels = vertices.iter().map(|&v| label(v)).collect();
    let count = first.mesh.positions.len();
    let take = VertexTake { points: MarkerTake { labels, points, origin }, vertices, count, faces: first.mesh.faces };
    let name = source::stem(path).trim_end_matches(|c: char| c.is_ascii_digit() || matches!(c, '_' | '-' | '.')).to_owned();
    Ok(Capture {
        name,
        rate: rate.unwrap_or(RATE),
        first_frame: numbers[0],
        space: first.space,
        motion: Motion::Vertices(take),
        source: path.to_owned(),
        cleaning: Cleaning::default(),
        notes,
    })
}

/// The files of a sequence in the order of their numbers.
fn siblings(path: &Path) -> Result<Vec<(i64, PathBuf)>> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let alone = |found: &str| {
        Error::new(Kind::Unsupported, found.to_owned())
            .file(path)
            .expected("one of a sequence of meshes with running numbers: run_0001.obj, run_0002.obj, …")
            .hint("give any file of the sequence; its siblings are found by their names")
    };
    let Some((head, digits, tail)) = split(&name) else { return Err(alone("is a single mesh: its name has no number")) };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))?;
    let mut files: Vec<(i64, PathBuf)> = Vec::new();
    for entry in entries.flatten() {
        let other = entry.file_name().to_string_lossy().into_owned();
        let Some((h, d, t)) = split(&other) else { continue };
        // Padded and plain numbers are two sequences.
        let padded = |d: &str| d.starts_with('0') && d.len() > 1;
        let alike = d.len() == digits.len() || !padded(d) && !padded(digits);
        if h == head && t == tail && alike {
            files.extend(d.parse().ok().filter(|n| *n <= number::LARGEST_FRAME as i64).map(|n| (n, entry.path())));
        }
    }
    files.sort();
    if files.len() < 2 {
        return Err(alone("is a single mesh: its folder has no other number of the same name"));
    }
    Ok(files)
}

/// A file name before, in and behind the last run of digits of its stem.
fn split(name: &str) -> Option<(&str, &str, &str)> {
    let bare = name.strip_suffix(".gz").unwrap_or(name);
    let stem = bare.rfind('.')?;
    let end = name[..stem].rfind(|c: char| c.is_ascii_digit())? + 1;
    let start =
        name[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |i| i + name[i..].chars().next().map_or(1, char::len_utf8));
    Some((&name[..start], &name[start..end], &name[end..]))
}

/// A mesh with the connectivity of the first.
fn same(first: &Scan, file: &Path) -> Result<Scan> {
    let scan = scan::read(file).map_err(|e| if e.file.is_none() { e.file(file) } else { e })?;
    let (a, b) = (&first.mesh, &scan.mesh);
    if a.positions.len() != b.positions.len() || a.faces != b.faces {
        let sizes = |m: &SurfaceMesh| format!("{} vertices and {} faces", m.positions.len(), m.faces.len());
        let how = if sizes(a) == sizes(b) { "its faces join other vertices".to_owned() } else { format!("it has {}", sizes(b)) };
        return Err(Error::new(Kind::Unsupported, format!("is no frame of the sequence: {how}"))
            .file(file)
            .expected(format!("{} as in {}", sizes(a), first.source.display()))
            .hint("a sequence whose meshes share their vertex order, as animation exports and tracked templates do"));
    }
    Ok(scan)
}

fn pick(scan: &Scan, vertices: &[u32]) -> Vec<DVec3> {
    vertices.iter().map(|&v| scan.mesh.positions[v as usize]).collect()
}

/// Label of a vertex.
pub(super) fn label(vertex: u32) -> String {
    format!("v{vertex}")
}

/// At most so many vertices of faces, each farthest from those before it: any number of the first is spread evenly.
pub(super) fn spread(mesh: &SurfaceMesh, most: usize) -> Vec<u32> {
    let mut used = vec![false; mesh.positions.len()];
    mesh.faces.corners.iter().for_each(|&v| used[v as usize] = true);
    let candidates: Vec<u32> = (0u32..).zip(&used).filter(|(_, used)| **used).map(|(v, _)| v).collect();
    let at = |v: u32| mesh.positions[v as usize];
    let mut gaps = vec![f64::INFINITY; candidates.len()];
    let mut chosen = Vec::new();
    let mut next = 0;
    while chosen.len() < most.min(candidates.len()) {
        let here = at(candidates[next]);
        chosen.push(candidates[next]);
        gaps[next] = -1.0;
        gaps.par_iter_mut().zip(&candidates).for_each(|(gap, &v)| {
            let d = (at(v) - here).length_squared();
            if d < *gap {
                *gap = d;
            }
        });
        next = (0..gaps.len()).fold(0, |best, i| if gaps[i] > gaps[best] { i } else { best });
    }
    chosen
}

/// Numbers of the frames: those of the files, or running ones where they leave long gaps.
fn numbering(files: &[(i64, PathBuf)], notes: &mut Notes) -> Vec<i64> {
    let numbers: Vec<i64> = files.iter().map(|f| f.0).collect();
    let longest = numbers.windows(2).map(|w| w[1].saturating_sub(w[0])).max().unwrap_or(1);
    if longest <= LONGEST_GAP {
        return numbers;
    }
    notes.warn(format!("the numbers of the files leave gaps of up to {longest}: the frames are counted from {}", numbers[0]));
    (0..numbers.len() as i64).map(|k| numbers[0] + k).collect()
}

/// Frames for every number, by cubic curves through the files' own.
fn fill(numbers: &[i64], keys: &[Vec<DVec3>], notes: &mut Notes) -> Vec<[f32; 3]> {
    let frames = (numbers[numbers.len() - 1] - numbers[0] + 1) as usize;
    if frames > numbers.len() {
        notes.warn(format!("{} of {frames} frames have no file: they are filled in between the others", frames - numbers.len()));
    }
    let mut points = Vec::with_capacity(frames * keys[0].len());
    let mut k = 0;
    for number in numbers[0]..=numbers[numbers.len() - 1] {
        while k + 2 < numbers.len() && numbers[k + 1] <= number {
            k += 1;
        }
        let (a, b) = (numbers[k] as f64, numbers[k + 1] as f64);
        let t = (number as f64 - a) / (b - a);
        let slope = |i: usize, v: usize| {
            let (low, high) = (i.saturating_sub(1), (i + 1).min(numbers.len() - 1));
            (keys[high][v] - keys[low][v]) / (numbers[high] - numbers[low]) as f64 * (b - a)
        };
        for (v, (&p, &q)) in keys[k].iter().zip(&keys[k + 1]).enumerate() {
            let here = match number {
                n if n == numbers[k] => p,
                n if n == numbers[k + 1] => q,
                _ => {
                    let (m, n) = (slope(k, v), slope(k + 1, v));
                    let (t2, t3) = (t * t, t * t * t);
                    p * (2.0 * t3 - 3.0 * t2 + 1.0) + m * (t3 - 2.0 * t2 + t) + q * (3.0 * t2 - 2.0 * t3) + n * (t3 - t2)
                }
            };
            points.push(here.to_array().map(|x| x as f32));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::capture::{ReadOptions, read};
    use std::fmt::Write;

    /// A strip of quads that bends by `bend`.
    fn strip(bend: f64, columns: usize) -> String {
        let mut text = String::new();
        for i in 0..columns {
            let x = i as f64;
            for y in 0..2 {
                writeln!(text, "v {x} {y} {}", bend * x * x).unwrap();
            }
        }
        for i in 0..columns - 1 {
            let v = 2 * i + 1;
            writeln!(text, "f {v} {} {} {}", v + 2, v + 3, v + 1).unwrap();
        }
        text
    }

    fn folder(files: &[(&str, String)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    #[test]
    fn siblings_are_frames_by_their_numbers_and_missing_ones_are_filled_in() {
        let files = [("run_0004.obj", 0.4), ("run_0001.obj", 0.1), ("run_0002.obj", 0.2), ("run_0006.obj", 0.6)];
        let mut files: Vec<_> = files.into_iter().map(|(name, bend)| (name, strip(bend, 5))).collect();
        files.push(("walk_0001.obj", strip(9.0, 5)));
        files.push(("run_reference.obj", strip(9.0, 5)));
        files.push(("run_1.obj", strip(9.0, 5)));
        let folder = folder(&files);
        let capture = read(&folder.path().join("run_0002.obj"), &ReadOptions::default()).unwrap();
        let take = capture.motion.points();
        assert_eq!((capture.name.as_str(), capture.first_frame, take.frames(), take.markers()), ("run", 1, 6, 10));
        for frame in 0..6 {
            for v in 0..10 {
                let p = take.point(frame, v).unwrap();
                let bend = 0.1 * (frame + 1) as f64;
                assert!((p.z - bend * p.x * p.x).abs() < 1e-6, "frame {frame}: {p}");
            }
        }
        assert!(capture.notes.iter().any(|n| n.starts_with("2 of 6 frames have no file")));
        let Motion::Vertices(vertices) = &capture.motion else { panic!("no vertices") };
        assert_eq!((vertices.count, vertices.faces.len()), (10, 4));
        // The first few are spread over the whole strip.
        let x: Vec<f64> = vertices.vertices[..3].iter().map(|&v| f64::from(v / 2)).collect();
        assert!(x.contains(&0.0) && x.contains(&4.0), "{x:?}");
    }

    #[test]
    fn far_apart_numbers_are_counted() {
        let folder = folder(&[("t0.obj", strip(0.0, 3)), ("t40.obj", strip(1.0, 3)), ("t1000.obj", strip(2.0, 3))]);
        let capture = read(&folder.path().join("t40.obj"), &ReadOptions::default()).unwrap();
        assert_eq!((capture.first_frame, capture.motion.points().frames()), (0, 3));
        assert!(capture.notes.iter().any(|n| n.contains("gaps of up to 960")));
    }

    #[test]
    fn a_mesh_alone_and_a_mesh_of_another_connectivity_are_told() {
        let alone = folder(&[("cat.obj", strip(0.0, 3)), ("dog_1.obj", strip(0.0, 3))]);
        for name in ["cat.obj", "dog_1.obj"] {
            let error = read(&alone.path().join(name), &ReadOptions::default()).unwrap_err();
            assert_eq!(error.kind, Kind::Unsupported);
            assert!(error.found.starts_with("is a single mesh"), "{error}");
        }
        let mixed = folder(&[("cat_1.obj", strip(0.0, 3)), ("cat_2.obj", strip(0.0, 4))]);
        let error = read(&mixed.path().join("cat_1.obj"), &ReadOptions::default()).unwrap_err();
        assert!(error.file.as_ref().is_some_and(|f| f.ends_with("cat_2.obj")), "{error}");
        assert!(error.to_string().contains("8 vertices and 3 faces"), "{error}");
    }

    #[test]
    fn names_are_split_at_their_last_number() {
        assert_eq!(split("cat_000001.obj"), Some(("cat_", "000001", ".obj")));
        assert_eq!(split("take2_frame10_low.ply.gz"), Some(("take2_frame", "10", "_low.ply.gz")));
        assert_eq!(split("é7.obj"), Some(("é", "7", ".obj")));
        assert_eq!(split("12.obj"), Some(("", "12", ".obj")));
        assert_eq!(split("cat.obj"), None);
        assert_eq!(split("cat2"), None);
    }
}
