//! Output files: each appears under its name only when it is complete, and a run that fails leaves nothing behind.

use crate::error::{Error, Kind, Notes, Result};
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};

/// Whether an output is already there: the file, or for a pattern with `#` any frame of it.
pub fn exists(path: &Path) -> bool {
    match Pattern::parse(path) {
        Some(pattern) => !pattern.frames_there().is_empty(),
        None => path.exists(),
    }
}

/// Bytes of an output: of the file, or for a pattern with `#` of all frames of it; `None` where there is none.
pub fn bytes(path: &Path) -> Option<u64> {
    let Some(pattern) = Pattern::parse(path) else {
        return fs::metadata(path).ok().filter(fs::Metadata::is_file).map(|f| f.len());
    };
    let sizes = pattern.frames_there().into_iter().filter_map(|name| Some(fs::metadata(pattern.folder.join(name)).ok()?.len()));
    sizes.reduce(|all, one| all + one)
}

/// Tries whether an output, file or pattern, can be created; leaves nothing behind.
///
/// Errors: [`Kind::Unwritable`] with the system's reason.
pub fn check_writable(path: &Path) -> Result<()> {
    match Pattern::parse(path) {
        Some(_) => Sequence::create(path).map(drop),
        None => Pending::create(path).map(drop),
    }
}

/// The path of `file` as seen from `folder`, with `/` between its parts; absolute if they share nothing. Both have to exist.
pub fn relative(folder: &Path, file: &Path) -> String {
    let (Ok(folder), Ok(file)) = (folder.canonicalize(), file.canonicalize()) else { return file.to_string_lossy().into_owned() };
    let shared = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return file.to_string_lossy().into_owned();
    }
    let up = folder.components().skip(shared).map(|_| "..".to_owned());
    let down = file.components().skip(shared).map(|c| c.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

/// Folders that did not exist; they go again unless they are kept.
#[derive(Debug, Default)]
struct NewFolders {
    outermost_first: Vec<PathBuf>,
    kept: bool,
}

impl NewFolders {
    fn create(folder: &Path) -> Result<Self> {
        let mut missing: Vec<PathBuf> =
            folder.ancestors().take_while(|a| !a.as_os_str().is_empty() && !a.exists()).map(Path::to_owned).collect();
        missing.reverse();
        let mut new = Self::default();
        for folder in missing {
            // A path through `..` may exist by now.
            match fs::create_dir(&folder) {
                Ok(()) => new.outermost_first.push(folder),
                Err(_) if folder.is_dir() => {}
                Err(reason) => return Err(Error::unwritable(&folder, &reason)),
            }
        }
        Ok(new)
    }
}

impl Drop for NewFolders {
    fn drop(&mut self) {
        if !self.kept {
            // Only empty ones can be removed this way.
            self.outermost_first.iter().rev().for_each(|folder| drop(fs::remove_dir(folder)));
        }
    }
}

/// The folder of a file; the current one where its path names none.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file that is written beside its target and renamed on [`Pending::finish`]; dropped before, it is removed.
#[derive(Debug)]
pub struct Pending {
    // Dropped in this order: the file goes before its folder.
    temporary: NamedTempFile,
    folders: NewFolders,
    target: PathBuf,
}

impl Pending {
    /// Opens a temporary file beside `target`; a missing folder is created.
    ///
    /// Errors: [`Kind::Unwritable`].
    pub fn create(target: &Path) -> Result<Self> {
        if target.is_dir() {
            return Err(Error::new(Kind::Unwritable, "is a folder").file(target).expected("the name of a file"));
        }
        if target.exists() && !target.is_file() {
            return Err(Error::new(Kind::Unwritable, "is not a regular file").file(target).expected("the name of a file"));
        }
        // What a link points to is replaced, not the link.
        let target =
            &if target.is_symlink() { target.canonicalize().unwrap_or_else(|_| target.to_owned()) } else { target.to_owned() };
        let folders = NewFolders::create(folder_of(target))?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(".retarget-");
        // As any other new file: the umask takes away what the user wants taken away.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let temporary = builder.tempfile_in(folder_of(target)).map_err(|e| Error::unwritable(target, &e))?;
        Ok(Self { temporary, folders, target: target.to_owned() })
    }

    /// Appends bytes. Nothing is buffered: hand over large pieces.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.temporary.write_all(bytes).map_err(|e| Error::unwritable(&self.target, &e))
    }

    /// Replaces bytes in what is already written; further writing goes on at the end.
    pub fn patch(&mut self, at: u64, bytes: &[u8]) -> Result<()> {
        let file = self.temporary.as_file_mut();
        let patched =
            file.seek(SeekFrom::Start(at)).and_then(|_| file.write_all(bytes)).and_then(|()| file.seek(SeekFrom::End(0)));
        patched.map(drop).map_err(|e| Error::unwritable(&self.target, &e))
    }

    /// The file itself, for seeking and buffering.
    pub fn file_mut(&mut self) -> &mut File {
        self.temporary.as_file_mut()
    }

    /// Puts the file in place of the target; returns its size in bytes.
    pub fn finish(mut self) -> Result<u64> {
        let bytes = self.temporary.as_file().metadata().map_err(|e| Error::unwritable(&self.target, &e))?.len();
        self.temporary.persist(&self.target).map_err(|e| Error::unwritable(&self.target, &e.error))?;
        self.folders.kept = true;
        Ok(bytes)
    }
}

