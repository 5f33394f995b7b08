//! Damped Gauss–Newton over rigid motions.
//!
//! Every step is taken: with joints as stiff penalties the way down is a narrow curved valley, and steps that had to lower the energy would crawl.

use super::coordinates::{Coordinates, Limits, Violation};
use super::model::Model;
use super::rows::{self, Hold, Pose, Weights};
use super::system::{Part, System};
use super::told::Told;
use crate::linalg::NotPositive;
use glam::{DMat3, DQuat, DVec3};

/// The largest turn of a variable in one step, radians: the step is shortened as a whole. Rows are linear in turns only nearby.
const LARGEST_TURN: f64 = 1.0;

/// Steps that are taken in full at first.
const FULL: u32 = 3;

/// How strongly a variable stays as it was turned, against how strongly a joint does.
const WHOLE: f64 = 0.01;

/// What is solved, and its buffers: a step allocates nothing.
#[derive(Debug)]
pub(super) struct Solver {
    pub(super) model: Model,
    pub(super) weights: Weights,
    pub(super) holds: Vec<Hold>,
    /// Hardness of each handle.
    pub(super) betas: Vec<f64>,
    /// Points that do not go below the ground.
    soles: Vec<Hold>,
    system: System,
    told: Told,
    parts: Vec<Part<DMat3>>,
    planes: Vec<Part<DVec3>>,
}

/// How joints stay turned as in the frame before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drag {
    /// Against a handle.
    pub(super) weight: f64,
    /// Share of it that joints feel which handles tell well.
    pub(super) light: f64,
    /// Turns up to this, in radians, feel no more than that.
    pub(super) free: f64,
}

impl Drag {
    /// All joints feel all of it.
    pub(super) fn all(weight: f64) -> Self {
        Self { weight, light: 1.0, free: 0.0 }
    }
}

/// How strongly slides stay as in the frame before, against a handle: hardly, but nothing else may hold them.
const SLIDE: f64 = 1e-4;

/// What is carried from step to step and from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct State {
    pub(super) pose: Pose,
    /// Last angle of each joint, unwrapped.
    pub(super) angles: Vec<f64>,
    /// Limits that hold.
    pub(super) limits: Vec<Limits>,
    /// Soles that are on the ground.
    pub(super) grounded: Vec<bool>,
}

/// How a solve went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Solved {
    pub(super) steps: u32,
    /// Largest entry of the last step: of a turn matrix, or of a place.
    pub(super) moved: f64,
    /// Whether the last step let go of a limit or of the ground.
    pub(super) released: bool,
    pub(super) energy: f64,
}

impl Solved {
    pub(super) fn settled(&self, tolerance: f64) -> bool {
        self.moved < tolerance && !self.released
    }
}

impl Solver {
    pub(super) fn new(model: Model, holds: Vec<Hold>, betas: Vec<f64>, weights: Weights) -> Result<Self, NotPositive> {
        let variables = |hold: &Hold| hold.iter().map(|h| h.0 as u32).collect::<Vec<u32>>();
        let points = model.ground.iter().flat_map(|ground| &ground.points);
        let soles: Vec<Hold> = points.map(|&(part, place)| Model::holds(&model.row(part, place))).collect();
        let mut groups: Vec<Vec<u32>> = holds.iter().chain(&soles).map(variables).collect();
        groups.extend(model.links.iter().map(|l| vec![l.a as u32, l.b as u32]));
        groups.extend(model.strains.iter().map(|s| vec![s.a as u32, s.b as u32]));
        let system = System::new(model.variables(), &groups)?;
        let told = Told::new(&model, &holds);
        Ok(Self { model, weights, told, holds, betas, soles, system, parts: Vec::new(), planes: Vec::new() })
    }

    /// The rest pose.
    pub(super) fn rest(&self) -> State {
        State {
            pose: Pose { turns: vec![DMat3::IDENTITY; self.model.variables()], places: self.model.origins.clone() },
            angles: vec![0.0; self.model.links.len()],
            limits: vec![Limits::default(); self.model.links.len()],
            grounded: vec![false; self.soles.len()],
        }
    }

    /// Entries of the factor.
    pub(super) fn entries(&self) -> usize {
        self.system.entries()
    }

    /// At most `cap` steps, until none moves anything by more than `tolerance`. `drag` is against `before`.
    ///
    /// # Errors
    /// A pose that is not finite any more.
    #[allow(clippy::too_many_arguments)]
    pub(super) fn solve(
        &mut self,
        state: &mut State,
        targets: &[DVec3],
        presence: &[f64],
        before: &Pose,
        drag: Drag,
        cap: u32,
        tolerance: f64,
    ) -> Result<Solved, NotPositive> {
        let Self { told, model, holds, betas, .. } = self;
        told.measure(model, holds, betas, presence, before, drag.light);
        let mut solved = Solved::default();
        let mut share = 1.0;
        while solved.steps < cap {
            self.assemble(state, targets, presence, before, drag);
            solved.energy = self.system.energy;
            self.system.solve()?;
            solved.released = self.release(state);
            share = if solved.steps < FULL { 1.0 } else { self.system.relaxation(share) };
            (solved.moved, share) = self.step(&mut state.pose, share);
            solved.steps += 1;
            if solved.settled(tolerance) {
                break;
            }
        }
        for (k, link) in self.model.links.iter().enumerate() {
            state.angles[k] = Coordinates::of(link, &self.model, &state.pose, state.angles[k]).angle;
        }
        Ok(solved)
    }

