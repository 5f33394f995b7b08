//! Skeletons without names, and skeletons that lie in the scan already.

use super::*;

#[test]
fn nameless_joints_are_told_by_their_form() {
    let model = person(0.3);
    // The left side first, and the right.
    let other: Vec<usize> = [0..5, 10..15, 5..10, 19..23, 15..19].into_iter().flatten().collect();
    for order in [(0..MIXAMO.len()).collect(), other] {
        let plain = Actor::like(&model, 1.0);
        let place = |joint: usize| order.iter().position(|&j| j == joint).unwrap();
        let actor = Actor {
            names: order.iter().map(|&j| plain.names[j].clone()).collect(),
            parents: order.iter().map(|&j| plain.parents[j].map(place)).collect(),
            offsets: order.iter().map(|&j| plain.offsets[j]).collect(),
            axes: order.iter().map(|&j| plain.axes[j]).collect(),
        };
        let named = actor.capture(&Bend::default(), &exercise());
        let unnamed = nameless(actor).capture(&Bend::default(), &exercise());
        let [Motion::Skeleton(take), Motion::Skeleton(blank)] = [&named.motion, &unnamed.motion] else { unreachable!() };
        let rig = |take| Rig { take, mirror: false };
        let by_name = cast::by_names(&rig(take), false, &BTreeMap::new()).unwrap();
        let by_form = form::cast(&rig(blank), false).unwrap();
        assert_eq!(by_form.arms, by_name.arms);
        assert_eq!(by_form.legs, by_name.legs);
        assert_eq!((by_form.spine, by_form.neck, by_form.head), (by_name.spine, by_name.neck, by_name.head));
        let binding = bound(&model, &unnamed, &Options::default()).unwrap();
        assert!(binding.notes.iter().any(|n| n.contains("the form of the skeleton tells")));
    }
}

#[test]
fn what_a_person_carries_in_one_hand_is_not_the_hand() {
    let model = person(0.3);
    let mut actor = Actor::like(&model, 1.0);
    let index = |name: &str| MIXAMO.iter().position(|m| m.0 == name).unwrap();
    // Short arms, so that a stick in one hand makes the lengths more like those of others.
    ["LeftForeArm", "LeftHand", "RightForeArm", "RightHand"].iter().for_each(|name| actor.offsets[index(name)] *= 0.7);
    let exact = |capture: &Capture, by_form: bool| {
        let Motion::Skeleton(take) = &capture.motion else { unreachable!() };
        let rig = Rig { take, mirror: false };
        if by_form { form::cast(&rig, false).unwrap() } else { cast::by_names(&rig, false, &BTreeMap::new()).unwrap() }
    };
    let expected = exact(&actor.capture(&Bend::default(), &exercise()), false);
    let hand = index("RightHandMiddle1");
    for length in [0.1, 0.3, 0.45] {
        let mut armed = nameless(Actor::like(&model, 1.0));
        armed.offsets.clone_from(&actor.offsets);
        armed.names.push("Bone.stick".into());
        armed.parents.push(actor.parents[hand]);
        armed.offsets.push(actor.offsets[hand] + actor.offsets[hand].normalize() * length);
        armed.axes.push(DQuat::IDENTITY);
        let found = exact(&armed.capture(&Bend::default(), &exercise()), true);
        assert_eq!(found.arms, expected.arms, "{length}");
    }
}

#[test]
fn a_tree_that_is_no_person_is_no_cast() {
    let model = person(0.3);
    let mut actor = Actor::like(&model, 1.0);
    // Arms as long as legs, and a neck like a horse's.
    for (j, name) in MIXAMO.iter().enumerate() {
        let stretch = if name.0.contains("Arm") || name.0 == "Neck" { 2.2 } else { 1.0 };
        actor.offsets[j] *= stretch;
        actor.names[j] = format!("Bone.{j:03}");
    }
    let capture = actor.capture(&Bend::default(), &exercise());
    let Motion::Skeleton(take) = &capture.motion else { unreachable!() };
    assert!(form::cast(&Rig { take, mirror: false }, false).is_none());
    assert_eq!(bound(&model, &capture, &Options::default()).unwrap_err().exit_code(), 3);
}

