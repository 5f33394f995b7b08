//! The shell deformer and its examples, through the program: an arm whose elbow and shoulder have been bent.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;

use common::arm::{DIAGONAL, arm, faces, folder, path, write_obj};
use common::{read_pc2, retarget, retarget_ok};
use glam::{DMat3, DVec3};
use serde_json::Value;
use std::path::Path;

/// Largest distance of a frame from the arm with these angles, in diagonals, wherever it lies.
fn off_anywhere(frame: &[[f32; 3]], shoulder: f64, elbow: f64) -> f64 {
    let truth = arm(shoulder, elbow);
    let points: Vec<DVec3> = frame.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
    let centre = |x: &[DVec3]| x.iter().sum::<DVec3>() / x.len() as f64;
    let (from, to) = (centre(&points), centre(&truth));
    let mut covariance = DMat3::ZERO;
    for (p, t) in points.iter().zip(&truth) {
        let (p, t) = (*p - from, *t - to);
        covariance += DMat3::from_cols(t * p.x, t * p.y, t * p.z);
    }
    let turn = retarget::linalg::nearest_rotation(covariance, DMat3::IDENTITY);
    points
        .iter()
        .zip(&truth)
        .map(|(p, t)| (turn * (*p - from) + to).distance(*t))
        .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
        / DIAGONAL
}

/// Largest distance of a frame from the arm with these angles, in diagonals.
fn off(frame: &[[f32; 3]], shoulder: f64, elbow: f64) -> f64 {
    let truth = arm(shoulder, elbow);
    frame
        .iter()
        .zip(&truth)
        .map(|(p, q)| DVec3::from(p.map(f64::from)).distance(*q))
        .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
        / DIAGONAL
}

fn points_of(path: &Path) -> Vec<[f32; 3]> {
    let text = std::fs::read_to_string(path).unwrap();
    let vertices = text.lines().filter_map(|l| l.strip_prefix("v "));
    vertices.map(|l| l.split(' ').map(|n| n.parse().unwrap()).collect::<Vec<f32>>().try_into().unwrap()).collect()
}

