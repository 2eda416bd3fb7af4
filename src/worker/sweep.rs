use std::time::{Duration, Instant};

use futures::TryStreamExt;

use crate::blobs::{BlobError, Blobs, Owner};
use crate::jobs::{Job, Status, Store, StoreError, UPLOAD_LIFE};
use crate::telemetry;

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
    metrics::histogram!(telemetry::SWEEP).record(started.elapsed());
    Ok(())
}

/// Expires jobs whose time is over, and forgets keys, tokens, uploads and jobs.
async fn expire(store: &dyn Store, blobs: &Blobs, retention: Retention) -> Result<(), SweepError> {
    store.forget_keys().await?;
    store.forget_tokens().await?;
    store.forget_uploads().await?;
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

/// Removes files that no job owns: of uploads that a killed server left, or of which no job was made, of deletions that were stopped
/// half way, and of attempts that were lost and whose worker, or its file store, went before they were cleared away.
async fn remove_orphans(store: &dyn Store, blobs: &Blobs) -> Result<(), SweepError> {
    blobs.delete_quiet_incoming(UPLOAD_LIFE).await?;
    let (mut owners, mut gone) = (blobs.owners(AGE).await?, None);
    while let Some(Owner { job: id, claim }) = owners.try_next().await? {
        let job = store.get(id).await?.filter(|job| !job.purged && job.status != Status::Expired);
        let removed = match (job, claim) {
            (None, _) if gone == Some(id) => false,
            (None, _) => {
                gone = Some(id);
                blobs.delete_quiet_job(id, AGE).await?
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
