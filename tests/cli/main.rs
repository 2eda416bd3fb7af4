//! The command line as an engineer uses it: the built program, files, exit codes.

#[path = "../support/files.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod files;

#[path = "../support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests of the engine")]
mod meshes;

mod compare;
mod example;
mod inspect;
mod inspect_options;
mod repair;
mod repair_options;
#[cfg(feature = "service")]
mod service;
mod support;
mod verdict;
