//! Requests to the database and its answers, as values that the simulated network can lose, delay and repeat.

use std::time::Duration;

use meshmend::jobs::{
    CancelResult, Claim, Completion, DeliveryAttempt, DeliveryResult, DeliveryStore, DueDelivery, Failure,
    IdempotencyStore, Job, JobId, JobProgress, JobStore, KeyState, Lease, NewJob, QueueStore, StoreError,
};

use super::plan::LEASE;

/// The parts of the store that take part in the protocol.
pub trait FleetStore: JobStore + QueueStore + IdempotencyStore + DeliveryStore {}

impl<S: JobStore + QueueStore + IdempotencyStore + DeliveryStore> FleetStore for S {}

/// How long the claim of a delivery lasts.
pub const DELIVERY_LEASE: Duration = Duration::from_secs(8);
/// How many deliveries of a tenant may be under way.
pub const DELIVERIES_PER_TENANT: u32 = 4;

/// The kind of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    Submit,
    Get,
    Cancel,
    HoldKey,
    ReleaseKey,
    Claim,
    Heartbeat,
    Complete,
    Fail,
    Release,
    RequeueExpired,
    ClaimDelivery,
    Settle,
}

/// A call of one of the store's methods.
#[derive(Debug, Clone)]
pub enum Request {
    Submit(Box<NewJob>),
    Get(JobId),
    Cancel(JobId),
    HoldKey { tenant: String, key: String, job: JobId },
    ReleaseKey { tenant: String, key: String, job: JobId },
    Claim { worker: String, max_running: u32 },
    Heartbeat(Lease, Option<JobProgress>),
    Complete(Lease, Box<Completion>),
    Fail(Lease, Box<Failure>),
    Release(Lease),
    RequeueExpired,
    ClaimDelivery,
    Settle(Box<DueDelivery>, DeliveryAttempt, DeliveryResult),
}

/// What a request returned.
#[derive(Debug, Clone)]
pub enum Answer {
    Job(Box<Job>),
    Found(Option<Box<Job>>),
    Canceled(Option<CancelResult>),
    Key(KeyState),
    Claimed(Option<Box<Claim>>),
    Done,
    Requeued(Vec<Job>),
    Due(Option<Box<DueDelivery>>),
    Settled,
}

impl Request {
    pub fn kind(&self) -> Kind {
        match self {
            Self::Submit(_) => Kind::Submit,
            Self::Get(_) => Kind::Get,
            Self::Cancel(_) => Kind::Cancel,
            Self::HoldKey { .. } => Kind::HoldKey,
            Self::ReleaseKey { .. } => Kind::ReleaseKey,
            Self::Claim { .. } => Kind::Claim,
            Self::Heartbeat(..) => Kind::Heartbeat,
            Self::Complete(..) => Kind::Complete,
            Self::Fail(..) => Kind::Fail,
            Self::Release(_) => Kind::Release,
            Self::RequeueExpired => Kind::RequeueExpired,
            Self::ClaimDelivery => Kind::ClaimDelivery,
            Self::Settle(..) => Kind::Settle,
        }
    }

    /// The lease in whose name the request is made, if it is made under one.
    pub fn lease(&self) -> Option<&Lease> {
        match self {
            Self::Heartbeat(held, _) | Self::Complete(held, _) | Self::Fail(held, _) | Self::Release(held) => {
                Some(held)
            }
            _ => None,
        }
    }

    /// Calls the store.
    pub async fn execute(self, store: &dyn FleetStore) -> Result<Answer, StoreError> {
        let lease = Duration::from_millis(LEASE);
        Ok(match self {
            Self::Submit(new) => Answer::Job(Box::new(store.submit(*new).await?)),
            Self::Get(id) => Answer::Found(store.get(id).await?.map(Box::new)),
            Self::Cancel(id) => Answer::Canceled(store.cancel(id).await?),
            Self::HoldKey { tenant, key, job } => Answer::Key(store.hold_key(&tenant, &key, job).await?),
            Self::ReleaseKey { tenant, key, job } => {
                store.release_key(&tenant, &key, job).await?;
                Answer::Done
            }
            Self::Claim { worker, max_running } => {
                Answer::Claimed(store.claim(&worker, lease, max_running).await?.map(Box::new))
            }
            Self::Heartbeat(held, progress) => {
                store.heartbeat(&held, lease, progress).await?;
                Answer::Done
            }
            Self::Complete(held, completion) => Answer::Job(Box::new(store.complete(&held, *completion).await?)),
            Self::Fail(held, failure) => Answer::Job(Box::new(store.fail(&held, *failure).await?)),
            Self::Release(held) => {
                store.release(&held).await?;
                Answer::Done
            }
            Self::RequeueExpired => Answer::Requeued(store.requeue_expired().await?),
            Self::ClaimDelivery => {
                Answer::Due(store.claim_delivery(DELIVERY_LEASE, DELIVERIES_PER_TENANT).await?.map(Box::new))
            }
            Self::Settle(due, attempt, result) => {
                store.settle_delivery(&due, attempt, result).await?;
                Answer::Settled
            }
        })
    }
}
