//! What the pages name is there, and what is there is named.

use crate::pages::{blocks, name, pages, root};
use retarget::binding::rig::RigFile;
use std::collections::{BTreeMap, BTreeSet};

/// Options of other programs that the pages name.
const OF_OTHERS: &[&str] = &[
    "all",
    "all-targets",
    "array",
    "bench",
    "check",
    "document-private-items",
    "example",
    "file",
    "git",
    "ignored",
    "include-ignored",
    "lib",
    "list",
    "locked",
    "mem",
    "no-default-features",
    "no-deps",
    "no-run",
    "nocapture",
    "open",
    "path",
    "release",
    "root",
    // Hidden.
    "solve-tolerance",
    "test",
    "test-threads",
    "time",
    // Misspelt on purpose.
    "qualty",
    "tests",
];

/// A heading as GitHub makes an anchor of it.
fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
    kept.trim().replace(' ', "-")
}

fn anchors(text: &str) -> BTreeSet<String> {
    text.lines().filter(|line| line.starts_with('#')).map(|line| anchor(line.trim_start_matches('#'))).collect()
}

#[test]
fn links_lead_somewhere() {
    let mut wrong = Vec::new();
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if link.contains("://") {
                continue;
            }
            let (path, place) = link.split_once('#').map_or((link, None), |(path, place)| (path, Some(place)));
            let target = if path.is_empty() { page.clone() } else { page.parent().unwrap().join(path) };
            let heading = |place| anchors(&std::fs::read_to_string(&target).unwrap_or_default()).contains(place);
            if !target.exists() || !place.is_none_or(heading) {
                wrong.push(format!("{}: {link}", name(&page)));
            }
        }
    }
    assert!(wrong.is_empty(), "links to nowhere:\n{}", wrong.join("\n"));
}

/// What the program prints to standard output.
fn printed(arguments: &[&str]) -> String {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_retarget")).current_dir(root()).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Long options of the program and its subcommands, but for hidden ones.
fn options() -> BTreeSet<String> {
    let long = |line: &str| {
        let line = line.trim_start();
        let rest = line.strip_prefix("--").or_else(|| line.strip_prefix('-')?.split_once(", --").map(|(_, rest)| rest))?;
        Some(rest.chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect::<String>())
    };
    let help = [&["--help"][..], &["inspect", "--help"], &["joints", "--help"], &["blend", "--help"], &["batch", "--help"]];
    let options: BTreeSet<String> =
        help.iter().flat_map(|arguments| printed(arguments).lines().filter_map(long).collect::<Vec<_>>()).collect();
    assert!(options.contains("quality") && options.contains("estimate") && options.contains("quiet"), "{options:?}");
    options
}

#[test]
fn options_that_the_pages_name_exist_and_all_are_named() {
    let known = options();
    let (mut wrong, mut named) = (Vec::new(), BTreeSet::new());
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for rest in text.split("--").skip(1) {
            let option: String = rest.chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect();
            let option = option.trim_end_matches('-');
            if option.is_empty() {
                continue;
            }
            if !known.contains(option) && !OF_OTHERS.contains(&option) {
                wrong.push(format!("{}: --{option}", name(&page)));
            }
            named.insert(option.to_owned());
        }
    }
    assert!(wrong.is_empty(), "no such options:\n{}", wrong.join("\n"));
    let missing: Vec<String> = known.difference(&named).cloned().collect();
    assert!(missing.is_empty(), "options that no page names: {}", missing.join(", "));
}

/// Keys of a TOML value, at any depth outside of `[frozen]`; those of tables that the user names, such as `[markers]`, are the user's.
fn keys(value: &toml::Value, into: &mut BTreeSet<String>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                into.insert(key.clone());
                if !["frozen", "markers", "landmarks", "skeleton"].contains(&key.as_str()) {
                    keys(value, into);
                }
            }
        }
        toml::Value::Array(values) => values.iter().for_each(|value| keys(value, into)),
        _ => {}
    }
}

