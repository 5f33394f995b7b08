#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::*;
use glam::{DMat3, DQuat};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Limbs as closed round shells that overlap, as clothed and game characters have them.
#[derive(Default)]
struct Shells {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Shells {
    /// A closed tube with round ends; `ends` are centre and radius.
    fn capsule(&mut self, ends: [(DVec3, f64); 2]) {
        const AROUND: u32 = 16;
        const CAP: u32 = 5;
        let axis = (ends[1].0 - ends[0].0).normalize_or(DVec3::Y);
        let side = axis.any_orthonormal_vector();
        let other = axis.cross(side);
        let first = self.points.len() as u32;
        for ring in 0..2 * CAP {
            let (centre, radius) = ends[(ring / CAP) as usize];
            let part = f64::from(ring % CAP) / f64::from(CAP - 1);
            let latitude = FRAC_PI_2 * if ring < CAP { part - 1.0 } else { part };
            for step in 0..AROUND {
                let longitude = TAU * f64::from(step) / f64::from(AROUND);
                let around = side * longitude.cos() + other * longitude.sin();
                self.points.push(centre + (around * latitude.cos() + axis * latitude.sin()) * radius);
            }
        }
        for ring in 0..2 * CAP - 1 {
            for step in 0..AROUND {
                let at = |r: u32, s: u32| first + r * AROUND + s % AROUND;
                let [a, b, c, d] = [at(ring, step), at(ring, step + 1), at(ring + 1, step), at(ring + 1, step + 1)];
                self.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }

    /// A closed box.
    fn slab(&mut self, low: DVec3, high: DVec3) {
        let first = self.points.len() as u32;
        let side = |bit: bool, axis: usize| if bit { high[axis] } else { low[axis] };
        self.points.extend((0..8).map(|k| DVec3::new(side(k & 1 != 0, 0), side(k & 2 != 0, 1), side(k & 4 != 0, 2))));
        for q in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            let q = q.map(|v| first + v);
            self.triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        }
    }

    fn placed(&self, turn: DMat3) -> Vec<DVec3> {
        let turned: Vec<DVec3> = self.points.iter().map(|p| turn * *p).collect();
        let (lo, hi) = turned.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        turned.iter().map(|p| (*p - (lo + hi) * 0.5) / (hi - lo).length()).collect()
    }
}

/// A person 1.75 tall with up +Y, facing +Z, and the true joints; the arms point `down` degrees below level.
fn person(down: f64) -> (Shells, [DVec3; Joint::COUNT]) {
    standing(down, true)
}

fn standing(down: f64, with_arms: bool) -> (Shells, [DVec3; Joint::COUNT]) {
    let v = DVec3::new;
    let mut shells = Shells::default();
    let mut joints = [DVec3::ZERO; Joint::COUNT];
    for (x, first_arm, first_leg) in [(1.0, Joint::LeftShoulder, Joint::LeftHip), (-1.0, Joint::RightShoulder, Joint::RightHip)] {
        let arm = v(x * down.to_radians().cos(), -down.to_radians().sin(), 0.0);
        let shoulder = v(x * 0.18, 1.42, 0.0);
        let [elbow, wrist, tip] = [0.29, 0.54, 0.73].map(|l| shoulder + arm * l);
        if with_arms {
            shells.capsule([(shoulder, 0.055), (elbow, 0.042)]);
            shells.capsule([(elbow, 0.042), (wrist, 0.028)]);
            shells.capsule([(wrist + arm * 0.05, 0.040), (tip - arm * 0.02, 0.02)]);
        }
        joints[first_arm as usize..][..4].copy_from_slice(&[shoulder, elbow, wrist, tip]);
        let (hip, knee, ankle) = (v(x * 0.095, 0.92, 0.0), v(x * 0.13, 0.50, 0.01), v(x * 0.165, 0.08, 0.0));
        let toe = v(x * 0.18, 0.02, 0.20);
        shells.capsule([(hip, 0.085), (knee, 0.052)]);
        shells.capsule([(knee, 0.052), (ankle, 0.036)]);
        shells.capsule([(v(ankle.x, 0.045, -0.02), 0.045), (v(toe.x, 0.022, 0.178), 0.022)]);
        shells.capsule([(v(x * 0.06, 0.94, 0.0), 0.115), (v(x * 0.085, 1.34, 0.0), 0.105)]);
        joints[first_leg as usize..][..4].copy_from_slice(&[hip, knee, ankle, toe]);
    }
    shells.capsule([(v(0.0, 1.38, 0.0), 0.075), (v(0.0, 1.56, 0.02), 0.055)]);
    shells.capsule([(v(0.0, 1.62, 0.03), 0.085), (v(0.0, 1.665, 0.02), 0.085)]);
    joints[Joint::Neck as usize] = v(0.0, 1.49, 0.0);
    joints[Joint::Head as usize] = v(0.0, 1.58, 0.02);
    joints[Joint::Crown as usize] = v(0.0, 1.75, 0.02);
    joints[Joint::MidHip as usize] = (joints[Joint::LeftHip as usize] + joints[Joint::RightHip as usize]) * 0.5;
    (shells, joints)
}

fn turns() -> [DMat3; 4] {
    let some = |x: f64, y: f64, z: f64, w: f64| DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    [DMat3::IDENTITY, some(0.3, -0.5, 0.2, 0.7), some(-0.8, 0.1, 0.4, 0.3), some(0.1, 0.9, -0.6, -0.2)]
}

/// Worst error of a joint in shares of stature.
fn worst(body: &Body, shells: &Shells, joints: &[DVec3; Joint::COUNT], turn: DMat3) -> (f64, usize) {
    // The person and the true joints enter the unit box together.
    let mut with = Shells { points: shells.points.clone(), triangles: Vec::new() };
    let inside = with.points.len();
    with.points.extend(joints);
    let truth = with.placed(turn).split_off(inside);
    (0..Joint::COUNT)
        .map(|j| (body.joints[j].distance(truth[j]) / body.stature, j))
        .fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a })
}

