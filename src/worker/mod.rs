//! Workers: claim a job, run it in a child process under limits, keep the lease alive, publish the result.
//!
//! ```text
//! pool (slots) -> attempt (one claim) -> process (the child and its group) -> child (sandbox, then work: the engine, in there)
//! ```

mod attempt;
mod child;
mod crash;
mod drawing;
mod errand;
mod failpoint;
mod files;
mod inside;
mod limits;
mod patience;
mod pool;
mod probe;
mod process;
mod scratch;
mod stages;
mod sweep;
mod task;
mod usage;
mod warm_up;
mod work;

pub use failpoint::pause_at;
pub use inside::run_inside;
pub use limits::ProcessLimits;
pub use pool::{Pool, PoolError, Shutdown, WorkerConfig};
pub use sweep::Retention;
