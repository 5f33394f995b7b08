#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::*;
use crate::proxy::rows::HandleRows;
use crate::proxy::rows::bodies::{affine, bar, bend};
use crate::splitmix::Sequence;

fn shaken() -> Proxy {
    bar([16, 5, 5], DVec3::new(0.9, 0.3, 0.3), 0.4)
}

/// Points on and near the boundary, and debris up to the corners of the unit box.
fn scattered(proxy: &Proxy, count: usize) -> Vec<DVec3> {
    let mut dice = Sequence(5);
    (0..count)
        .map(|k| {
            let [a, b, c] = proxy.boundary[(k * 31) % proxy.boundary.len()].map(|v| proxy.rest[v as usize]);
            let (u, v) = (dice.unit(), dice.unit());
            let on = a + (b - a) * u + (c - a) * v * (1.0 - u);
            match k % 10 {
                9 => dice.point(1.0),
                8 => on + dice.point(0.1),
                _ => on + dice.point(0.005),
            }
        })
        .collect()
}

fn posed(proxy: &Proxy, map: impl Fn(DVec3) -> DVec3) -> Vec<DVec3> {
    proxy.rest.iter().map(|&p| map(p)).collect()
}

fn apply_one(map: &SurfaceMap, pose: &[DVec3]) -> Vec<[f32; 3]> {
    let mut out = [Vec::new()];
    map.apply(&[pose], &mut out);
    let [out] = out;
    out
}

