//! The choices and numbers that options take.

use crate::binding;
use crate::deform::volumetric::Options;
use crate::export::Encode;
use crate::proxy::rows::MapKind;
use clap::ValueEnum;

/// `--style`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StyleArg {
    /// Parts that meet at a flat round face turn on it
    Mechanism,
    /// They slide on it
    Furniture,
}

impl From<StyleArg> for crate::joints::Style {
    fn from(style: StyleArg) -> Self {
        match style {
            StyleArg::Mechanism => Self::Mechanism,
            StyleArg::Furniture => Self::Furniture,
        }
    }
}

/// `--align`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Align {
    /// Markers: similarity if the scan stands as the actor does in the reference frame, pose if it is his own, else retarget. Skeletons: their joints turn the parts of the scan
    Auto,
    /// The capture already is in the scan's space; only units are converted
    None,
    /// One scale, rotation and shift
    Similarity,
    /// One scale, rotation and shift; attachment points from an articulated fit
    Pose,
    /// Every segment of the scan turns as the actor's does, on the scan's own lengths
    Retarget,
}

/// `--encode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EncodeArg {
    /// A skin, with corrective morph targets where joints no longer help
    Auto,
    /// A skin alone
    Skin,
    /// Morph targets alone, under a node that carries the motion of the whole
    Morph,
}

impl From<EncodeArg> for Encode {
    fn from(encode: EncodeArg) -> Self {
        match encode {
            EncodeArg::Auto => Self::Auto,
            EncodeArg::Skin => Self::Skin,
            EncodeArg::Morph => Self::Morph,
        }
    }
}

/// `--plant`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Plant {
    /// Held where they came down, by the two bones of the leg
    Auto,
    /// As the joints have it
    Off,
}

/// `--map`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Map {
    /// Gradients averaged over the ring of tetrahedra
    Ring,
    /// Stoll et al. 2007, (2.9)-(2.12)
    Paper,
}

impl From<Align> for binding::Align {
    fn from(align: Align) -> Self {
        match align {
            Align::Auto => Self::Auto,
            Align::None => Self::None,
            Align::Similarity => Self::Similarity,
            Align::Pose => Self::Pose,
            Align::Retarget => Self::Retarget,
        }
    }
}

impl From<Map> for MapKind {
    fn from(map: Map) -> Self {
        match map {
            Map::Ring => MapKind::Ring,
            Map::Paper => MapKind::Paper,
        }
    }
}

/// `--quality`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum QualityArg {
    /// For a first look: 99 % of a person within about 1 mm of the converged pose, 3 mm at worst; half the time of default
    Draft,
    /// 99 % within about 0.1 mm, 0.3 mm at worst, where markers are on the whole body; 8 to 9 passes of the solver per frame at 100 to 120 Hz
    Default,
    /// Within about 0.01 mm; two to three times the time of default
    Converged,
}

impl QualityArg {
    /// Largest step of the solver at which a frame counts as solved, in diagonals.
    pub fn tolerance(self) -> f64 {
        match self {
            QualityArg::Draft => Options::DRAFT,
            QualityArg::Default => Options::NORMAL,
            QualityArg::Converged => Options::CONVERGED,
        }
    }
}

/// `--ref`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reference {
    /// The frame nearest to the scan's pose.
    Auto,
    /// This frame, in the capture's own numbering.
    Frame(i64),
}

/// Weights of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights(pub Vec<f64>);

pub(super) fn parse_reference(text: &str) -> Result<Reference, String> {
    if text.eq_ignore_ascii_case("auto") {
        return Ok(Reference::Auto);
    }
    text.parse().map(Reference::Frame).map_err(|_| "expected 'auto' or a frame number".into())
}

pub(super) fn parse_frames(text: &str) -> Result<(i64, i64), String> {
    let (a, b) = text.split_once("..").ok_or("expected A..B, both inclusive, for example 120..480")?;
    let number = |s: &str| s.trim().trim_start_matches('=').parse::<i64>().map_err(|_| format!("'{s}' is not a frame number"));
    let (a, b) = (number(a)?, number(b)?);
    if a > b {
        return Err(format!("the range ends ({b}) before it begins ({a})"));
    }
    Ok((a, b))
}

pub(super) fn parse_finite(text: &str) -> Result<f64, String> {
    text.parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(|| "expected a number".into())
}

pub(super) fn parse_percent(text: &str) -> Result<f64, String> {
    parse_positive(text).ok().filter(|p| *p <= 100.0).ok_or_else(|| "expected a percentage above 0, at most 100".into())
}

pub(super) fn parse_rate(text: &str) -> Result<f64, String> {
    parse_positive(text)
        .ok()
        .filter(|r| (0.01..=1000.0).contains(r))
        .ok_or_else(|| "expected 0.01 to 1000 frames per second".into())
}

pub(super) fn parse_reach(text: &str) -> Result<f64, String> {
    parse_positive(text).ok().filter(|r| (0.01..=10.0).contains(r)).ok_or_else(|| "expected 0.01 to 10 per cent".into())
}

pub(super) fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("expected a positive number".into()),
    }
}

pub(super) fn parse_weights(text: &str) -> Result<Weights, String> {
    let number = |word: &str| word.trim().parse::<f64>().ok().filter(|w| w.is_finite());
    let weights: Option<Vec<f64>> = text.split(',').map(number).collect();
    weights.map(Weights).ok_or_else(|| "expected numbers, separated by commas".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_numbers_are_checked() {
        assert_eq!(parse_frames("1..=3"), Ok((1, 3)));
        assert!(parse_frames("3..1").is_err());
        assert!(parse_frames("7").is_err());
        assert_eq!(parse_reference("279"), Ok(Reference::Frame(279)));
        assert_eq!(parse_weights("0.5, -0.2"), Ok(Weights(vec![0.5, -0.2])));
        assert!(parse_weights("0.5,").is_err() && parse_weights("nan").is_err());
        assert!(parse_positive("-1").is_err() && parse_positive("nan").is_err());
    }
}
