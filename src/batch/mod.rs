//! Many takes: the manifest that lists them, the record that each leaves beside its outputs, and workers that do them on this machine.

pub mod manifest;
pub mod queue;
pub mod record;

pub use manifest::{Manifest, Take};
pub use record::{Record, State};
