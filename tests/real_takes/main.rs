//! Real captures on real scans: every figure that a person would check before believing the motion.
//!
//! `scripts/measure.sh` runs all of them and prints one table.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod anatomy;
#[path = "../common/mod.rs"]
mod common;
mod folds;
mod measure;
mod repeat;

use anatomy::{Anatomy, segment_of};
use glam::DVec3;
use measure::Figures;
use repeat::{Again, repeated};

use serde_json::Value;
use std::path::{Path, PathBuf};

const TPOSE: &str = "meshes/bodies/makehuman_male_body_tpose_quads_cm.obj.gz";
const APOSE: &str = "meshes/bodies/makehuman_male_body_apose_quads.obj.gz";
const MAYNARD: &str = "meshes/bodies/nbs_maynard_tpose.obj.gz";
const DENSE: &str = "meshes/scans/synthetic_scan_male_apose_mm_zup.ply.gz";

const ARENA: &str = "motion/c3d/mocap36.c3d";
const WALK: &str = "motion/c3d/pig_antom_walk.c3d";
const STATIC: &str = "motion/c3d/pig_antom_static.c3d";
const OWN_POSE: &str = "motion/c3d/pycgm_rom_static.c3d";
const CLIMB: &str = "motion/c3d/cmu_01_01.c3d";

/// A finished run: its figures and what it decided.
struct Run {
    figures: Figures,
    report: Value,
}

/// Where finished runs are kept for a look: the folder that `RETARGET_KEEP` names, else one that goes away.
enum Place {
    Kept(PathBuf),
    Passing(tempfile::TempDir),
}

impl Place {
    fn new() -> Self {
        match std::env::var_os("RETARGET_KEEP") {
            Some(folder) => {
                std::fs::create_dir_all(&folder).unwrap();
                Place::Kept(folder.into())
            }
            None => Place::Passing(tempfile::tempdir().unwrap()),
        }
    }

    fn path(&self) -> &Path {
        match self {
            Place::Kept(folder) => folder,
            Place::Passing(folder) => folder.path(),
        }
    }
}

/// Runs a pair, prints its row of the table, checks the names and gives what was measured.
fn run(name: &str, scan: &str, capture: &str, options: &[&str]) -> Option<Run> {
    run_in(&Place::new(), name, scan, capture, options)
}

/// The same, where the outputs are needed afterwards.
fn run_in(place: &Place, name: &str, scan: &str, capture: &str, options: &[&str]) -> Option<Run> {
    let data = common::shared()?;
    let output = |ending: &str| place.path().join(format!("{name}.{ending}"));
    let scan = data.join(scan);
    let mut arguments: Vec<PathBuf> = vec![scan.clone(), data.join(capture), "--force".into()];
    arguments.extend(options.iter().map(|o| if o.ends_with(".c3d") { data.join(o) } else { PathBuf::from(o) }));
    for ending in ["glb", "pc2"] {
        arguments.extend(["-o".into(), output(ending)]);
    }
    arguments.extend(["--report".into(), output("json")]);
    let said = common::retarget_ok(place.path(), &arguments);
    eprintln!("--- {name}\n{said}");

    let report: Value = serde_json::from_slice(&std::fs::read(output("json")).unwrap()).unwrap();
    let scan = retarget::scan::read(&scan).unwrap();
    let figures = Figures::read(&scan, &output("pc2"), &report);
    eprintln!("      {}\ntable {}", Figures::HEAD, figures.row(name));
    every_marker_is_on_its_own_segment(&report);
    Some(Run { figures, report })
}

fn handles(report: &Value) -> &Vec<Value> {
    report["decisions"]["binding"]["handles"].as_array().unwrap()
}

fn every_marker_is_on_its_own_segment(report: &Value) {
    for handle in handles(report) {
        let label = handle["label"].as_str().unwrap();
        let expected = segment_of(label).unwrap_or_else(|| panic!("{label} is in no table of this test"));
        assert_eq!(handle["segment"].as_str(), Some(expected.as_str()), "{label}");
    }
}

impl Run {
    /// Demands the figures that hold for every take.
    fn demand(&self, least_bound: f64) {
        let faults = self.figures.faults(least_bound);
        assert!(faults.is_empty(), "{}", faults.join("; "));
    }

