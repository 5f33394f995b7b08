//! Filling of gaps: from rigid neighbours, else by interpolation over short times, else not at all.

use super::MarkerTake;
use super::neighbours::{Present, at, steady};
use super::rigid::{self, Motion};
use glam::DVec3;
use std::ops::Range;

/// Neighbours that carry a marker over a gap.
const NEIGHBOURS: usize = 4;
/// Further neighbours that are taken in when the first ones lie on one line.
const MORE_NEIGHBOURS: usize = 6;
/// Neighbours spread at least this share of the body across their longest direction, else their rotation is arbitrary.
const SPREAD: f64 = 0.01;
/// Where the neighbours carry the marker from one end of a gap further than this share of the body off the other end, it is
/// not the marker that was lost.
const DRIFT: f64 = 0.08;
/// Longest gaps, in seconds, that neighbours fill between two known positions, and beyond the first or last one.
const BETWEEN: f64 = 5.0;
const BEYOND: f64 = 2.0;
/// Longest gaps, in seconds, for a cubic and for a straight line.
const CUBIC: f64 = 0.1;
const LINEAR: f64 = 0.25;

/// A gap, and what became of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    pub(super) marker: usize,
    /// Frames counted from 0.
    pub(super) frames: Range<usize>,
    pub(super) by: By,
}

/// What a gap was filled by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// The rigid motion of so many neighbours.
    Neighbours(usize),
    /// A curve between its ends.
    Curve,
    /// Nothing: it stays.
    Nothing,
}

/// Fills the gaps of all markers. `size`: diagonal of the body, in the take's unit.
///
/// Only measured positions carry others, so the order of markers does not matter.
pub(super) fn fill(take: &mut MarkerTake, rate: f64, size: f64) -> Vec<Gap> {
    let present = Present::of(take);
    let mut done = Vec::new();
    for marker in 0..take.markers() {
        let gaps = present.gaps(marker);
        if gaps.is_empty() {
            continue;
        }
        let candidates = steady(take, &present, marker, size);
        for frames in gaps {
            let fill = carried(take, &present, marker, &frames, &candidates, rate, size)
                .map(|(positions, neighbours)| (positions, By::Neighbours(neighbours)))
                .or_else(|| Some((interpolated(take, &present, marker, &frames, rate)?, By::Curve)));
            let (positions, by) = fill.unwrap_or((Vec::new(), By::Nothing));
            for (frame, p) in frames.clone().zip(positions) {
                let at = frame * take.markers() + marker;
                take.points[at] = p.as_vec3().to_array();
            }
            done.push(Gap { marker, frames, by });
        }
    }
    done
}

/// The gap filled by the rigid motion of neighbours that were seen all through it, and their number.
///
/// The marker is carried from the last position before and from the first one after the gap, and the two are blended, so the
/// path joins both ends whatever the skin does.
fn carried(
    take: &MarkerTake,
    present: &Present,
    marker: usize,
    gap: &Range<usize>,
    candidates: &[usize],
    rate: f64,
    size: f64,
) -> Option<(Vec<DVec3>, usize)> {
    let before = gap.start.checked_sub(1);
    let after = (gap.end < present.frames).then_some(gap.end);
    let longest = if before.is_some() && after.is_some() { BETWEEN } else { BEYOND };
    if gap.len() as f64 > longest * rate {
        return None;
    }
    let known = before.unwrap_or(gap.start)..after.map_or(gap.end, |f| f + 1);
    let mut neighbours: Vec<usize> = Vec::with_capacity(MORE_NEIGHBOURS);
    let mut wide = false;
    for other in candidates.iter().copied().filter(|o| present.throughout(known.clone(), *o)) {
        neighbours.push(other);
        let anchor = before.or(after)?;
        let places: Vec<DVec3> = neighbours.iter().map(|m| at(take, anchor, *m)).collect();
        wide = places.len() >= 3 && rigid::width(&places) > SPREAD * size;
        if (wide && neighbours.len() >= NEIGHBOURS) || neighbours.len() == MORE_NEIGHBOURS {
            break;
        }
    }
    if !wide {
        return None;
    }

    let places = |frame: usize| neighbours.iter().map(|m| at(take, frame, *m)).collect::<Vec<_>>();
    let ends = [before, after].map(|end| end.map(|frame| (places(frame), at(take, frame, marker))));
    let carry = |end: &(Vec<DVec3>, DVec3), target: &[DVec3]| Motion::fit(&end.0, target).apply(end.1);
    if let [Some(first), Some(last)] = &ends
        && carry(first, &last.0).distance(last.1) > DRIFT * size
    {
        return None;
    }
    let steps = (gap.len() + 1) as f64;
    let filled: Option<Vec<DVec3>> = gap
        .clone()
        .map(|frame| {
            let target = places(frame);
            match &ends {
                [Some(first), Some(last)] => {
                    let share = (frame + 1 - gap.start) as f64 / steps;
                    Some(carry(first, &target).lerp(carry(last, &target), share))
                }
                [Some(one), None] | [None, Some(one)] => Some(carry(one, &target)),
                [None, None] => None,
            }
        })
        .collect();
    Some((filled?, neighbours.len()))
}

