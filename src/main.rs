//! The `retarget` program.

fn main() {}
