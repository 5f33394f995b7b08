//! Skeleton takes on scans: joints told by name or form, their turns brought onto the scan's own body.
//!
//! Every segment of the scan turns as the capture's joint does; lengths are the scan's own, and the way of the pelvis is scaled by the
//! length of the legs. What pulls the scan are points in and on its parts that move so.

mod cast;
mod form;
mod grips;
mod names;
mod neutral;
mod own;
pub mod person;
mod puppet;
mod rig;
mod stance;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;

use super::landmarks::Body;
use super::plant::{self, Planter};
use super::reference::frame_index;
use super::rig::{Frozen, FrozenJoints};
use super::segments::{Segment, Skeleton};
use super::shape::{scan_unit, segment_places, unit_factor};
use super::similarity::{Similarity, turn_between};
use super::track::Track;
use super::{Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Turning, refuse};
use crate::capture::{Capture, MarkerTake, SkeletonTake};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known};
use crate::statistics::quantile;
use cast::Cast;
use glam::{DQuat, DVec3};
use grips::Grip;
pub use names::Role;
use neutral::{Nearness, Neutral};
use puppet::{BALL, Part, Puppet};
use rig::{Pose, Rig};
use stance::Lengths;

/// Mean angle between the scan's segments and those of the nearest pose, in degrees, beyond which twists are doubtful.
const FAR: f64 = 45.0;
/// Length ratios of actor and scan farther from 1 than this are worth a word.
const OTHER_BUILD: f64 = 0.25;
/// Lengths of trunk and arm, in those of the leg, of a person whose joints have no telling names.
const LIKE_LEGS: (f64, f64) = (0.35, 1.1);
/// Cosine from which a direction of a skeleton that lies in the scan is the body's.
const ALIKE: f64 = 0.7;
/// Length ratios of actor and scan beyond which joints that only their form tells are no person's.
const ABSURD: f64 = 1.8;
/// Share of frames in which the feet may be below the floor.
const ON_FLOOR: f64 = 0.2;

