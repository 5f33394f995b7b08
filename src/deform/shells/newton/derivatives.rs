//! Derivatives against differences, and the step against that of the dense equations.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::deform::shells::shapes::{Bend, arm, dice};
use crate::deform::shells::shell::Material;
use crate::linalg::DenseCholesky;

const WEIGHTS: [f64; 2] = [0.3, -0.2];
const FREE: Weights = Weights::Free { bounds: Bounds::FREE, regularization: 1e-4 };
const SETTINGS: Settings =
    Settings { steps: 1, decrease: 0.0, still: 0.0, damping: 1e-9, tension: Tension::WhenNeeded, weights: FREE };

/// An arm, shaken, with pulls on some of its vertices; `open` without its last cap.
fn shaken(open: bool) -> (Newton, Vec<DVec3>) {
    let of = |shoulder, elbow, bulge| arm(15, 8, Bend { shoulder, elbow, bulge });
    let (rest, mut faces) = of(0.0, 0.0, 0.0);
    if open {
        let tip = rest.len() as u32 - 1;
        faces.retain(|f| !f.contains(&tip));
    }
    let examples = [of(0.0, 60.0, 0.2).0, of(40.0, 0.0, 0.0).0];
    let mut random = dice(5);
    let x: Vec<DVec3> = rest.iter().map(|p| *p + 0.04 * (DVec3::new(random(), random(), random()) - 0.5)).collect();
    let pull = |v: u32| Grip { pull: Pull { vertices: vec![v, v + 1], values: vec![0.75, 0.25] }, offsets: Vec::new() };
    let mut held = vec![false; rest.len()];
    held[..8].fill(true);
    let shell = Shell::new(&rest, &faces, &examples, &Material::WITH_EXAMPLES, &[]).unwrap();
    (Newton::new(shell, &held, [20, 60, 90, 110].map(pull).to_vec()), x)
}

/// All residuals: edges, hinges, volume.
fn residuals(newton: &mut Newton, x: &[DVec3], weights: &[f64]) -> Vec<f64> {
    newton.linearize(x, weights);
    let at = &newton.at;
    at.stretch.iter().chain(&at.bend).chain(std::iter::once(&at.swell)).copied().collect()
}

/// The same as rows of derivatives by positions, dense.
fn rows(newton: &Newton) -> Vec<Vec<f64>> {
    let (shell, at) = (&newton.shell, &newton.at);
    let size = 3 * shell.rest.len();
    let mut rows = Vec::new();
    let put = |row: &mut Vec<f64>, v: u32, g: DVec3| {
        let place = 3 * v as usize;
        row[place..place + 3].iter_mut().zip(g.to_array()).for_each(|(r, g)| *r += g);
    };
    for ([a, b], g) in shell.topology.edges.iter().zip(&at.edges) {
        let mut row = vec![0.0; size];
        put(&mut row, *b, *g);
        put(&mut row, *a, -*g);
        rows.push(row);
    }
    for (hinge, g) in shell.topology.hinges.iter().zip(&at.hinges) {
        let mut row = vec![0.0; size];
        hinge.iter().zip(g).for_each(|(&v, g)| put(&mut row, v, *g));
        rows.push(row);
    }
    let mut row = vec![0.0; size];
    at.volume.iter().enumerate().for_each(|(v, g)| put(&mut row, v as u32, *g));
    rows.push(row);
    rows
}

