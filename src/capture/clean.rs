//! Cleaning of a marker take: empty and doubled trajectories, jumps, empty ends.

use super::gaps::{self, By};
use super::strays::{self, Stretches};
use super::{Cleaning, How, MarkerTake, Repair, counted, swaps};
use crate::error::{Error, Kind, Notes, Result};
use crate::statistics::middle;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Two trajectories nearer than this share of the body are one marker.
const SAME: f64 = 0.01;
/// Fastest real markers reach 4.1 body sizes per second and 380 per second squared; 1.5 times that is a fault.
const SPEED: f64 = 6.0;
const ACCELERATION: f64 = 600.0;
/// At high rates noise alone exceeds the acceleration, so a jump also measures this share of the body.
const SMALLEST_JUMP: f64 = 0.03;
/// Two jumps within this time, in seconds, enclose a stray stretch.
const STRAY: f64 = 0.25;
/// Frames on both sides of a jump that are not trusted.
const MARGIN: usize = 2;
/// A marker that jumps in a larger share of its frames is a fast thing and not a faulty track.
const TOO_MANY_JUMPS: f64 = 0.1;
/// A frame at either end with a smaller share of the markers is cut off.
const ALMOST_NONE: f64 = 0.1;
/// A marker that stays missing for a larger share of the take is named.
const OFTEN_MISSING: f64 = 0.2;

/// Cleans a take in place; its labels become unique.
///
/// # Errors
/// [`Kind::Unsupported`] when no marker has a position in any frame.
pub(super) fn clean(
    take: &mut MarkerTake,
    first_frame: &mut i64,
    rate: f64,
    cleaning: &mut Cleaning,
    notes: &mut Notes,
) -> Result<()> {
    let total = take.markers();
    cleaning.empty += drop_empty(take);
    if take.labels.is_empty() {
        return Err(Error::new(Kind::Unsupported, format!("none of the {total} markers has a position in any frame"))
            .expected("at least one trajectory"));
    }
    let size = size(take);
    join_copies(take, size, *first_frame, cleaning, notes);
    let common = common_steps(take);
    exchange(take, &common, rate, size, *first_frame, cleaning, notes);
    remove_stuck(take, rate, size, *first_frame, cleaning, notes);
    remove_jumps(take, &common, rate, size, *first_frame, cleaning, notes);
    remove_strays(take, rate, size, *first_frame, cleaning, notes);
    trim(take, first_frame, cleaning, notes);
    cleaning.empty += drop_empty(take);
    fill(take, rate, size, *first_frame, cleaning, notes);
    Ok(())
}

/// A repair of frames counted from 0.
fn repair(take: &MarkerTake, marker: usize, frames: &Range<usize>, first_frame: i64, how: How) -> Repair {
    let frames = (first_frame + frames.start as i64, first_frame + frames.end as i64 - 1);
    Repair { marker: take.labels[marker].clone(), frames, how }
}

/// Fills the gaps, and says what became of each.
fn fill(take: &mut MarkerTake, rate: f64, size: f64, first_frame: i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let mut longest: Option<(usize, usize)> = None;
    let frames = take.frames();
    let mut missing = vec![0; take.markers()];
    for gap in gaps::fill(take, rate, size) {
        let how = match gap.by {
            By::Neighbours(n) => How::Filled(n),
            By::Curve => How::Interpolated,
            By::Nothing => How::Released,
        };
        if gap.by == By::Nothing {
            cleaning.left += 1;
            missing[gap.marker] += gap.frames.len();
            longest = longest.filter(|(_, length)| *length >= gap.frames.len()).or(Some((gap.marker, gap.frames.len())));
        } else {
            cleaning.filled += 1;
            cleaning.filled_positions += gap.frames.len();
        }
        cleaning.filled_from_neighbours += usize::from(matches!(gap.by, By::Neighbours(_)));
        cleaning.repairs.push(repair(take, gap.marker, &gap.frames, first_frame, how));
    }
    if let Some((marker, frames)) = longest {
        let seconds = frames as f64 / rate;
        notes.warn(format!(
            "{} too long to fill (longest {seconds:.2} s, {}): the markers are released meanwhile",
            counted(cleaning.left, "gap", "gaps"),
            take.labels[marker]
        ));
    }
    let share = |marker: usize| missing[marker] as f64 / frames.max(1) as f64;
    let mut rare: Vec<usize> = (0..take.markers()).filter(|m| share(*m) > OFTEN_MISSING).collect();
    rare.sort_by(|a, b| missing[*b].cmp(&missing[*a]).then(a.cmp(b)));
    if !rare.is_empty() {
        let said: Vec<String> = rare.iter().map(|m| format!("{} {:.0} %", take.labels[*m], 100.0 * share(*m))).collect();
        let markers = counted(rare.len(), "marker is", "markers are");
        notes.warn(format!("{markers} missing for more than a fifth of the take: {}", listed(&said)));
    }
}

