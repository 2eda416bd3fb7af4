//! Workers: claim a job, run it in a child process under limits, extend the lease, publish the result.
//!
//! ```text
//! pool (slots) -> attempt (one claim) -> process (the child and its group) -> child (enters the sandbox and runs the engine)
//! ```

mod attempt;
mod child;
mod child_request;
mod context;
mod drawing;
mod files;
mod pool;
mod prepared;
mod process;
mod reporter;
mod scratch;
mod task;

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use child::run_job;
use child_request::{run_trial, run_warm_up};
pub use context::{Retention, Shutdown, WorkerConfig};
pub use pool::{Pool, PoolError};
use task::{JOB, TRIAL, WARM_UP};

/// Runs as a worker's child process if `arguments` (without the program's name) say so; `None` otherwise.
///
/// Call it first in `main`: entering the sandbox requires a single thread, and the child must start within milliseconds.
#[must_use]
pub fn run_child(arguments: impl IntoIterator<Item = OsString>) -> Option<ExitCode> {
    let mut arguments = arguments.into_iter();
    let (verb, folder) = (arguments.next()?, arguments.next()?);
    let run: fn(&Path) -> ExitCode = match verb.to_str()? {
        JOB => run_job,
        TRIAL => run_trial,
        WARM_UP => run_warm_up,
        _ => return None,
    };
    Some(run(Path::new(&folder)))
}
