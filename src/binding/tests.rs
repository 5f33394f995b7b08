//! Made people: bodies of capsules, captured by markers at the dictionary's places.

mod markers;

use super::fit::{self, Observation, Ratio};
use super::landmarks::{Arms, Body, Joint, NotHuman};
use super::segments::{Segment, Side, Skeleton};
use super::*;
use crate::capture::{Capture, MarkerTake, Motion};
use crate::error::Kind;
use crate::space::{Evidence, Known};
use glam::DQuat;
use std::f64::consts::TAU;

pub(super) const PLUG_IN_GAIT: [&str; 35] = [
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAK", "LSHO", "LELB", "LWRA", "LWRB", "LFIN", "RSHO", "RELB",
    "RWRA", "RWRB", "RFIN", "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE", "RTHI", "RKNE",
    "RTIB", "RANK", "RHEE", "RTOE",
];

/// A person 1.75 m tall in metres, y up, facing +z, arms at `arms` radians below the horizontal; then scaled to the unit box.
pub(super) struct Person {
    pub body: Body,
    pub tree: TriangleTree,
    pub unit_box: UnitBox,
}

pub(super) fn person(arms: f64) -> Person {
    use Joint::*;
    let mut joints = [DVec3::ZERO; Joint::COUNT];
    let mut set = |joint: Joint, x: f64, y: f64, z: f64| joints[joint as usize] = DVec3::new(x, y, z);
    set(MidHip, 0.0, 0.93, 0.0);
    set(Neck, 0.0, 1.46, -0.02);
    set(Head, 0.0, 1.56, 0.0);
    set(Crown, 0.0, 1.75, 0.0);
    let (c, s) = (arms.cos(), arms.sin());
    for (x, [shoulder, elbow, wrist, tip], [hip, knee, ankle, toe]) in [
        (1.0, [LeftShoulder, LeftElbow, LeftWrist, LeftHandTip], [LeftHip, LeftKnee, LeftAnkle, LeftToe]),
        (-1.0, [RightShoulder, RightElbow, RightWrist, RightHandTip], [RightHip, RightKnee, RightAnkle, RightToe]),
    ] {
        for (joint, along) in [(shoulder, 0.0), (elbow, 0.29), (wrist, 0.54), (tip, 0.73)] {
            set(joint, x * (0.18 + along * c), 1.42 - along * s, 0.0);
        }
        set(hip, x * 0.09, 0.93, 0.0);
        set(knee, x * 0.12, 0.50, 0.01);
        set(ankle, x * 0.14, 0.08, -0.02);
        set(toe, x * 0.16, 0.02, 0.19);
    }
    let at = |joint: Joint| joints[joint as usize];
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    let mut capsule = |a: DVec3, b: DVec3, r: f64| add_capsule(&mut points, &mut triangles, a, b, r);
    capsule(at(MidHip), at(Neck), 0.14);
    capsule(at(LeftHip), at(RightHip), 0.11);
    capsule(at(LeftShoulder), at(RightShoulder), 0.06);
    capsule(at(Neck), at(Head), 0.06);
    capsule(at(Head), DVec3::new(0.0, 1.66, 0.0), 0.09);
    for limb in [
        [LeftShoulder, LeftElbow, LeftWrist, LeftHandTip, LeftHip, LeftKnee, LeftAnkle, LeftToe],
        [RightShoulder, RightElbow, RightWrist, RightHandTip, RightHip, RightKnee, RightAnkle, RightToe],
    ] {
        for (a, b, r) in [(0, 1, 0.05), (1, 2, 0.04), (2, 3, 0.03), (4, 5, 0.08), (5, 6, 0.055), (6, 7, 0.045)] {
            capsule(at(limb[a]), at(limb[b]), r);
        }
    }
    let (lo, hi) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p: &DVec3| (l.min(*p), h.max(*p)));
    let unit_box = UnitBox { centre: (lo + hi) * 0.5, diagonal: (hi - lo).length() };
    let entered: Vec<DVec3> = points.iter().map(|&p| unit_box.enter(p)).collect();
    let body = Body {
        joints: joints.map(|p| unit_box.enter(p)),
        up: DVec3::Y,
        forward: DVec3::Z,
        facing_ratio: 5.0,
        margin: 0.8,
        cost: 0.1,
        stature: 1.75 / unit_box.diagonal,
        arm_elevation: [-arms.to_degrees(); 2],
        arms: Arms::Apart,
        floor: None,
    };
    Person { body, tree: TriangleTree::new(&entered, &triangles), unit_box }
}

