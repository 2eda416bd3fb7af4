//! Data types of the job queue: new jobs, uploads, leases, results of attempts and the retry policy. Also the [`Notifier`] of changes.

use std::time::Duration;

use time::OffsetDateTime;
use tokio::sync::{Notify, broadcast};

use super::id::{JobId, UploadId};
use super::job::{Artifacts, Input, Job, JobOutcome, JobProblem, Metadata, StoredReport};
use super::options::JobOptions;
use super::report::JobReport;

/// A job to accept. Its files are in the blob store already.
#[derive(Debug, Clone, PartialEq)]
pub struct NewJob {
    /// The id. The caller chooses it, because the storage keys of the files contain it.
    pub id: JobId,
    /// The files, at least one.
    pub inputs: Vec<Input>,
    /// The tenant that owns the job.
    pub tenant: String,
    /// The id of the API key that submitted the job.
    pub api_key_id: Option<String>,
    /// What to do.
    pub options: JobOptions,
    /// The client's own key-value pairs, returned with the job.
    pub metadata: Metadata,
    /// The address to notify of the job's end.
    pub callback_url: Option<String>,
    /// A hash of all that determines the result: bytes, options, engine.
    pub fingerprint: String,
    /// The result of an earlier job with the same fingerprint. A job with such a result is stored as already finished.
    pub result: Option<Reused>,
    /// The request's idempotency key. The caller must hold it for this job ([`KeyState::Held`]).
    pub key: Option<RequestKey>,
    /// The upload that contains the job's file. At most one job can use an upload.
    pub upload: Option<UploadId>,
    /// The request's W3C trace context; the worker continues the trace.
    pub traceparent: Option<String>,
}

impl NewJob {
    /// A job with only the required fields.
    #[must_use]
    pub fn new(id: JobId, tenant: &str, inputs: Vec<Input>, options: JobOptions) -> Self {
        Self {
            id,
            inputs,
            tenant: tenant.to_owned(),
            api_key_id: None,
            options,
            metadata: Metadata::new(),
            callback_url: None,
            fingerprint: String::new(),
            result: None,
            key: None,
            upload: None,
            traceparent: None,
        }
    }
}

/// The result of an earlier job.
#[derive(Debug, Clone, PartialEq)]
pub struct Reused {
    /// The earlier job.
    pub from: JobId,
    /// The outcome of the earlier job.
    pub outcome: JobOutcome,
    /// The report of the earlier job.
    pub report: StoredReport,
    /// Copies of the earlier job's files, made for the new job.
    pub artifacts: Artifacts,
}

/// How long an unfinished request holds its idempotency key. A request that takes longer extends the hold before it ends.
pub const KEY_HOLD: Duration = Duration::from_secs(30);
/// How long the idempotency key of an accepted request is kept.
pub const KEY_LIFE: Duration = Duration::from_secs(24 * 3600);

/// A request's idempotency key, with a fingerprint that distinguishes the request from others with the same key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestKey {
    /// The key that the client sent.
    pub key: String,
    /// A hash of the request's files and options.
    pub fingerprint: String,
}

/// The state of an idempotency key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KeyState {
    /// The key is now held for the caller's job, for [`KEY_HOLD`].
    Held,
    /// Another unfinished request holds the key.
    InUse,
    /// A request with this key was accepted as a job.
    Used {
        /// The fingerprint of that request.
        fingerprint: String,
        /// The job of that request.
        job: JobId,
    },
}

/// How long after its announcement a client may send an upload's bytes.
pub const UPLOAD_OPEN: Duration = Duration::from_secs(3600);
/// How long after its announcement a job can use an upload; then the upload is deleted.
pub const UPLOAD_LIFE: Duration = Duration::from_secs(24 * 3600);

/// An upload that a client announces before it sends the bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewUpload {
    /// The upload's id.
    pub id: UploadId,
    /// The tenant that owns the upload.
    pub tenant: String,
    /// The file's name, if the client gave one.
    pub name: Option<String>,
    /// SHA-256 of the token in the upload's URL, in hexadecimal; `None` if the client uploads to a presigned URL of the object store.
    pub token_sha256: Option<String>,
}

/// An announced upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PendingUpload {
    /// The announcement.
    pub upload: NewUpload,
    /// The time of the announcement.
    pub created_at: OffsetDateTime,
    /// Whether the client may still send the bytes: for [`UPLOAD_OPEN`], and only until a job uses the upload.
    pub is_open: bool,
    /// The job that uses the upload.
    pub job: Option<JobId>,
}

/// A worker's lease on a job. The store rejects a write of the worker unless all three values match the job's current lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub id: JobId,
    /// The number of the attempt.
    pub attempt: u32,
    /// A random string, new for each claim.
    pub token: String,
}

/// A job that a worker claimed.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// The worker's lease on the job.
    pub lease: Lease,
    /// The job.
    pub job: Job,
}

/// The result of a job that succeeded.
#[derive(Debug, Clone, PartialEq)]
pub struct Completion {
    /// The report; its outcome becomes the job's.
    pub report: JobReport,
    /// The files, already in the blob store under the attempt's key.
    pub artifacts: Artifacts,
}

