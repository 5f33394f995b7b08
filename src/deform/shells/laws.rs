//! What must hold for any shell: invariances, examples that are found again, bounds, release of handles. Shapes are made here.
#![allow(clippy::unwrap_used)]

use super::newton::{Goals, Newton, Settings, Tension, Weights};
use super::shapes::{Bend, arm, dice, straight};
use super::*;
use crate::error::Kind;
use crate::linalg::SparseRow;
use glam::{DMat3, DQuat};

const RINGS: usize = 31;
const SEGMENTS: usize = 10;

fn bent(shoulder: f64, elbow: f64) -> Vec<DVec3> {
    arm(RINGS, SEGMENTS, Bend { shoulder, elbow, bulge: 0.25 * elbow / 100.0 }).0
}

/// An arm at rest with an elbow and a shoulder that have been bent.
fn subject(examples: &[Vec<DVec3>]) -> Body {
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    Body::build(&rest, &faces, examples, 100_000, &|| Ok(())).unwrap().numbered_as_scan()
}

fn examples() -> [Vec<DVec3>; 2] {
    [bent(0.0, 100.0), bent(70.0, 0.0)]
}

fn row(vertices: impl IntoIterator<Item = usize>) -> SparseRow {
    let indices: Vec<u32> = vertices.into_iter().map(|v| v as u32).collect();
    SparseRow { values: vec![1.0 / indices.len() as f64; indices.len()], indices }
}

/// Elbow and wrist as the means of rings, points of the skin, and some of the trunk, so that it stays.
fn handles() -> Vec<Handle> {
    let ring = |i: usize| row(i * SEGMENTS..(i + 1) * SEGMENTS);
    let skin = [(15, 2), (22, 3), (25, 7), (27, 0), (0, 0), (0, 3), (0, 6), (2, 1), (2, 5), (3, 8)];
    let rows = [ring(18), ring(28)].into_iter().chain(skin.into_iter().map(|(i, j)| row([i * SEGMENTS + j])));
    rows.enumerate().map(|(i, row)| Handle { name: format!("h{i}"), row, beta: 1.0 }).collect()
}

fn targets(handles: &[Handle], x: &[DVec3]) -> Targets {
    Targets { positions: handles.iter().map(|h| h.row.apply(x)).collect(), presence: vec![1.0; handles.len()] }
}

fn paper(count: usize) -> Options {
    Options { steps: 40, decrease: 1e-10, still: 1e-9, bounds: Bounds::FREE, ..Options::for_examples(count) }
}

fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

/// Shoulder, then elbow, then half of both, in small steps.
fn path() -> Vec<(f64, f64)> {
    (1..=30)
        .map(|t| {
            let t = f64::from(t);
            if t <= 20.0 {
                (70.0 * (t / 10.0).min(1.0), 100.0 * (t / 10.0 - 1.0).max(0.0))
            } else {
                (70.0 - 3.5 * (t - 20.0), 100.0 - 5.0 * (t - 20.0))
            }
        })
        .collect()
}

/// Poses and weights along the path.
fn run(examples: &[Vec<DVec3>], map: impl Fn(DVec3) -> DVec3) -> (Vec<Vec<DVec3>>, Vec<Vec<f64>>) {
    let body = subject(examples);
    let handles = handles();
    let mut shells = Shells::new(&body, &handles, &[], &paper(examples.len())).unwrap();
    let (mut poses, mut weights) = (Vec::new(), Vec::new());
    for (shoulder, elbow) in path() {
        let mut targets = targets(&handles, &bent(shoulder, elbow));
        targets.positions.iter_mut().for_each(|p| *p = map(*p));
        shells.step(&targets).unwrap();
        poses.push(shells.pose()[..body.vertices()].to_vec());
        weights.push(shells.weights().to_vec());
    }
    (poses, weights)
}

