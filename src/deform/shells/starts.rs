//! Where a take begins, and begins anew: rest and the examples are tried.

use super::body::Body;
use super::newton::{Goals, Minimum, Newton, Settings};
use super::pulls::Pulls;
use crate::linalg::nearest_rotation;
use glam::{DMat3, DVec3};

/// Mean distance of the handles from their targets, in diagonals, from which targets are approached in stages.
const FAR: f64 = 0.05;
/// Stages on the way to targets that are far.
const STAGES: u32 = 6;
/// Steps in each stage, and at its end.
const STEPS: u32 = 4;
const LAST_STEPS: u32 = 40;
/// Starts that are tried, those nearest to the targets.
const MOST: usize = 8;
/// Frames whose energy is remembered.
const MEMORY: usize = 20;
/// Multiple of their median from which a frame has leapt into another valley, and the least energy of which that is said.
const LEAP: f64 = 10.0;
const NOTHING: f64 = 10.0;
/// Multiple of the energy of the frame before that is still its own.
const HARDLY_MORE: f64 = 1.01;
/// Frames without another attempt after one that found nothing better: each costs as much as many frames.
const WAIT: u32 = 8;

/// Poses to start from, what the last frames cost, and the memory of an attempt.
#[derive(Clone, Debug, Default)]
pub(super) struct Starts {
    /// Rest, then the examples.
    poses: Vec<Vec<DVec3>>,
    /// Where each pull holds them.
    holds: Vec<Vec<DVec3>>,
    energies: Vec<f64>,
    sorted: Vec<f64>,
    next: usize,
    /// That of the frame before.
    last: f64,
    /// Frames that are still to wait.
    waiting: u32,
    /// Poses by their distances from the targets, and what moves them there.
    order: Vec<(usize, f64, Rigid)>,
    trial: Trial,
    best: Trial,
    /// A pose before its first stage, where the pulls hold it, and where they shall be in a stage.
    origin: Vec<DVec3>,
    from: Vec<DVec3>,
    positions: Vec<DVec3>,
}

/// A pose with its weights.
#[derive(Clone, Debug, Default)]
struct Trial {
    x: Vec<DVec3>,
    weights: Vec<f64>,
}

impl Trial {
    fn copy_from(&mut self, x: &[DVec3], weights: &[f64]) {
        self.x.clear();
        self.x.extend_from_slice(x);
        self.weights.clear();
        self.weights.extend_from_slice(weights);
    }
}

impl Starts {
    pub fn new(body: &Body, pulls: &Pulls) -> Self {
        let rest = body.proxy.rest[..body.vertices()].to_vec();
        let trial = Trial { x: rest.clone(), weights: vec![0.0; body.examples.len()] };
        let poses: Vec<Vec<DVec3>> = std::iter::once(rest.clone()).chain(body.examples.iter().cloned()).collect();
        let hold = |x: &Vec<DVec3>| (0..pulls.attachments.len()).map(|p| pulls.hold(p, x, &body.proxy.boundary)).collect();
        Self {
            holds: poses.iter().map(hold).collect(),
            energies: Vec::with_capacity(MEMORY),
            sorted: Vec::with_capacity(MEMORY),
            next: 0,
            last: f64::INFINITY,
            waiting: 0,
            order: Vec::with_capacity(poses.len()),
            best: trial.clone(),
            trial,
            origin: rest,
            from: pulls.attachments.clone(),
            positions: pulls.attachments.clone(),
            poses,
        }
    }

    /// What came before has nothing to do with what comes.
    pub fn forget(&mut self) {
        self.energies.clear();
        self.next = 0;
        self.waiting = 0;
    }

    /// Nothing better was found: says of the next frames that they do not leap.
    pub fn wait(&mut self) {
        self.waiting = WAIT;
    }

    /// Remembers what a frame cost.
    pub fn note(&mut self, energy: f64) {
        self.last = energy;
        if self.energies.len() < MEMORY {
            self.energies.push(energy);
        } else {
            self.energies[self.next] = energy;
        }
        self.next = (self.next + 1) % MEMORY;
    }

    /// Whether a frame costs far more than those before it; asked once per frame. `still`: whether the targets do not move; then one that costs no more
    /// than the frame before has been judged.
    pub fn leaps(&mut self, energy: f64, still: bool) -> bool {
        if still && energy <= HARDLY_MORE * self.last {
            return false;
        }
        if self.waiting > 0 {
            self.waiting -= 1;
            return false;
        }
        if self.energies.len() < MEMORY / 2 {
            return false;
        }
        self.sorted.clear();
        self.sorted.extend_from_slice(&self.energies);
        self.sorted.sort_unstable_by(f64::total_cmp);
        energy > NOTHING.max(LEAP * self.sorted[self.sorted.len() / 2])
    }

