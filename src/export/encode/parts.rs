//! Motion of things that are made of rigid parts: a track per part, and no skin.
//!
//! Pieces of the surface that do not touch each other are tried one by one: as part of one that moves alike, else as a part of their own. If one
//! of them bends, the whole is no such thing.

use super::measure::{self, Written};
use super::morphs::Morphs;
use super::motion::{FitPoints, Motion};
use super::rigid::{Packed, Rigid};
use super::skin::Skin;
use super::table::{Growing, Table};
use super::{Encoded, Influences, Job, PointMap};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// Parts at most: each is a node.
const MOST_PARTS: usize = 250;
/// Frames that are tried first.
const TRIED: usize = 8;
/// How far a vertex of a rigid part may be off, as a share of the tolerance.
const RIGID: f64 = 0.04;

/// A track per rigid part; `None` unless the pieces of the surface are at least two rigid parts.
pub fn encode<M: PointMap>(job: &Job<'_, M>, motion: &Motion<'_>) -> Result<Option<Encoded>> {
    let at_rest: Vec<DVec3> = job.vertices.iter().map(|&v| job.rest[v as usize]).collect();
    let Some(parts) = parts(job, motion, &at_rest)?.filter(|parts| parts.len() > 1) else { return Ok(None) };
    let Some(tracks) = tracks(job, motion, &at_rest, &parts)? else { return Ok(None) };
    let mut of_vertex = vec![0; at_rest.len()];
    for (k, part) in parts.iter().enumerate() {
        part.iter().for_each(|&i| of_vertex[i as usize] = k as u16);
    }
    let whole = |&k: &u16| Influences { joints: [k, 0, 0, 0], weights: [1.0, 0.0, 0.0, 0.0] };
    let influences: Vec<Influences> = of_vertex.iter().map(whole).collect();
    let skin = Skin::new(motion, &tracks, &at_rest, &influences, job.space, job.levels)?;
    let (rest, morphs) = (job.rest_as_written(), Morphs::none(motion.frames()));
    let written = Written { skin: &skin, morphs: &morphs, rest: &rest, space: job.space };
    let all: Vec<usize> = (0..motion.frames()).collect();
    let errors = written.measure(job.map, job.vertices, job.spool, &all, job.cancel)?;
    let summary = measure::summary(&errors, all.len());
    Ok(Some(Encoded { skin, morphs, rest, summary, proxy_influences: Vec::new(), parts: Some(of_vertex) }))
}

/// Pieces that move alike in a few frames, as places of vertices; `None` if one of them bends.
fn parts<M: PointMap>(job: &Job<'_, M>, motion: &Motion<'_>, rest: &[DVec3]) -> Result<Option<Vec<Vec<u32>>>> {
    let pieces = job.pieces;
    if pieces.len() < 2 {
        return Ok(None);
    }
    let points = FitPoints::new(job.proxy_rest, (0..job.proxy_rest.len() as u32).collect());
    let frames = motion.farthest_frames(&points, TRIED)?;
    let poses = frames.iter().map(|&f| posed(job, motion, f)).collect::<Result<Vec<_>>>()?;
    let mut parts: Vec<(Vec<u32>, Vec<Rigid>)> = Vec::new();
    for piece in pieces {
        let alike = |motions: &[Rigid]| motions.iter().zip(&poses).all(|(m, pose)| farthest(m, piece, rest, pose) <= bound(job));
        if let Some((part, _)) = parts.iter_mut().find(|(_, motions)| alike(motions)) {
            part.extend(piece);
            continue;
        }
        let motions: Option<Vec<Rigid>> = poses.iter().map(|pose| fit(piece, rest, pose)).collect();
        match motions.filter(|m| alike(m)) {
            Some(motions) if parts.len() < MOST_PARTS => parts.push((piece.clone(), motions)),
            _ => return Ok(None),
        }
    }
    Ok(Some(parts.into_iter().map(|(part, _)| part).collect()))
}

/// Motions of all parts in all frames; `None` if one of them bends.
fn tracks<M: PointMap>(
    job: &Job<'_, M>,
    motion: &Motion<'_>,
    rest: &[DVec3],
    parts: &[Vec<u32>],
) -> Result<Option<Table<Packed>>> {
    let mut tracks = Growing::new(motion.spool.folder(), parts.len())?;
    for f in 0..motion.frames() {
        job.cancel.check()?;
        let pose = posed(job, motion, f)?;
        let track = |part: &Vec<u32>| fit(part, rest, &pose).filter(|m| farthest(m, part, rest, &pose) <= bound(job));
        let Some(row) = parts.par_iter().map(|p| track(p).map(|m| m.pack())).collect::<Option<Vec<_>>>() else { return Ok(None) };
        tracks.push(&row)?;
    }
    tracks.finish().map(Some)
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

fn farthest(motion: &Rigid, part: &[u32], rest: &[DVec3], pose: &[DVec3]) -> f64 {
    part.iter().map(|&i| motion.apply(rest[i as usize]).distance(pose[i as usize])).fold(0.0, f64::max)
}
