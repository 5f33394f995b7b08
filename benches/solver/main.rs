//! Figures of the solver and of the map: `cargo bench --bench solver -- SECTION [ARGUMENT…]`.
//!
//! | section | arguments | what it prints |
//! |---|---|---|
//! | `iteration` | `COUNT CASE.npz…` | milliseconds of one plain iteration, with AVX2 and without, one line per case; with `--poses FOLDER` also where it got |
//! | `walk` | `CASE.npz [PEER_MS]` | passes and milliseconds to 0.1 mm of the converged pose, at the case's frame rate and four times it, against plain iteration |
//! | `accuracy` | | what each quality gives and costs, on the fixture take and, with `RETARGET_SHARED`, on real ones |
//! | `map` | `[SCAN]` | the surface map against plain reads of the matrix, and normals against the map |
//! | `growth` | `[SCAN]` | time against the sizes of scan, proxy, take and set of handles, with slopes |
//! | `shells` | | a step of the shell deformer against the size of its mesh; a real walk, with `RETARGET_SHARED` |
//! | `takes` | | whole runs of a scan of 205,000 vertices: set-up, frames per second, memory |
//!
//! Times are those on a core where the system tells, medians of several.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

mod accuracy;
mod body;
#[path = "../../tests/common/cases.rs"]
mod cases;
#[path = "../../tests/common/mod.rs"]
mod common;
#[path = "../../tests/common/core_time.rs"]
mod core_time;
mod growth;
mod iteration;
mod map;
mod shells;
mod takes;
mod walk;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let rest = arguments.get(1..).unwrap_or(&[]);
    match arguments.first().map(String::as_str) {
        Some("iteration") => iteration::run(rest),
        Some("walk") => walk::run(rest),
        Some("accuracy") => accuracy::run(),
        Some("map") => map::run(rest.first()),
        Some("growth") => growth::run(rest.first()),
        Some("takes") => takes::run(),
        Some("shells") => shells::run(),
        Some(other) => panic!("no section {other}"),
        None => {
            map::run(None);
            growth::run(None);
            accuracy::run();
            shells::run();
            takes::run();
        }
    }
}

/// The middle one.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median of `times` calls, milliseconds on a core. For work on this thread.
fn milliseconds(times: usize, mut work: impl FnMut()) -> f64 {
    median(
        (0..times)
            .map(|_| {
                let start = core_time::seconds_on_core();
                work();
                (core_time::seconds_on_core() - start) * 1e3
            })
            .collect(),
    )
}
