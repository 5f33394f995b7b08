//! Files that a mesh names: material libraries, images, buffers. They lie in its folder or in its archive.

use super::Image;
use super::archive::{Archive, Entry};
use crate::beside::{folder_of, locate, read};
use crate::error::{Error, Kind, Result};
use crate::opened;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// What lies beside a mesh.
#[derive(Clone)]
pub(super) enum Beside {
    /// Nothing.
    Nothing,
    /// The files of a folder.
    Folder(PathBuf),
    /// The files of an archive, seen from a folder in it.
    Archive(Rc<Archive>, String),
}

impl Beside {
    /// The files in the folder of `path`.
    pub(super) fn of(path: &Path) -> Self {
        Self::Folder(folder_of(path).to_owned())
    }

    /// The files around `entry` of an archive.
    pub(super) fn within(archive: &Rc<Archive>, entry: &Entry) -> Self {
        Self::Archive(archive.clone(), folder_in(&entry.name))
    }

    /// Whether it is an archive.
    pub(super) fn is_archive(&self) -> bool {
        matches!(self, Self::Archive(..))
    }

    /// Whether a file of this name is there.
    pub(super) fn has(&self, name: &str) -> bool {
        match self {
            Self::Nothing => false,
            Self::Folder(folder) => locate(folder, name).is_some(),
            Self::Archive(archive, folder) => entry(archive, folder, name).is_some(),
        }
    }

    /// The image of this name, if there is one.
    pub(super) fn image(&self, name: &str) -> Option<Image> {
        match self {
            Self::Nothing => None,
            Self::Folder(folder) => locate(folder, name).map(Image::File),
            Self::Archive(archive, folder) => {
                let (entry, bytes) = archive.shared(&entry(archive, folder, name)?.name)?;
                Some(Image::Embedded { name: entry.name.clone(), bytes: bytes.ok()? })
            }
        }
    }

    /// The content of a file with what lies beside it; `None` if it is missing.
    pub(super) fn read(&self, name: &str) -> Option<Result<(Vec<u8>, Self)>> {
        match self {
            Self::Nothing => None,
            Self::Folder(folder) => {
                let path = locate(folder, name)?;
                Some(read(&path).map_err(|e| Error::unreadable(&path, &e)).map(|bytes| (bytes, Self::of(&path))))
            }
            Self::Archive(archive, folder) => {
                let entry = entry(archive, folder, name)?;
                Some(archive.unpack(entry).map(|bytes| (bytes, Self::within(archive, entry))))
            }
        }
    }

    /// The content of a file that the mesh cannot do without.
    pub(super) fn needed(&self, name: &str) -> Result<Vec<u8>> {
        let missing = || {
            Err(Error::new(Kind::Unreadable, format!("'{name}', which the file needs, is missing"))
                .hint("put it beside the file, or pack both into one"))
        };
        self.read(name).map_or_else(missing, |found| found.map(|(bytes, _)| bytes))
    }
}

/// As [`locate`] finds files: as written, else of that name in the folder itself.
fn entry<'a>(archive: &'a Archive, folder: &str, name: &str) -> Option<&'a Entry> {
    let base = name.rsplit(['/', '\\']).next().unwrap_or(name);
    archive.find(&format!("{folder}/{name}")).or_else(|| archive.find(&format!("{folder}/{base}")))
}

fn folder_in(name: &str) -> String {
    name.rsplit_once('/').map_or_else(String::new, |(folder, _)| folder.to_owned())
}

/// What a message calls a file inside an archive: `scan.zip/body.obj`.
pub(super) fn inside(path: &Path, entry: &Entry) -> PathBuf {
    path.join(&entry.name)
}

impl Image {
    /// Its name for messages and for files made from it.
    pub fn name(&self) -> String {
        match self {
            Image::File(path) => path.display().to_string(),
            Image::Embedded { name, .. } => name.clone(),
        }
    }

    /// Its encoded bytes.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn read(&self) -> std::io::Result<Vec<u8>> {
        match self {
            Image::File(path) => opened::read(path),
            Image::Embedded { bytes, .. } => Ok(bytes.to_vec()),
        }
    }
}
