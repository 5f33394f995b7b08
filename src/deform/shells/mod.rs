//! Example-driven shells.

mod geometry;
mod newton;
mod quadratic;
mod shell;
#[cfg(test)]
mod stored_cases;
mod system;
mod topology;
