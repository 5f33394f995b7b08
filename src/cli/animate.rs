//! The main job: read, decide, set up, run, sum up.

use super::args::{Animate, Map, QualityArg};
use super::articulate;
use super::console::Console;
use super::decisions::{
    FOLDING, bind_line, binding_details, binding_json, capture_line, cut, done_line, file_name, oriented_json, outcome_warnings,
    repair_details, repairs_json, scan_line, solve_line, unbound, within,
};
use super::outputs;
use super::picture::{self, Bound, Unbound};
use super::rig::Rig;
use super::shells::{self, Examples};
use crate::batch::record::Summary;
use crate::binding::landmarks::Floor;
use crate::binding::regions::Subject;
use crate::binding::select::Hold;
use crate::binding::{self, Binding, Limbs, Regions, Rules, ScanShape, Segment, driven, landmarks};
use crate::cache::{Cache, Key};
use crate::capture::handles_csv::HandleTable;
use crate::capture::resample::Sampling;
use crate::capture::{self, Capture, ReadOptions, smooth};
use crate::deform::shells::{Body, Shells, SurfaceRows};
use crate::deform::volumetric::{Options, Volumetric};
use crate::deform::{Deformer, Grip, Handle, OrientedHandle};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::files::Pending;
use crate::export::{Cancel, FrameSink, Header};
use crate::pipeline::grips::{self, Holding};
use crate::pipeline::{self, Job, Progress};
use crate::proxy::rows::HandleRows;
use crate::proxy::{self, BuildOptions, Proxy, medit};
use crate::report::{self, ReportWriter};
use crate::scan::{self, Faces, Scan, UnitBox};
use crate::spatial::TriangleTree;
use crate::surface::SurfaceMap;
use crate::words;
use glam::DVec3;
use serde_json::{Value, json};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// A main job that has written its outputs.
pub(super) struct Finished {
    /// It in figures.
    pub(super) summary: Summary,
    /// Whether it stays within `--fail-above`.
    pub(super) within: Result<()>,
}

/// Runs the main job.
pub(super) fn run(args: &Animate, console: &Console, cancel: Cancel) -> Result<Finished> {
    let start = Instant::now();
    let threads = args.threads.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|e| Error::new(Kind::Usage, format!("cannot start {threads} threads: {e}")).hint("--threads 1"))?;
    args.shells.check(&[
        (args.proxy.is_some(), "--proxy", "--proxy-vertices N"),
        (args.map == Map::Paper, "--map paper", "leave it out: a shell has one map"),
        (args.solve_tolerance.is_some(), "--solve-tolerance", "--quality"),
    ])?;
    let sinks = outputs::sinks(args)?;
    let setup = if articulate::applies(args)? {
        articulate::not_used(args)?;
        articulate::set_up(args, console, &cancel, start)?
    } else {
        Setup::make(args, console, &cancel, start)?
    };
    setup.animate(args, console, cancel, sinks, threads > 1)
}

/// Everything that is decided and computed before the first frame.
pub(super) struct Setup {
    pub(super) scan: Arc<Scan>,
    pub(super) capture: Capture,
    /// Frames to write, counted from 0.
    pub(super) range: Range<usize>,
    pub(super) unit_box: UnitBox,
    pub(super) binding: Binding,
    pub(super) proxy: Arc<Proxy>,
    pub(super) map: Arc<SurfaceMap>,
    pub(super) handles: Vec<Handle>,
    pub(super) oriented: Vec<OrientedHandle>,
    pub(super) regions: Regions,
    pub(super) deformer: Box<dyn Deformer>,
    /// The example poses of a shell.
    pub(super) examples: Examples,
    /// How frames are solved, in words.
    pub(super) solve: String,
    pub(super) clock: Clock,
    /// What was repaired in the capture.
    pub(super) repairs: Value,
    pub(super) warnings: Vec<String>,
    pub(super) start: Instant,
}

