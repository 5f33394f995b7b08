//! Values of every joint in every frame on disk, so that memory does not grow with the take.

use super::scratch::Scratch;
use crate::error::Result;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::path::Path;
use std::sync::Arc;

/// Frames of a block. Within a block each column is contiguous, so that a frame is read in one piece and a column in few.
const BLOCK: usize = 32;

/// Rows are frames, columns are joints. Clones share the file.
#[derive(Clone, Debug)]
pub struct Table<T> {
    file: Arc<Scratch>,
    columns: usize,
    frames: usize,
    kind: PhantomData<T>,
}

/// A table that still grows, frame by frame.
#[derive(Debug)]
pub struct Growing<T> {
    file: Scratch,
    columns: usize,
    frames: usize,
    /// The block that is not complete yet.
    last: Vec<T>,
}

impl<T: Pod> Growing<T> {
    /// A table without frames, its file in `folder`.
    pub fn new(folder: &Path, columns: usize) -> Result<Self> {
        Ok(Self { file: Scratch::new(folder)?, columns, frames: 0, last: vec![T::zeroed(); columns * BLOCK] })
    }

    /// Appends a frame.
    pub fn push(&mut self, row: &[T]) -> Result<()> {
        assert_eq!(row.len(), self.columns);
        let places = self.last.iter_mut().skip(self.frames % BLOCK).step_by(BLOCK);
        places.zip(row).for_each(|(place, value)| *place = *value);
        self.frames += 1;
        if self.frames.is_multiple_of(BLOCK) { self.write_block() } else { Ok(()) }
    }

    /// The table.
    pub fn finish(mut self) -> Result<Table<T>> {
        if !self.frames.is_multiple_of(BLOCK) {
            self.write_block()?;
        }
        Ok(Table { file: Arc::new(self.file), columns: self.columns, frames: self.frames, kind: PhantomData })
    }

    /// Writes the block of the latest frame, whole.
    fn write_block(&mut self) -> Result<()> {
        self.file.write(place::<T>(self.columns, (self.frames - 1) / BLOCK, 0), &self.last)
    }
}

impl<T: Pod> Table<T> {
    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The folder of the file.
    pub fn folder(&self) -> &Path {
        self.file.folder()
    }

    /// All columns of a frame.
    pub fn frame(&self, frame: usize) -> Result<Vec<T>> {
        assert!(frame < self.frames);
        let mut block = vec![T::zeroed(); self.columns * BLOCK];
        self.file.read(place::<T>(self.columns, frame / BLOCK, 0), &mut block)?;
        Ok(block.into_iter().skip(frame % BLOCK).step_by(BLOCK).collect())
    }

    /// A column over all frames.
    pub fn column(&self, column: usize) -> Result<Vec<T>> {
        assert!(column < self.columns);
        let mut values = vec![T::zeroed(); self.frames.next_multiple_of(BLOCK)];
        for (block, values) in values.chunks_exact_mut(BLOCK).enumerate() {
            self.file.read(place::<T>(self.columns, block, column), values)?;
        }
        values.truncate(self.frames);
        Ok(values)
    }
}

/// Where a column of a block begins, in bytes.
fn place<T>(columns: usize, block: usize, column: usize) -> u64 {
    ((block * columns + column) * BLOCK * size_of::<T>()) as u64
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_columns_come_back_whole_blocks_or_not() {
        let folder = tempfile::tempdir().unwrap();
        for frames in [1, 31, 32, 33, 100] {
            let value = |f: usize, k: usize| [f as f32, k as f32 + 0.5];
            let mut growing = Growing::new(folder.path(), 3).unwrap();
            for f in 0..frames {
                growing.push(&[value(f, 0), value(f, 1), value(f, 2)]).unwrap();
            }
            let table = growing.finish().unwrap();
            assert_eq!((table.columns(), table.frames()), (3, frames));
            for f in 0..frames {
                assert_eq!(table.frame(f).unwrap(), [0, 1, 2].map(|k| value(f, k)), "frame {f} of {frames}");
            }
            for k in 0..3 {
                assert_eq!(table.column(k).unwrap(), (0..frames).map(|f| value(f, k)).collect::<Vec<_>>());
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
