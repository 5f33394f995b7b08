//! Takes as tables, through the program: frame numbers and rates in every output, other rates, smoothing, places far away.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, read_pc2, retarget, retarget_ok};
use retarget::capture::{self, MarkerTake, ReadOptions};
use std::fmt::Write;
use std::path::Path;

/// The fixture take, 372 frames from 1 on.
fn walk() -> capture::Capture {
    capture::read(&fixture("walk.c3d"), &ReadOptions::default()).unwrap()
}

/// The fixture take as a table whose first frame has this number.
fn table(capture: &capture::Capture, first: i64) -> String {
    table_at(capture, first, [0.0; 3])
}

/// The same, shifted.
fn table_at(capture: &capture::Capture, first: i64, shift: [f64; 3]) -> String {
    let take = capture.motion.points();
    let mut text = format!("# unit {}\n# up Z\nframe,time", capture.space.unit.unwrap().value);
    take.labels.iter().for_each(|l| write!(text, ",{l}_x,{l}_y,{l}_z").unwrap());
    for frame in 0..take.frames() {
        write!(text, "\n{},{}", first + frame as i64, frame as f64 / capture.rate).unwrap();
        for marker in 0..take.markers() {
            match take.point(frame, marker) {
                Some(p) => {
                    let at = |i: usize| f64::from(p[i] as f32) + shift[i];
                    write!(text, ",{},{},{}", at(0), at(1), at(2)).unwrap();
                }
                None => text.push_str(",,,"),
            }
        }
    }
    text
}

fn run(folder: &Path, take: &str, more: &[&str]) -> String {
    let scan = fixture("scan.obj").to_string_lossy().into_owned();
    let mut arguments = vec![scan.as_str(), take, "--proxy-vertices", "900", "--force", "--threads", "2"];
    arguments.extend(more);
    retarget_ok(folder, arguments)
}

/// First number and number of frames of a cache.
fn cache(path: &Path) -> (f32, Vec<Vec<[f32; 3]>>) {
    let bytes = std::fs::read(path).unwrap();
    (f32::from_le_bytes(bytes[20..24].try_into().unwrap()), read_pc2(path))
}

