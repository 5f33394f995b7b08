//! The actor's segments, posed after the markers of every frame with their lengths held.
//!
//! Unknowns of a frame: place of the pelvis, one rotation per segment, a shift of each shoulder (the clavicle). Damped Gauss–Newton on robust
//! distances of the markers from their held places on the segments, and weak ties to the frame before for what no marker tells. Every
//! frame starts from its neighbour, since a limb that starts far away may end on its wrong side.

use super::fit::{Fit, SIGMA, solve};
use super::segments::{Segment, Skeleton};
use glam::{DMat3, DQuat, DVec3};

/// A marker held on a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    pub segment: Segment,
    /// The shoulder that takes it along on the trunk.
    pub shoulder: Option<usize>,
    /// Its place in the axes of the segment, counted from the segment's origin.
    pub local: DVec3,
    pub weight: f64,
}

impl Held {
    /// Its place in the axes of the segment in a pose.
    pub(super) fn place(&self, shoulders: &[DVec3; 2]) -> DVec3 {
        self.local + self.shoulder.map_or(DVec3::ZERO, |s| shoulders[s])
    }
}

/// The actor's pose in a frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pose {
    /// Origin of the pelvis.
    pub root: DVec3,
    /// Rotation of every segment against the scan's rest.
    pub turns: [DQuat; Segment::COUNT],
    /// How far the shoulders have left their places on the trunk, in the axes of the trunk.
    pub shoulders: [DVec3; 2],
}

/// The segments of an actor: their origins in the axes of their parents.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    offsets: [DVec3; Segment::COUNT],
    /// Height of the actor.
    stature: f64,
}

/// Which shoulder a segment hangs on.
pub(super) fn shoulder_of(segment: Segment) -> Option<usize> {
    match segment {
        Segment::LeftUpperArm => Some(0),
        Segment::RightUpperArm => Some(1),
        _ => None,
    }
}

/// Stiffness of the ties to the frame before, per radian: a few per cent of what three markers of a hand say.
const TIE: f64 = 0.1;
/// Stiffness of the ties of a relative rotation to the reference pose, which bring back what no marker has told for long.
const HOME: f64 = 0.02;
/// How far a shoulder moves on the trunk, in statures.
const SHOULDER: f64 = 0.03;
/// A frame is posed when no unknown (radians, statures) changes by more in a step.
const DONE: f64 = 1e-7;
const STEPS: usize = 60;

const TURNS: usize = 3;
const SHOULDERS: usize = TURNS + 3 * Segment::COUNT;
const UNKNOWNS: usize = SHOULDERS + 6;

impl Chain {
    /// The actor of a fit, in the space of the fit's observations.
    pub(super) fn of_fit(body: &Skeleton, fit: &Fit) -> Self {
        let offset = |segment: Segment| {
            segment.parent().map_or(DVec3::ZERO, |parent| {
                let between = fit.origins[segment as usize] - fit.origins[parent as usize];
                fit.rotations[parent as usize].inverse() * between
            })
        };
        Self { offsets: Segment::ALL.map(offset), stature: body.stature * fit.size }
    }

    /// The scan itself.
    pub(super) fn of_scan(body: &Skeleton) -> Self {
        let offset = |segment: Segment| {
            segment.parent().map_or(DVec3::ZERO, |parent| body.bone(segment).origin - body.bone(parent).origin)
        };
        Self { offsets: Segment::ALL.map(offset), stature: body.stature }
    }

    /// Origin of a segment in the axes of its parent.
    pub(super) fn rest(&self, segment: Segment) -> DVec3 {
        self.offsets[segment as usize]
    }

    /// Origins of all segments.
    pub(super) fn origins(&self, pose: &Pose) -> [DVec3; Segment::COUNT] {
        let mut origins = [pose.root; Segment::COUNT];
        for segment in Segment::ALL {
            if let Some(parent) = segment.parent() {
                origins[segment as usize] = origins[parent as usize] + pose.turns[parent as usize] * self.offset(segment, pose);
            }
        }
        origins
    }

