//! A page that plays the result: one file, opened from disk by any browser with WebGL 2.
//!
//! It holds the GLB that [`super::glb::GlbSink`] would write, what was measured of every frame, and a player of its own (`page/`); nothing is
//! loaded from elsewhere.

use super::encode::spool::Spool;
use super::files::{Pending, folder_of};
use super::glb::{Options, Recording, file_space};
use super::{FrameBatch, FrameSink, Header, Measures, Needs, Written, rounded};
use crate::error::{Error, Result};
use crate::statistics::Spread;
use crate::words;
use base64::{Base64, encoded};
use glam::DVec3;
use serde_json::{Value, json};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod base64;

/// The page, with names in double braces for what is put in.
const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
/// One script in parts: what is above is known below.
const SCRIPT: &[&str] = &[
    include_str!("page/start.js"),
    include_str!("page/vectors.js"),
    include_str!("page/model.js"),
    include_str!("page/handles.js"),
    include_str!("page/shaders.js"),
    include_str!("page/renderer.js"),
    include_str!("page/camera.js"),
    include_str!("page/plot.js"),
    include_str!("page/main.js"),
];

/// Places in the page are steps of a box around all of them; this one stands for a place that is missing.
const MISSING: u16 = u16::MAX;

/// Tetrahedra that may be inverted before a frame counts as folded, as in the run's own words.
const FOLDED: u32 = 10;

/// Writes a page.
#[derive(Debug)]
pub struct PageSink {
    path: PathBuf,
    recording: Recording,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    header: Arc<Header>,
    // Dropped in this order: the measures go before the folder.
    measured: Measured,
    file: Pending,
}

/// What was measured so far. Numbers of a frame are kept in memory, places of handles on disk.
#[derive(Debug, Default)]
struct Measured {
    names: Vec<String>,
    rest: Vec<DVec3>,
    metres: Option<f64>,
    /// Holds, then targets, of each frame.
    places: Option<Spool>,
    /// Box of all of them.
    corners: Option<[DVec3; 2]>,
    max: Vec<f64>,
    median: Vec<f64>,
    worst: Vec<Option<usize>>,
    volume: Vec<f64>,
    examples: Vec<String>,
    /// Of each example in every frame.
    weights: Vec<Vec<f64>>,
    /// 1: not solved to the tolerance; 2: folded; 4: without any handle.
    flags: Vec<u8>,
}

impl PageSink {
    /// A sink for `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self::of(path, &Recording::new(Options::default()))
    }

    /// A sink for what is recorded, which other sinks may write, too: it is encoded once.
    pub fn of(path: impl Into<PathBuf>, recording: &Recording) -> Self {
        Self { path: path.into(), recording: recording.clone(), open: None }
    }

    fn opened(&mut self) -> &mut Open {
        self.open.as_mut().expect("a sink is begun before it gets frames")
    }
}

impl FrameSink for PageSink {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        // The file first: it makes the folder.
        let file = Pending::create(&self.path)?;
        self.recording.begin(&self.path, header)?;
        self.open = Some(Open { header: header.clone(), measured: Measured::default(), file });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        self.recording.push(batch)
    }

    fn measured(&mut self, measures: &Measures<'_>) -> Result<()> {
        let path = self.path.clone();
        self.opened().measured.take(folder_of(&path), measures).map_err(|e| e.file(&path))
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        let path = self.path;
        let Some(Open { header, measured, mut file }) = self.open.take() else {
            return Err(Error::refused("no frames").file(&path));
        };
        let unwritable = |e: std::io::Error| Error::unwritable(&path, &e);
        let mut out = BufWriter::with_capacity(1 << 20, file.file_mut());
        let (head, rest) = split(PAGE, "{{glb}}");
        let (between, tail) = split(rest, "{{run}}");
        let (tail, end) = split(tail, "{{script}}");
        let head = head.replace("{{title}}", &escaped(&title(&header))).replace("{{style}}", STYLE);
        out.write_all(head.as_bytes()).map_err(unwritable)?;
        let mut base64 = Base64::new(&mut out);
        let mut written = self.recording.write(&path, &mut base64)?;
        base64.finish().map_err(unwritable)?;
        // In a script element only its end tag has a meaning of its own; here no tag is left.
        let run = measured.describe(&header, &written).map_err(|e| e.file(&path))?.to_string().replace('<', "\\u003c");
        for text in [between, &run, tail].iter().chain(SCRIPT).chain(&[end]) {
            out.write_all(text.as_bytes()).map_err(unwritable)?;
        }
        out.flush().map_err(unwritable)?;
        drop(out);
        written.encoding = format!("page, {}", written.encoding);
        Ok(Written { bytes: file.finish()?, ..written })
    }
}

