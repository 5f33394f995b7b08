//! Marker takes on a scan of other proportions: every segment of the scan turns as the actor's does, on the scan's own lengths.
//!
//! A marker's target is its attachment, carried with its segment of the scan, and on top what the marker itself did against the segment of
//! the actor (soft tissue, breathing). The way of the pelvis is scaled by the length of the legs, so that steps fit.

use super::chase::{Chain, Held, Pose, relative};
use super::fit::{Fit, Ratio};
use super::plant::{self, Leg, Planter};
use super::segments::{Segment, Side, Skeleton};
use super::similarity::Similarity;
use super::track::Track;
use super::{BoundMarker, Watch};
use crate::capture::MarkerTake;
use crate::error::Result;
use crate::statistics::quantile;
use glam::{DQuat, DVec3};

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

/// How an actor's markers move the body of a scan.
#[derive(Clone, Debug)]
pub(super) struct Retargeting<'a> {
    pub body: &'a Skeleton,
    /// The actor in the reference frame.
    pub fit: &'a Fit,
    /// See [`clavicles`].
    pub clavicles: [DVec3; 2],
    /// From the capture, mirrored axes undone, into the space of the fit's observations.
    pub placement: Similarity,
    /// Frame of the take that is nearest to the fitted pose.
    pub start: usize,
    /// Frames per second, where feet that rest are to be held.
    pub feet: Option<f64>,
}

/// Markers of a full set.
const FULL: usize = 26;
/// Markers that tell how a segment lies.
const TELLING: usize = 3;
/// Hardness of the handles at joints.
const SOFT: f64 = 0.1;

/// Handles inside the body at the ends of segments that few markers tell: of a set that is not full. They move as the segments do, and softly:
/// with 17 of 41 markers the skin is twice as near to that of the full set.
pub(super) fn joints(body: &Skeleton, handles: &[BoundMarker]) -> Vec<BoundMarker> {
    if handles.len() >= FULL {
        return Vec::new();
    }
    let own = |segment: Segment| handles.iter().filter(|h| h.segment == Some(segment)).count();
    let few = Segment::ALL.into_iter().filter(|&s| own(s) < TELLING);
    few.flat_map(|segment| {
        let bone = body.bone(segment);
        let handle = |(word, share): (&str, f64)| BoundMarker {
            label: BoundMarker::held_by(segment.name(), word),
            marker: 0,
            attachment: bone.origin.lerp(bone.end, share),
            segment: Some(segment),
            beta: SOFT,
        };
        [("near", 0.0), ("far", 0.9)].map(handle)
    })
    .collect()
}

impl Retargeting<'_> {
    /// The trajectories of the handles, and behind them of the `joints`, in the unit box, and what held the feet.
    ///
    /// Shapes: `seen`: one entry per handle. Cost: memory grows by a pose of 288 bytes per frame while it runs, and by 12 bytes per handle
    /// and frame for the result.
    pub(super) fn trajectories(
        &self,
        track: &Track<'_>,
        handles: &[BoundMarker],
        seen: &[Seen],
        joints: &[BoundMarker],
        watch: Watch<'_>,
    ) -> Result<(MarkerTake, Option<Planter>)> {
        let Self { body, fit, clavicles, placement, start, .. } = self;
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
        let pelvis = body.bone(Segment::Pelvis).origin;
        let legs = scan.leg() / actor.leg();
        let first = Pose { root: origins[Segment::Pelvis as usize], turns, shoulders: [DVec3::ZERO; 2] };
        let poses = chased(&actor, &held, track, placement, handles, &first, *start, watch)?;
        // Of the reference frame and not of the take's own: takes of one session keep their places among each other.
        let root = first.root;
        let on_scan = |pose: &Pose| Pose {
            root: pelvis + (pose.root - root) * legs,
            turns: pose.turns,
            shoulders: [0, 1].map(|s| clavicles[s] + pose.shoulders[s] / fit.size),
        };
        let floor = plant::floor(body);
        let soles = [plant::sole(body, 0), plant::sole(body, 1)];
        let mut lowest: Vec<f64> = poses
            .iter()
            .map(|pose| {
                let pose = on_scan(&pose.pose());
                let origins = scan.origins(&pose);
                let heights = FEET.iter().zip(&soles).flat_map(|(&foot, sole)| {
                    sole.map(|p| (origins[foot as usize] + pose.turns[foot as usize] * p).dot(body.up))
                });
                heights.fold(f64::INFINITY, f64::min)
            })
            .collect();
        let lift = body.up * (floor - quantile(&mut lowest, ON_FLOOR).unwrap_or(floor));
        let mut planter = self.feet.map(|rate| Planter::new(body, floor, rate));
        let seen_legs = Segment::LEGS.map(|leg| held.iter().any(|held| leg.contains(&held.segment)));
        let mut points = Vec::with_capacity(poses.len() * (handles.len() + joints.len()));
        for (frame, pose) in poses.iter().enumerate() {
            let pose = &pose.pose();
            let origins = actor.origins(pose);
            let mut on_scan = on_scan(pose);
            on_scan.root += lift;
            let mut scan_origins = scan.origins(&on_scan);
            if let Some(planter) = &mut planter {
                (0..2).filter(|&side| seen_legs[side]).for_each(|side| hold(planter, side, &mut on_scan, &mut scan_origins));
            }
            for (held, handle) in held.iter().zip(handles) {
                let s = held.segment as usize;
                let place = track.point(frame, handle.marker).map(|p| {
                    let own = pose.turns[s].inverse() * (placement.apply(p) - origins[s]) - held.place(&pose.shoulders);
                    let rest = handle.attachment - body.bone(held.segment).origin;
                    let shift = held.shoulder.map_or(DVec3::ZERO, |s| on_scan.shoulders[s]);
                    scan_origins[s] + on_scan.turns[s] * (rest + shift + own / fit.size)
                });
                points.push(place.unwrap_or(DVec3::NAN).to_array().map(|x| x as f32));
            }
            points.extend(joints.iter().map(|joint| {
                let s = joint.segment.unwrap_or(Segment::Pelvis);
                let place = scan_origins[s as usize] + on_scan.turns[s as usize] * (joint.attachment - body.bone(s).origin);
                place.to_array().map(|x| x as f32)
            }));
        }
        let take = MarkerTake {
            labels: handles.iter().chain(joints).map(|h| h.label.clone()).collect(),
            points,
            ..MarkerTake::default()
        };
        Ok((take, planter))
    }
}

