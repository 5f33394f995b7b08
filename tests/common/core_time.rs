//! Time on a core.

use std::sync::OnceLock;
use std::time::Instant;

/// Time that this thread has spent on a core, where the system tells (Linux), so that other programs do not count; else the time of day.
pub fn seconds_on_core() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64(), |n| n * 1e-9)
}
