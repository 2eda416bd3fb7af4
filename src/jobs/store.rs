use std::time::Duration;

use async_trait::async_trait;
use sqlx::error::DatabaseError;
use sqlx::sqlite::SqliteError;

use super::row::elapsed;
use super::{
    Artifacts, Bell, Input, Job, JobId, JobOptions, JobOutcome, JobProblem, JobProgress, JobReport, KeyState, Metadata,
    RequestKey, Status, StoredReport, UploadId, UploadStore,
};
use crate::telemetry;

/// What went wrong in the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database said no.
    #[error("database: {0}")]
    Database(#[source] sqlx::Error),
    /// The migrations could not be run.
    #[error("migration: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// A row holds what this version can't read.
    #[error("job {id}: column {column} can't be read: {reason}")]
    Corrupt {
        /// The row's id.
        id: String,
        /// The column.
        column: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The request took so long that its idempotency key went to another one.
    #[error("the idempotency key is another request's now")]
    KeyLost,
    /// Another job was made of the upload, or its time is over.
    #[error("the upload is another job's now, or gone")]
    UploadTaken,
    /// The lease is no longer this worker's: it ran out, or the job was canceled or deleted.
    #[error("the lease on this job was lost")]
    LeaseLost,
}

impl StoreError {
    /// Whether the same may succeed in a while: the database is away or not ready, or the connection broke. What was asked may
    /// have been done all the same.
    #[must_use]
    pub fn may_pass(&self) -> bool {
        use sqlx::Error as E;
        let Self::Database(error) = self else { return false };
        if let Some(code) = sqlite_code(error) {
            return SQLITE_PASSES.contains(&code);
        }
        match error {
            E::Io(_) | E::Tls(_) | E::Protocol(_) | E::PoolTimedOut | E::WorkerCrashed => true,
            // Connection exceptions, the server's resources, its operator, and timeouts (PostgreSQL, appendix A).
            E::Database(error) => error.code().is_some_and(|code| {
                code.len() == 5 && ["08", "53", "57", "55P03"].iter().any(|class| code.starts_with(class))
            }),
            _ => false,
        }
    }

    /// Whether it is for want of room on the database's disk.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let Self::Database(error) = self else { return false };
        match sqlite_code(error) {
            Some(code) => code == SQLITE_FULL,
            None => error.as_database_error().is_some_and(|error| error.code().as_deref() == Some("53100")),
        }
    }
}

const SQLITE_FULL: u32 = 13;
/// SQLite's results that another time may be others: busy, locked, read-only, a failed read or write, full.
const SQLITE_PASSES: [u32; 5] = [5, 6, 8, 10, SQLITE_FULL];

/// The primary result code of an error of SQLite's (its documentation, "Result and Error Codes").
pub(super) fn sqlite_code(error: &sqlx::Error) -> Option<u32> {
    let error = error.as_database_error()?.try_downcast_ref::<SqliteError>()?;
    error.code()?.parse::<u32>().ok().map(|extended| extended & 0xff)
}

/// Counted here, where every error of a database passes.
impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        let error = Self::Database(error);
        let kind = if error.may_pass() { "away" } else { "other" };
        metrics::counter!(telemetry::STORE_ERRORS, "kind" => kind).increment(1);
        error
    }
}

/// A job to accept. Its files are in the blob store already.
#[derive(Debug, Clone, PartialEq)]
pub struct NewJob {
    /// The name, made by the caller because the files' keys hold it.
    pub id: JobId,
    /// The files, at least one.
    pub inputs: Vec<Input>,
    /// Whose it is.
    pub tenant: String,
    /// The key it was submitted with.
    pub made_by: Option<String>,
    /// What to do.
    pub options: JobOptions,
    /// The client's own notes.
    pub metadata: Metadata,
    /// Where to tell of its end.
    pub callback_url: Option<String>,
    /// A hash of what its result depends on: bytes, options, engine.
    pub fingerprint: String,
    /// The result of an earlier job with the same fingerprint: then it has ended as soon as it is accepted.
    pub result: Option<Reused>,
    /// The request's key, which must be held for it.
    pub key: Option<RequestKey>,
    /// The upload that it is made of, of which no other may be.
    pub upload: Option<UploadId>,
    /// Where the request stands in a trace, for the worker to go on from.
    pub traceparent: Option<String>,
}

