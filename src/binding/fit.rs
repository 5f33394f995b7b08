//! The scan's own segments, posed and resized until named markers lie where the dictionary expects them.
//!
//! Unknowns: position of the pelvis, one rotation per segment, nine length ratios, one scale, a shift of each shoulder, a girth ratio.
//! Levenberg–Marquardt on robust marker distances with weak priors; the Jacobian by differences, since one evaluation costs microseconds.

use super::segments::{Segment, Side, Skeleton};
use glam::{DQuat, DVec3};

/// Length ratios, actor to scan, that the fit solves for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub(crate) enum Ratio {
    Torso,
    Width,
    UpperArm,
    Forearm,
    Hand,
    Thigh,
    Shank,
    Foot,
    Head,
}

pub(crate) const RATIOS: usize = 9;

/// The ratios that decide on the size of a person.
pub(crate) const SIZE: [(Ratio, &str); 5] = [
    (Ratio::Torso, "torso"),
    (Ratio::UpperArm, "upper arm"),
    (Ratio::Forearm, "forearm"),
    (Ratio::Thigh, "thigh"),
    (Ratio::Shank, "shank"),
];

fn ratio_of(segment: Segment) -> Ratio {
    use Segment::*;
    match segment {
        Pelvis => Ratio::Width,
        Trunk => Ratio::Torso,
        Head => Ratio::Head,
        LeftUpperArm | RightUpperArm => Ratio::UpperArm,
        LeftForearm | RightForearm => Ratio::Forearm,
        LeftHand | RightHand => Ratio::Hand,
        LeftThigh | RightThigh => Ratio::Thigh,
        LeftShank | RightShank => Ratio::Shank,
        LeftFoot | RightFoot => Ratio::Foot,
    }
}

/// A named marker of the reference frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    /// The marker, in the unit box by a first upright placement.
    pub marker: DVec3,
    /// The landmark on the skin of the scan at rest.
    pub place: DVec3,
    pub segment: Segment,
    pub weight: f64,
}

/// The scan's skeleton in the actor's pose and size.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    /// Global rotation of each segment against the scan's rest.
    pub rotations: [DQuat; Segment::COUNT],
    /// Origin of each segment in the space of the observations, size included.
    pub origins: [DVec3; Segment::COUNT],
    /// Size of the actor against the scan, in the space of the observations: geometric mean over torso, arms and legs.
    pub size: f64,
    /// Length ratios against `size`.
    pub ratios: [f64; RATIOS],
    /// Distance of each observation from its fitted landmark, in the space of the observations.
    pub residuals: Vec<f64>,
}

/// Distances count from this share of stature on as errors rather than noise.
pub(super) const SIGMA: f64 = 0.02;
const ITERATIONS: usize = 200;
/// The fit is done when no unknown (radians, shares of the unit box, logarithms) changes by more in a step.
const DONE: f64 = 1e-10;
/// Near the minimum the cost is known to this part only, the way to it better.
const ROUNDING: f64 = 1e-13;

const PARAMETERS: usize = 65;
const TURNS: usize = 3;
const LENGTHS: usize = 48;
const SCALE: usize = 57;
const SHOULDERS: usize = 58;
const GIRTH: usize = 64;

#[derive(Clone, Debug)]
struct State {
    root: DVec3,
    rotations: [DQuat; Segment::COUNT],
    lengths: [f64; RATIOS],
    scale: f64,
    shoulders: [DVec3; 2],
    girth: f64,
}

impl State {
    fn moved(&self, step: &[f64]) -> Self {
        let mut out = self.clone();
        let v = |at: usize| DVec3::new(step[at], step[at + 1], step[at + 2]);
        out.root += v(0);
        for (i, q) in out.rotations.iter_mut().enumerate() {
            *q = (DQuat::from_scaled_axis(v(TURNS + 3 * i)) * *q).normalize();
        }
        for (length, d) in out.lengths.iter_mut().zip(&step[LENGTHS..SCALE]) {
            *length += d;
        }
        out.scale += step[SCALE];
        out.shoulders[0] += v(SHOULDERS);
        out.shoulders[1] += v(SHOULDERS + 3);
        out.girth += step[GIRTH];
        out
    }

    fn length(&self, ratio: Ratio) -> f64 {
        self.lengths[ratio as usize].exp()
    }

