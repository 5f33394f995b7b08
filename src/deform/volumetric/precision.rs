//! How near frames that are solved to a tolerance come to the converged ones, and that nothing else than the tolerance decides it.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::bodies::{block, distance, handles, noise, shapes, targets_of, twisted};
use super::oriented_laws::{bar, ends, twist_poses};
use super::{Options, Volumetric};
use crate::deform::{Deformer, FrameStats, Grip, Targets};
use crate::linalg::lanes::avx2;
use crate::linalg::use_baseline;
use crate::proxy::Proxy;
use glam::DVec3;

/// Poses and measures of a sequence of targets.
fn solved(proxy: &Proxy, options: &Options, takes: &[Targets]) -> (Vec<Vec<DVec3>>, Vec<FrameStats>, Vec<Vec<f64>>) {
    let mut deformer = Volumetric::new(proxy, &handles(proxy, 1.0), options).unwrap();
    let (mut poses, mut stats, mut energies) = (Vec::new(), Vec::new(), Vec::new());
    for (frame, targets) in takes.iter().enumerate() {
        stats.push(if frame == 0 { deformer.start(targets) } else { deformer.step(targets) }.unwrap());
        poses.push(deformer.pose().to_vec());
        energies.push(deformer.energies().to_vec());
    }
    (poses, stats, energies)
}

/// A twist that comes and goes, with so much noise on every target.
fn swaying(proxy: &Proxy, frames: u32, amplitude: f64) -> Vec<Targets> {
    let handles = handles(proxy, 1.0);
    let mut random = noise();
    (0..frames)
        .map(|frame| {
            let mut targets = targets_of(proxy, &handles, twisted(0.8 * (0.12 * f64::from(frame)).sin()));
            targets.positions.iter_mut().for_each(|p| *p += DVec3::new(random(), random(), random()) * amplitude);
            targets
        })
        .collect()
}

/// The baseline for as long as it lives: also where an assertion or a solve fails in between, other tests go on as before.
struct Baseline;

impl Baseline {
    fn set() -> Self {
        use_baseline(true);
        Self
    }
}

impl Drop for Baseline {
    fn drop(&mut self) {
        use_baseline(false);
    }
}

#[test]
fn both_instruction_sets_give_the_same_bits() {
    if !avx2() {
        eprintln!("skipped: no AVX2 here");
        return;
    }
    for proxy in shapes() {
        let takes = swaying(&proxy, 8, 1e-3);
        let rigid = vec![(0..20).collect::<Vec<u32>>()];
        for options in [
            Options::default(),
            Options { rigid, ..Options::default() },
            Options { iterations: Some(4), ..Options::default() },
            Options { iterations: Some(4), rotation_steps: Some(1), ..Options::default() },
        ] {
            let vector = solved(&proxy, &options, &takes);
            let baseline = {
                let _guard = Baseline::set();
                solved(&proxy, &options, &takes)
            };
            assert!(vector == baseline, "{options:?}");
        }
    }
}

#[test]
fn noise_of_markers_is_not_amplified() {
    let proxy = block([10, 3, 3], 0.1);
    let takes = swaying(&proxy, 40, 3e-4);
    let roughness = |tolerance: f64| {
        let (poses, ..) = solved(&proxy, &Options { tolerance, ..Options::default() }, &takes);
        let squares = poses
            .windows(3)
            .skip(2)
            .flat_map(|p| (0..proxy.rest.len()).map(|v| (p[0][v] - p[1][v] * 2.0 + p[2][v]).length_squared()));
        squares.sum::<f64>().sqrt()
    };
    let converged = roughness(1e-10);
    for tolerance in [Options::DRAFT, Options::NORMAL, Options::CONVERGED] {
        let ratio = roughness(tolerance) / converged;
        eprintln!("second differences at {tolerance:e}: {ratio:.4} of the converged");
        assert!((0.9..1.005).contains(&ratio), "{tolerance}: {ratio}");
    }
}

#[test]
fn the_energy_falls_and_the_estimate_holds_at_every_quality() {
    for proxy in shapes() {
        let takes = swaying(&proxy, 20, 3e-4);
        let (converged, ..) = solved(&proxy, &Options { tolerance: 1e-11, ..Options::default() }, &takes);
        let mut last = f64::INFINITY;
        for tolerance in [Options::DRAFT, Options::NORMAL, Options::CONVERGED] {
            let (poses, stats, energies) = solved(&proxy, &Options { tolerance, ..Options::default() }, &takes);
            assert!(energies.iter().all(|e| e.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9))));
            let errors: Vec<f64> = poses.iter().zip(&converged).map(|(a, b)| distance(a, b)).collect();
            for (error, stats) in errors.iter().zip(&stats) {
                let estimate = stats.error.unwrap();
                assert!(*error <= 2.0 * estimate, "{tolerance}: {error} for {estimate}");
            }
            let worst = errors.iter().fold(0.0, |m, e| e.max(m));
            eprintln!("{tolerance:e}: worst vertex {worst:.1e} diagonals");
            assert!(worst < last, "{tolerance}: {worst}");
            last = worst;
        }
    }
}

#[test]
fn a_full_turn_by_frames_ends_where_the_converged_one_does() {
    let (proxy, length) = bar(20);
    let regions = ends(&proxy, length, |vertices| Grip::Region { vertices, beta: 100.0 });
    let twist = (std::f64::consts::TAU, 0.0, 40);
    let last = |tolerance: f64| {
        let options = Options { tolerance, ..Options::default() };
        twist_poses(&proxy, &regions, &options, twist).pop().unwrap()
    };
    let converged = last(1e-9);
    for tolerance in [Options::DRAFT, Options::NORMAL] {
        let error = distance(&last(tolerance), &converged) / length;
        eprintln!("a full turn at {tolerance:e}: {error:.1e} of the length");
        assert!(error < 0.01, "{error}");
    }
}
