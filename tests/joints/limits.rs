//! Limits and the ground push and never pull.

use crate::laws::{all, block, deformer, joint, markers, rigid, turn, worst};
use glam::{DQuat, DVec3};
use retarget::deform::Deformer;
use retarget::deform::joints::{Ground, JointSpec, Joints, Model, Options};
use retarget::glam;
use retarget::joints::Kind;

/// A frame that the joints allow is met this nearly.
const MET: f64 = 1e-6;
const CENTRE: DVec3 = DVec3::new(0.0, 0.0, 0.1);

/// A link on a base, asked to move against it; the misses, and whether what was asked is allowed.
fn follow(spec: JointSpec, asked: impl Fn(f64, DVec3) -> DVec3, allowed: impl Fn(f64) -> bool) -> Vec<(bool, f64)> {
    let parts = vec![
        rigid("base", block(DVec3::ZERO, DVec3::new(0.2, 0.2, 0.1))),
        rigid("link", block(DVec3::new(0.0, 0.0, 0.3), DVec3::new(0.05, 0.05, 0.2))),
    ];
    let (mut body, handles, rest) = deformer(parts, &[spec], markers);
    let mut out = Vec::new();
    for f in 0..=60 {
        // Out beyond the limit, slowly back, and away from it.
        let x = -0.4 + f64::from(f) * 0.02;
        let targets: Vec<DVec3> =
            rest.iter().enumerate().map(|(k, &p)| if k < 4 { p } else { asked(x, p - CENTRE) + CENTRE }).collect();
        let targets = all(targets);
        if f == 0 { body.start(&targets) } else { body.step(&targets) }.expect("solved");
        let after = body.remaining_violation();
        assert!(after.limit < 1e-9 && after.slide < 1e-9, "{x}: {after:?}");
        out.push((allowed(x), worst(&handles, body.pose(), &targets.positions)));
    }
    out
}

#[test]
fn a_limit_that_was_met_lets_go_without_a_jump() {
    let hinge = JointSpec { angle: Some((0.0, 2.0)), ..joint("hinge", Kind::Revolute, 0, 1, CENTRE, DVec3::X) };
    let slider = JointSpec { slide: Some((0.0, 1.0)), ..joint("slider", Kind::Prismatic, 0, 1, CENTRE, DVec3::Z) };
    let ball = JointSpec { cone: Some(0.3), ..joint("ball", Kind::Ball, 0, 1, CENTRE, DVec3::Z) };
    let about_x = |x: f64, p: DVec3| DQuat::from_rotation_x(x) * p;
    let inside = |x: f64| x > 0.0;
    for (name, frames) in [
        ("hinge", follow(hinge, about_x, inside)),
        ("slider", follow(slider, |x, p| p + DVec3::Z * 0.3 * x, inside)),
        ("ball", follow(ball, about_x, |x| x.abs() < 0.3)),
    ] {
        let beyond = frames.iter().filter(|f| !f.0).map(|f| f.1).fold(0.0, f64::max);
        assert!(beyond > 0.01, "{name}: nothing was asked of its limit");
        for (f, (_, miss)) in frames.iter().enumerate().filter(|(_, f)| f.0) {
            assert!(*miss < MET, "{name}, frame {f}: {miss} off, though the joint allows it");
        }
    }
}

#[test]
fn what_nothing_drives_neither_stays_behind_nor_slides_away() {
    for kind in [Kind::Plane, Kind::Prismatic, Kind::Cylinder, Kind::Revolute] {
        let parts = vec![
            rigid("base", block(DVec3::ZERO, DVec3::new(0.2, 0.2, 0.1))),
            rigid("link", block(DVec3::new(0.0, 0.0, 0.3), DVec3::new(0.05, 0.05, 0.2))),
        ];
        let link = parts[1].points.clone();
        let spec = joint("joint", kind, 0, 1, CENTRE, DVec3::Z);
        // Those of the base alone.
        let (mut body, _, rest) = deformer(parts.clone(), std::slice::from_ref(&spec), |model| markers(model)[..4].to_vec());
        let model = Model::new(parts, &[], &[spec]).expect("a model");
        let rows: Vec<_> = link.iter().map(|&p| model.row(1, p)).collect();
        for f in 0..=60 {
            let t = f64::from(f) / 60.0;
            let (q, shift) = (turn(2.0 * t), DVec3::new(1.0, -0.5, 2.0) * t);
            let targets = all(rest.iter().map(|&p| q * p + shift).collect());
            if f == 0 { body.start(&targets) } else { body.step(&targets) }.expect("solved");
            for (row, &p) in rows.iter().zip(&link) {
                let off = row.apply(body.pose()).distance(q * p + shift);
                // A turn that nothing drives lags by a hundredth, on a link that is 0.4 long. What slid would be up to 2.3 away.
                assert!(off < 0.03, "{kind:?}, frame {f}: {off} from where it was on the base");
            }
        }
    }
}

#[test]
fn soles_stand_on_the_ground_and_rise_from_it() {
    let ground = |points| Ground { up: DVec3::Z, height: -0.1, points };
    let foot = block(DVec3::ZERO, DVec3::new(0.2, 0.1, 0.1));
    let soles: Vec<(usize, DVec3)> = foot.iter().filter(|p| p.z < 0.0).map(|&p| (0, p)).collect();
    let model = Model::new(vec![rigid("foot", foot)], &[], &[]).expect("a model").over(ground(soles.clone()));
    let handles = markers(&model);
    let frames = model.frames().rest;
    let rest: Vec<DVec3> = handles.iter().map(|h| h.row.apply(&frames)).collect();
    let rows: Vec<_> = soles.iter().map(|&(part, p)| model.row(part, p)).collect();
    let mut body = Joints::new(model, &handles, &Options::default()).expect("a deformer");
    let mut lowest_asked: f64 = 0.0;
    for f in 0..40 {
        let t = 0.2 * f64::from(f);
        let q = turn(0.3 * t.sin());
        let asked = |p: DVec3| q * p + DVec3::new(0.0, 0.1 * t, 0.15 * (1.3 * t).sin());
        let targets = all(rest.iter().map(|&p| asked(p)).collect());
        if f == 0 { body.start(&targets) } else { body.step(&targets) }.expect("solved");
        let height = |r: &retarget::linalg::SparseRow| r.apply(body.pose()).z + 0.1;
        let lowest = rows.iter().map(height).fold(f64::INFINITY, f64::min);
        let wanted = soles.iter().map(|s| asked(s.1).z + 0.1).fold(f64::INFINITY, f64::min);
        lowest_asked = lowest_asked.min(wanted);
        assert!(lowest > -1e-12, "frame {f}: {lowest} below the ground");
        if wanted > 0.0 {
            assert!(worst(&handles, body.pose(), &targets.positions) < MET, "frame {f}: held down");
        } else {
            assert!(lowest < 1e-4, "frame {f}: floats at {lowest}");
        }
    }
    assert!(lowest_asked < -0.1, "nothing was asked of the ground");
}
