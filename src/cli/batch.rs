//! `retarget batch`: many takes from a manifest, on this machine or one by one for a queue.

mod estimate;
mod table;

use super::animate;
use super::args::{Animate, Batch, Take as Arguments};
use super::console::Console;
use super::outputs;
use crate::batch::manifest::{Manifest, OptionTable, Take, Takes};
use crate::batch::queue::{self, Ended};
use crate::batch::record::{Due, Record, Summary};
use crate::error::{Error, Kind, Result};
use crate::export::{Cancel, files};
use crate::{opened, words};
use clap::{ArgAction, CommandFactory, Parser};
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Mutex;
use std::time::SystemTime;

/// Runs the subcommand.
pub(super) fn run(args: &Batch, console: &Console, cancel: &Cancel) -> Result<()> {
    if args.until_input_closes {
        queue::stop_with_standard_input(cancel);
    }
    let manifest = Manifest::read(&args.manifest, options())?;
    if let Some(number) = args.index {
        return one(args, &manifest, manifest.take(number)?, console, cancel);
    }
    // Wrong arguments are found before the first take begins, not in the night.
    manifest.takes.iter().try_for_each(|take| parse(&manifest, take).map(drop))?;
    if args.estimate { estimate::run(args, &manifest, console, cancel) } else { all(args, &manifest, console, cancel) }
}

/// The options of the main job, by what they take.
fn options() -> OptionTable {
    let command = Arguments::command();
    let path = clap::value_parser!(PathBuf).type_id();
    let options = command.get_arguments().filter_map(|option| {
        let takes = match option.get_action() {
            ArgAction::SetTrue => Takes::Nothing,
            _ if option.get_value_parser().type_id() == path => Takes::Path,
            _ => Takes::Value,
        };
        Some((option.get_long()?.to_owned(), takes))
    });
    // How much is printed is for the batch to say.
    options.filter(|(name, _)| !["help", "quiet", "verbose"].contains(&name.as_str())).collect()
}

/// The arguments of a take.
fn parse(manifest: &Manifest, take: &Take) -> Result<Animate> {
    Arguments::try_parse_from(manifest.arguments(take)).map(|take| Animate { shells: take.shells, ..take.animate }).map_err(
        |error| {
            let text = error.render().to_string();
            let text =
                text.trim_start_matches("error: ").split("\n\nUsage").next().unwrap_or_default().split("\n\nFor more").next();
            Error::new(Kind::Usage, text.unwrap_or_default().trim()).file(&manifest.path).at(&*take.place)
        },
    )
}

/// Does one take, unless it is done already.
fn one(args: &Batch, manifest: &Manifest, take: &Take, console: &Console, cancel: &Cancel) -> Result<()> {
    let mut animate = parse(manifest, take)?;
    let path = Record::path(manifest, take);
    let known = Record::read(&path);
    match Record::due(known.as_ref(), manifest, take) {
        None if !args.force => {
            console.station("take", &format!("{}  {} is done already", take.number, take.name()));
            return known.map_or(Ok(()), |record| gate(&record, take));
        }
        Some(Due::Changed(what)) => console.station("take", &format!("{}  {} again: {what}", take.number, take.name())),
        _ => console.station("take", &format!("{}  {}", take.number, take.name())),
    }
    // What an earlier run of the take has begun is its own to replace, and nothing else.
    let own = |path: &PathBuf| known.as_ref().is_some_and(|record| record.owns(manifest, path));
    let foreign = manifest.outputs(take).into_iter().find(|path| !own(path) && files::exists(path));
    if let Some(path) = foreign.filter(|_| !args.force && !animate.force) {
        return Err(Error::new(Kind::Unwritable, "exists already, and no earlier run of this take has written it")
            .file(path)
            .expected("a path where nothing is")
            .hint("--force replaces it"));
    }
    animate.force = true;
    // The manifest knows better than the share of the cores.
    animate.threads = animate.threads.or(args.threads);
    animate.cache = args.cache.clone().or(animate.cache);
    for output in manifest.outputs(take) {
        let folder = crate::beside::folder_of(&output);
        fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e))?;
    }
    // Refusals come before the outputs are marked as its own.
    drop(outputs::sinks(&animate)?);
    let mut record = Record::begin(manifest, take);
    record.write(&path)?;
    let started = SystemTime::now();
    let finished = animate::run(&animate, console, cancel.clone())?;
    record.summary = finished.summary;
    record.exit = finished.within.as_ref().map_or_else(Error::exit_code, |()| 0);
    record.complete(manifest, &opened::all(), &manifest.outputs(take), started)?;
    record.write(&path)?;
    finished.within
}

