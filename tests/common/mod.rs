//! What several test programs share: where the data are, how the program is run, how caches are read.

#![allow(dead_code, clippy::unwrap_used, clippy::print_stderr)]

use glam::DVec3;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

pub mod arm;
pub mod c3d_writer;
pub mod cache_readers;

/// The folder of real captures and meshes, where it is present: beside the project, or where `RETARGET_SHARED` says.
pub fn shared() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let folder = std::env::var_os("RETARGET_SHARED").map_or(beside, PathBuf::from);
    if folder.join("data").is_dir() {
        return Some(folder.join("data"));
    }
    eprintln!("skipped: the real captures and meshes are not here (RETARGET_SHARED names their folder)");
    None
}

/// A file of `fixtures/`.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// Runs the program in a folder.
pub fn retarget<I: AsRef<std::ffi::OsStr>>(folder: &Path, arguments: impl IntoIterator<Item = I>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_retarget")).current_dir(folder).args(arguments).output().unwrap()
}

/// Runs the program and demands that it succeeds; gives what it said.
pub fn retarget_ok<I: AsRef<std::ffi::OsStr>>(folder: &Path, arguments: impl IntoIterator<Item = I>) -> String {
    let output = retarget(folder, arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    said
}

/// Frames of a PC2 cache.
pub fn read_pc2(path: &Path) -> Vec<Vec<[f32; 3]>> {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..12], b"POINTCACHE2\0");
    let integer = |at: usize| i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let (points, frames) = (integer(16), integer(28));
    let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!(bytes.len(), 32 + frames * points * 12);
    (0..frames).map(|f| (0..points).map(|p| [0, 1, 2].map(|c| number(32 + ((f * points + p) * 3 + c) * 4))).collect()).collect()
}

/// Points of a binary PLY that holds nothing but f32 positions, as the truths and the goldens do.
pub fn read_ply_points(path: &Path) -> Vec<DVec3> {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let number = |c: &[u8]| f64::from(f32::from_le_bytes(c.try_into().unwrap()));
    bytes[body..].chunks_exact(12).map(|p| DVec3::new(number(&p[..4]), number(&p[4..8]), number(&p[8..]))).collect()
}
