#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::bodies::{affine, bar, body};
use super::*;
use crate::splitmix::Sequence;

fn shaken() -> Proxy {
    bar([8, 3, 3], DVec3::new(0.9, 0.3, 0.3), 0.5)
}

#[test]
fn rows_give_the_point_and_follow_affine_maps() {
    let proxy = shaken();
    let posed: Vec<DVec3> = proxy.rest.iter().map(|&p| affine(p)).collect();
    for kind in [MapKind::Ring, MapKind::Paper] {
        let rows = HandleRows::new(&proxy, kind);
        let mut dice = Sequence(1);
        for k in 0..200 {
            let on_surface = proxy.boundary[k % proxy.boundary.len()].map(|v| proxy.rest[v as usize]);
            let point = if k % 2 == 0 { (on_surface[0] + on_surface[1]) * 0.5 } else { dice.point(1.2) };
            let row = rows.row(point);
            assert!(row.indices.windows(2).all(|w| w[0] < w[1]));
            // The paper's coefficients are large far from the body.
            let bound = 1e-14 * (1.0 + row.values.iter().map(|v| v.abs()).sum::<f64>());
            assert!((row.values.iter().sum::<f64>() - 1.0).abs() < bound);
            assert!(row.apply(&proxy.rest).distance(point) < bound);
            assert!(row.apply(&posed).distance(affine(point)) < 2.0 * bound);
        }
    }
}

#[test]
fn a_ring_row_on_the_surface_is_barycentric() {
    let proxy = shaken();
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    let face = proxy.boundary[17];
    let [a, b, c] = face.map(|v| proxy.rest[v as usize]);
    let row = rows.row(a * 0.5 + b * 0.3 + c * 0.2);
    for (v, expected) in face.into_iter().zip([0.5, 0.3, 0.2]) {
        let at = row.indices.iter().position(|&i| i == v).unwrap();
        assert!((row.values[at] - expected).abs() < 1e-12);
    }
    assert!(row.values.iter().map(|v| v.abs()).sum::<f64>() < 1.0 + 1e-12);
}

#[test]
fn ring_rows_hardly_notice_a_sliver() {
    // A bar, and the same with a flat tetrahedron stuck to its top.
    let plain = bar([4, 2, 2], DVec3::new(0.8, 0.4, 0.4), 0.0);
    let top: Vec<u32> = (0..plain.rest.len() as u32).filter(|&v| plain.rest[v as usize].z > 0.19).take(3).collect();
    let (mut rest, mut tets) = (plain.rest.clone(), plain.tets.clone());
    let apex = top.iter().map(|&v| rest[v as usize]).sum::<DVec3>() / 3.0 + DVec3::Z * 1e-9;
    rest.push(apex);
    tets.push([top[0], top[1], top[2], rest.len() as u32 - 1]);
    let rows = HandleRows::new(&body(rest, tets), MapKind::Ring);
    let row = rows.row(apex + DVec3::Z * 0.02);
    assert!(row.values.iter().map(|v| v.abs()).sum::<f64>() < 3.0);
}

/// (2.9)–(2.12) written down once more: Cramer's rule for the coordinates, a loop over all faces.
fn printed_formulas(proxy: &Proxy, point: DVec3) -> Vec<f64> {
    let (lo, hi) = proxy.rest.iter().fold((proxy.rest[0], proxy.rest[0]), |(lo, hi), &p| (lo.min(p), hi.max(p)));
    let centre = |face: &[u32; 3]| face.iter().map(|&v| proxy.rest[v as usize]).sum::<DVec3>() / 3.0;
    let phi = |d: f64, r: f64| if d <= r { (1.0 - d / r).powi(4) * (4.0 * d / r + 1.0) } else { 0.0 };
    let mut r = 0.05 * (hi - lo).length();
    let nearest = proxy.boundary.iter().map(|f| centre(f).distance(point)).fold(f64::INFINITY, f64::min);
    if nearest >= r {
        r = 2.0 * nearest;
    }
    let total: f64 = proxy.boundary.iter().map(|f| phi(centre(f).distance(point), r)).sum();
    let mut row = vec![0.0; proxy.rest.len()];
    for (face, &t) in proxy.boundary.iter().zip(&proxy.boundary_tets) {
        let weight = phi(centre(face).distance(point), r) / total;
        let tet = proxy.tets[t as usize];
        let corners = tet.map(|v| proxy.rest[v as usize]);
        let volume = |[a, b, c, d]: [DVec3; 4]| (b - a).cross(c - a).dot(d - a);
        for k in 0..4 {
            let mut moved = corners;
            moved[k] = point;
            row[tet[k] as usize] += weight * volume(moved) / volume(corners);
        }
    }
    row
}

#[test]
fn paper_rows_are_the_printed_formulas() {
    let proxy = bar([20, 6, 6], DVec3::new(1.0, 0.3, 0.3), 0.4);
    let rows = HandleRows::new(&proxy, MapKind::Paper);
    let mut dice = Sequence(2);
    let (mut grown, mut within) = (0, 0);
    for k in 0..300 {
        let face = proxy.boundary[(37 * k) % proxy.boundary.len()];
        let off = if k % 4 == 0 { 0.5 } else { 0.05 };
        let point = proxy.rest[face[0] as usize] + dice.point(off);
        let row = rows.row(point);
        let expected = printed_formulas(&proxy, point);
        let mut dense = vec![0.0; proxy.rest.len()];
        row.indices.iter().zip(&row.values).for_each(|(&v, &c)| dense[v as usize] = c);
        let size = expected.iter().fold(1.0f64, |m, e| m.max(e.abs()));
        assert!(dense.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-11 * size));
        if rows.closest(point).unwrap().distance > 0.06 { grown += 1 } else { within += 1 }
    }
    assert!(grown > 20 && within > 100, "{grown} {within}");
}

#[test]
fn distances_are_negative_inside() {
    let proxy = bar([4, 2, 2], DVec3::new(0.8, 0.4, 0.4), 0.0);
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    assert!((rows.distance(DVec3::new(0.0, 0.0, 0.15)) + 0.05).abs() < 1e-12);
    assert!((rows.distance(DVec3::new(0.1, 0.05, 0.25)) - 0.05).abs() < 1e-12);
    assert_eq!(HandleRows::new(&Proxy::default(), MapKind::Ring).distance(DVec3::ZERO), f64::INFINITY);
    assert!(HandleRows::new(&Proxy::default(), MapKind::Paper).row(DVec3::ZERO).indices.is_empty());
}

#[test]
fn ring_rows_are_continuous_over_edges_and_corners() {
    let proxy = shaken();
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    let bend = |p: DVec3| affine(p) + DVec3::new(p.y * p.z, p.x * p.x, p.x * p.y) * 2.0;
    let posed: Vec<DVec3> = proxy.rest.iter().map(|&p| bend(p)).collect();
    let mut dice = Sequence(3);
    let mut over = 0;
    for face in &proxy.boundary {
        let [a, b, c] = face.map(|v| proxy.rest[v as usize]);
        let out = (b - a).cross(c - a).normalize();
        for foot in [a, a.lerp(b, 0.3)] {
            // Off a convex edge or corner the foot stays on it, whichever face is nearest.
            let point = foot + out * 0.02;
            let here = rows.row(point).apply(&posed);
            for _ in 0..4 {
                let near = point + dice.point(1e-7);
                assert!(rows.row(near).apply(&posed).distance(here) < 1e-5);
                over += usize::from(rows.closest(near).unwrap().triangle != rows.closest(point).unwrap().triangle);
            }
        }
    }
    assert!(over > 100, "{over}");
}
