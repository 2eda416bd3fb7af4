//! Workers: claim a job, run it in a child process under limits, keep the lease alive, publish the result.
//!
//! ```text
//! pool (slots) -> attempt (one claim) -> process (the child and its group) -> child (sandbox, then work: the engine, in there)
//! ```

mod attempt;
mod child;
mod child_request;
mod context;
mod drawing;
mod pool;
mod process;
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

/// Does what a worker started this process for, by the arguments after the program's name; none where nobody's worker did. To be
/// called before anything else: there must be one thread, and a process that lives for a few milliseconds has none to spare.
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
