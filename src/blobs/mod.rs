//! Files: uploads and artifacts over object_store, in a local folder or in a bucket of an S3-compatible store.
//!
//! Keys: `uploads/<job id>` for the uploaded file, `more/<job id>/<number>` for each further one of a job that has several
//! (a folder for the one that most have would cost another sync to disk), and `jobs/<job id>/<claim>/<name>` for what an attempt made, so that the files
//! of a lost attempt are never mistaken for the result. `incoming/<upload id>` is a file that was sent before its job.

mod abandoned;
mod bucket;
mod error;
mod local;
mod presigned;
mod put;

use std::fs::File;
use std::io::{ErrorKind, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, GetResultPayload, ObjectStore, ObjectStoreExt};
use sha2::{Digest, Sha256};
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};
use tokio_util::io::ReaderStream;

use crate::jobs::{JobId, UploadId};
pub use abandoned::Owner;
use bucket::Bucket;
pub use bucket::S3Config;
pub use error::{BlobError, UploadError};
use error::{not_found, of_folder};
pub use put::Stored;

/// Bytes held back before they are handed to a folder, and read of a file at once. Small, since many may come and go at once.
const CHUNK: usize = 256 << 10;

/// Where files are kept.
#[derive(Debug, Clone)]
pub struct Blobs {
    store: Arc<dyn ObjectStore>,
    place: Place,
}

/// What is known of a store beside its keys.
#[derive(Debug, Clone)]
enum Place {
    Folder(PathBuf),
    Bucket(Bucket),
}

impl Blobs {
    /// Files in a local folder, made if missing. Files are synced to disk before they count as stored.
    ///
    /// # Errors
    /// When the folder can't be made.
    pub fn local(folder: &Path) -> Result<Self, BlobError> {
        std::fs::create_dir_all(folder)?;
        let store = LocalFileSystem::new_with_prefix(folder)?.with_fsync(true).with_automatic_cleanup(true);
        Ok(Self { store: Arc::new(store), place: Place::Folder(folder.to_owned()) })
    }

    /// Files in a bucket of an S3-compatible store. It is not asked for anything yet.
    ///
    /// Every request's bytes are signed with their SHA-256, so that the store takes only what was sent.
    ///
    /// # Errors
    /// When the address makes no sense, or the local folder can't be made.
    pub fn s3(config: &S3Config) -> Result<Self, BlobError> {
        let bucket = Bucket::open(config)?;
        Ok(Self { store: bucket.store(), place: Place::Bucket(bucket) })
    }

    /// Bytes that may still be written to the disk that the files are on, or wait on to be sent; none where that is not known.
    ///
    /// # Errors
    /// When the file system does not tell.
    pub fn free_bytes(&self) -> Result<Option<u64>, BlobError> {
        let folder = match &self.place {
            Place::Folder(folder) => folder,
            Place::Bucket(bucket) => &bucket.spool,
        };
        Ok(Some(free_bytes(folder)?))
    }

    /// The key of a job's uploaded file, counted from 0.
    #[must_use]
    pub fn input_key(id: JobId, number: usize) -> String {
        if number == 0 { format!("uploads/{id}") } else { format!("more/{id}/{number}") }
    }

    /// The key of a file that was sent before its job.
    #[must_use]
    pub fn incoming_key(id: UploadId) -> String {
        format!("incoming/{id}")
    }

    /// The key of a file that one claim of a job made.
    #[must_use]
    pub fn artifact_key(id: JobId, token: &str, name: &str) -> String {
        format!("jobs/{id}/{token}/{name}")
    }

    /// A file's size.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key.
    pub async fn bytes(&self, key: &str) -> Result<u64, BlobError> {
        Ok(self.store.head(&Key::from(key)).await.map_err(not_found)?.size)
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

    /// A whole file's bytes, the last of which come only if all are those with this SHA-256.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key; the stream ends with [`BlobError::Damaged`] where they differ.
    pub async fn get_whole(
        &self,
        key: &str,
        sha256: &str,
    ) -> Result<BoxStream<'static, Result<Bytes, BlobError>>, BlobError> {
        let source = self.get(key, None).await?;
        let (key, stored) = (key.to_owned(), sha256.to_owned());
        let begun = (source, Sha256::new(), Bytes::new());
        let checked = futures::stream::try_unfold(begun, move |(mut source, mut hash, mut held)| {
            let (key, stored) = (key.clone(), stored.clone());
            async move {
                loop {
                    match source.try_next().await? {
                        Some(chunk) => {
                            hash.update(&chunk);
                            let ready = std::mem::replace(&mut held, chunk);
                            if !ready.is_empty() {
                                return Ok(Some((ready, (source, hash, held))));
                            }
                        }
                        None => {
                            let found = hex::encode(hash.clone().finalize());
                            if found != stored {
                                return Err(BlobError::Damaged { key, stored, found });
                            }
                            let last = std::mem::take(&mut held);
                            return Ok((!last.is_empty()).then_some((last, (source, hash, held))));
                        }
                    }
                }
            }
        });
        Ok(checked.boxed())
    }

    /// Copies a whole file into the local file system.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when there is none of that key, [`BlobError::Damaged`] when it has another SHA-256.
    pub async fn fetch(&self, key: &str, sha256: &str, path: &Path) -> Result<(), BlobError> {
        if let Place::Folder(folder) = &self.place {
            let (source, target) = (folder.join(key), path.to_owned());
            let copied = tokio::task::spawn_blocking(move || match File::open(source) {
                Err(error) if error.kind() == ErrorKind::NotFound => Err(BlobError::NotFound),
                source => Ok(local::copy(source.map_err(of_folder)?, &mut File::create(target)?)?),
            });
            let found = copied.await.map_err(std::io::Error::from)??.sha256;
            let (key, stored) = (key.to_owned(), sha256.to_owned());
            return if found == stored { Ok(()) } else { Err(BlobError::Damaged { key, stored, found }) };
        }
        let mut source = self.get_whole(key, sha256).await?;
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

/// Bytes that may still be written to the disk that a folder is on.
///
/// # Errors
/// When the file system does not tell.
pub fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}