#[test]
fn rest_in_gives_rest_out() {
    let body = subject(&examples());
    let handles = handles();
    let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    for frame in 0..3 {
        let at_rest = targets(&handles, &body.proxy.rest);
        let stats = if frame == 0 { shells.start(&at_rest).unwrap() } else { shells.step(&at_rest).unwrap() };
        assert!(distance(shells.pose(), &body.proxy.rest) < 1e-9 && stats.converged);
        assert!(shells.weights().iter().all(|w| w.abs() < 1e-9), "{:?}", shells.weights());
        assert!((stats.volume_ratio - 1.0).abs() < 1e-9);
    }
}

#[test]
fn handles_of_an_example_give_back_that_example() {
    let body = subject(&examples());
    let handles = handles();
    for (i, example) in examples().iter().enumerate() {
        let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
        shells.start(&targets(&handles, example)).unwrap();
        let off = distance(&shells.pose()[..body.vertices()], example) / 3.0;
        assert!(off < 5e-4, "example {i}: {off}");
        for (k, weight) in shells.weights().iter().enumerate() {
            assert!((weight - f64::from(u8::from(k == i))).abs() < 0.005, "example {i}: {:?}", shells.weights());
        }
    }
}

#[test]
fn examples_combine_and_what_lies_between_them_has_weights_between() {
    let (poses, weights) = run(&examples(), |p| p);
    let near = |frame: usize, elbow: f64, shoulder: f64, limit: f64| {
        let w = &weights[frame];
        assert!((w[0] - elbow).abs() < limit && (w[1] - shoulder).abs() < limit, "frame {frame}: {w:?}");
    };
    near(9, 0.0, 1.0, 0.01);
    near(19, 1.0, 1.0, 0.03);
    near(29, 0.5, 0.5, 0.02);
    let off = |frame: usize| {
        let (shoulder, elbow) = path()[frame];
        distance(&poses[frame], &bent(shoulder, elbow)) / 3.0
    };
    assert!(off(19) < 0.006 && off(9) < 0.002, "{} {}", off(9), off(19));
    // Weights have no jumps.
    for pair in weights.windows(2) {
        assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| (a - b).abs() < 0.15), "{pair:?}");
    }
}

#[test]
fn examples_help() {
    let target = bent(0.0, 100.0);
    let off = |examples: &[Vec<DVec3>]| {
        let (body, handles) = (subject(examples), handles());
        let mut shells = Shells::new(&body, &handles, &[], &paper(examples.len())).unwrap();
        for t in 1..=10 {
            shells.step(&targets(&handles, &bent(0.0, 10.0 * f64::from(t)))).unwrap();
        }
        distance(&shells.pose()[..body.vertices()], &target)
    };
    let (with, without) = (off(&examples()), off(&[]));
    assert!(without > 10.0 * with, "{with} with, {without} without");
}

#[test]
fn neither_a_turned_example_nor_another_order_changes_anything() {
    let [elbow, shoulder] = examples();
    let (poses, weights) = run(&[elbow.clone(), shoulder.clone()], |p| p);
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 2.3);
    let turned: Vec<DVec3> = elbow.iter().map(|p| turn * *p + DVec3::new(3.0, -2.0, 1.0)).collect();
    for (examples, order) in [([turned, shoulder.clone()], [0, 1]), ([shoulder, elbow], [1, 0])] {
        let (other_poses, other_weights) = run(&examples, |p| p);
        for (frame, (a, b)) in poses.iter().zip(&other_poses).enumerate() {
            assert!(distance(a, b) < 3e-8, "frame {frame}: {}", distance(a, b));
            let [w, v] = [&weights[frame], &other_weights[frame]];
            assert!((0..2).all(|i| (w[i] - v[order[i]]).abs() < 1e-7), "{w:?} {v:?}");
        }
    }
}

#[test]
fn what_moves_the_targets_rigidly_moves_the_body() {
    let (poses, weights) = run(&examples(), |p| p);
    let turn = DQuat::from_axis_angle(DVec3::new(-1.0, 0.5, 2.0).normalize(), 1.9);
    let motion = |p: DVec3| turn * p + DVec3::new(5.0, 1.0, -2.0);
    let (moved, again) = run(&examples(), motion);
    for frame in 0..poses.len() {
        let expected: Vec<DVec3> = poses[frame].iter().map(|p| motion(*p)).collect();
        assert!(distance(&moved[frame], &expected) < 1e-6, "frame {frame}: {}", distance(&moved[frame], &expected));
        assert!((0..2).all(|i| (weights[frame][i] - again[frame][i]).abs() < 1e-6));
    }
}

