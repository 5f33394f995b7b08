//! A small file, and the real ones against another reader.
#![allow(clippy::unwrap_used, clippy::type_complexity)]

use super::*;
use crate::capture::{self, Capture, Motion, ReadOptions, SkeletonTake, tests::real};

/// Two bones of which the first turns by 90° about z in a second, at 24 frames per second; metres, z up.
pub(in crate::capture) const ASCII: &str = "; FBX 7.4.0 project file\nFBXHeaderExtension:  {\n\tFBXHeaderVersion: 1003\n\tFBXVersion: 7400\n}\nGlobalSettings:  {\n\tVersion: 1000\n\
    \tProperties70:  {\n\t\tP: \"UpAxis\", \"int\", \"Integer\", \"\",2\n\t\tP: \"UpAxisSign\", \"int\", \"Integer\", \"\",1\n\t\tP: \"FrontAxis\", \"int\", \"Integer\", \"\",1\n\
    \t\tP: \"FrontAxisSign\", \"int\", \"Integer\", \"\",-1\n\t\tP: \"CoordAxis\", \"int\", \"Integer\", \"\",0\n\t\tP: \"CoordAxisSign\", \"int\", \"Integer\", \"\",1\n\
    \t\tP: \"UnitScaleFactor\", \"double\", \"Number\", \"\",100\n\t\tP: \"TimeMode\", \"enum\", \"\", \"\",11\n\t}\n}\nObjects:  {\n\
    \tNodeAttribute: 11, \"NodeAttribute::base\", \"LimbNode\" {\n\t\tTypeFlags: \"Skeleton\"\n\t}\n\tNodeAttribute: 12, \"NodeAttribute::tip\", \"LimbNode\" {\n\t\tTypeFlags: \"Skeleton\"\n\t}\n\
    \tModel: 1, \"Model::base\", \"LimbNode\" {\n\t\tVersion: 232\n\t\tProperties70:  {\n\t\t\tP: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",1,2,3\n\t\t}\n\t}\n\
    \tModel: 2, \"Model::tip\", \"LimbNode\" {\n\t\tVersion: 232\n\t\tProperties70:  {\n\t\t\tP: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",0,5,0\n\t\t}\n\t}\n\
    \tAnimationStack: 3, \"AnimStack::Bend\", \"\" {\n\t\tProperties70:  {\n\t\t\tP: \"LocalStart\", \"KTime\", \"Time\", \"\",0\n\t\t\tP: \"LocalStop\", \"KTime\", \"Time\", \"\",92372316000\n\t\t}\n\t}\n\
    \tAnimationLayer: 4, \"AnimLayer::Base\", \"\" {\n\t}\n\tAnimationCurveNode: 5, \"AnimCurveNode::R\", \"\" {\n\t\tProperties70:  {\n\t\t\tP: \"d|X\", \"Number\", \"\", \"A\",0\n\
    \t\t\tP: \"d|Y\", \"Number\", \"\", \"A\",0\n\t\t\tP: \"d|Z\", \"Number\", \"\", \"A\",0\n\t\t}\n\t}\n\tAnimationCurve: 6, \"AnimCurve::\", \"\" {\n\t\tDefault: 0\n\t\tKeyVer: 4008\n\
    \t\tKeyTime: *2 {\n\t\t\ta: 0,46186158000\n\t\t} \n\t\tKeyValueFloat: *2 {\n\t\t\ta: 0,90\n\t\t} \n\t\tKeyAttrFlags: *1 {\n\t\t\ta: 260\n\t\t} \n\t\tKeyAttrDataFloat: *4 {\n\t\t\ta: 0,0,0,0\n\
    \t\t} \n\t\tKeyAttrRefCount: *1 {\n\t\t\ta: 2\n\t\t} \n\t}\n}\nConnections:  {\n\tC: \"OO\",1,0\n\tC: \"OO\",2,1\n\tC: \"OO\",11,1\n\tC: \"OO\",12,2\n\tC: \"OO\",4,3\n\tC: \"OO\",5,4\n\
    \tC: \"OP\",5,1, \"Lcl Rotation\"\n\tC: \"OP\",6,5, \"d|Z\"\n}\n";

fn skeleton(capture: &Capture) -> &SkeletonTake {
    match &capture.motion {
        Motion::Skeleton(take) => take,
        other => panic!("not a skeleton but {}", other.noun()),
    }
}

fn at(take: &SkeletonTake, joint: &str, frame: usize) -> DVec3 {
    let joint = take
        .joints
        .iter()
        .position(|j| j.name == joint)
        .unwrap_or_else(|| panic!("no joint {joint} in {:?}", take.origins.labels));
    take.origins.point(frame, joint).unwrap()
}

