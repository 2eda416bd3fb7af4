//! What is known of a stored file, and why one could not be stored or fetched.

use sha2::{Digest, Sha256};

use crate::jobs::JobId;
use crate::telemetry;

/// Bytes held back before they are handed to a folder, and read of a file at once. Small, since many may come and go at once.
pub(super) const CHUNK: usize = 256 << 10;
/// Bytes kept from the start of a file, to tell its format.
const HEAD: usize = 4 << 10;

/// A file that was stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stored {
    /// Its size.
    pub bytes: u64,
    /// SHA-256, in hexadecimal.
    pub sha256: String,
    /// Its first bytes, at most a few thousand.
    pub head: Vec<u8>,
}

/// What is known of a file from the bytes that have come.
#[derive(Default)]
pub(super) struct Account {
    bytes: u64,
    hash: Sha256,
    head: Vec<u8>,
}

impl Account {
    pub fn add(&mut self, chunk: &[u8]) {
        self.bytes += chunk.len() as u64;
        self.hash.update(chunk);
        self.head.extend_from_slice(&chunk[..chunk.len().min(HEAD - self.head.len())]);
    }

    pub fn stored(self) -> Stored {
        Stored { bytes: self.bytes, sha256: hex::encode(self.hash.finalize()), head: self.head }
    }
}

/// Whose a file is.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Owner {
    /// The job.
    pub job: JobId,
    /// The claim that made it; none where it was uploaded.
    pub claim: Option<String>,
}

/// Why a file could not be stored or fetched.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The store said no.
    #[error("file store: {0}")]
    Store(#[source] object_store::Error),
    /// The local file system said no.
    #[error("file store: {0}")]
    Io(#[from] std::io::Error),
    /// There is no such file.
    #[error("no such file")]
    NotFound,
    /// The file's bytes are not those that were stored.
    #[error("the file '{key}' was damaged: its SHA-256 is {found}, and was {stored} when it was stored")]
    Damaged {
        /// The file's key.
        key: String,
        /// What its SHA-256 should be.
        stored: String,
        /// What it is.
        found: String,
    },
    /// The address of the store can't be used.
    #[error("the file store: {0}")]
    Address(String),
}

/// Counted here, where every error of the store passes.
impl From<object_store::Error> for BlobError {
    fn from(error: object_store::Error) -> Self {
        metrics::counter!(telemetry::BLOB_ERRORS).increment(1);
        Self::Store(error)
    }
}

impl BlobError {
    /// Whether a disk that is full, or may not be written to, is behind it, however deep libraries wrapped that.
    #[must_use]
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind as E;
        let error: &(dyn std::error::Error + 'static) = self;
        let causes = std::iter::successors(Some(error), |error| error.source());
        causes.filter_map(|error| error.downcast_ref::<std::io::Error>()).any(|error| {
            matches!(error.kind(), E::StorageFull | E::QuotaExceeded | E::ReadOnlyFilesystem | E::PermissionDenied)
        })
    }

    /// Whether the same may succeed in a while: the store is away, or overloaded. What was asked may have been done all the same.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        // What has no variant of its own: broken connections, time-outs, and the statuses 5xx, 429 and 408, after they were
        // tried again for a while. What is missing or not allowed has one.
        matches!(self, Self::Store(object_store::Error::Generic { store: "S3", .. }))
    }
}

/// An error of the folder that is the store.
pub(super) fn of_folder(error: std::io::Error) -> BlobError {
    metrics::counter!(telemetry::BLOB_ERRORS).increment(1);
    error.into()
}

pub(super) fn not_found(error: object_store::Error) -> BlobError {
    match error {
        object_store::Error::NotFound { .. } => BlobError::NotFound,
        other => other.into(),
    }
}

/// Why an upload was not stored. Nothing of it is left.
#[derive(Debug, thiserror::Error)]
pub enum UploadError<E> {
    /// More bytes came than may.
    #[error("more than {0} bytes")]
    TooLarge(u64),
    /// The stream of bytes broke off.
    #[error("the upload broke off")]
    Source(E),
    /// The store said no.
    #[error(transparent)]
    Store(#[from] BlobError),
}
