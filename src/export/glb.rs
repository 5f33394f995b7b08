//! Binary glTF: the motion as a skin of rigid joints that every viewer plays, corrected by morph targets where joints do not help, or as morph
//! targets alone.
//!
//! Positions are the scan's own, in its unit and axes; only a scan that lies far from the origin is written around the origin, under a node with
//! the offset, since single precision would lose its detail. Vertex colours are converted from sRGB to the linear light that glTF asks for.

use super::encode::{Encode, Tolerance};
use super::files::Pending;
use super::{FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Error, Result};
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::sync::Arc;

mod container;
mod document;
mod geometry;
mod looks;
mod morphs;
mod names;
mod recording;

pub(super) use geometry::is_solid;
pub(super) use looks::{linear, load as load_image};
pub use recording::Recording;
pub(super) use recording::file_space;

/// How a motion is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// How near it has to come; a motion that cannot be stored so is an error.
    pub tolerance: Tolerance,
    /// By what.
    pub encode: Encode,
    /// Whether every vertex carries the number of the scan's vertex that it is a copy of, as the attribute `_SOURCE_INDEX`.
    pub source_index: bool,
}

/// Writes an animated GLB.
#[derive(Debug)]
pub struct GlbSink {
    path: PathBuf,
    recording: Recording,
    file: Option<Pending>,
}

impl GlbSink {
    /// A sink for `path` that stays within 0.25 % of the diagonal at the worst vertex and 0.05 % root mean square.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self::of(path, &Recording::new(Options::default()))
    }

    /// A sink for what is recorded, which other sinks may write, too: it is encoded once.
    pub fn of(path: impl Into<PathBuf>, recording: &Recording) -> Self {
        Self { path: path.into(), recording: recording.clone(), file: None }
    }
}

impl FrameSink for GlbSink {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        // The file first: it makes the folder.
        self.file = Some(Pending::create(&self.path)?);
        self.recording.begin(&self.path, header)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        self.recording.push(batch)
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        let Some(mut file) = self.file.take() else {
            return Err(Error::refused("no frames").file(&self.path));
        };
        let mut out = BufWriter::with_capacity(1 << 20, file.file_mut());
        let written = self.recording.write(&self.path, &mut out)?;
        out.flush().map_err(|e| Error::unwritable(&self.path, &e))?;
        drop(out);
        Ok(Written { bytes: file.finish()?, ..written })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod reader;
#[cfg(test)]
pub(super) mod tests;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tolerance_tests;
