//! Every dialect that was met, by a small text of its own and by the real files.
#![allow(clippy::unwrap_used, clippy::approx_constant)]

use super::*;
use crate::capture::{self, Capture, Motion, ReadOptions, SkeletonTake, tests::real};
use crate::error::{Error, Kind};
use std::path::Path;

const SMALL: &str = "HIERARCHY\nROOT Hips\n{\n\tOFFSET 0.0 0.0 0.0\n\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
    \tJOINT Chest\n\t{\n\t\tOFFSET 0.0 10.0 0.0\n\t\tCHANNELS 3 Zrotation Xrotation Yrotation\n\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 5.0 0.5\n\t\t}\n\t}\n\
    \tJOINT Leg\n\t{\n\t\tOFFSET 2.0 -8.0 0.0\n\t\tCHANNELS 3 Xrotation Yrotation Zrotation\n\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 -6.0 0.0\n\t\t}\n\t}\n}\n\
    MOTION\nFrames: 3\nFrame Time: 0.04\n1.0 90.5 2.0 90 0 0 0 0 0 0 0 0\n1.5 91.5 2.5 10.25 20.5 -30.5 4.5 5.5 6.5 7.5 -8.5 9.5\n\
    2.0 92.5 3.0 -100.5 2.5 3.5 4.5 5.5 6.5 7.5 8.5 9.5\n";

fn parse(text: &str) -> SkeletonFile {
    read(text.as_bytes(), None).unwrap()
}

fn refused(text: &str) -> Error {
    read(text.as_bytes(), None).unwrap_err()
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

fn at(take: &SkeletonTake, joint: &str, row: usize) -> [f32; 3] {
    let joint = take.joints.iter().position(|j| j.name == joint).unwrap_or_else(|| panic!("no joint {joint}"));
    take.origins.points[(row - 1) * take.joints.len() + joint]
}

fn near(a: [f32; 3], b: [f64; 3], reach: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (f64::from(*a) - b).abs() <= reach)
}

#[test]
fn a_small_file_means_what_the_mathematics_says() {
    let file = parse(SMALL);
    let take = &file.take;
    let names: Vec<&str> = take.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["Hips", "Chest", "Chest_End", "Leg", "Leg_End"]);
    assert_eq!(take.origins.labels, names);
    assert_eq!(take.joints.iter().map(|j| j.parent).collect::<Vec<_>>(), [None, Some(0), Some(1), Some(0), Some(3)]);
    assert_eq!(take.joints.iter().map(|j| j.end).collect::<Vec<_>>(), [false, false, true, false, true]);
    assert_eq!((file.rate, file.first_frame, take.origins.frames(), take.rest), (25.0, 1, 3, Rest::FirstFrame));
    // A quarter turn about z lays the trunk along −x.
    assert!(near(at(take, "Chest", 1), [-9.0, 90.5, 2.0], 1e-5), "{:?}", at(take, "Chest", 1));
    assert!(near(at(take, "Chest_End", 1), [-14.0, 90.5, 2.5], 1e-5));
    assert!(near(at(take, "Leg", 1), [9.0, 92.5, 2.0], 1e-5));
    assert_eq!(take.joints[1].rest, DVec3::new(-9.0, 90.5, 2.0));
    // Turns as matrices multiplied out by hand: R = Rz·Rx·Ry in the order of the channels.
    let [z, x, y] = [10.25f64, 20.5, -30.5].map(f64::to_radians);
    let turn = DQuat::from_rotation_z(z) * DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y);
    let chest = DVec3::new(1.5, 91.5, 2.5) + turn * DVec3::new(0.0, 10.0, 0.0);
    assert!(near(at(take, "Chest", 2), chest.to_array(), 1e-5));
    let [x, y, z] = [7.5f64, -8.5, 9.5].map(f64::to_radians);
    let leg = turn * DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
    for joint in [3, 4] {
        let q = take.rotations[5 + joint].map(f64::from);
        assert!((DQuat::from_array(q).dot(leg).abs() - 1.0).abs() < 1e-6, "joint {joint}");
    }
    assert_eq!(said(&file), "row 1 is a rest pose that was put before the motion: the motion begins with row 2");
}

