//! Splitting of long edges, for surfaces with too few vertices to carry a body. The surface itself stays as it is.

use super::edges::{Edges, double_area};
use glam::DVec3;

/// Passes after which even an edge of the whole diagonal is short.
const PASSES: usize = 40;
/// Shrinking of the length at which edges are split, when all edges are shorter and there are still too few vertices.
const SHRINK: f64 = 0.9;
/// Long needles of no area would be split for ever; this multiple of the wanted vertices ends it.
const MOST: usize = 8;

/// Splits edges at their midpoints until there are at least `target` vertices, about evenly spread.
pub(super) fn refine(points: &mut Vec<DVec3>, triangles: &mut Vec<[u32; 3]>, target: usize) {
    let area: f64 = triangles.iter().map(|&t| 0.5 * double_area(points, t).length()).sum();
    // Edge length of equilateral triangles, two per vertex; edges are split at 1.6 times that, so that halves are not far below it.
    let mut longest = 1.6 * (area * 2.0 / 3f64.sqrt() / target as f64).sqrt();
    for _ in 0..PASSES {
        let mut midpoint = vec![u32::MAX; 3 * triangles.len()];
        let before = points.len();
        for ([a, b], corners) in Edges::of(triangles, points.len()).iter() {
            let (p, q) = (points[a as usize], points[b as usize]);
            if p.distance(q) > longest && points.len() < MOST * target {
                for &corner in corners {
                    midpoint[corner as usize] = points.len() as u32;
                }
                points.push((p + q) * 0.5);
            }
        }
        if points.len() == before {
            if before >= target {
                break;
            }
            longest *= SHRINK;
            continue;
        }
        let mut split = Vec::with_capacity(2 * triangles.len());
        for (t, m) in triangles.iter().zip(midpoint.chunks_exact(3)) {
            split_triangle(points, *t, [m[0], m[1], m[2]], &mut split);
        }
        *triangles = split;
    }
}

/// `m[k]`: midpoint of the side from vertex `k` to the next, or `u32::MAX`.
fn split_triangle(points: &[DVec3], t: [u32; 3], m: [u32; 3], out: &mut Vec<[u32; 3]>) {
    let has = m.map(|v| v != u32::MAX);
    match has.iter().filter(|h| **h).count() {
        0 => out.push(t),
        1 => {
            let k = has.iter().position(|h| *h).unwrap_or(0);
            let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
            out.extend([[a, m[k], c], [m[k], b, c]]);
        }
        2 => {
            let k = has.iter().position(|h| !*h).unwrap_or(0);
            let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
            let (bc, ca) = (m[(k + 1) % 3], m[(k + 2) % 3]);
            out.push([c, ca, bc]);
            let length = |v: u32, w: u32| points[v as usize].distance_squared(points[w as usize]);
            // The shorter diagonal of the remaining quadrilateral.
            if length(a, bc) < length(b, ca) {
                out.extend([[a, b, bc], [a, bc, ca]])
            } else {
                out.extend([[a, b, ca], [b, bc, ca]])
            }
        }
        _ => out.extend([[t[0], m[0], m[2]], [m[0], t[1], m[1]], [m[2], m[1], t[2]], [m[0], m[1], m[2]]]),
    }
}
