//! The store: one trait for each subject, and [`Store`] for all of them.

use std::time::Duration;

use async_trait::async_trait;

use super::error::StoreError;
use super::id::{JobId, UploadId};
use super::job::{Artifacts, Job, JobOutcome, JobProgress, Metadata, Status};
use super::profiles::{NewProfile, TenantProfile};
use super::queue::{
    Claim, ClassLoad, Completion, Failure, KeyState, Lease, NewJob, NewUpload, Notifier, PendingUpload, QueuedCounts,
};
use super::webhooks::{
    Backlog, Delivery, DeliveryAttempt, DeliveryQuery, DeliveryResult, DueDelivery, Endpoint, EndpointChange,
    NewEndpoint, Secrets, SigningSecret,
};
use crate::access::{AccessKey, KeyQuery, NewKey, SecretHash, Tenant, TenantChange, TenantLimits, TenantName};

/// The result of a request to cancel a job.
#[derive(Debug, Clone, PartialEq)]
pub enum CancelResult {
    /// The job is canceled; it may have been canceled before.
    Canceled(Box<Job>),
    /// The job had ended in another way.
    AlreadyEnded(Box<Job>),
}

impl CancelResult {
    /// The result for a job that has ended.
    pub(super) fn of_ended(job: Job) -> Self {
        if job.status == Status::Canceled { Self::Canceled(Box::new(job)) } else { Self::AlreadyEnded(Box::new(job)) }
    }
}

/// The jobs to list, newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ListQuery {
    /// Only jobs of this tenant.
    pub tenant: String,
    /// Only jobs submitted with this key.
    pub api_key_id: Option<String>,
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
    /// The items, newest first. Jobs have no reports here.
    pub items: Vec<T>,
    /// The id to pass as `before` for the next page, if there is one.
    pub next: Option<Id>,
}

impl<T, Id> Page<T, Id> {
    /// A page of at most `limit` of `items`. An item beyond the limit shows that there is a next page.
    pub(super) fn of(mut items: Vec<T>, limit: u32, id: impl FnOnce(&T) -> Id) -> Self {
        let has_next = items.len() > limit as usize;
        items.truncate(limit as usize);
        let next = items.last().filter(|_| has_next).map(id);
        Self { items, next }
    }
}

/// The number of jobs with one status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StatusCount {
    /// The status.
    pub status: Status,
    /// The number of jobs.
    pub count: u64,
}

/// The connections to a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Connections {
    /// Connections that run a statement.
    pub busy: u32,
    /// Open connections without work.
    pub idle: u32,
    /// The maximum number of connections.
    pub most: u32,
}

impl Connections {
    /// The connections of a pool.
    pub(super) fn of<D: sqlx::Database>(pool: &sqlx::Pool<D>) -> Self {
        let idle = u32::try_from(pool.num_idle()).unwrap_or(u32::MAX);
        Self { busy: pool.size().saturating_sub(idle), idle, most: pool.options().get_max_connections() }
    }
}

