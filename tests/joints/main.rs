//! Things made of parts: joints found in shapes, and the deformer that keeps them.

#![allow(clippy::print_stderr)]

mod corpus;
mod detection;
mod laws;
mod program;
mod shapes;
mod targets;