impl NewJob {
    /// A job of a tenant that says nothing but what is to be done.
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
    /// That job.
    pub from: JobId,
    /// What became of the model.
    pub outcome: JobOutcome,
    /// The account.
    pub report: StoredReport,
    /// The files, copied for the new job.
    pub artifacts: Artifacts,
}

/// A worker's hold on a job. Every write under it is fenced by all three values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub id: JobId,
    /// The claim's number.
    pub attempt: u32,
    /// Random, new with every claim.
    pub token: String,
}

/// A job that a worker took.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// The hold on it.
    pub lease: Lease,
    /// The job.
    pub job: Job,
}

/// What a finished job leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct Completion {
    /// The account; its outcome becomes the job's.
    pub report: JobReport,
    /// The files, already in the blob store under the attempt's key.
    pub artifacts: Artifacts,
}

/// Whether and how a failure may be tried again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// Trying again would give the same: the job fails.
    Final,
    /// Something around the job failed: tried again up to the policy's attempts.
    Passing,
    /// The child process ended by itself: tried again up to the policy's crashes.
    Crash,
}

/// A failed attempt.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Whether it may be tried again.
    pub kind: FailureKind,
    /// Why; kept as the job's problem if this was the last try.
    pub problem: JobProblem,
    /// The account, where the work was done and its result is refused.
    pub report: Option<JobReport>,
    /// Files to keep, such as the log.
    pub artifacts: Artifacts,
}

/// What a request to cancel found.
#[derive(Debug, Clone, PartialEq)]
pub enum Cancelled {
    /// It is canceled now, or was before.
    Yes(Box<Job>),
    /// It had ended otherwise.
    TooLate(Box<Job>),
}

impl Cancelled {
    /// What a job says that was neither queued nor running.
    pub(super) fn of_ended(job: Job) -> Self {
        if job.status == Status::Canceled { Self::Yes(Box::new(job)) } else { Self::TooLate(Box::new(job)) }
    }
}

/// What to list: newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ListQuery {
    /// Of this tenant.
    pub tenant: String,
    /// Only jobs submitted with this key.
    pub made_by: Option<String>,
    /// Only jobs of these statuses; of any where there is none.
    pub statuses: Vec<Status>,
    /// Only jobs of these outcomes; of any, and without one, where there is none.
    pub outcomes: Vec<JobOutcome>,
    /// Only jobs accepted at this time or later, in milliseconds since the Unix epoch.
    pub created_from: Option<i64>,
    /// Only jobs accepted before this time.
    pub created_before: Option<i64>,
    /// Only jobs whose metadata has these entries, perhaps among others.
    pub metadata: Metadata,
    /// Only jobs older than this one.
    pub before: Option<JobId>,
    /// At most so many.
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

/// How many jobs wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Waiting {
    /// Of all tenants.
    pub all: u64,
    /// Of the one that was asked for.
    pub of_tenant: u64,
}

/// How many jobs there are of one status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StatusCount {
    /// The status.
    pub status: Status,
    /// How many.
    pub count: u64,
}

/// The jobs of a class of tenants that wait and run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassLoad {
    /// The class.
    pub class: String,
    /// How many wait.
    pub queued: u64,
    /// How many run.
    pub running: u64,
    /// How long the one has been due that waits longest; zero where none waits but for a retry's time.
    pub wait: Duration,
}

impl ClassLoad {
    /// What a row says: class, jobs that wait, jobs that run, milliseconds.
    pub(super) fn of_row((class, queued, running, wait): (String, i64, i64, Option<i64>)) -> Self {
        let wait = wait.map_or(Duration::ZERO, elapsed);
        Self { class, queued: queued.unsigned_abs(), running: running.unsigned_abs(), wait }
    }
}

