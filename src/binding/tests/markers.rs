//! Markers that are unknown, doubtful or not there.

use super::*;

#[test]
fn unknown_labels_go_to_the_segment_that_they_move_with() {
    let person = person(0.75);
    let mut words = PLUG_IN_GAIT.to_vec();
    words.extend(["RFT1", "sword"]);
    let labels = labels_of(&words);
    let named = labels_of(&PLUG_IN_GAIT);
    let mut seen = landmarks_of(&person, &named);
    let skeleton = Skeleton::of(&person.body);
    let shank = skeleton.bone(Segment::RightShank);
    let extra = shank.origin.lerp(shank.end, 0.6) + shank.forward * 0.03;
    seen.push(Observation { marker: DVec3::ZERO, place: extra, segment: Segment::RightShank, weight: 0.5 });
    let frames: Vec<Vec<DVec3>> = (0..12)
        .map(|k| {
            let swing = (f64::from(k) * 0.5).sin() * 0.6;
            let turns = [
                (Segment::RightThigh, DVec3::X * swing),
                (Segment::RightShank, DVec3::X * (0.6 - swing)),
                (Segment::RightFoot, DVec3::X * 0.5 * swing),
                (Segment::LeftThigh, DVec3::X * -swing),
                (Segment::LeftUpperArm, DVec3::X * swing),
            ];
            let mut frame = fit::simulate(&skeleton, &seen, &turns, &[]);
            // Swung about on its own.
            frame.push(DVec3::new(0.4, 0.1 * f64::from(k % 3), 0.3 * swing));
            frame
        })
        .collect();
    let binding = bound(&person, &take(&person, &labels, &frames, 0.4, 0.5), &Options::default()).unwrap();
    let handle = binding.handles.iter().find(|h| h.label == "RFT1").unwrap();
    assert_eq!(handle.segment, Some(Segment::RightShank));
    assert!((handle.attachment - extra).length() < 0.02 * person.body.stature);
    assert_eq!(binding.unbound.len(), 1);
    assert_eq!(binding.unbound[0].0, "sword");
}

#[test]
fn an_unknown_label_that_moves_nearly_as_a_prop_does_pulls_softly() {
    let person = person(0.75);
    let mut words = PLUG_IN_GAIT.to_vec();
    words.extend(["steady", "sway"]);
    let labels = labels_of(&words);
    let mut seen = landmarks_of(&person, &labels_of(&PLUG_IN_GAIT));
    let skeleton = Skeleton::of(&person.body);
    let shank = skeleton.bone(Segment::RightShank);
    let place = shank.origin.lerp(shank.end, 0.6) + shank.forward * 0.03;
    seen.extend([(); 2].map(|()| Observation { marker: DVec3::ZERO, place, segment: Segment::RightShank, weight: 0.5 }));
    let frames: Vec<Vec<DVec3>> = (0..20)
        .map(|k| {
            let foot = (Segment::RightFoot, DVec3::X * 0.8 * (k as f64 * 0.35).sin());
            let mut frame = fit::simulate(&skeleton, &seen, &[&stride(k)[..], &[foot]].concat(), &[]);
            // A prop moves 2 % of height against its segment; these do 0.5 % and 1.5 %.
            for (marker, far) in [(35, 0.005), (36, 0.015)] {
                frame[marker] += DVec3::X * far * person.body.stature * [-1.0, 1.0][k % 2] * f64::from(u8::from(k > 0));
            }
            frame
        })
        .collect();
    let binding = bound(&person, &take(&person, &labels, &frames, 0.4, 0.5), &Options::default()).unwrap();
    let hardness = |label: &str| binding.handles.iter().find(|h| h.label == label).map(|h| (h.segment, h.beta < 1.0));
    assert_eq!(hardness("steady"), Some((Some(Segment::RightShank), false)));
    assert_eq!(hardness("sway"), Some((Some(Segment::RightShank), true)));
    assert!(binding.notes.iter().any(|n| n.starts_with("1 doubtful marker pulls softly: sway 1.")), "{:?}", binding.notes);
}

