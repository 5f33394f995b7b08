//! Joints of models whose truth is known: type, axis within 5°, centre within 2 % of the diagonal. Skipped without the data.

use glam::DVec3;
use retarget::glam;
use retarget::joints::{self, Joint, Kind, Options};
use retarget::scan::{self, Scan, UnitBox};
use serde_json::Value;
use std::path::{Path, PathBuf};

pub fn folder(under: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("RETARGET_SHARED").map(|shared| Path::new(&shared).join(under)).filter(|f| f.is_dir());
    if folder.is_none() {
        eprintln!("skipped: RETARGET_SHARED has no {under}");
    }
    folder
}

struct Truth<'a> {
    kind: &'a str,
    axis: Option<DVec3>,
    centre: Option<DVec3>,
}

fn vector(value: &Value) -> Option<DVec3> {
    let x = value.as_array()?;
    Some(DVec3::new(x.first()?.as_f64()?, x.get(1)?.as_f64()?, x.get(2)?.as_f64()?))
}

fn is_right(joint: &Joint, truth: &Truth<'_>, size: f64) -> bool {
    if joint.kind.word() != truth.kind {
        return false;
    }
    let along = truth.axis.map_or(DVec3::ZERO, DVec3::normalize);
    let axis = if joint.kind == Kind::Plane { joint.frame.z_axis } else { joint.frame.x_axis };
    let turned = truth.axis.is_some() && axis.dot(along).abs() < 5.0_f64.to_radians().cos();
    let d = truth.centre.map_or(DVec3::ZERO, |c| joint.centre - c);
    let off = match joint.kind {
        Kind::Revolute | Kind::Cylinder => (d - along * d.dot(along)).length(),
        Kind::Plane => d.dot(along).abs(),
        Kind::Ball => d.length(),
        Kind::Prismatic | Kind::Fixed => 0.0,
    };
    !turned && off < 0.02 * size
}

pub struct Found {
    pub names: Vec<String>,
    pub parts: Vec<joints::Part>,
    pub joints: Vec<Joint>,
    pub size: f64,
    pub scan: Scan,
}

pub fn find(path: &Path) -> Found {
    let scan = scan::read(path).expect("a mesh");
    let size = UnitBox::of(&scan.mesh).expect("an extent").diagonal;
    let components = joints::components(&scan);
    let parts: Vec<joints::Part> = components.iter().map(|c| c.part(&scan.mesh.positions, size)).collect();
    let joints = joints::find(&parts, size, &Options::default());
    Found { names: components.into_iter().map(|c| c.name).collect(), parts, joints, size, scan }
}

#[test]
fn the_parametric_pieces_have_their_types() {
    let Some(folder) = folder("bench/joints_cases") else { return };
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json")).expect("truth")).expect("JSON");
    let (mut right, mut all) = (0, 0);
    for (file, t) in truth.as_object().expect("cases") {
        if file.starts_with("sloppy") {
            continue;
        }
        let found = find(&folder.join(file));
        let kind = t["type"].as_str().expect("a type");
        let truth = Truth { kind, axis: vector(&t["axis"]), centre: vector(&t["centre"]) };
        let is_right = found.joints.first().map_or(kind == "fixed", |j| is_right(j, &truth, found.size));
        if !is_right {
            eprintln!("{file}: {kind}, found {:?}", found.joints.first().map(|j| j.kind));
        }
        assert!(is_right || !found.joints.iter().any(Joint::is_sure), "{file} is called sure and is not {kind}");
        right += usize::from(is_right);
        all += 1;
    }
    assert_eq!((right, all), (64, 64));
}

/// How many joints of a model are as its truth says.
#[derive(Default)]
pub struct Score {
    pub is_robot: bool,
    pub right: usize,
    /// Whose parts touch, and all whose parts are there.
    pub touch: usize,
    pub all: usize,
    /// Joints between parts that have none, but for those that would close a loop.
    pub wrong_pairs: usize,
}

/// Models with a truth, and that.
pub fn models() -> Vec<(String, PathBuf, Value)> {
    let Some(folder) = folder("data/meshes/jointed") else { return Vec::new() };
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder).expect("a folder").map(|e| e.expect("an entry").path()).collect();
    files.retain(|p| p.to_string_lossy().contains(".obj"));
    files.sort();
    let with_truth = |file: PathBuf| {
        let name = file.file_name().expect("a name").to_string_lossy().split('.').next().expect("a stem").to_owned();
        let text = std::fs::read_to_string(folder.join(format!("{name}_truth.json"))).expect("truth");
        (name, file, serde_json::from_str(&text).expect("JSON"))
    };
    files.into_iter().map(with_truth).collect()
}

