#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::winding::solid_angle;
use super::{PointTree, TriangleTree};
use crate::splitmix::Sequence;
use glam::DVec3;
use std::f64::consts::{PI, TAU};

type Mesh = (Vec<DVec3>, Vec<[u32; 3]>);

/// A bumpy sphere of `rings` × 2 `rings` quads, split.
fn bumpy(rings: usize) -> Mesh {
    let around = 2 * rings;
    let mut points = Vec::new();
    for i in 0..=rings {
        for j in 0..around {
            let (u, v) = (PI * i as f64 / rings as f64, TAU * j as f64 / around as f64);
            let radius = 0.4 + 0.08 * (5.0 * u).sin() * u.sin() * (3.0 * v).cos();
            points.push(DVec3::new(u.sin() * v.cos(), u.sin() * v.sin(), u.cos()) * radius);
        }
    }
    let at = |i: usize, j: usize| (i * around + j % around) as u32;
    let mut triangles = Vec::new();
    for i in 0..rings {
        for j in 0..around {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    (points, triangles)
}

/// Triangles without any order, among them doubled, flat and point-like ones.
fn soup(count: usize) -> Mesh {
    let mut dice = Sequence(7);
    let mut points = Vec::new();
    for k in 0..count {
        let at = dice.point(1.0);
        let mut corners = [at, at + dice.point(0.3), at + dice.point(0.3)];
        match k % 10 {
            0 => corners = [at; 3],
            1 => corners[2] = (corners[0] + corners[1]) * 0.5,
            2 => corners[1] = corners[0],
            3 if k > 10 => corners = [points[3 * k - 30], points[3 * k - 29], points[3 * k - 28]],
            _ => {}
        }
        points.extend(corners);
    }
    let triangles = (0..count as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    (points, triangles)
}

/// Distance to a triangle by its plane and its edges; shares nothing with the tree.
fn distance_by_subdivision(q: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let corners = [a, b, c];
    let mut least = f64::INFINITY;
    // The nearest point is a foot in the plane, a foot on an edge, or a corner: try all, keep the feasible ones.
    for k in 0..3 {
        let (p, r) = (corners[k], corners[(k + 1) % 3]);
        let along = r - p;
        let t = if along.length_squared() > 0.0 { (q - p).dot(along) / along.length_squared() } else { 0.0 };
        least = least.min(q.distance(p + along * t.clamp(0.0, 1.0)));
    }
    let normal = (b - a).cross(c - a);
    if normal.length() > 1e-14 {
        let foot = q - normal * ((q - a).dot(normal) / normal.length_squared());
        let inside = (0..3).all(|k| (corners[(k + 1) % 3] - corners[k]).cross(foot - corners[k]).dot(normal) >= 0.0);
        if inside {
            least = least.min(q.distance(foot));
        }
    }
    least
}

#[test]
fn closest_points_are_those_of_a_search_through_all_triangles() {
    for (points, triangles) in [bumpy(20), soup(700)] {
        let tree = TriangleTree::new(&points, &triangles);
        let mut dice = Sequence(1);
        for _ in 0..300 {
            let query = dice.point(1.6);
            let found = tree.closest(query).unwrap();
            let corners = |t: usize| triangles[t].map(|v| points[v as usize]);
            let least = (0..triangles.len()).map(|t| distance_by_subdivision(query, corners(t))).fold(f64::INFINITY, f64::min);
            assert!((found.distance - least).abs() < 1e-12, "{} against {least}", found.distance);
            let [a, b, c] = corners(found.triangle);
            let weights = found.barycentric;
            assert!(weights.iter().all(|w| (-1e-15..=1.0 + 1e-15).contains(w)));
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!((a * weights[0] + b * weights[1] + c * weights[2]).distance(found.point) < 1e-13);
            assert_eq!(tree.closest_within(query, found.distance * 1.001), Some(found));
            assert_eq!(tree.closest_within(query, found.distance * 0.999), None);
        }
    }
}

#[test]
fn of_doubled_triangles_the_first_is_found() {
    let (points, triangles) = bumpy(12);
    let doubled: Vec<_> = triangles.iter().chain(&triangles).copied().collect();
    let (single, double) = (TriangleTree::new(&points, &triangles), TriangleTree::new(&points, &doubled));
    let mut dice = Sequence(2);
    for _ in 0..200 {
        let query = dice.point(1.0);
        assert_eq!(single.closest(query), double.closest(query));
    }
}

#[test]
fn over_edges_and_corners_the_same_triangle_is_nearest_along_other_axes_and_in_another_unit() {
    let (points, triangles) = bumpy(20);
    let here = TriangleTree::new(&points, &triangles);
    let turned = |p: DVec3| DVec3::new(p.y, p.z, p.x);
    let rounded = |p: DVec3| p * 1000.0 / 1000.0;
    let trees =
        [turned, rounded].map(|map| (map, TriangleTree::new(&points.iter().map(|p| map(*p)).collect::<Vec<_>>(), &triangles)));
    let mut dice = Sequence(4);
    let mut shared = 0;
    // Outside, most feet are on edges and corners, which several triangles share.
    for query in (0..2000).map(|_| dice.point(1.0)).chain(points.iter().copied()) {
        let found = here.closest(query).unwrap();
        shared += usize::from(found.barycentric.iter().any(|w| *w < 1e-9));
        for (map, tree) in &trees {
            assert_eq!(tree.closest(map(query)).unwrap().triangle, found.triangle, "{query}");
        }
    }
    assert!(shared > 500, "{shared}");
}

#[test]
fn a_vertex_of_the_surface_is_its_own_closest_point() {
    let (points, triangles) = bumpy(20);
    let tree = TriangleTree::new(&points, &triangles);
    assert!(points.iter().all(|&p| tree.closest(p).unwrap().distance < 1e-16));
}

#[test]
fn rays_hit_what_a_search_through_all_triangles_hits() {
    for (points, triangles) in [bumpy(20), soup(700)] {
        let tree = TriangleTree::new(&points, &triangles);
        let mut dice = Sequence(3);
        let mut total = 0;
        for _ in 0..1000 {
            let (origin, direction) = (dice.point(1.5), dice.point(1.0));
            let mut expected: Vec<(f64, usize)> = (0..triangles.len())
                .filter_map(|t| {
                    // Moeller, Trumbore 1997.
                    let [a, b, c] = triangles[t].map(|v| points[v as usize]);
                    let unit = direction.normalize();
                    let (e1, e2, p) = (b - a, c - a, unit.cross(c - a));
                    let det = e1.dot(p);
                    let s = (origin - a) / det;
                    let (u, q) = (s.dot(p), s.cross(e1));
                    let (v, t0) = (unit.dot(q), e2.dot(q));
                    (det.abs() > 1e-15 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t0 >= 0.0).then_some((t0, t))
                })
                .collect();
            expected.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let found = tree.hits(origin, direction * 17.0);
            assert!(found.windows(2).all(|w| w[0].distance <= w[1].distance));
            let mut ids =
                (found.iter().map(|h| h.triangle).collect::<Vec<_>>(), expected.iter().map(|e| e.1).collect::<Vec<_>>());
            ids.0.sort_unstable();
            ids.1.sort_unstable();
            assert_eq!(ids.0, ids.1);
            assert!(found.iter().zip(&expected).all(|(h, e)| (h.distance - e.0).abs() < 1e-11));
            total += found.len();
        }
        assert!(total > 50, "{total}");
    }
}

#[test]
fn no_ray_slips_through_a_closed_surface() {
    let (points, triangles) = bumpy(16);
    let tree = TriangleTree::new(&points, &triangles);
    for (k, &p) in points.iter().enumerate() {
        // Through vertices and through the middles of edges.
        let q = points[triangles[k % triangles.len()][1] as usize];
        let r = points[triangles[k % triangles.len()][2] as usize];
        for target in [p, (q + r) * 0.5] {
            assert!(!tree.hits(DVec3::new(0.01, 0.02, 0.03), target - DVec3::new(0.01, 0.02, 0.03)).is_empty());
        }
    }
}

#[test]
fn axis_parallel_rays_hit_an_axis_parallel_square() {
    let points = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
    let tree = TriangleTree::new(&points, &[[0, 1, 2], [0, 2, 3]]);
    let hits = tree.hits(DVec3::new(0.25, 0.5, 2.0), DVec3::NEG_Z);
    assert_eq!(hits.len(), 1);
    assert_eq!((hits[0].triangle, hits[0].distance), (1, 2.0));
    assert_eq!(tree.hits(DVec3::new(0.5, 0.5, -3.0), DVec3::Z).len(), 2, "an edge belongs to both");
    assert!(tree.hits(DVec3::new(0.25, 0.5, 2.0), DVec3::Z).is_empty(), "nothing behind the origin");
    assert!(tree.hits(DVec3::new(-1.0, 0.5, 0.0), DVec3::X).is_empty(), "edge-on");
    assert!(tree.hits(DVec3::new(0.25, 0.5, 2.0), DVec3::ZERO).is_empty());
    assert!(tree.hits(DVec3::new(0.25, 0.5, 2.0), DVec3::NAN).is_empty());
}

#[test]
fn winding_numbers_agree_with_the_exact_sum() {
    let (points, triangles) = bumpy(24);
    for open in [false, true] {
        let triangles = if open { &triangles[..triangles.len() * 3 / 4] } else { &triangles[..] };
        let tree = TriangleTree::new(&points, triangles);
        let mut dice = Sequence(4);
        let mut worst = 0.0f64;
        for _ in 0..500 {
            let query = dice.point(1.2);
            let exact = triangles.iter().map(|t| solid_angle(query, &t.map(|v| points[v as usize]))).sum::<f64>() / (4.0 * PI);
            worst = worst.max((tree.winding(query) - exact).abs());
            if !open {
                assert!((exact - exact.round()).abs() < 1e-9);
                assert_eq!(tree.winding(query) > 0.5, exact > 0.5);
            }
        }
        assert!(worst < 0.1, "{worst}");
    }
    let tree = TriangleTree::new(&points, &triangles);
    assert!((tree.winding(DVec3::ZERO) - 1.0).abs() < 0.02);
    assert!(tree.winding(DVec3::splat(5.0)).abs() < 0.01);
}

#[test]
fn empty_and_broken_input_give_empty_answers() {
    let nothing = TriangleTree::new(&[], &[]);
    assert!(nothing.is_empty() && nothing.bounds().is_none());
    assert_eq!(nothing.closest(DVec3::ZERO), None);
    assert!(nothing.hits(DVec3::ZERO, DVec3::X).is_empty());
    assert_eq!(nothing.winding(DVec3::ZERO), 0.0);

    let points = [DVec3::ZERO, DVec3::NAN, DVec3::X, DVec3::Y];
    let tree = TriangleTree::new(&points, &[[0, 1, 2], [0, 2, 3]]);
    assert_eq!(tree.len(), 1);
    assert_eq!(tree.closest(DVec3::Z).unwrap().triangle, 1);
    assert_eq!(tree.closest(DVec3::NAN), None);

    // A thousand times the same point: no split helps.
    let tree = TriangleTree::new(&[DVec3::X], &vec![[0, 0, 0]; 1000]);
    let found = tree.closest(DVec3::ZERO).unwrap();
    assert_eq!((found.triangle, found.point, found.distance), (0, DVec3::X, 1.0));
    assert_eq!(tree.winding(DVec3::ZERO), 0.0);
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    let (points, triangles) = bumpy(100);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| TriangleTree::new(&points, &triangles))
    };
    let (one, four) = (build(1), build(4));
    assert_eq!(one.ids, four.ids);
    let mut dice = Sequence(5);
    for _ in 0..200 {
        let query = dice.point(1.0);
        assert_eq!(one.winding(query).to_bits(), four.winding(query).to_bits());
    }
}

#[test]
fn neighbours_are_those_of_a_search_through_all_points() {
    let mut dice = Sequence(6);
    let mut points: Vec<DVec3> = (0..500).map(|_| dice.point(1.0)).collect();
    // Doubles, and a plane full of equal coordinates.
    points.extend_from_within(..50);
    points.extend((0..200).map(|k| DVec3::new(0.1, 0.01 * f64::from(k % 20), 0.0)));
    let tree = PointTree::new(&points);
    let mut found = Vec::new();
    for _ in 0..200 {
        let query = dice.point(1.2);
        let mut all: Vec<(f64, usize)> = points.iter().enumerate().map(|(k, p)| (p.distance(query), k)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for count in [0, 1, 8, 1000] {
            tree.nearest(query, count, &mut found);
            let found: Vec<(f64, usize)> = found.iter().map(|n| (n.distance, n.point)).collect();
            assert_eq!(found, all[..count.min(all.len())]);
        }
        tree.within(query, 0.3, &mut found);
        let mut near: Vec<usize> = all.iter().filter(|a| a.0 <= 0.3).map(|a| a.1).collect();
        near.sort_unstable();
        assert_eq!(found.iter().map(|n| n.point).collect::<Vec<_>>(), near);
    }
    PointTree::new(&[]).nearest(DVec3::ZERO, 3, &mut found);
    assert!(found.is_empty());
}
