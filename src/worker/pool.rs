use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rustix::process::Pid;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::field::Empty;
use tracing::{Instrument, Span};

use super::ProcessLimits;
use super::attempt::Attempt;
use super::drawing::draw;
use super::probe::probe;
use super::scratch::Scratch;
use super::sweep::{EVERY, Retention, sweep};
use super::task::{Confinement, Task};
use super::usage::{Allowance, Excess};
use super::warm_up::warm_blender_up;
use crate::blender::{BlenderConfig, installation};
use crate::blobs::{Blobs, free_bytes};
use crate::format::Limits;
use crate::jobs::{Claim, Job, Store};
use crate::repair::{HandedOut, RemesherInfo, promised_overrun};
use crate::sandbox::{Protection, Sandbox, SandboxMode, SandboxStatus};
use crate::telemetry;

/// What counts a job's processes where the kernel does not.
const COUNTED_HERE: &str = "worker";

/// How workers run jobs.
#[derive(Debug, Clone)]
pub struct WorkerConfig {
    /// The program to start for a job's child process: this one.
    pub program: PathBuf,
    /// The folder that holds what no job may see: the database, the files, the scratch folders of others.
    pub private: PathBuf,
    /// Where scratch folders go.
    pub scratch: PathBuf,
    /// Jobs that run at the same time.
    pub slots: usize,
    /// Jobs of one tenant that may run at the same time, where nothing else is set for it.
    pub max_running: u32,
    /// How long results are kept after the end of their job, and then what is known of the job.
    pub retention: Retention,
    /// Bytes that must be free on the disks of the files and of the scratch folder for a job to be begun.
    pub min_free: u64,
    /// How long a claim holds without a heartbeat.
    pub lease: Duration,
    /// How long to wait before looking for work that no bell told of.
    pub poll: Duration,
    /// Most address space of a job's process, in bytes.
    pub job_memory: u64,
    /// Largest file that a job may write, in bytes.
    pub job_file: u64,
    /// Most that a job may write into its scratch folder, in bytes.
    pub job_scratch: u64,
    /// Most processes and threads of a job.
    pub job_processes: u64,
    /// What to do where the kernel can't wall jobs off.
    pub sandbox: SandboxMode,
    /// Files and folders that a job may read beside those of the system and of Blender.
    pub readable: Vec<PathBuf>,
    /// Time after which a job's processes are killed, beyond its deadline and the 2 s and 10 % within which a repair keeps that.
    pub deadline_grace: Duration,
    /// What a reader may spend.
    pub limits: Limits,
    /// Tier 3, where there is one.
    pub remesher: Option<RemesherInfo>,
    /// What tier 3 may use.
    pub blender: BlenderConfig,
    /// Run Blender once on a small model at the start.
    pub blender_warm_up: bool,
}

/// Why there is no pool.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// The scratch folder can't be used.
    #[error("the scratch folder: {0}")]
    Scratch(#[from] std::io::Error),
    /// The sandbox can't be had.
    #[error("the sandbox for jobs: {0}")]
    Sandbox(std::io::Error),
}

/// The two steps of stopping.
#[derive(Debug, Clone, Default)]
pub struct Shutdown {
    /// Take no new work; finish what runs.
    pub drain: CancellationToken,
    /// Stop at once: kill what runs and hand it back.
    pub now: CancellationToken,
}

/// A number of workers in one process that share a store.
pub struct Pool {
    pub(super) name: String,
    pub(super) store: Arc<dyn Store>,
    pub(super) blobs: Blobs,
    pub(super) config: WorkerConfig,
    pub(super) scratch: Scratch,
    sandbox: Sandbox,
    status: Option<SandboxStatus>,
}

impl Pool {
    /// Makes the scratch folder, removes those of workers that are gone, and tries the sandbox that jobs will run in.
    ///
    /// # Errors
    /// When the scratch folder can't be made, or when the sandbox is required and can't be had.
    pub async fn new(store: Arc<dyn Store>, blobs: Blobs, config: WorkerConfig) -> Result<Self, PoolError> {
        let name = format!("worker-{}-{}", std::process::id(), &uuid::Uuid::new_v4().simple().to_string()[..8]);
        // Orphans of a job's process group are to be reaped here, not by an init that a container may not have.
        rustix::process::set_child_subreaper(Some(rustix::process::getpid())).map_err(std::io::Error::from)?;
        let scratch = Scratch::open(&config.scratch, &name)?;
        let blender = config.remesher.iter().flat_map(|info| installation(info.program.as_ref(), &config.private));
        let readable = blender.chain(config.readable.iter().cloned()).collect();
        let sandbox = Sandbox { mode: config.sandbox, readable, max_processes: config.job_processes };
        let mut pool = Self { name, store, blobs, config, scratch, sandbox, status: None };
        if pool.config.slots > 0 {
            pool.status = Some(pool.try_sandbox().await.map_err(PoolError::Sandbox)?);
        }
        Ok(pool)
    }

