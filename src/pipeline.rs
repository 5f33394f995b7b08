//! The stream: frames are solved in order while earlier ones are mapped and written.
//!
//! Stages pass batches of eight frames through bounded channels; the batches are reused, so memory does not grow with the take.

mod fading;
pub(crate) mod grips;
pub mod mechanism;
mod oriented;
mod outcome;

pub use crate::statistics::Spread;
pub use outcome::{Frames, Outcome, WeightRange};

use crate::binding::Binding;
use crate::capture::MarkerTake;
use crate::deform::{Deformer, Handle, OrientedHandle, Targets};
use crate::error::{Error, Kind, Result};
use crate::export::{FrameBatch, FrameMeasure, FrameSink, Header, Measures, Needs, Residual, Written};
use crate::report::ReportWriter;
use crate::surface::{Fans, NormalVertices};
use fading::Fading;
use glam::DVec3;
use oriented::OrientedTargets;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

/// Frames per batch: the surface map reads its pairs once for all of them.
pub const BATCH: usize = 8;

/// Frames solved before the first one that is written, so that a frame hardly depends on where the range begins.
pub const PRE_ROLL: usize = 8;

/// Everything that a run needs, set up.
pub struct Job<'a> {
    /// Shared with the sinks.
    pub header: Arc<Header>,
    /// The cleaned take.
    pub take: &'a MarkerTake,
    /// Frames to write, counted from 0.
    pub range: Range<usize>,
    /// Number of frame 0 in the capture's own numbering.
    pub first_frame: i64,
    /// How markers become targets.
    pub binding: &'a Binding,
    /// The handles, in the binding's order.
    pub handles: &'a [Handle],
    /// The oriented handles, in the order of the binding's turning ones.
    pub oriented: &'a [OrientedHandle],
    /// The bound deformer.
    pub deformer: Box<dyn Deformer>,
    /// Names of the examples that the deformer has weights of.
    pub examples: &'a [String],
    /// Where frames go.
    pub sinks: Vec<Box<dyn FrameSink>>,
    /// The report, if asked for.
    pub report: Option<ReportWriter>,
    /// Length of the scan's unit in metres, if known.
    pub metres: Option<f64>,
    /// Whether stages overlap on threads of their own.
    pub overlap: bool,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// So many frames are solved.
    Frames(usize),
    /// All frames are solved; the outputs are completed, which takes a while for a skin.
    Finishing,
}

/// One batch of frames on its way through the stages; the arrays are reused.
#[derive(Default)]
struct Batch {
    first: usize,
    measures: Vec<FrameMeasure>,
    holds: Vec<Vec<DVec3>>,
    weights: Vec<Vec<f64>>,
    targets: Vec<Vec<DVec3>>,
    proxy: Vec<Vec<DVec3>>,
    points: Vec<Vec<[f32; 3]>>,
    normals: Vec<Vec<[f32; 3]>>,
    map_ms: f64,
}

/// Runs all frames and completes all sinks. `progress` is told how far it is.
///
/// # Errors
/// The first failure of any stage; nothing is left behind then. The report is returned unfinished, since it also tells of the outputs.
pub fn run(mut job: Job<'_>, progress: &(dyn Fn(Progress) + Sync)) -> Result<Outcome> {
    let needs = job
        .sinks
        .iter()
        .map(|s| s.needs())
        .fold(Needs::default(), |a, b| Needs { points: a.points || b.points || b.normals, normals: a.normals || b.normals });
    for sink in &mut job.sinks {
        sink.begin(&job.header)?;
    }
    let fans = needs.normals.then(|| Fans::new(&job.header.scan, &NormalVertices::of(&job.header.scan)));
    let mapper = Mapper { header: job.header.clone(), needs, fans };
    let mut writer = Writer {
        sinks: std::mem::take(&mut job.sinks),
        report: job.report.take(),
        names: job.handles.iter().map(|h| h.name.clone()).chain(job.oriented.iter().map(|h| h.name.clone())).collect(),
        rest: {
            let points = job.handles.iter().map(|h| h.row.apply(&job.header.proxy.rest));
            points.chain(job.oriented.iter().map(|h| h.rest)).collect()
        },
        examples: job.examples.to_vec(),
        metres: job.metres,
        map_ms: 0.0,
        write_ms: 0.0,
    };
    let mut solver = Solver::new(job, progress);
    if solver.job.overlap {
        overlapped(&mut solver, &mapper, &mut writer)?
    } else {
        in_turn(&mut solver, &mapper, &mut writer)?
    }
    let mut outcome = solver.outcome;
    outcome.stage_ms[1] = writer.map_ms;
    outcome.stage_ms[2] = writer.write_ms;
    outcome.report = writer.report;
    progress(Progress::Finishing);
    let start = Instant::now();
    outcome.written = finish(writer.sinks)?;
    outcome.finish_ms = start.elapsed().as_secs_f64() * 1e3;
    Ok(outcome)
}

