//! Helpers that read the pages and the source, and the models of the pictures.

pub mod pages;
pub mod pictures;
pub mod source;
