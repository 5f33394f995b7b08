//! Joints of some frames side by side, fitted in turn to what the others leave over (the bone step of Le & Deng 2012, weighted).
//!
//! The weights are the same in every frame: points and arms are looked up once for all lanes.

use super::Influences;
use super::rigid::{Rigid, nearest_rotation, outer};
use crate::linalg::lanes::for_each_instruction_set;
use glam::{DMat3, DVec3};

/// Pull towards the rotation of the step before: decides what points on a line or a plane leave open, changes nothing else.
const PRIOR: f64 = 1e-6;

/// Fewest points that hold a joint.
pub const FEWEST: usize = 4;

/// Frames that are fitted side by side.
pub const LANES: usize = 8;
/// A number in each of them.
pub type Wide = [f32; LANES];
/// An affine map in each of them: columns of the linear part, then the offset.
type WideMap = [Wide; 12];

/// Joints in some frames, and what they leave over of each point's target.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The joints.
    pub joints: Vec<[Rigid; LANES]>,
    /// Target less skinned point: x, y, z.
    pub left: Vec<[Wide; 3]>,
}

impl Fitted {
    /// Squared length of what is left over of each point in a frame.
    pub fn squares(&self, lane: usize) -> impl Iterator<Item = f32> {
        self.left.iter().map(move |r| r.iter().map(|c| c[lane] * c[lane]).sum())
    }
}

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
    weight: f32,
    /// Rest position from the support's middle.
    arm: [f32; 3],
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
    fn spans(&self, emphasis: &[Wide]) -> [Span; LANES] {
        let sums = span_sums(&self.hooks, emphasis);
        std::array::from_fn(|lane| {
            let [mass, x, y, z, xx, xy, xz, yy, yz, zz] = sums.map(|s| f64::from(s[lane]));
            let sum = DVec3::new(x, y, z);
            let square = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
            let mean = sum / mass;
            Span { mass, mean, scatter: square - outer(mean, sum) }
        })
    }
}

/// Points at rest with weights, joint by joint.
#[derive(Clone, Debug)]
pub struct Blend {
    supports: Vec<Support>,
}

impl Blend {
    /// Sorts the weights by joint.
    pub fn new(points: &[DVec3], influences: &[Influences], joints: usize) -> Self {
        let mut arms = vec![Vec::new(); joints];
        for (&point, (i, influence)) in points.iter().zip(influences.iter().enumerate()) {
            for (k, weight) in influence.iter().filter(|(_, w)| *w > 1e-6) {
                arms[k].push((i as u32, weight, point));
            }
        }
        let support = |arms: Vec<(u32, f64, DVec3)>| {
            let (sum, total) = arms.iter().fold((DVec3::ZERO, 0.0), |(s, t), (_, w, p)| (s + *p * (w * w), t + w * w));
            let middle = if total > 0.0 { sum / total } else { DVec3::ZERO };
            let hook = |(point, weight, p): (u32, f64, DVec3)| Hook {
                point,
                weight: weight as f32,
                arm: (p - middle).as_vec3().to_array(),
            };
            Support { middle, hooks: arms.into_iter().map(hook).collect() }
        };
        Self { supports: arms.into_iter().map(support).collect() }
    }

    /// What the joints leave over of the targets.
    pub fn begin(&self, joints: Vec<[Rigid; LANES]>, targets: Vec<[Wide; 3]>) -> Fitted {
        let mut left = targets;
        for (support, joint) in self.supports.iter().zip(&joints) {
            let map = wide_map(|lane| (joint[lane].rotation, joint[lane].apply(support.middle)));
            take_off(&support.hooks, &map, &mut left);
        }
        Fitted { joints, left }
    }

    /// Fits each joint once per sweep, in order, keeping what is left up to date. `emphasis` weighs the points' squared errors.
    pub fn sweep(&self, fitted: &mut Fitted, emphasis: &[Wide], sweeps: usize) {
        let spans: Vec<[Span; LANES]> = self.supports.iter().map(|s| s.spans(emphasis)).collect();
        for _ in 0..sweeps {
            for ((support, spans), joint) in self.supports.iter().zip(&spans).zip(&mut fitted.joints) {
                if support.hooks.len() >= FEWEST {
                    refit(support, spans, joint, &mut fitted.left, emphasis);
                }
            }
        }
    }
}