#[test]
fn a_person_in_t_and_a_pose_is_found_in_any_turn() {
    for (down, turned) in [(0.0, [0, 1]), (20.0, [2, 3]), (45.0, [0, 2]), (60.0, [1, 3])] {
        let (shells, joints) = person(down);
        for turn in turned.map(|i| turns()[i]) {
            let body = find(&shells.placed(turn), &shells.triangles).unwrap();
            assert!(body.margin > 0.25 && body.cost < 0.3, "margin {} cost {}", body.margin, body.cost);
            let (error, joint) = worst(&body, &shells, &joints, turn);
            assert!(error < 0.04, "arms {down} down: joint {joint} is off by {:.1} % of stature", 100.0 * error);
            assert!(body.up.angle_between(turn * DVec3::Y) < 4_f64.to_radians());
            assert!(body.forward.angle_between(turn * DVec3::Z) < 5_f64.to_radians());
            assert!(body.facing_ratio > 2.0);
            for elevation in body.arm_elevation {
                assert!((elevation + down).abs() < 4.0, "{elevation} for {down} degrees down");
            }
        }
    }
}

#[test]
fn up_snaps_to_the_axis_of_the_file_and_soles_to_crown_is_the_stature() {
    let (shells, _) = person(30.0);
    let placed = shells.placed(DMat3::from_rotation_y(0.4));
    let body = find(&placed, &shells.triangles).unwrap();
    assert_eq!(body.up, DVec3::Y);
    let (low, high) = placed.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.y), b.max(p.y)));
    assert!((body.stature - (high - low)).abs() < 1e-12);
}

#[test]
fn flipped_faces_loose_sheets_and_holes_do_not_matter() {
    let (mut shells, joints) = person(40.0);
    for (i, t) in shells.triangles.iter_mut().enumerate() {
        if i % 3 == 0 {
            t.swap(0, 1);
        }
    }
    let clean = shells.placed(DMat3::IDENTITY);
    let expected = find(&clean, &shells.triangles).unwrap();
    let mut points = clean.clone();
    let first = points.len() as u32;
    let corner = expected.joints[Joint::RightHandTip as usize] + DVec3::new(-0.05, 0.02, 0.0);
    points.extend([corner, corner + DVec3::new(-0.05, 0.0, 0.0), corner + DVec3::new(0.0, 0.05, 0.0), DVec3::NAN]);
    let mut triangles: Vec<[u32; 3]> =
        shells.triangles.iter().enumerate().filter(|(i, _)| i % 23 != 0).map(|(_, t)| *t).collect();
    triangles.extend([[first, first + 1, first + 2], [first, first + 1, first + 3]]);
    let body = find(&points, &triangles).unwrap();
    let (error, joint) = worst(&body, &shells, &joints, DMat3::IDENTITY);
    assert!(error < 0.05, "joint {joint} is off by {:.1} % of stature", 100.0 * error);
}

