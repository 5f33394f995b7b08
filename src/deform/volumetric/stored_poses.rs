//! Poses that an independent implementation in double precision converged to, kept as `.npz` files outside the repository; skipped without them.
//!
//! They live under `bench/cases` of the folder that `RETARGET_SHARED` names, else of `../shared`.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

#[path = "../../../tests/common/cases.rs"]
pub(crate) mod cases;

use super::{Options, Volumetric};
use crate::deform::{Deformer, FrameStats, Targets};
use cases::Case as Stored;
use glam::{DQuat, DVec3};
use std::path::PathBuf;
use std::time::Instant;

/// A stored case with a deformer.
struct Case {
    deformer: Volumetric,
    stored: Stored,
}

/// A case by name.
fn case(name: &str, options: &Options) -> Option<Case> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = shared.join("bench/cases").join(format!("{name}.npz"));
    let Some(stored) = Stored::read(&path) else {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    };
    let deformer = stored.deformer(options);
    Some(Case { deformer, stored })
}

/// A deformer with the handles of a case, their targets at rest, and the diagonal.
pub(super) fn at_rest(name: &str, options: &Options) -> Option<(Volumetric, Targets, f64)> {
    let Case { deformer, stored } = case(name, options)?;
    Some((deformer, stored.at_rest().0, stored.diagonal))
}

/// The same with the handles where the last frame has them.
pub(super) fn posed(name: &str, options: &Options) -> Option<(Volumetric, Targets, f64)> {
    let Case { mut deformer, mut stored } = case(name, options)?;
    deformer.place(stored.placements.last().unwrap()).unwrap();
    Some((deformer, stored.targets.pop().unwrap(), stored.diagonal))
}

