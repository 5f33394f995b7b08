//! The `retarget` program.

fn main() -> std::process::ExitCode {
    retarget::cli::run()
}
