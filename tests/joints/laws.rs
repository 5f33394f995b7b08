//! Laws of the joint-aware deformer, on a chain, a machine with every type of joint, and soft parts. Lengths are those of the unit box.

use glam::{DMat3, DQuat, DVec3};
use retarget::deform::joints::{Body, Group, JointSpec, Joints, Model, Options, Part, Region, Side};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::glam;
use retarget::joints::Kind;

pub fn block(centre: DVec3, half: DVec3) -> Vec<DVec3> {
    let sign = |k: u32, bit: u32| if k & bit == 0 { -1.0 } else { 1.0 };
    (0..8).map(|k| centre + half * DVec3::new(sign(k, 1), sign(k, 2), sign(k, 4))).collect()
}

pub fn frame(x: DVec3) -> DMat3 {
    let z = x.any_orthonormal_vector();
    DMat3::from_cols(x, z.cross(x), z)
}

pub fn joint(name: &str, kind: Kind, a: usize, b: usize, centre: DVec3, x: DVec3) -> JointSpec {
    let (a, b) = (Side::Part(a), Side::Part(b));
    JointSpec { name: name.into(), kind, a, b, centre, frame: frame(x), angle: None, slide: None, cone: None, region: None }
}

pub fn rigid(name: &str, points: Vec<DVec3>) -> Part {
    Part { name: name.into(), points, body: Body::Rigid }
}

const LINKS: usize = 6;
const LINK: f64 = 1.0 / LINKS as f64;

/// Six links along X; turns about Y and Z in turn.
fn chain(angle: Option<(f64, f64)>) -> (Vec<Part>, Vec<JointSpec>) {
    let middle = |k: usize| DVec3::X * (LINK * (k as f64 + 0.5) - 0.5);
    let parts = (0..LINKS).map(|k| rigid(&format!("link {k}"), block(middle(k), DVec3::new(LINK / 2.0, 0.02, 0.02))));
    let joints = (1..LINKS).map(|k| {
        let axis = if k % 2 == 0 { DVec3::Y } else { DVec3::Z };
        let at = DVec3::X * (LINK * k as f64 - 0.5);
        JointSpec { angle, ..joint(&format!("joint {k}"), Kind::Revolute, k - 1, k, at, axis) }
    });
    (parts.collect(), joints.collect())
}

/// Parts around a base, one for every type of joint.
fn machine() -> (Vec<Part>, Vec<JointSpec>) {
    let kinds = [Kind::Revolute, Kind::Ball, Kind::Cylinder, Kind::Prismatic, Kind::Plane, Kind::Fixed];
    let mut parts = vec![rigid("base", block(DVec3::ZERO, DVec3::new(0.4, 0.1, 0.05)))];
    let mut joints = Vec::new();
    for (k, kind) in kinds.into_iter().enumerate() {
        let at = DVec3::new(-0.35 + 0.14 * k as f64, 0.05, 0.06);
        parts.push(rigid(kind.word(), block(at + DVec3::Z * 0.1, DVec3::new(0.02, 0.03, 0.1))));
        joints.push(joint(kind.word(), kind, 0, k + 1, at, DVec3::new(0.3, 1.0, 0.2).normalize()));
    }
    (parts, joints)
}

/// Four markers on every part.
pub fn markers(model: &Model) -> Vec<Handle> {
    let parts = model.parts().iter().enumerate();
    let of_part = |(k, part): (usize, &Part)| -> Vec<Handle> {
        let corners = [0, 3, 5, 6].map(|c| part.points[c]);
        corners.iter().map(|&p| Handle { name: part.name.clone(), row: model.row(k, p), beta: 1.0 }).collect()
    };
    parts.flat_map(of_part).collect()
}

pub fn held(model: &Model, handles: &[Handle]) -> Vec<DVec3> {
    let rest = model.frames().rest;
    handles.iter().map(|h| h.row.apply(&rest)).collect()
}

pub fn all(positions: Vec<DVec3>) -> Targets {
    Targets { presence: vec![1.0; positions.len()], positions }
}

pub fn deformer(
    parts: Vec<Part>,
    joints: &[JointSpec],
    handles: impl Fn(&Model) -> Vec<Handle>,
) -> (Joints, Vec<Handle>, Vec<DVec3>) {
    let model = Model::new(parts, &[], joints).expect("a model");
    let handles = handles(&model);
    let rest = held(&model, &handles);
    (Joints::new(model, &handles, &Options::default()).expect("a deformer"), handles, rest)
}