#[test]
fn handles_choose_how_much_of_each_example_is_in_a_frame() {
    let folder = folder();
    let run = |more: &[&str]| -> Vec<Vec<[f32; 3]>> {
        let arguments = ["arm.obj", "take.csv", "--force", "-o", "out.pc2"].iter().chain(more).copied();
        let said = retarget_ok(folder.path(), arguments);
        assert!(more.is_empty() || said.contains("shells"), "{said}");
        read_pc2(&folder.path().join("out.pc2"))
    };
    let shells = run(&["--examples", "elbow.obj", "shoulder.obj", "--report", "report.json"]);
    for (frame, limit) in [(0, 1e-5), (10, 0.005), (20, 0.008)] {
        let (shoulder, elbow) = path()[frame];
        let off = off(&shells[frame], shoulder, elbow);
        eprintln!("frame {frame}: {:.3} % of the diagonal from the truth", 100.0 * off);
        assert!(off < limit, "frame {frame}: {off}");
    }
    let report: Value = serde_json::from_str(&std::fs::read_to_string(folder.path().join("report.json")).unwrap()).unwrap();
    let names: Vec<&str> = report["decisions"]["examples"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    assert_eq!(names, ["elbow.obj", "shoulder.obj"]);
    let weights = |frame: usize| -> Vec<f64> {
        report["frames"][frame]["weights"].as_array().unwrap().iter().map(|w| w.as_f64().unwrap()).collect()
    };
    for (frame, expected) in [(0, [0.0, 0.0]), (10, [0.0, 1.0]), (20, [1.0, 1.0])] {
        assert!(weights(frame).iter().zip(expected).all(|(w, e)| (w - e).abs() < 0.05), "frame {frame}: {:?}", weights(frame));
    }
    // The same without what the examples know, and with an example that lies elsewhere.
    let volumetric = run(&[]);
    let without = off(&volumetric[20], 70.0, 100.0);
    assert!(without > 4.0 * off(&shells[20], 70.0, 100.0), "{without}");
    let [turned, plain] =
        ["turned.obj", "elbow.obj"].map(|elbow| run(&["--quality", "converged", "--examples", elbow, "shoulder.obj"]));
    // As near as two ways to the same minimum end.
    for (a, b) in turned.iter().flatten().zip(plain.iter().flatten()) {
        assert!((0..3).all(|k| f64::from(a[k] - b[k]).abs() < 1e-5 * DIAGONAL), "{a:?} {b:?}");
    }
}

#[test]
fn outputs_are_the_same_bytes_for_any_number_of_threads() {
    let folder = folder();
    let run = |threads: &str| {
        let examples = ["--examples", "elbow.obj", "shoulder.obj", "--proxy-vertices", "300"];
        let arguments = ["arm.obj", "take.csv", "--force", "-o", "out.pc2", "--threads", threads];
        retarget_ok(folder.path(), arguments.iter().chain(&examples));
        std::fs::read(folder.path().join("out.pc2")).unwrap()
    };
    let one = run("1");
    assert!(one == run("2") && one == run("3"));
}

#[test]
fn what_set_up_computes_of_a_shell_is_kept_and_other_examples_are_another_one() {
    let folder = folder();
    let run = |examples: &[&str], cache: bool| {
        let fixed = ["arm.obj", "take.csv", "--force", "-o", "out.pc2", "--proxy-vertices", "300", "--examples"];
        let cache: &[&str] = if cache { &["--cache", "kept"] } else { &[] };
        retarget_ok(folder.path(), fixed.iter().chain(examples).chain(cache));
        std::fs::read(folder.path().join("out.pc2")).unwrap()
    };
    let kept = || std::fs::read_dir(folder.path().join("kept")).unwrap().count();
    let (both, one) = (["elbow.obj", "shoulder.obj"], ["elbow.obj"]);
    let expected = [run(&both, false), run(&one, false)];
    assert!(run(&both, true) == expected[0]);
    let first = kept();
    assert!(run(&both, true) == expected[0] && kept() == first && first >= 2, "{first} files");
    assert!(run(&one, true) == expected[1] && kept() > first);
}

#[test]
fn a_pose_of_another_mesh_is_refused_with_what_differs() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let mut other = faces();
    other[811].swap(1, 2);
    write_obj(&at("faces.obj"), &arm(0.0, 50.0), &other);
    let mut more = arm(0.0, 50.0);
    more.push(DVec3::ZERO);
    write_obj(&at("more.obj"), &more, &faces());
    for (arguments, words, code) in [
        (vec!["--examples", "elbow.obj", "faces.obj"], vec!["faces.obj", "face 812"], 3),
        (vec!["--examples", "more.obj"], vec!["more.obj", "1,467 vertices where arm.obj has 1,466"], 3),
        (vec!["--examples", "none.obj"], vec!["none.obj"], 1),
        (vec!["--examples", "elbow.obj", "--method", "volumetric"], vec!["--method volumetric"], 2),
        (vec!["--method", "shells", "--proxy", "p.mesh"], vec!["--proxy"], 2),
        (vec!["--method", "shells", "--map", "paper"], vec!["--map paper with shells"], 2),
        (vec!["--method", "shells", "--solve-tolerance", "1e-6"], vec!["--solve-tolerance with shells", "--quality"], 2),
        (vec!["--thickness", "1"], vec!["--thickness without shells"], 2),
        (vec!["--shell-weights", "paper"], vec!["--shell-weights without shells"], 2),
        (vec!["--example-scale", "auto"], vec!["--example-scale without examples"], 2),
        (vec!["--method", "shells", "--weight-range", "box"], vec!["--weight-range without examples"], 2),
        (vec!["--method", "shells", "--learn-stiffness"], vec!["--learn-stiffness without examples"], 2),
    ] {
        let output = retarget(folder.path(), ["arm.obj", "take.csv", "-o", "out.pc2"].iter().chain(&arguments));
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(words.iter().all(|w| said.contains(w)), "{said}");
        assert!(!at("out.pc2").exists());
    }
}