/// Diagonal of the box around the markers, median over sampled frames that show at least half as many as the best one.
pub(super) fn size(take: &MarkerTake) -> f64 {
    const SAMPLES: usize = 100;
    let markers = take.markers();
    let step = (take.frames() / SAMPLES).max(1);
    let boxes: Vec<(usize, f64)> = take
        .points
        .chunks_exact(markers)
        .step_by(step)
        .map(|frame| {
            let there = frame.iter().filter(|p| !p[0].is_nan()).map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()));
            let (n, low, high) =
                there.fold((0, DVec3::INFINITY, DVec3::NEG_INFINITY), |(n, l, h), p| (n + 1, l.min(p), h.max(p)));
            (n, if n > 0 { low.distance(high) } else { 0.0 })
        })
        .collect();
    let most = boxes.iter().map(|b| b.0).max().unwrap_or(0);
    let mut full: Vec<f64> = boxes.iter().filter(|b| 2 * b.0 >= most && b.0 > 0).map(|b| b.1).collect();
    middle(&mut full).unwrap_or(0.0)
}

/// Drops markers without any position and returns how many.
fn drop_empty(take: &mut MarkerTake) -> usize {
    let mut seen = vec![false; take.markers()];
    for frame in take.points.chunks_exact(take.markers().max(1)) {
        for (seen, p) in seen.iter_mut().zip(frame) {
            *seen |= !p[0].is_nan();
        }
    }
    keep(take, &seen)
}

/// Keeps the markers that are marked, without a second copy of the take; returns how many were dropped.
fn keep(take: &mut MarkerTake, kept: &[bool]) -> usize {
    let markers = take.markers();
    let left = kept.iter().filter(|k| **k).count();
    if left == markers {
        return 0;
    }
    let mut to = 0;
    for from in 0..take.points.len() {
        if kept[from % markers] {
            take.points[to] = take.points[from];
            to += 1;
        }
    }
    take.points.truncate(to);
    take.points.shrink_to_fit();
    let mut marks = kept.iter();
    take.labels.retain(|_| marks.next().is_some_and(|k| *k));
    markers - left
}

/// Joins trajectories of one marker (`RBAC` and `RBAC-1`, or one label twice) and gives other namesakes labels of their own.
fn join_copies(take: &mut MarkerTake, size: f64, first_frame: i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let markers = take.markers();
    let mut kept = vec![true; markers];
    let (mut joined, mut renamed) = (Vec::new(), Vec::new());
    let mut first: BTreeMap<String, usize> = BTreeMap::new();
    for (marker, label) in take.labels.iter().enumerate() {
        first.entry(label.clone()).or_insert(marker);
    }
    let mut next: BTreeMap<usize, usize> = BTreeMap::new();
    for copy in 0..markers {
        let label = take.labels[copy].clone();
        let namesake = first.get(&label).copied().filter(|m| *m != copy);
        let stem = numbered(&label).and_then(|stem| first.get(stem)).copied().filter(|m| kept[*m]);
        let Some(original) = namesake.or(stem) else { continue };
        if one_marker(take, original, copy, size) {
            for frame in take.points.chunks_exact_mut(markers) {
                if frame[original][0].is_nan() {
                    frame[original] = frame[copy];
                }
            }
            kept[copy] = false;
            cleaning.copies += 1;
            cleaning.repairs.push(repair(take, original, &(0..take.frames()), first_frame, How::Joined(label.clone())));
            joined.push(label);
        } else if namesake.is_some() {
            let number = next.entry(original).or_insert(1);
            let free = loop {
                *number += 1;
                let free = format!("{label}#{number}");
                if !first.contains_key(&free) {
                    break free;
                }
            };
            first.insert(free.clone(), copy);
            renamed.push(free.clone());
            take.labels[copy] = free;
            cleaning.renamed += 1;
        }
    }
    if !joined.is_empty() {
        let copies = counted(joined.len(), "copy", "copies");
        notes.warn(format!("{copies} of a marker joined with it: {}", listed(&joined)));
    }
    if !renamed.is_empty() {
        let namesakes = counted(renamed.len(), "marker", "markers");
        notes.warn(format!("{namesakes} with the label of another: renamed to {}", listed(&renamed)));
    }
    keep(take, &kept);
}

