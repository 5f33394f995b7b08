//! The other file of the pair: ASF for an AMC, AMC for an ASF.

use crate::capture::source::{extension, stem};
use crate::error::{Error, Kind, Notes, Result};
use std::path::{Path, PathBuf};

/// The skeleton and the motion that `path` and its partner are.
///
/// A skeleton for `01_01.amc` is `01_01.asf`, then `01.asf` (the subject of a take); also packed, also in capitals; then the only
/// skeleton in the folder. The motion for `01.asf` is `01.amc`, then the only one of `01_*.amc`.
///
/// # Errors
/// No partner, with the names that were looked for; several.
pub(super) fn pair(path: &Path, skeleton: Option<&Path>, notes: &mut Notes) -> Result<(PathBuf, PathBuf)> {
    if let Some(skeleton) = skeleton {
        return Ok((skeleton.to_owned(), if extension(path) == "asf" { motion(path)? } else { path.to_owned() }));
    }
    if extension(path) == "asf" {
        return Ok((path.to_owned(), motion(path)?));
    }
    let name = stem(path);
    // `cmu_01_01`, `cmu_01`, `cmu`.
    let mut stems: Vec<&str> = vec![&name];
    stems.extend(
        name.char_indices().rev().filter(|(_, c)| matches!(c, '_' | '-')).map(|(at, _)| &name[..at]).filter(|s| !s.is_empty()),
    );
    let skeletons = beside(path, "asf");
    for wanted in &stems {
        if let Some(found) = skeletons.iter().find(|p| stem(p).eq_ignore_ascii_case(wanted)) {
            return Ok((found.clone(), path.to_owned()));
        }
    }
    if let [only] = &skeletons[..] {
        notes.warn(format!("the skeleton is taken from {}, the only one in the folder", shown(only)));
        return Ok((only.clone(), path.to_owned()));
    }
    let looked: Vec<String> = stems.iter().map(|s| format!("{s}.asf")).collect();
    Err(Error::new(Kind::Unreadable, "the skeleton of this motion is missing")
        .file(path)
        .expected(format!("{} (or .asf.gz) in the same folder", looked.join(" or ")))
        .hint("name it: --skeleton FILE.asf"))
}

fn motion(path: &Path) -> Result<PathBuf> {
    let name = stem(path).to_ascii_lowercase();
    let motions = beside(path, "amc");
    let own = |p: &&PathBuf| stem(p).eq_ignore_ascii_case(&name);
    if let Some(found) = motions.iter().find(own) {
        return Ok(found.clone());
    }
    let of_subject = |p: &&PathBuf| stem(p).to_ascii_lowercase().strip_prefix(&name).is_some_and(|r| r.starts_with(['_', '-']));
    match &motions.iter().filter(of_subject).collect::<Vec<_>>()[..] {
        [only] => Ok((*only).clone()),
        [] => Err(Error::new(Kind::Unreadable, "is a skeleton, and its motion is missing")
            .file(path)
            .expected(format!("{name}.amc or {name}_*.amc (or .amc.gz) in the same folder"))
            .hint("give the .amc file as the capture")),
        several => Err(Error::new(Kind::Ambiguous, format!("is a skeleton with {} motions", several.len()))
            .file(path)
            .expected(several.iter().take(5).map(|p| shown(p)).collect::<Vec<_>>().join(", "))
            .hint("give one of these as the capture")),
    }
}

fn shown(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Files with this extension in the folder of `path`, in the order of their names.
fn beside(path: &Path, wanted: &str) -> Vec<PathBuf> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> = entries.map(|e| e.path()).filter(|p| extension(p) == wanted && p.is_file()).collect();
    found.sort();
    found
}
