//! Convex hull of tetrahedra → the body: what lies outside, across air gaps, or is flat and loose goes.

use super::Proxy;
use super::tetrahedra::{boundary, components_by_faces, components_by_vertices, quality, volume};
use crate::spatial::TriangleTree;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;

/// Samples inside an edge when it is tested for air.
const SAMPLES: u32 = 7;
/// Tetrahedra of less quality with two boundary faces are peeled off.
const SLIVER: f64 = 0.1;
/// Tetrahedra of less quality count as flat: their gradients are noise, and they are stiff out of all proportion.
const FLAT: f64 = 1e-3;
/// Passes of peeling; each one may bare new slivers.
const PEELS: usize = 10;
/// Parts below this share of the volume are dropped.
const CRUMB: f64 = 0.005;

/// Keeps the tetrahedra whose centroid lies inside the surface.
pub(super) fn keep_inside(points: &[DVec3], tets: &mut Vec<[u32; 4]>, tree: &TriangleTree) {
    let centroid = |t: &[u32; 4]| t.iter().map(|&v| points[v as usize]).sum::<DVec3>() * 0.25;
    let inside: Vec<bool> = tets.par_iter().with_min_len(64).map(|t| tree.winding(centroid(t)) > 0.5).collect();
    retain_by(tets, |i| inside[i]);
}

/// Removes the tetrahedra with an edge that leaves the body by more than `gap`; returns how many.
pub(super) fn cut_air_gaps(points: &[DVec3], tets: &mut Vec<[u32; 4]>, tree: &TriangleTree, gap: f64) -> usize {
    let of = |t: &[u32; 4]| [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)].map(|(i, j)| [t[i].min(t[j]), t[i].max(t[j])]);
    let mut edges: Vec<[u32; 2]> = tets.iter().flat_map(of).collect();
    edges.sort_unstable();
    edges.dedup();
    let crosses_air = |&[a, b]: &[u32; 2]| {
        let (p, q) = (points[a as usize], points[b as usize]);
        // The middle of a short edge is never `gap` away from both of its ends, which lie on the surface or inside.
        p.distance(q) >= 2.0 * gap
            && (1..=SAMPLES).any(|k| {
                let sample = p.lerp(q, f64::from(k) / f64::from(SAMPLES + 1));
                tree.closest_within(sample, gap).is_none() && tree.winding(sample) < 0.5
            })
    };
    let crossing: Vec<bool> = edges.par_iter().with_min_len(64).map(crosses_air).collect();
    let before = tets.len();
    tets.retain(|t| !of(t).iter().any(|e| edges.binary_search(e).is_ok_and(|i| crossing[i])));
    before - tets.len()
}

/// Peels slivers and flat tetrahedra off the boundary; returns how many.
pub(super) fn peel(points: &[DVec3], tets: &mut Vec<[u32; 4]>) -> usize {
    let before = tets.len();
    for _ in 0..PEELS {
        let mut bare = vec![0u8; tets.len()];
        for side in boundary(tets) {
            bare[side.tet as usize] += 1;
        }
        let loose = |i: usize, t: [u32; 4]| {
            let limit = if bare[i] == 2 { SLIVER } else { FLAT };
            bare[i] > 0 && quality(points, t) < limit
        };
        let keep: Vec<bool> = tets.iter().enumerate().map(|(i, t)| !loose(i, *t)).collect();
        let count = tets.len();
        retain_by(tets, |i| keep[i]);
        if tets.len() == count {
            break;
        }
    }
    before - tets.len()
}

/// Drops the parts, connected across faces, that make up less than 0.5 % of the volume; returns how many parts.
pub(super) fn drop_crumbs(points: &[DVec3], tets: &mut Vec<[u32; 4]>) -> usize {
    let (part, count) = components_by_faces(tets);
    let mut volumes = vec![0.0; count];
    for (t, &part) in tets.iter().zip(&part) {
        volumes[part as usize] += volume(points, *t).abs();
    }
    let total: f64 = volumes.iter().sum();
    retain_by(tets, |i| volumes[part[i] as usize] >= CRUMB * total);
    volumes.iter().filter(|&&v| v < CRUMB * total).count()
}

/// Tetrahedra, positively oriented up to flat ones → the proxy, and how many flat ones were taken out.
///
/// The boundary is that of all tetrahedra, so that a flat one inside leaves no slit; behind a face of a flat one stands the tetrahedron that
/// shares most of its vertices with the face.
pub(super) fn finish(points: &[DVec3], mut tets: Vec<[u32; 4]>) -> (Proxy, usize) {
    let solid = |t: &[u32; 4]| quality(points, *t) >= FLAT;
    let mut number = vec![u32::MAX; points.len()];
    for &v in tets.iter().filter(|t| solid(t)).flatten() {
        number[v as usize] = 0;
    }
    // A vertex that hangs on flat tetrahedra only would be held by nothing.
    tets.retain(|t| t.iter().all(|&v| number[v as usize] == 0));
    let mut rest = Vec::new();
    for (n, &p) in number.iter_mut().zip(points).filter(|(n, _)| **n == 0) {
        *n = rest.len() as u32;
        rest.push(p);
    }
    for v in tets.iter_mut().flatten() {
        *v = number[*v as usize];
    }
    let sides = boundary(&tets);
    let faces: Vec<[u32; 3]> = sides.iter().map(|side| side.face(&tets)).collect();
    let mut position = vec![None; tets.len()];
    let mut kept = Vec::with_capacity(tets.len());
    for (i, t) in tets.iter().enumerate().filter(|(_, t)| quality(&rest, **t) >= FLAT) {
        position[i] = Some(kept.len() as u32);
        kept.push(*t);
    }
    let mut around = Vec::new();
    let behind = sides.iter().zip(&faces).map(|(side, face)| {
        position[side.tet as usize].unwrap_or_else(|| {
            if around.is_empty() {
                around = tets_around(&kept, rest.len());
            }
            nearest_behind(&kept, &around, face)
        })
    });
    let boundary_tets = behind.collect();
    let components = components_by_vertices(&kept, rest.len());
    let flat = tets.len() - kept.len();
    (Proxy { rest, tets: kept, boundary: faces, boundary_tets, components }, flat)
}

fn tets_around(tets: &[[u32; 4]], vertices: usize) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::new(); vertices];
    for (i, t) in (0u32..).zip(tets) {
        t.iter().for_each(|&v| around[v as usize].push(i));
    }
    around
}

/// Of the tetrahedra around a face the first that shares most vertices with it.
fn nearest_behind(tets: &[[u32; 4]], around: &[Vec<u32>], face: &[u32; 3]) -> u32 {
    let shared = |t: u32| tets[t as usize].iter().filter(|v| face.contains(v)).count();
    let candidates = face.iter().flat_map(|&v| &around[v as usize]).copied();
    candidates.max_by_key(|&t| (shared(t), Reverse(t))).expect("every vertex belongs to a tetrahedron that is not flat")
}

fn retain_by<T>(items: &mut Vec<T>, keep: impl Fn(usize) -> bool) {
    let mut i = 0;
    items.retain(|_| {
        i += 1;
        keep(i - 1)
    });
}