    /// Demands that every attachment point lies on the segment that its label names, by bones that the program has never seen.
    fn demand_anatomy(&self, bones: &Anatomy) {
        let height = self.report["decisions"]["binding"]["scan_height"].as_f64().unwrap();
        let mut wrong = Vec::new();
        for handle in handles(&self.report) {
            let p = DVec3::from(std::array::from_fn(|c| handle["attachment"][c].as_f64().unwrap()));
            if let Err(why) = bones.on_segment(handle["segment"].as_str().unwrap(), p, height) {
                wrong.push(format!("{}: {why}", handle["label"]));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("; "));
    }
}

/// Bones of the A-pose man in decimetres, whose origin is near the hip.
fn bones_of_the_man() -> Anatomy {
    let data = common::shared().unwrap();
    Anatomy::read(&data.join("meshes/bodies/makehuman_male_rigged_apose_joints.json"))
        .mapped(|p| p * 10.0 - DVec3::new(0.0, 8.181, 0.0))
}

fn bones_of_the_dense_scan() -> Anatomy {
    Anatomy::read(&common::shared().unwrap().join("meshes/scans/synthetic_scan_male_apose_mm_zup_truth.json"))
}

#[test]
fn some_steps_of_a_walk_on_a_body() {
    let Some(run) = run("b-short", APOSE, WALK, &["--ref-file", STATIC, "--frames", "230..249"]) else { return };
    run.demand(0.85);
    run.demand_anatomy(&bones_of_the_man());
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn a_mocap36_on_the_t_pose() {
    let Some(run) = run("a", TPOSE, ARENA, &[]) else { return };
    run.demand(0.85);
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn b_walk_on_the_a_pose() {
    let Some(run) = run("b", APOSE, WALK, &["--ref-file", STATIC]) else { return };
    run.demand(0.85);
    run.demand_anatomy(&bones_of_the_man());
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn c_standing_in_the_pose_of_the_dense_scan() {
    let Some(run) = run("c", DENSE, OWN_POSE, &[]) else { return };
    run.demand(0.90);
    run.demand_anatomy(&bones_of_the_dense_scan());
    // The actor's arms hang a little differently, so single vertices of the hands go further than the shape as a whole.
    let (_, rms) = run.figures.from_rest;
    assert!(rms <= 0.03, "{:.2} % of the diagonal away from the rest shape", rms * 100.0);
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn d_walk_on_the_dense_scan() {
    let Some(run) = run("d", DENSE, WALK, &["--ref-file", STATIC]) else { return };
    run.demand(0.85);
    run.demand_anatomy(&bones_of_the_dense_scan());
    assert_eq!(run.figures.frames, 320);
    assert!(run.figures.peak_mb <= 800.0, "{} MB", run.figures.peak_mb);
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn e_mocap36_on_a_muscular_man() {
    let Some(run) = run("e", MAYNARD, ARENA, &["--frames", "1..600"]) else { return };
    run.demand(0.85);
}

/// The set-up of the dense scan depends on what else the machine does, so the best of three counts.
#[test]
#[ignore = "seconds on a quiet machine; run by scripts/measure.sh"]
fn the_dense_scan_is_set_up_in_six_seconds() {
    let Some(_) = common::shared() else { return };
    let seconds = (0..3)
        .map(|_| run("d-short", DENSE, WALK, &["--ref-file", STATIC, "--frames", "200..201"]).unwrap().figures.set_up)
        .fold(f64::INFINITY, f64::min);
    eprintln!("table set-up of the dense scan: {seconds:.2} s");
    assert!(seconds <= 6.0, "{seconds:.2} s");
}

/// A climb never shows a neutral pose: the program says so and names the options, or goes on with a warning.
#[test]
fn a_take_that_never_stands_is_refused_or_warned_about() {
    let Some(data) = common::shared() else { return };
    let work = tempfile::tempdir().unwrap();
    let frames = ["--frames", "900..910", "-o", "climb.glb"].map(PathBuf::from);
    let output = common::retarget(work.path(), [data.join(APOSE), data.join(CLIMB)].into_iter().chain(frames));
    let said = String::from_utf8(output.stderr).unwrap();
    eprintln!("{said}");
    match output.status.code() {
        Some(0) => assert!(said.lines().any(|l| l.starts_with("warning") && l.contains("pose")), "{said}"),
        Some(3) => {
            assert!(said.contains("--ref-file") || said.contains("--accept-doubtful"), "{said}");
            assert!(!work.path().join("climb.glb").exists());
        }
        other => panic!("exit code {other:?}\n{said}"),
    }
}

/// A run over the dense scan that writes a GLB alone: the report, and what the program said.
fn dense(folder: &Path, capture: &Path) -> Value {
    let data = common::shared().unwrap();
    let arguments = [
        data.join(DENSE),
        capture.to_owned(),
        "--ref-file".into(),
        data.join(STATIC),
        "--force".into(),
        "-o".into(),
        "m.glb".into(),
        "--report".into(),
        "m.json".into(),
        // What coincides in a parallel set-up differs from run to run by a tenth.
        "--threads".into(),
        "1".into(),
    ];
    eprintln!("{}", common::retarget_ok(folder, arguments));
    serde_json::from_slice(&std::fs::read(folder.join("m.json")).unwrap()).unwrap()
}

#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn memory_is_the_same_for_a_take_ten_times_as_long() {
    let Some(data) = common::shared() else { return };
    let work = tempfile::tempdir().unwrap();
    let once = std::fs::read(data.join(WALK)).unwrap();
    let long = work.path().join("long.c3d");
    let peak = |what: &str, capture: &Path, frames: usize| {
        let report = dense(work.path(), capture);
        assert_eq!(report["frames"].as_array().unwrap().len(), frames);
        let peak = report["peak_mb"].as_f64().unwrap();
        eprintln!("table peak memory of {frames} frames{what}: {peak:.0} MB");
        peak
    };
    let short = peak("", &data.join(WALK), 320);
    assert!(short <= 800.0, "{short} MB");
    for (what, again) in [(", there and back", Again::ThereAndBack), (", with jumps", Again::FromTheStart)] {
        std::fs::write(&long, repeated(&once, 10, again)).unwrap();
        let ten = peak(what, &long, 3200);
        assert!(ten <= 1.05 * short, "{short} MB for one, {ten} MB for ten{what}");
    }
}

/// A body that is somewhere else from one frame to the next stays a body: a cut in a capture is no reason to tear the scan.
#[test]
#[ignore = "minutes; run by scripts/measure.sh"]
fn a_jump_to_another_place_tears_nothing() {
    let Some(data) = common::shared() else { return };
    let work = tempfile::tempdir().unwrap();
    let take = work.path().join("jump.c3d");
    std::fs::write(&take, repeated(&std::fs::read(data.join(WALK)).unwrap(), 2, Again::FromTheStart)).unwrap();
    let run = run("b-jump", APOSE, take.to_str().unwrap(), &["--ref-file", STATIC, "--frames", "440..500"]).unwrap();
    run.demand(0.85);
}
