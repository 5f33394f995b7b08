//! What must hold for oriented and exact handles, rigid groups and the interpolation of rotations. Shapes are made here.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::bodies::{block, distance, handles, plain, rigid, shapes, targets_of, to_the_end, twisted};
use super::{Options, Volumetric};
use crate::deform::{Deformer, Grip, Handle, OrientedHandle, Placement, Targets};
use crate::error::Kind;
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use glam::{DQuat, DVec3};

const NO_POINTS: Targets = Targets { positions: Vec::new(), presence: Vec::new() };

fn on_vertex(v: u32) -> SparseRow {
    SparseRow { indices: vec![v], values: vec![1.0] }
}

fn vertices(proxy: &Proxy, inside: impl Fn(DVec3) -> bool) -> Vec<u32> {
    (0..).zip(&proxy.rest).filter(|(_, p)| inside(**p)).map(|(v, _)| v).collect()
}

fn oriented(name: &str, rest: DVec3, grip: Grip) -> OrientedHandle {
    OrientedHandle { name: name.into(), rest, grip }
}

/// A straight bar along x and its length.
pub(super) fn bar(cells: u32) -> (Proxy, f64) {
    let proxy = block([cells, 4, 4], 0.0);
    let length = proxy.rest.iter().map(|p| p.x).fold(0.0, f64::max);
    (proxy, length)
}

/// The axis of a bar.
fn middle(proxy: &Proxy, x: f64) -> DVec3 {
    let far = proxy.rest.iter().fold(DVec3::ZERO, |m, p| m.max(*p));
    DVec3::new(x, far.y / 2.0, far.z / 2.0)
}

/// Handles at both ends of a bar, two layers of vertices each.
pub(super) fn ends(proxy: &Proxy, length: f64, grip: impl Fn(Vec<u32>) -> Grip) -> [OrientedHandle; 2] {
    let layer = proxy.rest[1].distance(proxy.rest[0]);
    let near = vertices(proxy, |p| p.x < 1.5 * layer);
    let far = vertices(proxy, |p| p.x > length - 1.5 * layer);
    [oriented("near", middle(proxy, 0.0), grip(near)), oriented("far", middle(proxy, length), grip(far))]
}

fn exact(vertices: Vec<u32>) -> Grip {
    Grip::Exact { vertices }
}

fn hard_region(vertices: Vec<u32>) -> Grip {
    Grip::Region { vertices, beta: 1e6 }
}

/// A frame of four virtual points by one tetrahedron's affine map: exact on affine maps, and outside of the tetrahedron where axes are long.
fn frame_at(proxy: &Proxy, tet: [u32; 4], origin: DVec3, axis: f64, beta: f64) -> Grip {
    let p = tet.map(|v| proxy.rest[v as usize]);
    let inverse = glam::DMat3::from_cols(p[0] - p[3], p[1] - p[3], p[2] - p[3]).inverse();
    let row = |x: DVec3| {
        let c = inverse * (x - p[3]);
        let mut terms: Vec<(u32, f64)> = tet.into_iter().zip([c.x, c.y, c.z, 1.0 - c.x - c.y - c.z]).collect();
        terms.sort_by_key(|t| t.0);
        let (indices, values) = terms.into_iter().unzip();
        SparseRow { indices, values }
    };
    let at = |offset: DVec3| row(origin + offset * axis);
    Grip::Frame { rows: [at(DVec3::ZERO), at(DVec3::X), at(DVec3::Y), at(DVec3::Z)], beta }
}

fn still(handle: &OrientedHandle) -> Placement {
    Placement { position: handle.rest, orientation: DQuat::IDENTITY, presence: 1.0 }
}

fn moved(handle: &OrientedHandle, turn: DQuat, shift: DVec3) -> Placement {
    Placement { position: turn * handle.rest + shift, orientation: turn, presence: 1.0 }
}

/// The far end turned about the axis.
fn twist_of(ends: &[OrientedHandle; 2], angle: f64) -> [Placement; 2] {
    let far = Placement { orientation: DQuat::from_rotation_x(angle), ..still(&ends[1]) };
    [still(&ends[0]), far]
}

