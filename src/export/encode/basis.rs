//! Motion → morph targets alone: the principal components of the proxy's motion, carried to the scan by the map.
//!
//! The map is linear, so a basis of proxy poses is a basis of scan poses, and is found among a few thousand points. It is learned from frames that
//! differ most, and from those that it misses; as many components are taken as the tolerance needs. The root's motion is taken out first and
//! stays a track of a node: morph targets cannot turn.
//!
//! Blender cuts weights off below 0 and above 1. So components begin at the least that there ever is of them, and one more target, whose weight is
//! 1 all the time, holds all these beginnings.

use super::measure::{self, Written};
use super::morphs::{Morphs, Target};
use super::motion::{FitPoints, Motion};
use super::rigid::Packed;
use super::sample::Sample;
use super::skin::Skin;
use super::surface::read_by_map;
use super::table::{Growing, Table};
use super::{Encoded, Job, PointMap, Tolerance};
use crate::error::{Error, Kind, Result};
use crate::linalg::eigen;
use crate::words;
use glam::DVec3;
use rayon::prelude::*;

/// Targets at most: the file grows by 12 bytes per vertex and target.
const MOST_TARGETS: usize = 200;
/// Bytes of all targets at most: the file's own counters end there.
const MOST_BYTES: u64 = 1 << 32;
/// Frames to learn from at first, more of them when some are missed, and how often that is done.
const FIRST_FRAMES: usize = 96;
const MORE_FRAMES: usize = 32;
const ROUNDS: usize = 5;
/// What the proxy's points aim at, as shares of the tolerance; one after the other until the scan's own vertices are within it.
const AIMS: [f64; 3] = [0.9, 0.7, 0.5];
/// Poses that the map takes in one call.
const BATCH: usize = 8;
/// Share of the frames' products that may stay between components: far below what they are cut off at.
const UNTURNED: f64 = 1e-26;

/// Components of a motion, as displacements of the fit points: x, y, z of each; orthonormal, the largest first.
type Modes = Vec<Vec<f64>>;

/// Stores the motion as morph targets under a node that carries the motion of the whole.
pub fn encode<M: PointMap>(job: &Job<'_, M>, motion: &Motion<'_>) -> Result<Encoded> {
    let points = FitPoints::new(job.proxy_rest, read_by_map(job.map, job.vertices));
    let at_rest: Vec<DVec3> = job.vertices.iter().map(|&v| job.rest[v as usize]).collect();
    let skin = Skin::new(motion, &no_joints(motion)?, &at_rest, &[], job.space, job.levels)?;
    let rest = job.rest_as_written();
    let all: Vec<usize> = (0..motion.frames()).collect();
    let mut best: Option<Encoded> = None;
    for aim in AIMS {
        let goal = Tolerance { worst: aim * job.tolerance.worst, rms: aim * job.tolerance.rms };
        let (modes, amounts) = learn(motion, &points, goal)?;
        check_size(modes.len(), job.vertices.len())?;
        let morphs = carry(job, motion, &points, &modes, &amounts)?;
        let written = Written { skin: &skin, morphs: &morphs, rest: &rest, space: job.space };
        let errors = written.measure(job.map, job.vertices, job.spool, &all, job.cancel)?;
        let summary = measure::summary(&errors, all.len());
        let used = |s: &measure::Summary| job.tolerance.used(s.worst / job.space.scale, s.rms / job.space.scale);
        if best.as_ref().is_none_or(|b| used(&summary) < used(&b.summary)) {
            let (skin, rest) = (skin.clone(), rest.clone());
            best = Some(Encoded { skin, morphs, rest, summary, proxy_influences: Vec::new(), parts: None });
        }
        if used(&summary) <= 1.0 || modes.len() == MOST_TARGETS {
            break;
        }
    }
    Ok(best.expect("there is a first aim"))
}

/// Refuses targets that no file holds, before there are any.
fn check_size(modes: usize, vertices: usize) -> Result<()> {
    let bytes = (modes as u64 + 1) * vertices as u64 * 12;
    if bytes <= MOST_BYTES {
        return Ok(());
    }
    let found = format!("{} morph targets of {} take {}", modes + 1, words::plural(vertices, "vertex"), words::bytes(bytes));
    Err(Error::new(Kind::Unsupported, found)
        .expected(format!("at most {} in a GLB", words::bytes(MOST_BYTES)))
        .hint("a larger --tolerance, --encode skin, or an exact format as -o FILE.usdc"))
}

/// Tracks of the root alone.
fn no_joints(motion: &Motion<'_>) -> Result<Table<Packed>> {
    let mut tracks = Growing::new(motion.spool.folder(), 0)?;
    (0..motion.frames()).try_for_each(|_| tracks.push(&[]))?;
    tracks.finish()
}

