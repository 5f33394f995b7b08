//! The bytes of a mesh file, unpacked, and which format they are.

use super::archive::{Archive, is_archive};
use super::beside::{Beside, inside};
use crate::error::{Error, Kind, Result};
use crate::packing;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// The formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY.
    Ply,
    /// Stereolithography, ascii or binary.
    Stl,
    /// Geomview's object file format.
    Off,
    /// glTF, text or binary.
    Gltf,
}

/// What is expected of a file.
const EXPECTED: &str = "a mesh file: .obj, .ply, .stl, .off, .gltf or .glb, also as .gz or .zip";

/// The content of a mesh file.
pub(super) struct Content {
    /// Its bytes, unpacked.
    pub(super) bytes: Vec<u8>,
    /// What messages call it; the extension tells the format where the content does not.
    pub(super) name: PathBuf,
    /// Files that it may name.
    pub(super) beside: Beside,
}

/// The content of `path`; gzip and zip are recognised by their signatures and unpacked.
///
/// Errors: unreadable, larger than 4 GiB, damaged, packed to an absurd ratio, or an archive that does not hold one mesh.
pub(super) fn load(path: &Path) -> Result<Content> {
    let bytes = packing::load(path, EXPECTED)?;
    unwrap_packing(bytes, path).map_err(|e| if e.file.is_none() { e.file(path) } else { e })
}

/// Takes gzip or zip away, once.
pub(super) fn unwrap_packing(bytes: Vec<u8>, path: &Path) -> Result<Content> {
    if bytes.starts_with(&packing::GZIP) {
        return Ok(Content { bytes: packing::unpack(&bytes, "a mesh")?, name: path.to_owned(), beside: Beside::of(path) });
    }
    if !is_archive(&bytes) {
        return Ok(Content { bytes, name: path.to_owned(), beside: Beside::of(path) });
    }
    let archive = Rc::new(Archive::open(bytes)?);
    let is_mesh = |name: &str| {
        let base = name.rsplit('/').next().unwrap_or(name);
        let known = ["obj", "ply", "stl", "off", "gltf", "glb"].contains(&extension(Path::new(base)).as_str());
        // Copies that a Mac adds hold no mesh.
        known && !base.starts_with("._") && !name.starts_with("__MACOSX/")
    };
    let meshes: Vec<_> = archive.files().filter(|e| is_mesh(&e.name)).collect();
    let entry = match meshes[..] {
        [one] => one,
        [] => {
            let names: Vec<_> = archive.files().take(5).map(|e| format!("'{}'", e.name)).collect();
            let names = if names.is_empty() { "nothing".to_owned() } else { names.join(", ") };
            return Err(
                Error::new(Kind::Unsupported, format!("a zip archive without a mesh: it holds {names}")).expected(EXPECTED)
            );
        }
        _ => {
            let names: Vec<_> = meshes.iter().take(5).map(|e| format!("'{}'", e.name)).collect();
            return Err(Error::new(Kind::Ambiguous, format!("a zip archive of {} meshes: {}", meshes.len(), names.join(", ")))
                .expected("one mesh")
                .hint("unpack the one that is meant"));
        }
    };
    let bytes = archive.unpack(entry)?;
    Ok(Content { bytes, name: inside(path, entry), beside: Beside::within(&archive, entry) })
}

/// The format of `bytes`: by signature first, then by the extension of `path` (without `.gz`), then by content.
///
/// Errors: a known other format, or nothing that is known.
pub(super) fn format(path: &Path, bytes: &[u8]) -> Result<Format> {
    let foreign: [(&[u8], &str); 6] = [
        (b"Kaydara FBX", "an FBX file"),
        (b"\x89PNG", "a PNG image"),
        (b"\xff\xd8\xff", "a JPEG image"),
        (b"PK\x03\x04", "an archive in an archive"),
        (b"BLENDER", "a Blender file"),
        (b"PXR-USDC", "a USD file"),
    ];
    if let Some((_, what)) = foreign.iter().find(|(signature, _)| bytes.starts_with(signature)) {
        return Err(unknown(path, what));
    }
    if super::ply::is_ply(bytes) {
        return Ok(Format::Ply);
    }
    if crate::gltf::is_binary(bytes) {
        return Ok(Format::Gltf);
    }
    if super::off::is_off(bytes) {
        return Ok(Format::Off);
    }
    let extension = extension(path);
    match extension.as_str() {
        "obj" if super::stl::is_exact_binary(bytes) => Ok(Format::Stl),
        "obj" => Ok(Format::Obj),
        "stl" => Ok(Format::Stl),
        "off" | "coff" | "noff" | "stoff" => Ok(Format::Off),
        "gltf" => Ok(Format::Gltf),
        "glb" => Err(Error::malformed("does not begin with 'glTF'").file(path).at("byte 0").expected("a GLB file")),
        "ply" => Err(Error::malformed("does not begin with the line 'ply'").file(path).at("line 1").expected("a PLY file")),
        _ if super::stl::is_exact_binary(bytes) || bytes.starts_with(b"solid") => Ok(Format::Stl),
        _ if bytes.trim_ascii_start().starts_with(b"{") => Ok(Format::Gltf),
        _ if looks_like_obj(bytes) => Ok(Format::Obj),
        _ => Err(unknown(path, "not a known mesh format")),
    }
}

fn unknown(path: &Path, what: &str) -> Error {
    Error::new(Kind::Unsupported, what).file(path).expected(EXPECTED).hint("convert it to one of these")
}

/// The extension in lower case, without a final `.gz`.
pub(super) fn extension(path: &Path) -> String {
    let lower = |p: &Path| p.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match lower(path).as_str() {
        "gz" => path.file_stem().map(|stem| lower(Path::new(stem))).unwrap_or_default(),
        other => other.to_owned(),
    }
}

fn looks_like_obj(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1 << 16)];
    !head.contains(&0) && head.split(|b| matches!(b, b'\n' | b'\r')).any(|line| line.trim_ascii_start().starts_with(b"v "))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    #[test]
    fn signature_beats_extension_beats_guess() {
        let kind = |name: &str, bytes: &[u8]| format(Path::new(name), bytes);
        assert_eq!(kind("a.obj", b"ply\nformat").unwrap(), Format::Ply);
        assert_eq!(kind("a.OBJ.gz", b"v 0 0 0").unwrap(), Format::Obj);
        assert_eq!(kind("a.stl", b"solid").unwrap(), Format::Stl);
        assert_eq!(kind("a", b"# x\nv 0 0 0").unwrap(), Format::Obj);
        assert_eq!(kind("a.ply", b"solid").unwrap_err().kind, Kind::Malformed);
        assert_eq!(kind("a.obj", b"glTF\x02\0\0\0").unwrap(), Format::Gltf);
        assert_eq!(kind("a.obj", b"# knight\nCOFF 1 1 1").unwrap(), Format::Off);
        assert_eq!(kind("a", b" {\"asset\":").unwrap(), Format::Gltf);
        assert!(kind("a.glb", b"{").is_err());
        assert!(kind("a.obj", b"\x89PNG\r\n").unwrap_err().found.contains("PNG"));
    }
}
