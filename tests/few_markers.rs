//! Twenty-two markers on a cartwheel: what rigid parts and stiffer shafts add to them, against the truth (as Fig. 3.2 of Stoll et al. 2007 shows).

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;
#[allow(dead_code)]
#[path = "../examples/make_fixtures/generate/mod.rs"]
mod generate;

use common::{c3d_writer, fixture, read_pc2, retarget_ok};
use generate::body::{ARM, Body, Bone, CHEST, HEAD, LEG, PELVIS, bones};
use generate::motion::{chain, ease, posed};
use glam::{DMat3, DQuat, DVec3};
use std::path::Path;

const FRAMES: usize = 100;
const RATE: f64 = 60.0;
/// Frames that are measured: the wheel, in every fourth one.
const MEASURED: std::ops::Range<usize> = 16..84;

/// A wheel to the body's left: arms up, round over both hands, and down again; frame 0 is the rest pose.
fn pose(bones: &[Bone], frame: usize) -> Vec<(DMat3, DVec3)> {
    let t = frame as f64 / (FRAMES - 1) as f64;
    let up = ease(t, 0.0, 0.18) * (1.0 - ease(t, 0.84, 1.0));
    let wheel = ease(t, 0.12, 0.88);
    let mut local = vec![DQuat::IDENTITY; bones.len()];
    let z = DQuat::from_rotation_z;
    local[PELVIS] = z(-std::f64::consts::TAU * wheel);
    local[CHEST] = z(-0.25 * up * (std::f64::consts::TAU * wheel).sin());
    local[HEAD] = DQuat::from_rotation_x(-0.35 * up) * DQuat::from_rotation_y(0.3 * up);
    for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
        local[ARM[side]] = z(sign * 1.9 * up);
        // Hands that bear the body bend back at the wrist.
        let across = (bones[ARM[side] + 2].to - bones[ARM[side] + 2].from).cross(DVec3::Z).normalize();
        local[ARM[side] + 2] = DQuat::from_axis_angle(across, -0.5 * up);
        local[LEG[side]] = z(sign * 0.55 * up) * DQuat::from_rotation_x(-0.15 * up);
        local[LEG[side] + 1] = DQuat::from_rotation_x(0.3 * up);
        local[LEG[side] + 2] = DQuat::from_rotation_x(0.4 * up);
    }
    let low = (0.5 * std::f64::consts::TAU * wheel).sin().powi(2);
    chain(bones, &local, DVec3::new(2.4 * wheel, -0.15 * low, 0.0))
}

/// The markers and the skin vertices that they are glued to: one or two on each end, one on each joint of a limb.
fn markers(body: &Body, bones: &[Bone]) -> Vec<(&'static str, usize)> {
    const FEW: [&str; 22] = [
        "LFHD", "RBHD", "C7", "CLAV", "LSHO", "RSHO", "LELB", "RELB", "LWRA", "RWRA", "LFIN", "RFIN", "LFWT", "RFWT", "LBWT",
        "RBWT", "LKNE", "RKNE", "LANK", "RANK", "LTOE", "RTOE",
    ];
    let all = generate::markers::glued(body, bones);
    FEW.map(|name| (name, all.iter().find(|(known, _)| known == name).unwrap().1)).into()
}

fn write_take(path: &Path, markers: &[(&str, usize)], skins: &[Vec<DVec3>]) {
    let points = skins
        .iter()
        .flat_map(|skin| markers.iter().map(|&(_, v)| Some(generate::markers::laboratory(skin[v]).to_array().map(|x| x as f32))));
    let file = c3d_writer::C3dFile {
        labels: markers.iter().map(|(name, _)| (*name).to_owned()).collect(),
        points: points.collect(),
        rate: RATE as f32,
        first_frame: 0,
        ..Default::default()
    };
    std::fs::write(path, file.bytes()).unwrap();
}

