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
//! 6. [`measure`]: these numbers decoded again and compared with the motion.
//!
//! All lengths are fractions of the scan's diagonal (the unit box).

use self::blend::Blend;
use self::fit::Fit;
use self::measure::{Summary, VertexError, Written};
use self::motion::{FitPoints, Motion};
use self::skin::{FileSpace, Skin};
use self::spool::Spool;
use self::surface::SurfaceWeights;
use self::tracks::Tracks;
use crate::error::Result;
use crate::export::Cancel;
use crate::linalg::SparseRow;
use crate::surface::SurfaceMap;
use glam::DVec3;

pub mod blend;
pub mod fit;
pub mod measure;
pub mod motion;
pub mod rigid;
pub mod sample;
pub mod select;
pub mod skin;
pub mod spool;
pub mod start;
pub mod surface;
pub mod tracks;

/// Vertices at most whose weights are solved on all frames.
const REFINED: usize = 2000;
/// Vertices of the scan that join the points of the joints' fit when the scan misses the tolerance.
const WORST: usize = 300;

/// How far the skin may be from the motion, in fractions of the diagonal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// At the worst vertex of the worst frame.
    pub worst: f64,
    /// Root mean square over all vertices and frames.
    pub rms: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self { worst: 0.0025, rms: 0.0005 }
    }
}

impl Tolerance {
    /// How much of the tolerance an error uses: at most 1 when it is met.
    pub fn used(&self, worst: f64, rms: f64) -> f64 {
        (worst / self.worst).max(rms / self.rms)
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
    /// All points of up to eight poses.
    fn apply(&self, poses: &[&[DVec3]], out: &mut [Vec<[f32; 3]>]);
}

impl PointMap for SurfaceMap {
    fn row(&self, point: usize) -> SparseRow {
        SurfaceMap::row(self, point)
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
    /// Coordinates of the file.
    pub space: FileSpace,
    /// How near the skin should come.
    pub tolerance: Tolerance,
    /// Stops long work.
    pub cancel: &'a Cancel,
}

/// A skin with its measured error.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// As written.
    pub skin: Skin,
    /// Positions of the skin's vertices at rest, as written.
    pub rest: Vec<[f32; 3]>,
    /// Distances in the file's unit.
    pub summary: Summary,
    /// Joint weights of proxy vertices, for names: proxy vertex, weights.
    pub proxy_influences: Vec<(u32, Influences)>,
}

impl<M: PointMap> Job<'_, M> {
    /// Fits, rounds and measures.
    pub fn run(&self) -> Result<Encoded> {
        let motion = Motion::new(self.spool, self.proxy_rest, self.cancel)?;
        let read = surface::read_by_map(self.map, self.vertices, self.proxy_rest.len());
        let points = FitPoints::new(self.proxy_rest, read);
        // The scan's own vertices need the rest of the tolerance.
        let goal = Tolerance { worst: 0.8 * self.tolerance.worst, rms: 0.9 * self.tolerance.rms };
        let fit = fit::fit(&motion, points, goal)?;
        let rest: Vec<[f32; 3]> =
            self.vertices.iter().map(|&v| self.space.leave(self.rest[v as usize]).as_vec3().to_array()).collect();
        let mut best = self.write(&motion, &fit, &rest, goal)?;
        if self.used(&best) > 1.0 {
            let other = self.write(&motion, &self.settle_worst(&motion, &fit, &best, goal)?, &rest, goal)?;
            if self.used(&other) < self.used(&best) {
                best = other;
            }
        }
        let proxy_influences = fit.points.vertices().iter().copied().zip(fit.influences.iter().copied()).collect();
        let summary = measure::summary(&best.errors, self.spool.frames());
        Ok(Encoded { skin: best.skin, rest, summary, proxy_influences })
    }

    fn used(&self, draft: &Draft) -> f64 {
        let s = measure::summary(&draft.errors, self.spool.frames());
        self.tolerance.used(s.worst / self.space.scale, s.rms / self.space.scale)
    }

    /// Weights on the scan, rounding, measurement; then the vertices near the tolerance once more, on all frames.
    fn write(&self, motion: &Motion<'_>, fit: &Fit, rest: &[[f32; 3]], goal: Tolerance) -> Result<Draft> {
        let weights = SurfaceWeights::new(self.map, fit, self.proxy_rest.len());
        let influences = weights.solve(self.vertices, self.rest);
        self.cancel.check()?;
        let at_rest: Vec<DVec3> = self.vertices.iter().map(|&v| self.rest[v as usize]).collect();
        let mut skin = Skin::new(motion, &fit.tracks, &at_rest, &influences, self.space);
        let mut errors =
            Written { skin: &skin, rest, space: self.space }.measure(self.map, self.vertices, self.spool, self.cancel)?;
        let bound = 0.72 * self.tolerance.worst * self.space.scale;
        let doubtful = surface::worst_vertices(&errors, bound, REFINED);
        let row = |&i: &usize| self.map.row(self.vertices[i] as usize);
        let paths: Vec<(DVec3, SparseRow)> = doubtful.iter().map(|i| (at_rest[*i], row(i))).collect();
        let refined = weights.refine(motion, &paths, goal)?;
        let before: Vec<Influences> = doubtful.iter().map(|&i| skin.influences(i)).collect();
        for (&i, influences) in doubtful.iter().zip(&refined) {
            skin.set_influences(i, influences);
        }
        let rows: Vec<(usize, SparseRow)> = doubtful.iter().copied().zip(paths.into_iter().map(|p| p.1)).collect();
        let again = Written { skin: &skin, rest, space: self.space }.measure_rows(&rows, self.spool, self.cancel)?;
        for ((&i, error), before) in doubtful.iter().zip(again).zip(&before) {
            if error.worst_square < errors[i].worst_square {
                errors[i] = error;
            } else {
                skin.set_influences(i, before);
            }
        }
        Ok(Draft { skin, errors })
    }

    /// The joints of all frames once more, with the scan's worst vertices among the points.
    fn settle_worst(&self, motion: &Motion<'_>, fit: &Fit, draft: &Draft, goal: Tolerance) -> Result<Fit> {
        let worst = surface::worst_vertices(&draft.errors, 0.0, WORST);
        let vertex = |i: &usize| self.vertices[*i] as usize;
        let rows = worst.iter().map(|i| self.map.row(vertex(i))).collect();
        let points = fit.points.with_rows(rows, worst.iter().map(|i| self.rest[vertex(i)]));
        let mut influences = fit.influences.clone();
        influences.extend(worst.iter().map(|&i| draft.skin.influences(i)));
        let blend = Blend::new(&points.rest, &influences, fit.tracks.joints());
        let mut tracks = Tracks::new(fit.tracks.joints());
        motion.each_frame(
            &points,
            |f, pose| fit::settle(&blend, &pose, fit.tracks.frame(f), 6, 0.5, goal).joints,
            |_, joints| tracks.push(&joints),
        )?;
        Ok(Fit { tracks, ..fit.clone() })
    }
}

/// A skin on trial.
#[derive(Debug)]
struct Draft {
    skin: Skin,
    errors: Vec<VertexError>,
}
