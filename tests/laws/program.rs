//! Laws of the whole program, from files to files.

use super::cases::{Case, TAKES, Take, cases, largest};
use super::common::c3d_writer::C3dFile;
use super::common::{fixture, read_pc2, retarget_ok};
use super::tally::Tally;
use glam::{DQuat, DVec3};
use retarget::capture::{self, MarkerTake, Motion};
use std::fmt::Write as _;
use std::path::Path;

/// Meshes made here: the program is run on these, so that it takes seconds.
const OWN: usize = 9;
/// Frames of a take.
const FRAMES: usize = 12;

/// At quality `converged` a frame ends within about twenty tolerances of 1e-6 of the minimum.
const SOLVED: f64 = 2e-5;
/// Two proxies of 500 vertices of one surface follow the same markers this nearly, in diagonals: their edges run elsewhere.
const OTHER_PROXY: f64 = 1.5e-2;

type Frames = Vec<Vec<DVec3>>;

fn obj(points: &[DVec3], triangles: &[[u32; 3]]) -> String {
    let mut text = String::new();
    for p in points {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for t in triangles {
        let _ = writeln!(text, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1);
    }
    text
}

/// A capture without unit and axes: in the space of the scan.
fn capture(frames: &[Vec<DVec3>]) -> Vec<u8> {
    let labels = (0..frames[0].len()).map(|i| format!("M{i:02}")).collect();
    let points = frames.iter().flatten().map(|p| Some(p.to_array().map(|c| c as f32))).collect();
    C3dFile { labels, points, unit: String::new(), up: String::new(), right: String::new(), ..C3dFile::default() }.bytes()
}

/// The markers of a take on a mesh; the first frame is at rest.
fn markers(case: &Case, take: &Take, frames: usize) -> Frames {
    let time = |k: usize| 0.5 * k as f64 / FRAMES as f64;
    (0..frames).map(|k| case.rest.iter().map(|&p| (take.motion)(time(k), p)).collect()).collect()
}

/// Writes scan and capture, runs the program as it is in the scan's space, and reads the cache.
fn run(points: &[DVec3], triangles: &[[u32; 3]], markers: &[Vec<DVec3>], more: &[&str]) -> Frames {
    let work = tempfile::tempdir().unwrap();
    std::fs::write(work.path().join("scan.obj"), obj(points, triangles)).unwrap();
    std::fs::write(work.path().join("take.c3d"), capture(markers)).unwrap();
    let fixed = ["scan.obj", "take.c3d", "--align", "none", "--proxy-vertices", "500", "--quality", "converged", "-o", "out.pc2"];
    retarget_ok(work.path(), fixed.iter().chain(more));
    wide(&read_pc2(&work.path().join("out.pc2")))
}

fn wide(frames: &[Vec<[f32; 3]>]) -> Frames {
    frames.iter().map(|f| f.iter().map(|p| DVec3::from(p.map(f64::from))).collect()).collect()
}

/// Largest distance between two runs.
fn apart(a: &Frames, b: &Frames) -> f64 {
    assert_eq!(a.len(), b.len());
    largest(a.iter().zip(b).map(|(a, b)| super::distance(a, b)))
}

/// Every own mesh with one of the takes.
fn pairs() -> impl Iterator<Item = (&'static Case, &'static Take)> {
    cases()[..OWN].iter().enumerate().map(|(i, case)| (case, &TAKES[i % TAKES.len()]))
}

#[test]
fn a_rigid_motion_of_all_markers_moves_the_scan_by_it() {
    let mut tally = Tally::new("program: rigid in, rigid out (--align none)", SOLVED);
    let motion = |k: usize| {
        let q = DQuat::from_axis_angle(DVec3::new(0.3, 1.0, -0.4).normalize(), 0.06 * k as f64);
        move |p: DVec3| q * p + DVec3::new(0.01, -0.004, 0.02) * k as f64
    };
    for case in &cases()[..OWN] {
        let frames: Frames = (0..FRAMES).map(|k| case.rest.iter().map(|&p| motion(k)(p)).collect()).collect();
        let out = run(&case.shape.points, &case.shape.triangles, &frames, &[]);
        assert_eq!(out.len(), FRAMES);
        let error = |k: usize| largest(out[k].iter().zip(&case.shape.points).map(|(p, &q)| p.distance(motion(k)(q))));
        tally.note(case, None, "program", largest((0..FRAMES).map(error)));
    }
    tally.close();
}

#[test]
fn scaled_renumbered_mirrored_and_longer_inputs_give_the_same_animation() {
    // A power of two changes no rounding; a thousand does, and where many choices are equally good another proxy may come of it.
    let mut doubled = Tally::new("program: scan and take x 1024, output x 1024", 1e-6);
    let mut scaled = Tally::new("program: scan and take x 1000, output x 1000", OTHER_PROXY);
    let mut renumbered = Tally::new("program: renumbered scan, renumbered output", OTHER_PROXY);
    let mut mirrored = Tally::new("program: mirrored scan and take, mirrored output", OTHER_PROXY);
    let mut longer = Tally::new("program: extra later frames leave the earlier ones alone", 0.0);
    let mirror = |p: DVec3| DVec3::new(-p.x, p.y, p.z);
    for (case, take) in pairs() {
        let (points, triangles) = (&case.shape.points, &case.shape.triangles);
        let markers = markers(case, take, FRAMES);
        let mapped = |map: &dyn Fn(DVec3) -> DVec3| -> (Vec<DVec3>, Frames) {
            (points.iter().map(|&p| map(p)).collect(), markers.iter().map(|f| f.iter().map(|&p| map(p)).collect()).collect())
        };
        let base = run(points, triangles, &markers, &[]);
        assert!(apart(&vec![base[0].clone()], &vec![base[FRAMES - 1].clone()]) > 0.02, "{} must move", case.shape.name);

        for (factor, tally) in [(1024.0, &mut doubled), (1000.0, &mut scaled)] {
            let (large, far) = mapped(&|p| p * factor);
            let mut out = run(&large, triangles, &far, &[]);
            out.iter_mut().flatten().for_each(|p| *p /= factor);
            tally.note(case, Some(take), "program", apart(&out, &base));
        }

        let last = points.len() as u32 - 1;
        let backwards: Vec<DVec3> = points.iter().rev().copied().collect();
        let shuffled: Vec<[u32; 3]> = triangles.iter().rev().map(|t| t.map(|v| last - v)).collect();
        let mut out = run(&backwards, &shuffled, &markers, &[]);
        out.iter_mut().for_each(|f| f.reverse());
        renumbered.note(case, Some(take), "program", apart(&out, &base));

        let (other, opposite) = mapped(&mirror);
        let turned: Vec<[u32; 3]> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let mut out = run(&other, &turned, &opposite, &[]);
        out.iter_mut().flatten().for_each(|p| *p = mirror(*p));
        mirrored.note(case, Some(take), "program", apart(&out, &base));

        // The later frames run back to the start.
        let there_and_back: Frames = markers.iter().chain(markers.iter().rev()).cloned().collect();
        let out = run(points, triangles, &there_and_back, &[]);
        longer.note(case, Some(take), "program", apart(&out[..FRAMES].to_vec(), &base));
    }
    doubled.close();
    scaled.close();
    renumbered.close();
    mirrored.close();
    longer.close();
}

#[test]
fn any_number_of_threads_writes_the_same_bytes_twice() {
    let mut tally = Tally::new("program: 1, 2, 3 and 4 threads, the same bytes, twice", 0.0);
    for (i, (case, take)) in pairs().enumerate() {
        let work = tempfile::tempdir().unwrap();
        std::fs::write(work.path().join("scan.obj"), obj(&case.shape.points, &case.shape.triangles)).unwrap();
        std::fs::write(work.path().join("take.c3d"), capture(&markers(case, take, 5))).unwrap();
        let mut first: Option<Vec<Vec<u8>>> = None;
        // All counts of threads for every mesh, the second time by turns.
        for (n, threads) in ["1", "2", "3", "4", ["1", "2", "3", "4"][i % 4]].into_iter().enumerate() {
            let folder = work.path().join(n.to_string());
            std::fs::create_dir(&folder).unwrap();
            let fixed = ["../scan.obj", "../take.c3d", "--align", "none", "--proxy-vertices", "500", "--threads", threads];
            let outputs = ["-o", "a.glb", "-o", "a.pc2", "-o", "f_#.ply", "-o", "g_#.obj"];
            retarget_ok(&folder, fixed.iter().chain(&outputs));
            let bytes =
                ["a.glb", "a.pc2", "f_1.ply", "f_5.ply", "g_4.obj"].map(|f| std::fs::read(folder.join(f)).unwrap()).to_vec();
            let same = first.get_or_insert_with(|| bytes.clone()) == &bytes;
            tally.note(case, Some(take), threads, if same { 0.0 } else { 1.0 });
        }
    }
    tally.close();
}

/// The fixture take as its file has it: millimetres, Z up.
fn walk() -> MarkerTake {
    let Motion::Markers(take) = capture::read(&fixture("walk.c3d"), &capture::ReadOptions::default()).unwrap().motion else {
        panic!("the fixture has markers")
    };
    take
}

/// Chosen frames of the fixture take, counted from 0, in another unit and with another axis up.
fn excerpt(frames: &[usize], rate: f32, unit: &str, up: &str, hidden: impl Fn(&str, usize) -> bool) -> Vec<u8> {
    let take = walk();
    let factor = match unit {
        "m" => 0.001,
        "cm" => 0.1,
        _ => 1.0,
    };
    let point = |f: usize, m: usize| {
        let p = take.point(f, m).filter(|_| !hidden(&take.labels[m], f))? * factor;
        Some(if up == "+Y" { DVec3::new(p.x, p.z, -p.y) } else { p }.to_array().map(|c| c as f32))
    };
    let points = frames.iter().flat_map(|&f| (0..take.markers()).map(move |m| (f, m))).map(|(f, m)| point(f, m)).collect();
    C3dFile { labels: take.labels.clone(), points, rate, unit: unit.into(), up: up.into(), ..C3dFile::default() }.bytes()
}

/// Runs the fixture scan with a capture; gives the cache in diagonals of the scan.
fn person(folder: &Path, bytes: &[u8]) -> Frames {
    std::fs::write(folder.join("take.c3d"), bytes).unwrap();
    let scan = fixture("scan.obj");
    let fixed =
        ["take.c3d", "--proxy-vertices", "800", "--quality", "converged", "--force", "-o", "out.pc2"].map(std::ffi::OsStr::new);
    retarget_ok(folder, [scan.as_os_str()].iter().chain(&fixed));
    let mut out = wide(&read_pc2(&folder.join("out.pc2")));
    out.iter_mut().flatten().for_each(|p| *p /= DIAGONAL);
    out
}

/// Diagonal and height of the fixture scan, metres.
const DIAGONAL: f64 = 2.26;
const HEIGHT: f64 = 1.76;

#[test]
fn units_and_axes_of_the_capture_do_not_matter() {
    let work = tempfile::tempdir().unwrap();
    let walk: Vec<usize> = (0..120).step_by(4).collect();
    let squat: Vec<usize> = (300..372).step_by(4).rev().collect();
    let stand: Vec<usize> = (0..12).collect();
    type Excerpt<'a> = (&'a [usize], f32, &'a [(&'static str, &'static str)]);
    let spaces: [Excerpt<'_>; 3] =
        [(&walk, 30.0, &[("m", "+Z"), ("cm", "+Y")]), (&squat, 30.0, &[("mm", "+Y")]), (&stand, 120.0, &[("m", "+Y")])];
    let (mut worst, mut placed) = (0.0f64, 0.0f64);
    for (frames, rate, others) in spaces {
        let seen = |_: &str, _: usize| false;
        let base = person(work.path(), &excerpt(frames, rate, "mm", "+Z", seen));
        assert_eq!(base.len(), frames.len());
        for (unit, up) in others {
            let out = person(work.path(), &excerpt(frames, rate, unit, up, seen));
            let (error, first) = (apart(&out, &base), super::distance(&out[0], &base[0]));
            eprintln!("{} frames in {unit}, {up} up: {error:.1e} of the diagonal apart, the first {first:.1e}", frames.len());
            (worst, placed) = (worst.max(error), placed.max(first));
        }
    }
    assert!(placed < 1e-5, "placed {placed:e} apart");
    // Coordinates are rounded otherwise in another unit, and frames that end at the cap of passes end elsewhere.
    assert!(worst < 1e-3, "{worst:e}");
}

#[test]
fn markers_that_return_leave_no_jump() {
    let work = tempfile::tempdir().unwrap();
    let arms: Vec<usize> = (0..160).collect();
    let sets: [&[&str]; 3] = [&["LWRA"], &["LFRM", "LWRA", "LWRB", "LFIN"], &["RANK", "RHEE", "RMT5", "RTOE", "RSHN"]];
    let whole = person(work.path(), &excerpt(&arms, 120.0, "mm", "+Z", |_, _| false));
    for set in sets {
        let gone = 40..120;
        let out = person(work.path(), &excerpt(&arms, 120.0, "mm", "+Z", |name, f| set.contains(&name) && gone.contains(&f)));
        assert_eq!(out.len(), whole.len());
        // What a vertex moves in a frame beyond what it moves when nothing is missing.
        let jump = |k: usize| {
            let each = out[k].iter().zip(&out[k - 1]).zip(whole[k].iter().zip(&whole[k - 1]));
            largest(each.map(|((a, b), (c, d))| ((*a - *b) - (*c - *d)).length())) * DIAGONAL / HEIGHT
        };
        let missed = apart(&vec![out[gone.end - 1].clone()], &vec![whole[gone.end - 1].clone()]) * DIAGONAL / HEIGHT;
        let (frame, worst) = (gone.end..out.len()).map(|k| (k, jump(k))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        eprintln!(
            "{set:?} gone for 80 frames: {:.2} % of height off at the end, jump {:.2} % in frame {frame}",
            missed * 100.0,
            worst * 100.0
        );
        assert!(worst < 0.02, "{set:?}: jump of {:.2} % of height in frame {frame}", worst * 100.0);
    }
}
