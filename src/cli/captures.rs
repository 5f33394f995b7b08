//! What moves the scan: a capture, its static trial, tables of handles.

use super::args::Animate;
use super::rig::Rig;
use crate::binding::Binding;
use crate::capture::handles_csv::HandleTable;
use crate::capture::resample::Sampling;
use crate::capture::{self, Capture, ReadOptions};
use crate::error::{Error, Kind, Notes, Result};
use crate::pipeline;
use crate::words::{self, file_name};
use std::ops::Range;
use std::path::Path;

/// What moves the scan.
pub(super) struct Captures {
    pub(super) capture: Capture,
    /// The static trial.
    pub(super) reference: Option<Capture>,
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

/// What of the capture is read.
pub(super) fn read_options(args: &Animate) -> ReadOptions {
    ReadOptions {
        subject: args.subject.clone(),
        rate: args.rate,
        clip: args.clip.clone(),
        skeleton: args.skeleton.clone(),
        bodies: args.bodies,
        surface: args.surface,
        as_found: false,
    }
}

pub(super) fn read_captures(args: &Animate, rig: &Rig) -> Result<Captures> {
    let options = read_options(args);
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
