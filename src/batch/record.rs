//! What a take has read and written, kept beside its first output, so that a finished take is not done again.

use super::manifest::{Manifest, Take, Values};
use crate::error::{Error, Result};
use crate::export::files::{self, Pending};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Options that change no output.
const WITHOUT_EFFECT: [&str; 6] = ["threads", "quiet", "verbose", "force", "cache", "cache-size"];
/// Bytes that a record may have.
const LARGEST: u64 = 64 << 20;

/// How far a take came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It was begun; what stands under its outputs' names is its own and may be replaced.
    Begun,
    /// All outputs are whole.
    Done,
}

/// The record of a take: `walk.glb.take.json` beside `walk.glb`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of the program.
    pub retarget: String,
    /// How far it came.
    pub state: State,
    /// Exit code of the main job: 0, or 4 where a quality gate failed.
    #[serde(default)]
    pub exit: u8,
    /// The arguments as the manifest has them, without those that change no output.
    pub arguments: Values,
    /// SHA-256 of every file that was read, by its path as seen from the manifest's folder.
    #[serde(default)]
    pub inputs: BTreeMap<PathBuf, String>,
    /// Bytes of every output, by its path in the same way.
    #[serde(default)]
    pub outputs: BTreeMap<PathBuf, u64>,
    /// What it amounted to.
    #[serde(default)]
    pub summary: Summary,
}

/// A take in figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Seconds from start to end.
    pub seconds: f64,
    /// Seconds of these before the first frame.
    pub setup_seconds: f64,
    /// Largest memory of the process in megabytes; absent where the system does not tell.
    #[serde(default)]
    pub peak_mb: Option<f64>,
    /// Frames written.
    pub frames: usize,
    /// Vertices of the scan.
    pub vertices: usize,
    /// Median distance of handles to targets over the take, in millimetres (in the scan's unit where that is unknown).
    pub residual_median_mm: f64,
    /// The largest distance; absent without handles.
    #[serde(default)]
    pub residual_worst_mm: Option<f64>,
    /// Its handle.
    #[serde(default)]
    pub worst_handle: Option<String>,
    /// Its frame, in the capture's own numbering.
    #[serde(default)]
    pub worst_frame: Option<i64>,
    /// Least and largest volume of the body against rest.
    pub volume: (f64, f64),
    /// Warnings that were printed.
    pub warnings: usize,
}

/// Why a take has to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Due {
    /// It never was.
    New,
    /// It was interrupted.
    Interrupted,
    /// Something has changed: what.
    Changed(String),
}

impl Record {
    /// Where the record of a take is kept.
    pub fn path(manifest: &Manifest, take: &Take) -> PathBuf {
        let mut path = manifest.outputs(take).into_iter().next().unwrap_or_default().into_os_string();
        path.push(".take.json");
        path.into()
    }

    /// A record of a take that is begun now.
    pub fn begin(manifest: &Manifest, take: &Take) -> Self {
        let mut arguments = take.values.clone();
        WITHOUT_EFFECT.iter().for_each(|key| drop(arguments.remove(*key)));
        Self {
            retarget: env!("CARGO_PKG_VERSION").to_owned(),
            state: State::Begun,
            exit: 0,
            arguments,
            inputs: BTreeMap::new(),
            outputs: manifest.outputs(take).iter().map(|path| (seen_from(manifest.folder(), path), 0)).collect(),
            summary: Summary::default(),
        }
    }

    /// Whether a run of the take has written this path, or meant to: it may be replaced.
    pub fn owns(&self, manifest: &Manifest, path: &Path) -> bool {
        self.outputs.contains_key(&seen_from(manifest.folder(), path))
    }

    /// Reads the record of a take; `None` where there is none that can be read.
    pub fn read(path: &Path) -> Option<Self> {
        let mut text = String::new();
        File::open(path).ok()?.take(LARGEST).read_to_string(&mut text).ok()?;
        serde_json::from_str(&text).ok()
    }

    /// Writes the record in place of an earlier one.
    ///
    /// # Errors
    /// [`crate::error::Kind::Unwritable`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|e| Error::unwritable(path, &e.into()))?;
        let mut file = Pending::create(path)?;
        file.write(text.as_bytes())?;
        file.write(b"\n")?;
        file.finish().map(drop)
    }

    /// Adds the inputs and outputs of a run that began at `started`. An input that was written since then is as good as changed: the
    /// take will be done again.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn complete(&mut self, manifest: &Manifest, inputs: &[PathBuf], outputs: &[PathBuf], started: SystemTime) -> Result<()> {
        let folder = manifest.folder();
        for path in inputs {
            let changed = fs::metadata(path).and_then(|about| about.modified()).is_ok_and(|at| at > started);
            let hash = if changed { String::new() } else { hash(path)? };
            self.inputs.insert(seen_from(folder, path), hash);
        }
        for path in outputs {
            self.outputs.insert(seen_from(folder, path), files::bytes(path).unwrap_or(0));
        }
        self.state = State::Done;
        Ok(())
    }

    /// Why a take has to be done (again); `None` where its record says that it is done and nothing has changed since.
    pub fn due(record: Option<&Self>, manifest: &Manifest, take: &Take) -> Option<Due> {
        let Some(record) = record else { return Some(Due::New) };
        let changed = |what: String| Some(Due::Changed(what));
        let wanted = Self::begin(manifest, take);
        if record.state != State::Done {
            return Some(Due::Interrupted);
        }
        if record.retarget != wanted.retarget {
            return changed(format!("done by version {}", record.retarget));
        }
        if record.arguments != wanted.arguments {
            return changed("other options".into());
        }
        for (path, bytes) in &record.outputs {
            match files::bytes(&manifest.folder().join(path)) {
                Some(there) if there == *bytes => {}
                Some(_) => return changed(format!("{} has changed", path.display())),
                None => return changed(format!("{} is missing", path.display())),
            }
        }
        for (path, known) in &record.inputs {
            match hash(&manifest.folder().join(path)) {
                Ok(now) if now == *known => {}
                Ok(_) => return changed(format!("{} has changed", path.display())),
                Err(_) => return changed(format!("{} is missing", path.display())),
            }
        }
        None
    }
}