/// The names of a frame sequence: the last run of `#` in the file name stands for the number.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Pattern {
    folder: PathBuf,
    prefix: String,
    digits: usize,
    suffix: String,
}

impl Pattern {
    /// `None` without a `#` in the file name.
    fn parse(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy();
        let end = name.rfind('#')? + 1;
        let begin = name[..end].trim_end_matches('#').len();
        Some(Self {
            folder: folder_of(path).to_owned(),
            prefix: name[..begin].to_owned(),
            digits: end - begin,
            suffix: name[end..].to_owned(),
        })
    }

    /// The number with at least as many digits as there were `#`; a minus stands before them.
    fn name(&self, frame: i64) -> String {
        let sign = if frame < 0 { "-" } else { "" };
        format!("{}{sign}{:0width$}{}", self.prefix, frame.unsigned_abs(), self.suffix, width = self.digits)
    }

    fn is_frame(&self, name: &str) -> bool {
        let number = name.strip_prefix(self.prefix.as_str()).and_then(|n| n.strip_suffix(self.suffix.as_str()));
        number.and_then(|n| n.parse().ok()).is_some_and(|frame| self.name(frame) == name)
    }

    fn frames_there(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            entries.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|n| self.is_frame(n)).collect();
        names.sort();
        names
    }
}

/// What a finished sequence consists of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Finished {
    /// Files.
    pub files: usize,
    /// Their bytes in all.
    pub bytes: u64,
    /// Frames of the same pattern from before that have other numbers and are still there.
    pub older: usize,
}

/// Warns of frames from before among the new ones.
pub(super) fn note_older(finished: &Finished, notes: &mut Notes) {
    if finished.older > 0 {
        notes.warn(format!("{} frames of the same name from before are still there, with other numbers", finished.older));
    }
}

/// One file per frame. They are collected in a hidden folder beside their targets and moved all at once on [`Sequence::finish`];
/// dropped before, all are removed, and so is a folder that was created for them.
#[derive(Debug)]
pub struct Sequence {
    // Dropped in this order: the files go before their folder.
    staging: TempDir,
    folders: NewFolders,
    pattern: Pattern,
}

impl Sequence {
    /// Prepares a sequence; `pattern` is a path such as `frames/f_####.ply`. A missing folder is created.
    ///
    /// Errors: no `#` in the file name, or [`Kind::Unwritable`].
    pub fn create(pattern: &Path) -> Result<Self> {
        let Some(parsed) = Pattern::parse(pattern) else {
            return Err(Error::new(Kind::Usage, "the name of a frame sequence has no '#'")
                .file(pattern)
                .expected("a run of '#' for the frame number, such as frames/f_####.ply"));
        };
        let folders = NewFolders::create(&parsed.folder)?;
        let staging = tempfile::Builder::new().prefix(".retarget-").tempdir_in(&parsed.folder);
        let staging = staging.map_err(|e| Error::unwritable(&parsed.folder, &e))?;
        Ok(Self { staging, folders, pattern: parsed })
    }

    /// The folder of the frames.
    pub fn folder(&self) -> &Path {
        &self.pattern.folder
    }