/// The fewest components that keep all points within `goal`, or the most that are allowed, and how much of each is in every frame.
fn learn(motion: &Motion<'_>, points: &FitPoints, goal: Tolerance) -> Result<(Modes, Table<f32>)> {
    let mut frames = motion.farthest_frames(points, FIRST_FRAMES)?;
    let mut round = 0;
    loop {
        motion.cancel.check()?;
        let sample = Sample::read(motion, points, frames.clone())?;
        let modes = fewest(&points.rest, &sample, goal);
        let mut amounts = Growing::new(motion.spool.folder(), modes.len())?;
        let mut worst = Vec::with_capacity(motion.frames());
        let project = |_, pose: Vec<DVec3>| {
            let mut left = displacement(&points.rest, pose.into_iter());
            let row: Vec<f32> = modes.iter().map(|mode| take_out(mode, &mut left) as f32).collect();
            (row, largest(&left))
        };
        motion.each_frame(points, project, |_, (row, error)| {
            worst.push(error);
            amounts.push(&row)
        })?;
        let mut missed: Vec<usize> = (0..worst.len()).filter(|f| worst[*f] > goal.worst && !frames.contains(f)).collect();
        round += 1;
        if missed.is_empty() || round == ROUNDS {
            return Ok((modes, amounts.finish()?));
        }
        missed.sort_by(|&a, &b| worst[b].total_cmp(&worst[a]).then(a.cmp(&b)));
        frames.extend(missed.into_iter().take(MORE_FRAMES));
        frames.sort_unstable();
    }
}

/// The fewest principal components of a sample that leave no point of it farther off than `goal`.
fn fewest(rest: &[DVec3], sample: &Sample, goal: Tolerance) -> Modes {
    let mut left: Vec<Vec<f64>> = (0..sample.len()).map(|f| displacement(rest, sample.pose(f).into_iter())).collect();
    let modes = principal(&left);
    let mut count = 0;
    for mode in modes.iter().take(MOST_TARGETS) {
        let worst = left.iter().map(|l| largest(l)).fold(0.0, f64::max);
        let square: f64 = left.iter().flatten().map(|x| x * x).sum();
        if goal.used(worst, (square / (rest.len() * left.len()) as f64).sqrt()) <= 1.0 {
            break;
        }
        left.par_iter_mut().for_each(|l| {
            take_out(mode, l);
        });
        count += 1;
    }
    modes.into_iter().take(count).collect()
}

/// Orthonormal components of some rows, from the eigenvectors of their scalar products (the method of snapshots, Sirovich 1987).
fn principal(rows: &[Vec<f64>]) -> Modes {
    let count = rows.len();
    let pairs: Vec<(usize, usize)> = (0..count).flat_map(|a| (0..=a).map(move |b| (a, b))).collect();
    let products: Vec<f64> =
        pairs.par_iter().map(|&(a, b)| rows[a].iter().zip(&rows[b]).map(|(x, y)| x * y).sum::<f64>()).collect();
    let mut gram = vec![vec![0.0; count]; count];
    for (&(a, b), product) in pairs.iter().zip(products) {
        (gram[a][b], gram[b][a]) = (product, product);
    }
    let identity = |i| (0..count).map(|j| f64::from(u8::from(i == j))).collect();
    let mut vectors: Vec<Vec<f64>> = (0..count).map(identity).collect();
    eigen::diagonalize(&mut gram, &mut vectors, UNTURNED);
    let values: Vec<f64> = (0..count).map(|k| gram[k][k]).collect();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]).then(a.cmp(&b)));
    // What is smaller than rounding has no direction.
    let least = 1e-12 * values[order[0]].max(f64::MIN_POSITIVE);
    order.retain(|&k| values[k] > least);
    let mode = |&k: &usize| {
        let mut mode = vec![0.0; rows[0].len()];
        for (row, vector) in rows.iter().zip(&vectors) {
            let share = vector[k] / values[k].sqrt();
            mode.iter_mut().zip(row).for_each(|(m, x)| *m += share * x);
        }
        mode
    };
    order.par_iter().map(mode).collect()
}

fn displacement(rest: &[DVec3], pose: impl Iterator<Item = DVec3>) -> Vec<f64> {
    rest.iter().zip(pose).flat_map(|(p, q)| (q - *p).to_array()).collect()
}

