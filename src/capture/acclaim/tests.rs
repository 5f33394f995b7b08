//! Small files, the damaged ones, and the real ones against other readers and other formats of the same take.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::capture::{self, Capture, Motion, ReadOptions, SkeletonTake, tests::real};
use crate::error::Kind;
use crate::space::Unit;

const ASF: &str = "# a leg\n:version 1.10\n:name LEG\n:units\n  mass 1.0\n  length 0.45\n  angle deg\n:documentation\n  nothing\n:root\n  order TX TY TZ RX RY RZ\n  \
    axis XYZ\n  position 0 0 0\n  orientation 0 0 0\n:bonedata\n  begin\n    id 1\n    name femur\n    direction 0 -2 0\n    length 4\n    axis 0 0 30 XYZ\n    \
    dof rx ry rz\n    limits (-160 20)\n           (-70 70)\n           (-60 70)\n  end\n  begin\n    name tibia\n    direction 0 -1 0\n    length 3\n    \
    axis 10 20 30 ZYX\n    dof rz rx\n  end\n  begin\n    name tail\n    direction 0 0 -1\n    length 1\n    axis 0 0 0 XYZ\n  end\n:hierarchy\n  begin\n    \
    root femur tail\n    femur tibia\n  end\n";

const AMC: &str = "#!OML:ASF leg.asf\n:FULLY-SPECIFIED\n:DEGREES\n7\nroot 1 2 3 0 90 0\nfemur 0 0 0\ntibia 15 25\n8\nroot 1 2 4 10 20 30\nfemur 5e+00 -6 7\ntibia 15 25\n\
    9\nroot 1 2 5 0 0 0\nfemur 0 0 0\ntibia 0 0\n";

fn parse(asf: &str, amc: &str) -> Result<SkeletonFile> {
    super::parse(asf.as_bytes(), amc.as_bytes())
}

fn said(file: &SkeletonFile) -> String {
    file.notes.iter().collect::<Vec<_>>().join("\n")
}

fn skeleton(capture: &Capture) -> &SkeletonTake {
    match &capture.motion {
        Motion::Skeleton(take) => take,
        other => panic!("not a skeleton but {}", other.noun()),
    }
}

fn at(take: &SkeletonTake, joint: &str, frame: usize) -> DVec3 {
    let joint = take.joints.iter().position(|j| j.name == joint).unwrap_or_else(|| panic!("no joint {joint}"));
    take.origins.point(frame, joint).unwrap_or(DVec3::NAN)
}

const RATE: &str = "the files do not say their rate: 120 frames per second are assumed";

#[test]
fn a_small_pair_means_what_the_mathematics_says() {
    let file = parse(ASF, AMC).unwrap();
    let take = &file.take;
    let names: Vec<&str> = take.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["root", "femur", "tibia", "tibia_End", "tail", "tail_End"]);
    assert_eq!(take.joints.iter().map(|j| j.parent).collect::<Vec<_>>(), [None, Some(0), Some(1), Some(2), Some(0), Some(4)]);
    assert_eq!((file.rate, file.first_frame, take.origins.frames(), said(&file).as_str()), (120.0, 7, 3, RATE));
    assert_eq!(file.space.unit.unwrap().value, Unit::Other { nanometres: 56_444_444 });
    assert_eq!(take.joints[2].rest, DVec3::new(0.0, -4.0, 0.0));
    assert_eq!(take.joints[3].rest, DVec3::new(0.0, -7.0, 0.0));
    // A quarter turn about y takes −z to −x.
    assert!(at(take, "tail_End", 0).distance(DVec3::new(0.0, 2.0, 3.0)) < 1e-6);
    let [x, y, z] = [DQuat::from_rotation_x, DQuat::from_rotation_y, DQuat::from_rotation_z];
    let r = f64::to_radians;
    let root = z(r(30.0)) * y(r(20.0)) * x(r(10.0));
    let axes = z(r(30.0));
    let femur = root * axes * z(r(7.0)) * y(r(-6.0)) * x(r(5.0)) * axes.inverse();
    // The order ZYX: z first, x last, whatever the order of the numbers.
    let axes = x(r(10.0)) * y(r(20.0)) * z(r(30.0));
    let tibia = femur * axes * x(r(25.0)) * z(r(15.0)) * axes.inverse();
    let knee = DVec3::new(1.0, 2.0, 4.0) + femur * DVec3::new(0.0, -4.0, 0.0);
    assert!(at(take, "tibia", 1).distance(knee) < 1e-6);
    assert!(at(take, "tibia_End", 1).distance(knee + tibia * DVec3::new(0.0, -3.0, 0.0)) < 1e-6);
    let turn = DQuat::from_array(take.rotations[6 + 2].map(f64::from));
    assert!((turn.dot(tibia).abs() - 1.0).abs() < 1e-6);
}