impl Setup {
    fn make(args: &Animate, console: &Console, cancel: &Cancel, start: Instant) -> Result<Self> {
        let mut clock = Clock::new(start);
        let mut warnings = Vec::new();
        let rig = Rig::read(args)?;
        let cache = args.cache.as_ref().map(|folder| Cache::open(folder, args.cache_size << 20)).transpose()?;
        let (scan, captures) = rayon::join(|| scan::read(&args.scan), || read_captures(args, &rig));
        let (scan, mut captures) = (scan?, captures?);
        clock.lap("read");
        cancel.check()?;
        if let Some(hertz) = args.smooth {
            let capture = &mut captures.capture;
            smooth::low_pass(&mut capture.motion, capture.rate, hertz).map_err(|e| e.file(&args.capture))?;
        }
        let range = pipeline::select(captures.capture.first_frame, captures.frames(), args.frames)?;

        let unit_box = UnitBox::of(&scan.mesh).ok_or_else(|| {
            Error::malformed("the mesh has no extent").file(&args.scan).expected("faces over at least two different positions")
        })?;
        let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
        let triangles = scan.mesh.vertex_triangles();
        let mut example_notes = Notes::default();
        let examples = Examples::read(&args.shells.examples, args.shells.example_scale, &scan, unit_box, &mut example_notes)?;
        let (built, bound) = rayon::join(
            || body(args, cache.as_ref(), &scan, unit_box, &points, &triangles, &examples, cancel),
            || bind(args, &scan, unit_box, &points, &triangles, &mut captures, &rig, (console, cancel)),
        );
        let (mut binding, floor) = match bound {
            Err(error) if matches!(error.kind, Kind::Refused | Kind::Ambiguous) && args.picture.is_some() => {
                show_unbound(args, console, &scan, &points, &triangles, &captures.capture)?;
                return Err(error);
            }
            bound => bound?,
        };
        let (scan, triangles, built) = match floor {
            Some(floor) => {
                let without = without_floor(&scan, unit_box, &floor, &mut binding.notes);
                let triangles = without.mesh.vertex_triangles();
                let built = body(args, cache.as_ref(), &without, unit_box, &points, &triangles, &examples, cancel);
                (without, triangles, built)
            }
            None => (scan, triangles, built),
        };
        let (mut capture, reference) = (captures.capture, captures.reference);
        console.station("scan", &scan_line(args, &scan, &binding));
        console.station("capture", &capture_line(args, &capture, &binding));
        console.station("bind", &bind_line(args, &binding));
        warn(console, &mut warnings, &scan.notes);
        warn(console, &mut warnings, &example_notes);
        warn(console, &mut warnings, &capture.notes);
        if let Some(reference) = &reference {
            warn(console, &mut warnings, &reference.notes);
        }
        warn(console, &mut warnings, &cut(args, &capture, &range));
        warn(console, &mut warnings, &binding.notes);
        warn(console, &mut warnings, &unbound(&binding));
        warn(console, &mut warnings, &grips::missing(&binding.turning, &holdings(args), range.clone()));
        repair_details(&capture).iter().chain(&binding_details(&binding)).for_each(|line| console.detail(line));
        let Made { proxy, mut shell, words: remarks, notes, joined, touching } = built?;
        console.station("proxy", &remarks);
        warn(console, &mut warnings, &notes);
        let mut notes = Notes::default();
        rig.save(args, &scan, &binding, &mut notes)?;
        warn(console, &mut warnings, &notes);
        clock.lap("bind and proxy");
        if let Some(path) = &args.picture {
            let reference = reference.as_ref().unwrap_or(&capture);
            let heading = vec![of_files(args), bind_line(args, &binding)];
            let (points, triangles) = (&points, &triangles);
            let bound = Bound { heading, scan: &scan, points, triangles, binding: &binding, reference, joined: &joined };
            picture::write(path, &picture::bound(&bound))?;
            console.station("picture", &path.display().to_string());
            clock.lap("picture");
        }
        // In the frames of the file, whatever --fps makes of them.
        let repairs = repairs_json(&capture);
        let range = resample(args, &mut capture, &mut binding, range)?;
        cancel.check()?;

        let (mut proxy, mut handles, mut oriented, mut regions) = (proxy, Vec::new(), Vec::new(), Regions::default());
        for _ in 0..2 {
            let limbs = if touching { Limbs::of(&proxy, &binding, unit_box.diagonal, &joined) } else { None };
            let subject = Subject::new(&scan, &points, unit_box, &proxy, &binding).with_limbs(limbs.as_ref());
            regions = Regions::new(&subject, &rules(args, &rig, &binding))?;
            handles = attach(&proxy, shell.as_ref(), &binding, &regions, limbs.as_ref(), args);
            oriented = grips::grips(&subject, &binding.turning.handles, &holdings(args))?;
            let Some(held) = held_components(&proxy, &handles, &oriented) else { break };
            proxy = proxy.with_components(|c| held[c as usize]);
            shell = shell.map(|body| body.with_components(|c| held[c as usize]));
            let loose = words::plural(held.iter().filter(|h| !**h).count(), "separate part");
            let mut notes = Notes::default();
            notes.warn(format!("{loose} of the scan without a marker: the nearest part of the body takes it along"));
            warn(console, &mut warnings, &notes);
        }
        if !regions.counts.is_empty() {
            console.station("parts", &regions.words());
        }
        let (map, deformer) = rayon::join(
            || match &shell {
                Some(body) => Ok(map_of_shell(cache.as_ref(), body, &points, &scan.mesh.faces, &examples)),
                None => map_of(args, cache.as_ref(), &proxy, &points, &scan.mesh.faces),
            },
            || deformer(args, &proxy, shell.as_ref(), &handles, &oriented, &regions),
        );
        let (map, (deformer, notes)) = (Arc::new(map?), deformer?);
        warn(console, &mut warnings, &notes);
        if let Some(trouble) = cache.and_then(|cache| cache.trouble()) {
            let mut notes = Notes::default();
            notes.warn(format!("the cache is not kept: {trouble}"));
            warn(console, &mut warnings, &notes);
        }
        if let Some(path) = &args.save_proxy {
            let mut text = Vec::new();
            medit::write(&mut text, &proxy, &unit_box).map_err(|e| Error::unwritable(path, &e))?;
            let mut file = Pending::create(path)?;
            file.write(&text)?;
            file.finish()?;
        }
        clock.lap("map and factor");
        cancel.check()?;
        Ok(Self {
            scan: Arc::new(scan),
            capture,
            range,
            unit_box,
            binding,
            proxy: Arc::new(proxy),
            map,
            handles,
            oriented,
            regions,
            deformer,
            solve: solve_words(args, &examples),
            examples,
            clock,
            repairs,
            warnings,
            start,
        })
    }