    /// What holds this pool's jobs; none where it runs none.
    #[must_use]
    pub fn sandbox(&self) -> Option<&SandboxStatus> {
        self.status.as_ref()
    }

    async fn try_sandbox(&self) -> std::io::Result<SandboxStatus> {
        let config = &self.config;
        let outside = self.scratch.attempt()?;
        let confinement = self.confinement(Duration::from_secs(60));
        let mut walls = probe(&config.program, outside.path(), confinement).await?;
        if !walls.processes.in_force {
            let why = walls.processes.detail.take().unwrap_or_default();
            let detail = Some(format!("counted now and then; the kernel does not do it: {why}"));
            walls.processes = Protection { in_force: true, by: vec![COUNTED_HERE.to_owned()], detail };
        }
        for (wall, Protection { in_force, by, detail }) in walls.named() {
            let (by, detail) = (by.join(", "), detail.as_deref().unwrap_or_default());
            if *in_force {
                tracing::info!(wall, by, detail, "jobs are walled off");
            } else {
                tracing::warn!(wall, detail, "jobs are not walled off");
            }
        }
        Ok(SandboxStatus {
            mode: config.sandbox,
            walls,
            max_processes: config.job_processes,
            memory_bytes: config.job_memory,
            scratch_bytes: config.job_scratch,
            file_bytes: config.job_file,
        })
    }

    /// What holds a job's processes, with processor time for so long on every core.
    pub(super) fn confinement(&self, longest: Duration) -> Confinement {
        let cores = u32::try_from(std::thread::available_parallelism().map_or(1, usize::from)).unwrap_or(1);
        let limits = ProcessLimits {
            memory_bytes: self.config.job_memory,
            file_bytes: self.config.job_file,
            // A backstop behind the deadline, for a process that escapes its group.
            cpu: longest * cores + Duration::from_secs(5),
        };
        Confinement { limits, sandbox: self.sandbox.clone() }
    }

    /// Waits until a job's processes take too much, and answers what of; none where they ran longer than they may. The files that are in
    /// `folder` from the start are not counted.
    pub(super) async fn overrun(&self, job: &Job, folder: &Path, group: Pid) -> io::Result<Option<Excess>> {
        let model = job.artifacts.get(Task::MODEL).and_then(|model| Some(model.file.as_ref()?.bytes));
        let given = job.inputs.iter().map(|input| input.bytes).chain(model).sum();
        let counts = self.status.as_ref().is_some_and(|it| it.walls.processes.by == [COUNTED_HERE]);
        let allowance = Allowance {
            scratch_bytes: self.config.job_scratch.saturating_add(given),
            processes: counts.then_some(self.config.job_processes),
        };
        allowance.overrun(self.deadline(job), folder, group).await
    }

    /// The task of a job's child process: to do the job, or to draw the pictures of what it handed out.
    pub(super) fn task(&self, job: &Job, draw: Option<HandedOut>) -> Task {
        let config = &self.config;
        Task {
            inputs: job.inputs.clone(),
            options: job.options.clone(),
            draw,
            limits: config.limits,
            confinement: self.confinement(self.deadline(job)),
            remesher: config.remesher.clone().filter(|_| draw.is_none()),
            blender: config.blender.clone(),
        }
    }

    /// The time after which a job's processes are killed: later than a repair takes by itself to keep its deadline.
    pub(super) fn deadline(&self, job: &Job) -> Duration {
        let deadline = Duration::from_secs_f64(job.options.deadline_s().clamp(1.0, 3600.0));
        deadline + promised_overrun(deadline) + self.config.deadline_grace
    }

    /// Whether a job's processes may leave its process group.
    pub(super) fn loose(&self) -> bool {
        self.status.as_ref().is_none_or(|it| !it.walls.system_calls.in_force)
    }

    /// Bytes free on the disk that has the fewest, as an error where that is too few to begin a job.
    fn room(&self) -> Result<u64, u64> {
        let scratch = free_bytes(&self.config.scratch).ok();
        let files = self.blobs.free_bytes().ok().flatten();
        let free = [scratch, files].into_iter().flatten().min().unwrap_or(u64::MAX);
        if free < self.config.min_free { Err(free) } else { Ok(free) }
    }

    /// Runs until told to stop. Running jobs are finished, or handed back when `shutdown.now` is reached first.
    pub async fn run(self, shutdown: Shutdown) {
        let pool = Arc::new(self);
        tracing::info!(worker = pool.name, slots = pool.config.slots, "workers are ready");
        let mut tasks = JoinSet::new();
        tasks.spawn(rescue(Arc::clone(&pool), shutdown.drain.clone()));
        tasks.spawn(sweep_now_and_then(Arc::clone(&pool), shutdown.drain.clone()));
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "idle").set(pool.config.slots as f64);
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "busy").set(0);
        if let Some(remesher) =
            pool.config.remesher.clone().filter(|_| pool.config.blender_warm_up && pool.config.slots > 0)
        {
            tasks.spawn(warm_blender_up(Arc::clone(&pool), remesher, shutdown.drain.clone()));
        }
        for _ in 0..pool.config.slots {
            tasks.spawn(slot(Arc::clone(&pool), shutdown.clone()));
        }
        while let Some(ended) = tasks.join_next().await {
            if let Err(error) = ended {
                tracing::error!(%error, "a worker slot ended");
            }
        }
        tracing::info!(worker = pool.name, "workers have stopped");
    }
}