/// Gives markers with the label of an earlier one labels of their own: `C7#2`.
pub(super) fn rename_namesakes(take: &mut MarkerTake) {
    let mut taken: BTreeSet<String> = take.labels.iter().cloned().collect();
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for label in &mut take.labels {
        let number = seen.entry(label.clone()).or_insert(0);
        *number += 1;
        while *number > 1 && taken.contains(&format!("{label}#{number}")) {
            *number += 1;
        }
        if *number > 1 {
            *label = format!("{label}#{number}");
            taken.insert(label.clone());
        }
    }
}

/// `RBAC` of `RBAC-1`.
fn numbered(label: &str) -> Option<&str> {
    let (stem, number) = label.rsplit_once('-')?;
    (!stem.is_empty() && !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())).then_some(stem)
}

fn listed(labels: &[String]) -> String {
    const SHOWN: usize = 6;
    let more = if labels.len() > SHOWN { ", …" } else { "" };
    format!("{}{more}", labels[..labels.len().min(SHOWN)].join(", "))
}

/// Whether two trajectories are one marker: close where both are there, or never there together.
fn one_marker(take: &MarkerTake, a: usize, b: usize, size: f64) -> bool {
    let together = (0..take.frames()).filter_map(|f| Some(take.point(f, a)?.distance(take.point(f, b)?)));
    let mut distances: Vec<f64> = together.collect();
    middle(&mut distances).unwrap_or(0.0) <= SAME * size
}

/// Puts right labels that two markers exchange during the take.
fn exchange(
    take: &mut MarkerTake,
    common: &[DVec3],
    rate: f64,
    size: f64,
    first_frame: i64,
    cleaning: &mut Cleaning,
    notes: &mut Notes,
) {
    let mended = swaps::mend(take, common, rate, size);
    cleaning.exchanged = mended.len();
    let mut said = Vec::new();
    for (a, b, spans) in mended {
        let frames: usize = spans.iter().map(ExactSizeIterator::len).sum();
        let other = &take.labels[b];
        said.push(format!("{} and {other} in {frames}", take.labels[a]));
        let repairs = spans.iter().map(|span| repair(take, a, span, first_frame, How::Exchanged(other.clone())));
        cleaning.repairs.extend(repairs);
    }
    if !said.is_empty() {
        let pairs = counted(said.len(), "pair of markers", "pairs of markers");
        notes.warn(format!("{pairs} had exchanged labels, put right: {} frames", listed(&said)));
    }
}

/// Makes gaps of stretches in which a marker stands still while its neighbours move.
fn remove_stuck(take: &mut MarkerTake, rate: f64, size: f64, first_frame: i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let stuck = strays::stuck(take, rate, size);
    cleaning.stuck = stuck.len();
    let said = make_gaps(take, &stuck, first_frame, &How::Stuck, cleaning);
    if !said.is_empty() {
        notes.warn(format!(
            "{} stood still while their neighbours moved, made gaps: {}",
            counted(said.len(), "marker", "markers"),
            listed(&said)
        ));
    }
}

/// Makes gaps of stretches in which a marker is not where its neighbours carry it.
fn remove_strays(take: &mut MarkerTake, rate: f64, size: f64, first_frame: i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let wrong = strays::wrong(take, rate, size);
    cleaning.strays = wrong.len();
    let said = make_gaps(take, &wrong, first_frame, &How::Stray, cleaning);
    if !said.is_empty() {
        let markers = counted(said.len(), "marker was", "markers were");
        notes.warn(format!("{markers} not where their neighbours carry them, made gaps: {}", listed(&said)));
    }
}

