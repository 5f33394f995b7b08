//! The first frame, which nothing leads to.
//!
//! Parts with enough handles are put where these fit best. Otherwise the body goes from rest to the targets in small steps, its joints bent a little
//! beforehand: a straight chain pulled along itself is singular. Which way a limb bends is decided by that, so several are tried.

use super::solve::{Drag, Solved, Solver, State};
use super::tree::Tree;
use crate::linalg::{NotPositive, nearest_rotation};
use glam::{DMat3, DVec3};

/// Shares of the way to the middle of their ranges by which joints are bent.
const BENDS: [f64; 3] = [0.3, 0.5, 0.7];
/// Steps from rest to the targets, and Gauss–Newton steps in each.
const WAY: u32 = 20;
const STEPS: u32 = 5;
/// How strongly turns stay near those of the step before, at most: this way takes no time.
const STAY: f64 = 0.3;
/// Steps at the end.
const LAST: u32 = 60;
/// Energy per handle, in squared tenths of the diagonal times the weight, below which a start is as good as it gets.
const GOOD: f64 = 1e-7;

/// A state that fits the targets of a first frame.
pub(super) fn start(
    solver: &mut Solver,
    tree: &Tree,
    targets: &[DVec3],
    presence: &[f64],
    stay: f64,
    tolerance: f64,
) -> Result<(State, Solved), NotPositive> {
    let mut best: Option<(f64, State, Solved)> = None;
    let mut steps = 0;
    let bends = BENDS.map(Some);
    for bend in [None].into_iter().chain(bends) {
        let result = match bend {
            None => by_parts(solver, tree, targets, presence, tolerance),
            Some(bend) => by_steps(solver, tree, targets, presence, stay, bend, tolerance).map(Some),
        };
        // A way that ends nowhere is no way.
        let Ok(Some((mut state, solved))) = result else { continue };
        steps += solved.steps;
        let before = state.pose.clone();
        let energy = solver.energy(&mut state, targets, presence, &before);
        if energy.is_finite() && best.as_ref().is_none_or(|b| energy < b.0) {
            best = Some((energy, state, solved));
        }
        let handles = presence.iter().sum::<f64>().max(1.0);
        if best.as_ref().is_some_and(|b| b.0 < GOOD * handles * solver.weights.position) {
            break;
        }
    }
    let (energy, mut state, mut solved) = best.ok_or(NotPositive)?;
    if !solved.settled(tolerance) {
        // What the targets leave open wandered.
        let before = state.pose.clone();
        solved = solver.solve(&mut state, targets, presence, &before, Drag::all(stay), LAST, tolerance)?;
        steps += solved.steps;
    }
    Ok((state, Solved { steps, energy, ..solved }))
}

/// Parts where their handles fit best, the others carried along by their joints; `None` where no part has enough handles.
fn by_parts(
    solver: &mut Solver,
    tree: &Tree,
    targets: &[DVec3],
    presence: &[f64],
    tolerance: f64,
) -> Result<Option<(State, Solved)>, NotPositive> {
    let mut state = solver.rest();
    let rest = state.pose.clone();
    let count = solver.model.variables();
    let mut of_variable: Vec<Vec<(DVec3, DVec3)>> = vec![Vec::new(); count];
    for (k, hold) in solver.holds.iter().enumerate() {
        if presence[k] > 0.0
            && let [(v, share, _)] = hold[..]
            && (share - 1.0).abs() < 1e-9
        {
            of_variable[v].push((rest.hold(hold), targets[k]));
        }
    }
    let fits: Vec<Option<(DMat3, DVec3)>> = of_variable.iter().map(|pairs| fit(pairs)).collect();
    if fits.iter().all(Option::is_none) {
        return Ok(None);
    }
    let moved = |(turn, shift): (DMat3, DVec3), v: usize| (turn, turn * solver.model.origins[v] + shift);
    // Known parts first; the motion of the nearest known neighbour for the others.
    let mut known: Vec<Option<(DMat3, DVec3)>> = fits;
    tree.spread(&solver.model, &mut known);
    for (v, fit) in known.iter().enumerate() {
        if let Some(fit) = *fit {
            (state.pose.turns[v], state.pose.places[v]) = moved(fit, v);
        }
    }
    let before = state.pose.clone();
    let solved = solver.solve(&mut state, targets, presence, &before, Drag::all(1e-6), LAST, tolerance)?;
    Ok(Some((state, solved)))
}

