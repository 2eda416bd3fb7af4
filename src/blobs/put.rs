//! Files on their way into the store: counted, hashed, and whole in the end or not there at all.

use std::io::ErrorKind;
use std::path::PathBuf;

use bytes::Bytes;
use futures::{Stream, StreamExt, TryStreamExt};
use object_store::path::Path as Key;
use object_store::{ObjectStoreExt, WriteMultipart};
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use super::error::of_folder;
use super::{BlobError, Blobs, CHUNK, Place, UploadError, local};

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

impl Blobs {
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
