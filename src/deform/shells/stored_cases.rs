//! Converged answers of an independent implementation in double precision.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::geometry::{diagonal, volume};
use super::newton::{Goals, Grip, Minimum, Newton, Settings, Tension, Weights};
use super::quadratic::Bounds;
use super::shell::{Material, Shell};
use crate::deform::volumetric::stored_poses::cases::{self, Arrays};
use crate::linalg::nearest_rotation;
use glam::{DMat3, DVec3};
use std::path::PathBuf;
use std::time::Instant;

/// Arrays of a stored case, where it is present.
fn read_npz(name: &str) -> Option<Arrays> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = shared.join("bench/shells_cases").join(name);
    let arrays = cases::read_npz(&path);
    if arrays.is_none() {
        eprintln!("skipped: {} is not there", path.display());
    }
    arrays
}

fn points(numbers: &[f64]) -> Vec<DVec3> {
    numbers.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

fn indices(numbers: &[f64]) -> Vec<u32> {
    numbers.iter().map(|x| *x as u32).collect()
}

fn faces(numbers: &[f64]) -> Vec<[u32; 3]> {
    indices(numbers).as_chunks().0.to_vec()
}

fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f64::max)
}

const NO_GOALS: Goals<'_> = Goals { positions: &[], weights: &[] };

const CONVERGED: Settings =
    Settings { steps: 200, decrease: 1e-13, still: 0.0, damping: 1e-9, tension: Tension::WhenNeeded, weights: Weights::Given };

/// A case without examples: its answer, and how far it is from the stored one, in diagonals and in energy.
fn pure(name: &str) -> Option<(Newton, Vec<DVec3>, Minimum, f64, f64)> {
    let case = read_npz(&format!("{name}.npz"))?;
    let [stretching, bending, volume] = case["params"][..].try_into().unwrap();
    let material = Material { stretching, bending, volume, ..Material::PAPER };
    let shell = Shell::new(&points(&case["V"]), &faces(&case["F"]), &[], &material, &[]).unwrap();
    let mut held = vec![false; shell.rest.len()];
    indices(&case["fixed"]).iter().for_each(|&v| held[v as usize] = true);
    let mut newton = Newton::new(shell, &held, Vec::new());
    let mut x = points(&case["X0"]);
    let begin = Instant::now();
    let minimum = newton.minimize(&mut x, &mut [], &NO_GOALS, &Settings { tension: Tension::Always, ..CONVERGED });
    let off = distance(&x, &points(&case["X"])) / diagonal(&newton.shell.rest);
    let energy = minimum.energy() / case["E"][0] - 1.0;
    eprintln!(
        "{name}: {} steps, {:.1} ms each, E {:.9} (stored {:.9}), {off:.1e} D off, {:?}",
        minimum.steps,
        begin.elapsed().as_secs_f64() * 1e3 / f64::from(minimum.steps),
        minimum.energy(),
        case["E"][0],
        minimum.stop
    );
    Some((newton, x, minimum, off, energy))
}

#[test]
fn pure_deformations_reach_the_stored_minima() {
    for (name, off_limit, energy_limit) in [
        ("stretch_novol", 1e-5, 1e-6),
        ("stretch_vol1000", 1e-5, 1e-6),
        ("stretch_vol10lm", 1e-4, 1e-5),
        ("twist_bar_l1", 1e-5, 1e-6),
        ("bend_cylinder_l1", 1e-5, 1e-6),
        ("bumpy_plane_l1", 1e-5, 1e-6),
    ] {
        let Some((_, _, _, off, energy)) = pure(name) else { return };
        assert!(off < off_limit && energy.abs() < energy_limit, "{name}: {off:e} D, {energy:e}");
    }
}

#[test]
fn the_volume_of_a_stretched_cylinder_is_kept_as_well_as_its_weight_says() {
    for (name, percent) in [("stretch_novol", 34.27), ("stretch_vol1000", 31.92), ("stretch_vol10lm", 0.085)] {
        let Some((newton, x, ..)) = pure(name) else { return };
        let ratio = volume(&x, &newton.shell.faces, &[]) / newton.shell.volume;
        assert!((100.0 * (ratio - 1.0) - percent).abs() < 0.01, "{name}: {ratio}");
    }
}

/// One pose moved rigidly onto another.
fn aligned(x: &[DVec3], onto: &[DVec3]) -> Vec<DVec3> {
    let centre = |x: &[DVec3]| x.iter().sum::<DVec3>() / x.len() as f64;
    let (from, to) = (centre(x), centre(onto));
    let mut covariance = DMat3::ZERO;
    for (a, t) in x.iter().zip(onto) {
        let (a, t) = (*a - from, *t - to);
        covariance += DMat3::from_cols(t * a.x, t * a.y, t * a.z);
    }
    let turn = nearest_rotation(covariance, DMat3::IDENTITY);
    x.iter().map(|p| turn * (*p - from) + to).collect()
}

