//! Every real file through `inspect`, and every body with representative takes through the main job, compared with committed tables.
//!
//! `scripts/corpus.sh` runs both and prints what was read, refused and wrong. The tables, with `;` between columns and `#` before a remark:
//!
//! - `files.csv`: path; `read` or `refused`; for a file that is read facts such as `vertices=6890` (a place in the JSON of `inspect`, dots
//!   between its steps, `.n` for the length of a list), for one that is refused words of the message.
//! - `values.csv`: path; point; frame in the file's own numbering; x, y, z in the file's unit, or `missing`, or `dropped`.
//! - `jobs.csv`: scan; capture; options; `done` or `refused`; facts of the report, or words of the message.

#![allow(clippy::unwrap_used, clippy::print_stderr, clippy::print_stdout)]

#[path = "../common/mod.rs"]
mod common;
mod limbs;
mod pairs;
mod variations;
mod verdict;

use rayon::prelude::*;
use retarget::capture::{self, ReadOptions};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

/// Rows of a table without remarks and empty lines, in columns.
fn rows(text: &'static str, columns: usize) -> Vec<Vec<&'static str>> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or("").trim()).filter(|line| !line.is_empty());
    let rows = lines.map(|line| line.split(';').map(str::trim).collect::<Vec<_>>());
    rows.inspect(|row| assert_eq!(row.len(), columns, "{row:?}")).collect()
}

/// What became of a row.
struct Verdict {
    name: String,
    read: bool,
    wrong: Vec<String>,
}

/// Prints the sums, and what is wrong; demands that nothing is.
fn close(what: &str, verdicts: &[Verdict]) {
    let read = verdicts.iter().filter(|v| v.read).count();
    let wrong: Vec<&Verdict> = verdicts.iter().filter(|v| !v.wrong.is_empty()).collect();
    for verdict in &wrong {
        println!("wrong  {}: {}", verdict.name, verdict.wrong.join("; "));
    }
    println!("{what}: {read} read, {} refused, {} wrong", verdicts.len() - read, wrong.len());
    assert!(wrong.is_empty(), "{} wrong", wrong.len());
}

/// The value at a place such as `faces.quads`; `.n` is the length of a list.
fn at(value: &Value, place: &str) -> Value {
    place.split('.').fold(value.clone(), |value, step| match (&value, step) {
        (Value::Array(list), "n") => list.len().into(),
        (Value::Array(list), step) => step.parse().ok().and_then(|k: usize| list.get(k)).cloned().unwrap_or_default(),
        (value, step) => value[step].clone(),
    })
}

/// Whether a value is as the table says: numbers to its last digit, a list of numbers after commas, `null`, `~` for words in it, `>` for
/// at least.
fn is(value: &Value, expected: &str) -> bool {
    let near = |value: &Value, expected: &str| {
        let decimals = expected.split('.').nth(1).map_or(0, str::len) as i32;
        let target: Option<f64> = expected.parse().ok();
        value.as_f64().zip(target).is_some_and(|(a, b)| (a - b).abs() <= 0.6 * 10f64.powi(-decimals) + 1e-6 * b.abs())
    };
    if let Some(words) = expected.strip_prefix('~') {
        return value.to_string().to_lowercase().contains(&words.replace('_', " ").to_lowercase());
    }
    if let Some(least) = expected.strip_prefix('>') {
        return value.as_f64().zip(least.parse().ok()).is_some_and(|(a, b): (f64, f64)| a >= b);
    }
    match value {
        Value::Null => expected == "null",
        Value::String(text) => text.replace(' ', "_") == expected,
        Value::Number(_) => near(value, expected),
        Value::Bool(b) => expected == b.to_string(),
        Value::Array(_) => {
            let mut flat = Vec::new();
            flatten(value, &mut flat);
            let expected: Vec<&str> = expected.split(',').collect();
            flat.len() == expected.len() && flat.iter().zip(&expected).all(|(a, b)| near(a, b))
        }
        Value::Object(_) => expected == "there",
    }
}

fn flatten<'a>(value: &'a Value, into: &mut Vec<&'a Value>) {
    match value {
        Value::Array(list) => list.iter().for_each(|v| flatten(v, into)),
        other => into.push(other),
    }
}

/// Facts that do not hold, with what is there instead.
fn contradictions(value: &Value, facts: &str) -> Vec<String> {
    let facts = facts.split_whitespace().map(|fact| fact.split_once('=').unwrap_or_else(|| panic!("{fact}")));
    facts
        .filter_map(|(place, expected)| {
            let found = at(value, place);
            (!is(&found, expected)).then(|| format!("{place} is {found}, not {expected}"))
        })
        .collect()
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_retarget")).args(arguments).output().unwrap()
}

/// What a refusal must say: the words of the table, and never a panic.
fn refusal(output: &Output, words: &str) -> Vec<String> {
    let said = String::from_utf8_lossy(&output.stderr);
    let mut wrong = Vec::new();
    if !matches!(output.status.code(), Some(1 | 3)) || said.contains("panicked") {
        wrong.push(format!("exit {:?}: {said}", output.status.code()));
    }
    let missing = words.split('|').map(str::trim).filter(|word| !said.contains(word));
    wrong.extend(missing.map(|word| format!("no '{word}' in: {}", said.trim())));
    wrong
}

