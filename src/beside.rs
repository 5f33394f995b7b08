//! Files beside a file that names them.

use crate::opened;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Largest file in bytes that is read because another one names it.
const LARGEST: u64 = 1 << 30;

/// The folder of a file; `.` for a bare name.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The file that one in `folder` means by `file`: as written, else of that name in the folder itself, else the same in other letter case.
/// Backslashes part folders too, since most such files come from Windows.
pub(crate) fn locate(folder: &Path, file: &str) -> Option<PathBuf> {
    let file = file.replace('\\', "/");
    let direct = folder.join(&file);
    let beside = folder.join(file.rsplit('/').next().unwrap_or(&file));
    [&direct, &beside].into_iter().find(|p| p.is_file()).cloned().or_else(|| any_case(&direct)).or_else(|| any_case(&beside))
}

fn any_case(path: &Path) -> Option<PathBuf> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let mut found: Vec<PathBuf> = fs::read_dir(folder_of(path))
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|p| p.file_name().is_some_and(|n| n.to_string_lossy().to_lowercase() == wanted) && p.is_file())
        .collect();
    found.sort();
    found.into_iter().next()
}

/// The content of a file.
///
/// # Errors
/// Unreadable, or larger than 1 GiB.
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let too_large = || Err(io::Error::other("larger than 1 GiB"));
    let file = opened::open(path)?;
    if file.metadata()?.len() > LARGEST {
        return too_large();
    }
    // What is no plain file has no length.
    let mut bytes = Vec::new();
    file.take(LARGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST { too_large() } else { Ok(bytes) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_file_larger_than_any_of_its_kind_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("Huge.bin");
        // Sparse: it takes no room on the disk.
        fs::File::create(&path).unwrap().set_len(LARGEST + 1).unwrap();
        assert_eq!(locate(folder.path(), "textures\\huge.BIN").as_deref(), Some(&*path));
        assert!(read(&path).unwrap_err().to_string().contains("1 GiB"));
        let small = folder.path().join("small.bin");
        fs::write(&small, b"abc").unwrap();
        assert_eq!(read(&small).unwrap(), b"abc");
    }
}