impl StatusCount {
    /// The counts of all statuses, from the rows of those that have jobs.
    pub(super) fn of_all(rows: &[(String, i64)]) -> Vec<Self> {
        let count = |status: Status| {
            let found = rows.iter().find(|(name, _)| name == status.as_str());
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

    /// Stops a job. The worker of a running job loses its lease, which it learns at its next heartbeat or by a notification.
    async fn cancel(&self, id: JobId) -> Result<Option<CancelResult>, StoreError>;
}

/// The queue of jobs, the leases on claimed jobs, and the ends of attempts.
///
/// Any number of processes may share one store. A job is claimed in one short transaction under a lease. The worker that holds
/// the lease extends it by [`heartbeat`](Self::heartbeat). When the lease expires,
/// [`requeue_expired`](Self::requeue_expired) makes the job claimable again.
#[async_trait]
pub trait QueueStore: Send + Sync {
    /// How many jobs are queued, in total and of the tenant.
    async fn queued_counts(&self, tenant: &str) -> Result<QueuedCounts, StoreError>;

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

    /// Releases a claimed job unfinished and does not count the attempt, as at a shutdown. If an earlier write of this worker ended the
    /// attempt and the response was lost, that end stands.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's; nothing was changed.
    async fn release(&self, held: &Lease) -> Result<(), StoreError>;

    /// Requeues jobs whose lease expired, or fails those whose leases expired too often.
    async fn requeue_expired(&self) -> Result<Vec<Job>, StoreError>;
}

/// Where idempotency keys are kept: the keys of requests that may be repeated and must make only one job.
#[async_trait]
pub trait IdempotencyStore: Send + Sync {
    /// Holds the key of a request for the job that the request is to make, or returns who has the key. A second call for the same job
    /// extends the hold.
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError>;

    /// Releases the key of a request that was refused.
    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError>;

    /// Deletes expired keys. Returns how many.
    async fn forget_keys(&self) -> Result<u64, StoreError>;
}

/// Where uploads are kept: files that clients send before they ask for a job.
#[async_trait]
pub trait UploadStore: Send + Sync {
    /// Adds an upload; `None` if `max` uploads already wait for a job.
    async fn add_upload(&self, upload: NewUpload, max: u64) -> Result<Option<PendingUpload>, StoreError>;

    /// One upload that may still become a job, or became one not long ago.
    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError>;

    /// Deletes expired uploads. An upload that became a job is kept as long as the key of that job's request may be. Returns how many.
    async fn forget_uploads(&self) -> Result<u64, StoreError>;
}

/// Where drawings of ended jobs are requested and claimed. A worker draws them at the first request, so that a job whose drawings nobody
/// requests costs no more than a job without.
#[async_trait]
pub trait DrawingStore: Send + Sync {
    /// Requests the pictures of a job that has ended. Repeated requests before they are drawn have no effect.
    async fn request_drawings(&self, job: JobId) -> Result<(), StoreError>;

    /// Claims the drawings of a job, if any are requested, under a lease of `lease`. Tenants with the fewest drawings under way go
    /// first, and of their jobs the one requested longest ago. Drawings with an expired lease can be claimed again.
    async fn claim_drawings(&self, lease: Duration) -> Result<Option<Claim>, StoreError>;

    /// Extends the lease on a job's drawings to `lease` from now.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's.
    async fn hold_drawings(&self, held: &Lease, lease: Duration) -> Result<(), StoreError>;

    /// Publishes what was drawn. The job's other pictures can't be drawn, so they are removed from its artifacts.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the lease is no longer this worker's, or the job's files were deleted.
    async fn finish_drawings(&self, held: &Lease, drawn: Artifacts) -> Result<Job, StoreError>;
}

/// How jobs lose their content and their records.
#[async_trait]
pub trait RetentionStore: Send + Sync {
    /// Empties the rows of jobs that ended `age` ago, at most `max` of them, and marks them as expired. The caller deletes their files.
    async fn expire(&self, age: Duration, max: u32) -> Result<Vec<JobId>, StoreError>;

    /// Deletes the rows of jobs that ended `age` ago and are expired or purged. Returns how many.
    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError>;

    /// Empties a job's row, and cancels the job first if it has not ended. The caller then deletes its files. False if there is no such
    /// job.
    async fn purge(&self, id: JobId) -> Result<bool, StoreError>;
}

/// Where API keys and the limits of tenants are kept.
#[async_trait]
pub trait AccessStore: Send + Sync {
    /// Creates a key whose secret has this hash.
    async fn create_key(&self, key: NewKey, hash: &SecretHash) -> Result<AccessKey, StoreError>;

    /// Returns the key whose secret has this hash, with its tenant's limits; none if the key or its parent is unknown, revoked or expired.
    async fn find_key(&self, hash: &SecretHash) -> Result<Option<(AccessKey, TenantLimits)>, StoreError>;

    /// Records that a key was used.
    async fn touch_key(&self, id: &str) -> Result<(), StoreError>;

    /// One page of API keys, newest first, revoked ones too. Browser tokens are not listed.
    async fn keys(&self, query: KeyQuery) -> Result<Page<AccessKey, String>, StoreError>;

    /// Revokes a key, and with it the tokens made with it. False if there is no such key or it was revoked before.
    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError>;

    /// Deletes expired browser tokens. Returns how many.
    async fn forget_tokens(&self) -> Result<u64, StoreError>;

    /// The limits that are set for a tenant.
    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError>;

    /// Changes the settings of a tenant that `change` names, and returns all of them. A tenant without settings gets its first.
    async fn change_tenant(&self, tenant: &TenantName, change: TenantChange) -> Result<Tenant, StoreError>;

    /// One page of the tenants that have settings or an API key, sorted by name, starting after `after`.
    async fn tenants(&self, after: Option<&str>, limit: u32) -> Result<Page<Tenant, String>, StoreError>;

    /// One tenant; none if it has neither settings nor an API key.
    async fn tenant(&self, name: &str) -> Result<Option<Tenant>, StoreError>;
}

/// Where the process profiles of tenants are kept.
#[async_trait]
pub trait ProfileStore: Send + Sync {
    /// The tenant's profiles, sorted by name.
    async fn profiles(&self, tenant: &str) -> Result<Vec<TenantProfile>, StoreError>;

    /// One of the tenant's profiles.
    async fn profile(&self, tenant: &str, name: &str) -> Result<Option<TenantProfile>, StoreError>;

    /// Adds a profile; `None` if the tenant has a profile of this name, or already has `max` profiles.
    async fn add_profile(&self, tenant: &str, new: &NewProfile, max: u32) -> Result<Option<TenantProfile>, StoreError>;

    /// Replaces the limits of a profile; `None` if there is none, or if it is no longer as `expected`.
    async fn replace_profile(
        &self,
        tenant: &str,
        new: &NewProfile,
        expected: Option<&TenantProfile>,
    ) -> Result<Option<TenantProfile>, StoreError>;

    /// Deletes a profile. False if there is none, or if it is no longer as `expected`.
    async fn delete_profile(
        &self,
        tenant: &str,
        name: &str,
        expected: Option<&TenantProfile>,
    ) -> Result<bool, StoreError>;
}

/// The result of a request to send a delivery again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RedeliveryResult {
    /// The delivery is due now.
    Due,
    /// Its endpoint is disabled.
    Disabled,
    /// The tenant has no such delivery.
    Unknown,
}

/// Where webhook endpoints and the secrets of callbacks are kept.
#[async_trait]
pub trait EndpointStore: Send + Sync {
    /// Adds an endpoint; `None` if the tenant already has `max` endpoints.
    async fn create_endpoint(&self, new: NewEndpoint, max: u32) -> Result<Option<Endpoint>, StoreError>;

