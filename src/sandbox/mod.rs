//! The walls around a job: a process puts itself in before it touches a stranger's bytes, and whatever it starts is in there too.
//!
//! Three layers, each of which holds without the others, and each of which a kernel or a container may refuse:
//!
//! ```text
//! namespaces (no network, no capabilities, a count of processes) -> Landlock (files, signals) -> seccomp (system calls)
//! ```
//!
//! What is refused is told, not hidden: [`Trial`] enters the sandbox and tries what must fail, and [`Walls`] says what came of it.
//! [`processes`] finds and ends what a run leaves behind where no wall holds it back.

mod layers;
pub mod processes;
mod seccomp;
mod trial;

pub use layers::{Sandbox, SandboxMode};
pub use trial::{Protection, SandboxStatus, Trial, Walls};
