//! What must hold of handles: released, fading, hard, few or none, and of bodies in several pieces.
#![allow(clippy::unwrap_used)]

use super::bodies::*;
use super::{Options, Volumetric};
use crate::deform::{Deformer, Handle, Targets};
use crate::error::Kind;
use crate::proxy::Proxy;
use glam::{DQuat, DVec3};

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
