//! The program from outside: what it says, what it writes, how it fails.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, read_pc2, retarget, retarget_ok};
use std::path::Path;

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The fixture scan and take.
fn pair() -> [String; 2] {
    [fixture("scan.obj"), fixture("walk.c3d")].map(|p| p.to_string_lossy().into_owned())
}

/// Arguments of a short run on the fixture.
fn short(more: &[&str]) -> Vec<String> {
    let mut out = pair().to_vec();
    out.extend(["--frames", "1..12"].map(String::from));
    out.extend(more.iter().map(|s| (*s).to_owned()));
    out
}

#[test]
fn every_station_says_what_it_decided() {
    let work = tempfile::tempdir().unwrap();
    let text = retarget_ok(work.path(), short(&["-o", "a.pc2"]));
    for station in ["scan", "capture", "bind", "proxy", "solve", "write", "done"] {
        assert!(text.lines().any(|l| l.starts_with(station)), "no line for {station}:\n{text}");
    }
    assert!(text.contains("41 of 41 markers bound"), "{text}");
    // The scan is the actor's own, so the skin gives the placement to a fraction of a per cent.
    assert!(text.contains("similarity by the skin") && text.contains("scale 1.000"), "{text}");
    assert!(!text.contains('\u{1b}'), "escape codes in a pipe:\n{text}");
    let quiet = retarget_ok(work.path(), short(&["-o", "b.pc2", "--quiet"]));
    assert_eq!(quiet, "");
}

#[test]
fn all_formats_come_from_one_solve_and_agree() {
    let work = tempfile::tempdir().unwrap();
    let outputs = ["-o", "a.pc2", "-o", "ply/f_####.ply", "-o", "obj/f_##.obj", "-o", "a.glb", "--report", "r.json"];
    retarget_ok(work.path(), short(&outputs));
    let cache = read_pc2(&work.path().join("a.pc2"));
    assert_eq!(cache.len(), 12);
    let source = retarget::scan::read(&fixture("scan.obj")).unwrap();
    for (frame, points) in cache.iter().enumerate() {
        let ply = retarget::scan::read(&work.path().join(format!("ply/f_{:04}.ply", frame + 1))).unwrap();
        let obj = retarget::scan::read(&work.path().join(format!("obj/f_{:02}.obj", frame + 1))).unwrap();
        assert_eq!(ply.mesh.faces, source.mesh.faces);
        assert_eq!(obj.mesh.faces, source.mesh.faces);
        assert_eq!(obj.look.uvs.len(), source.look.uvs.len());
        for ((c, p), o) in points.iter().zip(&ply.mesh.positions).zip(&obj.mesh.positions) {
            assert_eq!(*c, p.to_array().map(|x| x as f32), "PC2 and PLY differ in frame {frame}");
            assert!(p.distance(*o) < 1e-6, "PLY and OBJ differ in frame {frame}: {p} {o}");
        }
    }
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(work.path().join("r.json")).unwrap()).unwrap();
    assert_eq!(report["frames"].as_array().unwrap().len(), 12);
    assert_eq!(report["outputs"].as_array().unwrap().len(), 4);
    assert!(report["decisions"].is_object() && report["setup_ms"].is_object());
}

#[test]
fn one_and_two_threads_write_the_same_bytes() {
    let work = tempfile::tempdir().unwrap();
    // The same names, in a folder for each: a GLB carries its own.
    let outputs = |n: &str| {
        let folder = work.path().join(n);
        std::fs::create_dir(&folder).unwrap();
        let outputs = ["-o", "a.glb", "-o", "a.pc2", "-o", "f_####.ply", "-o", "g_####.obj"];
        retarget_ok(&folder, short(&[&["--threads", n, "--report", "r.json"][..], &outputs].concat()));
    };
    outputs("1");
    outputs("2");
    let bytes = |name: String| std::fs::read(work.path().join(name)).unwrap();
    for name in ["a.glb", "a.pc2", "f_0007.ply", "g_0012.obj"] {
        assert!(bytes(format!("1/{name}")) == bytes(format!("2/{name}")), "{name} depends on the number of threads");
    }
    let report = |name: &str| {
        let mut value: serde_json::Value = serde_json::from_slice(&bytes(name.to_owned())).unwrap();
        let top = value.as_object_mut().unwrap();
        for key in ["setup_ms", "peak_mb"] {
            top.remove(key);
        }
        for frame in top["frames"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("ms");
        }
        value
    };
    assert_eq!(report("1/r.json"), report("2/r.json"));
}

