//! The bytes of a capture file, unpacked.

use crate::error::{Error, Result};
use crate::packing;
pub(super) use crate::packing::GZIP;
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// The first bytes of the content of `path`, unpacked where it is gzip; as many as can be read, at most `length`.
///
/// # Errors
/// Files that cannot be opened.
pub(super) fn head(path: &Path, length: u64) -> Result<Vec<u8>> {
    let mut file = BufReader::new(File::open(path).map_err(|e| Error::unreadable(path, &e))?);
    let mut head = Vec::new();
    // A folder or damaged gzip data fail here; their own message comes from the reader of the format.
    let _ = file.by_ref().take(length).read_to_end(&mut head);
    if head.starts_with(&GZIP) {
        let rest = std::mem::take(&mut head);
        let _ = MultiGzDecoder::new(BufReader::new(rest.chain(file))).take(length).read_to_end(&mut head);
    }
    Ok(head)
}

/// The content of `path`, unpacked where it is gzip.
///
/// # Errors
/// Unreadable, larger than 4 GiB, damaged gzip, or a gzip that unpacks to an absurd size.
pub(super) fn load(path: &Path) -> Result<Vec<u8>> {
    let bytes = packing::load(path, "a capture file")?;
    if bytes.starts_with(&GZIP) { unpack(&bytes).map_err(|e| e.file(path)) } else { Ok(bytes) }
}

/// Whether the content of `path` is gzip.
pub(super) fn is_packed(path: &Path) -> bool {
    let mut signature = [0; 2];
    File::open(path).and_then(|mut file| file.read_exact(&mut signature)).is_ok() && signature == GZIP
}

/// The extension in lower case, without a final `.gz`.
pub(super) fn extension(path: &Path) -> String {
    let lower = |p: &Path| p.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match lower(path).as_str() {
        "gz" => path.file_stem().map(|stem| lower(Path::new(stem))).unwrap_or_default(),
        other => other.to_owned(),
    }
}

/// The name without extension and without `.gz`.
pub(super) fn stem(path: &Path) -> String {
    let stem = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let name = stem(path);
    let packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    if packed { stem(Path::new(&name)) } else { name }
}

/// The content of gzip data.
///
/// # Errors
/// Damaged data, or data that unpacks to an absurd size.
pub(super) fn unpack(packed: &[u8]) -> Result<Vec<u8>> {
    packing::unpack(packed, "a capture")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::io::Write;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn a_packed_file_shows_the_head_and_the_name_of_what_is_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.2.BVH.gz");
        std::fs::write(&path, gzip(b"HIERARCHY\nROOT Hips\n{\n")).unwrap();
        assert_eq!(head(&path, 9).unwrap(), b"HIERARCHY");
        assert_eq!(load(&path).unwrap(), b"HIERARCHY\nROOT Hips\n{\n");
        assert_eq!((extension(&path), stem(&path)), ("bvh".into(), "walk.2".into()));
        assert_eq!((extension(Path::new("a/b.amc")), stem(Path::new("a/b.amc"))), ("amc".into(), "b".into()));
        assert_eq!(load(folder.path()).unwrap_err().found, "is a folder");
    }
}
