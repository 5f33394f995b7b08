//! PointCache2: the scan's vertices in one file, for the mesh cache modifiers of Blender, 3ds Max and others.
//!
//! `POINTCACHE2\0`, i32 1, i32 points, f32 first frame, f32 samples per frame, i32 samples; then per sample f32 x y z of all points; all
//! little endian.

use super::files::Pending;
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::UnitBox;
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Byte of the number of samples, which is known at the end only.
const SAMPLES_AT: u64 = 28;

/// Loss of 32-bit coordinates, as a fraction of the diagonal, from which on it is reported: a man by 2 micrometres.
const NOTABLE: f64 = 1e-6;

/// Writes a PC2 file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct Pc2 {
    path: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    file: Pending,
    points: usize,
    unit_box: UnitBox,
    first_frame: i64,
    samples: usize,
    cancel: Cancel,
    buffer: Vec<u8>,
    rounding: Rounding,
}

/// What 32-bit coordinates lose, in the scan's unit.
#[derive(Debug, Default)]
struct Rounding {
    largest: f64,
    sum_of_squares: f64,
    worst_sample: usize,
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
        self.open = Some(Open {
            file,
            points,
            unit_box,
            first_frame,
            samples: 0,
            cancel: cancel.clone(),
            buffer: vec![0; 12 * points],
            rounding: Rounding::default(),
        });
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
            assert_eq!(points.len(), open.points, "a frame has all vertices of the scan");
            open.sample(points)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let mut open = self.open.expect("begin comes before finish");
        open.file.patch(SAMPLES_AT, &(open.samples as i32).to_le_bytes())?;
        let bytes = open.file.finish()?;
        let mut written = Written { path: self.path, bytes, encoding: "exact".to_owned(), ..Written::default() };
        // Coordinates of the size of the scan itself are as exact as the motion; far from the origin they are not.
        let Rounding { largest, sum_of_squares, worst_sample } = open.rounding;
        if largest > NOTABLE * open.unit_box.diagonal {
            let mut notes = Notes::default();
            notes.warn(format!(
                "the scan lies so far from the origin that the 32-bit coordinates of PC2 are off by up to {largest:.2e}"
            ));
            written.encoding = "32-bit coordinates".to_owned();
            written.max_error = largest;
            written.rms_error = (sum_of_squares / (open.samples * open.points).max(1) as f64).sqrt();
            written.notes = notes;
            written.worst_frame = Some(open.first_frame + worst_sample as i64);
        }
        Ok(written)
    }
}

impl Open {
    fn sample(&mut self, points: &[[f32; 3]]) -> Result<()> {
        let before = self.rounding.largest;
        for (bytes, &point) in self.buffer.chunks_exact_mut(12).zip(points) {
            let exact = self.unit_box.leave(Vec3::from(point).as_dvec3());
            let rounded = exact.as_vec3();
            bytes.copy_from_slice(bytemuck::cast_slice(&rounded.to_array().map(|x| x.to_le_bytes())));
            let lost: DVec3 = exact - rounded.as_dvec3();
            self.rounding.sum_of_squares += lost.length_squared();
            self.rounding.largest = self.rounding.largest.max(lost.length());
        }
        if self.rounding.largest > before {
            self.rounding.worst_sample = self.samples;
        }
        self.samples += 1;
        self.file.write(&self.buffer)
    }
}
