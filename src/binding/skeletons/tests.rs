//! Made skeletons with arbitrary axes at their joints, posed by known turns.

mod unnamed;

use super::*;
use crate::binding::landmarks::{Joint as Landmark, NotHuman};
use crate::binding::tests::{Person, person};
use crate::capture::{Joint, Motion};
use crate::error::Kind;
use crate::space::{Axis, Space, Unit};
use glam::DMat3;
use std::collections::BTreeMap;

/// Name, parent, and landmark or place in metres (y up, facing +z, left is +x).
type Made = (&'static str, Option<&'static str>, At);

#[derive(Clone, Copy)]
enum At {
    Mark(Landmark),
    Point(f64, f64, f64),
}

const MIXAMO: [Made; 23] = {
    use At::{Mark, Point};
    use Landmark::*;
    [
        ("Hips", None, Point(0.0, 0.96, 0.0)),
        ("Spine", Some("Hips"), Point(0.0, 1.05, 0.0)),
        ("Spine1", Some("Spine"), Point(0.0, 1.3, 0.0)),
        ("Neck", Some("Spine1"), Mark(Neck)),
        ("Head", Some("Neck"), Mark(Head)),
        ("LeftShoulder", Some("Spine1"), Point(0.05, 1.4, 0.0)),
        ("LeftArm", Some("LeftShoulder"), Mark(LeftShoulder)),
        ("LeftForeArm", Some("LeftArm"), Mark(LeftElbow)),
        ("LeftHand", Some("LeftForeArm"), Mark(LeftWrist)),
        ("LeftHandMiddle1", Some("LeftHand"), Mark(LeftHandTip)),
        ("RightShoulder", Some("Spine1"), Point(-0.05, 1.4, 0.0)),
        ("RightArm", Some("RightShoulder"), Mark(RightShoulder)),
        ("RightForeArm", Some("RightArm"), Mark(RightElbow)),
        ("RightHand", Some("RightForeArm"), Mark(RightWrist)),
        ("RightHandMiddle1", Some("RightHand"), Mark(RightHandTip)),
        ("LeftUpLeg", Some("Hips"), Mark(LeftHip)),
        ("LeftLeg", Some("LeftUpLeg"), Mark(LeftKnee)),
        ("LeftFoot", Some("LeftLeg"), Mark(LeftAnkle)),
        ("LeftToeBase", Some("LeftFoot"), Mark(LeftToe)),
        ("RightUpLeg", Some("Hips"), Mark(RightHip)),
        ("RightLeg", Some("RightUpLeg"), Mark(RightKnee)),
        ("RightFoot", Some("RightLeg"), Mark(RightAnkle)),
        ("RightToeBase", Some("RightFoot"), Mark(RightToe)),
    ]
};

/// A skeleton of an actor `size` times a person, in centimetres with z up.
struct Actor {
    names: Vec<String>,
    parents: Vec<Option<usize>>,
    /// From the parent, in the person's axes and metres.
    offsets: Vec<DVec3>,
    /// The joint's own axes at the person's rest.
    axes: Vec<DQuat>,
}

/// Turns of joints in the person's axes, after those of their parents; and the place of the root.
#[derive(Clone, Default)]
struct Bend {
    turns: Vec<(&'static str, DVec3)>,
    root: DVec3,
}

fn bend(turns: &[(&'static str, DVec3)]) -> Bend {
    Bend { turns: turns.to_vec(), root: DVec3::ZERO }
}

/// From a person's axes (y up, facing +z) into the capture's (z up, facing −y).
fn z_up() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y))
}