#[test]
fn a_take_far_away_moves_as_one_at_home() {
    let far = DVec3::new(3e7, -4e7, 5e3);
    let home = parse(SMALL).take;
    let moved = SMALL
        .replace("\n1.0 90.5 2.0 ", "\n30000001.0 -39999909.5 5002.0 ")
        .replace("\n1.5 91.5 2.5 ", "\n30000001.5 -39999908.5 5002.5 ")
        .replace("\n2.0 92.5 3.0 ", "\n30000002.0 -39999907.5 5003.0 ");
    let away = parse(&moved).take;
    for frame in 0..3 {
        for joint in 0..home.joints.len() {
            let [a, b] = [&home, &away].map(|t| t.origins.point(frame, joint).unwrap());
            assert!((b - a).distance(far) < 1e-5, "frame {frame}, joint {joint}: {a} {b}");
        }
    }
}

#[test]
fn a_rest_pose_before_the_motion_is_no_frame_of_it() {
    let read = |as_found| {
        let options = ReadOptions { as_found, ..ReadOptions::default() };
        capture::read_bytes(SMALL.into(), Path::new("a.bvh"), &options).unwrap()
    };
    let (all, motion) = (read(true), read(false));
    let (whole, take) = (skeleton(&all), skeleton(&motion));
    let joints = take.joints.len();
    assert_eq!((all.first_frame, whole.origins.frames()), (1, 3));
    assert_eq!((motion.first_frame, take.origins.frames()), (2, 2));
    assert_eq!(take.origins.points, whole.origins.points[joints..]);
    assert_eq!(take.rotations, whole.rotations[joints..]);
    assert_eq!((take.rest, &take.joints), (Rest::FirstFrame, &whole.joints));
    // Where nothing comes before the motion, all rows are of it.
    let rows: Vec<&str> = SMALL.lines().collect();
    let without = [&rows[..rows.len() - 3], &rows[rows.len() - 2..]].concat().join("\n");
    let capture = capture::read_bytes(without.into(), Path::new("a.bvh"), &ReadOptions::default()).unwrap();
    assert_eq!((capture.first_frame, skeleton(&capture).rest), (1, Rest::Hierarchy));
    // Nor is a first row a rest pose where the motion itself is of round angles.
    let round = SMALL.replace("10.25 20.5 -30.5 4.5 5.5 6.5 7.5 -8.5 9.5", "10 20 -30 4 5 6 7 -8 9");
    assert_eq!(parse(&round).take.rest, Rest::Hierarchy);
}

