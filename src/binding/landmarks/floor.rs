//! A floor that has grown together with the feet, as photogrammetry makes it.

use super::voxels::Filled;
use glam::DVec3;
use rayon::prelude::*;

/// Directions that are tried for the floor's normal.
const TRIED: usize = 200;
/// Triangles whose normals are looked at.
const SAMPLED: usize = 20_000;
/// Cosine between the normals of a flat surface and its mean.
const FLAT: f64 = 0.94;
/// Cells at an end in which a floor is looked for.
const LAYER: usize = 8;
/// A floor's section is larger by this than those two to five cells further in.
const WIDER: f64 = 2.5;
/// Sections that are larger by no more than this belong to what stands on the floor.
const ALIKE: f64 = 1.3;
/// How far over its topmost cells a floor reaches, in cells: it is not quite even.
const OVER: f64 = 0.4;
/// Least area of a floor as a share of the squared extent across it.
const LEAST: f64 = 0.03;

/// A flat floor under a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Unit vector from the floor to the body.
    pub up: DVec3,
    /// Height of its upper side along `up`, in the unit box of the scan.
    pub height: f64,
}

impl Floor {
    /// Whether a place belongs to the floor.
    pub fn holds(&self, p: DVec3) -> bool {
        p.dot(self.up) < self.height
    }

    /// The flat slab at an end of the shape, if there is one, along whatever axis: the one that is widest against what stands on it.
    pub(super) fn of(filled: &Filled, points: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let cells: Vec<DVec3> = filled.centres().collect();
        let found =
            normals(points, triangles).into_iter().flat_map(|n| [n, -n]).filter_map(|up| slab(&cells, filled.pitch(), up));
        found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, floor)| floor)
    }
}

fn slab(cells: &[DVec3], h: f64, up: DVec3) -> Option<(f64, Floor)> {
    let (low, high) = cells.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.dot(up)), b.max(p.dot(up))));
    let mut areas = vec![0.0_f64; ((high - low) / h) as usize + 1];
    for p in cells {
        areas[((p.dot(up) - low) / h) as usize] += h * h;
    }
    let least = LEAST * (high - low) * (high - low);
    let further = |i: usize| areas.get(i + 2..i + 6).map(|a| a.iter().copied().fold(0.0, f64::max));
    let last = (0..LAYER).rev().find(|&i| further(i).is_some_and(|f| f > 0.0 && areas[i] > WIDER * f && areas[i] > least))?;
    let beyond = further(last)?;
    let first = (last + 1..last + 3).find(|&i| areas[i] <= ALIKE * beyond).unwrap_or(last + 2);
    Some((areas[last] / beyond, Floor { up, height: low + (first as f64 - 0.5 + OVER) * h }))
}

/// Normals that much of the surface shares, up to their signs.
fn normals(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let corners = triangles.iter().step_by(triangles.len().div_ceil(SAMPLED).max(1)).map(|t| t.map(|v| points[v as usize]));
    let normals: Vec<DVec3> = corners.map(|[a, b, c]| (b - a).cross(c - a)).filter(|n| n.length_squared() > 0.0).collect();
    let total: f64 = normals.iter().map(|n| n.length()).sum();
    let mut tried = Vec::with_capacity(TRIED);
    let mut area = 0.0;
    for n in &normals {
        area += n.length();
        if area * TRIED as f64 > (tried.len() as f64 + 0.5) * total {
            tried.push(n.normalize());
        }
    }
    let shared = |axis: &DVec3| {
        let along = |n: &&DVec3| n.dot(*axis).abs() > FLAT * n.length();
        normals.iter().filter(along).map(|n| *n * n.dot(*axis).signum()).sum::<DVec3>().try_normalize()
    };
    tried.par_iter().filter_map(shared).collect()
}
