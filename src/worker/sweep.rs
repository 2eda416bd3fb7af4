use std::time::Duration;

use futures::TryStreamExt;

use crate::blobs::{BlobError, Blobs};
use crate::jobs::{JobStore, StoreError, UPLOAD_LIFE};

/// How often to sweep.
pub(super) const EVERY: Duration = Duration::from_secs(3600);
/// Files younger than this may be an upload under way.
const AGE: Duration = Duration::from_secs(3600);

/// Why a sweep was not finished.
#[derive(Debug, thiserror::Error)]
pub(super) enum SweepError {
    #[error(transparent)]
    Blobs(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Forgets idempotency keys and uploads whose time is over, and removes files that no job owns: of uploads that a killed server left,
/// and of deletions that were stopped half way.
pub(super) async fn sweep(store: &dyn JobStore, blobs: &Blobs) -> Result<(), SweepError> {
    store.forget_keys().await?;
    store.forget_uploads().await?;
    blobs.delete_quiet_incoming(UPLOAD_LIFE).await?;
    let mut owners = blobs.owners(AGE).await?;
    while let Some(id) = owners.try_next().await? {
        if store.get(id).await?.is_none_or(|job| job.purged) && blobs.delete_quiet_job(id, AGE).await? {
            tracing::info!(%id, "removed files that no job owns");
        }
    }
    Ok(())
}
