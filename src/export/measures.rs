//! What is measured of frames on their way out: for the report, and for the outputs that show it.

use crate::deform::FrameStats;
use glam::DVec3;
use serde_json::{Value, json};

/// How far the handles of one frame stayed from their targets, in millimetres (in the scan's unit where that is unknown).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residual {
    /// Median over the handles present.
    pub median: f64,
    /// The largest.
    pub max: f64,
    /// The handle of the largest; `None` if none was present.
    pub worst: Option<usize>,
}

/// Everything measured about one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameMeasure {
    /// Frame in the capture's own numbering.
    pub frame: i64,
    /// The solver's measures.
    pub stats: FrameStats,
    /// Distance of handles to targets.
    pub residual: Residual,
    /// About how far the worst vertex is from the converged pose, in the unit of the residual; `None` with a fixed count of iterations, whose steps
    /// tell nothing of it.
    pub error: Option<f64>,
    /// Milliseconds of the solve.
    pub solve_ms: f64,
}

/// What was measured of some consecutive frames, and where their handles are and should be.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// One per frame.
    pub frames: &'a [FrameMeasure],
    /// Names of the handles; those that turn come after the others.
    pub names: &'a [String],
    /// Names of the examples, if there are any.
    pub examples: &'a [String],
    /// A weight for each of them, one array per frame.
    pub weights: &'a [Vec<f64>],
    /// Where the handles hold the body at rest, in the unit box.
    pub rest: &'a [DVec3],
    /// Where they hold it, in the unit box, one array per frame.
    pub holds: &'a [Vec<DVec3>],
    /// Where they should be, in the unit box, one array per frame; not a number where one is missing.
    pub targets: &'a [Vec<DVec3>],
    /// Length of the scan's unit in metres, if known: residuals are in millimetres then, in the scan's unit otherwise.
    pub metres: Option<f64>,
}

/// Six significant digits: more is noise, and shorter lines.
pub(crate) fn rounded(x: f64) -> Value {
    if !x.is_finite() {
        return Value::Null;
    }
    json!(format!("{x:.5e}").parse::<f64>().unwrap_or(x))
}