#[test]
fn an_example_with_its_own_weight_comes_back() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    retarget_ok(folder.path(), ["blend", "arm.obj", "elbow.obj", "shoulder.obj", "--at", "1,0", "-o", "out.obj"]);
    assert!(off(&points_of(&at("out.obj")), 0.0, 100.0) < 1e-5);
    // Between and beyond, where the arm is known.
    let arguments = ["--at", "0,0", "--at", "0,0.5", "--at", "0,1.2", "-o", "seq_##.obj", "--verbose"];
    let said = retarget_ok(folder.path(), ["blend", "arm.obj", "elbow.obj", "shoulder.obj"].iter().chain(&arguments));
    for (frame, angle, limit) in [(0, 0.0, 1e-5), (1, 35.0, 0.02), (2, 84.0, 0.02)] {
        let off = off_anywhere(&points_of(&at(&format!("seq_{frame:02}.obj"))), angle, 0.0);
        eprintln!("{angle}: {:.2} % of the diagonal from the arm that is bent so", 100.0 * off);
        assert!(off < limit, "{angle}: {off}\n{said}");
    }
    // The coarse mesh alone is not far.
    let coarse = ["--at", "0,0.5", "-o", "coarse.obj", "--refine", "0", "--proxy-vertices", "300"];
    retarget_ok(folder.path(), ["blend", "arm.obj", "elbow.obj", "shoulder.obj"].iter().chain(&coarse));
    let (fine, coarse) = (points_of(&at("seq_01.obj")), points_of(&at("coarse.obj")));
    let apart = fine.iter().zip(&coarse).map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt());
    assert!(f64::from(apart.fold(0.0, f32::max)) < 0.01 * DIAGONAL);
}

#[test]
fn weights_may_come_from_a_table_and_what_does_not_fit_is_refused() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("weights.csv"), "elbow,shoulder\n0,0\n0.5,0.5\n").unwrap();
    std::fs::write(at("bad.csv"), "0,0\n0.5;0.5\n").unwrap();
    std::fs::write(at("far.csv"), "1e6,0\n").unwrap();
    let blend = |more: &[&str]| retarget(folder.path(), ["blend", "arm.obj", "elbow.obj", "shoulder.obj"].iter().chain(more));
    let ok = blend(&["--weights", "weights.csv", "-o", "out.pc2", "-o", "f_#.ply", "--fps", "24", "--proxy-vertices", "300"]);
    assert!(ok.status.success(), "{}", String::from_utf8_lossy(&ok.stderr));
    assert_eq!(read_pc2(&at("out.pc2")).len(), 2);
    assert!(at("f_0.ply").exists() && at("f_1.ply").exists());
    for (arguments, words, code) in [
        (vec!["--at", "0.5", "-o", "x.obj"], vec!["2 examples", "1 weight", "elbow.obj, shoulder.obj"], 2),
        (vec!["--at", "0,0", "--at", "1,1", "-o", "x.obj"], vec!["one file for 2 frames"], 2),
        (vec!["--at", "a,b", "-o", "x.obj"], vec!["expected numbers"], 2),
        (vec!["--at", "0,0", "--at", "0,-21", "-o", "x.pc2"], vec!["weight -21", "frame 1", "20"], 2),
        (vec!["--weights", "far.csv", "-o", "x.pc2"], vec!["weight 1000000", "frame 0"], 2),
        (vec!["--weights", "bad.csv", "-o", "x.pc2"], vec!["bad.csv", "line 2"], 1),
        (vec!["--at", "0,0", "-o", "out.pc2"], vec!["exists already"], 1),
        (vec!["--at", "0,0", "-o", "elbow.obj", "--force"], vec!["would replace an input"], 2),
        (vec!["-o", "x.obj"], vec!["--at"], 2),
    ] {
        let output = blend(&arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(words.iter().all(|w| said.contains(w)), "{said}");
        assert!(!at("x.obj").exists() && !at("x.pc2").exists());
    }
}

