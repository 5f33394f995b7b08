//! Table 2 of Xu et al. 2009, measured on our models: `scripts/joints_table.sh` prints it. Times are printed and never judged.

use crate::common;
use crate::corpus::{self, Found};
use crate::laws::{all, held, joint, rigid};
use glam::DVec3;
use retarget::binding::person::{self, Joints as Person};
use retarget::binding::rig::RigFile;
use retarget::capture::{self, Motion, ReadOptions};
use retarget::deform::joints::{Body, JointSpec, Joints, Model, Options, Part, Side, Violation};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::error::Notes;
use retarget::joints::Kind;
use retarget::linalg::SparseRow;
use retarget::pipeline::mechanism::drive::{self, Puppeteer, Stand};
use retarget::pipeline::mechanism::{Machine, feet, robot};
use retarget::scan::{self, UnitBox};
use retarget::surface::SurfaceMap;
use retarget::{binding, glam};
use std::time::Instant;

const FRAMES: usize = 40;

/// Milliseconds of a step, and of the update of the mesh in a frame.
struct Times {
    step: f64,
    map: f64,
}

/// Three handles on each part, which sways on its own: nothing of it is allowed, so that all joints are under load.
fn times(model: Model, rows: Vec<SparseRow>) -> Times {
    let mut handles = Vec::new();
    for (k, part) in model.parts().iter().enumerate() {
        let farthest = |from: DVec3| {
            let nearer = |p: &&DVec3, q: &&DVec3| p.distance_squared(from).total_cmp(&q.distance_squared(from));
            part.points.iter().max_by(nearer).copied().unwrap_or(from)
        };
        let first = farthest(part.points[0]);
        let second = farthest(first);
        for at in [first, second, farthest((first + second) * 0.5)] {
            handles.push(Handle { name: part.name.clone(), row: model.row(k, at), beta: 1.0 });
        }
    }
    let rest = held(&model, &handles);
    let map = SurfaceMap::of_rows(model.frames().rest.len(), rows);
    let mut body = Joints::new(model, &handles, &Options::default()).expect("a deformer");
    let sway = |f: usize, k: usize, p: DVec3| {
        let t = 0.1 * f as f64 + (k / 3) as f64;
        p + DVec3::new(t.sin(), (1.3 * t).cos(), (0.7 * t).sin()) * 0.01
    };
    let at = |f: usize| all(rest.iter().enumerate().map(|(k, &p)| sway(f, k, p)).collect());
    body.start(&at(0)).expect("solved");
    let (began, mut steps) = (Instant::now(), 0);
    for f in 1..FRAMES {
        steps += body.step(&at(f)).expect("solved").passes;
    }
    let step = began.elapsed().as_secs_f64() * 1e3 / f64::from(steps.max(1));
    let pose = body.pose();
    let mut out = vec![Vec::new(); 8];
    map.apply(&[pose; 8], &mut out);
    let began = Instant::now();
    for _ in 0..5 {
        map.apply(&[pose; 8], &mut out);
    }
    Times { step, map: began.elapsed().as_secs_f64() * 1e3 / 40.0 }
}

/// A model as it was found, all parts rigid.
fn model_of(found: &Found) -> Model {
    let unit_box = UnitBox::of(&found.scan.mesh).expect("an extent");
    let enter = |points: &[DVec3]| points.iter().map(|&p| unit_box.enter(p)).collect::<Vec<_>>();
    let parts = found.parts.iter().map(|p| rigid(&p.name, enter(&p.points))).collect();
    let spec = |j: &retarget::joints::Joint| JointSpec {
        name: String::new(),
        kind: j.kind,
        a: Side::Part(j.a),
        b: Side::Part(j.b),
        centre: unit_box.enter(j.centre),
        frame: j.frame,
        angle: j.angle,
        slide: j.slide.map(|(lo, hi)| (lo / unit_box.diagonal, hi / unit_box.diagonal)),
        cone: j.cone,
        region: None,
    };
    let joints: Vec<JointSpec> = found.joints.iter().filter(|j| !j.closes_loop).map(spec).collect();
    Model::new(parts, &[], &joints).expect("a model")
}

/// A row of parts along X with a hinge between each two.
fn row(count: usize, body: Body) -> (Model, Vec<SparseRow>) {
    let length = 1.0 / count as f64;
    let part = |k: usize| {
        let grid = |i: usize, n: usize| i as f64 / n as f64 - 0.5;
        let points = (0..=20).flat_map(|i| (0..=8).flat_map(move |j| (0..=8).map(move |l| [i, j, l])));
        let points = points
            .map(|[i, j, l]| DVec3::new((k as f64 + 0.5 + grid(i, 20)) * length - 0.5, 0.04 * grid(j, 8), 0.03 * grid(l, 8)));
        Part { body, ..rigid(&format!("part {k}"), points.collect()) }
    };
    let at = |k: usize| DVec3::X * (k as f64 * length - 0.5);
    let joints: Vec<JointSpec> = (1..count)
        .map(|k| joint("hinge", Kind::Revolute, k - 1, k, at(k), if k % 2 == 0 { DVec3::Y } else { DVec3::Z }))
        .collect();
    let model = Model::new((0..count).map(part).collect(), &[], &joints).expect("a model");
    let rows = (0..count).flat_map(|k| model.parts()[k].points.iter().map(|&p| model.row(k, p)).collect::<Vec<_>>()).collect();
    (model, rows)
}