/// A short gap between two known positions: a cubic through the speeds at its ends, or a straight line.
fn interpolated(take: &MarkerTake, present: &Present, marker: usize, gap: &Range<usize>, rate: f64) -> Option<Vec<DVec3>> {
    let (before, after) = (gap.start.checked_sub(1)?, gap.end);
    let frames = |seconds: f64| ((seconds * rate).round() as usize).max(1);
    if after >= present.frames || gap.len() > frames(LINEAR) {
        return None;
    }
    let (a, b) = (at(take, before, marker), at(take, after, marker));
    let steps = (gap.len() + 1) as f64;
    let chord = (b - a) / steps;
    let cubic = gap.len() <= frames(CUBIC);
    let speed = |from: Option<usize>, to: usize| match from {
        Some(from) if cubic && to < present.frames && present.has(from, marker) && present.has(to, marker) => {
            at(take, to, marker) - at(take, from, marker)
        }
        _ => chord,
    };
    let (start, end) = (speed(before.checked_sub(1), before) * steps, speed(Some(after), after + 1) * steps);
    let path = |frame: usize| {
        let t = (frame - before) as f64 / steps;
        let (t2, t3) = (t * t, t * t * t);
        a * (2.0 * t3 - 3.0 * t2 + 1.0) + start * (t3 - 2.0 * t2 + t) + b * (3.0 * t2 - 2.0 * t3) + end * (t3 - t2)
    };
    Some(gap.clone().map(path).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const RATE: f64 = 100.0;

    /// Five points of a body that tumbles along, and its diagonal.
    fn tumbling(frames: usize) -> (MarkerTake, f64) {
        let body = [[0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [0.0, 200.0, 0.0], [0.0, 0.0, 250.0], [100.0, 100.0, 100.0]];
        let labels = ["a", "b", "c", "d", "e"].map(str::to_owned).to_vec();
        let mut points = Vec::new();
        for f in 0..frames {
            let t = f as f64 / RATE;
            let turn = glam::DQuat::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 2.0 * t);
            let shift = DVec3::new(800.0 * t, 100.0 * (3.0 * t).sin(), 900.0);
            points.extend(body.map(|p| (turn * DVec3::from(p) + shift).as_vec3().to_array()));
        }
        (MarkerTake { labels, points, ..MarkerTake::default() }, 800.0)
    }

    fn hide(take: &mut MarkerTake, frames: Range<usize>, marker: usize) {
        for f in frames {
            let at = f * take.markers() + marker;
            take.points[at] = [f32::NAN; 3];
        }
    }

    fn worst(a: &MarkerTake, b: &MarkerTake) -> f32 {
        let off = |p: &[f32; 3], q: &[f32; 3]| (0..3).map(|i| (p[i] - q[i]).abs()).fold(0.0, f32::max);
        a.points.iter().zip(&b.points).map(|(p, q)| if p[0].is_nan() { f32::INFINITY } else { off(p, q) }).fold(0.0, f32::max)
    }

    #[test]
    fn rigid_neighbours_carry_a_marker_through_and_beyond() {
        let (truth, size) = tumbling(300);
        for gap in [100..170, 0..80, 250..300] {
            let mut take = truth.clone();
            hide(&mut take, gap.clone(), 4);
            let done = fill(&mut take, RATE, size);
            assert_eq!(done, [Gap { marker: 4, frames: gap, by: By::Neighbours(4) }]);
            assert!(worst(&take, &truth) < 0.01);
        }
    }

    #[test]
    fn without_neighbours_only_short_gaps_between_ends_are_filled() {
        let (mut truth, _) = tumbling(300);
        truth.labels.truncate(1);
        truth.points = truth.points.iter().step_by(5).copied().collect();
        let mut take = truth.clone();
        for gap in [20..30, 60..85, 120..160, 290..300] {
            hide(&mut take, gap, 0);
        }
        let done = fill(&mut take, RATE, 440.0);
        assert_eq!(done.iter().map(|g| g.by).collect::<Vec<_>>(), [By::Curve, By::Curve, By::Nothing, By::Nothing]);
        assert_eq!(done.iter().map(|g| g.frames.len()).collect::<Vec<_>>(), [10, 25, 40, 10]);
        assert!(take.point(140, 0).is_none() && take.point(295, 0).is_none());
        assert!(take.point(25, 0).unwrap().distance(truth.point(25, 0).unwrap()) < 0.5);
    }

    #[test]
    fn neighbours_on_one_line_do_not_turn_a_marker() {
        let (mut take, size) = tumbling(100);
        let along = |f: usize| take.points[f * 5];
        let bent: Vec<[f32; 3]> = (0..100)
            .flat_map(|f| {
                let [x, y, z] = along(f);
                [[x, y, z], [x + 50.0, y, z], [x + 100.0, y, z], [x + 20.0, y + 60.0, z], [x + 150.0, y, z]]
            })
            .collect();
        take.points = bent;
        hide(&mut take, 30..90, 3);
        assert_eq!(fill(&mut take, RATE, size), [Gap { marker: 3, frames: 30..90, by: By::Nothing }]);
    }

    /// The fifth point is elsewhere on the body, in its own axes, from a frame on: where it would be without, and the take with the gap before it.
    fn slipped(by: f64, gap: Range<usize>) -> (MarkerTake, MarkerTake, f64) {
        let (truth, size) = tumbling(400);
        let mut take = truth.clone();
        for f in gap.end..400 {
            let [a, b] = [0, 1].map(|m| truth.point(f, m).unwrap());
            let place = truth.point(f, 4).unwrap() + (b - a).normalize() * by;
            take.points[f * 5 + 4] = place.as_vec3().to_array();
        }
        hide(&mut take, gap, 4);
        (truth, take, size)
    }

    #[test]
    fn a_marker_that_comes_back_elsewhere_is_another_one_and_skin_that_slips_is_followed() {
        let gap = 300..370;
        let (_, mut take, size) = slipped(0.125 * 800.0, gap.clone());
        assert_eq!(fill(&mut take, RATE, size), [Gap { marker: 4, frames: gap.clone(), by: By::Nothing }]);
        let slip = 0.05 * 800.0;
        let (truth, mut take, size) = slipped(slip, gap.clone());
        assert_eq!(fill(&mut take, RATE, size), [Gap { marker: 4, frames: gap.clone(), by: By::Neighbours(4) }]);
        for f in gap.clone() {
            let off = take.point(f, 4).unwrap().distance(truth.point(f, 4).unwrap());
            let expected = slip * (f + 1 - gap.start) as f64 / (gap.len() + 1) as f64;
            assert!((off - expected).abs() < 0.05, "frame {f}: {off}, not {expected}");
        }
    }

    #[test]
    fn neighbours_carry_a_marker_longer_between_two_places_than_beyond_one() {
        let (truth, size) = tumbling(700);
        for (gap, by) in [(200..500, By::Neighbours(4)), (0..300, By::Nothing), (400..700, By::Nothing), (100..650, By::Nothing)]
        {
            let mut take = truth.clone();
            hide(&mut take, gap.clone(), 4);
            assert_eq!(fill(&mut take, RATE, size), [Gap { marker: 4, frames: gap, by }]);
        }
    }

    #[test]
    fn a_curve_keeps_the_speeds_at_its_ends_only_over_a_tenth_of_a_second() {
        let place = |f: f64| [0.1 * f * f, 5.0 * f, 900.0];
        let points: Vec<[f32; 3]> = (0..100).map(|f| place(f64::from(f)).map(|x| x as f32)).collect();
        let truth = MarkerTake { labels: vec!["a".into()], points, ..MarkerTake::default() };
        let filled = |gap: Range<usize>| {
            let mut take = truth.clone();
            hide(&mut take, gap.clone(), 0);
            assert_eq!(fill(&mut take, RATE, 500.0)[0].by, By::Curve);
            let middle = gap.start + gap.len() / 2;
            let (a, b) = (truth.point(gap.start - 1, 0).unwrap(), truth.point(gap.end, 0).unwrap());
            let straight = a.lerp(b, (middle + 1 - gap.start) as f64 / (gap.len() + 1) as f64);
            let p = take.point(middle, 0).unwrap();
            (p.distance(truth.point(middle, 0).unwrap()), p.distance(straight))
        };
        let (from_truth, from_straight) = filled(20..29);
        assert!(from_truth < 0.3 && from_straight > 2.0, "{from_truth} {from_straight}");
        let (_, from_straight) = filled(20..40);
        assert!(from_straight < 1e-3, "{from_straight}");
    }
}