fn add_capsule(points: &mut Vec<DVec3>, triangles: &mut Vec<[u32; 3]>, a: DVec3, b: DVec3, r: f64) {
    let axis = (b - a).normalize();
    let x = axis.any_orthonormal_vector();
    let y = axis.cross(x);
    let first = points.len() as u32;
    const AROUND: u32 = 12;
    // Rings as (end, height along the axis, radius), in radii.
    let rings = [(a, -0.99, 0.05), (a, -0.7, 0.714), (a, 0.0, 1.0), (b, 0.0, 1.0), (b, 0.7, 0.714), (b, 0.99, 0.05)];
    for (end, along, radius) in rings {
        for k in 0..AROUND {
            let (s, c) = (TAU * f64::from(k) / f64::from(AROUND)).sin_cos();
            points.push(end + axis * along * r + (x * c + y * s) * radius * r);
        }
    }
    for ring in 0..rings.len() as u32 - 1 {
        for k in 0..AROUND {
            let (i, j) = (first + ring * AROUND + k, first + ring * AROUND + (k + 1) % AROUND);
            triangles.push([i, j, j + AROUND]);
            triangles.push([i, j + AROUND, i + AROUND]);
        }
    }
    for k in 1..AROUND - 1 {
        triangles.push([first, first + k + 1, first + k]);
        let top = first + (rings.len() as u32 - 1) * AROUND;
        triangles.push([top, top + k, top + k + 1]);
    }
}

/// The landmarks of labels on a person, as observations.
pub(super) fn landmarks_of(person: &Person, labels: &[String]) -> Vec<Observation> {
    let skeleton = Skeleton::of(&person.body);
    let named = labels::name(labels, &vec![1; labels.len()], false);
    named
        .iter()
        .map(|(i, place)| Observation {
            marker: DVec3::new(i as f64, 0.0, 0.0),
            place: places::on_skin(place, &skeleton, &person.tree),
            segment: place.segment(),
            weight: place.weight,
        })
        .collect()
}

pub(super) fn labels_of(words: &[&str]) -> Vec<String> {
    words.iter().map(|&w| w.to_owned()).collect()
}

/// Frames of markers in millimetres, z up, turned by `yaw` about up and shifted; noise of `noise` millimetres.
pub(super) fn take(person: &Person, labels: &[String], frames: &[Vec<DVec3>], yaw: f64, noise: f64) -> Capture {
    let to_capture = DQuat::from_axis_angle(DVec3::Z, yaw) * similarity::turn_between(DVec3::Y, DVec3::Z);
    let mut seed = 12345u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as f64 / f64::from(u32::MAX >> 1) * 2.0 - 1.0
    };
    let mut points = Vec::new();
    for frame in frames {
        for &p in frame {
            let jitter = DVec3::new(random(), random(), random()) * noise;
            let q = to_capture * person.unit_box.leave(p) * 1000.0 + DVec3::new(800.0, -300.0, 0.0) + jitter;
            points.push([q.x as f32, q.y as f32, q.z as f32]);
        }
    }
    Capture {
        name: "made".to_owned(),
        rate: 100.0,
        first_frame: 1,
        space: Space { unit: Some(Known::new(Unit::Millimetre, Evidence::File)), ..Space::default() },
        motion: Motion::Markers(MarkerTake { labels: labels.to_vec(), points, ..MarkerTake::default() }),
        source: "made.c3d".into(),
        cleaning: crate::capture::Cleaning::default(),
        notes: Notes::default(),
    }
}

