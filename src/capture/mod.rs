//! Capture files → [`Capture`]. One file per format; cleaning in files of its own.

mod bvh;
mod c3d;
mod clean;
mod format;
mod gaps;
pub mod handles_csv;
mod labels;
mod neighbours;
mod number;
mod rigid;
mod skeleton;
mod source;
mod swaps;
mod turns;
mod vertices;

#[cfg(test)]
#[path = "../../tests/common/c3d_writer.rs"]
mod c3d_writer;
#[cfg(test)]
mod tests;

use crate::error::{Notes, Result};
use crate::scan::Faces;
use crate::space::{Known, Space, Unit};
use crate::words;
use format::Format;
use glam::{DQuat, DVec3};
use std::fmt;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
pub use vertices::is_mesh;

/// What to take from a capture file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Subject by its label prefix; `None` takes the one with most markers.
    pub subject: Option<String>,
}

/// Reads and cleans a capture file; the format is told by the contents.
///
/// What is doubtful about the file and what cleaning did is in [`Capture::notes`] and [`Capture::cleaning`].
///
/// # Errors
/// Unreadable or broken files, formats that are not read yet, files with nothing to animate, a subject that is not there.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Capture> {
    let capture = match format::tell(path)? {
        Format::Bvh => source::load(path).and_then(|bytes| Ok(bvh::read(&bytes)?.capture(path))),
        Format::C3d => c3d::C3d::open(path).and_then(|file| assemble(file, path, options)),
        Format::Meshes => vertices::read(path),
        other => Err(other.unsupported()),
    };
    capture.map_err(|e| if e.file.is_none() { e.file(path) } else { e }.hint_for_broken_file())
}

/// One take of a motion capture.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Name of the subject, or of the file.
    pub name: String,
    /// Frames per second; positive.
    pub rate: f64,
    /// Number of the first frame in the capture's own numbering.
    pub first_frame: i64,
    /// What the file says of unit and axes.
    pub space: Space,
    /// What moves.
    pub motion: Motion,
    /// The file it came from.
    pub source: PathBuf,
    /// What cleaning did.
    pub cleaning: Cleaning,
    /// What was doubtful about the file, and what was assumed.
    pub notes: Notes,
}

impl Capture {
    /// One line for people: `41 markers, 320 frames at 120 Hz · mm · Z up (file) · dropped 3 ghosts · 212 gaps filled`.
    pub fn summary(&self) -> String {
        let take = self.motion.points();
        let rate = (self.rate * 1000.0).round() / 1000.0;
        let mut parts = vec![format!(
            "{}, {} at {rate} Hz",
            words::plural(take.markers(), self.motion.noun()),
            words::plural(take.frames(), "frame")
        )];
        parts.extend(self.space.unit.map(|u| u.value.to_string()));
        parts.extend(self.space.up.map(|u| format!("{} up ({})", u.value.to_string().trim_start_matches('+'), u.how)));
        parts.push(self.cleaning.to_string());
        parts.retain(|p| !p.is_empty());
        parts.join(" · ")
    }
}

/// What a capture holds.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Motion {
    /// Trajectories of points on the surface.
    Markers(MarkerTake),
    /// Joints with places and turns, inside of the body.
    Skeleton(SkeletonTake),
    /// Vertices of a captured surface.
    Vertices(VertexTake),
}

impl Motion {
    /// Trajectories of the points that move: markers, origins of joints, vertices.
    pub fn points(&self) -> &MarkerTake {
        match self {
            Motion::Markers(take) => take,
            Motion::Skeleton(skeleton) => &skeleton.origins,
            Motion::Vertices(surface) => &surface.points,
        }
    }

    /// As [`Motion::points`], to be changed.
    pub fn points_mut(&mut self) -> &mut MarkerTake {
        match self {
            Motion::Markers(take) => take,
            Motion::Skeleton(skeleton) => &mut skeleton.origins,
            Motion::Vertices(surface) => &mut surface.points,
        }
    }

