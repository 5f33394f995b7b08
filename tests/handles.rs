//! Parts by selector and handles from tables, through the program.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, read_pc2, retarget, retarget_ok};
use std::fmt::Write;
use std::path::Path;

type Point = [f64; 3];

const RINGS: usize = 60;
const SIDES: usize = 20;
const LENGTH: f64 = 12.0;

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn wide(p: [f32; 3]) -> Point {
    p.map(f64::from)
}

/// A round bar along x from 0 to 12, of radius 1: points, and triangles in three thirds.
fn bar() -> (Vec<Point>, [Vec<[usize; 3]>; 3]) {
    let mut points = Vec::new();
    let mut thirds: [Vec<[usize; 3]>; 3] = Default::default();
    for ring in 0..=RINGS {
        for side in 0..SIDES {
            let angle = side as f64 / SIDES as f64 * std::f64::consts::TAU;
            points.push([ring as f64 / RINGS as f64 * LENGTH, angle.cos(), angle.sin()]);
        }
    }
    for ring in 0..RINGS {
        for side in 0..SIDES {
            let at = |r: usize, s: usize| r * SIDES + s % SIDES;
            let (a, b, c, d) = (at(ring, side), at(ring, side + 1), at(ring + 1, side + 1), at(ring + 1, side));
            thirds[3 * ring / RINGS].extend([[a, b, c], [a, c, d]]);
        }
    }
    for (ring, third) in [(0, 0), (RINGS, 2)] {
        for side in 1..SIDES - 1 {
            let [a, b, c] = [0, side, side + 1].map(|s| ring * SIDES + s);
            thirds[third].push(if third == 0 { [a, c, b] } else { [a, b, c] });
        }
    }
    (points, thirds)
}

/// The bar as OBJ with a group for each third, and as PLY with a red middle.
fn write_bar(folder: &Path) {
    let (points, thirds) = bar();
    let mut obj = String::new();
    for [x, y, z] in &points {
        writeln!(obj, "v {x} {y} {z}").unwrap();
    }
    for (name, faces) in ["left", "middle part", "right"].iter().zip(&thirds) {
        writeln!(obj, "g {name}").unwrap();
        for [a, b, c] in faces {
            writeln!(obj, "f {} {} {}", a + 1, b + 1, c + 1).unwrap();
        }
    }
    std::fs::write(folder.join("bar.obj"), obj).unwrap();
    let faces = thirds.iter().map(Vec::len).sum::<usize>();
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n",
        points.len()
    );
    for [x, y, z] in &points {
        let color = if (4.0..=8.0).contains(x) { "250 4 0" } else { "0 0 255" };
        writeln!(ply, "{x} {y} {z} {color}").unwrap();
    }
    for [a, b, c] in thirds.iter().flatten() {
        writeln!(ply, "3 {a} {b} {c}").unwrap();
    }
    std::fs::write(folder.join("bar.ply"), ply).unwrap();
}

/// Four handles at either end of the bar; the right end is turned by 80° about the middle over five frames.
fn write_bend(folder: &Path) {
    let mut csv = "# the bar is bent\nframe,name,x,y,z\n".to_owned();
    for frame in 0..=5 {
        let angle = 80f64.to_radians() * f64::from(frame) / 5.0;
        for (end, x) in [("l", 0.0), ("r", LENGTH)] {
            for (n, (y, z)) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)].into_iter().enumerate() {
                let (dx, dy) = (x - LENGTH / 2.0, y);
                let (x, y) = if end == "l" {
                    (x, y)
                } else {
                    (LENGTH / 2.0 + dx * angle.cos() - dy * angle.sin(), dx * angle.sin() + dy * angle.cos())
                };
                writeln!(csv, "{frame},{end}{n},{x},{y},{z}").unwrap();
            }
        }
    }
    std::fs::write(folder.join("bend.csv"), csv).unwrap();
}

/// Largest change of a distance between vertices of the bar with x in a range, in the last frame, over the bar's diagonal.
fn departure(cache: &Path, from: f64, to: f64) -> f64 {
    let (rest, _) = bar();
    let frames = read_pc2(cache);
    let pose = frames.last().unwrap();
    let inside: Vec<usize> = (0..rest.len()).filter(|&v| (from..=to).contains(&rest[v][0])).step_by(7).collect();
    assert!(inside.len() > 10);
    let pairs = inside.iter().flat_map(|&a| inside.iter().map(move |&b| (a, b)));
    let worst = pairs.map(|(a, b)| (distance(wide(pose[a]), wide(pose[b])) - distance(rest[a], rest[b])).abs());
    worst.fold(0.0, f64::max) / (LENGTH * LENGTH + 8.0).sqrt()
}