fn shell(rest: &[DVec3], faces: &[[u32; 3]], examples: &[Vec<DVec3>]) -> Newton {
    let shell = Shell::new(rest, faces, examples, &Material::WITH_EXAMPLES, &[]).unwrap();
    Newton::new(shell, &vec![false; rest.len()], Vec::new())
}

#[test]
fn energy_does_not_change_with_place_turn_or_size_but_with_the_mirror() {
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    let mut random = dice(3);
    let x: Vec<DVec3> = bent(20.0, 40.0).iter().map(|p| *p + 0.02 * (DVec3::new(random(), random(), random()) - 0.5)).collect();
    let weights = [0.3, -0.1];
    let mut newton = shell(&rest, &faces, &examples());
    let energy = newton.resisted(&x, &weights);
    let mut ratio =
        |map: &dyn Fn(DVec3) -> DVec3| newton.resisted(&x.iter().map(|p| map(*p)).collect::<Vec<_>>(), &weights) / energy;
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 1.34);
    let moved = ratio(&|p| turn * p + DVec3::new(100.0, -50.0, 20.0));
    assert!((moved - 1.0).abs() < 1e-9, "{moved}");
    let mirrored = ratio(&|p| p * DVec3::new(1.0, 1.0, -1.0));
    assert!(mirrored > 1.05, "{mirrored}");
    for factor in [1e-3, 1e3] {
        let scaled = |x: &[DVec3]| x.iter().map(|p| *p * factor).collect::<Vec<_>>();
        let mut newton = shell(&scaled(&rest), &faces, &examples().map(|e| scaled(&e)));
        let same = newton.resisted(&scaled(&x), &weights) / energy;
        assert!((same - 1.0).abs() < 1e-10, "{factor}: {same}");
    }
}

#[test]
fn stretching_by_area_does_not_depend_on_the_number_of_triangles() {
    let energy = |rings: usize, segments: usize| {
        let (rest, faces) = straight(6.0, 0.6, rings, segments);
        let material = Material { stretching: 1.0, ..Material::WITH_EXAMPLES };
        let mut newton =
            Newton::new(Shell::new(&rest, &faces, &[], &material, &[]).unwrap(), &vec![false; rest.len()], Vec::new());
        let x: Vec<DVec3> = rest.iter().map(|p| *p * DVec3::new(1.0, 1.0, 1.1)).collect();
        newton.resisted(&x, &[])
    };
    let (coarse, fine) = (energy(25, 12), energy(73, 36));
    assert!((fine / coarse - 1.0).abs() < 0.02, "{coarse} {fine}");
}

#[test]
fn an_example_that_is_there_twice_shares_its_weight() {
    let [elbow, _] = examples();
    let (_, once) = run(std::slice::from_ref(&elbow), |p| p);
    let (_, twice) = run(&[elbow.clone(), elbow], |p| p);
    for (w, v) in once.iter().zip(&twice) {
        assert!((v[0] - v[1]).abs() < 1e-3 && (v[0] + v[1] - w[0]).abs() < 2e-3, "{w:?} {v:?}");
    }
}

#[test]
fn bounds_keep_one_handle_from_bending_joints_backwards() {
    let (body, all) = (subject(&examples()), handles());
    // Only the wrist and the trunk.
    let handles: Vec<Handle> = all.iter().enumerate().filter(|(i, _)| *i == 1 || *i > 5).map(|(_, h)| h.clone()).collect();
    let mut shells = Shells::new(&body, &handles, &[], &Options { bounds: Bounds::CONVEX, ..paper(2) }).unwrap();
    for t in 1..=20 {
        shells.step(&targets(&handles, &bent(0.0, 5.0 * f64::from(t)))).unwrap();
        assert!(shells.weights().iter().all(|w| (0.0..=1.0).contains(w)), "{:?}", shells.weights());
    }
    let w = shells.weights();
    assert!((w[0] - 1.0).abs() < 0.02 && w[1].abs() < 0.02, "{w:?}");
}

