//! Joints and weights of the proxy's motion: alternation on chosen frames, transforms on all frames, more joints where the error is.

use super::blend::{Blend, Emphasis, Fitted, LANES, Wide};
use super::motion::{FitPoints, Motion};
use super::rigid::{Packed, Rigid};
use super::sample::{JointPlanes, Sample, products};
use super::select::{CANDIDATES, Gram, PAIRS};
use super::start::{nearest_to, split};
use super::table::Growing;
use super::tracks::Tracks;
use super::{Encode, Influences, Tolerance};
use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// Frames that weights are learned from at first: more teach nothing new.
const FIRST_FRAMES: usize = 32;
/// Joints to begin with. Growing from too few ends with more.
const FIRST_JOINTS: usize = 56;
/// Joints at most: with the root they fit bytes, and what players allow in one skin.
pub const MOST_JOINTS: usize = 250;
/// Rounds of improvement at most.
const CYCLES: usize = 8;
/// The same when points are added.
const LATER_CYCLES: usize = 3;
/// An error that uses more of the tolerance needs many joints more.
const FAR_OFF: f64 = 2.0;
/// A frame that uses less of the tolerance needs no more rounds.
const SETTLED: f64 = 0.5;

/// A skin of the fit points.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The points.
    pub points: FitPoints,
    /// Weights per point.
    pub influences: Vec<Influences>,
    /// Joints in all frames.
    pub tracks: Tracks,
    /// The frames that weights were learned from.
    pub sample: Sample,
    /// Errors that are left.
    pub error: FitError,
}

/// Errors of a fit.
#[derive(Clone, Debug, Default)]
pub struct FitError {
    /// Sum over frames of squared errors, per point.
    pub squares: Vec<f64>,
    /// Largest squared error over frames, per point.
    pub worst_square: Vec<f64>,
    /// Largest error, per frame.
    pub per_frame: Vec<f64>,
    /// Points that count for the mean: those picked out because they are bad do not.
    counted: usize,
}

impl FitError {
    fn new(counted: usize) -> Self {
        Self { counted, ..Self::default() }
    }

    /// How much of a tolerance it uses.
    pub fn used(&self, tolerance: Tolerance) -> f64 {
        tolerance.used(self.worst(), self.rms())
    }

    /// Largest error.
    pub fn worst(&self) -> f64 {
        self.worst_square.iter().fold(0.0, |a: f64, &b| a.max(b)).sqrt()
    }

    /// Root mean square over the proxy's points.
    pub fn rms(&self) -> f64 {
        (self.squares[..self.counted].iter().sum::<f64>() / (self.counted * self.per_frame.len()) as f64).sqrt()
    }

    /// Number of frames with a point beyond the tolerance.
    pub fn frames_over(&self, tolerance: Tolerance) -> usize {
        self.per_frame.iter().filter(|e| **e > tolerance.worst).count()
    }

    /// The worst frames, worst first.
    pub fn worst_frames(&self, most: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.per_frame.len()).collect();
        order.sort_by(|&a, &b| self.per_frame[b].total_cmp(&self.per_frame[a]).then(a.cmp(&b)));
        order.truncate(most);
        order
    }

    fn add(&mut self, settled: &Settled) {
        self.squares.resize(settled.squares.len(), 0.0);
        self.worst_square.resize(settled.squares.len(), 0.0);
        let mut worst = 0f64;
        for ((sum, most), &e) in self.squares.iter_mut().zip(&mut self.worst_square).zip(&settled.squares) {
            let e = f64::from(e);
            *sum += e;
            *most = most.max(e);
            worst = worst.max(e);
        }
        self.per_frame.push(worst.sqrt());
    }
}

/// Fits joints until the points are within `goal`, or as near as the bounds on joints and rounds allow.
///
/// With corrective morph targets to come, few bad frames are [spared](Tolerance::spares).
pub fn fit(motion: &Motion<'_>, points: FitPoints, goal: Tolerance, encode: Encode) -> Result<Fit> {
    let frames = motion.farthest_frames(&points, FIRST_FRAMES)?;
    let sample = Sample::read(motion, &points, frames)?;
    let joints = split(&points, &sample, FIRST_JOINTS, goal.rms, motion.cancel)?;
    let emphasis = vec![Emphasis::new(points.len()); sample.len().div_ceil(LANES)];
    State { points, sample, joints, emphasis, tracks: None, encode }.improve(motion, goal, CYCLES, true)
}