fn double(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

#[test]
fn rest_stays_rest_and_affine_maps_are_kept() {
    let proxy = shaken();
    let points = scattered(&proxy, 5000);
    for kind in [MapKind::Ring, MapKind::Paper] {
        let map = SurfaceMap::build(&proxy, &points, kind).unwrap();
        let rest = apply_one(&map, &proxy.rest);
        let moved = apply_one(&map, &posed(&proxy, affine));
        let worst = |out: &[[f32; 3]], exact: &dyn Fn(DVec3) -> DVec3| {
            out.iter().zip(&points).map(|(&o, &p)| double(o).distance(exact(p))).fold(0.0, f64::max)
        };
        let (at_rest, at_affine) = (worst(&rest, &|p| p), worst(&moved, &affine));
        assert!(at_rest < 3e-7 && at_affine < 4e-7, "{kind:?} {at_rest:e} {at_affine:e}");
    }
}

#[test]
fn rows_are_what_is_applied() {
    let proxy = shaken();
    let points = scattered(&proxy, 600);
    let pose = posed(&proxy, bend);
    for kind in [MapKind::Ring, MapKind::Paper] {
        let map = SurfaceMap::build(&proxy, &points, kind).unwrap();
        for (v, &out) in apply_one(&map, &pose).iter().enumerate() {
            let row = map.row(v);
            let size: f64 = row.values.iter().map(|c| c.abs()).sum();
            assert!((row.values.iter().sum::<f64>() - 1.0).abs() < 1e-14 * size);
            assert!(row.indices.windows(2).all(|w| w[0] < w[1]));
            assert!(row.apply(&proxy.rest).distance(points[v]) < 1e-7);
            assert!(row.apply(&pose).distance(double(out)) < 1e-6);
        }
    }
}

#[test]
fn what_rows_read_is_known_without_them() {
    let proxy = shaken();
    let points = scattered(&proxy, 600);
    for kind in [MapKind::Ring, MapKind::Paper] {
        let map = SurfaceMap::build(&proxy, &points, kind).unwrap();
        let vertices = [3, 70, 71, 444];
        let mut read = vec![false; proxy.rest.len()];
        vertices.iter().for_each(|&v| map.row(v as usize).indices.iter().for_each(|&i| read[i as usize] = true));
        assert_eq!(map.reads(&vertices), read, "{kind:?}");
        assert!(read.iter().any(|r| !r), "so few rows do not read everything");
    }
}

#[test]
fn the_paper_map_has_the_rows_of_paper_handles() {
    let proxy = shaken();
    let points = scattered(&proxy, 300);
    let map = SurfaceMap::build(&proxy, &points, MapKind::Paper).unwrap();
    let rows = HandleRows::new(&proxy, MapKind::Paper);
    for (v, &p) in points.iter().enumerate() {
        assert_eq!(map.row(v), rows.row(p));
    }
}

#[test]
fn a_frame_has_the_same_bits_in_any_company_and_with_any_number_of_threads() {
    let proxy = shaken();
    let points = scattered(&proxy, 3000);
    let poses: Vec<Vec<DVec3>> =
        (0..8).map(|k| posed(&proxy, |p| bend(p) * (1.0 + 0.01 * f64::from(k)) + DVec3::X * f64::from(k))).collect();
    for kind in [MapKind::Ring, MapKind::Paper] {
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let map = pool(1).install(|| SurfaceMap::build(&proxy, &points, kind).unwrap());
        let again = pool(3).install(|| SurfaceMap::build(&proxy, &points, kind).unwrap());
        let alone: Vec<Vec<[f32; 3]>> = poses.iter().map(|pose| apply_one(&map, pose)).collect();
        for count in 0..=8 {
            let batch: Vec<&[DVec3]> = poses[..count].iter().map(|p| &p[..]).collect();
            for (map, threads) in [(&map, 1), (&again, 3)] {
                let mut out = vec![vec![[9.0; 3]; 5]; count];
                pool(threads).install(|| map.apply(&batch, &mut out));
                assert!(out == alone[..count], "{kind:?} {count} {threads}");
            }
        }
    }
}

#[test]
fn vector_instructions_do_not_change_bits() {
    let Some(avx2) = apply::Avx2::detect() else {
        eprintln!("skipped: no AVX2 here");
        return;
    };
    let proxy = shaken();
    let points = scattered(&proxy, 2000);
    let poses: Vec<Vec<DVec3>> = (0..8).map(|k| posed(&proxy, |p| bend(p) * (1.0 + 0.1 * f64::from(k)))).collect();
    for kind in [MapKind::Ring, MapKind::Paper] {
        let map = SurfaceMap::build(&proxy, &points, kind).unwrap();
        for count in [1, 4, 8] {
            let batch: Vec<&[DVec3]> = poses[..count].iter().map(|p| &p[..]).collect();
            let mut out = [(); 2].map(|()| vec![vec![[0.0; 3]; points.len()]; count]);
            map.apply_with(None, &batch, &mut out[0]);
            map.apply_with(Some(avx2), &batch, &mut out[1]);
            assert!(out[0] == out[1], "{kind:?} {count}");
        }
    }
}

#[test]
fn the_map_is_smooth_across_faces() {
    let proxy = bar([16, 5, 5], DVec3::new(0.9, 0.3, 0.3), 0.0);
    // A line along the top, which crosses many faces.
    let points: Vec<DVec3> = (0..40000).map(|k| DVec3::new(-0.4 + 2e-5 * f64::from(k), 0.013, 0.16)).collect();
    let map = SurfaceMap::build(&proxy, &points, MapKind::Ring).unwrap();
    let out = apply_one(&map, &posed(&proxy, bend));
    let worst = out.windows(2).map(|w| double(w[0]).distance(double(w[1]))).fold(0.0, f64::max);
    assert!(worst < 2.2e-5, "{worst}");
    let off = out.iter().zip(&points).map(|(&o, &p)| double(o).distance(bend(p))).fold(0.0, f64::max);
    assert!(off < 4e-3, "{off}");
}

/// A hairpin: two bars side by side with a narrow gap, joined at one end.
fn hairpin() -> Proxy {
    let whole = bar([20, 5, 3], DVec3::new(0.9, 0.25, 0.15), 0.0);
    // The middle row of cells is the gap, except at the low end of x.
    let in_gap = |tet: &[u32; 4]| {
        let c = tet.iter().map(|&v| whole.rest[v as usize]).sum::<DVec3>() / 4.0;
        c.y.abs() < 0.025 && c.x > -0.35
    };
    let tets = whole.tets.iter().filter(|t| !in_gap(t)).copied().collect();
    let squeezed = whole.rest.iter().map(|p| DVec3::new(p.x, p.y - 0.024 * (p.y / 0.025).clamp(-1.0, 1.0), p.z)).collect();
    crate::proxy::rows::bodies::body(squeezed, tets)
}

#[test]
fn one_leg_of_a_hairpin_does_not_follow_the_other() {
    let proxy = hairpin();
    let x = 0.42;
    let points: Vec<DVec3> = (0..30).map(|k| DVec3::new(x - 0.01 * f64::from(k), 0.001, 0.07)).collect();
    let map = SurfaceMap::build(&proxy, &points, MapKind::Ring).unwrap();
    // The leg at negative y moves away.
    let pose = posed(&proxy, |p| if p.y < 0.0 && p.x > -0.3 { p - DVec3::Y * 0.3 } else { p });
    for (&o, &p) in apply_one(&map, &pose).iter().zip(&points) {
        assert!(double(o).distance(p) < 1e-6, "{p} went to {}", double(o));
    }
}

#[test]
fn a_loose_strip_moves_as_one_and_a_patch_of_skin_does_not() {
    let proxy = shaken();
    let top = |x: f64, z: f64| DVec3::new(x, 0.0, z);
    // Triangles that share places but not indices, as a file with seams has them.
    let strip = |z: f64| -> Vec<DVec3> {
        (0..6).flat_map(|k| [top(0.007 * f64::from(k), z), top(0.007 * f64::from(k + 1), z), DVec3::new(0.0, 0.02, z)]).collect()
    };
    let points: Vec<DVec3> = strip(0.22).into_iter().chain(strip(0.153)).collect();
    let mut faces = Faces::default();
    (0..12).for_each(|k| faces.push([3 * k, 3 * k + 1, 3 * k + 2]));
    let map = SurfaceMap::build_by_pieces(&proxy, &points, &faces, MapKind::Ring).unwrap();
    let single = SurfaceMap::build(&proxy, &points, MapKind::Ring).unwrap();
    let pose = posed(&proxy, bend);
    let (by_pieces, by_vertices) = (apply_one(&map, &pose), apply_one(&single, &pose));
    assert_eq!(by_pieces[18..], by_vertices[18..]);
    // As one: an affine map of the whole strip, so that the middle of two vertices stays the middle.
    let bent = |out: &[[f32; 3]]| {
        (1..5)
            .map(|k| double(out[3 * k]) * 2.0 - double(out[3 * k - 3]) - double(out[3 * k + 3]))
            .map(|d| d.length())
            .sum::<f64>()
    };
    assert!(bent(&by_pieces) < 2e-6, "{}", bent(&by_pieces));
    assert!(bent(&by_vertices) > 1e-4, "{}", bent(&by_vertices));
}

#[test]
fn what_cannot_be_mapped_is_refused() {
    let proxy = shaken();
    let kinds = [MapKind::Ring, MapKind::Paper];
    assert!(kinds.iter().all(|&k| SurfaceMap::build(&Proxy::default(), &[DVec3::ZERO], k).is_err()));
    let error = SurfaceMap::build(&proxy, &[DVec3::ZERO, DVec3::NAN], MapKind::Ring).unwrap_err();
    assert_eq!(error.place.as_deref(), Some("vertex 2"));
    assert!(kinds.iter().all(|&k| SurfaceMap::build(&proxy, &[], k).unwrap().is_empty()));
}

#[test]
fn a_single_tetrahedron_is_a_body() {
    let rest = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let proxy = crate::proxy::rows::bodies::body(rest, vec![[0, 1, 2, 3]]);
    let points = [DVec3::ZERO, DVec3::splat(0.3), DVec3::new(0.1, 0.1, -0.2)];
    let map = SurfaceMap::build(&proxy, &points, MapKind::Ring).unwrap();
    for (&o, p) in apply_one(&map, &posed(&proxy, affine)).iter().zip(points) {
        assert!(double(o).distance(affine(p)) < 5e-7);
    }
}

#[test]
fn skin_follows_its_own_part_where_parts_overlap() {
    use crate::scan::Faces;
    // A spring of one and a quarter turns, so tight that its ends run a fifth of their width inside each other.
    let (rings, sides, turns, pitch) = (240, 32, 1.25, 0.4);
    let point = |turn: f64, angle: f64| {
        let (s, c) = (turn * std::f64::consts::TAU).sin_cos();
        let radius = 1.0 + 0.25 * angle.cos();
        DVec3::new(radius * c, radius * s, pitch * turn + 0.25 * angle.sin()) / 3.0
    };
    let (mut points, mut at_turn, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..=rings {
        let turn = turns * f64::from(i) / f64::from(rings);
        for k in 0..sides {
            points.push(point(turn, f64::from(k) / f64::from(sides) * std::f64::consts::TAU));
            at_turn.push(turn);
        }
    }
    let at = |i: i32, k: i32| (i * sides + k % sides) as u32;
    for i in 0..rings {
        for k in 0..sides {
            triangles.extend([[at(i, k), at(i + 1, k), at(i + 1, k + 1)], [at(i, k), at(i + 1, k + 1), at(i, k + 1)]]);
        }
    }
    for k in 1..sides - 1 {
        triangles.extend([[at(0, 0), at(0, k), at(0, k + 1)], [at(rings, 0), at(rings, k + 1), at(rings, k)]]);
    }
    let options = crate::proxy::BuildOptions { surface_vertices: 1500 };
    let built = crate::proxy::build(&points, &triangles, &options, &|| Ok(())).unwrap();
    assert!(built.summary.touching > 20, "{}", built.summary.touching);
    let mut faces = Faces::default();
    triangles.iter().for_each(|t| faces.push(*t));
    // The part of a vertex of the proxy, where the skin tells it.
    let part = |p: DVec3| {
        let nearest = |select: &dyn Fn(f64) -> bool| {
            let all = points.iter().zip(&at_turn).filter(|(_, turn)| select(**turn)).map(|(q, turn)| (q.distance(p), *turn));
            all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0.0))
        };
        let (distance, turn) = nearest(&|_| true);
        let other = nearest(&|t| (t - turn).abs() > 0.5).0;
        (distance < 0.01 && other > distance + 0.004).then_some(turn)
    };
    let strayed = |map: &SurfaceMap| {
        let proxy = &built.proxy;
        let parts: Vec<Option<f64>> = proxy.rest.iter().map(|p| part(*p)).collect();
        let far = |v: usize| {
            let row = map.row(v);
            let foreign = row.indices.iter().zip(&row.values);
            let foreign = foreign.filter(|(w, _)| parts[**w as usize].is_some_and(|turn| (turn - at_turn[v]).abs() > 0.5));
            foreign.map(|(_, c)| c.abs()).sum::<f64>() > 0.05
        };
        (0..points.len()).filter(|&v| far(v)).count()
    };
    let with = strayed(&SurfaceMap::build_by_pieces(&built.proxy, &points, &faces, MapKind::Ring).unwrap());
    let without = strayed(&SurfaceMap::build(&built.proxy, &points, MapKind::Ring).unwrap());
    eprintln!("{without} vertices on another part, {with} with the faces of the skin");
    assert!(with == 0 && without > 0, "{with} with, {without} without the skin's faces");
}
