//! What a file of points says beside their places.

use crate::error::Notes;
use crate::space::Space;

/// All that a file says of its points but where they are.
#[derive(Clone, Debug, Default)]
pub(super) struct Head {
    /// One label per point as written, without blanks around it; empty where the file has fewer labels than points.
    pub labels: Vec<String>,
    /// Whether the file has labels at all.
    pub labelled: bool,
    /// Labels listed as angles, forces, moments, powers, scalars or modelled markers.
    pub computed: Vec<String>,
    /// Names of the subjects, where the file lists them.
    pub subjects: Vec<String>,
    /// Frames per second; positive.
    pub rate: f64,
    /// Number of the first frame.
    pub first_frame: i64,
    /// Unit and up axis, where the file says so.
    pub space: Space,
    /// Contradictions and what was believed.
    pub notes: Notes,
}