pub(super) fn bound(person: &Person, capture: &Capture, options: &Options) -> Result<Binding> {
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    bind(&scan, Ok(person.body.clone()), capture, None, options, &|_, _| Ok(()))
}

/// Largest distance between attachments and the landmarks that the markers were made from, in statures.
fn worst(person: &Person, labels: &[String], binding: &Binding) -> f64 {
    let truth = landmarks_of(person, labels);
    let far = binding.handles.iter().map(|h| (h.attachment - truth[h.marker].place).length());
    far.fold(0.0, f64::max) / person.body.stature
}

#[test]
fn another_pose_of_the_same_person_is_carried_back_to_the_scan() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let turns = [
        (Segment::LeftUpperArm, DVec3::new(0.0, -0.2, -0.5)),
        (Segment::RightUpperArm, DVec3::new(-0.4, 0.0, 0.4)),
        (Segment::LeftForearm, DVec3::new(-0.5, 0.0, 0.0)),
        (Segment::LeftThigh, DVec3::new(-0.4, 0.0, 0.0)),
        (Segment::LeftShank, DVec3::new(0.5, 0.0, 0.0)),
        (Segment::Trunk, DVec3::new(0.1, 0.1, 0.0)),
    ];
    let frame = fit::simulate(&skeleton, &seen, &turns, &[]);
    let binding = bound(&person, &take(&person, &labels, &[frame], 1.2, 3.0), &Options::default()).unwrap();
    assert_eq!(binding.decisions.align, Align::Pose);
    assert_eq!(binding.handles.len(), 35);
    assert!((binding.decisions.scale - 1.0).abs() < 0.02, "{:?}", binding.decisions.scale);
    assert!(worst(&person, &labels, &binding) < 0.02, "{}", worst(&person, &labels, &binding));
    for handle in &binding.handles {
        assert_eq!(handle.segment, Some(seen[handle.marker].segment), "{}", handle.label);
    }
}

#[test]
fn proportions_are_taken_out_of_the_attachments() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let ratios = [(Ratio::Thigh, 1.10), (Ratio::Shank, 1.06), (Ratio::Torso, 0.94), (Ratio::UpperArm, 0.95)];
    let turns = [(Segment::LeftUpperArm, DVec3::new(0.0, 0.0, 0.4)), (Segment::RightUpperArm, DVec3::new(0.0, 0.0, -0.4))];
    let frame = fit::simulate(&skeleton, &seen, &turns, &ratios);
    let binding = bound(&person, &take(&person, &labels, &[frame], -2.0, 2.0), &Options::default()).unwrap();
    assert!(worst(&person, &labels, &binding) < 0.03, "{}", worst(&person, &labels, &binding));
    let ratio = |name: &str| binding.decisions.proportions.iter().find(|p| p.0 == name).unwrap().1;
    assert!(ratio("thigh") > 1.04 && ratio("torso") < 0.98, "{:?}", binding.decisions.proportions);
}

#[test]
fn the_frame_nearest_to_the_scans_pose_is_the_reference() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let frames: Vec<Vec<DVec3>> = (0..9)
        .map(|k| {
            let angle = 0.2 * (f64::from(k) - 6.0);
            let turns = [(Segment::LeftUpperArm, DVec3::Z * angle), (Segment::RightUpperArm, DVec3::Z * -angle)];
            fit::simulate(&skeleton, &seen, &turns, &[])
        })
        .collect();
    let binding = bound(&person, &take(&person, &labels, &frames, 0.4, 0.5), &Options::default()).unwrap();
    assert_eq!(binding.decisions.reference_frame, 7);
    assert_eq!(binding.decisions.align, Align::Similarity);
    assert!(worst(&person, &labels, &binding) < 0.005);
}

#[test]
fn mirrored_markers_are_refused_with_the_options_that_decide() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let frame = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let mut capture = take(&person, &labels, &[frame], 0.4, 0.5);
    let markers = capture.motion.points_mut();
    for p in &mut markers.points {
        p[0] = -p[0];
    }
    let error = bound(&person, &capture, &Options::default()).unwrap_err();
    assert_eq!(error.exit_code(), 3);
    let text = error.to_string();
    assert!(text.contains("--mirror") && text.contains("--swap-sides"), "{text}");
    let mended = bound(&person, &capture, &Options { mirror: true, ..Options::default() }).unwrap();
    assert!(worst(&person, &labels, &mended) < 0.01);
}

