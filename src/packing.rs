//! The bytes of a file, and gzip taken away, within bounds: what readers of scans and of captures have in common.

use crate::error::{Error, Kind, Result};
use crate::opened;
use flate2::bufread::MultiGzDecoder;
use std::io::Read;
use std::path::Path;

/// How a gzip file begins.
pub(crate) const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Largest content in bytes: corner and vertex numbers are 32-bit, and no format needs less than one byte for one.
const LARGEST: u64 = u32::MAX as u64;
/// Unpacked bytes per packed byte above which packed data are refused. Meshes and captures reach 3 to 30; deflate itself can reach 1030.
pub(crate) const LARGEST_RATIO: u64 = 100;
/// Unpacked bytes that are always allowed: a small file may well consist of repetitions.
pub(crate) const ALWAYS_ALLOWED: u64 = 64 << 20;

/// The content of `path` as it is; `expected` says in errors what it should be.
///
/// # Errors
/// Unreadable, a folder, or larger than 4 GiB.
pub(crate) fn load(path: &Path, expected: &str) -> Result<Vec<u8>> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    let file = opened::open(path).map_err(unreadable)?;
    let about = file.metadata().map_err(unreadable)?;
    if about.is_dir() {
        return Err(Error::new(Kind::Unreadable, "is a folder").file(path).expected(expected));
    }
    let mut bytes = Vec::with_capacity(about.len().min(LARGEST) as usize);
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > LARGEST { Err(too_large().file(path)) } else { Ok(bytes) }
}

fn too_large() -> Error {
    Error::new(Kind::Unsupported, "more than 4 GiB of data").expected("at most 4 GiB")
}

/// The content of gzip data; `noun` says what it should be: `a mesh`.
///
/// # Errors
/// Damaged data, or data that unpacks to an absurd size.
pub(crate) fn unpack(packed: &[u8], noun: &str) -> Result<Vec<u8>> {
    let allowed = (ALWAYS_ALLOWED + LARGEST_RATIO * packed.len() as u64).min(LARGEST);
    let mut bytes = Vec::new();
    let outcome = MultiGzDecoder::new(packed).take(allowed + 1).read_to_end(&mut bytes);
    if bytes.len() as u64 > allowed {
        if allowed == LARGEST {
            return Err(too_large());
        }
        return Err(Error::refused(format!("gzip data of {} bytes unpacks to more than {allowed} bytes", packed.len()))
            .expected(format!("{noun}, which gzip seldom packs by more than 30 : 1 (limit {LARGEST_RATIO} : 1)"))
            .hint(format!("unpack it yourself if it really is {noun}")));
    }
    outcome
        .map_err(|e| Error::malformed(format!("damaged gzip data: {e}")).at(format!("after {} unpacked bytes", bytes.len())))?;
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::io::Write;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn a_gzip_bomb_is_refused_and_a_repetitive_file_is_not() {
        let bomb = gzip(&vec![b' '; (ALWAYS_ALLOWED + (20 << 20)) as usize]);
        let error = unpack(&bomb, "a mesh").unwrap_err();
        assert!(error.kind == Kind::Refused && error.to_string().contains("a mesh, which"), "{error}");
        let small = vec![b' '; 1 << 20];
        assert_eq!(unpack(&gzip(&small), "a mesh").unwrap(), small);
    }

    #[test]
    fn a_gzip_cut_short_is_an_error() {
        let packed = gzip(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        assert!(unpack(&packed, "a mesh").is_ok());
        assert_eq!(unpack(&packed[..packed.len() - 5], "a mesh").unwrap_err().kind, Kind::Malformed);
    }
}
