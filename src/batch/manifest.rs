//! A manifest: a CSV or TOML file of takes, each the arguments of one main job.
//!
//! Columns of the CSV and keys of the TOML are `scan`, `capture`, `out` and the long options of the main job without their dashes. Patterns
//! (`takes/*.c3d`) in `scan` and `capture` stand for all files that match, each scan with each capture; `{scan}` and `{capture}` in any other
//! value are the names of the two files without folder and extension. Paths are seen from the manifest's folder.

#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod table;
mod toml_file;

use crate::error::{Error, Kind, Result};
use crate::words;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes that a manifest may have.
const LARGEST: u64 = 64 << 20;
/// Takes that a manifest may list.
const MOST: usize = 1_000_000;
/// Bytes that their arguments may have in all.
const LARGEST_ARGUMENTS: usize = 512 << 20;
/// Of these a take without any, and an argument without its text.
const TAKE: usize = 256;
const VALUE: usize = 128;

/// What an option takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takes {
    /// Nothing: it is given or not.
    Nothing,
    /// A value.
    Value,
    /// The path of a file.
    Path,
}

/// The options that a manifest may set, by their long names.
pub type OptionTable = BTreeMap<String, Takes>;

/// The arguments of a take as they are written: option and values.
pub type Values = BTreeMap<String, Vec<String>>;

/// A row before patterns are expanded.
#[derive(Clone, Debug, Default)]
struct Row {
    /// `line 3`, `[[take]] 2`.
    place: String,
    values: Values,
}

/// One scan with one capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Take {
    /// Its place in the manifest, counted from 1.
    pub number: usize,
    /// Where the manifest says so: `line 3`.
    pub place: String,
    /// The arguments as they are written, patterns and placeholders filled in.
    pub values: Values,
}

/// A manifest that has been read.
#[derive(Clone, Debug)]
pub struct Manifest {
    /// The file.
    pub path: PathBuf,
    /// The takes, in the order of the file; of one row, the first scan with every capture, then the second.
    pub takes: Vec<Take>,
    options: OptionTable,
}

impl Manifest {
    /// Reads a manifest; `options` are those of the main job.
    ///
    /// # Errors
    /// Unreadable; malformed, with the place; an unknown key, with the nearest known one; a pattern that matches nothing; a take without scan,
    /// capture or output; two takes with the same output.
    pub fn read(path: &Path, options: OptionTable) -> Result<Self> {
        let mut bytes = Vec::new();
        let read = File::open(path).and_then(|file| file.take(LARGEST + 1).read_to_end(&mut bytes));
        read.map_err(|e| Error::unreadable(path, &e).expected("a manifest: .csv or .toml"))?;
        if bytes.len() as u64 > LARGEST {
            return Err(Error::new(Kind::Unsupported, "larger than 64 MB").file(path).expected("a list of takes: .csv or .toml"));
        }
        let toml = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        let takes = rows(&bytes, toml, &options).and_then(|rows| expand(&rows, folder(path)));
        let takes = takes.map_err(|e| if e.file.is_none() { e.file(path) } else { e })?;
        let manifest = Self { path: path.to_owned(), takes, options };
        manifest.outputs_differ()?;
        Ok(manifest)
    }

    /// The folder that paths are seen from.
    pub fn folder(&self) -> &Path {
        folder(&self.path)
    }

    /// The take with this number, counted from 1.
    ///
    /// # Errors
    /// [`Kind::Usage`] when there is none.
    pub fn take(&self, number: usize) -> Result<&Take> {
        number.checked_sub(1).and_then(|n| self.takes.get(n)).ok_or_else(|| {
            Error::new(Kind::Usage, format!("there is no take {number}"))
                .file(&self.path)
                .expected(format!("1 to {}", words::count(self.takes.len())))
        })
    }

    /// The arguments of a take for the main job, paths joined with the manifest's folder.
    pub fn arguments(&self, take: &Take) -> Vec<OsString> {
        let mut arguments = Vec::new();
        for (key, values) in take.values.iter().filter(|(key, _)| !is_positional(key)) {
            for value in values {
                match self.options.get(key) {
                    Some(Takes::Nothing) => arguments.push(format!("--{key}").into()),
                    Some(Takes::Path) => {
                        let mut argument = OsString::from(format!("--{key}="));
                        argument.push(self.folder().join(value));
                        arguments.push(argument);
                    }
                    _ => arguments.push(format!("--{key}={value}").into()),
                }
            }
        }
        arguments.push("--".into());
        arguments.extend(["scan", "capture"].map(|key| self.folder().join(take.one(key)).into_os_string()));
        arguments
    }

