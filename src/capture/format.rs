//! Which format a capture file has: by the first bytes, and by the extension where they say nothing.

use super::{ReadOptions, marker_csv, source, table};
use crate::error::{Error, Kind, Notes, Result};
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
            Format::HandleCsv => {
                return Error::new(Kind::Unsupported, "is a table of handles, or one without columns of markers")
                    .expected("a capture: C3D, TRC, CSV with columns such as LASI_x, BVH, AMC, glTF or FBX")
                    .hint("a table of handles is given as CAPTURE or with --handles");
            }
            Format::Acclaim | Format::Meshes => "is one of several files that are read together",
            _ => "cannot be read",
        };
        Error::new(Kind::Unsupported, what).expected("a capture: C3D, TRC, CSV, BVH, AMC, glTF or FBX")
    }

    /// A warning for each of the options that says nothing of this format.
    pub(super) fn not_used(self, options: &ReadOptions) -> Notes {
        use Format::{Acclaim, C3d, Fbx, Gltf, MarkerCsv, MotiveCsv, Trc};
        let given = [
            ("--subject", options.subject.is_some(), matches!(self, C3d | Trc | MarkerCsv | MotiveCsv)),
            ("--bodies", options.bodies, matches!(self, C3d | MotiveCsv | Gltf)),
            ("--surface", options.surface, self == Gltf),
            ("--clip", options.clip.is_some(), matches!(self, Gltf | Fbx)),
            ("--skeleton", options.skeleton.is_some(), self == Acclaim),
            ("--rate", options.rate.is_some(), !matches!(self, C3d | Gltf | Fbx)),
        ];
        let mut notes = Notes::default();
        for (name, _, _) in given.iter().filter(|(_, given, used)| *given && !used) {
            notes.warn(format!("{name} is given but not used: it says nothing of {}", self.noun()));
        }
        notes
    }

    /// For people: what a file of this format is.
    fn noun(self) -> &'static str {
        match self {
            Format::C3d => "a C3D file",
            Format::Bvh => "a BVH file",
            Format::Acclaim => "an AMC motion",
            Format::Gltf => "a glTF file",
            Format::Fbx => "an FBX file",
            Format::Usd => "a USD file",
            Format::Trc => "a TRC table",
            Format::MotiveCsv | Format::MarkerCsv => "a table of markers",
            Format::HandleCsv => "a table of handles",
            Format::Meshes => "a sequence of meshes",
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    #[cfg(not(feature = "fbx"))]
    fn without_its_library_fbx_is_refused_with_the_way_out() {
        for bytes in [&b"Kaydara FBX Binary  \0\x1a\0"[..], b"; FBX 7.4.0 project file"] {
            let error = crate::capture::read_bytes(bytes.to_vec(), Path::new("walk.fbx"), &ReadOptions::default()).unwrap_err();
            assert!(error.kind == Kind::Unsupported && error.found.ends_with("built without FBX"), "{error}");
            assert!(error.hint.as_deref().is_some_and(|h| h.contains("feature 'fbx'")), "{error}");
        }
    }

    #[test]
    fn options_that_say_nothing_of_a_format_are_told() {
        let options = ReadOptions {
            subject: Some("Ann".into()),
            rate: Some(60.0),
            bodies: true,
            surface: true,
            clip: Some("Walk".into()),
            skeleton: Some("a.asf".into()),
            as_found: false,
        };
        let said = |format: Format| {
            let notes = format.not_used(&options);
            notes.iter().map(|n| n.split(' ').next().unwrap_or_default().to_owned()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(said(Format::C3d), "--surface --clip --skeleton --rate");
        assert_eq!(said(Format::Bvh), "--subject --bodies --surface --clip --skeleton");
        assert_eq!(said(Format::Acclaim), "--subject --bodies --surface --clip");
        assert_eq!(said(Format::Gltf), "--subject --skeleton --rate");
        assert_eq!(said(Format::HandleCsv), "--subject --bodies --surface --clip --skeleton");
        assert!(Format::Bvh.not_used(&ReadOptions::default()).is_empty());
    }
}