pub fn worst(handles: &[Handle], pose: &[DVec3], targets: &[DVec3]) -> f64 {
    handles
        .iter()
        .zip(targets)
        .map(|(h, t)| h.row.apply(pose).distance(*t))
        .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
}

pub fn turn(seed: f64) -> DQuat {
    DQuat::from_xyzw(seed.sin(), (2.0 * seed).cos(), (3.0 * seed).sin(), 0.8).normalize()
}

#[test]
fn rest_in_gives_rest_out() {
    for (parts, joints) in [chain(None), machine()] {
        let (mut body, _, rest) = deformer(parts, &joints, markers);
        let frames = body.model().frames().rest;
        for _ in 0..2 {
            body.start(&all(rest.clone())).expect("solved");
            assert!(body.pose().iter().zip(&frames).all(|(p, q)| p.distance(*q) < 1e-12));
            body.step(&all(rest.clone())).expect("solved");
            assert!(body.pose().iter().zip(&frames).all(|(p, q)| p.distance(*q) < 1e-12));
        }
    }
}

#[test]
fn handles_that_move_like_one_body_move_everything_so() {
    for (parts, joints) in [chain(Some((-1.0, 1.0))), machine()] {
        let (mut body, _, rest) = deformer(parts, &joints, markers);
        let (q, shift) = (turn(0.7), DVec3::new(0.3, -2.0, 1.0));
        body.start(&all(rest.iter().map(|p| q * *p + shift).collect())).expect("solved");
        let frames = body.model().frames().rest;
        let off = body
            .pose()
            .iter()
            .zip(&frames)
            .map(|(p, r)| p.distance(q * *r + shift))
            .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
        assert!(off < 1e-9, "{off}");
    }
}

#[test]
fn a_pose_that_the_joints_allow_is_met_and_its_image_under_a_motion_too() {
    let (parts, joints) = chain(None);
    let (mut body, handles, rest) = deformer(parts, &joints, markers);
    let angles = |f: usize, k: usize| 0.4 * ((f as f64) * 0.2 + k as f64).sin();
    let posed = |f: usize| -> Vec<DVec3> {
        // Links one after the other, each turned with those before it.
        let mut out = rest.clone();
        for k in (1..LINKS).rev() {
            let spec = &joints[k - 1];
            let q = DQuat::from_axis_angle(spec.frame.x_axis, angles(f, k));
            out[4 * k..].iter_mut().for_each(|p| *p = q * (*p - spec.centre) + spec.centre);
        }
        out
    };
    let (g, shift) = (turn(1.3), DVec3::new(-0.2, 0.1, 0.4));
    let (parts, _) = chain(None);
    let (mut image, ..) = deformer(parts, &joints, markers);
    let mut passes = 0;
    for f in 0..20 {
        let targets = posed(f);
        let moved: Vec<DVec3> = targets.iter().map(|p| g * *p + shift).collect();
        if f == 0 {
            // Parts with enough markers begin where these fit best.
            let began = body.start(&all(targets.clone())).expect("solved").passes;
            assert!(began < 15, "{began} steps");
            image.start(&all(moved)).expect("solved");
        } else {
            passes += body.step(&all(targets.clone())).expect("solved").passes;
            image.step(&all(moved)).expect("solved");
        }
        assert!(worst(&handles, body.pose(), &targets) < 1e-6, "frame {f}: {}", worst(&handles, body.pose(), &targets));
        let v = body.violation();
        assert!(v.gap < 1e-7 && v.axis < 2e-6, "{v:?}");
        let off = image
            .pose()
            .iter()
            .zip(body.pose())
            .map(|(p, q)| p.distance(g * *q + shift))
            .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
        assert!(off < 1e-7, "frame {f}: {off}");
    }
    assert!(f64::from(passes) / 19.0 < 4.5, "{passes} steps for 19 frames");
}