    /// The tenant's endpoints, oldest first.
    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError>;

    /// One of the tenant's endpoints.
    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError>;

    /// Changes an endpoint. Disabling it fails its pending deliveries.
    async fn change_endpoint(
        &self,
        tenant: &str,
        id: &str,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreError>;

    /// Gives an endpoint a new secret. The old secret also signs for `keep`.
    async fn rotate_endpoint(
        &self,
        tenant: &str,
        id: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Option<Endpoint>, StoreError>;

    /// Removes an endpoint with its deliveries. False if there is none.
    async fn delete_endpoint(&self, tenant: &str, id: &str) -> Result<bool, StoreError>;

    /// The secrets of the tenant's callbacks. A tenant without a secret gets `fresh`.
    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError>;

    /// Gives the tenant's callbacks a new secret. The old secret also signs for `keep`.
    async fn rotate_callback_secret(
        &self,
        tenant: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Secrets, StoreError>;
}

/// Where webhook messages and their deliveries are kept: the outbox.
///
/// The transaction that ends a job writes the messages about it. A delivery is claimed under a lease and is due again when the lease
/// expires, so each message arrives at least once.
#[async_trait]
pub trait DeliveryStore: Send + Sync {
    /// Sends a test message to an endpoint, and returns the delivery's id; `None` if the endpoint does not exist or is disabled.
    async fn send_ping(&self, tenant: &str, endpoint: &str) -> Result<Option<String>, StoreError>;

    /// The tenant's deliveries, newest first.
    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError>;

    /// Makes a delivery due now, whatever its status. A delivery that is not pending gets its full number of attempts again.
    async fn redeliver(&self, tenant: &str, id: &str) -> Result<RedeliveryResult, StoreError>;

    /// Claims a delivery that is due, if there is one, under a lease of `lease`. Tenants with the fewest deliveries under way go first,
    /// and of their deliveries the one that has been due longest. Tenants with `max` deliveries under way are passed over.
    async fn claim_delivery(&self, lease: Duration, max: u32) -> Result<Option<DueDelivery>, StoreError>;

    /// Records the result of a claimed delivery, unless the claim is lost. Returns whether this disabled the endpoint, because the
    /// receiver is gone or every delivery has failed for [`FAILING`](super::FAILING).
    async fn settle_delivery(
        &self,
        due: &DueDelivery,
        attempt: DeliveryAttempt,
        result: DeliveryResult,
    ) -> Result<bool, StoreError>;

    /// How many deliveries are pending.
    async fn backlog(&self) -> Result<Backlog, StoreError>;

    /// Deletes messages that were created `age` ago, with their deliveries. Returns how many.
    async fn forget_messages(&self, age: Duration) -> Result<u64, StoreError>;
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
    + ProfileStore
    + EndpointStore
    + DeliveryStore
{
    /// Checks that the database answers.
    async fn ping(&self) -> Result<(), StoreError>;

    /// The connections to the database that this process holds now.
    fn connections(&self) -> Connections;

    /// Notifies when jobs change through this store object.
    fn notifier(&self) -> &Notifier;
}
