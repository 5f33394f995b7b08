//! A floor that has grown together with the feet, as photogrammetry makes it.

use super::edges::double_area;
use crate::spatial::TriangleTree;
use glam::DVec3;
use rayon::prelude::*;

/// Thickness of the layer at an end of the body in which a floor is looked for, as a share of the diagonal.
const LAYER: f64 = 0.015;
/// Height above the end at which the body standing on it is cut, as a share of the diagonal.
const ABOVE: f64 = 0.05;
/// Least cosine between the normal of a floor and the axis.
const FLAT: f64 = 0.8;
/// Least area of a floor, as a share of the squared diagonal. Both soles of a person are 0.02.
const LEAST: f64 = 0.03;
/// Least ratio of the floor to what stands on it: bodies that end flat have 1, standing feet about 2.
const WIDER: f64 = 3.0;
/// Samples along each side of the cut.
const SAMPLES: usize = 64;

/// Ratio of the floor under a body to what stands on it, where there is a floor, along any axis and either way. `tree`: the closed surface.
pub(super) fn ground(points: &[DVec3], triangles: &[[u32; 3]], tree: &TriangleTree, diagonal: f64) -> Option<f64> {
    let (lo, hi) = tree.bounds()?;
    let ends = (0..3).flat_map(|axis| [1.0, -1.0].map(|sign| (axis, sign)));
    let found = ends.filter_map(|(axis, sign)| {
        let end = if sign > 0.0 { lo[axis] } else { hi[axis] };
        let height = |p: DVec3| (p[axis] - end) * sign;
        let flat = |t: &[u32; 3]| {
            let normal = double_area(points, *t);
            let centre = t.iter().map(|&v| points[v as usize]).sum::<DVec3>() / 3.0;
            let lies = height(centre) < LAYER * diagonal && normal[axis].abs() > FLAT * normal.length();
            if lies { 0.5 * normal[axis].abs() } else { 0.0 }
        };
        let area = triangles.iter().map(flat).sum::<f64>() / (diagonal * diagonal);
        if area < LEAST {
            return None;
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let sample = |k: usize| {
            let share = |i: usize| (i as f64 + 0.5) / SAMPLES as f64;
            let mut p = lo + (hi - lo) * share(k % SAMPLES);
            p[v] = lo[v] + (hi[v] - lo[v]) * share(k / SAMPLES);
            p[axis] = end + sign * ABOVE * diagonal;
            tree.winding(p) > 0.5
        };
        let inside = (0..SAMPLES * SAMPLES).into_par_iter().filter(|&k| sample(k)).count();
        let cell = (hi[u] - lo[u]) * (hi[v] - lo[v]) / (SAMPLES * SAMPLES) as f64;
        let cut = inside as f64 * cell / (diagonal * diagonal);
        (cut > 0.0 && area > WIDER * cut).then_some(area / cut)
    });
    found.max_by(f64::total_cmp)
}
