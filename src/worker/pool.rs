//! A number of workers in one process: their slots, the requeuing of lost jobs, and the removal of what has expired.

use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::TryStreamExt;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::field::Empty;
use tracing::{Instrument, Span};

use super::attempt::Attempt;
use super::child_request::{try_sandbox, warm_blender_up};
use super::context::{COUNTED_HERE, Retention, Shutdown, WorkerConfig, WorkerContext};
use super::drawing::draw;
use super::scratch::Scratch;
use crate::blender::installation;
use crate::blobs::{BlobError, Blobs, Owner};
use crate::jobs::{Claim, IdSource, Job, Status, Store, StoreError, SystemIds, UPLOAD_LIFE};
use crate::sandbox::{Protection, Sandbox, SandboxStatus};
use crate::telemetry;

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

/// A number of workers in one process that share a store.
pub struct Pool {
    context: Arc<WorkerContext>,
}

impl Pool {
    /// Makes the scratch folder, removes those of workers that are gone, and tries the sandbox that jobs will run in.
    ///
    /// # Errors
    /// When the scratch folder can't be made, or when the sandbox is required and can't be had.
    pub async fn new(store: Arc<dyn Store>, blobs: Blobs, config: WorkerConfig) -> Result<Self, PoolError> {
        let name = format!("worker-{}-{}", std::process::id(), &SystemIds.random().simple().to_string()[..8]);
        // Orphans of a job's process group are to be reaped here, not by an init that a container may not have.
        rustix::process::set_child_subreaper(Some(rustix::process::getpid())).map_err(std::io::Error::from)?;
        let scratch = Scratch::open(&config.scratch, &name)?;
        let blender = config.remesher.iter().flat_map(|info| installation(info.program.as_ref(), &config.private));
        let readable = blender.chain(config.readable.iter().cloned()).collect();
        let sandbox = Sandbox { mode: config.sandbox, readable, max_processes: config.job_processes };
        let mut context = WorkerContext { name, store, blobs, config, scratch, sandbox, status: None };
        if context.config.slots > 0 {
            context.status = Some(sandbox_status(&context).await.map_err(PoolError::Sandbox)?);
        }
        Ok(Self { context: Arc::new(context) })
    }

    /// What holds this pool's jobs; none where it runs none.
    #[must_use]
    pub fn sandbox(&self) -> Option<&SandboxStatus> {
        self.context.status.as_ref()
    }

    /// Runs until told to stop. Running jobs are finished, or released when `shutdown.now` is reached first.
    pub async fn run(self, shutdown: Shutdown) {
        let context = self.context;
        tracing::info!(worker = context.name, slots = context.config.slots, "workers are ready");
        let mut tasks = JoinSet::new();
        tasks.spawn(requeue_expired(Arc::clone(&context), shutdown.drain.clone()));
        tasks.spawn(sweep_now_and_then(Arc::clone(&context), shutdown.drain.clone()));
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "idle").set(context.config.slots as f64);
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "busy").set(0);
        if let Some(remesher) =
            context.config.remesher.clone().filter(|_| context.config.blender_warm_up && context.config.slots > 0)
        {
            tasks.spawn(warm_blender_up(Arc::clone(&context), remesher, shutdown.drain.clone()));
        }
        for _ in 0..context.config.slots {
            tasks.spawn(slot(Arc::clone(&context), shutdown.clone()));
        }
        while let Some(ended) = tasks.join_next().await {
            if let Err(error) = ended {
                tracing::error!(%error, "a worker slot ended");
            }
        }
        tracing::info!(worker = context.name, "workers have stopped");
    }
}

