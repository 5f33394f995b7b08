//! Bodies and things as they come, with the joints that are known of them.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::*;
use crate::scan::UnitBox;
use glam::DQuat;
use serde_json::Value;
use std::path::PathBuf;

fn meshes() -> Option<PathBuf> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let meshes = shared.join("data/meshes");
    if !meshes.is_dir() {
        eprintln!("skipped: no meshes under {}", shared.display());
        return None;
    }
    Some(meshes)
}

/// The body in a file, or why there is none, and the file's unit box.
fn look(file: &std::path::Path) -> (Result<Body, NotHuman>, UnitBox) {
    let scan = crate::scan::read(file).unwrap();
    let unit = UnitBox::of(&scan.mesh).unwrap();
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|p| unit.enter(*p)).collect();
    (find(&points, &scan.mesh.vertex_triangles()), unit)
}

/// Error of each joint against bones of the MakeHuman rig, in per cent of stature.
fn errors(body: &Body, unit: &UnitBox, place: impl Fn(&str) -> DVec3) -> Vec<(Joint, f64)> {
    use Joint::{
        Head, LeftAnkle, LeftElbow, LeftHip, LeftKnee, LeftShoulder, LeftWrist, Neck, RightAnkle, RightElbow, RightHip,
        RightKnee, RightShoulder, RightWrist,
    };
    let bones = [
        (Neck, "neck01"),
        (Head, "head"),
        (LeftShoulder, "upperarm01.L"),
        (LeftElbow, "lowerarm01.L"),
        (LeftWrist, "wrist.L"),
        (LeftHip, "upperleg01.L"),
        (LeftKnee, "lowerleg01.L"),
        (LeftAnkle, "foot.L"),
        (RightShoulder, "upperarm01.R"),
        (RightElbow, "lowerarm01.R"),
        (RightWrist, "wrist.R"),
        (RightHip, "upperleg01.R"),
        (RightKnee, "lowerleg01.R"),
        (RightAnkle, "foot.R"),
    ];
    let error = |joint: Joint, bone| body.joints[joint as usize].distance(unit.enter(place(bone))) / body.stature * 100.0;
    bones.map(|(joint, bone)| (joint, error(joint, bone))).to_vec()
}

fn vector(value: &Value) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|i| value[i].as_f64().unwrap()))
}

fn json(file: PathBuf) -> Value {
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}

#[test]
fn joints_of_standing_people_are_where_their_rigs_have_them() {
    let Some(meshes) = meshes() else { return };
    let poses = json(meshes.join("examples/human_makehuman_male/joints.json"));
    let scan = json(meshes.join("scans/synthetic_scan_male_apose_mm_zup_truth.json"));
    let mut all = Vec::new();
    for pose in ["00_rest_apose", "01_tpose"] {
        let (body, unit) = look(&meshes.join(format!("examples/human_makehuman_male/{pose}.obj.gz")));
        all.push((pose, errors(&body.unwrap(), &unit, |bone| vector(&poses["poses"][pose][bone]))));
    }
    let (body, unit) = look(&meshes.join("scans/synthetic_scan_male_apose_mm_zup.ply.gz"));
    all.push(("scan", errors(&body.unwrap(), &unit, |bone| vector(&scan["joints_mm"][bone]["head"]))));
    for (file, errors) in all {
        let mean = errors.iter().map(|(_, e)| e).sum::<f64>() / errors.len() as f64;
        assert!(mean < 1.5, "{file}: {mean:.2} % of stature in the mean");
        for (joint, error) in errors {
            assert!(error < 4.0, "{file}: {joint:?} is off by {error:.2} % of stature");
        }
    }
}

