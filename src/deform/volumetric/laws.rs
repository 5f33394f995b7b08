//! What must hold for any body: invariances, descent of the energy, recovery.
#![allow(clippy::unwrap_used)]

use super::bodies::*;
use super::{Options, Volumetric};
use crate::deform::{Deformer, Handle};
use crate::linalg::SparseRow;
use crate::linalg::lanes::Lanes;
use crate::proxy::Proxy;
use glam::{DMat3, DQuat, DVec3};

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