    fn origins(&self, body: &Skeleton) -> [DVec3; Segment::COUNT] {
        let mut origins = [self.root; Segment::COUNT];
        for segment in Segment::ALL {
            let Some(parent) = segment.parent() else { continue };
            let offset = body.bone(segment).origin - body.bone(parent).origin;
            let offset = match segment {
                Segment::Trunk | Segment::Head => offset * self.length(Ratio::Torso),
                Segment::LeftUpperArm => offset * self.length(Ratio::Torso) + self.shoulders[0],
                Segment::RightUpperArm => offset * self.length(Ratio::Torso) + self.shoulders[1],
                Segment::LeftThigh | Segment::RightThigh => offset * self.length(Ratio::Width),
                _ => offset * self.length(ratio_of(parent)),
            };
            origins[segment as usize] = origins[parent as usize] + self.rotations[parent as usize] * offset;
        }
        origins
    }

    fn predict(&self, body: &Skeleton, origins: &[DVec3; Segment::COUNT], o: &Observation) -> DVec3 {
        let bone = body.bone(o.segment);
        let v = o.place - bone.origin;
        let length = self.length(ratio_of(o.segment));
        let v = match o.segment {
            Segment::Pelvis | Segment::Trunk | Segment::Head => v * length,
            _ => {
                let along = bone.axis * v.dot(bone.axis);
                along * length + (v - along) * self.girth.exp()
            }
        };
        (origins[o.segment as usize] + self.rotations[o.segment as usize] * v) * self.scale.exp()
    }
}

/// How strongly a segment keeps its rest orientation against its parent, per radian. The head is held hard: the tilt of a head band is not
/// the tilt of the head.
fn stiffness(segment: Segment) -> f64 {
    use Segment::*;
    3.0 * match segment {
        Head => 5.0,
        Trunk => 2.0,
        LeftHand | RightHand | LeftFoot | RightFoot => 0.6,
        _ => 0.12,
    }
}

impl State {
    fn at_rest(body: &Skeleton) -> Self {
        Self {
            root: body.bone(Segment::Pelvis).origin,
            rotations: [DQuat::IDENTITY; Segment::COUNT],
            lengths: [0.0; RATIOS],
            scale: 0.0,
            shoulders: [DVec3::ZERO; 2],
            girth: 0.0,
        }
    }
}

/// Fits the skeleton to the observations, starting from the rest pose at the pelvis of the scan.
pub(crate) fn fit(body: &Skeleton, observations: &[Observation]) -> Fit {
    let mut state = State::at_rest(body);
    let problem = Problem { body, observations };
    let mut residuals = problem.residuals(&state);
    let mut cost = problem.cost(&residuals);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let (normal, gradient) = problem.normal_equations(&state, &residuals);
        let mut moved = None;
        while damping < 1e8 {
            let Some(step) = solve(&normal, &gradient, damping) else {
                damping *= 10.0;
                continue;
            };
            let trial = state.moved(&step);
            let trial_residuals = problem.residuals(&trial);
            let trial_cost = problem.cost(&trial_residuals);
            if trial_cost < cost * (1.0 + ROUNDING) {
                moved = step.iter().map(|x| x.abs()).reduce(f64::max);
                (state, residuals, cost) = (trial, trial_residuals, trial_cost);
                damping = (damping * 0.2).max(1e-9);
                break;
            }
            damping *= 5.0;
        }
        if moved.is_none_or(|m| m < DONE) {
            break;
        }
    }
    finish(body, observations, &state)
}

fn finish(body: &Skeleton, observations: &[Observation], state: &State) -> Fit {
    let origins = state.origins(body);
    let scale = state.scale.exp();
    let mean = SIZE.iter().map(|&(r, _)| state.lengths[r as usize]).sum::<f64>() / SIZE.len() as f64;
    Fit {
        rotations: state.rotations,
        origins: origins.map(|o| o * scale),
        size: scale * mean.exp(),
        ratios: state.lengths.map(|l| (l - mean).exp()),
        residuals: observations.iter().map(|o| (state.predict(body, &origins, o) - o.marker).length()).collect(),
    }
}

impl Fit {
    /// Counts another overall size as the actor's; the length ratios change against it.
    pub(crate) fn resize(&mut self, size: f64) {
        for ratio in &mut self.ratios {
            *ratio *= self.size / size;
        }
        self.size = size;
    }

    /// A point of the space of the observations, carried with a segment back to the scan's rest pose: its distance from the bone is kept at
    /// the actor's overall size, its place along a limb or the trunk follows the scan's own length.
    pub(crate) fn carry(&self, body: &Skeleton, segment: Segment, p: DVec3) -> DVec3 {
        let bone = body.bone(segment);
        let v = self.rotations[segment as usize].inverse() * (p - self.origins[segment as usize]) / self.size;
        if segment.is_stiff() {
            return bone.origin + v;
        }
        let along = bone.axis * v.dot(bone.axis);
        bone.origin + (v - along) + along / self.ratios[ratio_of(segment) as usize]
    }

