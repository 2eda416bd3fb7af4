//! Files on their way into the store and out of it: counted, hashed, and whole in the end or not there at all.

use std::fs::File;
use std::io::{ErrorKind, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{Stream, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::signer::{Method, SignedUrlOptions, Signer};
use object_store::{GetOptions, GetRange, GetResultPayload, ObjectStore, ObjectStoreExt, WriteMultipart};
use sha2::{Digest, Sha256};
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};
use tokio_util::io::ReaderStream;

use super::bucket::{Bucket, S3Config};
use super::local;
use super::stored::{Account, BlobError, CHUNK, Stored, UploadError, not_found, of_folder};
use crate::jobs::{IdSource, JobId, SystemIds, UploadId};

/// How long an address is good that nobody asks.
const SHORTEST: Duration = Duration::from_secs(1);

/// Where files are kept.
#[derive(Debug, Clone)]
pub struct Blobs {
    pub(super) store: Arc<dyn ObjectStore>,
    pub(super) place: Place,
}

/// What is known of a store beside its keys.
#[derive(Debug, Clone)]
pub(super) enum Place {
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
        let key = Key::from(format!("probe/{}", SystemIds.random().simple()));
        self.store.put(&key, Bytes::from_static(b"probe").into()).await?;
        self.store.get(&key).await?.bytes().await?;
        self.store.delete(&key).await?;
        Ok(())
    }

    /// Stores a stream of bytes, at most `limit` of them, without ever holding more than a few chunks.
    ///
    /// For a store that is no folder they first go to an unnamed file on the local disk: however slowly they come, and however
    /// many come at once, they take no memory and no part of them is in the store before the last has come.
    ///
    /// # Errors
    /// [`UploadError`]; what was written is removed.
    pub async fn put_stream<E>(
        &self,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<Stored, UploadError<E>> {
        let mut source = std::pin::pin!(limited(source, limit));
        match &self.place {
            Place::Folder(_) => self.put_in_folder(key, source).await,
            Place::Bucket(bucket) => {
                let mut file = bucket.spool_file().await?;
                while let Some(chunk) = source.try_next().await? {
                    file.write_all(&chunk).await.map_err(BlobError::from)?;
                }
                file.flush().await.map_err(BlobError::from)?;
                Ok(bucket.send(Key::from(key), file).await?)
            }
        }
    }

    async fn put_in_folder<E>(
        &self,
        key: &str,
        mut source: impl Stream<Item = Result<Bytes, UploadError<E>>> + Unpin,
    ) -> Result<Stored, UploadError<E>> {
        let upload = self.store.put_multipart(&Key::from(key)).await.map_err(BlobError::from)?;
        let mut upload = WriteMultipart::new_with_chunk_size(upload, CHUNK);
        let mut account = Account::default();
        let written = async {
            while let Some(chunk) = source.try_next().await? {
                account.add(&chunk);
                upload.write(&chunk);
                upload.wait_for_capacity(1).await.map_err(BlobError::from)?;
            }
            Ok(())
        };
        if let Err(failure) = written.await {
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, key, "could not remove a broken upload");
            }
            return Err(failure);
        }
        upload.finish().await.map_err(BlobError::from)?;
        Ok(account.stored())
    }

    /// Stores local files, each under its key; gives none for one that is not there. Until it has returned, part of one may be there:
    /// nobody may have been told of the keys.
    ///
    /// # Errors
    /// When one can't be read or stored; the others may be there.
    pub async fn put_files(&self, files: &[(String, PathBuf)]) -> Result<Vec<Option<Stored>>, BlobError> {
        match &self.place {
            Place::Folder(folder) => {
                let (folder, files) = (folder.clone(), files.to_vec());
                let copied = tokio::task::spawn_blocking(move || local::copy_in(&folder, &files)).await;
                copied.map_err(std::io::Error::from)?.map_err(of_folder)
            }
            Place::Bucket(bucket) => {
                let sent = files.iter().map(|(key, path)| async move {
                    match tokio::fs::File::open(path).await {
                        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
                        Err(error) => Err(error.into()),
                        Ok(file) => bucket.send(Key::from(key.as_str()), file).await.map(Some),
                    }
                });
                futures::future::try_join_all(sent).await
            }
        }
    }

    // Addresses of single files that need no credentials and are good for a while, so that bytes need not pass through the service.

    /// An address that answers with a file and these two headers; none where the store is a folder.
    ///
    /// # Errors
    /// When there are no credentials to sign with.
    pub async fn presigned_get(
        &self,
        key: &str,
        life: Duration,
        content_disposition: &str,
        content_type: &str,
    ) -> Result<Option<String>, BlobError> {
        let answer = [("response-content-disposition", content_disposition), ("response-content-type", content_type)];
        self.presigned(Method::GET, key, life, &SignedUrlOptions::new().with_query(answer)).await
    }

    /// An address that takes a file's bytes as the body of a PUT, as often as it is sent; none where the store is a folder. How many
    /// bytes that may be can't be said in it.
    ///
    /// # Errors
    /// When there are no credentials to sign with.
    pub async fn presigned_put(&self, key: &str, life: Duration) -> Result<Option<String>, BlobError> {
        self.presigned(Method::PUT, key, life, &SignedUrlOptions::new()).await
    }

    /// The origin of those addresses, such as `https://bucket.s3.amazonaws.com`; none where the store is a folder, or nothing can be
    /// signed now.
    pub async fn public_origin(&self) -> Option<String> {
        let any = self.presigned(Method::GET, "origin", SHORTEST, &SignedUrlOptions::new()).await;
        let address = url::Url::parse(&any.ok().flatten()?).ok()?;
        Some(address.origin().ascii_serialization())
    }

    async fn presigned(
        &self,
        method: Method,
        key: &str,
        life: Duration,
        options: &SignedUrlOptions,
    ) -> Result<Option<String>, BlobError> {
        let Place::Bucket(bucket) = &self.place else { return Ok(None) };
        let address = bucket.public().signed_url_opts(method, &Key::from(key), life, options).await?;
        Ok(Some(address.into()))
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

/// The stream, but ended by an error where it is longer than `limit`.
fn limited<E>(
    source: impl Stream<Item = Result<Bytes, E>>,
    limit: u64,
) -> impl Stream<Item = Result<Bytes, UploadError<E>>> {
    let mut left = limit;
    source.map(move |chunk| {
        let chunk = chunk.map_err(UploadError::Source)?;
        left = left.checked_sub(chunk.len() as u64).ok_or(UploadError::TooLarge(limit))?;
        Ok(chunk)
    })
}