#[test]
fn limits_hold_however_far_the_handles_go() {
    let (parts, joints) = chain(Some((-0.5, 0.3)));
    let tip = |model: &Model| {
        let mut handles = markers(model);
        handles.truncate(4);
        handles.push(Handle { name: "tip".into(), row: model.row(LINKS - 1, DVec3::X * 0.5), beta: 1.0 });
        handles
    };
    let (mut body, _, rest) = deformer(parts, &joints, tip);
    for f in 0..30 {
        let angle = f as f64 * 0.1;
        let mut targets = rest.clone();
        targets[4] = DVec3::new(-0.4, 0.0, 0.0) + DVec3::new(0.8 * angle.cos(), 0.8 * angle.sin(), 0.3 * angle.sin());
        if f == 0 { body.start(&all(targets)) } else { body.step(&all(targets)) }.expect("solved");
        let before = body.violation();
        assert!(before.gap < 3e-3 && before.axis.to_degrees() < 2.0 && before.limit.to_degrees() < 1.0, "frame {f}: {before:?}");
        let after = body.remaining_violation();
        assert!(after.gap < 1e-12 && after.axis < 1e-11 && after.limit < 1e-11, "frame {f}: {after:?}");
    }
}

#[test]
fn joints_move_as_their_types_allow() {
    let (parts, joints) = machine();
    // The base is held so hard that nothing drags it along.
    let firm = |model: &Model| {
        let mut handles = markers(model);
        handles[..4].iter_mut().for_each(|h| h.beta = 1e4);
        handles
    };
    let (mut body, handles, rest) = deformer(parts, &joints, firm);
    body.start(&all(rest.clone())).expect("solved");
    // Every part but the base is asked for one and the same motion along and about the axis of the joints.
    let axis = joints[0].frame.x_axis;
    let mut asked = rest.clone();
    for (k, spec) in joints.iter().enumerate() {
        let q = DQuat::from_axis_angle(axis, 0.3);
        asked[4 * (k + 1)..4 * (k + 2)].iter_mut().for_each(|p| *p = q * (*p - spec.centre) + spec.centre + axis * 0.05);
    }
    // The base stays.
    for target in [all(asked.clone()), all(asked.clone())] {
        body.step(&target).expect("solved");
    }
    let rest_frames = body.model().frames().rest;
    let motion = |part: usize| {
        let v = body.model().variable(part, body.model().parts()[part].points[0]);
        let p = &body.pose()[4 * v..4 * v + 4];
        let r = &rest_frames[4 * v..4 * v + 4];
        let turn = DMat3::from_cols(p[1] - p[0], p[2] - p[0], p[3] - p[0])
            * DMat3::from_cols(r[1] - r[0], r[2] - r[0], r[3] - r[0]).inverse();
        (turn, p[0] - turn * r[0])
    };
    let base = motion(0);
    let relative = |part: usize, point: DVec3| {
        let (turn, shift) = motion(part);
        base.0.transpose() * (turn * point + shift - base.1) - point
    };
    let gap = |k: usize| relative(k + 1, joints[k].centre);
    let turned = |k: usize| DQuat::from_mat3(&(base.0.transpose() * motion(k + 1).0)).to_axis_angle();
    let [revolute, ball, cylinder, prismatic, plane, fixed] = [0, 1, 2, 3, 4, 5];
    assert!(gap(revolute).length() < 1e-9 && gap(ball).length() < 1e-9 && gap(fixed).length() < 1e-12);
    assert!((gap(cylinder).dot(axis) - 0.05).abs() < 2e-3, "a cylinder joint slides: {}", gap(cylinder).dot(axis));
    assert!((gap(cylinder) - axis * gap(cylinder).dot(axis)).length() < 1e-9);
    assert!(gap(prismatic).dot(axis) > 0.03 && turned(prismatic).1 < 1e-9);
    assert!((turned(revolute).1 - 0.3).abs() < 0.05 && (turned(cylinder).1 - 0.3).abs() < 0.01);
    assert!(turned(revolute).0.cross(axis).length() < 1e-6 && turned(cylinder).0.cross(axis).length() < 1e-6);
    assert!(gap(plane).dot(joints[plane].frame.z_axis).abs() < 1e-9);
    assert!(worst(&handles[..4], body.pose(), &asked[..4]) < 1e-3);
}

