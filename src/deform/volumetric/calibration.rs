//! How far a pose is from the answer, when the solver's last step was so long.
//!
//! That depends on the body and on where its handles are: a long limb without any creeps for many steps. So it is measured where the answer is
//! known: with every target at rest, from a pose that random forces have bent.

use super::Volumetric;
use super::coarse::DAMPING;
use super::descent::Place;
use super::elements::Element;
use crate::linalg::lanes::{Lanes, longest};
use crate::linalg::rotation;
use crate::splitmix::{nth, signed};

/// The least that is believed; bodies with many markers have 13 to 25.
const LEAST: f64 = super::ERROR_PER_STEP;
/// Where hardly anything is held, frames end before the far ends have stopped.
const MOST: f64 = 100.0;
/// How far the bent pose is from rest, in diagonals.
const BEND: f64 = 0.01;
/// Steps in diagonals between which the ratio is taken: about those at which frames end.
const BETWEEN: (f64, f64) = (2e-6, 5e-5);
/// Passes after which the measurement ends in any case.
const PASSES: u32 = 60;

impl Volumetric {
    /// Measures the error over the last step; leaves the body at rest.
    ///
    /// Forces are random in size, along the ways to the middles of the tetrahedra: a body that is turned or mirrored has those of the body, turned or
    /// mirrored.
    pub(super) fn error_per_step(&mut self, elements: &[Element]) -> f64 {
        let count = self.attachments.len();
        self.asked.positions[..count].copy_from_slice(&self.attachments);
        self.asked.presence.fill(1.0);
        self.oriented.ask(&mut self.asked);
        self.handles.take(&self.asked, self.oriented.holds());
        self.drag.release();

        let m = &mut self.memory;
        m.plain.fill(Lanes::ZERO);
        for element in elements {
            let middle = element.corners.iter().fold(Lanes::ZERO, |sum, &v| sum + self.rest[v as usize]) * 0.25;
            for &v in &element.corners {
                if m.plain[v as usize] == Lanes::ZERO {
                    m.plain[v as usize] = (middle - self.rest[v as usize]) * signed(nth(u64::from(v)));
                }
            }
        }
        self.oriented.clear_given(&mut m.plain);
        self.handles.solve(&self.factor, &mut m.plain, &mut m.pulls, &mut m.pull_axis);
        let scale = BEND * self.settings.diagonal / longest(&m.plain).max(f64::MIN_POSITIVE);
        for ((p, rest), bent) in self.p.iter_mut().zip(&self.rest).zip(&m.plain) {
            *p = *rest + *bent * scale;
        }
        self.oriented.put_given(&mut self.p);
        self.evaluate(Place::Current, 2);
        self.memory.anderson.forget();
        self.coarse.build(&self.blocks, &self.rotations, DAMPING);
        let mut largest: Option<f64> = None;
        for _ in 0..PASSES {
            self.precondition();
            let m = &mut self.memory;
            let step = longest(&m.step) / self.settings.diagonal;
            for ((image, p), step) in m.image.iter_mut().zip(&self.p).zip(&m.step) {
                *image = *p + *step;
            }
            m.anderson.record(&m.image, &m.step);
            if !m.anderson.mix(&mut m.trial) {
                m.trial.copy_from_slice(&m.image);
            }
            self.evaluate(Place::Trial, 1);
            std::mem::swap(&mut self.p, &mut self.memory.trial);
            let away = self.p.iter().zip(&self.rest).map(|(p, rest)| longest(&[*p - *rest]));
            let error = away.fold(0.0, f64::max) / self.settings.diagonal;
            if step < BETWEEN.0 {
                // A body that is held everywhere arrives at once.
                largest = largest.or(Some(LEAST));
                break;
            }
            if step < BETWEEN.1 {
                largest = Some(largest.map_or(error / step, |most| most.max(error / step)));
            }
        }
        self.p.copy_from_slice(&self.rest);
        self.rotations.fill(rotation::IDENTITY);
        self.memory.anderson.forget();
        largest.unwrap_or(MOST).clamp(LEAST, MOST)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use crate::deform::volumetric::bodies::{block, distance, noise, on_vertex, targets_of};
    use crate::deform::volumetric::{Options, Volumetric};
    use crate::deform::{Deformer, Handle};
    use crate::proxy::Proxy;
    use glam::{DQuat, DVec3};

    /// Markers on so much of a bar.
    fn handles(proxy: &Proxy, reach: f64) -> Vec<Handle> {
        let near = (0..proxy.rest.len()).filter(|&v| proxy.rest[v].x < reach);
        near.step_by(7).map(|v| on_vertex(v, 1.0)).collect()
    }

    #[test]
    fn a_limb_without_markers_has_a_larger_error_for_the_same_step_and_ends_as_near() {
        let proxy = block([60, 2, 2], 0.1);
        let error_per_step =
            |reach: f64| Volumetric::new(&proxy, &handles(&proxy, reach), &Options::default()).unwrap().settings.error_per_step;
        let (all, fifth) = (error_per_step(2.0), error_per_step(0.2));
        assert!(fifth > 2.0 * all, "{fifth} and {all}");

        let handles = handles(&proxy, 0.2);
        let solve = |options: &Options| {
            let mut deformer = Volumetric::new(&proxy, &handles, options).unwrap();
            let mut random = noise();
            (0..20)
                .map(|frame| {
                    let turn = DQuat::from_rotation_y(0.6 * (0.2 * f64::from(frame)).sin());
                    let mut targets = targets_of(&proxy, &handles, |p| turn * p);
                    targets.positions.iter_mut().for_each(|p| *p += DVec3::new(random(), random(), random()) * 3e-4);
                    let stats = if frame == 0 { deformer.start(&targets) } else { deformer.step(&targets) }.unwrap();
                    (deformer.pose().to_vec(), stats.error.unwrap())
                })
                .collect::<Vec<_>>()
        };
        let converged = solve(&Options { tolerance: 1e-11, ..Options::default() });
        for ((pose, estimate), (truth, _)) in solve(&Options::default()).iter().zip(&converged) {
            let error = distance(pose, truth);
            // The estimate may be half of the error, as for every body; the frame ends within twice what the tolerance asks.
            assert!(error < 2.0 * estimate && error < 40.0 * Options::NORMAL, "{error} for {estimate}");
        }
    }
}
