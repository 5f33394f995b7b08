//! Proxy poses on disk, so that memory does not grow with the take.

use super::scratch::Scratch;
use crate::error::Result;
use glam::DVec3;
use std::path::Path;

/// Poses of a fixed number of vertices in single precision.
#[derive(Debug)]
pub struct Spool {
    file: Scratch,
    vertices: usize,
    frames: usize,
}

impl Spool {
    /// An empty spool in `folder`.
    pub fn new(folder: &Path, vertices: usize) -> Result<Self> {
        Ok(Self { file: Scratch::new(folder)?, vertices, frames: 0 })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The folder of the file.
    pub fn folder(&self) -> &Path {
        self.file.folder()
    }

    /// Appends a pose.
    pub fn push(&mut self, pose: &[DVec3]) -> Result<()> {
        assert_eq!(pose.len(), self.vertices, "every pose has the proxy's vertices");
        let numbers: Vec<[f32; 3]> = pose.iter().map(|p| p.as_vec3().to_array()).collect();
        let end = self.frames as u64 * self.stride();
        self.file.write(end, &numbers)?;
        self.frames += 1;
        Ok(())
    }

    /// Reads consecutive frames.
    pub fn read(&self, first: usize, count: usize) -> Result<Vec<Vec<DVec3>>> {
        let mut numbers = vec![[0f32; 3]; count * self.vertices];
        self.file.read(first as u64 * self.stride(), &mut numbers)?;
        let pose = |f: usize| &numbers[f * self.vertices..(f + 1) * self.vertices];
        Ok((0..count).map(|f| pose(f).iter().map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into())).collect()).collect())
    }

    /// Reads one frame.
    pub fn read_one(&self, frame: usize) -> Result<Vec<DVec3>> {
        Ok(self.read(frame, 1)?.pop().unwrap_or_default())
    }

    fn stride(&self) -> u64 {
        self.vertices as u64 * 12
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn poses_come_back_in_single_precision() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::new(folder.path(), 3).unwrap();
        let pose = |f: usize| (0..3).map(|i| DVec3::new(f as f64, i as f64 * 0.1, -1.0 / 3.0)).collect::<Vec<_>>();
        for f in 0..5 {
            spool.push(&pose(f)).unwrap();
        }
        assert_eq!(spool.frames(), 5);
        let back = spool.read(3, 2).unwrap();
        for (f, read) in back.iter().enumerate() {
            for (a, b) in read.iter().zip(pose(3 + f)) {
                assert!((*a - b).length() < 1e-7);
            }
        }
        assert!(spool.read(4, 2).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