    /// Solves from each pose, moved rigidly onto the targets, and leaves the answer of least energy in `x` and `weights`.
    pub fn best(
        &mut self,
        newton: &mut Newton,
        pulls: &Pulls,
        goals: &Goals<'_>,
        settings: &Settings,
        x: &mut [DVec3],
        weights: &mut [f64],
    ) -> Minimum {
        self.order.clear();
        for (i, holds) in self.holds.iter().enumerate() {
            let rigid = Rigid::fit(holds, goals);
            self.order.push((i, rigid.distance(holds, goals), rigid));
        }
        self.order.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let mut best: Option<Minimum> = None;
        let mut steps = 0;
        for k in 0..self.order.len().min(MOST) {
            let (i, distance, rigid) = self.order[k];
            self.trial.copy_from(&self.poses[i], weights);
            self.trial.x.iter_mut().for_each(|p| *p = rigid.apply(*p));
            self.trial.weights.fill(0.0);
            if i > 0 {
                self.trial.weights[i - 1] = 1.0;
            }
            let minimum = self.approach(newton, pulls, goals, settings, distance);
            steps += minimum.steps;
            let better = best.is_none_or(|other| {
                minimum.energy() < other.energy() || !other.energy().is_finite() && minimum.energy().is_finite()
            });
            if better {
                best = Some(minimum);
                self.best.copy_from(&self.trial.x, &self.trial.weights);
            }
        }
        let Some(minimum) = best else { return Minimum::default() };
        x.copy_from_slice(&self.best.x);
        weights.copy_from_slice(&self.best.weights);
        Minimum { steps, ..minimum }
    }

    /// Solves the trial, in stages where the targets are far.
    fn approach(&mut self, newton: &mut Newton, pulls: &Pulls, goals: &Goals<'_>, settings: &Settings, distance: f64) -> Minimum {
        let stages = if distance > FAR * newton.shell.size { STAGES } else { 1 };
        let Trial { x, weights } = &mut self.trial;
        self.origin.copy_from_slice(x);
        self.from.clear();
        self.from.extend((0..goals.positions.len()).map(|p| pulls.hold(p, x, &newton.shell.faces)));
        let (mut minimum, mut steps) = (Minimum::default(), 0);
        for stage in 1..=stages {
            let share = f64::from(stage) / f64::from(stages);
            self.positions.clear();
            self.positions.extend(self.from.iter().zip(goals.positions).map(|(a, b)| a.lerp(*b, share)));
            pulls.settle(x, if stage == stages { None } else { Some((&self.origin, share)) });
            let cap = if stage == stages { LAST_STEPS } else { STEPS };
            let goals = Goals { positions: &self.positions, weights: goals.weights };
            minimum = newton.minimize(x, weights, &goals, &Settings { steps: cap, ..*settings });
            steps += minimum.steps;
        }
        Minimum { steps, ..minimum }
    }
}

/// A turn and a shift.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rigid {
    turn: DMat3,
    from: DVec3,
    to: DVec3,
}

impl Rigid {
    /// Moves points nearest to goals, each by its weight.
    pub fn fit(points: &[DVec3], goals: &Goals<'_>) -> Self {
        let all = || points.iter().zip(goals.positions).zip(goals.weights).filter(|(_, w)| **w > 0.0);
        let total: f64 = all().map(|(_, w)| w).sum();
        if total <= 0.0 {
            return Self { turn: DMat3::IDENTITY, from: DVec3::ZERO, to: DVec3::ZERO };
        }
        let from = all().map(|((p, _), w)| *p * *w).sum::<DVec3>() / total;
        let to = all().map(|((_, t), w)| *t * *w).sum::<DVec3>() / total;
        let mut covariance = DMat3::ZERO;
        for ((p, t), w) in all() {
            let (p, t) = ((*p - from) * (*w / total), *t - to);
            covariance += DMat3::from_cols(t * p.x, t * p.y, t * p.z);
        }
        Self { turn: nearest_rotation(covariance, DMat3::IDENTITY), from, to }
    }

    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.turn * (p - self.from) + self.to
    }

    /// Mean distance of the moved points from their goals.
    fn distance(&self, points: &[DVec3], goals: &Goals<'_>) -> f64 {
        let all = points.iter().zip(goals.positions).zip(goals.weights).filter(|(_, w)| **w > 0.0);
        let (sum, count) = all.fold((0.0, 0), |(sum, count), ((p, t), _)| (sum + self.apply(*p).distance(*t), count + 1));
        sum / f64::from(count.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_vain_attempt_some_frames_pass_before_the_next() {
        let mut starts = Starts { energies: vec![1.0; MEMORY], ..Starts::default() };
        assert!(!starts.leaps(9.0, false) && starts.leaps(11.0, false));
        starts.wait();
        assert!((0..WAIT).all(|_| !starts.leaps(11.0, false)));
        assert!(starts.leaps(11.0, false));
        starts.wait();
        starts.forget();
        starts.energies.resize(MEMORY, 1.0);
        assert!(starts.leaps(11.0, false));
        // Held still, a body that has not leapt does not begin to.
        starts.note(11.0);
        assert!(!starts.leaps(11.0, true) && starts.leaps(12.0, true));
    }
}