    fn offset(&self, segment: Segment, pose: &Pose) -> DVec3 {
        self.offsets[segment as usize] + shoulder_of(segment).map_or(DVec3::ZERO, |s| pose.shoulders[s])
    }

    /// Length of a leg from hip to ankle, mean of both sides.
    pub(super) fn leg(&self) -> f64 {
        let length = |s: Segment| self.offsets[s as usize].length();
        0.5 * [Segment::LeftShank, Segment::LeftFoot, Segment::RightShank, Segment::RightFoot].map(length).iter().sum::<f64>()
    }

    /// The pose of a frame in which marker `i`, held at `held[i]`, is seen at `seen[i]`; `before` is the pose of the frame before or after.
    pub(super) fn chase(&self, held: &[Held], seen: &[Option<DVec3>], before: &Pose, home: &[DQuat; Segment::COUNT]) -> Pose {
        let frame = Frame { chain: self, held, seen, before, home };
        let mut pose = before.clone();
        let mut cost = frame.cost(&pose);
        let mut damping = 1e-6;
        for _ in 0..STEPS {
            let (normal, gradient) = frame.normal_equations(&pose);
            let mut largest = None;
            while damping < 1e8 {
                if let Some(step) = solve(&normal, &gradient, damping) {
                    let trial = frame.moved(&pose, &step);
                    let trial_cost = frame.cost(&trial);
                    if trial_cost <= cost {
                        largest = step.iter().map(|x| x.abs()).reduce(f64::max);
                        (pose, cost) = (trial, trial_cost);
                        damping = (damping * 0.1).max(1e-9);
                        break;
                    }
                }
                damping *= 10.0;
            }
            if largest.is_none_or(|step| step < DONE) {
                break;
            }
        }
        pose
    }
}

/// The rotation of every segment against its parent's.
pub(super) fn relative(turns: &[DQuat; Segment::COUNT]) -> [DQuat; Segment::COUNT] {
    Segment::ALL.map(|s| s.parent().map_or(DQuat::IDENTITY, |parent| turns[parent as usize].inverse() * turns[s as usize]))
}

struct Frame<'a> {
    chain: &'a Chain,
    held: &'a [Held],
    seen: &'a [Option<DVec3>],
    before: &'a Pose,
    home: &'a [DQuat; Segment::COUNT],
}

/// A residual of three numbers and what it changes with: the unknowns from an index on, by a matrix.
struct Row {
    residual: DVec3,
    slopes: [(usize, DMat3); 8],
    count: usize,
}

impl Row {
    fn new(residual: DVec3) -> Self {
        Self { residual, slopes: [(0, DMat3::ZERO); 8], count: 0 }
    }

    fn slope(&mut self, unknown: usize, matrix: DMat3) {
        self.slopes[self.count] = (unknown, matrix);
        self.count += 1;
    }
}