#[test]
fn a_handle_that_is_away_for_a_while_changes_little() {
    let (body, handles) = (subject(&examples()), handles());
    let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    let (poses, _) = run(&examples(), |p| p);
    for (frame, (shoulder, elbow)) in path().into_iter().enumerate() {
        let mut targets = targets(&handles, &bent(shoulder, elbow));
        if (8..18).contains(&frame) {
            targets.presence[3] = 0.0;
            targets.positions[3] = DVec3::NAN;
            targets.presence[4] = 0.0;
        }
        shells.step(&targets).unwrap();
        let off = distance(&shells.pose()[..body.vertices()], &poses[frame]) / 3.0;
        // In the frame in which they come back creases are still held by where they were without them.
        let most = match frame {
            8..18 => 2e-3,
            18 => 1e-5,
            _ => 1e-6,
        };
        assert!(off < most, "frame {frame}: {off}");
    }
}

#[test]
fn without_any_handle_the_pose_stays_and_a_broken_target_is_refused() {
    let (body, handles) = (subject(&examples()), handles());
    let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    let mut targets = targets(&handles, &bent(0.0, 50.0));
    shells.start(&targets).unwrap();
    let pose = shells.pose().to_vec();
    targets.presence.fill(0.0);
    assert_eq!(shells.step(&targets).unwrap().passes, 0);
    assert_eq!(shells.pose(), pose);
    targets.presence[2] = 1.0;
    targets.positions[2] = DVec3::NAN;
    assert!(shells.step(&targets).unwrap_err().to_string().contains("h2"));
}

#[test]
fn only_a_frame_that_is_solved_says_how_well() {
    let (body, handles) = (subject(&examples()), handles());
    let frame = |options: Options| {
        let mut shells = Shells::new(&body, &handles, &[], &options).unwrap();
        shells.start(&targets(&handles, &body.proxy.rest)).unwrap();
        shells.step(&targets(&handles, &bent(0.0, 5.0))).unwrap()
    };
    let none = frame(Options { steps: 0, ..paper(2) });
    assert!(!none.converged && none.error.is_none() && none.step == 0.0, "{none:?}");
    let one = frame(Options { steps: 1, ..paper(2) });
    assert!(!one.converged && one.error.is_none() && one.step > 0.0, "{one:?}");
    let solved = frame(paper(2));
    assert!(solved.converged && solved.error == Some(solved.step), "{solved:?}");
    let counted = frame(Options { steps: 1, decrease: 0.0, still: 0.0, ..paper(2) });
    assert!(counted.converged && counted.error.is_none(), "{counted:?}");
}

#[test]
fn a_frame_that_is_begun_anew_says_so() {
    let (body, handles) = (subject(&examples()), handles());
    let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    let at_rest = targets(&handles, &body.proxy.rest);
    (0..12).for_each(|_| assert!(!shells.step(&at_rest).unwrap().recovered));
    // Inside out as a whole, so that no vertex has neighbours that say where it belongs, and without steps that would move it.
    shells.x.iter_mut().for_each(|p| p.y = -p.y);
    shells.settings.steps = 0;
    let stats = shells.step(&at_rest).unwrap();
    assert!(stats.recovered && distance(shells.pose(), &body.proxy.rest) < 1e-6, "{stats:?}");
}

