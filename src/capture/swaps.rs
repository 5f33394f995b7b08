//! Two markers that exchange their labels in the middle of a take, as happens when they come close or are lost together.

use super::MarkerTake;
use glam::DVec3;
use std::ops::Range;

/// A marker is looked at when it moves further than this share of the body against the whole in one step.
const MOVED: f64 = 0.01;
/// Two markers have exchanged their labels when each continues the other's path this much better than its own.
const BETTER: f64 = 0.2;
/// A pair that is known to exchange needs less to exchange back: half of an exchange would spoil the rest of the take.
const BETTER_BACK: f64 = 0.5;
/// Longest time without sight, in seconds, over which a path is continued.
const MEMORY: f64 = 0.1;
/// More markers that move at once are a torn take and not an exchange; it also bounds the pairs.
const MOST_MOVED: usize = 64;

/// Puts exchanged labels right and returns the pairs of markers with the frames in which they were exchanged, counted from 0.
///
/// `common`: the step of the whole from each frame to the next. Of the two ways to name a pair, the one that changes fewer frames is taken.
pub(super) fn mend(take: &mut MarkerTake, common: &[DVec3], rate: f64, size: f64) -> Vec<(usize, usize, Vec<Range<usize>>)> {
    let (markers, frames) = (take.markers(), take.frames());
    let memory = ((MEMORY * rate) as usize).max(1);
    let mut partner: Vec<Option<usize>> = vec![None; markers];
    let mut exchanged = vec![false; markers];
    // Frames in which the state changed.
    let mut turns: Vec<Vec<usize>> = vec![Vec::new(); markers];
    // Where each marker was last seen, carried on by its own last step or by the motion of the whole.
    let mut last: Vec<Option<(usize, DVec3)>> = vec![None; markers];
    let mut moved: Vec<(usize, f64, DVec3)> = Vec::with_capacity(markers);
    for f in 0..frames {
        let row = f * markers;
        for m in 0..markers {
            if let (true, Some(p)) = (exchanged[m], partner[m].filter(|p| *p > m)) {
                take.points.swap(row + m, row + p);
            }
        }
        moved.clear();
        for (m, last) in last.iter_mut().enumerate() {
            let Some((seen, at)) = last else { continue };
            let step = take.point(*seen, m).zip(seen.checked_sub(1).and_then(|before| take.point(before, m)));
            *at += step.map_or(common[f - 1], |(now, before)| now - before);
            if let Some(p) = take.point(f, m).filter(|p| f - *seen <= memory && p.distance(*at) > MOVED * size) {
                moved.push((m, p.distance(*at), p));
            }
        }
        if moved.len() > MOST_MOVED {
            moved.clear();
        }
        for (n, (a, own_a, at_a)) in moved.iter().enumerate() {
            for (b, own_b, at_b) in &moved[n + 1..] {
                let (Some((_, last_a)), Some((_, last_b))) = (last[*a], last[*b]) else { continue };
                let cross = at_a.distance(last_b) + at_b.distance(last_a);
                let free = partner[*a].is_none_or(|p| p == *b) && partner[*b].is_none_or(|p| p == *a);
                let better = if partner[*a] == Some(*b) { BETTER_BACK } else { BETTER };
                if free && cross < better * (own_a + own_b) {
                    (partner[*a], partner[*b]) = (Some(*b), Some(*a));
                    for m in [*a, *b] {
                        exchanged[m] = !exchanged[m];
                        turns[m].push(f);
                    }
                    take.points.swap(row + a, row + b);
                }
            }
        }
        for (m, last) in last.iter_mut().enumerate() {
            if let Some(p) = take.point(f, m) {
                *last = Some((f, p));
            }
        }
    }

    let mut mended = Vec::new();
    for a in 0..markers {
        let Some(b) = partner[a].filter(|b| *b > a) else { continue };
        let mut spans = between(&turns[a], frames);
        if 2 * spans.iter().map(ExactSizeIterator::len).sum::<usize>() > frames {
            take.points.chunks_exact_mut(markers).for_each(|frame| frame.swap(a, b));
            turns[a].insert(0, 0);
            spans = between(&turns[a], frames);
        }
        mended.push((a, b, spans));
    }
    mended
}

/// The spans between every odd turn and the next one, the last one up to the end.
fn between(turns: &[usize], end: usize) -> Vec<Range<usize>> {
    let spans = turns.chunks(2).map(|turn| turn[0]..turn.get(1).copied().unwrap_or(end));
    spans.filter(|span| !span.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_hands(frames: usize) -> MarkerTake {
        let points = (0..frames)
            .flat_map(|f| {
                let t = f as f32 / 100.0;
                [[40.0 * (8.0 * t).sin(), 0.0, 900.0], [60.0 + 40.0 * (8.0 * t).sin(), 10.0, 900.0], [0.0, 500.0, 1700.0]]
            })
            .collect();
        MarkerTake { labels: ["a", "b", "c"].map(str::to_owned).to_vec(), points, ..MarkerTake::default() }
    }

    #[test]
    fn exchanged_labels_are_put_right_wherever_they_begin() {
        let truth = two_hands(300);
        let still = vec![DVec3::ZERO; 299];
        for span in [100..160, 0..40, 250..300] {
            let mut take = truth.clone();
            span.clone().for_each(|f| take.points.swap(3 * f, 3 * f + 1));
            assert_eq!(mend(&mut take, &still, 100.0, 1800.0), [(0, 1, vec![span])]);
            assert_eq!(take.points, truth.points);
        }
        let mut take = truth.clone();
        assert!(mend(&mut take, &still, 100.0, 1800.0).is_empty());
        assert_eq!(take.points, truth.points);
    }
}
