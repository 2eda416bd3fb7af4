use async_trait::async_trait;

use super::{Dialect, SqlConnection, SqlStore, sql};
use crate::jobs::row::millis;
use crate::jobs::uploads::read_upload;
use crate::jobs::{JobId, KEY_LIFE, NewUpload, PendingUpload, StoreError, UPLOAD_LIFE, UploadId, UploadStore};

#[async_trait]
impl<D: Dialect> UploadStore for SqlStore<D> {
    async fn add_upload(&self, upload: NewUpload, most: u64) -> Result<Option<PendingUpload>, StoreError> {
        // In PostgreSQL, concurrent statements do not count each other's rows, so the limit is approximate.
        let statement = sql(
            "INSERT INTO uploads (id, tenant, name, token_sha256, created_at) SELECT $1, $2, $3, $4, meshmend_now($5) \
             WHERE (SELECT count(*) FROM uploads WHERE job_id IS NULL AND created_at > meshmend_now($5) - $6) < $7 \
             RETURNING id, tenant, name, token_sha256, created_at, CAST(0 AS BIGINT) AS age, job_id",
        )
        .bind(upload.id.to_string())
        .bind(upload.tenant)
        .bind(upload.name)
        .bind(upload.token_sha256)
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE))
        .bind(i64::try_from(most).unwrap_or(i64::MAX));
        self.writer().await?.query_row(statement).await?.as_ref().map(read_upload).transpose()
    }

    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError> {
        let statement = sql(
            "SELECT id, tenant, name, token_sha256, created_at, meshmend_now($2) - created_at AS age, job_id FROM uploads \
             WHERE id = $1 AND (job_id IS NOT NULL OR created_at > meshmend_now($2) - $3)",
        )
        .bind(id.to_string())
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE));
        self.reader().await?.query_row(statement).await?.as_ref().map(read_upload).transpose()
    }

    async fn forget_uploads(&self) -> Result<u64, StoreError> {
        let statement = sql(
            "DELETE FROM uploads WHERE created_at <= meshmend_now($1) - $2 - CASE WHEN job_id IS NULL THEN 0 ELSE $3 END",
        )
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE))
        .bind(millis(KEY_LIFE));
        self.writer().await?.execute(statement).await
    }
}

/// Assigns an upload to a job, in the transaction that accepts the job.
pub(super) async fn assign(
    connection: &mut impl SqlConnection,
    id: UploadId,
    job: JobId,
    now: Option<i64>,
) -> Result<(), StoreError> {
    let statement =
        sql("UPDATE uploads SET job_id = $1 WHERE id = $2 AND job_id IS NULL AND created_at > meshmend_now($3) - $4")
            .bind(job)
            .bind(id.to_string())
            .bind(now)
            .bind(millis(UPLOAD_LIFE));
    if connection.execute(statement).await? == 1 { Ok(()) } else { Err(StoreError::UploadTaken) }
}