#[test]
fn a_tube_winds_up_to_a_helix_as_stored() {
    let Some(case) = read_npz("helix.npz") else { return };
    let rest = points(&case["V"]);
    let example = points(&case["examples"]);
    let shell = Shell::new(&rest, &faces(&case["F"]), std::slice::from_ref(&example), &Material::PAPER, &[]).unwrap();
    let n = rest.len();
    let mut newton = Newton::new(shell, &vec![false; n], Vec::new());
    let settings = Settings { damping: 1e-7, ..CONVERGED };
    let stored = points(&case["X"]);
    let mut x = rest;
    for (i, &weight) in case["alphas"].iter().enumerate() {
        if weight == 0.75 {
            x.clone_from(&example);
        }
        let minimum = newton.minimize(&mut x, &mut [weight], &NO_GOALS, &settings);
        let stored = &stored[i * n..(i + 1) * n];
        let off = distance(&aligned(&x, stored), stored) / diagonal(&newton.shell.rest);
        let analytic: Vec<DVec3> = points(&case["analytic"])[i * n..(i + 1) * n].to_vec();
        let exact = distance(&aligned(&x, &analytic), &analytic) / diagonal(&newton.shell.rest);
        eprintln!(
            "helix {weight}: {} steps, E {:.8e}, {off:.1e} D off, {:.2} % from the exact helix",
            minimum.steps,
            minimum.energy(),
            100.0 * exact
        );
        if weight == 0.0 || weight == 1.0 {
            assert!(minimum.energy() < 1e-18 && off < 1e-9, "{weight}: {off:e}");
        } else {
            assert!((minimum.energy() / case["E"][i] - 1.0).abs() < 1e-5 && off < 1e-4, "{weight}: {off:e}");
            assert!(exact < 0.025, "{weight}: {exact}");
        }
    }
}

/// The arm with its examples, its handles and their targets per frame.
struct Arm {
    newton: Newton,
    targets: Vec<Vec<DVec3>>,
    weights: Vec<[f64; 2]>,
    /// Stored frames and poses.
    stored: Vec<(usize, Vec<DVec3>)>,
    truth_steps: Vec<f64>,
}

fn arm(rotated: bool) -> Option<Arm> {
    let case = read_npz("arm.npz")?;
    let rest = points(&case["V"]);
    let n = rest.len();
    let all = points(&case["examples"]);
    let mut examples: Vec<Vec<DVec3>> = all.chunks(n).map(<[DVec3]>::to_vec).collect();
    if rotated {
        examples[0] = points(&case["example1_rotated"]);
    }
    let shell = Shell::new(&rest, &faces(&case["F"]), &examples, &Material::PAPER, &[]).unwrap();
    let mut held = vec![false; n];
    indices(&case["fixed"]).iter().for_each(|&v| held[v as usize] = true);
    let count = 1 + case["C_row"].iter().fold(0.0_f64, |m, r| m.max(*r)) as usize;
    let mut grips = vec![Grip::default(); count];
    for ((row, column), value) in case["C_row"].iter().zip(&case["C_col"]).zip(&case["C_val"]) {
        let pull = &mut grips[*row as usize].pull;
        pull.vertices.push(*column as u32);
        pull.values.push(*value);
    }
    let stored = points(&case["X"]);
    Some(Arm {
        newton: Newton::new(shell, &held, grips),
        targets: points(&case["targets"]).chunks(count).map(<[DVec3]>::to_vec).collect(),
        weights: case["alpha"].as_chunks::<2>().0.to_vec(),
        stored: indices(&case["frames_kept"]).iter().zip(stored.chunks(n)).map(|(f, x)| (*f as usize, x.to_vec())).collect(),
        truth_steps: case["iters"].clone(),
    })
}

/// All frames of the arm; the largest distances of weights and poses from the stored ones.
fn run(arm: &mut Arm, settings: &Settings) -> (f64, f64, f64) {
    let mut x = arm.newton.shell.rest.clone();
    let mut weights = [0.0; 2];
    let (mut off_weights, mut off, mut steps) = (0.0_f64, 0.0_f64, 0);
    let pull = vec![1e6 / diagonal(&arm.newton.shell.rest).powi(2); arm.targets[0].len()];
    let begin = Instant::now();
    for (frame, targets) in arm.targets.iter().enumerate() {
        let minimum = arm.newton.minimize(&mut x, &mut weights, &Goals { positions: targets, weights: &pull }, settings);
        steps += minimum.steps;
        let stored = arm.weights[frame];
        off_weights = off_weights.max((weights[0] - stored[0]).abs()).max((weights[1] - stored[1]).abs());
        if let Some((_, pose)) = arm.stored.iter().find(|(f, _)| *f == frame) {
            off = off.max(distance(&x, pose) / diagonal(&arm.newton.shell.rest));
        }
    }
    let mean = f64::from(steps) / arm.targets.len() as f64;
    eprintln!(
        "arm: {mean:.2} steps a frame (stored {:.2}), {:.1} ms each; weights {off_weights:.1e}, poses {off:.1e} D off",
        arm.truth_steps.iter().sum::<f64>() / arm.truth_steps.len() as f64,
        begin.elapsed().as_secs_f64() * 1e3 / f64::from(steps)
    );
    (off_weights, off, mean)
}