#[test]
fn a_part_that_no_handle_holds_is_refused_with_its_place() {
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    let n = rest.len() as u32;
    let twice: Vec<DVec3> = rest.iter().copied().chain(rest.iter().map(|p| *p + DVec3::Y * 3.0)).collect();
    let all: Vec<[u32; 3]> = faces.iter().copied().chain(faces.iter().map(|f| f.map(|v| v + n))).collect();
    let body = Body::build(&twice, &all, &[], 100_000, &|| Ok(())).unwrap().numbered_as_scan();
    let mut handles = handles();
    let error = Shells::new(&body, &handles, &[], &paper(0)).unwrap_err().to_string();
    let words = format!("of 2 of the shell: {} triangles around", body.proxy.boundary.len() / 2);
    assert!(error.contains(&words), "{error}");
    handles.push(Handle { name: "other".into(), row: row([n as usize]), beta: 1.0 });
    assert!(Shells::new(&body, &handles, &[], &paper(0)).is_ok());
}

#[test]
fn stiffness_of_other_triangles_than_there_are_is_refused() {
    let (body, handles) = (subject(&[]), handles());
    let refused = |options: Options| Shells::new(&body, &handles, &[], &options).unwrap_err().to_string();
    let text = refused(Options { rigid: vec![vec![0], vec![99_999]], ..paper(0) });
    assert!(text.contains("rigid group 1: triangle 99999"), "{text}");
    let text = refused(Options { stiffness: vec![1.0; 3], rigid: vec![vec![0]], ..paper(0) });
    assert!(text.contains("3 stiffness values"), "{text}");
    let mut stiffness = vec![1.0; body.proxy.boundary.len()];
    stiffness[7] = f64::NAN;
    let text = refused(Options { stiffness, ..paper(0) });
    assert!(text.contains("triangle 7"), "{text}");
}

#[test]
fn a_cut_in_the_take_is_solved_as_if_it_began_there() {
    let (body, handles) = (subject(&examples()), handles());
    let far = |x: Vec<DVec3>| x.iter().map(|p| DQuat::from_rotation_x(2.0) * *p + DVec3::Y * 4.0).collect::<Vec<_>>();
    let there = targets(&handles, &far(bent(70.0, 100.0)));
    let mut cut = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    cut.start(&targets(&handles, &body.proxy.rest)).unwrap();
    cut.step(&there).unwrap();
    let mut fresh = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    fresh.start(&there).unwrap();
    assert_eq!(cut.pose(), fresh.pose());
    assert!(distance(&cut.pose()[..body.vertices()], &far(bent(70.0, 100.0))) < 0.03);
}

#[test]
fn the_wrist_alone_finds_an_example_at_once() {
    let (body, all) = (subject(&examples()), handles());
    let handles: Vec<Handle> = all.iter().enumerate().filter(|(i, _)| *i == 1 || *i > 5).map(|(_, h)| h.clone()).collect();
    let mut shells = Shells::new(&body, &handles, &[], &Options { bounds: Bounds::CONVEX, ..paper(2) }).unwrap();
    // Turned, so that rest is no better a start than the examples.
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 1.0, -0.5).normalize(), 2.5);
    let there: Vec<DVec3> = bent(0.0, 100.0).iter().map(|p| turn * *p).collect();
    shells.start(&targets(&handles, &there)).unwrap();
    let off = distance(&shells.pose()[..body.vertices()], &there) / 3.0;
    assert!(off < 1e-3, "{off}: {:?}", shells.weights());
}

#[test]
fn edges_that_have_vanished_do_not_spoil_the_rest() {
    let collapse = |mut x: Vec<DVec3>| {
        for (a, b) in [(15 * SEGMENTS + 5, 15 * SEGMENTS + 6), (24 * SEGMENTS + 2, 24 * SEGMENTS + 3)] {
            // They are not gone to the same degree in every pose.
            x[b] = x[a].lerp(x[b], 1e-9 * (1.0 + x[200].y.abs()));
        }
        x
    };
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    let body = Body::build(&collapse(rest), &faces, &examples().map(collapse), 100_000, &|| Ok(())).unwrap().numbered_as_scan();
    let handles = handles();
    // Weighted by area such edges count little; as printed they would outweigh all others.
    let options = Options { material: Material::PAPER, ..paper(2) };
    let mut shells = Shells::new(&body, &handles, &[], &options).unwrap();
    assert!(shells.without_bending().1 > 0);
    for (shoulder, elbow) in &path()[..20] {
        shells.step(&targets(&handles, &collapse(bent(*shoulder, *elbow)))).unwrap();
    }
    let w = shells.weights();
    assert!((w[0] - 1.0).abs() < 0.04 && (w[1] - 1.0).abs() < 0.04, "{w:?}");
}