#[test]
fn swapped_labels_are_mended_by_swap_sides() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let frame: Vec<DVec3> = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let swapped: Vec<String> = labels
        .iter()
        .map(|l| match l.chars().next() {
            Some('L') => format!("R{}", &l[1..]),
            Some('R') => format!("L{}", &l[1..]),
            _ => l.clone(),
        })
        .collect();
    let capture = take(&person, &swapped, &[frame], 0.0, 0.0);
    assert!(bound(&person, &capture, &Options::default()).is_err());
    let mended = bound(&person, &capture, &Options { swap_sides: true, ..Options::default() }).unwrap();
    assert!(worst(&person, &labels, &mended) < 0.01);
}

#[test]
fn a_capture_on_the_scan_is_bound_as_it_is() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let frame: Vec<DVec3> = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let mut capture = take(&person, &labels, std::slice::from_ref(&frame), 0.0, 0.0);
    let markers = capture.motion.points_mut();
    markers.points = frame.iter().map(|&p| person.unit_box.leave(p).as_vec3().to_array()).collect();
    capture.space.unit = None;
    let binding = bound(&person, &capture, &Options::default()).unwrap();
    assert_eq!(binding.decisions.align, Align::None);
    let (mut positions, mut present) = (Vec::new(), Vec::new());
    let markers = capture.motion.points();
    binding.targets(markers, 0, &mut positions, &mut present);
    for (handle, target) in binding.handles.iter().zip(&positions) {
        assert!((handle.attachment - target).length() < 1e-9);
    }
}

#[test]
fn what_is_no_body_is_refused_with_the_way_out() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let frame: Vec<DVec3> = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let capture = take(&person, &labels, &[frame], 0.4, 0.0);
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    let nobody = NotHuman { reason: "five limbs".to_owned(), margin_and_cost: Some((0.04, 0.6)) };
    let error = bind(&scan, Err(nobody), &capture, None, &Options::default(), &|_, _| Ok(())).unwrap_err();
    assert_eq!(error.exit_code(), 3);
    assert!(error.to_string().contains("--align none"));
    let few = labels_of(&["a", "b", "c", "LASI", "RASI"]);
    let mut nameless = capture.clone();
    let markers = nameless.motion.points_mut();
    markers.labels = few;
    markers.points.truncate(5);
    assert_eq!(bound(&person, &nameless, &Options::default()).unwrap_err().exit_code(), 3);
}

#[test]
fn arms_along_the_trunk_weigh_less_and_their_facing_must_be_clear() {
    let mut person = person(1.4);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    // The joints of the arms were found 5 % of the height too far back.
    let wrong = DVec3::Z * 0.05 * person.body.stature;
    let frame: Vec<DVec3> = seen.iter().map(|o| if o.segment.is_arm() { o.place + wrong } else { o.place }).collect();
    let capture = take(&person, &labels, &[frame], 0.4, 0.0);
    let misled = |binding: &Binding| {
        let others = binding.handles.iter().filter(|h| h.segment.is_some_and(|s| !s.is_arm()));
        others.map(|h| h.attachment.distance(seen[h.marker].place)).fold(0.0, f64::max)
    };
    let options = Options { align: Align::Pose, ..Options::default() };
    let apart = misled(&bound(&person, &capture, &options).unwrap());
    person.body.arms = Arms::Hanging;
    let binding = bound(&person, &capture, &options).unwrap();
    assert!(binding.notes.iter().any(|n| n.contains("arms touch the body")));
    let hanging = misled(&binding);
    assert!(hanging < 0.8 * apart, "{hanging} against {apart}");
    person.body.facing_ratio = 1.4;
    let error = bound(&person, &capture, &options).unwrap_err();
    assert_eq!(error.exit_code(), 3);
    assert!(error.to_string().contains("--flip"), "{error}");
    assert!(bound(&person, &capture, &Options { accept_doubtful: true, ..options }).is_ok());
}

