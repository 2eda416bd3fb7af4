//! The workers of one process: the slots that claim jobs, the requeuing of jobs with expired leases, and the removal of expired
//! data.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant, SystemTime};

use futures::TryStreamExt;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::field::Empty;
use tracing::{Instrument, Span};

use super::attempt::Attempt;
use super::child_request::{try_sandbox, warm_blender_up};
use super::context::{Retention, Shutdown, WORKER_COUNT, WorkerConfig, WorkerContext};
use super::drawing::draw;
use super::prepared::PreparedChildren;
use super::scratch::Scratch;
use crate::access::IdSource;
use crate::blender::installation;
use crate::blobs::{BlobError, Blobs, Owner};
use crate::jobs::{Claim, Clock, Job, Status, Store, StoreError, UPLOAD_LIFE};
use crate::sandbox::{Protection, Sandbox, SandboxStatus};
use crate::telemetry;

/// Why the pool could not be created.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// The scratch folder can't be used.
    #[error("could not prepare the scratch folder: {0}")]
    Scratch(#[from] std::io::Error),
    /// The sandbox trial failed.
    #[error("could not set up the sandbox for jobs: {0}")]
    Sandbox(std::io::Error),
}

/// The worker slots of one process, which share a store.
pub struct Pool {
    context: Arc<WorkerContext>,
    clock: Arc<dyn Clock>,
}

impl Pool {
    /// Creates the scratch folder, removes those of ended workers, and tests the sandbox.
    ///
    /// # Errors
    /// When the scratch folder can't be created, or when the sandbox is required but not available.
    pub async fn new(
        store: Arc<dyn Store>,
        blobs: Blobs,
        config: WorkerConfig,
        clock: Arc<dyn Clock>,
        ids: &dyn IdSource,
    ) -> Result<Self, PoolError> {
        let name = format!("worker-{}-{}", std::process::id(), &ids.random().simple().to_string()[..8]);
        // Makes this process the reaper of orphans of a job's process group; a container may have no init that reaps.
        rustix::process::set_child_subreaper(Some(rustix::process::getpid())).map_err(std::io::Error::from)?;
        let scratch = Scratch::open(&config.scratch, &name)?;
        let blender = config.remesher.iter().flat_map(|info| installation(info.program.as_ref(), &config.private));
        let readable = blender.chain(config.readable.iter().cloned()).collect();
        let sandbox = Sandbox { mode: config.sandbox, readable, max_processes: config.job_processes };
        let mut context = WorkerContext {
            name,
            store,
            blobs,
            config,
            scratch,
            sandbox,
            prepared: PreparedChildren::default(),
            busy_slots: AtomicUsize::new(0),
            status: None,
        };
        if context.config.slots > 0 {
            context.status = Some(sandbox_status(&context).await.map_err(PoolError::Sandbox)?);
        }
        Ok(Self { context: Arc::new(context), clock })
    }

    /// The sandbox of this pool's jobs; `None` for a pool without slots.
    #[must_use]
    pub fn sandbox(&self) -> Option<&SandboxStatus> {
        self.context.status.as_ref()
    }

    /// Runs until `shutdown.drain` is cancelled. Finishes the running jobs, or releases them when `shutdown.now` is cancelled.
    pub async fn run(self, shutdown: Shutdown) {
        let context = self.context;
        tracing::info!(worker = context.name, slots = context.config.slots, "workers ready");
        let mut tasks = JoinSet::new();
        tasks.spawn(requeue_expired(Arc::clone(&context), shutdown.drain.clone()));
        tasks.spawn(sweep_periodically(Arc::clone(&context), self.clock, shutdown.drain.clone()));
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
                tracing::error!(%error, "worker task panicked");
            }
        }
        context.prepared.end().await;
        tracing::info!(worker = context.name, "workers stopped");
    }
}

