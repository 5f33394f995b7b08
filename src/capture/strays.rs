//! Markers that are not where their neighbours carry them: ghosts under the label of a marker, and markers that stand still while the body moves.

use super::MarkerTake;
use super::neighbours::{Present, at, mostly_steady};
use super::rigid::{self, Motion};
use glam::{DVec3, Vec3};
use std::ops::Range;

/// Neighbours that carry a marker: one of them may be wrong itself.
const NEIGHBOURS: usize = 5;
/// Neighbours spread at least this share of the body across their longest direction, else their rotation is arbitrary.
const SPREAD: f64 = 0.01;
/// A stretch begins where a marker leaves its neighbours by this share of the body in one frame, or after a gap.
const STEP: f64 = 0.015;
/// A stretch is wrong where its marker is farther from where the neighbours carry it than this share of the body, and than so many times
/// what it and they deviate by elsewhere.
const OFF: f64 = 0.03;
const TIMES: f64 = 3.0;
/// Longest time, in seconds, without sight of the marker before and after a stretch that is compared with what surrounds it.
const BESIDE: f64 = 0.1;
/// Parts between steps that a wrong stretch may fall into.
const PARTS: usize = 3;
/// A marker that is wrong in a larger share of its frames has no neighbours to speak of.
const MOST: f64 = 0.35;
/// Frames of the whole take, and of a stretch, that a marker is compared in.
const SAMPLES: usize = 60;
const LOOKS: usize = 9;
/// Shortest time, in seconds, to the last digit in one place, and how far, as a share of the body, the neighbours go in it.
const STILL: f64 = 0.05;
const CARRIED: f64 = 0.02;
const CARRIED_FAR: f64 = 0.1;
/// Share of that way that the marker takes at once when it moves again.
const CATCH_UP: f64 = 0.5;
/// The search is quadratic in the markers.
const MOST_MARKERS: usize = 500;

/// Stretches of markers in frames counted from 0.
pub(super) type Stretches = Vec<(usize, Range<usize>)>;

/// Stretches in which a marker stands still to the last digit while its neighbours carry it elsewhere.
pub(super) fn stuck(take: &MarkerTake, rate: f64, size: f64) -> Stretches {
    let (markers, frames) = (take.markers(), take.frames());
    let mut still = still(take, ((STILL * rate).ceil() as usize).max(3));
    if still.is_empty() {
        return still;
    }
    // Where it stands still it says nothing of its neighbours.
    let mut moving = Present::of(take);
    still.iter().for_each(|(m, span)| span.clone().for_each(|f| moving.clear(f, *m)));
    let Some(neighbours) = Neighbours::of(take, moving, size) else { return Vec::new() };
    let neighbours = Neighbours { present: Present::of(take), ..neighbours };
    // A foot on the floor and a hand on a bar stand still too, in takes of few digits; but they are not carried far, and do not catch up in one
    // step afterwards.
    still.retain(|(m, span)| {
        let here = at(take, span.start, *m);
        let carried = |frame| Some(neighbours.motion(take, *m, span.start, frame)?.apply(here).distance(here));
        let freed = span.end == frames || take.points[span.end * markers + m][0].is_nan();
        let caught_up = |way: f64| way > CARRIED * size && (freed || at(take, span.end, *m).distance(here) > CATCH_UP * way);
        carried(span.end - 1).is_some_and(caught_up)
            || spread(span, LOOKS).into_iter().filter_map(carried).any(|way| way > CARRIED_FAR * size)
    });
    still.sort_by_key(|(m, span)| (*m, span.start));
    still
}

/// Stretches in which a marker has one place to the last digit.
fn still(take: &MarkerTake, shortest: usize) -> Stretches {
    let (markers, frames) = (take.markers(), take.frames());
    let mut since = vec![0; markers];
    let mut still = Stretches::new();
    for f in 1..=frames {
        for (m, since) in since.iter_mut().enumerate() {
            // What is missing is never the same.
            let same = f < frames && take.points[f * markers + m] == take.points[(f - 1) * markers + m];
            if !same {
                if f - *since >= shortest {
                    still.push((m, *since..f));
                }
                *since = f;
            }
        }
    }
    still
}

