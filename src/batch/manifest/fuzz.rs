//! Bodies that a fuzzer runs, and that the tests run over samples and their mutants: whatever a manifest says, it becomes takes or an error
//! that says something. Patterns are not looked for.

use super::{OptionTable, Takes, expand, is_positional, rows};
use std::path::Path;

/// Reads the bytes as a table; tells whether they were read.
pub fn table(bytes: &[u8]) -> bool {
    body(bytes, false)
}

/// Reads the bytes as TOML.
pub fn toml(bytes: &[u8]) -> bool {
    body(bytes, true)
}

fn body(bytes: &[u8], toml: bool) -> bool {
    let kinds = [("out", Takes::Path), ("rig", Takes::Path), ("frames", Takes::Value), ("flip", Takes::Nothing)];
    let options: OptionTable = kinds.iter().map(|(name, takes)| ((*name).to_owned(), *takes)).collect();
    let takes = rows(bytes, toml, &options).and_then(|mut rows| {
        for value in rows.iter_mut().flat_map(|row| &mut row.values).filter(|(key, _)| is_positional(key)).flat_map(|(_, v)| v) {
            value.retain(|c| !"*?[".contains(c));
        }
        expand(&rows, Path::new(""))
    });
    match takes {
        Ok(takes) => {
            assert!(!takes.is_empty());
            for (n, take) in takes.iter().enumerate() {
                assert_eq!(take.number, n + 1);
                assert!(!take.place.is_empty());
                assert!(
                    take.values
                        .iter()
                        .all(|(key, values)| !values.is_empty() && (is_positional(key) || options.contains_key(key)))
                );
                assert!(["scan", "capture"].iter().all(|key| take.values[*key].len() == 1));
            }
            true
        }
        Err(error) => {
            assert!(!error.found.is_empty());
            false
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::fuzz::mutants::run;

    const TABLE: &str =
        "# a day\nscan,capture,out,frames,flip\na.obj|b.obj,w.c3d,{scan}.glb,1..9,\nc.obj,\"w, 2.c3d\",c.glb|c.pc2,,yes\n";
    const TOML: &str = "[all]\nrig = 'r.toml' # of all\n[[take]]\nscan = ['a.obj', 'b.obj']\ncapture = 'w.c3d'\nout = \"o/{scan}.glb\"\nflip = true\n[[take]]\nscan = 'c'\ncapture = 'd'\nout = ['e.glb', 'e.pc2']\nframes = 12\nrig = false\n";

    #[test]
    fn damaged_manifests_do_no_harm() {
        run(17, "table", table, &[TABLE.into(), TABLE.replace(',', ";").into()]);
        run(18, "toml", toml, &[TOML.into()]);
    }

    /// Puts the samples where the fuzzer looks for them; see `scripts/fuzz.sh`.
    #[test]
    fn seeds_of_the_fuzzer_of_manifests() {
        let Some(folder) = std::env::var_os("RETARGET_FUZZ_SEEDS") else { return };
        for (name, sample) in [("batch_table", TABLE), ("batch_toml", TOML)] {
            let folder = Path::new(&folder).join(name);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("0"), sample).unwrap();
        }
    }
}