#[test]
fn user_values_of_yaw_and_scale_are_kept() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let frame: Vec<DVec3> = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let capture = take(&person, &labels, &[frame], 0.3, 0.0);
    let options = Options { yaw: Some(-20.0), scale: Some(0.97), ..Options::default() };
    let binding = bound(&person, &capture, &options).unwrap();
    assert!((binding.decisions.yaw + 20.0).abs() < 1e-9);
    assert!((binding.decisions.scale - 0.97).abs() < 1e-9);
}

#[test]
fn arms_below_the_scans_are_measured() {
    let person = person(0.0);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let turns = [(Segment::LeftUpperArm, DVec3::Z * -1.0), (Segment::RightUpperArm, DVec3::Z * 1.0)];
    let frame = fit::simulate(&skeleton, &seen, &turns, &[]);
    let observations: Vec<Observation> = seen.iter().zip(&frame).map(|(o, &marker)| Observation { marker, ..*o }).collect();
    let found = fit::fit(&skeleton, &observations);
    for side in [Side::Left, Side::Right] {
        assert!((found.arm_elevation(&skeleton, side) + 57.3).abs() < 4.0);
    }
}

/// Turns of a person who walks on the spot, swings the arms and nods.
pub(super) fn stride(k: usize) -> [(Segment, DVec3); 8] {
    let swing = (k as f64 * 0.35).sin();
    [
        (Segment::Trunk, DVec3::Y * 0.2 * swing),
        (Segment::Head, DVec3::X * 0.2 * swing),
        (Segment::LeftUpperArm, DVec3::new(0.5 * swing, 0.0, -0.4)),
        (Segment::RightUpperArm, DVec3::new(-0.5 * swing, 0.0, 0.4)),
        (Segment::LeftThigh, DVec3::X * -0.5 * swing),
        (Segment::LeftShank, DVec3::X * (0.5 + 0.4 * swing)),
        (Segment::RightThigh, DVec3::X * 0.5 * swing),
        (Segment::RightShank, DVec3::X * (0.5 - 0.4 * swing)),
    ]
}

/// Largest distance of the targets of all frames from those of the scan's own body in the same poses, each frame's mean shift taken out.
fn worst_target(binding: &Binding, truth: &[Vec<DVec3>], capture: &Capture) -> f64 {
    let (mut positions, mut present) = (Vec::new(), Vec::new());
    let mut worst = 0.0f64;
    for (frame, truth) in truth.iter().enumerate() {
        binding.targets(binding.take(capture), frame, &mut positions, &mut present);
        assert!(present.iter().all(|&p| p));
        let mean = positions.iter().zip(truth).map(|(a, b)| *a - *b).sum::<DVec3>() / truth.len() as f64;
        worst = positions.iter().zip(truth).map(|(a, b)| (*a - *b - mean).length()).fold(worst, f64::max);
    }
    worst
}

#[test]
fn an_actor_of_other_build_moves_the_scan_on_its_own_lengths() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let ratios = [(Ratio::Thigh, 1.2), (Ratio::Shank, 1.1), (Ratio::Torso, 0.9), (Ratio::UpperArm, 0.85), (Ratio::Forearm, 1.1)];
    let poses = |ratios: &[(Ratio, f64)]| -> Vec<Vec<DVec3>> {
        (0..30).map(|k| fit::simulate(&skeleton, &seen, &stride(k), ratios)).collect()
    };
    let (truth, capture) = (poses(&[]), take(&person, &labels, &poses(&ratios), 0.8, 0.5));
    let far = |align: Align| {
        let binding = bound(&person, &capture, &Options { align, ..Options::default() }).unwrap();
        (worst_target(&binding, &truth, &capture) / person.body.stature, binding)
    };
    let (retargeted, binding) = far(Align::Auto);
    assert_eq!(binding.decisions.align, Align::Retarget);
    let (posed, plain) = far(Align::Pose);
    assert!(retargeted < 0.02, "{retargeted}");
    assert!(posed > 2.0 * retargeted, "the actor's own lengths miss those of the scan: {posed} against {retargeted}");
    let strain = |b: &Binding| b.decisions.strain.unwrap().1;
    assert!(strain(&binding) < 0.5 * strain(&plain), "{} {}", strain(&binding), strain(&plain));
}