#[test]
fn a_marker_off_the_skin_is_followed_as_if_it_were_on_it() {
    let body = subject(&examples());
    let rows = SurfaceRows::new(&body);
    let mut handles = handles();
    let outwards = |x: &[DVec3], v: usize| {
        let ring = v / SEGMENTS * SEGMENTS;
        let centre = x[ring..ring + SEGMENTS].iter().sum::<DVec3>() / SEGMENTS as f64;
        x[v] + 0.06 * (x[v] - centre).normalize()
    };
    let skin = [15 * SEGMENTS + 2, 22 * SEGMENTS + 3, 25 * SEGMENTS + 7, 27 * SEGMENTS];
    for (handle, &v) in handles[2..6].iter_mut().zip(&skin) {
        handle.row = rows.row(outwards(&body.proxy.rest, v));
        assert!(handle.row.apply(&body.proxy.rest).distance(outwards(&body.proxy.rest, v)) < 1e-9);
    }
    let mut shells = Shells::new(&body, &handles, &[], &paper(2)).unwrap();
    for (shoulder, elbow) in &path()[..20] {
        let x = bent(*shoulder, *elbow);
        let mut positions: Vec<DVec3> = handles
            .iter()
            .map(|h| {
                h.row
                    .indices
                    .iter()
                    .zip(&h.row.values)
                    .filter(|(v, _)| (**v as usize) < x.len())
                    .map(|(&v, c)| x[v as usize] * *c)
                    .sum()
            })
            .collect();
        skin.iter().zip(&mut positions[2..6]).for_each(|(&v, p)| *p = outwards(&x, v));
        shells.step(&Targets { positions, presence: vec![1.0; handles.len()] }).unwrap();
    }
    let off = distance(&shells.pose()[..body.vertices()], &bent(70.0, 100.0)) / 3.0;
    assert!(off < 0.006, "{off}");
}

#[test]
fn a_joint_inside_is_held_from_all_sides() {
    let body = subject(&[]);
    let rows = SurfaceRows::new(&body);
    let centre = DVec3::new(1.8, 0.0, 0.0);
    let row = rows.row(centre);
    assert!((row.values.iter().sum::<f64>() - 1.0).abs() < 1e-9 && row.apply(&body.proxy.rest).distance(centre) < 1e-9);
    assert!(row.indices.len() > 3 && row.indices.iter().all(|v| (*v as usize) < body.vertices()), "{row:?}");
}

#[test]
fn two_runs_give_the_same_bits() {
    assert_eq!(run(&examples(), |p| p), run(&examples(), |p| p));
}

#[test]
fn weights_that_are_given_give_the_examples_and_what_lies_between() {
    let body = subject(&examples());
    let mut solver = Interpolator::new(&body, &Material::WITH_EXAMPLES).unwrap();
    let n = body.vertices();
    for (weights, expected) in [([0.0, 0.0], bent(0.0, 0.0)), ([1.0, 0.0], bent(0.0, 100.0)), ([0.0, 1.0], bent(70.0, 0.0))] {
        solver.solve(&weights).unwrap();
        assert!(distance(&solver.pose()[..n], &expected) < 1e-9, "{weights:?}");
    }
    // The bend of a joint is halved and exaggerated with its weight.
    for (weight, angle) in [(0.5, 50.0), (1.2, 120.0)] {
        solver.solve(&[weight, 0.0]).unwrap();
        let pose = &solver.pose()[..n];
        let ring = |x: &[DVec3], i: usize| x[i * SEGMENTS..(i + 1) * SEGMENTS].iter().sum::<DVec3>() / SEGMENTS as f64;
        let bend = |x: &[DVec3]| (ring(x, 10) - ring(x, 7)).angle_between(ring(x, 28) - ring(x, 25)).to_degrees();
        assert!((bend(pose) - bend(&bent(0.0, angle))).abs() < 3.0, "{weight}: {}", bend(pose));
        assert!((solver.solve(&[weight, 0.0]).unwrap().volume_ratio - 1.0).abs() < 0.1);
    }
    assert!(solver.solve(&[1.0]).is_err() && solver.solve(&[f64::NAN, 0.0]).is_err());
    let far = solver.solve(&[0.0, 20.5]).unwrap_err();
    assert!(far.kind == Kind::Usage && far.to_string().contains("20.5"), "{far}");
}