#[test]
fn fixed_parts_share_one_motion_and_a_permuted_model_moves_the_same() {
    let (parts, joints) = machine();
    let (body, ..) = deformer(parts.clone(), &joints, markers);
    assert_eq!(body.model().variables(), parts.len() - 1);
    let order = [3, 6, 0, 2, 5, 1, 4];
    let permuted: Vec<Part> = order.iter().map(|&k| parts[k].clone()).collect();
    let place = |k: usize| order.iter().position(|&o| o == k).expect("a permutation");
    let renamed: Vec<JointSpec> = joints
        .iter()
        .map(|j| match (j.a, j.b) {
            (Side::Part(a), Side::Part(b)) => JointSpec { a: Side::Part(place(a)), b: Side::Part(place(b)), ..j.clone() },
            _ => j.clone(),
        })
        .collect();
    // The markers in the order of the first model.
    let in_order = |model: &Model| -> Vec<Handle> {
        let all = markers(model);
        (0..parts.len()).flat_map(|k| all[4 * place(k)..4 * place(k) + 4].to_vec()).collect()
    };
    let (mut one, handles, rest) = deformer(parts.clone(), &joints, markers);
    let (mut other, renumbered, _) = deformer(permuted, &renamed, in_order);
    let targets: Vec<DVec3> = rest.iter().enumerate().map(|(k, p)| turn(0.2) * *p + DVec3::Z * 0.01 * (k as f64).sin()).collect();
    one.start(&all(targets.clone())).expect("solved");
    other.start(&all(targets)).expect("solved");
    let off = handles
        .iter()
        .zip(&renumbered)
        .map(|(a, b)| a.row.apply(one.pose()).distance(b.row.apply(other.pose())))
        .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
    assert!(off < 1e-9, "{off}");
}

#[test]
fn a_run_repeats_to_the_bit() {
    let run = || {
        let (parts, joints) = machine();
        let (mut body, _, rest) = deformer(parts, &joints, markers);
        let mut bits = Vec::new();
        for f in 0..6 {
            let targets: Vec<DVec3> = rest
                .iter()
                .enumerate()
                .map(|(k, p)| turn(0.1 * f as f64) * *p + DVec3::Y * 0.02 * ((k + f) as f64).sin())
                .collect();
            if f == 0 { body.start(&all(targets)) } else { body.step(&all(targets)) }.expect("solved");
            bits.extend(body.pose().iter().flat_map(|p| p.to_array().map(f64::to_bits)));
        }
        bits
    };
    assert_eq!(run(), run());
}

fn bar(cells: [u32; 3], stiffness: f64) -> Part {
    let grid = |n: usize, k: usize, size: f64| (k as f64 / n as f64 - 0.5) * size;
    let points = (0..=40).flat_map(|i| (0..=6).flat_map(move |j| (0..=6).map(move |k| (i, j, k))));
    let points = points.map(|(i, j, k)| DVec3::new(grid(40, i, 0.9), grid(6, j, 0.12), grid(6, k, 0.1)));
    Part { name: "bar".into(), points: points.collect(), body: Body::Soft { cells, stiffness } }
}

fn ends(model: &Model) -> Vec<Handle> {
    let at = |x: f64| [(x, 0.05, 0.04), (x, -0.05, 0.04), (x, 0.05, -0.04), (x, -0.05, -0.04)];
    let places = [at(-0.44), at(0.44)].concat();
    places.into_iter().map(|(x, y, z)| Handle { name: "end".into(), row: model.row(0, DVec3::new(x, y, z)), beta: 1.0 }).collect()
}

#[test]
fn a_soft_part_bends_between_its_ends_and_stretches_only_if_it_is_made_to() {
    let reach = |stiffness: f64| {
        let (mut body, handles, rest) = deformer(vec![bar([12, 2, 2], stiffness)], &[], ends);
        body.start(&all(rest.clone())).expect("solved");
        let pulled: Vec<DVec3> = rest.iter().map(|p| if p.x > 0.0 { *p + DVec3::X * 0.3 } else { *p }).collect();
        body.step(&all(pulled.clone())).expect("solved");
        worst(&handles, body.pose(), &pulled)
    };
    let (stiff, soft) = (reach(1.0), reach(0.01));
    assert!(stiff > 3.0 * soft && soft < 0.05, "misses: stiff {stiff}, soft {soft}");
    // Bent, the surface keeps to the cells: no vertex flies off, and every cell is rigid.
    let (mut body, _, rest) = deformer(vec![bar([12, 2, 2], 1.0)], &[], ends);
    body.start(&all(rest.clone())).expect("solved");
    for f in 1..=8 {
        let q = DQuat::from_rotation_z(f as f64 * 0.1);
        let bent: Vec<DVec3> = rest.iter().map(|p| if p.x > 0.0 { q * *p } else { *p }).collect();
        body.step(&all(bent)).expect("solved");
    }
    for frame in body.pose().chunks_exact(4) {
        let arms = DMat3::from_cols(frame[1] - frame[0], frame[2] - frame[0], frame[3] - frame[0]) * 10.0;
        let off = arms.transpose() * arms - DMat3::IDENTITY;
        assert!(off.to_cols_array().iter().all(|x| x.abs() < 1e-12) && arms.determinant() > 0.0);
    }
    let model = body.model();
    for p in [DVec3::new(0.1, 0.02, 0.03), DVec3::new(-0.4, 0.05, 0.0)] {
        let sum: f64 = model.row(0, p).values.iter().sum();
        assert!((sum - 1.0).abs() < 1e-12);
        assert!(model.row(0, p).apply(&model.frames().rest).distance(p) < 1e-12);
    }
}

