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
/// Frames without another attempt after one that found nothing better: each costs as much as many frames.
const WAIT: u32 = 8;

/// Poses to start from, and what the last frames cost.
#[derive(Clone, Debug)]
pub(super) struct Starts {
    /// Rest, then the examples.
    poses: Vec<Vec<DVec3>>,
    /// Where each pull holds them.
    holds: Vec<Vec<DVec3>>,
    energies: Vec<f64>,
    sorted: Vec<f64>,
    next: usize,
    /// Frames that are still to wait.
    waiting: u32,
}

impl Starts {
    pub fn new(body: &Body, pulls: &Pulls) -> Self {
        let rest = body.proxy.rest[..body.vertices()].to_vec();
        let poses: Vec<Vec<DVec3>> = std::iter::once(rest).chain(body.examples.iter().cloned()).collect();
        let hold = |x: &Vec<DVec3>| (0..pulls.attachments.len()).map(|p| pulls.hold(p, x, &body.proxy.boundary)).collect();
        Self {
            holds: poses.iter().map(hold).collect(),
            poses,
            energies: Vec::with_capacity(MEMORY),
            sorted: Vec::with_capacity(MEMORY),
            next: 0,
            waiting: 0,
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
        if self.energies.len() < MEMORY {
            self.energies.push(energy);
        } else {
            self.energies[self.next] = energy;
        }
        self.next = (self.next + 1) % MEMORY;
    }

    /// Whether a frame costs far more than those before it; asked once per frame.
    pub fn leaps(&mut self, energy: f64) -> bool {
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
        &self,
        newton: &mut Newton,
        pulls: &Pulls,
        goals: &Goals<'_>,
        settings: &Settings,
        x: &mut [DVec3],
        weights: &mut [f64],
    ) -> Minimum {
        let mut order: Vec<(usize, f64, Rigid)> = self
            .holds
            .iter()
            .enumerate()
            .map(|(i, holds)| {
                let rigid = Rigid::fit(holds, goals);
                (i, rigid.distance(holds, goals), rigid)
            })
            .collect();
        order.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let mut best: Option<(Minimum, Vec<DVec3>, Vec<f64>)> = None;
        let mut steps = 0;
        for (i, distance, rigid) in order.into_iter().take(MOST) {
            let mut pose: Vec<DVec3> = self.poses[i].iter().map(|p| rigid.apply(*p)).collect();
            let mut shares = vec![0.0; weights.len()];
            if i > 0 {
                shares[i - 1] = 1.0;
            }
            let far = distance > FAR * newton.shell.diagonal;
            let stages = if far { STAGES } else { 1 };
            let from: Vec<DVec3> = (0..goals.positions.len()).map(|p| pulls.hold(p, &pose, &newton.shell.faces)).collect();
            let origin = pose.clone();
            let mut minimum = Minimum::default();
            for stage in 1..=stages {
                let share = f64::from(stage) / f64::from(stages);
                let positions: Vec<DVec3> = from.iter().zip(goals.positions).map(|(a, b)| a.lerp(*b, share)).collect();
                pulls.settle(&mut pose, if stage == stages { None } else { Some((&origin, share)) });
                let cap = if stage == stages { LAST_STEPS } else { STEPS };
                let settings = Settings { steps: cap, ..*settings };
                minimum =
                    newton.minimize(&mut pose, &mut shares, &Goals { positions: &positions, weights: goals.weights }, &settings);
                steps += minimum.steps;
            }
            let better = best.as_ref().is_none_or(|(other, ..)| {
                minimum.energy() < other.energy() || !other.energy().is_finite() && minimum.energy().is_finite()
            });
            if better {
                best = Some((minimum, pose, shares));
            }
        }
        let Some((minimum, pose, shares)) = best else { return Minimum::default() };
        x.copy_from_slice(&pose);
        weights.copy_from_slice(&shares);
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
        let (energies, sorted) = (vec![1.0; MEMORY], Vec::new());
        let mut starts = Starts { poses: Vec::new(), holds: Vec::new(), energies, sorted, next: 0, waiting: 0 };
        assert!(!starts.leaps(9.0) && starts.leaps(11.0));
        starts.wait();
        assert!((0..WAIT).all(|_| !starts.leaps(11.0)));
        assert!(starts.leaps(11.0));
        starts.wait();
        starts.forget();
        starts.energies.resize(MEMORY, 1.0);
        assert!(starts.leaps(11.0));
    }
}
