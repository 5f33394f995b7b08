//! Many takes: the manifest that lists them, the record that each leaves beside its outputs, and workers that do them on this machine.

pub(crate) mod manifest;
pub(crate) mod queue;
pub(crate) mod record;
