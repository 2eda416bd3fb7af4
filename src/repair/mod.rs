//! Repair: operators (one file each), presets and the plan as data, and the pipeline on one page.

mod context;
mod options;
mod remesher;
mod report;

pub use context::{Cancelled, Context, NoProgress, Progress, Stage, monotonic_clock};
pub use options::{Options, OptionsError, OutputFormat, Preset};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::*;