/// Stretches between gaps and sudden steps in which a marker is not where its neighbours carry it.
pub(super) fn wrong(take: &MarkerTake, rate: f64, size: f64) -> Stretches {
    let Some(neighbours) = Neighbours::of(take, Present::of(take), size) else { return Vec::new() };
    let steps = neighbours.steps(take);
    let judged = |(marker, steps): (usize, Vec<usize>)| neighbours.judge(take, marker, &steps, rate);
    steps.into_iter().enumerate().filter(|(marker, _)| neighbours.of[*marker].len() >= 3).flat_map(judged).collect()
}

/// Neighbours of all markers, the steadiest first.
struct Neighbours {
    of: Vec<Vec<usize>>,
    present: Present,
    size: f64,
}

impl Neighbours {
    /// `None` for takes that are too short, or of too few or too many markers.
    fn of(take: &MarkerTake, present: Present, size: f64) -> Option<Self> {
        const FEWEST_FRAMES: usize = 10;
        let markers = take.markers();
        if !(4..=MOST_MARKERS).contains(&markers) || take.frames() < FEWEST_FRAMES || size <= 0.0 {
            return None;
        }
        let of = (0..markers)
            .map(|marker| {
                let mut near = mostly_steady(take, &present, marker, size);
                near.truncate(NEIGHBOURS);
                near
            })
            .collect();
        Some(Self { of, present, size })
    }

    /// How those neighbours move from one frame to another that are there in both, where they are enough to carry a marker.
    fn motion(&self, take: &MarkerTake, marker: usize, from: usize, to: usize) -> Option<Motion> {
        let there = self.of[marker].iter().filter(|n| self.present.has(from, **n) && self.present.has(to, **n));
        let (from, to): (Vec<DVec3>, Vec<DVec3>) = there.map(|n| (at(take, from, *n), at(take, to, *n))).unzip();
        self.enough(&from).then(|| Motion::fit(&from, &to))
    }

    /// How far the marker is in one frame from where its neighbours carry it from another.
    fn apart(&self, take: &MarkerTake, marker: usize, from: usize, to: usize) -> Option<f64> {
        Some(self.motion(take, marker, from, to)?.apply(at(take, from, marker)).distance(at(take, to, marker)))
    }

    fn enough(&self, places: &[DVec3]) -> bool {
        places.len() >= 3 && rigid::width(places) > SPREAD * self.size
    }

    /// Frames of each marker in which it has left its neighbours at once.
    fn steps(&self, take: &MarkerTake) -> Vec<Vec<usize>> {
        let (markers, frames) = (take.markers(), take.frames());
        let limit = (STEP * self.size) as f32;
        let mut steps = vec![Vec::new(); markers];
        let mut moved = vec![Vec3::NAN; markers];
        for f in 1..frames {
            let (before, now) = (&take.points[(f - 1) * markers..][..markers], &take.points[f * markers..][..markers]);
            for (moved, (a, b)) in moved.iter_mut().zip(before.iter().zip(now)) {
                *moved = Vec3::from(*b) - Vec3::from(*a);
            }
            for (m, neighbours) in self.of.iter().enumerate() {
                let [a, b, c, ..] = neighbours[..] else { continue };
                // Three of them are enough for a first look; where one is missing the second look decides.
                let left = moved[m] - (moved[a] + moved[b] + moved[c]) / 3.0;
                if left.length_squared() <= limit * limit || moved[m].is_nan() {
                    continue;
                }
                if self.present.has(f - 1, m)
                    && self.present.has(f, m)
                    && self.apart(take, m, f - 1, f).is_none_or(|far| far > STEP * self.size)
                {
                    steps[m].push(f);
                }
            }
        }
        steps
    }