/// Keys of the animation in a GLB: how many, first and last time.
fn keys(path: &Path) -> (u64, f64, f64) {
    let bytes = std::fs::read(path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let input = json["animations"][0]["samplers"][0]["input"].as_u64().unwrap() as usize;
    let times = &json["accessors"][input];
    (times["count"].as_u64().unwrap(), times["min"][0].as_f64().unwrap(), times["max"][0].as_f64().unwrap())
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn farthest(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    a.iter().zip(b).flat_map(|(p, q)| (0..3).map(|i| (p[i] - q[i]).abs())).fold(0.0, f32::max)
}

#[test]
fn frames_keep_their_own_numbers_in_every_output() {
    let walk = walk();
    let work = tempfile::tempdir().unwrap();
    let reference = fixture("walk.c3d").to_string_lossy().into_owned();
    run(work.path(), &reference, &["-o", "truth.pc2", "--frames", "4..8", "--align", "similarity", "--ref", "1"]);
    let (start, truth) = cache(&work.path().join("truth.pc2"));
    assert_eq!((start, truth.len()), (4.0, 5));
    for first in [0i64, 30, 705, -5, 70_000] {
        let take = format!("take{first}.csv");
        std::fs::write(work.path().join(&take), table(&walk, first)).unwrap();
        let (a, b) = (first + 3, first + 7);
        let frames = format!("--frames={a}..{b}");
        let reference = format!("--ref={first}");
        let ply = format!("ply{first}/f_####.ply");
        let more = ["-o", "a.pc2", "-o", "a.glb", "-o", &ply, frames.as_str(), "--align", "similarity", &reference];
        run(work.path(), &take, &more);
        let (start, frames) = cache(&work.path().join("a.pc2"));
        assert_eq!((start, frames.len()), (a as f32, 5), "{first}");
        for (frame, truth) in frames.iter().zip(&truth) {
            assert!(farthest(frame, truth) < 2e-4, "{first}: {} m", farthest(frame, truth));
        }
        let name = |n: i64| format!("f_{}{:04}.ply", if n < 0 { "-" } else { "" }, n.abs());
        let mut wanted: Vec<String> = (a..=b).map(name).collect();
        wanted.sort();
        assert_eq!(names(&work.path().join(format!("ply{first}"))), wanted);
        let (count, from, to) = keys(&work.path().join("a.glb"));
        assert!(count == 5 && from == 0.0 && (to - 4.0 / walk.rate).abs() < 1e-6, "{first}: {count} {from} {to}");
    }
    let outside =
        retarget(work.path(), [fixture("scan.obj").to_str().unwrap(), "take-5.csv", "-o", "b.pc2", "--frames", "367..400"]);
    let said = String::from_utf8_lossy(&outside.stderr).into_owned();
    assert!(outside.status.code() == Some(2) && said.contains("a range within -5..366"), "{said}");
}

#[test]
fn another_rate_keeps_the_time_and_both_ends() {
    let walk = walk();
    let work = tempfile::tempdir().unwrap();
    let take = fixture("walk.c3d").to_string_lossy().into_owned();
    let same = ["--frames", "101..121", "--iterations", "60"];
    run(work.path(), &take, &[&["-o", "all.pc2"], &same[..]].concat());
    let slow = (walk.rate / 4.0).to_string();
    run(work.path(), &take, &[&["-o", "slow.pc2", "-o", "slow.glb", "-o", "f_###.ply", "--fps", &slow], &same[..]].concat());
    let fast = (walk.rate * 2.0).to_string();
    run(work.path(), &take, &[&["-o", "fast.pc2", "-o", "fast.glb", "--fps", &fast], &same[..]].concat());
    let [all, slow, fast] = ["all", "slow", "fast"].map(|n| cache(&work.path().join(format!("{n}.pc2"))));
    assert_eq!((all.1.len(), slow.1.len(), fast.1.len()), (21, 6, 41));
    assert_eq!((all.0, slow.0, fast.0), (101.0, 101.0, 101.0));
    // The solver is warm from other frames, so poses agree to its tolerance.
    for k in 0..6 {
        assert!(farthest(&slow.1[k], &all.1[4 * k]) < 3e-3, "{k}: {}", farthest(&slow.1[k], &all.1[4 * k]));
    }
    for k in 0..21 {
        assert!(farthest(&fast.1[2 * k], &all.1[k]) < 3e-3, "{k}: {}", farthest(&fast.1[2 * k], &all.1[k]));
    }
    let seconds = 20.0 / walk.rate;
    for (name, count) in [("slow", 6), ("fast", 41)] {
        let (keys, from, to) = keys(&work.path().join(format!("{name}.glb")));
        assert!(keys == count && from == 0.0 && (to - seconds).abs() < 1e-6, "{name}: {keys} {from} {to}");
    }
    let plys: Vec<String> = names(work.path()).into_iter().filter(|n| n.ends_with(".ply")).collect();
    assert_eq!(plys, (101..107).map(|n| format!("f_{n}.ply")).collect::<Vec<_>>());
}

#[test]
fn smoothing_takes_the_shaking_away() {
    let walk = walk();
    let mut shaken = walk.clone();
    let take: &mut MarkerTake = shaken.motion.points_mut();
    let markers = take.markers();
    let size = 0.01 / walk.space.unit.unwrap().value.metres() as f32;
    take.points.iter_mut().enumerate().for_each(|(i, p)| p[2] += if (i / markers).is_multiple_of(2) { size } else { -size });
    let work = tempfile::tempdir().unwrap();
    for (name, capture) in [("still.csv", &walk), ("shaken.csv", &shaken)] {
        std::fs::write(work.path().join(name), table(capture, 1)).unwrap();
    }
    let same = ["--frames", "101..112", "--align", "similarity", "--ref", "100", "--smooth", "6"];
    run(work.path(), "still.csv", &[&["-o", "still.pc2"], &same[..]].concat());
    let said = run(work.path(), "shaken.csv", &[&["-o", "smooth.pc2"], &same[..]].concat());
    assert!(said.contains("smoothed at 6 Hz"), "{said}");
    run(work.path(), "shaken.csv", &[&["-o", "shaken.pc2"], &same[..6]].concat());
    let [still, smooth, shaken] = ["still", "smooth", "shaken"].map(|n| cache(&work.path().join(format!("{n}.pc2"))).1);
    let off = |frames: &[Vec<[f32; 3]>]| still.iter().zip(frames).map(|(a, b)| farthest(a, b)).fold(0.0, f32::max);
    assert!(off(&smooth) < 2e-3 && off(&shaken) > 5e-3, "{} {}", off(&smooth), off(&shaken));
    let refused = retarget(work.path(), [fixture("scan.obj").to_str().unwrap(), "still.csv", "-o", "a.pc2", "--smooth", "80"]);
    assert_eq!(refused.status.code(), Some(2));
}

#[test]
fn a_take_far_from_the_origin_moves_the_scan_all_the_same() {
    let walk = walk();
    let work = tempfile::tempdir().unwrap();
    std::fs::write(work.path().join("near.csv"), table(&walk, 1)).unwrap();
    std::fs::write(work.path().join("far.csv"), table_at(&walk, 1, [3e7, -3e7, 3e7])).unwrap();
    let [near, far] = ["near", "far"].map(|name| {
        let out = format!("{name}.pc2");
        let same = ["--frames", "101..102"];
        run(work.path(), &format!("{name}.csv"), &[&["-o", &out, "--align", "pose", "--ref", "100"], &same[..]].concat());
        let posed = cache(&work.path().join(&out)).1;
        // By the skin.
        run(work.path(), &format!("{name}.csv"), &[&["-o", &out], &same[..]].concat());
        [posed, cache(&work.path().join(&out)).1].concat()
    });
    for (a, b) in near.iter().zip(&far) {
        // Single precision out there would take steps of two millimetres.
        assert!(farthest(a, b) < 1e-4, "{} m", farthest(a, b));
    }
}