/// Goes on from a fit with other points behind the proxy's, which have to meet the goal too.
///
/// `influences`: of all points; `frames`: to learn from besides those of the fit; `grows`: whether joints may be added.
pub fn extend(
    motion: &Motion<'_>,
    fit: &Fit,
    points: FitPoints,
    influences: &[Influences],
    frames: &[usize],
    grows: bool,
    (goal, encode): (Tolerance, Encode),
) -> Result<Fit> {
    let mut all = fit.sample.frames.clone();
    all.extend(frames);
    all.sort_unstable();
    all.dedup();
    let blend = Blend::new(&points.rest, influences, fit.tracks.joints());
    let (sample, joints, emphasis) = begin(motion, &points, &fit.tracks, all, &blend, goal)?;
    State { points, sample, joints, emphasis, tracks: Some(fit.tracks.clone()), encode }.improve(
        motion,
        goal,
        LATER_CYCLES,
        grows,
    )
}

/// What a cycle begins with.
struct State {
    points: FitPoints,
    sample: Sample,
    joints: JointPlanes,
    /// Of each group of [`LANES`] frames of the sample.
    emphasis: Vec<Emphasis>,
    /// Transforms on all frames, once there are any.
    tracks: Option<Tracks>,
    encode: Encode,
}

impl State {
    fn improve(mut self, motion: &Motion<'_>, goal: Tolerance, cycles: usize, grows: bool) -> Result<Fit> {
        let mut best: Option<Fit> = None;
        for left in (0..cycles).rev() {
            let rounds = if self.tracks.is_none() { 9 } else { 4 };
            let (influences, on_sample) = self.alternate(motion, rounds, goal)?;
            let now = self.settle_all(motion, influences, goal)?;
            let used = now.error.used(goal);
            let worse;
            let now = if best.as_ref().is_none_or(|b| used < b.error.used(goal)) {
                best.insert(now)
            } else {
                worse = now;
                &worse
            };
            let spared = self.encode != Encode::Skin && goal.spares(used, now.error.frames_over(goal), motion.frames());
            if used <= 1.0 || spared || left == 0 {
                break;
            }
            let more_frames = worst_frames(&now.error, &self.sample, goal);
            let fits_sample = goal.used(on_sample.worst() / 0.9, on_sample.rms() / 0.95) <= 1.0;
            let grown = if fits_sample || !grows { None } else { grow(motion, &self.points, &now.tracks, &now.error, goal)? };
            if more_frames.is_empty() && grown.is_none() && (fits_sample || !grows) {
                break;
            }
            let mut frames = self.sample.frames.clone();
            frames.extend(more_frames);
            frames.sort_unstable();
            let next = grown.unwrap_or_else(|| now.tracks.clone());
            let blend = Blend::new(&self.points.rest, &now.influences, now.tracks.joints());
            (self.sample, self.joints, self.emphasis) = begin(motion, &self.points, &next, frames, &blend, goal)?;
            self.tracks = Some(next);
        }
        best.ok_or_else(|| Error::refused("no frame to fit a skin to"))
    }

    /// The joints on all frames for fixed weights.
    fn settle_all(&mut self, motion: &Motion<'_>, influences: Vec<Influences>, goal: Tolerance) -> Result<Fit> {
        let begin = match self.tracks.take() {
            Some(tracks) => tracks,
            None => Tracks::of_groups(motion, &self.points, &dominated(&influences, self.joints.joints()))?,
        };
        let blend = Blend::new(&self.points.rest, &influences, begin.joints());
        let mut tracks = Growing::new(motion.spool.folder(), begin.joints())?;
        let mut error = FitError::new(self.points.vertices().len());
        motion.each_group(
            &self.points,
            LANES,
            |first, poses| {
                let joints = (first..first + poses.len()).map(|f| begin.motions(f)).collect::<Result<Vec<_>>>();
                match joints {
                    Ok(joints) => settle(&blend, &poses, &joints, goal).into_iter().map(Ok).collect(),
                    Err(error) => vec![Err(error)],
                }
            },
            |_, settled: Result<Settled>| {
                let settled = settled?;
                error.add(&settled);
                tracks.push(&settled.joints)
            },
        )?;
        let tracks = tracks.finish()?;
        Ok(Fit { points: self.points.clone(), influences, tracks, sample: self.sample.clone(), error })
    }
}

/// Positions, joints and emphasis on some frames, from the transforms that a cycle starts with.
fn begin(
    motion: &Motion<'_>,
    points: &FitPoints,
    tracks: &Tracks,
    frames: Vec<usize>,
    blend: &Blend,
    goal: Tolerance,
) -> Result<(Sample, JointPlanes, Vec<Emphasis>)> {
    let sample = Sample::read(motion, points, frames)?;
    let joints = JointPlanes::read(tracks, &sample.frames)?;
    let emphasis = emphasis_of(&sample, &joints, blend, goal);
    Ok((sample, joints, emphasis))
}