#[test]
fn wrong_arguments_exit_with_2_and_say_what_was_expected() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = pair();
    let cases: [(&[&str], &str); 8] = [
        (&[&scan, &take], "--out"),
        (&[&scan, &take, "-o", "a.fbx"], ".glb"),
        (&[&scan, &take, "-o", "a.ply"], "a_####.ply"),
        (&[&scan, &take, "-o", "a_###.glb"], "without #"),
        (&[&scan, &take, "-o", "a.glb", "-o", "./a.glb"], "twice"),
        (&[&scan, &take, "-o", "a.glb", "--frames", "9..2"], "ends (2)"),
        (&[&scan, &take, "-o", "a.glb", "--frames", "9000..9001"], "1..372"),
        (&[&scan, &take, "-o", "a.glb", "--quallity", "draft"], "--quality"),
    ];
    for (arguments, word) in cases {
        let output = retarget(work.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", said(&output));
        assert!(said(&output).contains(word), "{arguments:?}: {}", said(&output));
    }
    assert_eq!(std::fs::read_dir(work.path()).unwrap().count(), 0, "nothing may be written");
}

#[test]
fn files_that_cannot_be_read_are_named_with_what_was_expected() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = pair();
    std::fs::write(work.path().join("empty.obj"), "").unwrap();
    std::fs::write(work.path().join("points.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\n").unwrap();
    std::fs::write(work.path().join("text.c3d"), "this is not a capture").unwrap();
    std::fs::write(work.path().join("take.bvh"), "HIERARCHY\nROOT Hips\n").unwrap();
    let whole = std::fs::read(&take).unwrap();
    std::fs::write(work.path().join("head.c3d"), &whole[..700]).unwrap();
    for (scan, take, word) in [
        ("missing.obj", take.as_str(), "missing.obj"),
        ("empty.obj", &take, "empty.obj"),
        ("points.obj", &take, "points.obj"),
        (scan.as_str(), "missing.c3d", "missing.c3d"),
        (&scan, "text.c3d", "text.c3d"),
        (&scan, "head.c3d", "head.c3d"),
        (&scan, "take.bvh", "MOTION"),
    ] {
        let output = retarget(work.path(), [scan, take, "-o", "out.glb"]);
        assert_eq!(output.status.code(), Some(1), "{scan} {take}: {}", said(&output));
        assert!(said(&output).starts_with("error"), "{}", said(&output));
        assert!(said(&output).contains(word), "{scan} {take}: {}", said(&output));
    }
    assert!(!work.path().join("out.glb").exists());
}

#[test]
fn an_output_is_replaced_only_when_told_to() {
    let work = tempfile::tempdir().unwrap();
    std::fs::write(work.path().join("a.pc2"), "precious").unwrap();
    let output = retarget(work.path(), short(&["-o", "a.pc2"]));
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("--force"), "{}", said(&output));
    assert_eq!(std::fs::read(work.path().join("a.pc2")).unwrap(), b"precious");
    retarget_ok(work.path(), short(&["-o", "a.pc2", "--force"]));
    assert_eq!(read_pc2(&work.path().join("a.pc2")).len(), 12);
    let output = retarget(work.path(), short(&["-o", "nowhere/a.pc2"]));
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("nowhere"), "{}", said(&output));
}

