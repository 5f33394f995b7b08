//! ZIP archives: their files by name, unpacked one by one within bounds.
//!
//! Source: PKWARE, APPNOTE.TXT 6.3; RFC 1951 for the packed data.

use crate::error::{Error, Kind, Result};
use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::io::Read;
use std::sync::Arc;

/// Unpacked bytes per byte of the archive above which it is refused, and what is always allowed: as for gzip.
const LARGEST_RATIO: u64 = crate::packing::LARGEST_RATIO;
const ALWAYS_ALLOWED: u64 = crate::packing::ALWAYS_ALLOWED;

/// Most files that are looked at; each is at least 46 bytes of directory.
const MOST: usize = 1 << 16;

/// An archive in memory.
pub(super) struct Archive {
    bytes: Vec<u8>,
    entries: Vec<Entry>,
    /// Files by their path in lower case; the first of equals.
    numbers: HashMap<String, usize>,
    /// Files that several others may name.
    shared: RefCell<HashMap<usize, Arc<[u8]>>>,
    /// Bytes that may still be unpacked.
    allowance: Cell<u64>,
}

/// A file of the archive.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// Its path, parted by `/`.
    pub(super) name: String,
    method: u16,
    encrypted: bool,
    crc: u32,
    packed: u64,
    size: u64,
    header: u64,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// Whether the file begins like an archive with files.