    /// Writes the file of a frame from its parts.
    pub fn write<'a>(&self, frame: i64, parts: impl IntoIterator<Item = &'a [u8]>) -> Result<()> {
        self.write_named(&self.pattern.name(frame), parts)
    }

    /// Name of a file that belongs to the whole sequence.
    pub fn companion_name(&self, ending: &str) -> String {
        format!("{}{ending}", self.pattern.prefix)
    }

    /// Writes a file that belongs to the whole sequence under [`Sequence::companion_name`].
    pub fn write_companion(&self, ending: &str, bytes: &[u8]) -> Result<()> {
        self.write_named(&self.companion_name(ending), [bytes])
    }

    fn write_named<'a>(&self, name: &str, parts: impl IntoIterator<Item = &'a [u8]>) -> Result<()> {
        let write = || {
            let mut file = File::create(self.staging.path().join(name))?;
            parts.into_iter().try_for_each(|part| file.write_all(part))
        };
        write().map_err(|e| Error::unwritable(&self.pattern.folder.join(name), &e))
    }

    /// Moves all files to their names.
    ///
    /// Errors: [`Kind::Unwritable`]; then none of them is left, and the files that they would have replaced are back.
    pub fn finish(mut self) -> Result<Finished> {
        let listing = fs::read_dir(self.staging.path()).and_then(|entries| entries.map(|e| e.map(|e| e.file_name())).collect());
        let mut names: Vec<std::ffi::OsString> = listing.map_err(|e| Error::unwritable(self.staging.path(), &e))?;
        names.sort();
        let before = self.pattern.frames_there();
        let older = before.iter().filter(|n| names.binary_search(&(*n).into()).is_err()).count();
        let replaced = self.staging.path().join("replaced");
        fs::create_dir(&replaced).map_err(|e| Error::unwritable(&replaced, &e))?;
        let mut finished = Finished { files: names.len(), bytes: 0, older };
        for (k, name) in names.iter().enumerate() {
            let (from, to, aside) = (self.staging.path().join(name), self.pattern.folder.join(name), replaced.join(name));
            let moved = fs::metadata(&from).and_then(|m| {
                if to.is_dir() {
                    return Err(std::io::Error::from(std::io::ErrorKind::IsADirectory));
                }
                if to.symlink_metadata().is_ok() {
                    fs::rename(&to, &aside)?;
                }
                fs::rename(&from, &to).map(|()| m.len())
            });
            match moved {
                Ok(bytes) => finished.bytes += bytes,
                Err(reason) => {
                    for name in &names[..k] {
                        drop(fs::remove_file(self.pattern.folder.join(name)));
                    }
                    for name in &names[..=k] {
                        // Fails where nothing was replaced.
                        drop(fs::rename(replaced.join(name), self.pattern.folder.join(name)));
                    }
                    return Err(Error::unwritable(&to, &reason));
                }
            }
        }
        self.folders.kept = true;
        Ok(finished)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn frame_numbers_fill_the_last_run_of_hashes() {
        let name = |path: &str, frame: i64| Pattern::parse(Path::new(path)).unwrap().name(frame);
        assert_eq!(name("a/f_####.ply", 7), "f_0007.ply");
        assert_eq!(name("f_##.ply", 12345), "f_12345.ply");
        assert_eq!(name("#f####", -3), "#f-0003");
        assert_eq!(name("####.obj", 0), "0000.obj");
        assert_eq!(Pattern::parse(Path::new("a##/f.ply")), None);
        assert_eq!(name("f#.ply", i64::MIN), "f-9223372036854775808.ply");
    }

    #[test]
    fn a_sequence_appears_as_a_whole() {
        let dir = tempfile::tempdir().unwrap();
        let pattern = dir.path().join("new/deep/f_###.ply");
        assert!(!exists(&pattern));
        let sequence = Sequence::create(&pattern).unwrap();
        sequence.write(-1, [&b"ab"[..], b"c"]).unwrap();
        sequence.write(1000, [&b"de"[..]]).unwrap();
        assert!(!exists(&pattern));
        assert_eq!(sequence.finish().unwrap(), Finished { files: 2, bytes: 5, older: 0 });
        assert_eq!(names(&dir.path().join("new/deep")), ["f_-001.ply", "f_1000.ply"]);
        assert_eq!(fs::read(dir.path().join("new/deep/f_-001.ply")).unwrap(), b"abc");
        assert!(exists(&pattern) && !exists(&dir.path().join("new/deep/g_###.ply")));
        let sequence = Sequence::create(&pattern).unwrap();
        sequence.write(1000, [&b"x"[..]]).unwrap();
        assert_eq!(sequence.finish().unwrap(), Finished { files: 1, bytes: 1, older: 1 });
    }

    #[test]
    fn a_sequence_that_cannot_be_finished_leaves_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        for (name, text) in [("f_1.ply", "one"), ("f_2.ply", "two")] {
            fs::write(dir.path().join(name), text).unwrap();
        }
        let sequence = Sequence::create(&dir.path().join("f_#.ply")).unwrap();
        for frame in 1..=3 {
            sequence.write(frame, [&b"new"[..]]).unwrap();
        }
        fs::create_dir(dir.path().join("f_3.ply")).unwrap();
        assert_eq!(sequence.finish().unwrap_err().kind, Kind::Unwritable);
        let text = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
        assert_eq!((text("f_1.ply").as_str(), text("f_2.ply").as_str()), ("one", "two"));
        assert_eq!(names(dir.path()), ["f_1.ply", "f_2.ply", "f_3.ply"]);
    }

    #[test]
    fn what_is_dropped_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let sequence = Sequence::create(&dir.path().join("new/deep/f_#.ply")).unwrap();
        sequence.write(0, [&b"ab"[..]]).unwrap();
        drop(sequence);
        let mut pending = Pending::create(&dir.path().join("other/a.pc2")).unwrap();
        pending.write(b"abc").unwrap();
        drop(pending);
        check_writable(&dir.path().join("x/f_#.ply")).unwrap();
        check_writable(&dir.path().join("x/a.glb")).unwrap();
        assert_eq!(names(dir.path()), [] as [&str; 0]);
    }

    #[test]
    fn a_pending_file_replaces_its_target_on_finish() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.pc2");
        fs::write(&target, b"old").unwrap();
        let mut pending = Pending::create(&target).unwrap();
        pending.write(b"0123").unwrap();
        pending.patch(1, b"xy").unwrap();
        pending.write(b"4").unwrap();
        assert_eq!(fs::read(&target).unwrap(), b"old");
        assert_eq!(pending.finish().unwrap(), 5);
        assert_eq!(fs::read(&target).unwrap(), b"0xy34");
        assert_eq!(names(dir.path()), ["a.pc2"]);
    }

    #[cfg(unix)]
    #[test]
    fn files_have_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("plain"), b"").unwrap();
        Pending::create(&dir.path().join("ours")).unwrap().finish().unwrap();
        let sequence = Sequence::create(&dir.path().join("f#")).unwrap();
        sequence.write(1, []).unwrap();
        sequence.finish().unwrap();
        let mode = |name: &str| fs::metadata(dir.path().join(name)).unwrap().permissions().mode();
        assert_eq!((mode("ours"), mode("f1")), (mode("plain"), mode("plain")));
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, b"").unwrap();
        assert_eq!(Pending::create(&file.join("a.pc2")).unwrap_err().kind, Kind::Unwritable);
        assert_eq!(Sequence::create(&file.join("f_#.ply")).unwrap_err().kind, Kind::Unwritable);
        assert_eq!(Pending::create(dir.path()).unwrap_err().kind, Kind::Unwritable);
        assert_eq!(Sequence::create(&dir.path().join("f.ply")).unwrap_err().kind, Kind::Usage);
    }

    #[test]
    fn paths_lead_from_the_output_to_the_source() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir_all(dir.path().join("scans/tex")).unwrap();
        fs::create_dir_all(dir.path().join("out/frames")).unwrap();
        fs::write(dir.path().join("scans/a b.mtl"), b"").unwrap();
        let from = |folder: &str| relative(&dir.path().join(folder), &dir.path().join("scans/a b.mtl"));
        assert_eq!(from("out/frames"), "../../scans/a b.mtl");
        assert_eq!(from("scans"), "a b.mtl");
        assert_eq!(from("scans/tex"), "../a b.mtl");
    }
}
