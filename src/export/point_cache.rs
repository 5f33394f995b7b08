//! Point caches: the scan's vertices of all frames in one file, and nothing else.
//!
//! PC2 (PointCache2, for the mesh cache modifiers of Blender, 3ds Max and others): `POINTCACHE2\0`, i32 1, i32 points, f32 first frame, f32 samples
//! per frame, i32 samples; then per sample f32 x y z of all points; all little endian. It has no rate.
//!
//! MDD (for LightWave, Blender, Maya, Houdini and others): i32 frames, i32 points, f32 seconds of every frame, then per frame f32 x y z of all
//! points; all big endian. Frame N is at N ÷ rate seconds.

use super::files::Pending;
use super::single::{Singles, bytes};
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::UnitBox;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes a PC2 or MDD file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct PointCache {
    path: PathBuf,
    format: Format,
    open: Option<Open>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Pc2,
    Mdd,
}

#[derive(Debug)]
struct Open {
    file: Pending,
    singles: Singles,
    cancel: Cancel,
    buffer: Vec<u8>,
}

/// When the frames are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    /// Number of the first.
    pub(super) first: i64,
    /// How many.
    pub(super) frames: usize,
    /// Per second.
    pub(super) rate: f64,
}

impl PointCache {
    /// A PC2 file at `path`.
    pub fn pc2(path: &Path) -> Self {
        Self { path: path.to_owned(), format: Format::Pc2, open: None }
    }

    /// An MDD file at `path`.
    pub fn mdd(path: &Path) -> Self {
        Self { path: path.to_owned(), format: Format::Mdd, open: None }
    }

    pub(super) fn open(&mut self, points: usize, unit_box: UnitBox, times: Times, cancel: &Cancel) -> Result<()> {
        let mut file = Pending::create(&self.path)?;
        file.write(&self.format.head(points, times))?;
        let singles = Singles::new(points, unit_box, times.first);
        self.open = Some(Open { file, singles, cancel: cancel.clone(), buffer: Vec::new() });
        Ok(())
    }
}

impl Format {
    fn name(self) -> &'static str {
        match self {
            Self::Pc2 => "PC2",
            Self::Mdd => "MDD",
        }
    }

    fn head(self, points: usize, Times { first, frames, rate }: Times) -> Vec<u8> {
        let (points, samples) = (points as i32, frames as i32);
        match self {
            Self::Pc2 => {
                let mut head = b"POINTCACHE2\0".to_vec();
                head.extend([1i32.to_le_bytes(), points.to_le_bytes()].concat());
                head.extend([(first as f32).to_le_bytes(), 1f32.to_le_bytes(), samples.to_le_bytes()].concat());
                head
            }
            Self::Mdd => {
                let seconds = (first..first + frames as i64).map(|frame| (frame as f64 / rate) as f32);
                let head = [samples.to_be_bytes(), points.to_be_bytes()];
                head.into_iter().chain(seconds.map(f32::to_be_bytes)).flatten().collect()
            }
        }
    }
}

impl FrameSink for PointCache {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: false }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        let times = Times { first: header.first_frame, frames: header.frames, rate: header.rate };
        self.open(header.scan.mesh.positions.len(), header.unit_box, times, &header.cancel)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        for points in batch.points {
            open.cancel.check()?;
            let points = open.singles.frame(points);
            // Two calls, so that each is compiled for its own order of bytes.
            match self.format {
                Format::Pc2 => bytes(points, f32::to_le_bytes, &mut open.buffer),
                Format::Mdd => bytes(points, f32::to_be_bytes, &mut open.buffer),
            }
            open.file.write(&open.buffer)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        let bytes = open.file.finish()?;
        Ok(open.singles.written(self.path, bytes, self.format.name(), Notes::default()))
    }
}
