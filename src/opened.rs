//! Which files were read as input: the scan, the capture, and all that these name. A record of a take needs every one of them.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// A program reads the inputs of one take; readers all over the house add to the list.
static OPENED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Opens an input.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    let file = File::open(path)?;
    OPENED.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).insert(path.to_owned());
    Ok(file)
}

/// The whole content of an input.
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The inputs that were opened so far, in the order of their names.
pub(crate) fn all() -> Vec<PathBuf> {
    OPENED.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).iter().cloned().collect()
}