#[test]
fn a_joint_within_one_part_lets_its_regions_turn_against_each_other() {
    // The ends of one bar are rigid, with a hinge between them, as the ears of a bunny on its head.
    let half = |name: &str, lo: f64, hi: f64| Group {
        name: name.into(),
        part: 0,
        regions: vec![Region { lo: DVec3::new(lo, -1.0, -1.0), hi: DVec3::new(hi, 1.0, 1.0) }],
    };
    let groups = [half("left", -1.0, 0.0), half("right", 0.0, 1.0)];
    let hinge = JointSpec { a: Side::Group(0), b: Side::Group(1), ..joint("hinge", Kind::Revolute, 0, 1, DVec3::ZERO, DVec3::Z) };
    let model = Model::new(vec![bar([8, 2, 2], 1.0)], &groups, &[hinge]).expect("a model");
    assert_eq!(model.variables(), 2);
    let handles = ends(&model);
    let rest = held(&model, &handles);
    let mut body = Joints::new(model, &handles, &Options::default()).expect("a deformer");
    let q = DQuat::from_rotation_z(1.0);
    let bent: Vec<DVec3> = rest.iter().map(|p| if p.x > 0.0 { q * *p } else { *p }).collect();
    body.start(&all(bent.clone())).expect("solved");
    assert!(worst(&handles, body.pose(), &bent) < 1e-6, "no strain across the border: {}", worst(&handles, body.pose(), &bent));
}

#[test]
fn regions_that_hang_on_the_same_one_come_apart_from_each_other_too() {
    // Two ears side by side on a head, all of one bar.
    let region = |name: &str, lo: [f64; 3], hi: [f64; 3]| Group {
        name: name.into(),
        part: 0,
        regions: vec![Region { lo: DVec3::from(lo), hi: DVec3::from(hi) }],
    };
    let groups = [
        region("head", [-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]),
        region("left", [-1.0, -1.0, 0.0], [0.0, 1.0, 1.0]),
        region("right", [0.0, -1.0, 0.0], [1.0, 1.0, 1.0]),
    ];
    let hinge = |name: &str, ear: usize, x: f64| JointSpec {
        a: Side::Group(0),
        b: Side::Group(ear),
        ..joint(name, Kind::Revolute, 0, 1, DVec3::X * x, DVec3::X)
    };
    let model =
        Model::new(vec![bar([8, 2, 2], 1.0)], &groups, &[hinge("left", 1, -0.2), hinge("right", 2, 0.2)]).expect("a model");
    let places = |z: f64| {
        [(-0.4, 0.04), (-0.4, -0.04), (-0.1, 0.04), (0.4, 0.04), (0.4, -0.04), (0.1, 0.04)].map(|(x, y)| DVec3::new(x, y, z))
    };
    // Where cells of one side alone tell what happens.
    let all_places = [places(-0.05), places(0.05)].concat();
    let handle = |p: &DVec3| {
        let mut handle = Handle { name: "at".into(), row: model.row(0, *p), beta: 1.0 };
        let variable = model.variable(0, *p);
        // Its variable's own point, not the blend of cells around it.
        let o = model.frames().rest[4 * variable];
        let arms = (*p - o) * 10.0;
        handle.row.indices = (0..4).map(|k| 4 * variable as u32 + k).collect();
        handle.row.values = vec![1.0 - arms.x - arms.y - arms.z, arms.x, arms.y, arms.z];
        handle
    };
    let handles: Vec<Handle> = all_places.iter().map(handle).collect();
    assert_eq!(model.variables(), 3);
    let asked = |p: &DVec3| {
        let angle = if p.z < 0.0 { 0.0 } else { 0.8 * p.x.signum() };
        DQuat::from_rotation_x(angle) * *p
    };
    let targets: Vec<DVec3> = all_places.iter().map(asked).collect();
    let mut body = Joints::new(model, &handles, &Options::default()).expect("a deformer");
    body.start(&all(targets.clone())).expect("solved");
    assert!(worst(&handles, body.pose(), &targets) < 1e-6, "strain between them: {}", worst(&handles, body.pose(), &targets));
}