    /// The paths of a take's outputs, those of `-o` first.
    pub fn outputs(&self, take: &Take) -> Vec<PathBuf> {
        let of = |key| take.values.get(key).into_iter().flatten();
        OUTPUTS.iter().flat_map(|key| of(*key)).map(|path| self.folder().join(path)).collect()
    }

    fn outputs_differ(&self) -> Result<()> {
        let mut seen: BTreeMap<PathBuf, &Take> = BTreeMap::new();
        for take in &self.takes {
            for path in self.outputs(take) {
                if let Some(other) = seen.insert(path.clone(), take) {
                    return Err(Error::new(Kind::Usage, format!("two takes write '{}'", path.display()))
                        .file(&self.path)
                        .at(if other.place == take.place {
                            format!("{}, {} and {}", take.place, other.name(), take.name())
                        } else {
                            format!("{} and {}", other.place, take.place)
                        })
                        .expected("an output of its own for every take")
                        .hint("{scan} and {capture} in the name stand for those of the take: out/{scan}_{capture}.glb"));
                }
            }
        }
        Ok(())
    }
}

impl Take {
    /// `scan.obj × walk.c3d`.
    pub fn name(&self) -> String {
        let base = |key| Path::new(self.one(key)).file_name().unwrap_or_default().to_string_lossy().into_owned();
        format!("{} \u{d7} {}", base("scan"), base("capture"))
    }

    /// The only value of `scan` or `capture`.
    fn one(&self, key: &str) -> &str {
        self.values.get(key).and_then(|values| values.first()).map_or("", String::as_str)
    }
}

/// Options that name what is written.
const OUTPUTS: [&str; 5] = ["out", "report", "picture", "save-rig", "save-proxy"];

fn is_positional(key: &str) -> bool {
    matches!(key, "scan" | "capture")
}

fn folder(path: &Path) -> &Path {
    crate::beside::folder_of(path)
}

/// The rows of a manifest, whose keys are known.
fn rows(bytes: &[u8], toml: bool, options: &OptionTable) -> Result<Vec<Row>> {
    let text = std::str::from_utf8(bytes)
        .map_err(|e| Error::malformed("is not text in UTF-8").at(format!("byte {}", e.valid_up_to())))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let rows = if toml { toml_file::rows(text) } else { table::rows(text) }?;
    rows.iter().try_for_each(|row| check(row, options))?;
    Ok(rows)
}

/// Whether keys are known and nothing is missing.
fn check(row: &Row, options: &OptionTable) -> Result<()> {
    for (key, values) in &row.values {
        if is_positional(key) {
            continue;
        }
        let Some(takes) = options.get(key) else {
            let known = options.keys().map(String::as_str).chain(["scan", "capture"]);
            let nearest = known.min_by_key(|known| strsim::levenshtein(key, known));
            return Err(Error::new(Kind::Usage, format!("unknown key '{key}'"))
                .at(&*row.place)
                .expected("scan, capture, out, or an option of the main job without its dashes")
                .hint(nearest.unwrap_or_default()));
        };
        if *takes == Takes::Nothing && values.iter().any(|v| !v.is_empty()) {
            return Err(Error::new(Kind::Usage, format!("'{key}' is '{}'", values.join(" ")))
                .at(&*row.place)
                .expected("yes or no"));
        }
    }
    for key in ["scan", "capture", "out"] {
        if row.values.get(key).is_none_or(|values| values.iter().all(String::is_empty)) {
            return Err(Error::new(Kind::Usage, format!("no '{key}'")).at(&*row.place).expected("scan, capture and out"));
        }
    }
    Ok(())
}