#[test]
fn a_part_keeps_its_shape_by_whatever_it_is_called() {
    let work = tempfile::tempdir().unwrap();
    write_bar(work.path());
    write_bend(work.path());
    let bend = |scan: &str, arguments: &[&str]| {
        let all = [scan, "bend.csv", "-o", "out.pc2", "--force", "--proxy-vertices", "900"];
        let said = retarget_ok(work.path(), all.iter().chain(arguments));
        (said, work.path().join("out.pc2"))
    };
    let (said, cache) = bend("bar.obj", &[]);
    assert!(said.contains("8 handles, 6 frames at 30 Hz"), "{said}");
    assert!(!said.contains("parts"), "nothing was asked for:\n{said}");
    let (free, free_right) = (departure(&cache, 4.6, 7.4), departure(&cache, 7.0, 11.0));
    assert!(free > 0.03 && free_right > 0.01, "the bar hardly bends: {free} {free_right}");

    for (scan, what) in [
        ("bar.obj", "group:middle*"),
        ("bar.obj", "group:middle part"),
        ("bar.obj", "group:part"),
        ("bar.ply", "color:#ff0000"),
        ("bar.ply", "sphere:6,0,0,2.2"),
    ] {
        let (said, cache) = bend(scan, &["--rigid", what]);
        assert!(said.contains(&format!("{what} × 100: ")), "{said}");
        let left = departure(&cache, 4.6, 7.4);
        assert!(left < 0.1 * free, "{what} departs by {left} of the diagonal, {free} without");
    }
    let (_, cache) = bend("bar.obj", &["--rigid", "near:r0,R1,r2,r3"]);
    let left = departure(&cache, 7.0, 11.0);
    assert!(left < 0.2 * free_right, "the right half departs by {left}, {free_right} without");

    let (_, cache) = bend("bar.obj", &["--stiffness", "group:middle*=10"]);
    let ten = departure(&cache, 4.6, 7.4);
    let (_, cache) = bend("bar.obj", &["--stiffness", "group:middle*=0.1"]);
    let soft = departure(&cache, 4.6, 7.4);
    let (said, cache) = bend("bar.obj", &["--stiffness", "group:middle*=0.1", "--stiffness", "group:*=10"]);
    let all = departure(&cache, 4.6, 7.4);
    assert!(ten < 0.35 * free && soft > 1.3 * free, "× 10 {ten}, × 1 {free}, × 0.1 {soft}");
    assert!(said.contains("group:middle*") && all > 0.7 * free && all < 1.3 * free, "the later rule wins: {all}, {free}");
}

#[test]
fn a_handle_with_an_orientation_turns_the_scan() {
    let work = tempfile::tempdir().unwrap();
    write_bar(work.path());
    // Two handles inside of the bar; the right one turns about the bar's axis by 60°, from an orientation that is not the identity.
    let mut csv = "frame,name,x,y,z,qx,qy,qz,qw\n".to_owned();
    for frame in 0..=6 {
        let half = (20.0 + 10.0 * f64::from(frame)).to_radians() / 2.0;
        writeln!(csv, "{frame},left,1,0,0,0,0,0,1\n{frame},right,11,0,0,{},0,0,{}", half.sin(), half.cos()).unwrap();
    }
    std::fs::write(work.path().join("turn.csv"), csv).unwrap();
    retarget_ok(work.path(), ["bar.obj", "turn.csv", "-o", "out.pc2", "--proxy-vertices", "900"]);
    let (rest, _) = bar();
    let frames = read_pc2(&work.path().join("out.pc2"));
    let angle = |from: f64, to: f64| {
        let ring: Vec<usize> = (0..rest.len()).filter(|&v| (from..=to).contains(&rest[v][0])).collect();
        let turns = ring.iter().map(|&v| {
            let ([_, y, z], [_, v, w]) = (rest[v], wide(frames[6][v]));
            (y * w - z * v).atan2(y * v + z * w).to_degrees()
        });
        turns.sum::<f64>() / ring.len() as f64
    };
    let [left, middle, right] = [angle(0.9, 1.1), angle(5.9, 6.1), angle(10.9, 11.1)];
    // The skin gives way round four points by a tenth of the turn.
    assert!(left.abs() < 4.0 && (54.0..61.0).contains(&right) && (middle - 30.0).abs() < 3.0, "{left} {middle} {right}");
}

