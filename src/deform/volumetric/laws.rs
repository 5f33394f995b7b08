//! What must hold for any body: invariances, descent of the energy, release of handles, recovery. Shapes are made here.
#![allow(clippy::unwrap_used)]

use super::{Options, Volumetric};
use crate::deform::{Deformer, Handle, Targets};
use crate::error::Kind;
use crate::linalg::SparseRow;
use crate::linalg::lanes::Lanes;
use crate::proxy::Proxy;
use glam::{DMat3, DQuat, DVec3};

/// A block of `cells` cubes, each cut into six tetrahedra round its diagonal, bent a little by `wobble` so that no two are alike.
pub(super) fn block(cells: [u32; 3], wobble: f64) -> Proxy {
    let [nx, ny, nz] = cells;
    let id = |x: u32, y: u32, z: u32| (z * (ny + 1) + y) * (nx + 1) + x;
    let mut proxy = Proxy::default();
    for (z, y, x) in grid([nx + 1, ny + 1, nz + 1]) {
        let p = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let shift = DVec3::new((3.1 * p.y + p.z).sin(), (2.3 * p.x - p.z).cos(), (1.7 * p.x + 2.9 * p.y).sin());
        proxy.rest.push(p + shift * wobble);
    }
    for (z, y, x) in grid(cells) {
        for path in [[1, 2, 4], [1, 4, 2], [2, 1, 4], [2, 4, 1], [4, 1, 2], [4, 2, 1]] {
            let corner = |bits: u32| id(x + (bits & 1), y + (bits >> 1 & 1), z + (bits >> 2));
            let mut tet = [corner(0), corner(path[0]), corner(path[0] | path[1]), corner(7)];
            let [a, b, c, d] = tet.map(|v| proxy.rest[v as usize]);
            if (b - a).cross(c - a).dot(d - a) < 0.0 {
                tet.swap(1, 2);
            }
            proxy.tets.push(tet);
        }
    }
    let scale = 1.0 / DVec3::new(f64::from(nx), f64::from(ny), f64::from(nz)).length();
    proxy.rest.iter_mut().for_each(|p| *p *= scale);
    proxy
}

fn grid([nx, ny, nz]: [u32; 3]) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| (z, y, x))))
}

/// A bar, a plate and a lump.
pub(super) fn shapes() -> [Proxy; 3] {
    [block([10, 2, 2], 0.1), block([6, 6, 1], 0.15), block([4, 4, 4], 0.2)]
}

pub(super) fn on_vertex(v: usize, beta: f64) -> Handle {
    Handle { name: format!("v{v}"), row: SparseRow { indices: vec![v as u32], values: vec![1.0] }, beta }
}

/// Handles on every seventh vertex, every third of them between two vertices.
pub(super) fn handles(proxy: &Proxy, beta: f64) -> Vec<Handle> {
    (0..proxy.rest.len())
        .step_by(7)
        .map(|v| {
            let mut handle = on_vertex(v, beta);
            if v % 3 == 0 && v + 1 < proxy.rest.len() {
                handle.row = SparseRow { indices: vec![v as u32, v as u32 + 1], values: vec![1.25, -0.25] };
            }
            handle
        })
        .collect()
}

pub(super) fn targets_of(proxy: &Proxy, handles: &[Handle], motion: impl Fn(DVec3) -> DVec3) -> Targets {
    let positions: Vec<DVec3> = handles.iter().map(|h| motion(h.row.apply(&proxy.rest))).collect();
    Targets { presence: vec![1.0; positions.len()], positions }
}

/// Twist about x by `angle` from end to end, with a bend.
pub(super) fn twisted(angle: f64) -> impl Fn(DVec3) -> DVec3 {
    move |p| DQuat::from_rotation_x(angle * p.x) * p + DVec3::Z * (0.3 * angle * p.x * p.x)
}

pub(super) fn rigid() -> (DQuat, DVec3) {
    (DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.0), DVec3::new(0.7, -0.3, 2.0))
}

pub(super) fn plain(iterations: u32) -> Options {
    Options { iterations: Some(iterations), ..Default::default() }
}

pub(super) fn to_the_end() -> Options {
    Options { tolerance: 1e-10, ..Default::default() }
}