    /// What a point is called, for people.
    pub fn noun(&self) -> &'static str {
        match self {
            Motion::Markers(_) => "marker",
            Motion::Skeleton(_) => "joint",
            Motion::Vertices(_) => "vertex",
        }
    }
}

/// Places and turns of the joints of a skeleton, or of segments without a hierarchy, frame by frame.
#[derive(Clone, Debug, Default)]
pub struct SkeletonTake {
    /// The joints; parents come before their children.
    pub joints: Vec<Joint>,
    /// Where the joints are, as trajectories labelled by the joints' names.
    pub origins: MarkerTake,
    /// Frame-major turns of the joints in the capture's axes, as quaternions `x y z w` from the joint's own axes into those of the
    /// capture, `frames × joints`; NaN where the origin is.
    pub rotations: Vec<[f32; 4]>,
    /// What the joints' places and turns at rest are taken from.
    pub rest: Rest,
}

impl SkeletonTake {
    /// Number of joints on the longest way from a root, with both ends; 0 without joints.
    pub fn depth(&self) -> usize {
        let mut depths: Vec<usize> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            depths.push(1 + joint.parent.map_or(0, |p| depths[p]));
        }
        depths.into_iter().max().unwrap_or_default()
    }

    /// Least and largest coordinates of all joints in all frames; infinite where no joint has a place.
    pub fn range(&self) -> (DVec3, DVec3) {
        let places = self.origins.points.iter().filter(|p| !p[0].is_nan()).map(|p| DVec3::from(p.map(f64::from)));
        places.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
    }
}

/// What a rest pose is taken from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Rest {
    /// The file has none: places and turns at rest are NaN.
    #[default]
    Unknown,
    /// The hierarchy with all angles zero: mostly a T-pose, but it need not be a pose that a body can take.
    Hierarchy,
    /// The first frame, which an exporter put before the motion as a pose at rest.
    FirstFrame,
    /// The pose in which a skin was bound to the joints.
    Bind,
}

impl fmt::Display for Rest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Rest::Unknown => "unknown",
            Rest::Hierarchy => "the hierarchy with all angles zero",
            Rest::FirstFrame => "the first frame",
            Rest::Bind => "the pose of the skin",
        })
    }
}

/// A joint at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Its name, unique in the take.
    pub name: String,
    /// Its parent, an earlier joint; `None` for a root.
    pub parent: Option<usize>,
    /// Where it is at rest, in the capture's unit and axes; NaN where the file has no rest.
    pub rest: DVec3,
    /// How it is turned at rest.
    pub rest_turn: DQuat,
    /// Whether it is only the end of a bone and has no turn of its own.
    pub end: bool,
}

/// Vertices of a captured surface: some of them, spread evenly.
#[derive(Clone, Debug, Default)]
pub struct VertexTake {
    /// Their trajectories; any number of the first of them is spread over the whole surface.
    pub points: MarkerTake,
    /// Which vertices of the surface they are.
    pub vertices: Vec<u32>,
    /// Number of all vertices of the surface.
    pub count: usize,
    /// The faces over them.
    pub faces: Faces,
}

/// Trajectories of labelled points, frame by frame.
#[derive(Clone, Debug, Default)]
pub struct MarkerTake {
    /// One label per marker, unique.
    pub labels: Vec<String>,
    /// Frame-major positions in the capture's unit and axes, `frames × labels`; a missing point is NaN.
    pub points: Vec<[f32; 3]>,
}

impl MarkerTake {
    /// Number of markers.
    pub fn markers(&self) -> usize {
        self.labels.len()
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        if self.labels.is_empty() { 0 } else { self.points.len() / self.labels.len() }
    }

    /// Position of a marker in a frame (counted from 0), `None` where it is missing.
    pub fn point(&self, frame: usize, marker: usize) -> Option<DVec3> {
        let p = self.points[frame * self.labels.len() + marker];
        (!p[0].is_nan()).then(|| DVec3::new(p[0].into(), p[1].into(), p[2].into()))
    }
}