#[test]
fn an_interpolation_ends_where_it_started_whatever_came_between() {
    let body = subject(&examples());
    let mut solver = Interpolator::new(&body, &Material::WITH_EXAMPLES).unwrap();
    solver.solve(&[0.5, 0.2]).unwrap();
    let first = solver.pose().to_vec();
    for t in 0..=10 {
        solver.solve(&[0.5 + 0.05 * f64::from(t), 0.2]).unwrap();
    }
    solver.solve(&[0.5, 0.2]).unwrap();
    assert!(distance(solver.pose(), &first) < 1e-3, "{}", distance(solver.pose(), &first));
}

#[test]
fn folds_beyond_half_a_turn_do_not_resist() {
    // A strip of two triangles whose edge is folded from nearly flat-folded on one side to the other.
    let angle = |degrees: f64| {
        let (s, c) = degrees.to_radians().sin_cos();
        vec![DVec3::ZERO, DVec3::Y, DVec3::NEG_X, DVec3::new(c, 0.5, s)]
    };
    let faces = [[0, 1, 2], [1, 0, 3]];
    let of = |a: f64, b: f64| Shell::new(&angle(a), &faces, &[angle(b)], &Material::PAPER, &[]).unwrap();
    assert_eq!(of(100.0, -60.0).folded, 0);
    assert_eq!(of(120.0, -120.0).folded, 1);
    assert_eq!(of(120.0, -120.0).bend, [0.0]);
}

#[test]
fn a_stiffer_part_changes_less() {
    let body = subject(&[]);
    let handles = handles();
    let soft = Options { material: Material::WITHOUT_EXAMPLES, ..paper(0) };
    let centre = |t: &[u32; 3]| t.iter().map(|&v| body.proxy.rest[v as usize].x).sum::<f64>() / 3.0;
    let stiffness = body.proxy.boundary.iter().map(|t| if (1.4..2.2).contains(&centre(t)) { 50.0 } else { 1.0 }).collect();
    let change = |options: Options| {
        let mut shells = Shells::new(&body, &handles, &[], &options).unwrap();
        for t in 1..=6 {
            shells.step(&targets(&handles, &bent(0.0, 10.0 * f64::from(t)))).unwrap();
        }
        let x = shells.pose();
        let edges = shells.newton.shell.topology.edges.iter();
        let inside = edges.filter(|[a, b]| [a, b].iter().all(|v| (1.5..2.1).contains(&body.proxy.rest[**v as usize].x)));
        inside
            .map(|[a, b]| {
                let of = |x: &[DVec3]| x[*a as usize].distance(x[*b as usize]);
                (of(x) / of(&body.proxy.rest) - 1.0).powi(2)
            })
            .sum::<f64>()
    };
    let (plain, stiff) = (change(soft.clone()), change(Options { stiffness, ..soft }));
    assert!(stiff < 0.5 * plain, "{plain} {stiff}");
}

