//! Whole builds on small shapes, and the laws that every proxy keeps.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::tetrahedra::{boundary, quality, volume};
use super::*;
use crate::error::{Error, Kind, Result};
use crate::spatial::TriangleTree;
use std::f64::consts::PI;

type Mesh = (Vec<DVec3>, Vec<[u32; 3]>);

const SMALL: BuildOptions = BuildOptions { surface_vertices: 600 };

fn run((points, triangles): &Mesh) -> Built {
    let built = build(points, triangles, &SMALL, &|| Ok(())).unwrap();
    assert_consistent(&built.proxy);
    built
}

/// What the deformer and the surface map rely on.
pub(super) fn assert_consistent(proxy: &Proxy) {
    let mut used = vec![false; proxy.rest.len()];
    proxy.tets.iter().flatten().for_each(|&v| used[v as usize] = true);
    assert!(!used.contains(&false), "a vertex without a tetrahedron");
    assert!(proxy.tets.iter().all(|t| volume(&proxy.rest, *t) > 0.0 && quality(&proxy.rest, *t) >= 1e-3));
    assert_eq!(proxy.boundary.len(), proxy.boundary_tets.len());
    assert_eq!(proxy.components.len(), proxy.tets.len());
    for (face, &tet) in proxy.boundary.iter().zip(&proxy.boundary_tets) {
        let tet = proxy.tets[tet as usize];
        let apex: Vec<u32> = tet.into_iter().filter(|v| !face.contains(v)).collect();
        assert!(apex.len() < 4, "a face without its tetrahedron");
        if let [apex] = apex[..] {
            assert!(volume(&proxy.rest, [apex, face[0], face[1], face[2]]) > 0.0, "a face that looks inwards");
        }
    }
    // The divergence theorem: outward faces enclose what the tetrahedra fill, up to the flat ones left out.
    let enclosed: f64 =
        proxy.boundary.iter().map(|f| f.map(|v| proxy.rest[v as usize])).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
    let filled: f64 = proxy.tets.iter().map(|t| volume(&proxy.rest, *t)).sum();
    assert!((enclosed - filled).abs() < 3e-3 * filled, "{enclosed} {filled}");
    let mut of = vec![None; proxy.rest.len()];
    for (t, &c) in proxy.tets.iter().zip(&proxy.components) {
        for &v in t {
            assert_eq!(*of[v as usize].get_or_insert(c), c, "a vertex in two components");
        }
    }
}

fn filled(proxy: &Proxy) -> f64 {
    proxy.tets.iter().map(|t| volume(&proxy.rest, *t)).sum()
}

fn add(mesh: &mut Mesh, (points, triangles): Mesh) {
    let first = mesh.0.len() as u32;
    mesh.0.extend(points);
    mesh.1.extend(triangles.iter().map(|t| t.map(|v| v + first)));
}

