//! Storing and fetching files. Transfers are counted and hashed, and a file is stored whole or not at all.

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
use super::stored::{BlobError, CHUNK, Stored, Summary, UploadError, folder_error, not_found};
use crate::access::IdSource;
use crate::jobs::{JobId, UploadId};

/// The lifetime of a signed address that is only parsed, never requested.
const SHORTEST: Duration = Duration::from_secs(1);

/// The file store.
#[derive(Debug, Clone)]
pub struct Blobs {
    /// The files by their keys.
    pub(super) store: Arc<dyn ObjectStore>,
    /// The folder or the bucket behind `store`.
    pub(super) backend: Backend,
}

/// The local folder or the bucket in which files are stored.
#[derive(Debug, Clone)]
pub(super) enum Backend {
    Folder(PathBuf),
    Bucket(Bucket),
}

impl Blobs {
    /// Stores files in a local folder, created if missing. Files are synced to disk before they count as stored.
    ///
    /// # Errors
    /// When the folder can't be created.
    pub fn local(folder: &Path) -> Result<Self, BlobError> {
        std::fs::create_dir_all(folder)?;
        let store = LocalFileSystem::new_with_prefix(folder)?.with_fsync(true).with_automatic_cleanup(true);
        Ok(Self { store: Arc::new(store), backend: Backend::Folder(folder.to_owned()) })
    }

    /// Stores files in a bucket of an S3-compatible store. Sends no request yet.
    ///
    /// Every request has the SHA-256 of its bytes in its signature, so that the store detects changed bytes.
    ///
    /// # Errors
    /// When the address can't be used, or the local folder can't be created.
    pub fn s3(config: &S3Config) -> Result<Self, BlobError> {
        let bucket = Bucket::open(config)?;
        Ok(Self { store: bucket.store(), backend: Backend::Bucket(bucket) })
    }

    /// Free bytes of the disk that holds the files, or holds files on their way to the bucket; `None` if unknown.
    ///
    /// # Errors
    /// When the file system does not report its free space.
    pub fn free_bytes(&self) -> Result<Option<u64>, BlobError> {
        let folder = match &self.backend {
            Backend::Folder(folder) => folder,
            Backend::Bucket(bucket) => &bucket.spool,
        };
        Ok(Some(free_bytes(folder)?))
    }

    /// The key of a job's uploaded file `number`, counted from 0.
    #[must_use]
    pub fn input_key(id: JobId, number: usize) -> String {
        if number == 0 { format!("uploads/{id}") } else { format!("more/{id}/{number}") }
    }

    /// The key of a file that was uploaded before its job.
    #[must_use]
    pub fn incoming_key(id: UploadId) -> String {
        format!("incoming/{id}")
    }

    /// The key of a file that one claim of a job produced.
    #[must_use]
    pub fn artifact_key(id: JobId, token: &str, name: &str) -> String {
        format!("jobs/{id}/{token}/{name}")
    }

    /// A file's size in bytes.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when no file has this key.
    pub async fn bytes(&self, key: &str) -> Result<u64, BlobError> {
        Ok(self.store.head(&Key::from(key)).await.map_err(not_found)?.size)
    }

    /// A file's bytes, or a range of them.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when no file has this key.
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