    /// Energy of a state.
    pub(super) fn energy(&mut self, state: &mut State, targets: &[DVec3], presence: &[f64], before: &Pose) -> f64 {
        self.assemble(state, targets, presence, before, Drag::all(0.0));
        self.system.energy
    }

    fn assemble(&mut self, state: &mut State, targets: &[DVec3], presence: &[f64], before: &Pose, drag: Drag) {
        let Self { model, weights, holds, betas, soles, system, told, parts, planes } = self;
        system.clear();
        let pose = &state.pose;
        for strain in &model.strains {
            rows::strain(system, weights.strain, pose, model, strain);
        }
        for (k, hold) in holds.iter().enumerate() {
            if presence[k] > 0.0 {
                rows::handle(system, weights.position * betas[k] * presence[k], pose, hold, targets[k], parts);
            }
        }
        for (k, link) in model.links.iter().enumerate() {
            let at = Coordinates::of(link, model, pose, state.angles[k]);
            state.angles[k] = at.angle;
            state.limits[k].meet(link, &at);
            rows::joint(system, weights, pose, model, link, &at, &state.limits[k]);
        }
        if let Some(ground) = &model.ground {
            for (sole, grounded) in soles.iter().zip(&mut state.grounded) {
                *grounded |= pose.hold(sole).dot(ground.up) < ground.height;
                if *grounded {
                    rows::on_plane(system, weights.limit, pose, sole, ground.up, ground.height, planes);
                }
            }
        }
        let stay = drag.weight;
        if stay > 0.0 {
            for (link, axes) in model.links.iter().zip(&told.axes) {
                rows::drag(system, weights.position * stay, pose, before, link, axes, drag.free);
            }
            for link in &model.links {
                rows::slide(system, weights.position * SLIDE, pose, before, model, link);
            }
            for variable in 0..model.variables() {
                rows::stay(system, weights.position * stay * WHOLE, pose, before, variable);
            }
        }
    }

    /// Lets go of the limits and of the ground where these would have to pull; whether there are any.
    fn release(&self, state: &mut State) -> bool {
        let mut released = false;
        for ((link, limits), &angle) in self.model.links.iter().zip(&mut state.limits).zip(&state.angles) {
            if limits.hold() {
                let at = Coordinates::of(link, &self.model, &state.pose, angle);
                let ahead = at.ahead(link, &self.model, &state.pose, |v| self.system.step(v));
                released |= limits.release(link, ahead);
            }
        }
        if let Some(ground) = &self.model.ground {
            for (sole, grounded) in self.soles.iter().zip(&mut state.grounded).filter(|g| *g.1) {
                let moves = sole.iter().map(|&(v, share, arm)| {
                    let (turn, shift) = self.system.step(v);
                    shift * share + turn.cross(state.pose.turns[v] * arm)
                });
                *grounded = (state.pose.hold(sole) + moves.sum::<DVec3>()).dot(ground.up) < ground.height;
                released |= !*grounded;
            }
        }
        released
    }

    /// How far the deepest sole is below the ground.
    pub(super) fn depth(&self, pose: &Pose) -> Option<(f64, DVec3)> {
        let ground = self.model.ground.as_ref()?;
        let depth = self.soles.iter().map(|sole| ground.height - pose.hold(sole).dot(ground.up)).fold(0.0, f64::max);
        Some((depth, ground.up))
    }

    /// Applies a part of the step; returns how far the whole of it moves anything, and the part that was taken.
    fn step(&self, pose: &mut Pose, part: f64) -> (f64, f64) {
        let count = pose.turns.len();
        let largest = (0..count).map(|v| self.system.step(v).0.length()).fold(0.0, f64::max);
        let share = part.min(LARGEST_TURN / largest);
        let mut moved = 0.0_f64;
        for v in 0..count {
            let (turn, shift) = self.system.step(v);
            let (turn, shift) = (turn * share, shift * share);
            let quaternion = DQuat::from_scaled_axis(turn) * DQuat::from_mat3(&pose.turns[v]);
            pose.turns[v] = DMat3::from_quat(quaternion.normalize());
            pose.places[v] += shift;
            moved = moved.max(turn.abs().max_element()).max(shift.abs().max_element());
        }
        (moved / share, share)
    }

    /// The worst violation of the joints in a pose.
    pub(super) fn violation(&self, pose: &Pose, angles: &[f64]) -> Violation {
        let of = self.model.links.iter().zip(angles).map(|(link, &angle)| {
            let at = Coordinates::of(link, &self.model, pose, angle);
            Violation::of(link, &at)
        });
        of.fold(Violation::default(), Violation::max)
    }
}
