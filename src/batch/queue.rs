//! Takes on this machine: as many at once as there are workers, each a process of its own, so that none can stop another.

use crate::error::{Error, Kind, Result};
use crate::export::Cancel;
use std::io::Read;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Bytes that are kept of what a take prints: the last ones.
const KEPT: usize = 64 << 10;
/// How often it is looked whether somebody asked to stop.
const PAUSE: Duration = Duration::from_millis(50);

/// How a take ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Its exit code; 1 where it was killed.
    pub exit: u8,
    /// What it printed, of very long texts the end.
    pub printed: String,
}

/// Does the jobs `0..count` with `workers` processes at once. `command` makes the command of a job: it must stop by itself once its standard
/// input closes, which happens when somebody asks to stop or this process ends. `ended` is told of each in the order in which they end.
///
/// # Errors
/// [`Kind::Interrupted`], when all processes have stopped.
pub fn run(
    count: usize,
    workers: usize,
    cancel: &Cancel,
    command: &(dyn Fn(usize) -> Command + Sync),
    ended: &(dyn Fn(usize, Ended) + Sync),
) -> Result<()> {
    let next = AtomicUsize::new(0);
    let running = AtomicUsize::new(workers.min(count));
    let leashes: Vec<Mutex<Option<ChildStdin>>> = (0..workers).map(|_| Mutex::default()).collect();
    std::thread::scope(|scope| {
        for leash in leashes.iter().take(count) {
            let (next, running) = (&next, &running);
            scope.spawn(move || {
                let _running = Running(running);
                loop {
                    let job = next.fetch_add(1, Ordering::Relaxed);
                    if job >= count || cancel.check().is_err() {
                        break;
                    }
                    let end = one(command(job), leash);
                    // What was stopped has not ended.
                    if cancel.check().is_ok() || end.exit == 0 {
                        ended(job, end);
                    }
                }
            });
        }
        while running.load(Ordering::Acquire) > 0 {
            if cancel.check().is_err() {
                leashes.iter().for_each(|leash| drop(lock(leash).take()));
            }
            std::thread::sleep(PAUSE);
        }
    });
    cancel.check()
}

/// A worker that is at work; it is not when it panics, either.
struct Running<'a>(&'a AtomicUsize);

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Release);
    }
}

fn one(mut command: Command, leash: &Mutex<Option<ChildStdin>>) -> Ended {
    let spawned = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
    let mut child = match spawned {
        Ok(child) => child,
        Err(error) => return Ended { exit: 1, printed: format!("error: cannot start: {error}") },
    };
    *lock(leash) = child.stdin.take();
    let printed = last_of_what_is_printed(&mut child);
    let status = child.wait();
    drop(lock(leash).take());
    match status.map(|status| (status, exit_code(status))) {
        Ok((_, Some(exit))) => Ended { exit, printed },
        Ok((status, None)) => Ended { exit: 1, printed: format!("{printed}error: the process ended with {status}") },
        Err(error) => Ended { exit: 1, printed: format!("{printed}error: the process was lost: {error}") },
    }
}

fn exit_code(status: ExitStatus) -> Option<u8> {
    status.code().map(|code| u8::try_from(code).unwrap_or(1))
}

fn last_of_what_is_printed(child: &mut Child) -> String {
    let mut kept = Vec::new();
    let mut buffer = [0; 4096];
    let Some(stream) = child.stderr.as_mut() else { return String::new() };
    while let Ok(read @ 1..) = stream.read(&mut buffer) {
        kept.extend_from_slice(&buffer[..read]);
        if kept.len() > 2 * KEPT {
            kept.drain(..kept.len() - KEPT);
        }
    }
    String::from_utf8_lossy(&kept).into_owned()
}

fn lock(leash: &Mutex<Option<ChildStdin>>) -> std::sync::MutexGuard<'_, Option<ChildStdin>> {
    leash.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Asks to stop once standard input closes: when whoever started this process stops it or is gone.
pub fn stop_with_standard_input(cancel: &Cancel) {
    let cancel = cancel.clone();
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        cancel.cancel();
    });
}

/// The number of workers for `wanted` of them, or for the cores of this machine, and the threads that each gets.
///
/// # Errors
/// [`Kind::Usage`] for none.
pub fn share_cores(wanted: Option<usize>, jobs: usize) -> Result<(usize, usize)> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if wanted == Some(0) {
        return Err(Error::new(Kind::Usage, "0 workers").expected("at least one"));
    }
    let workers = wanted.unwrap_or(cores).min(jobs.max(1));
    Ok((workers, (cores / workers).max(1)))
}

#[cfg(all(test, unix))]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    #[test]
    fn one_bad_job_does_not_stop_the_others() {
        let scripts = ["echo one >&2", "echo 'error: two' >&2; exit 3", "kill -9 $$", "echo four >&2; exit 4"];
        for workers in [1, 3, 9] {
            let ends = Mutex::new(vec![None; 4]);
            let tell = |job: usize, end: Ended| ends.lock().unwrap()[job] = Some(end);
            run(4, workers, &Cancel::default(), &|job| shell(scripts[job]), &tell).unwrap();
            let ends: Vec<Ended> = ends.into_inner().unwrap().into_iter().map(Option::unwrap).collect();
            assert_eq!(ends.iter().map(|e| e.exit).collect::<Vec<_>>(), [0, 3, 1, 4]);
            assert_eq!(ends[1].printed, "error: two\n");
            assert!(ends[2].printed.contains("signal: 9"), "{}", ends[2].printed);
        }
    }

    #[test]
    fn asking_to_stop_ends_those_that_run_and_begins_no_other() {
        let cancel = Cancel::default();
        let told = AtomicUsize::new(0);
        let begun = AtomicUsize::new(0);
        // Ends by itself when its standard input closes.
        let command = |_: usize| {
            if begun.fetch_add(1, Ordering::Relaxed) == 1 {
                cancel.cancel();
            }
            shell("cat >/dev/null; exit 130")
        };
        let result = run(50, 2, &cancel, &command, &|_, _| {
            told.fetch_add(1, Ordering::Relaxed);
        });
        assert_eq!(result.unwrap_err().kind, Kind::Interrupted);
        assert_eq!((begun.into_inner(), told.into_inner()), (2, 0));
    }

    #[test]
    fn of_a_long_text_the_end_is_kept() {
        let end = Mutex::new(None);
        let script = "yes 0123456789 | head -n 30000 >&2; echo the end >&2";
        run(1, 1, &Cancel::default(), &|_| shell(script), &|_, e| *end.lock().unwrap() = Some(e)).unwrap();
        let printed = end.into_inner().unwrap().unwrap().printed;
        assert!(printed.ends_with("the end\n") && printed.len() <= 2 * KEPT + 4096, "{}", printed.len());
    }

    #[test]
    fn workers_share_the_cores() {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        assert_eq!(share_cores(Some(1), 9).unwrap(), (1, cores));
        assert_eq!(share_cores(None, 1).unwrap(), (1, cores));
        assert_eq!(share_cores(Some(64), 100).unwrap(), (64, (cores / 64).max(1)));
        assert!(share_cores(Some(0), 1).is_err());
    }
}
