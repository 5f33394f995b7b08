//! Which format a capture file has: by the first bytes, and by the extension where they say nothing.

use super::source;
use crate::error::{Error, Kind, Result};
use std::path::Path;

/// Formats of captures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// Points (and turns of segments) in the biomechanists' binary format.
    C3d,
    /// Biovision hierarchy: a skeleton and its motion in one text.
    Bvh,
    /// Acclaim: a motion (AMC) whose skeleton (ASF) is a file of its own.
    Acclaim,
    /// glTF, as text or binary.
    Gltf,
    /// Autodesk FBX, as text or binary.
    Fbx,
    /// Universal Scene Description.
    Usd,
    /// Table of markers, tab-separated.
    Trc,
    /// Table of markers, comma-separated.
    Csv,
    /// One of a sequence of meshes.
    Meshes,
}

/// Bytes that are looked at.
const HEAD: u64 = 64;

/// Tells the format of a file. What nothing tells apart is taken for C3D, whose reader says what is wrong.
///
/// # Errors
/// Files that cannot be opened.
pub(super) fn tell(path: &Path) -> Result<Format> {
    Ok(of(&source::head(path, HEAD)?, &source::extension(path)))
}

fn of(head: &[u8], extension: &str) -> Format {
    let text = String::from_utf8_lossy(head);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let begins = |word: &str| text.get(..word.len()).is_some_and(|t| t.eq_ignore_ascii_case(word));
    if head.get(1) == Some(&0x50) && (extension == "c3d" || !text.is_ascii() || head.contains(&0)) {
        return Format::C3d;
    }
    match extension {
        _ if begins("HIERARCHY") => Format::Bvh,
        _ if begins("PathFileType") => Format::Trc,
        _ if begins("Kaydara FBX") => Format::Fbx,
        _ if begins("glTF") => Format::Gltf,
        "bvh" => Format::Bvh,
        "asf" | "amc" => Format::Acclaim,
        "fbx" => Format::Fbx,
        "gltf" | "glb" => Format::Gltf,
        "usd" | "usda" | "usdc" | "usdz" => Format::Usd,
        "trc" => Format::Trc,
        "csv" | "tsv" => Format::Csv,
        "obj" | "ply" | "stl" | "off" => Format::Meshes,
        _ => Format::C3d,
    }
}

impl Format {
    /// The error for a format that is not read.
    pub(super) fn unsupported(self) -> Error {
        let skeleton = "skeleton takes are not read yet";
        let table = "marker tables are not read yet";
        let what = match self {
            Format::C3d => "is a C3D file".to_owned(),
            Format::Bvh => format!("is BVH text: {skeleton}"),
            Format::Acclaim => format!("is an Acclaim file: {skeleton}"),
            Format::Gltf => format!("is a glTF file: {skeleton}"),
            Format::Fbx => format!("is an FBX file: {skeleton}"),
            Format::Usd => format!("is a USD file: {skeleton}"),
            Format::Trc => format!("is a TRC table: {table}"),
            Format::Csv => format!("is a CSV table: {table}"),
            Format::Meshes => "is a mesh".to_owned(),
        };
        Error::new(Kind::Unsupported, what).expected("a C3D file with labelled markers").hint("export the markers as C3D")
    }
}
