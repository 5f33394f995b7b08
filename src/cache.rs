//! What set-up computes of a scan, kept on disk for other takes of the same scan.
//!
//! An entry is found by the SHA-256 of all that it was computed from, so an entry is never wrong, only missing. Among it are the program's version
//! and the instruction set of the processor: linear algebra adds in another order where registers are wider.
//! Entries are whole or absent and carry a checksum; several processes may use a folder at once.

use crate::error::{Error, Kind, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

/// How file names of entries end.
const ENDING: &str = "retarget";
/// How file names of entries begin while they are written.
const UNFINISHED: &str = ".retarget-";
/// After this time nobody writes an unfinished entry any more.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);
/// Counted up when what is kept changes between two versions of the program.
const LAYOUT: u64 = 2;
/// Bytes of the checksum before the content.
const CHECKSUM: usize = 32;

/// A folder of entries.
#[derive(Debug)]
pub struct Cache {
    folder: PathBuf,
    largest: u64,
    trouble: Mutex<Option<Error>>,
}

/// What an entry was computed from.
#[derive(Clone, Debug)]
pub struct Key(Sha256);

impl Key {
    /// A key for a kind of entry.
    pub fn new(kind: &str) -> Self {
        Self::on(&instruction_set(), kind)
    }

    fn on(instruction_set: &str, kind: &str) -> Self {
        let program = Self(Sha256::new()).bytes(env!("CARGO_PKG_VERSION").as_bytes()).plain(&[LAYOUT]);
        program.bytes(instruction_set.as_bytes()).bytes(kind.as_bytes())
    }

    /// Adds bytes; where they end counts.
    #[must_use]
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// Adds numbers, triples, structures: whatever is plain data.
    #[must_use]
    pub fn plain<T: bytemuck::NoUninit>(self, items: &[T]) -> Self {
        self.bytes(bytemuck::cast_slice(items))
    }

    fn name(&self) -> String {
        let hex: String = self.0.clone().finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{hex}.{ENDING}")
    }
}

/// The processor's kind, with what decides in which order sums are taken.
fn instruction_set() -> String {
    let mut words = vec![std::env::consts::ARCH];
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        let wide = [("avx2", has!("avx2")), ("fma", has!("fma")), ("avx512f", has!("avx512f"))];
        words.extend(wide.iter().filter(|word| word.1).map(|word| word.0));
    }
    words.join(" ")
}

