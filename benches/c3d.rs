//! Speed of reading C3D from the page cache on one core: `cargo bench --bench c3d`.
//!
//! Prints megabytes of the file per second on the core, best of five: the values alone (`as_found`), and with all cleaning.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "../tests/common/c3d_writer.rs"]
mod c3d_writer;
#[path = "../tests/common/core_time.rs"]
mod core_time;

use c3d_writer::{C3dFile, Processor};
use core_time::seconds_on_core;
use retarget::capture::{self, ReadOptions};
use std::path::Path;

const MARKERS: usize = 60;
const FRAMES: usize = 100_000;

/// Markers of a walking person, with a gap here and there.
fn walk() -> C3dFile {
    let place = |f: usize, m: usize| {
        let (t, k) = (f as f32 / 120.0, m as f32);
        let sway = [30.0 * (5.0 * t + k).sin(), 20.0 * (4.0 * t + k).cos(), 10.0 * (9.0 * t + k).sin()];
        [1500.0 * (0.3 * t).sin() + 200.0 * (k * 1.7).sin() + sway[0], 150.0 * (k * 0.9).cos() + sway[1], 30.0 * k + sway[2]]
    };
    let labels = (0..MARKERS).map(|m| format!("P{m}x")).collect();
    let gap = |f: usize, m: usize| (f / 40 + 7 * m).is_multiple_of(997) && f % 40 < 9;
    let points = (0..FRAMES).flat_map(|f| (0..MARKERS).map(move |m| (!gap(f, m)).then(|| place(f, m)))).collect();
    C3dFile { labels, points, rate: 120.0, ..C3dFile::default() }
}

fn measure(path: &Path, name: &str, options: &ReadOptions) {
    let bytes = std::fs::metadata(path).unwrap().len() as f64;
    let best = (0..5)
        .map(|_| {
            let start = seconds_on_core();
            let capture = capture::read(path, options).unwrap();
            let seconds = seconds_on_core() - start;
            assert_eq!(capture.motion.points().frames(), FRAMES);
            seconds
        })
        .fold(f64::INFINITY, f64::min);
    println!("{name:<28} {:>6.1} MB  {:>7.0} MB/s", bytes / 1e6, bytes / 1e6 / best);
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let walk = walk();
    for (name, file) in [
        ("floats, Intel", C3dFile { ..walk.clone() }),
        ("floats, DEC", C3dFile { processor: Processor::Dec, ..walk.clone() }),
        ("integers, Intel", C3dFile { integers: Some(0.1), ..walk.clone() }),
        ("floats, Intel, 64 analog", C3dFile { analog: 64, ..walk.clone() }),
    ] {
        let path = folder.path().join("walk.c3d");
        std::fs::write(&path, file.bytes()).unwrap();
        measure(&path, name, &ReadOptions { as_found: true, ..ReadOptions::default() });
        if name == "floats, Intel" {
            measure(&path, "floats, Intel, cleaned", &ReadOptions::default());
        }
    }
}
