//! Debris of scanning: loose sheets beside the body, such as ghosts and shards of the platform.

use crate::disjoint::DisjointSets;
use crate::equal::first_in_place;
use glam::DVec3;

/// A loose piece of less than this share of the surface may be debris.
const SMALL: f64 = 0.05;
/// A piece that faces one way, with the length of its summed area vectors above this share of its area, is a sheet; a hand with an
/// open wrist has 0.05.
const SHEET: f64 = 0.5;
/// When sheets make up more than this share of the surface, the surface is made of them.
const MOST: f64 = 0.10;

/// The triangles without debris.
pub(super) fn without_debris(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let sound = |t: &[u32; 3]| t.iter().all(|&v| points.get(v as usize).is_some_and(|p| p.is_finite()));
    let mut kept: Vec<[u32; 3]> = triangles.iter().filter(|t| sound(t)).copied().collect();
    let mut sets = DisjointSets::of(first_in_place(points));
    for &[a, b, c] in &kept {
        sets.unite(a, b);
        sets.unite(a, c);
    }
    let mut area = vec![0.0; points.len()];
    let mut facing = vec![DVec3::ZERO; points.len()];
    for t in &kept {
        let [a, b, c] = t.map(|v| points[v as usize]);
        let normal = (b - a).cross(c - a);
        let piece = sets.find(t[0]) as usize;
        area[piece] += normal.length();
        facing[piece] += normal;
    }
    let total: f64 = area.iter().sum();
    let debris = |piece: usize| area[piece] < SMALL * total && facing[piece].length() > SHEET * area[piece];
    let sheets: f64 = (0..area.len()).filter(|&p| debris(p)).map(|p| area[p]).sum();
    if sheets <= MOST * total {
        kept.retain(|t| !debris(sets.find(t[0]) as usize));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron(at: DVec3, size: f64) -> ([DVec3; 4], [[u32; 3]; 4]) {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| at + p * size);
        (corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    }

    #[test]
    fn a_small_sheet_goes_and_a_small_solid_stays() {
        let (mut points, big) = tetrahedron(DVec3::ZERO, 1.0);
        let (small_points, small) = tetrahedron(DVec3::splat(3.0), 0.1);
        let mut points = { std::mem::take(&mut points).to_vec() };
        points.extend(small_points);
        points.extend([DVec3::splat(5.0), DVec3::new(5.1, 5.0, 5.0), DVec3::new(5.0, 5.1, 5.0)]);
        let mut triangles = big.to_vec();
        triangles.extend(small.map(|t| t.map(|v| v + 4)));
        let solids = triangles.clone();
        triangles.push([8, 9, 10]);
        assert_eq!(without_debris(&points, &triangles), solids);
    }

    #[test]
    fn a_soup_is_welded_before_it_is_judged() {
        let (corners, faces) = tetrahedron(DVec3::ZERO, 1.0);
        let soup: Vec<DVec3> = faces.iter().flatten().map(|&v| corners[v as usize]).collect();
        let triangles = [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]];
        assert_eq!(without_debris(&soup, &triangles), triangles);
    }

    #[test]
    fn a_surface_of_sheets_is_left_alone() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::X + DVec3::Z, DVec3::Y + DVec3::Z];
        let triangles = [[0, 1, 2], [3, 4, 5]];
        assert_eq!(without_debris(&points, &triangles), triangles);
    }
}
