//! The pages, and the blocks of code in them.

use std::path::{Path, PathBuf};

/// The folder of the package.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every page: `README.md`, `CONTRIBUTING.md`, and what is under `docs/`.
pub fn pages() -> Vec<PathBuf> {
    let mut pages = vec![root().join("README.md"), root().join("CONTRIBUTING.md")];
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                pages.push(path);
            }
        }
    }
    pages
}

/// A path as it is seen from the folder of the package.
pub fn name(page: &Path) -> String {
    page.strip_prefix(root()).unwrap_or(page).display().to_string()
}

/// Lines of the fenced blocks of a kind, with the number of the first line of each, counted from 0.
pub fn blocks<'a>(text: &'a str, kind: &str) -> Vec<(usize, Vec<&'a str>)> {
    let mut blocks: Vec<(usize, Vec<&str>)> = Vec::new();
    let mut fence: Option<bool> = None;
    for (number, line) in text.lines().enumerate() {
        match (line.strip_prefix("```"), fence) {
            (Some(word), None) => {
                fence = Some(word.trim() == kind);
                if word.trim() == kind {
                    blocks.push((number + 1, Vec::new()));
                }
            }
            (Some(_), Some(_)) => fence = None,
            (None, Some(true)) => blocks.last_mut().unwrap().1.push(line),
            _ => {}
        }
    }
    blocks
}
