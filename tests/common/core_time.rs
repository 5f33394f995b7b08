//! Time on cores, so that other programs do not count.

use std::time::Instant;

/// Seconds that this thread has spent on a core, where the system tells (Linux); else the time of day.
pub fn seconds_on_core() -> f64 {
    thread_clock().unwrap_or_else(|| {
        static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        START.get_or_init(Instant::now).elapsed().as_secs_f64()
    })
}

#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
fn thread_clock() -> Option<f64> {
    #[repr(C)]
    struct Time {
        seconds: i64,
        nanoseconds: i64,
    }
    unsafe extern "C" {
        safe fn clock_gettime(clock: i32, time: &mut Time) -> i32;
    }
    const THIS_THREAD: i32 = 3;
    let mut time = Time { seconds: 0, nanoseconds: 0 };
    let told = clock_gettime(THIS_THREAD, &mut time) == 0;
    told.then_some(time.seconds as f64 + time.nanoseconds as f64 * 1e-9)
}

#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
fn thread_clock() -> Option<f64> {
    None
}

/// Seconds that all programs started from here and finished have spent on cores, to a hundredth; `None` where the system does not tell.
#[allow(dead_code)]
pub fn seconds_of_children() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name in parentheses; fields 16 and 17 of all, in ticks of which there are a hundred in a second.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(13);
    let (user, system): (f64, f64) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    Some((user + system) / 100.0)
}