fn ellipsoid(centre: DVec3, radii: DVec3, rings: u32) -> Mesh {
    let around = 2 * rings;
    let mut points = vec![centre + radii * DVec3::Z];
    for i in 1..rings {
        let (s, c) = (PI * f64::from(i) / f64::from(rings)).sin_cos();
        for j in 0..around {
            let (t, u) = (2.0 * PI * f64::from(j) / f64::from(around)).sin_cos();
            points.push(centre + radii * DVec3::new(s * u, s * t, c));
        }
    }
    points.push(centre - radii * DVec3::Z);
    let last = points.len() as u32 - 1;
    let at = |i: u32, j: u32| 1 + (i - 1) * around + j % around;
    let mut triangles = Vec::new();
    for j in 0..around {
        triangles.push([0, at(1, j), at(1, j + 1)]);
        for i in 1..rings - 1 {
            triangles.extend([[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]);
        }
        triangles.push([last, at(rings - 1, j + 1), at(rings - 1, j)]);
    }
    (points, triangles)
}

/// A box of `n` × `n` squares per side, each side with its own vertices.
fn cuboid(lo: DVec3, hi: DVec3, n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for top in [false, true] {
            let (mut points, mut triangles) = Mesh::default();
            for i in 0..=n {
                for j in 0..=n {
                    let mut p = if top { hi } else { lo };
                    p[u] = lo[u] + (hi[u] - lo[u]) * f64::from(i) / f64::from(n);
                    p[v] = lo[v] + (hi[v] - lo[v]) * f64::from(j) / f64::from(n);
                    points.push(p);
                }
            }
            for i in 0..n {
                for j in 0..n {
                    let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| i * (n + 1) + j);
                    triangles.extend(if top { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
                }
            }
            add(&mut mesh, (points, triangles));
        }
    }
    mesh
}

fn sphere(centre: DVec3, radius: f64) -> Mesh {
    ellipsoid(centre, DVec3::splat(radius), 24)
}

#[test]
fn a_sphere_is_filled() {
    let built = run(&sphere(DVec3::ZERO, 0.28));
    let ratio = filled(&built.proxy) / (4.0 / 3.0 * PI * 0.28f64.powi(3));
    assert!((0.97..1.0).contains(&ratio), "{ratio}");
    assert_eq!((built.summary.pieces, built.summary.form, built.summary.body_pieces), (1, Form::Body, 1));
    assert!((600..800).contains(&built.summary.vertices), "{}", built.summary.vertices);
    assert!(built.notes.is_empty());
}

#[test]
fn two_spheres_are_two_pieces_and_the_user_is_told() {
    let mut mesh = sphere(DVec3::X * 0.3, 0.15);
    add(&mut mesh, sphere(DVec3::X * -0.3, 0.15));
    let built = run(&mesh);
    assert_eq!((built.summary.pieces, built.summary.body_pieces), (2, 2));
    assert!(built.notes.iter().next().unwrap().contains("2 pieces"));
    assert_eq!(built.summary.remarks(), "2 pieces");
}

#[test]
fn debris_follows_but_is_not_part_of_the_body() {
    let mut mesh = sphere(DVec3::ZERO, 0.25);
    add(&mut mesh, sphere(DVec3::new(0.4, 0.2, 0.1), 0.01));
    add(&mut mesh, cuboid(DVec3::new(-0.3, -0.1, -0.3), DVec3::new(0.3, 0.1, -0.2999), 4));
    let built = run(&mesh);
    assert_eq!((built.summary.body_pieces, built.summary.loose_pieces, built.summary.pieces), (1, 2, 1));
    assert!(built.proxy.rest.iter().all(|p| p.length() < 0.26));
}

#[test]
fn a_floor_larger_than_the_body_is_no_part_of_it() {
    let mut mesh = sphere(DVec3::ZERO, 0.1);
    add(
        &mut mesh,
        (vec![DVec3::new(-0.35, -0.35, -0.11), DVec3::new(0.35, -0.35, -0.11), DVec3::new(0.0, 0.5, -0.11)], vec![[0, 1, 2]]),
    );
    let built = run(&mesh);
    assert_eq!((built.summary.form, built.summary.body_pieces, built.summary.loose_pieces), (Form::Body, 1, 1));
    assert!(built.proxy.rest.iter().all(|p| p.length() < 0.11));
}

#[test]
fn what_cannot_be_simplified_becomes_cubes() {
    // A checkerboard of cubes: every edge has four triangles, so none may collapse.
    let mut mesh = Mesh::default();
    for i in 0..512u32 {
        let (x, y, z) = (i % 8, i / 8 % 8, i / 64);
        if (x + y + z) % 2 == 0 {
            let lo = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * 0.07 - DVec3::splat(0.28);
            add(&mut mesh, cuboid(lo, lo + DVec3::splat(0.07), 1));
        }
    }
    let built = build(&mesh.0, &mesh.1, &BuildOptions { surface_vertices: 200 }, &|| Ok(())).unwrap();
    assert_consistent(&built.proxy);
    assert_eq!(built.summary.form, Form::Cubes);
    assert!(built.notes.iter().any(|n| n.contains("vertices are left where 200 were wanted")));
    assert!((100..400).contains(&built.summary.vertices), "{}", built.summary.vertices);
}

#[test]
fn a_box_with_a_hole_keeps_its_volume() {
    let mut mesh = cuboid(DVec3::new(-0.2, -0.15, -0.4), DVec3::new(0.2, 0.15, 0.4), 16);
    let cut = |t: &[u32; 3]| t.iter().map(|&v| mesh.0[v as usize]).all(|p| p.z > 0.39 && p.x.abs() < 0.12 && p.y.abs() < 0.1);
    let before = mesh.1.len();
    let open: Vec<[u32; 3]> = mesh.1.iter().filter(|t| !cut(t)).copied().collect();
    assert!(open.len() < before);
    mesh.1 = open;
    let built = run(&mesh);
    let ratio = filled(&built.proxy) / (0.4 * 0.3 * 0.8);
    assert!((0.98..1.001).contains(&ratio), "{ratio}");
}

#[test]
fn flipped_and_rotated_faces_give_the_same_proxy() {
    let mut mesh = ellipsoid(DVec3::ZERO, DVec3::new(0.4, 0.25, 0.15), 24);
    mesh.1.truncate(mesh.1.len() - 7);
    let expected = run(&mesh).proxy;
    for (i, t) in mesh.1.iter_mut().enumerate() {
        t.rotate_left(i % 3);
        if i % 5 < 3 {
            t.swap(0, 2);
        }
    }
    let flipped = run(&mesh).proxy;
    assert_eq!((flipped.rest, flipped.tets, flipped.boundary), (expected.rest, expected.tets, expected.boundary));
}

#[test]
fn a_low_poly_box_gets_vertices_without_changing_its_shape() {
    let built = run(&cuboid(DVec3::splat(-0.2), DVec3::new(0.2, 0.2, 0.5), 1));
    assert!(built.summary.vertices > 400, "{}", built.summary.vertices);
    assert!((filled(&built.proxy) / (0.4 * 0.4 * 0.7) - 1.0).abs() < 1e-3);
}

#[test]
fn fingers_with_air_between_them_stay_apart() {
    // A palm with two fingers, 0.8 % of the diagonal apart.
    let (near, far) = (0.004, 0.104);
    let mut mesh = cuboid(DVec3::new(-0.15, -0.05, -0.45), DVec3::new(0.15, 0.05, -0.1), 12);
    for side in [-1.0, 1.0] {
        let (a, b) = (side * near, side * far);
        add(&mut mesh, cuboid(DVec3::new(f64::min(a, b), -0.04, -0.2), DVec3::new(f64::max(a, b), 0.04, 0.45), 12));
    }
    let built = run(&mesh);
    assert_eq!(built.summary.pieces, 1);
    let finger = |v: u32| {
        let p = built.proxy.rest[v as usize];
        if p.z < 0.0 { 0 } else { p.x.signum() as i32 }
    };
    let joined = built.proxy.tets.iter().filter(|t| t.iter().any(|&v| finger(v) > 0) && t.iter().any(|&v| finger(v) < 0)).count();
    assert_eq!(joined, 0);
}

#[test]
fn an_edge_through_air_is_cut_from_the_width_of_the_gap_on() {
    let mut mesh = cuboid(DVec3::new(-0.3, -0.2, -0.2), DVec3::new(-0.02, 0.2, 0.2), 4);
    add(&mut mesh, cuboid(DVec3::new(0.02, -0.2, -0.2), DVec3::new(0.3, 0.2, 0.2), 4));
    let tree = TriangleTree::new(&mesh.0, &mesh.1);
    let points = [(-0.2, 0.0, 0.0), (-0.1, 0.1, 0.0), (-0.1, 0.0, 0.1), (-0.1, 0.0, 0.0), (0.06, 0.05, 0.05)].map(DVec3::from);
    let across = [[0, 1, 2, 3], [3, 1, 2, 4]];
    // The samples nearest to the middle of the gap, 0.04 wide, are almost 0.02 away from its sides.
    for (gap, cut) in [(0.01, 1), (0.03, 0)] {
        let mut tets = across.to_vec();
        assert_eq!(carve::cut_air_gaps(&points, &mut tets, &tree, gap), cut);
        assert_eq!(tets[..], across[..2 - cut]);
    }
}

#[test]
fn a_sheet_is_coated() {
    let n = 20u32;
    let at = |i: u32, j: u32| {
        DVec3::new(f64::from(i) / 30.0, f64::from(j) / 30.0, (f64::from(i) * 0.3).sin() * 0.05) - DVec3::splat(0.3)
    };
    let points: Vec<DVec3> = (0..=n).flat_map(|i| (0..=n).map(move |j| at(i, j))).collect();
    let corner = |i: u32, j: u32| i * (n + 1) + j;
    let squares = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let triangles: Vec<[u32; 3]> = squares
        .flat_map(|(i, j)| {
            [[corner(i, j), corner(i + 1, j), corner(i + 1, j + 1)], [corner(i, j), corner(i + 1, j + 1), corner(i, j + 1)]]
        })
        .collect();
    let built = run(&(points.clone(), triangles));
    assert_eq!((built.summary.form, built.summary.pieces), (Form::Coat, 1));
    let tree = TriangleTree::new(&built.proxy.rest, &built.proxy.boundary);
    assert!(points.iter().all(|p| tree.winding(*p) > 0.5));
    assert!(built.notes.iter().any(|n| n.contains("no body")));
}

#[test]
fn cubes_fill_a_body_where_tetrahedra_cannot_be_proven() {
    let mesh = sphere(DVec3::ZERO, 0.28);
    let tree = TriangleTree::new(&mesh.0, &mesh.1);
    let (points, tets) = shell::shell(&tree, &mesh.0, &mesh.1, true, 600);
    let (proxy, flat) = carve::finish(&points, tets);
    assert_consistent(&proxy);
    assert_eq!((flat, proxy.components.iter().max()), (0, Some(&0)));
    let skin = TriangleTree::new(&proxy.rest, &proxy.boundary);
    assert!(skin.winding(DVec3::ZERO) > 0.9 && mesh.0.iter().all(|p| skin.winding(*p) > 0.5));
    assert!((400..800).contains(&proxy.rest.len()));
}

#[test]
fn a_flat_tetrahedron_leaves_no_slit_and_its_face_gets_a_neighbour() {
    // A regular-looking one with a flat one on its face: four points of a square between two apices.
    let points =
        [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y, DVec3::new(0.5, 0.5, -0.7), DVec3::new(0.5, 0.5, 0.7)];
    let tets = vec![[0, 2, 1, 4], [0, 3, 2, 4], [0, 1, 2, 3], [0, 1, 3, 5], [1, 2, 3, 5]];
    assert!(tets.iter().all(|t| volume(&points, *t) >= 0.0));
    assert_eq!(boundary(&tets).len(), 8);
    let (proxy, flat) = carve::finish(&points, tets);
    assert_eq!((flat, proxy.tets.len(), proxy.boundary.len()), (1, 4, 8));
    assert_consistent(&proxy);
    // The same without the upper half: the flat one now bounds the body.
    let (proxy, flat) = carve::finish(&points[..5], vec![[0, 2, 1, 4], [0, 3, 2, 4], [0, 1, 2, 3]]);
    assert_eq!((flat, proxy.tets.len(), proxy.boundary.len()), (1, 2, 6));
    for (face, &tet) in proxy.boundary.iter().zip(&proxy.boundary_tets) {
        let shared = face.iter().filter(|v| proxy.tets[tet as usize].contains(v)).count();
        assert!(shared >= 2);
    }
}

#[test]
fn what_cannot_be_built_is_refused() {
    let fails = |mesh: &Mesh, options: &BuildOptions| build(&mesh.0, &mesh.1, options, &|| Ok(())).unwrap_err().kind;
    let ball = sphere(DVec3::ZERO, 0.3);
    assert_eq!(fails(&Mesh::default(), &SMALL), Kind::Refused);
    assert_eq!(fails(&(vec![DVec3::NAN; 3], vec![[0, 1, 2]]), &SMALL), Kind::Refused);
    assert_eq!(fails(&(vec![DVec3::ZERO, DVec3::X], vec![[0, 1, 2]]), &SMALL), Kind::Malformed);
    assert_eq!(fails(&ball, &BuildOptions { surface_vertices: 10 }), Kind::Usage);
    let stopped = build(&ball.0, &ball.1, &SMALL, &|| -> Result<()> { Err(Error::new(Kind::Interrupted, "interrupted")) });
    assert_eq!(stopped.unwrap_err().kind, Kind::Interrupted);
}

#[test]
fn the_words_of_the_decisions_block() {
    let summary = Summary { vertices: 3512, tetrahedra: 1012840, pieces: 1, across_air_gaps: 212, ..Summary::default() };
    assert_eq!(summary.size(), "3,512 vertices, 1,012,840 tetrahedra");
    assert_eq!(summary.remarks(), "one piece · 212 removed across air gaps");
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let mesh = ellipsoid(DVec3::ZERO, DVec3::new(0.4, 0.25, 0.15), 30);
    let with =
        |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| run(&mesh).proxy);
    let (one, three) = (with(1), with(3));
    assert_eq!(
        (one.rest, one.tets, one.boundary, one.boundary_tets),
        (three.rest, three.tets, three.boundary, three.boundary_tets)
    );
}