    /// A point of the scan at rest, carried with a segment into the actor's pose: the inverse of [`Fit::carry`].
    pub(crate) fn pose(&self, body: &Skeleton, segment: Segment, rest: DVec3) -> DVec3 {
        let bone = body.bone(segment);
        let mut v = rest - bone.origin;
        if !segment.is_stiff() {
            let along = bone.axis * v.dot(bone.axis);
            v += along * (self.ratios[ratio_of(segment) as usize] - 1.0);
        }
        self.origins[segment as usize] + self.rotations[segment as usize] * v * self.size
    }

    /// Segments whose axes lean against their parents by more than 20 degrees more than in the scan, with the angle.
    pub(crate) fn bends(&self, body: &Skeleton) -> Vec<(Segment, f64)> {
        let angle = |segment: Segment| {
            let parent = segment.parent()?;
            let relative = self.rotations[parent as usize].inverse() * self.rotations[segment as usize];
            let axis = body.bone(segment).axis;
            let angle = (relative * axis).dot(axis).clamp(-1.0, 1.0).acos().to_degrees();
            (angle > 20.0).then_some((segment, angle))
        };
        Segment::ALL.into_iter().filter_map(angle).collect()
    }

    /// Elevation of an upper arm against the horizontal, in degrees.
    pub(crate) fn arm_elevation(&self, body: &Skeleton, side: Side) -> f64 {
        let segment = if side == Side::Right { Segment::RightUpperArm } else { Segment::LeftUpperArm };
        let axis = self.rotations[segment as usize] * body.bone(segment).axis;
        axis.dot(body.up).clamp(-1.0, 1.0).asin().to_degrees()
    }
}

struct Problem<'a> {
    body: &'a Skeleton,
    observations: &'a [Observation],
}

impl Problem<'_> {
    /// Marker residuals (three each), then those of the priors.
    fn residuals(&self, state: &State) -> Vec<f64> {
        let height = self.body.stature;
        let origins = state.origins(self.body);
        let mut out = Vec::with_capacity(3 * self.observations.len() + 3 * Segment::COUNT + 20);
        for o in self.observations {
            let r = (state.predict(self.body, &origins, o) - o.marker) * (o.weight / (SIGMA * height));
            out.extend(r.to_array());
        }
        for segment in Segment::ALL {
            if let Some(parent) = segment.parent() {
                let mut relative = state.rotations[parent as usize].inverse() * state.rotations[segment as usize];
                if relative.w < 0.0 {
                    relative = -relative;
                }
                out.extend((relative.to_scaled_axis() * stiffness(segment)).to_array());
            }
        }
        out.extend(state.lengths.iter().map(|l| l / 0.12));
        out.push(state.scale / 0.3);
        for shift in state.shoulders {
            out.extend((shift / (0.03 * height)).to_array());
        }
        out.push(state.girth / 0.15);
        out
    }

    fn marker_squared(&self, residuals: &[f64], i: usize) -> f64 {
        residuals[3 * i..3 * i + 3].iter().map(|r| r * r).sum()
    }

    /// Soft-L1 in the markers, squares in the priors.
    fn cost(&self, residuals: &[f64]) -> f64 {
        let n = self.observations.len();
        let markers: f64 = (0..n).map(|i| 2.0 * ((1.0 + self.marker_squared(residuals, i)).sqrt() - 1.0)).sum();
        markers + residuals[3 * n..].iter().map(|r| r * r).sum::<f64>()
    }

    fn normal_equations(&self, state: &State, residuals: &[f64]) -> (Vec<f64>, Vec<f64>) {
        const STEP: f64 = 1e-5;
        let n = residuals.len();
        let weights: Vec<f64> = (0..n)
            .map(|row| match row / 3 {
                i if i < self.observations.len() => (1.0 + self.marker_squared(residuals, i)).powf(-0.5),
                _ => 1.0,
            })
            .collect();
        let columns: Vec<Vec<f64>> = (0..PARAMETERS)
            .map(|k| {
                let mut step = [0.0; PARAMETERS];
                let mut at = |x: f64| {
                    step[k] = x;
                    self.residuals(&state.moved(&step))
                };
                at(STEP).iter().zip(at(-STEP)).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()
            })
            .collect();
        let mut normal = vec![0.0; PARAMETERS * PARAMETERS];
        let mut gradient = vec![0.0; PARAMETERS];
        for i in 0..PARAMETERS {
            let weighted: Vec<f64> = columns[i].iter().zip(&weights).map(|(a, w)| a * w).collect();
            gradient[i] = weighted.iter().zip(residuals).map(|(a, r)| a * r).sum();
            for j in 0..=i {
                normal[i * PARAMETERS + j] = weighted.iter().zip(&columns[j]).map(|(a, b)| a * b).sum();
            }
        }
        (normal, gradient)
    }
}

