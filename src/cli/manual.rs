//! `retarget completions` and `retarget man`: made of the same definitions as the arguments, to standard output.

use super::args::{Cli, Completions, Man};
use crate::error::{Error, Kind, Result};
use clap::{Arg, CommandFactory};
use std::io::{ErrorKind, Write};

/// Prints the completions of a shell.
///
/// # Errors
/// Standard output that cannot be written, other than that nobody reads it any more.
pub(super) fn completions(args: &Completions) -> Result<()> {
    let mut command = Cli::command();
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "retarget", &mut text);
    print(&text)
}

/// Prints the manual page of the main job, or of a subcommand.
///
/// # Errors
/// As [`completions`].
pub(super) fn page(args: &Man) -> Result<()> {
    let mut command = Cli::command().disable_help_subcommand(true).mut_args(explained).mut_subcommands(|c| c.mut_args(explained));
    command.build();
    let command = match &args.of {
        None => command,
        Some(name) => match command.find_subcommand(name) {
            // Its name is `retarget-NAME` from here on, as its page is called.
            Some(subcommand) => subcommand.clone().version(super::args::VERSION),
            None => {
                let names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
                return Err(Error::new(Kind::Usage, format!("there is no subcommand '{name}'"))
                    .expected(format!("one of {}", names.join(", "))));
            }
        },
    };
    let mut text = Vec::new();
    clap_mangen::Man::new(command).render(&mut text).map_err(|e| unwritable(&e))?;
    print(&text)
}

/// What `-h` leaves out would be without a word in the page, unless it has a text of its own for `--help`.
fn explained(argument: Arg) -> Arg {
    match (argument.get_long_help(), argument.get_help().cloned()) {
        (None, Some(help)) => argument.long_help(help),
        _ => argument,
    }
}

fn print(text: &[u8]) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(unwritable(&e)),
        _ => Ok(()),
    }
}

fn unwritable(reason: &std::io::Error) -> Error {
    Error::unwritable("standard output".as_ref(), reason)
}