/// Completes the sinks; those that took no frames as they came still have work to do, which may fail or be interrupted, and go first, so that
/// nothing is there before everything is.
fn finish(sinks: Vec<Box<dyn FrameSink>>) -> Result<Vec<Written>> {
    let mut sinks: Vec<(usize, Box<dyn FrameSink>)> = sinks.into_iter().enumerate().collect();
    sinks.sort_by_key(|(place, sink)| (sink.needs().points, *place));
    let mut written = sinks.into_iter().map(|(place, sink)| Ok((place, sink.finish()?))).collect::<Result<Vec<_>>>()?;
    written.sort_by_key(|w| w.0);
    Ok(written.into_iter().map(|w| w.1).collect())
}

/// All stages on this thread.
fn in_turn(solver: &mut Solver<'_>, mapper: &Mapper, writer: &mut Writer) -> Result<()> {
    let mut batch = Batch::default();
    while solver.fill(&mut batch)? {
        mapper.map(&mut batch);
        writer.write(&batch)?;
    }
    Ok(())
}

/// Solve here, map and write on a thread each. Four batches circulate.
fn overlapped(solver: &mut Solver<'_>, mapper: &Mapper, writer: &mut Writer) -> Result<()> {
    let (to_map, from_solve): (SyncSender<Batch>, Receiver<Batch>) = sync_channel(1);
    let (to_write, from_map) = sync_channel(1);
    let (to_reuse, reusable) = sync_channel(4);
    for _ in 0..4 {
        let _ = to_reuse.send(Batch::default());
    }
    std::thread::scope(|scope| {
        scope.spawn(move || {
            for mut batch in from_solve {
                mapper.map(&mut batch);
                if to_write.send(batch).is_err() {
                    return;
                }
            }
        });
        let writing = scope.spawn(move || -> Result<()> {
            for batch in from_map {
                writer.write(&batch)?;
                let _ = to_reuse.send(batch);
            }
            Ok(())
        });
        // A receiver that hung up means that a later stage failed; its error is the one that tells.
        let mut solve = || -> Result<()> {
            while let Ok(mut batch) = reusable.recv() {
                if !solver.fill(&mut batch)? || to_map.send(batch).is_err() {
                    break;
                }
            }
            Ok(())
        };
        let solved = solve();
        drop(to_map);
        let written = writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        written.and(solved)
    })
}

/// First stage: markers → targets → proxy poses.
struct Solver<'a> {
    job: Job<'a>,
    oriented: OrientedTargets,
    progress: &'a (dyn Fn(Progress) + Sync),
    next: usize,
    targets: Targets,
    present: Vec<bool>,
    fading: Fading,
    /// Before the first frame.
    cold: bool,
    distances: Vec<f64>,
    outcome: Outcome,
}

impl<'a> Solver<'a> {
    fn new(job: Job<'a>, progress: &'a (dyn Fn(Progress) + Sync)) -> Self {
        let handles = job.handles.len();
        Self {
            next: job.range.start.saturating_sub(PRE_ROLL),
            targets: Targets { positions: vec![DVec3::ZERO; handles], presence: vec![0.0; handles] },
            present: vec![false; handles],
            fading: Fading::new(handles),
            cold: true,
            distances: Vec::with_capacity(handles + job.oriented.len()),
            oriented: OrientedTargets::new(job.oriented, &job.header.proxy.rest),
            outcome: Outcome { volume: (f64::INFINITY, f64::NEG_INFINITY), ..Outcome::default() },
            progress,
            job,
        }
    }

    /// Solves the next frames into `batch`; false when there is none left.
    fn fill(&mut self, batch: &mut Batch) -> Result<bool> {
        batch.measures.clear();
        while batch.measures.len() < BATCH && self.next < self.job.range.end {
            let frame = self.next;
            let measure = self.solve(frame).map_err(|e| {
                if e.place.is_none() && e.kind != Kind::Interrupted {
                    e.at(format!("frame {}", self.job.first_frame + frame as i64))
                } else {
                    e
                }
            })?;
            self.next += 1;
            if frame < self.job.range.start {
                continue;
            }
            let slot = batch.measures.len();
            if slot == 0 {
                batch.first = frame - self.job.range.start;
            }
            if batch.proxy.len() <= slot {
                batch.proxy.push(Vec::new());
                batch.holds.push(Vec::new());
                batch.targets.push(Vec::new());
                batch.weights.push(Vec::new());
            }
            batch.proxy[slot].clear();
            batch.proxy[slot].extend_from_slice(self.job.deformer.pose());
            self.handles(&mut batch.holds[slot], &mut batch.targets[slot]);
            batch.weights[slot].clear();
            batch.weights[slot].extend_from_slice(self.job.deformer.weights());
            batch.measures.push(measure);
            self.note(&measure);
            (self.progress)(Progress::Frames(self.outcome.frames));
        }
        Ok(!batch.measures.is_empty())
    }