/// A ring of `degrees` around Z with round ends.
fn open_ring(degrees: f64) -> Mesh {
    let (along, around, radius) = (360u32, 16u32, 0.08);
    let arc = degrees.to_radians() / f64::from(along);
    let place = |i: u32, j: u32| {
        let (s, c) = (arc * f64::from(i)).sin_cos();
        let (t, u) = (2.0 * PI * f64::from(j) / f64::from(around)).sin_cos();
        let from_end = (0.35 * arc * f64::from(i.min(along - i)) / radius).min(1.0);
        let thick = radius * (from_end * (2.0 - from_end)).sqrt();
        DVec3::new((0.35 + thick * u) * c, (0.35 + thick * u) * s, thick * t)
    };
    let points: Vec<DVec3> = (0..=along).flat_map(|i| (0..around).map(move |j| place(i, j))).collect();
    let at = |i: u32, j: u32| i * around + j % around;
    let squares = (0..along).flat_map(|i| (0..around).map(move |j| (i, j)));
    let triangles =
        squares.flat_map(|(i, j)| [[at(i, j), at(i + 1, j + 1), at(i + 1, j)], [at(i, j), at(i, j + 1), at(i + 1, j + 1)]]);
    (points, triangles.collect())
}

#[test]
fn ends_of_one_ring_that_touch_or_overlap_stay_apart() {
    for (degrees, touches) in [(350.0, false), (365.0, true), (368.0, true)] {
        let mesh = open_ring(degrees);
        let built = build(&mesh.0, &mesh.1, &BuildOptions { surface_vertices: 2000 }, &|| Ok(())).unwrap();
        assert_consistent(&built.proxy);
        assert_eq!(built.summary.touching > 0, touches, "{degrees}");
        assert_eq!((built.summary.pieces, built.summary.joined), (1, 0));
        // Cut through where it is whole, the ring falls into two halves unless its ends hold on to each other.
        let rest = &built.proxy.rest;
        let cut = |t: &&[u32; 4]| !t.iter().any(|&v| rest[v as usize].x < -0.2 && rest[v as usize].y > 0.0);
        let halves: Vec<[u32; 4]> = built.proxy.tets.iter().filter(cut).copied().collect();
        let parts = tetrahedra::components_by_vertices(&halves, rest.len());
        assert_eq!(parts.iter().max(), Some(&1), "{degrees}");
    }
}

