//! `retarget` makes a laser scan (or any mesh) move like the person, animal or machine that was captured.
//!
//! ```text
//!  SCAN file ──► scan ──► proxy ──┐
//!                                 ├──► binding ──► deform ──► surface ──► export ──► OUT files
//!  CAPTURE file ──► capture ──────┘     (handles)   (proxy pose)  (scan pose)
//! ```

pub mod binding;
pub mod capture;
pub mod cli;
pub mod deform;
pub mod error;
pub mod export;
pub mod linalg;
pub mod pipeline;
pub mod proxy;
pub mod report;
pub mod scan;
pub mod space;
pub mod spatial;
pub mod surface;