#[test]
fn a_take_far_away_moves_as_one_at_home() {
    let far = DVec3::new(3e7, -4e7, 5e3);
    let home = parse(ASF, AMC).unwrap().take;
    let away = parse(ASF, &AMC.replace("root 1 2 ", "root 30000001 -39999998 500")).unwrap().take;
    for frame in 0..3 {
        for joint in 0..home.joints.len() {
            let [a, b] = [&home, &away].map(|t| t.origins.point(frame, joint).unwrap());
            assert!((b - a).distance(far) < 1e-5, "frame {frame}, joint {joint}: {a} {b}");
        }
    }
}

#[test]
fn angles_may_be_radians_unless_they_cannot() {
    let degrees = parse(ASF, AMC).unwrap();
    let numbers = |text: &str, bones: &[&str]| -> String {
        let convert = |line: &str| {
            let mut words = line.split(' ').map(str::to_owned).collect::<Vec<_>>();
            let from = if words[0] == "root" { 4 } else { 1 };
            if bones.contains(&words[0].as_str()) {
                words[from..].iter_mut().for_each(|w| *w = w.parse::<f64>().unwrap().to_radians().to_string());
            }
            words.join(" ") + "\n"
        };
        text.lines().map(convert).collect()
    };
    let radians = numbers(AMC, &["root", "femur", "tibia"]).replace(":DEGREES", ":RADIANS");
    let file = parse(ASF, &radians).unwrap();
    assert_eq!(said(&file), RATE);
    for (a, b) in file.take.origins.points.iter().zip(&degrees.take.origins.points) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5));
    }
    let lie = parse(ASF, &AMC.replace(":DEGREES", ":RADIANS")).unwrap();
    assert_eq!(lie.take.origins.points, degrees.take.origins.points);
    assert!(said(&lie).contains("taken for degrees"), "{}", said(&lie));
    // Without a word in the motion the skeleton counts; its own axes are then in radians too.
    let asf = ASF
        .replace("angle deg", "angle rad")
        .replace("0 0 30 XYZ", "0 0 0.5235987755982988 XYZ")
        .replace("10 20 30 ZYX", "0.17453292519943295 0.3490658503988659 0.5235987755982988 ZYX");
    let file = parse(&asf, &radians.replace(":RADIANS\n", "")).unwrap();
    for (a, b) in file.take.origins.points.iter().zip(&degrees.take.origins.points) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

#[test]
fn what_is_missing_is_missing_and_said() {
    let file = parse(ASF, &AMC.replacen("femur 5e+00 -6 7\n", "", 1)).unwrap();
    let there = |joint: &str, frame: usize| !at(&file.take, joint, frame).is_nan();
    assert!(there("root", 1) && there("tail_End", 1) && !there("femur", 1) && !there("tibia_End", 1) && there("femur", 2));
    assert!(said(&file).contains("1 frame without all bones"), "{}", said(&file));
    let still =
        parse(ASF, &AMC.lines().filter(|l| !l.starts_with("tibia")).map(|l| format!("{l}\n")).collect::<String>()).unwrap();
    assert!(!at(&still.take, "tibia_End", 1).is_nan());
    assert!(said(&still).contains("1 bone in no frame: at rest"), "{}", said(&still));
    let skipped = parse(ASF, &AMC.replace("\n9\n", "\n12\n")).unwrap();
    assert_eq!(skipped.take.origins.frames(), 6);
    assert!(at(&skipped.take, "root", 4).is_nan() && at(&skipped.take, "root", 5).z == 5.0);
    assert!(said(&skipped).contains("frames 7 to 12 without 3 frames"), "{}", said(&skipped));
    let again = parse(ASF, &AMC.replace("\n9\n", "\n7\n")).unwrap();
    assert_eq!(again.take.origins.frames(), 3);
    assert!(said(&again).contains("do not rise"), "{}", said(&again));
    assert_eq!(parse(ASF, &AMC.replace("\n9\n", "\n900000000000\n")).unwrap_err().kind, Kind::Refused);
    let more = parse(ASF, &AMC.replace("tibia 0 0\n", "tibia 0 0\ntoe 1 2\n")).unwrap();
    assert!(said(&more).contains("does not have: toe"), "{}", said(&more));
    let cut = parse(ASF, AMC.strip_suffix(" 0\n").unwrap()).unwrap();
    assert_eq!(cut.take.origins.frames(), 2);
    assert!(said(&cut).contains("frame 9, the last, is cut short"), "{}", said(&cut));
}

