use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use async_trait::async_trait;
use time::OffsetDateTime;
use uuid::Uuid;

use super::row::{Columns, Reader};
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

/// Reads an upload from a row of its columns and its `age` in milliseconds.
pub(super) fn read_upload(row: &impl Columns) -> Result<PendingUpload, StoreError> {
    let from = Reader::new(row)?;
    let job: Option<JobId> = from.some_parsed("job_id")?;
    let is_open = u128::try_from(from.number("age")?).is_ok_and(|age| age < UPLOAD_OPEN.as_millis()) && job.is_none();
    let upload = NewUpload {
        id: from.parsed("id")?,
        tenant: from.text("tenant")?,
        name: from.some_text("name")?,
        token_sha256: from.some_text("token_sha256")?,
    };
    Ok(PendingUpload { upload, created_at: from.time("created_at")?, is_open, job })
}

/// Where uploads are kept: files that clients send before they ask for a job.
#[async_trait]
pub trait UploadStore: Send + Sync {
    /// Adds an upload; none if `most` uploads wait for a job already.
    async fn add_upload(&self, upload: NewUpload, most: u64) -> Result<Option<PendingUpload>, StoreError>;

    /// One upload that may still become a job, or became one not long ago.
    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError>;

    /// Deletes expired uploads. An upload that became a job is kept as long as the key of that job's request may be. Returns how many.
    async fn forget_uploads(&self) -> Result<u64, StoreError>;
}