/// Binds a skeleton take to the body of a scan.
///
/// # Errors
/// Refusals: not a human skeleton, an unclear up axis, toes that point backwards; a reference frame outside the take.
pub(super) fn bind(
    scan: &ScanShape<'_>,
    body: &Body,
    capture: &Capture,
    take: &SkeletonTake,
    reference: Option<&Capture>,
    options: &Options,
    mut notes: Notes,
) -> Result<Binding> {
    let skeleton = Skeleton::of(body);
    let rig = Rig { take, mirror: options.mirror };
    let in_file = |e: Error| if e.file.is_none() { e.file(&capture.source) } else { e };
    let (cast, lengths) = recognise(&rig, options, &mut notes).map_err(in_file)?;
    let stance = stance::read(&rig, &cast, &lengths, &capture.space, options, &mut notes).map_err(in_file)?;
    if !matches!(options.align, Align::Auto | Align::Retarget) {
        notes.warn(format!("--align {} is for markers: joints are retargeted", options.align));
    }
    if reference.is_some() {
        notes.warn("the reference capture is not used: a skeleton take carries its own rest");
    }

    let near = match options.reference {
        Reference::Frame(number) => {
            let frame = frame_index(capture, &Track { take: &take.origins, mirror: false }, number)?;
            neutral::nearness_of(&rig, &cast, &skeleton, frame)
        }
        Reference::Auto => neutral::nearest_frame(&rig, &cast, &skeleton),
    };
    let near =
        near.ok_or_else(|| in_file(Error::refused("no frame shows all of hips, knees, ankles, shoulders, elbows and wrists")))?;
    let Pose::Frame(frame) = near.pose else { return Err(in_file(Error::refused("the take has no frames"))) };
    let rest = if options.reference == Reference::Auto { neutral::rest(&rig, &cast, &skeleton) } else { None };
    let pose = rest.map_or(near.pose, |rest| rest.pose);
    let up = stance.up.value.vector();
    let neutral = Neutral::read(&rig, &cast, &skeleton, pose, up)
        .ok_or_else(|| in_file(Error::refused("the joints of the reference pose have no places or turns")))?;
    check_pose(cast.by_form, rest.is_some(), near, options, &mut notes).map_err(in_file)?;

    let unit = scan_unit(scan, Some(body), options);
    let factor = unit_factor(stance.unit, unit);
    let diagonal = scan.unit_box.diagonal;
    let [thigh, shank] = [Segment::LeftThigh, Segment::LeftShank].map(|left| mean_length(&skeleton, left));
    let mut puppet = Puppet::new(rig, pose, &cast, &skeleton, &neutral);
    puppet.scale = options.scale.map_or((thigh + shank) / stance.leg, |s| s * factor / diagonal);
    let yaw =
        place(&mut puppet, &skeleton, frame, up, options).ok_or_else(|| in_file(Error::refused("the pelvis has no turn")))?;
    let kept = puppet.keep(rest.is_some());
    let grips = grips::all(&puppet, &skeleton, scan.tree);
    let (trajectories, planter) = animate(&mut puppet, &skeleton, &grips, rig.frames(), options.feet(capture));
    let feet = planter.and_then(|planter| planter.slip(scan.unit_box.diagonal));

    let ratio = |capture: f64, scan: f64| capture * puppet.scale / scan;
    let proportions = vec![
        ("torso", ratio(lengths.torso, torso(&skeleton))),
        ("upper arm", ratio(lengths.upper_arm, mean_length(&skeleton, Segment::LeftUpperArm))),
        ("forearm", ratio(lengths.forearm, mean_length(&skeleton, Segment::LeftForearm))),
        ("thigh", ratio(lengths.thigh, thigh)),
        ("shank", ratio(lengths.shank, shank)),
    ];
    if cast.by_form
        && let Some((name, ratio)) = proportions.iter().find(|(_, r)| !(1.0 / ABSURD..=ABSURD).contains(r))
    {
        let what = format!(
            "only the form of the skeleton tells a person, and its {name} is {ratio:.2} times the scan's against the legs"
        );
        let error = Error::refused(what).expected(format!("{:.2} to {ABSURD:.2}", 1.0 / ABSURD));
        refuse(error.hint("a skeleton with the usual names (Hips, LeftArm, LeftForeArm, …)"), options, &mut notes)
            .map_err(in_file)?;
    }
    let other: Vec<String> =
        proportions.iter().filter(|(_, r)| (r - 1.0).abs() > OTHER_BUILD).map(|(name, r)| format!("{name} {r:.2}")).collect();
    if !other.is_empty() {
        notes.warn(format!(
            "actor and scan differ in build ({}): the scan keeps its lengths, so hands and feet reach elsewhere",
            other.join(", ")
        ));
    }
    let known = |value, user: bool| Some(Known::new(value, if user { Evidence::User } else { Evidence::Shape }));
    let handles = handles_of(grips);
    let decisions = Decisions {
        align: Align::Retarget,
        noun: "joint",
        on_skin: false,
        reference_frame: capture.first_frame + frame as i64,
        reference_range: (capture.first_frame, capture.first_frame + rig.frames() as i64 - 1),
        reference_capture: None,
        reference_rest: rest.is_some(),
        scale: puppet.scale * diagonal / factor,
        yaw: yaw.to_degrees(),
        scan_unit: unit,
        scan_up: known(body.up, options.scan_up.is_some()),
        scan_forward: known(body.forward, options.flip),
        scan_height: Some(body.stature * diagonal),
        capture_unit: stance.unit,
        capture_up: Some(stance.up),
        actor_height: Some(stance.stature),
        set: cast.family,
        named: if cast.by_form { 0 } else { cast.named },
        markers: take.joints.iter().filter(|j| !j.end).count(),
        bound: handles.len(),
        off_surface: None,
        residual: None,
        proportions,
        strain: None,
        feet,
    };
    let frozen = Frozen::of_joints(&decisions, capture, body, frame, kept, options);
    Ok(Binding {
        placement: Similarity::IDENTITY,
        handles,
        unbound: Vec::new(),
        segments: segment_places(&skeleton),
        decisions,
        frozen: Some(frozen),
        trajectories: Some(trajectories),
        turning: Turning::default(),
        notes,
    })
}

