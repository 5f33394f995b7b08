//! Delaunay tetrahedralization, guarded and proven.
//!
//! The library underneath is fast and right on points in general position; it loops on duplicates, panics on NaN, and is slow and makes flat
//! tetrahedra on regular grids. So points are merged, centred, scaled, shuffled and displaced by a fixed pseudo-random amount that is far
//! below anything visible, and every face of the result is checked with exact predicates.

use super::tetrahedra::{Side, faces, sides};
use crate::splitmix::{mix, signed};
use glam::DVec3;
use robust::Coord3D;
use simple_delaunay_lib::delaunay_3d::delaunay_struct_3d::DelaunayStructure3D;
use simple_delaunay_lib::delaunay_3d::simplicial_struct_3d::Node;
use std::fmt;

/// Largest displacement per coordinate, relative to the diagonal.
const DISPLACEMENT: f64 = 1e-7;

/// Why there is no tetrahedralization.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// Fewer than four different points, or a coordinate that is not finite.
    Points,
    /// The library gave up.
    Library(String),
    /// The result is not the Delaunay tetrahedralization.
    Unproven(&'static str),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Points => f.write_str("fewer than four different points"),
            Self::Library(reason) => f.write_str(reason),
            Self::Unproven(reason) => f.write_str(reason),
        }
    }
}

/// Tetrahedra of the points, positively oriented up to the displacement: a flat one may be inverted by as much.
///
/// Of equal points only the first is used.
pub(super) fn tetrahedralize(points: &[DVec3]) -> Result<Vec<[u32; 4]>, Failure> {
    if points.iter().any(|p| !p.is_finite()) {
        return Err(Failure::Points);
    }
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let bits = |v: u32| points[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    order.sort_unstable_by_key(|&v| (bits(v), v));
    order.dedup_by_key(|v| bits(*v));
    if order.len() < 4 {
        return Err(Failure::Points);
    }
    order.sort_unstable();
    shuffle(&mut order);
    let displaced = displace(points, &order);
    let mut tets = insert(&displaced)?;
    for t in &mut tets {
        if orientation(&displaced, *t) < 0.0 {
            t.swap(0, 1);
        }
    }
    prove(&displaced, &tets).map_err(Failure::Unproven)?;
    for v in tets.iter_mut().flatten() {
        *v = order[*v as usize];
    }
    Ok(tets)
}

fn shuffle(order: &mut [u32]) {
    for i in (1..order.len()).rev() {
        let j = mix(i as u64 ^ 0x00AB_CDEF) % (i as u64 + 1);
        order.swap(i, j as usize);
    }
}

/// Points in the given order, centred, of unit diagonal, displaced.
fn displace(points: &[DVec3], order: &[u32]) -> Vec<DVec3> {
    let chosen = || order.iter().map(|&v| points[v as usize]);
    let (lo, hi) = chosen().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let (centre, diagonal) = (lo + (hi - lo) * 0.5, (hi - lo).length());
    let noise = |k: u64| signed(mix(k));
    let shift = |v: u32| DVec3::from_array([0, 1, 2].map(|k| noise(u64::from(v) * 3 + k)));
    order.iter().zip(chosen()).map(|(&v, p)| (p - centre) / diagonal + shift(v) * DISPLACEMENT).collect()
}

fn insert(points: &[DVec3]) -> Result<Vec<[u32; 4]>, Failure> {
    let run = || -> Result<Vec<[u32; 4]>, String> {
        let mut structure = DelaunayStructure3D::new();
        let coordinates: Vec<[f64; 3]> = points.iter().map(|p| p.to_array()).collect();
        structure.insert_vertices(&coordinates, true).map_err(|e| e.to_string())?;
        let simplices = structure.get_simplicial();
        let mut tets = Vec::new();
        for i in 0..simplices.get_nb_tetrahedra() {
            let nodes = simplices.get_tetrahedron(i).map_err(|e| e.to_string())?.nodes();
            if let [Node::Value(a), Node::Value(b), Node::Value(c), Node::Value(d)] = nodes {
                tets.push([a, b, c, d].map(|v| v as u32));
            }
        }
        Ok(tets)
    };
    match std::panic::catch_unwind(run) {
        Ok(result) => result.map_err(Failure::Library),
        Err(_) => Err(Failure::Library("stopped by an inner check".into())),
    }
}

/// Exact proof by the Delaunay lemma: positive tetrahedra that fit face to face, empty spheres across every face, and a convex hull.
fn prove(points: &[DVec3], tets: &[[u32; 4]]) -> Result<(), &'static str> {
    let mut used = vec![false; points.len()];
    for t in tets {
        if orientation(points, *t) <= 0.0 {
            return Err("a tetrahedron is flat");
        }
        t.iter().for_each(|&v| used[v as usize] = true);
    }
    if used.contains(&false) {
        return Err("a point is left out");
    }
    let all = sides(tets);
    let apex = |s: &Side| tets[s.tet as usize][s.corner as usize];
    let mut hull = Vec::new();
    for face in faces(&all) {
        match face {
            [side] => hull.push(*side),
            [a, b] => {
                let [x, y, z] = a.face(tets);
                if orientation(points, [apex(b), x, y, z]) >= 0.0 {
                    return Err("two tetrahedra lie on one side of their face");
                }
                if in_sphere(points, tets[a.tet as usize], apex(b)) {
                    return Err("a sphere is not empty");
                }
            }
            _ => return Err("a face has more than two tetrahedra"),
        }
    }
    prove_convex(points, tets, &hull)
}