pub(super) fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).fold(0.0, |m, (a, b)| if a.distance(*b) <= m { m } else { a.distance(*b) })
}

/// Poses of a growing twist, started at rest.
fn twist(proxy: &Proxy, handles: &[Handle], options: &Options, frames: u32, around: impl Fn(DVec3) -> DVec3) -> Volumetric {
    let mut deformer = Volumetric::new(proxy, handles, options).unwrap();
    deformer.start(&targets_of(proxy, handles, |p| p)).unwrap();
    for frame in 1..=frames {
        let motion = twisted(0.25 * f64::from(frame));
        deformer.step(&targets_of(proxy, handles, |p| around(motion(p)))).unwrap();
    }
    deformer
}

#[test]
fn targets_at_rest_give_the_rest_pose() {
    for proxy in shapes() {
        for options in [plain(5), Options::default()] {
            let handles = handles(&proxy, 1.0);
            let mut deformer = Volumetric::new(&proxy, &handles, &options).unwrap();
            let targets = targets_of(&proxy, &handles, |p| p);
            let stats = deformer.start(&targets).unwrap();
            assert!(distance(deformer.pose(), &proxy.rest) < 1e-12);
            assert!(stats.inverted == 0 && (stats.volume_ratio - 1.0).abs() < 1e-12 && stats.converged && stats.energy < 1e-24);
            deformer.step(&targets).unwrap();
            deformer.step(&targets).unwrap();
            assert!(distance(deformer.pose(), &proxy.rest) < 1e-12);
        }
    }
}

#[test]
fn rigidly_moved_targets_give_the_moved_rest_pose_at_once() {
    let (q, t) = rigid();
    for proxy in shapes() {
        let moved: Vec<DVec3> = proxy.rest.iter().map(|p| q * *p + t).collect();
        for options in [plain(5), Options::default()] {
            let handles = handles(&proxy, 1.0);
            let mut deformer = Volumetric::new(&proxy, &handles, &options).unwrap();
            let stats = deformer.start(&targets_of(&proxy, &handles, |p| q * p + t)).unwrap();
            assert!(distance(deformer.pose(), &moved) < 1e-12);
            assert!(options.iterations.is_some() || stats.passes <= 4, "{stats:?}");
        }
    }
}

#[test]
fn a_rigid_motion_is_followed_from_the_rest_pose() {
    let (q, t) = rigid();
    for proxy in shapes() {
        let moved: Vec<DVec3> = proxy.rest.iter().map(|p| q * *p + t).collect();
        let handles = handles(&proxy, 1.0);
        let mut deformer = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
        deformer.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
        deformer.step(&targets_of(&proxy, &handles, |p| q * p + t)).unwrap();
        assert!(distance(deformer.pose(), &moved) < 1e-8);
    }
}

#[test]
fn a_turned_world_gives_a_turned_pose() {
    let (q, _) = rigid();
    for mut proxy in shapes() {
        let handles = handles(&proxy, 1.0);
        let straight = twist(&proxy, &handles, &plain(4), 3, |p| p);
        let expected: Vec<DVec3> = straight.pose().iter().map(|p| q * *p).collect();
        proxy.rest.iter_mut().for_each(|p| *p = q * *p);
        let back = q.inverse();
        let mut turned = Volumetric::new(&proxy, &handles, &plain(4)).unwrap();
        turned.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
        for frame in 1..=3 {
            let motion = twisted(0.25 * f64::from(frame));
            turned.step(&targets_of(&proxy, &handles, |p| q * motion(back * p))).unwrap();
        }
        assert!(distance(turned.pose(), &expected) < 1e-11);
    }
}

