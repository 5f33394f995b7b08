//! Binding × frame → pose of the proxy. The trait speaks of handles, targets and poses; each deformer has a folder.

use crate::error::Result;
use crate::linalg::SparseRow;
use glam::DVec3;

pub mod volumetric;

/// A point of the body that targets pull.
#[derive(Clone, Debug)]
pub struct Handle {
    /// Name of the marker or joint.
    pub name: String,
    /// Where it sits, as a row over proxy vertices; applied to the rest pose it gives the attachment point.
    pub row: SparseRow,
    /// Hardness relative to the body (`volumetric`: `a_h = beta · max L_vv` over the row's vertices). 1 is the default, 0.1 doubtful.
    pub beta: f64,
}

/// Where the handles shall be in one frame; one entry per handle.
#[derive(Clone, Debug, Default)]
pub struct Targets {
    /// Target positions in the unit box of the scan; ignored where presence is 0.
    pub positions: Vec<DVec3>,
    /// 1 where the handle holds with its full weight, 0 where it is released, between while it fades.
    pub presence: Vec<f64>,
}

/// Measures of one solved frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// Evaluations of energy and gradient.
    pub passes: u32,
    /// Largest move of the last preconditioned step, in diagonals.
    pub step: f64,
    /// Whether the tolerance was reached before the cap (always true with a fixed count of iterations).
    pub converged: bool,
    /// Whether the pose had become worthless (not finite) and was found again from the aligned rest pose.
    pub recovered: bool,
    /// The energy of the pose.
    pub energy: f64,
    /// Tetrahedra turned inside out.
    pub inverted: u32,
    /// Volume of the tetrahedra against rest.
    pub volume_ratio: f64,
}

/// Poses a body from handle targets, frame after frame.
pub trait Deformer: Send {
    /// First frame, or a frame after a jump: aligned rigidly to the targets, then solved cold.
    fn start(&mut self, targets: &Targets) -> Result<FrameStats>;

    /// Next frame, warm from the one before.
    fn step(&mut self, targets: &Targets) -> Result<FrameStats>;

    /// Points of the proxy after the last frame, in the unit box.
    fn pose(&self) -> &[DVec3];
}