impl State {
    /// Weights and joints in turn on the sample. Returns the weights and the errors on the sample.
    fn alternate(&mut self, motion: &Motion<'_>, rounds: usize, goal: Tolerance) -> Result<(Vec<Influences>, FitError)> {
        let Self { points, sample, joints, emphasis, .. } = self;
        let mut influences = Vec::new();
        let mut error = FitError::new(points.vertices().len());
        for _ in 0..rounds {
            motion.cancel.check()?;
            influences = weigh(points, sample, joints, emphasis);
            let blend = Blend::new(&points.rest, &influences, joints.joints());
            let before = &*joints;
            let settled: Vec<Settled> = emphasis
                .par_iter_mut()
                .enumerate()
                .flat_map_iter(|(group, emphasis)| {
                    let mut now = begin_lanes(&blend, sample, before, group);
                    blend.sweep(&mut now, emphasis.weights(), 1);
                    emphasis.follow(&now.left, goal.rms, 0.4);
                    let count = LANES.min(sample.len() - group * LANES);
                    (0..count).map(|lane| Settled::new(&now, lane)).collect::<Vec<_>>()
                })
                .collect();
            error = FitError::new(points.vertices().len());
            for (f, settled) in settled.iter().enumerate() {
                error.add(settled);
                for (k, joint) in settled.joints.iter().enumerate() {
                    joints.set(k, f, &Rigid::unpack(joint));
                }
            }
        }
        Ok((influences, error))
    }
}

/// Weights of each point over the joints that carry it best.
fn weigh(points: &FitPoints, sample: &Sample, joints: &JointPlanes, emphasis: &[Emphasis]) -> Vec<Influences> {
    let weigh_point = |scratch: &mut WeightScratch, (i, &p): (usize, &DVec3)| {
        joints.costs(p, sample.point(i), &mut scratch.costs);
        let candidates = smallest(&scratch.costs, CANDIDATES);
        scratch.emphasis.clear();
        scratch.emphasis.extend(emphasis.iter().flat_map(|e| e.weights()[i]).take(sample.len()).map(f32::sqrt));
        scratch.solve(joints, p, sample.point(i), &candidates, true)
    };
    points.rest.par_iter().enumerate().map_init(WeightScratch::default, weigh_point).collect()
}

/// Buffers of the weight solve of one point.
#[derive(Debug, Default)]
pub struct WeightScratch {
    /// Errors of the candidates, one after the other.
    pub misses: Vec<f32>,
    /// Square roots of the frames' weights; empty for equal weights.
    pub emphasis: Vec<f32>,
    /// Costs of all joints.
    pub costs: Vec<f32>,
}

impl WeightScratch {
    /// Best at most four of the candidates for a point at `rest` that is at `positions` in the frames of `joints`.
    pub fn solve(
        &mut self,
        joints: &JointPlanes,
        rest: DVec3,
        positions: &[f32],
        candidates: &[usize],
        swaps: bool,
    ) -> Influences {
        let width = positions.len();
        self.misses.resize(candidates.len() * width, 0.0);
        for (miss, &k) in self.misses.chunks_exact_mut(width).zip(candidates) {
            joints.miss(k, rest, positions, miss);
            for axis in miss.chunks_exact_mut(width / 3) {
                axis.iter_mut().zip(&self.emphasis).for_each(|(m, e)| *m *= e);
            }
        }
        let mut pairs = [0.0; PAIRS];
        products(&self.misses, width, &mut pairs);
        Gram::new(candidates.len(), &pairs).choose(swaps).influences(candidates)
    }
}

/// Indices of the `count` smallest values, smallest first; ties go to the lower index.
pub fn smallest(values: &[f32], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    let by_value = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]).then(a.cmp(b));
    if order.len() > count {
        order.select_nth_unstable_by(count - 1, by_value);
        order.truncate(count);
    }
    order.sort_unstable_by(by_value);
    order
}

/// Joints of one frame and what they leave over.
#[derive(Clone, Debug)]
struct Settled {
    joints: Vec<Packed>,
    /// Squared error per point.
    squares: Vec<f32>,
}

impl Settled {
    fn new(fitted: &Fitted, lane: usize) -> Self {
        Self { joints: fitted.joints.iter().map(|joint| joint[lane].pack()).collect(), squares: fitted.squares(lane).collect() }
    }
}

