//! Says in `RETARGET_VERSION` what `--version` prints: the version of the package and, built from a working copy, the commit.

use std::path::Path;
use std::process::Command;

/// What a binary is made of. A commit of anything else leaves it, and the commit that it names, as they are.
const MADE_OF: [&str; 4] = ["src", "build.rs", "Cargo.toml", "Cargo.lock"];

fn main() {
    for path in MADE_OF {
        println!("cargo:rerun-if-changed={path}");
    }
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let named = commit().map_or(version.clone(), |commit| format!("{version} ({commit})"));
    println!("cargo:rustc-env=RETARGET_VERSION={named}");
}

/// The first twelve digits of the commit that is checked out here, with a `+` where sources were changed since; none in a packaged crate, which may lie
/// in somebody else's working copy.
fn commit() -> Option<String> {
    let root = std::env::var("CARGO_MANIFEST_DIR").ok()?;
    if !Path::new(&root).join(".git").exists() {
        return None;
    }
    let git = |arguments: &[&str]| Command::new("git").current_dir(&root).args(arguments).output().ok();
    let head = git(&["rev-parse", "HEAD"]).filter(|output| output.status.success())?;
    let changed = !git(&[&["diff", "--quiet", "HEAD", "--"][..], &MADE_OF].concat())?.status.success();
    let head = String::from_utf8(head.stdout).ok()?;
    Some(format!("{}{}", head.get(..12)?, if changed { "+" } else { "" }))
}
