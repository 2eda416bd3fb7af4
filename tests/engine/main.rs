//! The engine from outside: formats, operators and the pipeline, on meshes that the tests make.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod analyze;
mod characteristics;
mod compare;
mod defects;
mod formats;
mod holes;
mod intersections;
mod lost;
mod mend;
#[path = "../support/meshes.rs"]
mod meshes;
mod operators;
mod pipeline;
mod print;
mod render;