#[test]
fn defects_are_told_with_their_line() {
    let motion = |from: &str, to: &str| parse(ASF, &AMC.replacen(from, to, 1)).unwrap_err();
    let short = motion("femur 5e+00 -6 7", "femur 5e+00");
    assert_eq!((short.found.as_str(), short.place.as_deref()), ("bone 'femur' has 1 number in frame 8", Some("line 10")));
    assert_eq!(motion("femur 5e+00", "femur x").found, "unexpected 'femur x -6 7'");
    assert_eq!(motion("tibia 15 25", "tibia 15 25\ntibia 15 25").found, "bone 'tibia' is twice in frame 7");
    assert_eq!(motion("7\n", "").found, "unexpected 'root 1 2 3 0 90 0'");
    assert_eq!(parse(ASF, ":DEGREES\n").unwrap_err().found, "there are no frames");
    let skeleton = |from: &str, to: &str| parse(&ASF.replacen(from, to, 1), AMC).unwrap_err();
    assert_eq!(skeleton("femur tibia", "femur shin").found, "bone 'shin' is in the hierarchy but not described");
    let ring = parse(&ASF.replacen("femur tibia", "tibia tibia", 1), AMC).unwrap();
    assert!(said(&ring).contains("1 bone without a way to the root: left out"), "{}", said(&ring));
    assert_eq!(skeleton("root femur tail", "root femur tibia").found, "bone 'tibia' has two parents");
    assert_eq!(skeleton("name tail", "name femur").found, "bone 'femur' is described twice");
    assert_eq!(skeleton("direction 0 -2 0", "direction 0 -2").found, "unexpected 'direction 0 -2'");
    assert_eq!(skeleton("axis 0 0 30 XYZ", "axis 0 0 30 XXZ").found, "unexpected 'axis 0 0 30 XXZ'");
    assert_eq!(skeleton("length 0.45", "length 0").expected.as_deref(), Some("length and a positive number"));
    assert_eq!(parse(&ASF[..ASF.find(":hierarchy").unwrap()], AMC).unwrap_err().found, "no hierarchy of bones");
}

#[test]
fn the_other_file_of_the_pair_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    };
    let take = put("cmu_01_02.amc", AMC);
    let options = ReadOptions::default();
    let missing = capture::read(&take, &options).unwrap_err();
    assert_eq!(missing.kind, Kind::Unreadable);
    assert!(
        missing.to_string().contains("cmu_01_02.asf or cmu_01.asf or cmu.asf") && missing.to_string().contains("--skeleton"),
        "{missing}"
    );
    let other = put("other.ASF", &ASF.replace("length 4", "length 5"));
    let only = capture::read(&take, &options).unwrap();
    assert!(only.notes.iter().any(|n| n.contains("other.ASF, the only one")));
    let subject = put("cmu_01.asf", ASF);
    let found = capture::read(&take, &options).unwrap();
    assert_eq!(at(skeleton(&found), "tibia", 2), DVec3::new(1.0, -2.0, 5.0));
    assert_eq!((found.name.as_str(), found.notes.iter().collect::<Vec<_>>()), ("cmu_01_02", vec![RATE]));
    let timed = ReadOptions { rate: Some(60.0), ..ReadOptions::default() };
    assert_eq!(capture::read(&take, &timed).map(|c| (c.rate, c.notes.is_empty())).unwrap(), (60.0, true));
    let named = ReadOptions { skeleton: Some(other), ..ReadOptions::default() };
    assert_eq!(at(skeleton(&capture::read(&take, &named).unwrap()), "tibia", 2), DVec3::new(1.0, -3.0, 5.0));
    assert_eq!(skeleton(&capture::read(&subject, &options).unwrap()).origins.frames(), 3);
    put("cmu_01_03.amc", AMC);
    let several = capture::read(&subject, &options).unwrap_err();
    assert_eq!(several.kind, Kind::Ambiguous);
    assert!(several.to_string().contains("cmu_01_02.amc, cmu_01_03.amc"), "{several}");
    let broken = put("cmu_04.asf", ":root\n");
    assert!(capture::read(&broken, &options).unwrap_err().to_string().contains("cmu_04.amc or cmu_04_*.amc"));
    put("cmu_04_01.amc", AMC);
    assert_eq!(capture::read(&broken, &options).unwrap_err().file.unwrap(), broken, "the error is in the skeleton");
}

