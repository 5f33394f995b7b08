//! A marker take as the binding reads it.

use crate::capture::MarkerTake;
use glam::DVec3;

/// Marker positions of a take, with mirrored axes undone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Track<'a> {
    pub take: &'a MarkerTake,
    pub mirror: bool,
}

impl Track<'_> {
    pub(crate) fn point(&self, frame: usize, marker: usize) -> Option<DVec3> {
        let p = self.take.point(frame, marker)?;
        Some(if self.mirror { DVec3::new(-p.x, p.y, p.z) } else { p })
    }

    /// At most `count` frames, evenly spread over the take.
    pub(crate) fn sample(&self, count: usize) -> Vec<usize> {
        let frames = self.take.frames();
        let n = frames.min(count);
        (0..n).map(|k| if n < 2 { 0 } else { k * (frames - 1) / (n - 1) }).collect()
    }

    /// Number of frames in which each marker is there.
    pub(crate) fn coverage(&self) -> Vec<usize> {
        let mut counts = vec![0; self.take.markers()];
        if !counts.is_empty() {
            for frame in self.take.points.chunks_exact(counts.len()) {
                for (count, p) in counts.iter_mut().zip(frame) {
                    *count += usize::from(!p[0].is_nan());
                }
            }
        }
        counts
    }
}