#[test]
fn a_snake_without_limbs_follows_a_few_handles_within_its_cones() {
    const PIECES: usize = 10;
    let length = 1.0 / PIECES as f64;
    let at = |k: f64| DVec3::X * (length * k - 0.5);
    let parts: Vec<Part> = (0..PIECES)
        .map(|k| rigid(&format!("piece {k}"), block(at(k as f64 + 0.5), DVec3::new(0.4 * length, 0.03, 0.03))))
        .collect();
    let cone = 40.0_f64.to_radians();
    let joints: Vec<JointSpec> = (1..PIECES)
        .map(|k| JointSpec { cone: Some(cone), ..joint(&format!("ball {k}"), Kind::Ball, k - 1, k, at(k as f64), DVec3::X) })
        .collect();
    let few = |model: &Model| -> Vec<Handle> {
        [0, 2, 4, 7, 9].map(|k| Handle { name: format!("{k}"), row: model.row(k, at(k as f64 + 0.5)), beta: 1.0 }).to_vec()
    };
    let (mut body, handles, rest) = deformer(parts, &joints, few);
    for f in 0..60 {
        let t = f as f64 * 0.05;
        let wave = |p: &DVec3| DVec3::new(0.85 * p.x, 0.08 * (6.0 * p.x - t).sin(), 0.05 * (5.0 * p.x + t).cos());
        let targets: Vec<DVec3> = rest.iter().map(wave).collect();
        if f == 0 { body.start(&all(targets.clone())) } else { body.step(&all(targets.clone())) }.expect("solved");
        let (before, after) = (body.violation(), body.remaining_violation());
        assert!(before.gap < 1e-3 && before.limit.to_degrees() < 2.0, "frame {f}: {before:?}");
        assert!(after.gap < 1e-12 && after.limit < 1e-9, "frame {f}: {after:?}");
        assert!(worst(&handles, body.pose(), &targets) < 0.03, "frame {f}: {}", worst(&handles, body.pose(), &targets));
    }
}

/// How far from its target a handle of a chain may be while joints that few handles tell turn by up to 2° a frame, in diagonals.
const LAG: f64 = 1e-3;

#[test]
fn what_joints_can_do_is_met_while_they_move_though_few_handles_tell() {
    let (parts, joints) = chain(Some((-0.9, 0.9)));
    // Where a point of a link comes to when joints turn.
    let bent = |link: usize, p: DVec3, f: f64| {
        (1..=link).rev().fold(p, |p, k| {
            let axis = if k % 2 == 0 { DVec3::Y } else { DVec3::Z };
            let centre = DVec3::X * (LINK * k as f64 - 0.5);
            DQuat::from_axis_angle(axis, 0.4 * (0.08 * f + k as f64).sin() - 0.4 * (k as f64).sin()) * (p - centre) + centre
        })
    };
    let places: Vec<(usize, DVec3)> = (0..LINKS)
        .flat_map(|k| (0..if k == 0 { 4 } else { 1 }).map(move |c| (k, c)))
        .map(|(k, c)| (k, parts[k].points[[7, 4, 2, 1][c]]))
        .collect();
    let few = |model: &Model| -> Vec<Handle> {
        places.iter().map(|&(k, p)| Handle { name: format!("{k}"), row: model.row(k, p), beta: 1.0 }).collect()
    };
    let (mut body, handles, _) = deformer(parts.clone(), &joints, few);
    let mut furthest: f64 = 0.0;
    for f in 0..80 {
        let targets: Vec<DVec3> = places.iter().map(|&(k, p)| bent(k, p, f64::from(f))).collect();
        if f == 0 { body.start(&all(targets.clone())) } else { body.step(&all(targets.clone())) }.expect("solved");
        furthest = furthest.max(worst(&handles, body.pose(), &targets));
    }
    eprintln!("lag {furthest:.2e}");
    assert!(furthest < LAG, "lags by {furthest}");
}

