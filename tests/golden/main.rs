//! Golden frames of the fixture take, compared vertex by vertex; `scripts/bless.sh` makes them anew and says what moved.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

#[path = "../common/mod.rs"]
mod common;

use common::{arm, c3d_writer, fixture, read_ply_points, retarget_ok};
use glam::DVec3;
use std::path::{Path, PathBuf};

#[allow(dead_code)]
#[path = "../../examples/make_fixtures/generate/mod.rs"]
mod generate;

/// Frames of the marker take that have a golden and a truth.
const WALK: [u32; 5] = [1, 111, 201, 307, 372];
/// Frames of the take by handles that turn: the first, the quarters (the second third has a hand that nobody holds), the last.
const REACH: [u32; 4] = [1, 20, 40, 60];

/// Frames of an arm by shells with two examples: the shoulder half way, all the way, and the elbow with it.
const ARM: [u32; 4] = [5, 10, 15, 20];
/// The same of the arm.
const ARM_TRUTH: [f64; 4] = [0.000_112, 0.000_031, 0.000_77, 0.000_46];

/// What may differ between processors, in diagonals. At quality `converged` a frame ends within about twenty tolerances of 1e-7 of the minimum,
/// however its sums are rounded: two processors may be twice that apart; the rest is the rounding of the file's f32 coordinates.
const TOLERANCE: f64 = 5e-5;

/// Mean distance from the true skin that 41 markers leave open, in diagonals, frame by frame: what was reached, and a tenth more.
/// The truth is a blended skin that loses volume at its joints, which the markers do not tell.
const WALK_TRUTH: [f64; 5] = [0.000_04, 0.002_1, 0.005_06, 0.010_08, 0.000_105];
/// The same of seven frames and two points.
const REACH_TRUTH: [f64; 4] = [0.000_01, 0.002_46, 0.005_54, 0.005_92];

fn golden(take: &str, frame: u32) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{take}_{frame:04}.ply"))
}

fn write_points(path: &Path, points: &[DVec3]) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points.len()
    )
    .into_bytes();
    for p in points {
        p.to_array().iter().for_each(|&c| bytes.extend((c as f32).to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

/// Mean and largest distance.
fn distance(a: &[DVec3], b: &[DVec3]) -> (f64, f64) {
    assert_eq!(a.len(), b.len());
    let each = || a.iter().zip(b).map(|(p, q)| p.distance(*q));
    (each().sum::<f64>() / a.len() as f64, each().fold(0.0, f64::max))
}

/// Runs a take on the fixture scan and compares some of its frames with the truth and with the goldens, or blesses them.
fn compare(take: &str, file: &str, frames: &[(u32, f64)], truth: impl Fn(u32) -> Vec<DVec3>) {
    let work = tempfile::tempdir().unwrap();
    let scan = fixture("scan.obj");
    retarget_ok(
        work.path(),
        [
            scan.as_os_str(),
            fixture(file).as_os_str(),
            "-o".as_ref(),
            "f_####.ply".as_ref(),
            "--quality".as_ref(),
            "converged".as_ref(),
        ],
    );
    let source = retarget::scan::read(&scan).unwrap();
    let diagonal = retarget::scan::UnitBox::of(&source.mesh).unwrap().diagonal;
    for &(frame, limit) in frames {
        judge(take, frame, limit, &work.path().join(format!("f_{frame:04}.ply")), &truth(frame), diagonal);
    }
}

/// Compares a frame with the truth and with its golden, or blesses it.
fn judge(take: &str, frame: u32, limit: f64, file: &Path, truth: &[DVec3], diagonal: f64) {
    let ours = retarget::scan::read(file).unwrap().mesh.positions;
    let (mean, worst) = distance(&ours, truth);
    eprintln!(
        "{take} {frame}: mean {:.4} %, worst {:.2} % of the diagonal from the truth",
        mean / diagonal * 100.0,
        worst / diagonal * 100.0
    );
    assert!(mean < limit * diagonal, "{take} {frame}: mean {:.4} % from the truth", mean / diagonal * 100.0);
    let golden = golden(take, frame);
    if std::env::var_os("RETARGET_BLESS").is_some() {
        if golden.exists() {
            let (mean, worst) = distance(&ours, &read_ply_points(&golden));
            eprintln!(
                "{take} {frame}: moved by {:.2e} in the mean, {:.2e} at most (diagonals)",
                mean / diagonal,
                worst / diagonal
            );
        }
        write_points(&golden, &ours);
    } else {
        let (_, worst) = distance(&ours, &read_ply_points(&golden));
        assert!(
            worst < TOLERANCE * diagonal,
            "{take} {frame} moved by {:.2e} diagonals; scripts/bless.sh if it should",
            worst / diagonal
        );
    }
}

#[test]
fn chosen_frames_of_the_marker_take_are_as_blessed_and_near_the_truth() {
    // The take shows the rest pose of the scan, and the placement brings it there: the truth is in the scan's own space, place and size included.
    let frames: Vec<(u32, f64)> = WALK.into_iter().zip(WALK_TRUTH).collect();
    compare("walk", "walk.c3d", &frames, |frame| read_ply_points(&fixture(&format!("true_{frame:04}.ply"))));
}

#[test]
fn chosen_frames_of_an_arm_with_examples_are_as_blessed_and_near_the_truth() {
    let folder = arm::folder();
    let arguments = ["arm.obj", "take.csv", "--examples", "elbow.obj", "shoulder.obj", "--quality", "converged", "-o", "f_#.ply"];
    retarget_ok(folder.path(), arguments);
    for (frame, limit) in ARM.into_iter().zip(ARM_TRUTH) {
        let (shoulder, elbow) = arm::path()[frame as usize];
        judge("arm", frame, limit, &folder.path().join(format!("f_{frame}.ply")), &arm::arm(shoulder, elbow), arm::DIAGONAL);
    }
}

#[test]
fn chosen_frames_of_the_take_by_turning_handles_are_as_blessed_and_near_the_truth() {
    let bones = generate::body::bones();
    let points = retarget::scan::read(&fixture("scan.obj")).unwrap().mesh.positions;
    let body = generate::body::Body::on(&bones, points);
    let frames: Vec<(u32, f64)> = REACH.into_iter().zip(REACH_TRUTH).collect();
    assert!(frames[0].0 == 1 && frames[3].0 as usize == generate::reach::FRAMES);
    compare("reach", "reach.csv", &frames, |frame| {
        generate::motion::posed(&body, &bones, &generate::reach::pose(&bones, frame as usize - 1))
    });
}