fn handles_of(grips: Vec<Grip>) -> Vec<BoundMarker> {
    let handle = |(marker, g): (usize, Grip)| BoundMarker {
        label: g.label,
        marker,
        attachment: g.rest,
        segment: Some(g.segment),
        beta: 1.0,
    };
    grips.into_iter().enumerate().map(handle).collect()
}

/// Binds a take of the same skeleton by what was decided.
///
/// # Errors
/// Another skeleton.
pub(super) fn bind_again(
    scan: &ScanShape<'_>,
    capture: &Capture,
    take: &SkeletonTake,
    frozen: &Frozen,
    kept: &FrozenJoints,
    options: &Options,
) -> Result<Binding> {
    let other = |what: &str| {
        Error::refused(format!("{what} that the rig file was made from"))
            .file(&capture.source)
            .hint("a rig file without [frozen], or one that was made from a capture of this skeleton")
    };
    let mut notes = Notes::default();
    frozen.check_scan(scan, &mut notes);
    let body = frozen.body().ok_or_else(|| other("the scan is not the one"))?;
    let skeleton = Skeleton::of(&body);
    let rig = Rig { take, mirror: frozen.mirror() };
    let (cast, _) = recognise(&rig, options, &mut notes).map_err(|e| e.file(&capture.source))?;
    if cast.spine.len() != kept.spine.len() {
        return Err(other("the spine has not as many joints as that"));
    }
    let neutral = Neutral::kept(kept);
    let mut puppet = Puppet::again(rig, &cast, &skeleton, &neutral, kept);
    let grips = grips::all(&puppet, &skeleton, scan.tree);
    let (trajectories, planter) = animate(&mut puppet, &skeleton, &grips, rig.frames(), options.feet(capture));
    let feet = planter.and_then(|planter| planter.slip(scan.unit_box.diagonal));
    let handles = handles_of(grips);
    let decisions = Decisions {
        set: cast.family,
        named: if cast.by_form { 0 } else { cast.named },
        markers: take.joints.iter().filter(|j| !j.end).count(),
        bound: handles.len(),
        feet,
        ..frozen.decisions(scan, capture)
    };
    Ok(Binding {
        placement: Similarity::IDENTITY,
        handles,
        unbound: Vec::new(),
        segments: segment_places(&skeleton),
        decisions,
        frozen: Some(frozen.clone()),
        trajectories: Some(trajectories),
        turning: Turning::default(),
        notes,
    })
}

/// Binds a skeleton that lies in the scan as it is, at rest or in a frame; `None` where it does not and may be brought there. Of a person's
/// skeleton and scan all joints must lie inside, and left and up be alike: what merely overlaps is retargeted.
pub(super) fn bind_own(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    capture: &Capture,
    take: &SkeletonTake,
    reference: Option<&Capture>,
    options: &Options,
) -> Option<Result<Binding>> {
    let rig = Rig { take, mirror: options.mirror };
    let moved = options.yaw.is_some() || options.scale.is_some() || options.flip || options.reference != Reference::Auto;
    let margin = match (options.align, body) {
        (Align::None, _) | (Align::Auto, None) => own::LOOSE,
        (Align::Auto, Some(_)) if !moved && reference.is_none() => own::STRICT,
        _ => return None,
    };
    let found = match own::lies_in(scan, body, &rig, capture, options, margin) {
        Ok(found) => found,
        Err(error) => return Some(Err(error)),
    };
    let mut notes = Notes::default();
    let lies = match (found, options.align, body) {
        (Some(lies), Align::Auto, Some(body)) if !stands_alike(&rig, body, lies.pose, options) => return None,
        (Some(lies), ..) => {
            notes.warn("the skeleton lies in the scan as it is: nothing was moved");
            lies
        }
        (None, Align::None, _) => match own::elsewhere(scan, body, &rig, capture, options, &mut notes) {
            Ok(lies) => lies,
            Err(error) => return Some(Err(error)),
        },
        (None, ..) => return None,
    };
    if reference.is_some() {
        notes.warn("the reference capture is not used: the skeleton is taken as it lies in the scan");
    }
    Some(own::bind(scan, body, capture, take, lies, options, notes))
}