/// A pose after each of `frames` equal parts of a twist, in which the bar grows by the part `longer`.
pub(super) fn twist_poses(
    proxy: &Proxy,
    ends: &[OrientedHandle; 2],
    options: &Options,
    (angle, longer, frames): (f64, f64, u32),
) -> Vec<Vec<DVec3>> {
    let mut deformer = Volumetric::with_oriented(proxy, &[], ends, options).unwrap();
    deformer.start(&NO_POINTS).unwrap();
    let mut poses = Vec::new();
    for frame in 1..=frames {
        let part = f64::from(frame) / f64::from(frames);
        let mut placements = twist_of(ends, angle * part);
        placements[1].position.x += longer * part * ends[1].rest.x;
        deformer.place(&placements).unwrap();
        deformer.step(&NO_POINTS).unwrap();
        poses.push(deformer.pose().to_vec());
    }
    poses
}

#[test]
fn handles_that_move_rigidly_carry_the_body_at_once() {
    let (turn, shift) = rigid();
    let (proxy, length) = bar(20);
    let carried: Vec<DVec3> = proxy.rest.iter().map(|p| turn * *p + shift).collect();
    let tet = proxy.tets[proxy.tets.len() / 2];
    let outside = proxy.rest[tet[0] as usize] + DVec3::splat(0.05);
    let frame = oriented("frame", outside, frame_at(&proxy, tet, outside, 0.05, 1.0));
    let lists: [Vec<OrientedHandle>; 4] = [
        ends(&proxy, length, exact).into(),
        ends(&proxy, length, hard_region).into(),
        vec![frame],
        vec![oriented("one end, pivot elsewhere", DVec3::new(3.0, -1.0, 2.0), exact(vertices(&proxy, |p| p.x < 0.1)))],
    ];
    for list in lists {
        for options in [plain(5), Options::default()] {
            let mut deformer = Volumetric::with_oriented(&proxy, &[], &list, &options).unwrap();
            deformer.start(&NO_POINTS).unwrap();
            assert!(distance(deformer.pose(), &proxy.rest) < 1e-11, "rest: {}", list[0].name);
            deformer.place(&list.iter().map(|h| moved(h, turn, shift)).collect::<Vec<_>>()).unwrap();
            let stats = deformer.start(&NO_POINTS).unwrap();
            assert!(distance(deformer.pose(), &carried) < 1e-11, "{}: {}", list[0].name, distance(deformer.pose(), &carried));
            assert!((stats.volume_ratio - 1.0).abs() < 1e-11 && stats.inverted == 0, "{stats:?}");
        }
    }
}

#[test]
fn exact_vertices_are_met_and_hard_points_come_near_them() {
    for proxy in shapes() {
        let points = handles(&proxy, 1e6);
        let places: Vec<u32> = (0..proxy.rest.len() as u32).step_by(7).collect();
        // The same vertices as soft points with a great weight, and eliminated.
        let soft: Vec<Handle> = points.iter().zip(&places).map(|(h, &v)| Handle { row: on_vertex(v), ..h.clone() }).collect();
        let hard: Vec<OrientedHandle> =
            places.iter().map(|&v| oriented("vertex", proxy.rest[v as usize], exact(vec![v]))).collect();
        for options in [plain(10), to_the_end()] {
            let mut by_weight = Volumetric::new(&proxy, &soft, &options).unwrap();
            by_weight.start(&targets_of(&proxy, &soft, |p| p)).unwrap();
            let mut by_elimination = Volumetric::with_oriented(&proxy, &[], &hard, &options).unwrap();
            by_elimination.start(&NO_POINTS).unwrap();
            for angle in [0.2, 0.5, 1.5] {
                let motion = twisted(angle);
                by_weight.step(&targets_of(&proxy, &soft, &motion)).unwrap();
                let at = |h: &OrientedHandle| Placement { position: motion(h.rest), orientation: DQuat::IDENTITY, presence: 1.0 };
                by_elimination.place(&hard.iter().map(at).collect::<Vec<_>>()).unwrap();
                let stats = by_elimination.step(&NO_POINTS).unwrap();
                let energies = by_elimination.energies();
                assert!(stats.converged && energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "{energies:?}");
                for (&v, handle) in places.iter().zip(&hard) {
                    assert!(by_elimination.pose()[v as usize].distance(motion(handle.rest)) < 1e-14);
                }
                assert!(distance(by_weight.pose(), by_elimination.pose()) < 1e-5, "{angle}");
            }
        }
    }
}

