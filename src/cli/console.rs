//! The only place that prints: station lines, warnings, the progress bar, errors. Everything goes to standard error.

use crate::error::Error;
use crate::words;
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::io::Write as _;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A line on standard error. Nobody may be reading any more (`| head`), which is no failure.
macro_rules! say {
    ($($words:tt)*) => {{
        let _ = writeln!(anstream::stderr(), $($words)*);
    }};
}

/// How often a line tells of progress where no bar can be drawn.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

/// What the user wants to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// Errors only.
    Quiet,
    /// One line per station, warnings, progress.
    Normal,
    /// Timings and details too.
    Verbose,
}

/// Prints for people, in one voice.
#[derive(Debug)]
pub(super) struct Console {
    level: Level,
}

impl Console {
    /// A console at this level.
    pub(super) fn new(level: Level) -> Self {
        Self { level }
    }

    /// A line of the decisions block: the station's name and what it decided.
    pub(super) fn station(&self, name: &str, text: &str) {
        if self.level != Level::Quiet {
            say!("\x1b[1m{name:<8}\x1b[0m {text}");
        }
    }

    /// A line for `--verbose`.
    pub(super) fn detail(&self, text: &str) {
        if self.level == Level::Verbose {
            say!("         \x1b[2m{text}\x1b[0m");
        }
    }

    /// A line of a table.
    pub(super) fn plain(&self, text: &str) {
        if self.level != Level::Quiet {
            say!("{text}");
        }
    }

    /// A warning: doubtful input, and what was assumed.
    pub(super) fn warning(&self, text: &str) {
        if self.level != Level::Quiet {
            say!("\x1b[33mwarning\x1b[0m  {text}");
        }
    }

    /// An error, always printed.
    pub(super) fn error(&self, error: &Error) {
        say!("\x1b[1;31merror\x1b[0m: {error}");
    }

    /// Starts telling of progress through `total` frames; `what` is done with them.
    pub(super) fn progress(&self, what: &'static str, total: usize) -> Progress {
        let drawn = self.level != Level::Quiet && std::io::stderr().is_terminal();
        let bar = drawn.then(|| {
            let bar = ProgressBar::new(total as u64);
            let style = ProgressStyle::with_template("  {prefix}[{bar:30}] {human_pos}/{human_len}  {per_sec}  ETA {eta}");
            bar.set_prefix(what);
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar
        });
        let now = Instant::now();
        Progress {
            bar,
            plain: self.level != Level::Quiet && !drawn,
            what,
            total,
            start: now,
            last: Mutex::new(now),
            done: AtomicUsize::new(0),
        }
    }
}

/// Progress through the frames: a bar on a terminal, a plain line every few seconds elsewhere.
#[derive(Debug)]
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    plain: bool,
    what: &'static str,
    total: usize,
    start: Instant,
    last: Mutex<Instant>,
    done: AtomicUsize,
}

impl Progress {
    /// So many frames are done.
    pub(super) fn at(&self, done: usize) {
        self.done.store(done, Ordering::Relaxed);
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
        let Ok(mut last) = self.last.lock() else { return };
        if self.plain && last.elapsed() >= PLAIN_INTERVAL {
            *last = Instant::now();
            let mut line = format!("  {}{} of {} frames", self.what, words::count(done), words::count(self.total));
            let rate = done as f64 / self.start.elapsed().as_secs_f64();
            let _ = write!(line, "  {} frames/s", words::digits(rate));
            say!("{line}");
        }
    }

    /// All frames are done; the outputs are completed.
    pub(super) fn finishing(&self) {
        if let Some(bar) = &self.bar {
            bar.set_style(
                ProgressStyle::with_template("  completing the outputs {elapsed}")
                    .unwrap_or_else(|_| ProgressStyle::default_bar()),
            );
            bar.enable_steady_tick(Duration::from_millis(500));
        } else if self.plain && self.start.elapsed() >= PLAIN_INTERVAL {
            say!("  completing the outputs");
        }
    }

    /// Frames done so far.
    pub(super) fn done(&self) -> usize {
        self.done.load(Ordering::Relaxed)
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