#[test]
fn texts_in_any_dress_are_the_same_take() {
    let control = parse(SMALL);
    let comma = SMALL.split('\n').map(|l| {
        if l.contains("OFFSET") || l.starts_with(|c: char| "-0123456789".contains(c)) { l.replace('.', ",") } else { l.into() }
    });
    let wrapped: String = SMALL
        .lines()
        .map(|l| {
            if l.starts_with('1') || l.starts_with('2') {
                l.replacen(" 0 ", "\n0 ", 1).replacen(" 4.5 ", " \n 4.5\n\n", 1) + "\n"
            } else {
                format!("{l}\n")
            }
        })
        .collect();
    let one_line = SMALL.replace('\n', " ").replace("\t", " ");
    let dresses = [
        ("CRLF", SMALL.replace('\n', "\r\n")),
        ("CR only", SMALL.replace('\n', "\r")),
        ("byte-order mark", format!("\u{feff}{SMALL}")),
        ("decimal commas", comma.collect::<Vec<_>>().join("\n").replace("0.04", "0,04")),
        ("lower case", SMALL.to_lowercase().replace("hips", "Hips").replace("chest", "Chest").replace("leg", "Leg")),
        ("upper case", SMALL.to_uppercase().replace("HIPS", "Hips").replace("CHEST", "Chest").replace("LEG", "Leg")),
        ("wrapped rows", wrapped),
        ("one line", one_line),
        ("no final newline, trailing blanks", SMALL.replace(" 0\n", " 0  \t\n").trim_end().to_owned()),
        (
            "comments",
            format!(
                "# made by hand\n// twice\n{}",
                SMALL.replace("OFFSET 2.0", "# the leg\n\t\tOFFSET 2.0").replace("9.5\n", "9.5 # row\n")
            ),
        ),
        ("brace behind the name", SMALL.replace("\n{", " {").replace("\n\t{", " {")),
        ("frames without colon", SMALL.replace("Frames:", "Frames :").replace("Frame Time:\t", "FRAME TIME :")),
        ("end effector", SMALL.replace("End Site", "End Effector")),
        ("separators", SMALL.replace("0.0 10.0 0.0", "0.0, 10.0, 0.0")),
        ("exponents", SMALL.replace("90.5", "9.05e+01").replace(" 20.5 ", " 2050E-02 ")),
        ("no keyword", SMALL.replace("HIERARCHY\n", "")),
        ("end of file mark", format!("{SMALL}\u{1a}")),
    ];
    for (what, text) in dresses {
        let file = read(text.as_bytes(), None).unwrap_or_else(|e| panic!("{what}: {e}\n{text}"));
        assert_eq!(file.take.joints, control.take.joints, "{what}");
        assert_eq!(file.take.origins.points, control.take.origins.points, "{what}");
        assert_eq!(file.take.rotations, control.take.rotations, "{what}");
        assert_eq!((file.rate, said(&file)), (control.rate, said(&control)), "{what}");
    }
}

#[test]
fn channels_may_come_in_any_order() {
    let swapped = SMALL
        .replace(
            "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
            "6 Zrotation Xrotation Yrotation Zposition Xposition Yposition",
        )
        .replace("1.0 90.5 2.0 90 0 0 ", "90 0 0 2.0 1.0 90.5 ")
        .replace("1.5 91.5 2.5 10.25 20.5 -30.5 ", "10.25 20.5 -30.5 2.5 1.5 91.5 ")
        .replace("2.0 92.5 3.0 -100.5 2.5 3.5 ", "-100.5 2.5 3.5 3.0 2.0 92.5 ");
    assert_eq!(parse(&swapped).take.origins.points, parse(SMALL).take.origins.points);
}

/// The small file with positions on every joint: `chest` and `leg` are theirs in every row.
fn positions_everywhere(root: &str, chest: &str, leg: &str) -> String {
    let mut text = SMALL.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ").replacen(
        "OFFSET 0.0 0.0 0.0",
        &format!("OFFSET {root}"),
        1,
    );
    let rows = text.split_off(text.find("1.0 90.5").unwrap());
    for row in rows.lines() {
        let numbers: Vec<&str> = row.split(' ').collect();
        text += &format!("{} {chest} {} {leg} {}\n", numbers[..6].join(" "), numbers[6..9].join(" "), numbers[9..].join(" "));
    }
    text
}

#[test]
fn positions_that_repeat_offset_replace_it_and_those_near_zero_are_added() {
    let control = parse(SMALL);
    let repeated = parse(&positions_everywhere("0 0 0", "0.01 10.0 0.0", "2.0 -8.0 0.0"));
    assert!(near(at(&repeated.take, "Leg_End", 2), at(&control.take, "Leg_End", 2).map(f64::from), 1e-4));
    assert!(!near(at(&repeated.take, "Chest", 2), at(&control.take, "Chest", 2).map(f64::from), 1e-4), "what is written counts");
    assert!(said(&repeated).contains("positions of 2 joints repeat OFFSET: they replace it"), "{}", said(&repeated));
    let deltas = parse(&positions_everywhere("0 0 0", "0 0 0", "0 0.5 0"));
    assert_eq!(at(&deltas.take, "Chest", 2), at(&control.take, "Chest", 2));
    assert!(said(&deltas).contains("positions of 2 joints are near zero: they are added to OFFSET"), "{}", said(&deltas));
    // The root is read as the joints below it.
    let deltas = parse(&positions_everywhere("0 100 0", "0 0 0", "0 0 0"));
    assert!(near(at(&deltas.take, "Hips", 1), [1.0, 190.5, 2.0], 1e-5));
    let repeated = parse(&positions_everywhere("0 3 700", "0 10 0", "2 -8 0"));
    assert!(near(at(&repeated.take, "Hips", 1), [1.0, 90.5, 2.0], 1e-5));
}

