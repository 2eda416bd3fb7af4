//! The size and the hash of a stored file, and the errors of storing and fetching.

use sha2::{Digest, Sha256};

use crate::jobs::JobId;
use crate::telemetry;

/// The size of one read or write, in bytes. It is small, because many transfers may run at once.
pub(super) const CHUNK: usize = 256 << 10;
/// How many bytes from the start of a file are kept, to detect its format.
const HEAD: usize = 4 << 10;

/// The size, hash and first bytes of a stored file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stored {
    /// The size in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes, in hexadecimal.
    pub sha256: String,
    /// The first bytes, at most 4 KiB.
    pub head: Vec<u8>,
}

/// Collects a file's size, hash and first bytes while its chunks pass.
#[derive(Default)]
pub(super) struct Summary {
    bytes: u64,
    hash: Sha256,
    head: Vec<u8>,
}

impl Summary {
    /// Adds the next chunk.
    pub fn add(&mut self, chunk: &[u8]) {
        self.bytes += chunk.len() as u64;
        self.hash.update(chunk);
        self.head.extend_from_slice(&chunk[..chunk.len().min(HEAD - self.head.len())]);
    }

    /// The summary of the whole file.
    pub fn finish(self) -> Stored {
        Stored { bytes: self.bytes, sha256: hex::encode(self.hash.finalize()), head: self.head }
    }
}

/// The owner of a stored file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Owner {
    /// The job.
    pub job: JobId,
    /// The token of the claim that produced the file; `None` for an uploaded file.
    pub claim: Option<String>,
}

/// Why a file could not be stored or fetched.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The file store reported an error.
    #[error("file store: {0}")]
    Store(#[source] object_store::Error),
    /// The local file system reported an error.
    #[error("file store: {0}")]
    Io(#[from] std::io::Error),
    /// The file does not exist.
    #[error("the file does not exist in the file store")]
    NotFound,
    /// The file's bytes have changed since it was stored.
    #[error("the stored file '{key}' is damaged: its SHA-256 is {found}, but was {stored} when it was stored")]
    Damaged {
        /// The file's key.
        key: String,
        /// The SHA-256 at the time of storing.
        stored: String,
        /// The SHA-256 now.
        found: String,
    },
    /// The store's address or settings can't be used.
    #[error("file store: {0}")]
    Address(String),
}

/// Also counts the error in the metrics: every error of the store passes this conversion.
impl From<object_store::Error> for BlobError {
    fn from(error: object_store::Error) -> Self {
        metrics::counter!(telemetry::BLOB_ERRORS).increment(1);
        Self::Store(error)
    }
}

impl BlobError {
    /// Whether the cause is a full disk, or one that can't be written to. Looks through all errors that libraries wrapped around it.
    #[must_use]
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind as E;
        let error: &(dyn std::error::Error + 'static) = self;
        let causes = std::iter::successors(Some(error), |error| error.source());
        causes.filter_map(|error| error.downcast_ref::<std::io::Error>()).any(|error| {
            matches!(error.kind(), E::StorageFull | E::QuotaExceeded | E::ReadOnlyFilesystem | E::PermissionDenied)
        })
    }

    /// Whether a retry may succeed: the store is unavailable or overloaded. The failed request may have taken effect all the same.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        // object_store reports errors without their own variant as generic: broken connections, timeouts, and the statuses 5xx,
        // 429 and 408 after its own retries. Missing files and denied access have variants.
        matches!(self, Self::Store(object_store::Error::Generic { store: "S3", .. }))
    }
}

/// An error of the local folder in which files are stored, counted in the metrics.
pub(super) fn folder_error(error: std::io::Error) -> BlobError {
    metrics::counter!(telemetry::BLOB_ERRORS).increment(1);
    error.into()
}

/// Converts an error of object_store, and names missing files.
pub(super) fn not_found(error: object_store::Error) -> BlobError {
    match error {
        object_store::Error::NotFound { .. } => BlobError::NotFound,
        other => other.into(),
    }
}

/// Why an upload was not stored. No part of it is kept.
#[derive(Debug, thiserror::Error)]
pub enum UploadError<E> {
    /// The upload is larger than the limit, in bytes.
    #[error("the upload is larger than {0} bytes")]
    TooLarge(u64),
    /// The source of the bytes failed.
    #[error("the upload was interrupted")]
    Source(E),
    /// The file store failed.
    #[error(transparent)]
    Store(#[from] BlobError),
}
