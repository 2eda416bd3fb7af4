//! Workers: claim a job, run it in a child process under limits, keep the lease alive, publish the result.
//!
//! ```text
//! pool (slots) -> attempt (one claim) -> process (the child and its group) -> child (work: the engine, in there)
//! ```

mod attempt;
mod child;
mod crash;
mod failpoint;
mod files;
mod limits;
mod patience;
mod pool;
mod process;
mod scratch;
mod sweep;
mod task;
mod work;

pub use child::run_child;
pub use failpoint::pause_at;
pub use limits::ProcessLimits;
pub use pool::{Pool, Shutdown, WorkerConfig};