#[test]
fn a_small_file_means_what_the_mathematics_says() {
    let file = read(ASCII.as_bytes(), None).unwrap();
    let take = &file.take;
    assert_eq!(take.joints.iter().map(|j| (j.name.as_str(), j.parent)).collect::<Vec<_>>(), [("base", None), ("tip", Some(0))]);
    // The stack is of two seconds, the keys of one.
    assert_eq!((file.rate, file.first_frame, take.origins.frames(), take.rest), (24.0, 0, 49, Rest::Nodes));
    let (s, start) = (5.0 * 0.5f64.sqrt(), DVec3::new(1.0, 2.0, 3.0));
    for (frame, tip) in [
        (0, DVec3::new(0.0, 5.0, 0.0)),
        (12, DVec3::new(-s, s, 0.0)),
        (24, DVec3::new(-5.0, 0.0, 0.0)),
        (48, DVec3::new(-5.0, 0.0, 0.0)),
    ] {
        assert!(at(take, "tip", frame).distance(start + tip) < 1e-5, "{frame}: {}", at(take, "tip", frame));
    }
    assert_eq!((take.joints[1].rest, file.space.unit.unwrap().value), (start + DVec3::new(0.0, 5.0, 0.0), Unit::Metre));
    assert_eq!(file.space.up.unwrap().value.vector(), DVec3::Z);
    assert!(file.notes.is_empty(), "{:?}", file.notes);
}

#[test]
fn a_take_far_away_moves_as_one_at_home() {
    let home = read(ASCII.as_bytes(), None).unwrap().take;
    let away = read(ASCII.replace("\"A\",1,2,3", "\"A\",30000001,-39999998,5003").as_bytes(), None).unwrap().take;
    for frame in 0..home.origins.frames() {
        for joint in ["base", "tip"] {
            let far = at(&away, joint, frame) - at(&home, joint, frame);
            assert!(far.distance(DVec3::new(3e7, -4e7, 5e3)) < 1e-5, "frame {frame}, {joint}: {far}");
        }
    }
}

#[test]
fn what_hangs_on_a_bound_joint_rests_where_it_hangs() {
    let pose = "\tPose: 20, \"Pose::Bind\", \"BindPose\" {\n\t\tType: \"BindPose\"\n\t\tVersion: 100\n\t\tNbPoseNodes: 1\n\t\tPoseNode:  {\n\t\t\tNode: 1\n\
        \t\t\tMatrix: *16 {\n\t\t\t\ta: 1,0,0,0,0,1,0,0,0,0,1,0,7,8,9,1\n\t\t\t} \n\t\t}\n\t}\n}\nConnections:  {";
    let take = read(ASCII.replace("}\nConnections:  {", pose).as_bytes(), None).unwrap().take;
    assert_eq!(take.rest, Rest::Bind);
    assert_eq!((take.joints[0].rest, take.joints[1].rest), (DVec3::new(7.0, 8.0, 9.0), DVec3::new(7.0, 13.0, 9.0)));
}

#[test]
fn files_without_motion_or_bones_say_so() {
    let still = read(ASCII.replace("\tC: \"OP\",5,1, \"Lcl Rotation\"\n", "").as_bytes(), None).unwrap();
    assert_eq!(still.take.origins.frames(), 1);
    assert!(still.notes.iter().any(|n| n.contains("its pose is one frame")), "{:?}", still.notes);
    let none =
        read(ASCII.replace("LimbNode", "Null").replace("\tC: \"OP\",5,1, \"Lcl Rotation\"\n", "").as_bytes(), None).unwrap_err();
    assert_eq!(none.found, "the file has neither bones nor nodes that move");
    // Without bones the nodes that move are joints.
    let nodes = read(ASCII.replace("\"LimbNode\"", "\"Null\"").as_bytes(), None).unwrap();
    assert_eq!(nodes.take.origins.labels, ["base"]);
    assert!(read(ASCII.as_bytes(), Some("Walk")).unwrap_err().to_string().contains("'Bend' (2.0 s)"));
    assert_eq!(read(&ASCII.as_bytes()[..900], None).unwrap_err().kind, Kind::Malformed);
    assert!(read(b"Kaydara FBX Binary  \0\x1a\0", None).unwrap_err().found.starts_with("FBX: "));
    let long = ASCII.replace("92372316000", "9223372036854775807");
    assert_eq!(read(long.as_bytes(), None).unwrap_err().kind, Kind::Refused);
}