    fn judge(&self, take: &MarkerTake, marker: usize, steps: &[usize], rate: f64) -> Stretches {
        let parts = self.parts(marker, steps);
        if parts.len() < 2 {
            return Vec::new();
        }
        let most = (MOST * parts.iter().map(ExactSizeIterator::len).sum::<usize>() as f64) as usize;
        let mut wrong = vec![false; parts.len()];
        for count in 1..=PARTS {
            for first in 1..parts.len().saturating_sub(count) {
                let group = first..first + count;
                if parts[group.clone()].iter().map(ExactSizeIterator::len).sum::<usize>() <= most
                    && !wrong[first - 1..=group.end].contains(&true)
                    && self.differs(take, marker, &parts[first - 1..=group.end], rate)
                {
                    wrong[group].fill(true);
                }
            }
        }
        if let Some(shape) = self.shape(take, marker) {
            let samples: Vec<(usize, f64)> =
                shape.samples.iter().filter_map(|&f| Some((f, self.off(take, marker, &shape, f)?.0))).collect();
            for (wrong, part) in wrong.iter_mut().zip(&parts).filter(|(wrong, part)| !**wrong && part.len() <= most) {
                *wrong = self.is_off(take, marker, &shape, &samples, part);
            }
        }
        let wrong: Vec<Range<usize>> = parts.into_iter().zip(wrong).filter(|(_, wrong)| *wrong).map(|(part, _)| part).collect();
        if wrong.iter().map(ExactSizeIterator::len).sum::<usize>() > most {
            return Vec::new();
        }
        let mut joined: Stretches = Vec::new();
        for part in wrong {
            match joined.last_mut() {
                Some((_, last)) if last.end == part.start => last.end = part.end,
                _ => joined.push((marker, part)),
            }
        }
        joined
    }

    /// What lies between the gaps of a marker and the given frames.
    fn parts(&self, marker: usize, steps: &[usize]) -> Vec<Range<usize>> {
        let gaps = self.present.gaps(marker);
        let mut cuts: Vec<usize> = steps.iter().copied().chain(gaps.iter().flat_map(|gap| [gap.start, gap.end])).collect();
        cuts.extend([0, self.present.frames]);
        cuts.sort_unstable();
        cuts.dedup();
        cuts.windows(2).map(|cut| cut[0]..cut[1]).filter(|part| self.present.has(part.start, marker)).collect()
    }

    /// Whether a marker leaves its neighbours where the parts between begin, and is back where they end: they carry it from the first part to
    /// the last one, or the two steps cancel, seen from the room or from the neighbours.
    fn differs(&self, take: &MarkerTake, marker: usize, parts: &[Range<usize>], rate: f64) -> bool {
        let (before, start) = (parts[0].end - 1, parts[1].start);
        let (end, after) = (parts[parts.len() - 2].end - 1, parts[parts.len() - 1].start);
        let beside = (BESIDE * rate) as usize + 1;
        if start - before > beside || after - end > beside {
            return false;
        }
        let step = |from: usize, to: usize| {
            Some(at(take, to, marker) - self.motion(take, marker, from, to)?.apply(at(take, from, marker)))
        };
        let (Some(into), Some(out)) = (step(before, start), step(end, after)) else { return false };
        let least = into.length().min(out.length());
        if least <= OFF * self.size {
            return false;
        }
        let here = at(take, start, marker);
        let turned = self.motion(take, marker, start, end).map(|motion| motion.apply(here + into) - motion.apply(here));
        step(before, after).is_some_and(|across| across.length() < 0.5 * least)
            || [Some(into), turned].into_iter().flatten().any(|into| (into + out).length() < 0.5 * least)
    }

    /// Whether a marker is elsewhere in a part of the take than its neighbours carry it in the rest.
    fn is_off(&self, take: &MarkerTake, marker: usize, shape: &Shape, samples: &[(usize, f64)], part: &Range<usize>) -> bool {
        let mut usual: Vec<f64> = samples.iter().filter(|(f, _)| !part.contains(f)).map(|s| s.1).collect();
        let Some(usual) = quantile(&mut usual, 0.9) else { return false };
        let limit = (TIMES * usual).max(OFF * self.size);
        let looks = spread(part, LOOKS).into_iter().filter_map(|f| self.off(take, marker, shape, f));
        let mut off: Vec<f64> = looks.map(|(off, others)| if off > TIMES * others { off } else { 0.0 }).collect();
        quantile(&mut off, 0.5).is_some_and(|off| off > limit)
    }