    fn solve(&mut self, frame: usize) -> Result<FrameMeasure> {
        self.job.header.cancel.check()?;
        let start = Instant::now();
        self.job.binding.targets(self.job.take, frame, &mut self.targets.positions, &mut self.present);
        let passage = self.fading.follow(self.job.handles, self.job.deformer.pose(), &self.present, &mut self.targets);
        let places = if self.job.oriented.is_empty() { &[] } else { self.job.binding.turning.frame(frame) };
        let placements = self.oriented.place(places, self.job.deformer.pose(), passage);
        self.job.deformer.place(placements)?;
        let stats = if std::mem::take(&mut self.cold) {
            self.job.deformer.start(&self.targets)?
        } else {
            self.job.deformer.step(&self.targets)?
        };
        let solve_ms = start.elapsed().as_secs_f64() * 1e3;
        let residual = self.residual();
        let error = stats.error.map(|error| error * self.millimetres());
        Ok(FrameMeasure { frame: self.job.first_frame + frame as i64, stats, residual, error, solve_ms })
    }

    /// In a diagonal; those of the scan's unit where that is not known in metres.
    fn millimetres(&self) -> f64 {
        self.job.header.unit_box.diagonal * self.job.metres.map_or(1.0, |m| m * 1000.0)
    }

    fn residual(&mut self) -> Residual {
        let millimetres = self.millimetres();
        let pose = self.job.deformer.pose();
        self.distances.clear();
        let mut residual = Residual::default();
        for (h, handle) in self.job.handles.iter().enumerate() {
            if self.present[h] {
                let distance = handle.row.apply(pose).distance(self.targets.positions[h]) * millimetres;
                if residual.worst.is_none() || distance > residual.max {
                    residual.max = distance;
                    residual.worst = Some(h);
                }
                self.distances.push(distance);
            }
        }
        for (h, distance) in self.oriented.distances(pose) {
            let (h, distance) = (self.job.handles.len() + h, distance * millimetres);
            if residual.worst.is_none() || distance > residual.max {
                residual.max = distance;
                residual.worst = Some(h);
            }
            self.distances.push(distance);
        }
        self.distances.sort_unstable_by(f64::total_cmp);
        if let Some(&median) = self.distances.get(self.distances.len() / 2) {
            residual.median = median;
        }
        residual
    }

    /// Where all handles hold the body, and where they should be.
    fn handles(&self, holds: &mut Vec<DVec3>, targets: &mut Vec<DVec3>) {
        let pose = self.job.deformer.pose();
        holds.clear();
        targets.clear();
        holds.extend(self.job.handles.iter().map(|h| h.row.apply(pose)));
        let places = self.targets.positions.iter().zip(&self.present);
        targets.extend(places.map(|(target, present)| if *present { *target } else { DVec3::NAN }));
        for (hold, target) in self.oriented.places(pose) {
            holds.push(hold);
            targets.push(target.unwrap_or(DVec3::NAN));
        }
    }

    fn note(&mut self, m: &FrameMeasure) {
        let out = &mut self.outcome;
        out.frames += 1;
        let weights = self.job.deformer.weights();
        out.weights.resize(weights.len(), WeightRange::default());
        out.weights.iter_mut().zip(weights).for_each(|(range, weight)| range.add(*weight));
        out.passes += u64::from(m.stats.passes);
        out.stage_ms[0] += m.solve_ms;
        out.volume = (out.volume.0.min(m.stats.volume_ratio), out.volume.1.max(m.stats.volume_ratio));
        for &d in &self.distances {
            out.residuals.add(d);
        }
        match m.residual.worst {
            Some(h) if out.worst.is_none_or(|(d, ..)| m.residual.max > d) => out.worst = Some((m.residual.max, h, m.frame)),
            Some(_) => {}
            None => out.held.add(m.frame),
        }
        if m.stats.inverted > 10 {
            out.folds.add(m.frame);
            if let Some(part) = m.stats.fold.and_then(|p| self.job.binding.part_at(p)) {
                match out.folding.iter_mut().find(|f| f.0 == part) {
                    Some(known) => known.1 += 1,
                    None => out.folding.push((part, 1)),
                }
                out.folding.sort_by_key(|f| std::cmp::Reverse(f.1));
            }
        }
        if !m.stats.converged {
            out.unsolved.add(m.frame);
            out.unsolved_error = m.stats.error.map(|e| e.max(out.unsolved_error.unwrap_or(0.0))).or(out.unsolved_error);
        }
        if m.stats.recovered {
            out.recovered.add(m.frame);
        }
    }
}

