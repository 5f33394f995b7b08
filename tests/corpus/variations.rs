//! Real takes and scans as others would deliver them: turned, in other units, with other names, with more and with less in them. What
//! cannot be right must be refused or warned of. `scripts/pairs.sh` prints the table.

use super::common;
use super::pairs::{self, Body, Row, Take};
use super::verdict::doubts_who_is_who;
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use retarget::capture::{self, MarkerTake, ReadOptions};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::common::c3d_writer::C3dFile;

const FRAMES: usize = 60;

/// Labels and positions in millimetres, z up, to be spoilt.
#[derive(Clone)]
struct Markers {
    labels: Vec<String>,
    frames: Vec<Vec<Option<DVec3>>>,
    unit: &'static str,
    /// Of the file; empty where it does not say.
    up: &'static str,
    /// What is right: up and unit.
    truth: (&'static str, &'static str),
}

impl Markers {
    fn of(take: &MarkerTake, first: usize) -> Self {
        let frames = (first..first + FRAMES).map(|f| (0..take.markers()).map(|m| take.point(f, m)).collect()).collect();
        Self { labels: take.labels.clone(), frames, unit: "mm", up: "+Z", truth: ("+Z", "mm") }
    }

    fn moved(mut self, by: impl Fn(DVec3) -> DVec3) -> Self {
        self.frames.iter_mut().flatten().for_each(|p| *p = p.map(&by));
        self
    }

    fn named(mut self, by: impl Fn(usize, &str) -> String) -> Self {
        self.labels = self.labels.iter().enumerate().map(|(i, label)| by(i, label)).collect();
        self
    }

    fn mean(frame: &[Option<DVec3>], of: &[usize]) -> Option<DVec3> {
        let seen: Option<Vec<DVec3>> = of.iter().map(|&m| frame[m]).collect();
        seen.map(|s| s.iter().sum::<DVec3>() / s.len() as f64)
    }

    /// More points, each some way from the mean of others.
    fn with(mut self, about: &[&str], points: &[(&str, DVec3)]) -> Self {
        let of: Vec<usize> = about.iter().map(|l| self.labels.iter().position(|x| x == l).unwrap()).collect();
        for (label, shift) in points {
            self.labels.push((*label).to_owned());
            self.frames.iter_mut().for_each(|frame| frame.push(Self::mean(frame, &of).map(|p| p + *shift)));
        }
        self
    }

    fn write(&self, path: &Path) {
        let points = self.frames.iter().flatten().map(|p| p.map(|p| p.to_array().map(|x| x as f32))).collect();
        let right = if self.up.is_empty() { "" } else { "+X" };
        let file = C3dFile {
            labels: self.labels.clone(),
            points,
            unit: self.unit.into(),
            up: self.up.into(),
            right: right.into(),
            ..C3dFile::default()
        };
        std::fs::write(path, file.bytes()).unwrap();
    }
}

