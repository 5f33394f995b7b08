//! Measures of a run, and the report file, which is written as frames finish.

use crate::error::Result;
use crate::export::files::Pending;
use crate::export::{FrameMeasure, Written, rounded};
use serde_json::{Value, json};
use std::path::Path;

/// Version of the layout of the report file; `docs/report.schema.json` describes it.
pub const VERSION: u32 = 1;

/// Text kept back until it is worth a write.
const BUFFER: usize = 1 << 16;

/// Writes the report file beside its target and renames it at the end.
#[derive(Debug)]
pub struct ReportWriter {
    file: Pending,
    buffer: String,
    frames: usize,
}

impl ReportWriter {
    /// Opens the file and writes the head: inputs, decisions, set-up times.
    ///
    /// # Errors
    /// [`crate::error::Kind::Unwritable`], here and in the other functions.
    pub fn begin(target: &Path, head: &[(&str, Value)]) -> Result<Self> {
        let mut buffer = format!("{{\n\"version\": {VERSION}");
        for (key, value) in head {
            buffer += &format!(",\n{}: {value}", json!(key));
        }
        buffer += ",\n\"frames\": [";
        Ok(Self { file: Pending::create(target)?, buffer, frames: 0 })
    }

    /// Adds a frame. `names` are the names of the handles, `weights` those of the examples.
    pub fn frame(&mut self, m: &FrameMeasure, map_ms: f64, write_ms: f64, names: &[String], weights: &[f64]) -> Result<()> {
        let mut value = json!({
            "frame": m.frame,
            "iterations": m.stats.passes,
            "ms": { "solve": rounded(m.solve_ms), "map": rounded(map_ms), "write": rounded(write_ms) },
            "residual_mm": {
                "median": rounded(m.residual.median),
                "max": rounded(m.residual.max),
                "worst": m.residual.worst.map(|h| names[h].as_str()),
            },
            "error_mm": m.error.map(rounded),
            "volume_ratio": rounded(m.stats.volume_ratio),
            "inverted_tets": m.stats.inverted,
            "converged": m.stats.converged,
        });
        if !weights.is_empty() {
            value["weights"] = weights.iter().map(|w| rounded(*w)).collect();
            value["energy"] = rounded(m.stats.energy);
        }
        if let Some(v) = m.stats.violation {
            let [axis, limit] = [v.axis, v.limit].map(|x| rounded(x.to_degrees()));
            value["joints"] = json!({ "gap": rounded(v.gap), "axis_deg": axis, "limit_deg": limit, "slide": rounded(v.slide) });
        }
        let separator = if self.frames == 0 { "\n" } else { ",\n" };
        self.frames += 1;
        self.buffer += &format!("{separator}{value}");
        if self.buffer.len() >= BUFFER {
            self.file.write(self.buffer.as_bytes())?;
            self.buffer.clear();
        }
        Ok(())
    }

    /// Writes outputs, warnings and memory, and puts the file in place.
    pub fn finish(mut self, written: &[Written], metres: Option<f64>, warnings: &[String]) -> Result<()> {
        let mm = metres.unwrap_or(0.001) * 1000.0;
        let outputs: Vec<Value> = written
            .iter()
            .map(|w| {
                json!({
                    "path": w.path.display().to_string(),
                    "bytes": w.bytes,
                    "encoding": w.encoding,
                    "max_error_mm": rounded(w.max_error * mm),
                    "rms_error_mm": rounded(w.rms_error * mm),
                    "worst_frame": w.worst_frame,
                })
            })
            .collect();
        self.buffer += &format!(
            "\n],\n\"outputs\": {},\n\"warnings\": {},\n\"peak_mb\": {}\n}}\n",
            json!(outputs),
            json!(warnings),
            json!(peak_megabytes())
        );
        self.file.write(self.buffer.as_bytes())?;
        self.file.finish().map(drop)
    }
}

/// The largest memory that the process has held so far, in megabytes; `None` where the system does not tell.
pub fn peak_megabytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some((kilobytes * 1.024).round() / 1000.0)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::export::Residual;

    #[test]
    fn a_report_is_json_and_is_absent_until_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        let mut report = ReportWriter::begin(&path, &[("inputs", json!({"scan": "a \"b\".obj"}))]).unwrap();
        let m = FrameMeasure { frame: 143, residual: Residual { median: 0.4, max: 9.0, worst: Some(0) }, ..Default::default() };
        report.frame(&m, 1.0, 2.0, &["RELB".into()], &[]).unwrap();
        report.frame(&m, 1.0, f64::NAN, &["RELB".into()], &[]).unwrap();
        assert!(!path.exists());
        report.finish(&[Written { bytes: 7, ..Default::default() }], Some(0.001), &["careful".into()]).unwrap();
        let value: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(value["frames"].as_array().unwrap().len(), 2);
        assert_eq!(value["frames"][0]["residual_mm"]["worst"], "RELB");
        assert_eq!(value["outputs"][0]["bytes"], 7);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
