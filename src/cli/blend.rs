//! `retarget blend`: poses between and beyond examples, for weights that are given.

use super::args::{Blend, Weights};
use super::console::Console;
use super::outputs;
use super::shells::{self, Examples};
use super::values::parse_weights;
use crate::deform::shells::{Body, Interpolator, too_far};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::{Cancel, FrameBatch, FrameSink, Header};
use crate::scan::{self, Scan, UnitBox};
use crate::surface::{Fans, NormalVertices, SurfaceMap};
use crate::words;
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// A coarse mesh is worth its while where the scan has more vertices than this multiple of it.
const WORTH: usize = 2;
/// Most weights in a file.
const MOST: usize = 1 << 26;

/// Runs it.
pub(super) fn run(args: &Blend, console: &Console) -> Result<()> {
    let start = Instant::now();
    let cancel = Cancel::default();
    let on_interrupt = cancel.clone();
    // Fails only if a handler is set already, which is as good.
    let _ = ctrlc::set_handler(move || on_interrupt.cancel());
    let inputs: Vec<&PathBuf> = std::iter::once(&args.rest).chain(&args.examples).chain(&args.weights).collect();
    let recording = outputs::recording(args.tolerance, args.encode, false);
    let sinks = outputs::checked(&args.out, &[], &inputs, args.force, true, &recording)?;
    let frames = frames(args)?;
    check_reach(&frames)?;
    let several = args.out.iter().find(|p| frames.len() > 1 && is_one_frame(p));
    if let Some(path) = several {
        return Err(Error::new(Kind::Usage, format!("one file for {} frames", words::count(frames.len())))
            .file(path)
            .expected("a run of # for the frame number, as in 'frames/f_####.ply'"));
    }
    let scan = scan::read(&args.rest)?;
    let unit_box = UnitBox::of(&scan.mesh).ok_or_else(|| {
        Error::malformed("the mesh has no extent").file(&args.rest).expected("faces over at least two different positions")
    })?;
    let mut notes = Notes::default();
    notes.extend(scan.notes.clone());
    let examples = Examples::read(&args.examples, args.example_scale, &scan, unit_box, &mut notes)?;
    if let Some((f, weights)) = frames.iter().enumerate().find(|(_, w)| w.len() != examples.names.len()) {
        return Err(Error::new(
            Kind::Usage,
            format!(
                "{}, {} for frame {f}",
                words::plural(examples.names.len(), "example"),
                words::plural(weights.len(), "weight")
            ),
        )
        .expected("one weight per example, in the order in which they are named")
        .hint(examples.names.join(", ")));
    }
    let mut poser = Poser::new(args, &scan, unit_box, &examples, &cancel, &mut notes)?;
    console.station("rest", &format!("{}  {} vertices", words::file_name(&args.rest), words::count(scan.mesh.positions.len())));
    console.station("examples", &examples.names.join(" \u{b7} "));
    console.station("shell", &poser.words());
    notes.iter().for_each(|text| console.warning(text));
    let written = write(args, console, sinks, scan, unit_box, &mut poser, &frames, cancel)?;
    let outputs = written.iter().map(|w| format!("{} {}", w.path.display(), words::bytes(w.bytes)));
    let line = std::iter::once(words::seconds(start.elapsed().as_secs_f64())).chain(outputs).collect::<Vec<_>>();
    written.iter().flat_map(|w| w.notes.iter()).for_each(|text| console.warning(text));
    console.station("done", &line.join(" \u{b7} "));
    Ok(())
}

#[allow(clippy::too_many_arguments)]
fn write(
    args: &Blend,
    console: &Console,
    mut sinks: Vec<Box<dyn FrameSink>>,
    scan: Scan,
    unit_box: UnitBox,
    poser: &mut Poser,
    frames: &[Vec<f64>],
    cancel: Cancel,
) -> Result<Vec<crate::export::Written>> {
    let metres = scan.space.unit.map(|u| u.value.metres());
    let up = scan.space.up.map(|up| up.value.vector());
    let fans = Fans::new(&scan, &NormalVertices::of(&scan));
    let header = Arc::new(Header {
        scan: Arc::new(scan),
        unit_box,
        proxy: Arc::new(poser.coarse.body.proxy.clone()),
        map: poser.map.clone(),
        take: args.rest.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        rate: args.fps,
        first_frame: 0,
        frames: frames.len(),
        places: Vec::new(),
        up,
        metres,
        cancel: cancel.clone(),
    });
    if poser.fine.is_some() && sinks.iter().any(|s| !s.needs().points) {
        console.warning("outputs that follow the coarse mesh (.glb, .html, pictures) have no part in --refine");
    }
    for sink in &mut sinks {
        sink.begin(&header)?;
    }
    let progress = console.progress("", frames.len());
    let (mut points, mut normals) = (vec![Vec::new()], vec![Vec::new()]);
    for (first, weights) in frames.iter().enumerate() {
        cancel.check()?;
        let steps = poser.pose(weights, &mut points).map_err(|e| e.at(format!("frame {first}")))?;
        fans.compute(&[points[0].as_slice()], &mut normals);
        let proxy = [poser.coarse.solver.pose().to_vec()];
        for sink in &mut sinks {
            sink.frames(&FrameBatch { first, proxy: &proxy, points: &points, normals: &normals })?;
        }
        console.detail(&format!("frame {first}: {steps}"));
        progress.at(first + 1);
    }
    progress.finish();
    sinks.into_iter().map(FrameSink::finish).collect()
}

/// A mesh with the solver of its poses.
struct Level {
    body: Body,
    solver: Interpolator,
}

