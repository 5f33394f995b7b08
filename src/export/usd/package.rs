//! A package (`.usdz`): a crate and its textures in one file that phones and browsers open.
//!
//! A zip archive that stores its files as they are, each beginning at a multiple of 64 bytes, the crate first. Source: "Usdz File Format
//! Specification" of OpenUSD.

use super::Encoding;
use super::binary::Crate;
use super::tree::{Layer, Track};
use crate::error::{Error, Kind, Result};
use crate::export::Cancel;
use crate::export::files::Pending;
use flate2::Crc;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Files begin at multiples of this.
const ALIGNMENT: u64 = 64;
/// Number of the extra field that fills up to there.
const PADDING: u16 = 0x1986;
/// Bytes that are copied at a time.
const PIECE: usize = 1 << 20;
/// First of January 1980, the earliest day of a zip archive: the same bytes whenever it is written.
const DAY: u16 = 1 << 5 | 1;

/// A package that is being written.
#[derive(Debug)]
pub(super) struct Package {
    path: PathBuf,
    /// Grows in a file of its own, since the archive states its checksum before it.
    stage: Crate,
    name: String,
    /// Names in the package, and bytes.
    textures: Vec<(String, Vec<u8>)>,
    archive: Archive,
}

impl Package {
    /// `files`: for the crate on its way, and for the package itself at `path`.
    pub(super) fn begin(
        [stage, file]: [Pending; 2],
        layer: Layer,
        textures: Vec<(String, Vec<u8>)>,
        path: &Path,
    ) -> Result<Self> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let plain: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect();
        Ok(Self {
            path: path.to_owned(),
            stage: Crate::begin(stage, layer)?,
            name: format!("{plain}.usdc"),
            textures,
            archive: Archive { file, end: 0, directory: Vec::new(), files: 0 },
        })
    }

    /// Refuses what would pass the 4 GiB of a zip archive before it is computed.
    pub(super) fn check_size(path: &Path, bytes: u64) -> Result<()> {
        if bytes < u64::from(u32::MAX) {
            return Ok(());
        }
        Err(Error::new(Kind::Unsupported, format!("a package of {bytes} bytes"))
            .file(path)
            .expected("less than 4 GiB, which is what the format holds")
            .hint("-o FILE.usdc, or fewer --frames"))
    }
}

impl Encoding for Package {
    fn sample(&mut self, track: Track, code: i64, values: &[[f32; 3]]) -> Result<()> {
        self.stage.sample(track, code, values)
    }

    fn complete(&mut self, cancel: &Cancel) -> Result<()> {
        self.stage.complete(cancel)?;
        let unreadable = |e| Error::unreadable(&self.path, &e);
        let file = self.stage.file_mut();
        let length = file.seek(SeekFrom::End(0)).map_err(unreadable)?;
        Self::check_size(
            &self.path,
            length + self.textures.iter().map(|(name, b)| (b.len() + 2 * name.len() + 256) as u64).sum::<u64>(),
        )?;
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let mut entry = self.archive.begin(&self.name)?;
        let mut piece = vec![0; PIECE];
        loop {
            cancel.check()?;
            let read = file.read(&mut piece).map_err(unreadable)?;
            if read == 0 {
                break;
            }
            self.archive.append(&mut entry, &piece[..read])?;
        }
        self.archive.end(entry)?;
        for (name, bytes) in std::mem::take(&mut self.textures) {
            let mut entry = self.archive.begin(&name)?;
            self.archive.append(&mut entry, &bytes)?;
            self.archive.end(entry)?;
        }
        self.archive.close()
    }

    fn finish(self: Box<Self>) -> Result<u64> {
        self.archive.file.finish()
    }
}

/// A zip archive of stored files.
#[derive(Debug)]
struct Archive {
    file: Pending,
    end: u64,
    directory: Vec<u8>,
    files: u16,
}

/// A file on its way into an archive.
struct Entry {
    name: String,
    /// Where its local header is.
    place: u64,
    extra: Vec<u8>,
    crc: Crc,
    length: u64,
}

impl Archive {
    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.end += bytes.len() as u64;
        self.file.write(bytes)
    }

    fn begin(&mut self, name: &str) -> Result<Entry> {
        let place = self.end;
        let before = place + 30 + name.len() as u64 + 4;
        let padding = before.next_multiple_of(ALIGNMENT) - before;
        let extra = [&PADDING.to_le_bytes()[..], &(padding as u16).to_le_bytes(), &vec![0; padding as usize]].concat();
        let entry = Entry { name: name.to_owned(), place, extra, crc: Crc::new(), length: 0 };
        // Once more when checksum and length are known.
        let header = entry.local();
        self.write(&header)?;
        Ok(entry)
    }

    fn append(&mut self, entry: &mut Entry, bytes: &[u8]) -> Result<()> {
        entry.crc.update(bytes);
        entry.length += bytes.len() as u64;
        self.write(bytes)
    }

    fn end(&mut self, entry: Entry) -> Result<()> {
        self.file.patch(entry.place, &entry.local())?;
        self.directory.extend(entry.central());
        self.files += 1;
        Ok(())
    }

    fn close(&mut self) -> Result<()> {
        let start = self.end;
        let directory = std::mem::take(&mut self.directory);
        self.write(&directory)?;
        let mut tail = b"PK\x05\x06\0\0\0\0".to_vec();
        tail.extend([self.files.to_le_bytes(), self.files.to_le_bytes()].concat());
        tail.extend([(directory.len() as u32).to_le_bytes(), (start as u32).to_le_bytes()].concat());
        tail.extend([0, 0]);
        self.write(&tail)
    }
}

impl Entry {
    /// What both headers say: from the version that is needed to the lengths of name and extra field.
    fn common(&self, extra: usize) -> Vec<u8> {
        let words = |values: &[u16]| values.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let longs = [self.crc.sum(), self.length as u32, self.length as u32].map(u32::to_le_bytes).concat();
        [words(&[10, 0, 0, 0, DAY]), longs, words(&[self.name.len() as u16, extra as u16])].concat()
    }

    fn local(&self) -> Vec<u8> {
        [b"PK\x03\x04", &self.common(self.extra.len())[..], self.name.as_bytes(), &self.extra].concat()
    }

    fn central(&self) -> Vec<u8> {
        let place = (self.place as u32).to_le_bytes();
        [b"PK\x01\x02\x0A\0", &self.common(0)[..], &[0; 10], &place, self.name.as_bytes()].concat()
    }
}