/// Makes gaps of stretches; returns the markers with the frames of each.
fn make_gaps(take: &mut MarkerTake, stretches: &Stretches, first_frame: i64, how: &How, cleaning: &mut Cleaning) -> Vec<String> {
    let markers = take.markers();
    let mut frames: BTreeMap<usize, usize> = BTreeMap::new();
    for (marker, span) in stretches {
        cleaning.repairs.push(repair(take, *marker, span, first_frame, how.clone()));
        span.clone().for_each(|f| take.points[f * markers + marker] = [f32::NAN; 3]);
        *frames.entry(*marker).or_default() += span.len();
    }
    frames.into_iter().map(|(marker, n)| format!("{} in {}", take.labels[marker], counted(n, "frame", "frames"))).collect()
}

/// Makes gaps of jumps: steps, relative to the motion of the whole, that no body makes.
fn remove_jumps(
    take: &mut MarkerTake,
    common: &[DVec3],
    rate: f64,
    size: f64,
    first_frame: i64,
    cleaning: &mut Cleaning,
    notes: &mut Notes,
) {
    let (markers, frames) = (take.markers(), take.frames());
    if frames < 3 || size <= 0.0 {
        return;
    }
    let stray = (STRAY * rate) as usize;
    let mut fast = Vec::new();
    let mut jumping = Vec::new();
    let mut bad: Vec<bool> = vec![false; frames];
    for (marker, jumps) in jumps(take, common, rate, size).into_iter().enumerate().filter(|(_, jumps)| !jumps.is_empty()) {
        bad.fill(false);
        for f in &jumps {
            bad[(f + 1).saturating_sub(MARGIN)..(f + 1 + MARGIN).min(frames)].fill(true);
        }
        for pair in jumps.windows(2).filter(|p| p[1] - p[0] <= stray) {
            bad[pair[0]..=pair[1]].fill(true);
        }
        let there = (0..frames).filter(|f| take.point(*f, marker).is_some()).count();
        let lost: Vec<usize> = (0..frames).filter(|f| bad[*f] && take.point(*f, marker).is_some()).collect();
        if lost.len() as f64 > TOO_MANY_JUMPS * there as f64 {
            fast.push(take.labels[marker].clone());
            continue;
        }
        jumping.push(take.labels[marker].clone());
        for span in bad.chunk_by(|a, b| a == b).scan(0, |start, run| {
            let span = *start..*start + run.len();
            *start = span.end;
            Some((run[0], span))
        }) {
            if let (true, span) = span {
                cleaning.jumps += 1;
                cleaning.repairs.push(repair(take, marker, &span, first_frame, How::Jump));
            }
        }
        for f in lost {
            take.points[f * markers + marker] = [f32::NAN; 3];
        }
    }
    if cleaning.jumps > 0 {
        let jumps = counted(cleaning.jumps, "jump", "jumps");
        notes.warn(format!("{jumps} faster than a body moves, made gaps: {}", listed(&jumping)));
    }
    if !fast.is_empty() {
        notes.warn(format!("too many jumps to mend, left as they are: {}", listed(&fast)));
    }
}

/// Frames of each marker after which it is too far away, or has turned too sharply.
fn jumps(take: &MarkerTake, common: &[DVec3], rate: f64, size: f64) -> Vec<Vec<usize>> {
    let markers = take.markers();
    let step_limit = (SPEED * size / rate).max(SMALLEST_JUMP * size);
    let bend_limit = (ACCELERATION * size / (rate * rate)).max(SMALLEST_JUMP * size);
    let mut jumps = vec![Vec::new(); markers];
    let mut before = vec![DVec3::NAN; markers];
    let place = |p: &[f32; 3]| DVec3::new(p[0].into(), p[1].into(), p[2].into());
    for (f, common) in common.iter().enumerate() {
        // Where the whole body is elsewhere the take was cut, and its markers are right on both sides.
        if common.length() > step_limit {
            before.fill(DVec3::NAN);
            continue;
        }
        let (from, to) = take.points[f * markers..][..2 * markers].split_at(markers);
        for (m, (from, to)) in from.iter().zip(to).enumerate() {
            let now = place(to) - place(from) - *common;
            // What is missing is not a number, and never more than a limit.
            let far = now.length_squared() > step_limit * step_limit;
            let bent = (now - before[m]).length_squared() > bend_limit * bend_limit;
            if far || bent {
                jumps[m].push(f);
            }
            before[m] = now;
        }
    }
    jumps
}

