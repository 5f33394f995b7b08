//! Golden frames of the fixture take, compared vertex by vertex; `scripts/bless.sh` makes them anew and says what moved.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

#[path = "../common/mod.rs"]
mod common;

use common::{fixture, read_ply_points, retarget_ok};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Frames that have a golden and a truth.
const FRAMES: [u32; 5] = [1, 111, 201, 307, 372];

/// What may differ between processors, in diagonals. At quality `converged` a frame ends within about twenty tolerances of 1e-6 of the minimum,
/// however its sums are rounded: two processors may be twice that apart; the rest is the rounding of the file's f32 coordinates.
const TOLERANCE: f64 = 5e-5;

/// Mean distance from the true skin that 41 markers leave open, in diagonals, frame by frame: what was reached, and a tenth more.
/// The truth is a blended skin that loses volume at its joints, which the markers do not tell.
const TRUTH: [f64; 5] = [0.000_04, 0.002_1, 0.005_06, 0.010_08, 0.000_105];

fn golden(frame: u32) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/walk_{frame:04}.ply"))
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

#[test]
fn chosen_frames_of_the_fixture_take_are_as_blessed_and_near_the_truth() {
    let work = tempfile::tempdir().unwrap();
    let [scan, take] = [fixture("scan.obj"), fixture("walk.c3d")];
    retarget_ok(
        work.path(),
        [scan.as_os_str(), take.as_os_str(), "-o".as_ref(), "f_####.ply".as_ref(), "--quality".as_ref(), "converged".as_ref()],
    );
    let bless = std::env::var_os("RETARGET_BLESS").is_some();
    let source = retarget::scan::read(&scan).unwrap();
    let diagonal = retarget::scan::UnitBox::of(&source.mesh).unwrap().diagonal;
    for (frame, limit) in FRAMES.into_iter().zip(TRUTH) {
        let ours = retarget::scan::read(&work.path().join(format!("f_{frame:04}.ply"))).unwrap().mesh.positions;
        // The take shows the rest pose of the scan, and the placement brings it there: the truth is in the scan's own space, place and size included.
        let truth = read_ply_points(&fixture(&format!("true_{frame:04}.ply")));
        let (mean, worst) = distance(&ours, &truth);
        eprintln!(
            "frame {frame}: mean {:.3} %, worst {:.2} % of the diagonal from the truth",
            mean / diagonal * 100.0,
            worst / diagonal * 100.0
        );
        assert!(mean < limit * diagonal, "frame {frame}: mean {:.3} % from the truth", mean / diagonal * 100.0);
        if bless {
            if golden(frame).exists() {
                let (mean, worst) = distance(&ours, &read_ply_points(&golden(frame)));
                eprintln!(
                    "frame {frame}: moved by {:.2e} in the mean, {:.2e} at most (diagonals)",
                    mean / diagonal,
                    worst / diagonal
                );
            }
            write_points(&golden(frame), &ours);
        } else {
            let (_, worst) = distance(&ours, &read_ply_points(&golden(frame)));
            assert!(
                worst < TOLERANCE * diagonal,
                "frame {frame} moved by {:.2e} diagonals; scripts/bless.sh if it should",
                worst / diagonal
            );
        }
    }
}
