//! What the takes of a manifest would need: measured where they are done, else from the sizes of scan and capture.

use super::table::print_value;
use super::{Fate, parse};
use crate::batch::manifest::{Manifest, Take};
use crate::batch::record::{Record, Summary};
use crate::capture::handles_csv::HandleTable;
use crate::capture::{self, ReadOptions};
use crate::cli::args::{Animate, Batch};
use crate::cli::captures::read_options;
use crate::cli::console::Console;
use crate::error::Result;
use crate::export::Cancel;
use crate::{pipeline, scan, words};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

// Fitted to the table of docs/farm.md.
/// Seconds of set-up: of any scan, and per vertex.
const SETUP: (f64, f64) = (0.6, 4.5e-6);
/// Seconds per frame: of any scan, and per vertex.
const FRAME: (f64, f64) = (7e-3, 8e-9);
/// Megabytes: of any take, per vertex, and per marker and frame.
const MEMORY: (f64, f64, f64) = (60.0, 1.3e-3, 2e-4);
/// What a queue is asked for beside what is expected.
const MARGIN: f64 = 1.5;

/// What a take needs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Need {
    seconds: f64,
    megabytes: f64,
}

impl Need {
    /// Of a scan and a capture of these sizes, with two threads.
    fn of(vertices: usize, frames: usize, markers: usize) -> Self {
        let (vertices, frames) = (vertices as f64, frames as f64);
        Self {
            seconds: SETUP.0 + SETUP.1 * vertices + frames * (FRAME.0 + FRAME.1 * vertices),
            megabytes: MEMORY.0 + MEMORY.1 * vertices + MEMORY.2 * markers as f64 * frames,
        }
    }
}

/// First frame, frames, rate, markers or joints of a capture.
type Extent = (i64, usize, f64, usize);

/// Sizes of inputs, read once for all takes that share them.
#[derive(Default)]
struct Sizes {
    /// Vertices.
    scans: BTreeMap<PathBuf, Result<usize>>,
    /// By file and what of it is read.
    captures: BTreeMap<(PathBuf, String), Result<Extent>>,
}

impl Sizes {
    fn need(&mut self, args: &Animate) -> Result<Need> {
        let vertices = self.scans.entry(args.scan.clone()).or_insert_with(|| Ok(scan::read(&args.scan)?.mesh.positions.len()));
        let vertices = vertices.clone()?;
        // Repairs do not change how much there is.
        let options = ReadOptions { as_found: true, ..read_options(args) };
        let key = (args.capture.clone(), format!("{options:?}"));
        let capture = self.captures.entry(key).or_insert_with(|| measure(args, &options));
        let (first, frames, rate, markers) = capture.clone()?;
        let range = pipeline::select(first, frames, args.frames)?;
        let frames = range.len() as f64 * args.fps.map_or(1.0, |fps| fps / rate);
        Ok(Need::of(vertices, frames.ceil() as usize, markers))
    }
}

fn measure(args: &Animate, options: &ReadOptions) -> Result<Extent> {
    if capture::is_handle_table(&args.capture) {
        let table = HandleTable::read(&args.capture)?;
        let capture = table.empty_capture(args.rate.unwrap_or(HandleTable::RATE));
        return Ok((capture.first_frame, table.frames(), capture.rate, 1));
    }
    let capture = capture::read(&args.capture, options)?;
    let points = capture.motion.points();
    Ok((capture.first_frame, points.frames(), capture.rate, points.markers()))
}

/// Prints what each take needs, and what to ask a queue for.
pub(super) fn run(args: &Batch, manifest: &Manifest, console: &Console, cancel: &Cancel) -> Result<()> {
    let mut sizes = Sizes::default();
    let mut rows = Vec::new();
    for take in &manifest.takes {
        cancel.check()?;
        let record = Record::read(&Record::path(manifest, take));
        let done = Record::due(record.as_ref(), manifest, take).is_none();
        rows.push((take, record.filter(|_| done).map(Fate::DoneBefore), sizes.need(&parse(manifest, take)?)));
    }
    // Another machine is faster or slower by the same factor throughout.
    let mut ratios: Vec<f64> =
        rows.iter().filter_map(|(_, fate, need)| Some(fate.as_ref()?.summary()?.seconds / need.as_ref().ok()?.seconds)).collect();
    ratios.sort_by(f64::total_cmp);
    let slower = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);

    let mut asked = Need::default();
    let mut values = Vec::new();
    for (take, fate, need) in &rows {
        let measured = fate.as_ref().and_then(Fate::summary);
        let need = match (measured, need) {
            (Some(summary), _) => Ok(measured_need(summary)),
            (None, Ok(need)) => Ok(Need { seconds: need.seconds * slower, ..*need }),
            (None, Err(error)) => Err(error),
        };
        if let Ok(need) = need {
            asked.seconds = asked.seconds.max(need.seconds);
            asked.megabytes = asked.megabytes.max(need.megabytes);
        }
        values.push(row(take, measured.is_some(), &need, console));
    }
    let seconds = (asked.seconds * MARGIN).ceil().max(60.0);
    let megabytes = ((asked.megabytes * MARGIN) / 64.0).ceil().max(1.0) * 64.0;
    console.station("ask", &format!("--array=1-{} --mem={megabytes:.0}M --time={}", rows.len(), clock(seconds)));
    if args.json {
        print_value(&json!({ "takes": values, "ask": { "takes": rows.len(), "megabytes": megabytes, "seconds": seconds } }))?;
    }
    Ok(())
}

fn measured_need(summary: &Summary) -> Need {
    Need { seconds: summary.seconds, megabytes: summary.peak_mb.unwrap_or(0.0) }
}

fn row(take: &Take, done: bool, need: &Result<Need, &crate::error::Error>, console: &Console) -> Value {
    let head = format!("{}  {}", take.number, take.name());
    match need {
        Ok(need) => {
            let state = if done { "done" } else { "open" };
            console.station("take", &format!("{head}  {state} · {} · {:.0} MB", words::seconds(need.seconds), need.megabytes));
            json!({ "number": take.number, "done": done, "seconds": need.seconds, "megabytes": need.megabytes })
        }
        Err(error) => {
            console.station("failed", &format!("{head}  {error}"));
            json!({ "number": take.number, "done": done, "error": error.to_string() })
        }
    }
}

/// `hours:minutes:seconds`, as queues want it.
fn clock(seconds: f64) -> String {
    let s = seconds as u64;
    format!("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needs_grow_with_scan_and_take() {
        let (small, large) = (Need::of(13_000, 300, 41), Need::of(205_000, 300, 41));
        assert!(small.seconds < large.seconds && small.megabytes < large.megabytes);
        assert!(Need::of(13_000, 3_000, 41).seconds > 5.0 * small.seconds);
        assert_eq!(clock(3_725.0), "1:02:05");
        // What was measured as GLB (docs/farm.md), and what a queue is asked for: enough, and not far too much.
        for (vertices, frames, markers, seconds, megabytes) in
            [(20_547, 372, 41, 2.5, 74.0), (13_380, 1_151, 36, 11.1, 71.0), (204_712, 320, 35, 4.2, 277.0)]
        {
            let need = Need::of(vertices, frames, markers);
            let (time, space) = (MARGIN * need.seconds / seconds, MARGIN * need.megabytes / megabytes);
            assert!((1.0..3.0).contains(&time) && (1.0..3.0).contains(&space), "{vertices}: {time} {space}");
        }
    }
}
