//! The main job for things made of parts: a rig file with components or joints, and a capture that drives them.

use super::args::{Align, Animate, Map, Plant, Reference};
use super::captures::{Captures, is_table, read_captures, resample};
use super::console::Console;
use super::decisions::{capture_line, cut, file_name, scan_line};
use super::rig::Rig;
use super::setup::{Clock, Setup, warn};
use super::shells::Examples;
use crate::binding::person::{self, Joints as PersonJoints, Person};
use crate::binding::rig::RigFile;
use crate::binding::rig::mechanism::{BindKind, FromSection};
use crate::binding::{self, Binding, BoundMarker, Decisions, Regions, Similarity, Turning};
use crate::capture::{Capture, MarkerTake, Motion, SkeletonTake, smooth};
use crate::deform::joints::{Joints, Options, Weights};
use crate::deform::{Deformer, Handle};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::Cancel;
use crate::pipeline;
use crate::pipeline::mechanism::drive::{self, Drive, Puppeteer, Stand};
use crate::pipeline::mechanism::{Machine, robot};
use crate::scan::{self, Scan, UnitBox};
use crate::space::{Evidence, Known, Unit};
use crate::spatial::TriangleTree;
use crate::surface::SurfaceMap;
use crate::words;
use glam::{DQuat, DVec3};
use std::sync::Arc;
use std::time::Instant;

/// Whether the rig file speaks of parts and joints.
pub(super) fn applies(args: &Animate) -> Result<bool> {
    match &args.rig {
        Some(path) => RigFile::read(path).map(|rig| !rig.joints.is_empty() || !rig.components.is_empty()),
        None => Ok(false),
    }
}

/// Sets up everything before the first frame.
pub(super) fn set_up(args: &Animate, console: &Console, cancel: &Cancel, start: Instant) -> Result<Setup> {
    let mut clock = Clock::new(start);
    let mut warnings = Vec::new();
    let rig = Rig::read(args)?;
    let (scan, captures) = rayon::join(|| scan::read(&args.scan), || read_captures(args, &rig));
    let (scan, mut captures) = (scan?, captures?);
    clock.lap("read");
    cancel.check()?;
    if let Some(hertz) = args.smooth {
        let capture = &mut captures.capture;
        smooth::low_pass(&mut capture.motion, capture.rate, hertz).map_err(|e| e.file(&args.capture))?;
    }
    let range = pipeline::select(captures.capture.first_frame, captures.frames(), args.frames)?;
    let unit_box = UnitBox::of(&scan.mesh).ok_or_else(|| Error::malformed("the mesh has no extent").file(&args.scan))?;
    let mut notes = Notes::default();
    let file = rig.file();
    if file.mesh.vertices.is_some_and(|v| v != scan.mesh.positions.len()) {
        notes.warn(format!(
            "the rig file was made for a mesh of {} vertices, this one has {}",
            words::count(file.mesh.vertices.unwrap_or(0)),
            words::count(scan.mesh.positions.len())
        ));
    }
    let machine = Machine::new(file, &scan, unit_box, &mut notes).map_err(|e| in_rig(e, args))?;
    let options = rig.options(args, &scan, unit_box, &mut notes)?;
    let stage = Stage { args, file, scan: &scan, unit_box, machine: &machine, options: &options };
    let driven = match &captures.capture.motion {
        Motion::Skeleton(take) if !is_table(&args.capture) => stage.skeleton(&captures, take, &mut notes),
        _ => stage.points(&captures, &mut notes),
    };
    let Driven { handles, mut binding, words: bind_words } =
        driven.map_err(|e| if e.file.is_none() { e.file(&args.capture) } else { e })?;
    let mut capture = captures.capture;
    console.station("scan", &scan_line(args, &scan, &binding));
    console.station(
        "capture",
        &match captures.tables.first().filter(|_| is_table(&args.capture)) {
            Some(table) => format!(
                "{}  {}, {} at {} Hz",
                file_name(&args.capture),
                words::plural(table.names.len(), "handle"),
                words::plural(table.frames(), "frame"),
                words::digits(capture.rate)
            ),
            None => capture_line(args, &capture, &binding),
        },
    );
    console.station("bind", &bind_words);
    warn(console, &mut warnings, &scan.notes);
    warn(console, &mut warnings, &capture.notes);
    warn(console, &mut warnings, &cut(args, &capture, &range));
    warn(console, &mut warnings, &notes);
    let range = resample(args, &mut capture, &mut binding, range)?;

    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let proxy = machine.model.frames();
    let map = SurfaceMap::of_rows(proxy.rest.len(), machine.rows(&points));
    let solver = solver_options(args, file);
    let (parts, joints, model) = (machine.model.parts().len(), machine.joints.len(), machine.model.clone());
    let deformer = Joints::new(model, &handles, &solver).map_err(|e| in_rig(e, args))?;
    let loops = match deformer.loops() {
        0 => String::new(),
        n => format!(" · {} closed, kept as well as they can be", words::plural(n, "loop")),
    };
    console.station(
        "parts",
        &format!(
            "{} · {} · {} in {}{loops}",
            words::plural(parts, "part"),
            words::plural(joints, "joint"),
            words::plural(machine.model.cells(), "cell"),
            words::plural(machine.model.variables(), "rigid motion")
        ),
    );
    clock.lap("parts, joints and map");
    cancel.check()?;
    Ok(Setup {
        scan: Arc::new(scan),
        capture,
        range,
        unit_box,
        binding,
        proxy: Arc::new(proxy),
        map: Arc::new(map),
        handles,
        oriented: Vec::new(),
        regions: Regions::default(),
        deformer: Box::new(deformer) as Box<dyn Deformer>,
        examples: Examples::default(),
        solve: format!("joints, {} steps per frame at most", solver.iterations),
        clock,
        repairs: serde_json::Value::Array(Vec::new()),
        warnings,
        start,
    })
}