#[test]
fn a_jump_of_135_degrees_needs_the_interpolation() {
    let (proxy, length) = bar(20);
    for grip in [exact as fn(Vec<u32>) -> Grip, hard_region] {
        let ends = ends(&proxy, length, grip);
        let angle = 135_f64.to_radians();
        // Without the change of volume, as the three iterations have none.
        let converged = twist_poses(&proxy, &ends, &Options { bulk: 0.0, ..to_the_end() }, (angle, 0.0, 15)).pop().unwrap();
        let error = |interpolate_above: f64| {
            let options = Options { interpolate_above, ..plain(3) };
            distance(&twist_poses(&proxy, &ends, &options, (angle, 0.0, 1))[0], &converged) / length
        };
        let (with, without) = (error(Options::default().interpolate_above), error(f64::INFINITY));
        eprintln!("135° in one jump, 3 iterations: {with:.5} of the length with interpolation, {without:.3} without");
        assert!(with < 0.01 && without > 0.1, "{with} {without}");
    }
}

/// A bar of square section that is twisted further than about 450° snaps into a coil, whoever computes it; twice the length and some tension keep it
/// straight for two turns.
#[test]
fn long_twists_keep_up_in_every_frame() {
    for (cells, degrees, longer, frames) in [(20, 360.0_f64, 0.0, 40), (40, 720.0, 0.1, 60)] {
        let (proxy, length) = bar(cells);
        let ends = ends(&proxy, length, exact);
        let twist = (degrees.to_radians(), longer, frames);
        let converged = twist_poses(&proxy, &ends, &Options { bulk: 0.0, tolerance: 1e-7, ..to_the_end() }, twist);
        let error = |options: Options| {
            let poses = twist_poses(&proxy, &ends, &options, twist);
            poses.iter().zip(&converged).map(|(a, b)| distance(a, b) / length).fold(0.0, f64::max)
        };
        let with = error(Options { interpolate_above: 0.0, ..plain(3) });
        let default = error(Options { bulk: 0.0, ..Options::default() });
        let without = error(Options { interpolate_above: f64::INFINITY, ..plain(3) });
        eprintln!(
            "{degrees}° in {frames} frames, worst of the length: {with:.5} with interpolation and 3 iterations, {without:.3} without; {default:.5} by default"
        );
        assert!(with < 0.01 && default < 0.001 && without > 0.1, "{with} {default} {without}");
    }
}

#[test]
fn the_interpolation_changes_no_minimum() {
    let (proxy, length) = bar(20);
    let ends = ends(&proxy, length, exact);
    let to_the_end = Options { tolerance: 1e-9, ..Options::default() };
    let jump = |interpolate_above: f64| {
        twist_poses(&proxy, &ends, &Options { interpolate_above, ..to_the_end.clone() }, (1.0, 0.0, 1)).pop()
    };
    assert!(distance(&jump(0.0).unwrap(), &jump(f64::INFINITY).unwrap()) < 1e-6);
}