#[test]
fn parts_that_are_not_there_are_refused_with_what_is() {
    let work = tempfile::tempdir().unwrap();
    write_bar(work.path());
    write_bend(work.path());
    for (scan, option, what, code, words) in [
        ("bar.obj", "--rigid", "group:midle part", 2, ["no such group", "try: group:middle part"]),
        ("bar.obj", "--rigid", "group:legs*", 2, ["left, middle", "right"]),
        ("bar.obj", "--rigid", "color:#ff0000", 2, ["no vertex colours", "bar.obj"]),
        ("bar.ply", "--rigid", "group:left", 2, ["no such group", "bar.ply"]),
        ("bar.ply", "--rigid", "color:#00ff00", 3, ["selects nothing", "tolerance"]),
        ("bar.obj", "--rigid", "sphere:6,0,40,2", 3, ["selects nothing", "(12.000 1.000 1.000)"]),
        ("bar.obj", "--rigid", "near:l1,r7", 2, ["no handle r7", "try: near:r0"]),
        ("bar.obj", "--rigid", "hands", 2, ["parts of this body are not known", "sphere:"]),
        ("bar.obj", "--rigid", "hnads", 2, ["did you mean 'hands'", "--rigid"]),
        ("bar.obj", "--stiffness", "group:left", 2, ["WHAT=X", "--stiffness"]),
        ("bar.obj", "--stiffness", "group:left=-3", 2, ["0.001", "--stiffness"]),
    ] {
        let output = retarget(work.path(), [scan, "bend.csv", "-o", "out.pc2", option, what]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{what}: {said}");
        assert!(words.iter().all(|w| said.contains(w)), "{what}: {said}");
    }
    assert!(!work.path().join("out.pc2").exists());
}

/// Vertices far from each other.
fn spread(points: &[Point], count: usize) -> Vec<usize> {
    let mut chosen = vec![0];
    let mut away: Vec<f64> = points.iter().map(|p| distance(*p, points[0])).collect();
    while chosen.len() < count {
        let next = (0..points.len()).max_by(|&a, &b| away[a].total_cmp(&away[b])).unwrap();
        chosen.push(next);
        away.iter_mut().zip(points).for_each(|(d, p)| *d = d.min(distance(*p, points[next])));
    }
    chosen
}

#[test]
fn a_pose_comes_back_through_a_table_of_its_own_points() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = [fixture("scan.obj"), fixture("walk.c3d")].map(|p| p.to_string_lossy().into_owned());
    retarget_ok(work.path(), [scan.as_str(), &take, "-o", "walk.pc2", "--frames", "101..110"]);
    let walk = read_pc2(&work.path().join("walk.pc2"));
    let rest: Vec<Point> = retarget::scan::read(Path::new(&scan)).unwrap().mesh.positions.iter().map(|p| p.to_array()).collect();
    let chosen = spread(&rest, 90);
    let mut csv = "frame,name,x,y,z\n".to_owned();
    for (n, &v) in chosen.iter().enumerate() {
        let [x, y, z] = rest[v];
        writeln!(csv, "100,\"v,{n}\",{x},{y},{z}").unwrap();
        for (frame, points) in walk.iter().enumerate() {
            // Every tenth handle is missing in a frame of its own.
            if n % 10 != 3 || frame != n / 10 {
                let [x, y, z] = points[v];
                writeln!(csv, "{},\"v,{n}\",{x},{y},{z}", 101 + frame).unwrap();
            }
        }
    }
    std::fs::write(work.path().join("points.csv"), csv).unwrap();
    let said = retarget_ok(work.path(), [scan.as_str(), "points.csv", "-o", "again.pc2", "--rate", "120"]);
    assert!(said.contains("90 handles, 11 frames at 120 Hz"), "{said}");
    let again = read_pc2(&work.path().join("again.pc2"));
    assert_eq!(again.len(), 11);
    let height = 1.75;
    let still = rest.iter().zip(&again[0]).map(|(a, b)| distance(*a, wide(*b))).fold(0.0, f64::max);
    assert!(still < 1e-5 * height, "the first frame is the rest pose, {still} off");
    for (frame, (a, b)) in walk.iter().zip(&again[1..]).enumerate() {
        let mean = a.iter().zip(b).map(|(p, q)| distance(wide(*p), wide(*q))).sum::<f64>() / a.len() as f64;
        assert!(mean < 0.01 * height, "frame {frame}: {mean} off on average");
        let held = chosen.iter().enumerate().filter(|(n, _)| n % 10 != 3).map(|(_, &v)| distance(wide(a[v]), wide(b[v])));
        let (sum, worst) = held.fold((0.0, 0.0), |(s, w): (f64, f64), d| (s + d, w.max(d)));
        assert!(sum / 81.0 < 0.002 * height && worst < 0.02 * height, "frame {frame}: handles {} and {worst} off", sum / 81.0);
    }
    let moved = rest.iter().zip(&again[5]).map(|(a, b)| distance(*a, wide(*b))).sum::<f64>() / rest.len() as f64;
    assert!(moved > 0.05 * height, "the take hardly moves the scan: {moved}");
}

