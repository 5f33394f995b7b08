use super::*;
use crate::binding::tests::{PLUG_IN_GAIT, bound, labels_of, landmarks_of, person, stride, take};
use crate::binding::{Align, Binding, Marker, Options, fit, segments::Skeleton};
use crate::capture::Capture;
use glam::DVec3;
use std::sync::Arc;

fn targets(binding: &Binding, capture: &Capture) -> Vec<DVec3> {
    let (mut positions, mut present) = (Vec::new(), Vec::new());
    let take = binding.take(capture);
    (0..take.frames())
        .flat_map(|frame| {
            binding.targets(take, frame, &mut positions, &mut present);
            positions.clone()
        })
        .collect()
}

/// The same decisions, written and read.
fn thawed(binding: &Binding) -> Options {
    let rig = RigFile { frozen: binding.frozen.clone(), ..RigFile::default() };
    let read = RigFile::parse(&rig.to_text().unwrap()).unwrap();
    assert_eq!(read, rig, "{}", rig.to_text().unwrap());
    Options { frozen: read.frozen.map(Arc::new), ..Options::default() }
}

#[test]
fn every_section_is_read_and_written() {
    let text = r##"
[space]
scan_unit = "mm"
scan_up = "+Z"
capture_up = "-Y"
yaw = -12.5
flip = true

[reference]
frame = 12
file = "static.c3d"

[markers]
M1 = 812
M2 = "LELB"
M3 = [0.5, 1, -2.25]
RSWORD = "ignore"

[landmarks]
left_shoulder = 17
crown = [0.0, 1.8, 0.0]

[skeleton]
Bone_07 = "left elbow"
Root = "pelvis"

[[group]]
what = "color:#ff0000~20"
rigid = true

[[group]]
what = "upper_arms"
stiffness = 3.0
"##;
    let rig = RigFile::parse(text).unwrap();
    assert_eq!(rig.markers["M3"], Pin::At(Spot::Place(DVec3::new(0.5, 1.0, -2.25))));
    assert_eq!(rig.markers["M2"], Pin::As("LELB".to_owned()));
    assert_eq!(rig.landmarks[&Joint::LeftShoulder], Spot::Vertex(17));
    assert_eq!(RigFile::parse(&rig.to_text().unwrap()).unwrap(), rig);
}

#[test]
fn mistakes_are_told_with_their_place_and_the_nearest_word() {
    for (text, place, words) in [
        ("[space]\nyav = 3", "line 2, column 1", "yaw?"),
        ("[sapce]\n", "line 1, column 2", "space?"),
        ("[landmarks]\nleft_sholder = 3", "line 2", "left_shoulder?"),
        ("[markers]\nM1 = \"nonsense\"", "line 2", "no label that the dictionary knows"),
        ("[markers]\nM1 = [1, 2]", "line 2", "three"),
        ("[markers]\nM1 = -4", "line 2", "counted from 0"),
        ("[space]\nscan_unit = \"furlong\"", "line 2", "unknown unit"),
        ("[skeleton]\nBone = \"elbow\"", "line 2", "left or right"),
        ("[[group]]\nwhat = \"head\"", "[[group]]", "rigid = true or stiffness"),
        ("[[group]]\nwhat = \"head\"\nstiffness = -3.0", "[[group]]", "stiffness"),
        ("[space]\nscale = 0.0", "[space]", "above 0"),
        ("[space\n", "line 1", ""),
    ] {
        let error = RigFile::parse(text).unwrap_err();
        let shown = error.to_string();
        assert!(error.place.as_deref().is_some_and(|p| p.contains(place)), "{text}: {shown}");
        assert!(shown.contains(words), "{text}: {shown}");
    }
}

#[test]
fn frozen_decisions_give_the_same_bits_and_serve_other_takes() {
    let person = person(0.75);
    let labels = labels_of(&PLUG_IN_GAIT);
    let seen = landmarks_of(&person, &labels);
    let skeleton = Skeleton::of(&person.body);
    let ratios = [(fit::Ratio::Thigh, 1.15), (fit::Ratio::UpperArm, 0.9)];
    let frames = |from: usize| -> Vec<Vec<DVec3>> {
        (from..from + 12).map(|k| fit::simulate(&skeleton, &seen, &stride(k), &ratios)).collect()
    };
    let capture = take(&person, &labels, &frames(0), 0.7, 0.5);
    for align in [Align::Similarity, Align::Pose, Align::Retarget] {
        let first = bound(&person, &capture, &Options { align, ..Options::default() }).unwrap();
        let options = thawed(&first);
        let again = bound(&person, &capture, &options).unwrap();
        assert_eq!(again.decisions.align, align);
        assert_eq!(targets(&again, &capture), targets(&first, &capture), "{align}");
        assert_eq!(again.handles, first.handles, "{align}");
        assert_eq!(again.segments, first.segments);

        let mut other = take(&person, &labels, &frames(40), 0.7, 0.5);
        other.source = "other.c3d".into();
        let served = bound(&person, &other, &options).unwrap();
        assert!(served.handles.iter().zip(&first.handles).all(|(a, b)| a.attachment == b.attachment));
        if align != Align::Retarget {
            continue;
        }
        let anew = bound(&person, &other, &Options { align, ..Options::default() }).unwrap();
        let far = |a: &Binding, b: &Binding| {
            let shift = |b: &Binding| targets(b, &other).iter().sum::<DVec3>() / targets(b, &other).len() as f64;
            let (s, t) = (shift(a), shift(b));
            let pairs = targets(a, &other).into_iter().zip(targets(b, &other));
            pairs.map(|(p, q)| ((p - s) - (q - t)).length()).fold(0.0, f64::max) / person.body.stature
        };
        assert!(far(&served, &anew) < 0.08, "{align}: {}", far(&served, &anew));
    }
}

#[test]
fn labels_can_be_pinned_renamed_and_left_out() {
    let person = person(0.75);
    let mut words = PLUG_IN_GAIT;
    words[10] = "marker 11";
    let labels = labels_of(&words);
    let seen = landmarks_of(&person, &labels_of(&PLUG_IN_GAIT));
    let skeleton = Skeleton::of(&person.body);
    let frames: Vec<Vec<DVec3>> = (0..3).map(|k| fit::simulate(&skeleton, &seen, &stride(k), &[])).collect();
    let capture = take(&person, &labels, &frames, 0.7, 0.5);
    let of = |binding: &Binding, label: &str| binding.handles.iter().find(|h| h.label == label).cloned();
    assert!(of(&bound(&person, &capture, &Options::default()).unwrap(), "marker 11").is_none(), "three frames do not tell");

    let pin = seen[10].place + DVec3::Y * 0.004;
    let markers = |what: Marker| Options { markers: [("marker 11".to_owned(), what)].into(), ..Options::default() };
    let renamed = of(&bound(&person, &capture, &markers(Marker::As("LELB".to_owned()))).unwrap(), "marker 11").unwrap();
    assert_eq!(renamed.segment, Some(seen[10].segment));
    let pinned = of(&bound(&person, &capture, &markers(Marker::At(pin))).unwrap(), "marker 11").unwrap();
    assert_eq!(pinned.attachment, pin);
    let options = Options { markers: [("C7".to_owned(), Marker::Ignored)].into(), ..Options::default() };
    let without = bound(&person, &capture, &options).unwrap();
    assert!(of(&without, "C7").is_none());
    assert!(without.unbound.iter().any(|(label, why)| label == "C7" && why.contains("rig file")));
}
