//! Joints of one frame, fitted in turn to what the others leave over (the bone step of Le & Deng 2012, weighted).

use super::Influences;
use super::rigid::{Rigid, nearest_rotation, outer};
use glam::{DMat3, DVec3};

/// Pull towards the rotation of the step before: decides what points on a line or a plane leave open, changes nothing else.
const PRIOR: f64 = 1e-6;

/// Fewest points that hold a joint.
pub const FEWEST: usize = 4;

/// Points that hang on a joint.
#[derive(Clone, Debug, Default)]
struct Support {
    /// Their middle, so that arms are short numbers.
    middle: DVec3,
    hooks: Vec<Hook>,
}

#[derive(Clone, Copy, Debug)]
struct Hook {
    point: u32,
    weight: f64,
    /// Rest position from the support's middle.
    arm: DVec3,
}

/// Weighted moments of a support's arms: what a joint's fit needs besides the errors.
#[derive(Clone, Copy, Debug)]
struct Span {
    mass: f64,
    mean: DVec3,
    /// About the mean.
    scatter: DMat3,
}

impl Support {
    fn span(&self, emphasis: Option<&[f64]>) -> Span {
        let mut mass = 0.0;
        let mut sum = DVec3::ZERO;
        let mut square = DMat3::ZERO;
        for hook in &self.hooks {
            let a = hook.weight * emphasis.map_or(1.0, |e| e[hook.point as usize]) * hook.weight;
            let arm = hook.arm * a;
            mass += a;
            sum += arm;
            square += outer(arm, hook.arm);
        }
        let mean = sum / mass;
        Span { mass, mean, scatter: square - outer(mean, sum) }
    }
}

/// Points at rest with weights, joint by joint.
#[derive(Clone, Debug)]
pub struct Blend {
    supports: Vec<Support>,
    /// Of the supports, without emphasis.
    spans: Vec<Span>,
}

impl Blend {
    /// Sorts the weights by joint.
    pub fn new(points: &[DVec3], influences: &[Influences], joints: usize) -> Self {
        let mut supports = vec![Support::default(); joints];
        for (i, influence) in influences.iter().enumerate() {
            for (k, weight) in influence.iter().filter(|(_, w)| *w > 1e-6) {
                supports[k].hooks.push(Hook { point: i as u32, weight, arm: points[i] });
            }
        }
        for support in &mut supports {
            let (sum, total) = support.hooks.iter().fold((DVec3::ZERO, 0.0), |(s, t), h| {
                let w = h.weight * h.weight;
                (s + h.arm * w, t + w)
            });
            if total > 0.0 {
                support.middle = sum / total;
            }
            for hook in &mut support.hooks {
                hook.arm -= support.middle;
            }
        }
        let spans = supports.iter().map(|s| s.span(None)).collect();
        Self { supports, spans }
    }

    /// What the joints leave over: target less skinned point.
    pub fn residuals(&self, joints: &[Rigid], targets: &[DVec3]) -> Vec<DVec3> {
        let mut left = targets.to_vec();
        for (support, joint) in self.supports.iter().zip(joints) {
            let middle = joint.apply(support.middle);
            for hook in &support.hooks {
                left[hook.point as usize] -= (joint.rotation * hook.arm + middle) * hook.weight;
            }
        }
        left
    }

    /// Fits each joint once per sweep, in order, keeping `left` up to date. `emphasis` weighs the points' squared errors.
    pub fn sweep(&self, joints: &mut [Rigid], left: &mut [DVec3], emphasis: Option<&[f64]>, sweeps: usize) {
        let own;
        let spans: &[Span] = match emphasis {
            None => &self.spans,
            Some(emphasis) => {
                own = self.supports.iter().map(|s| s.span(Some(emphasis))).collect::<Vec<_>>();
                &own
            }
        };
        for _ in 0..sweeps {
            self.sweep_once(joints, left, emphasis, spans);
        }
    }

    fn sweep_once(&self, joints: &mut [Rigid], left: &mut [DVec3], emphasis: Option<&[f64]>, spans: &[Span]) {
        for ((support, span), joint) in self.supports.iter().zip(spans).zip(joints) {
            let Span { mass, mean, scatter } = *span;
            if support.hooks.len() < FEWEST || mass <= 0.0 {
                continue;
            }
            let mut left_sum = DVec3::ZERO;
            let mut left_arm = DMat3::ZERO;
            for hook in &support.hooks {
                let b = hook.weight * emphasis.map_or(1.0, |e| e[hook.point as usize]);
                let r = left[hook.point as usize] * b;
                left_sum += r;
                left_arm += outer(r, hook.arm);
            }
            let spread = scatter.x_axis.x + scatter.y_axis.y + scatter.z_axis.z;
            let covariance = left_arm - outer(left_sum, mean) + joint.rotation * scatter + joint.rotation * (PRIOR * spread);
            let rotation = nearest_rotation(&covariance, &joint.rotation);
            let turn = rotation - joint.rotation;
            // The middle's image moves so that the weighted mean of the residuals vanishes.
            let shift = left_sum / mass - turn * mean;
            let image = joint.apply(support.middle) + shift;
            *joint = Rigid { rotation, translation: image - rotation * support.middle };
            for hook in &support.hooks {
                left[hook.point as usize] -= (turn * hook.arm + shift) * hook.weight;
            }
        }
    }
}

