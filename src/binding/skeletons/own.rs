//! A skeleton that lies in the scan already: the rig that the scan was made with, of a person, an animal or a machine.

use super::rig::{Pose, Rig};
use crate::binding::bind::{scan_unit, unit_factor};
use crate::binding::landmarks::Body;
use crate::binding::segments::Skeleton;
use crate::binding::similarity::Similarity;
use crate::binding::{Align, Binding, BoundMarker, Decisions, Options, ScanShape, Segment, SegmentPlace, Turning};
use crate::capture::{Capture, MarkerTake, SkeletonTake};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Unit};
use glam::{DQuat, DVec3};

/// Share of the joints that must lie in the scan at rest.
const INSIDE: f64 = 0.75;
/// Distance outside of the skin, in diagonals, that still is in: ends of bones stick out.
const NEAR: f64 = 0.03;
/// Least extent of the joints, in diagonals of the scan.
const EXTENT: f64 = 0.35;
/// How far from a bone the points that hold its twist lie, in diagonals.
const ACROSS: f64 = 0.02;

/// Scan units per unit of the capture with which the joints at rest lie in the scan.
pub(super) fn lies_in(scan: &ScanShape<'_>, rig: &Rig<'_>, capture: &Capture, options: &Options) -> Option<f64> {
    let scan_unit = options.scan_unit.or(scan.space.unit.map(|u| u.value));
    let capture_unit = options.capture_unit.or(capture.space.unit.map(|u| u.value));
    let said = match (capture_unit, scan_unit) {
        (Some(a), Some(b)) => a.metres() / b.metres(),
        _ => 1.0,
    };
    let units = [Unit::Metre, Unit::Centimetre, Unit::Millimetre].map(|u| u.metres());
    let guesses = units.iter().flat_map(|a| units.map(|b| a / b));
    std::iter::once(said).chain([1.0]).chain(guesses).find(|&factor| {
        let places: Vec<DVec3> = (0..rig.take.joints.len())
            .filter_map(|j| rig.place(Pose::Rest, j))
            .map(|p| scan.unit_box.enter(p * factor))
            .collect();
        let (lo, hi) = places.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        if places.len() < 2 || (hi - lo).length() < EXTENT {
            return false;
        }
        let inside =
            |p: &&DVec3| scan.tree.winding(**p).abs() > 0.5 || scan.tree.closest(**p).is_some_and(|near| near.distance < NEAR);
        places.iter().filter(inside).count() as f64 >= INSIDE * places.len() as f64
    })
}

/// Binds every bone where it lies at rest.
///
/// # Errors
/// Joints without a rest.
pub(super) fn bind(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    capture: &Capture,
    take: &SkeletonTake,
    factor: f64,
    options: &Options,
) -> Result<Binding> {
    let rig = Rig { take, mirror: options.mirror };
    let scale = factor / scan.unit_box.diagonal;
    let placement = Similarity {
        mirror: false,
        scale,
        rotation: DQuat::IDENTITY,
        translation: -scan.unit_box.centre / scan.unit_box.diagonal,
    };
    let grips = grips(&rig, ACROSS / scale);
    if grips.is_empty() {
        return Err(Error::refused("no joint of the skeleton has a place at rest").file(&capture.source));
    }
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
        reference_frame: capture.first_frame,
        reference_range: (capture.first_frame, capture.first_frame + rig.frames() as i64 - 1),
        reference_capture: None,
        reference_rest: true,
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
    };
    let mut notes = Notes::default();
    notes.warn("the skeleton lies in the scan as it is: nothing was moved");
    Ok(Binding {
        placement: Similarity::IDENTITY,
        handles,
        unbound: Vec::new(),
        segments: segments.collect(),
        trajectories: Some(MarkerTake { labels: grips.into_iter().map(|g| g.label).collect(), points, ..MarkerTake::default() }),
        turning: Turning::default(),
        decisions,
        notes,
    })
}

/// A point that moves with a joint.
struct Grip {
    label: String,
    joint: usize,
    /// At rest, in the capture's space.
    rest: DVec3,
    /// In the joint's own axes.
    local: DVec3,
}

/// The joints, and the middles of their bones with points across; of joints without a bone, the ends of three axes.
fn grips(rig: &Rig<'_>, across: f64) -> Vec<Grip> {
    let mut grips = Vec::new();
    for (joint, data) in rig.take.joints.iter().enumerate() {
        let (Some(place), Some(turn)) = (rig.place(Pose::Rest, joint), rig.turn(Pose::Rest, joint)) else { continue };
        if data.end {
            continue;
        }
        let mut add = |word: &str, rest: DVec3| {
            let label = format!("{}{word}", data.name);
            grips.push(Grip { label, joint, rest, local: turn.inverse() * (rest - place) });
        };
        add("", place);
        let children = rig.take.joints.iter().enumerate().filter(|(_, j)| j.parent == Some(joint));
        let ends: Vec<(usize, DVec3)> = children.filter_map(|(c, _)| Some((c, rig.place(Pose::Rest, c)?))).collect();
        let bones: Vec<&(usize, DVec3)> = ends.iter().filter(|(_, end)| (*end - place).length() > across).collect();
        if bones.is_empty() {
            for (word, axis) in [(" x", DVec3::X), (" y", DVec3::Y), (" z", DVec3::Z)] {
                add(word, place + axis * across);
            }
        }
        for (k, (_, end)) in bones.into_iter().enumerate() {
            let middle = place.lerp(*end, 0.5);
            let side = (*end - place).normalize().any_orthonormal_vector();
            let other = (*end - place).normalize().cross(side);
            let bone = if k == 0 { String::new() } else { format!(" {}", k + 1) };
            for (word, offset) in [("middle", DVec3::ZERO), ("side", side), ("other side", -side), ("front", other)] {
                add(&format!("{bone} {word}"), middle + offset * across);
            }
        }
    }
    grips
}
