//! The state that all attempts of a worker process share: its stores, configuration, scratch folder and sandbox. Also
//! retries with backoff.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use rustix::process::Pid;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::prepared::{PreparedChild, PreparedChildren};
use super::process::{Excess, JobProcess, SharedLimits};
use super::scratch::Scratch;
use super::task::{ChildSetup, Confinement, JOB, MAX_DEADLINE, ProcessLimits, Task, deadline};
use crate::blender::BlenderConfig;
use crate::blobs::{BlobError, Blobs, free_bytes};
use crate::format::Limits;
use crate::jobs::{Job, Store, StoreError};
use crate::repair::{OfferedFile, RemesherInfo, promised_overrun};
use crate::sandbox::{Sandbox, SandboxMode, SandboxStatus};

/// The mechanism reported for the limit on processes where the worker counts them instead of the kernel.
pub(super) const WORKER_COUNT: &str = "worker";

/// How workers run jobs.
#[derive(Debug, Clone)]
pub struct WorkerConfig {
    /// The program to start for a job's child process: this program.
    pub program: PathBuf,
    /// The folder that jobs must not read: the database, the files, the scratch folders of others.
    pub private: PathBuf,
    /// The folder in which each worker process makes its scratch folder.
    pub scratch: PathBuf,
    /// The number of jobs that run at the same time.
    pub slots: usize,
    /// The number of jobs of one tenant that may run at the same time, unless the tenant has its own limit.
    pub max_running: u32,
    /// How long results, and then the records of jobs, are kept.
    pub retention: Retention,
    /// Free bytes required on the disks of the files and of the scratch folder to start a job.
    pub min_free: u64,
    /// How long a lease lasts without a heartbeat.
    pub lease: Duration,
    /// How often to look for work when no notification arrives.
    pub poll: Duration,
    /// Most address space of each process of a job, in bytes.
    pub job_memory: u64,
    /// Largest file that a job may write, in bytes.
    pub job_file: u64,
    /// Most that a job may write into its scratch folder, in bytes.
    pub job_scratch: u64,
    /// Most processes and threads of a job.
    pub job_processes: u64,
    /// What to do where the kernel can't provide every protection.
    pub sandbox: SandboxMode,
    /// Files and folders that a job may read besides those of the system and of Blender.
    pub readable: Vec<PathBuf>,
    /// How long a job's processes may run past the latest planned end of a repair before they are killed. That end is the deadline
    /// plus 2 s and 10 %.
    pub deadline_grace: Duration,
    /// Limits of the file readers.
    pub limits: Limits,
    /// The remesher of tier 3, if there is one.
    pub remesher: Option<RemesherInfo>,
    /// The settings of tier 3.
    pub blender: BlenderConfig,
    /// Whether each idle slot keeps a child process that waits for a task.
    pub prepared_children: bool,
    /// Whether to run Blender once on a small model at the start.
    pub blender_warm_up: bool,
}

/// How long a job's data is kept after its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// How long its files and its report are kept.
    pub results: Duration,
    /// How long its record is kept: that it existed, and how it ended.
    pub jobs: Duration,
}

/// The two steps of a shutdown.
#[derive(Debug, Clone, Default)]
pub struct Shutdown {
    /// Claim no new jobs; finish the running ones.
    pub drain: CancellationToken,
    /// Stop at once: kill the running jobs' processes and release the jobs.
    pub now: CancellationToken,
}

/// Why an attempt failed for a reason outside the job.
#[derive(Debug, thiserror::Error)]
pub(super) enum AttemptError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("could not read {0} from the repair process: {1}")]
    Json(&'static str, serde_json::Error),
}

/// The largest size of a job's files, in bytes, for which one thread runs the job: waking others takes longer than they save.
const FOR_ONE_THREAD: u64 = 256 << 10;

/// The number of threads for a job with files of this size, on a machine with this many processors: an equal share of the
/// processors for each busy slot, so that a single large job uses the machine and a full queue one processor for each job.
fn threads(bytes: u64, processors: usize, busy_slots: usize) -> usize {
    if bytes <= FOR_ONE_THREAD { 1 } else { (processors / busy_slots.max(1)).max(1) }
}

/// The state that all attempts of a worker process share.
pub(super) struct WorkerContext {
    /// The worker process's name, unique among all workers.
    pub name: String,
    /// The database.
    pub store: Arc<dyn Store>,
    /// The file store.
    pub blobs: Blobs,
    /// The settings.
    pub config: WorkerConfig,
    /// The scratch folder.
    pub scratch: Scratch,
    /// The sandbox of every job.
    pub sandbox: Sandbox,
    /// The child processes that wait for a task.
    pub prepared: PreparedChildren,
    /// The number of slots that run a job or draw pictures.
    pub busy_slots: AtomicUsize,
    /// The protections found by the sandbox trial; `None` before the trial.
    pub status: Option<SandboxStatus>,
}

impl WorkerContext {
    /// The confinement of a child process that may run for `longest`: CPU time for that long on every core.
    pub(super) fn confinement(&self, longest: Duration) -> Confinement {
        let cores = u32::try_from(std::thread::available_parallelism().map_or(1, usize::from)).unwrap_or(1);
        let limits = ProcessLimits {
            memory_bytes: self.config.job_memory,
            file_bytes: self.config.job_file,
            // A second limit besides the deadline, for a process that leaves its group.
            cpu: longest * cores + Duration::from_secs(5),
        };
        Confinement { limits, sandbox: self.sandbox.clone() }
    }

