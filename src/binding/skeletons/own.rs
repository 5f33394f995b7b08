//! A skeleton that lies in the scan already: the rig that the scan was made with, of a person, an animal or a machine.

use super::rig::{Pose, Rig};
use crate::binding::landmarks::Body;
use crate::binding::reference::frame_index;
use crate::binding::segments::Skeleton;
use crate::binding::shape::{scan_unit, unit_factor};
use crate::binding::similarity::Similarity;
use crate::binding::track::Track;
use crate::binding::{
    Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Segment, SegmentPlace, Turning, refuse,
};
use crate::capture::{Capture, MarkerTake, SkeletonTake};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Unit};
use glam::{DQuat, DVec3};

/// How surely the joints must lie in the scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Margin {
    /// Share of the joints, without the ends of bones, that must lie in the scan.
    inside: f64,
    /// Distance outside of the skin, in diagonals, that still is in: ends of bones stick out.
    near: f64,
    /// Least extent of the joints, in diagonals of the scan.
    extent: f64,
}

/// For joints of which the user or the body says that nothing else will do.
pub(super) const LOOSE: Margin = Margin { inside: 0.75, near: 0.03, extent: 0.35 };
/// For joints that a stranger's skeleton would be mistaken for when it merely stands in the scan: hands and feet of other bones leave it.
pub(super) const STRICT: Margin = Margin { inside: 0.97, near: 0.01, extent: 0.45 };
/// How far from a bone the points that hold its twist lie, in diagonals.
const ACROSS: f64 = 0.02;
/// Frames, and joints of each, that are looked at.
const SAMPLES: (usize, usize) = (40, 400);

/// A pose in which the joints lie in the scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lies {
    pub pose: Pose,
    /// Scan units per unit of the capture.
    pub factor: f64,
}

/// The pose and the unit by which the joints lie in the scan, the rest before the frames; where the user names a frame, that one. Frames of
/// nobody's choice must hold the strict margin. `None` where there is none.
///
/// # Errors
/// A reference frame outside of the take.
pub(super) fn lies_in(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    rig: &Rig<'_>,
    capture: &Capture,
    options: &Options,
    margin: Margin,
) -> Result<Option<Lies>> {
    let said = said(scan, body, capture, options);
    let mut factors = vec![said];
    if options.scale.is_none() && (options.capture_unit.is_none() || scan_unit(scan, body, options).is_none()) {
        let units = [Unit::Metre, Unit::Centimetre, Unit::Millimetre].map(|u| u.metres());
        factors.push(1.0);
        factors.extend(units.iter().flat_map(|a| units.map(|b| a / b)));
    }
    let first = pose(rig, capture, options)?;
    let mut poses = vec![(first, margin)];
    if options.reference == Reference::Auto {
        let margin = if options.align == Align::None { margin } else { STRICT };
        poses.extend(rig.sample(SAMPLES.0).into_iter().map(|f| (Pose::Frame(f), margin)));
    }
    let found = poses.into_iter().find_map(|(pose, margin)| {
        let lies = |&factor: &f64| {
            share(scan, rig, Lies { pose, factor }, margin).is_some_and(|(a, b)| a as f64 >= margin.inside * b as f64)
        };
        factors.iter().copied().find(lies).map(|factor| Lies { pose, factor })
    });
    Ok(found)
}

/// Scan units per unit of the capture as user and files say.
fn said(scan: &ScanShape<'_>, body: Option<&Body>, capture: &Capture, options: &Options) -> f64 {
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(capture.space.unit);
    options.scale.unwrap_or(1.0) * unit_factor(unit, scan_unit(scan, body, options))
}

/// The pose that the user names, else the rest.
fn pose(rig: &Rig<'_>, capture: &Capture, options: &Options) -> Result<Pose> {
    match options.reference {
        Reference::Auto => Ok(Pose::Rest),
        Reference::Frame(number) => {
            frame_index(capture, &Track { take: &rig.take.origins, mirror: rig.mirror }, number).map(Pose::Frame)
        }
    }
}