/// Root mean square change of the distances between some vertices.
fn unrigid(rest: &[DVec3], pose: &[DVec3], part: &[usize]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, &a) in part.iter().enumerate() {
        for &b in &part[..i] {
            sum += (rest[a].distance(rest[b]) - pose[a].distance(pose[b])).powi(2);
            count += 1.0;
        }
    }
    (sum / count).sqrt()
}

/// Angle between the halves of a limb, degrees, by the middles of its skin in three places.
fn bow(pose: &[DVec3], rings: &[Vec<usize>; 3]) -> f64 {
    let [a, b, c] = rings.each_ref().map(|ring| ring.iter().map(|&v| pose[v]).sum::<DVec3>() / ring.len() as f64);
    (b - a).angle_between(c - b).to_degrees()
}

/// What a run leaves, in percent of the height, over the measured frames.
#[derive(Debug, Default)]
struct Measures {
    /// Mean and 95th percentile of the distance from the true skin.
    truth: f64,
    truth_p95: f64,
    /// The same mean of head, hands and feet.
    ends_truth: f64,
    /// Mean distance of the places of their markers from where these are, and of those of the other markers.
    gripped: f64,
    others: f64,
    /// Root mean square change of distances within the head, the worse hand and the worse foot, in the mean over the frames.
    ends: [f64; 3],
    /// Bow of the worse upper arm, forearm, thigh and shank beyond that of the true skin, degrees, in the mean over the frames.
    bows: [f64; 4],
}

