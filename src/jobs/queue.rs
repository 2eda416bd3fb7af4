//! What goes into the queue and comes out of it: new jobs, leases, the ends of attempts, retries, and notifications of all these.

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
    /// The id, made by the caller because the keys of the files contain it.
    pub id: JobId,
    /// The files, at least one.
    pub inputs: Vec<Input>,
    /// The tenant that owns the job.
    pub tenant: String,
    /// The id of the API key that submitted the job.
    pub made_by: Option<String>,
    /// What to do.
    pub options: JobOptions,
    /// The client's own notes.
    pub metadata: Metadata,
    /// The address to notify of the job's end.
    pub callback_url: Option<String>,
    /// A hash of all that determines the result: bytes, options, engine.
    pub fingerprint: String,
    /// The result of an earlier job with the same fingerprint. A job with such a result has ended when it is accepted.
    pub result: Option<Reused>,
    /// The request's idempotency key, which must be held for the job.
    pub key: Option<RequestKey>,
    /// The upload that the job is made of. An upload becomes one job at most.
    pub upload: Option<UploadId>,
    /// The request's position in a trace, which the worker continues.
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
            made_by: None,
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
    /// The report.
    pub report: StoredReport,
    /// The files, copied for the new job.
    pub artifacts: Artifacts,
}

/// How long a request that is being handled holds its idempotency key; the request extends the hold in time.
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
    /// The key is held for the asking job, for [`KEY_HOLD`].
    Held,
    /// Another request that is not finished holds the key.
    InUse,
    /// A request with this key was accepted as a job.
    Used {
        /// The fingerprint of that request.
        fingerprint: String,
        /// The job of that request.
        job: JobId,
    },
}

/// How long the bytes of an upload may be sent to its address.
pub const UPLOAD_OPEN: Duration = Duration::from_secs(3600);
/// How long an upload may become a job; then it is deleted.
pub const UPLOAD_LIFE: Duration = Duration::from_secs(24 * 3600);

/// An upload to announce, before its bytes arrive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewUpload {
    /// Its id.
    pub id: UploadId,
    /// The tenant that owns it.
    pub tenant: String,
    /// The file's name, if the client gave one.
    pub name: Option<String>,
    /// SHA-256 of the token in its address, in hexadecimal; `None` for an address outside this service.
    pub token_sha256: Option<String>,
}

/// An announced upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PendingUpload {
    /// The announcement.
    pub upload: NewUpload,
    /// When it was announced.
    pub created_at: OffsetDateTime,
    /// Whether its bytes may still be sent. They may for [`UPLOAD_OPEN`], until a job uses the upload.
    pub is_open: bool,
    /// The job that uses it.
    pub job: Option<JobId>,
}

/// A worker's lease on a job. Every write of that worker is fenced by all three values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub id: JobId,
    /// The number of the attempt.
    pub attempt: u32,
    /// A random text, new with every claim.
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
    /// The failure is transient: the job is retried up to the policy's attempts.
    Transient,
    /// The child process crashed: the job is retried up to the policy's crashes.
    Crash,
}

/// A failed attempt.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Whether the attempt may be retried.
    pub kind: FailureKind,
    /// The cause; it becomes the job's problem if this was the last attempt.
    pub problem: JobProblem,
    /// The report, if the attempt had a result that was refused.
    pub report: Option<JobReport>,
    /// Files to keep, such as the log.
    pub artifacts: Artifacts,
}

/// How many jobs are queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Waiting {
    /// Of all tenants.
    pub all: u64,
    /// Of one tenant.
    pub of_tenant: u64,
}

/// The queued and running jobs of a class of tenants.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassLoad {
    /// The class.
    pub class: String,
    /// How many are queued.
    pub queued: u64,
    /// How many run.
    pub running: u64,
    /// How long the first queued job has been due; zero if no queued job is due.
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
    /// Whether a failure of this kind is final, at that attempt and after so many crashes.
    #[must_use]
    pub fn ends(&self, kind: FailureKind, attempt: u32, crashes: u32) -> bool {
        match kind {
            FailureKind::Final => true,
            FailureKind::Transient => attempt >= self.max_attempts,
            FailureKind::Crash => crashes >= self.max_crashes,
        }
    }

    /// The delay after failed attempt number `tries`, counted from 1. It grows exponentially, and its upper half is random
    /// jitter, so that jobs that failed together are not retried together. `random` is any 64 random bits.
    #[must_use]
    pub fn delay(&self, tries: u32, random: u64) -> Duration {
        let doubled = self.first_delay.saturating_mul(1_u32 << tries.saturating_sub(1).min(20));
        let longest = doubled.min(self.longest_delay);
        let half = longest / 2;
        let nanos = u64::try_from(half.as_nanos()).unwrap_or(u64::MAX);
        half + Duration::from_nanos(if nanos == 0 { 0 } else { random % nanos })
    }
}

/// Notifies waiting requests and idle workers of one process when a job changes or work arrives, so that they need not poll. A
/// notification can be missed (another process has its own notifier), so every listener also polls at intervals.
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
        // No listener is no error.
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

    /// A stream of the ids of jobs that change from now on. A listener that falls behind gets an error, and must read the store.
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