fn in_rig(error: Error, args: &Animate) -> Error {
    match (&error.file, &args.rig) {
        (None, Some(path)) => error.file(path),
        _ => error,
    }
}

fn solver_options(args: &Animate, file: &RigFile) -> Options {
    let said = &file.solver;
    let usual = Weights::default();
    Options {
        weights: Weights {
            joint: said.weights.joint.unwrap_or(usual.joint),
            limit: said.weights.limit.unwrap_or(usual.limit),
            strain: said.weights.strain.unwrap_or(usual.strain),
            position: said.weights.pos.unwrap_or(usual.position),
        },
        tolerance: args.quality.tolerance() * 20.0,
        iterations: args.iterations.or(said.iterations).unwrap_or(Options::default().iterations),
        hold: said.hold,
        snap: said.snap.unwrap_or(true),
    }
}

/// What drives the machine, and how that is said.
struct Driven {
    handles: Vec<Handle>,
    binding: Binding,
    words: String,
}

/// Everything that is known before the capture is looked at.
struct Stage<'a> {
    args: &'a Animate,
    file: &'a RigFile,
    scan: &'a Scan,
    unit_box: UnitBox,
    machine: &'a Machine,
    options: &'a binding::Options,
}

impl Stage<'_> {
    fn up(&self) -> Known<DVec3> {
        let said = self.options.scan_up.map(|up| Known::new(up.vector(), Evidence::User));
        let of_file = self.scan.space.up.map(|up| Known::new(up.value.vector(), up.how));
        said.or(of_file).unwrap_or(Known::new(DVec3::Z, Evidence::Default))
    }

    fn unit(&self) -> Option<Known<Unit>> {
        self.options.scan_unit.map(|u| Known::new(u, Evidence::User)).or(self.scan.space.unit)
    }

    /// Degrees about up that the user turns the capture by.
    fn turn(&self) -> f64 {
        self.options.yaw.unwrap_or(0.0) + if self.options.flip { 180.0 } else { 0.0 }
    }

    /// A skeleton: by the binds of the file, or by who is who.
    fn skeleton(&self, captures: &Captures, take: &SkeletonTake, notes: &mut Notes) -> Result<Driven> {
        let capture = &captures.capture;
        let person = person::person(capture, take, self.options, notes)?;
        let joints = PersonJoints::of(take, self.options);
        let frames = take.origins.frames();
        let up = self.up().value;
        let said_forward = self.file.space.scan_forward.as_ref().map(|f| f.0.vector());
        let body = robot::robot(self.machine, up, said_forward);
        let name = |joint: usize| take.joints[joint].name.clone();
        let told: Vec<_> = self.file.binds.iter().filter(|b| matches!(b.from, FromSection::Joint(_))).collect();
        let drives = if told.is_empty() {
            let body = body.as_ref().map_err(|lack| {
                Error::refused(format!("the parts and joints are not those of a body with arms and legs: {lack}"))
                    .expected("a pelvis with two legs, a chest with two arms, joined by joints of the rig file; up as [space] says")
                    .hint("[[bind]] in the rig file: from = { joint = \"LeftKnee\" }, to = { component = \"shank\", point = [x, y, z] }")
            })?;
            drive::drives(&person, body, &name)
        } else {
            self.told(take)?
        };
        let forward = body.as_ref().map(|b| b.forward).ok().or(said_forward).unwrap_or_else(|| up.any_orthonormal_vector());
        let front = drive::front(&joints, &person, frames).unwrap_or_else(|| person.up.value.vector().any_orthonormal_vector());
        let turn = self.turn();
        let axes = DQuat::from_axis_angle(up, turn.to_radians()) * drive::axes(person.up.value.vector(), front, up, forward);
        let leg = leg_of(&drives, &person).or(body.as_ref().ok().map(|b| length(b.legs[0]))).ok_or_else(|| {
            Error::refused("no leg of the machine is driven: its size against the actor is not known").hint("--scale X")
        });
        let scale = match self.options.scale {
            // Both in metres.
            Some(scale) => {
                scale * person.unit.map_or(1.0, |u| u.value.metres())
                    / (self.unit().map_or(1.0, |u| u.value.metres()) * self.unit_box.diagonal)
            }
            None => leg? / person.leg,
        };
        let floor = self.machine.model.parts().iter().flat_map(|p| &p.points).map(|p| p.dot(up)).fold(f64::INFINITY, f64::min);
        let stand = Stand { axes, scale, up, floor };
        let plant = self.args.plant == Plant::Auto;
        let mut puppeteer = Puppeteer::new(joints, &drives, stand, &person, frames, capture.rate, plant);
        let handles = drive::handles(self.machine, &drives);
        let mut take = MarkerTake { labels: handles.iter().map(|h| h.name.clone()).collect(), ..MarkerTake::default() };
        let mut places = Vec::new();
        for frame in 0..frames {
            puppeteer.frame(frame, &mut places);
            take.points.extend(places.iter().map(|p| p.to_array().map(|x| x as f32)));
        }
        let metres = |unit: Option<Known<Unit>>| unit.map_or(1.0, |u| u.value.metres());
        let factor = scale * self.unit_box.diagonal * metres(self.unit()) / metres(person.unit);
        let map = drives.iter().map(|d| self.says(d)).collect::<Vec<_>>().join(", ");
        let how = if told.is_empty() { "by the body" } else { "by the rig file" };
        let words = format!("bone by bone, {how} · scale {factor:.3} · {map}");
        let mut decisions = self.decisions(captures, "joint", handles.len());
        decisions.scale = factor;
        decisions.yaw = turn;
        decisions.capture_unit = person.unit;
        decisions.capture_up = Some(person.up);
        decisions.scan_forward = Some(Known::new(forward, Evidence::Shape));
        Ok(Driven { binding: self.binding(decisions, &handles, take), handles, words })
    }

    fn says(&self, drive: &Drive) -> String {
        let part = &self.machine.model.parts()[drive.spot.0].name;
        format!("{}{} → {part}", drive.name, if drive.turns { " (turn)" } else { "" })
    }

    /// The drives that the file says.
    fn told(&self, take: &SkeletonTake) -> Result<Vec<Drive>> {
        let index = |name: &str| {
            take.joints.iter().position(|j| j.name == name).ok_or_else(|| {
                let names: Vec<&str> = take.joints.iter().take(12).map(|j| j.name.as_str()).collect();
                Error::malformed(format!("[[bind]] from joint {name}: the capture has none of that name"))
                    .expected(format!("one of {}, …", names.join(", ")))
            })
        };
        let mut drives: Vec<Drive> = Vec::new();
        for bind in &self.file.binds {
            let FromSection::Joint(name) = &bind.from else { continue };
            let part = self.part(&bind.to.component)?;
            let place = bind.to.point.map_or(DVec3::ZERO, |p| self.unit_box.enter(p.into()));
            let joint = index(name)?;
            let turns = bind.kind == BindKind::Orientation;
            drives.push(Drive {
                joint,
                name: name.clone(),
                spot: (part, place),
                parent: None,
                weight: bind.weight.unwrap_or(1.0),
                turns,
            });
        }
        let binds = self.file.binds.iter().filter(|b| matches!(b.from, FromSection::Joint(_)));
        for (k, bind) in binds.enumerate() {
            let Some(parent) = &bind.parent else { continue };
            // The targets are made in the file's order.
            let found = drives[..k].iter().position(|d| d.name == *parent && !d.turns).ok_or_else(|| {
                Error::malformed(format!("[[bind]] from {}: no bind before it is from its parent {parent}", drives[k].name))
                    .expected("the bind of the parent first")
            })?;
            drives[k].parent = Some(found);
        }
        Ok(drives)
    }

    fn part(&self, name: &str) -> Result<usize> {
        let name = name.split_once('/').map_or(name, |n| n.0);
        self.machine.part(name).ok_or_else(|| Error::malformed(format!("there is no component {name}")).at("[[bind]]"))
    }

    /// Markers and handles of tables: where the file binds them, or where they lie on the parts in the first frame.
    fn points(&self, captures: &Captures, notes: &mut Notes) -> Result<Driven> {
        let table = captures.tables.first().filter(|_| is_table(&self.args.capture));
        let capture = &captures.capture;
        let markers = capture.motion.points();
        let (labels, frames): (&[String], usize) = match table {
            Some(table) => (&table.names, table.frames()),
            None => (&markers.labels, markers.frames()),
        };
        let told: Vec<(usize, DVec3, f64, usize)> = self.bound_markers(labels, notes)?;
        let raw = |frame: usize, marker: usize| match table {
            Some(table) => Some(table.points[frame * labels.len() + marker]).filter(|p| p.is_finite()),
            None => markers.point(frame, marker),
        };
        let in_scan = table.is_some() || self.args.align == Align::None;
        self.check_sides(in_scan, notes)?;
        let factor = if table.is_some() { 1.0 } else { self.factor(capture) };
        let space = (!in_scan).then(|| self.space(capture, &told, &raw, frames, factor));
        let place = |frame: usize, marker: usize| {
            let p = raw(frame, marker)?;
            Some(match space {
                Some((axes, scale)) => axes * p * scale,
                None => self.unit_box.enter(p * factor),
            })
        };
        let mut chosen = told;
        if chosen.is_empty() {
            if !in_scan {
                return Err(Error::refused("no [[bind]] says which marker sits on which component")
                    .expected("[[bind]] with from = { marker = \"NAME\" }, to = { component = \"NAME\", point = [x, y, z] }")
                    .hint("--align none where the markers lie on the parts of the mesh in their first frame"));
            }
            chosen = self.lying(labels, frames, &place, notes)?;
        }
        let handles: Vec<Handle> = chosen
            .iter()
            .map(|&(part, at, weight, marker)| Handle {
                name: labels[marker].clone(),
                row: self.machine.model.row(part, at),
                beta: weight,
            })
            .collect();
        let mut take = MarkerTake { labels: handles.iter().map(|h| h.name.clone()).collect(), ..MarkerTake::default() };
        for frame in 0..frames {
            let points = chosen.iter().map(|c| place(frame, c.3).unwrap_or(DVec3::NAN));
            take.points.extend(points.map(|p| p.to_array().map(|x| x as f32)));
        }
        let mut parts: Vec<usize> = chosen.iter().map(|c| c.0).collect();
        parts.sort_unstable();
        parts.dedup();
        let noun = if table.is_some() { "handle" } else { "marker" };
        let words = format!("{} on {}", words::plural(handles.len(), noun), words::plural(parts.len(), "part"));
        let mut decisions = self.decisions(captures, noun, handles.len());
        decisions.reference_frame = table.map_or(capture.first_frame, |t| t.first_frame);
        decisions.yaw = if in_scan { 0.0 } else { self.turn() };
        Ok(Driven { binding: self.binding(decisions, &handles, take), handles, words })
    }

    /// Part, place, weight and index of the markers that the file binds.
    fn bound_markers(&self, labels: &[String], notes: &mut Notes) -> Result<Vec<(usize, DVec3, f64, usize)>> {
        let mut told = Vec::new();
        let mut missing = Vec::new();
        for bind in &self.file.binds {
            let (FromSection::Marker(name), Some(point)) = (&bind.from, bind.to.point) else { continue };
            let part = self.part(&bind.to.component)?;
            match labels.iter().position(|l| l == name) {
                Some(marker) => told.push((part, self.unit_box.enter(point.into()), bind.weight.unwrap_or(1.0), marker)),
                None => missing.push(name.as_str()),
            }
        }
        if !missing.is_empty() {
            if told.is_empty() {
                return Err(Error::refused(format!(
                    "the capture has none of the markers that the rig file binds ({}, …)",
                    missing[0]
                ))
                .expected(labels.iter().take(12).cloned().collect::<Vec<_>>().join(", ")));
            }
            notes.warn(format!(
                "{} of the rig file not in the capture: {}",
                words::plural(missing.len(), "marker"),
                missing.join(", ")
            ));
        }
        Ok(told)
    }

    /// What turns and sides cannot do to markers and handles: refused from the command line, a warning from the rig file.
    fn check_sides(&self, in_scan: bool, notes: &mut Notes) -> Result<()> {
        let (args, options) = (self.args, self.options);
        let without = [
            ("--mirror", args.mirror, options.mirror),
            ("--swap-sides", args.swap_sides, options.swap_sides),
            ("--flip", args.flip && in_scan, options.flip && in_scan),
        ];
        if let Some((option, ..)) = without.iter().find(|o| o.1) {
            return Err(Error::new(Kind::Usage, format!("{option} has no effect on these markers"))
                .expected("markers where they are on the parts; sides are told apart in skeletons alone"));
        }
        let lies = [("--yaw", options.yaw.is_some() && in_scan), ("--capture-up", options.capture_up.is_some() && in_scan)];
        let ignored: Vec<&str> = without.iter().map(|o| (o.0, o.2)).chain(lies).filter(|o| o.1).map(|o| o.0).collect();
        if !ignored.is_empty() {
            let why = if in_scan { "the capture is taken as it lies on the mesh" } else { "markers have no sides" };
            notes.warn(format!("{} not used: {why}", ignored.join(" and ")));
        }
        Ok(())
    }

    /// Scan units per unit of a marker capture, times `--scale`.
    fn factor(&self, capture: &Capture) -> f64 {
        let of_capture = self.options.capture_unit.or(capture.space.unit.map(|u| u.value));
        let units = of_capture.zip(self.unit()).map_or(1.0, |(c, s)| c.metres() / s.value.metres());
        self.options.scale.unwrap_or(1.0) * units
    }

    /// Turn and scale of a marker capture: axes by up, lengths by the distances of markers on one part, or by `factor`.
    fn space(
        &self,
        capture: &Capture,
        told: &[(usize, DVec3, f64, usize)],
        raw: &dyn Fn(usize, usize) -> Option<DVec3>,
        frames: usize,
        factor: f64,
    ) -> (DQuat, f64) {
        let up = self.options.capture_up.or(capture.space.up.map(|up| up.value)).map_or(DVec3::Z, |up| up.vector());
        let turn = DQuat::from_axis_angle(self.up().value, self.turn().to_radians());
        let axes = turn * DQuat::from_rotation_arc(up, self.up().value);
        let mut ratios = Vec::new();
        for (k, a) in told.iter().enumerate() {
            for b in told[..k].iter().filter(|b| b.0 == a.0) {
                let apart = a.1.distance(b.1);
                let seen = (0..frames.min(200)).find_map(|f| Some(raw(f, a.3)?.distance(raw(f, b.3)?)));
                ratios.extend(seen.filter(|s| *s > 0.0 && apart > 1e-6).map(|s| apart / s));
            }
        }
        ratios.sort_by(f64::total_cmp);
        let by_distances = ratios.get(ratios.len() / 2).copied().filter(|_| self.options.scale.is_none());
        (axes, by_distances.unwrap_or(factor / self.unit_box.diagonal))
    }

    /// Markers on the parts that are nearest to where they are in the first frame. One that comes later is left out: its part has moved by then.
    fn lying(
        &self,
        labels: &[String],
        frames: usize,
        place: &dyn Fn(usize, usize) -> Option<DVec3>,
        notes: &mut Notes,
    ) -> Result<Vec<(usize, DVec3, f64, usize)>> {
        const FAR: f64 = 0.1;
        let points: Vec<DVec3> = self.scan.mesh.positions.iter().map(|&p| self.unit_box.enter(p)).collect();
        let triangles = self.scan.mesh.vertex_triangles();
        let tree = TriangleTree::new(&points, &triangles);
        let mut lying = Vec::new();
        let mut late = Vec::new();
        for (marker, label) in labels.iter().enumerate() {
            let Some(at) = (frames > 0).then(|| place(0, marker)).flatten() else {
                late.push(label.as_str());
                continue;
            };
            let Some(near) = tree.closest(at) else { continue };
            if near.distance > FAR {
                return Err(Error::refused(format!(
                    "{label} begins {:.0} % of the diagonal away from the mesh",
                    100.0 * near.distance
                ))
                .expected("markers in the mesh's own space, on its parts in the first frame"));
            }
            let part = self.machine.part_of_vertex[triangles[near.triangle][0] as usize] as usize;
            lying.push((part, at, 1.0, marker));
        }
        if lying.is_empty() {
            return Err(Error::refused("no marker has a place in the first frame")
                .expected("markers on the parts in the first frame, or [[bind]] in the rig file"));
        }
        if !late.is_empty() {
            notes.warn(format!(
                "{} not in the first frame and so on no part: {}; [[bind]] in the rig file says where they are",
                words::plural(late.len(), "marker"),
                late.join(", ")
            ));
        }
        Ok(lying)
    }

    fn decisions(&self, captures: &Captures, noun: &'static str, count: usize) -> Decisions {
        let capture = &captures.capture;
        let first = capture.first_frame;
        Decisions {
            align: binding::Align::Retarget,
            noun,
            on_skin: false,
            reference_frame: first,
            reference_range: (first, first + captures.frames() as i64 - 1),
            reference_capture: None,
            reference_rest: false,
            scale: 1.0,
            yaw: 0.0,
            scan_unit: self.unit(),
            scan_up: Some(self.up()),
            scan_forward: None,
            scan_height: None,
            capture_unit: capture.space.unit,
            capture_up: capture.space.up,
            actor_height: None,
            set: None,
            named: count,
            markers: count,
            bound: count,
            off_surface: None,
            residual: None,
            proportions: Vec::new(),
            strain: None,
            feet: None,
        }
    }

    fn binding(&self, decisions: Decisions, handles: &[Handle], take: MarkerTake) -> Binding {
        let rest = self.machine.model.frames().rest;
        let bound = handles.iter().enumerate().map(|(marker, handle)| BoundMarker {
            label: handle.name.clone(),
            marker,
            attachment: handle.row.apply(&rest),
            segment: None,
            beta: handle.beta,
        });
        Binding {
            placement: Similarity::IDENTITY,
            handles: bound.collect(),
            unbound: Vec::new(),
            segments: Vec::new(),
            trajectories: Some(take),
            turning: Turning::default(),
            decisions,
            frozen: None,
            notes: Notes::default(),
        }
    }
}

