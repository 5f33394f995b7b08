//! The results of a batch, for people and for programs.

use super::Fate;
use crate::batch::manifest::Manifest;
use crate::cli::console::Console;
use crate::error::{Error, Kind, Result};
use crate::words;
use serde_json::{Value, json};
use std::io::Write;

/// Prints a row for each take, those with the largest residuals first, after those that failed.
pub(super) fn print(manifest: &Manifest, fates: &[Fate], console: &Console) {
    let mut order: Vec<usize> = (0..fates.len()).collect();
    let worst = |n: usize| fates[n].summary().and_then(|s| s.residual_worst_mm).unwrap_or(0.0);
    let class = |n: usize| match fates[n] {
        Fate::Failed(..) => 0,
        Fate::Left => 2,
        _ => 1,
    };
    order.sort_by(|&a, &b| class(a).cmp(&class(b)).then(worst(b).total_cmp(&worst(a))).then(a.cmp(&b)));
    let width = manifest.takes.iter().map(|take| take.name().chars().count()).max().unwrap_or(0).min(60);
    console.plain(&format!(
        "{:>6}  {:width$}  {:7}  {:>8}  {:>7}  {:>9}  {:>8}  worst at",
        "take", "", "", "time", "frames", "median mm", "worst mm"
    ));
    for n in order {
        let take = &manifest.takes[n];
        let state = match &fates[n] {
            Fate::Failed(exit, _) => format!("exit {exit}"),
            Fate::Left => "left".into(),
            fate if fate.exit() == Some(4) => "above".into(),
            Fate::DoneBefore(_) => "before".into(),
            Fate::Done(_) => "done".into(),
        };
        let head = format!("{:>6}  {:width$}  {state:7}", take.number, take.name());
        let Some(summary) = fates[n].summary() else {
            console.plain(&head);
            continue;
        };
        let at = match (&summary.worst_handle, summary.worst_frame) {
            (Some(handle), Some(frame)) => format!("{handle}, frame {frame}"),
            _ => String::new(),
        };
        console.plain(&format!(
            "{head}  {:>8}  {:>7}  {:>9}  {:>8}  {at}",
            words::seconds(summary.seconds),
            words::count(summary.frames),
            words::digits(summary.residual_median_mm),
            summary.residual_worst_mm.map_or_else(|| "-".into(), words::digits),
        ));
    }
}

/// Prints an array with an object for each take to standard output.
pub(super) fn print_json(manifest: &Manifest, fates: &[Fate]) -> Result<()> {
    let rows: Vec<Value> = manifest
        .takes
        .iter()
        .zip(fates)
        .map(|(take, fate)| {
            let (state, error) = match fate {
                Fate::DoneBefore(_) => ("done_before", None),
                Fate::Done(_) => ("done", None),
                Fate::Failed(_, error) => ("failed", Some(error)),
                Fate::Left => ("left", None),
            };
            json!({
                "number": take.number,
                "place": take.place,
                "scan": take.values["scan"][0],
                "capture": take.values["capture"][0],
                "outputs": take.values["out"],
                "state": state,
                "exit": fate.exit(),
                "error": error,
                "summary": fate.summary(),
            })
        })
        .collect();
    print_value(&Value::Array(rows))
}

/// Prints a value to standard output; a reader that has enough of it is no failure.
pub(super) fn print_value(value: &Value) -> Result<()> {
    let written = serde_json::to_string_pretty(value).map_err(std::io::Error::from);
    match written.and_then(|text| writeln!(std::io::stdout().lock(), "{text}")) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::new(Kind::Unwritable, format!("cannot write to standard output: {error}")))
        }
        _ => Ok(()),
    }
}