    /// Waits until a job's processes exceed a shared limit, and returns which one; `None` at the time limit of the job. Files
    /// that are in `folder` at the start do not count.
    pub(super) async fn wait_for_excess(&self, job: &Job, folder: &Path, group: Pid) -> io::Result<Option<Excess>> {
        let model = job.artifacts.get(Task::MODEL).and_then(|model| Some(model.file.as_ref()?.bytes));
        let given = job.inputs.iter().map(|input| input.bytes).chain(model).sum();
        let worker_counts = |status: &SandboxStatus| status.protections.processes.mechanisms == [WORKER_COUNT];
        let limits = SharedLimits {
            scratch_bytes: self.config.job_scratch.saturating_add(given),
            processes: self.status.as_ref().is_some_and(worker_counts).then_some(self.config.job_processes),
        };
        limits.wait_for_excess(self.time_limit(job), folder, group).await
    }

    /// The task of a job's child process: to run the job, or, with `draw`, to draw the pictures of that file.
    pub(super) fn task(&self, job: &Job, attempt: u32, draw: Option<OfferedFile>) -> Task {
        let config = &self.config;
        Task {
            inputs: job.inputs.clone(),
            options: job.options.clone(),
            draw,
            limits: config.limits,
            cpu: self.confinement(self.time_limit(job)).limits.cpu,
            first_attempt: attempt == 1,
            threads: threads(
                job.inputs.iter().map(|input| input.bytes).sum(),
                std::thread::available_parallelism().map_or(1, usize::from),
                self.busy_slots.load(Ordering::Relaxed),
            ),
            remesher: config.remesher.clone().filter(|_| draw.is_none()),
            blender: config.blender.clone(),
        }
    }

    /// The time after which a job's processes are killed. A repair that keeps its own deadline ends before.
    fn time_limit(&self, job: &Job) -> Duration {
        self.longest_run(deadline(&job.options))
    }

    /// The same for a job with this deadline.
    fn longest_run(&self, deadline: Duration) -> Duration {
        deadline + promised_overrun(deadline) + self.config.deadline_grace
    }

    /// Whether a job's processes may leave their process group, because no protection prevents it.
    pub(super) fn may_leave_group(&self) -> bool {
        self.status.as_ref().is_none_or(|status| !status.protections.system_calls.enforced)
    }

    /// The free bytes of the disk that has the least.
    ///
    /// # Errors
    /// The same number, if it is too small to start a job.
    pub(super) fn check_free_space(&self) -> Result<u64, u64> {
        let scratch = free_bytes(&self.config.scratch).ok();
        let files = self.blobs.free_bytes().ok().flatten();
        let free = [scratch, files].into_iter().flatten().min().unwrap_or(u64::MAX);
        if free < self.config.min_free { Err(free) } else { Ok(free) }
    }

    /// A child process for one task: one that waits, or a new one if none waits.
    ///
    /// # Errors
    /// When the scratch folder can't be created or the process can't be started.
    pub(super) fn child(&self) -> io::Result<PreparedChild> {
        self.prepared.take().map_or_else(|| self.start_child(), Ok)
    }

    /// Starts one more child that waits, unless one waits for each slot already. A failure is logged only, since a job starts
    /// its own child where none waits.
    pub(super) fn prepare_child(&self) {
        let max = if self.config.prepared_children { self.config.slots } else { 0 };
        if let Err(error) = self.prepared.refill(max, || self.start_child()) {
            tracing::warn!(%error, "could not start a child process ahead");
        }
    }

    fn start_child(&self) -> io::Result<PreparedChild> {
        let scratch = self.scratch.attempt()?;
        let setup = ChildSetup {
            confinement: self.confinement(self.longest_run(MAX_DEADLINE)),
            blender: self.config.remesher.as_ref().map(|_| self.config.blender.clone()),
        };
        let process = JobProcess::start(&self.config.program, JOB, scratch.path(), &setup)?;
        Ok(PreparedChild { scratch, process })
    }
}

/// How long to retry an operation that an attempt needs to start or to end.
const RETRY_TIME: Duration = Duration::from_secs(600);

/// An error that may be transient.
pub(super) trait Transient: Display {
    /// Whether a retry may succeed.
    fn is_transient(&self) -> bool;
}

impl Transient for StoreError {
    fn is_transient(&self) -> bool {
        self.is_transient()
    }
}

impl Transient for BlobError {
    fn is_transient(&self) -> bool {
        self.is_transient()
    }
}

/// Runs `work`, and retries with backoff while its error is transient, for ten minutes at most. Failing earlier would waste
/// the work that is already done. Stops between two tries when `stop` is cancelled.
pub(super) async fn retry_with_backoff<T, E, F>(stop: Option<&CancellationToken>, work: impl Fn() -> F) -> Result<T, E>
where
    E: Transient,
    F: Future<Output = Result<T, E>>,
{
    let until = Instant::now() + RETRY_TIME;
    let mut pause = Duration::from_millis(100);
    loop {
        match work().await {
            Err(error)
                if error.is_transient()
                    && Instant::now() < until
                    && !stop.is_some_and(CancellationToken::is_cancelled) =>
            {
                tracing::warn!(%error, "transient failure; retrying");
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
            result => return result,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lone_large_job_uses_the_machine_and_a_full_queue_one_processor_for_each_job() {
        let [small, large] = [FOR_ONE_THREAD, FOR_ONE_THREAD + 1];
        assert_eq!([1, 2, 4, 16, 99].map(|busy_slots| threads(large, 16, busy_slots)), [16, 8, 4, 1, 1]);
        assert_eq!((threads(small, 16, 1), threads(large, 16, 0)), (1, 16));
    }
}