#[test]
fn a_skeleton_that_lies_in_the_scan_moves_it_as_it_is() {
    let model = person(0.5);
    let mut actor = Actor::like(&model, 1.0);
    actor.axes.reverse();
    // In the scan's own axes and metres.
    let pose = |bend: &Bend| -> Vec<(DVec3, DQuat)> {
        actor.pose(bend).into_iter().map(|(p, q)| (z_up().inverse() * p / 100.0, z_up().inverse() * q)).collect()
    };
    let mut capture = actor.capture(&Bend::default(), &[]);
    let Motion::Skeleton(take) = &mut capture.motion else { unreachable!() };
    for (joint, (p, q)) in take.joints.iter_mut().zip(pose(&Bend::default())) {
        (joint.rest, joint.rest_turn) = (p, q);
    }
    for (p, q) in exercise().iter().flat_map(&pose) {
        take.origins.points.push(p.to_array().map(|x| x as f32));
        take.rotations.push(q.to_array().map(|x| x as f32));
    }
    let space = Space::default();
    let scan = ScanShape { tree: &model.tree, unit_box: model.unit_box, space: &space, mesh: None };
    let nobody = NotHuman::default();
    let binding = crate::binding::bind(&scan, Err(nobody), &capture, None, &Options::default(), &|_, _| Ok(())).unwrap();
    let at = |frame: usize, name: &str| {
        let j = actor.names.iter().position(|n| n == name).unwrap();
        model.unit_box.enter(pose(&exercise()[frame])[j].0)
    };
    for name in ["LeftHand", "RightLeg", "Head"] {
        assert!(
            attachment(&binding, name)
                .distance(model.unit_box.enter(pose(&Bend::default())[actor.names.iter().position(|n| n == name).unwrap()].0))
                < 1e-6
        );
        assert!(target(&binding, 11, name).distance(at(11, name)) < 1e-6, "{name}");
    }
    // Somewhere else it is refused.
    let Motion::Skeleton(take) = &mut capture.motion else { unreachable!() };
    take.joints.iter_mut().for_each(|joint| joint.rest += DVec3::X * 3.0);
    take.origins.points.iter_mut().for_each(|p| p[0] += 3.0);
    let error = crate::binding::bind(&scan, Err(NotHuman::default()), &capture, None, &Options::default(), &|_, _| Ok(()));
    assert_eq!(error.unwrap_err().exit_code(), 3);
}

/// The actor's skeleton in the model's own axes and metres, changed by `shift` after a turn about up and a scale.
fn in_the_scan(actor: &Actor, rest: &Bend, frames: &[Bend], size: f64, turn: f64, shift: DVec3) -> Capture {
    let back = DQuat::from_rotation_y(turn);
    let pose = |bend: &Bend| -> Vec<(DVec3, DQuat)> {
        let posed = actor.pose(bend).into_iter();
        posed.map(|(p, q)| (back * z_up().inverse() * p / 100.0 * size + shift, back * z_up().inverse() * q)).collect()
    };
    let mut capture = actor.capture(&Bend::default(), &[]);
    let Motion::Skeleton(take) = &mut capture.motion else { unreachable!() };
    for (joint, (p, q)) in take.joints.iter_mut().zip(pose(rest)) {
        (joint.rest, joint.rest_turn) = (p, q);
    }
    for (p, q) in frames.iter().flat_map(pose) {
        take.origins.points.push(p.to_array().map(|x| x as f32));
        take.rotations.push(q.to_array().map(|x| x as f32));
    }
    capture
}

const AS_IT_IS: &str = "nothing was moved";

fn says(binding: &Binding, words: &str) -> bool {
    binding.notes.iter().any(|n| n.contains(words))
}