/// Weights → poses of the scan.
struct Poser {
    coarse: Level,
    map: Arc<SurfaceMap>,
    /// The whole mesh, where it is solved after the coarse one.
    fine: Option<Level>,
    /// Positions of its vertices before.
    near: Vec<DVec3>,
    steps: u32,
}

impl Poser {
    fn new(
        args: &Blend,
        scan: &Scan,
        unit_box: UnitBox,
        examples: &Examples,
        cancel: &Cancel,
        notes: &mut Notes,
    ) -> Result<Self> {
        let points = unit_box.enter_all(&scan.mesh.positions);
        let triangles = scan.mesh.vertex_triangles();
        let level = |vertices: Option<u32>| -> Result<Level> {
            let body =
                shells::body(&points, &triangles, examples, vertices, &|| cancel.check()).map_err(|e| e.file(&args.rest))?;
            Ok(Level { solver: Interpolator::new(&body, &args.material.material(&body))?, body })
        };
        let mut coarse = level(args.proxy_vertices)?;
        let worth = points.len() > WORTH * coarse.body.vertices();
        let mut fine = if args.refine > 0 || !worth { Some(level(Some(u32::MAX))?) } else { None };
        if !worth && let Some(whole) = fine.take() {
            coarse = whole;
        }
        notes.extend(coarse.body.notes.clone());
        let map = SurfaceMap::build_for_shell(&coarse.body, &points, &scan.mesh.faces, &examples.poses);
        let near = vec![DVec3::ZERO; fine.as_ref().map_or(0, |f| f.body.vertices())];
        Ok(Self { coarse, map: Arc::new(map), fine, near, steps: args.refine })
    }

    fn words(&self) -> String {
        let refined =
            self.fine.as_ref().map(|_| format!(" \u{b7} then {} on the whole mesh", words::plural(self.steps as usize, "step")));
        self.coarse.body.words() + &refined.unwrap_or_default()
    }

    /// The scan for these weights, into the one frame of `points`; returns how it was found.
    fn pose(&mut self, weights: &[f64], points: &mut [Vec<[f32; 3]>]) -> Result<String> {
        let stats = self.coarse.solver.solve(weights)?;
        self.map.apply(&[self.coarse.solver.pose()], points);
        let (level, mut words) = (&self.coarse, format!("{} steps", stats.passes));
        let level = match &mut self.fine {
            Some(fine) => {
                for (place, point) in fine.body.places.iter().zip(&points[0]) {
                    if *place != Body::NONE {
                        self.near[*place as usize] = DVec3::from(point.map(f64::from));
                    }
                }
                let stats = fine.solver.refine(weights, &self.near, self.steps)?;
                words += &format!(", {} on the whole mesh", stats.passes);
                &*fine
            }
            None => level,
        };
        // Vertices of the mesh are where they were found to be; the others follow.
        let pose = level.solver.pose();
        for (place, point) in level.body.places.iter().zip(&mut points[0]) {
            if *place != Body::NONE {
                *point = pose[*place as usize].as_vec3().to_array();
            }
        }
        Ok(format!("{words}, volume {:.1} %", 100.0 * stats.volume_ratio))
    }
}

/// The weights of every frame.
fn frames(args: &Blend) -> Result<Vec<Vec<f64>>> {
    let Some(path) = &args.weights else { return Ok(args.at.iter().map(|w| w.0.clone()).collect()) };
    let text = std::fs::read_to_string(path).map_err(|e| Error::unreadable(path, &e))?;
    table(&text).map_err(|e| e.file(path))
}

fn table(text: &str) -> Result<Vec<Vec<f64>>> {
    let mut frames: Vec<Vec<f64>> = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        match parse_weights(line) {
            Ok(Weights(weights)) => frames.push(weights),
            Err(_) if frames.is_empty() && number == 0 => {}
            Err(reason) => {
                return Err(Error::malformed(format!("'{}': {reason}", line.trim())).at(format!("line {}", number + 1)));
            }
        }
        if frames.len().saturating_mul(frames[..].first().map_or(1, Vec::len)) > MOST {
            return Err(Error::refused(format!("more than {MOST} weights")).expected("a shorter table"));
        }
    }
    if frames.is_empty() {
        return Err(Error::malformed("no weights").expected("a line of numbers per frame, separated by commas"));
    }
    Ok(frames)
}

/// Refuses weights that are too far out.
fn check_reach(frames: &[Vec<f64>]) -> Result<()> {
    let beyond = |w: &&f64| w.abs() > Interpolator::FARTHEST;
    match frames.iter().enumerate().find_map(|(f, weights)| Some((f, weights.iter().find(beyond)?))) {
        Some((frame, weight)) => Err(too_far(*weight).at(format!("frame {frame}"))),
        None => Ok(()),
    }
}

fn is_one_frame(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    (name.ends_with(".ply") || name.ends_with(".obj")) && !name.contains('#')
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_read_from_tables() {
        assert_eq!(table("fist,bent\n0,1\n\n0.5, 0.5\n").unwrap(), [vec![0.0, 1.0], vec![0.5, 0.5]]);
        let error = table("0,1\n0;1\n").unwrap_err().to_string();
        assert!(error.contains("line 2"), "{error}");
        assert!(table("fist\n").is_err());
    }

    #[test]
    fn a_weight_that_is_far_out_is_refused_with_its_frame() {
        assert!(check_reach(&[vec![20.0, -20.0]]).is_ok());
        let error = check_reach(&[vec![0.0, 1.0], vec![0.0, -20.5]]).unwrap_err();
        assert_eq!(error.kind, Kind::Usage);
        let text = error.to_string();
        assert!(text.contains("frame 1") && text.contains("-20.5"), "{text}");
    }
}