fn line(name: &str, vertices: usize, model: &Model, joints: usize, score: &str, times: &Times) {
    let (cells, parts) = (model.cells(), model.parts().len());
    let Times { step, map } = times;
    eprintln!("{name:<22} {vertices:>9} {cells:>6} {parts:>6} {joints:>7} {score:>22} {step:>9.3} {map:>9.3}");
}

#[test]
fn table_2() {
    let head = ["model", "vertices", "cells", "parts", "joints", "right/touch/all, wrong", "ms/step", "ms/mesh"];
    let [a, b, c, d, e, f, g, h] = head;
    eprintln!("{a:<22} {b:>9} {c:>6} {d:>6} {e:>7} {f:>22} {g:>9} {h:>9}");
    for (name, file, truth) in corpus::models() {
        let found = corpus::find(&file);
        let score = corpus::score(&name, &truth, &found);
        let model = model_of(&found);
        let unit_box = UnitBox::of(&found.scan.mesh).expect("an extent");
        let rows = found
            .parts
            .iter()
            .enumerate()
            .flat_map(|(k, part)| part.points.iter().map(|&p| model.row(k, unit_box.enter(p))).collect::<Vec<_>>());
        let rows: Vec<SparseRow> = rows.collect();
        let vertices = rows.len();
        let times = times(model.clone(), rows);
        let joints = found.joints.iter().filter(|j| !j.closes_loop).count();
        let words = format!("{}/{}/{}, {}", score.right, score.touch, score.all, score.wrong_pairs);
        line(&name, vertices, &model, joints, &words, &times);
    }
    let soft = Body::Soft { cells: [5, 3, 2], stiffness: 1.0 };
    for (name, count, body) in [("30 rigid parts", 30, Body::Rigid), ("15 soft parts", 15, soft)] {
        let (model, rows) = row(count, body);
        let vertices = rows.len();
        let times = times(model.clone(), rows);
        assert_eq!(model.cells(), if body == Body::Rigid { 30 } else { 450 });
        line(name, vertices, &model, count - 1, "-", &times);
    }
}

