use std::time::Duration;

use async_trait::async_trait;
use uuid::Uuid;

use super::PostgresStore;
use crate::jobs::drawings::{can_be_drawn, with_drawings};
use crate::jobs::row::{count, job_columns, millis, read_job, to_json};
use crate::jobs::{Artifacts, Claim, DrawingStore, Job, JobId, JobStore, Lease, StoreError};

#[async_trait]
impl DrawingStore for PostgresStore {
    async fn ask_for_drawings(&self, job: JobId) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO drawings (job_id, tenant, asked_at) SELECT id, tenant, meshmend_now($2) FROM jobs WHERE id = $1 \
             ON CONFLICT (job_id) DO NOTHING",
        )
        .bind(job.to_string())
        .bind(self.now())
        .execute(&self.pool)
        .await?;
        Ok(())
    }

    async fn claim_drawings(&self, lease: Duration) -> Result<Option<Claim>, StoreError> {
        let token = Uuid::new_v4().simple().to_string();
        let claimed: Option<(String, i64)> = sqlx::query_as(
            "UPDATE drawings SET attempt = attempt + 1, lease_token = $1, lease_expires_at = meshmend_now($2) + $3 \
             WHERE job_id = ( \
                 SELECT job_id FROM drawings AS next WHERE lease_expires_at IS NULL OR lease_expires_at <= meshmend_now($2) \
                 ORDER BY (SELECT count(*) FROM drawings AS held \
                           WHERE held.tenant = next.tenant AND held.lease_expires_at > meshmend_now($2)), \
                          asked_at, job_id LIMIT 1 FOR UPDATE SKIP LOCKED) \
             RETURNING job_id, attempt",
        )
        .bind(&token)
        .bind(self.now())
        .bind(millis(lease))
        .fetch_optional(&self.pool)
        .await?;
        let Some((id, attempt)) = claimed else { return Ok(None) };
        let job = match id.parse() {
            Ok(id) => self.get(id).await?.filter(can_be_drawn),
            Err(_) => None,
        };
        let Some(job) = job else {
            sqlx::query("DELETE FROM drawings WHERE job_id = $1").bind(id).execute(&self.pool).await?;
            return Ok(None);
        };
        // Another one may wait for another idle worker.
        self.bell.ring_for_work();
        Ok(Some(Claim { lease: Lease { id: job.id, attempt: count(attempt), token }, job }))
    }

    async fn hold_drawings(&self, held: &Lease, lease: Duration) -> Result<(), StoreError> {
        let statement = sqlx::query(
            "UPDATE drawings SET lease_expires_at = meshmend_now($1) + $2 \
             WHERE job_id = $3 AND attempt = $4 AND lease_token = $5",
        );
        self.fenced(statement.bind(self.now()).bind(millis(lease)), held).await
    }

    async fn finish_drawings(&self, held: &Lease, drawn: Artifacts) -> Result<Job, StoreError> {
        let mut transaction = self.pool.begin().await?;
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1 FOR UPDATE"))
            .bind(held.id.to_string())
            .fetch_optional(&mut *transaction)
            .await?;
        let ours = sqlx::query("DELETE FROM drawings WHERE job_id = $1 AND lease_token = $2")
            .bind(held.id.to_string())
            .bind(&held.token)
            .execute(&mut *transaction)
            .await?;
        let job = row.as_ref().map(read_job).transpose()?.filter(|job| ours.rows_affected() == 1 && can_be_drawn(job));
        let job = job.ok_or(StoreError::LeaseLost)?;
        let artifacts = with_drawings(job.artifacts.clone(), drawn);
        sqlx::query("UPDATE jobs SET artifacts = $1, version = version + 1 WHERE id = $2")
            .bind(to_json(&artifacts))
            .bind(held.id.to_string())
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(Job { artifacts, version: job.version + 1, ..job })
    }
}
