//! The joint-aware deformer: rigid parts and soft cells that hang together by joints, pulled by handles.
//!
//! It minimises, over one rigid motion per cell (cells that fixed joints, groups or the surroundings of a joint tie together share one),
//!
//! ```text
//! E = w_j Σ joints + w_l Σ limits + w_s Σ differences of neighbouring cells + w_p Σ |handle − target|²
//! ```
//!
//! Source: Xu, Wang, Yin, Zhou, van de Panne, Chen, Guo: *Joint-aware manipulation of deformable models*, 2009, §4. Cells are rigid by construction instead
//! of by an energy, joints hold by anchors instead of corners, and after the last step a tree of joints is made exact.

mod cells;
mod coordinates;
mod model;
mod rows;
mod solve;
mod start;
mod system;
mod told;
mod tree;

pub use coordinates::Violation;
pub use model::{Body, Ground, Group, JointSpec, Model, Part, Region, Side};
pub use rows::Weights;

use super::{Deformer, FrameStats, Handle, Targets};
use crate::error::{Error, Result};
use glam::DVec3;
use rows::Pose;
use solve::{Drag, Solved, Solver, State};
use tree::Tree;

/// How the deformer solves.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Weights of the energies.
    pub weights: Weights,
    /// A frame ends when no turn (radians) and no place (diagonals) changes by more in a step.
    pub tolerance: f64,
    /// Steps per frame at most.
    pub iterations: u32,
    /// How strongly joints stay turned as in the frame before, against a handle; `None`: a twenty-fifth of the rate where handles leave parts open, else
    /// hardly at all.
    pub hold: Option<f64>,
    /// Frames per second.
    pub rate: f64,
    /// Whether a tree of joints between rigid parts is made exact in the end.
    pub snap: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { weights: Weights::default(), tolerance: 1e-4, iterations: 20, hold: None, rate: 30.0, snap: true }
    }
}

/// Hold for bodies that handles leave open, in seconds: a drag that slows joints down as much at any rate. Less lets a limb that comes out of a singular pose
/// (an arm that hangs along two of its axes) snap over within a frame, more lags behind the take.
const DRAG: f64 = 0.04;
/// Share of it that joints feel which handles tell well.
const LIGHT: f64 = 0.1;
/// What these turn faster than this, in radians per second, feels all of it.
const SPEED: f64 = 3.0;
/// Hold for others.
const HARDLY: f64 = 1e-9;

/// Handles that jump farther between frames, in diagonals, are led there in steps of this length.
const JUMP: f64 = 0.1;
const MOST_STEPS: f64 = 40.0;

/// The deformer of a thing made of parts. Its handles are rows over [`Model::frames`]; a frame allocates nothing after the first.
pub struct Joints {
    solver: Solver,
    tree: Tree,
    options: Options,
    hold: f64,
    state: State,
    /// Turns of the frame before, the targets of it, and those on the way from them.
    before: Pose,
    last: Vec<DVec3>,
    way: Vec<DVec3>,
    snapped: Pose,
    violation: Violation,
    pose: Vec<DVec3>,
}

impl Joints {
    /// Sets up: rows, pattern, symbolic factorization.
    ///
    /// # Errors
    /// [`crate::error::Kind::Refused`] without handles, or with one that is not over the model's frame points.
    pub fn new(model: Model, handles: &[Handle], options: &Options) -> Result<Self> {
        let points = 4 * model.variables() as u32;
        if handles.is_empty() {
            return Err(
                Error::refused("no handles: nothing moves the parts").expected("markers or joints that are bound to parts")
            );
        }
        for handle in handles {
            let usable = handle.row.indices.iter().all(|&i| i < points) && handle.row.values.iter().all(|v| v.is_finite());
            if !(usable && handle.beta.is_finite() && handle.beta > 0.0) {
                return Err(Error::refused(format!("handle {} has no usable row or hardness", handle.name)));
            }
        }
        let holds: Vec<rows::Hold> = handles.iter().map(|h| Model::holds(&h.row)).collect();
        let betas = handles.iter().map(|h| h.beta).collect();
        let tree = Tree::new(&model, holds.iter().flatten().map(|h| h.0));
        let hold = options.hold.unwrap_or_else(|| if is_open(&model, &holds) { DRAG * options.rate } else { HARDLY });
        let solver = Solver::new(model, holds, betas, options.weights)
            .map_err(|_| Error::refused("more parts and joints than can be solved together"))?;
        let state = solver.rest();
        let mut deformer = Self {
            tree,
            options: *options,
            hold,
            before: state.pose.clone(),
            snapped: state.pose.clone(),
            last: vec![DVec3::NAN; handles.len()],
            way: vec![DVec3::ZERO; handles.len()],
            violation: Violation::default(),
            pose: Vec::new(),
            state,
            solver,
        };
        deformer.finish();
        Ok(deformer)
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.solver.model
    }

    /// Joints that close a loop: they are kept as well as they can be, not exactly.
    pub fn loops(&self) -> usize {
        self.tree.loops
    }

    /// Entries of the factor.
    pub fn factor_entries(&self) -> usize {
        self.solver.entries()
    }

