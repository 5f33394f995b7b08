//! Capture files → [`Capture`]. One file per format; cleaning in files of its own.

mod acclaim;
mod assemble;
mod bvh;
mod c3d;
mod clean;
mod cleaning;
mod clips;
#[cfg(feature = "fbx")]
mod fbx;
mod format;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz_skeletons;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz_tables;
mod gaps;
mod gltf;
pub mod handles_csv;
mod head;
mod labels;
mod marker_csv;
mod motive_csv;
mod neighbours;
mod number;
pub mod resample;
mod rigid;
mod segments;
mod skeleton;
pub mod smooth;
mod source;
mod strays;
mod swaps;
mod table;
mod trc;
mod triads;
mod turns;
mod vertices;

#[cfg(test)]
#[path = "../../tests/common/c3d_writer.rs"]
mod c3d_writer;
#[cfg(test)]
mod mutants;
#[cfg(test)]
mod skeleton_mutants;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_of_tables;

use crate::error::{Error, Notes, Result};
use crate::scan::Faces;
use crate::space::Space;
pub use cleaning::{Cleaning, How, Repair};

use crate::words;
use cleaning::counted;
use format::Format;
use glam::{DQuat, DVec3};
use std::fmt;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// What to take from a capture file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Subject by its label prefix; `None` takes the one with most markers.
    pub subject: Option<String>,
    /// Frames per second where the file does not say; `None` assumes what is usual in its format.
    pub rate: Option<f64>,
    /// Takes the bones or rigid bodies of a file that holds markers too, and of a glTF file the nodes alone that move meshes.
    pub bodies: bool,
    /// Takes the skinned meshes of a glTF file as a captured surface, instead of their joints.
    pub surface: bool,
    /// Leaves gaps, jumps, copies, empty frames and a rest pose before the motion as they are in the file.
    pub as_found: bool,
    /// Animation by its name, where the file holds several; `None` takes the longest.
    pub clip: Option<String>,
    /// Skeleton of an AMC motion; `None` looks for it beside the motion.
    pub skeleton: Option<PathBuf>,
}

/// Reads and cleans a capture file, also as `.gz`; the format is told by the contents.
///
/// What is doubtful about the file and what cleaning did is in [`Capture::notes`] and [`Capture::cleaning`].
///
/// # Errors
/// Unreadable or broken files, formats that are not read yet, files with nothing to animate, a subject that is not there.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Capture> {
    let format = format::tell(path)?;
    let capture = match format {
        Format::Meshes => vertices::read(path, options.rate),
        Format::Acclaim => acclaim::open(path, options.skeleton.as_deref(), options.rate).map(|file| file.capture(path)),
        Format::C3d if !source::is_packed(path) => c3d::C3d::open(path).and_then(|file| assemble::c3d(file, path, options)),
        format => source::load(path).and_then(|bytes| parse(format, bytes, path, options)),
    };
    let mut capture = capture.map_err(|e| if e.file.is_none() { e.file(path) } else { e }.hint_for_broken_file())?;
    capture.notes.extend(format.not_used(options));
    Ok(capture)
}

/// Reads and cleans a capture that is in memory; `name` stands for the path and helps to tell the format.
///
/// # Errors
/// As [`read`].
pub fn read_bytes(bytes: Vec<u8>, name: &Path, options: &ReadOptions) -> Result<Capture> {
    let bytes = if bytes.starts_with(&source::GZIP) { source::unpack(&bytes)? } else { bytes };
    parse(format::of_bytes(&bytes, name), bytes, name, options).map_err(Error::hint_for_broken_file)
}

fn parse(format: Format, bytes: Vec<u8>, path: &Path, options: &ReadOptions) -> Result<Capture> {
    match format {
        Format::C3d => assemble::c3d(c3d::C3d::parse(Cursor::new(bytes))?, path, options),
        Format::Bvh => {
            let file = bvh::read(&bytes, options.rate)?;
            Ok(if options.as_found { file } else { file.without_rest_row() }.capture(path))
        }
        Format::Gltf => gltf::read(&bytes, &crate::gltf::beside(path), path, options),
        #[cfg(feature = "fbx")]
        Format::Fbx => Ok(fbx::read(&bytes, options.clip.as_deref())?.capture(path)),
        Format::Trc => assemble::table(trc::read(&bytes, options)?, path, options),
        Format::MarkerCsv => assemble::table(marker_csv::read(&bytes, options)?, path, options),
        Format::MotiveCsv => match motive_csv::read(&bytes, options)? {
            motive_csv::Export::Markers(table) => assemble::table(table, path, options),
            motive_csv::Export::Bodies(take, head) => segments::assemble(take, head, path, options),
        },
        other => Err(other.unsupported()),
    }
}

/// A warning for each of the options that says nothing of a file like this one.
pub fn not_used(path: &Path, options: &ReadOptions) -> Notes {
    format::tell(path).map_or_else(|_| Notes::default(), |format| format.not_used(options))
}

/// Whether a file is a table of handles ([`handles_csv`]) and not a capture; told by its first lines.
pub fn is_handle_table(path: &Path) -> bool {
    format::tell(path).map_or_else(|_| source::extension(path) == "csv", |format| format == Format::HandleCsv)
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
        let (low, high) = places.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        (low + self.origins.origin, high + self.origins.origin)
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
    /// The pose in which the file holds its nodes when no animation plays: mostly at rest, but it may be a frame of the motion.
    Nodes,
}

impl fmt::Display for Rest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Rest::Unknown => "unknown",
            Rest::Hierarchy => "the hierarchy with all angles zero",
            Rest::FirstFrame => "the first frame",
            Rest::Bind => "the pose of the skin",
            Rest::Nodes => "the nodes without animation",
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

/// Vertices of a captured surface, which may be of rigid segments: some of them, spread evenly.
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
    /// Frame-major positions from `origin` in the capture's unit and axes, `frames × labels`; a missing point is NaN.
    pub points: Vec<[f32; 3]>,
    /// What the positions count from: zero, but for takes so far away that single precision would lose what they do.
    pub origin: DVec3,
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
        (!p[0].is_nan()).then(|| DVec3::new(p[0].into(), p[1].into(), p[2].into()) + self.origin)
    }

    /// A position as it is stored: counted from the origin.
    pub fn stored(&self, position: DVec3) -> [f32; 3] {
        (position - self.origin).to_array().map(|x| x as f32)
    }
}