fn length(limb: [(usize, DVec3); 3]) -> f64 {
    limb[0].1.distance(limb[1].1) + limb[1].1.distance(limb[2].1)
}

/// Length of the driven leg on the machine, in the unit box.
fn leg_of(drives: &[Drive], person: &Person) -> Option<f64> {
    let spot = |joint: usize| drives.iter().find(|d| d.joint == joint && !d.turns).map(|d| d.spot);
    person.legs.iter().find_map(|&[hip, knee, ankle]| Some(length([spot(hip)?, spot(knee)?, spot(ankle)?])))
}

/// Options of the main job that mean nothing here.
pub(super) fn not_used(args: &Animate) -> Result<()> {
    let given = [
        (args.shells.are_chosen().unwrap_or(true), "--method shells, --examples"),
        (args.proxy.is_some(), "--proxy"),
        (args.save_proxy.is_some(), "--save-proxy"),
        (args.save_rig.is_some(), "--save-rig"),
        (args.picture.is_some(), "--picture"),
        (args.handles.is_some(), "--handles"),
        (!args.hold.is_empty() || !args.hold_exact.is_empty(), "--hold"),
        (!args.rigid.is_empty() || !args.stiffness.is_empty(), "--rigid, --stiffness"),
        (args.map == Map::Paper, "--map paper"),
        (args.solve_tolerance.is_some(), "--solve-tolerance"),
        (args.reference != Reference::Auto, "--ref"),
        (args.ref_file.is_some(), "--ref-file"),
        (!matches!(args.align, Align::Auto | Align::None), "--align similarity, pose or retarget"),
    ];
    match given.into_iter().find(|g| g.0) {
        Some((_, option)) => Err(Error::new(Kind::Usage, format!("{option} is not for things made of parts"))
            .expected("parts, joints, binds and stiffness in the rig file")),
        None => Ok(()),
    }
}