#[test]
fn the_root_replaces_its_offset_unless_its_positions_are_near_zero() {
    let with = |offset: &str, from: &str, to: &str| {
        SMALL.replacen("OFFSET 0.0 0.0 0.0", &format!("OFFSET {offset}"), 1).replace(from, to)
    };
    let repeated = parse(&with("0 91 0", "x", "x"));
    assert!(near(at(&repeated.take, "Hips", 1), [1.0, 90.5, 2.0], 1e-5));
    assert!(said(&repeated).contains("repeat its OFFSET"), "{}", said(&repeated));
    let added = parse(&with("0 950 0", "x", "x"));
    assert!(near(at(&added.take, "Hips", 1), [1.0, 1040.5, 2.0], 1e-4));
    assert!(said(&added).contains("near zero: they are added"), "{}", said(&added));
    // The height repeats, the way does not: no vote for adding.
    let doubtful = parse(&with("0 91 -427", "x", "x"));
    assert!(near(at(&doubtful.take, "Hips", 1), [1.0, 90.5, 2.0], 1e-5));
    assert!(said(&doubtful).contains("(assumed)"), "{}", said(&doubtful));
}

#[test]
fn names_are_kept_and_made_unique() {
    let file = parse(
        &SMALL
            .replace("ROOT Hips", "ROOT Subject 1:Hips")
            .replace("JOINT Chest", "JOINT Bip01 L UpperArm")
            .replace("JOINT Leg", "JOINT Bip01 L UpperArm"),
    );
    let names: Vec<&str> = file.take.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(
        names,
        ["Subject 1:Hips", "Bip01 L UpperArm", "Bip01 L UpperArm_End", "Bip01 L UpperArm#2", "Bip01 L UpperArm_End#2"]
    );
    assert!(said(&file).contains("2 joints had the name of another"), "{}", said(&file));
}

#[test]
fn two_roots_and_leaves_without_end_site() {
    let leaf = SMALL.replacen("\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 5.0 0.5\n\t\t}\n", "", 1);
    let file = parse(&leaf);
    let names: Vec<&str> = file.take.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["Hips", "Chest", "Leg", "Leg_End"]);
    assert_eq!(at(&file.take, "Leg_End", 2), at(&parse(SMALL).take, "Leg_End", 2));
    let prop = "ROOT Ball\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\nMOTION";
    let mut two = SMALL.replacen("MOTION", prop, 1);
    for (row, end) in ["0 0 0 0 0\n", "7.5 -8.5 9.5\n", "7.5 8.5 9.5\n"].into_iter().enumerate() {
        two = two.replacen(end, &end.replace('\n', &format!(" {row} 50 60\n")), 1);
    }
    let file = parse(&two);
    assert_eq!(at(&file.take, "Ball", 3), [2.0, 50.0, 60.0]);
    assert_eq!(file.take.joints[5].parent, None);
    assert!(said(&file).contains("2 roots (Hips, Ball)"), "{}", said(&file));
}

