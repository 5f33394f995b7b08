//! PointCache2: the scan's vertices in one file, for the mesh cache modifiers of Blender, 3ds Max and others.
//!
//! `POINTCACHE2\0`, i32 1, i32 points, f32 first frame, f32 samples per frame, i32 samples; then per sample f32 x y z of all points; all
//! little endian.

use super::files::Pending;
use super::single::{Singles, bytes};
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::UnitBox;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Byte of the number of samples, which is known at the end only.
const SAMPLES_AT: u64 = 28;

/// Writes a PC2 file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct Pc2 {
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

impl Pc2 {
    /// A sink for `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None }
    }

    pub(super) fn open(&mut self, points: usize, unit_box: UnitBox, first_frame: i64, cancel: &Cancel) -> Result<()> {
        let mut file = Pending::create(&self.path)?;
        let mut head = b"POINTCACHE2\0".to_vec();
        head.extend(1i32.to_le_bytes());
        head.extend((points as i32).to_le_bytes());
        head.extend((first_frame as f32).to_le_bytes());
        head.extend(1f32.to_le_bytes());
        head.extend(0i32.to_le_bytes());
        file.write(&head)?;
        let singles = Singles::new(points, unit_box, first_frame);
        self.open = Some(Open { file, singles, cancel: cancel.clone(), buffer: Vec::new() });
        Ok(())
    }
}

impl FrameSink for Pc2 {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: false }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        self.open(header.scan.mesh.positions.len(), header.unit_box, header.first_frame, &header.cancel)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        for points in batch.points {
            open.cancel.check()?;
            bytes(open.singles.frame(points), f32::to_le_bytes, &mut open.buffer);
            open.file.write(&open.buffer)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let mut open = self.open.expect("begin comes before finish");
        open.file.patch(SAMPLES_AT, &(open.singles.frames() as i32).to_le_bytes())?;
        let bytes = open.file.finish()?;
        Ok(open.singles.written(self.path, bytes, "PC2", Notes::default()))
    }
}
