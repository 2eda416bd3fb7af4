use std::time::Duration;

use async_trait::async_trait;

use super::{
    Attempt, Backlog, Delivery, DeliveryQuery, DueDelivery, Endpoint, EndpointChange, NewEndpoint, Secrets,
    SigningSecret, Verdict,
};
use crate::jobs::{Page, StoreError};

/// What became of the wish to send something again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Redelivered {
    /// It is due now.
    Yes,
    /// Its endpoint is disabled.
    Disabled,
    /// The tenant has no such delivery.
    Unknown,
}

/// Where webhook endpoints and the outbox are kept.
///
/// The messages about a job are written by the statements of [`JobStore`](crate::jobs::JobStore) that end it, in their transactions. A
/// delivery is claimed under a lease; when that runs out it is due again, so each arrives at least once.
#[async_trait]
pub trait WebhookStore: Send + Sync {
    /// Makes an endpoint; none if the tenant has `most` of them already.
    async fn create_endpoint(&self, new: NewEndpoint, most: u32) -> Result<Option<Endpoint>, StoreError>;

    /// The tenant's endpoints, oldest first.
    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError>;

    /// One of the tenant's endpoints.
    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError>;

    /// Changes an endpoint. Disabling it gives up what waits for it.
    async fn change_endpoint(
        &self,
        tenant: &str,
        id: &str,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreError>;

    /// Gives an endpoint a new secret; the old one signs beside it for `keep`.
    async fn rotate_endpoint(
        &self,
        tenant: &str,
        id: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Option<Endpoint>, StoreError>;

    /// Removes an endpoint with its deliveries. False if there is none.
    async fn delete_endpoint(&self, tenant: &str, id: &str) -> Result<bool, StoreError>;

    /// The secret of the tenant's callbacks, which is `fresh` from now on if there was none.
    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError>;

    /// Gives the tenant's callbacks a new secret; the old one signs beside it for `keep`.
    async fn rotate_callback_secret(
        &self,
        tenant: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Secrets, StoreError>;

    /// Sends an endpoint a message of no consequence, and gives the delivery's name; none if it is not there or disabled.
    async fn send_ping(&self, tenant: &str, endpoint: &str) -> Result<Option<String>, StoreError>;

    /// The tenant's deliveries, newest first.
    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError>;

    /// Makes a delivery due now, whatever became of it; one that was given up gets all of its tries anew.
    async fn redeliver(&self, tenant: &str, id: &str) -> Result<Redelivered, StoreError>;

    /// Takes a delivery that is due, if one is, and holds it for `lease`. Tenants take turns: the one with the fewest under way, of
    /// its deliveries the one that has been due longest. A tenant of which `most` are under way is passed over.
    async fn claim_delivery(&self, lease: Duration, most: u32) -> Result<Option<DueDelivery>, StoreError>;

    /// Notes how a claimed delivery went, unless the claim is lost. True if its endpoint was disabled by that: because the receiver
    /// is gone, or since nothing was delivered to it for [`FAILING`](super::FAILING).
    async fn settle_delivery(&self, due: &DueDelivery, attempt: Attempt, verdict: Verdict) -> Result<bool, StoreError>;

    /// What waits to be delivered.
    async fn backlog(&self) -> Result<Backlog, StoreError>;

    /// Forgets messages that were made `age` ago, with their deliveries. Answers how many.
    async fn forget_messages(&self, age: Duration) -> Result<u64, StoreError>;
}
