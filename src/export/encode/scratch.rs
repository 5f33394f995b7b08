//! An anonymous file that the system removes by itself.

use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Numbers at places of a file.
#[derive(Debug)]
pub struct Scratch {
    file: Mutex<File>,
    folder: PathBuf,
}

impl Scratch {
    /// An empty file in `folder`.
    pub fn new(folder: &Path) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(|e| Error::unwritable(folder, &e))?;
        Ok(Self { file: Mutex::new(file), folder: folder.to_path_buf() })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes from byte `at` on.
    pub fn write<T: Pod>(&mut self, at: u64, values: &[T]) -> Result<()> {
        let file = self.file.get_mut().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(at))
            .and_then(|_| file.write_all(bytemuck::cast_slice(values)))
            .map_err(|e| Error::unwritable(&self.folder, &e))
    }

    /// Reads from byte `at` on.
    pub fn read<T: Pod>(&self, at: u64, values: &mut [T]) -> Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(at))
            .and_then(|_| file.read_exact(bytemuck::cast_slice_mut(values)))
            .map_err(|e| Error::unreadable(&self.folder, &e))
    }
}
