//! Repair: operators (one file each), presets and the plan as data, and the pipeline on one page.
//!
//! [`repair`] is the way in. The operators of tier 1 are [`weld`], [`duplicates`], [`degenerate`], [`orient`] and
//! [`holes`], those of tier 2 [`cut`], [`mod@resolve`], [`debris`] and [`mod@separate`]; they work on a
//! [`crate::mesh::Surface`] and answer what they changed as [`Change`]s.

mod category;
mod climb;
pub mod cut;
pub mod debris;
pub mod degenerate;
mod drawings;
pub mod duplicates;
pub mod holes;
mod input;
mod options;
pub mod orient;
mod outside;
mod pipeline;
mod plan;
mod presets;
pub mod quantise;
mod red_flags;
mod remesher;
mod report;
pub mod resolve;
pub mod separate;
pub mod sheets;
mod summary;
mod tiers;
mod triangulate;
mod verdict;
mod walls;
pub mod weld;

pub use crate::context::{Cancelled, Context, NoProgress, Progress, Stage, monotonic_clock};
pub use crate::inspect::OptionsError;
pub use category::categorise;
pub use drawings::{DrawError, draw};
pub use options::{Options, OutputFormat, Preset};
pub use pipeline::{RepairError, Repaired, repair};
pub use plan::make_plan;
pub use red_flags::{Standing, red_flags};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::*;