/// Fits a joint to what is left over and to what it carries itself.
fn refit(support: &Support, spans: &[Span; LANES], joint: &mut [Rigid; LANES], left: &mut [[Wide; 3]], emphasis: &[Wide]) {
    let sums = left_sums(&support.hooks, emphasis, left);
    let mut moves = [(DMat3::ZERO, DVec3::ZERO); LANES];
    for lane in 0..LANES {
        let Span { mass, mean, scatter } = spans[lane];
        if mass <= 0.0 {
            continue;
        }
        let at = |k: usize| DVec3::from_array([0, 1, 2].map(|axis| sums[3 * k + axis][lane].into()));
        let (left_sum, left_arm) = (at(0), DMat3::from_cols(at(1), at(2), at(3)));
        let joint = &mut joint[lane];
        let spread = scatter.x_axis.x + scatter.y_axis.y + scatter.z_axis.z;
        let covariance = left_arm - outer(left_sum, mean) + joint.rotation * scatter + joint.rotation * (PRIOR * spread);
        let rotation = nearest_rotation(&covariance, &joint.rotation);
        let turn = rotation - joint.rotation;
        // The middle's image moves so that the weighted mean of the residuals vanishes.
        let shift = left_sum / mass - turn * mean;
        let image = joint.apply(support.middle) + shift;
        *joint = Rigid { rotation, translation: image - rotation * support.middle };
        moves[lane] = (turn, shift);
    }
    take_off(&support.hooks, &wide_map(|lane| moves[lane]), left);
}

fn wide_map(of: impl Fn(usize) -> (DMat3, DVec3)) -> WideMap {
    let mut map = [[0.0; LANES]; 12];
    for lane in 0..LANES {
        let (linear, offset) = of(lane);
        let numbers = linear.to_cols_array().into_iter().chain(offset.to_array());
        map.iter_mut().zip(numbers).for_each(|(wide, x)| wide[lane] = x as f32);
    }
    map
}

for_each_instruction_set! {
    /// Takes off the points what a map of their arms gives them.
    fn take_off(hooks: &[Hook], map: &WideMap, left: &mut [[Wide; 3]]) {
        for hook in hooks {
            let [x, y, z] = hook.arm.map(|c| c * hook.weight);
            let left = &mut left[hook.point as usize];
            for axis in 0..3 {
                for lane in 0..LANES {
                    left[axis][lane] -= map[axis][lane] * x + map[3 + axis][lane] * y + map[6 + axis][lane] * z
                        + map[9 + axis][lane] * hook.weight;
                }
            }
        }
    }
}

for_each_instruction_set! {
    /// Sums over the hooks of what is left, and of that times each coordinate of the arm.
    fn left_sums(hooks: &[Hook], emphasis: &[Wide], left: &[[Wide; 3]]) -> WideMap {
        let mut sums = [[0.0; LANES]; 12];
        for hook in hooks {
            let (left, emphasis) = (&left[hook.point as usize], &emphasis[hook.point as usize]);
            for axis in 0..3 {
                let mut share = [0.0; LANES];
                for lane in 0..LANES {
                    share[lane] = hook.weight * emphasis[lane] * left[axis][lane];
                    sums[axis][lane] += share[lane];
                }
                for column in 0..3 {
                    for lane in 0..LANES {
                        sums[3 + 3 * column + axis][lane] += share[lane] * hook.arm[column];
                    }
                }
            }
        }
        sums
    }
}

