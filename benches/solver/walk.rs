//! How soon a frame is within 0.1 mm of the converged pose, by the program's way and by plain iteration.

use super::cases::Case;
use super::core_time::seconds_on_core;
use super::iteration::{plain, published};
use glam::DVec3;
use retarget::deform::Deformer;
use retarget::deform::volumetric::Options;
use std::path::Path;

/// What counts as there: so many metres for 99 % of all vertices in all frames.
const NEAR: f64 = 1e-4;

/// Tolerances from loose to tight.
const TOLERANCES: [f64; 10] = [5e-5, 2e-5, 1.5e-5, 1e-5, 7e-6, 5e-6, 2.5e-6, 1e-6, 5e-7, 1e-7];

/// Counts of plain iterations.
const COUNTS: [u32; 9] = [75, 100, 140, 180, 225, 275, 350, 450, 600];

/// The body moves after so many frames at the case's own rate.
const BEGIN: usize = 3;

/// A sequence solved.
struct Run {
    poses: Vec<Vec<DVec3>>,
    passes: f64,
    milliseconds: f64,
}

fn run_all(case: &Case, options: &Options, begin: usize) -> Run {
    let mut deformer = case.deformer(options);
    let mut run = Run { poses: Vec::new(), passes: 0.0, milliseconds: 0.0 };
    for frame in 0..case.targets.len() {
        let start = seconds_on_core();
        let stats = case.solve(&mut deformer, frame, frame == 0);
        if frame >= begin {
            run.milliseconds += (seconds_on_core() - start) * 1e3;
            run.passes += f64::from(stats.passes);
            run.poses.push(deformer.pose().to_vec());
        }
    }
    run.passes /= run.poses.len() as f64;
    run.milliseconds /= run.poses.len() as f64;
    run
}

/// p50, p99 and largest distance in millimetres for poses in metres.
fn errors(a: &[Vec<DVec3>], b: &[Vec<DVec3>]) -> [f64; 3] {
    let mut all: Vec<f64> = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a.distance(*b) * 1e3).collect();
    all.sort_unstable_by(f64::total_cmp);
    [all[all.len() / 2], all[all.len() * 99 / 100], all[all.len() - 1]]
}

pub fn run(arguments: &[String]) {
    let path = Path::new(arguments.first().expect("a case"));
    let peer: Option<f64> = arguments.get(1).map(|ms| ms.parse().expect("milliseconds of the peer's iteration"));
    println!("per frame; distances of all vertices to the converged pose, mm");
    for factor in [1, 4] {
        let mut case = Case::read(path).unwrap_or_else(|| panic!("{} is not there", path.display()));
        if factor > 1 {
            case = case.resampled(factor);
        }
        println!("\n{} frames per second", 30 * factor);
        sequence(&case, BEGIN * factor, peer);
    }
    println!("\ncold, from the rest pose");
    cold(&Case::read(path).unwrap());
}

fn sequence(case: &Case, begin: usize, peer: Option<f64>) {
    let converged = run_all(case, &Options { tolerance: 1e-9, ..published() }, begin);
    println!("{:<24} {:>7} {:>9} {:>8} {:>8} {:>8}", "", "passes", "ms", "p50", "p99", "max");
    let mut ours = None;
    for tolerance in TOLERANCES {
        let run = run_all(case, &Options { tolerance, ..published() }, begin);
        let [p50, p99, max] = errors(&run.poses, &converged.poses);
        let name = format!("tolerance {tolerance:.1e}");
        println!("{name:<24} {:>7.1} {:>9.2} {p50:>8.4} {p99:>8.4} {max:>8.3}", run.passes, run.milliseconds);
        if p99 <= NEAR * 1e3 && ours.is_none() {
            ours = Some(run.milliseconds);
        }
    }
    let ours = ours.expect("some tolerance is tight enough");
    for count in COUNTS {
        let run = run_all(case, &plain(count, Some(1)), begin);
        let [p50, p99, max] = errors(&run.poses, &converged.poses);
        println!("{:<24} {count:>7} {:>9.2} {p50:>8.4} {p99:>8.4} {max:>8.3}", "plain, warm", run.milliseconds);
        if p99 <= NEAR * 1e3 {
            println!("plain over ours to {} mm p99: {:.0}", NEAR * 1e3, run.milliseconds / ours);
            if let Some(peer) = peer {
                println!("plain at the peer's {peer:.2} ms per iteration over ours: {:.0}", f64::from(count) * peer / ours);
            }
            break;
        }
    }
}

/// One frame of the middle of the walk, from rest.
fn cold(case: &Case) {
    let frame = case.targets.len() / 2;
    let solve = |options: &Options| {
        let mut deformer = case.deformer(options);
        let start = seconds_on_core();
        let stats = case.solve(&mut deformer, frame, true);
        (deformer.pose().to_vec(), stats.passes, (seconds_on_core() - start) * 1e3)
    };
    let (converged, ..) = solve(&Options { tolerance: 1e-9, ..published() });
    let p99 = |pose: Vec<DVec3>| errors(&[pose], std::slice::from_ref(&converged))[1];
    let mut ours = f64::NAN;
    for tolerance in TOLERANCES {
        let (pose, passes, ms) = solve(&Options { tolerance, ..published() });
        let p99 = p99(pose);
        println!("{:<24} {passes:>7} {ms:>9.2} {:>8} {p99:>8.4}", format!("tolerance {tolerance:.1e}"), "");
        if p99 <= NEAR * 1e3 {
            ours = ms;
            break;
        }
    }
    for count in [200, 300, 400, 500, 600, 800, 1000, 1300, 1700] {
        let (pose, passes, ms) = solve(&plain(count, Some(1)));
        let p99 = p99(pose);
        println!("{:<24} {passes:>7} {ms:>9.2} {:>8} {p99:>8.4}", "plain", "");
        if p99 <= NEAR * 1e3 {
            println!("plain over ours: {:.1}", ms / ours);
            break;
        }
    }
}