/// Damped reweighting of squared errors: the logarithm follows `2 log(error / tolerated)` within bounds.
#[derive(Clone, Debug)]
pub struct Emphasis {
    logs: Vec<f64>,
    weights: Vec<f64>,
}

impl Emphasis {
    /// All equal; `weights` gives `None` until the first [`Emphasis::follow`].
    pub fn new(points: usize) -> Self {
        Self { logs: vec![0.0; points], weights: Vec::new() }
    }

    /// Moves towards the errors that are left; `gain` in 0 ..= 1 is how far.
    pub fn follow(&mut self, left: &[DVec3], tolerated: f64, gain: f64) {
        let unit = 1.0 / (tolerated * tolerated);
        for (log, r) in self.logs.iter_mut().zip(left) {
            *log += gain * (emphasis_target(r.length_squared() * unit) - *log);
        }
        self.weights.clear();
        self.weights.extend(self.logs.iter().map(|&l| emphasis_weight(l)));
    }

    /// The weights.
    pub fn weights(&self) -> Option<&[f64]> {
        (!self.weights.is_empty()).then_some(&self.weights)
    }
}

/// Where the logarithm of the weight goes for a squared error in units of the tolerated one.
pub fn emphasis_target(squared: f64) -> f64 {
    squared.max(0.25).ln()
}

/// The weight of a logarithm; above 64 the iteration swings.
pub fn emphasis_weight(log: f64) -> f64 {
    log.min(64f64.ln()).exp()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn sweeps_find_the_joints_of_an_exact_skin() {
        let points: Vec<DVec3> =
            (0..200).map(|i| DVec3::new(i as f64 / 200.0, (i as f64 * 0.9).sin() * 0.1, (i as f64 * 1.7).cos() * 0.1)).collect();
        let influences: Vec<Influences> = points
            .iter()
            .map(|p| {
                let w = (3.0 * p.x - 1.0).clamp(0.0, 1.0);
                Influences { joints: [0, 1, 0, 0], weights: [1.0 - w, w, 0.0, 0.0] }
            })
            .collect();
        let truth = [
            Rigid { rotation: DMat3::from_rotation_z(0.2), translation: DVec3::new(0.1, 0.0, 0.0) },
            Rigid { rotation: DMat3::from_rotation_z(1.1), translation: DVec3::new(0.2, -0.3, 0.1) },
        ];
        let targets: Vec<DVec3> =
            points.iter().zip(&influences).map(|(p, i)| i.iter().map(|(k, w)| truth[k].apply(*p) * w).sum()).collect();
        let blend = Blend::new(&points, &influences, 2);
        let mut joints = [Rigid::IDENTITY; 2];
        let mut left = blend.residuals(&joints, &targets);
        blend.sweep(&mut joints, &mut left, None, 60);
        for (a, b) in left.iter().zip(blend.residuals(&joints, &targets)) {
            assert!(a.length() < 1e-4 && (*a - b).length() < 1e-12);
        }
    }

    #[test]
    fn a_sweep_balances_what_is_left_by_its_emphasis() {
        let points: Vec<DVec3> = (0..30).map(|i| DVec3::new(i as f64 / 30.0, (i as f64).sin(), (i as f64 * 1.7).cos())).collect();
        let targets: Vec<DVec3> = points.iter().enumerate().map(|(i, p)| *p * 1.2 + DVec3::Y * (i as f64 * 0.37).sin()).collect();
        let mut emphasis = Emphasis::new(points.len());
        let errors: Vec<DVec3> = (0..30).map(|i| DVec3::X * f64::from(i % 5)).collect();
        emphasis.follow(&errors, 1.0, 1.0);
        let weights = emphasis.weights().unwrap();
        assert!(weights[4] > 4.0 * weights[0]);
        let blend = Blend::new(&points, &[Influences { joints: [0; 4], weights: [1.0, 0.0, 0.0, 0.0] }; 30], 1);
        let mut joints = [Rigid::IDENTITY];
        let mut left = blend.residuals(&joints, &targets);
        blend.sweep(&mut joints, &mut left, Some(weights), 1);
        let pull: DVec3 = left.iter().zip(weights).map(|(r, w)| *r * *w).sum();
        assert!(pull.length() < 1e-9, "{pull}");
        let (mut again, mut joints_again) = (blend.residuals(&[Rigid::IDENTITY], &targets), [Rigid::IDENTITY]);
        blend.sweep(&mut joints_again, &mut again, Some(weights), 2);
        blend.sweep(&mut joints, &mut left, Some(weights), 1);
        assert_eq!((left, joints), (again, joints_again));
    }
}