/// Median step of the markers from each frame to the next, zero where too few are seen to speak for the whole.
fn common_steps(take: &MarkerTake) -> Vec<DVec3> {
    const FEWEST: usize = 5;
    let markers = take.markers();
    let mut axes: [Vec<f64>; 3] = Default::default();
    (1..take.frames())
        .map(|f| {
            axes.iter_mut().for_each(Vec::clear);
            for m in 0..markers {
                if let (Some(a), Some(b)) = (take.point(f - 1, m), take.point(f, m)) {
                    let d = (b - a).to_array();
                    axes.iter_mut().zip(d).for_each(|(axis, d)| axis.push(d));
                }
            }
            if axes[0].len() < FEWEST { DVec3::ZERO } else { DVec3::from(axes.each_mut().map(|a| middle(a).unwrap_or(0.0))) }
        })
        .collect()
}

/// Cuts frames with almost no marker off both ends.
fn trim(take: &mut MarkerTake, first_frame: &mut i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let markers = take.markers();
    let needed = ((ALMOST_NONE * markers as f64).ceil() as usize).max(1);
    let seen: Vec<usize> = take.points.chunks_exact(markers).map(|f| f.iter().filter(|p| !p[0].is_nan()).count()).collect();
    let Some(start) = seen.iter().position(|n| *n >= needed) else { return };
    let end = seen.iter().rposition(|n| *n >= needed).map_or(seen.len(), |p| p + 1);
    for cut in [0..start, end..seen.len()] {
        if let Some(most) = seen[cut.clone()].iter().max() {
            let (from, to) = (*first_frame + cut.start as i64, *first_frame + cut.end as i64 - 1);
            let frames = if from == to { format!("frame {from} has") } else { format!("frames {from}\u{2013}{to} have") };
            let what = if *most == 0 { "no markers".into() } else { format!("at most {most} of {markers} markers") };
            notes.warn(format!("{frames} {what}: trimmed"));
        }
    }
    cut(take, start, end);
    cleaning.trimmed_start = start;
    cleaning.trimmed_end = seen.len() - end;
    *first_frame += start as i64;
}

