//! Points inside the body: without them most tetrahedra would be slivers from skin to skin.

use crate::spatial::TriangleTree;
use crate::splitmix::{mix, signed};
use glam::DVec3;
use rayon::prelude::*;

/// Spacing of the cubic lattice relative to the cube root of the volume per surface vertex.
const SPACING: f64 = 2.0;
/// Points nearer to the surface than this share of the spacing would make flat tetrahedra.
const CLEARANCE: f64 = 0.45;
/// Displacement per coordinate relative to the spacing; breaks the regularity that makes Delaunay slivers.
const JITTER: f64 = 0.1;
/// More points than this help nobody; the spacing grows instead.
const MOST_SITES: f64 = 5e5;

/// Points of a jittered body-centred lattice inside the surface of `tree`, for a body of `volume` with `surface` vertices on its skin.
pub(super) fn inner_points(tree: &TriangleTree, volume: f64, surface: usize) -> Vec<DVec3> {
    let Some((lo, hi)) = tree.bounds() else { return Vec::new() };
    let extent = hi - lo;
    let least = (2.0 * extent.x * extent.y * extent.z / MOST_SITES).cbrt();
    let spacing = (SPACING * (volume / surface.max(1) as f64).cbrt()).max(least);
    if spacing.is_nan() || spacing <= 0.0 {
        return Vec::new();
    }
    let [nx, ny, nz] = (extent / spacing).ceil().to_array().map(|n| n as u64);
    let site = |i: u64| -> Option<DVec3> {
        let (i, centre) = (i / 2, i % 2);
        let corner = DVec3::new((i % nx) as f64, (i / nx % ny) as f64, (i / nx / ny) as f64);
        let point = lo + (corner + DVec3::splat(0.5 + 0.5 * centre as f64)) * spacing;
        if tree.closest_within(point, CLEARANCE * spacing).is_some() || tree.winding(point) <= 0.5 {
            return None;
        }
        let noise = |k: u64| signed(mix(6 * i + 3 * centre + k));
        Some(point + DVec3::new(noise(0), noise(1), noise(2)) * (JITTER * spacing))
    };
    (0..2 * nx * ny * nz).into_par_iter().filter_map(site).collect()
}