    /// A whole file's bytes. The last chunk is withheld until the SHA-256 of all bytes is verified.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when no file has this key. The stream ends with [`BlobError::Damaged`] when the hash differs.
    pub async fn get_whole(
        &self,
        key: &str,
        sha256: &str,
    ) -> Result<BoxStream<'static, Result<Bytes, BlobError>>, BlobError> {
        let source = self.get(key, None).await?;
        let (key, stored) = (key.to_owned(), sha256.to_owned());
        let start = (source, Sha256::new(), Bytes::new());
        let checked = futures::stream::try_unfold(start, move |(mut source, mut hash, mut held)| {
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

    /// Copies a whole file to the local file system.
    ///
    /// # Errors
    /// [`BlobError::NotFound`] when no file has this key, [`BlobError::Damaged`] when its SHA-256 differs.
    pub async fn fetch(&self, key: &str, sha256: &str, path: &Path) -> Result<(), BlobError> {
        if let Backend::Folder(folder) = &self.backend {
            let (source, target) = (folder.join(key), path.to_owned());
            let copied = tokio::task::spawn_blocking(move || match File::open(source) {
                Err(error) if error.kind() == ErrorKind::NotFound => Err(BlobError::NotFound),
                source => Ok(local::copy(source.map_err(folder_error)?, &mut File::create(target)?)?),
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
    /// [`BlobError::NotFound`] when no file has the key `from`.
    pub async fn copy(&self, from: &str, to: &str) -> Result<(), BlobError> {
        self.store.copy(&Key::from(from), &Key::from(to)).await.map_err(not_found)
    }

    /// Deletes a file. A missing file is no error.
    ///
    /// # Errors
    /// When the store can't delete.
    pub async fn delete(&self, key: &str) -> Result<(), BlobError> {
        match self.store.delete(&Key::from(key)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(e) => Err(e.into()),
        }
    }

    /// Writes, reads and deletes a small file, to check that the store works.
    ///
    /// # Errors
    /// The store's first error.
    pub async fn probe(&self, ids: &dyn IdSource) -> Result<(), BlobError> {
        let key = Key::from(format!("probe/{}", ids.random().simple()));
        self.store.put(&key, Bytes::from_static(b"probe").into()).await?;
        self.store.get(&key).await?.bytes().await?;
        self.store.delete(&key).await?;
        Ok(())
    }

    /// Stores a stream of at most `limit` bytes, with only a few chunks in memory.
    ///
    /// For a bucket, the bytes are first collected in an unnamed file on the local disk. Slow or numerous uploads thus use no memory,
    /// and the bucket gets no bytes before the last has arrived.
    ///
    /// # Errors
    /// [`UploadError`]; the bytes written so far are removed.
    pub async fn put_stream<E>(
        &self,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<Stored, UploadError<E>> {
        let mut source = std::pin::pin!(limited(source, limit));
        match &self.backend {
            Backend::Folder(_) => self.put_in_folder(key, source).await,
            Backend::Bucket(bucket) => {
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
        let mut summary = Summary::default();
        let written = async {
            while let Some(chunk) = source.try_next().await? {
                summary.add(&chunk);
                upload.write(&chunk);
                upload.wait_for_capacity(1).await.map_err(BlobError::from)?;
            }
            Ok(())
        };
        if let Err(failure) = written.await {
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, key, "could not remove a failed upload");
            }
            return Err(failure);
        }
        upload.finish().await.map_err(BlobError::from)?;
        Ok(summary.finish())
    }

    /// Stores local files, each under its key. The result has `None` for a missing file. The keys must not be published before this
    /// returns, because a part of a file may be stored until then.
    ///
    /// # Errors
    /// When a file can't be read or stored; other files may be stored.
    pub async fn put_files(&self, files: &[(String, PathBuf)]) -> Result<Vec<Option<Stored>>, BlobError> {
        match &self.backend {
            Backend::Folder(folder) => {
                let (folder, files) = (folder.clone(), files.to_vec());
                let copied = tokio::task::spawn_blocking(move || local::copy_in(&folder, &files)).await;
                copied.map_err(std::io::Error::from)?.map_err(folder_error)
            }
            Backend::Bucket(bucket) => {
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

    // Signed addresses of single files, valid for a limited time without credentials. Clients use them to send and fetch bytes without
    // the service in between.

    /// A signed address that returns a file with these two headers; `None` for a local folder.
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
        let headers = [("response-content-disposition", content_disposition), ("response-content-type", content_type)];
        self.presigned(Method::GET, key, life, &SignedUrlOptions::new().with_query(headers)).await
    }

    /// A signed address that stores the body of each PUT request as the file; `None` for a local folder. The signature can't limit the
    /// size.
    ///
    /// # Errors
    /// When there are no credentials to sign with.
    /// When there are no credentials to sign with.
    pub async fn presigned_put(&self, key: &str, life: Duration) -> Result<Option<String>, BlobError> {
        self.presigned(Method::PUT, key, life, &SignedUrlOptions::new()).await
    }

    /// The origin of signed addresses, such as `https://bucket.s3.amazonaws.com`; `None` for a local folder, or if signing fails now.
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
        let Backend::Bucket(bucket) = &self.backend else { return Ok(None) };
        let address = bucket.public().signed_url_opts(method, &Key::from(key), life, options).await?;
        Ok(Some(address.into()))
    }
}

/// Free bytes of the disk that holds `folder`.
///
/// # Errors
/// When the file system does not report its free space.
pub fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// The stream, which ends with an error when it exceeds `limit` bytes.
fn limited<E>(
    source: impl Stream<Item = Result<Bytes, E>>,
    limit: u64,
) -> impl Stream<Item = Result<Bytes, UploadError<E>>> {
    let mut remaining = limit;
    source.map(move |chunk| {
        let chunk = chunk.map_err(UploadError::Source)?;
        remaining = remaining.checked_sub(chunk.len() as u64).ok_or(UploadError::TooLarge(limit))?;
        Ok(chunk)
    })
}
