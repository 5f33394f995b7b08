//! One frame: from the predicted pose down to the minimum of the energy.

use super::anderson::Anderson;
use super::coarse::{DAMPING, MORE_DAMPING, MOST_DAMPING};
use super::{ERROR_PER_STEP, FrameStats, Volumetric};
use crate::linalg::lanes::{Lanes, add_scaled, for_each_instruction_set, longest};
use crate::linalg::rotation::{self, Quaternions};
use glam::DVec3;

/// Passes after which a frame is left as it is, warm and cold. Where a crease snaps, a frame of a squat takes up to 114.
pub(super) const MOST_PASSES: (u32, u32) = (120, 200);

/// Iterations after which the coarse level is turned with the body again, warm and cold.
const REBUILD: (u32, u32) = (12, 6);

/// How much more the coarse correction counts, per bulk: the matrix has weights that bound the change of volume, while bodies bend and twist without one.
const BENDING: f64 = 0.9;

/// A global step that moves the solution of the last one by less than this, in diagonals, need not be repeated.
const EXACT: f64 = 1e-12;

/// A step is taken back when the energy rises by more than this part of it.
const RISE: f64 = 1e-13;

/// Given vertices farther than this from where they were expected, in diagonals, would tear their neighbours: the others follow them first.
const LEAP: f64 = 0.02;
/// A rise by less than this part is the doing of rotations that are not exact yet.
const HARMLESS: f64 = 1e-6;

/// The plain step is halved no further than to this part.
const LEAST_STEP: f64 = 0.02;

/// Part of the tetrahedra that are inside out, or turned otherwise than they lie, where a state is worthless; in the deepest squat it is a three-hundredth.
const LOST: f64 = 0.05;
/// Cosine of half the angle between two rotations from which they are of different poses.
const QUARTER_TURN: f64 = std::f64::consts::FRAC_1_SQRT_2;

pub(super) struct Settings {
    pub(super) tolerance: f64,
    /// The error of a pose over the last step, see [`super::calibration`].
    pub(super) error_per_step: f64,
    /// Diagonal of the rest box.
    pub(super) diagonal: f64,
    pub(super) iterations: Option<u32>,
    pub(super) rotation_steps: Option<u32>,
    /// Angle, see [`super::Options::interpolate_above`].
    pub(super) interpolate_above: f64,
}

/// What a frame needs besides the state that it leaves behind; reserved once.
pub(super) struct Memory {
    gradient: Vec<Lanes>,
    /// The plain step `A⁻¹ g`, and the full one.
    pub(super) plain: Vec<Lanes>,
    pub(super) step: Vec<Lanes>,
    pub(super) image: Vec<Lanes>,
    pub(super) trial: Vec<Lanes>,
    load: Vec<Lanes>,
    pub(super) pulls: Vec<[f64; 3]>,
    pub(super) pull_axis: Vec<f64>,
    pub(super) anderson: Anderson,
    /// Rotations put aside, for plain iterations only.
    aside: Vec<Quaternions>,
    pub(super) energies: Vec<f64>,
}

impl Memory {
    pub(super) fn new(size: usize, handles: usize, blocks: usize, iterations: Option<u32>) -> Self {
        let zeros = || vec![Lanes::ZERO; size];
        let longest = iterations.unwrap_or(MOST_PASSES.1 + 3) as usize;
        Self {
            gradient: zeros(),
            plain: zeros(),
            step: zeros(),
            image: zeros(),
            trial: zeros(),
            load: zeros(),
            pulls: vec![[0.0; 3]; handles],
            pull_axis: vec![0.0; handles],
            anderson: Anderson::new(size),
            aside: vec![rotation::IDENTITY; if iterations.is_some() { blocks } else { 0 }],
            energies: Vec::with_capacity(longest + 1),
        }
    }
}

