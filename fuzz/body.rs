//! Hands bytes to the body that the environment variable `BODY` names.

#![no_main]

use libfuzzer_sys::fuzz_target;
use retarget::fuzz::{BODIES, Body};
use std::sync::LazyLock;

static CHOSEN: LazyLock<Body> = LazyLock::new(|| {
    let name = std::env::var("BODY").unwrap_or_default();
    match BODIES.iter().find(|(n, _)| *n == name) {
        Some((_, body)) => *body,
        None => panic!("BODY is '{name}', expected one of {:?}", BODIES.iter().map(|(n, _)| *n).collect::<Vec<_>>()),
    }
});

fuzz_target!(|bytes: &[u8]| {
    (*CHOSEN)(bytes);
});