/// How many of how many joints lie in the scan; `None` where all of them are too near to each other or far outside of its box.
fn share(scan: &ScanShape<'_>, rig: &Rig<'_>, lies: Lies, margin: Margin) -> Option<(usize, usize)> {
    let joints = &rig.take.joints;
    let places: Vec<(usize, DVec3)> =
        (0..joints.len()).filter_map(|j| Some((j, scan.unit_box.enter(rig.place(lies.pose, j)? * lies.factor)))).collect();
    let (lo, hi) = places.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), (_, p)| (lo.min(*p), hi.max(*p)));
    if places.len() < 2 || (hi - lo).length() < margin.extent || (hi - lo).max_element() > 2.0 {
        return None;
    }
    let inside = |p: DVec3| {
        let boxed = p.abs().max_element() < 0.6;
        boxed && (scan.tree.winding(p).abs() > 0.5 || scan.tree.closest(p).is_some_and(|near| near.distance < margin.near))
    };
    let places: Vec<DVec3> = places.into_iter().filter(|(j, _)| !joints[*j].end).map(|(_, p)| p).collect();
    let step = places.len().div_ceil(SAMPLES.1).max(1);
    let looked: Vec<DVec3> = places.into_iter().step_by(step).collect();
    (!looked.is_empty()).then(|| (looked.iter().filter(|p| inside(**p)).count(), looked.len()))
}

/// The pose to take where the user says that the joints lie in the scan and they do not.
///
/// # Errors
/// A refusal unless doubtful input is accepted.
pub(super) fn elsewhere(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    rig: &Rig<'_>,
    capture: &Capture,
    options: &Options,
    notes: &mut Notes,
) -> Result<Lies> {
    let lies = Lies { pose: pose(rig, capture, options)?, factor: said(scan, body, capture, options) };
    let found = match share(scan, rig, lies, Margin { extent: 0.0, ..LOOSE }) {
        Some((some, all)) if some > 0 => format!("only {some} of {all} joints lie in the scan"),
        _ => "no joint of the skeleton lies in the scan".to_owned(),
    };
    let error = Error::refused(found)
        .file(&capture.source)
        .expected(format!(
            "{:.0} % of the joints in the scan or within {:.0} % of its diagonal, at rest or in a frame",
            100.0 * LOOSE.inside,
            100.0 * LOOSE.near
        ))
        .hint("--scale or --capture-unit where only the size differs, --ref N with a frame in which they meet");
    refuse(error, options, notes)?;
    Ok(lies)
}