/// Every scan of a row with every capture.
fn expand(rows: &[Row], folder: &Path) -> Result<Vec<Take>> {
    let mut takes = Vec::new();
    let mut room = LARGEST_ARGUMENTS;
    for row in rows {
        let files = |key: &str| -> Result<Vec<String>> {
            let mut files = Vec::new();
            for pattern in row.values.get(key).into_iter().flatten() {
                files.extend(matching(pattern, folder).map_err(|e| e.at(format!("{}, {key}", row.place)))?);
            }
            Ok(files)
        };
        let (scans, captures) = (files("scan")?, files("capture")?);
        if scans.len().saturating_mul(captures.len()) > MOST - takes.len() {
            return Err(Error::new(Kind::Usage, format!("more than {} takes", words::count(MOST))).at(&*row.place));
        }
        for (scan, capture) in scans.iter().flat_map(|scan| captures.iter().map(move |capture| (scan, capture))) {
            let fill = |text: &String| text.replace("{scan}", &stem(scan)).replace("{capture}", &stem(capture));
            let mut values: Values =
                row.values.iter().map(|(key, values)| (key.clone(), values.iter().map(fill).collect())).collect();
            values.insert("scan".into(), vec![scan.clone()]);
            values.insert("capture".into(), vec![capture.clone()]);
            // With about what the list itself takes.
            let bytes: usize = TAKE + values.values().flatten().map(|value| value.len() + VALUE).sum::<usize>();
            room = room.checked_sub(bytes).ok_or_else(|| {
                let size = words::bytes(LARGEST_ARGUMENTS as u64);
                Error::new(Kind::Usage, format!("the arguments of all takes have more than {size}")).at(&*row.place)
            })?;
            takes.push(Take { number: takes.len() + 1, place: row.place.clone(), values });
        }
    }
    if takes.is_empty() {
        return Err(Error::new(Kind::Usage, "no takes").expected("a row for every take"));
    }
    Ok(takes)
}

/// The files that a pattern stands for, seen from `folder`, in the order of their names; what is no pattern stands for itself, there or not.
fn matching(pattern: &str, folder: &Path) -> Result<Vec<String>> {
    if !pattern.contains(['*', '?', '[']) {
        return Ok(vec![pattern.to_owned()]);
    }
    let whole = Path::new(&glob::Pattern::escape(&folder.to_string_lossy())).join(pattern);
    let options = glob::MatchOptions { require_literal_separator: true, require_literal_leading_dot: true, ..Default::default() };
    let paths = glob::glob_with(&whole.to_string_lossy(), options)
        .map_err(|e| Error::new(Kind::Usage, format!("'{pattern}' is no pattern: {}", e.msg)))?;
    let mut found: Vec<String> = paths
        .filter_map(|path| path.ok().filter(|path| path.is_file()))
        .map(|path| path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().into_owned())
        .collect();
    found.sort();
    if found.is_empty() {
        return Err(Error::new(Kind::Unreadable, format!("no file is called '{pattern}'"))
            .expected(format!("a pattern that matches files, seen from '{}'", folder.display())));
    }
    Ok(found)
}