/// Compares with a truth; none that is sure may be wrong.
pub fn score(name: &str, truth: &Value, found: &Found) -> Score {
    let mut score = Score { is_robot: truth["links"].is_object(), ..Score::default() };
    let index = |n: &str| found.names.iter().position(|name| name == n);
    let mut true_pairs = Vec::new();
    for t in truth["joints"].as_array().expect("joints") {
        let kind = t["type"].as_str().expect("a type");
        let kind = if kind == "continuous" { "revolute" } else { kind };
        let side = |k: usize| -> Vec<usize> {
            if let Some(pair) = t["body_pair"].as_array() {
                let body = truth["rigid_bodies"].as_array().expect("bodies").iter().find(|b| b["id"] == pair[k]);
                let links = body.map(|b| b["links_with_geometry"].as_array().expect("links"));
                return links.into_iter().flatten().filter_map(|l| index(l.as_str()?)).collect();
            }
            index(t[["parent", "child"][k]].as_str().expect("a name")).into_iter().collect()
        };
        let (a, b) = (side(0), side(1));
        if a.is_empty() || b.is_empty() {
            continue;
        }
        let of_pair = |j: &&Joint| (a.contains(&j.a) && b.contains(&j.b)) || (a.contains(&j.b) && b.contains(&j.a));
        let candidates: Vec<&Joint> = found.joints.iter().filter(of_pair).collect();
        true_pairs.extend(candidates.iter().map(|j| (j.a, j.b)));
        if kind == "fixed" && score.is_robot {
            continue;
        }
        let truth = Truth { kind, axis: vector(&t["axis"]), centre: vector(&t["position"]) };
        let is_right = candidates.iter().any(|j| is_right(j, &truth, found.size));
        let sure = candidates.iter().find(|j| j.is_sure() && !self::is_right(j, &truth, found.size));
        assert!(sure.is_none(), "{name}: {} is called sure and is wrong", t["name"]);
        score.right += usize::from(is_right);
        score.touch += usize::from(!candidates.is_empty());
        score.all += 1;
    }
    let wrong = || found.joints.iter().filter(|j| !true_pairs.contains(&(j.a, j.b)));
    let pair = |j: &Joint| format!("{} and {}", found.names[j.a], found.names[j.b]);
    let false_sure = wrong().find(|j| j.is_sure());
    assert!(false_sure.is_none(), "{name}: a sure joint between {}", pair(false_sure.expect("one")));
    score.wrong_pairs = wrong().filter(|j| !j.closes_loop).count();
    score
}

#[test]
fn models_have_the_joints_of_their_truth() {
    let (mut right, mut touch, mut all) = (0, 0, 0);
    for (name, file, truth) in models() {
        let found = find(&file);
        let score = score(&name, &truth, &found);
        eprintln!("{name}: {} of {} right, {} touch, {} pairs in all", score.right, score.all, score.touch, found.joints.len());
        if score.is_robot {
            (right, touch, all) = (right + score.right, touch + score.touch, all + score.all);
        } else {
            assert_eq!(score.right, score.all, "{name}");
        }
    }
    eprintln!("robots: {right} of {all}, {touch} touch");
    assert!(right * 10 >= touch * 6 && right * 2 >= all);
}

/// Ranges of motion are those of the shapes, also where the vertices are noisy by 0.2 % of the size.
#[test]
fn the_parametric_pieces_have_their_ranges() {
    let Some(folder) = folder("bench/joints_cases") else { return };
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json")).expect("truth")).expect("JSON");
    // What the tolerance of the search makes of an angle at the arm of the stop, and of a slide in diagonals.
    const ANGLE: f64 = 8.0;
    const SLIDE: f64 = 0.005;
    let near = |(lo, hi): (f64, f64), truth: &Value, most: f64| {
        let [from, to] = [0, 1].map(|k| truth[k].as_f64().expect("a limit"));
        (lo - from).abs() < most && (hi - to).abs() < most
    };
    let mut count = 0;
    for (file, t) in truth.as_object().expect("cases") {
        if file.starts_with("sloppy") || file.starts_with("range") {
            continue;
        }
        let found = find(&folder.join(file));
        let Some(joint) = found.joints.first() else { continue };
        let degrees = |(lo, hi): (f64, f64)| (lo.to_degrees(), hi.to_degrees());
        match t["piece"].as_str().expect("a piece") {
            "hinge" => {
                let angle = degrees(joint.angle.expect("a range"));
                assert!(near(angle, &t["limits_deg"], ANGLE), "{file}: {angle:?}");
            }
            "rod_sleeve" | "square_slider" => {
                let slide = joint.slide.expect("a range");
                assert!(near(slide, &t["limits_len"], SLIDE * found.size), "{file}: {slide:?}");
                assert!(joint.angle.is_none(), "{file}: {:?}", joint.angle);
            }
            "ball" => {
                let cone = joint.cone.expect("a cone").to_degrees();
                assert!((cone - t["cone_deg"].as_f64().expect("a cone")).abs() < ANGLE, "{file}: {cone}");
            }
            "cone_pivot" => assert!(joint.angle.is_none(), "{file}: {:?}", joint.angle),
            _ => continue,
        }
        count += 1;
    }
    assert_eq!(count, 35);
}