/// Whether left and up of a person's joints are those of the body; joints that are no person's do not tell.
fn stands_alike(rig: &Rig<'_>, body: &Body, pose: Pose, options: &Options) -> bool {
    let skeleton = Skeleton::of(body);
    let cast = cast::by_names(rig, options.swap_sides, &options.joints).ok().or_else(|| form::cast(rig, options.swap_sides));
    let Some(cast) = cast else { return true };
    let left = stance::leftwards(rig, &cast, pose, skeleton.up);
    let trunk = stance::shoulders(rig, &cast, pose).zip(stance::hips(rig, &cast, pose));
    let up = trunk.and_then(|(top, low)| (top - low).try_normalize());
    left.is_none_or(|d| d.dot(skeleton.left) > ALIKE) && up.is_none_or(|d| d.dot(skeleton.up) > ALIKE)
}

/// The parts of the joints and their lengths, or why this is no human skeleton.
fn recognise(rig: &Rig<'_>, options: &Options, notes: &mut Notes) -> Result<(Cast, Lengths)> {
    let refusal = |what: String| {
        Error::refused(what)
            .expected("a person's skeleton: pelvis, chest, and on both sides shoulder, elbow, wrist, hip, knee and ankle")
            .hint("a skeleton with the usual names (Hips, LeftArm, LeftForeArm, …); --align none when it lies in the scan")
    };
    let mut cast = match cast::by_names(rig, options.swap_sides, &options.joints) {
        Ok(cast) => cast,
        Err(missing) => {
            let missing = missing.join(", no ");
            let cast = form::cast(rig, options.swap_sides).ok_or_else(|| {
                refusal(format!("the joints are not those of a person: by name there is no {missing}, and the form is another"))
            })?;
            notes.warn(format!("the names of the joints say too little (no {missing}): the form of the skeleton tells a person"));
            cast
        }
    };
    for side in 0..2 {
        cast.legs[side].toe = neutral::pointing_toe(rig, &cast, side);
    }
    let lengths = Lengths::of(rig, &cast).ok_or_else(|| refusal("no frame shows all joints of the limbs".to_owned()))?;
    let leg = lengths.thigh + lengths.shank;
    let unlike = |length: f64| !(LIKE_LEGS.0 * leg..=LIKE_LEGS.1 * leg).contains(&length);
    if cast.by_form && (unlike(lengths.torso) || unlike(lengths.upper_arm + lengths.forearm)) {
        let what = "the names of the joints say nothing, and trunk, arms and legs have not the lengths of a person's";
        return Err(refusal(what.to_owned()));
    }
    let shortest =
        [lengths.thigh, lengths.shank, lengths.upper_arm, lengths.forearm, lengths.torso].into_iter().fold(f64::MAX, f64::min);
    if shortest.is_nan() || shortest < 0.05 * lengths.thigh.max(lengths.torso) {
        return Err(refusal("a limb of the skeleton has no length".to_owned()));
    }
    Ok((cast, lengths))
}

/// A pose far from the scan's, with no standing rest, twists limbs; of joints that only their form tells it says that they are no person's.
fn check_pose(by_form: bool, rest: bool, near: Nearness, options: &Options, notes: &mut Notes) -> Result<()> {
    if rest || near.angle <= FAR {
        return Ok(());
    }
    if by_form {
        let what = format!(
            "no pose of the skeleton is near the scan's ({:.0}° away in the mean), and only its form tells a person",
            near.angle
        );
        let error = Error::refused(what).expected(format!("{FAR:.0}° or less, or a standing person at rest"));
        return refuse(error.hint("a skeleton with the usual names (Hips, LeftArm, LeftForeArm, …)"), options, notes);
    }
    notes.warn(format!(
        "no frame is near the scan's pose ({:.0}° away in the mean) and the file's rest is no standing person: limbs may be twisted; \
         --ref N takes another frame",
        near.angle
    ));
    Ok(())
}