/// From rest, turned and shifted as a whole, in small steps.
fn by_steps(
    solver: &mut Solver,
    tree: &Tree,
    targets: &[DVec3],
    presence: &[f64],
    stay: f64,
    bend: f64,
    tolerance: f64,
) -> Result<(State, Solved), NotPositive> {
    let drag = Drag::all(stay.min(STAY));
    let mut state = solver.rest();
    // Rows of directions are no places.
    let is_place = |k: usize| (solver.holds[k].iter().map(|h| h.1).sum::<f64>() - 1.0).abs() < 1e-9;
    let pairs: Vec<(DVec3, DVec3)> = (0..targets.len())
        .filter(|&k| presence[k] > 0.0 && is_place(k))
        .map(|k| (state.pose.hold(&solver.holds[k]), targets[k]))
        .collect();
    let (turn, shift) = fit(&pairs).unwrap_or_else(|| (DMat3::IDENTITY, mean_shift(&pairs)));
    for v in 0..solver.model.variables() {
        state.pose.turns[v] = turn;
        state.pose.places[v] = turn * solver.model.origins[v] + shift;
    }
    tree.forward(&solver.model, &mut state.pose, |link| {
        let Some((lo, hi)) = link.angle else { return 0.0 };
        let nearest = 0.0_f64.clamp(lo, hi);
        nearest + bend * (0.5 * (lo + hi) - nearest)
    });
    let from: Vec<DVec3> = solver.holds.iter().map(|hold| state.pose.hold(hold)).collect();
    let mut way = from.clone();
    let mut before = state.pose.clone();
    let mut all = 0;
    for k in 1..=WAY {
        let share = f64::from(k) / f64::from(WAY);
        for ((at, from), to) in way.iter_mut().zip(&from).zip(targets) {
            *at = from.lerp(*to, share);
        }
        all += solver.solve(&mut state, &way, presence, &before, drag, STEPS, tolerance)?.steps;
        before.set(&state.pose);
    }
    let solved = solver.solve(&mut state, targets, presence, &before, drag, LAST, tolerance)?;
    Ok((state, Solved { steps: all + solved.steps, ..solved }))
}

fn mean_shift(pairs: &[(DVec3, DVec3)]) -> DVec3 {
    pairs.iter().map(|(p, q)| *q - *p).sum::<DVec3>() / pairs.len().max(1) as f64
}

/// The rigid motion nearest to pairs of places; `None` for fewer than three that are not on a line.
fn fit(pairs: &[(DVec3, DVec3)]) -> Option<(DMat3, DVec3)> {
    let count = pairs.len() as f64;
    let (p0, q0) = pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(a, b), (p, q)| (a + *p / count, b + *q / count));
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    let covariance = pairs.iter().fold(DMat3::ZERO, |sum, (p, q)| sum + outer(*q - q0, *p - p0));
    let spread = pairs.iter().fold(DMat3::ZERO, |sum, (p, _)| sum + outer(*p - p0, *p - p0));
    let (values, _) = crate::linalg::eigen::symmetric(spread.to_cols_array_2d());
    if pairs.len() < 3 || values[1] < 1e-6 * values[2] || values[2] <= 0.0 {
        return None;
    }
    let turn = nearest_rotation(covariance, DMat3::IDENTITY);
    Some((turn, q0 - turn * p0))
}

impl Tree {
    /// Gives the motion of the nearest neighbour along the joints to variables without one.
    fn spread(&self, model: &super::model::Model, known: &mut [Option<(DMat3, DVec3)>]) {
        let pairs: Vec<(usize, usize)> =
            model.links.iter().map(|l| (l.a, l.b)).chain(model.strains.iter().map(|s| (s.a, s.b))).collect();
        loop {
            let before = known.to_vec();
            let mut changed = false;
            for &(a, b) in &pairs {
                for (from, to) in [(a, b), (b, a)] {
                    if known[to].is_none() && before[from].is_some() {
                        known[to] = before[from];
                        changed = true;
                    }
                }
            }
            if !changed {
                break;
            }
        }
        // What hangs together with nothing known moves as the whole does.
        let first = known.iter().flatten().next().copied();
        known.iter_mut().filter(|k| k.is_none()).for_each(|k| *k = first);
    }
}