#[test]
fn rigid_ends_and_stiffer_shafts_help_few_markers() {
    let work = tempfile::tempdir().unwrap();
    let bones = bones();
    let scan = fixture("scan.obj");
    let rest = retarget::scan::read(&scan).unwrap().mesh.positions;
    let body = Body::on(&bones, rest.clone());
    let skins: Vec<Vec<DVec3>> = (0..FRAMES).map(|f| posed(&body, &bones, &pose(&bones, f))).collect();
    let markers = markers(&body, &bones);
    assert_eq!(markers.len(), 22);
    write_take(&work.path().join("wheel.c3d"), &markers, &skins);
    let of_bone = |bone: usize| -> Vec<usize> {
        let (from, to) = (bones[bone].from, bones[bone].to);
        let along = |p: DVec3| (p - from).dot(to - from) / (to - from).length_squared();
        (0..rest.len())
            .filter(|&v| body.weights[v][0].0 == bone && body.weights[v][0].1 > 0.9 && along(rest[v]) > 0.3)
            .step_by(3)
            .collect()
    };
    let ends: [Vec<Vec<usize>>; 3] =
        [vec![of_bone(HEAD)], ARM.map(|arm| of_bone(arm + 2)).into(), LEG.map(|leg| of_bone(leg + 2)).into()];
    assert!(ends.iter().flatten().all(|part| part.len() > 30));
    let end_bones: Vec<usize> = [HEAD].into_iter().chain(ARM.map(|arm| arm + 2)).chain(LEG.map(|leg| leg + 2)).collect();
    let on_end: Vec<bool> = body.weights.iter().map(|w| end_bones.contains(&w[0].0)).collect();
    let rings = |bone: usize| -> [Vec<usize>; 3] {
        let (from, to) = (bones[bone].from, bones[bone].to);
        let along = |p: DVec3| (p - from).dot(to - from) / (to - from).length_squared();
        [0.25, 0.5, 0.75].map(|place| {
            let on = |v: &usize| body.weights[*v][0].0 == bone && (along(rest[*v]) - place).abs() < 0.06;
            (0..rest.len()).filter(on).collect()
        })
    };
    let shafts: [[[Vec<usize>; 3]; 2]; 4] = [ARM, ARM.map(|b| b + 1), LEG, LEG.map(|b| b + 1)].map(|pair| pair.map(rings));
    assert!(shafts.iter().flatten().flatten().all(|ring| ring.len() > 8));
    let height = 1.757;

    let run = |name: &str, options: &[&str]| {
        let out = work.path().join("out.pc2");
        let all = [scan.to_str().unwrap(), "wheel.c3d", "-o", "out.pc2", "--force"];
        let said = retarget_ok(work.path(), all.iter().chain(options));
        assert!(said.contains("22 of 22 markers bound"), "{said}");
        let frames = read_pc2(&out);
        if let Some(folder) = std::env::var_os("RETARGET_KEEP") {
            std::fs::copy(&out, Path::new(&folder).join(format!("wheel_{name}.pc2"))).unwrap();
        }
        let mut m = Measures::default();
        let mut distances = Vec::new();
        let mut count = 0.0;
        for f in MEASURED.step_by(4) {
            let pose: Vec<DVec3> = frames[f].iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
            distances.extend(pose.iter().zip(&skins[f]).map(|(a, b)| a.distance(*b)));
            let all_ends = || ends.iter().flatten().flatten();
            m.ends_truth += all_ends().map(|&v| pose[v].distance(skins[f][v])).sum::<f64>() / all_ends().count() as f64;
            for (mean, of_ends) in [(&mut m.gripped, true), (&mut m.others, false)] {
                let held = || markers.iter().filter(|(_, v)| on_end[*v] == of_ends);
                *mean += held().map(|&(_, v)| pose[v].distance(skins[f][v])).sum::<f64>() / held().count() as f64;
            }
            for (worst, parts) in m.ends.iter_mut().zip(&ends) {
                *worst += parts.iter().map(|part| unrigid(&rest, &pose, part)).fold(0.0, f64::max);
            }
            for (worst, limbs) in m.bows.iter_mut().zip(&shafts) {
                *worst += limbs.iter().map(|rings| (bow(&pose, rings) - bow(&skins[f], rings)).abs()).fold(0.0, f64::max);
            }
            count += 1.0;
        }
        distances.sort_unstable_by(f64::total_cmp);
        m.truth = distances.iter().sum::<f64>() / distances.len() as f64 / height * 100.0;
        m.truth_p95 = distances[distances.len() * 95 / 100] / height * 100.0;
        [&mut m.ends_truth, &mut m.gripped, &mut m.others].into_iter().for_each(|mean| *mean *= 100.0 / height / count);
        m.bows = m.bows.map(|bow| bow / count);
        m.ends = m.ends.map(|e| e * 100.0 / height / count);
        eprintln!(
            "{name}: {m:.3?}\n{}",
            said.lines()
                .filter(|l| l.starts_with("done") || l.starts_with("warn") || l.starts_with("parts"))
                .collect::<Vec<_>>()
                .join("\n")
        );
        m
    };
    let soft: Vec<String> = ["ends", "upper_arms", "forearms", "thighs", "shanks"]
        .iter()
        .flat_map(|part| ["--stiffness".into(), format!("{part}=1")])
        .collect();
    let without = run("without", &soft.iter().map(String::as_str).collect::<Vec<_>>());
    let default = run("default", &[]);
    assert!(default.truth < 0.9 * without.truth && default.truth_p95 < 0.9 * without.truth_p95, "nearer to the truth");
    assert!(default.ends_truth < 0.8 * without.ends_truth, "head, hands and feet are nearer to the truth");
    // Rigid ends cannot bend towards each of their markers; these hold them all the more firmly.
    assert!(default.gripped < 0.9 * without.gripped, "markers of head, hands and feet are followed");
    for (name, k) in [("head", 0), ("hands", 1)] {
        assert!(default.ends[k] < 0.75 * without.ends[k], "{name} keeps its shape");
    }
    // A tenth more than without; it is half as much again where stiffer shanks end in soft feet.
    assert!(default.ends[2] < 1.25 * without.ends[2], "stiffer shanks do not bend the feet");
    for (name, k) in [("upper arms", 0), ("forearms", 1), ("thighs", 2), ("shanks", 3)] {
        assert!(default.bows[k] < 0.8 * without.bows[k], "{name} bow less");
    }
}
