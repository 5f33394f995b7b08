//! Capture files → [`Capture`]. One file per format; cleaning in files of its own.

use crate::error::Notes;
use crate::space::Space;
use glam::DVec3;
use std::path::PathBuf;

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
    /// What was doubtful about the file, and what cleaning did.
    pub notes: Notes,
}

/// What a capture holds.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Motion {
    /// Trajectories of points on the surface.
    Markers(MarkerTake),
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
