//! Segments that move on their own, as marker-less systems and rigid bodies give them: from what a file holds to a capture.

use super::head::Head;
use super::{Capture, Cleaning, Motion, ReadOptions, SkeletonTake, source};
use crate::error::{Error, Kind, Notes, Result};
use std::path::Path;

/// A capture of segments: without those that are never there, and without empty frames at the ends.
///
/// # Errors
/// [`Kind::Unsupported`] where no segment is there in any frame.
pub(super) fn assemble(mut take: SkeletonTake, head: Head, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let mut notes = head.notes;
    let mut cleaning = Cleaning::default();
    let mut first_frame = head.first_frame;
    if !options.as_found {
        cleaning.empty = drop_empty(&mut take);
        if take.joints.is_empty() {
            return Err(Error::new(Kind::Unsupported, format!("none of the {} segments is there in any frame", cleaning.empty))
                .expected("at least one segment that moves"));
        }
        trim(&mut take, &mut first_frame, &mut cleaning, &mut notes);
    }
    let name = match &head.subjects[..] {
        [one] => one.clone(),
        _ => source::stem(path),
    };
    Ok(Capture {
        name,
        rate: head.rate,
        first_frame,
        space: head.space,
        motion: Motion::Skeleton(take),
        source: path.to_owned(),
        cleaning,
        notes,
    })
}

/// Drops segments that are never there and returns how many; their children hang on the next one up.
fn drop_empty(take: &mut SkeletonTake) -> usize {
    let count = take.joints.len();
    let frames = take.origins.frames();
    let there = |j: usize| (0..frames).any(|f| !take.origins.points[f * count + j][0].is_nan());
    let kept: Vec<usize> = (0..count).filter(|j| there(*j)).collect();
    if kept.len() == count {
        return 0;
    }
    let mut number = vec![None; count];
    kept.iter().enumerate().for_each(|(k, j)| number[*j] = Some(k));
    let mut up: Vec<Option<usize>> = take.joints.iter().map(|j| j.parent).collect();
    for joint in 0..count {
        // Parents come before their children, so that a parent's own is settled already.
        if let Some(parent) = up[joint].filter(|p| number[*p].is_none()) {
            up[joint] = up[parent];
        }
    }
    let rows = (0..frames).flat_map(|f| kept.iter().map(move |j| f * count + j));
    let points = rows.clone().map(|i| take.origins.points[i]).collect();
    take.rotations = rows.map(|i| take.rotations[i]).collect();
    take.origins.points = points;
    take.origins.labels = kept.iter().map(|j| take.origins.labels[*j].clone()).collect();
    let joints = kept.iter().map(|j| {
        let mut joint = take.joints[*j].clone();
        joint.parent = up[*j].and_then(|p| number[p]);
        joint
    });
    take.joints = joints.collect();
    count - kept.len()
}

/// Cuts frames without any segment off both ends.
fn trim(take: &mut SkeletonTake, first_frame: &mut i64, cleaning: &mut Cleaning, notes: &mut Notes) {
    let count = take.joints.len();
    let empty = |f: &usize| take.origins.points[f * count..(f + 1) * count].iter().all(|p| p[0].is_nan());
    let frames = take.origins.frames();
    let Some(start) = (0..frames).find(|f| !empty(f)) else { return };
    let end = (0..frames).rev().find(|f| !empty(f)).map_or(frames, |f| f + 1);
    for cut in [0..start, end..frames].into_iter().filter(|cut| !cut.is_empty()) {
        let (from, to) = (*first_frame + cut.start as i64, *first_frame + cut.end as i64 - 1);
        let what = if from == to { format!("frame {from} has") } else { format!("frames {from}\u{2013}{to} have") };
        notes.warn(format!("{what} no segments: trimmed"));
    }
    take.origins.points.truncate(end * count);
    take.origins.points.drain(..start * count);
    take.rotations.truncate(end * count);
    take.rotations.drain(..start * count);
    (cleaning.trimmed_start, cleaning.trimmed_end) = (start, frames - end);
    *first_frame += start as i64;
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::capture::{Joint, MarkerTake};
    use glam::{DQuat, DVec3};

    /// A chain of segments over two frames, of which those of `there` are there in the second.
    fn chain(count: usize, there: impl Fn(usize) -> bool) -> SkeletonTake {
        let joint = |n: usize| Joint {
            name: format!("s{n}"),
            parent: n.checked_sub(1),
            rest: DVec3::NAN,
            rest_turn: DQuat::IDENTITY,
            end: false,
        };
        let joints: Vec<Joint> = (0..count).map(joint).collect();
        let place = |n: usize| if there(n) { [n as f32; 3] } else { [f32::NAN; 3] };
        let points = std::iter::repeat_n([f32::NAN; 3], count).chain((0..count).map(place)).collect();
        let labels = joints.iter().map(|j| j.name.clone()).collect();
        let rotations = vec![[0.0, 0.0, 0.0, 1.0]; 2 * count];
        SkeletonTake {
            joints,
            origins: MarkerTake { labels, points, ..MarkerTake::default() },
            rotations,
            ..SkeletonTake::default()
        }
    }

    #[test]
    fn children_of_segments_that_are_never_there_hang_on_the_next_one_up() {
        let mut take = chain(7, |n| [2, 5, 6].contains(&n));
        assert_eq!(drop_empty(&mut take), 4);
        let joints: Vec<_> = take.joints.iter().map(|j| (j.name.as_str(), j.parent)).collect();
        assert_eq!(joints, [("s2", None), ("s5", Some(0)), ("s6", Some(1))]);
        assert_eq!((take.origins.labels.join(" "), take.rotations.len()), ("s2 s5 s6".into(), 6));
        assert_eq!(take.origins.points[3..], [[2.0; 3], [5.0; 3], [6.0; 3]]);
        // As many as a file can name.
        let mut take = chain(60_000, |n| n % 2 == 1 || n > 59_000);
        assert_eq!(drop_empty(&mut take), 29_501);
        assert_eq!(take.joints[30_498].parent, Some(30_497));
    }
}