impl Actor {
    fn like(model: &Person, size: f64) -> Self {
        let place = |at: At| match at {
            At::Mark(joint) => model.unit_box.leave(model.body.joints[joint as usize]) * size,
            At::Point(x, y, z) => DVec3::new(x, y, z) * size,
        };
        let index = |name: &str| MIXAMO.iter().position(|m| m.0 == name).unwrap();
        let parents: Vec<Option<usize>> = MIXAMO.iter().map(|m| m.1.map(index)).collect();
        let offsets =
            (0..MIXAMO.len()).map(|j| place(MIXAMO[j].2) - parents[j].map_or(DVec3::ZERO, |p| place(MIXAMO[p].2))).collect();
        let axes = (0..MIXAMO.len()).map(|j| DQuat::from_scaled_axis(DVec3::new(j as f64, 1.0 - j as f64, 0.7) * 0.4)).collect();
        Self { names: MIXAMO.iter().map(|m| m.0.to_owned()).collect(), parents, offsets, axes }
    }

    /// Places and turns of all joints, in centimetres with z up, facing −y for a person that faces +z.
    fn pose(&self, bend: &Bend) -> Vec<(DVec3, DQuat)> {
        let out = z_up();
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for j in 0..self.names.len() {
            let (above, turn) = self.parents[j].map_or((bend.root, DQuat::IDENTITY), |p| world[p]);
            let own = bend.turns.iter().filter(|t| self.names[j].ends_with(t.0));
            let own = own.fold(DQuat::IDENTITY, |q, t| q * DQuat::from_scaled_axis(t.1));
            world.push((above + turn * self.offsets[j], turn * own));
        }
        world.iter().zip(&self.axes).map(|((p, q), axes)| (out * *p * 100.0, out * *q * *axes)).collect()
    }

    fn capture(&self, rest: &Bend, frames: &[Bend]) -> Capture {
        let at_rest = self.pose(rest);
        let joints = (0..self.names.len()).map(|j| {
            let (rest, rest_turn) = at_rest[j];
            Joint { name: self.names[j].clone(), parent: self.parents[j], rest, rest_turn, end: false }
        });
        let mut take = SkeletonTake { joints: joints.collect(), ..SkeletonTake::default() };
        take.origins.labels = self.names.clone();
        for frame in frames {
            for (p, q) in self.pose(frame) {
                take.origins.points.push(p.to_array().map(|x| x as f32));
                take.rotations.push(q.to_array().map(|x| x as f32));
            }
        }
        Capture {
            name: "made".to_owned(),
            rate: 100.0,
            first_frame: 1,
            space: Space::default(),
            motion: Motion::Skeleton(take),
            source: "made.bvh".into(),
            cleaning: crate::capture::Cleaning::default(),
            notes: Notes::default(),
        }
    }
}

fn bound(person: &Person, capture: &Capture, options: &Options) -> Result<Binding> {
    let space = Space::default();
    let scan = ScanShape { tree: &person.tree, unit_box: person.unit_box, space: &space, mesh: None };
    crate::binding::bind(&scan, Ok(person.body.clone()), capture, None, options, &|_, _| Ok(()))
}

/// By its label, or by what follows the joint's name in it.
fn handle<'a>(binding: &'a Binding, label: &str) -> &'a BoundMarker {
    let named = |h: &&BoundMarker| h.label == label || h.label.ends_with(&format!(" \u{203a} {label}"));
    binding.handles.iter().find(named).unwrap_or_else(|| panic!("no handle {label}"))
}

/// Where a handle goes in a frame, in the unit box.
fn target(binding: &Binding, frame: usize, label: &str) -> DVec3 {
    let h = handle(binding, label);
    binding.trajectories.as_ref().unwrap().point(frame, h.marker).unwrap()
}

fn attachment(binding: &Binding, label: &str) -> DVec3 {
    handle(binding, label).attachment
}

/// Limbs as ends in the binding and in the skeleton.
const LIMBS: [(&str, &str, &str, &str); 8] = [
    ("left shoulder", "left elbow", "LeftArm", "LeftForeArm"),
    ("left elbow", "left wrist", "LeftForeArm", "LeftHand"),
    ("right shoulder", "right elbow", "RightArm", "RightForeArm"),
    ("right elbow", "right wrist", "RightForeArm", "RightHand"),
    ("left hip", "left knee", "LeftUpLeg", "LeftLeg"),
    ("left knee", "left ankle", "LeftLeg", "LeftFoot"),
    ("right hip", "right knee", "RightUpLeg", "RightLeg"),
    ("right knee", "right ankle", "RightLeg", "RightFoot"),
];

