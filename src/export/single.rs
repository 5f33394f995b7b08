//! Scan vertices in the single precision of the caches, and what is lost by it.

use super::Written;
use crate::error::Notes;
use crate::scan::UnitBox;
use glam::Vec3;
use std::path::PathBuf;

/// Loss of 32-bit coordinates, as a fraction of the diagonal, from which on it is reported: a man by 2 micrometres.
const NOTABLE: f64 = 1e-6;

/// Brings frames from the unit box into the scan's own space, in single precision.
#[derive(Debug)]
pub(super) struct Singles {
    unit_box: UnitBox,
    first_frame: i64,
    frames: usize,
    points: Vec<[f32; 3]>,
    largest: f64,
    sum_of_squares: f64,
    worst: usize,
}

impl Singles {
    /// For scans of so many vertices. `first_frame`: the number of the first frame.
    pub(super) fn new(vertices: usize, unit_box: UnitBox, first_frame: i64) -> Self {
        let points = vec![[0.0; 3]; vertices];
        Self { unit_box, first_frame, frames: 0, points, largest: 0.0, sum_of_squares: 0.0, worst: 0 }
    }

    /// Frames so far.
    pub(super) fn frames(&self) -> usize {
        self.frames
    }

    /// The vertices of the next frame in the scan's space. Panics when there are not as many as the scan has.
    pub(super) fn frame(&mut self, points: &[[f32; 3]]) -> &[[f32; 3]] {
        assert_eq!(points.len(), self.points.len(), "a frame has all vertices of the scan");
        let before = self.largest;
        for (single, &point) in self.points.iter_mut().zip(points) {
            let exact = self.unit_box.leave(Vec3::from(point).as_dvec3());
            let rounded = exact.as_vec3();
            *single = rounded.to_array();
            let lost = exact - rounded.as_dvec3();
            self.sum_of_squares += lost.length_squared();
            self.largest = self.largest.max(lost.length());
        }
        if self.largest > before {
            self.worst = self.frames;
        }
        self.frames += 1;
        &self.points
    }

    /// What is said of the file: coordinates of the size of the scan itself are as exact as the motion; far from the origin they are not.
    pub(super) fn written(&self, path: PathBuf, bytes: u64, format: &str, mut notes: Notes) -> Written {
        let mut written = Written { path, bytes, encoding: "exact".to_owned(), ..Written::default() };
        if self.largest > NOTABLE * self.unit_box.diagonal {
            let largest = self.largest;
            notes.warn(format!(
                "the scan lies so far from the origin that the 32-bit coordinates of {format} are off by up to {largest:.2e}"
            ));
            written.encoding = "32-bit coordinates".to_owned();
            written.max_error = largest;
            written.rms_error = (self.sum_of_squares / (self.frames * self.points.len()).max(1) as f64).sqrt();
            written.worst_frame = Some(self.first_frame + self.worst as i64);
        }
        written.notes = notes;
        written
    }
}

/// Numbers as bytes by `convert` (`f32::to_le_bytes`, `f32::to_be_bytes`); `out` is resized where needed.
pub(super) fn bytes<const N: usize>(values: &[[f32; N]], convert: impl Fn(f32) -> [u8; 4], out: &mut Vec<u8>) {
    out.resize(4 * N * values.len(), 0);
    for (bytes, &value) in out.chunks_exact_mut(4).zip(values.as_flattened()) {
        bytes.copy_from_slice(&convert(value));
    }
}
