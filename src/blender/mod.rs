//! Tier 3: Blender as a process of its own, with its script, its scratch folder and its deadline.
//!
//! [`BlenderRemesher::find`] looks for a program, either Blender or a Python with `bpy`; [`BlenderRemesher`] then
//! implements [`Remesher`](crate::repair::Remesher). One run is one straight line:
//!
//! ```text
//! soup -> frame (centred, scaled) -> estimate -> exchange file -> process + script.py -> exchange file -> frame -> soup
//! ```
//!
//! What is promised of a run, whatever the program does: it ends by its deadline, nothing of it lives on, it sees no
//! environment and no user profile but its scratch folder, and its result is read as hostile input.

mod estimate;
mod exchange;
mod find;
mod frame;
mod on_demand;
mod process;
mod remesher;
mod strays;

pub use find::{BlenderConfig, BlenderMissing, Rejected};
pub use on_demand::OnDemandBlender;
pub use remesher::BlenderRemesher;
