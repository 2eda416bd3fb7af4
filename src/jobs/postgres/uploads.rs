use async_trait::async_trait;
use sqlx::PgConnection;

use super::PostgresStore;
use crate::jobs::row::millis;
use crate::jobs::uploads::Row;
use crate::jobs::{JobId, KEY_LIFE, NewUpload, PendingUpload, StoreError, UPLOAD_LIFE, UploadId, UploadStore};

#[async_trait]
impl UploadStore for PostgresStore {
    async fn add_upload(&self, upload: NewUpload, most: u64) -> Result<Option<PendingUpload>, StoreError> {
        // Several at once may each count before the others are there: the limit is there to be near, not to be met.
        let row: Option<Row> = sqlx::query_as(
            "INSERT INTO uploads (id, tenant, name, token_sha256, created_at) SELECT $1, $2, $3, $4, meshmend_now($5) \
             WHERE (SELECT count(*) FROM uploads WHERE job_id IS NULL AND created_at > meshmend_now($5) - $6) < $7 \
             RETURNING id, tenant, name, token_sha256, created_at, 0::bigint, job_id",
        )
        .bind(upload.id.to_string())
        .bind(upload.tenant)
        .bind(upload.name)
        .bind(upload.token_sha256)
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE))
        .bind(i64::try_from(most).unwrap_or(i64::MAX))
        .fetch_optional(&self.pool)
        .await?;
        row.map(PendingUpload::of_row).transpose()
    }

    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError> {
        let row: Option<Row> = sqlx::query_as(
            "SELECT id, tenant, name, token_sha256, created_at, meshmend_now($2) - created_at, job_id FROM uploads \
             WHERE id = $1 AND (job_id IS NOT NULL OR created_at > meshmend_now($2) - $3)",
        )
        .bind(id.to_string())
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE))
        .fetch_optional(&self.pool)
        .await?;
        row.map(PendingUpload::of_row).transpose()
    }

    async fn forget_uploads(&self) -> Result<u64, StoreError> {
        let gone = sqlx::query(
            "DELETE FROM uploads WHERE created_at <= meshmend_now($1) - $2 - CASE WHEN job_id IS NULL THEN 0 ELSE $3 END",
        )
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE))
        .bind(millis(KEY_LIFE))
        .execute(&self.pool)
        .await?;
        Ok(gone.rows_affected())
    }
}

/// Notes that a job is made of an upload, in the transaction that accepts it.
pub(super) async fn take(
    connection: &mut PgConnection,
    id: UploadId,
    job: JobId,
    now: Option<i64>,
) -> Result<(), StoreError> {
    let taken = sqlx::query(
        "UPDATE uploads SET job_id = $1 WHERE id = $2 AND job_id IS NULL AND created_at > meshmend_now($3) - $4",
    )
    .bind(job.to_string())
    .bind(id.to_string())
    .bind(now)
    .bind(millis(UPLOAD_LIFE))
    .execute(connection)
    .await?;
    if taken.rows_affected() == 1 { Ok(()) } else { Err(StoreError::UploadTaken) }
}
