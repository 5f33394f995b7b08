//! The program on things made of parts: joints found, the rig file fed back, parts driven.

use crate::shapes::{Piece, Place, pieces};
use glam::{DQuat, DVec3};
use retarget::binding::rig::RigFile;
use retarget::glam;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn retarget(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_retarget")).args(args).current_dir(folder).output().expect("the program runs")
}

fn words(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The piece as an OBJ file with two objects.
fn write_obj(path: &Path, piece: &Piece, place: &Place) {
    let mut text = String::new();
    let mut first = 1;
    for (name, mesh) in [("base", &piece.base), ("moving", &piece.moving)] {
        let _ = writeln!(text, "o {name}");
        for p in &mesh.0 {
            let p = place.apply(*p);
            let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
        }
        for t in &mesh.1 {
            let _ = writeln!(text, "f {} {} {}", t[0] + first, t[1] + first, t[2] + first);
        }
        first += mesh.0.len() as u32;
    }
    std::fs::write(path, text).expect("a file");
}

fn vertices(path: &Path) -> Vec<DVec3> {
    let text = std::fs::read_to_string(path).expect("an OBJ file");
    let number = |x: &str| x.parse::<f64>().expect("a number");
    let vertex = |line: &str| {
        let x: Vec<f64> = line.split_whitespace().skip(1).map(number).collect();
        DVec3::new(x[0], x[1], x[2])
    };
    text.lines().filter(|l| l.starts_with("v ")).map(vertex).collect()
}

/// Four places on each part, the moving one turned about the axis by an angle per frame.
fn handles(piece: &Piece, place: &Place, angles: &[f64]) -> String {
    let mut text = "frame,name,x,y,z\n".to_owned();
    let corners = |mesh: &crate::shapes::Mesh| [0, mesh.0.len() / 3, mesh.0.len() / 2, mesh.0.len() - 1].map(|k| mesh.0[k]);
    for (frame, angle) in angles.iter().enumerate() {
        let q = DQuat::from_rotation_z(*angle);
        for (k, p) in corners(&piece.base).into_iter().enumerate() {
            let p = place.apply(p);
            let _ = writeln!(text, "{frame},base{k},{},{},{}", p.x, p.y, p.z);
        }
        for (k, p) in corners(&piece.moving).into_iter().enumerate() {
            let p = place.apply(q * p);
            let _ = writeln!(text, "{frame},moving{k},{},{},{}", p.x, p.y, p.z);
        }
    }
    text
}

#[test]
fn a_hinge_is_found_written_fed_back_and_driven() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let piece = &pieces()[1];
    let place = Place::odd(1.0);
    write_obj(&at.join("hinge.obj"), piece, &place);
    let found = retarget(at, &["joints", "hinge.obj", "-o", "rig.toml", "--picture", "joints.png"]);
    assert!(found.status.success(), "{}", words(&found));
    assert!(words(&found).contains("revolute") && words(&found).contains("1 sure"), "{}", words(&found));
    assert!(std::fs::read(at.join("joints.png")).expect("a picture").starts_with(b"\x89PNG"));

    let rig = RigFile::read(&at.join("rig.toml")).expect("a rig file");
    let text = std::fs::read_to_string(at.join("rig.toml")).expect("text");
    assert_eq!(rig.to_text().expect("text"), text, "an unedited file comes back to the byte");
    assert_eq!((rig.components.len(), rig.joints.len()), (2, 1));
    let axis = DVec3::from(rig.joints[0].x.expect("an axis"));
    assert!(axis.dot(place.turn * DVec3::Z).abs() > 0.999_99);

    let angles: Vec<f64> = (0..12).map(|f| 0.1 * f64::from(f)).collect();
    std::fs::write(at.join("drive.csv"), handles(piece, &place, &angles)).expect("a file");
    let outputs = ["f_####.obj", "anim.glb"];
    for threads in ["1", "2"] {
        let out = outputs.map(|name| format!("{threads}/{name}"));
        std::fs::create_dir(at.join(threads)).expect("a folder");
        let run = retarget(
            at,
            &[
                "hinge.obj",
                "drive.csv",
                "--rig",
                "rig.toml",
                "-o",
                &out[0],
                "-o",
                &out[1],
                "--report",
                &format!("{threads}/r.json"),
                "--threads",
                threads,
            ],
        );
        assert!(run.status.success(), "{}", words(&run));
    }
    for name in ["f_0000.obj", "f_0011.obj", "anim.glb"] {
        let bytes = |threads: &str| std::fs::read(at.join(threads).join(name)).expect("an output");
        assert!(bytes("1") == bytes("2"), "{name} differs");
    }
    let (first, last) = (vertices(&at.join("1/f_0000.obj")), vertices(&at.join("1/f_0011.obj")));
    let rest: Vec<DVec3> = piece.base.0.iter().chain(&piece.moving.0).copied().collect();
    let turned = DQuat::from_rotation_z(1.1);
    for (k, p) in rest.iter().enumerate() {
        let there = if k < piece.base.0.len() { *p } else { turned * *p };
        assert!(first[k].distance(place.apply(*p)) < 1e-5, "vertex {k} in the first frame");
        assert!(last[k].distance(place.apply(there)) < 2e-4, "vertex {k}: {} off", last[k].distance(place.apply(there)));
    }
    // Without components every object is one.
    let mut bare = rig;
    bare.components.clear();
    std::fs::write(at.join("bare.toml"), bare.to_text().expect("text")).expect("a file");
    let run = retarget(at, &["hinge.obj", "drive.csv", "--rig", "bare.toml", "-o", "bare_####.obj"]);
    assert!(run.status.success(), "{}", words(&run));
    assert!(
        std::fs::read(at.join("bare_0011.obj")).expect("a frame") == std::fs::read(at.join("1/f_0011.obj")).expect("a frame")
    );

    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(at.join("1/r.json")).expect("a report")).expect("JSON");
    assert_eq!(report["frames"].as_array().expect("frames").len(), 12);
    let joints = &report["frames"][11]["joints"];
    assert!(joints["gap"].as_f64().expect("a gap") < 1e-3 && joints["axis_deg"].as_f64().expect("an axis") < 0.5);
}