/// Tries the sandbox, and logs what it holds.
async fn sandbox_status(context: &WorkerContext) -> std::io::Result<SandboxStatus> {
    let config = &context.config;
    let outside = context.scratch.attempt()?;
    let confinement = context.confinement(Duration::from_secs(60));
    let mut protections = try_sandbox(&config.program, outside.path(), confinement).await?;
    if !protections.processes.enforced {
        let why = protections.processes.detail.take().unwrap_or_default();
        let detail = Some(format!("counted now and then; the kernel does not do it: {why}"));
        protections.processes = Protection { enforced: true, mechanisms: vec![COUNTED_HERE.to_owned()], detail };
    }
    for (wall, Protection { enforced, mechanisms, detail }) in protections.named() {
        let (mechanisms, detail) = (mechanisms.join(", "), detail.as_deref().unwrap_or_default());
        if *enforced {
            tracing::info!(protection = wall, mechanisms, detail, "sandbox protection enforced");
        } else {
            tracing::warn!(protection = wall, detail, "sandbox protection missing");
        }
    }
    Ok(SandboxStatus {
        mode: config.sandbox,
        protections,
        max_processes: config.job_processes,
        memory_bytes: config.job_memory,
        scratch_bytes: config.job_scratch,
        file_bytes: config.job_file,
    })
}

/// Claims and runs one job after the other.
async fn slot(context: Arc<WorkerContext>, shutdown: Shutdown) {
    let (mut had_room, mut drew) = (true, false);
    while !shutdown.drain.is_cancelled() {
        // What waits stays in the queue, where it is safe, rather than fail for want of room.
        let room = context.room();
        if let Err(free) = room
            && had_room
        {
            let least = context.config.min_free;
            tracing::error!(free, least, "too little room on the disk: no job is begun until there is more");
        }
        had_room = room.is_ok();
        if !had_room {
            sleep_unless(&shutdown.drain, context.config.poll).await;
            continue;
        }
        // Somebody waits for pictures; but those who wait for jobs get their turns.
        if !drew && let Some(claim) = claim_drawings(&context).await {
            drew = true;
            let span = attempt_span(&claim);
            let busy = Busy::begin();
            draw(&context, claim, &shutdown).instrument(span).await;
            drop(busy);
            continue;
        }
        let just_drew = std::mem::take(&mut drew);
        match context.store.claim(&context.name, context.config.lease, context.config.max_running).await {
            Ok(Some(claim)) => {
                run_claim(&context, claim, &shutdown).await;
                continue;
            }
            Ok(None) if just_drew => continue,
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "could not look for work"),
        }
        tokio::select! {
            () = context.store.notifier().work() => {}
            () = tokio::time::sleep(context.config.poll) => {}
            () = shutdown.drain.cancelled() => {}
        }
    }
}

async fn sleep_unless(stop: &CancellationToken, time: Duration) {
    tokio::select! {
        () = tokio::time::sleep(time) => {}
        () = stop.cancelled() => {}
    }
}

async fn run_claim(context: &WorkerContext, claim: Claim, shutdown: &Shutdown) {
    let span = attempt_span(&claim);
    let busy = Busy::begin();
    if let (1, Some(started)) = (claim.job.attempt, claim.job.started_at) {
        let waited = (started - claim.job.created_at).as_seconds_f64();
        metrics::histogram!(telemetry::JOB_WAIT).record(waited.max(0.0));
    }
    Attempt::new(context, claim, shutdown).run(shutdown).instrument(span).await;
    drop(busy);
}