#[test]
#[ignore = "reads hundreds of real files: scripts/corpus.sh"]
fn every_file_is_read_as_its_description_says_or_refused_with_the_reason() {
    let Some(data) = common::shared() else { return };
    let table = rows(include_str!("files.csv"), 3);
    let listed: BTreeSet<&str> = table.iter().map(|row| row[0]).collect();
    let unlisted: Vec<String> = files(&data).into_iter().filter(|f| !listed.contains(f.as_str())).collect();
    assert!(unlisted.is_empty(), "not in files.csv: {unlisted:?}");
    let verdicts: Vec<Verdict> = table
        .par_iter()
        .map(|row| {
            let output = run(&["inspect", "--json", &data.join(row[0]).to_string_lossy()]);
            let read = output.status.success();
            let wrong = match (read, row[1]) {
                (true, "read") => contradictions(&serde_json::from_slice(&output.stdout).unwrap(), row[2]),
                (false, "refused") => refusal(&output, row[2]),
                _ => vec![format!("not {}: {}", row[1], String::from_utf8_lossy(&output.stderr).trim())],
            };
            Verdict { name: row[0].to_owned(), read, wrong }
        })
        .collect();
    close("files", &verdicts);
}

/// All files below a folder, as relative paths.
fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(next).unwrap().map(|e| e.unwrap().path()) {
            if entry.is_dir() {
                open.push(entry);
            } else {
                found.push(entry.strip_prefix(folder).unwrap().to_string_lossy().into_owned());
            }
        }
    }
    found.sort();
    found
}

#[test]
#[ignore = "reads real files: scripts/corpus.sh"]
fn positions_are_those_that_other_readers_found() {
    let Some(data) = common::shared() else { return };
    let verdicts: Vec<Verdict> = rows(include_str!("values.csv"), 4)
        .par_iter()
        .map(|row| {
            let name = row[..3].join(" ");
            let capture = match capture::read(&data.join(row[0]), &ReadOptions::default()) {
                Ok(capture) => capture,
                Err(error) => return Verdict { name, read: false, wrong: vec![format!("{error:?}")] },
            };
            let take = capture.motion.points();
            let frame = row[2].parse::<i64>().unwrap() - capture.first_frame;
            let point = take.labels.iter().position(|label| label == row[1]);
            let inside = usize::try_from(frame).ok().filter(|&f| f < take.frames());
            let found = match (point, inside) {
                (None, _) => "dropped".to_owned(),
                (Some(_), None) => "missing".to_owned(),
                (Some(point), Some(frame)) => match take.point(frame, point) {
                    None => "missing".to_owned(),
                    Some(p) => format!("{},{},{}", p.x, p.y, p.z),
                },
            };
            let numbers = |text: &str| text.split(',').map(|n| n.trim().parse::<f64>()).collect::<Result<Vec<_>, _>>();
            let same = match (numbers(&found), numbers(row[3])) {
                (Ok(a), Ok(b)) => a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 2e-4 + 2e-6 * b.abs()),
                _ => found == row[3],
            };
            let wrong = if same { Vec::new() } else { vec![format!("{found}, not {}", row[3])] };
            Verdict { name, read: true, wrong }
        })
        .collect();
    close("values", &verdicts);
}

#[test]
#[ignore = "animates every real body: scripts/corpus.sh"]
fn every_body_is_animated_or_refused_with_the_reason() {
    let Some(data) = common::shared() else { return };
    let folder = tempfile::tempdir().unwrap();
    let table = rows(include_str!("jobs.csv"), 5);
    let verdicts: Vec<Verdict> = table
        .par_iter()
        .enumerate()
        .map(|(k, row)| {
            let path = |name: &str| data.join(name).to_string_lossy().into_owned();
            let output = |ending: &str| folder.path().join(format!("{k}.{ending}")).to_string_lossy().into_owned();
            let (scan, capture, report, cache) = (path(row[0]), path(row[1]), output("json"), output("pc2"));
            let mut arguments = vec![scan.as_str(), &capture, "-o", &cache, "--report", &report, "--threads", "1"];
            let options: Vec<String> =
                row[2].split_whitespace().map(|o| if o.contains('/') { path(o) } else { o.to_owned() }).collect();
            arguments.extend(options.iter().map(String::as_str));
            let output = run(&arguments);
            let done = output.status.success();
            let wrong = match (done, row[3]) {
                (true, "done") => contradictions(&serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap(), row[4]),
                (false, "refused") => refusal(&output, row[4]),
                _ => vec![format!("not {}: {}", row[3], String::from_utf8_lossy(&output.stderr).trim())],
            };
            drop(std::fs::remove_file(cache));
            let name = row[..2].iter().map(|p| p.rsplit('/').next().unwrap_or(p)).collect::<Vec<_>>().join(" + ");
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            let line = said.lines().find(|l| l.starts_with("bind ") || l.starts_with("error")).unwrap_or_default().to_owned();
            println!("{name}: {line}");
            Verdict { name, read: done, wrong }
        })
        .collect();
    close("jobs", &verdicts);
}