#[test]
fn a_scaled_and_a_mirrored_world_give_the_scaled_and_mirrored_pose() {
    for map in [DMat3::from_diagonal(DVec3::splat(1000.0)), DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))] {
        for mut proxy in shapes() {
            let handles = handles(&proxy, 1.0);
            let expected: Vec<DVec3> = twist(&proxy, &handles, &plain(4), 3, |p| p).pose().iter().map(|p| map * *p).collect();
            proxy.rest.iter_mut().for_each(|p| *p = map * *p);
            if map.determinant() < 0.0 {
                proxy.tets.iter_mut().for_each(|t| t.swap(1, 2));
            }
            let back = map.inverse();
            let mut mapped = Volumetric::new(&proxy, &handles, &plain(4)).unwrap();
            mapped.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
            for frame in 1..=3 {
                let motion = twisted(0.25 * f64::from(frame));
                mapped.step(&targets_of(&proxy, &handles, |p| map * motion(back * p))).unwrap();
            }
            let size = map.x_axis.length();
            assert!(distance(mapped.pose(), &expected) < 1e-11 * size);
        }
    }
}

#[test]
fn the_order_of_vertices_and_tetrahedra_does_not_matter() {
    for proxy in shapes() {
        let handles = handles(&proxy, 1.0);
        let straight = twist(&proxy, &handles, &plain(4), 3, |p| p);
        let count = proxy.rest.len();
        let place = |v: u32| (count as u32 - 1 - v + 5) % count as u32;
        let mut shuffled = Proxy { rest: vec![DVec3::ZERO; count], ..Default::default() };
        for (v, p) in proxy.rest.iter().enumerate() {
            shuffled.rest[place(v as u32) as usize] = *p;
        }
        shuffled.tets = proxy.tets.iter().rev().map(|t| [t[1], t[2], t[0], t[3]].map(place)).collect();
        let moved: Vec<Handle> = handles
            .iter()
            .map(|h| {
                let mut terms: Vec<(u32, f64)> = h.row.indices.iter().map(|&v| place(v)).zip(h.row.values.clone()).collect();
                terms.sort_by_key(|t| t.0);
                let (indices, values) = terms.into_iter().unzip();
                Handle { row: SparseRow { indices, values }, ..h.clone() }
            })
            .collect();
        let other = twist(&shuffled, &moved, &plain(4), 3, |p| p);
        let back: Vec<DVec3> = (0..count as u32).map(|v| other.pose()[place(v) as usize]).collect();
        assert!(distance(straight.pose(), &back) < 1e-11);
    }
}

#[test]
fn the_energy_never_rises() {
    for proxy in shapes() {
        for (options, beta) in [(plain(12), 1.0), (Options::default(), 1.0), (to_the_end(), 100.0)] {
            let handles = handles(&proxy, beta);
            let mut deformer = Volumetric::new(&proxy, &handles, &options).unwrap();
            deformer.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
            for angle in [0.1, 0.3, 3.0, -2.0, -2.1] {
                let stats = deformer.step(&targets_of(&proxy, &handles, twisted(angle))).unwrap();
                let energies = deformer.energies();
                assert!(energies.len() > 1 && energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "{angle}: {energies:?}");
                assert_eq!(energies.last(), Some(&stats.energy));
            }
        }
    }
}

