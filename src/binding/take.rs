//! A capture whose labels are read.

use super::labels::{self, Names};
use super::segments::Skeleton;
use super::track::Track;
use super::{Options, sides};
use crate::capture::Capture;

/// A capture with its labels read.
pub(super) struct Take<'a> {
    pub capture: &'a Capture,
    pub track: Track<'a>,
    pub names: Names,
    /// How markers were told where their labels say nothing or are wrong.
    pub remarks: Vec<String>,
}

impl<'a> Take<'a> {
    pub(super) fn of(capture: &'a Capture, options: &Options) -> Self {
        let take = capture.motion.points();
        let track = Track { take, mirror: options.mirror };
        let names = labels::name(&take.labels, &track.coverage(), options.swap_sides);
        let mut out = Self { capture, track, names, remarks: Vec::new() };
        out.correct(options, None);
        out
    }

    /// Takes what the user says of markers.
    pub(super) fn correct(&mut self, options: &Options, body: Option<&Skeleton>) {
        self.names.correct(&self.track.take.labels, &options.markers, body);
    }

    /// Takes the markers of pairs for each other that have left and right exchanged, but for those that the user speaks of.
    pub(super) fn exchange_sides(&mut self, options: &Options) {
        for (left, right) in sides::exchanged(&self.track, &self.names) {
            let (a, b) = (self.label(left), self.label(right));
            if !options.markers.contains_key(a) && !options.markers.contains_key(b) {
                self.remarks.push(format!("{a} and {b} have left and right exchanged throughout: taken for each other"));
                self.names.places.swap(left, right);
            }
        }
    }

    pub(super) fn range(&self) -> (i64, i64) {
        let first = self.capture.first_frame;
        (first, first + self.track.take.frames() as i64 - 1)
    }

    pub(super) fn label(&self, marker: usize) -> &str {
        &self.track.take.labels[marker]
    }

    /// The marker of `other` that is this take's `marker`: the same place, or the same label.
    pub(super) fn twin(&self, marker: usize, other: &Take<'_>) -> Option<usize> {
        let by_place = self.names.places[marker]
            .as_ref()
            .filter(|p| !p.is_nameless())
            .and_then(|p| other.names.iter().find(|(_, q)| q.landmark == p.landmark && q.side == p.side).map(|(i, _)| i));
        by_place.or_else(|| other.track.take.labels.iter().position(|l| l == self.label(marker)))
    }
}