/// Fails as the take did when it was done.
fn gate(record: &Record, take: &Take) -> Result<()> {
    if record.exit == 0 {
        return Ok(());
    }
    let worst = record.summary.residual_worst_mm.map_or_else(String::new, |worst| format!(": {} mm", words::digits(worst)));
    Err(Error::new(Kind::AboveLimit, format!("{} stays above the limit of --fail-above{worst}", take.name())))
}

/// What became of a take.
#[derive(Clone, Debug)]
pub(super) enum Fate {
    /// It was done by an earlier run.
    DoneBefore(Record),
    /// It was done now.
    Done(Record),
    /// It failed, with its exit code and error.
    Failed(u8, String),
    /// It was not begun, or was stopped.
    Left,
}

impl Fate {
    /// The exit code of the take; `None` where it has none.
    fn exit(&self) -> Option<u8> {
        match self {
            Fate::DoneBefore(record) | Fate::Done(record) => Some(record.exit),
            Fate::Failed(exit, _) => Some(*exit),
            Fate::Left => None,
        }
    }

    fn summary(&self) -> Option<&Summary> {
        match self {
            Fate::DoneBefore(record) | Fate::Done(record) => Some(&record.summary),
            _ => None,
        }
    }
}

/// Does all takes that are not done yet, each in a process of its own.
fn all(args: &Batch, manifest: &Manifest, console: &Console, cancel: &Cancel) -> Result<()> {
    let start = std::time::Instant::now();
    let program =
        std::env::current_exe().map_err(|e| Error::new(Kind::Unreadable, format!("cannot find the program itself: {e}")))?;
    let mut fates = vec![Fate::Left; manifest.takes.len()];
    let mut open = Vec::new();
    for (take, fate) in manifest.takes.iter().zip(&mut fates) {
        cancel.check()?;
        let record = Record::read(&Record::path(manifest, take));
        match (Record::due(record.as_ref(), manifest, take), record) {
            (None, Some(record)) if !args.force => *fate = Fate::DoneBefore(record),
            _ => open.push(take),
        }
    }
    let (workers, threads) = queue::share_cores(args.workers, open.len())?;
    let threads = args.threads.map_or(threads, usize::from);
    console.station(
        "batch",
        &format!(
            "{}  {}, {} done before · {} at a time, {} each",
            manifest.path.display(),
            words::plural(manifest.takes.len(), "take"),
            words::count(manifest.takes.len() - open.len()),
            words::plural(workers, "take"),
            words::plural(threads, "thread"),
        ),
    );
    let command = |job: usize| {
        let mut command = Command::new(&program);
        command.arg("batch").arg("--until-input-closes").args(["--index", &open[job].number.to_string()]);
        command.args(["--threads", &threads.to_string()]).args(args.force.then_some("--force"));
        if let Some(folder) = &args.cache {
            command.arg("--cache").arg(folder);
        }
        command.arg("--").arg(&manifest.path);
        command
    };
    let told = Mutex::new((0, &mut fates));
    let ended = |job: usize, end: Ended| {
        let take = open[job];
        let record = Record::read(&Record::path(manifest, take)).filter(|_| matches!(end.exit, 0 | 4));
        let fate = record.map_or_else(|| Fate::Failed(end.exit, last_error(&end.printed)), Fate::Done);
        let mut told = told.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        told.0 += 1;
        let place = format!("{} of {}  {}", words::count(told.0), words::count(open.len()), take.name());
        match &fate {
            Fate::Failed(_, error) => console.station("failed", &format!("{place}  {error}")),
            fate => console.station("take", &format!("{place}  {}", fate.summary().map_or_else(String::new, figures))),
        }
        told.1[take.number - 1] = fate;
    };
    let result = queue::run(open.len(), workers, cancel, &command, &ended);
    if args.json {
        table::print_json(manifest, &fates)?;
    }
    if fates.len() > 1 {
        table::print(manifest, &fates, console);
    }
    let failed = fates.iter().filter(|fate| matches!(fate, Fate::Failed(..))).count();
    let above = fates.iter().filter(|fate| fate.summary().is_some() && fate.exit() == Some(4)).count();
    let done = fates.iter().filter(|fate| fate.summary().is_some()).count();
    result.map_err(|error| match error.kind {
        Kind::Interrupted => {
            Error::new(Kind::Interrupted, format!("interrupted: {done} of {} done", words::plural(manifest.takes.len(), "take")))
                .hint("the same command goes on where it stopped")
        }
        _ => error,
    })?;
    console.station(
        "done",
        &format!("{} · {} done, {failed} failed", words::seconds(start.elapsed().as_secs_f64()), words::plural(done, "take")),
    );
    match (failed, above) {
        (0, 0) => Ok(()),
        (0, above) => {
            Err(Error::new(Kind::AboveLimit, format!("{} above the limit of --fail-above", words::plural(above, "take"))))
        }
        (failed, _) => Err(Error::new(
            Kind::Failed,
            format!("{} of {} failed", words::count(failed), words::plural(manifest.takes.len(), "take")),
        )
        .hint("mend what is said above, then the same command: what is done is not done again")),
    }
}