impl Cache {
    /// The cache in a folder, which is made if it is missing; it holds about `largest` bytes at most.
    ///
    /// # Errors
    /// [`Kind::Unwritable`].
    pub fn open(folder: &Path, largest: u64) -> Result<Self> {
        fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e))?;
        if !folder.is_dir() {
            return Err(Error::new(Kind::Unwritable, "is no folder").file(folder).expected("a folder for the cache"));
        }
        Ok(Self { folder: folder.to_owned(), largest, trouble: Mutex::default() })
    }

    /// The entry of this key, if it is there and whole.
    pub fn get<T: DeserializeOwned>(&self, key: &Key) -> Option<T> {
        let path = self.folder.join(key.name());
        let bytes = fs::read(&path).ok()?;
        let (checksum, content) = bytes.split_at_checked(CHECKSUM)?;
        if Sha256::digest(content).as_slice() != checksum {
            return None;
        }
        // The oldest go first when room is made. A folder that may only be read serves as well.
        let _ = File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        postcard::from_bytes(content).ok()
    }

    /// Keeps an entry; what prevents that is no failure, but told by [`Cache::trouble`].
    pub fn keep<T: Serialize>(&self, key: &Key, value: &T) {
        if let Err(error) = self.put(key, value) {
            self.trouble.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(error);
        }
    }

    /// What prevented that an entry was kept.
    pub fn trouble(&self) -> Option<Error> {
        self.trouble.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take()
    }

    /// Keeps an entry.
    ///
    /// # Errors
    /// [`Kind::Unwritable`].
    fn put<T: Serialize>(&self, key: &Key, value: &T) -> Result<()> {
        let content = postcard::to_stdvec(value).map_err(|e| Error::new(Kind::Unwritable, format!("cannot be stored: {e}")))?;
        let write = || {
            let mut file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(&self.folder)?;
            file.write_all(&Sha256::digest(&content))?;
            file.write_all(&content)?;
            file.persist(self.folder.join(key.name())).map_err(|e| e.error).map(drop)
        };
        write().map_err(|e| Error::unwritable(&self.folder, &e))?;
        self.make_room();
        Ok(())
    }

    /// Removes what writers have left behind that were killed, and the entries that were not used for the longest time until the rest is small
    /// enough.
    fn make_room(&self) {
        let mut files: Vec<(SystemTime, u64, PathBuf)> = Vec::new();
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let Some((modified, bytes)) = entry.metadata().ok().and_then(|about| Some((about.modified().ok()?, about.len())))
            else {
                continue;
            };
            let path = entry.path();
            if path.extension().is_some_and(|e| e == ENDING) {
                files.push((modified, bytes, path));
            } else if entry.file_name().to_string_lossy().starts_with(UNFINISHED)
                && modified.elapsed().is_ok_and(|age| age > ABANDONED)
            {
                let _ = fs::remove_file(path);
            }
        }
        let mut total: u64 = files.iter().map(|file| file.1).sum();
        files.sort();
        for (_, bytes, path) in files {
            if total <= self.largest {
                break;
            }
            // Another process may have removed it already.
            let _ = fs::remove_file(path);
            total -= bytes;
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_comes_back_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(&folder.path().join("new"), 1 << 20).unwrap();
        let key = Key::new("numbers").plain(&[1.0, 2.0]);
        assert_eq!(cache.get::<Vec<f64>>(&key), None);
        cache.put(&key, &vec![0.1, f64::NEG_INFINITY]).unwrap();
        assert_eq!(cache.get::<Vec<f64>>(&key), Some(vec![0.1, f64::NEG_INFINITY]));
        for other in [Key::new("others").plain(&[1.0, 2.0]), Key::new("numbers").plain(&[1.0]).plain(&[2.0])] {
            assert_eq!(cache.get::<Vec<f64>>(&other), None);
        }
        let path = folder.path().join("new").join(key.name());
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(cache.get::<Vec<f64>>(&key), None, "{length} bytes");
        }
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            fs::write(&path, damaged).unwrap();
            assert_eq!(cache.get::<Vec<f64>>(&key), None, "byte {at}");
        }
        assert_eq!(fs::read_dir(folder.path().join("new")).unwrap().count(), 1, "nothing half-written is left");
    }

    #[test]
    fn what_was_not_used_for_the_longest_time_goes_first() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 3_000).unwrap();
        let key = |n: u8| Key::new("k").bytes(&[n]);
        let age = |n: u8, seconds: u64| {
            let file = File::options().append(true).open(folder.path().join(key(n).name())).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
        };
        fs::write(folder.path().join("mine.txt"), vec![0; 9_000]).unwrap();
        cache.put(&key(1), &vec![1u8; 1_000]).unwrap();
        cache.put(&key(2), &vec![2u8; 1_000]).unwrap();
        age(1, 200);
        age(2, 100);
        assert!(cache.get::<Vec<u8>>(&key(1)).is_some(), "used now");
        cache.put(&key(3), &vec![3u8; 1_000]).unwrap();
        let there = |n| cache.get::<Vec<u8>>(&key(n)).is_some();
        assert_eq!((there(1), there(2), there(3)), (true, false, true));
        assert!(folder.path().join("mine.txt").exists(), "other files are left alone");
    }

    #[test]
    fn what_a_killed_writer_left_goes_after_a_day() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 3_000).unwrap();
        for (name, hours) in [("old", 25), ("young", 23)] {
            let path = folder.path().join(format!("{UNFINISHED}{name}"));
            fs::write(&path, "half").unwrap();
            let file = File::options().append(true).open(path).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(hours * 3600)).unwrap();
        }
        cache.put(&Key::new("k"), &1).unwrap();
        let there = |name| folder.path().join(format!("{UNFINISHED}{name}")).exists();
        assert_eq!((there("old"), there("young")), (false, true));
    }

    #[test]
    fn another_processor_has_entries_of_its_own() {
        assert_ne!(Key::on("x86_64 avx2", "k").name(), Key::on("x86_64", "k").name());
        assert_eq!(Key::on(&instruction_set(), "k").name(), Key::new("k").name());
    }

    #[test]
    fn several_writers_do_no_harm() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 60_000).unwrap();
        std::thread::scope(|scope| {
            for writer in 0..4u8 {
                let cache = &cache;
                scope.spawn(move || {
                    for n in 0..40u8 {
                        let key = Key::new("k").bytes(&[n % 8]);
                        match cache.get::<Vec<u8>>(&key) {
                            Some(found) => assert_eq!(found, vec![n % 8; 10_000], "writer {writer}"),
                            None => cache.put(&key, &vec![n % 8; 10_000]).unwrap(),
                        }
                    }
                });
            }
        });
        let bytes: u64 = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().metadata().unwrap().len()).sum();
        assert!(bytes <= 70_100, "{bytes}");
    }
}
