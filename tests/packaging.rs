//! What a package ships beside the program: version, completions, manual pages.

#![allow(clippy::unwrap_used)]

mod common;

use common::retarget;
use std::path::Path;
use std::process::{Command, Stdio};

fn printed(arguments: &[&str]) -> String {
    let output = retarget(Path::new(env!("CARGO_MANIFEST_DIR")), arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

const SUBCOMMANDS: [&str; 6] = ["inspect", "blend", "joints", "batch", "completions", "man"];

#[test]
fn the_version_names_the_commit_in_a_working_copy_and_nothing_else_in_a_package() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let git = |arguments: &[&str]| {
        let output = Command::new("git").current_dir(root).args(arguments).output().ok().filter(|o| o.status.success())?;
        Some(String::from_utf8(output.stdout).unwrap().trim().to_owned())
    };
    let version = format!("retarget {}", env!("CARGO_PKG_VERSION"));
    let printed = printed(&["--version"]);
    let Some(sources) = git(&["rev-parse", "HEAD:src"]).filter(|_| root.join(".git").exists()) else {
        assert_eq!(printed, format!("{version}\n"));
        return;
    };
    let named = printed
        .strip_prefix(&format!("{version} ("))
        .and_then(|rest| rest.strip_suffix(")\n"))
        .unwrap_or_else(|| panic!("{printed}"));
    let commit = named.trim_end_matches('+');
    assert_eq!(commit.len(), 12, "{printed}");
    let there = git(&["rev-parse", &format!("{commit}:src")]).unwrap_or_else(|| panic!("no commit {commit}"));
    // With changes the sources are neither those of the commit that is named nor those of the next one.
    assert!(named.ends_with('+') || there == sources, "{printed}");
}

#[test]
fn every_shell_completes_subcommands_and_options() {
    for shell in ["bash", "zsh", "fish"] {
        let script = printed(&["completions", shell]);
        for word in SUBCOMMANDS.iter().chain(&["source-index", "quality", "workers", "weight-range"]) {
            assert!(script.contains(word), "{shell}: {word}");
        }
        // Where the shell is here, it understands the script.
        if let Ok(mut child) = Command::new(shell).arg("-n").stdin(Stdio::piped()).stderr(Stdio::piped()).spawn() {
            std::io::Write::write_all(&mut child.stdin.take().unwrap(), script.as_bytes()).unwrap();
            let output = child.wait_with_output().unwrap();
            assert!(output.status.success(), "{shell}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
    assert_eq!(retarget(Path::new("."), ["completions", "tcsh"]).status.code(), Some(2));
}

#[test]
fn there_is_a_manual_page_of_the_program_and_of_every_subcommand() {
    let page = printed(&["man"]);
    assert!(page.contains(".TH retarget 1"), "{}", &page[..300]);
    for word in
        ["SCAN", "CAPTURE", "\\-\\-tolerance", "worst vertex of the worst frame", "\\-\\-weight\\-range", "retarget\\-inspect(1)"]
    {
        assert!(page.contains(word), "{word}");
    }
    for name in SUBCOMMANDS {
        let page = printed(&["man", name]);
        assert!(page.contains(&format!(".TH retarget-{name} 1")), "{name}: {}", &page[..300]);
        assert!(page.contains(".SH SYNOPSIS") && page.contains(&format!("retarget {name}")), "{name}: {page}");
    }
    let output = retarget(Path::new("."), ["man", "walk"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("there is no subcommand 'walk'"));
}

#[test]
fn a_reader_that_stops_reading_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_retarget"))
        .args(["completions", "bash"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}
