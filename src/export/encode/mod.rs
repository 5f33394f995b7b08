//! Motion → a skin of rigid joints: at most four influences per vertex, one transform per joint and frame.
//!
//! The pose of a scan is smooth and nearly rigid in pieces, so it is a skinning whose joints and weights can be found from the motion alone
//! (James & Twigg 2005, "Skinning mesh animations"; Le & Deng 2012, "Smooth skinning decomposition with rigid bones"). What makes few joints
//! enough is a damped reweighting: vertices and frames that are still wrong count more in the next round. The order of the work:
//!
//! 1. [`motion`]: the root's motion is taken out of every frame, and a few frames that differ most are chosen;
//! 2. [`start`]: clusters that move rigidly, split where they do not;
//! 3. [`fit`]: weights and joints alternate on the chosen frames, transforms follow on all frames, joints are added where the error is;
//! 4. [`surface`]: the weights of the scan's vertices through the map's rows;
//! 5. [`skin`]: the numbers as a file holds them;
//! 6. [`measure`]: these numbers decoded again and compared with the motion;
//! 7. [`correct`]: where joints no longer help, morph targets for what is left in single frames.
//!
//! [`basis`] stores a motion without joints, as morph targets alone; [`parts`] that of rigid parts, as a track of each, beside a
//! skin of what bends.
//!
//! All lengths are fractions of the scan's diagonal (the unit box).

use self::fit::Fit;
use self::measure::{Summary, VertexError, Written};
use self::morphs::Morphs;
use self::motion::{FitPoints, Motion};
use self::skin::{FileSpace, Skin};
use self::spool::Spool;
use self::surface::SurfaceWeights;
use crate::error::{Error, Kind, Result};
use crate::export::Cancel;
use crate::linalg::SparseRow;
use crate::surface::SurfaceMap;
use crate::words;
use glam::DVec3;
use std::collections::BTreeSet;

pub mod basis;
pub mod blend;
pub mod correct;
pub mod fit;
pub mod measure;
pub mod morphs;
pub mod motion;
pub mod parts;
pub mod rigid;
pub mod sample;
pub mod scratch;
pub mod select;
pub mod skin;
pub mod spool;
pub mod start;
pub mod surface;
pub mod table;
pub mod tracks;

/// Vertices at most whose weights are solved on all frames.
const REFINED: usize = 2000;
/// Vertices of the scan that join the points of the joints' fit when the scan misses the tolerance.
const WORST: usize = 300;

/// Attempts to improve the fit by the scan's worst vertices.
const EXTENSIONS: usize = 2;
/// The same, once a skin was measured on all frames.
const ROUNDS: usize = 6;
/// Frames that a trial is measured on besides those that it was learned from.
const CHECKED: usize = 16;

/// Misses count as rare in at most one of so many frames.
const RARE: usize = 100;

/// By what a motion is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encode {
    /// A track of each rigid part, and a skin of what bends, if the surface is of separate pieces; else a skin, and corrective morph targets where joints
    /// no longer help; else morph targets alone.
    #[default]
    Auto,
    /// A skin alone.
    Skin,
    /// Morph targets alone, under a node that carries the motion of the whole.
    Morph,
}

/// How far what is stored may be from the motion, in fractions of the diagonal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// At the worst vertex of the worst frame.
    pub worst: f64,
    /// Root mean square over all vertices and frames.
    pub rms: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self::of_worst(0.0025)
    }
}

impl Tolerance {
    /// The given worst error, and a fifth of it root mean square.
    pub fn of_worst(worst: f64) -> Self {
        Self { worst, rms: worst / 5.0 }
    }
}

impl Tolerance {
    /// How much of the tolerance an error uses: at most 1 when it is met.
    pub fn used(&self, worst: f64, rms: f64) -> f64 {
        (worst / self.worst).max(rms / self.rms)
    }

    /// Whether an error that uses so much of the tolerance is not worth more joints: by less than twice, and only in few of the frames. There
    /// the pose itself snaps, as where a fold turns over, and what a joint gains in one frame all others pay for; morph targets correct it.
    pub fn spares(&self, used: f64, frames_over: usize, frames: usize) -> bool {
        used <= 1.0 || used < 2.0 && frames_over * RARE <= frames
    }
}

/// At most four joints of a vertex with weights that sum to 1; unused places have weight 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Influences {
    /// Joints, heaviest first.
    pub joints: [u16; 4],
    /// Their weights.
    pub weights: [f64; 4],
}

