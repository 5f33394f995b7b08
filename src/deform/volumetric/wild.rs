//! Markers that jump about and tear the body: what no take should hold, and some do.
#![allow(clippy::unwrap_used)]

use super::bodies::{block, distance, noise, on_vertex, targets_of, to_the_end, twisted};
use super::descent::MOST_PASSES;
use super::{Options, Volumetric};
use crate::deform::{Deformer, Handle, Targets};
use crate::linalg::lanes::Lanes;
use crate::proxy::Proxy;
use glam::DVec3;

fn on_every(proxy: &Proxy, step: usize, beta: f64) -> Vec<Handle> {
    (0..proxy.rest.len()).step_by(step).map(|v| on_vertex(v, beta)).collect()
}

/// Every target up to `far` off its place in each direction, in diagonals.
fn scattered(proxy: &Proxy, handles: &[Handle], random: &mut impl FnMut() -> f64, far: f64) -> Targets {
    let mut targets = targets_of(proxy, handles, |p| p);
    targets.positions.iter_mut().for_each(|p| *p += DVec3::new(random(), random(), random()) * far);
    targets
}

#[test]
fn a_torn_body_still_finds_a_way_down_in_every_step() {
    for cells in [[10, 2, 2], [6, 6, 1]] {
        let proxy = block(cells, 0.15);
        for beta in [1.0, 100.0] {
            let handles = on_every(&proxy, 2, beta);
            let mut random = noise();
            let mut deformer = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
            deformer.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
            for frame in 1..12 {
                let stats = deformer.step(&scattered(&proxy, &handles, &mut random, 0.15)).unwrap();
                let energies = deformer.energies();
                assert!(
                    energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)),
                    "{cells:?}, {beta}, frame {frame}: {energies:?}"
                );
                // Where a step leads up, a shorter one leads down: only the number of passes ends a frame early.
                assert!(stats.converged || stats.passes >= MOST_PASSES.0, "{cells:?}, {beta}, frame {frame}: {stats:?}");
            }
        }
    }
}

#[test]
fn a_first_frame_far_from_rest_has_the_passes_of_two() {
    let proxy = block([10, 2, 2], 0.15);
    let handles = on_every(&proxy, 7, 1.0);
    let mut deformer = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
    let stats = deformer.start(&scattered(&proxy, &handles, &mut noise(), 0.3)).unwrap();
    assert!(stats.converged && stats.passes > MOST_PASSES.1, "{stats:?}");
}

#[test]
fn a_pose_that_is_inside_out_is_left_and_said_to_be_recovered() {
    let proxy = block([6, 2, 2], 0.1);
    let handles = on_every(&proxy, 5, 1.0);
    let targets = targets_of(&proxy, &handles, twisted(0.5));
    let mut fresh = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
    fresh.start(&targets).unwrap();
    let mut spoiled = Volumetric::new(&proxy, &handles, &to_the_end()).unwrap();
    spoiled.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
    spoiled.p.iter_mut().for_each(|p| *p = *p * Lanes([1.0, 1.0, -1.0, 1.0]));
    let stats = spoiled.step(&targets).unwrap();
    assert!(stats.recovered && stats.inverted == 0, "{stats:?}");
    assert_eq!(spoiled.pose(), fresh.pose());
    assert!(!spoiled.step(&targets).unwrap().recovered);
    assert!(distance(spoiled.pose(), fresh.pose()) < 1e-8);
}
