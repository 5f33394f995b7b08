//! Forty-one markers with CMU's names glued to the skin, and the take as a capture system would export it.

use super::body::{ARM, Body, Bone, LEG};
use super::files::Seeded;
use super::motion::{FRAMES, RATE, skin};
use crate::c3d_writer;
use glam::{DQuat, DVec3};

/// Markers stand off the skin by this much, metres.
const OFF_SKIN: f64 = 0.007;

/// Name of each marker and the skin vertex that it sits on.
pub fn glued(body: &Body, bones: &[Bone]) -> Vec<(String, usize)> {
    let mut wanted: Vec<(String, DVec3)> = vec![
        ("C7".into(), DVec3::new(0.0, 1.485, -0.08)),
        ("T10".into(), DVec3::new(0.0, 1.23, -0.13)),
        ("CLAV".into(), DVec3::new(0.0, 1.435, 0.09)),
        ("STRN".into(), DVec3::new(0.0, 1.27, 0.13)),
        ("RBAC".into(), DVec3::new(-0.085, 1.36, -0.12)),
    ];
    for (side, (letter, s)) in [("L", 1.0), ("R", -1.0)].into_iter().enumerate() {
        let [upper, fore, hand] = [&bones[ARM[side]], &bones[ARM[side] + 1], &bones[ARM[side] + 2]];
        let [thigh, shank, foot] = [&bones[LEG[side]], &bones[LEG[side] + 1], &bones[LEG[side] + 2]];
        let outer = DVec3::new(s * 0.7, 0.7, 0.0);
        let x = DVec3::X * s;
        for (name, place) in [
            ("FHD", DVec3::new(s * 0.05, 1.70, 0.10)),
            ("BHD", DVec3::new(s * 0.05, 1.70, -0.08)),
            ("SHO", upper.from + DVec3::new(-s * 0.02, 0.08, 0.0)),
            ("UPA", upper.from.lerp(upper.to, 0.5) + outer * 0.06),
            ("ELB", upper.to + outer * 0.05 - DVec3::Z * 0.01),
            ("FRM", fore.from.lerp(fore.to, 0.5) + outer * 0.05),
            ("WRA", fore.to + DVec3::Z * 0.04),
            ("WRB", fore.to - DVec3::Z * 0.04),
            ("FIN", hand.from.lerp(hand.to, 0.8) + outer * 0.03),
            ("FWT", DVec3::new(s * 0.11, 1.01, 0.11)),
            ("BWT", DVec3::new(s * 0.06, 1.02, -0.13)),
            ("THI", thigh.from.lerp(thigh.to, 0.55) + x * 0.07 + DVec3::Z * 0.04),
            ("KNE", thigh.to + x * 0.07),
            ("SHN", shank.from.lerp(shank.to, 0.46) + x * 0.06 + DVec3::Z * 0.01),
            ("ANK", shank.to + x * 0.05),
            ("HEE", foot.from + DVec3::new(0.0, -0.045, -0.09)),
            ("MT5", foot.from.lerp(foot.to, 0.75) + x * 0.06 - DVec3::Y * 0.02),
            ("TOE", foot.from.lerp(foot.to, 0.85) + DVec3::Y * 0.05),
        ] {
            wanted.push((format!("{letter}{name}"), place));
        }
    }
    wanted
        .into_iter()
        .map(|(name, place)| {
            let near = |i: &usize| body.points[*i].distance_squared(place);
            let vertex = (0..body.points.len()).min_by(|a, b| near(a).total_cmp(&near(b))).expect("the body has vertices");
            (name, vertex)
        })
        .collect()
}

/// From the scan's space (metres, Y up) into the laboratory (millimetres, Z up, turned).
pub fn laboratory(p: DVec3) -> DVec3 {
    let p = DQuat::from_rotation_y(0.6) * p;
    DVec3::new(p.x, -p.z, p.y) * 1000.0 + DVec3::new(420.0, -310.0, 0.0)
}

/// Frames in which a marker is not seen.
fn hidden(name: &str, frame: usize) -> bool {
    match name {
        "LWRA" => (60..80).contains(&frame),
        "RFIN" => (150..195).contains(&frame),
        "T10" => (200..203).contains(&frame),
        "LTHI" => frame >= FRAMES - 12,
        "RANK" => (240..246).contains(&frame),
        _ => false,
    }
}

/// The take: markers with gaps and a little noise, two ghosts, computed angles and a centre of mass.
pub fn c3d(body: &Body, bones: &[Bone]) -> Vec<u8> {
    let glued = glued(body, bones);
    let angles = ["LHipAngles", "RHipAngles", "LKneeAngles", "RKneeAngles"];
    let mut labels: Vec<String> = glued.iter().map(|(name, _)| name.clone()).collect();
    labels.extend(angles.map(String::from));
    labels.extend(["CentreOfMass", "*42", "*43"].map(String::from));
    let mut random = Seeded(41);
    let mut points = Vec::with_capacity(labels.len() * FRAMES);
    for frame in 0..FRAMES {
        let skin = skin(body, bones, frame);
        let normals = normals(body, &skin);
        for (name, vertex) in &glued {
            let noise = DVec3::new(random.next(), random.next(), random.next()) - 0.5;
            let place = laboratory(skin[*vertex] + normals[*vertex] * OFF_SKIN) + noise * 0.2;
            points.push((!hidden(name, frame)).then(|| place.to_array().map(|c| c as f32)));
        }
        for (k, _) in angles.iter().enumerate() {
            points.push(Some([(frame as f32 * 0.05 + k as f32).sin() * 40.0, 5.0, -3.0]));
        }
        let centre = skin.iter().copied().sum::<DVec3>() / skin.len() as f64;
        points.push(Some(laboratory(centre).to_array().map(|c| c as f32)));
        points.push((30..48).contains(&frame).then_some([900.0, 150.0, 40.0 + frame as f32]));
        points.push((152..170).contains(&frame).then_some([-200.0, 700.0, 1200.0]));
    }
    let named = |l: &str| if l.starts_with('*') { l.to_owned() } else { format!("Walker:{l}") };
    c3d_writer::C3dFile {
        labels: labels.iter().map(|l| named(l)).collect(),
        points,
        rate: RATE as f32,
        first_frame: 1,
        lists: vec![("ANGLES".into(), angles.iter().map(|a| named(a)).collect())],
        subjects: vec!["Walker".into()],
        ..c3d_writer::C3dFile::default()
    }
    .bytes()
}

/// Unit normals of the skin, area-weighted.
fn normals(body: &Body, skin: &[DVec3]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; skin.len()];
    for quad in &body.quads {
        let [a, b, c, d] = quad.map(|i| skin[i as usize]);
        let normal = (c - a).cross(d - b);
        for &i in quad {
            sums[i as usize] += normal;
        }
    }
    sums.into_iter().map(|n| n.normalize_or(DVec3::Y)).collect()
}