#[test]
fn a_real_walk_with_examples_is_as_calm_as_without() {
    let Some(data) = common::shared() else { return };
    let folder = tempfile::tempdir().unwrap();
    let poses = data.join("meshes/examples/human_makehuman_male");
    let pose = |name: &str| poses.join(format!("{name}.obj.gz")).display().to_string();
    let take = |name: &str| data.join(format!("motion/c3d/{name}.c3d")).display().to_string();
    let run = |examples: &[&str]| -> Vec<Vec<[f32; 3]>> {
        let mut arguments = vec![pose("00_rest_apose"), take("pig_antom_walk"), "--ref-file".into(), take("pig_antom_static")];
        arguments.extend(["--force", "--frames", "200..400", "--report", "report.json", "-o", "out.pc2"].map(String::from));
        if !examples.is_empty() {
            arguments.push("--examples".into());
            arguments.extend(examples.iter().map(|name| pose(name)));
        }
        retarget_ok(folder.path(), arguments);
        read_pc2(&folder.path().join("out.pc2"))
    };
    // Second differences between frames, millimetres.
    let jerk = |frames: &[Vec<[f32; 3]>]| -> f64 {
        let at = |f: usize, v: usize| DVec3::from(frames[f][v].map(f64::from));
        let each = (1..frames.len() - 1)
            .flat_map(|f| (0..frames[f].len()).map(move |v| (at(f + 1, v) - 2.0 * at(f, v) + at(f - 1, v)).length()));
        1e3 * each.fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
    };
    let volumetric = jerk(&run(&[]));
    let names = ["03_walk_left_forward", "04_walk_right_forward", "05_run", "06_arms_up", "07_squat_arms_forward", "08_sit"];
    let shells = jerk(&run(&[&names[..], &["09_kick_right", "11_forward_bend"]].concat()));
    let report: Value = serde_json::from_str(&std::fs::read_to_string(folder.path().join("report.json")).unwrap()).unwrap();
    let weights = |f: &Value| -> Vec<f64> { f["weights"].as_array().unwrap().iter().map(|w| w.as_f64().unwrap()).collect() };
    let all: Vec<Vec<f64>> = report["frames"].as_array().unwrap().iter().map(weights).collect();
    let second = |w: &[Vec<f64>]| {
        (0..w[0].len())
            .map(|i| (w[0][i] - 2.0 * w[1][i] + w[2][i]).abs())
            .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
    };
    let leap = all.windows(3).map(second).fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
    eprintln!("second differences: {shells:.1} mm, {volumetric:.1} volumetric; of the weights {leap:.3}");
    assert!(shells < 1.5 * volumetric && leap < 0.1, "{shells} {volumetric} {leap}");
}

/// Largest distance between two runs, in diagonals.
fn apart(a: &[Vec<[f32; 3]>], b: &[Vec<[f32; 3]>]) -> f64 {
    let each = a.iter().flatten().zip(b.iter().flatten());
    let distances = each.map(|(p, q)| DVec3::from(p.map(f64::from)).distance(DVec3::from(q.map(f64::from))));
    distances.fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m }) / DIAGONAL
}

