//! Motion of things that are made of parts: a track per rigid part, and a skin of those that bend.
//!
//! Pieces of the surface that do not touch each other are tried one by one: as part of one that moves alike, else as a part of their own. Those that
//! bend share a skin, whose joints are fitted to them alone.

use super::measure::{self, Written};
use super::morphs::Morphs;
use super::motion::{FitPoints, Motion};
use super::rigid::{Packed, Rigid};
use super::skin::Skin;
use super::table::{Growing, Table};
use super::{Encoded, Influences, Job, Parts, PointMap};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// Parts at most: each is a node.
const MOST_PARTS: usize = 250;
/// Frames that are tried first.
const TRIED: usize = 8;
/// Times that a frame joins those that are tried, because a part that was rigid in them bends there.
const TRIALS: usize = 8;
/// How far a vertex of a rigid part may be off, as a share of the tolerance.
const RIGID: f64 = 0.04;
/// Share of the vertices that are on rigid parts at least: crumbs beside one large piece that bends do not make it a thing of parts.
const LEAST: f64 = 0.1;

/// A track per rigid part and a skin of what bends; `None` without rigid parts, with one and nothing else, or if the skin misses the tolerance.
pub fn encode<M: PointMap>(job: &Job<'_, M>, motion: &Motion<'_>) -> Result<Option<Encoded>> {
    if job.pieces.len() < 2 {
        return Ok(None);
    }
    let at_rest: Vec<DVec3> = job.vertices.iter().map(|&v| job.rest[v as usize]).collect();
    let points = FitPoints::new(job.proxy_rest, (0..job.proxy_rest.len() as u32).collect());
    let mut frames = motion.farthest_frames(&points, TRIED)?;
    for _ in 0..=TRIALS {
        let poses = frames.iter().map(|&f| posed(job, motion, f)).collect::<Result<Vec<_>>>()?;
        let Some(split) = Split::of(job, &at_rest, &poses) else { return Ok(None) };
        match split.tracks(job, motion, &at_rest)? {
            Tracks::Of(tracks) => return split.encode(job, motion, &at_rest, &tracks),
            Tracks::BentIn(frame) => frames.push(frame),
        }
    }
    Ok(None)
}

/// Places of vertices by what their pieces do.
struct Split {
    /// Of each rigid part.
    rigid: Vec<Vec<u32>>,
    /// Of all that bends, ascending.
    soft: Vec<u32>,
}

/// Motions of all rigid parts in all frames, or a frame in which one of them bends.
enum Tracks {
    Of(Table<Packed>),
    BentIn(usize),
}

impl Split {
    /// By some poses.
    fn of<M>(job: &Job<'_, M>, rest: &[DVec3], poses: &[Vec<DVec3>]) -> Option<Self> {
        let most_soft = ((1.0 - LEAST) * rest.len() as f64) as usize;
        let mut parts: Vec<(Vec<u32>, Vec<Rigid>)> = Vec::new();
        let mut soft = Vec::new();
        for piece in job.pieces {
            let alike = |motions: &[Rigid]| motions.iter().zip(poses).all(|(m, pose)| is_moved(m, piece, rest, pose, bound(job)));
            if let Some((part, _)) = parts.iter_mut().find(|(_, motions)| alike(motions)) {
                part.extend(piece);
                continue;
            }
            let motions: Option<Vec<Rigid>> = poses.iter().map(|pose| fit(piece, rest, pose)).collect();
            match motions.filter(|m| alike(m)) {
                Some(motions) if parts.len() < MOST_PARTS => parts.push((piece.clone(), motions)),
                _ => soft.extend(piece),
            }
            if soft.len() > most_soft {
                return None;
            }
        }
        soft.sort_unstable();
        let rigid: Vec<Vec<u32>> = parts.into_iter().map(|(part, _)| part).collect();
        (rigid.len() + usize::from(!soft.is_empty()) > 1 && !rigid.is_empty()).then_some(Self { rigid, soft })
    }