#[test]
fn a_released_grip_stays_and_a_frame_lets_go() {
    let (proxy, length) = bar(20);
    let tet = proxy.tets[3];
    let origin = proxy.rest[tet[0] as usize];
    let far = ends(&proxy, length, exact)[1].clone();
    let list = [oriented("frame", origin, frame_at(&proxy, tet, origin, 0.05, 1.0)), far];
    let mut deformer = Volumetric::with_oriented(&proxy, &[], &list, &to_the_end()).unwrap();
    deformer.start(&NO_POINTS).unwrap();
    let bent = Placement { orientation: DQuat::from_rotation_z(0.5), ..still(&list[1]) };
    deformer.place(&[still(&list[0]), bent]).unwrap();
    deformer.step(&NO_POINTS).unwrap();
    assert!(distance(deformer.pose(), &proxy.rest) > 0.02);
    // Without the frame the body hangs on the exact end alone and is straight again.
    let gone = Placement { presence: 0.0, ..still(&list[0]) };
    deformer.place(&[gone, bent]).unwrap();
    for _ in 0..3 {
        deformer.step(&NO_POINTS).unwrap();
    }
    let pivot = list[1].rest;
    let straight: Vec<DVec3> = proxy.rest.iter().map(|p| bent.orientation * (*p - pivot) + pivot).collect();
    assert!(distance(deformer.pose(), &straight) < 1e-6, "{}", distance(deformer.pose(), &straight));
    deformer.place(&[gone, Placement { presence: 0.0, ..bent }]).unwrap();
    deformer.step(&NO_POINTS).unwrap();
    assert!(distance(deformer.pose(), &straight) < 1e-6, "released, the exact end stays");
}

#[test]
fn grips_and_placements_that_mean_nothing_are_refused() {
    let (proxy, _) = bar(20);
    let at = |grip| oriented("odd", DVec3::ZERO, grip);
    let flat = |v: u32| Grip::Frame { rows: [v, v + 1, v + 2, v + 3].map(on_vertex), beta: 1.0 };
    let cases = [
        (vec![at(exact(vec![]))], "holds no vertex"),
        (vec![at(exact(vec![1, 2, 1]))], "vertex 1 is held twice"),
        (vec![at(exact(vec![1, 2])), at(exact(vec![2]))], "vertex 2 is held twice"),
        (vec![at(hard_region(vec![70_000]))], "70000"),
        (vec![at(flat(0))], "in one plane"),
        (vec![oriented("odd", DVec3::NAN, exact(vec![1]))], "its point"),
    ];
    for (list, words) in cases {
        let error = Volumetric::with_oriented(&proxy, &[], &list, &Options::default()).err().unwrap();
        assert!(error.kind == Kind::Refused && error.found.contains("odd") && error.found.contains(words), "{error}");
    }
    let handle = at(exact(vec![1, 2, 30]));
    let mut deformer = Volumetric::with_oriented(&proxy, &[], std::slice::from_ref(&handle), &Options::default()).unwrap();
    for broken in [
        Placement { position: DVec3::NAN, ..still(&handle) },
        Placement { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..still(&handle) },
        Placement { presence: f64::NAN, ..still(&handle) },
    ] {
        assert!(deformer.place(&[broken]).unwrap_err().found.contains("odd"));
    }
    assert!(deformer.place(&[]).unwrap_err().found.contains("0 placements for 1"));
    deformer.start(&NO_POINTS).unwrap();
    assert!(distance(deformer.pose(), &proxy.rest) < 1e-12, "what is refused changes nothing");
}

#[test]
fn a_body_that_is_given_altogether_is_where_it_is_put() {
    let proxy = block([2, 1, 1], 0.1);
    let (turn, shift) = rigid();
    let handle = oriented("all", DVec3::ZERO, exact((0..proxy.rest.len() as u32).collect()));
    let mut deformer = Volumetric::with_oriented(&proxy, &[], std::slice::from_ref(&handle), &Options::default()).unwrap();
    deformer.start(&NO_POINTS).unwrap();
    deformer.place(&[moved(&handle, turn, shift)]).unwrap();
    let stats = deformer.step(&NO_POINTS).unwrap();
    let carried: Vec<DVec3> = proxy.rest.iter().map(|p| turn * *p + shift).collect();
    assert!(distance(deformer.pose(), &carried) < 1e-12 && stats.converged, "{stats:?}");
}

