//! Speed of reading BVH from page cache on one core, in megabytes of text per second.
//!
//! `cargo bench --bench bvh [-- FILE.bvh …]`: without files, a take of 60 joints and 20,000 frames that is written for the purpose.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use retarget::capture::{self, ReadOptions};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

const JOINTS: usize = 60;
const FRAMES: usize = 20_000;
const RUNS: usize = 7;

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let mut files: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).filter(|p| p.is_file()).collect();
    if files.is_empty() {
        let path = folder.path().join("take.bvh");
        std::fs::write(&path, take()).unwrap();
        files.push(path);
    }
    files.iter().for_each(|path| measure(path));
}

fn measure(path: &Path) {
    let bytes = std::fs::metadata(path).unwrap().len() as f64;
    let times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let start = Instant::now();
            let capture = capture::read(path, &ReadOptions::default()).unwrap();
            assert!(capture.motion.points().frames() > 0);
            start.elapsed().as_secs_f64()
        })
        .collect();
    let best = times.iter().copied().fold(f64::INFINITY, f64::min);
    let mut sorted = times;
    sorted.sort_by(f64::total_cmp);
    println!(
        "{}: {:.1} MB, best {:.0} MB/s, median {:.0} MB/s of {RUNS} runs",
        path.file_name().unwrap_or_default().to_string_lossy(),
        bytes / 1e6,
        bytes / 1e6 / best,
        bytes / 1e6 / sorted[RUNS / 2]
    );
}

/// A chain of joints that sway, with six decimals as most exporters write them.
fn take() -> String {
    let mut text = String::from(
        "HIERARCHY\nROOT j0\n{\nOFFSET 0 90 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n",
    );
    for k in 1..JOINTS {
        let _ = writeln!(text, "JOINT j{k}\n{{\nOFFSET 0.5 {k}.25 -1\nCHANNELS 3 Zrotation Xrotation Yrotation");
    }
    text += "End Site\n{\nOFFSET 0 1 0\n}\n";
    text += &"}\n".repeat(JOINTS);
    let _ = writeln!(text, "MOTION\nFrames: {FRAMES}\nFrame Time: 0.008333");
    for frame in 0..FRAMES {
        let t = frame as f64 / 120.0;
        let _ = write!(text, "{:.6} {:.6} {:.6}", 100.0 * t.sin(), 90.0 + t.cos(), 130.0 * t);
        for k in 0..3 * JOINTS {
            let _ = write!(text, " {:.6}", 60.0 * (t + 0.1 * k as f64).sin());
        }
        text.push('\n');
    }
    text
}
