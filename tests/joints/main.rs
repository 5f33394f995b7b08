//! Things made of parts: joints found in shapes, and the deformer that keeps them.

mod corpus;
mod detection;
mod laws;
mod program;
mod shapes;