/// The body of a mesh with its arms so many degrees below level: they turn about the shoulders, from the A pose in which they are clear of
/// the trunk. Gives positions and joints.
fn posed(points: &[DVec3], joints: &Value, down: f64) -> (Vec<DVec3>, impl Fn(&str) -> DVec3) {
    let at = |bone: &str| vector(&joints[bone]);
    let turns = ["L", "R"].map(|side| {
        let [shoulder, elbow, wrist] = ["upperarm01", "lowerarm01", "wrist"].map(|b| at(&format!("{b}.{side}")));
        let wanted = DVec3::new(shoulder.x.signum() * down.to_radians().cos(), -down.to_radians().sin(), 0.0);
        let turn = DQuat::from_rotation_arc((wrist - shoulder).normalize(), wanted);
        // An arm is what lies about its bones, or farther out than elbows; the shoulder takes a growing part in its turn.
        let share = move |p: DVec3| {
            let bones = [(shoulder, elbow), (elbow, wrist)];
            let near = bones.map(|(a, b)| p.distance(a.lerp(b, ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0))));
            let along = (p - shoulder).dot((elbow - shoulder).normalize());
            let about = near.into_iter().fold(f64::INFINITY, f64::min) < 0.11 || p.x.abs() > elbow.x.abs();
            if about { ((along + 0.03) / 0.08).clamp(0.0, 1.0) } else { 0.0 }
        };
        move |p: DVec3, all: bool| {
            let share = if all { 1.0 } else { share(p) };
            shoulder + DQuat::IDENTITY.slerp(turn, share) * (p - shoulder)
        }
    });
    let moved = points.iter().map(|&p| turns[usize::from(p.x < 0.0)](p, false)).collect();
    let joints = joints.clone();
    let joint = move |bone: &str| {
        let p = vector(&joints[bone]);
        let of_arm = ["lowerarm01", "wrist"].iter().any(|b| bone.starts_with(b));
        if of_arm { turns[usize::from(p.x < 0.0)](p, true) } else { p }
    };
    (moved, joint)
}

#[test]
fn joints_are_found_from_level_to_hanging_arms_in_any_turn_and_unit() {
    let Some(meshes) = meshes() else { return };
    let folder = meshes.join("examples/human_makehuman_male");
    let joints = &json(folder.join("joints.json"))["poses"]["00_rest_apose"];
    let scan = crate::scan::read(&folder.join("00_rest_apose.obj.gz")).unwrap();
    let turn = |x: f64, y: f64, z: f64, w: f64| DQuat::from_xyzw(x, y, z, w).normalize();
    for (down, arms, turn, unit) in [
        (0.0, Arms::Apart, DQuat::IDENTITY, 1.0),
        (0.0, Arms::Apart, turn(0.3, -0.5, 0.2, 0.7), 1000.0),
        (45.0, Arms::Apart, turn(-0.8, 0.1, 0.4, 0.3), 100.0),
        (72.0, Arms::Apart, DQuat::IDENTITY, 39.37),
        (72.0, Arms::Apart, turn(0.1, 0.9, -0.6, -0.2), 1.0),
        (84.0, Arms::Hanging, DQuat::IDENTITY, 1.0),
        (84.0, Arms::Hanging, turn(0.3, -0.5, 0.2, 0.7), 10.0),
        (88.0, Arms::Hanging, DQuat::IDENTITY, 0.01),
        (88.0, Arms::Hanging, turn(-0.8, 0.1, 0.4, 0.3), 1000.0),
    ] {
        let (points, joint) = posed(&scan.mesh.positions, joints, down);
        let place = |p: DVec3| turn * p * unit + DVec3::new(3.0, -7.0, 2.0) * unit;
        let mut mesh = scan.mesh.clone();
        mesh.positions = points.into_iter().map(place).collect();
        let unit_box = UnitBox::of(&mesh).unwrap();
        let entered = unit_box.enter_all(&mesh.positions);
        let body = find(&entered, &mesh.vertex_triangles()).unwrap_or_else(|e| panic!("arms {down} down: {}", e.reason));
        assert_eq!(body.arms, arms, "arms {down} down");
        assert!(body.forward.angle_between(turn * DVec3::Z).to_degrees() < 6.0, "arms {down} down: faces {}", body.forward);
        for (joint, error) in errors(&body, &unit_box, |bone| place(joint(bone))) {
            assert!(error < 4.0, "arms {down} down: {joint:?} is off by {error:.2} % of stature");
        }
    }
}