#[test]
fn a_result_above_the_limit_is_written_and_exits_with_4() {
    let work = tempfile::tempdir().unwrap();
    let text = retarget_ok(work.path(), short(&["-o", "a.pc2", "--fail-above", "500"]));
    // "done … worst 1.35 mm (LSHO, frame 12) …"
    let (_, worst) = text.lines().last().and_then(|done| done.split_once(", worst ")).unwrap();
    let (worst, rest) = worst.split_once(" mm (").unwrap();
    let (marker, rest) = rest.split_once(", frame ").unwrap();
    let frame = rest.split(')').next().unwrap();
    let limit = (worst.parse::<f64>().unwrap() * 0.9).to_string();
    let output = retarget(work.path(), short(&["-o", "b.pc2", "--report", "b.json", "--fail-above", &limit]));
    let said = said(&output);
    assert_eq!(output.status.code(), Some(4), "{said}");
    assert!(said.contains(&format!("error: {marker} stays {worst} mm from its target (frame {frame})")), "{said}");
    assert!(said.contains(&format!("(--fail-above {limit})")), "{said}");
    let bytes = |name: &str| std::fs::read(work.path().join(name)).unwrap();
    assert!(bytes("a.pc2") == bytes("b.pc2") && work.path().join("b.json").exists());
    assert_eq!(retarget(work.path(), short(&["-o", "c.pc2", "--fail-above", "0"])).status.code(), Some(2));
}

#[test]
fn a_scan_that_is_no_person_is_refused_with_the_option_that_decides() {
    let work = tempfile::tempdir().unwrap();
    let mut cube = String::new();
    for i in 0..8 {
        cube += &format!("v {} {} {}\n", i & 1, i >> 1 & 1, i >> 2);
    }
    cube += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    std::fs::write(work.path().join("cube.obj"), cube).unwrap();
    let output = retarget(work.path(), ["cube.obj", &pair()[1], "-o", "out.glb"]);
    assert_eq!(output.status.code(), Some(3), "{}", said(&output));
    assert!(said(&output).contains("--align"), "{}", said(&output));
    assert!(!work.path().join("out.glb").exists());
}

#[test]
fn frames_keep_the_numbers_of_the_capture_and_hardly_depend_on_where_the_range_begins() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = pair();
    retarget_ok(work.path(), [&scan, &take, "--frames", "1..60", "-o", "all.pc2"]);
    retarget_ok(work.path(), [&scan, &take, "--frames", "41..44", "-o", "some.pc2", "-o", "f_####.ply"]);
    assert!(work.path().join("f_0041.ply").exists() && !work.path().join("f_0045.ply").exists());
    let (all, some) = (read_pc2(&work.path().join("all.pc2")), read_pc2(&work.path().join("some.pc2")));
    let mut worst = 0.0f32;
    for (a, b) in all[40..44].iter().zip(&some) {
        for (p, q) in a.iter().zip(b) {
            worst = worst.max((0..3).map(|c| (p[c] - q[c]).abs()).fold(0.0, f32::max));
        }
    }
    assert!(worst < 0.001, "{worst} m apart");
}

#[test]
fn inspect_tells_what_is_in_files() {
    let work = tempfile::tempdir().unwrap();
    let output =
        retarget(work.path(), [Path::new("inspect"), &fixture("scan.obj"), &fixture("walk.c3d"), &fixture("scan_dirty.ply")]);
    assert!(output.status.success(), "{}", said(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("41 markers") && text.contains("372 frames") && text.contains("4 materials"), "{text}");
    let output = retarget(work.path(), [Path::new("inspect"), Path::new("--json"), &fixture("scan.obj"), &fixture("walk.c3d")]);
    let lines: Vec<serde_json::Value> =
        String::from_utf8(output.stdout).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), 2);
    assert_eq!(lines[1]["markers"].as_array().unwrap().len(), 41);
}