#[test]
fn rig_files_of_the_pages_are_rig_files_and_every_key_is_on_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let page = root().join("docs/rig-file.md");
    let text = std::fs::read_to_string(page).unwrap();
    let examples = blocks(&text, "toml");
    assert!(!examples.is_empty());
    for (line, example) in examples {
        std::fs::write(&path, example.join("\n")).unwrap();
        RigFile::read(&path).unwrap_or_else(|e| panic!("docs/rig-file.md:{line}: {e}"));
    }
    // The keys of a section, from what the reader expects there instead of one that it does not know.
    let expected = |text: &str| -> Vec<String> {
        std::fs::write(&path, text).unwrap();
        let error = RigFile::read(&path).expect_err("an unknown key is an error");
        let known = error.expected.unwrap_or_else(|| panic!("{text}: {}", error.found));
        known.split(", ").map(str::to_owned).collect()
    };
    let sections = expected("no_such_key = 1");
    assert!(sections.iter().any(|s| s == "space") && sections.len() > 8, "{sections:?}");
    let mut known: BTreeSet<String> = sections.iter().cloned().collect();
    for section in ["space", "reference", "mesh", "solver", "solver.shell"] {
        known.extend(expected(&format!("[{section}]\nno_such_key = 1")));
    }
    for (section, first) in [("group", "what = \"head\""), ("component", "name = \"a\""), ("joint", "name = \"a\"")] {
        known.extend(expected(&format!("[[{section}]]\n{first}\nno_such_key = 1")));
    }
    assert_eq!(unnamed(&known, &text), Vec::<&String>::new(), "keys that docs/rig-file.md does not name");
    // And what the program writes is on it.
    let mut written = BTreeSet::new();
    for arguments in [
        vec!["fixtures/scan.obj", "fixtures/walk.c3d", "--frames", "1..1", "--save-rig", "RIG", "-o", "OUT"],
        vec!["joints", "fixtures/lamp.obj", "-o", "RIG", "--force"],
    ] {
        let (rig, out) = (folder.path().join("out.toml"), folder.path().join("out.pc2"));
        let arguments = arguments.iter().map(|word| match *word {
            "RIG" => rig.clone().into_os_string(),
            "OUT" => out.clone().into_os_string(),
            word => word.into(),
        });
        let output =
            std::process::Command::new(env!("CARGO_BIN_EXE_retarget")).current_dir(root()).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        keys(&toml::from_str(&std::fs::read_to_string(&rig).unwrap()).unwrap(), &mut written);
    }
    assert_eq!(unnamed(&written, &text), Vec::<&String>::new(), "written keys that docs/rig-file.md does not name");
}

/// Keys that a page names neither as they are nor as a section.
fn unnamed<'a>(keys: &'a BTreeSet<String>, page: &str) -> Vec<&'a String> {
    let is_named =
        |key: &str| [format!("`{key}`"), format!("`[{key}]`"), format!("`[[{key}]]`")].iter().any(|name| page.contains(name));
    keys.iter().filter(|key| !is_named(key)).collect()
}

/// Names of the fields of an object, at any depth, with whether the values below are named by the user.
fn fields(value: &serde_json::Value, at: &str, into: &mut BTreeMap<String, ()>) {
    match value {
        serde_json::Value::Object(object) => {
            for (key, value) in object {
                into.insert(format!("{at}{key}"), ());
                // Their keys are stations and segments.
                if !["setup_ms", "proportions"].contains(&key.as_str()) {
                    fields(value, &format!("{at}{key}."), into);
                }
            }
        }
        serde_json::Value::Array(values) => values.iter().for_each(|value| fields(value, at, into)),
        _ => {}
    }
}

/// The same of a schema.
fn of_schema(schema: &serde_json::Value, at: &str, into: &mut BTreeMap<String, ()>) {
    if let Some(properties) = schema["properties"].as_object() {
        for (key, value) in properties {
            into.insert(format!("{at}{key}"), ());
            of_schema(value, &format!("{at}{key}."), into);
        }
    }
    if schema["items"].is_object() {
        of_schema(&schema["items"], at, into);
    }
}

#[test]
fn every_field_of_a_report_is_in_the_schema_and_every_field_of_the_schema_is_on_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let schema: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(root().join("docs/report.schema.json")).unwrap()).unwrap();
    let mut known = BTreeMap::new();
    of_schema(&schema, "", &mut known);
    let rig = folder.path().join("lamp.toml");
    let rig = rig.to_str().unwrap();
    printed(&["joints", "fixtures/lamp.obj", "-o", rig]);
    for (scan, capture, more) in [
        ("fixtures/lamp.obj", "fixtures/lamp.csv", vec!["--frames", "0..3", "--rig", rig]),
        ("fixtures/scan.obj", "fixtures/walk.c3d", vec!["--frames", "1..3"]),
        ("fixtures/scan.obj", "fixtures/tall.c3d", vec!["--frames", "1..3"]),
        ("fixtures/scan.obj", "fixtures/steps.bvh", vec!["--frames", "1..3"]),
        ("fixtures/scan.obj", "fixtures/reach.csv", vec!["--frames", "1..3", "--hold", "head=head"]),
        ("fixtures/trunk.obj", "fixtures/trunk.csv", vec!["--frames", "0..3", "--examples", "fixtures/trunk_bent.obj"]),
    ] {
        let report = folder.path().join("report.json");
        let out = folder.path().join("out.pc2");
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_retarget"))
            .current_dir(root())
            .args([scan, capture, "--force", "--report"])
            .arg(&report)
            .arg("-o")
            .arg(out)
            .args(more)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let mut found = BTreeMap::new();
        fields(&serde_json::from_str(&std::fs::read_to_string(&report).unwrap()).unwrap(), "", &mut found);
        let unknown: Vec<&String> = found.keys().filter(|field| !known.contains_key(*field)).collect();
        assert!(unknown.is_empty(), "{capture}: fields that the schema does not know: {unknown:?}");
    }
    let page = std::fs::read_to_string(root().join("docs/report.md")).unwrap();
    let missing: Vec<&String> =
        known.keys().filter(|field| !page.contains(&format!("`{}`", field.rsplit('.').next().unwrap()))).collect();
    assert!(missing.is_empty(), "fields that docs/report.md does not name: {missing:?}");
}
