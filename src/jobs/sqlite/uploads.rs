use async_trait::async_trait;
use sqlx::SqliteConnection;

use super::SqliteStore;
use crate::jobs::row::millis;
use crate::jobs::uploads::Row;
use crate::jobs::{JobId, KEY_LIFE, NewUpload, PendingUpload, StoreError, UPLOAD_LIFE, UploadId, UploadStore};

#[async_trait]
impl UploadStore for SqliteStore {
    async fn add_upload(&self, upload: NewUpload, most: u64) -> Result<Option<PendingUpload>, StoreError> {
        let row: Option<Row> = sqlx::query_as(
            "INSERT INTO uploads (id, tenant, name, token_sha256, created_at) SELECT ?1, ?2, ?3, ?4, ?5 \
             WHERE (SELECT count(*) FROM uploads WHERE job_id IS NULL AND created_at > ?5 - ?6) < ?7 \
             RETURNING id, tenant, name, token_sha256, created_at, 0, job_id",
        )
        .bind(upload.id.to_string())
        .bind(upload.tenant)
        .bind(upload.name)
        .bind(upload.token_sha256)
        .bind(self.clock.now_ms())
        .bind(millis(UPLOAD_LIFE))
        .bind(i64::try_from(most).unwrap_or(i64::MAX))
        .fetch_all(&self.writer)
        .await?
        .pop();
        row.map(PendingUpload::of_row).transpose()
    }

    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError> {
        let row: Option<Row> = sqlx::query_as(
            "SELECT id, tenant, name, token_sha256, created_at, ?2 - created_at, job_id FROM uploads \
             WHERE id = ?1 AND (job_id IS NOT NULL OR created_at > ?2 - ?3)",
        )
        .bind(id.to_string())
        .bind(self.clock.now_ms())
        .bind(millis(UPLOAD_LIFE))
        .fetch_optional(&self.reader)
        .await?;
        row.map(PendingUpload::of_row).transpose()
    }

    async fn forget_uploads(&self) -> Result<u64, StoreError> {
        let gone = sqlx::query(
            "DELETE FROM uploads WHERE created_at <= ?1 - ?2 - CASE WHEN job_id IS NULL THEN 0 ELSE ?3 END",
        )
        .bind(self.clock.now_ms())
        .bind(millis(UPLOAD_LIFE))
        .bind(millis(KEY_LIFE))
        .execute(&self.writer)
        .await?;
        Ok(gone.rows_affected())
    }
}

/// Notes that a job is made of an upload, in the transaction that accepts it.
pub(super) async fn take(
    connection: &mut SqliteConnection,
    id: UploadId,
    job: JobId,
    now: i64,
) -> Result<(), StoreError> {
    let taken = sqlx::query("UPDATE uploads SET job_id = ? WHERE id = ? AND job_id IS NULL AND created_at > ? - ?")
        .bind(job.to_string())
        .bind(id.to_string())
        .bind(now)
        .bind(millis(UPLOAD_LIFE))
        .execute(connection)
        .await?;
    if taken.rows_affected() == 1 { Ok(()) } else { Err(StoreError::UploadTaken) }
}
