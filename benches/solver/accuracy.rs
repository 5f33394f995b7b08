//! What each quality gives and costs: the program's own outputs against those of a run to 1e-9 of the diagonal.

use super::common::{fixture, read_pc2, retarget_ok, shared};
use super::median;
use serde_json::Value;
use std::path::{Path, PathBuf};

const QUALITIES: [&str; 3] = ["draft", "default", "converged"];

pub fn run() {
    println!(
        "distances of all vertices to the pose of --solve-tolerance 1e-9, mm; passes and milliseconds per frame (median of frames)"
    );
    println!(
        "{:<16} {:<10} {:>8} {:>8} {:>8} {:>8} {:>7} {:>9} {:>9}",
        "take", "quality", "p50", "p99", "max", "passes", "ms", "est p99", "est max"
    );
    let walk = [fixture("scan.obj"), fixture("walk.c3d")];
    take("fixture walk", &walk, &[]);
    take("fixture walk 30", &walk, &["--fps", "30"]);
    let Some(data) = shared() else { return };
    let of = |scan: &str, capture: &str| [data.join("meshes/bodies").join(scan), data.join("motion/c3d").join(capture)];
    let male = "makehuman_male_body_apose_quads.obj.gz";
    let standing = data.join("motion/c3d/pig_antom_static.c3d").to_string_lossy().into_owned();
    take("walk and static", &of(male, "pig_antom_walk.c3d"), &["--ref-file", &standing]);
    take("jump", &of(male, "mac_jump2.c3d"), &[]);
}

fn take(name: &str, inputs: &[PathBuf; 2], options: &[&str]) {
    let work = tempfile::tempdir().unwrap();
    let poses = |more: &[&str]| {
        let (cache, report) = (work.path().join("out.pc2"), work.path().join("out.json"));
        let mut arguments: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
        arguments.extend(["--force", "--quiet", "-o"].map(Path::new));
        arguments.push(&cache);
        arguments.push(Path::new("--report"));
        arguments.push(&report);
        arguments.extend(options.iter().chain(more).map(Path::new));
        retarget_ok(work.path(), &arguments);
        let report: Value = serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap();
        (read_pc2(&cache), report)
    };
    let (converged, report) = poses(&["--solve-tolerance", "1e-9"]);
    let millimetres = match report["decisions"]["binding"]["scan_unit"]["value"].as_str().unwrap() {
        "mm" => 1.0,
        "cm" => 10.0,
        "dm" => 100.0,
        "m" => 1000.0,
        other => panic!("{other}"),
    };
    for quality in QUALITIES {
        let (poses, report) = poses(&["--quality", quality]);
        let mut all: Vec<f32> = poses
            .iter()
            .flatten()
            .zip(converged.iter().flatten())
            .map(|(a, b)| (0..3).map(|c| (a[c] - b[c]) * (a[c] - b[c])).sum::<f32>().sqrt())
            .collect();
        all.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| f64::from(all[((all.len() - 1) as f64 * share) as usize]) * millimetres;
        let frames = report["frames"].as_array().unwrap();
        let of =
            |field: &dyn Fn(&Value) -> &Value| frames.iter().map(|f| field(f).as_f64().unwrap_or(f64::NAN)).collect::<Vec<_>>();
        let passes = of(&|f| &f["iterations"]);
        let mut estimates = of(&|f| &f["error_mm"]);
        estimates.sort_by(f64::total_cmp);
        println!(
            "{name:<16} {quality:<10} {:>8.4} {:>8.4} {:>8.3} {:>8.1} {:>7.2} {:>9.3} {:>9.3}",
            at(0.5),
            at(0.99),
            at(1.0),
            passes.iter().sum::<f64>() / passes.len() as f64,
            median(of(&|f| &f["ms"]["solve"])),
            estimates[estimates.len() * 99 / 100],
            estimates[estimates.len() - 1],
        );
    }
}
