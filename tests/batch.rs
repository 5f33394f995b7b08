//! Many takes from a manifest: one bad one stops no other, what is done is not done again, an interrupted batch goes on.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, retarget, retarget_ok};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A folder with the fixtures `a.obj` and `b.obj` (the same scan under two names), `walk.c3d`, and a manifest.
fn folder_with(manifest: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.obj", "b.obj"] {
        fs::copy(fixture("scan.obj"), folder.path().join(name)).unwrap();
    }
    for name in ["scan.mtl", "scan_skin.png", "walk.c3d"] {
        fs::copy(fixture(name), folder.path().join(name)).unwrap();
    }
    fs::write(folder.path().join("list.toml"), manifest).unwrap();
    folder
}

const TWO: &str = "[all]\nframes = '1..6'\n[[take]]\nscan = '?.obj'\ncapture = 'walk.c3d'\nout = ['out/{scan}_{capture}.pc2', 'out/{scan}_####.ply']\n";

/// Runs the manifest; the exit code, what was said, and the table of results.
fn batch(folder: &Path, more: &[&str]) -> (Option<i32>, String, Value) {
    let arguments = ["batch", "list.toml", "--json"].iter().chain(more);
    let output = retarget(folder, arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), said, serde_json::from_slice(&output.stdout).unwrap_or_default())
}

fn states(table: &Value) -> Vec<&str> {
    table.as_array().unwrap().iter().map(|row| row["state"].as_str().unwrap()).collect()
}

#[test]
fn takes_are_done_once_and_give_the_bytes_of_the_main_job() {
    let folder = folder_with(TWO);
    let (exit, said, table) = batch(folder.path(), &[]);
    assert_eq!(exit, Some(0), "{said}");
    assert_eq!(states(&table), ["done", "done"]);
    assert_eq!(table[1]["summary"]["frames"], 6);
    let takes = said.lines().filter(|line| line.starts_with("take ")).count();
    assert_eq!(takes, 2, "one line for each take\n{said}");
    retarget_ok(folder.path(), ["a.obj", "walk.c3d", "--frames", "1..6", "-o", "alone.pc2"]);
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("out/a_walk.pc2"), read("alone.pc2"));
    assert_eq!(read("out/b_walk.pc2"), read("alone.pc2"));

    let (exit, said, table) = batch(folder.path(), &[]);
    assert_eq!((exit, states(&table)), (Some(0), vec!["done_before"; 2]), "{said}");
    // A texture that the materials name is an input as well as what was named on the line.
    let record: Value = serde_json::from_slice(&read("out/a_walk.pc2.take.json")).unwrap();
    for input in ["a.obj", "scan.mtl", "walk.c3d"] {
        assert_eq!(record["inputs"][input].as_str().map(str::len), Some(64), "{input}: {record}");
    }
    fs::write(folder.path().join("scan.mtl"), "newmtl other\n").unwrap();
    fs::remove_file(folder.path().join("out/b_0003.ply")).unwrap();
    let (exit, said, table) = batch(folder.path(), &[]);
    assert_eq!((exit, states(&table)), (Some(0), vec!["done"; 2]), "{said}");
    assert!(folder.path().join("out/b_0003.ply").is_file());
}

#[test]
fn one_bad_take_does_not_stop_the_others() {
    let bad = "[[take]]\nscan = 'none.obj'\ncapture = 'walk.c3d'\nout = 'none.pc2'\n";
    let folder = folder_with(&TWO.replace("[[take]]", &format!("{bad}[[take]]")));
    let (exit, said, table) = batch(folder.path(), &["--workers", "1"]);
    assert_eq!((exit, states(&table)), (Some(1), vec!["failed", "done", "done"]), "{said}");
    assert!(table[0]["error"].as_str().unwrap().contains("none.obj"), "{table}");
    assert!(said.contains("1 of 3 takes failed"), "{said}");
    assert_eq!(states(&batch(folder.path(), &[]).2), ["failed", "done_before", "done_before"]);
}