/// Largest angle between a limb of the scan and the skeleton's, over the frames, in degrees. Both bodies stand alike at yaw 0.
fn worst_limb(binding: &Binding, capture: &Capture) -> f64 {
    let back = z_up().inverse();
    let joints = capture.motion.points();
    let place = |frame: usize, name: &str| {
        back * joints.point(frame, joints.labels.iter().position(|l| l.ends_with(name)).unwrap()).unwrap()
    };
    let mut worst = 0.0_f64;
    for frame in 0..joints.frames() {
        for (a, b, from, to) in LIMBS {
            let scan = target(binding, frame, b) - target(binding, frame, a);
            worst = worst.max(scan.angle_between(place(frame, to) - place(frame, from)).to_degrees());
        }
    }
    worst
}

/// Frames that bend everything, the first as the actor stands.
fn exercise() -> Vec<Bend> {
    (0..12)
        .map(|k| {
            let s = f64::from(k) / 11.0;
            let v = |x, y, z| DVec3::new(x, y, z) * s;
            Bend {
                turns: vec![
                    ("Hips", v(0.3, 0.8, -0.2)),
                    ("Spine", v(0.4, 0.2, 0.1)),
                    ("LeftArm", v(0.5, 0.3, -1.2)),
                    ("LeftForeArm", v(0.0, -1.5, 0.0)),
                    ("LeftHand", v(0.4, 0.0, 0.2)),
                    ("RightArm", v(-0.7, 0.9, 0.8)),
                    ("RightForeArm", v(0.0, 1.9, 0.3)),
                    ("LeftUpLeg", v(-1.1, 0.0, 0.2)),
                    ("LeftLeg", v(1.4, 0.0, 0.0)),
                    ("RightUpLeg", v(0.5, 0.2, -0.3)),
                    ("RightLeg", v(0.6, 0.0, 0.0)),
                    ("Head", v(0.0, 0.9, 0.0)),
                ],
                root: v(0.4, -0.1, 0.9),
            }
        })
        .collect()
}

/// Arms from the model's own level to `down` radians below it.
fn arms_down(down: f64) -> Bend {
    bend(&[("LeftArm", DVec3::Z * -down), ("RightArm", DVec3::Z * down)])
}

/// A pose that nobody stands in: what files have whose rest means nothing.
fn tangle() -> Bend {
    bend(&[
        ("Hips", DVec3::new(0.4, 2.0, 1.1)),
        ("LeftArm", DVec3::new(2.0, 0.3, 0.4)),
        ("RightArm", DVec3::new(0.2, 2.4, 1.0)),
        ("LeftUpLeg", DVec3::new(2.2, 0.0, 1.0)),
        ("RightUpLeg", DVec3::new(-1.4, 1.0, 0.0)),
        ("LeftForeArm", DVec3::new(0.0, 1.9, 0.0)),
    ])
}

