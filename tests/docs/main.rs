//! The documentation is complete and served, its commands run, and its pictures match what the program draws.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod commands;
mod links;
mod literals;
#[allow(dead_code, reason = "shared with the tests of the engine")]
#[path = "../support/meshes.rs"]
mod meshes;
mod messages;
mod pages;
mod pictures;
#[path = "../support/prose.rs"]
mod prose;
mod reference;
mod served;
#[allow(dead_code, reason = "shared with the tests of the service")]
#[path = "../support/server.rs"]
mod server;
mod support;