#[test]
fn an_arm_finds_the_stored_weights() {
    let free = Settings { weights: Weights::Free { bounds: Bounds::FREE, regularization: 1e-4 }, ..CONVERGED };
    let Some(mut arm) = arm(false) else { return };
    let (weights, off, _) = run(&mut arm, &Settings { steps: 60, decrease: 1e-11, ..free });
    assert!(weights < 1e-4 && off < 1e-4, "{weights:e} {off:e}");
    let (weights, off, _) = run(&mut arm, &Settings { steps: 5, decrease: 1e-9, ..free });
    assert!(weights < 2e-3 && off < 5e-4, "{weights:e} {off:e}");
}

#[test]
fn a_turned_example_finds_the_same_weights() {
    let free = Settings { weights: Weights::Free { bounds: Bounds::FREE, regularization: 1e-4 }, ..CONVERGED };
    let (Some(mut plain), Some(mut turned)) = (arm(false), arm(true)) else { return };
    let mut poses: [Vec<Vec<DVec3>>; 2] = Default::default();
    let mut weights: [Vec<[f64; 2]>; 2] = Default::default();
    for (k, arm) in [&mut plain, &mut turned].into_iter().enumerate() {
        let (mut x, mut w) = (arm.newton.shell.rest.clone(), [0.0; 2]);
        let pull = vec![1e6 / diagonal(&arm.newton.shell.rest).powi(2); arm.targets[0].len()];
        for targets in &arm.targets {
            let goals = Goals { positions: targets, weights: &pull };
            arm.newton.minimize(&mut x, &mut w, &goals, &Settings { steps: 60, decrease: 1e-11, ..free });
            poses[k].push(x.clone());
            weights[k].push(w);
        }
    }
    for frame in 0..weights[0].len() {
        let off = distance(&poses[0][frame], &poses[1][frame]) / diagonal(&plain.newton.shell.rest);
        let apart = (0..2).map(|i| (weights[0][frame][i] - weights[1][frame][i]).abs()).fold(0.0, f64::max);
        assert!(off < 1e-8 && apart < 1e-8, "frame {frame}: {off:e} D, weights {apart:e}");
    }
}

#[test]
fn a_body_finds_a_pose_that_it_has_not_seen() {
    let Some(case) = read_npz("human.npz") else { return };
    let rest = points(&case["V"]);
    let n = rest.len();
    let examples: Vec<Vec<DVec3>> = points(&case["examples"]).chunks(n).map(<[DVec3]>::to_vec).collect();
    let shell = Shell::new(&rest, &faces(&case["F"]), &examples, &Material::WITH_EXAMPLES, &[]).unwrap();
    let count = 1 + case["C_row"].iter().fold(0.0_f64, |m, r| m.max(*r)) as usize;
    let mut grips = vec![Grip::default(); count];
    for ((row, column), value) in case["C_row"].iter().zip(&case["C_col"]).zip(&case["C_val"]) {
        let pull = &mut grips[*row as usize].pull;
        pull.vertices.push(*column as u32);
        pull.values.push(*value);
    }
    let at_rest: Vec<DVec3> = grips.iter().map(|g| g.pull.apply(&rest)).collect();
    let targets = points(&case["targets"])[..count].to_vec();
    let mut newton = Newton::new(shell, &vec![false; n], grips);
    let diagonal = diagonal(&newton.shell.rest);
    let pull = vec![1e6 / diagonal.powi(2); count];
    let (mut x, mut weights) = (rest, vec![0.0; examples.len()]);
    let bounds = Bounds { least: -0.2, most: 1.2 };
    let free = Settings { weights: Weights::Free { bounds, regularization: 1e-4 }, ..CONVERGED };
    let begin = Instant::now();
    let mut steps = 0;
    for stage in 1..=20 {
        let share = f64::from(stage) / 20.0;
        let positions: Vec<DVec3> = at_rest.iter().zip(&targets).map(|(a, b)| a.lerp(*b, share)).collect();
        let settings = if stage < 20 {
            Settings { steps: 4, decrease: 1e-7, ..free }
        } else {
            Settings { steps: 80, decrease: 1e-12, ..free }
        };
        steps += newton.minimize(&mut x, &mut weights, &Goals { positions: &positions, weights: &pull }, &settings).steps;
    }
    let truth = points(&case["truth"])[..n].to_vec();
    let mean = x.iter().zip(&truth).map(|(a, b)| a.distance(*b)).sum::<f64>() / n as f64;
    let off = distance(&x, &points(&case["X"])[..n]) / diagonal;
    let apart = weights.iter().zip(&case["alpha"]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!(
        "T-pose: {:.2} mm from the truth on the mean, {off:.1e} D and {apart:.1e} from the stored answer; {steps} steps of {:.1} ms",
        1e3 * mean,
        begin.elapsed().as_secs_f64() * 1e3 / f64::from(steps)
    );
    assert!(mean < 0.005 && off < 1e-3 && apart < 1e-3, "{mean} {off:e} {apart:e}");
}