/// The name of a file without folder, extension and `.gz`.
fn stem(path: &str) -> String {
    let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy().into_owned();
    let name = name.strip_suffix(".gz").or_else(|| name.strip_suffix(".GZ")).unwrap_or(&name);
    Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::fs;

    fn options() -> OptionTable {
        let of = |names: &[&str], takes| names.iter().map(|n| ((*n).to_owned(), takes)).collect::<Vec<_>>();
        [of(&["flip"], Takes::Nothing), of(&["frames", "quality"], Takes::Value), of(&["out", "rig", "report"], Takes::Path)]
            .concat()
            .into_iter()
            .collect()
    }

    /// A folder with files of these names, and a manifest.
    fn folder_with(files: &[&str], name: &str, text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "x").unwrap();
        }
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        (folder, path)
    }

    fn refused(name: &str, text: &str) -> String {
        let (folder, path) = folder_with(&[], name, text);
        let message = Manifest::read(&path, options()).unwrap_err().to_string();
        message.replace(&folder.path().display().to_string(), "")
    }

    #[test]
    fn a_table_lists_takes_with_options() {
        let text =
            "# the first day\nscan,capture,out,frames,flip\na.obj,w.c3d,a.glb|a.pc2,1..9,\nb.obj,\"w, 2.c3d\",b.glb,,yes\n";
        let (folder, path) = folder_with(&[], "list.csv", text);
        let manifest = Manifest::read(&path, options()).unwrap();
        assert_eq!(manifest.takes.len(), 2);
        let words = |n: usize| -> Vec<String> {
            let take = manifest.take(n).unwrap();
            manifest.arguments(take).into_iter().map(|a| a.into_string().unwrap()).collect()
        };
        let at = |name: &str| folder.path().join(name).display().to_string();
        assert_eq!(
            words(1),
            [
                "--frames=1..9".into(),
                format!("--out={}", at("a.glb")),
                format!("--out={}", at("a.pc2")),
                "--".into(),
                at("a.obj"),
                at("w.c3d")
            ]
        );
        assert_eq!(words(2), ["--flip".into(), format!("--out={}", at("b.glb")), "--".into(), at("b.obj"), at("w, 2.c3d")]);
        assert_eq!(manifest.takes[1].place, "line 4");
        assert_eq!(manifest.takes[1].name(), "b.obj \u{d7} w, 2.c3d");
        assert!(manifest.take(3).unwrap_err().to_string().contains("1 to 2"));
        assert!(manifest.take(0).is_err());
    }

    #[test]
    fn patterns_make_every_scan_with_every_capture() {
        let files = ["s/b.obj", "s/a.obj", "t/run.c3d.gz", "t/walk.c3d", "t/.hidden.c3d", "t/sub/deep.c3d"];
        let text = "[all]\nquality = 'draft'\n[[take]]\nscan = 's/*.obj'\ncapture = ['t/*.c3d', 't/run*']\nout = 'o/{scan}_{capture}.glb'\nrig = 'r/{scan}.toml'\n";
        let (_folder, path) = folder_with(&files, "list.toml", text);
        let manifest = Manifest::read(&path, options()).unwrap();
        let outs: Vec<_> = manifest.takes.iter().map(|t| t.values["out"][0].as_str()).collect();
        assert_eq!(outs, ["o/a_walk.glb", "o/a_run.glb", "o/b_walk.glb", "o/b_run.glb"]);
        assert_eq!(manifest.takes[3].values["rig"], ["r/b.toml"]);
        assert_eq!(manifest.takes[3].values["quality"], ["draft"]);
        assert_eq!(manifest.takes[3].number, 4);
    }

    #[test]
    fn what_a_spreadsheet_writes_is_a_table_too() {
        let (_folder, path) =
            folder_with(&[], "list.csv", "\u{feff}Scan;Capture;Out;Frames\r\na.obj;w.c3d;a.glb;\"1..9\"\r\n;;;\r\n");
        let manifest = Manifest::read(&path, options()).unwrap();
        assert_eq!(manifest.takes.len(), 1);
        assert_eq!(manifest.takes[0].values["frames"], ["1..9"]);
    }

    #[test]
    fn refusals_name_the_place_and_the_way_out() {
        let message = refused("a.csv", "scan,capture,out,frmaes\na,b,c.glb,1\n");
        assert!(message.contains("'frmaes'") && message.contains("line 2") && message.contains("try: frames"), "{message}");
        let message = refused("a.csv", "scan,capture\na,b\n");
        assert!(message.contains("no 'out'") && message.contains("line 2"), "{message}");
        let message = refused("a.csv", "scan,capture,out\na,b,c.glb\nd,e\n");
        assert!(message.contains("line 3") && message.contains("3 cells"), "{message}");
        let message = refused("a.csv", "scan,capture,out\na,b,c.glb\nd,e,c.glb\n");
        assert!(message.contains("line 2 and line 3") && message.contains("{capture}"), "{message}");
        let message = refused("a.csv", "scan,capture,out\na/*.obj,b,c.glb\n");
        assert!(message.contains("'a/*.obj'") && message.contains("line 2, scan"), "{message}");
        let message = refused("a.csv", "scan,capture,out,flip\na,b,c.glb,maybe\n");
        assert!(message.contains("yes or no"), "{message}");
        assert!(refused("a.csv", "scan,capture,out\n").contains("no takes"));
        assert!(refused("a.csv", "").contains("no takes"));
        let message = refused("a.toml", "[[take]]\nscan = 'a'\ncapture = 'b'\nout = 'c.glb'\n[[takes]]\n");
        assert!(message.contains("'takes'"), "{message}");
        let message = refused("a.toml", "[[take]]\nscan = 'a'\ncapture = 'b'\nout = { a = 1 }\n");
        assert!(message.contains("[[take]] 1") && message.contains("'out'"), "{message}");
        assert!(refused("a.toml", "[[take]\n").contains("line 1"));
    }
}