    /// Where a marker usually is among its neighbours.
    fn shape(&self, take: &MarkerTake, marker: usize) -> Option<Shape> {
        const BASES: usize = 7;
        let neighbours = &self.of[marker];
        let all = |f: &usize| self.present.has(*f, marker) && neighbours.iter().all(|n| self.present.has(*f, *n));
        let step = (self.present.frames / SAMPLES).max(1);
        let samples: Vec<usize> = (0..self.present.frames).step_by(step).filter(all).collect();
        let places = |f: usize| neighbours.iter().map(|n| at(take, f, *n)).collect::<Vec<_>>();
        // Any one frame may be a bad one: the one that the others agree with best is taken.
        let mut best: Option<(f64, Shape)> = None;
        for base in spread(&(0..samples.len()), BASES) {
            let base = samples[base];
            let rest = places(base);
            if !self.enough(&rest) {
                continue;
            }
            let inside = samples.iter().map(|&f| Motion::fit(&places(f), &rest).apply(at(take, f, marker)));
            let mut axes: [Vec<f64>; 3] = Default::default();
            inside.for_each(|p| axes.iter_mut().zip(p.to_array()).for_each(|(axis, x)| axis.push(x)));
            let [x, y, z] = axes.each_mut().map(|axis| quantile(axis, 0.5));
            let own = DVec3::new(x?, y?, z?);
            let apart: f64 =
                axes.iter().zip(own.to_array()).map(|(axis, m)| axis.iter().map(|x| (x - m).abs()).sum::<f64>()).sum();
            if best.as_ref().is_none_or(|(b, _)| apart < *b) {
                best = Some((apart, Shape { neighbours: rest, own, samples: Vec::new() }));
            }
        }
        best.map(|(_, shape)| Shape { samples, ..shape })
    }

    /// How far a marker is from where its neighbours carry it, and how far they are from keeping their own shape. A single neighbour that is
    /// wrong itself is left out.
    fn off(&self, take: &MarkerTake, marker: usize, shape: &Shape, frame: usize) -> Option<(f64, f64)> {
        let there = self.of[marker].iter().zip(&shape.neighbours).filter(|(n, _)| self.present.has(frame, **n));
        let (rest, now): (Vec<DVec3>, Vec<DVec3>) = there.map(|(n, rest)| (*rest, at(take, frame, *n))).unzip();
        let here = at(take, frame, marker);
        let look = |rest: &[DVec3], now: &[DVec3]| {
            let motion = self.enough(rest).then(|| Motion::fit(rest, now))?;
            let squares: f64 = rest.iter().zip(now).map(|(a, b)| motion.apply(*a).distance_squared(*b)).sum();
            Some((motion.apply(shape.own).distance(here), (squares / rest.len() as f64).sqrt()))
        };
        let mut best = look(&rest, &now)?;
        if best.0 > OFF * self.size {
            for left_out in 0..rest.len() {
                let without = |places: &[DVec3]| [&places[..left_out], &places[left_out + 1..]].concat();
                if let Some(other) = look(&without(&rest), &without(&now)).filter(|other| other.0 < best.0) {
                    best = other;
                }
            }
        }
        Some(best)
    }
}

struct Shape {
    /// Places of the neighbours.
    neighbours: Vec<DVec3>,
    /// Where the marker is among them.
    own: DVec3,
    /// Frames in which all are there.
    samples: Vec<usize>,
}

/// At most so many numbers, evenly out of a range.
fn spread(range: &Range<usize>, most: usize) -> Vec<usize> {
    let n = range.len().min(most);
    (0..n).map(|k| range.start + (2 * k + 1) * range.len() / (2 * n)).collect()
}

