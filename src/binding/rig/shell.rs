//! What a rig file says of shells.

use super::is_default;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// `[solver.shell]`: how a shell is solved, as the options of the same names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShellSection {
    /// λ, μ and ν.
    #[serde(skip_serializing_if = "is_default")]
    pub weights: Option<[f64; 3]>,
    /// Whether λ, μ and ν are those of the paper, by edges.
    #[serde(skip_serializing_if = "is_default")]
    pub paper: bool,
    /// Per cent of the diagonal.
    #[serde(skip_serializing_if = "is_default")]
    pub thickness: Option<f64>,
    /// How far the weights of examples may go.
    #[serde(skip_serializing_if = "is_default")]
    pub weight_range: Option<Range>,
    /// Whether edges that change much in the examples are softer.
    #[serde(skip_serializing_if = "is_default")]
    pub learn_stiffness: bool,
}

/// `weight_range` in `[solver.shell]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Range {
    /// Anywhere.
    Free,
    /// −0.2 to 1.2.
    Box,
    /// 0 to 1.
    Convex,
}

impl ShellSection {
    /// Checks that its numbers are usable and do not contradict each other.
    pub(super) fn check(&self) -> Result<()> {
        let fail = |what: String, expected: &str| Err(Error::malformed(what).at("[solver.shell]").expected(expected.to_owned()));
        if let Some([stretching, bending, volume]) = self.weights
            && !(stretching > 0.0
                && bending > 0.0
                && volume >= 0.0
                && [stretching, bending, volume].iter().all(|w| w.is_finite()))
        {
            return fail(
                format!("weights = {:?}", [stretching, bending, volume]),
                "[stretching, bending, volume]: the first two above 0, the third at least 0",
            );
        }
        if let Some(thickness) = self.thickness.filter(|t| !(t.is_finite() && *t > 0.0)) {
            return fail(format!("thickness = {thickness}"), "per cent of the diagonal, above 0");
        }
        if [self.weights.is_some(), self.paper, self.thickness.is_some()].iter().filter(|given| **given).count() > 1 {
            return fail("more than one of weights, paper and thickness".into(), "one of them");
        }
        Ok(())
    }
}