#[test]
fn what_is_no_standing_person_is_refused() {
    let v = DVec3::new;
    let mut ball = Shells::default();
    ball.capsule([(DVec3::ZERO, 1.0), (v(0.0, 0.01, 0.0), 1.0)]);
    let mut horse = Shells::default();
    horse.capsule([(v(-0.5, 1.0, 0.0), 0.22), (v(0.5, 1.0, 0.0), 0.22)]);
    horse.capsule([(v(0.6, 1.1, 0.0), 0.12), (v(0.95, 1.55, 0.0), 0.09)]);
    horse.capsule([(v(0.95, 1.55, 0.0), 0.09), (v(1.3, 1.4, 0.0), 0.06)]);
    for x in [-0.55, 0.55] {
        for z in [-0.14, 0.14] {
            horse.capsule([(v(x, 0.9, z), 0.09), (v(x, 0.03, z), 0.03)]);
        }
    }
    let mut tailed = Shells { points: horse.points.clone(), triangles: horse.triangles.clone() };
    tailed.capsule([(v(-0.7, 1.1, 0.0), 0.04), (v(-0.9, 0.5, 0.0), 0.03)]);
    let mut rod = Shells::default();
    rod.capsule([(DVec3::ZERO, 0.1), (DVec3::Y, 0.1)]);
    let corners = [v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(0.0, 2.0, 0.0), v(1.0, 2.0, 0.0)];
    let mut points = corners.to_vec();
    points.extend(corners.map(|p| p + DVec3::Z));
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let block = Shells { points, triangles: quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect() };
    for (name, shape) in [("ball", ball), ("horse", horse), ("horse with tail", tailed), ("rod", rod), ("block", block)] {
        for turn in [turns()[0], turns()[2]] {
            let refusal = find(&shape.placed(turn), &shape.triangles).expect_err(name);
            assert!(refusal.reason.contains("looked for a standing person"), "{}", refusal.reason);
        }
    }
}

#[test]
fn hanging_arms_are_found_from_the_sides_in_any_turn() {
    for (down, turned) in [(84.0, [0, 1]), (87.0, [2, 3]), (90.0, [0, 2])] {
        let (shells, joints) = person(down);
        for turn in turned.map(|i| turns()[i]) {
            let body = find(&shells.placed(turn), &shells.triangles).unwrap();
            assert_eq!(body.arms, Arms::Hanging);
            let (error, joint) = worst(&body, &shells, &joints, turn);
            assert!(error < 0.03, "arms {down} down: joint {joint} is off by {:.1} % of stature", 100.0 * error);
            assert!(body.up.angle_between(turn * DVec3::Y) < 4_f64.to_radians());
            assert!(body.forward.angle_between(turn * DVec3::Z) < 5_f64.to_radians());
            for elevation in body.arm_elevation {
                assert!((elevation + down).abs() < 7.0, "{elevation} for {down} degrees down");
            }
        }
    }
}

#[test]
fn shoulders_are_seen_from_the_sides_where_a_stout_trunk_hides_the_armpits() {
    let (mut shells, joints) = person(70.0);
    for x in [-1.0, 1.0] {
        shells.capsule([(DVec3::new(x * 0.09, 1.0, 0.02), 0.15), (DVec3::new(x * 0.095, 1.28, 0.0), 0.125)]);
    }
    for turn in [turns()[0], turns()[2]] {
        let body = find(&shells.placed(turn), &shells.triangles).unwrap();
        assert_eq!(body.arms, Arms::Apart);
        let (error, joint) = worst(&body, &shells, &joints, turn);
        assert!(error < 0.05, "joint {joint} is off by {:.1} % of stature", 100.0 * error);
    }
}

#[test]
fn a_body_without_arms_is_refused() {
    let (shells, _) = standing(87.0, false);
    let refusal = find(&shells.placed(DMat3::IDENTITY), &shells.triangles).unwrap_err();
    assert!(refusal.reason.contains("looked for a standing person"), "{}", refusal.reason);
}

#[test]
fn a_floor_under_the_feet_is_left_out_in_any_turn() {
    for (down, arms) in [(45.0, Arms::Apart), (87.0, Arms::Hanging)] {
        let (mut shells, joints) = person(down);
        let feet = shells.points.len();
        shells.slab(DVec3::new(-0.35, -0.03, -0.25), DVec3::new(0.35, 0.004, 0.35));
        for turn in [turns()[0], turns()[1]] {
            let placed = shells.placed(turn);
            let body = find(&placed, &shells.triangles).unwrap();
            assert_eq!(body.arms, arms);
            let floor = body.floor.unwrap();
            assert!(placed[feet..].iter().all(|p| floor.holds(*p)));
            let highest = (0..feet).filter(|&v| floor.holds(placed[v])).map(|v| shells.points[v].y).fold(0.0, f64::max);
            assert!(highest < 0.03, "the floor takes the feet to a height of {highest} of 1.75");
            let (error, joint) = worst(&body, &shells, &joints, turn);
            assert!(error < 0.05, "joint {joint} is off by {:.1} % of stature", 100.0 * error);
        }
    }
}

#[test]
fn nothing_is_refused() {
    assert!(find(&[], &[]).is_err());
    assert!(find(&[DVec3::ZERO; 3], &[[0, 1, 2]]).is_err());
    assert!(find(&[DVec3::NAN; 3], &[[0, 1, 7]]).is_err());
}

#[test]
fn the_same_mesh_gives_the_same_bits() {
    let (shells, _) = person(25.0);
    let placed = shells.placed(turns()[1]);
    let [a, b] = [0, 1].map(|_| find(&placed, &shells.triangles).unwrap());
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
}