#[test]
fn steps_of_a_larger_actor_are_scaled_by_the_legs_and_stay_on_the_floor() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let ratios = [(Ratio::Thigh, 1.25), (Ratio::Shank, 1.25)];
    let way = |k: usize| DVec3::Z * (0.01 * k as f64);
    let frames: Vec<Vec<DVec3>> =
        (0..20).map(|k| fit::simulate(&skeleton, &seen, &[], &ratios).into_iter().map(|p| p + way(k)).collect()).collect();
    let capture = take(&person, &labels, &frames, 0.0, 0.0);
    let binding = bound(&person, &capture, &Options { align: Align::Retarget, ..Options::default() }).unwrap();
    let (mut first, mut last, mut present) = (Vec::new(), Vec::new(), Vec::new());
    binding.targets(binding.take(&capture), 0, &mut first, &mut present);
    binding.targets(binding.take(&capture), 19, &mut last, &mut present);
    for ((from, to), handle) in first.iter().zip(&last).zip(&binding.handles) {
        let step = (*to - *from).length() / way(19).length();
        assert!((step - 0.8).abs() < 0.02, "{}: {step}", handle.label);
        if handle.segment.is_some_and(|s| matches!(s, Segment::LeftFoot | Segment::RightFoot)) {
            let sunk = (*from - handle.attachment).dot(skeleton.up) / skeleton.stature;
            assert!(sunk.abs() < 0.005, "{} is {sunk} off the floor", handle.label);
        }
    }
}

/// A thing that no person is, and three or more of its markers with their places.
fn placed_thing(person: &Person, given: &[&str], frames: &[Vec<DVec3>], labels: &[String]) -> Result<Binding> {
    let places = &frames[0];
    let pinned = |word: &&str| (word.to_string(), Marker::At(places[labels.iter().position(|l| l == word).unwrap()]));
    let options = Options { markers: given.iter().map(pinned).collect(), ..Options::default() };
    let capture = take(person, labels, frames, 2.1, 0.0);
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    bind(&scan, Err(NotHuman::default()), &capture, None, &options, &|_, _| Ok(()))
}

#[test]
fn a_thing_is_placed_by_the_places_that_the_user_gives_for_some_of_its_markers() {
    let person = person(0.75);
    let labels = labels_of(&["nose", "withers", "hoof_1", "hoof_2", "tail"]);
    let on = landmarks_of(&person, &labels_of(&["LFHD", "LASI", "LANK", "RWRA", "RTOE"]));
    let rest: Vec<DVec3> = on.iter().map(|o| o.place).collect();
    let shift = DVec3::new(0.1, 0.02, -0.05);
    // Those whose places are given stay; the others move.
    let given = ["nose", "hoof_1", "hoof_2"];
    let moved = |(label, &p): (&String, &DVec3)| if given.contains(&label.as_str()) { p } else { p + shift };
    let frames = [rest.clone(), labels.iter().zip(&rest).map(moved).collect()];
    let binding = placed_thing(&person, &given, &frames, &labels).unwrap();
    assert_eq!((binding.decisions.align, binding.handles.len()), (Align::Similarity, 5));
    let capture = take(&person, &labels, &frames, 2.1, 0.0);
    for (frame, places) in frames.iter().enumerate() {
        for (handle, place) in binding.handles.iter().zip(places) {
            let target = binding.placement.apply(capture.motion.points().point(frame, handle.marker).unwrap());
            assert!((target - place).length() < 1e-5, "{} in frame {frame}: {target} and not {place}", handle.label);
        }
    }
    for (handle, place) in binding.handles.iter().zip(&rest) {
        assert!((handle.attachment - place).length() < 1e-5, "{}", handle.label);
    }
}