/// Takes a component out of a displacement; returns how much of it there was.
fn take_out(mode: &[f64], left: &mut [f64]) -> f64 {
    let amount: f64 = mode.iter().zip(left.iter()).map(|(m, l)| m * l).sum();
    left.iter_mut().zip(mode).for_each(|(l, m)| *l -= amount * m);
    amount
}

/// The longest displacement of a point.
fn largest(left: &[f64]) -> f64 {
    left.chunks_exact(3).map(|d| d.iter().map(|x| x * x).sum()).fold(0.0, f64::max).sqrt()
}

/// The components as targets of the scan's vertices, with weights from 0 to 1, and what they begin with as the last target.
fn carry<M: PointMap>(
    job: &Job<'_, M>,
    motion: &Motion<'_>,
    points: &FitPoints,
    modes: &Modes,
    amounts: &Table<f32>,
) -> Result<Morphs> {
    if modes.is_empty() {
        return Ok(Morphs::none(motion.frames()));
    }
    let (mut least, mut most) = (vec![f32::MAX; modes.len()], vec![f32::MIN; modes.len()]);
    for f in 0..amounts.frames() {
        for (k, x) in amounts.frame(f)?.into_iter().enumerate() {
            (least[k], most[k]) = (least[k].min(x), most[k].max(x));
        }
    }
    let range: Vec<f64> = least.iter().zip(&most).map(|(l, m)| f64::from(m - l).max(f64::from(f32::MIN_POSITIVE))).collect();
    // The pose that a target makes of the proxy at rest.
    let pose = |target: usize| {
        let mut pose = job.proxy_rest.to_vec();
        let mut add = |mode: &[f64], amount: f64| {
            for (&v, d) in points.vertices().iter().zip(mode.chunks_exact(3)) {
                pose[v as usize] += DVec3::from_slice(d) * amount;
            }
        };
        match modes.get(target) {
            Some(mode) => add(mode, range[target]),
            None => modes.iter().zip(&least).for_each(|(mode, &l)| add(mode, l.into())),
        }
        pose
    };
    let mapped = |poses: &[Vec<DVec3>]| {
        let mut out = vec![Vec::new(); poses.len()];
        job.map.apply(&poses.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut out);
        out
    };
    let rest = mapped(&[job.proxy_rest.to_vec()]).remove(0);
    let mut targets = Vec::with_capacity(modes.len() + 1);
    for first in (0..=modes.len()).step_by(BATCH) {
        job.cancel.check()?;
        let poses: Vec<Vec<DVec3>> = (first..(modes.len() + 1).min(first + BATCH)).map(pose).collect();
        for points in mapped(&poses) {
            let offset = |&v: &u32| {
                let wide = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
                ((wide(points[v as usize]) - wide(rest[v as usize])) * job.space.scale).as_vec3().to_array()
            };
            targets.push(Target::Dense(job.vertices.par_iter().map(offset).collect()));
        }
    }
    let mut weights = Growing::new(motion.spool.folder(), targets.len())?;
    for f in 0..amounts.frames() {
        let row = amounts.frame(f)?;
        let of_mode = |k: usize| (f64::from(row[k] - least[k]) / range[k]) as f32;
        weights.push(&(0..modes.len()).map(of_mode).chain([1.0]).collect::<Vec<_>>())?;
    }
    Ok(Morphs::new(targets, weights.finish()?))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn targets_that_no_file_holds_are_refused_before_they_are_made() {
        assert!(check_size(100, 3_500_000).is_ok());
        let error = check_size(100, 3_600_000).unwrap_err();
        assert_eq!(error.kind, Kind::Unsupported);
        let text = error.to_string();
        assert!(text.contains("101 morph targets") && text.contains("--encode skin"), "{text}");
    }

    #[test]
    fn components_are_orthonormal_and_as_many_as_there_are() {
        // Three directions, mixed in twelve rows.
        let direction = |d: usize, x: usize| ((x * (d + 2)) as f64 * 0.7).sin();
        let rows: Vec<Vec<f64>> = (0..12)
            .map(|r| (0..60).map(|x| (0..3).map(|d| ((r * (d + 1)) as f64).cos() * direction(d, x)).sum()).collect())
            .collect();
        let modes = principal(&rows);
        assert_eq!(modes.len(), 3);
        for (a, b) in (0..3).flat_map(|a| (0..3).map(move |b| (a, b))) {
            let product: f64 = modes[a].iter().zip(&modes[b]).map(|(x, y)| x * y).sum();
            assert!((product - f64::from(u8::from(a == b))).abs() < 1e-6, "{a} {b} {product}");
        }
        for mut row in rows {
            for mode in &modes {
                take_out(mode, &mut row);
            }
            assert!(largest(&row) < 1e-6);
        }
    }
}