impl Volumetric {
    /// Solves for the targets that the handles have; leaves the pose in `p` and the one before in `before`.
    pub(super) fn frame(&mut self) -> FrameStats {
        self.memory.energies.clear();
        let lost = self.settings.iterations.is_some() && self.settings.rotation_steps.is_none() && self.is_lost();
        let turned = self.turn_with_handles();
        let mut stats = match self.settings.iterations {
            Some(count) => match self.settings.rotation_steps {
                None => self.alternate(count, lost),
                Some(steps) => self.alternate_warm(count, steps),
            },
            None => self.descend(turned),
        };
        let (inverted, worst, volume_ratio) = self.blocks.measure(&self.p);
        let centre = |corners: [u32; 4]| corners.iter().map(|&v| self.rest[v as usize].xyz()).sum::<DVec3>() / 4.0;
        (stats.inverted, stats.fold, stats.volume_ratio) = (inverted, worst.map(centre), volume_ratio);
        stats
    }

    /// Whether the state that a frame of plain iterations begins with is worthless: much is inside out, or its rotations are those of another pose. No
    /// frame leaves such a state behind.
    fn is_lost(&mut self) -> bool {
        if self.is_inside_out() {
            return true;
        }
        self.memory.aside.copy_from_slice(&self.rotations);
        self.blocks.extract(&self.p, &mut self.memory.aside);
        let pairs = self.rotations.iter().zip(&self.memory.aside);
        let lanes = pairs.flat_map(|(a, b)| (0..4).map(|k| rotation::lane(a, k).dot(rotation::lane(b, k))));
        lanes.filter(|dot| dot.abs() < QUARTER_TURN).count() as f64 > self.most_inverted()
    }

    /// Whether so much is inside out that the pose is worthless, and was not so at the end of the last frame.
    pub(super) fn is_inside_out(&self) -> bool {
        let most = self.most_inverted();
        f64::from(self.last.inverted) <= most && f64::from(self.blocks.measure(&self.p).0) > most
    }

    fn most_inverted(&self) -> f64 {
        LOST * 4.0 * self.blocks.list.len() as f64
    }

    /// The paper's way: linear solve and exact rotations in turn. `lost`: whether the frame begins with a worthless state.
    fn alternate(&mut self, count: u32, lost: bool) -> FrameStats {
        self.before.copy_from_slice(&self.p);
        self.oriented.put_given(&mut self.p);
        let mut energy = self.evaluate(Place::Current, 0);
        let (mut step, mut passes, mut careful, mut recovered) = (0.0, count + 1, true, false);
        for iteration in 0..count {
            step = self.global_step();
            if careful {
                // Rows with large coefficients and weights cost the factor half of its digits; a second step with the same rotations finds them again.
                self.evaluate(Place::Current, 0);
                passes += 1;
                careful = self.global_step() > EXACT * self.settings.diagonal;
            }
            self.blocks.extract(&self.p, &mut self.rotations);
            energy = self.evaluate(Place::Current, 0);
            if iteration == 0 && lost {
                let other = self.start_over(energy);
                recovered = other < energy;
                energy = other.min(energy);
                passes += 2;
            }
            self.memory.energies.push(energy);
        }
        FrameStats { passes, step: step / self.settings.diagonal, converged: true, recovered, energy, ..Default::default() }
    }

    /// The same with rotations that follow by so many steps: one pass and one solve per iteration.
    fn alternate_warm(&mut self, count: u32, steps: u32) -> FrameStats {
        self.before.copy_from_slice(&self.p);
        self.oriented.put_given(&mut self.p);
        let mut energy = self.evaluate(Place::Current, steps);
        let mut step = 0.0;
        for _ in 0..count {
            step = self.global_step();
            energy = self.evaluate(Place::Current, steps);
            self.memory.energies.push(energy);
        }
        FrameStats { passes: count + 1, step: step / self.settings.diagonal, converged: true, energy, ..Default::default() }
    }