async fn claim_drawings(context: &WorkerContext) -> Option<Claim> {
    match context.store.claim_drawings(context.config.lease).await {
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
async fn requeue_expired(context: Arc<WorkerContext>, stop: CancellationToken) {
    let pause = context.config.lease / 3;
    let mut overslept = false;
    while !stop.is_cancelled() {
        // After a stop of the whole process, or of the machine, the leases of its own jobs ran out unseen: their
        // heartbeats go first.
        if overslept {
            tokio::time::sleep(pause).await;
        }
        match context.store.requeue_expired().await {
            Ok(jobs) => {
                for job in jobs {
                    tracing::warn!(job_id = %job.id, status = job.status.as_str(), crashes = job.crashes, "a worker was lost");
                    metrics::counter!(telemetry::LEASES_LOST).increment(1);
                }
            }
            Err(error) => tracing::error!(%error, "could not look for lost jobs"),
        }
        let asleep = Instant::now();
        sleep_unless(&stop, pause).await;
        overslept = asleep.elapsed() > 2 * pause;
    }
}

/// Expires results and removes what nobody owns, at the start and then now and then.
async fn sweep_now_and_then(context: Arc<WorkerContext>, stop: CancellationToken) {
    for round in 0.. {
        if stop.is_cancelled() {
            break;
        }
        if let Err(error) = sweep(context.store.as_ref(), &context.blobs, context.config.retention, round).await {
            tracing::warn!(%error, "could not sweep");
        }
        sleep_unless(&stop, SWEEP_EVERY).await;
    }
}

/// How often to look for what has expired.
const SWEEP_EVERY: Duration = Duration::from_secs(60);
/// How many of those looks go without one for files that nobody owns, which reads every file's name.
const ORPHANS_EVERY: u64 = 60;
/// Files younger than this may be an upload under way.
const ORPHAN_AGE: Duration = Duration::from_secs(3600);
/// How long it is kept what webhooks told, and how that went.
const MESSAGE_LIFE: Duration = Duration::from_secs(30 * 24 * 3600);
/// Jobs that expire in one statement.
const EXPIRE_BATCH: u32 = 100;

/// Why a sweep was not finished.
#[derive(Debug, thiserror::Error)]
enum SweepError {
    #[error(transparent)]
    Blobs(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Round number `round`, counted from 0, of those that remove what is not wanted any more. Any number of processes may sweep at once.
async fn sweep(store: &dyn Store, blobs: &Blobs, retention: Retention, round: u64) -> Result<(), SweepError> {
    let started = Instant::now();
    expire(store, blobs, retention).await?;
    if round.is_multiple_of(ORPHANS_EVERY) {
        remove_orphans(store, blobs).await?;
    }
    metrics::histogram!(telemetry::SWEEP).record(started.elapsed());
    Ok(())
}

/// Expires jobs whose time is over, and forgets keys, tokens, uploads and jobs.
async fn expire(store: &dyn Store, blobs: &Blobs, retention: Retention) -> Result<(), SweepError> {
    store.forget_keys().await?;
    store.forget_tokens().await?;
    store.forget_uploads().await?;
    count("messages", store.forget_messages(MESSAGE_LIFE).await?);
    loop {
        let expired = store.expire(retention.results, EXPIRE_BATCH).await?;
        for id in &expired {
            blobs.delete_job(*id).await?;
        }
        count("expired", expired.len() as u64);
        if expired.len() < EXPIRE_BATCH as usize {
            break;
        }
    }
    count("forgotten", store.forget_jobs(retention.jobs.max(retention.results)).await?);
    Ok(())
}

/// Removes files that no job owns: of uploads that a killed server left, or of which no job was made, of deletions that were stopped
/// half way, and of attempts that were lost and whose worker, or its file store, went before they were cleared away.
async fn remove_orphans(store: &dyn Store, blobs: &Blobs) -> Result<(), SweepError> {
    blobs.delete_quiet_incoming(UPLOAD_LIFE).await?;
    let (mut owners, mut gone) = (blobs.owners(ORPHAN_AGE).await?, None);
    while let Some(Owner { job: id, claim }) = owners.try_next().await? {
        let job = store.get(id).await?.filter(|job| !job.purged && job.status != Status::Expired);
        let removed = match (job, claim) {
            (None, _) if gone == Some(id) => false,
            (None, _) => {
                gone = Some(id);
                blobs.delete_quiet_job(id, ORPHAN_AGE).await?
            }
            (Some(job), Some(claim)) if is_lost(&job, &claim) => {
                blobs.delete_claim(id, &claim).await?;
                true
            }
            _ => false,
        };
        if removed {
            count("orphaned", 1);
            tracing::info!(job_id = %id, "removed files that no job owns");
        }
    }
    Ok(())
}

/// Whether a job ended otherwise than by this claim, so that nobody sees what that made. One that runs may be about to end by it.
fn is_lost(job: &Job, claim: &str) -> bool {
    let folder = Blobs::artifact_key(job.id, claim, "");
    let mut files = job.artifacts.values().filter_map(|artifact| artifact.file.as_ref());
    job.finished_at.is_some() && !files.any(|file| file.key.starts_with(&folder))
}

/// Counts what was swept away.
fn count(what: &'static str, many: u64) {
    metrics::counter!(telemetry::SWEPT, "what" => what).increment(many);
}
