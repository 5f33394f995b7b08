//! The guide is true: its commands are run and what they print is compared, its links lead somewhere, the options and keys it names exist, and no
//! option, key of the rig file or field of the report is left out.

#![allow(clippy::unwrap_used)]

#[cfg(unix)]
mod blessing;
#[cfg(unix)]
mod likeness;
mod names;
mod pages;
#[cfg(unix)]
mod transcripts;