#[test]
fn joints_elsewhere_are_not_taken_as_they_are() {
    let model = person(0.5);
    let actor = Actor::like(&model, 1.0);
    let away = in_the_scan(&actor, &Bend::default(), &exercise(), 1.0, 0.0, DVec3::X * 4.0);
    let none = Options { align: Align::None, ..Options::default() };
    let error = bound(&model, &away, &none).unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains("no joint of the skeleton lies in the scan"), "{error}");
    let accepted = bound(&model, &away, &Options { accept_doubtful: true, ..none.clone() }).unwrap();
    assert!(says(&accepted, "accepted as it is") && !says(&accepted, AS_IT_IS));

    let small = in_the_scan(&actor, &Bend::default(), &exercise(), 0.37, 0.0, DVec3::ZERO);
    assert_eq!(bound(&model, &small, &none).unwrap_err().exit_code(), 3);
    let scaled = bound(&model, &small, &Options { scale: Some(1.0 / 0.37), yaw: Some(20.0), ..none.clone() }).unwrap();
    assert!(says(&scaled, AS_IT_IS) && says(&scaled, "--yaw not used"));
    assert!((scaled.decisions.scale * 0.37 - 1.0).abs() < 1e-6, "{}", scaled.decisions.scale);
    let inches = in_the_scan(&actor, &Bend::default(), &exercise(), 1.0 / 0.0254, 0.0, DVec3::ZERO);
    let told = Options { capture_unit: Some(Unit::Inch), scan_unit: Some(Unit::Metre), ..none.clone() };
    assert!(says(&bound(&model, &inches, &told).unwrap(), AS_IT_IS));
}

#[test]
fn a_frame_in_which_the_joints_lie_in_the_scan_holds_them() {
    let model = person(0.5);
    let actor = Actor::like(&model, 1.0);
    // At rest, and in the first frames, the skeleton is another; frame 3 is as the scan.
    let far = Bend { root: DVec3::X * 5.0, ..Bend::default() };
    let frames = [far.clone(), far.clone(), Bend::default(), exercise()[11].clone()];
    let capture = in_the_scan(&actor, &far, &frames, 1.0, 0.0, DVec3::ZERO);
    let space = Space::default();
    let scan = ScanShape { tree: &model.tree, unit_box: model.unit_box, space: &space, mesh: None };
    let animal = || crate::binding::bind(&scan, Err(NotHuman::default()), &capture, None, &Options::default(), &|_, _| Ok(()));
    for binding in [animal(), bound(&model, &capture, &Options::default())] {
        let binding = binding.unwrap();
        assert_eq!((binding.decisions.align, binding.decisions.reference_frame), (Align::None, 3));
        for h in &binding.handles {
            assert!(target(&binding, 2, &h.label).distance(h.attachment) < 1e-6, "{}", h.label);
        }
        assert!(binding.decisions.bind_line().starts_with("none · reference frame 3 (1–4)"), "{}", binding.decisions.bind_line());
    }
    let first = Options { align: Align::None, reference: Reference::Frame(1), ..Options::default() };
    assert_eq!(bound(&model, &capture, &first).unwrap_err().exit_code(), 3);
}

#[test]
fn only_joints_inside_a_person_are_taken_as_they_are() {
    let model = person(0.5);
    let actor = Actor::like(&model, 1.0);
    let align = |size: f64, turn: f64, shift: DVec3| {
        let capture = in_the_scan(&actor, &Bend::default(), &[Bend::default()], size, turn, shift);
        bound(&model, &capture, &Options::default()).unwrap().decisions.align
    };
    assert_eq!(align(1.0, 0.0, DVec3::ZERO), Align::None);
    // In the way of a person, turned round in the same place, and of another size.
    assert_eq!(align(1.0, 0.0, DVec3::new(0.15, 0.0, 0.1)), Align::Retarget);
    assert_eq!(align(1.0, std::f64::consts::PI, DVec3::ZERO), Align::Retarget);
    assert_eq!(align(0.88, 0.0, DVec3::ZERO), Align::Retarget);
    // Without toes, who is turned round lies in the scan too.
    let mut stumps = Actor::like(&model, 1.0);
    let toes = stumps.offsets.iter_mut().zip(MIXAMO).filter(|(_, made)| made.0.ends_with("ToeBase"));
    toes.for_each(|(offset, _)| *offset = DVec3::Z * 0.01);
    for (turn, expected) in [(0.0, Align::None), (std::f64::consts::PI, Align::Retarget)] {
        let capture = in_the_scan(&stumps, &Bend::default(), &[Bend::default()], 1.0, turn, DVec3::ZERO);
        assert_eq!(bound(&model, &capture, &Options::default()).unwrap().decisions.align, expected, "{turn}");
    }
    let capture = in_the_scan(&actor, &Bend::default(), &[Bend::default()], 1.0, 0.0, DVec3::ZERO);
    let asked = Options { align: Align::Retarget, ..Options::default() };
    assert_eq!(bound(&model, &capture, &asked).unwrap().decisions.align, Align::Retarget);
}