#[test]
fn counts_that_lie_are_said_and_rows_that_do_not_fit_are_named() {
    let file = parse(&SMALL.replace("Frames: 3", "Frames: 4294967296"));
    assert_eq!(file.take.origins.frames(), 3);
    assert!(said(&file).contains("Frames: says 4294967296, 3 rows are there"), "{}", said(&file));
    let cut = parse(SMALL.trim_end().strip_suffix(" 9.5").unwrap());
    assert_eq!(cut.take.origins.frames(), 2);
    assert!(said(&cut).contains("the last row is cut short (11 of 12 numbers)"), "{}", said(&cut));
    let short = refused(&SMALL.replace("4.5 5.5 6.5 7.5 -8.5 9.5", "4.5 5.5"));
    assert_eq!((short.found.as_str(), short.place.as_deref()), ("row 2 has 8 numbers", Some("line 29")));
    let long = refused(&SMALL.replace("-8.5 9.5", "-8.5 9.5 0 0").replace('\n', "\r"));
    assert_eq!((long.found.as_str(), long.place.as_deref()), ("row 2 has 14 numbers", Some("line 29")));
    let word = refused(&SMALL.replace("7.5 -8.5", "7.5 left"));
    assert_eq!((word.found.as_str(), word.place.as_deref()), ("unexpected 'left'", Some("row 2, line 29")));
}

#[test]
fn frame_times_that_cannot_be_are_replaced() {
    for time in ["0", "nan", "-0.1", "1.#INF", "1e999"] {
        let file = parse(&SMALL.replace("0.04", time));
        assert_eq!(file.rate, 30.0, "{time}");
        assert!(said(&file).contains("30 frames per second are assumed"), "{}", said(&file));
    }
    assert!(said(&parse(&SMALL.replace("Frame Time: 0.04\n", ""))).contains("no Frame Time"));
    assert_eq!(read(SMALL.replace("0.04", "0").as_bytes(), Some(50.0)).unwrap().rate, 50.0);
    assert!(said(&parse(&SMALL.replace("0.04", "30"))).contains("doubtful"));
}

#[test]
fn numbers_that_are_none_make_gaps() {
    let file = parse(&SMALL.replace("4.5 5.5 6.5 7.5 -8.5 9.5", "nan 5.5 6.5 7.5 -8.5 1.#QNAN"));
    assert!(file.take.origins.point(1, 0).is_some() && file.take.origins.point(1, 2).is_none());
    assert!(file.take.rotations[5 + 1][3].is_nan(), "a turn is missing where its angle is");
    assert!(file.take.origins.points.iter().all(|p| p[0].is_nan() == p[2].is_nan()));
    assert!(said(&file).contains("2 numbers of the motion are not finite"), "{}", said(&file));
}

#[test]
fn defects_are_told_with_their_line() {
    let cases = [
        (SMALL.replace("CHANNELS 6 Xposition", "CHANNELS 6"), "CHANNELS says 6, 5 are named", "line 5"),
        (SMALL.replacen("CHANNELS 3", "CHANNELS 2147483648", 1), "CHANNELS says 2147483648, 3 are named", "line 9"),
        (SMALL.replace("}\nMOTION", "MOTION"), "MOTION comes before joint 'Hips' is closed", "line 24"),
        (SMALL.replace("\nMOTION", "\n}\nMOTION"), "unexpected '}'", "line 25"),
        (SMALL.replacen("\t\tOFFSET 2.0 -8.0 0.0\n", "", 1), "joint 'Leg' has no OFFSET", "line 22"),
        (SMALL.replacen("2.0 -8.0 0.0", "2.0 -8.0", 1), "unexpected 'CHANNELS'", "line 18"),
        (SMALL.replacen("2.0 -8.0 0.0", "2.0 nan 0.0", 1), "unexpected 'nan'", "line 17"),
        (SMALL[..SMALL.find("MOTION").unwrap()].to_owned(), "the hierarchy ends without the word MOTION", "line 24"),
        (SMALL.replacen("Hips", &"x".repeat(300), 1), "a name of 300 bytes", "line 2"),
        (SMALL.replace("Frame Time", "Frame Rate"), "unexpected 'RATE:'", "line 27"),
        (
            SMALL.replacen("OFFSET 0.0 5.0 0.5", "OFFSET 0.0 5.0 0.5\n\t\t\tJOINT Tip", 1),
            "a joint begins inside of 'Site', which is not open",
            "line 13",
        ),
        (String::new(), "there is no joint", "line 1"),
        ("solid nothing\n".to_owned(), "unexpected 'solid'", "line 1"),
    ];
    for (text, found, place) in cases {
        let error = refused(&text);
        assert_eq!((error.kind, error.found.as_str(), error.place.as_deref()), (Kind::Malformed, found, Some(place)));
    }
    let empty = refused(&SMALL[..SMALL.find("1.0 90.5").unwrap()]);
    assert_eq!((empty.kind, empty.found.as_str()), (Kind::Unsupported, "there are no rows of motion"));
    let still = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION\nFrames: 1\nFrame Time: 1\n";
    assert_eq!(refused(still).found, "no joint has CHANNELS: nothing moves");
}