    /// How far the joints were from what they allow in the last frame, before they were made exact.
    pub fn violation(&self) -> Violation {
        self.violation
    }

    /// The same of the pose that is given out.
    pub fn remaining_violation(&self) -> Violation {
        self.solver.violation(&self.snapped, &self.state.angles)
    }

    fn check(&self, targets: &Targets) -> Result<()> {
        let count = self.solver.holds.len();
        if targets.positions.len() != count || targets.presence.len() != count {
            return Err(Error::refused(format!("targets for {} handles of {count}", targets.positions.len())));
        }
        let held = targets.presence.iter().zip(&targets.positions);
        if held.into_iter().any(|(w, p)| !(*w >= 0.0 && w.is_finite()) || (*w > 0.0 && !p.is_finite())) {
            return Err(Error::refused("a target is not a finite place"));
        }
        Ok(())
    }

    /// Keeps the targets that were there.
    fn remember(&mut self, targets: &Targets) {
        for ((last, target), presence) in self.last.iter_mut().zip(&targets.positions).zip(&targets.presence) {
            *last = if *presence > 0.0 { *target } else { DVec3::NAN };
        }
    }

    /// Makes the tree exact and the pose to be given out.
    fn finish(&mut self) {
        self.violation = self.solver.violation(&self.state.pose, &self.state.angles);
        self.snapped.set(&self.state.pose);
        if self.options.snap {
            self.tree.snap(&self.solver.model, &mut self.snapped, &self.state.angles, &self.state.pose);
        }
        if let Some((depth, up)) = self.solver.depth(&self.snapped) {
            self.snapped.places.iter_mut().for_each(|place| *place += up * depth);
        }
        Model::pose(&self.snapped.turns, &self.snapped.places, &mut self.pose);
    }

    fn stats(&self, solved: Solved, recovered: bool) -> FrameStats {
        FrameStats {
            passes: solved.steps,
            step: solved.moved,
            error: None,
            converged: solved.settled(self.options.tolerance),
            recovered,
            energy: solved.energy,
            inverted: 0,
            fold: None,
            volume_ratio: 1.0,
            violation: Some(self.violation),
        }
    }

    fn start_over(&mut self, targets: &Targets, recovered: bool) -> Result<FrameStats> {
        let (positions, presence) = (&targets.positions, &targets.presence);
        if presence.iter().all(|w| *w == 0.0) {
            self.finish();
            return Ok(self.stats(Solved::default(), recovered));
        }
        let (state, solved) = start::start(&mut self.solver, &self.tree, positions, presence, self.hold, self.options.tolerance)
            .map_err(|_| Error::refused("no pose of the parts was found that meets the targets of the first frame"))?;
        self.state = state;
        self.before.set(&self.state.pose);
        self.remember(targets);
        self.finish();
        Ok(self.stats(solved, recovered))
    }
}

impl Deformer for Joints {
    fn start(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.check(targets)?;
        self.start_over(targets, false)
    }

    fn step(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.check(targets)?;
        let (positions, presence) = (&targets.positions, &targets.presence);
        if presence.iter().all(|w| *w == 0.0) {
            return Ok(self.stats(Solved::default(), false));
        }
        // A handle that comes back has no last target: it is led from where it is.
        for (k, hold) in self.solver.holds.iter().enumerate().filter(|(k, _)| presence[*k] > 0.0) {
            if self.last[k].is_nan() {
                self.last[k] = self.state.pose.hold(hold);
            }
        }
        let moved = |k: usize| if presence[k] > 0.0 { positions[k].distance(self.last[k]) } else { 0.0 };
        let jump = (0..positions.len()).map(moved).fold(0.0, f64::max);
        let steps = (jump / JUMP).ceil().clamp(1.0, MOST_STEPS);
        let Options { tolerance, iterations, .. } = self.options;
        let mut all = Solved::default();
        self.before.set(&self.state.pose);
        let drag = Drag { weight: self.hold, light: LIGHT, free: SPEED / (self.options.rate * steps) };
        for k in 1..=steps as u32 {
            let share = f64::from(k) / steps;
            for ((at, from), to) in self.way.iter_mut().zip(&self.last).zip(positions) {
                *at = if share < 1.0 { from.lerp(*to, share) } else { *to };
            }
            let result = self.solver.solve(&mut self.state, &self.way, presence, &self.before, drag, iterations, tolerance);
            match result {
                Ok(solved) => all = Solved { steps: all.steps + solved.steps, ..solved },
                Err(_) => return self.start_over(targets, true),
            }
            self.before.set(&self.state.pose);
        }
        self.remember(targets);
        self.finish();
        Ok(self.stats(all, false))
    }

    fn pose(&self) -> &[DVec3] {
        &self.pose
    }
}

/// Whether some variable has fewer than three handles.
fn is_open(model: &Model, holds: &[rows::Hold]) -> bool {
    let mut count = vec![0; model.variables()];
    holds.iter().flatten().for_each(|h| count[h.0] += 1);
    count.iter().any(|&c| c < 3)
}
