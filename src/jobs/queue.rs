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

/// How long a request that is under way holds its key; it asks again in time.
pub const KEY_HOLD: Duration = Duration::from_secs(30);
/// How long the key of an accepted request is known.
pub const KEY_LIFE: Duration = Duration::from_secs(24 * 3600);

/// The key of a request, and what tells it from other requests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestKey {
    /// As the client sent it.
    pub key: String,
    /// A hash of files and options.
    pub fingerprint: String,
}

/// What is known of a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KeyState {
    /// It is held for the job that asked, for [`KEY_HOLD`].
    Held,
    /// Another request holds it.
    InUse,
    /// A request with this fingerprint was accepted as this job.
    Used {
        /// Of that request.
        fingerprint: String,
        /// That job.
        job: JobId,
    },
}

/// How long an upload may be sent to its address.
pub const UPLOAD_OPEN: Duration = Duration::from_secs(3600);
/// How long a job may be made of an upload; those of which none was made then go.
pub const UPLOAD_LIFE: Duration = Duration::from_secs(24 * 3600);

/// An upload to announce, before any of its bytes have come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewUpload {
    /// Its name.
    pub id: UploadId,
    /// Whose it is.
    pub tenant: String,
    /// The file's name, if it was told.
    pub name: Option<String>,
    /// SHA-256 of what its address must say, in hexadecimal; none where the address is not this service's.
    pub token_sha256: Option<String>,
}

/// An upload that was announced.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PendingUpload {
    /// What was said of it.
    pub upload: NewUpload,
    /// When.
    pub created_at: OffsetDateTime,
    /// Whether its bytes may still be sent, which is so for [`UPLOAD_OPEN`].
    pub is_open: bool,
    /// The job that was made of it.
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
    Passing,
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

/// How often a job is tried again and how long after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RetryPolicy {
    /// Claims after which a failure that might pass (a full disk, a lost connection) is final.
    pub max_attempts: u32,
    /// Times a job may take its worker or its child process down before it is set aside.
    pub max_crashes: u32,
    /// Wait before the second try; it doubles with each further one.
    pub first_delay: Duration,
    /// Longest wait.
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
    /// Whether a job that failed so, at that attempt and after so many crashes, is not tried again.
    #[must_use]
    pub fn ends(&self, kind: FailureKind, attempt: u32, crashes: u32) -> bool {
        match kind {
            FailureKind::Final => true,
            FailureKind::Passing => attempt >= self.max_attempts,
            FailureKind::Crash => crashes >= self.max_crashes,
        }
    }

    /// The wait after try number `tries` (1 for the first) failed: exponential with full jitter over its upper half, so
    /// that jobs which failed together don't come back together. `random` is any 64 random bits.
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
/// notification can be missed (another process has its own notifier), so every listener also polls now and then.
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

    /// A stream of the ids of jobs that change from now on. A listener that falls behind is told so and must look.
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