/// Keeps the frames `start..end`, counted from 0.
fn cut(take: &mut MarkerTake, start: usize, end: usize) {
    let markers = take.markers();
    take.points.truncate(end * markers);
    take.points.drain(..start * markers);
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A block of markers that walks along x, with a wobble of its own each.
    fn walking(labels: &[&str], frames: usize) -> MarkerTake {
        let points = (0..frames)
            .flat_map(|f| {
                (0..labels.len()).map(move |m| {
                    let (t, m) = (f as f32 / 100.0, m as f32);
                    [1200.0 * t + 30.0 * (3.0 * t + m).sin(), 150.0 * (m % 4.0), 1800.0 * m / 9.0]
                })
            })
            .collect();
        MarkerTake { labels: labels.iter().map(|l| (*l).to_owned()).collect(), points, ..MarkerTake::default() }
    }

    fn run(take: &mut MarkerTake) -> (i64, Cleaning, Notes) {
        let (mut first, mut cleaning, mut notes) = (101, Cleaning::default(), Notes::default());
        clean(take, &mut first, 100.0, &mut cleaning, &mut notes).unwrap();
        (first, cleaning, notes)
    }

    const NAMES: [&str; 10] = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j"];

    #[test]
    fn a_clean_take_stays_as_it_is() {
        let mut take = walking(&NAMES, 200);
        let before = take.points.clone();
        let (first, cleaning, notes) = run(&mut take);
        assert_eq!((first, cleaning), (101, Cleaning::default()));
        assert!(notes.is_empty());
        assert_eq!(take.points, before);
    }

    #[test]
    fn ends_without_markers_are_trimmed_and_said() {
        let mut take = walking(&NAMES, 200);
        take.points[..30 * 10].fill([f32::NAN; 3]);
        take.points[190 * 10..].fill([f32::NAN; 3]);
        let (first, cleaning, notes) = run(&mut take);
        assert_eq!((first, take.frames()), (131, 160));
        assert_eq!((cleaning.trimmed_start, cleaning.trimmed_end), (30, 10));
        let said: Vec<_> = notes.iter().collect();
        assert_eq!(said, ["frames 101–130 have no markers: trimmed", "frames 291–300 have no markers: trimmed"]);
    }

    #[test]
    fn a_copy_is_joined_and_a_namesake_renamed() {
        let mut take = walking(&["a", "b", "c", "d", "e", "f", "g", "h", "a-1", "b"], 200);
        for f in 0..200 {
            let a = take.points[f * 10];
            take.points[f * 10 + 8] = [a[0] + 3.0, a[1], a[2]];
            if (50..120).contains(&f) {
                take.points[f * 10] = [f32::NAN; 3];
            }
        }
        let (_, cleaning, _) = run(&mut take);
        assert_eq!(take.labels, ["a", "b", "c", "d", "e", "f", "g", "h", "b#2"]);
        assert_eq!((cleaning.copies, cleaning.renamed, cleaning.filled), (1, 1, 0));
        assert!((take.points[60 * 9][0] - (1200.0 * 0.6 + 30.0 * 1.8f32.sin() + 3.0)).abs() < 1e-3);
    }

    #[test]
    fn a_spike_becomes_a_gap_and_is_filled() {
        let mut take = walking(&NAMES, 200);
        let truth = take.points[100 * 10 + 4];
        for f in 98..104 {
            take.points[f * 10 + 4][1] += 700.0;
        }
        let (_, cleaning, _) = run(&mut take);
        assert_eq!((cleaning.jumps, cleaning.strays, cleaning.filled, cleaning.left), (1, 0, 1, 0));
        let frames = (101 + 96, 101 + 106);
        let how = |how| Repair { marker: "e".into(), frames, how };
        assert_eq!(cleaning.repairs, [how(How::Jump), how(How::Filled(4))]);
        assert!((take.points[100 * 10 + 4][1] - truth[1]).abs() < 20.0);
    }

    #[test]
    fn what_stays_missing_is_released_and_named() {
        let mut take = walking(&NAMES, 800);
        for f in 100..300 {
            take.points[f * 10 + 4] = [f32::NAN; 3];
        }
        take.labels.truncate(4 + 1);
        take.points = take.points.chunks_exact(10).flat_map(|frame| [frame[0], frame[0], frame[0], frame[0], frame[4]]).collect();
        let (_, cleaning, notes) = run(&mut take);
        assert_eq!((cleaning.filled, cleaning.left), (0, 1));
        assert_eq!(cleaning.repairs, [Repair { marker: "e".into(), frames: (201, 400), how: How::Released }]);
        assert_eq!(cleaning.repairs[0].words(100.0, 101), "e released for 2 s at 1.0 s (frame 201)");
        let said: Vec<&str> = notes.iter().collect();
        assert!(said.contains(&"1 marker is missing for more than a fifth of the take: e 25 %"), "{said:?}");
    }

    #[test]
    fn a_cut_in_the_take_is_not_a_fault() {
        let mut take = walking(&NAMES, 200);
        let markers = NAMES.len();
        // The second half begins again, elsewhere and in another pose.
        for f in 100..200 {
            for m in 0..markers {
                let mut p = take.points[(f - 100) * markers + m];
                p[0] += 9000.0 + 500.0 * (m % 3) as f32;
                take.points[f * markers + m] = p;
            }
        }
        let before = take.points.clone();
        assert_eq!(run(&mut take).1.jumps, 0);
        assert_eq!(take.points, before);
    }

    #[test]
    fn a_fast_whole_is_not_a_fault() {
        let mut take = walking(&NAMES, 200);
        for (i, p) in take.points.iter_mut().enumerate() {
            p[0] += 50_000.0 * ((i / 10) as f32 / 200.0);
        }
        assert_eq!(run(&mut take).1.jumps, 0);
    }

    #[test]
    fn nothing_to_see_is_an_error() {
        let mut take = MarkerTake { labels: vec!["a".into()], points: vec![[f32::NAN; 3]; 5], ..MarkerTake::default() };
        let refused = clean(&mut take, &mut 1, 100.0, &mut Cleaning::default(), &mut Notes::default()).unwrap_err();
        assert_eq!(refused.kind, Kind::Unsupported);
    }
}
