use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::field::Empty;
use tracing::{Instrument, Span};

use super::attempt::Attempt;
use super::scratch::Scratch;
use super::sweep::{EVERY, sweep};
use crate::blender::BlenderConfig;
use crate::blobs::Blobs;
use crate::format::Limits;
use crate::jobs::{Claim, JobStore};
use crate::repair::RemesherInfo;
use crate::telemetry;

/// How workers run jobs.
#[derive(Debug, Clone)]
pub struct WorkerConfig {
    /// The program to start for a job's child process: this one.
    pub program: PathBuf,
    /// Where scratch folders go.
    pub scratch: PathBuf,
    /// Jobs that run at the same time.
    pub slots: usize,
    /// How long a claim holds without a heartbeat.
    pub lease: Duration,
    /// How long to wait before looking for work that no bell told of.
    pub poll: Duration,
    /// Most address space of a job's process, in bytes.
    pub job_memory: u64,
    /// Largest file that a job may write, in bytes.
    pub job_file: u64,
    /// Time beyond a job's own deadline after which its processes are killed.
    pub deadline_grace: Duration,
    /// What a reader may spend.
    pub limits: Limits,
    /// Tier 3, where there is one.
    pub remesher: Option<RemesherInfo>,
    /// What tier 3 may use.
    pub blender: BlenderConfig,
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
    pub(super) store: Arc<dyn JobStore>,
    pub(super) blobs: Blobs,
    pub(super) config: WorkerConfig,
    pub(super) scratch: Scratch,
}

impl Pool {
    /// Makes the scratch folder, and removes those of workers that are gone.
    ///
    /// # Errors
    /// When the scratch folder can't be made.
    pub fn new(store: Arc<dyn JobStore>, blobs: Blobs, config: WorkerConfig) -> std::io::Result<Self> {
        let name = format!("worker-{}-{}", std::process::id(), &uuid::Uuid::new_v4().simple().to_string()[..8]);
        // Orphans of a job's process group are to be reaped here, not by an init that a container may not have.
        rustix::process::set_child_subreaper(Some(rustix::process::getpid()))?;
        let scratch = Scratch::open(&config.scratch, &name)?;
        Ok(Self { name, store, blobs, config, scratch })
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
    while !shutdown.drain.is_cancelled() {
        match pool.store.claim(&pool.name, pool.config.lease).await {
            Ok(Some(claim)) => {
                let span = attempt_span(&claim);
                let busy = Busy::begin();
                if let (1, Some(started)) = (claim.job.attempt, claim.job.started_at) {
                    let waited = (started - claim.job.created_at).as_seconds_f64();
                    metrics::histogram!(telemetry::JOB_WAIT).record(waited.max(0.0));
                }
                Attempt::new(&pool, claim).run(&shutdown).instrument(span).await;
                drop(busy);
                continue;
            }
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

/// What every log line of an attempt has, and where it stands in the trace of the request that made its job. Of the highest
/// level, so that lines have it whatever level is logged.
fn attempt_span(claim: &Claim) -> Span {
    let Claim { lease, job } = claim;
    let span = tracing::error_span!(
        "job",
        otel.kind = "consumer",
        job_id = %lease.id,
        attempt = lease.attempt,
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

/// Removes files that no job owns, at the start and then by the hour.
async fn sweep_now_and_then(pool: Arc<Pool>, stop: CancellationToken) {
    while !stop.is_cancelled() {
        if let Err(error) = sweep(pool.store.as_ref(), &pool.blobs).await {
            tracing::warn!(%error, "could not sweep");
        }
        tokio::select! {
            () = tokio::time::sleep(EVERY) => {}
            () = stop.cancelled() => {}
        }
    }
}
