//! The protocol between a worker and its child process: the task, its files, and the child's confinement.

use std::io;
use std::path::Path;
use std::time::Duration;

use rlimit::Resource;
use serde::{Deserialize, Serialize};

use crate::blender::BlenderConfig;
use crate::format::Limits;
use crate::jobs::{Artifact, Input, JobOptions, JobProgress};
use crate::repair::{OfferedFile, RemesherInfo};
use crate::sandbox::Sandbox;

// The verbs with which a worker starts this program; each is followed by the path of the scratch folder.

/// Runs or draws a job.
pub(super) const JOB: &str = "job-child";
/// Tries the actions that the sandbox must prevent.
pub(super) const TRIAL: &str = "sandbox-trial";
/// Runs Blender once on a small model.
pub(super) const WARM_UP: &str = "warm-up-child";

/// The first line of JSON on a job child's standard input: how to confine itself. The child enters its sandbox at once, and then
/// waits for the line with its [`Task`], which may come much later. If the pipe closes instead, the child ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ChildSetup {
    /// Resource limits and the sandbox.
    pub confinement: Confinement,
    /// The settings of tier 3, if the task may need it: the sandbox then permits access to the lock files of Blender's slots.
    pub blender: Option<BlenderConfig>,
}

impl ChildSetup {
    /// Applies the resource limits to this process, and enters the sandbox with `folder` as the writable folder. The process
    /// must have a single thread, and must not have read untrusted bytes yet.
    ///
    /// # Errors
    /// When a limit can't be set, or the sandbox can't be entered.
    pub fn enter(&self, folder: &Path) -> io::Result<()> {
        self.confinement.limits.apply()?;
        let mut sandbox = self.confinement.sandbox.clone();
        if let Some(blender) = &self.blender {
            sandbox.readable.push(blender.prepare_slots()?);
        }
        sandbox.enter(folder)
    }
}

/// The task of a child process: one line of JSON on its standard input. The pipe then serves as a lifeline: when it closes, the
/// worker is gone, and the child ends its process group.
///
/// The [`input`](Self::input) files lie in the scratch folder, and the child writes its files there. It writes
/// [`MODEL`](Self::MODEL) if it has a result, then [`FULL_REPORT`](Self::FULL_REPORT), whose presence means that the work is done.
/// With the option `alternatives` it also writes the files of each alternative, and the report again after the last one.
/// It writes [`LOG`](Self::LOG), and [`PROBLEM`](Self::PROBLEM) if the job itself is to blame. A task with `draw` finds
/// [`MODEL`](Self::MODEL) in the folder and writes only pictures. On standard output the child writes one [`JobProgress`] a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Task {
    /// The files to work on, in the order they were sent.
    pub inputs: Vec<Input>,
    /// The mode and its options.
    pub options: JobOptions,
    /// For a job whose pictures are to be drawn: the file that the job offers. `None` for a job to run.
    pub draw: Option<OfferedFile>,
    /// Limits of the file readers.
    pub limits: Limits,
    /// The CPU time that the child may use.
    pub cpu: Duration,
    /// Whether this is the first attempt. Tests' failpoints apply to first attempts only.
    pub first_attempt: bool,
    /// The number of threads that run the job.
    pub threads: usize,
    /// The remesher of tier 3, if there is one.
    pub remesher: Option<RemesherInfo>,
    /// The settings of tier 3.
    pub blender: BlenderConfig,
}

/// The resource limits and the sandbox of a child process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Confinement {
    /// Limits that the kernel counts for each process.
    pub limits: ProcessLimits,
    /// The sandbox to enter.
    pub sandbox: Sandbox,
}

/// A line of the child's standard output.
pub(super) type ProgressLine = JobProgress;

impl Task {
    /// The name of the repaired model's file.
    pub const MODEL: &str = Artifact::MODEL;
    /// The name of the artifact with the uploaded file, offered if no repair improved the model.
    pub const ORIGINAL: &str = "original";
    /// The name of the full report, which the child writes.
    pub const FULL_REPORT: &str = "report-full.json";
    /// The name of the abridged report, which the worker derives from the full report.
    pub const REPORT: &str = "report.json";
    /// The name of the log.
    pub const LOG: &str = "log.txt";
    /// The name of the file with the [`JobProblem`](crate::jobs::JobProblem) that ended the job.
    pub const PROBLEM: &str = "problem.json";

    /// The child's exit code when it wrote [`PROBLEM`](Self::PROBLEM).
    pub const EXIT_PROBLEM: u8 = 2;

    /// The largest size of a report, in bytes.
    pub const REPORT_BYTES: usize = 16 << 20;

    /// How long the work may take.
    pub fn deadline(&self) -> Duration {
        deadline(&self.options)
    }

    /// The name of uploaded file `number`, counted from 0, in the folder.
    pub fn input(number: usize) -> String {
        format!("input-{number}")
    }

    /// The name of a drawing of the job's file `number`, counted from 0. The first file's drawing keeps `name`; the others get a
    /// prefix, such as `2-defects.png`.
    pub fn drawing(number: usize, name: &str) -> String {
        if number == 0 { name.to_owned() } else { format!("{}-{name}", number + 1) }
    }
}

/// The longest deadline of a job.
pub(super) const MAX_DEADLINE: Duration = Duration::from_secs(3600);

/// The deadline that a job's options set, within the bounds of deadlines.
pub(super) fn deadline(options: &JobOptions) -> Duration {
    Duration::from_secs_f64(options.deadline_s().clamp(1.0, MAX_DEADLINE.as_secs_f64()))
}

/// The most files that a process may have open.
const OPEN_FILES: u64 = 1024;

/// Limits on a child process and on each process it starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ProcessLimits {
    /// Address space, in bytes.
    pub memory_bytes: u64,
    /// Largest file that it may write, in bytes.
    pub file_bytes: u64,
    /// CPU time.
    pub cpu: Duration,
}

impl ProcessLimits {
    /// Applies the limits to the calling process; processes that it starts inherit them.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn apply(&self) -> io::Result<()> {
        Self::lower(Resource::AS, self.memory_bytes)?;
        Self::lower(Resource::FSIZE, self.file_bytes)?;
        Self::limit_cpu(self.cpu)?;
        Self::lower(Resource::NOFILE, OPEN_FILES)?;
        Self::lower(Resource::CORE, 0)
    }

    /// Limits the CPU time of the calling process; a limit that is lower already stays.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn limit_cpu(time: Duration) -> io::Result<()> {
        Self::lower(Resource::CPU, time.as_secs().max(1))
    }

    /// Sets the soft and the hard limit, never above the current hard limit.
    fn lower(resource: Resource, value: u64) -> io::Result<()> {
        let (_, hard) = resource.get()?;
        let value = value.min(hard);
        resource.set(value, value)
    }
}

/// A named point at which a test can pause this process, by the variable `FAILPOINTS` of the crate `fail`. Without the feature
/// `failpoints` it does nothing. Besides that crate's actions, `return(PATH)` waits until the file PATH exists.
pub(super) fn pause_at(_name: &str) {
    fail::fail_point!(_name, |gate: Option<String>| {
        while !std::fs::exists(gate.as_deref().unwrap_or_default()).is_ok_and(|is_open| is_open) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    });
}

/// The same inside an async task, whose other parts, such as heartbeats, keep running.
pub(super) async fn pause_alone_at(name: &'static str) {
    if cfg!(feature = "failpoints") {
        let _ = tokio::task::spawn_blocking(move || pause_at(name)).await;
    }
}
