use std::time::Duration;

use async_trait::async_trait;

use super::row::{Columns, corrupt};
use super::{JobId, StoreError};

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

impl KeyState {
    /// The state of a key that another request holds or used, by the key's row, its `fingerprint` and its `job_id`.
    pub(super) fn of_another(row: Option<&impl Columns>) -> Result<Self, StoreError> {
        let Some(row) = row else { return Ok(Self::InUse) };
        let Some(fingerprint) = row.text("fingerprint")? else { return Ok(Self::InUse) };
        let id = row.text("job_id")?.unwrap_or_default();
        let job = id.parse().map_err(|_| corrupt(&id, "job_id", "no job id"))?;
        Ok(Self::Used { fingerprint, job })
    }
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
