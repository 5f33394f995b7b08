//! Everything of the main job that is decided and computed before the first frame.

use super::args::{Animate, QualityArg};
use super::captures::{Captures, is_table, read_captures, resample};
use super::console::Console;
use super::decisions::{
    bind_line, binding_details, capture_line, cut, repair_details, repairs_json, scan_line, solve_line, unbound,
};
use super::fit::{Fitted, Fitting, holdings};
use super::grown::{self, Recut};
use super::picture::{self, Bound, Unbound};
use super::proxies::{Made, body, map_of, map_of_shell};
use super::rig::Rig;
use super::shells::{self, Examples};
use crate::binding::select::Hold;
use crate::binding::{self, Binding, Regions, ScanShape, driven, landmarks};
use crate::cache::Cache;
use crate::capture::{Capture, smooth};
use crate::deform::shells::{Body, Options as ShellOptions, Refined, Shells};
use crate::deform::volumetric::{Options, Volumetric};
use crate::deform::{Deformer, Handle, OrientedHandle};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::Cancel;
use crate::export::files::Pending;
use crate::linalg::SparseRow;
use crate::pipeline;
use crate::pipeline::grips;
use crate::proxy::{self, Proxy, medit};
use crate::scan::{self, Scan, UnitBox};
use crate::spatial::TriangleTree;
use crate::surface::{Apart, SurfaceMap};
use crate::words::{self, file_name};
use glam::DVec3;
use serde_json::Value;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Everything that is decided and computed before the first frame.
pub(super) struct Setup {
    pub(super) scan: Arc<Scan>,
    /// Faces of the scan as it was read, before floors are left out and limbs that have grown together are cut.
    pub(super) faces_read: usize,
    pub(super) capture: Capture,
    /// The file of the static trial, by the command line or by the rig file.
    pub(super) reference: Option<PathBuf>,
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
    /// Reads, decides and computes, and says what it decided.
    pub(super) fn make(args: &Animate, rig: &Rig, console: &Console, cancel: &Cancel, start: Instant) -> Result<Self> {
        let mut clock = Clock::new(start);
        let mut warnings = Vec::new();
        let cache = args.cache.as_ref().map(|folder| Cache::open(folder, args.cache_size << 20)).transpose()?;
        let (scan, captures) = rayon::join(|| scan::read(&args.scan), || read_captures(args, rig));
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
        let points = unit_box.enter_all(&scan.mesh.positions);
        let triangles = scan.mesh.vertex_triangles();
        let mut example_notes = Notes::default();
        let examples = Examples::read(&args.shells.examples, args.shells.example_scale, &scan, unit_box, &mut example_notes)?;
        let scene = Scene { args, cache: cache.as_ref(), unit_box, points: &points, examples: &examples, cancel };
        let (built, bound) = rayon::join(
            || scene.body(&scan, &points, &triangles),
            || bind(args, &scan, unit_box, &points, &triangles, &mut captures, rig, (console, cancel)),
        );
        let (mut binding, found) = match bound {
            Err(error) if matches!(error.kind, Kind::Refused | Kind::Ambiguous) && args.picture.is_some() => {
                show_unbound(args, console, &scan, &points, &triangles, &captures.capture)?;
                return Err(error);
            }
            bound => bound?,
        };
        let (line_of_scan, faces_read) = (scan_line(args, &scan, &binding), scan.mesh.faces.len());
        let Standing { scan, triangles, built, mut apart } = scene.stand(scan, triangles, built, found, &mut binding.notes);
        let (mut capture, reference) = (captures.capture, captures.reference);
        console.station("scan", &line_of_scan);
        console.station("capture", &capture_line(args, &capture, &binding));
        console.station("bind", &bind_line(args, &binding));
        let told = [&scan.notes, &example_notes, &capture.notes].into_iter().chain(reference.as_ref().map(|trial| &trial.notes));
        told.for_each(|notes| warn(console, &mut warnings, notes));
        let grips = grips::missing(&binding.turning, &holdings(args), range.clone());
        for notes in [&cut(args, &capture, &range), &binding.notes, &unbound(&binding), &grips] {
            warn(console, &mut warnings, notes);
        }
        repair_details(&capture).iter().chain(&binding_details(&binding)).for_each(|line| console.detail(line));
        let Made { proxy, shell, words: remarks, notes, joined, touching } = built?;
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

        let fitting = Fitting { args, rig, scan: &scan, points: &points, unit_box, binding: &binding };
        let joints = touching.then_some(&joined[..]);
        let (coarse, loose) = fitting.fit(proxy, shell, apart.as_mut(), joints)?;
        warn(console, &mut warnings, &loose);
        let whole = scene.whole(&fitting, &coarse, &triangles)?;
        if !coarse.regions.counts.is_empty() {
            console.station("parts", &coarse.regions.words());
        }
        let (solved, notes) = scene.solved(&scan, coarse, whole, apart.as_ref(), capture.rate)?;
        warn(console, &mut warnings, &notes);
        let Solved { map, deformer, fitted: Fitted { proxy, handles, oriented, regions, .. } } = solved;
        if let Some(trouble) = cache.as_ref().and_then(Cache::trouble) {
            let mut notes = Notes::default();
            notes.warn(format!("the cache is not kept: {trouble}"));
            warn(console, &mut warnings, &notes);
        }
        if let Some(path) = &args.save_proxy {
            save_proxy(path, &proxy, &unit_box)?;
        }
        clock.lap("map and factor");
        cancel.check()?;
        Ok(Self {
            scan: Arc::new(scan),
            faces_read,
            reference: reference.map(|reference| reference.source),
            capture,
            range,
            unit_box,
            binding,
            proxy: Arc::new(proxy),
            map: Arc::new(map),
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
}

/// What the steps of the set-up look at.
struct Scene<'a> {
    args: &'a Animate,
    cache: Option<&'a Cache>,
    unit_box: UnitBox,
    /// Vertices of the scan in the unit box.
    points: &'a [DVec3],
    examples: &'a Examples,
    cancel: &'a Cancel,
}

/// The scan as it is moved: without its floor and with its limbs apart.
struct Standing {
    scan: Scan,
    triangles: Vec<[u32; 3]>,
    built: Result<Made>,
    apart: Option<Apart>,
}

/// The body that frames are solved on, and what solves them.
struct Solved {
    map: SurfaceMap,
    deformer: Box<dyn Deformer>,
    fitted: Fitted,
}

impl Scene<'_> {
    /// `points`: where the vertices are that the body is made around.
    fn body(&self, scan: &Scan, points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Made> {
        body(self.args, self.cache, scan, self.unit_box, points, triangles, self.examples, self.cancel)
    }

    /// Takes away what a scan has grown together with; the body is built anew then. `found`: the person in the scan.
    fn stand(
        &self,
        scan: Scan,
        triangles: Vec<[u32; 3]>,
        built: Result<Made>,
        found: Option<landmarks::Body>,
        notes: &mut Notes,
    ) -> Standing {
        let recut = found.and_then(|found| grown::recut(self.args, &scan, self.unit_box, self.points, &found, notes));
        let Some(Recut { scan, shift }) = recut else { return Standing { scan, triangles, built, apart: None } };
        let triangles = scan.mesh.vertex_triangles();
        let moved = shift.as_deref().map(|shift| grown::moved(self.points, shift));
        let points = moved.as_deref().unwrap_or(self.points);
        let mut built = self.body(&scan, points, &triangles);
        let apart = match (&shift, &mut built) {
            (Some(shift), Ok(made)) => {
                made.touching = true;
                let proxy = proxy::carry_back(&mut made.proxy, points, &triangles, shift);
                Some(Apart { proxy, points: points.to_vec() })
            }
            _ => None,
        };
        Standing { scan, triangles, built, apart }
    }

    /// The whole mesh as a body, where frames are refined on it.
    fn whole(&self, fitting: &Fitting<'_>, coarse: &Fitted, triangles: &[[u32; 3]]) -> Result<Option<Fitted>> {
        let (Some(body), Some(_)) = (&coarse.shell, self.args.refine) else { return Ok(None) };
        let all = shells::whole(self.points, triangles, self.examples, body, &|| self.cancel.check());
        let all = all.map_err(|e| e.file(&fitting.scan.source))?;
        Ok(Some(fitting.fit(all.proxy.clone(), Some(all), None, None)?.0))
    }

    /// Map and deformer of a body, and what is to be said of them; of the whole mesh where it is there.
    fn solved(
        &self,
        scan: &Scan,
        coarse: Fitted,
        whole: Option<Fitted>,
        apart: Option<&Apart>,
        rate: f64,
    ) -> Result<(Solved, Notes)> {
        let map_of_body = |fitted: &Fitted| match &fitted.shell {
            Some(body) => Ok(map_of_shell(self.cache, body, self.points, &scan.mesh.faces, self.examples)),
            None => map_of(self.args, self.cache, &fitted.proxy, self.points, &scan.mesh.faces, apart),
        };
        let (map, made) = rayon::join(|| map_of_body(&coarse), || deformer(self.args, &coarse, rate));
        let (map, (mut deformer, notes)) = (map?, made?);
        let Some(whole) = whole else { return Ok((Solved { map, deformer, fitted: coarse }, notes)) };
        if let Some(body) = &whole.shell {
            deformer = refined(self.args, deformer, body, &whole, &map, rate)?;
        }
        Ok((Solved { map: map_of_body(&whole)?, deformer, fitted: whole }, notes))
    }
}

/// Writes the body of `--save-proxy`.
fn save_proxy(path: &Path, proxy: &Proxy, unit_box: &UnitBox) -> Result<()> {
    let mut text = Vec::new();
    medit::write(&mut text, proxy, unit_box).map_err(|e| Error::unwritable(path, &e))?;
    let mut file = Pending::create(path)?;
    file.write(&text)?;
    file.finish().map(drop)
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
    /// Names and milliseconds, in order.
    pub(super) laps: Vec<(&'static str, f64)>,
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

/// The deformer with its handles, and what is to be said about it.
fn deformer(args: &Animate, fitted: &Fitted, rate: f64) -> Result<(Box<dyn Deformer>, Notes)> {
    let mut notes = Notes::default();
    let Fitted { proxy, shell, handles, oriented, regions } = fitted;
    if let Some(body) = shell {
        let shells = Shells::new(body, handles, oriented, &shell_options(args, body, regions, rate))?;
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

/// How a shell is solved.
fn shell_options(args: &Animate, body: &Body, regions: &Regions, rate: f64) -> ShellOptions {
    let mut options = args.shells.options(body, regions.stiffness.clone(), regions.rigid.clone());
    options.rate = rate;
    (options.still, options.decrease, options.steps) = match (args.iterations, args.quality) {
        (Some(count), _) => (0.0, 0.0, count),
        (None, QualityArg::Draft) => (1e-4, 1e-3, 3),
        (None, QualityArg::Default) => (options.still, options.decrease, options.steps),
        (None, QualityArg::Converged) => (1e-8, 1e-10, 60),
    };
    options
}

/// The deformer of the whole mesh, after that of the coarse one; `map`: from the coarse mesh to the scan.
fn refined(
    args: &Animate,
    coarse: Box<dyn Deformer>,
    body: &Body,
    whole: &Fitted,
    map: &SurfaceMap,
    rate: f64,
) -> Result<Box<dyn Deformer>> {
    let Fitted { handles, oriented, regions, .. } = whole;
    let steps = args.refine.unwrap_or_default();
    let options = ShellOptions { steps, ..shell_options(args, body, regions, rate) };
    let mut rows = vec![SparseRow::default(); body.vertices()];
    for (v, place) in body.places.iter().enumerate().filter(|(_, place)| **place != Body::NONE) {
        rows[*place as usize] = map.row(v);
    }
    Ok(Box::new(Refined::new(coarse, rows, body, handles, oriented, &options)?))
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
) -> Result<(Binding, Option<landmarks::Body>)> {
    let mut notes = Notes::default();
    let options = rig.options(args, scan, unit_box, &mut notes)?;
    let places = rig.landmarks(scan, unit_box)?;
    let body = match options.frozen.as_ref().and_then(|frozen| frozen.body()) {
        Some(body) => Ok(body),
        None => landmarks::told(landmarks::find(points, triangles), &places, points),
    };
    let found = body.as_ref().ok().cloned();
    let floor = found.as_ref().and_then(|body| body.floor);
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
    if is_table(&args.capture) && args.scale.is_some() {
        notes.warn("--scale is not used with a table of handles: its places are those of the scan");
    }
    if args.accept_doubtful && !binding.notes.iter().any(|text| text.contains(binding::ACCEPTED)) {
        notes.warn("--accept-doubtful changed nothing: there was nothing to refuse");
    }
    notes.iter().for_each(|text| binding.notes.warn(text));
    let holds: Vec<Hold> = args.hold.iter().chain(&args.hold_exact).cloned().collect();
    for table in &captures.tables {
        driven::add_handles(&shape, &mut captures.capture, &mut binding, table, &holds)?;
    }
    Ok((binding, found))
}
