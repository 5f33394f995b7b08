//! What a run amounted to.

use crate::export::Written;
use crate::report::ReportWriter;
use crate::statistics::Spread;

/// What a run amounted to.
#[derive(Debug, Default)]
pub struct Outcome {
    /// The outputs, in the order of the sinks.
    pub written: Vec<Written>,
    /// The report, still to be finished.
    pub report: Option<ReportWriter>,
    /// Frames written.
    pub frames: usize,
    /// Distances of handles to targets over the take, in millimetres (the scan's unit where unknown).
    pub residuals: Spread,
    /// The worst of them: distance, handle (oriented ones are counted after the others), frame in the capture's own numbering.
    pub worst: Option<(f64, usize, i64)>,
    /// Least and largest volume ratio.
    pub volume: (f64, f64),
    /// Frames with a fold: many inverted tetrahedra or passes.
    pub folds: Frames,
    /// The parts of the body that fold in them, with the number of frames each, most first.
    pub folding: Vec<(&'static str, usize)>,
    /// Frames that were not solved to the tolerance.
    pub unsolved: Frames,
    /// Frames without any marker, where the pose was held.
    pub held: Frames,
    /// Passes of the solver in all.
    pub passes: u64,
    /// Frames found again from the rest pose, since the solver had lost them.
    pub recovered: Frames,
    /// How far the worst of the frames in `unsolved` may be from solved, in diagonals.
    pub unsolved_error: Option<f64>,
    /// What became of the weight of each example.
    pub weights: Vec<WeightRange>,
    /// Milliseconds per stage in all: solve, map, write.
    pub stage_ms: [f64; 3],
    /// Milliseconds that completing the outputs took.
    pub finish_ms: f64,
}

/// How far the weight of an example went, and in how many frames it was there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightRange {
    /// The least.
    pub least: f64,
    /// Frames with it.
    pub at_least: usize,
    /// The largest.
    pub most: f64,
    /// Frames with it.
    pub at_most: usize,
}

impl Default for WeightRange {
    fn default() -> Self {
        Self { least: f64::INFINITY, at_least: 0, most: f64::NEG_INFINITY, at_most: 0 }
    }
}

impl WeightRange {
    pub(super) fn add(&mut self, weight: f64) {
        if weight < self.least {
            (self.least, self.at_least) = (weight, 0);
        }
        if weight > self.most {
            (self.most, self.at_most) = (weight, 0);
        }
        self.at_least += usize::from(weight == self.least);
        self.at_most += usize::from(weight == self.most);
    }
}

/// A set of frames, kept as the first few ranges and a count.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frames {
    ranges: Vec<(i64, i64)>,
    count: usize,
}

impl Frames {
    const SHOWN: usize = 4;

    pub(super) fn add(&mut self, frame: i64) {
        self.count += 1;
        let room = self.ranges.len() <= Self::SHOWN;
        match self.ranges.last_mut() {
            Some(last) if last.1 + 1 == frame => last.1 = frame,
            _ if room => self.ranges.push((frame, frame)),
            _ => {}
        }
    }

    /// How many frames.
    pub fn count(&self) -> usize {
        self.count
    }
}

impl std::fmt::Display for Frames {
    /// `frames 12, 40..44 and others`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.count == 1 { "frame " } else { "frames " })?;
        for (i, (a, b)) in self.ranges.iter().take(Self::SHOWN).enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            if a == b { write!(f, "{comma}{a}")? } else { write!(f, "{comma}{a}..{b}")? }
        }
        if self.ranges.len() > Self::SHOWN { f.write_str(" and others") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_told_as_ranges() {
        let mut frames = Frames::default();
        for f in [3, 4, 5, 9] {
            frames.add(f);
        }
        assert_eq!(frames.to_string(), "frames 3..5, 9");
        for f in [20, 30, 40, 50, 60] {
            frames.add(f);
        }
        assert_eq!(frames.to_string(), "frames 3..5, 9, 20, 30 and others");
        assert_eq!(frames.count(), 9);
    }
}
