//! What a worker and its child process agree on: the task, its files, and what holds the process.

use std::io;
use std::time::Duration;

use rlimit::Resource;
use serde::{Deserialize, Serialize};

use crate::blender::BlenderConfig;
use crate::format::Limits;
use crate::jobs::{Input, JobOptions, JobProgress};
use crate::repair::{OfferedFile, RemesherInfo};
use crate::sandbox::Sandbox;

/// What a worker starts this program for; each is followed by the scratch folder with what it needs.
pub(super) const JOB: &str = "job-child";
pub(super) const TRIAL: &str = "sandbox-trial";
pub(super) const WARM_UP: &str = "warm-up-child";

/// What a worker tells its child process: a line of JSON on its standard input. That is then a lifeline: when it closes, the worker is
/// gone, and the child ends its process group.
///
/// The [`input`](Self::input) files lie in the scratch folder. The child leaves its files there too: [`MODEL`](Self::MODEL) where there is one, then
/// [`FULL_REPORT`](Self::FULL_REPORT), which says that the work is done; [`LOG`](Self::LOG), and [`PROBLEM`](Self::PROBLEM) where
/// the input is to blame. Where pictures are all that it is to make, [`MODEL`](Self::MODEL) lies there too, and it leaves nothing but them. On standard output it writes one [`JobProgress`] a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Task {
    pub inputs: Vec<Input>,
    pub options: JobOptions,
    /// Where the job was done before and its pictures are to be drawn: the file that it handed out.
    pub draw: Option<OfferedFile>,
    pub limits: Limits,
    pub confinement: Confinement,
    pub remesher: Option<RemesherInfo>,
    pub blender: BlenderConfig,
}

/// What holds a process that a worker starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Confinement {
    pub limits: ProcessLimits,
    pub sandbox: Sandbox,
}

/// A line of the child's standard output.
pub(super) type ProgressLine = JobProgress;

impl Task {
    pub const MODEL: &str = "model";
    /// The upload as it came, where nothing made it better.
    pub const ORIGINAL: &str = "original";
    /// The whole report, as the child leaves it.
    pub const FULL_REPORT: &str = "report-full.json";
    /// The abridged report, which the worker makes of the whole one.
    pub const REPORT: &str = "report.json";
    pub const LOG: &str = "log.txt";
    pub const PROBLEM: &str = "problem.json";

    /// The child's exit code for a problem with the input, described in [`PROBLEM`](Self::PROBLEM).
    pub const EXIT_PROBLEM: u8 = 2;

    /// Most bytes of a report.
    pub const REPORT_BYTES: usize = 16 << 20;

    /// The name of an uploaded file in the folder.
    pub fn input(number: usize) -> String {
        format!("input-{number}")
    }

    /// The name of a drawing of the job's file `number`, counted from 0: as it is for the first, `2-defects.png` and so on for the
    /// others.
    pub fn drawing(number: usize, name: &str) -> String {
        if number == 0 { name.to_owned() } else { format!("{}-{name}", number + 1) }
    }
}

/// Most files that a process may have open.
const OPEN_FILES: u64 = 1024;

/// What one job's child process, and each process it starts, may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ProcessLimits {
    /// Address space, in bytes.
    pub memory_bytes: u64,
    /// Largest file it may write, in bytes.
    pub file_bytes: u64,
    /// Processor time.
    pub cpu: Duration,
}

impl ProcessLimits {
    /// Puts the limits on the calling process; what it starts inherits them.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn apply(&self) -> io::Result<()> {
        Self::lower(Resource::AS, self.memory_bytes)?;
        Self::lower(Resource::FSIZE, self.file_bytes)?;
        Self::lower(Resource::CPU, self.cpu.as_secs().max(1))?;
        Self::lower(Resource::NOFILE, OPEN_FILES)?;
        Self::lower(Resource::CORE, 0)
    }

    /// Sets soft and hard limit, never above the hard limit that is there already.
    fn lower(resource: Resource, value: u64) -> io::Result<()> {
        let (_, hard) = resource.get()?;
        let value = value.min(hard);
        resource.set(value, value)
    }
}

/// A named place at which a test can make this process pause, by the variable `FAILPOINTS` of the crate `fail`; nothing
/// at all unless the feature `failpoints` is on. Beside that crate's own actions, `return(PATH)` waits until there is such a file.
pub(super) fn pause_at(_name: &str) {
    fail::fail_point!(_name, |gate: Option<String>| {
        while !std::fs::exists(gate.as_deref().unwrap_or_default()).is_ok_and(|is_open| is_open) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    });
}

/// The same in the midst of a task of which other parts, such as heartbeats, go on.
pub(super) async fn pause_alone_at(name: &'static str) {
    if cfg!(feature = "failpoints") {
        let _ = tokio::task::spawn_blocking(move || pause_at(name)).await;
    }
}
