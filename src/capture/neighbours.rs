//! Markers that move with a marker: those that keep their distance to it.

use super::MarkerTake;
use crate::statistics::middle;
use glam::DVec3;
use std::ops::Range;

/// A neighbour is nearer than this share of the body.
const NEAR: f64 = 0.4;
/// The distance to a neighbour deviates by no more than this share of the body over the take.
const RIGID: f64 = 0.03;
/// The search is quadratic in the markers; no body wears more.
const MOST_MARKERS: usize = 2000;

/// Which positions were measured: one bit each, since filling overwrites the points.
pub(super) struct Present {
    bits: Vec<u64>,
    markers: usize,
    /// Frames of the take.
    pub(super) frames: usize,
}

impl Present {
    pub(super) fn of(take: &MarkerTake) -> Self {
        let mut bits = vec![0; take.points.len().div_ceil(64)];
        for (i, p) in take.points.iter().enumerate() {
            bits[i / 64] |= u64::from(!p[0].is_nan()) << (i % 64);
        }
        Self { bits, markers: take.markers(), frames: take.frames() }
    }

    pub(super) fn has(&self, frame: usize, marker: usize) -> bool {
        let i = frame * self.markers + marker;
        self.bits[i / 64] >> (i % 64) & 1 == 1
    }

    /// From now on a position counts as missing.
    pub(super) fn clear(&mut self, frame: usize, marker: usize) {
        let i = frame * self.markers + marker;
        self.bits[i / 64] &= !(1 << (i % 64));
    }

    pub(super) fn throughout(&self, frames: Range<usize>, marker: usize) -> bool {
        frames.into_iter().all(|f| self.has(f, marker))
    }

    pub(super) fn gaps(&self, marker: usize) -> Vec<Range<usize>> {
        let mut gaps = Vec::new();
        let mut start = None;
        for frame in 0..self.frames {
            match (self.has(frame, marker), start) {
                (false, None) => start = Some(frame),
                (true, Some(s)) => {
                    gaps.push(s..frame);
                    start = None;
                }
                _ => {}
            }
        }
        gaps.extend(start.map(|s| s..self.frames));
        gaps
    }
}

/// A position that is known to be there.
pub(super) fn at(take: &MarkerTake, frame: usize, marker: usize) -> DVec3 {
    let [x, y, z] = take.points[frame * take.markers() + marker];
    DVec3::new(x.into(), y.into(), z.into())
}

/// Markers that keep their distance to this one, the steadiest first.
pub(super) fn steady(take: &MarkerTake, present: &Present, marker: usize, size: f64) -> Vec<usize> {
    steady_by(take, present, marker, size, |distances| {
        let (mut n, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for d in &*distances {
            n += 1.0;
            let change = d - mean;
            mean += change / n;
            squares += change * (d - mean);
        }
        (mean, (squares / f64::max(n, 1.0)).sqrt())
    })
}

/// Markers that keep their distance to this one in most of the take, whatever they do in the rest; the steadiest first.
pub(super) fn mostly_steady(take: &MarkerTake, present: &Present, marker: usize, size: f64) -> Vec<usize> {
    steady_by(take, present, marker, size, |distances| {
        let n = distances.len();
        let median = middle(distances).unwrap_or(0.0);
        distances.iter_mut().for_each(|d| *d = (*d - median).abs());
        (median, *distances.select_nth_unstable_by(7 * n / 10, f64::total_cmp).1)
    })
}

/// `spread`: middle and deviation of distances, of which there is at least one.
fn steady_by(
    take: &MarkerTake,
    present: &Present,
    marker: usize,
    size: f64,
    spread: impl Fn(&mut [f64]) -> (f64, f64),
) -> Vec<usize> {
    const SAMPLES: usize = 200;
    const FEWEST: usize = 5;
    if take.markers() > MOST_MARKERS {
        return Vec::new();
    }
    let step = (present.frames / SAMPLES).max(1);
    let frames: Vec<usize> = (0..present.frames).step_by(step).filter(|f| present.has(*f, marker)).collect();
    let mut distances = Vec::with_capacity(frames.len());
    let mut steady: Vec<(f64, usize)> = (0..take.markers())
        .filter(|other| *other != marker)
        .filter_map(|other| {
            distances.clear();
            let both = frames.iter().filter(|f| present.has(**f, other));
            distances.extend(both.map(|f| at(take, *f, marker).distance(at(take, *f, other))));
            if distances.len() < FEWEST {
                return None;
            }
            let (middle, deviation) = spread(&mut distances);
            (middle < NEAR * size && deviation <= RIGID * size).then_some((deviation, other))
        })
        .collect();
    steady.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    steady.into_iter().map(|(_, other)| other).collect()
}
