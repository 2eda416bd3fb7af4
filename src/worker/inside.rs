use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use super::child::run_child;
use super::probe::run_trial;
use super::warm_up::run_warm_up;

/// What a worker starts this program for; each is followed by the scratch folder with what it needs.
pub(super) const JOB: &str = "job-child";
pub(super) const TRIAL: &str = "sandbox-trial";
pub(super) const WARM_UP: &str = "warm-up-child";

/// Does what a worker started this process for, by the arguments after the program's name; none where nobody's worker did. To be
/// called before anything else: there must be one thread, and a process that lives for a few milliseconds has none to spare.
#[must_use]
pub fn run_inside(arguments: impl IntoIterator<Item = OsString>) -> Option<ExitCode> {
    let mut arguments = arguments.into_iter();
    let (verb, folder) = (arguments.next()?, arguments.next()?);
    let run: fn(&Path) -> ExitCode = match verb.to_str()? {
        JOB => run_child,
        TRIAL => run_trial,
        WARM_UP => run_warm_up,
        _ => return None,
    };
    Some(run(Path::new(&folder)))
}