    /// One iteration from the body at rest where the handles are, turned with them, instead of a worthless pose, if that has less `energy`: the plain
    /// iteration has no longest step, but lets the slow waves that random positions leave go by a hundredth at a time. Not in the paper; frames that begin
    /// with a sound state are left to the paper's way. The energy from there.
    fn start_over(&mut self, energy: f64) -> f64 {
        self.memory.trial.copy_from_slice(&self.p);
        self.memory.aside.copy_from_slice(&self.rotations);
        self.lie_at_rest();
        self.turn_with_handles();
        self.oriented.put_given(&mut self.p);
        self.evaluate(Place::Current, 0);
        self.global_step();
        self.blocks.extract(&self.p, &mut self.rotations);
        let other = self.evaluate(Place::Current, 0);
        if other < energy {
            return other;
        }
        self.p.copy_from_slice(&self.memory.trial);
        self.rotations.copy_from_slice(&self.memory.aside);
        self.evaluate(Place::Current, 0)
    }

    /// The positions that suit the rotations best, from the gradient at the present ones: the longest move.
    fn global_step(&mut self) -> f64 {
        let m = &mut self.memory;
        m.plain.copy_from_slice(&m.gradient);
        self.handles.solve(&self.factor, &mut m.plain, &mut m.pulls, &mut m.pull_axis);
        add_scaled(&mut self.p, -1.0, &m.plain);
        longest(&m.plain)
    }

    /// Turns the rotations with the oriented handles when one of them turns far (Stoll et al. 2007, §2.3.2).
    fn turn_with_handles(&mut self) -> bool {
        self.oriented.turn_with_handles(
            &self.blocks,
            &self.handles,
            &self.p,
            &mut self.rotations,
            self.settings.interpolate_above,
        )
    }

    /// The positions that suit the rotations best.
    fn follow_rotations(&mut self) {
        let m = &mut self.memory;
        self.blocks.pass_without_bulk(&self.p, &mut self.rotations, &mut m.plain);
        self.handles.pull(&self.p, &mut m.plain);
        self.oriented.clear_given(&mut m.plain);
        self.handles.solve(&self.factor, &mut m.plain, &mut m.pulls, &mut m.pull_axis);
        add_scaled(&mut self.p, -1.0, &m.plain);
    }

