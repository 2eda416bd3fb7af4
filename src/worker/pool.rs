use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::attempt::Attempt;
use super::scratch::Scratch;
use super::sweep::{EVERY, sweep};
use crate::blender::BlenderConfig;
use crate::blobs::Blobs;
use crate::format::Limits;
use crate::jobs::JobStore;
use crate::repair::RemesherInfo;

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
                let span = tracing::info_span!("job", id = %claim.lease.id, attempt = claim.lease.attempt);
                Attempt::new(&pool, claim, &shutdown).run(&shutdown).instrument(span).await;
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
                    tracing::warn!(id = %job.id, status = job.status.as_str(), crashes = job.crashes, "a worker was lost");
                    metrics::counter!("meshmend_leases_lost_total").increment(1);
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