/// Solves all frames in order; returns the measures of each and, for the stored ones, distances of all vertices in diagonals and the energy's excess.
fn run(case: &mut Case) -> (Vec<FrameStats>, Vec<Vec<f64>>, Vec<f64>) {
    let (mut all, mut distances, mut excess) = (Vec::new(), Vec::new(), Vec::new());
    let mut time = 0.0;
    let Case { deformer, stored } = case;
    for frame in 0..stored.targets.len() {
        let begin = Instant::now();
        let stats = stored.solve(deformer, frame, frame == 0);
        if frame > 2 {
            time += begin.elapsed().as_secs_f64();
        }
        let energies = deformer.energies();
        assert!(energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "frame {frame}: {energies:?}");
        all.push(stats);
        if let Some((_, pose, energy)) = stored.stored.iter().find(|s| s.0 == frame) {
            distances.push(pose.iter().zip(deformer.pose()).map(|(a, b)| a.distance(*b) / stored.diagonal).collect());
            excess.push(stats.energy / energy - 1.0);
        }
    }
    let warm = &all[3..];
    eprintln!(
        "{:.2} ms and {:.1} passes per frame, at most {}; first frame {}",
        time * 1e3 / warm.len() as f64,
        warm.iter().map(|s| f64::from(s.passes)).sum::<f64>() / warm.len() as f64,
        warm.iter().map(|s| s.passes).max().unwrap(),
        all[0].passes,
    );
    (all, distances, excess)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn the_stored_walk_is_reached_when_converged() {
    let options = Options { tolerance: 1e-8, sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
    let Some(mut case) = case("human_walk", &options) else { return };
    let (stats, distances, excess) = run(&mut case);
    let worst = largest(&distances.iter().map(|d| largest(d)).collect::<Vec<_>>());
    eprintln!("worst {worst:.1e} diagonals, energy {:.1e}", largest(&excess));
    assert!(worst < 1e-5, "{worst}");
    // The stored energy at rest is rounding.
    assert!(excess[1..].iter().all(|e| e.abs() < 1e-6), "{excess:?}");
    assert!(stats.iter().all(|s| s.converged));
}

#[test]
fn the_default_tolerance_is_a_fifth_of_a_millimetre_of_the_stored_walk() {
    let options = Options { sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
    let Some(mut case) = case("human_walk", &options) else { return };
    let (stats, distances, _) = run(&mut case);
    let mut all: Vec<f64> = distances[1..].concat();
    all.sort_by(f64::total_cmp);
    let millimetres = |d: f64| d * case.stored.diagonal * 1e3;
    let (p99, max) = (millimetres(all[all.len() * 99 / 100]), millimetres(*all.last().unwrap()));
    eprintln!("p99 {p99:.3} mm, max {max:.3} mm, inverted {:?}", stats.iter().map(|s| s.inverted).max());
    assert!(p99 < 0.2 && max < 0.5, "{p99} {max}");
    assert!(stats[3..].iter().map(|s| s.passes).max() < Some(25));
}

#[test]
fn stored_poses_with_given_vertices_are_reached() {
    for (name, tolerance) in [("bar_twist135", 1e-6), ("bar_twist360", 1e-6), ("bar_bend120", 1e-6), ("spot_head_turn", 1e-5)] {
        let options = Options { tolerance: 1e-8, sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
        let Some(mut case) = case(name, &options) else { return };
        let (stats, distances, excess) = run(&mut case);
        let worst = largest(&distances.iter().map(|d| largest(d)).collect::<Vec<_>>());
        eprintln!("{name}: worst {worst:.1e} diagonals, energy {:.1e}", largest(&excess[1..]));
        assert!(worst < tolerance, "{name}: {worst}");
        assert!(excess[1..].iter().all(|e| e.abs() < 1e-5), "{name}: {excess:?}");
        assert!(distances.len() > 4 && stats.iter().all(|s| s.converged), "{name}");
    }
}

#[test]
fn five_iterations_agree_with_another_implementation() {
    // The same system in quasi-definite form, [L Bᵀ; B −W⁻¹], which permuted vertices change by 1e-15. The reference factors L + Bᵀ W B: its rows, with
    // coefficients up to 92 and a thousandfold weight, leave it no more than eight digits, and it is 2.5e-8 diagonals away.
    let walk = [
        (0, [-0.012064648654785796, 0.7029449615191963, 0.7850063172145174]),
        (1000, [-0.037519442605808306, -0.02035836349071768, 0.7530959607142614]),
        (2000, [0.25603866625300337, 0.33959915829678006, 0.6643945696631174]),
        (3600, [0.010258112925755717, 0.08697094103357163, 0.7458793299896033]),
    ];
    let off = |case: &Case, expected: &[(usize, [f64; 3])]| {
        let far = |(v, place): &(usize, [f64; 3])| case.deformer.pose()[*v].distance(DVec3::from_array(*place));
        expected.iter().map(far).fold(0.0, f64::max) / case.stored.diagonal
    };
    let options = |interpolate_above: f64| Options {
        iterations: Some(5),
        sliver_cap: f64::INFINITY,
        interpolate_above,
        ..Default::default()
    };
    // From rest, without the rigid alignment that a start makes.
    let Some(mut human) = case("human_walk", &options(f64::INFINITY)) else { return };
    human.deformer.start(&human.stored.at_rest().0).unwrap();
    human.deformer.step(&human.stored.targets[11]).unwrap();
    let error = off(&human, &walk);
    eprintln!("human, frame 11 from rest: {error:.1e} diagonals");
    assert!(error < 1e-9, "{error}");
    let (with, without) = (
        [
            (300, [0.3982315314493835, 0.18720647594503836, 0.016226173203179442]),
            (411, [0.5500456898174592, 0.09182077282738735, 0.11559194804121001]),
            (452, [0.600000023747067, 0.15686022052439785, 0.1381969439677002]),
            (603, [0.8002124519424986, 0.09558561209773174, 0.19654942626146082]),
        ],
        [
            (300, [0.41041311197015207, 0.10020764141216443, -5.2668785400652525e-05]),
            (411, [0.5648874710441384, 0.09975873470265664, 0.14977612119823178]),
            (452, [0.6163553093900864, 0.15039541971353726, 0.10035763581303553]),
            (603, [0.8217965933947409, 0.19739527065880022, 0.15675532351674437]),
        ],
    );
    for (interpolate_above, expected) in [(0.1, with), (f64::INFINITY, without)] {
        let mut bar = case("bar_twist135", &options(interpolate_above)).unwrap();
        let no_points = Targets::default();
        let mut placements = bar.stored.at_rest().1;
        bar.deformer.place(&placements).unwrap();
        bar.deformer.start(&no_points).unwrap();
        placements[1].orientation = DQuat::from_rotation_x(135_f64.to_radians());
        bar.deformer.place(&placements).unwrap();
        bar.deformer.step(&no_points).unwrap();
        let error = off(&bar, &expected);
        eprintln!("bar, 135° in one jump: {error:.1e} diagonals");
        assert!(error < 1e-9, "{error}");
    }
}