#[test]
fn a_wrong_rig_file_is_refused_with_its_place_and_the_next_step() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let piece = &pieces()[1];
    write_obj(&at.join("hinge.obj"), piece, &Place::odd(1.0));
    std::fs::write(at.join("drive.csv"), handles(piece, &Place::odd(1.0), &[0.0, 0.1])).expect("a file");
    let part = |name: &str| format!("[[component]]\nname = \"{name}\"\n");
    let joint = |rest: &str| {
        format!(
            "{}{}[[joint]]\nname = \"j\"\ntype = \"revolute\"\na = \"base\"\nb = \"moving\"\ncentre = [0, 0, 0]\nx = [0, 0, 1]\n{rest}",
            part("base"),
            part("moving")
        )
    };
    let cases = [
        (part("leg"), "leg"),
        (joint("").replace("\"moving\"\ncentre", "\"movin\"\ncentre"), "moving?"),
        (joint("angle = [1.0, -1.0]\n"), "limits"),
        (joint("").replace("x = [0, 0, 1]", "x = [0, 0, 0]"), "axis"),
        (joint("").replace("revolute", "hinge"), "revolute"),
        (joint("").replace("\"base\"\nb", "\"moving\"\nb"), "itself"),
        (joint("angel = [0, 1]\n"), "angle"),
        (joint("").replace("name = \"base\"\n", "name = \"base\"\ncells = [4, 1, 1]\n"), "soft"),
        (joint("[solver]\niterations = 0\n"), "iterations = 0"),
        (joint("[solver]\nweights = { pos = -1.0 }\n"), "pos is no usable number"),
        (joint("[solver]\nweights = { strain = nan }\n"), "strain is no usable number"),
        (
            joint("[[bind]]\nfrom = { marker = \"M\" }\nto = { component = \"base\" }\nkind = \"orientation\"\n"),
            "a marker has a place and no turn",
        ),
    ];
    for (text, word) in cases {
        std::fs::write(at.join("rig.toml"), &text).expect("a file");
        let run = retarget(at, &["hinge.obj", "drive.csv", "--rig", "rig.toml", "-o", "out.glb"]);
        assert!(!run.status.success() && words(&run).contains(word), "{word}: {}", words(&run));
        assert!(!words(&run).contains("panicked") && !at.join("out.glb").exists());
    }
    let again = retarget(at, &["joints", "hinge.obj", "-o", "rig.toml"]);
    assert!(!again.status.success() && words(&again).contains("--force"), "{}", words(&again));
}