const FEET: [Segment; 2] = [Segment::LeftFoot, Segment::RightFoot];

/// Holds a foot of the scan while it rests on the floor.
fn hold(planter: &mut Planter, side: usize, pose: &mut Pose, origins: &mut [DVec3; Segment::COUNT]) {
    let [thigh, shank, foot] = Segment::LEGS[side].map(|s| s as usize);
    let mut leg = Leg {
        hip: origins[thigh],
        knee: origins[shank],
        ankle: origins[foot],
        thigh: pose.turns[thigh],
        shank: pose.turns[shank],
        foot: pose.turns[foot],
    };
    planter.plant(side, Some(&mut leg));
    (origins[shank], origins[foot]) = (leg.knee, leg.ankle);
    (pose.turns[thigh], pose.turns[shank]) = (leg.thigh, leg.shank);
}

/// The actor's pose in every frame, going out from the one that is nearest to `first`.
#[allow(clippy::too_many_arguments)]
fn chased(
    actor: &Chain,
    held: &[Held],
    track: &Track<'_>,
    placement: &Similarity,
    handles: &[BoundMarker],
    first: &Pose,
    start: usize,
    watch: Watch<'_>,
) -> Result<Vec<KeptPose>> {
    let frames = track.take.frames();
    let home = relative(&first.turns);
    let mut poses = vec![KeptPose::of(first); frames];
    let mut markers = vec![None; handles.len()];
    let mut chase = |frame: usize, before: &Pose| {
        for (marker, handle) in markers.iter_mut().zip(handles) {
            *marker = track.point(frame, handle.marker).map(|p| placement.apply(p));
        }
        actor.chase(held, &markers, before, &home)
    };
    if start >= frames {
        return Ok(poses);
    }
    // From far away, what ties the pose to the one before is still felt.
    let near = chase(start, first);
    let near = chase(start, &near);
    poses[start] = KeptPose::of(&near);
    let mut done = 1;
    let ways: [&mut dyn Iterator<Item = usize>; 2] = [&mut (start + 1..frames), &mut (0..start).rev()];
    for way in ways {
        let mut pose = near.clone();
        for frame in way {
            watch(done, frames)?;
            pose = chase(frame, &pose);
            poses[frame] = KeptPose::of(&pose);
            done += 1;
        }
    }
    Ok(poses)
}

/// A pose in half the memory, for the whole of a take: what is made of it is kept to the same precision.
#[derive(Clone, Debug)]
struct KeptPose {
    root: DVec3,
    turns: [[f32; 4]; Segment::COUNT],
    shoulders: [[f32; 3]; 2],
}

impl KeptPose {
    fn of(pose: &Pose) -> Self {
        let narrow = |v: DVec3| v.to_array().map(|x| x as f32);
        Self { root: pose.root, turns: pose.turns.map(|q| q.to_array().map(|x| x as f32)), shoulders: pose.shoulders.map(narrow) }
    }

    fn pose(&self) -> Pose {
        let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        Pose {
            root: self.root,
            turns: self.turns.map(|q| DQuat::from_array(q.map(f64::from)).normalize()),
            shoulders: self.shoulders.map(wide),
        }
    }
}
