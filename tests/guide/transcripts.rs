//! The commands of the pages do what the pages show.
//!
//! In a block that begins with ` ```console `, a line that begins with `$ ` is a command, which goes on in lines that begin with `> `, and what follows it
//! is what it prints, on both streams; a block without a command goes on with what the last one prints. The commands of a page are run one after the
//! other in an empty folder that holds `fixtures/`, with the program first in the path; `cargo run --release --`, as one runs it in a fresh clone, is
//! the program too. A command that fails is followed by `$ echo $?`. What is compared how: [`crate::likeness`]; how long a run took is not, and lines
//! that tell of progress, which a slow machine prints, are passed over. With `RETARGET_BLESS` the pages are written anew ([`crate::blessing`]).
//! `RETARGET_PAGE` names a part of the page's path: only these are run.

use crate::blessing::renewed;
use crate::likeness::{compare, without_seconds};
use crate::pages::{blocks, name, pages, root};
use std::path::Path;
use std::process::Command;

/// A command of a page.
struct Step {
    /// The line of the page that what it prints begins in, counted from 0.
    first: usize,
    command: String,
    shown: Vec<String>,
}

fn steps(text: &str) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for (first, lines) in blocks(text, "console") {
        for (k, line) in lines.into_iter().enumerate() {
            if let Some(command) = line.strip_prefix("$ ") {
                steps.push(Step { first: first + k + 1, command: command.to_owned(), shown: Vec::new() });
                continue;
            }
            let step = steps.last_mut().expect("a command before what it prints");
            match line.strip_prefix('>') {
                Some(more) if step.shown.is_empty() => {
                    let more = more.strip_prefix(' ').unwrap_or(more);
                    step.command += &format!("\n{more}");
                    step.first += 1;
                }
                _ => {
                    if step.shown.is_empty() {
                        step.first = first + k;
                    }
                    step.shown.push(line.to_owned());
                }
            }
        }
    }
    steps
}

/// Runs a command after one that ended with `before`; what it printed, and how it ended.
fn run(folder: &Path, command: &str, before: i32) -> (String, i32) {
    let program = Path::new(env!("CARGO_BIN_EXE_retarget")).parent().unwrap();
    let path = std::env::join_paths(
        [program.to_owned()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())),
    );
    let command = command.replace("cargo run --release -- ", "retarget ");
    let script = format!("exec 2>&1\n(exit {before})\n{command}\n");
    let output = Command::new("sh")
        .arg("-c")
        .arg(script)
        .current_dir(folder)
        .env("PATH", path.unwrap())
        .env("LC_ALL", "C")
        .output()
        .unwrap();
    (String::from_utf8_lossy(&output.stdout).into_owned(), output.status.code().unwrap_or(-1))
}

/// Lines of progress come and go with the speed of the machine.
fn is_progress(line: &str) -> bool {
    line.starts_with("  ") && (line.ends_with(" frames/s") || line == "  completing the outputs")
}

fn compare_without_seconds(shown: &[&str], printed: &[&str]) -> Result<(), usize> {
    let [shown, printed] = [shown, printed].map(|lines| lines.iter().map(|line| without_seconds(line)).collect::<Vec<_>>());
    compare(&shown.iter().map(String::as_str).collect::<Vec<_>>(), &printed.iter().map(String::as_str).collect::<Vec<_>>())
}

/// What is wrong with a page, and the page as it should be.
fn check(page: &Path) -> (Vec<String>, String) {
    let text = std::fs::read_to_string(page).unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("fixtures"), folder.path().join("fixtures")).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let (mut wrong, mut replaced, mut status) = (Vec::new(), Vec::new(), 0);
    for step in steps(&text) {
        let asks = step.command.trim() == "echo $?";
        if status != 0 && !asks {
            wrong.push(format!(
                "{}:{}: the command before failed with {status}, and no `echo $?` says so",
                name(page),
                step.first
            ));
        }
        let (printed, ended) = run(folder.path(), &step.command, status);
        status = ended;
        let printed: Vec<&str> = printed.lines().filter(|line| !is_progress(line)).collect();
        let shown: Vec<&str> = step.shown.iter().map(String::as_str).collect();
        if let Err(at) = compare_without_seconds(&shown, &printed) {
            let nothing = "(no more lines)";
            let wanted = shown.get(at).copied().unwrap_or(nothing);
            wrong.push(format!(
                "{}:{}: $ {}\n  not as shown: {wanted}\n  printed:\n    {}",
                name(page),
                step.first + at + 1,
                step.command,
                printed.join("\n    ")
            ));
            replaced.push((step.first..step.first + shown.len(), renewed(&shown, &printed)));
        }
    }
    for (range, with) in replaced.into_iter().rev() {
        lines.splice(range, with);
    }
    (wrong, lines.join("\n") + "\n")
}

#[test]
fn commands_print_what_the_pages_show() {
    let only = std::env::var("RETARGET_PAGE").unwrap_or_default();
    let (mut wrong, mut commands) = (Vec::new(), 0);
    for page in pages().iter().filter(|page| name(page).contains(&only)) {
        let count = steps(&std::fs::read_to_string(page).unwrap()).len();
        if count == 0 {
            continue;
        }
        commands += count;
        let (failures, text) = check(page);
        if !failures.is_empty() && std::env::var_os("RETARGET_BLESS").is_some() {
            std::fs::write(page, text).unwrap();
        } else {
            wrong.extend(failures);
        }
    }
    assert!(wrong.is_empty(), "{}\nif it should be so: scripts/bless.sh", wrong.join("\n"));
    assert!(!only.is_empty() || commands >= 20, "only {commands} commands: are the pages there?");
}