#[test]
fn a_limb_that_passes_its_own_axis_does_not_snap_over() {
    // A turntable, and an arm on it that is lifted: where the arm points up its tip does not tell how the table is turned.
    let parts = vec![
        rigid("base", block(DVec3::ZERO, DVec3::new(0.2, 0.2, 0.1))),
        rigid("table", block(DVec3::Z * 0.12, DVec3::new(0.2, 0.05, 0.02))),
        rigid("arm", block(DVec3::Z * 0.34, DVec3::new(0.02, 0.02, 0.2))),
    ];
    let joints = [
        joint("turn", Kind::Revolute, 0, 1, DVec3::Z * 0.1, DVec3::Z),
        joint("lift", Kind::Revolute, 1, 2, DVec3::Z * 0.14, DVec3::Y),
    ];
    let tip = DVec3::Z * 0.54;
    let few = |model: &Model| -> Vec<Handle> {
        let mut handles: Vec<Handle> = markers(model).into_iter().take(4).collect();
        handles.push(Handle { name: "tip".into(), row: model.row(2, tip), beta: 1.0 });
        handles
    };
    let (mut body, _, rest) = deformer(parts, &joints, few);
    let (mut farthest, mut asked): (f64, f64) = (0.0, 0.0);
    let mut last: Option<(Vec<DVec3>, DVec3)> = None;
    for f in 0..120 {
        // From ahead over the top to the back, a little beside it.
        let lift = 1.0 - 2.0 * f64::from(f) / 119.0;
        let centre = DVec3::Z * 0.14;
        let mut targets = rest.clone();
        targets[4] = centre + DQuat::from_rotation_x(0.02) * DQuat::from_rotation_y(lift) * (tip - centre);
        if f == 0 { body.start(&all(targets.clone())) } else { body.step(&all(targets.clone())) }.expect("solved");
        if let Some((pose, at)) = &last {
            let moved = body.pose().iter().zip(pose).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
            (farthest, asked) = (farthest.max(moved), asked.max(targets[4].distance(*at)));
        }
        last = Some((body.pose().to_vec(), targets[4]));
    }
    assert!(farthest < 1.5 * asked, "moves by {farthest} where {asked} is asked");
}

#[test]
fn missing_handles_leave_the_pose_and_a_jump_is_survived() {
    let (parts, joints) = chain(Some((-1.0, 1.0)));
    let (mut body, handles, rest) = deformer(parts, &joints, markers);
    body.start(&all(rest.clone())).expect("solved");
    let pose = body.pose().to_vec();
    let none = Targets { positions: vec![DVec3::NAN; rest.len()], presence: vec![0.0; rest.len()] };
    body.step(&none).expect("held");
    assert_eq!(body.pose(), pose);
    let far: Vec<DVec3> = rest.iter().map(|p| DQuat::from_rotation_z(3.0) * *p + DVec3::new(4.0, 0.0, 1.0)).collect();
    body.step(&all(far.clone())).expect("solved");
    assert!(worst(&handles, body.pose(), &far) < 1e-5, "{}", worst(&handles, body.pose(), &far));
}

#[test]
fn what_cannot_be_used_is_refused_in_words() {
    let (parts, joints) = chain(None);
    let model = |joints: &[JointSpec]| Model::new(parts.clone(), &[], joints).map(|_| ()).expect_err("refused").to_string();
    let with = |change: &dyn Fn(&mut JointSpec)| {
        let mut joints = joints.clone();
        change(&mut joints[1]);
        joints
    };
    assert!(model(&with(&|j| j.angle = Some((1.0, -1.0)))).contains("joint 2"));
    assert!(model(&with(&|j| j.centre.x = f64::NAN)).contains("joint 2"));
    assert!(model(&with(&|j| j.frame.x_axis = DVec3::ZERO)).contains("joint 2"));
    assert!(model(&with(&|j| j.b = j.a)).contains("joint 2"));
    let whole = Model::new(parts.clone(), &[], &joints).expect("a model");
    assert!(Joints::new(whole.clone(), &[], &Options::default()).is_err());
    let handles = markers(&whole);
    let mut body = Joints::new(whole, &handles, &Options::default()).expect("a deformer");
    assert!(body.start(&all(vec![DVec3::NAN; handles.len()])).is_err());
    assert!(body.start(&all(vec![DVec3::ZERO; 3])).is_err());
}
