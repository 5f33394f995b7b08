//! Whole runs of the program on a scan of 205,000 vertices with a take of 320 frames; needs the real data.

use super::common::{retarget_ok, shared};
use super::core_time::seconds_of_children;
use super::median;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[allow(dead_code)]
#[path = "../../tests/real_takes/repeat.rs"]
mod repeat;
use repeat::{Again, repeated};

const REPEATS: usize = 3;

/// Figures of one run; seconds and milliseconds by the clock, and seconds on cores.
struct Figures {
    set_up: f64,
    solve: f64,
    map: f64,
    write: f64,
    whole: f64,
    cores: f64,
    peak: f64,
    frames: usize,
}

pub fn run() {
    let Some(data) = shared() else { return };
    let scan = data.join("meshes/scans/synthetic_scan_male_apose_mm_zup.ply.gz");
    let walk = data.join("motion/c3d/pig_antom_walk.c3d");
    let standing = data.join("motion/c3d/pig_antom_static.c3d");
    let work = tempfile::tempdir().unwrap();
    let long = work.path().join("long.c3d");
    std::fs::write(&long, repeated(&std::fs::read(&walk).unwrap(), 10, Again::ThereAndBack)).unwrap();
    println!("205,000 vertices, default quality, two threads; medians of {REPEATS} runs");
    println!(
        "by the clock, which counts other programs: set-up from the files to the first frame, stages per frame (they overlap), the rest"
    );
    println!("on cores: set-up, and per frame; frames/s if two cores had nothing else to do");
    println!(
        "{:<14} {:>6} {:>8} {:>8} {:>7} {:>8} {:>8} | {:>8} {:>9} {:>8} | {:>7}",
        "run", "frames", "set-up s", "solve ms", "map ms", "write ms", "rest s", "set-up s", "ms/frame", "frames/s", "peak MB"
    );
    // Of the shortest run hardly anything is frames.
    let short = |ending: &str| figures(work.path(), &[&scan, &walk], &standing, ending, &["--frames", "143..143"]).cores;
    for (name, capture, ending, repeats) in
        [("320 to PC2", &walk, "pc2", REPEATS), ("320 to GLB", &walk, "glb", REPEATS), ("3200 to PC2", &long, "pc2", 1)]
    {
        let set_up_cores = median((0..REPEATS).map(|_| short("pc2")).collect());
        let runs: Vec<Figures> = (0..repeats).map(|_| figures(work.path(), &[&scan, capture], &standing, ending, &[])).collect();
        let of = |field: &dyn Fn(&Figures) -> f64| median(runs.iter().map(field).collect());
        let frames = runs[0].frames;
        let per_frame = (of(&|f| f.cores) - set_up_cores) * 1e3 / frames as f64;
        println!(
            "{name:<14} {frames:>6} {:>8.2} {:>8.2} {:>7.2} {:>8.2} {:>8.2} | {set_up_cores:>8.2} {per_frame:>9.2} {:>8.0} | {:>7.0}",
            of(&|f| f.set_up),
            of(&|f| f.solve),
            of(&|f| f.map),
            of(&|f| f.write),
            of(&|f| f.whole - f.set_up),
            2e3 / per_frame,
            of(&|f| f.peak)
        );
    }
}

fn figures(work: &Path, inputs: &[&PathBuf; 2], standing: &Path, ending: &str, more: &[&str]) -> Figures {
    let (out, report) = (work.join(format!("out.{ending}")), work.join("out.json"));
    let mut arguments: Vec<&Path> = inputs.iter().map(|p| p.as_path()).collect();
    arguments.extend(["--force", "--quiet", "--threads", "2", "--ref-file"].map(Path::new));
    arguments.extend([standing, Path::new("-o"), &out, Path::new("--report"), &report]);
    arguments.extend(more.iter().map(Path::new));
    let (start, before) = (Instant::now(), seconds_of_children());
    retarget_ok(work, &arguments);
    let whole = start.elapsed().as_secs_f64();
    let cores = seconds_of_children().zip(before).map_or(f64::NAN, |(after, before)| after - before);
    let report: Value = serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap();
    let frames = report["frames"].as_array().unwrap();
    let mean = |stage: &str| frames.iter().map(|f| f["ms"][stage].as_f64().unwrap()).sum::<f64>() / frames.len() as f64;
    let set_up: f64 = report["setup_ms"].as_object().unwrap().values().map(|v| v.as_f64().unwrap()).sum();
    Figures {
        set_up: set_up / 1e3,
        solve: mean("solve"),
        map: mean("map"),
        write: mean("write"),
        whole,
        cores,
        peak: report["peak_mb"].as_f64().unwrap_or(f64::NAN),
        frames: frames.len(),
    }
}
