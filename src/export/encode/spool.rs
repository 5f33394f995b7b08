//! Proxy poses on disk, so that memory does not grow with the take.

use crate::error::{Error, Result};
use glam::DVec3;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Poses of a fixed number of vertices in single precision, in an anonymous file that the system removes by itself.
#[derive(Debug)]
pub struct Spool {
    file: Mutex<File>,
    folder: PathBuf,
    vertices: usize,
    frames: usize,
}

impl Spool {
    /// An empty spool in `folder`.
    pub fn new(folder: &Path, vertices: usize) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(|e| Error::unwritable(folder, &e))?;
        Ok(Self { file: Mutex::new(file), folder: folder.to_path_buf(), vertices, frames: 0 })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of vertices of each frame.
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// Appends a pose.
    pub fn push(&mut self, pose: &[DVec3]) -> Result<()> {
        assert_eq!(pose.len(), self.vertices, "every pose has the proxy's vertices");
        let numbers: Vec<[f32; 3]> = pose.iter().map(|p| p.as_vec3().to_array()).collect();
        let end = self.frames as u64 * self.stride();
        let file = self.file.get_mut().unwrap_or_else(|poisoned| poisoned.into_inner());
        file.seek(SeekFrom::Start(end))
            .and_then(|_| file.write_all(bytemuck::cast_slice(&numbers)))
            .map_err(|e| Error::unwritable(&self.folder, &e))?;
        self.frames += 1;
        Ok(())
    }

    /// Reads consecutive frames.
    pub fn read(&self, first: usize, count: usize) -> Result<Vec<Vec<DVec3>>> {
        let mut numbers = vec![[0f32; 3]; count * self.vertices];
        {
            let mut file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            file.seek(SeekFrom::Start(first as u64 * self.stride()))
                .and_then(|_| file.read_exact(bytemuck::cast_slice_mut(&mut numbers)))
                .map_err(|e| Error::unreadable(&self.folder, &e))?;
        }
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
