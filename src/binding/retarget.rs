//! Marker takes on a scan of other proportions: every segment of the scan turns as the actor's does, on the scan's own lengths.
//!
//! A marker's target is its attachment, carried with its segment of the scan, and on top what the marker itself did against the segment of
//! the actor (soft tissue, breathing). The way of the pelvis is scaled by the length of the legs, so that steps fit.

use super::chase::{Chain, Held, Pose, relative};
use super::fit::{Fit, Ratio};
use super::segments::{Segment, Side, Skeleton};
use super::similarity::Similarity;
use super::track::Track;
use super::{BoundMarker, actor};
use crate::capture::MarkerTake;
use glam::DVec3;

/// Shoulders of two people lie apart on their trunks by so much (standard deviation, in statures); what the fit shifts them beyond is the
/// clavicle.
const OTHER_SHOULDERS: f64 = 0.015;
/// Length of the clavicle in statures, and the share of the arm's elevation that it follows.
const CLAVICLE: (f64, f64) = (0.10, 1.0 / 3.0);
/// Share of frames in which the feet may be below the floor.
pub(super) const ON_FLOOR: f64 = 0.2;

/// A marker as the reference frame shows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// In the space of the fit's observations.
    pub at: DVec3,
    /// The shoulder that takes it along on the trunk: left 0, right 1.
    pub shoulder: Option<usize>,
    pub weight: f64,
}

/// How far the shoulders of the scan at rest must move on the trunk to be where those of the actor's reference pose are, by the part of the
/// fitted shift that the elevation of the arms explains. Left and right, in the axes of the trunk at the scan's size.
pub(super) fn clavicles(body: &Skeleton, fit: &Fit, elevations: [f64; 2]) -> [DVec3; 2] {
    let (actor, scan) = (Chain::of_fit(body, fit), Chain::of_scan(body));
    let torso = fit.size * fit.ratios[Ratio::Torso as usize];
    [(Side::Left, Segment::LeftUpperArm), (Side::Right, Segment::RightUpperArm)].map(|(side, segment)| {
        let raised = (fit.arm_elevation(body, side) - elevations[usize::from(side == Side::Right)]).to_radians();
        let clavicle = CLAVICLE.0 * (CLAVICLE.1 * raised).sin();
        let share = clavicle * clavicle / (clavicle * clavicle + OTHER_SHOULDERS * OTHER_SHOULDERS);
        (actor.rest(segment) / torso - scan.rest(segment)) * share
    })
}

/// The trajectories of the handles on the scan's own body, in the unit box.
///
/// `placement` takes the capture into the space of the fit's observations; `start` is the frame of the take that is nearest to the fitted
/// pose. Shapes: `seen`: one entry per handle.
pub(super) fn trajectories(
    body: &Skeleton,
    fit: &Fit,
    clavicles: &[DVec3; 2],
    track: &Track<'_>,
    placement: &Similarity,
    handles: &[BoundMarker],
    seen: &[Seen],
    start: usize,
) -> MarkerTake {
    let (actor, scan) = (Chain::of_fit(body, fit), Chain::of_scan(body));
    let (turns, origins) = (fit.rotations, fit.origins);
    let held: Vec<Held> = handles
        .iter()
        .zip(seen)
        .map(|(handle, seen)| {
            let segment = handle.segment.unwrap_or(Segment::Pelvis);
            let local = turns[segment as usize].inverse() * (seen.at - origins[segment as usize]);
            Held { segment, shoulder: seen.shoulder, local, weight: seen.weight }
        })
        .collect();
    let home = relative(&turns);
    let pelvis = body.bone(Segment::Pelvis).origin;
    let legs = scan.leg() / actor.leg();
    let soles = soles(body);
    let frames = track.take.frames();
    let mut points = vec![DVec3::NAN; frames * handles.len()];
    let mut lowest = Vec::with_capacity(frames);
    let mut markers = vec![None; handles.len()];

    let first = Pose { root: origins[Segment::Pelvis as usize], turns, shoulders: [DVec3::ZERO; 2] };
    let mut root = first.root;
    let mut pose = first.clone();
    let mut nearest = None;
    for frame in (start..frames).chain((0..start).rev()) {
        if start > 0 && frame == start - 1 {
            pose = nearest.clone().unwrap_or_else(|| first.clone());
        }
        for (marker, handle) in markers.iter_mut().zip(handles) {
            *marker = track.point(frame, handle.marker).map(|p| placement.apply(p));
        }
        pose = actor.chase(&held, &markers, &pose, &home);
        if frame == start {
            // From far away, what ties the pose to the one before is still felt.
            pose = actor.chase(&held, &markers, &pose, &home);
            nearest = Some(pose.clone());
            root = pose.root;
        }
        let origins = actor.origins(&pose);
        let on_scan = Pose {
            root: pelvis + (pose.root - root) * legs,
            turns: pose.turns,
            shoulders: [0, 1].map(|s| clavicles[s] + pose.shoulders[s] / fit.size),
        };
        let scan_origins = scan.origins(&on_scan);
        for (i, (held, handle)) in held.iter().zip(handles).enumerate() {
            let s = held.segment as usize;
            if let Some(marker) = markers[i] {
                let own = (pose.turns[s].inverse() * (marker - origins[s]) - held.place(&pose.shoulders)) / fit.size;
                let rest = handle.attachment - body.bone(held.segment).origin;
                let shift = held.shoulder.map_or(DVec3::ZERO, |s| on_scan.shoulders[s]);
                points[frame * handles.len() + i] = scan_origins[s] + pose.turns[s] * (rest + shift + own);
            }
        }
        let height = |&(foot, p): &(Segment, DVec3)| {
            (scan_origins[foot as usize] + pose.turns[foot as usize] * (p - body.bone(foot).origin)).dot(body.up)
        };
        lowest.push(soles.iter().map(height).fold(f64::INFINITY, f64::min));
    }
    let floor = floor(body);
    let lift = body.up * (floor - actor::quantile(&mut lowest, ON_FLOOR).unwrap_or(floor));
    MarkerTake {
        labels: handles.iter().map(|h| h.label.clone()).collect(),
        points: points.into_iter().map(|p| (p + lift).to_array().map(|x| x as f32)).collect(),
        ..MarkerTake::default()
    }
}

/// Height of the floor under the scan.
fn floor(body: &Skeleton) -> f64 {
    body.bone(Segment::Head).end.dot(body.up) - body.stature
}

/// Points of the soles at rest: under heels and tips of the feet.
fn soles(body: &Skeleton) -> Vec<(Segment, DVec3)> {
    let floor = floor(body);
    let down = |p: DVec3| p + body.up * (floor - p.dot(body.up));
    [Segment::LeftFoot, Segment::RightFoot]
        .into_iter()
        .flat_map(|foot| {
            let bone = body.bone(foot);
            [(foot, down(bone.origin - bone.forward * (0.2 * bone.length))), (foot, down(bone.end))]
        })
        .collect()
}
