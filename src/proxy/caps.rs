//! Fans over the holes of a surface, for inside tests and volumes only: they never become geometry.

use crate::disjoint::DisjointSets;
use glam::DVec3;

/// Triangles over the points of the surface and the added centres.
pub(super) struct Caps {
    /// Length-weighted centroid of each loop; numbered after the points of the surface.
    pub(super) centres: Vec<DVec3>,
    /// One triangle per open side.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Closes every connected set of open sides by a fan to its centroid.
///
/// `open_sides`: directed as in their triangles. No order along the loop and no flatness is needed.
pub(super) fn fan_caps(points: &[DVec3], open_sides: &[[u32; 2]]) -> Caps {
    let mut vertices: Vec<u32> = open_sides.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.partition_point(|&w| w < v) as u32;
    let mut loops = DisjointSets::new(vertices.len());
    for &[a, b] in open_sides {
        loops.unite(local(a), local(b));
    }
    let (of, count) = loops.labels();
    let mut centres = vec![DVec3::ZERO; count];
    let mut lengths = vec![0.0; count];
    for &[a, b] in open_sides {
        let (p, q, at) = (points[a as usize], points[b as usize], of[local(a) as usize] as usize);
        centres[at] += (p + q) * (0.5 * p.distance(q));
        lengths[at] += p.distance(q);
    }
    for (centre, length) in centres.iter_mut().zip(lengths) {
        *centre /= length;
    }
    let apex = |a: u32| points.len() as u32 + of[local(a) as usize];
    Caps { triangles: open_sides.iter().map(|&[a, b]| [b, a, apex(a)]).collect(), centres }
}