#[test]
fn real_files_have_the_places_that_another_reader_found() {
    // Root, end of lradius, end of rtoes, end of head.
    let cases: [(&str, usize, [[f64; 3]; 4]); 5] = [
        (
            "cmu_01_01",
            1,
            [[9.3722, 17.8693, -17.3198], [12.3488, 25.3611, -13.9781], [6.9710, 0.8374, -15.8344], [9.7282, 29.0582, -16.4823]],
        ),
        (
            "cmu_01_01",
            1000,
            [[9.0373, 18.1429, 44.5038], [13.3984, 17.8795, 45.8933], [6.1550, 0.9884, 46.5855], [9.0122, 29.3667, 45.9787]],
        ),
        (
            "cmu_01_01",
            2751,
            [[8.8787, 17.8124, 38.5426], [12.2743, 18.7491, 43.4475], [7.5062, 0.5052, 40.9936], [8.5636, 29.1990, 38.9492]],
        ),
        (
            "cmu_11_01",
            1,
            [
                [12.2047, 17.4653, -40.3148],
                [15.1391, 15.7339, -37.2035],
                [6.9746, 1.3222, -38.1279],
                [11.8936, 28.9865, -39.0998],
            ],
        ),
        (
            "cmu_11_01",
            597,
            [[6.6960, 17.3735, 14.5524], [10.5773, 19.0926, 8.1194], [9.8110, 0.8072, 17.8179], [8.0576, 28.5573, 17.4473]],
        ),
    ];
    for (name, frame, places) in cases {
        let Some(path) = real(&format!("amc/{name}.amc.gz")) else { continue };
        let capture = capture::read(&path, &ReadOptions::default()).unwrap();
        let take = skeleton(&capture);
        assert_eq!((take.joints.iter().filter(|j| !j.end).count(), capture.rate, capture.first_frame), (31, 120.0, 1));
        assert_eq!(take.origins.frames(), if name == "cmu_01_01" { 2751 } else { 597 });
        assert_eq!(capture.notes.iter().collect::<Vec<_>>(), [RATE]);
        // The end of a bone is where the next one begins.
        for (joint, place) in ["root", "lwrist", "rtoes_End", "head_End"].iter().zip(places) {
            let found = at(take, joint, frame - 1);
            assert!(found.distance(place.into()) < 1.5e-4, "{name} {frame} {joint}: {found}");
        }
    }
}

