use std::time::Duration;

use async_trait::async_trait;

use super::{JobId, StoreError};

/// How jobs lose their content and are forgotten.
#[async_trait]
pub trait RetentionStore: Send + Sync {
    /// Empties the rows of jobs that ended `age` ago, at most `most` of them, and marks them as expired. The caller deletes their files.
    async fn expire(&self, age: Duration, most: u32) -> Result<Vec<JobId>, StoreError>;

    /// Deletes the rows of jobs that ended `age` ago and are expired or purged. Returns how many.
    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError>;

    /// Empties a job's row, and cancels the job first if it has not ended. The caller then deletes its files. False if there is no such
    /// job.
    async fn purge(&self, id: JobId) -> Result<bool, StoreError>;
}
