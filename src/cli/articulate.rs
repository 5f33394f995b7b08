//! The main job for things made of parts: a rig file with components or joints, and a capture that drives them.

mod points;
mod skeleton;

use super::args::{Align, Animate, Map, Reference};
use super::captures::{Captures, is_table, read_captures, resample};
use super::console::Console;
use super::decisions::{capture_line, cut, scan_line};
use super::rig::Rig;
use super::setup::{Clock, Setup, warn};
use super::shells::Examples;
use crate::binding::rig::RigFile;
use crate::binding::{self, Binding, BoundMarker, Decisions, Regions, Similarity, Turning};
use crate::capture::{MarkerTake, Motion, smooth};
use crate::deform::joints::{Ground, Joints, Model, Options, Weights};
use crate::deform::{Deformer, Handle};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::Cancel;
use crate::pipeline;
use crate::pipeline::mechanism::Machine;
use crate::scan::{self, Scan, UnitBox};
use crate::space::{Evidence, Known, Unit};
use crate::surface::SurfaceMap;
use crate::words::{self, file_name};
use glam::DVec3;
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
    let Driven { handles, mut binding, ground, words: bind_words } =
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
    let solver = solver_options(args, file, capture.rate);
    let (parts, joints) = (machine.model.parts().len(), machine.joints.len());
    let model = machine.model.clone();
    let model = ground.into_iter().fold(model, Model::over);
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
        faces_read: scan.mesh.faces.len(),
        scan: Arc::new(scan),
        capture,
        reference: None,
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

fn solver_options(args: &Animate, file: &RigFile, rate: f64) -> Options {
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
        rate,
        snap: said.snap.unwrap_or(true),
    }
}

/// What drives the machine, and how that is said.
struct Driven {
    handles: Vec<Handle>,
    binding: Binding,
    /// Under feet that stand.
    ground: Option<Ground>,
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

    fn part(&self, name: &str) -> Result<usize> {
        let name = name.split_once('/').map_or(name, |n| n.0);
        self.machine.part(name).ok_or_else(|| Error::malformed(format!("there is no component {name}")).at("[[bind]]"))
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