/// Joints over a real take: a robot of 30 joints with limits boxes as a person does.
#[test]
fn joints_hold_over_a_real_take() {
    let (Some(cases), Some(takes)) = (corpus::folder("bench/joints_cases"), corpus::folder("data/motion/bvh")) else { return };
    let text = std::fs::read_to_string(cases.join("talos.rig.toml")).expect("a rig file");
    let (parts, binds) = (text.find("[[component]]").expect("components"), text.find("[[bind]]").expect("binds"));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("rig.toml");
    let space = "[space]\nscan_unit = \"m\"\nscan_up = \"+Z\"\n";
    std::fs::write(&path, format!("{space}{}", &text[parts..binds])).expect("a file");
    let rig = RigFile::read(&path).expect("a rig file");
    let scan = scan::read(&cases.join("talos_merged.obj")).expect("a mesh");
    let unit_box = UnitBox::of(&scan.mesh).expect("an extent");
    let capture = capture::read(&takes.join("optitrack_boxing_toes.bvh.gz"), &ReadOptions::default()).expect("a take");
    let Motion::Skeleton(take) = &capture.motion else { panic!("no skeleton") };
    let mut notes = Notes::default();
    let machine = Machine::new(&rig, &scan, unit_box, &mut notes).expect("parts");
    let options = binding::Options::default();
    let person = person::person(&capture, take, &options, &mut notes).expect("a person");
    let joints = Person::of(take, &options);
    let body = robot::robot(&machine, DVec3::Z, None).expect("a body");
    let drives = drive::drives(&person, &body, &|j| take.joints[j].name.clone());
    let frames = take.origins.frames();
    let front = drive::front(&joints, &person, frames).expect("a front");
    let [hip, knee, ankle] = body.legs[0].map(|spot| spot.1);
    let stand = Stand {
        axes: drive::axes(person.up.value.vector(), front, body.up, body.forward),
        scale: (hip.distance(knee) + knee.distance(ankle)) / person.leg,
        up: body.up,
        floor: body.floor,
    };
    let mut puppeteer = Puppeteer::new(joints, &drives, stand, &person, frames, capture.rate, true);
    let ground = feet::ground(&machine.model, &drives, &person, &stand);
    let model = machine.model.clone().over(ground);
    let handles = drive::handles(&machine, &drives);
    let solver = Options { tolerance: 2e-5, rate: capture.rate, ..Options::default() };
    let mut robot = Joints::new(model, &handles, &solver).expect("a deformer");
    let vertices: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let rows = machine.rows(&vertices);
    let (mut before, mut after) = (Violation::default(), Violation::default());
    let larger = |a: Violation, b: Violation| Violation {
        gap: a.gap.max(b.gap),
        axis: a.axis.max(b.axis),
        limit: a.limit.max(b.limit),
        slide: a.slide.max(b.slide),
    };
    let (mut jump, mut asked) = (0.0_f64, 0.0_f64);
    let mut told: Vec<DVec3> = Vec::new();
    let (mut steps, mut seconds, mut bend, mut lowest) = (0, 0.0, 0.0_f64, f64::INFINITY);
    let mut last: [Vec<DVec3>; 2] = [Vec::new(), Vec::new()];
    let mut places = Vec::new();
    for f in 0..frames {
        puppeteer.frame(f, &mut places);
        let targets = Targets { presence: vec![1.0; places.len()], positions: places.clone() };
        let began = Instant::now();
        let stats = if f == 0 { robot.start(&targets) } else { robot.step(&targets) }.expect("solved");
        let posed: Vec<DVec3> = rows.iter().step_by(3).map(|r| r.apply(robot.pose())).collect();
        if f > 0 {
            (steps, seconds) = (steps + stats.passes, seconds + began.elapsed().as_secs_f64());
            (before, after) = (larger(before, robot.violation()), larger(after, robot.remaining_violation()));
        }
        if f > 0 {
            let farthest = |p: &[DVec3], q: &[DVec3]| p.iter().zip(q).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
            jump = jump.max(farthest(&posed, &last[0]));
            asked = asked.max(farthest(&places, &told));
        }
        told.clone_from(&places);
        if f > 1 {
            let each = posed.iter().zip(&last[0]).zip(&last[1]).map(|((p, q), r)| (*p - *q * 2.0 + *r).length());
            bend = each.fold(bend, f64::max);
        }
        lowest = posed.iter().map(|p| p.z - body.floor).fold(lowest, f64::min);
        last = [posed, std::mem::take(&mut last[0])];
    }
    let mm = unit_box.diagonal * 1e3;
    eprintln!(
        "boxing, {frames} frames: {:.2} steps a frame, {:.3} ms each (with every third vertex) · before the snap {:.2} mm, {:.2}°, {:.2}° · after \
         {:.1e} mm, {:.1e}°, {:.1e}° · largest second difference {:.0} mm, move in a frame {:.0} mm where {:.0} mm are asked · lowest {:.1} mm under the ground",
        f64::from(steps) / (frames - 1) as f64,
        seconds * 1e3 / f64::from(steps),
        before.gap * mm,
        before.axis.to_degrees(),
        before.limit.to_degrees(),
        after.gap * mm,
        after.axis.to_degrees(),
        after.limit.to_degrees(),
        bend * mm,
        jump * mm,
        asked * mm,
        -lowest * mm
    );
    assert!(before.gap * mm < 2.0 && before.axis.to_degrees() < 1.0 && before.limit.to_degrees() < 1.0, "{before:?}");
    assert!(after.gap < 1e-9 && after.axis < 1e-9 && after.limit < 1e-9, "{after:?}");
    // The wrists of the actor bend by 73 mm at his scale; a limb that sticks to a limit and comes off makes 120.
    assert!(bend * mm < 80.0, "a limb jumps by {} mm", bend * mm);
    assert!(lowest * mm > -3.0, "a foot is {} mm under the ground", -lowest * mm);
}

/// A lamp that two handles on its shade lead where its joints can go: how far they stay behind.
#[test]
fn joints_follow_what_they_can_reach() {
    let folder = tempfile::tempdir().expect("a folder");
    let fixture = |name: &str| common::fixture(name).to_string_lossy().into_owned();
    let (lamp, take) = (fixture("lamp.obj"), fixture("lamp.csv"));
    common::retarget_ok(folder.path(), ["joints", &lamp, "-o", "lamp.toml"]);
    let said = common::retarget_ok(folder.path(), [&lamp, &take, "--rig", "lamp.toml", "-o", "lamp.pc2"]);
    // In units of the lamp, whose file says no unit: metres.
    let figure = |word: &str| -> f64 {
        let after = said.split(word).nth(1).and_then(|rest| rest.split_once(" units"));
        after.and_then(|(x, _)| x.parse().ok()).unwrap_or_else(|| panic!("no {word}in units in {said}"))
    };
    let (median, worst) = (figure("residual median "), figure(", worst "));
    eprintln!("lamp: handles are {:.2} mm off, median, and {:.2} mm at worst", median * 1e3, worst * 1e3);
    assert!(median < 1.5e-4 && worst < 1e-3, "median {median}, worst {worst}");
}