/// The matrix of `v ×`.
fn cross(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// The rotation vector of a turn by at most half a turn.
fn log(q: DQuat) -> DVec3 {
    if q.w < 0.0 { -q } else { q }.to_scaled_axis()
}

fn turn(segment: Segment) -> usize {
    TURNS + 3 * segment as usize
}

impl Frame<'_> {
    fn moved(&self, pose: &Pose, step: &[f64]) -> Pose {
        let v = |at: usize| DVec3::new(step[at], step[at + 1], step[at + 2]);
        Pose {
            root: pose.root + v(0) * self.chain.stature,
            turns: Segment::ALL.map(|s| (DQuat::from_scaled_axis(v(turn(s))) * pose.turns[s as usize]).normalize()),
            shoulders: [0, 1].map(|s| pose.shoulders[s] + v(SHOULDERS + 3 * s) * self.chain.stature),
        }
    }

    /// Distance of a marker from its held place, in units of the expected noise.
    fn miss(&self, pose: &Pose, origins: &[DVec3; Segment::COUNT], i: usize) -> Option<DVec3> {
        let held = &self.held[i];
        let place = origins[held.segment as usize] + pose.turns[held.segment as usize] * held.place(&pose.shoulders);
        Some((place - self.seen[i]?) * (held.weight / (SIGMA * self.chain.stature)))
    }

    /// Soft-L1 in the markers, squares in the ties.
    fn cost(&self, pose: &Pose) -> f64 {
        let origins = self.chain.origins(pose);
        let missed = (0..self.held.len()).filter_map(|i| self.miss(pose, &origins, i));
        let markers: f64 = missed.map(|r| 2.0 * ((1.0 + r.length_squared()).sqrt() - 1.0)).sum();
        let mut ties = 0.0;
        self.each_tie(pose, |row| ties += row.residual.length_squared());
        markers + ties
    }

    fn each_tie(&self, pose: &Pose, mut add: impl FnMut(&Row)) {
        let (before, now) = (relative(&self.before.turns), relative(&pose.turns));
        for segment in Segment::ALL {
            let i = segment as usize;
            let Some(parent) = segment.parent() else {
                let mut row = Row::new(log(pose.turns[i] * self.before.turns[i].inverse()) * TIE);
                row.slope(turn(segment), DMat3::from_diagonal(DVec3::splat(TIE)));
                add(&row);
                continue;
            };
            for (rest, stiffness) in [(before[i], TIE), (self.home[i], HOME)] {
                let mut row = Row::new(pose.turns[parent as usize] * log(now[i] * rest.inverse()) * stiffness);
                row.slope(turn(segment), DMat3::from_diagonal(DVec3::splat(stiffness)));
                row.slope(turn(parent), DMat3::from_diagonal(DVec3::splat(-stiffness)));
                add(&row);
            }
        }
        let stature = self.chain.stature;
        let mut root = Row::new((pose.root - self.before.root) * (TIE / stature));
        root.slope(0, DMat3::from_diagonal(DVec3::splat(TIE)));
        add(&root);
        for s in 0..2 {
            let mut row = Row::new(pose.shoulders[s] / (SHOULDER * stature));
            row.slope(SHOULDERS + 3 * s, DMat3::from_diagonal(DVec3::splat(1.0 / SHOULDER)));
            add(&row);
        }
    }

    fn normal_equations(&self, pose: &Pose) -> (Vec<f64>, Vec<f64>) {
        let mut normal = vec![0.0; UNKNOWNS * UNKNOWNS];
        let mut gradient = vec![0.0; UNKNOWNS];
        let mut add = |row: &Row, weight: f64| {
            for &(i, a) in &row.slopes[..row.count] {
                let slope = a.transpose() * row.residual * weight;
                for (k, x) in slope.to_array().into_iter().enumerate() {
                    gradient[i + k] += x;
                }
                for &(j, b) in row.slopes[..row.count].iter().filter(|s| s.0 <= i) {
                    let block = a.transpose() * b * weight;
                    for k in 0..3 {
                        for l in 0..3 {
                            normal[(i + k) * UNKNOWNS + j + l] += block.col(l)[k];
                        }
                    }
                }
            }
        };
        let origins = self.chain.origins(pose);
        for i in 0..self.held.len() {
            let Some(miss) = self.miss(pose, &origins, i) else { continue };
            let held = &self.held[i];
            // Per stature for lengths, so that all unknowns are of one size.
            let unit = held.weight / (SIGMA * self.chain.stature);
            let length = DMat3::from_diagonal(DVec3::splat(unit * self.chain.stature));
            let mut row = Row::new(miss);
            row.slope(0, length);
            let (mut segment, mut arm) = (held.segment, held.place(&pose.shoulders));
            if let Some(s) = held.shoulder {
                row.slope(SHOULDERS + 3 * s, DMat3::from_quat(pose.turns[segment as usize]) * (unit * self.chain.stature));
            }
            loop {
                row.slope(turn(segment), cross(pose.turns[segment as usize] * arm) * -unit);
                let Some(parent) = segment.parent() else { break };
                if let Some(s) = shoulder_of(segment) {
                    row.slope(SHOULDERS + 3 * s, DMat3::from_quat(pose.turns[parent as usize]) * (unit * self.chain.stature));
                }
                arm = self.chain.offset(segment, pose);
                segment = parent;
            }
            add(&row, (1.0 + miss.length_squared()).powf(-0.5));
        }
        self.each_tie(pose, |row| add(row, 1.0));
        (normal, gradient)
    }
}