fn prove_convex(points: &[DVec3], tets: &[[u32; 4]], hull: &[Side]) -> Result<(), &'static str> {
    let mut sides: Vec<([u32; 2], usize)> = Vec::with_capacity(3 * hull.len());
    for (i, s) in hull.iter().enumerate() {
        let [a, b, c] = s.key;
        sides.extend([([a, b], i), ([b, c], i), ([a, c], i)]);
    }
    sides.sort_unstable();
    for pair in sides.chunk_by(|a, b| a.0 == b.0) {
        let &[(edge, f), (_, g)] = pair else { return Err("the hull is not a closed surface") };
        let [x, y, z] = hull[f].face(tets);
        let opposite = hull[g].key.into_iter().find(|v| !edge.contains(v)).ok_or("the hull is not a closed surface")?;
        // Outside of the face, i.e. in front of it, would make the hull concave there.
        if orientation(points, [opposite, x, y, z]) < 0.0 {
            return Err("the hull is not convex");
        }
    }
    Ok(())
}

/// Positive for positive volume, exactly.
fn orientation(points: &[DVec3], tet: [u32; 4]) -> f64 {
    let [a, b, c, d] = tet.map(|v| coordinates(points[v as usize]));
    -robust::orient3d(a, b, c, d)
}

/// Whether a point lies strictly inside the sphere through the corners of a positive tetrahedron, exactly.
fn in_sphere(points: &[DVec3], tet: [u32; 4], point: u32) -> bool {
    let [a, b, c, d] = tet.map(|v| coordinates(points[v as usize]));
    robust::insphere(b, a, c, d, coordinates(points[point as usize])) > 0.0
}

fn coordinates(p: DVec3) -> Coord3D<f64> {
    Coord3D { x: p.x, y: p.y, z: p.z }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tetrahedra::volume;
    use super::*;
    use crate::splitmix::unit;

    fn random(n: u64) -> Vec<DVec3> {
        let at = |k: u64| unit(mix(k + 7_000_000));
        (0..n).map(|i| DVec3::new(at(3 * i), at(3 * i + 1), at(3 * i + 2))).collect()
    }

    fn total(points: &[DVec3]) -> f64 {
        tetrahedralize(points).unwrap().iter().map(|t| volume(points, *t)).sum()
    }

    #[test]
    fn a_grid_fills_its_box() {
        let points: Vec<DVec3> =
            (0..1000).map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100))).collect();
        assert!((total(&points) - 729.0).abs() < 1e-3);
    }

    #[test]
    fn duplicates_far_offsets_and_extreme_scales_are_fine() {
        let mut points = random(300);
        let expected = total(&points);
        points.extend_from_within(..100);
        assert!((total(&points) - expected).abs() < 1e-12);
        for (scale, offset) in [(1e-6, 0.0), (1e12, 0.0), (1.0, 3e7)] {
            let moved: Vec<DVec3> = points.iter().map(|p| *p * scale + DVec3::splat(offset)).collect();
            assert!((total(&moved) / scale.powi(3) - expected).abs() < 1e-5, "{scale} {offset}");
        }
    }

    #[test]
    fn too_few_points_and_nan_are_refused() {
        let mut points = vec![DVec3::X, DVec3::Y, DVec3::Z, DVec3::X, DVec3::Y];
        assert_eq!(tetrahedralize(&points), Err(Failure::Points));
        points.extend([DVec3::ZERO, DVec3::NAN]);
        assert_eq!(tetrahedralize(&points), Err(Failure::Points));
    }

    #[test]
    fn the_proof_fails_on_a_wrong_mesh() {
        // The flipped pair: a tall bipyramid cut into two tetrahedra whose spheres contain each other's apex.
        let points = [DVec3::X, DVec3::new(-0.5, 0.8, 0.0), DVec3::new(-0.5, -0.8, 0.0), DVec3::Z * 0.2, DVec3::Z * -0.2];
        let two = [[0, 1, 2, 3], [0, 2, 1, 4]]
            .map(|t: [u32; 4]| if orientation(&points, t) < 0.0 { [t[1], t[0], t[2], t[3]] } else { t });
        assert_eq!(prove(&points, &two), Err("a sphere is not empty"));
        assert_eq!(prove(&points[..4], &two[..1]), Ok(()));
        assert_eq!(prove(&points, &two[..1]), Err("a point is left out"));
    }
}
