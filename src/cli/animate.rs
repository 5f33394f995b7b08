//! The main job: set up, run, sum up.

use super::args::{Animate, Map};
use super::articulate;
use super::console::Console;
use super::decisions::{FOLDING, binding_json, done_line, oriented_json, outcome_warnings, within};
use super::outputs;
use super::rig::Rig;
use super::setup::{Setup, warn};
use super::shells;
use crate::batch::record::Summary;
use crate::error::{Error, Kind, Result};
use crate::export::{Cancel, FrameSink, Header};
use crate::pipeline::{self, Job, Progress};
use crate::report::{self, ReportWriter};
use crate::words;
use serde_json::{Value, json};
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
    let rig = Rig::read(args)?;
    let mut merged = args.clone();
    if args.rig.is_some() {
        merged.shells.take_from(&rig.file().solver.shell)?;
    }
    let args = &merged;
    let threads = args.threads.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|e| Error::new(Kind::Usage, format!("cannot start {threads} threads: {e}")).hint("--threads 1"))?;
    args.shells.check(
        args.refine.is_some(),
        &[
            (args.proxy.is_some(), "--proxy", "--proxy-vertices N"),
            (args.map == Map::Paper, "--map paper", "leave it out: a shell has one map"),
            (args.solve_tolerance.is_some(), "--solve-tolerance", "--quality"),
        ],
    )?;
    let sinks = outputs::sinks(args)?;
    let setup = if articulate::applies(args)? {
        articulate::not_used(args)?;
        articulate::set_up(args, console, &cancel, start)?
    } else {
        Setup::make(args, &rig, console, &cancel, start)?
    };
    setup.animate(args, console, cancel, sinks, threads > 1)
}

impl Setup {
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
            examples: &self.examples.names,
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
        let names: Vec<&str> =
            self.handles.iter().map(|h| h.name.as_str()).chain(self.oriented.iter().map(|h| h.name.as_str())).collect();
        let texts = outcome_warnings(&outcome, &names, self.unit_box.diagonal, metres, folding);
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
            "reference": self.reference.as_deref().map(name),
            "handles": args.handles.as_deref().map(name),
            "proxy": args.proxy.as_deref().map(name),
            "rig": args.rig.as_deref().map(name),
        });
        let laps: serde_json::Map<String, Value> =
            self.clock.laps.iter().map(|(name, ms)| (name.replace(' ', "_"), json!((ms * 10.0).round() / 10.0))).collect();
        let decisions = json!({
            "scan": { "vertices": self.scan.mesh.positions.len(), "faces": self.faces_read, "diagonal": self.unit_box.diagonal },
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