/// Binds every bone where it lies in a pose.
///
/// # Errors
/// No joint with a place and a turn in that pose.
pub(super) fn bind(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    capture: &Capture,
    take: &SkeletonTake,
    lies: Lies,
    options: &Options,
    mut notes: Notes,
) -> Result<Binding> {
    let rig = Rig { take, mirror: options.mirror };
    let Lies { pose, factor } = lies;
    let scale = factor / scan.unit_box.diagonal;
    let placement = Similarity {
        mirror: false,
        scale,
        rotation: DQuat::IDENTITY,
        translation: -scan.unit_box.centre / scan.unit_box.diagonal,
    };
    let grips = grips(&rig, pose, ACROSS / scale);
    if grips.is_empty() {
        return Err(Error::refused("no joint of the skeleton has a place in the reference pose").file(&capture.source));
    }
    let unbound = take
        .joints
        .iter()
        .enumerate()
        .filter(|(j, joint)| !joint.end && (rig.place(pose, *j).is_none() || rig.turn(pose, *j).is_none()));
    let unbound = unbound.map(|(_, joint)| (joint.name.clone(), "not there in the reference pose".to_owned())).collect();
    let mut points = Vec::with_capacity(rig.frames() * grips.len());
    for frame in 0..rig.frames() {
        for grip in &grips {
            let (place, turn) = (rig.place(Pose::Frame(frame), grip.joint), rig.turn(Pose::Frame(frame), grip.joint));
            let p = place.zip(turn).map_or(DVec3::NAN, |(place, turn)| place + turn * grip.local);
            points.push(placement.apply(p).to_array().map(|x| x as f32));
        }
    }
    let handles: Vec<BoundMarker> = grips
        .iter()
        .enumerate()
        .map(|(marker, g)| BoundMarker {
            label: g.label.clone(),
            marker,
            attachment: placement.apply(g.rest),
            segment: None,
            beta: 1.0,
        })
        .collect();
    let skeleton = body.map(Skeleton::of);
    let segments = skeleton.iter().flat_map(|s| {
        Segment::ALL.map(|segment| SegmentPlace { segment, from: s.bone(segment).origin, to: s.bone(segment).end })
    });
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(capture.space.unit);
    let of_scan = scan_unit(scan, body, options);
    let decisions = Decisions {
        align: Align::None,
        noun: "joint",
        on_skin: false,
        reference_frame: capture.first_frame + if let Pose::Frame(frame) = pose { frame as i64 } else { 0 },
        reference_range: (capture.first_frame, capture.first_frame + rig.frames() as i64 - 1),
        reference_capture: None,
        reference_rest: pose == Pose::Rest,
        scale: factor / unit_factor(unit, of_scan),
        yaw: 0.0,
        scan_unit: of_scan,
        scan_up: body.map(|b| Known::new(b.up, Evidence::Shape)),
        scan_forward: body.map(|b| Known::new(b.forward, Evidence::Shape)),
        scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
        capture_unit: unit,
        capture_up: capture.space.up,
        actor_height: None,
        set: None,
        named: 0,
        markers: take.joints.iter().filter(|j| !j.end).count(),
        bound: handles.len(),
        off_surface: None,
        residual: None,
        proportions: Vec::new(),
        strain: None,
        feet: None,
    };
    let ignored = [
        ("--yaw", options.yaw.is_some()),
        ("--flip", options.flip),
        ("--swap-sides", options.swap_sides),
        ("--capture-up", options.capture_up.is_some()),
        ("--scan-up", options.scan_up.is_some()),
    ];
    let ignored: Vec<&str> = ignored.iter().filter(|i| i.1).map(|i| i.0).collect();
    if !ignored.is_empty() {
        notes.warn(format!("{} not used: the skeleton is taken as it lies in the scan", ignored.join(" and ")));
    }
    Ok(Binding {
        placement: Similarity::IDENTITY,
        handles,
        unbound,
        segments: segments.collect(),
        trajectories: Some(MarkerTake { labels: grips.into_iter().map(|g| g.label).collect(), points, ..MarkerTake::default() }),
        turning: Turning::default(),
        decisions,
        frozen: None,
        notes,
    })
}

/// A point that moves with a joint.
struct Grip {
    label: String,
    joint: usize,
    /// In the reference pose, in the capture's space.
    rest: DVec3,
    /// In the joint's own axes.
    local: DVec3,
}

/// The joints, and the middles of their bones with points across; of joints without a bone, the ends of three axes.
fn grips(rig: &Rig<'_>, pose: Pose, across: f64) -> Vec<Grip> {
    let mut grips = Vec::new();
    let mut below = vec![Vec::new(); rig.take.joints.len()];
    for (joint, data) in rig.take.joints.iter().enumerate() {
        if let (Some(parent), Some(place)) = (data.parent, rig.place(pose, joint)) {
            below[parent].push(place);
        }
    }
    for (joint, data) in rig.take.joints.iter().enumerate() {
        let (Some(place), Some(turn)) = (rig.place(pose, joint), rig.turn(pose, joint)) else { continue };
        if data.end {
            continue;
        }
        let mut add = |word: &str, rest: DVec3| {
            let label = if word.is_empty() { data.name.clone() } else { BoundMarker::held_by(&data.name, word) };
            grips.push(Grip { label, joint, rest, local: turn.inverse() * (rest - place) });
        };
        add("", place);
        let bones: Vec<DVec3> = below[joint].iter().copied().filter(|end| (*end - place).length() > across).collect();
        if bones.is_empty() {
            for (word, axis) in [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)] {
                add(word, place + axis * across);
            }
        }
        for (k, end) in bones.into_iter().enumerate() {
            let middle = place.lerp(end, 0.5);
            let side = (end - place).normalize().any_orthonormal_vector();
            let other = (end - place).normalize().cross(side);
            let bone = if k == 0 { String::new() } else { format!("{} ", k + 1) };
            for (word, offset) in [("middle", DVec3::ZERO), ("side", side), ("other side", -side), ("front", other)] {
                add(&format!("{bone}{word}"), middle + offset * across);
            }
        }
    }
    grips
}