#[test]
fn a_marker_that_is_hidden_in_the_pose_of_the_scan_does_not_lead_to_another_pose() {
    let person = person(0.75);
    let given = ["nose", "withers", "hoof_1", "hoof_2", "tail"];
    let labels = labels_of(&given);
    let on = landmarks_of(&person, &labels_of(&["LFHD", "LASI", "LANK", "RWRA", "RTOE"]));
    let rest: Vec<DVec3> = on.iter().map(|o| o.place).collect();
    let pin = |(word, &p): (&&str, &DVec3)| (word.to_string(), Marker::At(p));
    let options = Options { markers: given.iter().zip(&rest).map(pin).collect(), ..Options::default() };
    // All are seen with the head down only; in the pose of the scan the tail is hidden.
    let bent = rest.iter().enumerate().map(|(i, &p)| if i == 0 { p - DVec3::Y * 0.12 } else { p }).collect();
    let mut hidden = rest.clone();
    hidden[4] = DVec3::NAN;
    let capture = take(&person, &labels, &[bent, hidden], 2.1, 0.0);
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    let binding = bind(&scan, Err(NotHuman::default()), &capture, None, &options, &|_, _| Ok(())).unwrap();
    assert_eq!(binding.decisions.reference_frame, 2);
    assert_eq!((binding.handles.len(), binding.handles[4].attachment), (5, rest[4]));
}

#[test]
fn places_that_do_not_tell_how_a_thing_lies_are_refused() {
    let person = person(0.75);
    let labels = labels_of(&["a", "b", "c", "d"]);
    let rest = vec![DVec3::ZERO, DVec3::X * 0.2, DVec3::X * 0.3, DVec3::Y * 0.2];
    for given in [&["a", "b"][..], &["a", "b", "c"]] {
        let error = placed_thing(&person, given, std::slice::from_ref(&rest), &labels).unwrap_err();
        assert!(error.exit_code() == 3 && error.to_string().contains("3 or more"), "{given:?}: {error}");
    }
    let capture = take(&person, &labels, std::slice::from_ref(&rest), 0.0, 0.0);
    let mut places: std::collections::BTreeMap<String, Marker> =
        labels.iter().zip(&rest).map(|(l, &p)| (l.clone(), Marker::At(p))).collect();
    places.insert("c".to_owned(), Marker::At(DVec3::X * -0.4));
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    let options = Options { markers: places, ..Options::default() };
    let error = bind(&scan, Err(NotHuman::default()), &capture, None, &options, &|_, _| Ok(())).unwrap_err();
    assert!(error.to_string().contains("do not fit their places"), "{error}");
}

#[test]
fn posing_a_take_tells_how_far_it_is_and_stops_when_asked() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let place: Vec<DVec3> = landmarks_of(&person, &labels).iter().map(|o| o.place).collect();
    let frames: Vec<Vec<DVec3>> = (0..40).map(|k| place.iter().map(|&p| p + DVec3::Z * 0.01 * f64::from(k)).collect()).collect();
    let capture = take(&person, &labels, &frames, 0.4, 0.0);
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    let options = Options { align: Align::Retarget, reference: Reference::Frame(11), ..Options::default() };
    let told = std::sync::Mutex::new(Vec::new());
    let bound = |stop: usize| {
        let watch = |done: usize, of: usize| {
            told.lock().unwrap().push((done, of));
            if done < stop { Ok(()) } else { Err(crate::error::Error::new(Kind::Interrupted, "enough")) }
        };
        bind(&scan, Ok(person.body.clone()), &capture, None, &options, &watch)
    };
    assert!(bound(usize::MAX).is_ok());
    assert_eq!(std::mem::take(&mut *told.lock().unwrap()), (1..40).map(|k| (k, 40)).collect::<Vec<_>>());
    assert_eq!(bound(35).unwrap_err().kind, Kind::Interrupted);
    assert_eq!(told.lock().unwrap().len(), 35, "nothing is done after the stop");
}