impl Influences {
    /// The joints with a weight.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        self.joints.iter().zip(self.weights).filter(|(_, w)| *w > 0.0).map(|(&j, w)| (j as usize, w))
    }
}

/// A linear map from proxy poses to points: what the encoder needs of a [`SurfaceMap`].
pub trait PointMap: Sync {
    /// The row of one point over proxy vertices.
    fn row(&self, point: usize) -> SparseRow;
    /// Which proxy vertices the rows of some points may have coefficients for.
    fn reads(&self, points: &[u32]) -> Vec<bool>;
    /// All points of up to eight poses.
    fn apply(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]);
}

impl PointMap for SurfaceMap {
    fn row(&self, point: usize) -> SparseRow {
        SurfaceMap::row(self, point)
    }

    fn reads(&self, points: &[u32]) -> Vec<bool> {
        SurfaceMap::reads(self, points)
    }

    fn apply(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]) {
        SurfaceMap::apply(self, poses, out);
    }
}

/// What is encoded.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a, M> {
    /// From proxy poses to points.
    pub map: &'a M,
    /// Proxy at rest, unit box.
    pub proxy_rest: &'a [DVec3],
    /// Poses of the proxy.
    pub spool: &'a Spool,
    /// Points of the map that the skin holds.
    pub vertices: &'a [u32],
    /// Points of the map at rest, unit box.
    pub rest: &'a [DVec3],
    /// Pieces of the surface that do not touch each other, the largest first, as places in `vertices`.
    pub pieces: &'a [Vec<u32>],
    /// Coordinates of the file.
    pub space: FileSpace,
    /// How near it has to come.
    pub tolerance: Tolerance,
    /// By what.
    pub encode: Encode,
    /// Steps of a weight from 0 to 1.
    pub levels: u16,
    /// Stops long work.
    pub cancel: &'a Cancel,
}

/// A motion as stored, with its measured error.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Joints, and what hangs on them.
    pub skin: Skin,
    /// What is added to the positions at rest before the joints move them.
    pub morphs: Morphs,
    /// Positions of the skin's vertices at rest, as written.
    pub rest: Vec<[f32; 3]>,
    /// Distances in the file's unit.
    pub summary: Summary,
    /// Joint weights of proxy vertices, for names: proxy vertex, weights.
    pub proxy_influences: Vec<(u32, Influences)>,
    /// Where joints move rigid parts.
    pub parts: Option<Parts>,
}

/// What hangs on which joint of a thing made of parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Number of rigid parts: the first joints move one each.
    pub rigid: usize,
    /// Part of each vertex; vertices that bend have the number after the last and hang on the further joints.
    pub of_vertex: Vec<u16>,
}

impl Parts {
    /// Whether a vertex is on a rigid part.
    pub fn is_rigid(&self, vertex: usize) -> bool {
        usize::from(self.of_vertex[vertex]) < self.rigid
    }
}

impl Encoded {
    /// Number of rigid parts.
    pub fn rigid_parts(&self) -> usize {
        self.parts.as_ref().map_or(0, |parts| parts.rigid)
    }

    /// Number of joints that vertices hang on by weights.
    pub fn joints(&self) -> usize {
        self.skin.nodes() - 1 - self.rigid_parts()
    }
}

