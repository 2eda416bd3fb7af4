//! The operators: one file each, each with its parameters, precondition, result and what it leaves unfixed.
//!
//! [`Operator`] names them, says what each claims to fix and may do on the way, and runs one by its name with the parameters
//! that the options give it.

mod border;
mod claims;
mod clear;
mod counts;
mod name;
mod rounding;
mod run;

pub mod base;
pub mod clean_and_patch;
pub mod cut;
pub mod debris;
pub mod degenerate;
pub mod duplicates;
pub mod fins;

pub mod foldovers;
pub mod holes;
pub mod join;
mod local;
pub mod membranes;
pub mod merge;
pub mod one_sided;
mod open_parts;
pub mod orient;
pub mod overlaps;
mod places;
pub mod quantise;
pub mod remesh;
pub mod resolve;
pub mod separate;
pub mod sew;
pub mod sheets_within;
pub mod simplify;
pub mod slivers;
pub mod small_parts;
pub mod stitch;
pub mod t_junctions;
pub mod thicken;
mod walls;
pub mod weld;

pub use counts::{Counter, Counts};
pub use name::Operator;
pub(super) use open_parts::OpenParts;
use open_parts::open_parts;
pub(super) use run::Scope;

use super::Change;

/// What an operator did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Applied {
    /// What it changed, counted.
    pub changes: Vec<Change>,
    /// The farthest that it moved a vertex, in the model's unit, hole patches apart; 0 where every vertex is where it was.
    pub moved: f64,
    /// What it left and why, in words.
    pub left: Option<String>,
    /// Why it did nothing at all, where it should have.
    pub failed: Option<String>,
    /// What kept it from following an option to the full: the option's name and the reason.
    pub limited: Vec<(&'static str, String)>,
    /// Faces that it could not fix, of the surface as it left it.
    pub unfixed: Vec<u32>,
    /// The edge of the cells of a remesh, in the model's unit.
    pub voxel_size: Option<f64>,
    /// Whether the time was over before it had done all that it could.
    pub is_late: bool,
}

impl From<Vec<Change>> for Applied {
    fn from(changes: Vec<Change>) -> Self {
        Self { changes, ..Self::default() }
    }
}
