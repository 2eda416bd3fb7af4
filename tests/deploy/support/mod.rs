//! Helpers that read the shipped files and ask the program for its settings.

pub mod compose;
pub mod containers;
pub mod image;
pub mod manifests;
pub mod program;
pub mod source;
pub mod tools;