#[test]
fn one_take_in_three_formats_is_one_motion() {
    let (Some(amc), Some(bvh), Some(c3d)) =
        (real("amc/cmu_01_01.amc.gz"), real("bvh/cmu_01_01.bvh.gz"), real("c3d/cmu_01_01.c3d"))
    else {
        return;
    };
    let options = ReadOptions::default();
    let [amc, bvh, c3d] = [amc, bvh, c3d].map(|path| capture::read(&path, &options).unwrap());
    let legs = [
        ("root", "Hips"),
        ("lfemur", "LeftUpLeg"),
        ("ltibia", "LeftLeg"),
        ("lfoot", "LeftFoot"),
        ("ltoes", "LeftToeBase"),
        ("ltoes_End", "LeftToeBase_End"),
        ("rfemur", "RightUpLeg"),
        ("rtibia", "RightLeg"),
        ("rfoot", "RightFoot"),
        ("rtoes", "RightToeBase"),
        ("rtoes_End", "RightToeBase_End"),
    ];
    for frame in (0..2751).step_by(50) {
        for (a, b) in legs {
            let (p, q) = (at(skeleton(&amc), a, frame), at(skeleton(&bvh), b, frame));
            assert!(p.distance(q) < 1e-3, "{a} in frame {frame}: {p} {q}");
        }
        // The conversion to BVH dropped the thorax: everything above it is lower by its length.
        let apart = at(skeleton(&amc), "lhumerus", frame).distance(at(skeleton(&bvh), "LeftArm", frame));
        assert!((apart - 2.065).abs() < 1e-2, "{apart}");
    }
    // C3D (x, y, z) = 56.444 × AMC (z, x, y); a marker on the skin lies a few centimetres beside its joint.
    let Motion::Markers(markers) = &c3d.motion else { panic!() };
    let marker = |label: &str, frame: usize| {
        let column = markers.labels.iter().position(|l| l.ends_with(label)).unwrap();
        markers.point(frame, column).unwrap()
    };
    let unit = amc.space.unit.unwrap().value.metres() * 1000.0;
    for frame in [0, 500, 1500, 2500] {
        for (label, joint, reach) in
            [("LKNE", "ltibia", 29.0), ("RKNE", "rtibia", 29.0), ("LANK", "lfoot", 2.5), ("RANK", "rfoot", 2.5)]
        {
            let height = unit * at(skeleton(&amc), joint, frame).y;
            assert!((height - marker(label, frame).z).abs() < reach, "{label} {frame}: {height}");
        }
    }
}

#[test]
fn numbers_that_no_frame_has_are_refused() {
    for number in ["1000000000001", "-1000000000001", "9223372036854775807", "-9223372036854775808"] {
        let error = parse(ASF, &AMC.replacen("\n7\n", &format!("\n{number}\n"), 1)).unwrap_err();
        assert!(error.to_string().contains(number), "{error}");
    }
    let late = parse(
        ASF,
        &AMC.replace("\n7\n", "\n999999999998\n").replace("\n8\n", "\n999999999999\n").replace("\n9\n", "\n1000000000000\n"),
    );
    assert_eq!(late.unwrap().first_frame, 999_999_999_998);
}

/// The damaged files of the corpus: equal to the control, missing what is missing, or an error that says what and where.
#[test]
fn broken_files_are_read_or_refused_for_their_reason() {
    let Some(asf) = real("amc/cmu_11.asf") else { return };
    let options = ReadOptions { skeleton: Some(asf), ..ReadOptions::default() };
    let read = |name: &str| capture::read(&real(&format!("broken/amc_{name}.amc")).unwrap(), &options);
    let control = read("ok_4frames").unwrap();
    assert_eq!((skeleton(&control).origins.frames(), control.notes.iter().count()), (4, 1));
    for (name, words) in [("radians_flag", "taken for degrees"), ("unknown_bone", "does not have: tail")] {
        let capture = read(name).unwrap();
        assert_eq!(skeleton(&capture).origins.points, skeleton(&control).origins.points, "{name}");
        assert!(capture.notes.iter().any(|n| n.contains(words)), "{:?}", capture.notes);
    }
    let skipped = read("frame_numbers_skip").unwrap();
    assert_eq!(skeleton(&skipped).origins.frames(), 11);
    assert_eq!(at(skeleton(&skipped), "head", 10), at(skeleton(&control), "head", 3));
    let missing = read("bone_missing_frame3").unwrap();
    assert!(
        at(skeleton(&missing), "rtibia", 2).is_nan()
            && at(skeleton(&missing), "ltibia", 2) == at(skeleton(&control), "ltibia", 2)
    );
    assert_eq!(skeleton(&read("truncated").unwrap()).origins.frames(), 1);
    let short = read("short_values").unwrap_err().to_string();
    assert!(short.contains("bone 'lfemur' has 1 number in frame 2 (line 61)"), "{short}");
    // Without the option there is no skeleton to be found there.
    let alone = capture::read(&real("broken/amc_ok_4frames.amc").unwrap(), &ReadOptions::default()).unwrap_err();
    assert!(alone.to_string().contains("amc_ok_4frames.asf or amc_ok.asf or amc.asf"), "{alone}");
}
