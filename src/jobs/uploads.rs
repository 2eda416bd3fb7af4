use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use async_trait::async_trait;
use time::OffsetDateTime;
use uuid::Uuid;

use super::row::{corrupt, time};
use super::{JobId, StoreError};

/// How long an upload may be sent to its address.
pub const UPLOAD_OPEN: Duration = Duration::from_secs(3600);
/// How long a job may be made of an upload; those of which none was made then go.
pub const UPLOAD_LIFE: Duration = Duration::from_secs(24 * 3600);

/// An upload's name: `upl_` and a UUID of version 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UploadId(Uuid);

/// A text that is no upload id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("an upload id is 'upl_' and 32 hexadecimal digits")]
pub struct UploadIdError;

impl UploadId {
    /// A new id of this moment.
    #[must_use]
    pub fn new() -> Self {
        Self(Uuid::now_v7())
    }
}

impl Default for UploadId {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Display for UploadId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "upl_{}", self.0.simple())
    }
}

impl FromStr for UploadId {
    type Err = UploadIdError;

    fn from_str(text: &str) -> Result<Self, UploadIdError> {
        let digits = text.strip_prefix("upl_").filter(|digits| digits.len() == 32).ok_or(UploadIdError)?;
        Uuid::try_parse(digits).map(Self).map_err(|_| UploadIdError)
    }
}

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

/// A row of an upload: its id, tenant, name, token, time, age in milliseconds and job.
pub(super) type Row = (String, String, Option<String>, Option<String>, i64, i64, Option<String>);

impl PendingUpload {
    pub(super) fn of_row((id, tenant, name, token_sha256, created_at, age, job): Row) -> Result<Self, StoreError> {
        let created_at = time(&id, "created_at", created_at)?;
        let job = job.map(|job| job.parse().map_err(|_| corrupt(&id, "job_id", "no job id"))).transpose()?;
        let is_open = u128::try_from(age).is_ok_and(|age| age < UPLOAD_OPEN.as_millis()) && job.is_none();
        let id = id.parse().map_err(|_| corrupt(&id, "id", "no upload id"))?;
        Ok(Self { upload: NewUpload { id, tenant, name, token_sha256 }, created_at, is_open, job })
    }
}

/// Where files are noted that clients send before they ask for a job.
#[async_trait]
pub trait UploadStore: Send + Sync {
    /// Notes an upload, unless as many as `most` wait for a job already: then none.
    async fn add_upload(&self, upload: NewUpload, most: u64) -> Result<Option<PendingUpload>, StoreError>;

    /// One upload of which a job may still be made, or was made not long ago.
    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError>;

    /// Forgets uploads whose time is over. Those of which a job was made are known as long as that request's key may be. Answers how
    /// many.
    async fn forget_uploads(&self) -> Result<u64, StoreError>;
}