fn split<'a>(text: &'a str, at: &str) -> (&'a str, &'a str) {
    text.split_once(at).expect("the page has its places")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn title(header: &Header) -> String {
    let scan = header.scan.source.file_stem().unwrap_or_default().to_string_lossy();
    [scan.as_ref(), &header.take].into_iter().filter(|s| !s.is_empty()).collect::<Vec<_>>().join(" · ")
}

impl Measured {
    fn take(&mut self, folder: &Path, measures: &Measures<'_>) -> Result<()> {
        let handles = measures.names.len();
        if self.places.is_none() {
            self.places = Some(Spool::new(folder, 2 * handles)?);
            self.names = measures.names.to_vec();
            self.rest = measures.rest.to_vec();
            self.metres = measures.metres;
            self.examples = measures.examples.to_vec();
            self.weights = vec![Vec::new(); self.examples.len()];
        }
        for weights in measures.weights {
            self.weights.iter_mut().zip(weights).for_each(|(line, &w)| line.push(w));
        }
        let Some(spool) = &mut self.places else { return Ok(()) };
        for ((m, holds), targets) in measures.frames.iter().zip(measures.holds).zip(measures.targets) {
            let places: Vec<DVec3> = holds.iter().chain(targets).copied().collect();
            for &p in places.iter().filter(|p| p.is_finite()) {
                let [lo, hi] = self.corners.unwrap_or([p, p]);
                self.corners = Some([lo.min(p), hi.max(p)]);
            }
            spool.push(&places)?;
            self.max.push(m.residual.max);
            self.median.push(m.residual.median);
            self.worst.push(m.residual.worst);
            self.volume.push(m.stats.volume_ratio);
            let flags = [!m.stats.converged, m.stats.inverted > FOLDED, m.residual.worst.is_none()];
            self.flags.push(flags.iter().zip([1, 2, 4]).map(|(on, bit)| u8::from(*on) * bit).sum());
        }
        Ok(())
    }

    /// What the page's script reads. Places are in the coordinates of the GLB.
    fn describe(&self, header: &Header, written: &Written) -> Result<Value> {
        let space = file_space(&header.unit_box).0;
        let [lo, hi] = self.corners.unwrap_or_default();
        // Of size 1 where it has none: what is divided by it is 0.
        let step = ((hi - lo) / f64::from(MISSING - 1)).map(|s| if s > 0.0 { s } else { 1.0 });
        let mut paths = Vec::new();
        if let Some(spool) = &self.places {
            for frame in 0..spool.frames() {
                for p in spool.read_one(frame)? {
                    let steps = ((p - lo) / step).round();
                    let place = if p.is_finite() { steps.to_array().map(|s| s as u16) } else { [MISSING; 3] };
                    paths.extend(place.map(u16::to_le_bytes).as_flattened());
                }
            }
        }
        let numbers = |values: &[f64]| values.iter().map(|&x| rounded(x)).collect::<Vec<_>>();
        let unit = self.metres.map_or("", |_| "mm");
        let up = header.up.or(header.scan.space.up.map(|up| up.value.vector())).unwrap_or(DVec3::Y);
        Ok(json!({
            "summary": [title(header), self.summary(header, written)],
            "rate": header.rate,
            "first": header.first_frame,
            "frames": header.frames,
            "unit": unit,
            "perUnit": self.metres.map_or(1.0, |m| 1000.0 * m),
            "up": up.to_array(),
            "centre": space.shift.to_array(),
            "diagonal": space.scale,
            "handles": self.names,
            "rest": self.rest.iter().map(|&p| space.leave(p).to_array().map(rounded)).collect::<Vec<_>>(),
            "low": space.leave(lo).to_array(),
            "step": (step * space.scale).to_array(),
            "paths": encoded(&paths),
            "max": numbers(&self.max),
            "median": numbers(&self.median),
            "worst": self.worst,
            "volume": numbers(&self.volume),
            "examples": self.examples,
            "weights": self.weights.iter().map(|line| numbers(line)).collect::<Vec<_>>(),
            "flags": self.flags,
        }))
    }

    /// A line on the run.
    fn summary(&self, header: &Header, written: &Written) -> String {
        let mut parts = vec![format!("{} at {} fps", words::plural(header.frames, "frame"), (header.rate * 1e3).round() / 1e3)];
        let worst = (0..self.max.len()).filter(|&f| self.worst[f].is_some()).max_by(|&a, &b| self.max[a].total_cmp(&self.max[b]));
        if let Some(f) = worst {
            let mut spread = Spread::default();
            self.median.iter().zip(&self.worst).filter(|(_, w)| w.is_some()).for_each(|(&m, _)| spread.add(m));
            let unit = self.metres.map_or("", |_| " mm");
            let at = self.worst[f].and_then(|h| self.names.get(h)).map_or(String::new(), |name| format!("{name}, "));
            parts.push(format!(
                "residual median {}{unit}, largest {}{unit} ({at}frame {})",
                words::digits(spread.quantile(0.5)),
                words::digits(self.max[f]),
                header.first_frame + f as i64
            ));
        }
        parts.push(written.encoding.clone());
        let percent = 100.0 / header.unit_box.diagonal;
        parts.push(format!(
            "within {:.2} % of the diagonal, {:.3} % rms",
            written.max_error * percent,
            written.rms_error * percent
        ));
        parts.join(" · ")
    }
}

#[cfg(test)]
mod tests;
