//! Makes the files of `fixtures/` anew: `cargo run --release --example make_fixtures [FOLDER]`.

#[path = "../../tests/common/c3d_writer.rs"]
mod c3d_writer;
mod generate;

fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "fixtures".into());
    std::fs::create_dir_all(&folder)?;
    for (name, bytes) in generate::all() {
        std::fs::write(std::path::Path::new(&folder).join(name), bytes)?;
    }
    Ok(())
}