/// `4.2 s · residual median 0.4 mm, worst 9 mm (RELB, frame 211) · volume 99.1–100.3 %`.
fn figures(summary: &Summary) -> String {
    let mut parts = vec![words::seconds(summary.seconds)];
    if let (Some(worst), Some(handle), Some(frame)) = (summary.residual_worst_mm, &summary.worst_handle, summary.worst_frame) {
        let median = words::digits(summary.residual_median_mm);
        parts.push(format!("residual median {median} mm, worst {} mm ({handle}, frame {frame})", words::digits(worst)));
    }
    parts.push(format!("volume {:.1}–{:.1} %", summary.volume.0 * 100.0, summary.volume.1 * 100.0));
    parts.join(" · ")
}

/// The error at the end of what a take has printed.
fn last_error(printed: &str) -> String {
    let begin = printed.rfind("\nerror: ").map(|at| at + 1).or_else(|| printed.starts_with("error: ").then_some(0));
    begin.map_or_else(|| printed.trim(), |at| printed[at..].trim_start_matches("error: ").trim()).to_owned()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_options_of_the_main_job_are_those_of_a_manifest() {
        let options = options();
        assert_eq!(options["flip"], Takes::Nothing);
        assert_eq!(options["quality"], Takes::Value);
        assert_eq!(options["frames"], Takes::Value);
        for path in ["out", "report", "rig", "save-rig", "ref-file", "proxy", "save-proxy", "picture", "handles", "skeleton"] {
            assert_eq!(options[path], Takes::Path, "{path}");
        }
        assert!(["help", "scan", "quiet", "verbose"].iter().all(|name| !options.contains_key(*name)));
    }

    #[test]
    fn wrong_values_are_found_before_anything_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list.csv");
        fs::write(&path, "scan,capture,out,frames\na.obj,b.c3d,c.glb,1..5\na.obj,b.c3d,d.glb,5..1\n").unwrap();
        let manifest = Manifest::read(&path, options()).unwrap();
        assert_eq!(parse(&manifest, &manifest.takes[0]).unwrap().frames, Some((1, 5)));
        let error = parse(&manifest, &manifest.takes[1]).unwrap_err();
        assert_eq!((error.kind, error.place.as_deref()), (Kind::Usage, Some("line 3")));
        assert!(error.found.contains("ends (1) before"), "{}", error.found);
    }

    #[test]
    fn the_last_error_is_what_counts() {
        assert_eq!(last_error("scan  a\nwarning  b\nerror: no\n   expected yes\n"), "no\n   expected yes");
        assert_eq!(last_error("error: at once"), "at once");
        assert_eq!(last_error("thread panicked"), "thread panicked");
    }
}