/// Fits the joints of some frames with fixed weights, the badly carried points gaining weight from round to round; the best round of each frame
/// counts.
fn settle(blend: &Blend, poses: &[Vec<DVec3>], joints: &[Vec<Rigid>], goal: Tolerance) -> Vec<Settled> {
    let lanes: [usize; LANES] = std::array::from_fn(|lane| lane.min(poses.len() - 1));
    let target = |i: usize| [0, 1, 2].map(|axis| lanes.map(|f| poses[f][i][axis] as f32));
    let targets: Vec<[Wide; 3]> = (0..poses[0].len()).map(target).collect();
    let mut now = blend.begin((0..joints[0].len()).map(|k| lanes.map(|f| joints[f][k])).collect(), targets);
    let mut emphasis = Emphasis::new(now.left.len());
    let mut best: Vec<Option<(f64, Settled)>> = vec![None; poses.len()];
    for _ in 0..5 {
        blend.sweep(&mut now, emphasis.weights(), 2);
        for (lane, best) in best.iter_mut().enumerate() {
            let (sum, most) = now.squares(lane).fold((0.0, 0f32), |(s, m), e| (s + f64::from(e), m.max(e)));
            let used = goal.used(f64::from(most).sqrt(), (sum / now.left.len() as f64).sqrt());
            if best.as_ref().is_none_or(|(b, _)| used < *b) {
                *best = Some((used, Settled::new(&now, lane)));
            }
        }
        if best.iter().flatten().all(|(used, _)| *used < SETTLED) {
            break;
        }
        emphasis.follow(&now.left, goal.rms, 0.6);
    }
    best.into_iter().flatten().map(|(_, settled)| settled).collect()
}

/// The joints of a group of the sample's frames, and what they leave over. Lanes beyond the last frame repeat it.
fn begin_lanes(blend: &Blend, sample: &Sample, joints: &JointPlanes, group: usize) -> Fitted {
    let frames: [usize; LANES] = std::array::from_fn(|lane| (group * LANES + lane).min(sample.len() - 1));
    let target = |i: usize| {
        let path = sample.point(i);
        [0, 1, 2].map(|axis| frames.map(|f| path[axis * sample.len() + f]))
    };
    let targets = (0..sample.points()).map(target).collect();
    blend.begin((0..joints.joints()).map(|k| frames.map(|f| joints.get(k, f))).collect(), targets)
}

/// Points by their heaviest joint.
fn dominated(influences: &[Influences], joints: usize) -> Vec<Vec<u32>> {
    let mut groups = vec![Vec::new(); joints];
    for (i, influence) in influences.iter().enumerate() {
        groups[influence.joints[0] as usize].push(i as u32);
    }
    groups
}

/// The worst frames that are not in the sample yet.
fn worst_frames(error: &FitError, sample: &Sample, goal: Tolerance) -> Vec<usize> {
    let mut order = error.worst_frames(usize::MAX);
    order.retain(|f| error.per_frame[*f] > 0.8 * goal.worst && sample.frames.binary_search(f).is_err());
    order.truncate(8);
    order
}

/// More joints at the points with the largest errors, spaced apart; `None` when there are as many as allowed.
fn grow(motion: &Motion<'_>, points: &FitPoints, tracks: &Tracks, error: &FitError, goal: Tolerance) -> Result<Option<Tracks>> {
    let room = MOST_JOINTS.saturating_sub(tracks.joints());
    let percent = if error.used(goal) > FAR_OFF { 25 } else { 12 };
    let wanted = (tracks.joints() * percent).div_ceil(100).max(2).min(room);
    let frames = error.per_frame.len() as f64;
    let mut merit: Vec<f64> = (0..points.len())
        .map(|i| error.worst_square[i] / goal.worst.powi(2) + error.squares[i] / frames / goal.rms.powi(2))
        .collect();
    let size = (points.len() / (3 * tracks.joints())).max(8);
    let mut groups = Vec::new();
    for _ in 0..wanted {
        let worst = merit.iter().enumerate().fold(0, |best, (i, &m)| if m > merit[best] { i } else { best });
        if merit[worst] <= 0.0 {
            break;
        }
        let mut near = nearest_to(&points.rest, (0..points.len() as u32).collect(), points.rest[worst], 2 * size);
        for &i in &near {
            merit[i as usize] = 0.0;
        }
        near.truncate(size);
        groups.push(near);
    }
    if groups.is_empty() { Ok(None) } else { tracks.with(&Tracks::of_groups(motion, points, &groups)?).map(Some) }
}

/// Emphasis on the sample from the errors of the transforms that the next cycle starts with.
fn emphasis_of(sample: &Sample, joints: &JointPlanes, blend: &Blend, goal: Tolerance) -> Vec<Emphasis> {
    (0..sample.len().div_ceil(LANES))
        .into_par_iter()
        .map(|group| {
            let now = begin_lanes(blend, sample, joints, group);
            let mut emphasis = Emphasis::new(now.left.len());
            emphasis.follow(&now.left, goal.rms, 1.0);
            emphasis
        })
        .collect()
}