/// The variations of a marker take; `!` before the name where no answer but a refusal or a warning is right.
fn variations(plain: &Markers) -> Vec<(&'static str, Markers)> {
    let of = |change: &dyn Fn(Markers) -> Markers| change(plain.clone());
    let turn = DQuat::from_rotation_z(37_f64.to_radians());
    let face = |k: f64| DVec3::new(60.0 * (k * 1.3).cos(), 60.0 * (k * 1.3).sin(), -60.0 - 12.0 * k);
    let faces = ["LBROW", "RBROW", "LMOUTH", "RMOUTH", "CHIN", "NOSE", "LCHEEK", "RCHEEK"];
    let faces: Vec<(&str, DVec3)> = faces.iter().enumerate().map(|(k, &l)| (l, face(k as f64))).collect();
    let sword = [("Sword1", DVec3::X * 200.0), ("Sword2", DVec3::X * 500.0), ("Sword3", DVec3::X * 900.0 + DVec3::Z * 80.0)];
    let crossed = |a: &str| match a.strip_prefix(['L', 'R']) {
        Some(rest) if a.starts_with('L') => format!("R{rest}"),
        Some(rest) => format!("L{rest}"),
        None => a.to_owned(),
    };
    vec![
        ("as it is", plain.clone()),
        ("other prefix, small letters", of(&|m| m.named(|_, l| format!("hero_01:{}", l.to_lowercase())))),
        ("turned by 37° and 40 m away", of(&|m| m.moved(|p| turn * p + DVec3::new(40_000.0, -7_000.0, 0.0)))),
        (
            "metres, y up, axes not said",
            Markers { unit: "m", up: "", truth: ("+Y", "m"), ..of(&|m| m.moved(|p| DVec3::new(p.x, p.z, -p.y) * 1e-3)) },
        ),
        ("millimetres, y up, file says z", Markers { truth: ("+Y", "mm"), ..of(&|m| m.moved(|p| DVec3::new(p.x, p.z, -p.y))) }),
        ("upside down", Markers { up: "", truth: ("-Z", "mm"), ..of(&|m| m.moved(|p| DVec3::new(p.x, -p.y, -p.z))) }),
        ("neither unit nor axes said", Markers { unit: "", up: "", ..plain.clone() }),
        ("millimetres said to be centimetres", Markers { unit: "cm", ..plain.clone() }),
        ("face markers", of(&|m| m.with(&["LFHD", "RFHD"], &faces))),
        ("a sword", of(&|m| m.with(&["RWRA", "RWRB"], &sword))),
        (
            "gaps at the start",
            of(&|mut m| {
                let late = |i: usize, f: usize| f < 20 + i && i.is_multiple_of(3);
                for (f, frame) in m.frames.iter_mut().enumerate() {
                    frame.iter_mut().enumerate().filter(|(i, _)| late(*i, f)).for_each(|(_, p)| *p = None);
                }
                m
            }),
        ),
        (
            "a quarter of the markers left out",
            of(&|mut m| {
                let kept = ["LSHO", "LELB", "LWRA", "LWRB", "LKNE", "LANK", "RSHO", "RELB", "RWRA", "RWRB", "RKNE", "RANK"];
                let stays = |i: usize, l: &str| {
                    kept.contains(&l) || ["ASI", "PSI", "FWT", "BWT"].iter().any(|x| l.ends_with(x)) || i.is_multiple_of(2)
                };
                let stay: Vec<bool> = m.labels.iter().enumerate().map(|(i, l)| stays(i, l)).collect();
                let keep = |list: &mut Vec<Option<DVec3>>| {
                    let mut flags = stay.iter();
                    list.retain(|_| *flags.next().unwrap());
                };
                m.frames.iter_mut().for_each(keep);
                let mut flags = stay.iter();
                m.labels.retain(|_| *flags.next().unwrap());
                m
            }),
        ),
        ("knees exchanged", of(&|m| m.named(|_, l| if ["LKNE", "RKNE"].contains(&l) { crossed(l) } else { l.to_owned() }))),
        ("two people", {
            let other = plain.clone().moved(|p| turn * p + DVec3::new(0.0, 2500.0, 0.0));
            let mut both = plain.clone().named(|_, l| format!("Anna:{l}"));
            both.labels.extend(other.labels.iter().map(|l| format!("Ben:{l}")));
            both.frames.iter_mut().zip(other.frames).for_each(|(a, b)| a.extend(b));
            both
        }),
        ("!no names", Markers { ..of(&|m| m.named(|i, _| format!("M{i:03}"))) }),
        ("!mirrored axes", of(&|m| m.moved(|p| DVec3::new(-p.x, p.y, p.z)))),
        ("!all sides exchanged", of(&|m| m.named(|_, l| crossed(l)))),
    ]
}