#[test]
fn neither_the_model_nor_one_output_is_replaced_by_another() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    write_obj(&at.join("hinge.obj"), &pieces()[1], &Place::odd(1.0));
    let model = std::fs::read(at.join("hinge.obj")).expect("a model");
    let whole = at.join("hinge.obj").display().to_string();
    let cases: [&[&str]; 4] = [
        &["-o", "hinge.obj"],
        &["-o", "./hinge.obj"],
        &["-o", "rig.toml", "--picture", &whole],
        &["-o", "same.png", "--picture", "./same.png"],
    ];
    for outputs in cases {
        let run = retarget(at, &[&["joints", "hinge.obj", "--force"], outputs].concat());
        assert_eq!(run.status.code(), Some(2), "{outputs:?}: {}", words(&run));
        assert!(std::fs::read(at.join("hinge.obj")).expect("a model") == model && !at.join("same.png").exists());
    }
}

/// The places of a table of handles as markers in a TRC file in millimetres.
fn markers(table: &str) -> String {
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let labels: Vec<&str> = rows.iter().filter(|r| r[0] == "0").map(|r| r[1]).collect();
    let mut text = format!(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n100\t100\t{}\t{}\tmm\nFrame#\tTime\t{}\n\t\n\n",
        rows.len() / labels.len(),
        labels.len(),
        labels.join("\t\t\t")
    );
    for (frame, row) in rows.chunks(labels.len()).enumerate() {
        let _ = write!(text, "{}\t{:.4}", frame + 1, frame as f64 / 100.0);
        for marker in row {
            for x in &marker[2..] {
                let _ = write!(text, "\t{:.5}", 1000.0 * x.parse::<f64>().expect("a number"));
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn markers_in_millimetres_lie_on_a_model_in_metres_off_the_origin() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let piece = &pieces()[1];
    let place = Place { shift: DVec3::new(3.0, -2.0, 7.0), ..Place::odd(1.0) };
    write_obj(&at.join("hinge.obj"), piece, &place);
    assert!(retarget(at, &["joints", "hinge.obj", "-o", "rig.toml"]).status.success());
    let angles: Vec<f64> = (0..12).map(|f| 0.1 * f64::from(f)).collect();
    std::fs::write(at.join("drive.trc"), markers(&handles(piece, &place, &angles))).expect("a file");
    let run = |take: &str, out: &str, more: &[&str]| {
        std::fs::create_dir_all(at.join(out)).expect("a folder");
        let out = format!("{out}/f_####.obj");
        let main = ["hinge.obj", take, "--rig", "rig.toml", "--scan-unit", "m", "-o", &out];
        retarget(at, &[&main, more].concat())
    };
    let turned = DQuat::from_rotation_z(1.1);
    let expected: Vec<DVec3> = piece.base.0.iter().copied().chain(piece.moving.0.iter().map(|p| turned * *p)).collect();
    let is_met = |out: &str| {
        let last = vertices(&at.join(out).join("f_0012.obj"));
        let off = last
            .iter()
            .zip(&expected)
            .map(|(p, q)| p.distance(place.apply(*q)))
            .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
        assert!(last.len() == expected.len() && off < 5e-4, "{out}: {off} off");
    };
    let plain = run("drive.trc", "plain", &["--align", "none"]);
    assert!(plain.status.success(), "{}", words(&plain));
    is_met("plain");
    // Only the unit is converted.
    let turned = run("drive.trc", "turned", &["--align", "none", "--yaw", "40", "--capture-up", "+X"]);
    assert!(turned.status.success() && words(&turned).contains("--yaw and --capture-up not used"), "{}", words(&turned));
    is_met("turned");
    let refused: [&[&str]; 8] = [
        &["--mirror"],
        &["--swap-sides"],
        &["--flip"],
        &["--map", "paper"],
        &["--solve-tolerance", "1e-5"],
        &["--ref", "3"],
        &["--ref-file", "drive.trc"],
        &["--align", "pose"],
    ];
    for option in refused {
        let none: &[&str] = if option[0] == "--align" { &[] } else { &["--align", "none"] };
        let run = run("drive.trc", "none", &[none, option].concat());
        assert!(run.status.code() == Some(2) && words(&run).contains(option[0]), "{option:?}: {}", words(&run));
    }
}

#[test]
fn a_handle_that_comes_after_the_first_frame_is_named_and_pulls_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let piece = &pieces()[1];
    let place = Place::odd(1.0);
    write_obj(&at.join("hinge.obj"), piece, &place);
    assert!(retarget(at, &["joints", "hinge.obj", "-o", "rig.toml"]).status.success());
    let angles: Vec<f64> = (0..12).map(|f| 0.1 * f64::from(f)).collect();
    let table = handles(piece, &place, &angles);
    // Its part has turned by then.
    let is_kept = |line: &&str| !(0..6).any(|f| line.starts_with(&format!("{f},moving1,")));
    let late: Vec<&str> = table.lines().filter(is_kept).collect();
    std::fs::write(at.join("late.csv"), late.join("\n")).expect("a file");
    let run = retarget(at, &["hinge.obj", "late.csv", "--rig", "rig.toml", "-o", "f_####.obj"]);
    assert!(run.status.success() && words(&run).contains("on no part: moving1"), "{}", words(&run));
    let last = vertices(&at.join("f_0011.obj"));
    let turned = DQuat::from_rotation_z(1.1);
    let expected = piece.base.0.iter().copied().chain(piece.moving.0.iter().map(|p| turned * *p));
    let off = last
        .iter()
        .zip(expected)
        .map(|(p, q)| p.distance(place.apply(q)))
        .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
    assert!(off < 2e-4, "{off} off");
}

/// A humanoid robot with a rig of joints and limits, and a person who boxes: the body is found in the joints, and they hold.
#[test]
fn a_boxer_drives_a_robot_within_its_joints() {
    let Some(shared) = std::env::var_os("RETARGET_SHARED").map(std::path::PathBuf::from) else {
        eprintln!("skipped: RETARGET_SHARED names no folder");
        return;
    };
    let mesh = shared.join("bench/joints_cases/talos_merged.obj");
    let take = shared.join("data/motion/bvh/optitrack_boxing_toes.bvh.gz");
    let rig = std::fs::read_to_string(shared.join("bench/joints_cases/talos.rig.toml"));
    let (Ok(rig), true, true) = (rig, mesh.is_file(), take.is_file()) else {
        eprintln!("skipped: the robot or the take is not there");
        return;
    };
    // Its parts and joints; who drives what is found.
    let parts = rig.find("[[component]]").expect("components");
    let binds = rig.find("[[bind]]").expect("binds");
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let text = format!("[space]\nscan_unit = \"m\"\nscan_up = \"+Z\"\n{}", &rig[parts..binds]);
    std::fs::write(at.join("rig.toml"), text).expect("a file");
    let (mesh, take) = (mesh.display().to_string(), take.display().to_string());
    let run = retarget(at, &[&mesh, &take, "--rig", "rig.toml", "-o", "f.pc2", "--report", "r.json", "--frames", "1..300"]);
    assert!(run.status.success(), "{}", words(&run));
    for drive in ["LeftKnee \u{2192} leg_left_4_link", "RightWrist \u{2192} arm_right_7_link", "Hips \u{2192} base_link"] {
        assert!(words(&run).contains(drive), "{drive}: {}", words(&run));
    }
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(at.join("r.json")).expect("a report")).expect("JSON");
    let diagonal = report["decisions"]["scan"]["diagonal"].as_f64().expect("a diagonal");
    for frame in report["frames"].as_array().expect("frames") {
        let of = |what: &str| frame["joints"][what].as_f64().expect("a number");
        let gap = of("gap") * diagonal * 1e3;
        assert!(gap < 2.0 && of("axis_deg") < 1.0 && of("limit_deg") < 1.0, "frame {}: {}", frame["frame"], frame["joints"]);
    }
}
