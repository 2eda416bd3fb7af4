//! The engine from outside: operators and the pipeline on made meshes.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

#[path = "../support/meshes.rs"]
mod meshes;
mod operators;
mod pipeline;