/// The scan in another space.
fn scan(from: &Path, to: PathBuf, by: impl Fn(DVec3) -> DVec3, slab: Option<f64>) -> PathBuf {
    let mesh = retarget::scan::read(from).unwrap().mesh;
    let mut text = String::new();
    let mut corners = Vec::new();
    if let Some(half) = slab {
        let low = mesh.positions.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let high = low + 0.02 * half;
        for y in [low - 0.05 * half, high] {
            corners.extend([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, z)| DVec3::new(x * half, y, z * half)));
        }
    }
    for p in mesh.positions.iter().chain(&corners).map(|&p| by(p)) {
        writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap();
    }
    for face in mesh.faces.iter() {
        let words: Vec<String> = face.iter().map(|v| (v + 1).to_string()).collect();
        writeln!(text, "f {}", words.join(" ")).unwrap();
    }
    if !corners.is_empty() {
        let first = mesh.positions.len() + 1;
        for quad in [[0, 1, 2, 3], [7, 6, 5, 4], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]] {
            writeln!(text, "f {}", quad.map(|k: usize| (first + k).to_string()).join(" ")).unwrap();
        }
    }
    std::fs::write(&to, text).unwrap();
    to
}

/// Names of other programs for the joints of one.
fn families() -> Vec<(&'static str, Vec<(&'static str, String)>)> {
    let sided = |words: [(&'static str, &str); 8], other: &[(&'static str, &str)]| {
        let pair = |(from, to): (&'static str, &str)| {
            let (left, right) = match to.split_once('#') {
                Some((a, b)) => (format!("{a}l{b}"), format!("{a}r{b}")),
                None => (format!("Left{to}"), format!("Right{to}")),
            };
            [(from, left), (Box::leak(from.replace("Left", "Right").into_boxed_str()) as &'static str, right)]
        };
        let plain = other.iter().map(|&(from, to)| (from, to.to_owned()));
        words.into_iter().flat_map(pair).chain(plain).collect::<Vec<_>>()
    };
    let from = ["LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"];
    let zip = |to: [&'static str; 8]| std::array::from_fn(|i| (from[i], to[i]));
    vec![
        (
            "unreal",
            sided(
                zip(["clavicle_#", "upperarm_#", "lowerarm_#", "hand_#", "thigh_#", "calf_#", "foot_#", "ball_#"]),
                &[
                    ("Hips", "pelvis"),
                    ("Spine", "spine_01"),
                    ("Spine1", "spine_02"),
                    ("Spine2", "spine_03"),
                    ("Neck", "neck_01"),
                    ("Head", "head"),
                ],
            ),
        ),
        (
            "xsens",
            sided(
                zip(["Shoulder", "UpperArm", "ForeArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toe"]),
                &[("Hips", "Pelvis"), ("Spine", "L5"), ("Spine1", "T12"), ("Spine2", "T8"), ("Neck", "Neck"), ("Head", "Head")],
            ),
        ),
        (
            "rokoko",
            sided(
                zip(["Shoulder", "Arm", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Toe"]),
                &[
                    ("Hips", "Hip"),
                    ("Spine", "Spine1"),
                    ("Spine1", "Spine2"),
                    ("Spine2", "Spine3"),
                    ("Neck", "Neck"),
                    ("Head", "Head"),
                ],
            ),
        ),
    ]
}

#[test]
#[ignore = "animates varied real takes: scripts/pairs.sh"]
fn takes_and_scans_as_others_deliver_them_are_right_or_not_silent() {
    let Some(data) = common::shared() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mesh = |name: &str| data.join("meshes/bodies").join(name);
    let read = |name: &str| capture::read(&data.join("motion").join(name), &ReadOptions::default()).unwrap();
    let (male, female) = (mesh("makehuman_male_body_apose_quads.obj.gz"), mesh("makehuman_female_body_apose_tri_m_zup.ply.gz"));
    let smpl = mesh("smpl_man_tpose.obj.gz");
    let bodies = [
        ("", Body::of(male.clone(), DVec3::Y, DVec3::Z, "dm", None)),
        ("", Body::of(smpl.clone(), DVec3::Y, DVec3::Z, "m", None)),
    ];
    let turn = DQuat::from_rotation_y(37_f64.to_radians());
    let other = |name: &str| folder.path().join(format!("{name}.obj"));
    let place = |p: DVec3| DVec3::new(p.x, p.z, -p.y);
    // Inches are not told from the height: that no unit is known is said.
    let scans = [
        ("scan turned by 37°", Body::of(scan(&smpl, other("turned"), |p| turn * p, None), DVec3::Y, turn * DVec3::Z, "-", None)),
        ("scan in inches", Body::of(scan(&smpl, other("inches"), |p| p * 39.37, None), DVec3::Y, DVec3::Z, "none", None)),
        ("scan in centimetres, z up", Body::of(scan(&female, other("cm"), |p| p * 100.0, None), DVec3::Z, -DVec3::Y, "cm", None)),
        ("scan on its back", Body::of(scan(&smpl, other("back"), place, None), -DVec3::Z, DVec3::Y, "-", None)),
        ("scan on a floor", Body::of(scan(&male, other("floor"), |p| p, Some(12.0)), DVec3::Y, DVec3::Z, "-", None)),
    ];
    let (walk, jump) = (read("c3d/pig_antom_walk.c3d"), read("c3d/cmu_01_01.c3d"));
    let sources = [
        ("walk", Markers::of(walk.motion.points(), 100), "LSHO LELB LWRA+LWRB LASI+LPSI LKNE LANK"),
        ("jump", Markers::of(jump.motion.points(), 560), "LSHO LELB LWRA+LWRB LFWT+LBWT LKNE LANK"),
    ];
    let mut takes = Vec::new();
    for (source, plain, words) in &sources {
        for (name, markers) in variations(plain) {
            let file = folder.path().join(format!("{source}-{}.c3d", takes.len()));
            markers.write(&file);
            // The limbs are those of the take before it was spoilt.
            let straight = folder.path().join(format!("{source}.c3d"));
            plain.write(&straight);
            let mut take = Take::of(file, &straight, Vec::new(), markers.truth, words, "L=R");
            take.along = DVec3::Z;
            takes.push((format!("{source}: {name}"), take));
        }
    }
    let bvh = std::fs::read_to_string(data.join("motion/bvh/mixamo_walk.bvh")).unwrap();
    for (family, names) in families() {
        let lines = bvh.lines().map(|line| {
            let Some(at) = line.find("mixamorig:") else { return line.to_owned() };
            let (before, word) = (&line[..at], line[at + 10..].trim());
            let to = names.iter().find(|(from, _)| *from == word).map_or(word, |(_, to)| to);
            format!("{before}{to}")
        });
        let file = folder.path().join(format!("{family}.bvh"));
        std::fs::write(&file, lines.collect::<Vec<_>>().join("\n")).unwrap();
        let words =
            "mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand mixamorig:LeftUpLeg mixamorig:LeftLeg mixamorig:LeftFoot";
        let straight = data.join("motion/bvh/mixamo_walk.bvh");
        takes.push((format!("names of {family}"), Take::of(file, &straight, Vec::new(), ("+Y", "-"), words, "Left=Right")));
    }
    let mut jobs: Vec<(String, &Body, &Take)> = Vec::new();
    for (_, body) in &bodies {
        jobs.extend(takes.iter().map(|(name, take)| (name.clone(), body, take)));
    }
    for (name, body) in &scans {
        jobs.extend(
            takes
                .iter()
                .filter(|(n, _)| n.ends_with("as it is") || n.ends_with("unreal"))
                .map(|(n, take)| (format!("{name}, {n}"), body, take)),
        );
    }
    let rows: Vec<(String, Row)> = jobs
        .par_iter()
        .enumerate()
        .map(|(k, (name, body, take))| {
            let own = folder.path().join(k.to_string());
            std::fs::create_dir(&own).unwrap();
            (name.clone(), pairs::animate(&data, &own, body, take))
        })
        .collect();
    for (name, row) in &rows {
        print!("| {name} ");
        pairs::print(row);
        let told: Vec<&String> = row.warnings.iter().filter(|w| doubts_who_is_who(w)).collect();
        if !row.wrong.is_empty() || name.contains('!') {
            println!("{told:?}");
        }
    }
    pairs::sum("variations", rows.iter().map(|(_, row)| row));
    // What has no right answer is never taken without a word.
    for (name, row) in rows.iter().filter(|(name, _)| name.contains('!')) {
        assert!(row.refused.is_some() || row.warnings.iter().any(|w| doubts_who_is_who(w)), "{name}: {:?}", row.warnings);
    }
}