    fn animate(
        mut self,
        args: &Animate,
        console: &Console,
        cancel: Cancel,
        sinks: Vec<Box<dyn FrameSink>>,
        overlap: bool,
    ) -> Result<Finished> {
        let take = self.binding.take(&self.capture);
        let range = self.range.clone();
        let header = Arc::new(Header {
            scan: self.scan.clone(),
            unit_box: self.unit_box,
            proxy: self.proxy.clone(),
            map: self.map.clone(),
            take: self.capture.source.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            rate: self.capture.rate,
            first_frame: self.capture.first_frame + range.start as i64,
            frames: range.len(),
            places: self.binding.places().map(|(name, p)| (name.to_owned(), p)).collect(),
            up: self.binding.decisions.scan_up.map(|up| up.value),
            metres: self.binding.decisions.scan_unit.map(|u| u.value.metres()),
            cancel,
        });
        console.station("solve", &self.solve);
        console.station("write", &args.out.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(" · "));
        for (name, ms) in &self.clock.laps {
            console.detail(&format!("{name}: {}", words::seconds(ms / 1e3)));
        }
        let setup_seconds = self.start.elapsed().as_secs_f64();
        let report = args.report.as_ref().map(|path| ReportWriter::begin(path, &self.report_head(args))).transpose()?;
        let metres = self.binding.decisions.scan_unit.map(|u| u.value.metres());
        let job = Job {
            header: header.clone(),
            take,
            range,
            first_frame: self.capture.first_frame,
            binding: &self.binding,
            handles: &self.handles,
            oriented: &self.oriented,
            deformer: self.deformer,
            sinks,
            report,
            metres,
            overlap,
        };
        let progress = console.progress("", header.frames);
        let result = pipeline::run(job, &|step| match step {
            Progress::Frames(done) => progress.at(done),
            Progress::Finishing => progress.finishing(),
        });
        progress.finish();
        let mut outcome = result.map_err(|e| interrupted_where(e, &progress, header.frames))?;

        let folding = if args.shells.are_chosen()? { shells::FOLDING } else { FOLDING };
        let texts = outcome_warnings(&outcome, self.unit_box.diagonal, metres, folding);
        texts.iter().chain(&args.shells.weight_warnings(&outcome, &self.examples.names)).for_each(|text| {
            console.warning(text);
            self.warnings.push(text.clone());
        });
        for written in &outcome.written {
            warn(console, &mut self.warnings, &written.notes);
        }
        if let Some(report) = outcome.report.take() {
            report.finish(&outcome.written, metres, &self.warnings)?;
        }
        let total = self.start.elapsed().as_secs_f64();
        let names: Vec<&str> =
            self.handles.iter().map(|h| h.name.as_str()).chain(self.oriented.iter().map(|h| h.name.as_str())).collect();
        console.station("done", &done_line(&outcome, total, &names, metres, self.unit_box.diagonal));
        let [solve, map, write] = outcome.stage_ms.map(|ms| ms / outcome.frames.max(1) as f64);
        console.detail(&format!(
            "set-up {} · per frame: solve {solve:.1} ms ({:.1} passes), map {map:.1} ms, write {write:.1} ms · outputs completed in {} · peak {}",
            words::seconds(setup_seconds),
            outcome.passes as f64 / outcome.frames.max(1) as f64,
            words::seconds(outcome.finish_ms / 1e3),
            report::peak_megabytes().map_or("unknown".into(), |mb| format!("{mb:.0} MB")),
        ));
        let summary = Summary {
            seconds: total,
            setup_seconds,
            peak_mb: report::peak_megabytes(),
            frames: outcome.frames,
            vertices: self.scan.mesh.positions.len(),
            residual_median_mm: outcome.residuals.quantile(0.5),
            residual_worst_mm: outcome.worst.map(|worst| worst.0),
            worst_handle: outcome.worst.map(|worst| names[worst.1].to_owned()),
            worst_frame: outcome.worst.map(|worst| worst.2),
            volume: outcome.volume,
            warnings: self.warnings.len(),
        };
        let within = args.fail_above.map_or(Ok(()), |limit| within(limit, &outcome, &names, metres));
        Ok(Finished { summary, within })
    }