#[test]
fn few_numbers_cannot_claim_much_memory() {
    let mut text = String::from("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n");
    (0..9000).for_each(|_| text += "JOINT b\n{\nOFFSET 0 0 0\n}\n");
    text += "}\nMOTION\nFrames: 9\nFrame Time: 1\n";
    (0..60_000).for_each(|_| text += "0\n");
    assert_eq!(refused(&text).kind, Kind::Refused);
    // A hundred thousand joints, each inside of the one before.
    let depth = 100_000;
    let deep = "JOINT b\n{\nOFFSET 0 0 1\n".repeat(depth) + &"}\n".repeat(depth);
    let text =
        format!("HIERARCHY\nROOT a\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n{deep}}}\nMOTION\nFrames: 1\nFrame Time: 1\n5\n");
    let take = parse(&text).take;
    assert_eq!(take.origins.points[depth], [5.0, 0.0, depth as f32]);
    assert_eq!(refused(&"ROOT a\n{\nOFFSET 0 0 0\n".repeat(1000)).found, "unexpected 'ROOT'");
}

#[test]
fn real_files_have_the_places_that_other_readers_found() {
    let cases: &[(&str, &str, usize, [f64; 3])] = &[
        ("cmu_01_01.bvh.gz", "LeftHand", 1, [21.2539, 22.4167, -17.8671]),
        ("cmu_01_01.bvh.gz", "LeftHand", 2, [12.4087, 23.2971, -13.9665]),
        ("cmu_01_01.bvh.gz", "RightToeBase", 2752, [7.7517, 1.0323, 39.9315]),
        ("cmu_01_01.bvh.gz", "Head", 1000, [9.2966, 25.5615, 45.8278]),
        ("bandai1_walk_normal_002.bvh", "Hand_L", 1, [24.2649, 86.5138, 7.2569]),
        ("bandai1_walk_normal_002.bvh", "Toes_R", 31, [-5.8044, 8.4052, 155.5611]),
        ("bandai2_raise_hands_active_025.bvh", "Hips", 1, [-0.7878, 92.3776, 2.4785]),
        ("bandai2_raise_hands_active_025.bvh", "Hand_R", 27, [-10.9055, 82.9555, 2.7425]),
        ("makehuman_tpose.bvh", "wrist.L", 1, [6.585, 0.4402, 5.5649]),
        ("makehuman_walk1.bvh", "Hand_L", 1, [2.4192, -0.371, 9.6155]),
        ("makehuman_walk1.bvh", "Foot_R", 14, [-1.0132, 0.9374, 1.9163]),
        ("mixamo_walk.bvh", "mixamorig:LeftHand", 1, [19.9258, 106.6169, 23.003]),
        ("mixamo_walk.bvh", "mixamorig:RightFoot", 40, [-0.7487, 10.4922, 1.4491]),
        ("zup_mixed_orders.bvh", "LeftHand", 1, [-21.5704, -5.5183, 43.8701]),
        ("zup_mixed_orders.bvh", "RightHand", 75, [14.6816, -6.7078, 43.2626]),
        ("optitrack_boxing_toes.bvh.gz", "LeftWrist", 1, [-28.7721, 93.9519, 43.115]),
        ("optitrack_boxing_toes.bvh.gz", "LeftWrist", 3069, [3.333, 104.7528, -17.3633]),
        ("optitrack_boxing_toes.bvh.gz", "LeftWrist", 3070, [3.284, 104.2611, -17.1718]),
        ("rotation_first_root.bvh", "LeftLeg", 4, [16.0831, 45.3547, -17.2091]),
        ("rotation_first_root.bvh", "LeftLeg_End", 4, [17.8447, 39.7371, -18.3665]),
        ("mixed_orders_60joints_crlf.bvh", "LeftHand", 100, [-7.0153, 1.4142, 33.6061]),
    ];
    for (file, joint, row, place) in cases {
        let Some(path) = real(&format!("bvh/{file}")) else { continue };
        let capture = capture::read(&path, &ReadOptions { as_found: true, ..ReadOptions::default() }).unwrap();
        let found = at(skeleton(&capture), joint, *row);
        assert!(near(found, *place, 1.1e-4), "{file} {joint} {row}: {found:?}");
    }
}

