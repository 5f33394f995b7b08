//! Words: arguments, the decisions block, progress, the closing summary, how an error is shown.

mod animate;
mod args;
mod articulate;
mod batch;
mod blend;
mod captures;
mod console;
mod decisions;
mod fit;
mod grown;
mod inspect;
mod joints;
mod manual;
mod outputs;
mod picture;
mod proxies;
mod rig;
mod setup;
mod shells;
mod values;

use crate::export::Cancel;
use args::{Cli, Command};
use clap::Parser;
use console::{Console, Level};
use std::process::ExitCode;

/// Parses the arguments and does what they say.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // clap prints help and version to standard output, usage errors to standard error.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let (console, result) = match (&cli.command, cli.animate.is_some()) {
        (Some(Command::Inspect(inspect)), _) => {
            let console = Console::new(Level::Normal);
            let result = inspect::run(inspect, &console);
            (console, result)
        }
        (Some(Command::Joints(joints)), _) => {
            let console = Console::new(Level::Normal);
            let result = joints::run(joints, &console);
            (console, result)
        }
        (Some(Command::Batch(batch)), _) => {
            let console = Console::new(level(batch.quiet, false));
            let result = batch::run(batch, &console, &interruptible());
            (console, result)
        }
        (Some(Command::Completions(completions)), _) => (Console::new(Level::Normal), manual::completions(completions)),
        (Some(Command::Man(man)), _) => (Console::new(Level::Normal), manual::page(man)),
        (Some(Command::Blend(blend)), _) => {
            let console = Console::new(level(blend.quiet, blend.verbose));
            let result = blend::run(blend, &console);
            (console, result)
        }
        (None, true) => {
            let Some(animate) = cli.main_job() else { return ExitCode::from(2) };
            let console = Console::new(level(animate.quiet, animate.verbose));
            let result = animate::run(&animate, &console, interruptible()).and_then(|finished| finished.within);
            (console, result)
        }
        (None, false) => return ExitCode::from(2),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console.error(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// A request to stop that Ctrl-C makes.
fn interruptible() -> Cancel {
    let cancel = Cancel::default();
    let on_interrupt = cancel.clone();
    // Fails only if a handler is set already, which is as good.
    let _ = ctrlc::set_handler(move || on_interrupt.cancel());
    cancel
}

fn level(quiet: bool, verbose: bool) -> Level {
    match (quiet, verbose) {
        (true, _) => Level::Quiet,
        (_, true) => Level::Verbose,
        _ => Level::Normal,
    }
}
