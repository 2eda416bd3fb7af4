//! The repair operators, one file or folder for each operator or small group of related operators.
//!
//! Each operator documents its parameters, precondition, result and the defects it leaves. Its `Operation` states which
//! counters it lowers and derives its parameters from the options. [`Operator`] names the operators, and `list.rs` runs
//! them by name. No operator imports `list.rs` or this file.

mod border;
mod face_pairs;
mod free_positions;
mod layer_union;
mod list;
mod local_edits;
mod operator;
mod ray_caster;
mod round_at_once;
mod rounding;

pub mod base;
pub mod clean_and_patch;
pub mod cut_non_orientable;
pub mod debris;
pub mod degenerate;
pub mod duplicates;
mod fill_interior;
pub mod foldovers;
pub mod holes;
pub mod internal_faces;
mod islands;
pub mod join;
pub mod orient;
pub mod perturb;
pub mod remesh;
pub mod self_union;
pub mod sheets;
pub mod slivers;
pub mod solid_skin;
pub mod split_non_manifold;
pub mod stitch;
mod struts;
pub mod t_junctions;
pub mod thicken;
mod thicken_walls;
mod voids;
pub mod weld;

pub use super::options::Operator;
pub(super) use operator::Scope;
pub use operator::{Applied, Counter, Counts, Failure};
