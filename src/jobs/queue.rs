use std::time::Duration;

use async_trait::async_trait;

use super::{Artifacts, Job, JobId, JobProblem, JobProgress, JobReport, StoreError};

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

/// The queue of jobs, the leases on claimed jobs, and the ends of attempts.
///
/// Any number of processes may share one store. A job is claimed in one short transaction under a lease. The worker that holds the
/// lease extends it by [`heartbeat`](Self::heartbeat). When the lease expires, [`rescue`](Self::rescue) makes the job claimable again.
#[async_trait]
pub trait QueueStore: Send + Sync {
    /// How many jobs are queued, in all and of the tenant.
    async fn waiting(&self, tenant: &str) -> Result<Waiting, StoreError>;

    /// Jobs of its tenant that will be claimed before this one; none if this job is not queued.
    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError>;

    /// How long the job has been due that will be claimed next; zero if no queued job is due.
    async fn longest_wait(&self) -> Result<Duration, StoreError>;

    /// The queued and running jobs of each class of tenants that has any.
    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError>;

    /// Claims a job that is due, if there is one, under a lease of `lease`. Tenants take turns: first the tenant with the fewest running
    /// jobs, then the tenant that was served longest ago; of its jobs the one that has been due longest. Tenants with `max_running`
    /// running jobs, or as many as their own limit, are passed over.
    async fn claim(&self, worker: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError>;

    /// Extends a lease to `lease` from now and records the progress.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's; the worker must stop.
    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError>;

    /// Ends a job with a result and publishes its artifacts. Idempotent, as is [`fail`](Self::fail): a worker that lost the response
    /// may retry and gets the same result.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's; nothing was changed.
    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError>;

    /// Records a failed attempt: the job is queued for a retry or fails for good.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's; nothing was changed.
    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError>;

    /// Releases a claimed job unfinished and does not count the attempt, as at a shutdown.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's; nothing was changed.
    async fn hand_back(&self, held: &Lease) -> Result<(), StoreError>;

    /// Requeues jobs whose lease expired, or fails those whose leases expired too often.
    async fn rescue(&self) -> Result<Vec<Job>, StoreError>;
}
