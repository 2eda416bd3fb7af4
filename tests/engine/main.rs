//! The engine through its public interface: formats, operators and the pipeline, on meshes that the tests build.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod alarms;
mod alternatives;
mod analyze;
mod arrange;
mod change;
mod characteristics;
mod clean_and_patch;
mod compare;
#[path = "../support/damage.rs"]
mod damage;
mod damaged;
mod deadlines;
mod defects;
mod faces;
mod formats;
mod guesses;
mod holes;
mod internal_sheets;
mod intersections;
mod limits;
mod lost;
mod mend;
#[path = "../support/meshes.rs"]
mod meshes;
mod objects;
mod operators;
mod options;
mod orient;
mod part_accounting;
mod pipeline;
mod print;
mod printable;
mod process;
#[allow(dead_code, reason = "shared with the tests of the documents")]
#[path = "../support/prose.rs"]
mod prose;
mod remesh;
mod render;
mod sheets;
mod simplify;
mod solid;
mod stitch;
mod support;
mod thickening;
mod threads;
mod unions;
mod verify;
mod walls;