#[test]
fn the_picture_shows_body_and_markers_and_is_the_same_for_any_number_of_threads() {
    let work = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let mut arguments = pair().to_vec();
        arguments.extend(["--frames", "1..1"].iter().chain(more).map(|s| (*s).to_owned()));
        retarget(work.path(), arguments)
    };
    let text = said(&run(&["-o", "a.pc2", "--picture", "a.png", "--threads", "1"]));
    assert!(text.lines().any(|l| l.starts_with("picture") && l.ends_with("a.png")), "{text}");
    let bytes = std::fs::read(work.path().join("a.png")).unwrap();
    assert!(run(&["-o", "b.pc2", "--picture", "b.png", "--threads", "3"]).status.success());
    assert!(bytes == std::fs::read(work.path().join("b.png")).unwrap());

    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert!(info.width > 1200 && info.height > 1000);
    // Attachments are blue on the left and red on the right, in all four views; each is some fifty pixels.
    let count = |is: fn(&[u8]) -> bool| pixels.chunks_exact(3).filter(|p| is(p)).count();
    let (blue, red) = (count(|p| p[2] > 170 && p[0] < 60), count(|p| p[0] > 180 && p[2] < 60));
    assert!(blue > 1000 && red > 1000 && blue < 20_000 && red < 20_000, "{blue} {red}");
    let skin = count(|p| p[0] < 225 && p[0].abs_diff(p[2]) < 30);
    assert!(skin > 300_000, "{skin}");

    let again = run(&["-o", "c.pc2", "--picture", "a.png"]);
    assert_eq!(again.status.code(), Some(1), "it exists already");
    assert!(said(&again).contains("--force") && !work.path().join("c.pc2").exists());
    let twice = run(&["-o", "d.pc2", "--picture", "d.pc2"]);
    assert_eq!(twice.status.code(), Some(2), "{}", said(&twice));
}

