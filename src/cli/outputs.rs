//! From the paths after `-o` to sinks, and what is refused before any work begins.

use super::args::{Animate, EncodeArg};
use crate::error::{Error, Kind, Result};
use crate::export::{
    FrameSink, Tolerance, alembic::Alembic, files, glb, obj::ObjFrames, page::PageSink, ply::PlyFrames, point_cache::PointCache,
    stills::Stills, usd::Usd,
};
use std::path::{Path, PathBuf};

const FORMATS: &str = "one of .glb, .abc, .usdc, .usda, .usdz, .pc2, .mdd, .html (a page that plays), .png (a sheet of frames), .apng (an animation), or .ply or .obj with a run of # for the frame number, as in 'frames/f_####.ply'";

/// The sinks of all outputs.
///
/// # Errors
/// [`Kind::Usage`] for an unknown format, an output given twice, or one that would replace an input; [`Kind::Unwritable`] for one that
/// exists (without `--force`) or whose folder is missing.
pub(super) fn sinks(args: &Animate) -> Result<Vec<Box<dyn FrameSink>>> {
    let given = [Some(&args.scan), Some(&args.capture), args.ref_file.as_ref(), args.proxy.as_ref(), args.rig.as_ref()];
    let inputs: Vec<&PathBuf> =
        given.into_iter().flatten().chain(&args.handles).chain(&args.skeleton).chain(&args.shells.examples).collect();
    let others: Vec<&PathBuf> = args.report.iter().chain(&args.save_proxy).chain(&args.picture).chain(&args.save_rig).collect();
    let recording = recording(args.tolerance, args.encode, args.source_index);
    checked(&args.out, &others, &inputs, args.force, false, &recording)
}

/// What GLB and page share. `percent`: `--tolerance`.
pub(super) fn recording(percent: Option<f64>, encode: EncodeArg, source_index: bool) -> glb::Recording {
    let tolerance = percent.map_or_else(Tolerance::default, |percent| Tolerance::of_worst(percent / 100.0));
    glb::Recording::new(glb::Options { tolerance, encode: encode.into(), source_index })
}

/// The same for any outputs. `others`: files that are no animations; `single`: whether a file may hold one frame; `recording`: what GLB and page
/// share.
pub(super) fn checked(
    out: &[PathBuf],
    others: &[&PathBuf],
    inputs: &[&PathBuf],
    force: bool,
    single: bool,
    recording: &glb::Recording,
) -> Result<Vec<Box<dyn FrameSink>>> {
    let mut seen: Vec<PathBuf> = Vec::new();
    let mut sinks = Vec::new();
    for path in out.iter().chain(others.iter().copied()) {
        let whole = absolute(path);
        if seen.iter().any(|other| *other == whole || same_frames(other, &whole)) {
            return Err(Error::new(Kind::Usage, "this output is named twice")
                .file(path)
                .expected("every output to have a path of its own"));
        }
        if inputs.iter().any(|i| absolute(i) == whole || is_frame_of(&absolute(i), &whole)) {
            return Err(Error::new(Kind::Usage, "this output would replace an input").file(path).expected("another path"));
        }
        seen.push(whole);
        if out.contains(path) {
            sinks.push(sink(path, single, recording)?);
        }
        if !force && files::exists(path) {
            return Err(Error::new(Kind::Unwritable, "exists already")
                .file(path)
                .expected("a path where nothing is")
                .hint("--force replaces it"));
        }
        let sequence = is_sequence(path);
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !sequence && !folder.is_dir() {
            return Err(Error::new(Kind::Unwritable, format!("there is no folder '{}'", folder.display()))
                .file(path)
                .expected("an existing folder")
                .hint(format!("mkdir -p '{}'", folder.display())));
        }
        files::check_writable(path)?;
    }
    Ok(sinks)
}

fn is_sequence(path: &Path) -> bool {
    path.file_name().is_some_and(|n| n.to_string_lossy().contains('#'))
}

/// Folder, and what stands before and behind the run of `#`.
fn parts(pattern: &Path) -> Option<(PathBuf, String, String)> {
    let name = pattern.file_name()?.to_string_lossy().into_owned();
    let start = name.find('#')?;
    let run = name[start..].chars().take_while(|c| *c == '#').count();
    Some((pattern.parent()?.to_owned(), name[..start].to_owned(), name[start + run..].to_owned()))
}

/// Whether a file could be a frame of a pattern.
fn is_frame_of(file: &Path, pattern: &Path) -> bool {
    let (Some((folder, before, behind)), Some(name)) = (parts(pattern), file.file_name()) else { return false };
    let name = name.to_string_lossy();
    let number = name.strip_prefix(before.as_str()).and_then(|rest| rest.strip_suffix(behind.as_str()));
    file.parent() == Some(&folder) && number.is_some_and(|n| n.parse::<i64>().is_ok())
}

/// Whether two patterns name the same frames, up to leading zeros.
fn same_frames(a: &Path, b: &Path) -> bool {
    parts(a).is_some_and(|a| parts(b) == Some(a))
}

/// `recording`: what GLB and page share.
fn sink(path: &Path, single: bool, recording: &glb::Recording) -> Result<Box<dyn FrameSink>> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match (extension.as_str(), is_sequence(path)) {
        ("glb", false) => Ok(Box::new(glb::GlbSink::of(path, recording))),
        ("html", false) => Ok(Box::new(PageSink::of(path, recording))),
        ("png", false) => Ok(Box::new(Stills::sheet(path))),
        ("apng", false) => Ok(Box::new(Stills::preview(path))),
        ("pc2", false) => Ok(Box::new(PointCache::pc2(path))),
        ("usda" | "usdc" | "usdz", false) => Ok(Box::new(Usd::new(path))),
        ("abc", false) => Ok(Box::new(Alembic::new(path))),
        ("mdd", false) => Ok(Box::new(PointCache::mdd(path))),
        ("ply", is_sequence) if is_sequence || single => Ok(Box::new(PlyFrames::new(path))),
        ("obj", is_sequence) if is_sequence || single => Ok(Box::new(ObjFrames::new(path))),
        ("ply" | "obj", _) => {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let pattern = path.with_file_name(format!("{stem}_####.{extension}"));
            Err(Error::new(Kind::Usage, format!("one .{extension} file holds one frame"))
                .file(path)
                .expected("a run of # for the frame number")
                .hint(format!("-o '{}'", pattern.display())))
        }
        ("glb" | "html" | "png" | "apng" | "pc2" | "mdd" | "usda" | "usdc" | "usdz" | "abc", true) => {
            Err(Error::new(Kind::Usage, format!("a .{extension} file holds the whole take"))
                .file(path)
                .expected("a name without #"))
        }
        ("toml", false) => Err(Error::new(Kind::Usage, "a rig file is no output of the main job")
            .file(path)
            .expected(FORMATS)
            .hint("--save-rig FILE.toml, or for things made of parts: retarget joints MODEL -o RIG.toml")),
        _ => Err(Error::new(Kind::Usage, format!("unknown output format '.{extension}'")).file(path).expected(FORMATS)),
    }
}

/// The path from the root, with links of its folder resolved where it exists.
fn absolute(path: &Path) -> PathBuf {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = folder.canonicalize().or_else(|_| std::path::absolute(folder)).unwrap_or_else(|_| folder.to_owned());
    folder.join(path.file_name().unwrap_or_default())
}