#[test]
fn derivatives_are_those_of_the_residuals() {
    for open in [false, true] {
        let (mut newton, x) = shaken(open);
        residuals(&mut newton, &x, &WEIGHTS);
        let rows = rows(&newton);
        let largest = |range: std::ops::Range<usize>| rows[range].iter().flatten().fold(0.0_f64, |m, g| m.max(g.abs()));
        let (edges, hinges) = (newton.at.stretch.len(), newton.at.bend.len());
        let scales = [largest(0..edges), largest(edges..edges + hinges), largest(edges + hinges..edges + hinges + 1)];
        let scale = |r: usize| {
            if r < edges {
                scales[0]
            } else if r < edges + hinges {
                scales[1]
            } else {
                scales[2]
            }
        };
        let step = 1e-6;
        for v in 0..x.len() {
            for k in 0..3 {
                let at = |sign: f64| {
                    let mut moved = x.clone();
                    moved[v][k] += sign * step;
                    moved
                };
                let (above, below) = (at(1.0), at(-1.0));
                let (above, below) = (residuals(&mut newton, &above, &WEIGHTS), residuals(&mut newton, &below, &WEIGHTS));
                for (r, (a, b)) in above.iter().zip(&below).enumerate() {
                    let difference = (a - b) / (2.0 * step);
                    assert!((difference - rows[r][3 * v + k]).abs() < 1e-6 * scale(r), "residual {r}, vertex {v}: {difference}");
                }
            }
        }
        for i in 0..2 {
            let at = |newton: &mut Newton, sign: f64| {
                let mut weights = WEIGHTS;
                weights[i] += sign * step;
                residuals(newton, &x, &weights)
            };
            let (above, below) = (at(&mut newton, 1.0), at(&mut newton, -1.0));
            let example = &newton.shell.examples[i];
            let column = example.stretch.iter().chain(&example.bend).chain(std::iter::once(&example.swell));
            for ((a, b), derivative) in above.iter().zip(&below).zip(column) {
                assert!(((a - b) / (2.0 * step) - derivative).abs() < 1e-6 * example.curvature.sqrt(), "weight {i}");
            }
        }
    }
}

#[test]
fn gradients_neither_push_nor_turn_and_the_volume_grows_with_the_cube() {
    for open in [false, true] {
        let (mut newton, x) = shaken(open);
        newton.linearize(&x, &WEIGHTS);
        let (shell, at) = (&newton.shell, &newton.at);
        for (hinge, g) in shell.topology.hinges.iter().zip(&at.hinges) {
            let size: f64 = g.iter().map(|g| g.length()).sum();
            let torque: DVec3 = hinge.iter().zip(g).map(|(&v, g)| x[v as usize].cross(*g)).sum();
            assert!(g.iter().sum::<DVec3>().length() < 1e-10 * size && torque.length() < 1e-10 * size);
        }
        let now = volume(&x, &shell.faces, &shell.topology.holes) * shell.swell;
        let along: f64 = x.iter().zip(&at.volume).map(|(p, g)| (*p + DVec3::splat(9.0)).dot(*g)).sum();
        assert!((along / (3.0 * now) - 1.0).abs() < 1e-10, "{}", along / now);
    }
}

