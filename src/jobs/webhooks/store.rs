use std::time::Duration;

use async_trait::async_trait;

use super::{
    Attempt, Backlog, Delivery, DeliveryQuery, DueDelivery, Endpoint, EndpointChange, NewEndpoint, Secrets,
    SigningSecret, Verdict,
};
use crate::jobs::{Page, StoreError};

/// The result of a request to send a delivery again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Redelivered {
    /// It is due now.
    Yes,
    /// Its endpoint is disabled.
    Disabled,
    /// The tenant has no such delivery.
    Unknown,
}

/// Where webhook endpoints and the secrets of callbacks are kept.
#[async_trait]
pub trait EndpointStore: Send + Sync {
    /// Adds an endpoint; none if the tenant has `most` endpoints already.
    async fn create_endpoint(&self, new: NewEndpoint, most: u32) -> Result<Option<Endpoint>, StoreError>;

    /// The tenant's endpoints, oldest first.
    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError>;

    /// One of the tenant's endpoints.
    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError>;

    /// Changes an endpoint. Disabling it gives up its pending deliveries.
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

    /// The secrets of the tenant's callbacks. A tenant without a secret gets `fresh`.
    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError>;

    /// Gives the tenant's callbacks a new secret; the old one signs beside it for `keep`.
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
    /// Sends an endpoint a test message, and returns the delivery's name; none if the endpoint does not exist or is disabled.
    async fn send_ping(&self, tenant: &str, endpoint: &str) -> Result<Option<String>, StoreError>;

    /// The tenant's deliveries, newest first.
    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError>;

    /// Makes a delivery due now, whatever its status. A delivery that is not pending gets all of its tries again.
    async fn redeliver(&self, tenant: &str, id: &str) -> Result<Redelivered, StoreError>;

    /// Claims a delivery that is due, if there is one, under a lease of `lease`. Tenants take turns: first the tenant with the fewest
    /// deliveries under way; of its deliveries the one that has been due longest. Tenants with `most` under way are passed over.
    async fn claim_delivery(&self, lease: Duration, most: u32) -> Result<Option<DueDelivery>, StoreError>;

    /// Records the result of a claimed delivery, unless the claim is lost. Returns whether this disabled the endpoint: because the
    /// receiver is gone, or because nothing was delivered to it for [`FAILING`](super::FAILING).
    async fn settle_delivery(&self, due: &DueDelivery, attempt: Attempt, verdict: Verdict) -> Result<bool, StoreError>;

    /// How many deliveries are pending.
    async fn backlog(&self) -> Result<Backlog, StoreError>;

    /// Deletes messages that were made `age` ago, with their deliveries. Returns how many.
    async fn forget_messages(&self, age: Duration) -> Result<u64, StoreError>;
}