/// The fixture's markers as a TRC file, changed.
fn changed_markers(path: &Path, change: impl Fn(&mut retarget::capture::MarkerTake)) {
    let capture = retarget::capture::read(&fixture("walk.c3d"), &retarget::capture::ReadOptions::default()).unwrap();
    let mut take = capture.motion.points().clone();
    change(&mut take);
    let (frames, markers, labels) = (take.frames(), take.markers(), take.labels.join("\t\t\t"));
    let mut text = format!(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n{0}\t{0}\t{frames}\t{markers}\tmm\nFrame#\tTime\t{labels}\n\t\n\n",
        capture.rate
    );
    for f in 0..frames {
        text += &format!("{}\t{:.4}", f + 1, f as f64 / capture.rate);
        for m in 0..markers {
            text += &take.point(f, m).map_or("\t\t\t".to_owned(), |p| format!("\t{:.3}\t{:.3}\t{:.3}", p.x, p.y, p.z));
        }
        text.push('\n');
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn repairs_of_the_capture_are_counted_named_and_reported() {
    let work = tempfile::tempdir().unwrap();
    let take = work.path().join("faulty.trc");
    changed_markers(&take, |take| {
        let column = take.labels.iter().position(|l| l.ends_with("LKNE")).unwrap();
        for f in 40..90 {
            take.points[f * take.labels.len() + column][2] += 150.0;
        }
    });
    let scan = fixture("scan.obj");
    let run = |more: &[&str]| {
        let mut arguments: Vec<String> = [&scan, &take].map(|p| p.to_string_lossy().into_owned()).to_vec();
        arguments.extend(["--frames", "1..2"].iter().chain(more).map(|s| (*s).to_owned()));
        retarget_ok(work.path(), arguments)
    };
    let text = run(&["-o", "a.pc2", "--report", "r.json", "--verbose"]);
    assert!(text.contains("gap filled") && text.contains("LKNE filled "), "{text}");
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(work.path().join("r.json")).unwrap()).unwrap();
    let repairs = report["decisions"]["capture"]["repairs"].as_array().unwrap();
    let how: Vec<&str> = repairs.iter().map(|r| r["how"].as_str().unwrap()).collect();
    assert_eq!(how.last(), Some(&"filled"), "{repairs:?}");
    let covers = |r: &serde_json::Value| r["first_frame"].as_i64() <= Some(41) && r["last_frame"].as_i64() >= Some(90);
    let filled = repairs.iter().find(|r| r["how"] == "filled" && covers(r)).expect("the whole stretch is filled");
    assert!(filled["marker"].as_str().unwrap().ends_with("LKNE") && filled["neighbours"].as_u64() >= Some(3), "{filled}");
    assert!(how.iter().any(|h| ["stray", "jump"].contains(h)), "{repairs:?}");
    let quiet = run(&["-o", "b.pc2"]);
    assert!(!quiet.contains("LKNE filled "), "names are for --verbose: {quiet}");
}

#[test]
fn inspect_draws_what_is_bound_and_what_cannot_be() {
    let work = tempfile::tempdir().unwrap();
    let nameless = work.path().join("nameless.trc");
    changed_markers(&nameless, |take| {
        // Too few to be told by their places.
        let markers = take.labels.len();
        take.points = take.points.chunks_exact(markers).flat_map(|frame| frame[..12].to_vec()).collect();
        take.labels = (0..12).map(|m| format!("M{m:03}x")).collect();
    });
    let [scan, walk] = pair();
    let nameless = nameless.to_string_lossy().into_owned();
    let draw = |name: &str, files: &[&str]| {
        let output = retarget(work.path(), [&["inspect", "--picture", name], files].concat());
        (output.status.code(), said(&output), std::fs::read(work.path().join(name)).ok())
    };
    let size = |bytes: &[u8]| {
        let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        (reader.info().width, reader.info().height)
    };
    let (code, _, alone) = draw("alone.png", &[&scan]);
    assert_eq!(code, Some(0));
    let (code, _, bound) = draw("bound.png", &[&scan, &walk]);
    assert_eq!(code, Some(0));
    let (code, text, refused) = draw("refused.png", &[&scan, &nameless]);
    assert_eq!(code, Some(3), "{text}");
    let [alone, bound, refused] = [alone, bound, refused].map(Option::unwrap);
    assert!(alone != bound && size(&bound).0 > 1200);
    // Scan and markers from two sides each in place of the scan from four.
    assert!(refused != alone && refused != bound && size(&refused).0 > 1200);
    assert!(draw("alone.png", &[&scan]).1.contains("--force"));
    assert_eq!(draw("none.png", &[&walk]).0, Some(2));

    // The main job refuses the same, and draws the same.
    let output = retarget(work.path(), [&*scan, &nameless, "-o", "a.pc2", "--picture", "b.png"]);
    assert_eq!(output.status.code(), Some(3), "{}", said(&output));
    assert!(refused == std::fs::read(work.path().join("b.png")).unwrap() && !work.path().join("a.pc2").exists());
}

const ASF: &str = ":version 1.10\n:name LEG\n:units\n length 0.45\n angle deg\n:root\n order TX TY TZ RX RY RZ\n axis XYZ\n position 0 0 0\n orientation 0 0 0\n\
    :bonedata\nbegin\n name femur\n direction 0 -2 0\n length 4\n axis 0 0 30 XYZ\n dof rx ry rz\nend\n:hierarchy\nbegin\nroot femur\nend\n";

const AMC: &str = ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 2 3 0 90 0\nfemur 0 0 0\n2\nroot 1 2 4 10 20 30\nfemur 5 -6 7\n";

#[test]
fn inspect_takes_the_options_that_it_advises() {
    let work = tempfile::tempdir().unwrap();
    std::fs::create_dir(work.path().join("elsewhere")).unwrap();
    std::fs::write(work.path().join("elsewhere/leg.asf"), ASF).unwrap();
    std::fs::write(work.path().join("kick.amc"), AMC).unwrap();
    let alone = retarget(work.path(), ["inspect", "kick.amc"]);
    assert!(!alone.status.success() && said(&alone).contains("--skeleton"), "{}", said(&alone));
    let shown = |more: &[&str]| {
        let output = retarget(work.path(), [&["inspect", "kick.amc", "--skeleton", "elsewhere/leg.asf"], more].concat());
        assert!(output.status.success(), "{}", said(&output));
        (String::from_utf8_lossy(&output.stdout).into_owned(), said(&output))
    };
    let (found, warned) = shown(&[]);
    assert!(found.contains("2 frames at 120 Hz") && warned.contains("120 frames per second are assumed"), "{found}{warned}");
    let (found, warned) = shown(&["--rate", "60"]);
    assert!(found.contains("2 frames at 60 Hz") && !warned.contains("assumed"), "{found}{warned}");
    let (_, warned) = shown(&["--clip", "Walk"]);
    assert!(warned.contains("--clip is given but not used: it says nothing of an AMC motion"), "{warned}");
}

#[test]
fn a_table_of_handles_is_no_static_trial() {
    let work = tempfile::tempdir().unwrap();
    std::fs::write(work.path().join("reach.csv"), "frame,name,x,y,z\n1,hand,0,1,2\n").unwrap();
    let output = retarget(work.path(), short(&["-o", "a.pc2", "--ref-file", "reach.csv"]));
    assert!(!output.status.success() && said(&output).contains("reach.csv: is a table of handles"), "{}", said(&output));
}

fn report(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn faces_are_counted_as_they_are_in_the_file() {
    // A slab of quads under the feet, which are not written: the scan of the fixture has quads as well.
    let text = std::fs::read_to_string(fixture("scan.obj")).unwrap();
    let of = |kind: &str| text.lines().filter(|l| l.starts_with(kind)).count();
    let (vertices, faces) = (of("v "), of("f "));
    const CELLS: usize = 8;
    let mut slab = String::new();
    for height in [-0.055, 0.005] {
        for k in 0..=CELLS * (CELLS + 2) + CELLS {
            let along = |i: usize| 1.4 * i as f64 / CELLS as f64 - 0.7;
            slab += &format!("v {} {height} {}\n", along(k % (CELLS + 1)), along(k / (CELLS + 1)));
        }
    }
    let layer = (CELLS + 1) * (CELLS + 1);
    let mut quad = |corners: [usize; 4]| {
        let [a, b, c, d] = corners.map(|v| vertices + 1 + v);
        slab += &format!("f {a} {b} {c} {d}\n");
    };
    for i in 0..CELLS {
        let (near, far) = (i, i + CELLS * (CELLS + 1));
        quad([near, near + layer, near + layer + 1, near + 1]);
        quad([far, far + 1, far + layer + 1, far + layer]);
        let (left, right) = (i * (CELLS + 1), i * (CELLS + 1) + CELLS);
        quad([left, left + CELLS + 1, left + CELLS + 1 + layer, left + layer]);
        quad([right, right + layer, right + CELLS + 1 + layer, right + CELLS + 1]);
        for j in 0..CELLS {
            let low = i * (CELLS + 1) + j;
            quad([low, low + 1, low + CELLS + 2, low + CELLS + 1]);
            quad([low + layer, low + CELLS + 1 + layer, low + CELLS + 2 + layer, low + 1 + layer]);
        }
    }
    let all = faces + 4 * CELLS + 2 * CELLS * CELLS;
    let work = tempfile::tempdir().unwrap();
    std::fs::write(work.path().join("floor.obj"), text + &slab).unwrap();
    let take = fixture("walk.c3d");
    let outputs = ["--frames", "1..2", "-o", "f_#.ply", "--report", "r.json"];
    let said = retarget_ok(work.path(), ["floor.obj", take.to_str().unwrap()].into_iter().chain(outputs));
    assert!(said.contains("grown together with a flat floor"), "{said}");
    let line = said.lines().find(|l| l.starts_with("scan")).unwrap().replace(',', "");
    assert!(line.contains(&format!(" {all} polygons")), "{all}: {line}");
    assert_eq!(report(&work.path().join("r.json"))["decisions"]["scan"]["faces"], all);
    assert!(retarget::scan::read(&work.path().join("f_1.ply")).unwrap().mesh.faces.len() < all);
}

#[test]
fn the_report_names_the_static_trial_of_a_rig_file() {
    let work = tempfile::tempdir().unwrap();
    std::fs::create_dir(work.path().join("rigs")).unwrap();
    std::fs::copy(fixture("walk.c3d"), work.path().join("rigs/trial.c3d")).unwrap();
    std::fs::write(work.path().join("rigs/rig.toml"), "[reference]\nfile = \"trial.c3d\"\n").unwrap();
    let named = |more: &[&str]| {
        retarget_ok(work.path(), short(&[more, &["-o", "a.pc2", "--force", "--report", "r.json"]].concat()));
        report(&work.path().join("r.json"))["inputs"]["reference"].clone()
    };
    assert!(named(&[]).is_null());
    let trial = named(&["--rig", "rigs/rig.toml"]);
    assert_eq!(trial.as_str().map(Path::new), Some(Path::new("rigs/trial.c3d")));
}

#[test]
fn a_saved_rig_file_fed_back_gives_the_same_bytes() {
    let work = tempfile::tempdir().unwrap();
    let bytes = |name: &str| std::fs::read(work.path().join(name)).unwrap();
    retarget_ok(work.path(), short(&["-o", "a.pc2", "--align", "retarget", "--save-rig", "rig.toml"]));
    let text = retarget_ok(work.path(), short(&["-o", "b.pc2", "--rig", "rig.toml", "--save-rig", "again.toml"]));
    assert!(text.contains("(rig file)"), "what came from the rig file says so:\n{text}");
    assert_eq!(bytes("a.pc2"), bytes("b.pc2"));
    assert_eq!(bytes("rig.toml"), bytes("again.toml"));

    let saved = String::from_utf8(bytes("rig.toml")).unwrap();
    std::fs::write(work.path().join("edited.toml"), format!("[markers]\nC7 = \"ignore\"\n{saved}")).unwrap();
    let text = retarget_ok(work.path(), short(&["-o", "c.pc2", "--rig", "edited.toml"]));
    assert!(text.contains("C7") && text.contains("left out by the rig file"), "{text}");
    std::fs::write(work.path().join("wrong.toml"), saved.replace("[frozen]", "[space]\nyav = 3.0\n\n[frozen]")).unwrap();
    let output = retarget(work.path(), short(&["-o", "d.pc2", "--rig", "wrong.toml"]));
    assert_eq!(output.status.code(), Some(1));
    let text = said(&output);
    assert!(text.contains("wrong.toml") && text.contains("line 3") && text.contains("yaw?"), "{text}");
    assert!(!work.path().join("d.pc2").exists());
}

/// What `inspect` says of a cache, and of outputs that are not read.
#[test]
fn inspect_knows_caches_and_says_what_it_does_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let words = [[0u8, 0, 0, 2], [0, 0, 0, 3]].concat();
    std::fs::write(path("a.mdd"), [&words[..], &[0; 2 * 4 + 2 * 3 * 12]].concat()).unwrap();
    let output = retarget(folder.path(), ["inspect", "--json", "a.mdd"]);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&found["kind"], &found["points"], &found["samples"]), (&"cache".into(), &3.into(), &2.into()));
    std::fs::write(path("a.mdd"), &words).unwrap();
    let output = retarget(folder.path(), ["inspect", "a.mdd"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("expected 88 bytes"));
    for name in ["a.usdc", "a.usda", "a.usdz", "a.abc", "a.html", "a.png", "a.apng"] {
        std::fs::write(path(name), "something").unwrap();
        let output = retarget(folder.path(), ["inspect", name]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("writes, but does not read"), "{name}");
    }
}

#[test]
fn the_options_of_a_glb_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let (scan, take) = (fixture("scan.obj"), fixture("walk.c3d"));
    let run = |options: &[&str]| {
        let inputs = [scan.to_str().unwrap(), take.to_str().unwrap(), "--frames", "20..23", "--force", "-o", "a.glb"];
        let output = retarget(folder.path(), inputs.iter().chain(options));
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    for wrong in ["0", "-1", "nan", "inf", "101", "much"] {
        let (code, said) = run(&[&format!("--tolerance={wrong}")]);
        assert_eq!(code, Some(2), "{wrong}");
        assert!(said.contains("expected a percentage above 0, at most 100"), "{said}");
    }
    let (code, said) = run(&["--encode", "bones"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("auto") && said.contains("skin") && said.contains("morph"), "{said}");
    let (code, said) = run(&["--tolerance", "1e-12", "--encode", "morph", "-o", "a.pc2"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("a.glb: morph targets come within") && said.contains("worst in frame 2"), "{said}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
    let (code, said) = run(&["--encode", "morph", "--source-index", "--tolerance", "1", "-o", "a.html"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains(" morphs, rms"), "{said}");
}
