//! Bodies that a fuzzer runs, and that the tests run over samples and their mutants: whatever the bytes are, reading them as a capture of
//! markers ends soon, within memory in proportion to them, in a sound take or in an error that says something.

use super::{Capture, Motion, ReadOptions, read_bytes};
use std::path::Path;

/// Reads the bytes as C3D; tells whether they were read.
pub fn c3d(bytes: &[u8]) -> bool {
    body(bytes, "a.c3d")
}

/// Reads the bytes as a TRC table.
pub fn trc(bytes: &[u8]) -> bool {
    body(bytes, "a.trc")
}

/// Reads the bytes as a table of markers, plain or of Motive.
pub fn csv(bytes: &[u8]) -> bool {
    body(bytes, "a.csv")
}

fn body(bytes: &[u8], name: &str) -> bool {
    let read = |options: &ReadOptions| match read_bytes(bytes.to_vec(), Path::new(name), options) {
        Ok(capture) => {
            check(&capture, bytes.len());
            true
        }
        Err(error) => {
            assert!(!error.found.is_empty());
            false
        }
    };
    read(&ReadOptions { bodies: true, as_found: true, ..ReadOptions::default() });
    read(&ReadOptions::default())
}

/// Asserts what every reader promises of a take from `length` bytes.
fn check(capture: &Capture, length: usize) {
    let take = capture.motion.points();
    assert!(capture.rate > 0.0 && capture.rate.is_finite());
    assert_eq!(take.points.len(), take.markers() * take.frames());
    assert!(take.points.iter().all(|p| p.iter().all(|c| c.is_finite()) || p[0].is_nan()));
    assert!(take.origin.is_finite());
    if let Motion::Markers(_) = &capture.motion {
        assert!(take.points.len() * 12 <= 16 * length + (1 << 20), "a take many times larger than its file");
    }
    if let Motion::Skeleton(skeleton) = &capture.motion {
        assert_eq!((skeleton.rotations.len(), skeleton.joints.len()), (take.points.len(), take.markers()));
        assert!(skeleton.joints.iter().enumerate().all(|(n, j)| j.parent.is_none_or(|p| p < n)));
    }
}
