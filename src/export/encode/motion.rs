//! The motion that is fitted: points of the spooled poses with the root's motion taken out, and the frames to learn from.

use super::rigid::Rigid;
use super::spool::Spool;
use crate::error::Result;
use crate::export::Cancel;
use crate::linalg::SparseRow;
use glam::DVec3;
use rayon::prelude::*;

/// Frames that are in memory at a time.
const BATCH: usize = 64;
/// Frames at most among which those to learn from are sought.
const SKETCHES: usize = 2048;

/// Points that are followed: some proxy vertices, then points given as rows over all proxy vertices.
#[derive(Clone, Debug)]
pub struct FitPoints {
    /// Positions at rest.
    pub rest: Vec<DVec3>,
    vertices: Vec<u32>,
    rows: Vec<SparseRow>,
}

impl FitPoints {
    /// The given proxy vertices.
    pub fn new(proxy_rest: &[DVec3], vertices: Vec<u32>) -> Self {
        Self { rest: vertices.iter().map(|&v| proxy_rest[v as usize]).collect(), vertices, rows: Vec::new() }
    }

    /// These and more points, as rows with their positions at rest.
    pub fn with_rows(&self, rows: Vec<SparseRow>, rest: impl IntoIterator<Item = DVec3>) -> Self {
        let mut more = self.clone();
        more.rest.truncate(self.vertices.len());
        more.rest.extend(rest);
        more.rows = rows;
        more
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.rest.len()
    }

    /// Proxy vertices among the points; they come first.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    fn gather(&self, pose: &[DVec3], root: &Rigid) -> Vec<DVec3> {
        let vertices = self.vertices.iter().map(|&v| pose[v as usize]);
        vertices.chain(self.rows.iter().map(|r| r.apply(pose))).map(|q| root.undo(q)).collect()
    }
}

/// Spooled poses and the rigid motion of the whole in each.
#[derive(Debug)]
pub struct Motion<'a> {
    /// The poses.
    pub spool: &'a Spool,
    /// Motion of the whole body from rest, per frame.
    pub roots: Vec<Rigid>,
    /// Stops long work.
    pub cancel: &'a Cancel,
}

impl<'a> Motion<'a> {
    /// Finds the root's motion from all vertices of each pose.
    pub fn new(spool: &'a Spool, rest: &[DVec3], cancel: &'a Cancel) -> Result<Self> {
        let mut roots = Vec::with_capacity(spool.frames());
        in_batches(spool, cancel, |_, poses| {
            let fit = |pose: &Vec<DVec3>| Rigid::fit(rest.iter().copied().zip(pose.iter().copied()));
            roots.par_extend(poses.par_iter().map(|pose| fit(pose).unwrap_or(Rigid::IDENTITY)));
            Ok(())
        })?;
        Ok(Self { spool, roots, cancel })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.roots.len()
    }

    /// Gives every frame's points to `work` on all threads, and the results in the order of the frames to `take`.
    pub fn each_frame<T: Send>(
        &self,
        points: &FitPoints,
        work: impl Fn(usize, Vec<DVec3>) -> T + Sync,
        take: impl FnMut(usize, T) -> Result<()>,
    ) -> Result<()> {
        self.each_group(points, 1, |f, poses| poses.into_iter().map(|pose| work(f, pose)).collect(), take)
    }

    /// The same for groups of so many consecutive frames; `work` returns a result for each of them.
    pub fn each_group<T: Send>(
        &self,
        points: &FitPoints,
        frames: usize,
        work: impl Fn(usize, Vec<Vec<DVec3>>) -> Vec<T> + Sync,
        mut take: impl FnMut(usize, T) -> Result<()>,
    ) -> Result<()> {
        in_batches(self.spool, self.cancel, |first, poses| {
            let group = |(g, poses): (usize, &[Vec<DVec3>])| {
                let first = first + g * frames;
                let gathered = poses.iter().enumerate().map(|(k, pose)| points.gather(pose, &self.roots[first + k])).collect();
                work(first, gathered)
            };
            let results: Vec<Vec<T>> = poses.par_chunks(frames).enumerate().map(group).collect();
            results.into_iter().flatten().enumerate().try_for_each(|(k, result)| take(first + k, result))
        })
    }

    /// Points of one frame.
    pub fn frame(&self, points: &FitPoints, frame: usize) -> Result<Vec<DVec3>> {
        Ok(points.gather(&self.spool.read_one(frame)?, &self.roots[frame]))
    }