#[test]
fn limbs_point_where_the_skeletons_do_whatever_the_rest() {
    let model = person(0.0);
    let actor = Actor::like(&model, 1.2);
    for (arms, rest) in [(0.0, Bend::default()), (0.8, Bend::default()), (0.0, arms_down(1.4)), (0.8, tangle())] {
        let scan = person(arms);
        let capture = actor.capture(&rest, &exercise());
        let binding = bound(&scan, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
        let worst = worst_limb(&binding, &capture);
        assert!(worst < 0.01, "arms {arms}: {worst}°");
        let tangled = rest.turns.len() > 2;
        assert_eq!(binding.decisions.reference_rest, !tangled, "nobody stands in a tangle");
        let stature = scan.body.stature;
        for (a, b, ..) in LIMBS {
            let rest = attachment(&binding, a).distance(attachment(&binding, b));
            let posed = target(&binding, 11, a).distance(target(&binding, 11, b));
            assert!((posed - rest).abs() < 1e-5 * stature, "{a}: {rest} {posed}");
        }
    }
}

#[test]
fn a_rest_whose_turns_mean_nothing_is_not_used() {
    // As networks write them: the chest is turned by a right angle against the rest, and the shoulders undo it.
    let model = person(0.4);
    let actor = Actor::like(&model, 1.0);
    let frames: Vec<Bend> = exercise()
        .into_iter()
        .map(|mut frame| {
            let quarter = DVec3::Y * 1.5;
            frame.turns.extend([("Spine1", quarter), ("LeftShoulder", -quarter), ("RightShoulder", -quarter)]);
            frame
        })
        .collect();
    let capture = actor.capture(&Bend::default(), &frames);
    let binding = bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
    assert!(!binding.decisions.reference_rest);
    // The first frame is the model's own pose but for the places of the shoulders: the chest faces the front there.
    let front = target(&binding, 0, "trunk 86 front") - target(&binding, 0, "trunk 86 back");
    assert!(front.angle_between(DVec3::Z).to_degrees() < 20.0, "{front}");
}

/// Joints above the hips, in the middle of the pelvis: before, both thighs hang on the pelvis itself.
fn linked(mut actor: Actor, links: [&str; 2]) -> Actor {
    for (side, link) in ["Left", "Right"].into_iter().zip(links) {
        let hip = actor.names.iter().position(|n| *n == format!("{side}UpLeg")).unwrap();
        actor.names.insert(hip, link.to_owned());
        actor.parents.insert(hip, Some(0));
        actor.offsets.insert(hip, DVec3::ZERO);
        actor.axes.insert(hip, DQuat::IDENTITY);
        actor.parents.iter_mut().flatten().filter(|p| **p >= hip).for_each(|parent| *parent += 1);
        actor.parents[hip + 1] = Some(hip);
    }
    actor
}

#[test]
fn nor_is_a_rest_whose_pelvis_turns_without_its_hips() {
    let model = person(0.4);
    let actor = linked(Actor::like(&model, 1.0), ["LHipJoint", "RHipJoint"]);
    let with = |turn: f64| {
        let frames = exercise().into_iter().map(|mut frame| {
            let turn = DVec3::Y * turn;
            frame.turns.extend([("Hips", turn), ("LHipJoint", -turn), ("RHipJoint", -turn), ("Spine", -turn)]);
            frame
        });
        let capture = actor.capture(&Bend::default(), &frames.collect::<Vec<_>>());
        bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap().decisions.reference_rest
    };
    assert!(with(0.0) && !with(1.5));
}

/// Turn about an axis of the line from one point of the scan to another, against rest, radians.
fn turn_about(binding: &Binding, frame: usize, axis: DVec3, [from, to]: [&str; 2]) -> f64 {
    let across = |v: DVec3| v - axis * v.dot(axis);
    let rest = across(attachment(binding, to) - attachment(binding, from));
    let posed = across(target(binding, frame, to) - target(binding, frame, from));
    rest.cross(posed).dot(axis).atan2(rest.dot(posed))
}

#[test]
fn bent_elbows_and_knees_tell_the_twist_above_them() {
    let model = person(0.0);
    // A rest that means nothing; in the only frame elbows bend to the front and knees to the back, of limbs that are twisted.
    let frame = bend(&[
        ("LeftArm", DVec3::X * 0.6),
        ("LeftForeArm", -DVec3::Y),
        ("RightArm", DVec3::X * -0.4),
        ("RightForeArm", DVec3::Y),
        ("LeftUpLeg", DVec3::Y * 0.5),
        ("LeftLeg", DVec3::X),
    ]);
    let capture = Actor::like(&model, 1.0).capture(&tangle(), &[frame]);
    let binding = bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
    for (axis, part, twist) in
        [(DVec3::X, "left upper arm 68", 0.6), (DVec3::X, "right upper arm 68", -0.4), (DVec3::Y, "left thigh 68", 0.5)]
    {
        let turned = turn_about(&binding, 0, axis, [&format!("{part} back"), &format!("{part} front")]);
        assert!((turned - twist).abs() < 0.03, "{part}: {turned}");
    }
}

#[test]
fn without_a_rest_the_frame_nearest_to_the_scan_tells() {
    let model = person(0.0);
    let frames = [0.6, 0.3, 0.0, 0.001, 0.4].map(arms_down);
    let capture = Actor::like(&model, 1.0).capture(&tangle(), &frames);
    let binding = bound(&model, &capture, &Options::default()).unwrap();
    // Of two that are as near the first.
    assert_eq!(binding.decisions.reference_frame, 3);
}

#[test]
fn feet_that_stand_are_level_wherever_the_toes_are_joined() {
    let model = person(0.4);
    let mut actor = Actor::like(&model, 1.0);
    for name in ["LeftToeBase", "RightToeBase"] {
        let toe = actor.names.iter().position(|n| n == name).unwrap();
        actor.offsets[toe].y = 0.0;
    }
    let capture = actor.capture(&Bend::default(), &vec![Bend::default(); 8]);
    let binding = bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
    let lifted = target(&binding, 7, "left ankle") - attachment(&binding, "left ankle");
    for label in ["left foot 60 out", "right foot 60 in", "left toes 85 front"] {
        let moved = target(&binding, 7, label) - attachment(&binding, label) - lifted;
        assert!(moved.length() < 1e-3 * model.body.stature, "{label}: {moved}");
    }
}

#[test]
fn shoulders_slide_on_the_chest_but_not_away() {
    let model = person(0.0);
    let actor = Actor::like(&model, 1.0);
    let frames = [0.0, 0.3, 2.5].map(|up| bend(&[("LeftShoulder", DVec3::Z * up)]));
    let binding = bound(&model, &actor.capture(&Bend::default(), &frames), &Options::default()).unwrap();
    let moved = |frame: usize| {
        let from_chest = |place: &dyn Fn(&str) -> DVec3| place("left shoulder") - place("chest");
        from_chest(&|label| target(&binding, frame, label)) - from_chest(&|label| attachment(&binding, label))
    };
    let arm = actor.offsets[actor.names.iter().position(|n| n == "LeftArm").unwrap()];
    let truth = (DQuat::from_rotation_z(0.3) * arm - arm) / model.unit_box.diagonal;
    assert!(moved(0).length() < 1e-5 && (moved(1) - truth).length() < 1e-4, "{} {}", moved(1), truth);
    assert!((moved(2).length() - 0.08 * model.body.stature).abs() < 1e-4, "{}", moved(2).length());
}

#[test]
fn hips_almost_in_one_point_do_not_tell_left() {
    let model = person(0.4);
    let mut actor = Actor::like(&model, 1.0);
    for (name, x) in [("LeftUpLeg", 0.002), ("RightUpLeg", -0.002)] {
        let hip = actor.names.iter().position(|n| n == name).unwrap();
        actor.offsets[hip] = DVec3::new(x, -0.03, 3.0 * x);
    }
    let capture = actor.capture(&Bend::default(), &vec![Bend::default(); 3]);
    let binding = bound(&model, &capture, &Options::default()).unwrap();
    let front = target(&binding, 0, "trunk 86 front") - target(&binding, 0, "trunk 86 back");
    assert!(binding.decisions.yaw.abs() < 1.0 && front.angle_between(DVec3::Z) < 0.1, "{} {front}", binding.decisions.yaw);
}

#[test]
fn a_stub_under_the_ankle_is_no_toe() {
    let model = person(0.4);
    let mut actor = Actor::like(&model, 1.0);
    for name in ["LeftToeBase", "RightToeBase"] {
        let toe = actor.names.iter().position(|n| n == name).unwrap();
        let forward = std::mem::replace(&mut actor.offsets[toe], DVec3::Y * -0.07);
        actor.names.push(format!("{name}_End"));
        actor.parents.push(Some(toe));
        actor.offsets.push(forward - actor.offsets[toe]);
        actor.axes.push(DQuat::IDENTITY);
    }
    let capture = actor.capture(&Bend::default(), &exercise());
    let binding = bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
    // The first frame is the model's own pose: the toes are where they are at rest.
    for label in ["left toes 85 out", "right toes 85 in", "left foot 0 back"] {
        // All of the body may be lifted onto the floor.
        let lifted = target(&binding, 0, "left ankle") - attachment(&binding, "left ankle");
        let moved = target(&binding, 0, label) - attachment(&binding, label) - lifted;
        assert!(moved.length() < 1e-3 * model.body.stature, "{label}: {moved}");
    }
}

#[test]
#[allow(clippy::print_stderr)]
fn an_animal_without_names_of_a_person_is_refused() {
    let shared = std::env::var_os("RETARGET_SHARED").map_or_else(|| "../shared".into(), std::path::PathBuf::from);
    let fox = shared.join("data/motion/gltf/Fox.glb");
    if !fox.exists() {
        eprintln!("skipped: {} is not there", fox.display());
        return;
    }
    let capture = crate::capture::read(&fox, &crate::capture::ReadOptions::default()).unwrap();
    let error = bound(&person(0.4), &capture, &Options::default()).unwrap_err();
    assert_eq!(error.exit_code(), 3);
    assert!(error.to_string().contains("have not the lengths of a person's"), "{error}");
}

#[test]
fn hips_in_one_point_are_a_link_more() {
    let model = person(0.4);
    let actor = linked(Actor::like(&model, 1.0), ["__LeftUpLeg", "__RightUpLeg"]);
    let capture = actor.capture(&Bend::default(), &exercise());
    let Motion::Skeleton(take) = &capture.motion else { unreachable!() };
    let cast = cast::by_names(&Rig { take, mirror: false }, false, &BTreeMap::new()).unwrap();
    assert_eq!(take.joints[cast.legs[0].hip].name, "LeftUpLeg");
    assert_eq!(take.joints[cast.pelvis()].name, "Hips");
}

#[test]
fn the_line_tells_names_family_space_and_size() {
    let model = person(0.0);
    let capture = Actor::like(&model, 1.2).capture(&Bend::default(), &exercise());
    let binding = bound(&model, &capture, &Options::default()).unwrap();
    let d = &binding.decisions;
    assert_eq!(d.capture_up.map(|u| u.value), Some(Axis { index: 2, negative: false }));
    assert_eq!(d.capture_unit.map(|u| u.value), Some(Unit::Centimetre));
    assert!(d.reference_rest && d.reference_frame == 1);
    assert!((d.scale * 1.2 - 1.0).abs() < 1e-3, "{}", d.scale);
    assert!(d.yaw.abs() < 0.1, "{}", d.yaw);
    assert!(d.bind_line().contains(" · 23 of 23 joints named (mixamo) · 109 points hold the body"), "{}", d.bind_line());
    assert!(d.bind_line().starts_with("retarget · reference the file's rest, placed in frame 1 (1–12)"), "{}", d.bind_line());
    assert!(d.proportions.iter().all(|p| (p.1 - 1.0).abs() < 1e-2), "{:?}", d.proportions);
}

#[test]
fn a_body_that_is_the_actors_own_follows_exactly() {
    let model = person(0.0);
    let actor = Actor::like(&model, 1.0);
    let frames = exercise();
    let capture = actor.capture(&Bend::default(), &frames);
    let binding = bound(&model, &capture, &Options { yaw: Some(0.0), ..Options::default() }).unwrap();
    // Parts that move with one joint and no sliding shoulder: rings round legs, pelvis and the hip joints themselves.
    let rest = actor.pose(&Bend::default());
    let shift = target(&binding, 0, "left hip") - attachment(&binding, "left hip");
    for (label, joint) in [
        ("left thigh 68 front", "LeftUpLeg"),
        ("left shank 78 out", "LeftLeg"),
        ("right thigh 68 in", "RightUpLeg"),
        ("right shank 32 back", "RightLeg"),
        ("left ankle", "LeftLeg"),
        ("trunk 18 back", "Hips"),
    ] {
        let j = actor.names.iter().position(|n| n == joint).unwrap();
        let local = z_up() * model.unit_box.leave(attachment(&binding, label)) * 100.0;
        for (f, frame) in frames.iter().enumerate() {
            let (p, q) = actor.pose(frame)[j];
            let truth = p + q * rest[j].1.inverse() * (local - rest[j].0);
            let truth = model.unit_box.enter(z_up().inverse() * truth / 100.0) + shift;
            let far = target(&binding, f, label).distance(truth);
            assert!(far < 2e-5, "{label} in frame {f}: {far}");
        }
    }
}

#[test]
fn twist_follows_the_hand_and_half_of_it_the_cuff() {
    let model = person(0.0);
    let actor = Actor::like(&model, 1.0);
    // The left arm lies along +x.
    let frames: Vec<Bend> = (0..=9).map(|k| bend(&[("LeftHand", DVec3::X * 0.15 * f64::from(k))])).collect();
    let mut capture = actor.capture(&Bend::default(), &frames);
    for negated in [false, true] {
        // Two quaternions stand for one turn.
        let Motion::Skeleton(take) = &mut capture.motion else { unreachable!() };
        take.rotations.iter_mut().step_by(if negated { 2 } else { 1 }).for_each(|q| *q = q.map(|x| -x));
        let binding = bound(&model, &capture, &Options::default()).unwrap();
        let turned = |ends: [&str; 2]| turn_about(&binding, 9, DVec3::X, ends);
        assert!((turned(["left hand 40 back", "left hand 40 front"]) - 1.35).abs() < 1e-3);
        assert!((turned(["left forearm 82 back", "left forearm 82 front"]) - 0.675).abs() < 1e-3);
        assert!(turned(["left forearm 32 back", "left forearm 32 front"]).abs() < 1e-3);
    }
}

#[test]
fn a_spin_all_round_is_followed_without_a_jump() {
    let model = person(0.8);
    let actor = Actor::like(&model, 1.0);
    let frames: Vec<Bend> = (0..=72).map(|k| bend(&[("Hips", DVec3::Y * f64::from(k) * 5f64.to_radians())])).collect();
    let binding = bound(&model, &actor.capture(&Bend::default(), &frames), &Options::default()).unwrap();
    for h in &binding.handles {
        let path: Vec<DVec3> = (0..=72).map(|f| target(&binding, f, &h.label)).collect();
        let step = path.windows(2).map(|w| w[0].distance(w[1])).fold(0.0, f64::max);
        assert!(step < 0.06 * model.body.stature, "{}: {step}", h.label);
        assert!(path[0].distance(path[72]) < 1e-5, "{}", h.label);
        assert!(path[0].distance(h.attachment) < 1e-4, "{}: {}", h.label, path[0] - h.attachment);
    }
}

#[test]
fn feet_stand_on_the_floor_of_the_scan_and_steps_scale_with_the_legs() {
    let model = person(0.0);
    let actor = Actor::like(&model, 0.5);
    let frames: Vec<Bend> = (0..20).map(|k| Bend { root: DVec3::new(0.0, 7.0, 0.1 * f64::from(k)), ..Bend::default() }).collect();
    let binding = bound(&model, &actor.capture(&Bend::default(), &frames), &Options::default()).unwrap();
    let ankle = |f: usize| target(&binding, f, "left ankle");
    assert!((ankle(0).y - attachment(&binding, "left ankle").y).abs() < 1e-4);
    // Who crouches from the first frame on stands on it too.
    let crouch = [-0.9, 1.8, -0.9].map(|angle| DVec3::X * angle);
    let joints = ["LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot"];
    let crouch: Vec<_> = joints.into_iter().zip(crouch.into_iter().cycle()).collect();
    let crouching = bound(&model, &actor.capture(&Bend::default(), &vec![bend(&crouch); 4]), &Options::default()).unwrap();
    let height = target(&crouching, 3, "right ankle").y - attachment(&crouching, "right ankle").y;
    assert!(height.abs() < 1e-3, "{height}");
    // Twice as long legs take twice as long steps.
    let way = (ankle(19) - ankle(0)) * model.unit_box.diagonal;
    assert!((way - DVec3::new(0.0, 0.0, 3.8)).length() < 2e-3, "{way}");
}

#[test]
fn what_is_missing_of_a_person_is_named() {
    let model = person(0.0);
    let mut actor = Actor::like(&model, 1.0);
    // An elbow and a knee without names, and arms too long for a person's form.
    for (name, offset) in actor.names.iter_mut().zip(&mut actor.offsets) {
        if name.contains("Arm") {
            *offset *= 2.5;
        }
        if name == "LeftForeArm" || name == "RightLeg" {
            *name = format!("Thing {}", name.len());
        }
    }
    let error = bound(&model, &actor.capture(&Bend::default(), &exercise()), &Options::default()).unwrap_err();
    assert_eq!(error.exit_code(), 3);
    assert!(error.to_string().contains("no left elbow") && error.to_string().contains("no right knee"), "{error}");
}

#[test]
fn exchanged_sides_are_refused_and_the_option_puts_them_right() {
    let model = person(0.0);
    let mut actor = Actor::like(&model, 1.0);
    for name in &mut actor.names {
        *name = match (name.strip_prefix("Left"), name.strip_prefix("Right")) {
            (Some(rest), _) => format!("Right{rest}"),
            (_, Some(rest)) => format!("Left{rest}"),
            _ => continue,
        };
    }
    let capture = actor.capture(&Bend::default(), &exercise());
    let error = bound(&model, &capture, &Options::default()).unwrap_err();
    assert_eq!(error.kind, Kind::Ambiguous);
    let put_right = Options { swap_sides: true, ..Options::default() };
    let binding = bound(&model, &capture, &put_right).unwrap();
    assert!(binding.decisions.yaw.abs() < 0.1);
}

#[test]
fn mirrored_axes_are_undone() {
    let model = person(0.0);
    let actor = Actor::like(&model, 1.0);
    let plain = actor.capture(&Bend::default(), &exercise());
    let mut mirrored = plain.clone();
    let Motion::Skeleton(take) = &mut mirrored.motion else { unreachable!() };
    take.origins.points.iter_mut().for_each(|p| p[0] = -p[0]);
    take.rotations.iter_mut().for_each(|q| *q = [q[0], -q[1], -q[2], q[3]]);
    for joint in &mut take.joints {
        joint.rest.x = -joint.rest.x;
        let q = joint.rest_turn;
        joint.rest_turn = DQuat::from_xyzw(q.x, -q.y, -q.z, q.w);
    }
    let error = bound(&model, &mirrored, &Options::default()).unwrap_err();
    assert_eq!(error.kind, Kind::Ambiguous);
    let a = bound(&model, &plain, &Options::default()).unwrap();
    let b = bound(&model, &mirrored, &Options { mirror: true, ..Options::default() }).unwrap();
    let far = a.handles.iter().map(|h| target(&a, 11, &h.label).distance(target(&b, 11, &h.label))).fold(0.0, f64::max);
    assert!(far < 1e-5, "{far}");
}