/// Largest distance of `vertices` from a rigid motion of their rest positions.
fn unrigid(proxy: &Proxy, pose: &[DVec3], vertices: &[u32]) -> f64 {
    let mean = |points: &[DVec3]| vertices.iter().map(|&v| points[v as usize]).sum::<DVec3>() / vertices.len() as f64;
    let (from, to) = (mean(&proxy.rest), mean(pose));
    let mut covariance = glam::DMat3::ZERO;
    for &v in vertices {
        let (a, t) = (proxy.rest[v as usize] - from, pose[v as usize] - to);
        covariance += glam::DMat3::from_cols(t * a.x, t * a.y, t * a.z);
    }
    let turn = crate::linalg::nearest_rotation(covariance, glam::DMat3::IDENTITY);
    let off = |&v: &u32| (turn * (proxy.rest[v as usize] - from) + to).distance(pose[v as usize]);
    vertices.iter().map(off).fold(0.0, f64::max)
}

#[test]
fn a_rigid_group_moves_rigidly_also_in_two_parts() {
    let (proxy, length) = bar(20);
    let ends = ends(&proxy, length, exact);
    let within = |lo: f64, hi: f64| move |p: DVec3| p.x > lo * length - 1e-9 && p.x < hi * length + 1e-9;
    let tets_of = |inside: &dyn Fn(DVec3) -> bool| -> Vec<u32> {
        (0..).zip(&proxy.tets).filter(|(_, t)| t.iter().all(|&v| inside(proxy.rest[v as usize]))).map(|(j, _)| j).collect()
    };
    let third = within(0.35, 0.65);
    let (left, right) = (within(0.2, 0.35), within(0.65, 0.8));
    let both = move |p: DVec3| left(p) || right(p);
    for (name, inside) in [("middle third", &third as &dyn Fn(DVec3) -> bool), ("two parts", &both)] {
        let members = vertices(&proxy, inside);
        let departure = |rigid: Vec<Vec<u32>>| {
            let options = Options { rigid, ..to_the_end() };
            let mut deformer = Volumetric::with_oriented(&proxy, &[], &ends, &options).unwrap();
            deformer.start(&NO_POINTS).unwrap();
            for frame in 1..=6 {
                let angle = 20_f64.to_radians() * f64::from(frame);
                // The end runs along the arc of a bar of unchanged length.
                let arc = length / angle;
                let centre = ends[0].rest + DVec3::Y * arc;
                let end = centre + DVec3::new(angle.sin(), -angle.cos(), 0.0) * arc;
                let far = Placement { position: end, orientation: DQuat::from_rotation_z(angle), presence: 1.0 };
                deformer.place(&[still(&ends[0]), far]).unwrap();
                deformer.step(&NO_POINTS).unwrap();
                let energies = deformer.energies();
                assert!(energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "{name}, {frame}: {energies:?}");
            }
            unrigid(&proxy, deformer.pose(), &members)
        };
        let (soft, rigid) = (departure(Vec::new()), departure(vec![tets_of(inside)]));
        eprintln!("{name}: departure from a rigid motion {soft:.4} free, {rigid:.6} in a group");
        // Two parts that must turn as one while the bar bends between them cannot be as nearly rigid as one part.
        let limit = if name == "two parts" { 0.25 } else { 0.01 };
        assert!(soft > 0.02 && rigid < limit * soft, "{name}: {soft} {rigid}");
    }
}

/// An end that nothing holds, as a hand without markers, turns in its joint: with the damping that its own stiffness asks for, 12 of these frames would
/// not be solved.
#[test]
fn a_free_rigid_end_turns_in_its_joint() {
    let (proxy, length) = bar(60);
    let far = |v: u32, share: f64| proxy.rest[v as usize].x > share * length;
    let held: Vec<Handle> = (0..proxy.rest.len() as u32)
        .step_by(7)
        .filter(|v| !far(*v, 0.2))
        .map(|v| Handle { name: format!("v{v}"), row: on_vertex(v), beta: 1.0 })
        .collect();
    let end: Vec<u32> = (0..).zip(&proxy.tets).filter(|(_, t)| t.iter().all(|&v| far(v, 0.8))).map(|(j, _)| j).collect();
    let mut deformer = Volumetric::new(&proxy, &held, &Options { rigid: vec![end], ..Options::default() }).unwrap();
    let swing = |angle: f64| targets_of(&proxy, &held, move |p| DQuat::from_rotation_y(angle * (1.0 + 2.0 * p.x)) * p);
    deformer.start(&swing(0.0)).unwrap();
    let unsolved = (1..=30).filter(|f| !deformer.step(&swing(0.3 * (0.3 * f64::from(*f)).sin())).unwrap().converged).count();
    assert!(unsolved <= 3, "{unsolved} of 30 frames");
}

