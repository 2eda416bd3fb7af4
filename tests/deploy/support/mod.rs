//! Helpers that read the shipped files and ask the program for its settings.

pub mod containers;
pub mod image;
pub mod program;
pub mod source;