#[test]
fn arms_that_touch_the_body_are_found_from_the_sides() {
    let Some(meshes) = meshes() else { return };
    let poses = json(meshes.join("examples/human_makehuman_male/joints.json"));
    let (body, unit) = look(&meshes.join("examples/human_makehuman_male/02_arms_down.obj.gz"));
    let body = body.unwrap();
    assert_eq!((body.arms, body.floor), (Arms::Hanging, None));
    for (joint, error) in errors(&body, &unit, |bone| vector(&poses["poses"]["02_arms_down"][bone])) {
        assert!(error < 3.0, "{joint:?} is off by {error:.2} % of stature");
    }
    // Of the heavy man it is known that the wrists are at 53 % and the shoulders at 79 % of his height; as he is, and grown together
    // with arms and floor.
    for (file, floor, up, forward, most) in [
        ("bodies/makehuman_heavy_armsdown_soup_mm_zup.stl", false, DVec3::Z, DVec3::Y, 0.03),
        ("scans/synthetic_photogrammetry_fused_armsdown_m_yup.ply.gz", true, DVec3::Y, DVec3::Z, 0.045),
    ] {
        let (body, _) = look(&meshes.join(file));
        let body = body.unwrap_or_else(|e| panic!("{file}: {}", e.reason));
        assert_eq!((body.arms, body.floor.is_some(), body.up), (Arms::Hanging, floor, up), "{file}");
        assert!(body.forward.angle_between(forward).to_degrees() < 4.0 && body.facing_ratio > 2.0, "{file}: {}", body.forward);
        let soles = body.joints[Joint::Crown as usize].dot(up) - body.stature;
        for (joint, height) in
            [(Joint::LeftShoulder, 0.79), (Joint::RightShoulder, 0.79), (Joint::LeftWrist, 0.53), (Joint::RightWrist, 0.53)]
        {
            let found = (body.joints[joint as usize].dot(up) - soles) / body.stature;
            assert!((found - height).abs() < most, "{file}: {joint:?} at {found:.3} of the height");
        }
        let [left, right] = body.arm_elevation;
        assert!((left + 82.0).abs() < 6.0 && (right + 82.0).abs() < 6.0, "{file}: arms {left} and {right}");
    }
}

#[test]
fn bodies_are_upright_and_face_where_they_look() {
    let Some(meshes) = meshes() else { return };
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    for (file, up, forward) in [
        ("bodies/makehuman_base_body_apose_quads.obj.gz", y, z),
        ("bodies/makehuman_male_body_apose_quads.obj.gz", y, z),
        ("bodies/makehuman_female_body_apose_tri_m_zup.ply.gz", z, -y),
        ("bodies/makehuman_male_body_tpose_quads_cm.obj.gz", y, z),
        ("bodies/makehuman_male_clothed_textured/makehuman_male_clothed.obj.gz", y, z),
        ("bodies/smpl_man_tpose.obj.gz", y, z),
        ("bodies/nbs_maynard_tpose.obj.gz", y, z),
        ("scans/synthetic_scan_male_apose_mm_zup.ply.gz", z, (x * 7_f64.to_radians().sin() - y * 7_f64.to_radians().cos())),
    ] {
        let (body, _) = look(&meshes.join(file));
        let body = body.unwrap_or_else(|e| panic!("{file}: {}", e.reason));
        assert!(body.margin >= 0.25 && body.facing_ratio > 2.0, "{file}: margin {} facing {}", body.margin, body.facing_ratio);
        assert_eq!(body.up, up, "{file}");
        let turned = body.forward.angle_between(forward).to_degrees();
        assert!(turned < 4.0, "{file}: faces {turned:.1} degrees away");
        let across = body.joints[Joint::LeftShoulder as usize] - body.joints[Joint::RightShoulder as usize];
        assert!(across.dot(up.cross(forward)) > 0.0, "{file}: sides");
    }
}

#[test]
fn animals_things_and_busts_are_refused() {
    let Some(meshes) = meshes() else { return };
    for file in [
        "bodies/horse_quad.obj",
        "bodies/spot_cow_uv.obj.gz",
        "bodies/armadillo.obj.gz",
        "bodies/cheburashka_cartoon.obj.gz",
        "examples/horse_sumner/horse-reference.obj.gz",
        "examples/lion_sumner/lion-reference.obj.gz",
        "examples/cat_sumner/cat-reference.obj.gz",
        "scans/bunny_holes_raw.obj.gz",
        "scans/igea_head.ply.gz",
        "scans/laurana_statue_50k.ply.gz",
        "jointed/office_chair.obj.gz",
        "jointed/anymal_c_quadruped.obj.gz",
        "benchmark/cactus.obj.gz",
    ] {
        let (body, _) = look(&meshes.join(file));
        assert!(body.is_err(), "{file}: {body:?}");
    }
}