/// Turns and shifts the puppet onto the scan: as the body stands in `frame`. Gives the turn about up.
fn place(puppet: &mut Puppet<'_>, body: &Skeleton, frame: usize, up: DVec3, options: &Options) -> Option<f64> {
    let tilt = turn_between(up, body.up);
    puppet.turn = tilt;
    let (forward, _) = puppet.facing(frame)?;
    let measured = body.up.dot(forward.cross(body.forward)).atan2(forward.dot(body.forward));
    let yaw = options.yaw.map_or(measured, f64::to_radians);
    puppet.turn = DQuat::from_axis_angle(body.up, yaw) * tilt;
    let (_, hips) = puppet.facing(frame)?;
    puppet.shift = body.bone(Segment::Pelvis).origin - hips;
    Some(yaw)
}

/// Moves the grips through the take, with the feet on the scan's floor, and held there where `feet` gives the frames per second.
fn animate(
    puppet: &mut Puppet<'_>,
    body: &Skeleton,
    grips: &[Grip],
    frames: usize,
    feet: Option<f64>,
) -> (MarkerTake, Option<Planter>) {
    let floor = plant::floor(body);
    let soles = soles(body, floor);
    let mut heights: Vec<f64> = (0..frames)
        .filter_map(|frame| {
            let posture = puppet.frame(frame);
            let heights = soles.iter().filter_map(|&(part, p)| posture.apply(part, p)).map(|p| p.dot(body.up));
            heights.reduce(f64::min)
        })
        .collect();
    puppet.shift += body.up * (floor - quantile(&mut heights, ON_FLOOR).unwrap_or(floor));
    let mut planter = feet.map(|rate| Planter::new(body, floor, rate));
    let mut points = Vec::with_capacity(frames * grips.len());
    for frame in 0..frames {
        let mut posture = puppet.frame(frame);
        if let Some(planter) = &mut planter {
            (0..2).for_each(|side| posture.hold(planter, side));
        }
        let place = |g: &Grip| posture.apply(g.part, g.rest).unwrap_or(DVec3::NAN).to_array().map(|x| x as f32);
        points.extend(grips.iter().map(place));
    }
    let labels = grips.iter().map(|g| g.label.clone()).collect();
    (MarkerTake { labels, points, ..MarkerTake::default() }, planter)
}

/// Points of the soles at rest: under heels, balls and tips of the feet.
fn soles(body: &Skeleton, floor: f64) -> Vec<(Part, DVec3)> {
    let mut out = Vec::new();
    for (s, foot) in [Segment::LeftFoot, Segment::RightFoot].into_iter().enumerate() {
        let bone = body.bone(foot);
        let down = |p: DVec3| p + body.up * (floor - p.dot(body.up));
        let heel = bone.origin - bone.forward * (0.2 * bone.length);
        out.extend([(Part::Foot(s), down(heel)), (Part::Foot(s), down(bone.origin.lerp(bone.end, BALL)))]);
        out.push((Part::Toes(s), down(bone.end)));
    }
    out
}

/// Mean length of a segment of the left side and its counterpart.
fn mean_length(body: &Skeleton, left: Segment) -> f64 {
    let right = left.opposite();
    0.5 * (body.bone(left).length + body.bone(right).length)
}

/// From the middle of the hips to the middle of the shoulders.
fn torso(body: &Skeleton) -> f64 {
    let shoulders = (body.shoulders[0] + body.shoulders[1]) * 0.5;
    (shoulders - body.bone(Segment::Pelvis).origin).length()
}