/// Claims and runs one job after the other.
async fn slot(pool: Arc<Pool>, shutdown: Shutdown) {
    let (mut had_room, mut drew) = (true, false);
    while !shutdown.drain.is_cancelled() {
        // What waits stays in the queue, where it is safe, rather than fail for want of room.
        let room = pool.room();
        if room.is_err() && had_room {
            let free = room.unwrap_or_else(|free| free);
            tracing::error!(
                free,
                least = pool.config.min_free,
                "too little room on the disk: no job is begun until there is more"
            );
        }
        had_room = room.is_ok();
        if !had_room {
            tokio::select! {
                () = tokio::time::sleep(pool.config.poll) => {}
                () = shutdown.drain.cancelled() => {}
            }
            continue;
        }
        // Somebody waits for pictures; but those who wait for jobs get their turns.
        if !drew && let Some(claim) = claim_drawings(&pool).await {
            drew = true;
            let span = attempt_span(&claim);
            let busy = Busy::begin();
            draw(&pool, claim, &shutdown).instrument(span).await;
            drop(busy);
            continue;
        }
        let just_drew = std::mem::take(&mut drew);
        match pool.store.claim(&pool.name, pool.config.lease, pool.config.max_running).await {
            Ok(Some(claim)) => {
                let span = attempt_span(&claim);
                let busy = Busy::begin();
                if let (1, Some(started)) = (claim.job.attempt, claim.job.started_at) {
                    let waited = (started - claim.job.created_at).as_seconds_f64();
                    metrics::histogram!(telemetry::JOB_WAIT).record(waited.max(0.0));
                }
                Attempt::new(&pool, claim, &shutdown).run(&shutdown).instrument(span).await;
                drop(busy);
                continue;
            }
            Ok(None) if just_drew => continue,
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "could not look for work"),
        }
        tokio::select! {
            () = pool.store.bell().work() => {}
            () = tokio::time::sleep(pool.config.poll) => {}
            () = shutdown.drain.cancelled() => {}
        }
    }
}

async fn claim_drawings(pool: &Pool) -> Option<Claim> {
    match pool.store.claim_drawings(pool.config.lease).await {
        Ok(claim) => claim,
        Err(error) => {
            tracing::error!(%error, "could not look for pictures to draw");
            None
        }
    }
}

/// What every log line of an attempt has, and where it stands in the trace of the request that made its job. Of the highest
/// level, so that lines have it whatever level is logged.
fn attempt_span(claim: &Claim) -> Span {
    let Claim { lease, job } = claim;
    let span = tracing::error_span!(
        "job",
        otel.kind = "consumer",
        job_id = %lease.id,
        attempt = lease.attempt,
        tenant = job.tenant,
        trace_id = Empty
    );
    telemetry::continue_from(&span, job.traceparent.as_deref());
    span
}

/// A slot at work, in the metrics.
struct Busy;

impl Busy {
    fn begin() -> Self {
        Self::shift(1.0);
        Self
    }

    fn shift(slots: f64) {
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "busy").increment(slots);
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "idle").decrement(slots);
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        Self::shift(-1.0);
    }
}

/// Makes jobs of lost workers claimable again.
async fn rescue(pool: Arc<Pool>, stop: CancellationToken) {
    let pause = pool.config.lease / 3;
    let mut overslept = false;
    while !stop.is_cancelled() {
        // After a stop of the whole process, or of the machine, the leases of its own jobs ran out unseen: their
        // heartbeats go first.
        if overslept {
            tokio::time::sleep(pause).await;
        }
        match pool.store.rescue().await {
            Ok(jobs) => {
                for job in jobs {
                    tracing::warn!(job_id = %job.id, status = job.status.as_str(), crashes = job.crashes, "a worker was lost");
                    metrics::counter!(telemetry::LEASES_LOST).increment(1);
                }
            }
            Err(error) => tracing::error!(%error, "could not look for lost jobs"),
        }
        let asleep = Instant::now();
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = stop.cancelled() => {}
        }
        overslept = asleep.elapsed() > 2 * pause;
    }
}

/// Expires results and removes what nobody owns, at the start and then now and then.
async fn sweep_now_and_then(pool: Arc<Pool>, stop: CancellationToken) {
    for round in 0.. {
        if stop.is_cancelled() {
            break;
        }
        if let Err(error) = sweep(pool.store.as_ref(), &pool.blobs, pool.config.retention, round).await {
            tracing::warn!(%error, "could not sweep");
        }
        tokio::select! {
            () = tokio::time::sleep(EVERY) => {}
            () = stop.cancelled() => {}
        }
    }
}
