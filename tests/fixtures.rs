//! The committed fixtures are what their generator makes.

#![allow(clippy::unwrap_used, dead_code)]

#[path = "common/c3d_writer.rs"]
mod c3d_writer;
#[path = "../examples/make_fixtures/generate/mod.rs"]
mod generate;

#[test]
fn the_generator_makes_the_committed_fixtures_byte_for_byte() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    for (name, bytes) in generate::all() {
        let committed = std::fs::read(folder.join(&name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(committed == bytes, "{name} differs: cargo run --release --example make_fixtures");
    }
}