/// Connections to a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

/// Where jobs are kept and queued.
///
/// Any number of processes may share one store. A job is claimed in one short transaction under a lease; whoever holds
/// the lease extends it by [`heartbeat`](Self::heartbeat), and when it runs out [`rescue`](Self::rescue) makes the job
/// claimable again.
#[async_trait]
pub trait JobStore: UploadStore {
    /// Holds the key of a request for the job that it is to make, or tells whose it is. Asked again by the same it holds longer.
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError>;

    /// Gives back the key of a request that was refused.
    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError>;

    /// Forgets keys whose time is over. Answers how many.
    async fn forget_keys(&self) -> Result<u64, StoreError>;

    /// Accepts a job, and notes its request's key and the upload that it is made of with it. When this returns, the job is on disk.
    ///
    /// # Errors
    /// [`StoreError::KeyLost`] when the key is no longer held for it, [`StoreError::UploadTaken`] when the upload is not to be had;
    /// nothing was changed.
    async fn submit(&self, job: NewJob) -> Result<Job, StoreError>;

    /// One job; none if there never was one of that name.
    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError>;

    /// One page of jobs that are not purged.
    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError>;

    /// The newest job of the tenant that succeeded with this fingerprint.
    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError>;

    /// How many jobs wait, in all and of the tenant.
    async fn waiting(&self, tenant: &str) -> Result<Waiting, StoreError>;

    /// Jobs of its tenant that will be claimed before this one; none if it does not wait.
    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError>;

    /// How long the job has been due that will be claimed next; zero where none waits but for a retry's time.
    async fn longest_wait(&self) -> Result<Duration, StoreError>;

    /// What waits and runs of each class of tenants that has something of it.
    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError>;

    /// How many jobs there are of each status.
    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError>;

    /// Takes a job that is due, if one is, and holds it for `lease`. Tenants take turns: the one with the fewest running jobs, then the
    /// one that was served longest ago; of its jobs the one that has been due longest. A tenant of which `max_running` jobs run,
    /// or as many as its own limit says, is passed over.
    async fn claim(&self, worker: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError>;

    /// Extends a lease to `lease` from now and notes the progress.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the job is no longer this worker's; the worker must stop.
    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError>;

    /// Ends a job with a result and publishes its artifacts. Asked again by who did not hear whether it had arrived, it answers
    /// as it did the first time; so does [`fail`](Self::fail).
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the job is no longer this worker's; nothing was changed.
    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError>;

    /// Notes a failed attempt: the job waits for its next try or fails for good.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the job is no longer this worker's; nothing was changed.
    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError>;

    /// Gives a job back unfinished and charges it nothing, as at a shutdown.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the job is no longer this worker's; nothing was changed.
    async fn hand_back(&self, held: &Lease) -> Result<(), StoreError>;

    /// Makes jobs whose lease ran out claimable again, or sets them aside when it has happened too often.
    async fn rescue(&self) -> Result<Vec<Job>, StoreError>;

    /// Stops a job. A running one is taken from its worker, which learns it at its next heartbeat or by the bell.
    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError>;

    /// Empties the rows of jobs that ended `age` ago, at most `most` of them, which are expired then. The caller deletes their files.
    async fn expire(&self, age: Duration, most: u32) -> Result<Vec<JobId>, StoreError>;

    /// Forgets jobs that ended `age` ago and are expired or were purged. Answers how many.
    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError>;

    /// Empties a job's row, canceling it first if need be. The caller then deletes its files. False if there is none.
    async fn purge(&self, id: JobId) -> Result<bool, StoreError>;

    /// Asks the database for a sign of life.
    async fn ping(&self) -> Result<(), StoreError>;

    /// The connections to the database that this process holds now.
    fn connections(&self) -> Connections;

    /// Rings when jobs change through this store object.
    fn bell(&self) -> &Bell;
}