#[test]
fn real_files_have_their_counts() {
    let cases: &[(&str, usize, usize, f64, Rest)] = &[
        ("bandai1_walk_normal_002.bvh", 22, 31, 30.0, Rest::Hierarchy),
        ("bandai2_raise_hands_active_025.bvh", 22, 27, 30.0, Rest::Hierarchy),
        ("cmu_01_01.bvh.gz", 31, 2752, 120.0, Rest::FirstFrame),
        ("cmu_12_01_walk.bvh.gz", 31, 524, 120.0, Rest::FirstFrame),
        ("dme_cmu_example_crlf.bvh", 31, 278, 120.0, Rest::FirstFrame),
        ("dme_fixed.bvh", 31, 48, 30.0, Rest::Hierarchy),
        ("full_precision_frame_time.bvh", 2, 3, 23.976, Rest::Hierarchy),
        ("makehuman_dance1_1frame.bvh", 75, 1, 24.0, Rest::Hierarchy),
        ("makehuman_face_poseunits.bvh.gz", 163, 60, 24.0, Rest::Hierarchy),
        ("makehuman_tpose.bvh", 173, 1, 24.0, Rest::Hierarchy),
        ("makehuman_walk1.bvh", 75, 14, 24.0, Rest::Hierarchy),
        ("mixamo_pose.bvh", 55, 2, 30.0, Rest::Hierarchy),
        ("mixamo_thriller_part_2.bvh.gz", 55, 566, 30.0, Rest::Hierarchy),
        ("mixamo_walk.bvh", 55, 40, 30.0, Rest::Hierarchy),
        ("mixed_orders_60joints_crlf.bvh", 60, 100, 120.0, Rest::Hierarchy),
        ("mocapbank_tabs_crlf.bvh", 19, 455, 30.0, Rest::Hierarchy),
        ("optitrack_boxing_toes.bvh.gz", 21, 3070, 100.0, Rest::Hierarchy),
        ("pfnn_hierarchy_crlf.bvh", 31, 60, 30.0, Rest::Hierarchy),
        ("rotation_first_root.bvh", 4, 4, 25.0, Rest::Hierarchy),
        ("simple_2joints.bvh", 2, 2, 30.0, Rest::Hierarchy),
        ("sinusoidal_no_end_site.bvh", 4, 120, 60.0, Rest::Hierarchy),
        ("xia_angry_13_000.bvh", 31, 140, 120.0, Rest::Hierarchy),
        ("xia_rest.bvh", 31, 1, 24.0, Rest::Hierarchy),
        ("yxz_spaces_crlf.bvh", 23, 61, 120.0, Rest::Hierarchy),
        ("zup_mixed_orders.bvh", 24, 75, 30.0, Rest::Hierarchy),
    ];
    for (file, joints, frames, rate, rest) in cases {
        let Some(path) = real(&format!("bvh/{file}")) else { continue };
        let capture = capture::read(&path, &ReadOptions::default()).unwrap();
        let take = skeleton(&capture);
        // Frames keep the numbers of their rows; one at rest before the motion is none of it.
        let last = capture.first_frame as usize + take.origins.frames() - 1;
        let found = (take.joints.iter().filter(|j| !j.end).count(), last, capture.rate, take.rest);
        assert_eq!(found, (*joints, *frames, *rate, *rest), "{file}");
        let said: Vec<&str> = capture.notes.iter().collect();
        let expected = match *file {
            "optitrack_boxing_toes.bvh.gz" => "Frames: says 3069, 3070 rows are there: all of them are used",
            "makehuman_dance1_1frame.bvh" => "positions of root 'Root' repeat its OFFSET: they replace it",
            "makehuman_walk1.bvh" => "positions of root 'Root' are near zero: they are added to its OFFSET",
            "makehuman_face_poseunits.bvh.gz" => "positions of root 'root' are near zero: they are added to its OFFSET",
            "makehuman_tpose.bvh" => "positions of 143 joints are near zero: they are added to OFFSET",
            _ if file.starts_with("bandai") => "positions of 21 joints repeat OFFSET: they replace it",
            _ if *rest == Rest::FirstFrame => "row 1 is a rest pose that was put before the motion: the motion begins with row 2",
            _ => "",
        };
        assert_eq!(said.join("|"), expected, "{file}");
        let first = if *rest == Rest::FirstFrame { 2 } else { 1 };
        assert_eq!((capture.space, capture.first_frame), (Space::default(), first));
    }
}