/// A path as seen from a folder: relative where it lies in it.
fn seen_from(folder: &Path, path: &Path) -> PathBuf {
    path.strip_prefix(folder).unwrap_or(path).to_owned()
}

/// SHA-256 of a file.
fn hash(path: &Path) -> Result<String> {
    let mut hasher = Sha256::new();
    File::open(path).and_then(|mut file| std::io::copy(&mut file, &mut hasher)).map_err(|e| Error::unreadable(path, &e))?;
    Ok(hasher.finalize().iter().fold(String::with_capacity(64), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    }))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::batch::manifest::{OptionTable, Takes};

    #[test]
    fn a_take_is_due_until_it_is_done_and_again_when_anything_changes() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        let read = || {
            let options: OptionTable =
                [("out", Takes::Path), ("frames", Takes::Value), ("threads", Takes::Value)].map(|(n, t)| (n.into(), t)).into();
            Manifest::read(&folder.path().join("list.csv"), options).unwrap()
        };
        write("list.csv", "scan,capture,out,threads\na.obj,w.c3d,o.glb|f_##.ply,1\n");
        ["a.obj", "w.c3d", "a.mtl", "o.glb", "f_01.ply", "f_02.ply"].iter().for_each(|name| write(name, name));
        let manifest = read();
        let take = &manifest.takes[0];
        let path = Record::path(&manifest, take);
        assert_eq!(path.file_name().unwrap(), "o.glb.take.json");
        let due = |manifest: &Manifest| Record::due(Record::read(&path).as_ref(), manifest, &manifest.takes[0]);
        assert_eq!(due(&manifest), Some(Due::New));

        let mut record = Record::begin(&manifest, take);
        record.write(&path).unwrap();
        assert_eq!(due(&manifest), Some(Due::Interrupted));
        let inputs = ["a.obj", "w.c3d", "a.mtl"].map(|name| folder.path().join(name));
        let outputs = manifest.outputs(take);
        record.complete(&manifest, &inputs, &outputs, SystemTime::now()).unwrap();
        record.write(&path).unwrap();
        assert_eq!(due(&manifest), None);
        assert_eq!(record.outputs[Path::new("f_##.ply")], 16);

        let changed = |what: &str| Some(Due::Changed(what.to_owned()));
        write("list.csv", "scan,capture,out,threads\na.obj,w.c3d,o.glb|f_##.ply,2\n");
        assert_eq!(due(&read()), None, "threads change nothing");
        write("list.csv", "scan,capture,out,frames\na.obj,w.c3d,o.glb|f_##.ply,1..2\n");
        assert_eq!(due(&read()), changed("other options"));
        write("a.mtl", "another");
        assert_eq!(due(&manifest), changed("a.mtl has changed"));
        fs::remove_file(folder.path().join("a.mtl")).unwrap();
        assert_eq!(due(&manifest), changed("a.mtl is missing"));
        fs::remove_file(folder.path().join("f_02.ply")).unwrap();
        assert_eq!(due(&manifest), changed("f_##.ply has changed"));
        fs::remove_file(folder.path().join("o.glb")).unwrap();
        record.retarget = "0.0.1".into();
        record.write(&path).unwrap();
        assert_eq!(due(&manifest), changed("done by version 0.0.1"));
        fs::write(&path, "{").unwrap();
        assert_eq!(due(&manifest), Some(Due::New), "a record that cannot be read is none");
    }

    #[test]
    fn an_input_that_was_written_during_the_run_counts_as_changed() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("list.csv"), "scan,capture,out\na,b,c.glb\n").unwrap();
        ["a", "c.glb"].iter().for_each(|name| fs::write(folder.path().join(name), name).unwrap());
        let manifest = Manifest::read(&folder.path().join("list.csv"), [("out".into(), Takes::Path)].into()).unwrap();
        let mut record = Record::begin(&manifest, &manifest.takes[0]);
        let outputs = manifest.outputs(&manifest.takes[0]);
        record.complete(&manifest, &[folder.path().join("a")], &outputs, SystemTime::UNIX_EPOCH).unwrap();
        assert_eq!(Record::due(Some(&record), &manifest, &manifest.takes[0]), Some(Due::Changed("a has changed".into())));
    }
}