/// Second stage: proxy poses → scan vertices and normals.
struct Mapper {
    header: Arc<Header>,
    needs: Needs,
    /// If normals are needed.
    fans: Option<Fans>,
}

impl Mapper {
    fn map(&self, batch: &mut Batch) {
        let start = Instant::now();
        let frames = batch.measures.len();
        if self.needs.points {
            batch.points.resize_with(frames, Vec::new);
            let mut poses: [&[DVec3]; BATCH] = [&[]; BATCH];
            for (slot, pose) in poses.iter_mut().zip(&batch.proxy) {
                *slot = pose;
            }
            self.header.map.apply(&poses[..frames], &mut batch.points);
        }
        if let Some(fans) = &self.fans {
            batch.normals.resize_with(frames, Vec::new);
            let mut points: [&[[f32; 3]]; BATCH] = [&[]; BATCH];
            for (points, frame) in points.iter_mut().zip(&batch.points) {
                *points = frame;
            }
            fans.compute(&points[..frames], &mut batch.normals);
        }
        batch.map_ms = start.elapsed().as_secs_f64() * 1e3;
    }
}

/// Third stage: into the files.
struct Writer {
    sinks: Vec<Box<dyn FrameSink>>,
    report: Option<ReportWriter>,
    names: Vec<String>,
    /// Where the handles hold the body at rest.
    rest: Vec<DVec3>,
    /// Names of the examples.
    examples: Vec<String>,
    metres: Option<f64>,
    map_ms: f64,
    write_ms: f64,
}

impl Writer {
    fn write(&mut self, batch: &Batch) -> Result<()> {
        let start = Instant::now();
        let frames = batch.measures.len();
        let out = FrameBatch {
            first: batch.first,
            proxy: &batch.proxy[..frames],
            points: &batch.points[..frames.min(batch.points.len())],
            normals: &batch.normals[..frames.min(batch.normals.len())],
        };
        let measures = Measures {
            frames: &batch.measures,
            names: &self.names,
            examples: &self.examples,
            weights: &batch.weights[..frames],
            rest: &self.rest,
            holds: &batch.holds[..frames],
            targets: &batch.targets[..frames],
            metres: self.metres,
        };
        for sink in &mut self.sinks {
            sink.measured(&measures)?;
            sink.frames(&out)?;
        }
        let write_ms = start.elapsed().as_secs_f64() * 1e3;
        self.map_ms += batch.map_ms;
        self.write_ms += write_ms;
        if let Some(report) = &mut self.report {
            for (measure, weights) in batch.measures.iter().zip(&batch.weights) {
                report.frame(measure, batch.map_ms / frames as f64, write_ms / frames as f64, &self.names, weights)?;
            }
        }
        Ok(())
    }
}

/// Which frames of a take to run for `--frames A..B`.
///
/// # Errors
/// [`Kind::Usage`] when the take has no such frame.
pub fn select(first_frame: i64, frames: usize, wanted: Option<(i64, i64)>) -> Result<Range<usize>> {
    let last = first_frame + frames as i64 - 1;
    let Some((a, b)) = wanted else { return Ok(0..frames) };
    if b < first_frame || a > last {
        return Err(Error::new(Kind::Usage, format!("--frames {a}..{b}: the take has no such frame"))
            .expected(format!("a range within {first_frame}..{last}"))
            .hint(format!("--frames {first_frame}..{last}")));
    }
    Ok((a.max(first_frame) - first_frame) as usize..(b.min(last) - first_frame + 1) as usize)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_cut_to_the_take_and_refused_outside_it() {
        assert_eq!(select(143, 320, None).unwrap(), 0..320);
        assert_eq!(select(143, 320, Some((150, 160))).unwrap(), 7..18);
        assert_eq!(select(143, 320, Some((1, 10_000))).unwrap(), 0..320);
        let error = select(143, 320, Some((1, 100))).unwrap_err();
        assert_eq!(error.kind, Kind::Usage);
        assert!(error.to_string().contains("143..462"), "{error}");
    }
}
