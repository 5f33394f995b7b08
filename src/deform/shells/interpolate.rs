//! Poses between and beyond the examples, for weights that are given (Fröhlich & Botsch 2011, §5.1).

use super::body::{Body, tip};
use super::geometry::volume;
use super::newton::{Goals, Minimum, Newton, Settings, Tension, Weights};
use super::shell::{Material, Shell};
use super::starts::Rigid;
use crate::deform::FrameStats;
use crate::error::{Error, Kind, Result};
use glam::DVec3;

/// Largest change of the weights in one stage on the way from a known pose.
const STAGE: f64 = 0.2;
/// Steps in a stage, and in the last one.
const STEPS: u32 = 6;
const LAST_STEPS: u32 = 100;
/// Relative damping: nothing says where the shell is.
const DAMPING: f64 = 1e-7;
const SETTINGS: Settings = Settings {
    steps: LAST_STEPS,
    decrease: 1e-9,
    still: 1e-8,
    damping: DAMPING,
    tension: Tension::WhenNeeded,
    weights: Weights::Given,
};

/// Poses a body by weights of its examples.
#[derive(Debug)]
pub struct Interpolator {
    newton: Newton,
    /// Rest, then the examples.
    poses: Vec<Vec<DVec3>>,
    x: Vec<DVec3>,
    weights: Vec<f64>,
    pose: Vec<DVec3>,
}

impl Interpolator {
    /// The largest amount of a weight: the way there is gone in stages, so that a far one would never end.
    pub const FARTHEST: f64 = 20.0;

    /// A body at rest.
    ///
    /// # Errors
    /// A mesh that is no surface.
    pub fn new(body: &Body, material: &Material) -> Result<Self> {
        let rest = &body.proxy.rest[..body.vertices()];
        let shell = Shell::new(rest, &body.proxy.boundary, &body.examples, material, &[])?;
        let weights = vec![0.0; body.examples.len()];
        let newton = Newton::new(shell, &vec![false; rest.len()], Vec::new());
        let poses = std::iter::once(rest.to_vec()).chain(body.examples.iter().cloned()).collect();
        Ok(Self { newton, poses, x: rest.to_vec(), weights, pose: body.proxy.rest.clone() })
    }

    /// The pose for these weights, one per example; outside of 0 to 1 and of a sum of 1 the examples are exaggerated.
    ///
    /// It is reached from the nearest of rest, the examples and the pose before, in stages where that is far. It lies where the poses, blended point by
    /// point, lie: an example's own weight gives it where it is.
    ///
    /// # Errors
    /// [`Kind::Usage`] for another number of weights, or one that is no number or beyond [`Self::FARTHEST`]; [`Kind::Refused`] where no pose is found.
    pub fn solve(&mut self, weights: &[f64]) -> Result<FrameStats> {
        if weights.len() != self.weights.len() || weights.iter().any(|w| !w.is_finite()) {
            return Err(Error::new(Kind::Usage, format!("{} weights: {weights:?}", weights.len()))
                .expected(format!("{} numbers, one per example", self.weights.len())));
        }
        if let Some(weight) = weights.iter().find(|w| w.abs() > Self::FARTHEST) {
            return Err(too_far(*weight));
        }
        let distance = |from: &[f64]| from.iter().zip(weights).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let mut from = self.weights.clone();
        let mut nearest = distance(&from);
        for (i, pose) in self.poses.iter().enumerate() {
            let known: Vec<f64> = (1..self.poses.len()).map(|e| if e == i { 1.0 } else { 0.0 }).collect();
            if distance(&known) <= nearest {
                nearest = distance(&known);
                self.x.copy_from_slice(pose);
                from = known;
            }
        }
        let stages = (nearest / STAGE).ceil().max(1.0) as u32;
        let (mut minimum, mut steps) = (Minimum::default(), 0);
        for stage in 1..=stages {
            let share = f64::from(stage) / f64::from(stages);
            for ((weight, a), b) in self.weights.iter_mut().zip(&from).zip(weights) {
                *weight = if stage == stages { *b } else { a + share * (b - a) };
            }
            let settings = Settings { steps: if stage == stages { LAST_STEPS } else { STEPS }, ..SETTINGS };
            minimum = self.newton.minimize(&mut self.x, &mut self.weights, &Goals::NONE, &settings);
            steps += minimum.steps;
        }
        self.finish(Minimum { steps, ..minimum })
    }

    /// At most so many steps from a pose that is near, or from a known one where that resists less, for weights that are given: the last word of a finer mesh.
    ///
    /// # Errors
    /// [`Kind::Refused`] where the pose is not finite.
    pub fn refine(&mut self, weights: &[f64], near: &[DVec3], steps: u32) -> Result<FrameStats> {
        self.weights.copy_from_slice(weights);
        let mut least = self.newton.resisted(near, weights);
        self.x.copy_from_slice(near);
        for pose in &self.poses {
            let energy = self.newton.resisted(pose, weights);
            if energy < least {
                least = energy;
                self.x.copy_from_slice(pose);
            }
        }
        let settings = Settings { steps, ..SETTINGS };
        let minimum = self.newton.minimize(&mut self.x, &mut self.weights, &Goals::NONE, &settings);
        self.finish(minimum)
    }

    /// Vertices and the points off the triangles, as those of [`Body::proxy`].
    pub fn pose(&self) -> &[DVec3] {
        &self.pose
    }

    fn finish(&mut self, minimum: Minimum) -> Result<FrameStats> {
        if !minimum.energy().is_finite() || self.x.iter().any(|p| !p.is_finite()) {
            self.x.copy_from_slice(&self.poses[0]);
            return Err(
                Error::refused(format!("no pose for the weights {:?}", self.weights)).expected("weights nearer to 0 and 1")
            );
        }
        let beside = 1.0 - self.weights.iter().sum::<f64>();
        let blended: Vec<DVec3> = (0..self.x.len())
            .map(|v| {
                let examples = self.poses[1..].iter().zip(&self.weights).map(|(x, w)| x[v] * *w);
                self.poses[0][v] * beside + examples.sum::<DVec3>()
            })
            .collect();
        let even = vec![1.0; blended.len()];
        let rigid = Rigid::fit(&self.x, &Goals { positions: &blended, weights: &even });
        self.x.iter_mut().for_each(|p| *p = rigid.apply(*p));
        let n = self.x.len();
        let shell = &self.newton.shell;
        self.pose[..n].copy_from_slice(&self.x);
        for (point, face) in self.pose[n..].iter_mut().zip(&shell.faces) {
            *point = tip(&self.x, *face);
        }
        let now = volume(&self.x, &shell.faces, &shell.topology.holes);
        Ok(FrameStats {
            passes: minimum.steps,
            step: minimum.last.map_or(0.0, |moves| moves.most),
            error: minimum.last.filter(|_| minimum.is_settled()).map(|moves| moves.most),
            violation: None,
            converged: minimum.is_settled(),
            recovered: false,
            energy: minimum.energy(),
            inverted: 0,
            fold: None,
            volume_ratio: if shell.swell > 0.0 { now / shell.volume } else { 1.0 },
        })
    }
}

/// What is said of a weight beyond [`Interpolator::FARTHEST`].
pub(crate) fn too_far(weight: f64) -> Error {
    let most = Interpolator::FARTHEST;
    Error::new(Kind::Usage, format!("weight {weight}"))
        .expected(format!("weights from \u{2212}{most} to {most}; 1 is the example itself"))
}
