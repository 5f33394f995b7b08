//! Segment frames straight from the markers, for labels that the dictionary does not know and for markers that leave their segment.

use super::labels::{Names, Part, Place};
use super::segments::Segment;
use super::similarity::rigid;
use super::track::Track;
use crate::statistics::quantile;
use glam::{DQuat, DVec3};

/// Farther than this from a segment, in statures, distance counts against it.
const NEAR: f64 = 0.16;
/// Price of each unit of distance beyond `NEAR`.
const FAR_PRICE: f64 = 0.05;

/// A marker without a place, assigned to the segment in whose frame it moves least.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Assigned {
    pub marker: usize,
    pub segment: Segment,
    /// Median movement in the frame of its segment, in statures.
    pub movement: f64,
}

/// Markers that move with a segment: its own, and where they are fewer than four those at its joints.
fn members(names: &Names, segment: Segment) -> Vec<usize> {
    let own: Vec<usize> = names.iter().filter(|(_, p)| p.segment() == segment).map(|(i, _)| i).collect();
    if own.len() >= 4 {
        return own;
    }
    let at_joint = |p: &Place| match p.part {
        // The far end of the segment above is this segment's near joint.
        Part::UpperArm | Part::Forearm | Part::Thigh | Part::Shank => Some(p.segment()) == segment.parent() && p.t >= 0.9,
        Part::Shoulder => Some(p.segment()) == segment.parent() && shoulder_of(p) == Some(segment),
        Part::Pelvis => Some(Segment::Pelvis) == segment.parent() && segment != Segment::Trunk && p.side == side_of(segment),
        _ => false,
    };
    let child_near = |p: &Place| p.segment().parent() == Some(segment) && p.t <= 0.1 && p.part != Part::Foot;
    let mut all = own;
    all.extend(names.iter().filter(|(_, p)| at_joint(p) || child_near(p)).map(|(i, _)| i));
    all.sort_unstable();
    all.dedup();
    all
}

fn side_of(segment: Segment) -> super::segments::Side {
    use super::segments::Side;
    match segment {
        s if (Segment::LeftUpperArm..=Segment::LeftHand).contains(&s)
            || (Segment::LeftThigh..=Segment::LeftFoot).contains(&s) =>
        {
            Side::Left
        }
        Segment::Pelvis | Segment::Trunk | Segment::Head => Side::Middle,
        _ => Side::Right,
    }
}

fn shoulder_of(place: &Place) -> Option<Segment> {
    use super::segments::Side;
    match place.side {
        Side::Left => Some(Segment::LeftUpperArm),
        Side::Right => Some(Segment::RightUpperArm),
        Side::Middle => None,
    }
}

/// Motion of a cluster from the reference frame to `frame`.
fn motion(track: &Track<'_>, members: &[usize], reference: usize, frame: usize, except: Option<usize>) -> Option<(DQuat, DVec3)> {
    let pairs: Vec<(DVec3, DVec3)> = members
        .iter()
        .filter(|&&i| Some(i) != except)
        .filter_map(|&i| Some((track.point(reference, i)?, track.point(frame, i)?)))
        .collect();
    rigid(&pairs)
}

/// Assigns the markers `unnamed` over the frames `frames`. `stature` is in the capture's unit. Markers that are never together with a
/// segment get none.
pub(crate) fn assign(track: &Track<'_>, names: &Names, unnamed: &[usize], frames: &[usize], stature: f64) -> Vec<Assigned> {
    let clusters: Vec<(Segment, Vec<usize>)> =
        Segment::ALL.iter().map(|&s| (s, members(names, s))).filter(|(_, m)| m.len() >= 3).collect();
    let mut out = Vec::new();
    for &marker in unnamed {
        // The first sampled frame that shows the marker is where its place in each segment is read.
        let Some(&start) = frames.iter().find(|&&f| track.point(f, marker).is_some()) else { continue };
        let Some(home) = track.point(start, marker) else { continue };
        let mut best: Option<(f64, Assigned)> = None;
        for (segment, members) in &clusters {
            let distance =
                members.iter().filter_map(|&i| track.point(start, i)).map(|p| (p - home).length()).fold(f64::INFINITY, f64::min)
                    / stature;
            let mut moves: Vec<f64> = frames
                .iter()
                .filter_map(|&f| {
                    let p = track.point(f, marker)?;
                    let (q, t) = motion(track, members, start, f, None)?;
                    Some((q * home + t - p).length() / stature)
                })
                .collect();
            let Some(movement) = quantile(&mut moves, 0.5) else { continue };
            let price = movement + FAR_PRICE * (distance - NEAR).max(0.0);
            if distance.is_finite() && best.is_none_or(|(b, _)| price < b) {
                best = Some((price, Assigned { marker, segment: *segment, movement }));
            }
        }
        out.extend(best.map(|(_, assigned)| assigned));
    }
    out
}

/// Where a marker is in the frame `at`, from its place among its segment's other markers in the nearest of `frames` that shows it.
pub(crate) fn predict(
    track: &Track<'_>,
    names: &Names,
    marker: usize,
    segment: Segment,
    frames: &[usize],
    at: usize,
) -> Option<DVec3> {
    let members = members(names, segment);
    let mut near: Vec<usize> = frames.iter().copied().filter(|&f| track.point(f, marker).is_some()).collect();
    near.sort_by_key(|f| (f.abs_diff(at), *f));
    near.into_iter().take(20).find_map(|f| {
        let (q, t) = motion(track, &members, f, at, Some(marker))?;
        Some(q * track.point(f, marker)? + t)
    })
}

/// Markers of stiff segments that move against the others of their segment by more than `limit` (in statures), with that movement.
///
/// Only segments with four markers or more can tell which of them strays, and only where one does so much more than the next.
pub(crate) fn strays(track: &Track<'_>, names: &Names, frames: &[usize], stature: f64, limit: f64) -> Vec<(usize, f64)> {
    let mut out = Vec::new();
    for segment in Segment::ALL.into_iter().filter(|s| s.is_stiff()) {
        let own: Vec<usize> = names.iter().filter(|(_, p)| p.segment() == segment).map(|(i, _)| i).collect();
        if own.len() < 4 {
            continue;
        }
        let mut far: Vec<(f64, usize)> =
            own.iter().filter_map(|&i| Some((movement(track, &own, i, frames)? / stature, i))).collect();
        far.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        if let [(worst, marker), (second, _), ..] = far[..]
            && worst > limit
            && worst > 1.5 * second
        {
            out.push((marker, worst));
        }
    }
    out
}

/// Change of a marker's distances from its mates over the frames: the median mate's 95th percentile. One stray spoils one distance of
/// each mate, but all of its own.
fn movement(track: &Track<'_>, mates: &[usize], marker: usize, frames: &[usize]) -> Option<f64> {
    let change = |&mate: &usize| {
        let mut lengths: Vec<f64> =
            frames.iter().filter_map(|&f| Some((track.point(f, marker)? - track.point(f, mate)?).length())).collect();
        let middle = quantile(&mut lengths, 0.5)?;
        let mut changes: Vec<f64> = lengths.iter().map(|l| (l - middle).abs()).collect();
        quantile(&mut changes, 0.95)
    };
    let mut changes: Vec<f64> = mates.iter().filter(|&&mate| mate != marker).filter_map(change).collect();
    quantile(&mut changes, 0.5)
}
