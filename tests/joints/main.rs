//! Things made of parts: joints found in shapes, and the deformer that keeps them.

#![allow(clippy::print_stderr)]

mod arm;
#[path = "../common/mod.rs"]
mod common;
mod corpus;
mod detection;
mod feet;
mod glb;
mod laws;
mod limits;
mod program;
mod runs;
mod shapes;
mod table;
mod targets;
