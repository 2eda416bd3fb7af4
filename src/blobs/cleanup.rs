//! Deletion of files: of deleted jobs, of lost attempts, and of uploads that never became a job.

use std::path::Path;
use std::time::SystemTime;

use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path as Key;
use object_store::{ObjectMeta, ObjectStoreExt};

use super::local::{self, KINDS};
use super::store::{Backend, Blobs};
use super::stored::{BlobError, Owner};
use crate::jobs::JobId;

impl Blobs {
    /// Deletes a job's uploaded files and all files of its attempts, with partly written files.
    ///
    /// # Errors
    /// When the store can't list or delete. Missing files are no error.
    pub async fn delete_job(&self, id: JobId) -> Result<(), BlobError> {
        self.delete(&Self::input_key(id, 0)).await?;
        self.delete_listed(format!("more/{id}"), |_| true).await?;
        self.in_folder(move |folder| local::remove_uploads(folder, id)).await?;
        self.delete_attempts(id, None).await
    }

    /// Deletes the files of a job's attempts, except those of the claim with the token `keep`.
    ///
    /// # Errors
    /// When the store can't list or delete. Missing files are no error.
    pub async fn delete_attempts(&self, id: JobId, keep: Option<&str>) -> Result<(), BlobError> {
        let keep = keep.map(str::to_owned);
        let kept = keep.clone();
        let is_unwanted =
            move |file: &ObjectMeta| kept.is_none() || file.location.as_ref().split('/').nth(2) != kept.as_deref();
        self.delete_listed(format!("jobs/{id}"), is_unwanted).await?;
        self.in_folder(move |folder| local::remove_attempts(folder, id, keep.as_deref())).await
    }

    /// Deletes the files of one claim of a job.
    ///
    /// # Errors
    /// When the store can't list or delete. Missing files are no error.
    pub async fn delete_claim(&self, id: JobId, claim: &str) -> Result<(), BlobError> {
        self.delete_listed(format!("jobs/{id}/{claim}"), |_| true).await?;
        let claim = claim.to_owned();
        self.in_folder(move |folder| local::remove_claim(folder, id, &claim)).await
    }

    /// The owners of files that have not changed since a time; an owner may come more than once. A bucket is listed page by page.
    ///
    /// # Errors
    /// When the store can't list.
    pub async fn owners(&self, since: SystemTime) -> Result<BoxStream<'static, Result<Owner, BlobError>>, BlobError> {
        if let Backend::Folder(folder) = &self.backend {
            let folder = folder.clone();
            let found = tokio::task::spawn_blocking(move || local::owners(&folder, since)).await;
            return Ok(futures::stream::iter(found.map_err(std::io::Error::from)??).map(Ok).boxed());
        }
        let store = self.store.clone();
        let files = futures::stream::iter(KINDS).flat_map(move |kind| store.list(Some(&Key::from(kind))));
        let mut before = None;
        let owners = files.try_filter_map(move |file| {
            let mut parts = file.location.as_ref().split('/');
            let (kind, job, claim) = (parts.next(), parts.next().and_then(|id| id.parse().ok()), parts.next());
            let claim = claim.filter(|_| kind == Some("jobs")).map(str::to_owned);
            let owner = job.map(|job| Owner { job, claim });
            // The files of an owner come one after the other.
            let is_new = owner.is_some() && owner != before && is_stale(&file, since);
            if is_new {
                before.clone_from(&owner);
            }
            futures::future::ok(owner.filter(|_| is_new))
        });
        Ok(owners.map_err(BlobError::from).boxed())
    }

    /// Deletes all files of a job, unless one of them has changed since a time. Returns whether the files were deleted.
    ///
    /// # Errors
    /// When the store can't list or delete.
    pub async fn delete_stale_job(&self, id: JobId, since: SystemTime) -> Result<bool, BlobError> {
        let upload = match self.store.head(&Key::from(Self::input_key(id, 0))).await {
            Err(object_store::Error::NotFound { .. }) => None,
            found => Some(found?),
        };
        let store = &self.store;
        let others = futures::stream::iter(["more", "jobs"])
            .flat_map(move |kind| store.list(Some(&Key::from(format!("{kind}/{id}")))));
        let mut files = futures::stream::iter(upload.map(Ok)).chain(others);
        while let Some(file) = files.try_next().await? {
            if !is_stale(&file, since) {
                return Ok(false);
            }
        }
        drop(files);
        self.delete_job(id).await?;
        Ok(true)
    }

    /// Deletes files that were uploaded before their job and have not changed since a time.
    ///
    /// # Errors
    /// When the store can't list or delete.
    pub async fn delete_stale_incoming(&self, since: SystemTime) -> Result<(), BlobError> {
        self.delete_listed("incoming".to_owned(), move |file| is_stale(file, since)).await?;
        self.in_folder(move |folder| local::remove_stale_incoming(folder, since)).await
    }

    /// Deletes the files under a prefix that `is_unwanted` selects.
    async fn delete_listed(
        &self,
        prefix: String,
        is_unwanted: impl Fn(&ObjectMeta) -> bool + Send + 'static,
    ) -> Result<(), BlobError> {
        let files = self.store.list(Some(&Key::from(prefix)));
        let keys = files.try_filter_map(move |file| futures::future::ok(is_unwanted(&file).then_some(file.location)));
        let mut deleted = self.store.delete_stream(keys.boxed());
        while let Some(deleted) = deleted.next().await {
            match deleted {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Runs `work` on a local folder, for partly written files, which object_store does not list. Does nothing for a bucket.
    async fn in_folder(
        &self,
        work: impl FnOnce(&Path) -> std::io::Result<()> + Send + 'static,
    ) -> Result<(), BlobError> {
        let Backend::Folder(folder) = &self.backend else { return Ok(()) };
        let folder = folder.clone();
        let done = tokio::task::spawn_blocking(move || work(&folder)).await;
        Ok(done.map_err(std::io::Error::from)??)
    }
}

/// Whether a file has not changed since a time.
fn is_stale(file: &ObjectMeta, since: SystemTime) -> bool {
    SystemTime::from(file.last_modified) <= since
}
