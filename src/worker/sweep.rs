use std::time::{Duration, Instant};

use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Status, Store, StoreError};

/// How often to look for what has expired.
pub(super) const EVERY: Duration = Duration::from_secs(60);
/// How many of those looks go without one for files that nobody owns, which reads every file's name.
const ORPHANS_EVERY: u64 = 60;
/// Files younger than this may be an upload under way.
const AGE: Duration = Duration::from_secs(3600);
/// How long it is kept what webhooks told, and how that went.
const MESSAGES: Duration = Duration::from_secs(30 * 24 * 3600);
/// Jobs that expire in one statement.
const BATCH: u32 = 100;

/// How long what is left of a job is kept, both counted from its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// Its files and its report.
    pub results: Duration,
    /// That there was one, and how it ended.
    pub jobs: Duration,
}

/// Why a sweep was not finished.
#[derive(Debug, thiserror::Error)]
pub(super) enum SweepError {
    #[error(transparent)]
    Blobs(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Round number `round`, counted from 0, of those that remove what is not wanted any more. Any number of processes may sweep at once.
pub(super) async fn sweep(
    store: &dyn Store,
    blobs: &Blobs,
    retention: Retention,
    round: u64,
) -> Result<(), SweepError> {
    let started = Instant::now();
    expire(store, blobs, retention).await?;
    if round.is_multiple_of(ORPHANS_EVERY) {
        remove_orphans(store, blobs).await?;
    }
    metrics::histogram!("meshmend_sweep_seconds").record(started.elapsed());
    Ok(())
}

/// Expires jobs whose time is over, and forgets keys, tokens and jobs.
async fn expire(store: &dyn Store, blobs: &Blobs, retention: Retention) -> Result<(), SweepError> {
    store.forget_keys().await?;
    store.forget_tokens().await?;
    count("messages", store.forget_messages(MESSAGES).await?);
    loop {
        let expired = store.expire(retention.results, BATCH).await?;
        for id in &expired {
            blobs.delete_job(*id).await?;
        }
        count("expired", expired.len() as u64);
        if expired.len() < BATCH as usize {
            break;
        }
    }
    count("forgotten", store.forget_jobs(retention.jobs.max(retention.results)).await?);
    Ok(())
}

/// Removes files that no job owns: of uploads that a killed server left, and of deletions that were stopped half way.
async fn remove_orphans(store: &dyn Store, blobs: &Blobs) -> Result<(), SweepError> {
    for id in blobs.owners(AGE).await? {
        if store.get(id).await?.is_none_or(|job| job.purged || job.status == Status::Expired) {
            blobs.delete_job(id).await?;
            count("orphaned", 1);
            tracing::info!(%id, "removed files that no job owns");
        }
    }
    Ok(())
}

/// Counts what was swept away.
fn count(what: &'static str, many: u64) {
    metrics::counter!("meshmend_swept_total", "what" => what).increment(many);
}
