//! The shell deformer on an arm with two examples and, with the real data, on a walk with eight: what a step costs, and how many a frame takes.

use super::common::{retarget_ok, shared};
use super::core_time::seconds_of_children;
use super::{median, milliseconds};
use glam::{DQuat, DVec3};
use retarget::deform::shells::{Body, Options, Shells, SurfaceRows};
use retarget::deform::{Deformer, Handle, Targets};
use serde_json::Value;

const REPEATS: usize = 5;
/// Frames of the bend.
const FRAMES: u32 = 60;
/// Vertices of the coarse meshes; ratios are against the first.
const SIZES: [usize; 3] = [500, 1000, 4000];

/// A tube along y with `rings` of `segments`, bent by an angle about its middle.
fn tube(rings: usize, segments: usize, bend: f64) -> Vec<DVec3> {
    let share = |y: f64| ((y + 0.2) / 0.4).clamp(0.0, 1.0);
    let point = |ring: usize, segment: usize| {
        let (y, turn) = (ring as f64 / (rings - 1) as f64 - 0.5, std::f64::consts::TAU * segment as f64 / segments as f64);
        // The axis is an arc between −0.2 and 0.2.
        let steps = 200;
        let axis = (0..steps).fold(DVec3::ZERO, |at, k| {
            let s = y * (k as f64 + 0.5) / steps as f64;
            at + DQuat::from_rotation_z(bend * (share(s) - share(0.0))) * DVec3::Y * (y / steps as f64)
        });
        axis + DQuat::from_rotation_z(bend * (share(y) - share(0.0))) * DVec3::new(turn.cos(), 0.0, turn.sin()) * 0.1
    };
    (0..rings).flat_map(|r| (0..segments).map(move |s| point(r, s))).collect()
}

fn triangles(rings: usize, segments: usize) -> Vec<[u32; 3]> {
    let at = |r: usize, s: usize| (r * segments + s % segments) as u32;
    let side = |r: usize, s: usize| [[at(r, s), at(r + 1, s + 1), at(r, s + 1)], [at(r, s), at(r + 1, s), at(r + 1, s + 1)]];
    (0..rings - 1).flat_map(|r| (0..segments).flat_map(move |s| side(r, s))).collect()
}

pub fn run() {
    println!("a tube bent by 80° in {FRAMES} frames, 2 examples; milliseconds on a core, medians of {REPEATS}");
    println!("{:>8} {:>11} {:>12} {:>10} {:>8}", "vertices", "ms per step", "steps/frame", "frames/s", "ratio");
    let mut first = None;
    for size in SIZES {
        let segments = ((size as f64 / 3.0).sqrt() as usize).max(8);
        let rings = size / segments;
        let rest = tube(rings, segments, 0.0);
        let examples = [1.4, -0.9].map(|bend| tube(rings, segments, bend));
        let body = Body::build(&rest, &triangles(rings, segments), &examples, usize::MAX, &|| Ok(())).unwrap();
        let rows = SurfaceRows::new(&body);
        let held = [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98].map(|t| ((t * (rings - 1) as f64) as usize) * segments);
        let held: Vec<usize> = held.iter().flat_map(|v| [*v, v + segments / 2]).collect();
        let handle = |v: &usize| Handle { name: format!("h{v}"), row: rows.row(rest[*v]), beta: 1.0 };
        let handles: Vec<Handle> = held.iter().map(handle).collect();
        let frames: Vec<Targets> = (0..=FRAMES)
            .map(|k| {
                let pose = tube(rings, segments, 1.4 * f64::from(k) / f64::from(FRAMES));
                Targets { positions: held.iter().map(|v| pose[*v]).collect(), presence: vec![1.0; held.len()] }
            })
            .collect();
        let mut shells = Shells::new(&body, &handles, &[], &Options::for_examples(2)).unwrap();
        let mut steps = 0;
        let all = milliseconds(REPEATS, || {
            shells.start(&frames[0]).unwrap();
            steps = frames[1..].iter().map(|f| shells.step(f).unwrap().passes).sum();
        });
        // The start is a few steps of hundreds.
        let each = all / f64::from(steps);
        let ratio = each / *first.get_or_insert(each);
        println!(
            "{:>8} {each:>11.2} {:>12.1} {:>10.0} {ratio:>8.2}",
            body.vertices(),
            f64::from(steps) / f64::from(FRAMES),
            1e3 * f64::from(FRAMES) / all
        );
    }
    walk();
}

/// The real walk through the program.
fn walk() {
    let Some(data) = shared() else { return };
    let pose = |name: &str| data.join(format!("meshes/examples/human_makehuman_male/{name}.obj.gz"));
    let names = [
        "03_walk_left_forward",
        "04_walk_right_forward",
        "05_run",
        "06_arms_up",
        "07_squat_arms_forward",
        "08_sit",
        "09_kick_right",
        "11_forward_bend",
    ];
    let work = tempfile::tempdir().unwrap();
    println!("\na walk of 320 frames at 100 Hz, 8 examples, one thread; seconds on a core, medians of {REPEATS}");
    println!("{:<26} {:>9} {:>12} {:>12}", "", "seconds", "steps/frame", "ms/frame");
    let examples: Vec<String> =
        std::iter::once("--examples".into()).chain(names.map(|n| pose(n).display().to_string())).collect();
    let cases: [(&str, Vec<String>, &[&str]); 3] = [
        ("volumetric", Vec::new(), &[]),
        ("shells", examples.clone(), &[]),
        ("shells, draft", examples, &["--quality", "draft"]),
    ];
    for (name, examples, more) in cases {
        let mut steps = 0.0;
        let seconds = (0..REPEATS).map(|_| {
            let mut arguments = vec![pose("00_rest_apose").display().to_string()];
            arguments.push(data.join("motion/c3d/pig_antom_walk.c3d").display().to_string());
            arguments.extend(["--ref-file".into(), data.join("motion/c3d/pig_antom_static.c3d").display().to_string()]);
            arguments.extend(["--threads", "1", "--force", "--report", "r.json", "-o", "out.pc2"].map(String::from));
            arguments.extend(more.iter().map(|s| (*s).to_owned()));
            arguments.extend(examples.iter().cloned());
            let before = seconds_of_children().expect("seconds on cores");
            retarget_ok(work.path(), arguments);
            let spent = seconds_of_children().expect("seconds on cores") - before;
            let report: Value = serde_json::from_slice(&std::fs::read(work.path().join("r.json")).unwrap()).unwrap();
            let frames = report["frames"].as_array().unwrap();
            steps = frames.iter().map(|f| f["iterations"].as_f64().unwrap()).sum::<f64>() / frames.len() as f64;
            spent
        });
        let seconds = median(seconds.collect());
        println!("{name:<26} {seconds:>9.2} {steps:>12.1} {:>12.1}", seconds * 1e3 / 320.0);
    }
}