for_each_instruction_set! {
    /// Sums over the hooks of their weights, of the arms and of their products.
    fn span_sums(hooks: &[Hook], emphasis: &[Wide]) -> [Wide; 10] {
        let mut sums = [[0.0; LANES]; 10];
        for hook in hooks {
            let [x, y, z] = hook.arm;
            let factors = [1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            let (square, emphasis) = (hook.weight * hook.weight, &emphasis[hook.point as usize]);
            for k in 0..10 {
                for lane in 0..LANES {
                    sums[k][lane] += square * factors[k] * emphasis[lane];
                }
            }
        }
        sums
    }
}

/// Damped reweighting of squared errors: the logarithm follows `2 log(error / tolerated)` within bounds.
#[derive(Clone, Debug)]
pub struct Emphasis {
    /// To base 2.
    logs: Vec<Wide>,
    weights: Vec<Wide>,
}

/// Where a weight begins to swing instead of helping, as a logarithm to base 2.
const MOST: f32 = 6.0;
/// The logarithm of errors that are too small to be told apart.
const LEAST: f32 = -2.0;

impl Emphasis {
    /// All equal.
    pub fn new(points: usize) -> Self {
        Self { logs: vec![[0.0; LANES]; points], weights: vec![[1.0; LANES]; points] }
    }

    /// Moves towards the errors that are left; `gain` in 0 ..= 1 is how far.
    pub fn follow(&mut self, left: &[[Wide; 3]], tolerated: f64, gain: f32) {
        let unit = (1.0 / (tolerated * tolerated)) as f32;
        follow(&mut self.logs, &mut self.weights, left, unit, gain);
    }

    /// The weights of the points.
    pub fn weights(&self) -> &[Wide] {
        &self.weights
    }
}

for_each_instruction_set! {
    fn follow(logs: &mut [Wide], weights: &mut [Wide], left: &[[Wide; 3]], unit: f32, gain: f32) {
        for ((log, weight), left) in logs.iter_mut().zip(weights).zip(left) {
            for lane in 0..LANES {
                let square = left[0][lane] * left[0][lane] + left[1][lane] * left[1][lane] + left[2][lane] * left[2][lane];
                (log[lane], weight[lane]) = followed(log[lane], square * unit, gain);
            }
        }
    }
}

/// The logarithm moved towards that of a squared error in units of the tolerated one, and the weight that it stands for.
#[inline(always)]
pub fn followed(log: f32, square: f32, gain: f32) -> (f32, f32) {
    let log = log + gain * (log2(square).max(LEAST) - log);
    (log, exp2(log.min(MOST)))
}

/// Within 3e-4 for normal numbers; far below 0 for 0. Plain arithmetic: the same bits everywhere, and it vectorises.
#[inline(always)]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let t = f32::from_bits(bits & 0x7f_ffff | 1f32.to_bits()) - 1.0;
    // Exact at both ends; between them fitted by least squares.
    let mantissa = t + t * (1.0 - t) * (0.441_022 + t * (-0.244_374 + t * 0.083_259));
    ((bits >> 23) as i32 - 127) as f32 + mantissa
}

