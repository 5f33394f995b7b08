//! Bodies and things as they come, with the joints that are known of them.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::*;
use crate::scan::UnitBox;
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
