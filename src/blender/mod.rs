//! Tier 3: Blender as a process of its own, with its script, its scratch folder and its deadline.
//!
//! [`BlenderRemesher::find`] looks for a program, either Blender or a Python with `bpy`; [`BlenderRemesher`] then
//! implements [`Remesher`](crate::repair::Remesher). One run is one straight line:
//!
//! ```text
//! soup -> frame (centred, scaled) -> estimate -> exchange file -> slot -> process + script.py -> exchange file -> frame -> soup
//! ```
//!
//! What is promised of a run, whatever the program does: it ends by its deadline, nothing of it lives on, it sees no
//! environment and no user profile but its scratch folder, and its result is read as hostile input.
//!
//! Never more run at once on the machine than memory allows: each holds a slot, a locked file, and waits for one
//! where none is free. The time that it waits is its job's. A program that crashes in a voxel remesh is started again
//! once with larger voxels; a boolean is not, since the plan goes on to the remesh; nothing is started again that ran out of
//! time. What a run had finished when it was stopped is its result.

mod convert;
mod estimate;
mod exchange;
mod find;
mod frame;
mod installation;
mod on_demand;
mod process;
mod remesher;
mod slots;
mod warm_up;

pub use find::{BlenderConfig, BlenderMissing, Rejected};
pub use installation::installation;
pub use on_demand::OnDemandBlender;
pub use remesher::BlenderRemesher;
pub use warm_up::{Warmth, warm_up};