    fn tracks<M: PointMap>(&self, job: &Job<'_, M>, motion: &Motion<'_>, rest: &[DVec3]) -> Result<Tracks> {
        let mut tracks = Growing::new(motion.spool.folder(), self.rigid.len())?;
        for f in 0..motion.frames() {
            job.cancel.check()?;
            let pose = posed(job, motion, f)?;
            let track = |part: &Vec<u32>| fit(part, rest, &pose).filter(|m| is_moved(m, part, rest, &pose, bound(job)));
            match self.rigid.par_iter().map(|part| track(part).map(|m| m.pack())).collect::<Option<Vec<_>>>() {
                Some(row) => tracks.push(&row)?,
                None => return Ok(Tracks::BentIn(f)),
            }
        }
        tracks.finish().map(Tracks::Of)
    }

    fn encode<M: PointMap>(
        &self,
        job: &Job<'_, M>,
        motion: &Motion<'_>,
        at_rest: &[DVec3],
        tracks: &Table<Packed>,
    ) -> Result<Option<Encoded>> {
        let mut of_vertex = vec![self.rigid.len() as u16; at_rest.len()];
        for (k, part) in self.rigid.iter().enumerate() {
            part.iter().for_each(|&i| of_vertex[i as usize] = k as u16);
        }
        let parts = Parts { rigid: self.rigid.len(), of_vertex };
        let stiff: Vec<u32> = (0..at_rest.len() as u32).filter(|&i| parts.is_rigid(i as usize)).collect();
        let rest_of_stiff: Vec<DVec3> = stiff.iter().map(|&i| at_rest[i as usize]).collect();
        let whole = |&i: &u32| Influences { joints: [parts.of_vertex[i as usize], 0, 0, 0], weights: [1.0, 0.0, 0.0, 0.0] };
        let influences: Vec<Influences> = stiff.iter().map(whole).collect();
        let nodes = Skin::new(motion, tracks, &rest_of_stiff, &influences, job.space, job.levels)?;
        let (mut skin, mut morphs, mut proxy_influences) = (nodes, Morphs::none(motion.frames()), Vec::new());
        if !self.soft.is_empty() {
            let vertices: Vec<u32> = self.soft.iter().map(|&i| job.vertices[i as usize]).collect();
            let soft = Job { vertices: &vertices, pieces: &[], ..*job }.skinned(motion)?;
            skin = skin.beside(&soft.skin, [&stiff, &self.soft], motion.spool.folder())?;
            morphs = soft.morphs.of_places(&self.soft);
            proxy_influences = soft.proxy_influences;
        }
        let rest = job.rest_as_written();
        let written = Written { skin: &skin, morphs: &morphs, rest: &rest, space: job.space };
        let all: Vec<usize> = (0..motion.frames()).collect();
        let errors = written.measure(job.map, job.vertices, job.spool, &all, job.cancel)?;
        let summary = measure::summary(&errors, all.len());
        if job.misses(&summary) {
            return Ok(None);
        }
        Ok(Some(Encoded { skin, morphs, rest, summary, proxy_influences, parts: Some(parts) }))
    }
}

fn bound<M>(job: &Job<'_, M>) -> f64 {
    RIGID * job.tolerance.worst
}

/// The vertices in a frame, the root's motion taken out.
fn posed<M: PointMap>(job: &Job<'_, M>, motion: &Motion<'_>, frame: usize) -> Result<Vec<DVec3>> {
    let mut points = vec![Vec::new()];
    job.map.apply(&[&job.spool.read_one(frame)?], &mut points);
    let root = &motion.roots[frame];
    let point = |&v: &u32| root.undo(DVec3::from_array(points[0][v as usize].map(f64::from)));
    Ok(job.vertices.iter().map(point).collect())
}

fn fit(part: &[u32], rest: &[DVec3], pose: &[DVec3]) -> Option<Rigid> {
    Rigid::fit(part.iter().map(|&i| (rest[i as usize], pose[i as usize])))
}

/// Whether a motion brings the part to where it is in a pose.
fn is_moved(motion: &Rigid, part: &[u32], rest: &[DVec3], pose: &[DVec3], bound: f64) -> bool {
    part.iter().all(|&i| motion.apply(rest[i as usize]).distance_squared(pose[i as usize]) <= bound * bound)
}