/// What cleaning did to a take. Shown as `dropped 3 ghosts, 24 computed points · 212 gaps filled`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cleaning {
    /// Dropped points without a name.
    pub ghosts: usize,
    /// Dropped computed points: angles, forces, axes of segments, joint centres.
    pub computed: usize,
    /// Dropped points of other subjects.
    pub other_subjects: usize,
    /// Dropped markers without a position.
    pub empty: usize,
    /// Copies of a marker, joined with it.
    pub copies: usize,
    /// Markers that shared a label with another and were renamed.
    pub renamed: usize,
    /// Pairs of markers that had exchanged their labels for a time and were put right.
    pub exchanged: usize,
    /// Jumps that were made gaps.
    pub jumps: usize,
    /// Frames without markers cut off the start.
    pub trimmed_start: usize,
    /// Frames without markers cut off the end.
    pub trimmed_end: usize,
    /// Gaps filled.
    pub filled: usize,
    /// Those of them that rigid neighbours filled; the others are interpolated.
    pub filled_from_neighbours: usize,
    /// Positions filled, over all gaps.
    pub filled_positions: usize,
    /// Gaps that were too long to fill; their points stay missing.
    pub left: usize,
}

impl fmt::Display for Cleaning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let some = |n: usize, one: &str, many: &str| (n > 0).then(|| counted(n, one, many));
        let dropped = [
            some(self.ghosts, "ghost", "ghosts"),
            some(self.computed, "computed point", "computed points"),
            some(self.other_subjects, "point of other subjects", "points of other subjects"),
            some(self.empty, "empty marker", "empty markers"),
            some(self.copies, "copy", "copies"),
        ];
        let dropped: Vec<String> = dropped.into_iter().flatten().collect();
        let parts = [
            (!dropped.is_empty()).then(|| format!("dropped {}", dropped.join(", "))),
            some(self.exchanged, "pair of labels exchanged", "pairs of labels exchanged"),
            some(self.jumps, "jump removed", "jumps removed"),
            some(self.filled, "gap filled", "gaps filled"),
            some(self.left, "gap left open", "gaps left open"),
        ];
        f.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(" · "))
    }
}

/// `1 gap`, `2 gaps`.
fn counted(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

/// From an opened file to a clean capture.
fn assemble<R: Read + Seek>(mut file: c3d::C3d<R>, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let mut notes = std::mem::take(&mut file.notes);
    let mut cleaning = Cleaning::default();
    if !file.labelled {
        notes.warn(format!("the file has no labels: its {} points are numbered", file.labels.len()));
        for (n, label) in file.labels.iter_mut().enumerate() {
            *label = format!("M{:03}", n + 1);
        }
    }
    let selection =
        labels::select(&file.labels, &file.computed, &file.subjects, options.subject.as_deref(), &mut cleaning, &mut notes)?;
    let points = file.points(&selection.columns)?;
    notes.extend(std::mem::take(&mut file.notes));
    let mut take = MarkerTake { labels: selection.labels, points };
    let mut first_frame = file.first_frame;
    clean::clean(&mut take, &mut first_frame, file.rate, &mut cleaning, &mut notes)?;
    check_size(clean::size(&take), file.space.unit, &mut notes);

    let only = match &file.subjects[..] {
        [one] => Some(one.clone()),
        _ => None,
    };
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Capture {
        name: selection.subject.or(only).unwrap_or(stem),
        rate: file.rate,
        first_frame,
        space: file.space,
        motion: Motion::Markers(take),
        source: path.to_owned(),
        cleaning,
        notes,
    })
}

/// Warns where the unit makes the body absurdly large or small; the values are left alone.
fn check_size(size: f64, unit: Option<Known<Unit>>, notes: &mut Notes) {
    let Some(unit) = unit else { return };
    let metres = size * unit.value.metres();
    if metres > 20.0 || (metres > 0.0 && metres < 0.01) {
        let unit = unit.value;
        notes.warn(format!("the file says {unit}, but the markers then span {metres:.3} m: the unit is doubtful"));
    }
}
