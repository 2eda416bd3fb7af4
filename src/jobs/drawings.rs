use std::time::Duration;

use async_trait::async_trait;

use super::{Artifacts, Claim, Job, JobId, Lease, Status, StoreError};

/// Where drawings of ended jobs are requested and claimed. A worker draws them at the first request, so that a job whose drawings nobody
/// requests costs no more than a job without.
#[async_trait]
pub trait DrawingStore: Send + Sync {
    /// Asks for the pictures of a job that has ended. Asked again before they are drawn it does nothing.
    async fn ask_for_drawings(&self, job: JobId) -> Result<(), StoreError>;

    /// Takes a job whose pictures were asked for, and holds it for `lease`: of the tenant for which the fewest are being drawn the one
    /// that was asked for first. A hold that ran out can be claimed again.
    async fn claim_drawings(&self, lease: Duration) -> Result<Option<Claim>, StoreError>;

    /// Extends a hold to `lease` from now.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when it is no longer this worker's.
    async fn hold_drawings(&self, held: &Lease, lease: Duration) -> Result<(), StoreError>;

    /// Publishes what was drawn. Pictures of the job that are not among it can't be drawn, and the job has them no more.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when the hold is no longer this worker's, or the job's files are gone.
    async fn finish_drawings(&self, held: &Lease, drawn: Artifacts) -> Result<Job, StoreError>;
}

/// Whether a job's pictures may still be drawn.
pub(super) fn can_be_drawn(job: &Job) -> bool {
    job.finished_at.is_some() && job.status != Status::Expired && !job.purged
}

/// A job's files once its pictures are drawn.
pub(super) fn with_drawings(artifacts: Artifacts, mut drawn: Artifacts) -> Artifacts {
    let settle = |(name, artifact): (String, super::Artifact)| {
        let artifact = if artifact.file.is_some() { artifact } else { drawn.remove(&name)? };
        Some((name, artifact))
    };
    artifacts.into_iter().filter_map(settle).collect()
}