#[test]
fn rigid_groups_keep_the_energy_falling_by_plain_iterations_too() {
    for proxy in shapes() {
        let points = handles(&proxy, 1.0);
        let half = proxy.tets.len() as u32 / 2;
        let options = Options { rigid: vec![(0..half / 2).collect(), vec![half, half + 7, half + 20]], ..plain(12) };
        let mut deformer = Volumetric::new(&proxy, &points, &options).unwrap();
        deformer.start(&targets_of(&proxy, &points, |p| p)).unwrap();
        for angle in [0.1, 1.0, -2.0] {
            deformer.step(&targets_of(&proxy, &points, twisted(angle))).unwrap();
            let energies = deformer.energies();
            assert!(energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "{angle}: {energies:?}");
        }
        // The scalar part of the rotation that the first group shares.
        let group = deformer.blocks.groups()[0].start;
        let turn = deformer.rotations[group][0].0[0].abs();
        assert!(turn < 1.0 - 1e-8, "the group turns with the twist: {turn}");
    }
}

#[test]
fn groups_that_overlap_or_leave_the_proxy_are_refused() {
    let (proxy, length) = bar(20);
    let ends = ends(&proxy, length, exact);
    for (rigid, words) in [(vec![vec![1, 2], vec![3, 2]], "tetrahedron 2 is in group 0 too"), (vec![vec![99_999]], "99999")] {
        let error = Volumetric::with_oriented(&proxy, &[], &ends, &Options { rigid, ..Default::default() }).err().unwrap();
        assert!(error.kind == Kind::Refused && error.found.contains(words), "{error}");
    }
}

/// Five plain iterations from rest against an independent implementation in Python (numpy, sparse LU, singular values) on the same body.
#[test]
fn five_iterations_agree_with_another_implementation() {
    let proxy = block([3, 1, 1], 0.1);
    let pivot = DVec3::new(0.1, 0.2, -0.3);
    let near = oriented("near", pivot, exact(vec![0, 4, 8, 12]));
    let rows = [on_vertex(3), SparseRow { indices: vec![10, 15], values: vec![1.25, -0.25] }];
    let points: Vec<Handle> = rows.map(|row| Handle { name: "point".into(), row, beta: 1.0 }).into();
    let options = Options { sliver_cap: f64::INFINITY, interpolate_above: f64::INFINITY, ..plain(5) };
    let mut deformer = Volumetric::with_weights(&proxy, &points, &[0.7, 2.5], std::slice::from_ref(&near), &options).unwrap();
    let mut targets = targets_of(&proxy, &points, |p| p);
    deformer.start(&targets).unwrap();
    targets.positions[0] += DVec3::new(0.1, -0.2, 0.05);
    targets.positions[1] += DVec3::new(0.0, 0.15, 0.2);
    let shift = DVec3::new(0.05, 0.0, 0.1);
    deformer.place(&[Placement { position: pivot + shift, orientation: DQuat::from_rotation_z(0.9), presence: 1.0 }]).unwrap();
    let stats = deformer.step(&targets).unwrap();
    let expected = [
        (1, [0.43175859880107537, 0.029256664148368743, 0.13744832402650906]),
        (3, [0.9929693874041969, -0.15611311398545663, 0.03575100803725821]),
        (6, [0.7165458757129467, 0.2967164479612312, 0.07772489249891937]),
        (10, [0.6614242159382709, 0.08190178213147371, 0.4599189902905318]),
        (15, [1.0312218400048376, 0.2890367649236725, 0.37349660830868675]),
    ];
    for (v, place) in expected {
        let off = deformer.pose()[v].distance(DVec3::from_array(place));
        assert!(off < 1e-12, "vertex {v}: {off}");
    }
    assert!((stats.energy - 0.009774293390124932).abs() < 1e-14, "{}", stats.energy);
}