fn quantile(values: &mut [f64], q: f64) -> Option<f64> {
    let at = (q * values.len().checked_sub(1)? as f64) as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const RATE: f64 = 100.0;
    const SIZE: f64 = 800.0;

    /// Two rigid bodies of six markers, hinged like an elbow, that tumble along.
    fn tumbling(frames: usize) -> MarkerTake {
        let body = [[0, 0, 0], [120, 0, 0], [0, 90, 0], [0, 0, 140], [70, 60, 50], [20, 80, 110]]
            .map(|p: [i32; 3]| DVec3::from(p.map(f64::from)));
        let mut points = Vec::new();
        for f in 0..frames {
            let t = f as f64 / RATE;
            let turn = glam::DQuat::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 2.0 * t);
            let bent = glam::DQuat::from_axis_angle(DVec3::X, 0.8 * (3.0 * t).sin());
            let shift = DVec3::new(800.0 * t, 100.0 * (3.0 * t).sin(), 900.0);
            points.extend(body.map(|p| (turn * p + shift).as_vec3().to_array()));
            points.extend(body.map(|p| (turn * (bent * p + DVec3::Z * 300.0) + shift).as_vec3().to_array()));
        }
        MarkerTake { labels: (0..12).map(|m| format!("m{m}")).collect(), points, ..MarkerTake::default() }
    }

    fn shift(take: &mut MarkerTake, marker: usize, frames: Range<usize>, by: f32) {
        frames.for_each(|f| take.points[f * 12 + marker][1] += by);
    }

    fn hide(take: &mut MarkerTake, marker: usize, frames: Range<usize>) {
        frames.for_each(|f| take.points[f * 12 + marker] = [f32::NAN; 3]);
    }

    #[test]
    fn a_ghost_between_two_gaps_is_found_and_its_neighbours_are_not_blamed() {
        let take = tumbling(400);
        assert_eq!((wrong(&take, RATE, SIZE), stuck(&take, RATE, SIZE)), (vec![], vec![]));
        for (marker, frames) in [(1, 150..210), (9, 20..70), (4, 0..60), (11, 350..400)] {
            let mut take = tumbling(400);
            shift(&mut take, marker, frames.clone(), 60.0);
            assert_eq!(wrong(&take, RATE, SIZE), [(marker, frames.clone())], "by its steps");
            hide(&mut take, marker, frames.start.saturating_sub(3)..frames.start);
            hide(&mut take, marker, frames.end..(frames.end + 3).min(400));
            assert_eq!(wrong(&take, RATE, SIZE), [(marker, frames)], "between gaps");
        }
        // Less than 3 % of the body is soft tissue.
        let mut soft = tumbling(400);
        shift(&mut soft, 1, 150..210, 18.0);
        assert_eq!(wrong(&soft, RATE, SIZE), []);
    }

    #[test]
    fn a_ghost_of_a_marker_that_sways_anyway_is_found_by_its_steps() {
        let swaying = || {
            let mut take = tumbling(400);
            (0..400).for_each(|f| shift(&mut take, 1, f..f + 1, 30.0 * (0.01 * f as f32).sin()));
            take
        };
        assert_eq!(wrong(&swaying(), RATE, SIZE), []);
        let mut take = swaying();
        shift(&mut take, 1, 150..210, 60.0);
        assert_eq!(wrong(&take, RATE, SIZE), [(1, 150..210)]);
        // Once out and not back is another pose.
        let mut take = swaying();
        shift(&mut take, 1, 280..400, 60.0);
        assert_eq!(wrong(&take, RATE, SIZE), []);
    }

    #[test]
    fn a_marker_that_is_wrong_for_most_of_the_take_is_left_alone() {
        let mut take = tumbling(400);
        shift(&mut take, 1, 100..300, 60.0);
        assert_eq!(wrong(&take, RATE, SIZE), []);
    }

    #[test]
    fn a_marker_that_stands_still_while_its_neighbours_move_is_found() {
        for (marker, frames) in [(2, 100..200), (8, 310..400)] {
            let mut take = tumbling(400);
            let there = take.points[frames.start * 12 + marker];
            frames.clone().for_each(|f| take.points[f * 12 + marker] = there);
            assert_eq!(stuck(&take, RATE, SIZE), [(marker, frames)]);
        }
    }

    #[test]
    fn what_stands_still_with_its_neighbours_is_not_stuck() {
        let mut take = tumbling(400);
        // All of a static trial, to the last digit.
        let first = take.points[..12].to_vec();
        take.points.chunks_exact_mut(12).for_each(|frame| frame.copy_from_slice(&first));
        assert_eq!(stuck(&take, RATE, SIZE), []);
        // The point that others turn about, in whole millimetres.
        let turn = |f: usize| glam::DQuat::from_axis_angle(DVec3::Z, 0.02 * f as f64);
        let arm = [[0, 0, 0], [60, 5, 0], [50, 40, 10], [90, 0, 30]].map(|p: [i32; 3]| DVec3::from(p.map(f64::from)));
        let points = (0..200).flat_map(|f| arm.map(|p| (turn(f) * p).round().as_vec3().to_array())).collect();
        let take = MarkerTake { labels: (0..4).map(|m| format!("m{m}")).collect(), points, ..MarkerTake::default() };
        assert!(!still(&take, 5).is_empty());
        assert_eq!(stuck(&take, RATE, SIZE), []);
    }
}