#[test]
fn real_files_have_the_places_that_other_readers_found() {
    // The two bones under an inherited scale are as ufbx has them; Assimp puts the second one elsewhere. Half a second of huesitos lies
    // between two frames, and the chord between them inside of the arc.
    let cases: [(&str, Option<&str>, f64, &str, [f64; 3], f64); 7] = [
        ("maya_kenney_character_7700_binary.fbx", None, 0.0, "LeftHand", [47.388, 197.414, 78.679], 1e-3),
        ("maya_kenney_character_7700_binary.fbx", None, 0.5, "LeftHand", [61.058, 139.997, 37.969], 2e-3),
        ("blender_279_sausage_7400_binary.fbx", Some("Wiggle"), 0.0, "Top_end", [3.3308, 4.5018, 0.0], 1e-3),
        ("huesitos.fbx", None, 0.5, "Bone.008_end", [-271.780, 412.585, -307.135], 3.0),
        ("motionbuilder_sausage_rrss_7700_binary.fbx", None, 0.0, "Top", [2.687, 6.487, 0.0], 1e-3),
        ("motionbuilder_sausage_rrss_7700_ascii.fbx", None, 0.0, "Top", [2.687, 6.487, 0.0], 1e-3),
        ("maya_human_ik_7400_binary.fbx", None, 0.0, "Character1_LeftHand", [0.717, 1.466, 0.0], 1e-3),
    ];
    let mut wrong = Vec::new();
    for (file, clip, time, joint, place, reach) in cases {
        let Some(path) = real(&format!("fbx/{file}")) else { continue };
        let options = ReadOptions { clip: clip.map(str::to_owned), ..ReadOptions::default() };
        let capture = capture::read(&path, &options).unwrap();
        let frame = (time * capture.rate - capture.first_frame as f64).max(0.0);
        let take = skeleton(&capture);
        let last = take.origins.frames() - 1;
        let [a, b] = [frame as usize, frame as usize + 1].map(|f| at(take, joint, f.min(last)));
        let found = a.lerp(b, frame.fract());
        if found.distance(place.into()) > reach {
            wrong.push(format!("{file} {joint} at {time}: {found}, {} Hz, {} frames", capture.rate, last + 1));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn real_files_have_their_counts() {
    let cases: [(&str, usize, f64, usize); 8] = [
        ("animation_with_skeleton.fbx", 16, 24.0, 21),
        ("blender_279_sausage_7400_binary.fbx", 4, 24.0, 20),
        ("huesitos.fbx", 11, 25.0, 40),
        ("maya_human_ik_7400_ascii.fbx.gz", 62, 24.0, 1),
        ("maya_human_ik_7400_binary.fbx", 62, 24.0, 1),
        ("maya_kenney_character_7700_binary.fbx", 58, 24.0, 21),
        ("motionbuilder_sausage_rrss_7700_ascii.fbx", 4, 24.0, 121),
        ("motionbuilder_sausage_rrss_7700_binary.fbx", 4, 24.0, 121),
    ];
    let mut wrong = Vec::new();
    for (file, joints, rate, frames) in cases {
        let Some(path) = real(&format!("fbx/{file}")) else { continue };
        let capture = capture::read(&path, &ReadOptions::default()).unwrap();
        let take = skeleton(&capture);
        if (take.joints.len(), capture.rate, take.origins.frames()) != (joints, rate, frames) {
            let (counts, rate) = ((take.joints.len(), take.origins.frames()), capture.rate);
            wrong.push(format!("{file}: {counts:?} at {rate} Hz, {:?} {:?} {:?}", take.rest, capture.space, capture.notes));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn text_and_binary_twins_are_one_take() {
    for [a, b] in [
        ["maya_human_ik_7400_ascii.fbx.gz", "maya_human_ik_7400_binary.fbx"],
        ["motionbuilder_sausage_rrss_7700_ascii.fbx", "motionbuilder_sausage_rrss_7700_binary.fbx"],
    ] {
        let [Some(a), Some(b)] = [a, b].map(|f| real(&format!("fbx/{f}"))) else { return };
        let [a, b] = [a, b].map(|path| capture::read(&path, &ReadOptions::default()).unwrap());
        let (a, b) = (skeleton(&a), skeleton(&b));
        assert_eq!(a.origins.labels, b.origins.labels);
        assert!(a.origins.points.iter().zip(&b.origins.points).all(|(p, q)| p.iter().zip(q).all(|(p, q)| (p - q).abs() < 1e-4)));
    }
}