#[test]
fn a_ground_under_the_feet_is_told() {
    let mut mesh = cuboid(DVec3::new(-0.2, -0.05, -0.4), DVec3::new(-0.1, 0.05, 0.1), 6);
    add(&mut mesh, cuboid(DVec3::new(0.1, -0.05, -0.4), DVec3::new(0.2, 0.05, 0.1), 6));
    add(&mut mesh, cuboid(DVec3::new(-0.2, -0.1, 0.05), DVec3::new(0.2, 0.1, 0.4), 6));
    let told = |mesh: &Mesh| run(mesh).notes.iter().any(|n| n.contains("a flat ground"));
    assert!(!run(&mesh).notes.iter().any(|n| n.contains("ground")));
    add(&mut mesh, cuboid(DVec3::new(-0.4, -0.3, -0.42), DVec3::new(0.4, 0.3, -0.39), 6));
    assert!(told(&mesh), "{:?}", run(&mesh).notes);
}

#[test]
fn a_component_can_be_left_out() {
    let mut mesh = sphere(DVec3::X * 0.3, 0.15);
    add(&mut mesh, sphere(DVec3::X * -0.3, 0.15));
    let whole = run(&mesh).proxy;
    for kept in 0..2 {
        let proxy = whole.with_components(|c| c == kept);
        assert_consistent(&proxy);
        let count = whole.components.iter().filter(|&&c| c == kept).count();
        assert_eq!((proxy.tets.len(), proxy.components.iter().max()), (count, Some(&0)));
        let ratio = filled(&proxy) / filled(&whole);
        assert!((0.49..0.51).contains(&ratio) && proxy.boundary.len() < whole.boundary.len());
        let side = proxy.rest[0].x.signum();
        assert!(proxy.rest.iter().all(|p| p.x * side > 0.1));
    }
}