/// Within 1e-4, for small arguments: four terms of the series about the nearest whole number.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    // Adding this rounds to a whole number, which is then in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    let rounded = x + ROUND;
    let power = f32::from_bits((rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127)) << 23);
    let f = (x - (rounded - ROUND)) * std::f32::consts::LN_2;
    power * (1.0 + f * (1.0 + f * (1.0 / 2.0 + f * (1.0 / 6.0 + f / 24.0))))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn wide(p: DVec3) -> [Wide; 3] {
        p.as_vec3().to_array().map(|c| [c; LANES])
    }

    fn of_lane(left: &[[Wide; 3]], lane: usize) -> Vec<DVec3> {
        left.iter().map(|r| DVec3::new(r[0][lane].into(), r[1][lane].into(), r[2][lane].into())).collect()
    }

    #[test]
    fn sweeps_find_the_joints_of_an_exact_skin_in_every_lane() {
        let points: Vec<DVec3> =
            (0..200).map(|i| DVec3::new(i as f64 / 200.0, (i as f64 * 0.9).sin() * 0.1, (i as f64 * 1.7).cos() * 0.1)).collect();
        let influences: Vec<Influences> = points
            .iter()
            .map(|p| {
                let w = (3.0 * p.x - 1.0).clamp(0.0, 1.0);
                Influences { joints: [0, 1, 0, 0], weights: [1.0 - w, w, 0.0, 0.0] }
            })
            .collect();
        let truth = |lane: usize| {
            let turn = |angle: f64| DMat3::from_rotation_z(angle + 0.05 * lane as f64);
            [
                Rigid { rotation: turn(0.2), translation: DVec3::new(0.1, 0.0, 0.0) },
                Rigid { rotation: turn(1.1), translation: DVec3::new(0.2, -0.3, 0.1) },
            ]
        };
        let mut targets = vec![[[0.0; LANES]; 3]; points.len()];
        for lane in 0..LANES {
            for ((p, i), target) in points.iter().zip(&influences).zip(&mut targets) {
                let q: DVec3 = i.iter().map(|(k, w)| truth(lane)[k].apply(*p) * w).sum();
                (0..3).for_each(|axis| target[axis][lane] = q[axis] as f32);
            }
        }
        let blend = Blend::new(&points, &influences, 2);
        let mut fitted = blend.begin(vec![[Rigid::IDENTITY; LANES]; 2], targets.clone());
        blend.sweep(&mut fitted, &vec![[1.0; LANES]; points.len()], 60);
        let again = blend.begin(fitted.joints.clone(), targets);
        for lane in 0..LANES {
            for (a, b) in of_lane(&fitted.left, lane).iter().zip(of_lane(&again.left, lane)) {
                assert!(a.length() < 1e-4 && (*a - b).length() < 1e-6, "{lane} {a} {b}");
            }
        }
    }

    #[test]
    fn a_sweep_balances_what_is_left_by_its_emphasis() {
        let points: Vec<DVec3> = (0..30).map(|i| DVec3::new(i as f64 / 30.0, (i as f64).sin(), (i as f64 * 1.7).cos())).collect();
        let target = |(i, p): (usize, &DVec3)| wide(*p * 1.2 + DVec3::Y * (i as f64 * 0.37).sin());
        let targets: Vec<[Wide; 3]> = points.iter().enumerate().map(target).collect();
        let mut emphasis = Emphasis::new(points.len());
        let errors: Vec<[Wide; 3]> = (0..30).map(|i| wide(DVec3::X * f64::from(i % 5))).collect();
        emphasis.follow(&errors, 1.0, 1.0);
        let weights = emphasis.weights();
        assert!(weights[4][0] > 4.0 * weights[0][0]);
        let blend = Blend::new(&points, &[Influences { joints: [0; 4], weights: [1.0, 0.0, 0.0, 0.0] }; 30], 1);
        let mut fitted = blend.begin(vec![[Rigid::IDENTITY; LANES]], targets.clone());
        blend.sweep(&mut fitted, weights, 1);
        let pull: DVec3 = of_lane(&fitted.left, 3).iter().zip(weights).map(|(r, w)| *r * f64::from(w[3])).sum();
        assert!(pull.length() < 1e-4, "{pull}");
        let mut at_once = blend.begin(vec![[Rigid::IDENTITY; LANES]], targets);
        blend.sweep(&mut at_once, weights, 2);
        blend.sweep(&mut fitted, weights, 1);
        assert_eq!((fitted.left, fitted.joints), (at_once.left, at_once.joints));
    }

    #[test]
    fn logarithms_and_powers_are_near_enough() {
        for k in 1..4000 {
            let x = k as f32 * 0.013;
            assert!((log2(x) - x.log2()).abs() < 4e-4, "{x}");
            let y = x % 8.0 - 2.0;
            assert!((exp2(y) / y.exp2() - 1.0).abs() < 1e-4, "{y}");
        }
        assert!(log2(0.0) < -100.0);
        let (log, weight) = followed(1.0, 4.0, 0.5);
        assert!((log - 1.5).abs() < 1e-3 && (weight - 2f32.powf(1.5)).abs() < 1e-2);
        assert!((followed(0.0, 1e9, 1.0).1 - 64.0).abs() < 1e-2 && (followed(0.0, 0.0, 1.0).1 - 0.25).abs() < 1e-3);
    }
}