    fn descend(&mut self, turned: bool) -> FrameStats {
        let cold = self.frames < 2;
        let (cap, rebuild) = if cold { (MOST_PASSES.1, REBUILD.1) } else { (MOST_PASSES.0, REBUILD.0) };
        if cold {
            self.drag.release();
        } else {
            self.drag.hold(&self.blocks, &self.p, &self.rotations, self.lead.motion() / self.settings.diagonal);
        }
        for (p, before) in self.p.iter_mut().zip(&mut self.before) {
            let now = *p;
            if !cold {
                *p = now + (now - *before) * self.lead.share();
            }
            *before = now;
        }
        let leap = self.oriented.put_given(&mut self.p);
        if turned || leap > LEAP * self.settings.diagonal {
            self.follow_rotations();
        }
        // Rotations of an undeformed body still differ from the identity by rounding.
        let rounding = 1e-28 * self.blocks.total_weight;
        let mut newton = 1;
        let mut energy = self.evaluate(Place::Current, 2);
        self.memory.energies.push(energy);
        self.memory.anderson.forget();
        // Of the rigid groups: how much they are, and how much they will be when the coarse level is built again.
        let (mut damping, mut wanted) = (DAMPING, DAMPING);
        self.coarse.build(&self.blocks, &self.rotations, damping);
        let mut passes = 1;
        let mut iteration = 0;
        loop {
            if iteration > 0 && iteration % rebuild == 0 || wanted > damping {
                damping = if wanted > damping { wanted } else { (damping / MORE_DAMPING).max(DAMPING) };
                wanted = damping;
                self.coarse.build(&self.blocks, &self.rotations, damping);
                self.memory.anderson.forget();
            }
            iteration += 1;
            self.precondition();
            let m = &mut self.memory;
            let step = longest(&m.step) / self.settings.diagonal;
            // The ratio was measured with the least damping: with more of it steps are shorter by up to as much.
            let error = step * self.settings.error_per_step * damping / DAMPING;
            for ((image, p), step) in m.image.iter_mut().zip(&self.p).zip(&m.step) {
                *image = *p + *step;
            }
            m.anderson.record(&m.image, &m.step);
            let limit = energy * (1.0 + RISE) + rounding;
            let mut accepted = false;
            let mut next = f64::NAN;
            if m.anderson.mix(&mut m.trial) {
                next = self.evaluate(Place::Trial, newton);
                passes += 1;
                accepted = next <= limit;
            }
            if !accepted {
                let m = &mut self.memory;
                m.anderson.forget_changes();
                m.trial.copy_from_slice(&m.image);
                next = self.evaluate(Place::Trial, newton);
                passes += 1;
                accepted = next <= limit;
            }
            if !accepted {
                if self.coarse.has_rigid_groups() {
                    wanted = (damping * MORE_DAMPING).min(MOST_DAMPING);
                }
                // Without bulk the plain step cannot raise the energy, except by rotations that one Newton step leaves inexact.
                let m = &mut self.memory;
                m.anderson.forget();
                m.trial.copy_from_slice(&self.p);
                add_scaled(&mut m.trial, -1.0, &m.plain);
                next = self.evaluate(Place::Trial, newton);
                passes += 1;
                if next.is_nan() || next > limit {
                    newton = 3;
                    next = self.evaluate(Place::Trial, newton);
                    passes += 1;
                }
                if self.blocks.bulk() > 0.0 {
                    let mut back = 0.5;
                    while (next.is_nan() || next > limit) && back > LEAST_STEP {
                        add_scaled(&mut self.memory.trial, back, &self.memory.plain);
                        back *= 0.5;
                        next = self.evaluate(Place::Trial, newton);
                        passes += 1;
                    }
                    if next.is_nan() || next > energy * (1.0 + HARMLESS) + rounding {
                        // No way down from here: the pose stays.
                        return FrameStats { passes, step, error: Some(error), converged: false, energy, ..Default::default() };
                    }
                }
            }
            std::mem::swap(&mut self.p, &mut self.memory.trial);
            energy = next;
            self.memory.energies.push(energy);
            let converged = error < self.settings.tolerance * ERROR_PER_STEP;
            if converged || passes >= cap || !step.is_finite() {
                return FrameStats { passes, step, error: Some(error), converged, energy, ..Default::default() };
            }
        }
    }

    /// Energy at the current or the trial pose; half its gradient goes to `memory.gradient`.
    pub(super) fn evaluate(&mut self, place: Place, newton: u32) -> f64 {
        let m = &mut self.memory;
        let p = match place {
            Place::Current => &self.p,
            Place::Trial => &m.trial,
        };
        let body = self.blocks.pass(p, &mut self.rotations, newton, &mut m.gradient);
        let drag = self.drag.pass(&self.blocks, p, newton, &mut m.gradient);
        let energy = body + drag + self.handles.pull(p, &mut m.gradient);
        self.oriented.clear_given(&mut m.gradient);
        energy
    }

    /// From the gradient to the plain and the full step.
    pub(super) fn precondition(&mut self) {
        let m = &mut self.memory;
        m.plain.copy_from_slice(&m.gradient);
        self.handles.solve(&self.factor, &mut m.plain, &mut m.pulls, &mut m.pull_axis);
        if self.coarse.is_ready() {
            self.coarse.load(&m.plain, &mut m.load);
            self.handles.solve(&self.factor, &mut m.load, &mut m.pulls, &mut m.pull_axis);
        } else {
            m.load.fill(Lanes::ZERO);
        }
        full_step(&m.plain, &m.load, 1.0 + BENDING * self.blocks.bulk(), &mut m.step);
    }
}

for_each_instruction_set! {
    fn full_step(plain: &[Lanes], load: &[Lanes], share: f64, step: &mut [Lanes]) {
        for ((step, plain), load) in step.iter_mut().zip(plain).zip(load) {
            *step = -(*plain + *load * share);
        }
    }
}

#[derive(Clone, Copy)]
pub(super) enum Place {
    Current,
    Trial,
}