#[test]
fn a_belt_marker_on_a_folding_belly_is_held_softly() {
    let person = person(0.75);
    let mut words = PLUG_IN_GAIT.to_vec();
    words.push("MFWT");
    let labels = labels_of(&words);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let frames: Vec<Vec<DVec3>> = (0..20)
        .map(|k| {
            let swing = f64::from(k) * 0.05;
            let mut frame = fit::simulate(&skeleton, &seen, &[(Segment::LeftThigh, DVec3::X * -swing)], &[]);
            if let Some(belt) = frame.last_mut().filter(|_| k > 10) {
                *belt -= skeleton.forward * 0.1 * skeleton.stature * swing;
            }
            frame
        })
        .collect();
    let binding = bound(&person, &take(&person, &labels, &frames, 0.4, 0.5), &Options::default()).unwrap();
    let soft: Vec<&str> = binding.handles.iter().filter(|h| h.beta < 1.0).map(|h| h.label.as_str()).collect();
    assert_eq!(soft, ["MFWT"]);
}

#[test]
fn a_lower_body_set_binds_legs_and_pelvis_and_says_so() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT[19..]);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let turns = [(Segment::LeftThigh, DVec3::X * -0.3), (Segment::LeftShank, DVec3::X * 0.4)];
    let frame = fit::simulate(&skeleton, &seen, &turns, &[]);
    let binding = bound(&person, &take(&person, &labels, &[frame], 0.4, 0.5), &Options::default()).unwrap();
    assert_eq!(binding.handles.len(), 16);
    assert!(worst(&person, &labels, &binding) < 0.03, "{}", worst(&person, &labels, &binding));
    assert!(binding.notes.iter().any(|n| n.starts_with("no upper-body markers")));
}

#[test]
fn legs_without_markers_are_said_and_not_planted() {
    let person = person(0.75);
    let skeleton = Skeleton::of(&person.body);
    let bound_by = |words: &[&str]| {
        let labels = labels_of(words);
        let seen = landmarks_of(&person, &labels);
        // Who stands and sways: hips that go to and fro carry the feet of legs that hang from them along.
        let sway = |k: usize| DVec3::X * (0.004 * (k as f64 * 0.05).sin());
        let frames: Vec<Vec<DVec3>> =
            (0..80).map(|k| fit::simulate(&skeleton, &seen, &[], &[]).into_iter().map(|p| p + sway(k)).collect()).collect();
        let capture = take(&person, &labels, &frames, 0.4, 0.5);
        bound(&person, &capture, &Options { align: Align::Retarget, ..Options::default() }).unwrap()
    };
    let is_said = |binding: &Binding| binding.notes.iter().any(|n| n.starts_with("no markers on the legs"));
    let whole = bound_by(&PLUG_IN_GAIT);
    assert!(!is_said(&whole));
    assert_eq!(whole.decisions.feet.map(|slip| slip.contacts), Some(2));
    let upper = bound_by(&PLUG_IN_GAIT[..23]);
    assert!(is_said(&upper), "{:?}", upper.notes);
    assert!(upper.decisions.feet.is_none(), "{:?}", upper.decisions.feet);
}

#[test]
fn legs_much_longer_than_the_scans_are_named() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let ratios = [(Ratio::Thigh, 1.3), (Ratio::Shank, 1.3)];
    let frame = fit::simulate(&skeleton, &seen, &[], &ratios);
    let options = Options { align: Align::Pose, ..Options::default() };
    let binding = bound(&person, &take(&person, &labels, &[frame], 0.4, 0.5), &options).unwrap();
    let note = binding.notes.iter().find(|n| n.starts_with("actor and scan differ in build")).unwrap();
    assert!(note.contains("thigh 1."), "{note}");
}