/// Whether a failed attempt may be retried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// A retry would fail in the same way: the job fails.
    Final,
    /// The failure is transient: the job is retried, up to [`RetryPolicy::max_attempts`].
    Transient,
    /// The child process crashed: the job is retried, up to [`RetryPolicy::max_crashes`].
    Crash,
}

/// A failed attempt.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Whether the attempt may be retried.
    pub kind: FailureKind,
    /// The cause; it becomes the job's problem if this was the last attempt.
    pub problem: JobProblem,
    /// The report, if the attempt had a result that did not meet the job's options.
    pub report: Option<JobReport>,
    /// Files to keep, such as the log.
    pub artifacts: Artifacts,
}

/// The numbers of queued jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct QueuedCounts {
    /// Queued jobs of all tenants.
    pub all: u64,
    /// Queued jobs of one tenant.
    pub of_tenant: u64,
}

/// The queued and running jobs of a class of tenants.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassLoad {
    /// The class.
    pub class: String,
    /// Number of queued jobs.
    pub queued: u64,
    /// Number of running jobs.
    pub running: u64,
    /// How long the next job to claim has been due; zero if no queued job is due.
    pub wait: Duration,
}

/// How often a job is retried, and after which delays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RetryPolicy {
    /// The number of attempts after which a transient failure, such as a full disk or a lost connection, is final.
    pub max_attempts: u32,
    /// The number of crashes of its worker or its child process after which a job fails.
    pub max_crashes: u32,
    /// The delay before the second attempt; it doubles with each further attempt.
    pub first_delay: Duration,
    /// The longest delay.
    pub longest_delay: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self {
            max_attempts: 5,
            max_crashes: 3,
            first_delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(300),
        }
    }
}

impl RetryPolicy {
    /// Whether the job fails for good. `attempt` is the number of the failed attempt. `crashes` counts the job's crashes, including
    /// this failure if it is a crash.
    #[must_use]
    pub fn ends(&self, kind: FailureKind, attempt: u32, crashes: u32) -> bool {
        match kind {
            FailureKind::Final => true,
            FailureKind::Transient => attempt >= self.max_attempts,
            FailureKind::Crash => crashes >= self.max_crashes,
        }
    }

    /// The delay after failed attempt number `tries`, counted from 1. It doubles with each attempt, up to the longest delay. Its upper
    /// half is random jitter, so that jobs that failed together are not retried together. `random` is any 64 random bits.
    #[must_use]
    pub fn delay(&self, tries: u32, random: u64) -> Duration {
        let uncapped = self.first_delay.saturating_mul(1_u32 << tries.saturating_sub(1).min(20));
        let max = uncapped.min(self.longest_delay);
        let half = max / 2;
        let nanos = u64::try_from(half.as_nanos()).unwrap_or(u64::MAX);
        half + Duration::from_nanos(if nanos == 0 { 0 } else { random % nanos })
    }
}

/// Wakes waiting requests and idle workers of one process when a job changes or work arrives. A notifier does not hear of changes by other
/// processes, so every listener also polls at intervals.
#[derive(Debug)]
pub struct Notifier {
    changed: broadcast::Sender<JobId>,
    work: Notify,
    deliveries: Notify,
}

impl Default for Notifier {
    fn default() -> Self {
        Self { changed: broadcast::channel(1024).0, work: Notify::new(), deliveries: Notify::new() }
    }
}

impl Notifier {
    /// Notifies all listeners that a job's row changed.
    pub fn notify_job(&self, id: JobId) {
        // `send` fails only if nobody listens, which is fine.
        let _ = self.changed.send(id);
    }

    /// Notifies one idle worker that there is a job to claim.
    pub fn notify_work(&self) {
        self.work.notify_one();
    }

    /// Notifies the sender of webhooks that there is something to deliver.
    pub fn notify_deliveries(&self) {
        self.deliveries.notify_one();
    }

    /// A stream of the ids of jobs that change from now on. A listener that falls behind gets an error, and must then read the job from the
    /// store.
    #[must_use]
    pub fn listen(&self) -> broadcast::Receiver<JobId> {
        self.changed.subscribe()
    }

    /// Waits until there may be work.
    pub async fn work(&self) {
        self.work.notified().await;
    }

    /// Waits until there may be something to deliver.
    pub async fn deliveries(&self) {
        self.deliveries.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_with_jitter_and_stop_growing_at_the_longest() {
        let policy = RetryPolicy {
            first_delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(60),
            ..RetryPolicy::default()
        };
        for (tries, low, high) in [(1, 500, 1000), (2, 1000, 2000), (5, 8000, 16_000), (30, 30_000, 60_000)] {
            for random in [0, 1, u64::MAX / 3, u64::MAX] {
                let delay = policy.delay(tries, random).as_millis();
                assert!((low..=high).contains(&delay), "try {tries}: {delay} ms");
            }
        }
        assert_ne!(policy.delay(3, 1), policy.delay(3, 999_999_999));
    }
}