    fn report_head(&self, args: &Animate) -> Vec<(&'static str, Value)> {
        let name = |p: &Path| p.display().to_string();
        let inputs = json!({
            "scan": name(&args.scan),
            "capture": name(&args.capture),
            "reference": args.ref_file.as_deref().map(name),
            "handles": args.handles.as_deref().map(name),
            "proxy": args.proxy.as_deref().map(name),
            "rig": args.rig.as_deref().map(name),
        });
        let laps: serde_json::Map<String, Value> =
            self.clock.laps.iter().map(|(name, ms)| (name.replace(' ', "_"), json!((ms * 10.0).round() / 10.0))).collect();
        let decisions = json!({
            "scan": { "vertices": self.scan.mesh.positions.len(), "faces": self.scan.mesh.faces.len(), "diagonal": self.unit_box.diagonal },
            "capture": { "name": self.capture.name, "rate": self.capture.rate, "first_frame": self.capture.first_frame, "summary": self.capture.summary(), "repairs": self.repairs },
            "parts": self.regions.counts.iter().map(|(what, stiffness, tets)| json!({ "what": what, "stiffness": stiffness, "tetrahedra": tets })).collect::<Vec<_>>(),
            "binding": binding_json(&self.binding, self.unit_box),
            "oriented_handles": self.oriented.iter().map(|h| oriented_json(h, self.unit_box)).collect::<Vec<_>>(),
            "examples": self.examples.names,
            "proxy": { "vertices": self.proxy.rest.len(), "tetrahedra": self.proxy.tets.len() },
        });
        vec![("inputs", inputs), ("decisions", decisions), ("setup_ms", Value::Object(laps))]
    }
}

/// How frames are solved, in words.
fn solve_words(args: &Animate, examples: &Examples) -> String {
    if args.shells.are_chosen().unwrap_or(false) {
        let count = examples.names.len();
        let learnt = if count == 0 {
            "without examples".into()
        } else {
            format!("{}, weights {}", words::plural(count, "example"), args.shells.range_words())
        };
        return format!("shells, {learnt}");
    }
    solve_line(args)
}

/// `scan.obj · walk.c3d`.
fn of_files(args: &Animate) -> String {
    format!("{} \u{b7} {}", file_name(&args.scan), file_name(&args.capture))
}

/// Draws what there is to bind, where it could not be: what a person needs to name the markers in a rig file.
fn show_unbound(
    args: &Animate,
    console: &Console,
    scan: &Scan,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    capture: &Capture,
) -> Result<()> {
    let Some(path) = &args.picture else { return Ok(()) };
    let body = landmarks::find(points, triangles).ok();
    let heading = vec![of_files(args), "not bound".to_owned()];
    let unbound = Unbound { heading, scan, points, triangles, body: body.as_ref() };
    let up = args.capture_up.or(binding::actor_space(capture).space.up.map(|up| up.value));
    let up = up.map_or(DVec3::Z, |up| up.vector());
    picture::write(path, &picture::not_bound(unbound, capture, up))?;
    console.station("picture", &path.display().to_string());
    Ok(())
}

