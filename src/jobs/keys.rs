use std::time::Duration;

use super::row::corrupt;
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
    /// What the row of a key says, its fingerprint and its job, to who could not get hold of it.
    pub(super) fn of_another(row: Option<(Option<String>, String)>) -> Result<Self, StoreError> {
        let Some((Some(fingerprint), id)) = row else { return Ok(Self::InUse) };
        let job = id.parse().map_err(|_| corrupt(&id, "job_id", "no job id"))?;
        Ok(Self::Used { fingerprint, job })
    }
}