/// The damaged files of the corpus: equal to the control, or an error that says what and where.
#[test]
fn broken_files_are_read_or_refused_for_their_reason() {
    let Some(control) = real("broken/bvh_ok_5frames.bvh") else { return };
    let options = ReadOptions::default();
    let control = capture::read(&control, &options).unwrap();
    let same = "cr_only crlf comments decimal_commas exponents header_says_10_has_5 header_says_3_has_5 hierarchy_one_line lowercase_keywords \
                rows_wrapped utf8_bom frame_time_zero spaces_in_names namespace_colons";
    for name in same.split_whitespace() {
        let capture = capture::read(&real(&format!("broken/bvh_{name}.bvh")).unwrap(), &options).unwrap();
        assert_eq!(skeleton(&capture).origins.points, skeleton(&control).origins.points, "{name}");
        let warned = name.starts_with("header") || name == "frame_time_zero";
        assert_eq!(capture.notes.iter().count(), usize::from(warned), "{name}");
        let changed = name.contains("names");
        assert_eq!(skeleton(&capture).origins.labels == skeleton(&control).origins.labels, !changed, "{name}");
    }
    let refusals = [
        ("channels_6_lists_5", "CHANNELS says 6, 5 are named (line 5)"),
        ("long_row3", "row 3 has 62 numbers (line 122)"),
        ("short_row3", "row 3 has 56 numbers (line 122)"),
        ("missing_brace", "MOTION comes before joint 'Hips' is closed (line 117)"),
        ("no_motion", "the hierarchy ends without the word MOTION"),
        ("zero_frames", "there are no rows of motion"),
    ];
    for (name, reason) in refusals {
        let error = capture::read(&real(&format!("broken/bvh_{name}.bvh")).unwrap(), &options).unwrap_err();
        assert!(error.to_string().contains(reason), "{error}");
    }
    for name in ["nan_value", "inf_value"] {
        let capture = capture::read(&real(&format!("broken/bvh_{name}.bvh")).unwrap(), &options).unwrap();
        let take = skeleton(&capture);
        let missing = take.origins.points.iter().filter(|p| p[0].is_nan()).count();
        assert_eq!((missing, take.origins.frames()), (take.joints.len(), 5), "{name}");
    }
    let more = capture::read(&real("broken/bvh_two_roots.bvh").unwrap(), &options).unwrap();
    assert_eq!(skeleton(&more).joints.iter().filter(|j| !j.end).count(), 38);
    assert_eq!(at(skeleton(&more), "LeftWrist", 4), at(skeleton(&control), "LeftWrist", 4));
    let leaves = capture::read(&real("broken/bvh_no_end_sites.bvh").unwrap(), &options).unwrap();
    assert_eq!(skeleton(&leaves).joints.len(), 19);
    assert_eq!(at(skeleton(&leaves), "RightAnkle", 5), at(skeleton(&control), "RightAnkle", 5));
}
