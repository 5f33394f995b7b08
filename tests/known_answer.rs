//! A take whose answer is known: markers glued to a body's vertices and moved through its example poses.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;

use common::c3d_writer;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::Path;

const POSES: [&str; 12] = [
    "00_rest_apose",
    "01_tpose",
    "02_arms_down",
    "03_walk_left_forward",
    "04_walk_right_forward",
    "05_run",
    "06_arms_up",
    "07_squat_arms_forward",
    "08_sit",
    "09_kick_right",
    "10_twist_bend",
    "11_forward_bend",
];

/// Mean vertex error at a pose, in heights. 2 % is what the program promises; the worst pose has 0.63 %.
const LIMIT: f64 = 0.01;

/// Frames from one pose to the next.
const STEP: usize = 60;

type Joints = BTreeMap<String, [f64; 3]>;

/// Names of CMU's set, and where a technician would stick them on the rest pose.
fn places(joints: &Joints) -> Vec<(String, DVec3)> {
    let at = |name: &str| DVec3::from(joints[name]);
    let head = at("head");
    let chest = at("spine01");
    let pelvis = at("spine05");
    let mut out: Vec<(String, DVec3)> = vec![
        ("C7".into(), at("neck01") + DVec3::new(0.0, 0.0, -0.08)),
        ("T10".into(), chest + DVec3::new(0.0, -0.06, -0.10)),
        ("CLAV".into(), DVec3::new(0.0, at("clavicle.L")[1], 0.12)),
        ("STRN".into(), chest + DVec3::new(0.0, 0.0, 0.20)),
        ("RBAC".into(), chest + DVec3::new(-0.09, 0.06, -0.10)),
    ];
    for (letter, s) in [("L", 1.0), ("R", -1.0)] {
        let joint = |name: &str| at(&format!("{name}.{letter}"));
        let (shoulder, elbow, wrist) = (joint("upperarm01"), joint("lowerarm01"), joint("wrist"));
        let (hip, knee, ankle) = (joint("upperleg01"), joint("lowerleg01"), joint("foot"));
        let arm = (elbow - shoulder).normalize();
        let fore = (wrist - elbow).normalize();
        let outer = DVec3::Z.cross(arm).normalize() * s;
        let thumb = fore.cross(outer).normalize() * -s;
        let x = DVec3::X * s;
        for (name, place) in [
            ("FHD", head + DVec3::new(s * 0.05, 0.08, 0.08)),
            ("BHD", head + DVec3::new(s * 0.05, 0.08, -0.10)),
            ("SHO", shoulder + DVec3::new(-s * 0.02, 0.08, 0.0)),
            ("UPA", shoulder.lerp(elbow, 0.5) + outer * 0.06),
            ("ELB", elbow + outer * 0.05),
            ("FRM", elbow.lerp(wrist, 0.5) + outer * 0.05),
            ("WRA", wrist + thumb * 0.04),
            ("WRB", wrist - thumb * 0.04),
            ("FIN", wrist + fore * 0.08 + outer * 0.03),
            ("FWT", pelvis + DVec3::new(s * 0.11, 0.06, 0.12)),
            ("BWT", pelvis + DVec3::new(s * 0.06, 0.06, -0.12)),
            ("THI", hip.lerp(knee, 0.55) + x * 0.07 + DVec3::Z * 0.04),
            ("KNE", knee + x * 0.07),
            ("SHN", knee.lerp(ankle, 0.46) + x * 0.06),
            ("ANK", ankle + x * 0.05),
            ("HEE", ankle + DVec3::new(0.0, -0.03, -0.09)),
            ("MT5", ankle + DVec3::new(s * 0.06, -0.05, 0.09)),
            ("TOE", ankle + DVec3::new(s * 0.01, -0.02, 0.13)),
        ] {
            out.push((format!("{letter}{name}"), place));
        }
    }
    out
}

fn ease(s: f64) -> f64 {
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

#[test]
fn a_body_follows_glued_markers_through_its_example_poses() {
    let Some(data) = common::shared() else { return };
    let folder = data.join("meshes/examples/human_makehuman_male");
    let poses: Vec<Vec<DVec3>> =
        POSES.iter().map(|p| retarget::scan::read(&folder.join(format!("{p}.obj.gz"))).unwrap().mesh.positions).collect();
    let truth: serde_json::Value = serde_json::from_slice(&std::fs::read(folder.join("joints.json")).unwrap()).unwrap();
    let joints: Joints = serde_json::from_value(truth["poses"][POSES[0]].clone()).unwrap();

    let glued: Vec<(String, usize)> = places(&joints)
        .into_iter()
        .map(|(name, place)| {
            let near = |v: &usize| poses[0][*v].distance_squared(place);
            (name, (0..poses[0].len()).min_by(|a, b| near(a).total_cmp(&near(b))).unwrap())
        })
        .collect();
    // Into a laboratory in millimetres with Z up, turned, so that the placement has to be found.
    let laboratory = |p: DVec3| {
        let p = glam::DQuat::from_rotation_y(-0.8) * p;
        (DVec3::new(p.x, -p.z, p.y) * 1000.0 + DVec3::new(700.0, 300.0, 0.0)).to_array().map(|c| c as f32)
    };
    let mut points = Vec::new();
    for pair in poses.windows(2) {
        for f in 0..STEP {
            let s = ease(f as f64 / STEP as f64);
            points.extend(glued.iter().map(|&(_, v)| Some(laboratory(pair[0][v].lerp(pair[1][v], s)))));
        }
    }
    points.extend(glued.iter().map(|&(_, v)| Some(laboratory(poses[POSES.len() - 1][v]))));

    let work = tempfile::tempdir().unwrap();
    let take = c3d_writer::C3dFile {
        labels: glued.iter().map(|g| g.0.clone()).collect(),
        points,
        rate: 120.0,
        first_frame: 1,
        ..c3d_writer::C3dFile::default()
    };
    std::fs::write(work.path().join("poses.c3d"), take.bytes()).unwrap();
    let scan = folder.join(format!("{}.obj.gz", POSES[0]));
    let said =
        common::retarget_ok(work.path(), [scan.as_path(), Path::new("poses.c3d"), Path::new("-o"), Path::new("poses.pc2")]);
    eprintln!("{said}");

    let frames = common::read_pc2(&work.path().join("poses.pc2"));
    assert_eq!(frames.len(), (POSES.len() - 1) * STEP + 1);
    let height = 1.748;
    // The take shows the rest pose, and the placement brings it there: so the poses come back in the scan's own space, place and size included.
    let mut beyond = Vec::new();
    for (k, pose) in poses.iter().enumerate() {
        let frame = &frames[k * STEP];
        let error = |(p, q): (&[f32; 3], &DVec3)| DVec3::from(p.map(f64::from)).distance(*q);
        let mean = frame.iter().zip(pose).map(error).sum::<f64>() / pose.len() as f64;
        let worst = frame.iter().zip(pose).map(error).fold(0.0, f64::max);
        eprintln!("{:<24} mean {:.2} %  worst {:.1} % of the height", POSES[k], mean / height * 100.0, worst / height * 100.0);
        if mean > LIMIT * height {
            beyond.push(POSES[k]);
        }
    }
    assert!(beyond.is_empty(), "mean error beyond {LIMIT} of the height in {beyond:?}");
}