#[test]
fn a_queue_calls_takes_by_their_number() {
    let folder = folder_with(TWO);
    let said = retarget_ok(folder.path(), ["batch", "list.toml", "--index", "2"]);
    assert!(said.contains("b.obj") && said.lines().any(|line| line.starts_with("done")), "{said}");
    assert!(!folder.path().join("out/a_walk.pc2").exists());
    let said = retarget_ok(folder.path(), ["batch", "list.toml", "--index", "2"]);
    assert!(said.contains("is done already"), "{said}");
    let output = retarget(folder.path(), ["batch", "list.toml", "--index", "3"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("1 to 2"));
}

#[test]
fn the_quality_gate_is_remembered() {
    let folder = folder_with(&TWO.replace("[all]", "[all]\nfail-above = 0.001"));
    assert_eq!(batch(folder.path(), &[]).0, Some(4));
    let (exit, said, table) = batch(folder.path(), &[]);
    assert_eq!((exit, states(&table)), (Some(4), vec!["done_before"; 2]), "{said}");
    assert_eq!(retarget(folder.path(), ["batch", "list.toml", "--index", "1"]).status.code(), Some(4));
}

#[test]
fn what_is_not_its_own_is_not_replaced() {
    let folder = folder_with(TWO);
    fs::create_dir(folder.path().join("out")).unwrap();
    fs::write(folder.path().join("out/a_walk.pc2"), "mine").unwrap();
    for _ in 0..2 {
        let (exit, said, table) = batch(folder.path(), &[]);
        assert_eq!(exit, Some(1), "{said}");
        assert!(table[0]["error"].as_str().unwrap().contains("--force replaces it"), "{table}");
    }
    // Nor when a take that was done is to write one more file.
    let more = TWO.replace("'out/{scan}_####.ply'", "'out/{scan}_####.ply', '{scan}.more.pc2'");
    fs::write(folder.path().join("list.toml"), more).unwrap();
    fs::write(folder.path().join("b.more.pc2"), "mine").unwrap();
    assert_eq!(batch(folder.path(), &[]).0, Some(1));
    assert_eq!(fs::read(folder.path().join("b.more.pc2")).unwrap(), b"mine");
    fs::write(folder.path().join("list.toml"), TWO).unwrap();
    assert_eq!(fs::read(folder.path().join("out/a_walk.pc2")).unwrap(), b"mine");
    let (exit, said, _) = batch(folder.path(), &["--force"]);
    assert_eq!(exit, Some(0), "{said}");
}

#[test]
fn wrong_arguments_are_told_before_the_first_take() {
    let folder = folder_with(&format!("{TWO}[[take]]\nscan = 'a.obj'\ncapture = 'walk.c3d'\nout = 'c.pc2'\nframes = '6..1'\n"));
    let (exit, said, _) = batch(folder.path(), &[]);
    assert_eq!(exit, Some(2), "{said}");
    assert!(said.contains("[[take]] 2") && said.contains("list.toml"), "{said}");
    assert!(!folder.path().join("out").exists());
}

#[test]
fn estimates_are_made_without_doing_anything() {
    let folder = folder_with(TWO);
    let (exit, said, table) = batch(folder.path(), &["--estimate"]);
    assert_eq!(exit, Some(0), "{said}");
    assert!(said.contains("--array=1-2 --mem="), "{said}");
    assert_eq!(table["takes"].as_array().unwrap().len(), 2);
    assert!(table["ask"]["megabytes"].as_f64().unwrap() >= 64.0);
    assert!(!folder.path().join("out").exists());
}

#[test]
fn a_killed_batch_leaves_no_orphan_and_goes_on() {
    let folder = folder_with(&TWO.replace("frames = '1..6'\n", ""));
    let mut running = Command::new(env!("CARGO_BIN_EXE_retarget"))
        .current_dir(folder.path())
        .args(["batch", "list.toml", "--workers", "1"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // Until the first take has begun.
    let record = folder.path().join("out/a_walk.pc2.take.json");
    let patience = Instant::now();
    let temporary =
        || fs::read_dir(folder.path().join("out")).unwrap().any(|e| e.unwrap().file_name().to_string_lossy().starts_with('.'));
    while !record.exists() || !temporary() {
        assert!(patience.elapsed() < Duration::from_secs(120), "no take was begun");
        std::thread::sleep(Duration::from_millis(20));
    }
    running.kill().unwrap();
    running.wait().unwrap();
    // The process of the take stops by itself and takes its temporary files along.
    while temporary() {
        assert!(patience.elapsed() < Duration::from_secs(120), "a take goes on without the batch");
        std::thread::sleep(Duration::from_millis(20));
    }
    let (exit, said, table) = batch(folder.path(), &[]);
    assert_eq!((exit, states(&table)), (Some(0), vec!["done"; 2]), "{said}");
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("out/a_walk.pc2"), read("out/b_walk.pc2"));
}

#[test]
fn the_cache_changes_no_byte_and_serves_every_take_of_a_scan() {
    let folder = folder_with(TWO);
    let run = |out: &str, more: &[&str]| {
        retarget_ok(folder.path(), [&["a.obj", "walk.c3d", "--frames", "1..6", "-o", out], more].concat())
    };
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    let entries = || fs::read_dir(folder.path().join("kept")).unwrap().count();
    run("without.glb", &[]);
    run("first.glb", &["--cache", "kept"]);
    assert_eq!(entries(), 2, "proxy and map");
    // A hit leaves the entry as it is but for its time; making it anew would replace the file.
    let age = |seconds: u64| {
        for entry in fs::read_dir(folder.path().join("kept")).unwrap() {
            let file = fs::File::options().append(true).open(entry.unwrap().path()).unwrap();
            file.set_modified(std::time::SystemTime::now() - Duration::from_secs(seconds)).unwrap();
        }
    };
    let identities = || {
        use std::os::unix::fs::MetadataExt;
        let mut all: Vec<u64> =
            fs::read_dir(folder.path().join("kept")).unwrap().map(|e| e.unwrap().metadata().unwrap().ino()).collect();
        all.sort_unstable();
        all
    };
    age(1000);
    let before = identities();
    run("again.glb", &["--cache", "kept"]);
    assert_eq!(identities(), before, "found, not made anew");
    let used = |entry: fs::DirEntry| entry.metadata().unwrap().modified().unwrap().elapsed().unwrap() < Duration::from_secs(500);
    assert!(fs::read_dir(folder.path().join("kept")).unwrap().all(|e| used(e.unwrap())), "found");
    assert_eq!(read("without.glb"), read("first.glb"));
    assert_eq!(read("without.glb"), read("again.glb"));
    // Another proxy of the same scan, another map of the same proxy.
    run("coarse.glb", &["--cache", "kept", "--proxy-vertices", "1000"]);
    assert_eq!(entries(), 4);
    run("paper.glb", &["--cache", "kept", "--map", "paper"]);
    assert_eq!(entries(), 5);
    // An entry that was damaged is made anew.
    for entry in fs::read_dir(folder.path().join("kept")).unwrap() {
        fs::write(entry.unwrap().path(), "damaged").unwrap();
    }
    run("mended.glb", &["--cache", "kept"]);
    assert_eq!(read("without.glb"), read("mended.glb"));
    fs::remove_dir_all(folder.path().join("kept")).unwrap();
    let (exit, said, _) = batch(folder.path(), &["--cache", "kept"]);
    assert_eq!(exit, Some(0), "{said}");
    assert_eq!(entries(), 2, "one scan under two names");
}