    /// At most `count` frames that differ most, in ascending order: the farthest from the mean pose, then always the farthest from those chosen.
    pub fn farthest_frames(&self, points: &FitPoints, count: usize) -> Result<Vec<usize>> {
        if self.frames() <= count {
            return Ok((0..self.frames()).collect());
        }
        // A hundred points tell poses apart; what is kept per frame stays small.
        let stride = points.len().div_ceil(100).max(1);
        // Of a long take every few frames are candidates: neighbours are alike, and memory stays bounded.
        let step = self.frames().div_ceil(SKETCHES);
        let mut sketches: Vec<Vec<[f32; 3]>> = Vec::with_capacity(self.frames().div_ceil(step));
        let sketch = |f: usize, pose: Vec<DVec3>| -> Option<Vec<[f32; 3]>> {
            f.is_multiple_of(step).then(|| pose.iter().step_by(stride).map(|p| p.as_vec3().to_array()).collect())
        };
        self.each_frame(points, sketch, |_, s| {
            sketches.extend(s);
            Ok(())
        })?;
        let width = sketches[0].len();
        let mean: Vec<[f32; 3]> = (0..width)
            .map(|i| {
                let sum = sketches.iter().fold([0f64; 3], |s, k| std::array::from_fn(|a| s[a] + f64::from(k[i][a])));
                sum.map(|x| (x / sketches.len() as f64) as f32)
            })
            .collect();
        let distance = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f64 {
            let square = |(p, q): (&[f32; 3], &[f32; 3])| (0..3).map(|k| f64::from(p[k] - q[k]).powi(2)).sum::<f64>();
            a.iter().zip(b).map(square).sum()
        };
        let mut chosen = vec![farthest(sketches.iter().map(|s| distance(s, &mean)))];
        let mut nearest = vec![f64::INFINITY; sketches.len()];
        while chosen.len() < count {
            self.cancel.check()?;
            let last = &sketches[chosen[chosen.len() - 1]];
            nearest.par_iter_mut().zip(&sketches).for_each(|(n, s)| *n = n.min(distance(s, last)));
            let next = farthest(nearest.iter().copied());
            if nearest[next] <= 0.0 {
                break;
            }
            chosen.push(next);
        }
        chosen.iter_mut().for_each(|f| *f *= step);
        chosen.sort_unstable();
        Ok(chosen)
    }
}

/// Reads the spool from end to end.
pub fn in_batches(spool: &Spool, cancel: &Cancel, mut work: impl FnMut(usize, &[Vec<DVec3>]) -> Result<()>) -> Result<()> {
    let mut first = 0;
    while first < spool.frames() {
        cancel.check()?;
        let count = BATCH.min(spool.frames() - first);
        work(first, &spool.read(first, count)?)?;
        first += count;
    }
    Ok(())
}

/// Index of the first largest value.
fn farthest(values: impl Iterator<Item = f64>) -> usize {
    values.enumerate().fold((0, f64::NEG_INFINITY), |best, (i, v)| if v > best.1 { (i, v) } else { best }).0
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn frames_are_chosen_by_shape_once_the_root_s_motion_is_out() {
        let rest: Vec<DVec3> =
            (0..150).map(|i| DVec3::new(i as f64 / 150.0, (i as f64).sin() * 0.2, (i as f64 * 1.9).cos() * 0.2)).collect();
        let root =
            |f: usize| Rigid { rotation: DMat3::from_rotation_z(f as f64 * 0.3), translation: DVec3::new(f as f64, 0.0, -1.0) };
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::new(folder.path(), rest.len()).unwrap();
        for f in 0..70 {
            // The end of the cloud lifts in two frames, by different amounts.
            let lift = if f == 13 { 0.3 } else { f64::from(u8::from(f == 54)) * 0.2 };
            let bent = |p: &DVec3| if p.x > 0.9 { *p + DVec3::Y * lift } else { *p };
            spool.push(&rest.iter().map(|p| root(f).apply(bent(p))).collect::<Vec<_>>()).unwrap();
        }
        let cancel = Cancel::default();
        let motion = Motion::new(&spool, &rest, &cancel).unwrap();
        let points = FitPoints::new(&rest, (0..150).collect());
        for (found, truth) in motion.frame(&points, 40).unwrap().iter().zip(&rest) {
            assert!((*found - *truth).length() < 1e-4);
        }
        let chosen = motion.farthest_frames(&points, 3).unwrap();
        assert!(chosen.len() == 3 && chosen.contains(&13) && chosen.contains(&54), "{chosen:?}");
        let row = SparseRow { indices: vec![3, 9], values: vec![0.25, 0.75] };
        let more = points.with_rows(vec![row.clone()], [row.apply(&rest)]);
        let mut seen = 0;
        motion
            .each_frame(
                &more,
                |_, pose| pose,
                |f, pose| {
                    assert_eq!(f, seen);
                    assert!((pose[150] - row.apply(&pose[..150])).length() < 1e-12);
                    seen += 1;
                    Ok(())
                },
            )
            .unwrap();
        assert_eq!(seen, 70);
    }
}