pub(super) fn is_archive(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

impl Archive {
    /// Reads the directory at the end of the archive.
    ///
    /// # Errors
    /// No directory, one that is cut short, or the 64-bit variant of the format.
    pub(super) fn open(bytes: Vec<u8>) -> Result<Self> {
        let broken = |what: &str| {
            Error::malformed(format!("damaged zip archive: {what}")).expected("a complete zip file").hint("copy it again")
        };
        // A comment of at most 65535 bytes may follow the end record.
        let from = bytes.len().saturating_sub(22 + 65535);
        let end = (from..bytes.len().saturating_sub(21)).rev().find(|&at| bytes[at..].starts_with(b"PK\x05\x06"));
        let end = end.ok_or_else(|| broken("it has no directory"))?;
        let count = u16_at(&bytes, end + 10).unwrap_or(0);
        let mut at = u32_at(&bytes, end + 16).unwrap_or(0) as usize;
        if count == u16::MAX || at == u32::MAX as usize {
            return Err(Error::new(Kind::Unsupported, "a zip archive of the 64-bit variant").hint("unpack it first"));
        }
        let mut entries = Vec::new();
        for _ in 0..usize::from(count).min(MOST) {
            let entry = entry(&bytes, &mut at).ok_or_else(|| broken("its directory is cut short"))?;
            entries.push(entry);
        }
        let mut numbers = HashMap::new();
        for (k, entry) in entries.iter().enumerate().filter(|(_, e): &(usize, &Entry)| !e.name.ends_with('/')) {
            numbers.entry(entry.name.to_lowercase()).or_insert(k);
        }
        let allowance = Cell::new(ALWAYS_ALLOWED.saturating_add(LARGEST_RATIO * bytes.len() as u64));
        Ok(Self { bytes, entries, numbers, shared: RefCell::default(), allowance })
    }

    /// The files in the directory's order; folders are no files.
    pub(super) fn files(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|e| !e.name.ends_with('/'))
    }

    /// The file of this path, whatever its letter case.
    pub(super) fn find(&self, path: &str) -> Option<&Entry> {
        self.numbers.get(&normal(path).to_lowercase()).map(|&k| &self.entries[k])
    }

    /// The content of a file that several others may name: it is unpacked once.
    ///
    /// # Errors
    /// As [`Archive::unpack`].
    pub(super) fn shared(&self, path: &str) -> Option<(&Entry, Result<Arc<[u8]>>)> {
        let number = *self.numbers.get(&normal(path).to_lowercase())?;
        let entry = &self.entries[number];
        if let Some(known) = self.shared.borrow().get(&number) {
            return Some((entry, Ok(known.clone())));
        }
        let content = self.unpack(entry).map(Arc::<[u8]>::from);
        if let Ok(content) = &content {
            self.shared.borrow_mut().insert(number, content.clone());
        }
        Some((entry, content))
    }

    /// The content of a file.
    ///
    /// # Errors
    /// Encrypted, packed by another method than deflate, damaged, or of an absurd size.
    pub(super) fn unpack(&self, entry: &Entry) -> Result<Vec<u8>> {
        self.content(entry).map_err(|e| if e.place.is_none() { e.at(entry.name.clone()) } else { e })
    }

    fn content(&self, entry: &Entry) -> Result<Vec<u8>> {
        if entry.encrypted {
            return Err(Error::new(Kind::Unsupported, "is encrypted in the zip archive").hint("unpack it first"));
        }
        let damaged = |what: &str| Error::malformed(format!("damaged zip archive: {what}")).expected("a complete zip file");
        let header = usize::try_from(entry.header).unwrap_or(usize::MAX);
        let (name, extra) = match (
            self.bytes.get(header..),
            u16_at(&self.bytes, header.saturating_add(26)),
            u16_at(&self.bytes, header.saturating_add(28)),
        ) {
            (Some(local), Some(name), Some(extra)) if local.starts_with(b"PK\x03\x04") => (name, extra),
            _ => return Err(damaged("a file is not where the directory says")),
        };
        let begin = header + 30 + usize::from(name) + usize::from(extra);
        let packed = self
            .bytes
            .get(begin..)
            .and_then(|rest| rest.get(..entry.packed as usize))
            .ok_or_else(|| damaged("a file is cut short"))?;
        let allowed = self.allowance.get();
        let mut content = Vec::new();
        match entry.method {
            0 => content.extend_from_slice(&packed[..packed.len().min(allowed.saturating_add(1) as usize)]),
            8 => {
                let mut decoder = DeflateDecoder::new(packed).take(entry.size.min(allowed) + 1);
                decoder.read_to_end(&mut content).map_err(|e| damaged(&e.to_string()))?;
            }
            method => {
                return Err(Error::new(Kind::Unsupported, format!("is packed by method {method} in the zip archive"))
                    .expected("stored or deflated files")
                    .hint("unpack it first"));
            }
        }
        if content.len() as u64 > allowed {
            return Err(Error::refused(format!("the archive of {} bytes unpacks to an absurd size", self.bytes.len()))
                .expected(format!("at most {LARGEST_RATIO} : 1"))
                .hint("unpack it yourself if it really is a mesh"));
        }
        let mut crc = Crc::new();
        crc.update(&content);
        if content.len() as u64 != entry.size || crc.sum() != entry.crc {
            return Err(damaged("the content of a file is not what was packed"));
        }
        self.allowance.set(allowed - content.len() as u64);
        Ok(content)
    }
}

/// The directory's entry at `at`, which moves behind it.
fn entry(bytes: &[u8], at: &mut usize) -> Option<Entry> {
    let head = bytes.get(*at..)?.get(..46)?;
    if !head.starts_with(b"PK\x01\x02") {
        return None;
    }
    let length = |k: usize| u16_at(head, k).map(usize::from);
    let (name, extra, comment) = (length(28)?, length(30)?, length(32)?);
    let name_bytes = bytes.get(*at + 46..)?.get(..name)?;
    *at += 46 + name + extra + comment;
    Some(Entry {
        name: normal(&super::text::name(name_bytes)),
        method: u16_at(head, 10)?,
        encrypted: u16_at(head, 8)? & 1 != 0,
        crc: u32_at(head, 16)?,
        packed: u64::from(u32_at(head, 20)?),
        size: u64::from(u32_at(head, 24)?),
        header: u64::from(u32_at(head, 42)?),
    })
}