#[test]
fn steps_on_the_whole_mesh_come_nearer_to_its_optimum() {
    let folder = folder();
    let run = |more: &[&str]| -> Vec<Vec<[f32; 3]>> {
        let fixed = ["arm.obj", "take.csv", "--force", "--quality", "converged", "-o", "out.pc2"];
        retarget_ok(folder.path(), fixed.iter().chain(["--examples", "elbow.obj", "shoulder.obj"].iter()).chain(more));
        read_pc2(&folder.path().join("out.pc2"))
    };
    let optimum = run(&["--proxy-vertices", "100000"]);
    let coarse = run(&["--proxy-vertices", "200"]);
    let [two, six] = ["2", "6"].map(|steps| run(&["--proxy-vertices", "200", "--refine", steps]));
    let [coarse, two, six] = [&coarse, &two, &six].map(|frames| apart(frames, &optimum));
    eprintln!("largest distance from the optimum: coarse {coarse:.1e}, two steps {two:.1e}, six {six:.1e}");
    assert!(two < 0.5 * coarse && six <= two, "{coarse} {two} {six}");
}

#[test]
fn refine_is_refused_where_it_has_nothing_to_do() {
    let folder = folder();
    for (more, words) in [
        (&["--refine", "2"][..], ["--refine without shells", "--method shells"]),
        (&["--refine", "2", "--method", "shells", "--proxy-vertices", "100000"], ["all of which are solved", "--proxy-vertices"]),
        (&["--refine", "0", "--method", "shells"], ["--refine", "1..=1000"]),
    ] {
        let output = retarget(folder.path(), ["arm.obj", "take.csv", "-o", "out.pc2"].iter().chain(more));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success(), "{said}");
        assert!(words.iter().all(|w| said.contains(w)), "{said}");
        assert!(!folder.path().join("out.pc2").exists());
    }
}

#[test]
fn a_saved_rig_file_keeps_how_the_shell_is_solved() {
    let folder = folder();
    let run = |more: &[&str]| {
        let fixed = ["arm.obj", "take.csv", "--force", "-o", "out.pc2", "--proxy-vertices", "300", "--examples", "elbow.obj"];
        retarget_ok(folder.path(), fixed.iter().chain(more));
        std::fs::read(folder.path().join("out.pc2")).unwrap()
    };
    let usual = run(&[]);
    for (options, section) in [
        (
            &["--shell-weights", "50,2,500", "--weight-range", "convex"][..],
            "weights = [50.0, 2.0, 500.0]\nweight_range = \"convex\"",
        ),
        (&["--thickness", "2.5", "--learn-stiffness"], "thickness = 2.5\nlearn_stiffness = true"),
        (&["--shell-weights", "paper"], "paper = true"),
    ] {
        let first = run(&[options, &["--save-rig", "arm.toml"]].concat());
        assert!(first != usual, "{options:?} must change something");
        let text = std::fs::read_to_string(folder.path().join("arm.toml")).unwrap();
        assert!(text.contains("[solver.shell]") && text.contains(section), "{text}");
        assert!(run(&["--rig", "arm.toml"]) == first, "{options:?}");
        assert!(run(&["--rig", "arm.toml", "--shell-weights", "100,1,1000", "--weight-range", "box"]) != first);
    }
    // Where nothing is solved by a shell, or has no examples, the section waits.
    let section = "[solver.shell]\nthickness = 2.5\nweight_range = \"convex\"\nlearn_stiffness = true\n";
    std::fs::write(folder.path().join("arm.toml"), section).unwrap();
    for more in [&[][..], &["--method", "shells"]] {
        let fixed = ["arm.obj", "take.csv", "--force", "-o", "out.pc2", "--rig", "arm.toml", "--save-rig", "again.toml"];
        retarget_ok(folder.path(), fixed.iter().chain(more));
        let again = std::fs::read_to_string(folder.path().join("again.toml")).unwrap();
        assert!(again.contains(section), "{more:?}: {again}");
    }
    std::fs::write(folder.path().join("arm.toml"), "[solver.shell]\nthickness = 2\npaper = true\n").unwrap();
    let output = retarget(folder.path(), ["arm.obj", "take.csv", "--rig", "arm.toml", "-o", "none.pc2"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("[solver.shell]") && said.contains("one of them"), "{said}");
}