impl<M: PointMap> Job<'_, M> {
    /// Fits, rounds and measures.
    ///
    /// While it is on trial a skin is measured on the frames that it was learned from and the worst others; in the end on all.
    ///
    /// # Errors
    /// [`Kind::Unreached`] with the error that is left and its frame, counted from 0.
    pub fn run(&self) -> Result<Encoded> {
        let motion = Motion::new(self.spool, self.proxy_rest, self.cancel)?;
        let encoded = match self.encode {
            Encode::Morph => basis::encode(self, &motion)?,
            Encode::Skin => self.skinned(&motion)?,
            Encode::Auto => match parts::encode(self, &motion)? {
                Some(encoded) => encoded,
                None => match self.skinned(&motion)? {
                    skinned if self.misses(&skinned.summary) => {
                        // What few joints cannot do in all frames, a basis of poses may, if a file holds it.
                        match basis::encode(self, &motion) {
                            Ok(morphed) if !self.misses(&morphed.summary) => morphed,
                            Ok(_) => skinned,
                            Err(error) if error.kind == Kind::Unsupported => skinned,
                            Err(error) => return Err(error),
                        }
                    }
                    skinned => skinned,
                },
            },
        };
        let summary = &encoded.summary;
        if self.misses(summary) {
            let (worst, rms) = (summary.worst / self.space.scale, summary.rms / self.space.scale);
            let [worst, rms] = [worst, rms].map(|e| words::digits(100.0 * e));
            return Err(Error::new(Kind::Unreached, format!("{worst} % worst, {rms} % rms")).at(summary.frame.to_string()));
        }
        Ok(encoded)
    }

    fn misses(&self, summary: &Summary) -> bool {
        self.tolerance.used(summary.worst / self.space.scale, summary.rms / self.space.scale) > 1.0
    }

    fn skinned(&self, motion: &Motion<'_>) -> Result<Encoded> {
        let read = surface::read_by_map(self.map, self.vertices);
        let points = FitPoints::new(self.proxy_rest, read);
        let trial = self.trial(motion, fit::fit(motion, points, self.goal(), self.encode)?, &[])?;
        let mut best = self.complete(motion, self.search(motion, trial)?)?;
        for _ in 0..ROUNDS {
            if self.is_enough(&best) {
                break;
            }
            let frames = worst_frames(&best.errors);
            let fit = self.extended(motion, &best, &frames)?;
            let other = self.complete(motion, self.trial(motion, fit, &frames)?)?;
            if self.used(&other) >= self.used(&best) {
                break;
            }
            best = other;
        }
        let mut morphs = Morphs::none(self.spool.frames());
        if self.encode == Encode::Auto && self.used(&best) > 1.0 {
            (morphs, best.errors) = correct::correct(self, &best.skin, best.errors)?;
        }
        let summary = measure::summary(&best.errors, best.frames.len());
        let vertices = best.fit.points.vertices().iter().copied();
        let proxy_influences = vertices.zip(best.fit.influences.iter().copied()).collect();
        Ok(Encoded { skin: best.skin, morphs, rest: self.rest_as_written(), summary, proxy_influences, parts: None })
    }

    /// What the proxy's points aim at: the scan's own vertices need the rest of the tolerance.
    fn goal(&self) -> Tolerance {
        Tolerance { worst: 0.8 * self.tolerance.worst, rms: 0.9 * self.tolerance.rms }
    }

    /// Extends the fit by the scan's worst vertices while that helps. Where only few frames are bad they are learned from, with the same joints.
    fn search(&self, motion: &Motion<'_>, trial: Trial) -> Result<Trial> {
        let mut best = trial;
        for _ in 0..EXTENSIONS {
            let used = self.used(&best);
            if used <= 1.0 {
                break;
            }
            let other = self.trial(motion, self.extended(motion, &best, &[])?, &best.frames)?;
            if self.used(&other) >= used {
                break;
            }
            best = other;
            if self.is_enough(&best) {
                break;
            }
        }
        Ok(best)
    }

    /// The skin of a fit, measured on some frames; `frames` are among them.
    fn trial(&self, motion: &Motion<'_>, fit: Fit, frames: &[usize]) -> Result<Trial> {
        let weights = SurfaceWeights::new(self.map, &fit, self.proxy_rest.len())?;
        let influences = weights.solve(self.vertices, self.rest);
        self.cancel.check()?;
        let at_rest: Vec<DVec3> = self.vertices.iter().map(|&v| self.rest[v as usize]).collect();
        let skin = Skin::new(motion, &fit.tracks, &at_rest, &influences, self.space, self.levels)?;
        let mut checked = fit.sample.frames.clone();
        checked.extend(frames);
        checked.extend(fit.error.worst_frames(CHECKED));
        checked.sort_unstable();
        checked.dedup();
        self.measured(motion, Trial { skin, fit, frames: checked, errors: Vec::new() })
    }

    /// The same skin measured on all frames.
    fn complete(&self, motion: &Motion<'_>, trial: Trial) -> Result<Trial> {
        if trial.frames.len() == self.spool.frames() {
            return Ok(trial);
        }
        self.measured(motion, Trial { frames: (0..self.spool.frames()).collect(), ..trial })
    }

    /// Measures on the trial's frames; then the weights of vertices near the tolerance are solved once more, on all frames.
    fn measured(&self, motion: &Motion<'_>, mut trial: Trial) -> Result<Trial> {
        let rest = self.rest_as_written();
        let space = self.space;
        let skin = &mut trial.skin;
        let morphs = Morphs::none(self.spool.frames());
        let written = Written { skin, morphs: &morphs, rest: &rest, space };
        trial.errors = written.measure(self.map, self.vertices, self.spool, &trial.frames, self.cancel)?;
        let bound = 0.72 * self.tolerance.worst * space.scale;
        let doubtful = surface::worst_vertices(&trial.errors, bound, REFINED);
        let rows: Vec<(usize, SparseRow)> = doubtful.iter().map(|&i| (i, self.map.row(self.vertices[i] as usize))).collect();
        let before = written.measure_rows(&rows, self.spool, self.cancel)?;
        let paths: Vec<(DVec3, &SparseRow)> = rows.iter().map(|(i, row)| (self.rest[self.vertices[*i] as usize], row)).collect();
        let weights = SurfaceWeights::new(self.map, &trial.fit, self.proxy_rest.len())?;
        let refined = weights.refine(motion, &paths, self.goal())?;
        let old: Vec<Influences> = doubtful.iter().map(|&i| skin.influences(i)).collect();
        for (&i, influences) in doubtful.iter().zip(&refined) {
            skin.set_influences(i, influences);
        }
        let after = Written { skin, morphs: &morphs, rest: &rest, space }.measure_rows(&rows, self.spool, self.cancel)?;
        for (k, &i) in doubtful.iter().enumerate() {
            let better = after[k].worst_square < before[k].worst_square;
            if !better {
                skin.set_influences(i, &old[k]);
            }
            trial.errors[i] = if better { after[k] } else { before[k] };
        }
        Ok(trial)
    }

    /// The fit with the scan's worst vertices among its points, and with the frames where they are worst.
    fn extended(&self, motion: &Motion<'_>, trial: &Trial, frames: &[usize]) -> Result<Fit> {
        let fit = &trial.fit;
        let worst = surface::worst_vertices(&trial.errors, 0.0, WORST);
        let vertex = |i: &usize| self.vertices[*i] as usize;
        let rows = worst.iter().map(|i| self.map.row(vertex(i))).collect();
        let points = fit.points.with_rows(rows, worst.iter().map(|i| self.rest[vertex(i)]));
        let mut influences = fit.influences[..fit.points.vertices().len()].to_vec();
        influences.extend(worst.iter().map(|&i| trial.skin.influences(i)));
        // Where the mean misses, no few vertices are to blame: the proxy's points have to come nearer.
        let measured = measure::summary(&trial.errors, trial.frames.len()).rms / self.space.scale;
        let goal = self.goal();
        let missed = measured > self.tolerance.rms;
        let goal = Tolerance { rms: if missed { 0.85 * goal.rms * self.tolerance.rms / measured } else { goal.rms }, ..goal };
        fit::extend(motion, fit, points, &influences, frames, !self.is_enough(trial), (goal, self.encode))
    }

    fn rest_as_written(&self) -> Vec<[f32; 3]> {
        self.vertices.iter().map(|&v| self.space.leave(self.rest[v as usize]).as_vec3().to_array()).collect()
    }

    /// Within the tolerance, or beyond it in few frames that morph targets correct.
    fn is_enough(&self, trial: &Trial) -> bool {
        if self.encode == Encode::Skin {
            return self.used(trial) <= 1.0;
        }
        let bound = self.tolerance.worst * self.space.scale;
        let over: BTreeSet<usize> = trial.errors.iter().filter(|e| e.worst_square > bound * bound).map(|e| e.frame).collect();
        self.tolerance.spares(self.used(trial), over.len(), self.spool.frames())
    }

    fn used(&self, trial: &Trial) -> f64 {
        let s = measure::summary(&trial.errors, trial.frames.len());
        self.tolerance.used(s.worst / self.space.scale, s.rms / self.space.scale)
    }
}

/// A skin with its errors on some frames. Vertices near the tolerance are measured on all frames.
#[derive(Debug)]
struct Trial {
    fit: Fit,
    skin: Skin,
    frames: Vec<usize>,
    errors: Vec<VertexError>,
}

/// The frames of the worst vertices.
fn worst_frames(errors: &[VertexError]) -> Vec<usize> {
    let mut frames = Vec::new();
    for i in surface::worst_vertices(errors, 0.0, WORST) {
        if frames.len() < CHECKED && !frames.contains(&errors[i].frame) {
            frames.push(errors[i].frame);
        }
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_excess_in_few_frames_is_spared() {
        let tolerance = Tolerance::default();
        assert!(tolerance.spares(1.0, 500, 1000) && tolerance.spares(1.9, 10, 1000));
        assert!(!tolerance.spares(1.9, 11, 1000), "too many frames");
        assert!(!tolerance.spares(2.1, 1, 1000), "too far off");
        assert!(!tolerance.spares(1.1, 1, 99), "one frame of a short take is not rare");
    }
}
