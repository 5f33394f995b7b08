//! Binding × frame → pose of the proxy. The trait speaks of handles, targets and poses; each deformer has a folder.

use crate::error::{Error, Result};
use crate::linalg::SparseRow;
use glam::{DQuat, DVec3};

pub mod joints;
pub mod shells;
pub mod volumetric;

/// A point of the body that targets pull.
#[derive(Clone, Debug)]
pub struct Handle {
    /// Name of the marker or joint.
    pub name: String,
    /// Where it sits, as a row over proxy vertices; applied to the rest pose it gives the attachment point.
    pub row: SparseRow,
    /// Hardness relative to the body (`volumetric`: `a_h = 2 beta Σ |b_v| L_vv` over the row's coefficients). 1 is the default,
    /// 0.1 doubtful.
    pub beta: f64,
}

/// A place of the body that targets move and turn.
#[derive(Clone, Debug)]
pub struct OrientedHandle {
    /// Name, for messages.
    pub name: String,
    /// The point that targets move, at rest: inside, on or outside the body.
    pub rest: DVec3,
    /// How it holds the body.
    pub grip: Grip,
}

/// How an oriented handle holds the body.
#[derive(Clone, Debug)]
pub enum Grip {
    /// By virtual points that pull: rows of an origin and of the ends of three axes, not in one plane.
    Frame {
        /// Rows over proxy vertices; applied to the rest pose they give the four points.
        rows: [SparseRow; 4],
        /// As [`Handle::beta`].
        beta: f64,
    },
    /// By vertices of the proxy that are pulled.
    Region {
        /// Vertices of the proxy, each once.
        vertices: Vec<u32>,
        /// As [`Handle::beta`].
        beta: f64,
    },
    /// By vertices of the proxy that are where the handle puts them, to rounding. With one vertex the orientation means nothing. Released
    /// (presence 0), they stay where they are.
    Exact {
        /// Vertices of the proxy, each once, and in no other exact grip.
        vertices: Vec<u32>,
    },
}

/// Where an oriented handle shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Of the point that is [`OrientedHandle::rest`] at rest, in the unit box of the scan.
    pub position: DVec3,
    /// Turn from rest.
    pub orientation: DQuat,
    /// As [`Targets::presence`].
    pub presence: f64,
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
    /// About how far the worst vertex is from the minimum of the energy, in diagonals, as measured with every handle present. `None` with a fixed count of iterations, whose
    /// steps tell nothing of it.
    pub error: Option<f64>,
    /// Whether the tolerance was reached before the cap (always true with a fixed count of iterations).
    pub converged: bool,
    /// Whether the pose had become worthless (not finite; or much of it inside out) and was found again from the aligned rest pose, or a shell found a better one from another start.
    pub recovered: bool,
    /// The energy of the pose.
    pub energy: f64,
    /// Tetrahedra turned inside out.
    pub inverted: u32,
    /// Where the one of them with the most volume is at rest, in the unit box.
    pub fold: Option<DVec3>,
    /// Volume of the tetrahedra against rest.
    pub volume_ratio: f64,
    /// Of things with joints: how far these were from what they allow, before they were made exact.
    pub violation: Option<joints::Violation>,
}

/// The error of a pose over the last step of the solver that a tolerance counts on.
pub(crate) const ERROR_PER_STEP: f64 = 20.0;

/// Poses a body from handle targets, frame after frame.
pub trait Deformer: Send {
    /// First frame, or a frame after a jump: aligned rigidly to the targets, then solved cold.
    fn start(&mut self, targets: &Targets) -> Result<FrameStats>;

    /// Next frame, warm from the one before.
    fn step(&mut self, targets: &Targets) -> Result<FrameStats>;

    /// Where the oriented handles shall be from the next frame on; one entry per oriented handle.
    ///
    /// # Errors
    /// [`crate::error::Kind::Refused`] when the deformer has no such handles or a placement is not finite.
    fn place(&mut self, placements: &[Placement]) -> Result<()> {
        if placements.is_empty() {
            return Ok(());
        }
        Err(Error::refused(format!("{} placements", placements.len())).expected("none: this deformer has no oriented handles"))
    }

    /// Points of the proxy after the last frame, in the unit box.
    fn pose(&self) -> &[DVec3];

    /// Weights of the examples after the last frame; none where there are no examples.
    fn weights(&self) -> &[f64] {
        &[]
    }
}
