//! MDD: the scan's vertices in one file with the time of every frame, for LightWave, Blender, Maya, Houdini and others.
//!
//! i32 frames, i32 points, f32 seconds of every frame, then per frame f32 x y z of all points; all big endian.

use super::files::Pending;
use super::single::{Singles, bytes};
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::UnitBox;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes an MDD file, in the scan's own unit, axes and vertex order. Frame N is at N ÷ rate seconds.
#[derive(Debug)]
pub struct Mdd {
    path: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    file: Pending,
    singles: Singles,
    cancel: Cancel,
    buffer: Vec<u8>,
}

impl Mdd {
    /// A sink for `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None }
    }

    /// `times`: the number of the first frame, how many there will be, and their rate.
    pub(super) fn open(&mut self, points: usize, unit_box: UnitBox, times: (i64, usize, f64), cancel: &Cancel) -> Result<()> {
        let (first_frame, frames, rate) = times;
        let mut file = Pending::create(&self.path)?;
        let mut head = Vec::with_capacity(8 + 4 * frames);
        head.extend((frames as i32).to_be_bytes());
        head.extend((points as i32).to_be_bytes());
        for frame in first_frame..first_frame + frames as i64 {
            head.extend(((frame as f64 / rate) as f32).to_be_bytes());
        }
        file.write(&head)?;
        let singles = Singles::new(points, unit_box, first_frame);
        self.open = Some(Open { file, singles, cancel: cancel.clone(), buffer: Vec::new() });
        Ok(())
    }
}

impl FrameSink for Mdd {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: false }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        let times = (header.first_frame, header.frames, header.rate);
        self.open(header.scan.mesh.positions.len(), header.unit_box, times, &header.cancel)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        for points in batch.points {
            open.cancel.check()?;
            bytes(open.singles.frame(points), f32::to_be_bytes, &mut open.buffer);
            open.file.write(&open.buffer)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        let bytes = open.file.finish()?;
        Ok(open.singles.written(self.path, bytes, "MDD", Notes::default()))
    }
}