/// Milliseconds of the parts of the set-up.
pub(super) struct Clock {
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Clock {
    pub(super) fn new(start: Instant) -> Self {
        Self { last: start, laps: Vec::new() }
    }

    pub(super) fn lap(&mut self, name: &'static str) {
        let now = Instant::now();
        self.laps.push((name, (now - self.last).as_secs_f64() * 1e3));
        self.last = now;
    }
}

pub(super) fn warn(console: &Console, all: &mut Vec<String>, notes: &Notes) {
    for text in notes.iter() {
        console.warning(text);
        all.push(text.to_owned());
    }
}

/// What moves the scan.
pub(super) struct Captures {
    pub(super) capture: Capture,
    reference: Option<Capture>,
    /// Tables of handles; the first is the capture itself where that is one.
    pub(super) tables: Vec<HandleTable>,
}

impl Captures {
    pub(super) fn frames(&self) -> usize {
        let take = self.capture.motion.points();
        match (take.frames(), self.tables.first()) {
            (0, Some(table)) => table.frames(),
            (frames, _) => frames,
        }
    }
}

/// Whether the capture is a table of handles.
pub(super) fn is_table(path: &Path) -> bool {
    capture::is_handle_table(path)
}

pub(super) fn read_captures(args: &Animate, rig: &Rig) -> Result<Captures> {
    let options = ReadOptions {
        subject: args.subject.clone(),
        rate: args.rate,
        clip: args.clip.clone(),
        skeleton: args.skeleton.clone(),
        bodies: args.bodies,
        surface: args.surface,
        as_found: false,
    };
    let mut tables = Vec::new();
    let capture = if is_table(&args.capture) {
        let table = HandleTable::read(&args.capture)?;
        let mut capture = table.empty_capture(args.rate.unwrap_or(HandleTable::RATE));
        capture.notes.extend(capture::not_used(&args.capture, &options));
        tables.push(table);
        capture
    } else {
        capture::read(&args.capture, &options)?
    };
    tables.extend(args.handles.as_ref().map(|path| HandleTable::read(path)).transpose()?);
    let reference = rig.reference(args).map(|path| read_reference(&path, &options)).transpose()?;
    Ok(Captures { capture, reference, tables })
}

/// Hardness of handles on rigid parts against others: a part that cannot bend towards each of its handles leaves them farther away.
const GRIP: f64 = 4.0;

/// What handles of tables hold.
fn holdings(args: &Animate) -> Vec<Holding> {
    let holdings =
        |holds: &[Hold], exact| holds.iter().map(move |hold| Holding { hold: hold.clone(), exact }).collect::<Vec<_>>();
    [holdings(&args.hold, false), holdings(&args.hold_exact, true)].concat()
}

/// What is rigid or stiffer. A fixed count of plain iterations is for the energy as it was published.
fn rules(args: &Animate, rig: &Rig, binding: &Binding) -> Rules {
    let mut rules = if args.iterations.is_some() { Rules::default() } else { Rules::of_body(binding) };
    rig.rules(&mut rules);
    args.stiffness.iter().for_each(|rule| rules.stiffness(rule.clone()));
    args.rigid.iter().for_each(|what| rules.rigid(what.clone()));
    rules
}

/// The capture at `--fps`, cut to the frames that are written and those that lead into them; the first one written keeps its number.
pub(super) fn resample(
    args: &Animate,
    capture: &mut Capture,
    binding: &mut Binding,
    range: Range<usize>,
) -> Result<Range<usize>> {
    /// Positions that a take may have.
    const MOST: usize = 1 << 30;
    let Some(rate) = args.fps else { return Ok(range) };
    let first = capture.first_frame + range.start as i64;
    let (sampling, lead) = Sampling::new(range, pipeline::PRE_ROLL, capture.rate, rate);
    let points = binding.take(capture).markers() + binding.turning.handles.len();
    if sampling.frames().saturating_mul(points) > MOST {
        return Err(Error::new(Kind::Usage, format!("--fps {rate} makes {} frames", words::count(sampling.frames())))
            .expected("fewer frames per second, or a shorter range of frames"));
    }
    capture.motion = sampling.motion(&capture.motion);
    binding.resample(&sampling);
    (capture.rate, capture.first_frame) = (rate, first - lead as i64);
    Ok(lead..sampling.frames())
}

/// The static trial; one of a single person may not name the subject.
fn read_reference(path: &Path, options: &ReadOptions) -> Result<Capture> {
    // How fast it is plays no part, and clips are called as those of the capture.
    let options = &ReadOptions { rate: None, clip: None, ..options.clone() };
    let mut capture = capture::read(path, options)
        .or_else(|e| if e.kind == Kind::Usage { capture::read(path, &ReadOptions::default()) } else { Err(e) })?;
    let mut notes = Notes::default();
    capture.notes.iter().for_each(|text| notes.warn(format!("{}: {text}", file_name(path))));
    capture.notes = notes;
    Ok(capture)
}

/// The handles of the bound markers.
fn attach(
    proxy: &Proxy,
    shell: Option<&Body>,
    binding: &Binding,
    regions: &Regions,
    limbs: Option<&Limbs>,
    args: &Animate,
) -> Vec<Handle> {
    let surface = shell.map(SurfaceRows::new);
    let rows = HandleRows::new(proxy, args.map.into());
    // Where limbs touch, each segment has rows on its own limb.
    let own: Vec<HandleRows> =
        limbs.iter().flat_map(|limbs| Segment::ALL.map(|s| rows.among(proxy, |v| limbs.suits(v, s)))).collect();
    let on_rigid = regions.on_rigid(proxy, binding.handles.iter().map(|h| h.attachment));
    let handles = binding.handles.iter().zip(on_rigid);
    handles
        .map(|(h, rigid)| {
            let beta = if rigid && h.beta >= 1.0 { h.beta * GRIP } else { h.beta };
            Handle {
                name: h.label.clone(),
                row: match &surface {
                    Some(surface) => surface.row(h.attachment),
                    None => h.segment.and_then(|s| own.get(s as usize)).unwrap_or(&rows).row(h.attachment),
                },
                beta,
            }
        })
        .collect()
}

/// Which components of the proxy a handle holds; `None` where all or none are held.
fn held_components(proxy: &Proxy, handles: &[Handle], oriented: &[OrientedHandle]) -> Option<Vec<bool>> {
    let mut of_vertex = vec![0; proxy.rest.len()];
    for (tet, &component) in proxy.tets.iter().zip(&proxy.components) {
        tet.iter().for_each(|&v| of_vertex[v as usize] = component);
    }
    let count = proxy.components.iter().max().map_or(0, |&last| last as usize + 1);
    let mut held = vec![false; count];
    let mut hold = |vertices: &[u32]| vertices.iter().for_each(|&v| held[of_vertex[v as usize] as usize] = true);
    handles.iter().for_each(|handle| hold(&handle.row.indices));
    for handle in oriented {
        match &handle.grip {
            Grip::Frame { rows, .. } => rows.iter().for_each(|row| hold(&row.indices)),
            Grip::Region { vertices, .. } | Grip::Exact { vertices } => hold(vertices),
        }
    }
    (held.contains(&true) && held.contains(&false)).then_some(held)
}

/// The deformer with its handles, and what is to be said about it.
fn deformer(
    args: &Animate,
    proxy: &Proxy,
    shell: Option<&Body>,
    handles: &[Handle],
    oriented: &[OrientedHandle],
    regions: &Regions,
) -> Result<(Box<dyn Deformer>, Notes)> {
    let mut notes = Notes::default();
    if let Some(body) = shell {
        let mut options = args.shells.options(body, regions.stiffness.clone(), regions.rigid.clone());
        (options.still, options.decrease, options.steps) = match (args.iterations, args.quality) {
            (Some(count), _) => (0.0, 0.0, count),
            (None, QualityArg::Draft) => (1e-4, 1e-3, 3),
            (None, QualityArg::Default) => (options.still, options.decrease, options.steps),
            (None, QualityArg::Converged) => (1e-8, 1e-10, 60),
        };
        let shells = Shells::new(body, handles, oriented, &options)?;
        shells::remarks(&shells).into_iter().for_each(|text| notes.warn(text));
        return Ok((Box::new(shells), notes));
    }
    let options = Options {
        tolerance: args.solve_tolerance.unwrap_or(args.quality.tolerance()),
        iterations: args.iterations,
        stiffness: regions.stiffness.clone(),
        rigid: regions.rigid.clone(),
        ..Options::default()
    };
    Ok((Box::new(Volumetric::with_oriented(proxy, handles, oriented, &options)?), notes))
}

/// A proxy, with the words of its line.
struct Made {
    proxy: Proxy,
    /// The same as a shell, where frames are solved by one.
    shell: Option<Body>,
    words: String,
    notes: Notes,
    /// Where parts are joined that only touch.
    joined: Vec<DVec3>,
    /// Whether parts touch.
    touching: bool,
}

/// The map from the proxy to the scan, from the cache where it is there.
fn map_of(args: &Animate, cache: Option<&Cache>, proxy: &Proxy, points: &[DVec3], faces: &Faces) -> Result<SurfaceMap> {
    let of_proxy = |key: Key| {
        key.plain(&proxy.rest).plain(&proxy.tets).plain(&proxy.boundary).plain(&proxy.boundary_tets).plain(&proxy.components)
    };
    let kind = if args.map == Map::Paper { "paper map" } else { "ring map" };
    let key = || of_proxy(Key::new(kind)).plain(points).plain(&faces.starts).plain(&faces.corners);
    let Some((cache, key)) = cache.map(|cache| (cache, key())) else {
        return SurfaceMap::build_by_pieces(proxy, points, faces, args.map.into());
    };
    if let Some(map) = cache.get(&key) {
        return Ok(map);
    }
    let map = SurfaceMap::build_by_pieces(proxy, points, faces, args.map.into())?;
    cache.keep(&key, &map);
    Ok(map)
}

/// The coarse mesh of a shell, from the cache where it is there.
fn shell_of(
    args: &Animate,
    cache: Option<&Cache>,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    cancel: &Cancel,
) -> Result<Body> {
    let key = Key::new("shell").plain(points).plain(triangles).plain(&[args.proxy_vertices.unwrap_or(0)]);
    let key = examples.poses.iter().fold(key, |key, pose| key.plain(pose));
    if let Some(body) = cache.and_then(|cache| cache.get(&key)) {
        return Ok(body);
    }
    let body = shells::body(points, triangles, examples, args.proxy_vertices, &|| cancel.check())?;
    if let Some(cache) = cache {
        cache.keep(&key, &body);
    }
    Ok(body)
}

/// The map from a shell to the scan, from the cache where it is there.
fn map_of_shell(cache: Option<&Cache>, body: &Body, points: &[DVec3], faces: &Faces, examples: &Examples) -> SurfaceMap {
    let key = Key::new("shell map").plain(&body.proxy.rest).plain(&body.proxy.boundary).plain(&body.places).plain(&body.roots);
    let key = key.plain(points).plain(&faces.starts).plain(&faces.corners);
    let key = body.examples.iter().chain(&examples.poses).fold(key, |key, pose| key.plain(pose));
    if let Some(map) = cache.and_then(|cache| cache.get(&key)) {
        return map;
    }
    let map = SurfaceMap::build_for_shell(body, points, faces, &examples.poses);
    if let Some(cache) = cache {
        cache.keep(&key, &map);
    }
    map
}

/// The proxy: built from the scan, or read from `--proxy`, or from the cache where it is there.
#[allow(clippy::too_many_arguments)]
fn body(
    args: &Animate,
    cache: Option<&Cache>,
    scan: &Scan,
    unit_box: UnitBox,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    cancel: &Cancel,
) -> Result<Made> {
    if args.shells.are_chosen()? {
        let mut body = shell_of(args, cache, points, triangles, examples, cancel)
            .map_err(|e| if e.file.is_none() && e.kind != Kind::Interrupted { e.file(&scan.source) } else { e })?;
        let (proxy, notes) = (body.proxy.clone(), std::mem::take(&mut body.notes));
        let words = body.words();
        return Ok(Made { proxy, shell: Some(body), words, notes, joined: Vec::new(), touching: false });
    }
    if let Some(path) = &args.proxy {
        let (proxy, notes) = medit::read(path, &unit_box)?;
        let line = format!(
            "{}  {} vertices, {} tetrahedra",
            file_name(path),
            words::count(proxy.rest.len()),
            words::count(proxy.tets.len())
        );
        return Ok(Made { proxy, shell: None, words: line, notes, joined: Vec::new(), touching: false });
    }
    let options =
        BuildOptions { surface_vertices: args.proxy_vertices.map_or(BuildOptions::default().surface_vertices, |n| n as usize) };
    let key = Key::new("proxy").plain(points).plain(triangles).plain(&[options.surface_vertices]);
    if let Some((proxy, words, notes, joined, touching)) = cache.and_then(|cache| cache.get(&key)) {
        return Ok(Made { proxy, shell: None, words, notes, joined, touching });
    }
    let built = proxy::build(points, triangles, &options, &|| cancel.check())
        .map_err(|e| if e.file.is_none() && e.kind != Kind::Interrupted { e.file(&scan.source) } else { e })?;
    let words = format!("{} · {}", built.summary.size(), built.summary.remarks());
    let touching = built.summary.touching > 0;
    let made = Made { proxy: built.proxy, shell: None, words, notes: built.notes, joined: built.joined, touching };
    if let Some(cache) = cache {
        cache.keep(&key, &(&made.proxy, &made.words, &made.notes, &made.joined, made.touching));
    }
    Ok(made)
}

#[allow(clippy::too_many_arguments)]
fn bind(
    args: &Animate,
    scan: &Scan,
    unit_box: UnitBox,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    captures: &mut Captures,
    rig: &Rig,
    (console, cancel): (&Console, &Cancel),
) -> Result<(Binding, Option<Floor>)> {
    let mut notes = Notes::default();
    let options = rig.options(args, scan, unit_box, &mut notes)?;
    let places = rig.landmarks(scan, unit_box)?;
    let body = match options.frozen.as_ref().and_then(|frozen| frozen.body()) {
        Some(body) => Ok(body),
        None => landmarks::told(landmarks::find(points, triangles), &places, points),
    };
    let floor = body.as_ref().ok().and_then(|body| body.floor);
    let centre = |t: &[u32; 3]| t.iter().map(|&v| points[v as usize]).sum::<DVec3>() / 3.0;
    let tree = match floor {
        Some(floor) => {
            TriangleTree::new(points, &triangles.iter().filter(|t| !floor.holds(centre(t))).copied().collect::<Vec<_>>())
        }
        None => TriangleTree::new(points, triangles),
    };
    let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
    let mut binding = match captures.tables.first().filter(|_| is_table(&args.capture)) {
        Some(table) => driven::unbound(&shape, body.as_ref().ok(), table, &options),
        None => {
            let progress = std::sync::OnceLock::new();
            let watch = |done: usize, of: usize| {
                progress.get_or_init(|| console.progress("posing the actor  ", of)).at(done);
                cancel.check().map_err(|e| {
                    let so_far = format!("{} of {} frames", words::count(done), words::count(of));
                    Error::new(e.kind, format!("interrupted after the actor was posed in {so_far}; nothing was written"))
                })
            };
            let bound = binding::bind(&shape, body, &captures.capture, captures.reference.as_ref(), &options, &watch);
            progress.get().inspect(|progress| progress.finish());
            bound.map_err(|e| if e.file.is_none() && e.kind != Kind::Interrupted { e.file(&scan.source) } else { e })?
        }
    };
    notes.iter().for_each(|text| binding.notes.warn(text));
    let holds: Vec<Hold> = args.hold.iter().chain(&args.hold_exact).cloned().collect();
    for table in &captures.tables {
        driven::add_handles(&shape, &mut captures.capture, &mut binding, table, &holds)?;
    }
    Ok((binding, floor))
}

/// The scan without the floor that has grown together with the feet: it would move and tear with them.
fn without_floor(scan: &Scan, unit_box: UnitBox, floor: &Floor, notes: &mut Notes) -> Scan {
    let without =
        scan.with_faces(|corners| !floor.holds(unit_box.enter(corners.iter().sum::<DVec3>() / corners.len().max(1) as f64)));
    notes.warn(format!(
        "the feet have grown together with a flat floor: its {} are left out, and what is written has no floor",
        words::plural(scan.mesh.faces.len() - without.mesh.faces.len(), "face")
    ));
    without
}

/// An interruption says how far the run came.
fn interrupted_where(error: Error, progress: &super::console::Progress, frames: usize) -> Error {
    if error.kind != Kind::Interrupted {
        return error;
    }
    Error::new(
        Kind::Interrupted,
        format!("interrupted after {} of {} frames; nothing was written", words::count(progress.done()), words::count(frames)),
    )
}
