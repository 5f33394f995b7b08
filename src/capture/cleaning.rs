//! What cleaning did to a take, in numbers and one by one.

use crate::words;
use std::fmt;

/// A stretch of one marker that was changed or left open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// Label of the marker.
    pub marker: String,
    /// First and last frame, in the capture's own numbering.
    pub frames: (i64, i64),
    /// What was done.
    pub how: How,
}

/// What was done to a stretch of a marker.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum How {
    /// A gap, filled from so many rigid neighbours.
    Filled(usize),
    /// A short gap, filled by a curve between its ends.
    Interpolated,
    /// A gap too long to fill: the marker is missing.
    Released,
    /// Faster than a body moves: made a gap.
    Jump,
    /// Not where its neighbours carry it: made a gap.
    Stray,
    /// Standing still while its neighbours moved: made a gap.
    Stuck,
    /// Its label was exchanged with that of the other.
    Exchanged(String),
    /// Positions of a copy of this label taken in.
    Joined(String),
}

impl How {
    /// One word for programs.
    pub fn word(&self) -> &'static str {
        match self {
            How::Filled(_) => "filled",
            How::Interpolated => "interpolated",
            How::Released => "released",
            How::Jump => "jump",
            How::Stray => "stray",
            How::Stuck => "stuck",
            How::Exchanged(_) => "exchanged",
            How::Joined(_) => "joined",
        }
    }
}

impl Repair {
    /// For people: `RFIN filled 0.42 s from 3 neighbours at 3.1 s`. `rate`: frames per second; `first_frame`: of the capture, second 0.
    pub fn words(&self, rate: f64, first_frame: i64) -> String {
        let (first, last) = self.frames;
        let long = words::seconds_short((last - first + 1) as f64 / rate);
        let at = format!("at {:.1} s (frame {first})", (first - first_frame) as f64 / rate);
        let marker = &self.marker;
        match &self.how {
            How::Filled(n) => format!("{marker} filled {long} from {n} neighbours {at}"),
            How::Interpolated => format!("{marker} interpolated over {long} {at}"),
            How::Released => format!("{marker} released for {long} {at}"),
            How::Jump => format!("{marker} jumps: {long} made a gap {at}"),
            How::Stray => format!("{marker} is not where its neighbours carry it: {long} made a gap {at}"),
            How::Stuck => format!("{marker} stands still while its neighbours move: {long} made a gap {at}"),
            How::Exchanged(other) => format!("{marker} exchanged with {other} for {long} {at}"),
            How::Joined(copy) => format!("{marker} joined with {copy}"),
        }
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
    /// Stretches in which a marker was not where its neighbours carry it, made gaps.
    pub strays: usize,
    /// Stretches in which a marker stood still while its neighbours moved, made gaps.
    pub stuck: usize,
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
    /// All that was changed, marker by marker.
    pub repairs: Vec<Repair>,
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
            some(self.strays, "wrong stretch removed", "wrong stretches removed"),
            some(self.stuck, "stuck stretch removed", "stuck stretches removed"),
            some(self.filled, "gap filled", "gaps filled"),
            some(self.left, "gap left open", "gaps left open"),
        ];
        f.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(" · "))
    }
}

/// `1 gap`, `2 gaps`.
pub(super) fn counted(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}
