//! Things made of parts: rig file, scan and capture → model, handles and their targets.

pub mod drive;
pub mod feet;
pub mod floor;
pub mod machine;
pub mod robot;

pub use machine::Machine;
