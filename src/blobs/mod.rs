//! Files: uploads and artifacts, in a local folder (object_store's local file system; S3 fits the same type).
//!
//! Keys: `uploads/<job id>` for the uploaded file, `more/<job id>/<number>` for each further one of a job that has several
//! (a folder for the one that most have would cost another sync to disk), and `jobs/<job id>/<claim>/<name>` for what an attempt made, so that the files
//! of a lost attempt are never mistaken for the result.

mod local;

use std::io::SeekFrom;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{Stream, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, GetResultPayload, ObjectStore, ObjectStoreExt, WriteMultipart};
use sha2::{Digest, Sha256};
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};
use tokio_util::io::ReaderStream;

use crate::jobs::JobId;
use crate::telemetry;

/// Bytes held back before they are handed to the store. Small, since many uploads may run at once.
const CHUNK: usize = 256 << 10;
/// Bytes kept from the start of an upload, to tell its format.
const HEAD: usize = 4 << 10;

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
}

impl BlobError {
    /// Whether it is for want of room on the disk, or because nothing may be written to it any more.
    #[must_use]
    pub fn is_full(&self) -> bool {
        is_full(self)
    }
}

/// Whether a disk that is full or may not be written to is behind an error, however deep libraries wrapped it.
#[must_use]
pub fn is_full(error: &(dyn std::error::Error + 'static)) -> bool {
    use std::io::ErrorKind as E;
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.filter_map(|error| error.downcast_ref::<std::io::Error>()).any(|error| {
        matches!(error.kind(), E::StorageFull | E::QuotaExceeded | E::ReadOnlyFilesystem | E::PermissionDenied)
    })
}

/// Counted here, where every error of the store passes.
impl From<object_store::Error> for BlobError {
    fn from(error: object_store::Error) -> Self {
        metrics::counter!(telemetry::BLOB_ERRORS).increment(1);
        Self::Store(error)
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

/// Where files are kept.
#[derive(Debug, Clone)]
pub struct Blobs {
    store: Arc<dyn ObjectStore>,
    /// For a local store, its folder.
    folder: Option<PathBuf>,
}

impl Blobs {
    /// Files in a local folder, made if missing. Files are synced to disk before they count as stored.
    ///
    /// # Errors
    /// When the folder can't be made.
    pub fn local(folder: &Path) -> Result<Self, BlobError> {
        std::fs::create_dir_all(folder)?;
        let store = LocalFileSystem::new_with_prefix(folder)?.with_fsync(true).with_automatic_cleanup(true);
        Ok(Self { store: Arc::new(store), folder: Some(folder.to_owned()) })
    }

    /// Bytes that may still be written to the disk that the files are on; none where that is not known.
    ///
    /// # Errors
    /// When the file system does not tell.
    pub fn free_bytes(&self) -> Result<Option<u64>, BlobError> {
        let Some(folder) = &self.folder else { return Ok(None) };
        let disk = rustix::fs::statvfs(folder).map_err(std::io::Error::from)?;
        Ok(Some(disk.f_bavail.saturating_mul(disk.f_frsize)))
    }

    /// The key of a job's uploaded file, counted from 0.
    #[must_use]
    pub fn input_key(id: JobId, number: usize) -> String {
        if number == 0 { format!("uploads/{id}") } else { format!("more/{id}/{number}") }
    }

    /// The key of a file that one claim of a job made.
    #[must_use]
    pub fn artifact_key(id: JobId, token: &str, name: &str) -> String {
        format!("jobs/{id}/{token}/{name}")
    }

    /// Stores a stream of bytes, at most `limit` of them, without ever holding more than a few chunks.
    ///
    /// # Errors
    /// [`UploadError`]; what was written is removed.
    pub async fn put_stream<E>(
        &self,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<Stored, UploadError<E>> {
        let upload = self.store.put_multipart(&Key::from(key)).await.map_err(BlobError::from)?;
        let mut upload = WriteMultipart::new_with_chunk_size(upload, CHUNK);
        let mut hash = Sha256::new();
        let mut head = Vec::new();
        let mut bytes = 0_u64;
        let mut source = std::pin::pin!(source);
        let failure = loop {
            let chunk = match source.next().await {
                None => break None,
                Some(Err(e)) => break Some(UploadError::Source(e)),
                Some(Ok(chunk)) => chunk,
            };
            bytes += chunk.len() as u64;
            if bytes > limit {
                break Some(UploadError::TooLarge(limit));
            }
            hash.update(&chunk);
            head.extend_from_slice(&chunk[..chunk.len().min(HEAD - head.len())]);
            upload.write(&chunk);
            if let Err(e) = upload.wait_for_capacity(1).await {
                break Some(UploadError::Store(e.into()));
            }
        };
        if let Some(failure) = failure {
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, key, "could not remove a broken upload");
            }
            return Err(failure);
        }
        upload.finish().await.map_err(BlobError::from)?;
        Ok(Stored { bytes, sha256: hex::encode(hash.finalize()), head })
    }

    /// Stores a local file.
    ///
    /// # Errors
    /// When it can't be read or stored.
    pub async fn put_file(&self, key: &str, path: &Path) -> Result<Stored, BlobError> {
        let file = tokio::fs::File::open(path).await?;
        let source = ReaderStream::with_capacity(file, CHUNK);
        self.put_stream(key, source, u64::MAX).await.map_err(|e| match e {
            UploadError::Source(e) => BlobError::Io(e),
            UploadError::Store(e) => e,
            UploadError::TooLarge(_) => BlobError::Io(std::io::ErrorKind::FileTooLarge.into()),
        })
    }

    /// A file's bytes, or a range of them.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key.
    pub async fn get(
        &self,
        key: &str,
        range: Option<Range<u64>>,
    ) -> Result<BoxStream<'static, Result<Bytes, BlobError>>, BlobError> {
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        let found = self.store.get_opts(&Key::from(key), options).await.map_err(not_found)?;
        let range = found.range.clone();
        match found.payload {
            GetResultPayload::File(file, _) => {
                let mut file = tokio::fs::File::from_std(file);
                file.seek(SeekFrom::Start(range.start)).await?;
                let file = file.take(range.end - range.start);
                Ok(ReaderStream::with_capacity(file, CHUNK).map_err(BlobError::from).boxed())
            }
            GetResultPayload::Stream(stream) => Ok(stream.map_err(BlobError::from).boxed()),
        }
    }

    /// Copies a file into the local file system.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key.
    pub async fn fetch(&self, key: &str, path: &Path) -> Result<(), BlobError> {
        let mut source = self.get(key, None).await?;
        let mut file = tokio::fs::File::create(path).await?;
        while let Some(chunk) = source.try_next().await? {
            file.write_all(&chunk).await?;
        }
        file.flush().await?;
        Ok(())
    }

    /// Copies a file within the store.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key.
    pub async fn copy(&self, from: &str, to: &str) -> Result<(), BlobError> {
        self.store.copy(&Key::from(from), &Key::from(to)).await.map_err(not_found)
    }

    /// Deletes a job's uploaded files and all that its attempts made, half-written files among them.
    ///
    /// # Errors
    /// When the store can't list or delete; files already gone are no error.
    pub async fn delete_job(&self, id: JobId) -> Result<(), BlobError> {
        self.delete(&Self::input_key(id, 0)).await?;
        let mut files = self.store.list(Some(&Key::from(format!("more/{id}"))));
        while let Some(file) = files.try_next().await? {
            self.delete(file.location.as_ref()).await?;
        }
        self.in_folder(move |folder| local::remove_uploads(folder, id)).await?;
        self.delete_attempts(id, None).await
    }

    /// Deletes what a job's attempts made, but for the files of the claim with the token `keep`.
    ///
    /// # Errors
    /// When the store can't list or delete; files already gone are no error.
    pub async fn delete_attempts(&self, id: JobId, keep: Option<&str>) -> Result<(), BlobError> {
        let mut files = self.store.list(Some(&Key::from(format!("jobs/{id}"))));
        while let Some(file) = files.try_next().await? {
            let token = file.location.as_ref().split('/').nth(2);
            if keep.is_none() || token != keep {
                self.delete(file.location.as_ref()).await?;
            }
        }
        let keep = keep.map(str::to_owned);
        self.in_folder(move |folder| local::remove_attempts(folder, id, keep.as_deref())).await
    }

    /// The jobs that have files here which nobody has touched for `age`; for a store that is no folder, none.
    ///
    /// # Errors
    /// When the folder can't be read.
    pub async fn owners(&self, age: Duration) -> Result<Vec<JobId>, BlobError> {
        let Some(folder) = self.folder.clone() else { return Ok(Vec::new()) };
        let found = tokio::task::spawn_blocking(move || local::owners(&folder, age)).await;
        Ok(found.map_err(std::io::Error::from)??)
    }

    /// Does what only a folder needs, since half-written files are not in its list.
    async fn in_folder(
        &self,
        work: impl FnOnce(&Path) -> std::io::Result<()> + Send + 'static,
    ) -> Result<(), BlobError> {
        let Some(folder) = self.folder.clone() else { return Ok(()) };
        let done = tokio::task::spawn_blocking(move || work(&folder)).await;
        Ok(done.map_err(std::io::Error::from)??)
    }

    /// Deletes one file; one already gone is no error.
    ///
    /// # Errors
    /// When the store can't delete.
    pub async fn delete(&self, key: &str) -> Result<(), BlobError> {
        match self.store.delete(&Key::from(key)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(e) => Err(e.into()),
        }
    }

    /// Writes, reads and deletes a small file, to see that the store works.
    ///
    /// # Errors
    /// What the store says.
    pub async fn probe(&self) -> Result<(), BlobError> {
        let key = Key::from(format!("probe/{}", uuid::Uuid::new_v4().simple()));
        self.store.put(&key, Bytes::from_static(b"probe").into()).await?;
        self.store.get(&key).await?.bytes().await?;
        self.store.delete(&key).await?;
        Ok(())
    }
}

fn not_found(error: object_store::Error) -> BlobError {
    match error {
        object_store::Error::NotFound { .. } => BlobError::NotFound,
        other => other.into(),
    }
}