/// Step of the damped normal equations by Cholesky; `None` where they are not positive definite.
pub(super) fn solve(normal: &[f64], gradient: &[f64], damping: f64) -> Option<Vec<f64>> {
    let n = gradient.len();
    let mut l = normal.to_vec();
    for i in 0..n {
        l[i * n + i] += damping * normal[i * n + i] + 1e-12;
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
            let value = l[i * n + j] - dot;
            l[i * n + j] = if i == j {
                if value.is_nan() || value <= 0.0 {
                    return None;
                }
                value.sqrt()
            } else {
                value / l[j * n + j]
            };
        }
    }
    let mut x: Vec<f64> = gradient.iter().map(|g| -g).collect();
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
        x[i] = (x[i] - dot) / l[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
        x[i] = (x[i] - dot) / l[i * n + i];
    }
    Some(x)
}

/// Landmarks as an actor of other pose and proportions would show them: `turns` of segments against their parents, length ratios.
#[cfg(test)]
pub(super) fn simulate(
    body: &Skeleton,
    observations: &[Observation],
    turns: &[(Segment, DVec3)],
    ratios: &[(Ratio, f64)],
) -> Vec<DVec3> {
    let mut state = State::at_rest(body);
    for &(ratio, value) in ratios {
        state.lengths[ratio as usize] = value.ln();
    }
    for segment in Segment::ALL {
        let above = segment.parent().map_or(DQuat::IDENTITY, |p| state.rotations[p as usize]);
        let own = turns.iter().filter(|t| t.0 == segment).fold(DQuat::IDENTITY, |q, t| q * DQuat::from_scaled_axis(t.1));
        state.rotations[segment as usize] = above * own;
    }
    let origins = state.origins(body);
    observations.iter().map(|o| state.predict(body, &origins, o)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::{PLUG_IN_GAIT, labels_of, landmarks_of, person};
    use super::*;

    /// A skeleton, and its landmarks as the markers of somebody who stands like it.
    fn standing() -> (Skeleton, Vec<Observation>) {
        let person = person(0.75);
        let body = Skeleton::of(&person.body);
        let mut seen = landmarks_of(&person, &labels_of(&PLUG_IN_GAIT));
        let markers = simulate(&body, &seen, &[], &[]);
        seen.iter_mut().zip(markers).for_each(|(o, marker)| o.marker = marker);
        (body, seen)
    }

    #[test]
    fn another_size_changes_the_ratios_and_nothing_that_was_fitted() {
        let (body, seen) = standing();
        let before = fit(&body, &seen);
        let mut after = before.clone();
        after.resize(1.25 * before.size);
        assert_eq!(after.size, 1.25 * before.size);
        for (a, b) in after.ratios.iter().zip(before.ratios) {
            assert!((a * after.size - b * before.size).abs() < 1e-12);
        }
        for o in &seen {
            let there = after.pose(&body, o.segment, o.place);
            assert!(after.carry(&body, o.segment, there).distance(o.place) < 1e-9, "{:?}", o.segment);
        }
    }

    #[test]
    fn a_limb_is_bent_from_twenty_degrees_on() {
        let (body, seen) = standing();
        let mut fit = fit(&body, &seen);
        assert!(fit.bends(&body).is_empty(), "{:?}", fit.bends(&body));
        let upper = fit.rotations[Segment::LeftUpperArm as usize];
        let across = body.bone(Segment::LeftForearm).axis.any_orthonormal_vector();
        for (degrees, told) in [(15.0_f64, false), (25.0, true), (80.0, true)] {
            fit.rotations[Segment::LeftForearm as usize] = upper * DQuat::from_axis_angle(across, degrees.to_radians());
            let bend = fit.bends(&body).iter().find(|b| b.0 == Segment::LeftForearm).map(|b| b.1);
            assert_eq!(bend.is_some(), told, "{degrees}");
            assert!(bend.is_none_or(|b| (b - degrees).abs() < 1e-6), "{degrees}: {bend:?}");
        }
    }
}