#[test]
fn a_handle_pulls_beside_the_markers() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = [fixture("scan.obj"), fixture("walk.c3d")].map(|p| p.to_string_lossy().into_owned());
    let rest: Vec<Point> = retarget::scan::read(Path::new(&scan)).unwrap().mesh.positions.iter().map(|p| p.to_array()).collect();
    let run = |out: &str, more: &[&str]| {
        let all = [scan.as_str(), &take, "-o", out, "--frames", "1..12"];
        let said = retarget_ok(work.path(), all.into_iter().chain(more.iter().copied()));
        (said, read_pc2(&work.path().join(out)).pop().unwrap())
    };
    let (_, without) = run("without.pc2", &[]);
    // The belly at the front, pulled forward by 0.1 m from where it would be.
    let belly = (0..rest.len())
        .max_by(|&a, &b| (rest[a][2] - (rest[a][1] - 1.0).abs()).total_cmp(&(rest[b][2] - (rest[b][1] - 1.0).abs())))
        .unwrap();
    let target = wide(without[belly]).map(|x| x + 0.06);
    let [[x, y, z], [u, v, w]] = [rest[belly], target];
    std::fs::write(
        work.path().join("belly.csv"),
        format!("frame,name,x,y,z\n-5,belly,{x},{y},{z}\n12,belly,{u},{v},{w}\n11,belly,{u},{v},{w}\n"),
    )
    .unwrap();
    let (said, with) = run("with.pc2", &["--handles", "belly.csv"]);
    assert!(said.contains("41 of 41 markers bound") && said.contains("1 handle of a table"), "{said}");
    assert!(said.contains("frames outside of the capture's 1..372"), "{said}");
    let [before, after] = [distance(wide(without[belly]), target), distance(wide(with[belly]), target)];
    assert!(before > 0.1 && after < 0.7 * before, "the handle is {before} away without a pull, {after} with it");
    let foot = (0..rest.len()).min_by(|&a, &b| rest[a][1].total_cmp(&rest[b][1])).unwrap();
    assert!(distance(wide(without[foot]), wide(with[foot])) < 0.01, "the foot goes with the belly");
}

#[test]
fn tables_that_do_not_belong_to_the_scan_are_refused() {
    let work = tempfile::tempdir().unwrap();
    write_bar(work.path());
    let take = fixture("walk.c3d").to_string_lossy().into_owned();
    let scan = fixture("scan.obj").to_string_lossy().into_owned();
    let h = "frame,name,x,y,z";
    let cases: [(&[&str], String, i32, [&str; 2]); 7] = [
        (&["bar.obj", "t.csv"], "frame,name,x,y\n".to_owned(), 1, ["line 1", "column z is missing"]),
        (&["bar.obj", "t.csv"], format!("{h}\n0,a,0,0,0\n0,b,1,2\n"), 1, ["t.csv", "line 3"]),
        (&["bar.obj", "t.csv"], format!("{h},qx,qy,qz,qw\n0,a,0,0,0,0,0,0,9\n"), 1, ["length 9", "line 2"]),
        (&["bar.obj", "t.csv"], format!("{h}\n0,a,0,9000,0\n"), 3, ["handle a rests", "coordinates and unit"]),
        (&["bar.obj", "gone.csv"], String::new(), 1, ["gone.csv", "cannot read"]),
        (&[&scan, &take, "--handles", "t.csv"], format!("{h}\n1,LFHD,0,1,0\n"), 2, ["LFHD", "name of a marker"]),
        (&[&scan, &take, "--handles", "t.csv"], format!("{h}\n900,a,0,1,0\n"), 3, ["frames 900 to 900", "1..372"]),
    ];
    for (arguments, csv, code, words) in cases {
        std::fs::write(work.path().join("t.csv"), csv).unwrap();
        let output = retarget(work.path(), arguments.iter().chain(&["-o", "out.pc2"]));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(words.iter().all(|w| said.contains(w)), "{arguments:?} lacks {words:?}: {said}");
    }
    assert!(!work.path().join("out.pc2").exists());
}