#[test]
fn the_step_is_that_of_the_dense_equations() {
    let (mut newton, x) = shaken(false);
    let n = x.len();
    let goals: Vec<DVec3> = newton.pulls.iter().map(|p| p.apply(&x) + DVec3::new(0.02, -0.01, 0.03)).collect();
    let pull_weights = [700.0, 0.0, 900.0, 800.0];
    newton.linearize(&x, &WEIGHTS);
    newton.force(&x, &Goals { positions: &goals, weights: &pull_weights });
    newton.system.load(&newton.shell, &newton.at, &newton.pulls, &newton.forces, true);
    let unknown = Unknown { weights: &WEIGHTS, bounds: Bounds::FREE, regularization: 1e-4 };
    let Newton { system, shell, at, directions, .. } = &mut newton;
    system.direction(shell, at, &pull_weights, false, 1e-9, Some(&unknown), &mut directions[0]).unwrap();
    // Everything in one dense matrix, with the held vertices left out.
    let free: Vec<usize> = (24..3 * n).collect();
    let size = free.len() + 2;
    let mut all: Vec<(Vec<f64>, f64)> = Vec::new();
    let examples = &newton.shell.examples;
    let residuals = newton.at.stretch.iter().chain(&newton.at.bend).chain(std::iter::once(&newton.at.swell));
    for (r, (row, residual)) in rows(&newton).iter().zip(residuals).enumerate() {
        let column = |e: &crate::deform::shells::shell::Example| -> f64 {
            let edges = e.stretch.len();
            if r < edges { e.stretch[r] } else { e.bend.get(r - edges).copied().unwrap_or(e.swell) }
        };
        let row: Vec<f64> = free.iter().map(|&c| row[c]).chain(examples.iter().map(column)).collect();
        all.push((row, *residual));
    }
    for ((pull, goal), weight) in newton.pulls.iter().zip(&goals).zip(pull_weights) {
        for k in 0..3 {
            let mut row = vec![0.0; size];
            pull.vertices.iter().zip(&pull.values).for_each(|(&v, c)| row[3 * v as usize + k - 24] = c * weight.sqrt());
            all.push((row, weight.sqrt() * (pull.apply(&x)[k] - goal[k])));
        }
    }
    for i in 0..2 {
        let mut row = vec![0.0; size];
        let root = (1e-4 * examples[i].curvature).sqrt();
        row[free.len() + i] = root;
        all.push((row, root * WEIGHTS[i]));
    }
    let mut right = vec![0.0; size];
    let mut dense = DenseCholesky::with_capacity(size);
    let matrix = dense.refill(size);
    for (row, residual) in &all {
        let entries: Vec<(usize, f64)> = row.iter().copied().enumerate().filter(|(_, v)| *v != 0.0).collect();
        for &(j, b) in &entries {
            right[j] -= b * residual;
            for &(i, a) in entries.iter().filter(|(i, _)| *i >= j) {
                matrix[j * size + i] += a * b;
            }
        }
    }
    assert!(dense.factor());
    dense.solve(&mut right);
    let direction = &newton.directions[0];
    let largest = right.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
    for (&c, expected) in free.iter().zip(&right) {
        let found = direction.moves[c / 3][c % 3];
        assert!((found - expected).abs() < 1e-6 * largest, "{c}: {found} {expected}");
    }
    for (found, expected) in direction.weights.iter().zip(&right[free.len()..]) {
        assert!((found - expected).abs() < 1e-6 * largest, "{found} {expected}");
    }
    assert!(direction.moves[..8].iter().all(|m| *m == DVec3::ZERO));
}

#[test]
fn no_step_leads_upwards() {
    let (mut newton, start) = shaken(false);
    let goals = [DVec3::new(0.5, 0.6, 0.0), DVec3::new(1.5, 0.3, 0.2), DVec3::new(2.0, -0.5, 0.0), DVec3::new(2.2, 1.0, 0.3)];
    let goals = Goals { positions: &goals, weights: &[1e4; 4] };
    let (mut x, mut weights) = (start, WEIGHTS);
    let mut last = f64::INFINITY;
    for _ in 0..40 {
        let minimum = newton.minimize(&mut x, &mut weights, &goals, &SETTINGS);
        assert!(minimum.energy() <= last, "{} after {last}", minimum.energy());
        last = minimum.energy();
    }
    assert!(last.is_finite());
}

#[test]
fn a_point_off_a_triangle_moves_as_its_derivatives_say() {
    let mut random = dice(11);
    let x: Vec<DVec3> = (0..3).map(|_| DVec3::new(random(), random(), random())).collect();
    let step = 1e-6;
    for (v, derivative) in outwards_derivative(&x, [0, 1, 2]).into_iter().enumerate() {
        for k in 0..3 {
            let at = |sign: f64| {
                let mut moved = x.clone();
                moved[v][k] += sign * step;
                outwards(&moved, [0, 1, 2])
            };
            let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
            assert!(difference.distance(derivative.col(k)) < 1e-8, "{v} {k}: {difference} {}", derivative.col(k));
        }
    }
}
