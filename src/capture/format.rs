//! Which format a capture file has: by the first bytes, and by the extension where they say nothing.

use super::{marker_csv, source, table};
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
    /// Table of OptiTrack Motive.
    MotiveCsv,
    /// Table of markers under a plain header.
    MarkerCsv,
    /// Table of handles.
    HandleCsv,
    /// One of a sequence of meshes.
    Meshes,
}

/// Bytes that are looked at.
const HEAD: u64 = 1 << 16;

/// Tells the format of a file. What nothing tells apart is taken for C3D, whose reader says what is wrong.
///
/// # Errors
/// Files that cannot be opened.
pub(super) fn tell(path: &Path) -> Result<Format> {
    Ok(of(&source::head(path, HEAD)?, &source::extension(path)))
}

/// As [`tell`], for content that is in memory and unpacked.
pub(super) fn of_bytes(bytes: &[u8], path: &Path) -> Format {
    of(&bytes[..bytes.len().min(HEAD as usize)], &source::extension(path))
}

fn of(head: &[u8], extension: &str) -> Format {
    let text = table::decode(head);
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
        _ if begins("Format Version") => Format::MotiveCsv,
        "bvh" => Format::Bvh,
        "asf" | "amc" => Format::Acclaim,
        "fbx" => Format::Fbx,
        "gltf" | "glb" => Format::Gltf,
        "usd" | "usda" | "usdc" | "usdz" => Format::Usd,
        "trc" => Format::Trc,
        "csv" | "tsv" if marker_csv::is_marker_table(text) => Format::MarkerCsv,
        "csv" => Format::HandleCsv,
        "tsv" => Format::MarkerCsv,
        "obj" | "ply" | "stl" | "off" => Format::Meshes,
        _ => Format::C3d,
    }
}

impl Format {
    /// The error for a format that is not read.
    pub(super) fn unsupported(self) -> Error {
        let what = match self {
            Format::Usd => {
                return Error::new(Kind::Unsupported, "is a USD file, which is not read")
                    .expected("a skeleton take: BVH, ASF/AMC, glTF or FBX")
                    .hint("export the skeleton as glTF or FBX");
            }
            Format::Fbx => {
                return Error::new(Kind::Unsupported, "is an FBX file, and this program was built without FBX")
                    .expected("a skeleton take: BVH, ASF/AMC or glTF")
                    .hint("export it as BVH or glTF, or build with the feature 'fbx'");
            }
            Format::Trc | Format::MotiveCsv | Format::MarkerCsv => "is a table of markers".to_owned(),
            Format::HandleCsv => "is no table of markers".to_owned(),
            Format::C3d | Format::Bvh | Format::Acclaim | Format::Gltf => "cannot be read".to_owned(),
            Format::Meshes => "is a mesh".to_owned(),
        };
        Error::new(Kind::Unsupported, what).expected("labelled markers: C3D, TRC or CSV").hint("export the markers as C3D")
    }
}