/// A path with `/` between its parts, without `.` and `..`.
fn normal(path: &str) -> String {
    let folder = path.ends_with(['/', '\\']);
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    let joined = parts.join("/");
    if folder { joined + "/" } else { joined }
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::io::Write;

    /// An archive of these files; `packed` says which are deflated.
    pub(in crate::scan) fn zip(files: &[(&str, &[u8], bool)]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut directory = Vec::new();
        for (name, content, packed) in files {
            let mut crc = Crc::new();
            crc.update(content);
            let data = if *packed {
                let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
                encoder.write_all(content).unwrap();
                encoder.finish().unwrap()
            } else {
                content.to_vec()
            };
            let offset = bytes.len() as u32;
            let method = if *packed { 8u16 } else { 0 };
            let mut common = [20u16, 0, method, 0, 0].map(u16::to_le_bytes).concat();
            common.extend([crc.sum(), data.len() as u32, content.len() as u32].map(u32::to_le_bytes).concat());
            common.extend([name.len() as u16, 0].map(u16::to_le_bytes).concat());
            bytes.extend([b"PK\x03\x04", &common[..], name.as_bytes(), &data].concat());
            directory.extend([b"PK\x01\x02\x14\0", &common[..], &[0; 10], &offset.to_le_bytes(), name.as_bytes()].concat());
        }
        let (start, count) = (bytes.len() as u32, files.len() as u16);
        bytes.extend(&directory);
        bytes.extend(b"PK\x05\x06\0\0\0\0");
        bytes.extend([count.to_le_bytes(), count.to_le_bytes()].concat());
        bytes.extend([(directory.len() as u32).to_le_bytes(), start.to_le_bytes()].concat());
        bytes.extend([0, 0]);
        bytes
    }

    #[test]
    fn stored_and_deflated_files_come_out_whole() {
        let text = "v 0 0 0\n".repeat(100);
        let archive =
            Archive::open(zip(&[("a/", b"", false), ("a/B c.obj", text.as_bytes(), true), ("x.png", b"123", false)])).unwrap();
        assert_eq!(archive.files().map(|e| e.name.as_str()).collect::<Vec<_>>(), ["a/B c.obj", "x.png"]);
        assert_eq!(archive.unpack(archive.find("a\\./b C.OBJ").unwrap()).unwrap(), text.as_bytes());
        assert_eq!(archive.unpack(archive.find("a/../x.png").unwrap()).unwrap(), b"123");
        assert!(archive.find("b").is_none());
    }

    #[test]
    fn cut_and_changed_archives_are_errors() {
        let (text, digits) = (b"v 1 2 3\n".repeat(9), b"0123456789".to_vec());
        let whole = zip(&[("a.obj", &text, true), ("b.png", &digits, false)]);
        for cut in 0..whole.len() {
            assert!(Archive::open(whole[..cut].to_vec()).is_err(), "{cut}");
        }
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x5a;
            if let Ok(archive) = Archive::open(bytes) {
                for content in archive.files().filter_map(|e| archive.unpack(e).ok()) {
                    assert!(content == text || content == digits, "{at}");
                }
            }
        }
    }

    #[test]
    fn a_bomb_is_refused_whatever_its_directory_says() {
        let bomb = vec![b' '; ALWAYS_ALLOWED as usize + (30 << 20)];
        let archive = Archive::open(zip(&[("a.obj", &bomb, true)])).unwrap();
        assert_eq!(archive.unpack(archive.find("a.obj").unwrap()).unwrap_err().kind, Kind::Refused);
        let half = &bomb[..bomb.len() / 2];
        let archive = Archive::open(zip(&[("a", half, true), ("b", half, true), ("c", half, true)])).unwrap();
        let outcomes: Vec<bool> = archive.files().map(|e| archive.unpack(e).is_ok()).collect();
        assert_eq!(outcomes, [true, false, false]);
    }
}