#[test]
fn stiffness_learnt_from_examples_is_least_where_they_change_most() {
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    let learnt = Material { from_examples: true, by_area: false, ..Material::WITH_EXAMPLES };
    let plain = Material { by_area: false, ..Material::WITH_EXAMPLES };
    let of = |material: &Material| Shell::new(&rest, &faces, &[bent(0.0, 100.0)], material, &[]).unwrap();
    let (learnt, plain) = (of(&learnt), of(&plain));
    let ratios: Vec<f64> = learnt.stretch.iter().zip(&plain.stretch).map(|(a, b)| (a / b).powi(2)).collect();
    let (least, at) = ratios.iter().enumerate().map(|(e, r)| (*r, e)).fold((1.0, 0), |m, r| if r.0 < m.0 { r } else { m });
    // 1 − Δ / (max Δ (1 + 1e-2)), 1e-2 / 1.01 at the largest change.
    assert!((least - 0.01 / 1.01).abs() < 1e-12, "{least}");
    let place = rest[learnt.topology.edges[at][0] as usize].x;
    assert!((1.0..2.3).contains(&place), "{place}");
    let trunk = learnt.topology.edges.iter().zip(&ratios).filter(|(e, _)| rest[e[0] as usize].x < 0.3).map(|(_, r)| *r);
    assert!(trunk.fold(1.0, f64::min) > 0.999);
}

#[test]
fn a_smooth_bad_start_ends_in_the_same_minimum() {
    // Fig. 10: from a pose that has nothing to do with the targets.
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend::default());
    let all = examples();
    let shell = Shell::new(&rest, &faces, &all, &Material::PAPER, &[]).unwrap();
    let mut held = vec![false; rest.len()];
    held[..4 * SEGMENTS].fill(true);
    let handles = handles();
    let grip = |h: &Handle| newton::Grip {
        pull: system::Pull { vertices: h.row.indices.clone(), values: h.row.values.clone() },
        offsets: Vec::new(),
    };
    let mut newton = Newton::new(shell, &held, handles.iter().map(grip).collect());
    let positions = targets(&handles, &bent(35.0, 50.0)).positions;
    let weights = vec![1e6 / newton.shell.size.powi(2); positions.len()];
    let goals = Goals { positions: &positions, weights: &weights };
    let settings = Settings {
        steps: 60,
        decrease: 1e-9,
        still: 0.0,
        damping: 1e-9,
        tension: Tension::WhenNeeded,
        weights: Weights::Free { bounds: Bounds::FREE, regularization: 1e-4 },
    };
    let squashed: Vec<DVec3> =
        rest.iter().enumerate().map(|(v, p)| if held[v] { *p } else { *p * DVec3::new(1.0, 0.3, 0.3) }).collect();
    let mut found: Vec<(Vec<DVec3>, u32)> = Vec::new();
    for start in [bent(35.0, 50.0), all[0].clone(), squashed] {
        let (mut x, mut shares) = (start, [0.0; 2]);
        x[..4 * SEGMENTS].copy_from_slice(&rest[..4 * SEGMENTS]);
        let minimum = newton.minimize(&mut x, &mut shares, &goals, &settings);
        found.push((x, minimum.steps));
    }
    for (x, steps) in &found[1..] {
        assert!(distance(x, &found[0].0) < 1e-4 && *steps <= 20, "{} {steps}", distance(x, &found[0].0));
    }
}

#[test]
fn the_length_of_a_surface_is_that_of_the_turned_and_the_mirrored_one() {
    use super::geometry::{diagonal, size};
    let (rest, faces) = arm(RINGS, SEGMENTS, Bend { elbow: 60.0, ..Bend::default() });
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    let turned: Vec<DVec3> = rest.iter().map(|p| turn * *p + DVec3::X).collect();
    let mirrored: Vec<DVec3> = rest.iter().map(|p| *p * DVec3::new(1.0, -1.0, 1.0)).collect();
    let length = size(&rest, &faces);
    assert!((size(&turned, &faces) / length - 1.0).abs() < 1e-12 && (size(&mirrored, &faces) / length - 1.0).abs() < 1e-12);
    assert!((diagonal(&turned) / diagonal(&rest) - 1.0).abs() > 0.01);
    // Of a cube, all of whose triangles count by their area: six faces at half an edge, each with 1/6 in its plane.
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
    let cube: Vec<DVec3> = (0..8).map(corner).collect();
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces: Vec<[u32; 3]> = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    assert!((size(&cube, &faces) - 4.15 * (0.25_f64 + 1.0 / 6.0).sqrt()).abs() < 1e-12);
}