/// Tests the sandbox, and logs each protection.
async fn sandbox_status(context: &WorkerContext) -> std::io::Result<SandboxStatus> {
    let config = &context.config;
    let outside = context.scratch.attempt()?;
    let confinement = context.confinement(Duration::from_secs(60));
    let mut protections = try_sandbox(&config.program, outside.path(), confinement).await?;
    if !protections.processes.enforced {
        let reason = protections.processes.detail.take().unwrap_or_default();
        let detail = Some(format!("the worker counts processes at intervals, because the kernel does not: {reason}"));
        protections.processes = Protection { enforced: true, mechanisms: vec![WORKER_COUNT.to_owned()], detail };
    }
    for (name, Protection { enforced, mechanisms, detail }) in protections.named() {
        let (mechanisms, detail) = (mechanisms.join(", "), detail.as_deref().unwrap_or_default());
        if *enforced {
            tracing::info!(protection = name, mechanisms, detail, "sandbox protection enforced");
        } else {
            tracing::warn!(protection = name, detail, "sandbox protection missing");
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

/// Claims and runs one job after the other. After drawing pictures, a slot claims a job before it draws again.
async fn slot(context: Arc<WorkerContext>, shutdown: Shutdown) {
    let (mut had_space, mut drew) = (true, false);
    while !shutdown.drain.is_cancelled() {
        // With too little disk space, jobs stay queued rather than fail.
        let free_space = context.check_free_space();
        if let Err(free) = free_space
            && had_space
        {
            let least = context.config.min_free;
            tracing::error!(free, least, "too little free disk space; not starting jobs");
        }
        had_space = free_space.is_ok();
        if !had_space {
            sleep_unless(&shutdown.drain, context.config.poll).await;
            continue;
        }
        context.prepare_child();
        // Pictures go first, because a client waits for them, but never twice in a row.
        if !drew && let Some(claim) = claim_drawings(&context).await {
            drew = true;
            let span = attempt_span(&claim);
            let busy = Busy::begin(&context.busy_slots);
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
            Err(error) => tracing::error!(%error, "could not claim a job"),
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
    let busy = Busy::begin(&context.busy_slots);
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
            tracing::error!(%error, "could not claim drawings");
            None
        }
    }
}

/// The span of an attempt, which continues the trace of the request that submitted the job. Its level is the highest, so that
/// log lines of every level carry its fields.
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

/// Counts a slot as busy, also in the metrics, until it is dropped.
struct Busy<'a>(&'a AtomicUsize);

impl<'a> Busy<'a> {
    fn begin(slots: &'a AtomicUsize) -> Self {
        slots.fetch_add(1, Ordering::Relaxed);
        Self::shift(1.0);
        Self(slots)
    }

    fn shift(slots: f64) {
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "busy").increment(slots);
        metrics::gauge!(telemetry::WORKER_SLOTS, "state" => "idle").decrement(slots);
    }
}

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
        Self::shift(-1.0);
    }
}

/// Periodically requeues jobs whose lease expired.
async fn requeue_expired(context: Arc<WorkerContext>, stop: CancellationToken) {
    let pause = context.config.lease / 3;
    let mut overslept = false;
    while !stop.is_cancelled() {
        // After this process or the machine was suspended, the leases of its own jobs have expired. Their heartbeats come
        // first, to extend them.
        if overslept {
            tokio::time::sleep(pause).await;
        }
        match context.store.requeue_expired().await {
            Ok(jobs) => {
                for job in jobs {
                    tracing::warn!(job_id = %job.id, status = job.status.as_str(), crashes = job.crashes, "lease expired; worker lost");
                    metrics::counter!(telemetry::LEASES_LOST).increment(1);
                }
            }
            Err(error) => tracing::error!(%error, "could not requeue jobs with expired leases"),
        }
        let asleep = Instant::now();
        sleep_unless(&stop, pause).await;
        overslept = asleep.elapsed() > 2 * pause;
    }
}