/// The actor without telling names.
fn nameless(mut actor: Actor) -> Actor {
    actor.names.iter_mut().enumerate().for_each(|(j, name)| *name = format!("Bone.{j:03}"));
    actor
}

/// Refused with these words, accepted as doubtful.
fn doubtful(model: &Person, capture: &Capture, words: &str) {
    let error = bound(model, capture, &Options::default()).unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains(words), "{error}");
    let accepted = bound(model, capture, &Options { accept_doubtful: true, ..Options::default() }).unwrap();
    assert!(says(&accepted, words));
}

#[test]
fn a_person_told_by_form_stands_as_the_file_says() {
    let model = person(0.3);
    let mut capture = nameless(Actor::like(&model, 1.0)).capture(&Bend::default(), &exercise()[..3]);
    for (index, right) in [(2, true), (1, false)] {
        let up = Axis { index, negative: false };
        capture.space.up = Some(Known::new(up, Evidence::File));
        match right {
            true => assert!(bound(&model, &capture, &Options::default()).is_ok()),
            false => doubtful(&model, &capture, "where the file says +Y"),
        }
    }
}

#[test]
fn a_person_told_by_form_stands_somewhat_like_the_scan() {
    let far = Nearness { pose: Pose::Frame(0), angle: FAR + 20.0 };
    let check = |by_form: bool, rest: bool, accept_doubtful: bool| {
        let mut notes = Notes::default();
        let options = Options { accept_doubtful, ..Options::default() };
        check_pose(by_form, rest, far, &options, &mut notes).map(|()| notes.iter().count())
    };
    assert_eq!(check(true, false, false).unwrap_err().exit_code(), 3);
    assert_eq!(check(true, false, true).unwrap(), 1);
    assert_eq!(check(false, false, false).unwrap(), 1);
    assert_eq!(check(true, true, false).unwrap(), 0);
}

#[test]
fn chains_of_very_many_joints_are_no_limbs() {
    let model = person(0.3);
    let plain = nameless(Actor::like(&model, 1.0));
    for (links, person) in [(3, true), (70, false)] {
        let mut actor = Actor { names: Vec::new(), parents: Vec::new(), offsets: Vec::new(), axes: Vec::new() };
        let mut last = Vec::new();
        for (j, parent) in plain.parents.iter().enumerate() {
            // Upper arms and thighs in many links.
            let parts = if matches!(MIXAMO[j].0, "LeftForeArm" | "RightForeArm" | "LeftLeg" | "RightLeg") { links } else { 1 };
            let mut above = parent.map(|p: usize| last[p]);
            for _ in 0..parts {
                actor.names.push(format!("Bone.{:03}", actor.names.len()));
                actor.parents.push(above);
                actor.offsets.push(plain.offsets[j] / f64::from(parts));
                actor.axes.push(plain.axes[j]);
                above = Some(actor.names.len() - 1);
            }
            last.push(actor.names.len() - 1);
        }
        let capture = actor.capture(&Bend::default(), &exercise()[..2]);
        let Motion::Skeleton(take) = &capture.motion else { unreachable!() };
        assert_eq!(form::cast(&Rig { take, mirror: false }, false).is_some(), person, "{links}");
    }
}

#[test]
fn handles_beside_a_skeleton_have_any_name_but_a_joints() {
    let model = person(0.5);
    let capture = Actor::like(&model, 1.0).capture(&Bend::default(), &exercise());
    let space = Space::default();
    let scan = ScanShape { tree: &model.tree, unit_box: model.unit_box, space: &space, mesh: None };
    let add = |name: &str| {
        let (mut capture, mut binding) = (capture.clone(), bound(&model, &capture, &Options::default()).unwrap());
        let table = crate::capture::handles_csv::HandleTable {
            names: vec![name.to_owned()],
            first_frame: 1,
            points: vec![model.unit_box.leave(attachment(&binding, "chest")); 12],
            turns: vec![DQuat::IDENTITY; 12],
            oriented: vec![false],
            source: "handles.csv".into(),
        };
        crate::binding::driven::add_handles(&scan, &mut capture, &mut binding, &table, &[]).map(|()| binding)
    };
    for name in ["chest", "left elbow", "neck"] {
        assert_eq!(add(name).unwrap().handles.iter().filter(|h| h.known_as() == name).count(), 1, "{name}");
    }
    let error = add("LeftArm").unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("has the name of a joint"), "{error}");
}
