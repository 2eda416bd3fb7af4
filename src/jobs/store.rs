use async_trait::async_trait;

use super::{
    AccessStore, Artifacts, Bell, DeliveryStore, DrawingStore, EndpointStore, IdempotencyStore, Input, Job, JobId,
    JobOptions, JobOutcome, Metadata, QueueStore, RequestKey, RetentionStore, Status, StoreError, StoredReport,
    UploadId, UploadStore,
};

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

/// The result of a request to cancel a job.
#[derive(Debug, Clone, PartialEq)]
pub enum Cancelled {
    /// The job is canceled now, or was before.
    Yes(Box<Job>),
    /// The job had ended otherwise.
    TooLate(Box<Job>),
}

impl Cancelled {
    /// The result for a job that has ended.
    pub(super) fn of_ended(job: Job) -> Self {
        if job.status == Status::Canceled { Self::Yes(Box::new(job)) } else { Self::TooLate(Box::new(job)) }
    }
}

/// The jobs to list, newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ListQuery {
    /// Only jobs of this tenant.
    pub tenant: String,
    /// Only jobs submitted with this key.
    pub made_by: Option<String>,
    /// Only jobs of these statuses; of any status if empty.
    pub statuses: Vec<Status>,
    /// Only jobs of these outcomes; any job if empty, with an outcome or not.
    pub outcomes: Vec<JobOutcome>,
    /// Only jobs accepted at this time or later, in milliseconds since the Unix epoch.
    pub created_from: Option<i64>,
    /// Only jobs accepted before this time.
    pub created_before: Option<i64>,
    /// Only jobs whose metadata contains these entries.
    pub metadata: Metadata,
    /// Only jobs older than this one.
    pub before: Option<JobId>,
    /// The most jobs to list.
    pub limit: u32,
}

/// One page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page<T, Id> {
    /// What is on it, newest first; jobs without their reports.
    pub items: Vec<T>,
    /// Where the next page begins, if there is one.
    pub next: Option<Id>,
}

impl<T, Id> Page<T, Id> {
    /// A page of at most `limit` items, of which there is one more where there is a next page.
    pub(super) fn of(mut items: Vec<T>, limit: u32, id: impl FnOnce(&T) -> Id) -> Self {
        let more = items.len() > limit as usize;
        items.truncate(limit as usize);
        let next = items.last().filter(|_| more).map(id);
        Self { items, next }
    }
}

/// How many jobs there are of one status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StatusCount {
    /// The status.
    pub status: Status,
    /// How many.
    pub count: u64,
}

/// Connections to a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Connections {
    /// At work.
    pub busy: u32,
    /// Open, with nothing to do.
    pub idle: u32,
    /// Most that there may be.
    pub most: u32,
}

impl Connections {
    /// Those of a pool.
    pub(super) fn of<D: sqlx::Database>(pool: &sqlx::Pool<D>) -> Self {
        let idle = u32::try_from(pool.num_idle()).unwrap_or(u32::MAX);
        Self { busy: pool.size().saturating_sub(idle), idle, most: pool.options().get_max_connections() }
    }
}

impl StatusCount {
    /// The counts of all statuses from those that were found.
    pub(super) fn of_all(found: &[(String, i64)]) -> Vec<Self> {
        let count = |status: Status| {
            let found = found.iter().find(|(name, _)| name == status.as_str());
            Self { status, count: found.map_or(0, |(_, n)| n.unsigned_abs()) }
        };
        Status::ALL.into_iter().map(count).collect()
    }
}

/// The jobs that the service keeps.
#[async_trait]
pub trait JobStore: Send + Sync {
    /// Accepts a job, together with its request's key and the upload that it is made of. When this returns, the job is on disk.
    ///
    /// # Errors
    /// [`StoreError::KeyLost`] when the key is no longer held for the job, [`StoreError::UploadTaken`] when the upload is used or gone;
    /// nothing was changed.
    async fn submit(&self, job: NewJob) -> Result<Job, StoreError>;

    /// One job; none if there never was a job of that name.
    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError>;

    /// One page of jobs that are not purged.
    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError>;

    /// The newest job of the tenant that succeeded with this fingerprint.
    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError>;

    /// How many jobs there are of each status.
    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError>;

    /// Stops a job. The worker of a running job loses its lease, which it learns at its next heartbeat or by the bell.
    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError>;
}

/// All that the service keeps in its database, by subject.
#[async_trait]
pub trait Store:
    JobStore
    + QueueStore
    + IdempotencyStore
    + UploadStore
    + DrawingStore
    + RetentionStore
    + AccessStore
    + EndpointStore
    + DeliveryStore
{
    /// Checks that the database answers.
    async fn ping(&self) -> Result<(), StoreError>;

    /// The connections to the database that this process holds now.
    fn connections(&self) -> Connections;

    /// Rings when jobs change through this store object.
    fn bell(&self) -> &Bell;
}