#[test]
fn accelerated_and_plain_frames_have_the_same_minimum() {
    let proxy = block([5, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let fast = twist(&proxy, &handles, &Options { bulk: 0.0, ..to_the_end() }, 3, |p| p);
    let slow = twist(&proxy, &handles, &plain(600), 3, |p| p);
    assert!(distance(fast.pose(), slow.pose()) < 1e-7);
    assert!((fast.last.energy / slow.last.energy - 1.0).abs() < 1e-9);
    assert!(fast.last.energy > 1e-6, "the twist costs energy");
}

#[test]
fn the_laplacian_kills_constants() {
    for proxy in shapes() {
        let elements = super::elements::elements(&proxy, &Options::default()).unwrap();
        let matrix = super::matrix(&vec![false; proxy.rest.len()], &elements, &[], &[]);
        let (mut sums, mut largest) = (vec![0.0; proxy.rest.len()], 0.0_f64);
        for column in 0..proxy.rest.len() {
            for k in matrix.starts[column] as usize..matrix.starts[column + 1] as usize {
                let (row, value) = (matrix.rows[k] as usize, matrix.values[k]);
                sums[row] += value;
                sums[column] += if row == column { 0.0 } else { value };
                largest = largest.max(value);
            }
        }
        assert!(largest > 0.0 && sums.iter().all(|s| s.abs() < 1e-13 * largest), "{sums:?}");
    }
}

#[test]
fn a_cut_in_the_take_is_solved_as_a_start() {
    for proxy in shapes() {
        let handles = handles(&proxy, 1.0);
        let there = |p: DVec3| DQuat::from_rotation_z(2.5) * twisted(0.3)(p) + DVec3::new(3.0, -2.0, 1.0);
        let mut cut = twist(&proxy, &handles, &to_the_end(), 3, |p| p);
        let stats = cut.step(&targets_of(&proxy, &handles, there)).unwrap();
        let mut straight = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
        assert_eq!(straight.start(&targets_of(&proxy, &handles, there)).unwrap(), stats);
        assert_eq!(straight.pose(), cut.pose());
    }
}

#[test]
fn bulk_keeps_the_volume_of_a_squeezed_body() {
    for proxy in shapes() {
        let handles = handles(&proxy, 1.0);
        let squeezed = |bulk: f64| {
            let mut deformer = Volumetric::new(&proxy, &handles, &Options { bulk, ..to_the_end() }).unwrap();
            let targets = targets_of(&proxy, &handles, |p| p * DVec3::new(0.8, 1.0, 1.0));
            deformer.start(&targets).unwrap().volume_ratio
        };
        let (free, kept, hard) = (squeezed(0.0), squeezed(0.8), squeezed(3.0));
        assert!(free < kept && kept < hard && hard < 1.0, "{free} {kept} {hard}");
    }
}

#[test]
fn a_second_run_has_the_same_bits() {
    let proxy = block([8, 3, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let run = || {
        let mut deformer = twist(&proxy, &handles, &Options::default(), 4, |p| p);
        let mut targets = targets_of(&proxy, &handles, twisted(1.1));
        targets.presence[2] = 0.3;
        targets.presence[4] = 0.0;
        let stats = deformer.step(&targets).unwrap();
        (deformer.pose().iter().flat_map(|p| p.to_array().map(f64::to_bits)).collect::<Vec<_>>(), stats)
    };
    assert_eq!(run(), run());
}

#[test]
fn a_start_forgets_what_was_before() {
    let proxy = block([6, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let targets = targets_of(&proxy, &handles, twisted(0.4));
    let mut used = twist(&proxy, &handles, &Options::default(), 4, |p| p);
    let mut fresh = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
    assert_eq!(used.start(&targets).unwrap(), fresh.start(&targets).unwrap());
    assert_eq!(used.pose(), fresh.pose());
}

/// Numbers in −1..1 from a fixed linear congruence.
pub(super) fn noise() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

#[test]
fn random_rotations_and_positions_find_back() {
    for proxy in [block([4, 2, 2], 0.1), block([3, 3, 3], 0.1)] {
        let handles = handles(&proxy, 1.0);
        let rest = targets_of(&proxy, &handles, |p| p);
        let mut deformer = Volumetric::new(&proxy, &handles, &plain(120)).unwrap();
        deformer.start(&rest).unwrap();
        let mut random = noise();
        for q in &mut deformer.rotations {
            for lane in 0..4 {
                let any = DQuat::from_xyzw(random(), random(), random(), random()).normalize();
                crate::linalg::rotation::set_lane(q, lane, any);
            }
        }
        deformer.step(&rest).unwrap();
        assert!(distance(deformer.pose(), &proxy.rest) < 5e-3);
        for p in &mut deformer.p {
            *p += Lanes::point(DVec3::new(random(), random(), random()) * 0.15);
        }
        deformer.blocks.extract(&deformer.p, &mut deformer.rotations);
        deformer.step(&rest).unwrap();
        assert!(distance(deformer.pose(), &proxy.rest) < 5e-3);
    }
}

#[test]
fn a_released_handle_is_as_if_it_had_never_been() {
    for (beta, limit) in [(1.0, 1e-8), (100.0, 1e-7)] {
        for proxy in shapes() {
            let all = handles(&proxy, beta);
            for keep in [1, 3, all.len() - 1] {
                let some: Vec<Handle> = all[..keep].to_vec();
                let mut fresh = Volumetric::new(&proxy, &some, &to_the_end()).unwrap();
                fresh.start(&targets_of(&proxy, &some, twisted(0.5))).unwrap();
                let mut switched = Volumetric::new(&proxy, &all, &to_the_end()).unwrap();
                let mut targets = targets_of(&proxy, &all, twisted(0.5));
                targets.presence[keep..].fill(0.0);
                let stats = switched.start(&targets).unwrap();
                let apart = distance(fresh.pose(), switched.pose());
                assert!(apart < limit, "{keep} of {} at {beta}: {apart}, {stats:?}", all.len());
            }
        }
    }
}

#[test]
fn a_fading_handle_has_part_of_its_weight() {
    let proxy = block([6, 2, 2], 0.1);
    let full = handles(&proxy, 1.0);
    let mut targets = targets_of(&proxy, &full, twisted(0.8));
    let mut faded = Volumetric::new(&proxy, &full, &to_the_end()).unwrap();
    faded.start(&targets).unwrap();
    targets.presence[1] = 0.4;
    targets.presence[3] = 0.1;
    faded.step(&targets).unwrap();
    let mut weaker = full.clone();
    weaker[1].beta = 0.4;
    weaker[3].beta = 0.1;
    targets.presence.fill(1.0);
    let mut fresh = Volumetric::new(&proxy, &weaker, &to_the_end()).unwrap();
    fresh.start(&targets).unwrap();
    assert!(distance(faded.pose(), fresh.pose()) < 1e-8);
    faded.step(&targets).unwrap();
    let mut whole = Volumetric::new(&proxy, &full, &to_the_end()).unwrap();
    whole.start(&targets).unwrap();
    assert!(distance(faded.pose(), whole.pose()) < 1e-8, "a handle that returns has its whole weight again");
}

#[test]
fn the_residual_falls_with_the_hardness() {
    let proxy = block([6, 2, 2], 0.1);
    let residual = |beta: f64| {
        let handles = handles(&proxy, beta);
        let targets = targets_of(&proxy, &handles, twisted(0.8));
        let mut deformer = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
        deformer.start(&targets).unwrap();
        handles.iter().zip(&targets.positions).fold(0.0_f64, |m, (h, t)| m.max(h.row.apply(deformer.pose()).distance(*t)))
    };
    // A spring against a spring: the inverse of the residual is linear in the hardness.
    let (soft, hard, harder) = (residual(10.0), residual(100.0), residual(1000.0));
    let slopes = [(1.0 / hard - 1.0 / soft) / 90.0, (1.0 / harder - 1.0 / hard) / 900.0];
    assert!((slopes[0] / slopes[1] - 1.0).abs() < 0.01, "{soft} {hard} {harder}");
    assert!((hard / harder - 10.0).abs() < 0.2, "{hard} {harder}");
}

#[test]
fn stiff_tetrahedra_stay_nearly_rigid() {
    let proxy = block([9, 2, 2], 0.0);
    let handles = handles(&proxy, 1.0);
    let middle = |t: &[u32; 4]| t.iter().all(|&v| (0.35..0.65).contains(&proxy.rest[v as usize].x));
    let stretch = |factor: f64| {
        let stiffness = proxy.tets.iter().map(|t| if middle(t) { factor } else { 1.0 }).collect();
        let options = Options { stiffness, ..to_the_end() };
        let deformer = twist(&proxy, &handles, &options, 4, |p| p);
        let edge = |pose: &[DVec3], t: &[u32; 4]| pose[t[0] as usize].distance(pose[t[3] as usize]);
        let strained = proxy.tets.iter().filter(|t| middle(t));
        strained.map(|t| (edge(deformer.pose(), t) / edge(&proxy.rest, t) - 1.0).abs()).fold(0.0, f64::max)
    };
    let (soft, stiff) = (stretch(1.0), stretch(100.0));
    assert!(stiff < 0.1 * soft && soft > 1e-3, "{soft} {stiff}");
}

#[test]
fn without_a_present_handle_the_pose_is_held() {
    let proxy = block([6, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let mut deformer = twist(&proxy, &handles, &to_the_end(), 2, |p| p);
    let pose = deformer.pose().to_vec();
    let mut targets = targets_of(&proxy, &handles, twisted(0.75));
    targets.presence.fill(0.0);
    let stats = deformer.step(&targets).unwrap();
    assert_eq!(deformer.pose(), pose);
    assert!(stats.passes == 0 && stats.converged);
    targets.presence.fill(1.0);
    targets.positions.fill(DVec3::NAN);
    assert_eq!(deformer.step(&targets).unwrap_err().kind, Kind::Refused);
    assert_eq!(deformer.pose(), pose, "a frame that is refused leaves everything as it was");
    deformer.step(&targets_of(&proxy, &handles, twisted(0.75))).unwrap();
    let straight = twist(&proxy, &handles, &to_the_end(), 3, |p| p);
    assert!(distance(deformer.pose(), straight.pose()) < 1e-7);
}

/// Two blocks that do not touch.
fn pair() -> Proxy {
    let mut proxy = block([3, 2, 2], 0.1);
    let count = proxy.rest.len() as u32;
    let second: Vec<DVec3> = proxy.rest.iter().map(|p| *p + DVec3::Y * 2.0).collect();
    let tets: Vec<[u32; 4]> = proxy.tets.iter().map(|t| t.map(|v| v + count)).collect();
    proxy.rest.extend(second);
    proxy.tets.extend(tets);
    proxy
}

#[test]
fn a_component_that_loses_its_handles_is_held_where_it_was() {
    let proxy = pair();
    let second = proxy.rest.len() / 2;
    let handles: Vec<Handle> = [0, 3, 20, second, second + 3, second + 20].map(|v| on_vertex(v, 1.0)).into();
    let mut deformer = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
    let mut targets = targets_of(&proxy, &handles, |p| p);
    deformer.start(&targets).unwrap();
    let weight_ratio = deformer.handles.weight(3) / deformer.handles.weight(0);
    targets.presence[3..].fill(0.0);
    let shift = DVec3::Z * 0.2;
    targets.positions.iter_mut().for_each(|p| *p += shift);
    let stats = deformer.step(&targets).unwrap();
    assert!(stats.converged && !stats.recovered);
    assert_eq!(deformer.handles.weight(3) / deformer.handles.weight(0), 0.01 * weight_ratio);
    let (first, other) = (&deformer.pose()[..second], &deformer.pose()[second..]);
    assert!(first.iter().zip(&proxy.rest).all(|(a, b)| (*a - *b).distance(shift) < 1e-5));
    assert!(distance(other, &proxy.rest[second..]) < 1e-6);
}

#[test]
fn a_component_that_never_had_a_target_comes_with_the_others() {
    let (q, t) = rigid();
    let proxy = pair();
    let second = proxy.rest.len() / 2;
    let handles: Vec<Handle> = [0, 3, 20, second, second + 3, second + 20].map(|v| on_vertex(v, 1.0)).into();
    let mut deformer = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
    let mut targets = targets_of(&proxy, &handles, |p| q * p + t);
    targets.presence[3..].fill(0.0);
    targets.positions[3..].fill(DVec3::ZERO);
    deformer.start(&targets).unwrap();
    let moved: Vec<DVec3> = proxy.rest.iter().map(|p| q * *p + t).collect();
    assert!(distance(deformer.pose(), &moved) < 1e-9);
}

#[test]
fn a_steady_motion_is_predicted() {
    let proxy = block([10, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let mut deformer = twist(&proxy, &handles, &to_the_end(), 2, |p| p);
    for frame in 0..5 {
        let drift = DVec3::new(0.1, -0.2, 0.05) * f64::from(frame);
        let stats = deformer.step(&targets_of(&proxy, &handles, |p| twisted(0.5)(p) + drift)).unwrap();
        let surplus = deformer.energies()[0] / stats.energy - 1.0;
        match frame {
            1 => assert!(surplus > 1e-3, "the drift begins unforeseen: {surplus}"),
            2.. => assert!(surplus < 1e-9, "frame {frame} begins where it ends: {surplus}"),
            _ => {}
        }
    }
}

#[test]
fn a_component_without_any_handle_is_refused() {
    let error = Volumetric::new(&pair(), &[on_vertex(2, 1.0)], &Options::default()).err().unwrap();
    assert_eq!(error.kind, Kind::Refused);
    assert!(error.found.contains("component 2 of 2") && error.found.contains("72 tetrahedra"), "{error}");
    let none = Volumetric::new(&block([2, 1, 1], 0.0), &[], &Options::default()).err().unwrap();
    assert!(none.found.contains("no handle holds component 1 of 1"), "{none}");
}

#[test]
fn unusable_handles_are_refused_by_name() {
    let proxy = block([2, 1, 1], 0.0);
    let outside = on_vertex(500, 1.0);
    let weightless = on_vertex(1, 0.0);
    let mut doubled = on_vertex(1, 1.0);
    doubled.row.values = vec![2.0];
    for (handle, word) in [(outside, "v500"), (weightless, "hardness 0"), (doubled, "sum to 2")] {
        let error = Volumetric::new(&proxy, &[on_vertex(0, 1.0), handle], &Options::default()).err().unwrap();
        assert!(error.kind == Kind::Refused && error.found.contains(word), "{error}");
    }
    let stiffness = vec![1.0; 3];
    let error = Volumetric::new(&proxy, &[on_vertex(0, 1.0)], &Options { stiffness, ..Default::default() }).err().unwrap();
    assert!(error.found.contains("3 stiffness values for 12"), "{error}");
}

#[test]
fn a_single_handle_carries_the_body_and_two_turn_it_the_shortest_way() {
    let proxy = block([4, 1, 1], 0.1);
    let mut one = Volumetric::new(&proxy, &[on_vertex(3, 1.0)], &Options::default()).unwrap();
    one.start(&Targets { positions: vec![proxy.rest[3] + DVec3::ONE], presence: vec![1.0] }).unwrap();
    let carried: Vec<DVec3> = proxy.rest.iter().map(|p| *p + DVec3::ONE).collect();
    assert!(distance(one.pose(), &carried) < 1e-11);
    let handles = [on_vertex(0, 1.0), on_vertex(4, 1.0)];
    let quarter = DQuat::from_rotation_arc((proxy.rest[4] - proxy.rest[0]).normalize(), DVec3::new(0.2, 1.0, 0.3).normalize());
    let mut two = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
    two.start(&targets_of(&proxy, &handles, |p| quarter * p)).unwrap();
    let turned: Vec<DVec3> = proxy.rest.iter().map(|p| quarter * *p).collect();
    assert!(distance(two.pose(), &turned) < 1e-5);
}

#[test]
fn a_pose_that_is_not_finite_is_found_again() {
    let proxy = block([6, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let mut deformer = twist(&proxy, &handles, &to_the_end(), 3, |p| p);
    deformer.p[5] = Lanes::splat(f64::NAN);
    let targets = targets_of(&proxy, &handles, twisted(0.75));
    let stats = deformer.step(&targets).unwrap();
    assert!(stats.recovered && stats.converged);
    assert!(distance(deformer.pose(), twist(&proxy, &handles, &to_the_end(), 3, |p| p).pose()) < 1e-6);
    assert!(!deformer.step(&targets).unwrap().recovered);
}

#[test]
fn flat_tetrahedra_are_left_out_and_slivers_are_capped() {
    let mut proxy = block([4, 2, 2], 0.1);
    let handles = handles(&proxy, 1.0);
    let expected = twist(&proxy, &handles, &to_the_end(), 3, |p| p).pose().to_vec();
    let [a, b, c, _] = proxy.tets[0];
    proxy.tets.push([a, b, c, c]);
    assert_eq!(twist(&proxy, &handles, &to_the_end(), 3, |p| p).pose(), expected, "a tetrahedron without volume");
    // A nearly flat one across a face: a hundred thousand times as stiff as the others without the cap.
    let new = proxy.rest.len() as u32;
    let [p, q, r] = [a, b, c].map(|v| proxy.rest[v as usize]);
    proxy.rest.push((p + q + r) / 3.0 + (q - p).cross(r - p) * 1e-4);
    *proxy.tets.last_mut().unwrap() = [a, b, c, new];
    let capped = Options { bulk: 0.0, ..Default::default() };
    let sliver = super::elements::elements(&proxy, &capped).unwrap().pop().unwrap();
    assert!(sliver.capped < 1e-2 * sliver.volume);
    let whole = super::elements::elements(&proxy, &Options { sliver_cap: f64::INFINITY, ..capped }).unwrap().pop().unwrap();
    assert_eq!(whole.capped, whole.volume);
    assert!(distance(twist(&proxy, &handles, &to_the_end(), 3, |p| p).pose(), &expected) < 0.02);
}

#[test]
fn an_inverted_tetrahedron_is_counted() {
    let proxy = block([1, 1, 1], 0.0);
    let handles: Vec<Handle> = (0..8).map(|v| on_vertex(v, 1e4)).collect();
    let mut deformer = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
    let mut targets = targets_of(&proxy, &handles, |p| p);
    let stats = deformer.start(&targets).unwrap();
    assert!((stats.volume_ratio - 1.0).abs() < 1e-12 && stats.fold.is_none());
    targets.positions[1] += DVec3::new(-1.5, 0.5, 0.5);
    let stats = deformer.step(&targets).unwrap();
    assert!(stats.inverted > 0 && stats.volume_ratio < 0.9, "{stats:?}");
    let centre = |t: &[u32; 4]| t.iter().map(|&v| proxy.rest[v as usize]).sum::<DVec3>() / 4.0;
    let mut round = proxy.tets.iter().filter(|t| t.contains(&1));
    assert!(
        round.any(|t| centre(t).distance(stats.fold.unwrap()) < 1e-12),
        "the fold is where the vertex went through: {stats:?}"
    );
}

#[test]
fn a_body_that_is_held_still_stays() {
    for proxy in shapes() {
        let handles = handles(&proxy, 1.0);
        let mut deformer = twist(&proxy, &handles, &Options::default(), 6, |p| p);
        let targets = targets_of(&proxy, &handles, twisted(1.5));
        // It settles first: the velocity dies away, and creases that the drag held back open.
        for _ in 0..5 {
            deformer.step(&targets).unwrap();
        }
        let pose = deformer.pose().to_vec();
        for _ in 0..5 {
            let stats = deformer.step(&targets).unwrap();
            assert!(stats.converged && stats.passes == 0);
            assert_eq!(deformer.pose(), pose);
        }
        let mut fading = targets.clone();
        fading.presence[2] = 0.3;
        assert!(deformer.step(&fading).unwrap().passes > 0, "a weight is another one");
        let moved = deformer.step(&targets_of(&proxy, &handles, |p| twisted(1.5)(p) + DVec3::Y * 0.1)).unwrap();
        assert!(moved.passes > 0 && distance(deformer.pose(), &pose) > 0.09);
    }
}

#[test]
fn the_gradient_is_the_slope_of_the_energy_also_where_tetrahedra_are_folded() {
    let proxy = block([3, 2, 2], 0.1);
    let deformer = Volumetric::new(&proxy, &handles(&proxy, 1.0), &Options::default()).unwrap();
    let wave = |v: usize, phase: f64| {
        let t = v as f64 * 2.4 + phase;
        Lanes::point(DVec3::new(t.sin(), (1.7 * t).cos(), (2.3 * t).sin()))
    };
    let moved = |size: f64| -> Vec<Lanes> { deformer.rest.iter().enumerate().map(|(v, p)| *p + wave(v, 0.0) * size).collect() };
    for size in [0.0, 0.05, 0.2] {
        let p = moved(size);
        let mut rotations = deformer.rotations.clone();
        let mut gradient = vec![Lanes::ZERO; p.len()];
        let inverted = deformer.blocks.measure(&p).0;
        assert!((size > 0.1) == (inverted > 10), "{inverted} inside out");
        deformer.blocks.pass(&p, &mut rotations, 2, &mut gradient);
        let mut along = |step: f64| {
            let p: Vec<Lanes> = p.iter().enumerate().map(|(v, p)| *p + wave(v, 1.0) * step).collect();
            deformer.blocks.pass(&p, &mut rotations, 0, &mut vec![Lanes::ZERO; p.len()])
        };
        let slope = (along(1e-6) - along(-1e-6)) / 2e-6;
        let expected: f64 = gradient.iter().enumerate().map(|(v, g)| 2.0 * (*g * wave(v, 1.0)).sum()).sum();
        assert!((slope - expected).abs() < 1e-7 * (1.0 + expected.abs()), "{size}: {slope} {expected}");
    }
}