/// Removes expired data and orphaned files, at the start and then periodically.
async fn sweep_periodically(context: Arc<WorkerContext>, clock: Arc<dyn Clock>, stop: CancellationToken) {
    for round in 0.. {
        if stop.is_cancelled() {
            break;
        }
        if let Err(error) = sweep(&context, clock.as_ref(), round).await {
            tracing::warn!(%error, "could not remove expired data");
        }
        sleep_unless(&stop, SWEEP_EVERY).await;
    }
}

/// How often to remove expired data.
const SWEEP_EVERY: Duration = Duration::from_secs(60);
/// Every how many rounds to look for orphaned files, which lists every file.
const ORPHANS_EVERY: u64 = 60;
/// The least age of a file that may be removed; a younger one may belong to a running upload.
const ORPHAN_AGE: Duration = Duration::from_secs(3600);
/// How long webhook messages and the results of their deliveries are kept.
const MESSAGE_LIFE: Duration = Duration::from_secs(30 * 24 * 3600);
/// How many jobs expire in one statement.
const EXPIRE_BATCH: u32 = 100;

/// Why a sweep stopped early.
#[derive(Debug, thiserror::Error)]
enum SweepError {
    #[error(transparent)]
    Blobs(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Removes expired data; every [`ORPHANS_EVERY`] rounds, starting with round 0, also orphaned files. Any number of processes may
/// sweep at once.
async fn sweep(context: &WorkerContext, clock: &dyn Clock, round: u64) -> Result<(), SweepError> {
    let started = Instant::now();
    let (store, blobs) = (context.store.as_ref(), &context.blobs);
    expire(store, blobs, context.config.retention).await?;
    if round.is_multiple_of(ORPHANS_EVERY) {
        let now = SystemTime::UNIX_EPOCH + Duration::from_millis(clock.now_ms().unsigned_abs());
        remove_orphans(store, blobs, now).await?;
    }
    metrics::histogram!(telemetry::SWEEP).record(started.elapsed());
    Ok(())
}

/// Expires the results of old jobs, and deletes expired keys, tokens, uploads, messages and jobs.
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
    count("records", store.forget_jobs(retention.jobs.max(retention.results)).await?);
    Ok(())
}

/// Deletes files that no job owns: of uploads that never became a job, of interrupted deletions, and of lost attempts whose
/// files could not be deleted at once.
async fn remove_orphans(store: &dyn Store, blobs: &Blobs, now: SystemTime) -> Result<(), SweepError> {
    blobs.delete_stale_incoming(now - UPLOAD_LIFE).await?;
    let since = now - ORPHAN_AGE;
    let (mut owners, mut gone) = (blobs.owners(since).await?, None);
    while let Some(Owner { job: id, claim }) = owners.try_next().await? {
        let job = store.get(id).await?.filter(|job| !job.purged && job.status != Status::Expired);
        let removed = match (job, claim) {
            (None, _) if gone == Some(id) => false,
            (None, _) => {
                gone = Some(id);
                blobs.delete_stale_job(id, since).await?
            }
            (Some(job), Some(claim)) if is_lost(&job, &claim) => {
                blobs.delete_claim(id, &claim).await?;
                true
            }
            _ => false,
        };
        if removed {
            count("orphaned", 1);
            tracing::info!(job_id = %id, "removed orphaned files");
        }
    }
    Ok(())
}

/// Whether the job has ended and no artifact is from this claim, so that the claim's files are useless. A running job may still
/// end with this claim.
fn is_lost(job: &Job, claim: &str) -> bool {
    let folder = Blobs::artifact_key(job.id, claim, "");
    let mut files = job.artifacts.values().filter_map(|artifact| artifact.file.as_ref());
    job.finished_at.is_some() && !files.any(|file| file.key.starts_with(&folder))
}

/// Counts removed items in the metrics.
fn count(kind: &'static str, number: u64) {
    metrics::counter!(telemetry::SWEPT, "item" => kind).increment(number);
}
