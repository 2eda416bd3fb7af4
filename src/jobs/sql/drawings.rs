use std::time::Duration;

use async_trait::async_trait;
use uuid::Uuid;

use super::{Dialect, SqlConnection, SqlStore, sql};
use crate::jobs::drawings::{can_be_drawn, with_drawings};
use crate::jobs::row::{Columns, count, job_columns, millis, read_job, to_json};
use crate::jobs::{Artifacts, Claim, DrawingStore, Job, JobId, JobStore, Lease, StoreError};

#[async_trait]
impl<D: Dialect> DrawingStore for SqlStore<D> {
    async fn ask_for_drawings(&self, job: JobId) -> Result<(), StoreError> {
        let statement = sql(
            "INSERT INTO drawings (job_id, tenant, asked_at) SELECT id, tenant, meshmend_now($2) FROM jobs WHERE id = $1 \
             ON CONFLICT (job_id) DO NOTHING",
        );
        self.writer().await?.execute(statement.bind(job).bind(self.now())).await?;
        self.notify_work();
        Ok(())
    }

    async fn claim_drawings(&self, lease: Duration) -> Result<Option<Claim>, StoreError> {
        let due = "SELECT job_id FROM drawings WHERE lease_expires_at IS NULL OR lease_expires_at <= meshmend_now($1) LIMIT 1";
        if self.is_idle(sql(due).bind(self.now())).await? {
            return Ok(None);
        }
        let token = Uuid::new_v4().simple().to_string();
        let statement = sql(
            "UPDATE drawings SET attempt = attempt + 1, lease_token = $1, lease_expires_at = meshmend_now($2) + $3 \
             WHERE job_id = ( \
                 SELECT job_id FROM drawings AS next WHERE lease_expires_at IS NULL OR lease_expires_at <= meshmend_now($2) \
                 ORDER BY (SELECT count(*) FROM drawings AS held \
                           WHERE held.tenant = next.tenant AND held.lease_expires_at > meshmend_now($2)), \
                          asked_at, job_id LIMIT 1 FOR UPDATE SKIP LOCKED) \
             RETURNING job_id AS id, attempt",
        )
        .bind(&token)
        .bind(self.now())
        .bind(millis(lease));
        let Some(claimed) = self.writer().await?.query_row(statement).await? else { return Ok(None) };
        let (id, attempt) = (claimed.text("id")?.unwrap_or_default(), claimed.number("attempt")?.unwrap_or_default());
        let job = match id.parse() {
            Ok(id) => self.get(id).await?.filter(can_be_drawn),
            Err(_) => None,
        };
        let Some(job) = job else {
            self.writer().await?.execute(sql("DELETE FROM drawings WHERE job_id = $1").bind(id)).await?;
            return Ok(None);
        };
        // Another job may have drawings to claim, and another worker may be idle.
        self.bell.ring_for_work();
        Ok(Some(Claim { lease: Lease { id: job.id, attempt: count(attempt), token }, job }))
    }

    async fn hold_drawings(&self, held: &Lease, lease: Duration) -> Result<(), StoreError> {
        let statement = sql("UPDATE drawings SET lease_expires_at = meshmend_now($1) + $2 \
             WHERE job_id = $3 AND attempt = $4 AND lease_token = $5");
        self.fenced(statement.bind(self.now()).bind(millis(lease)), held).await
    }

    async fn finish_drawings(&self, held: &Lease, drawn: Artifacts) -> Result<Job, StoreError> {
        let mut transaction = self.begin().await?;
        let job = sql(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1 FOR UPDATE")).bind(held.id);
        let job = transaction.query_row(job).await?.as_ref().map(read_job).transpose();
        let release =
            sql("DELETE FROM drawings WHERE job_id = $1 AND lease_token = $2").bind(held.id).bind(&held.token);
        let is_held = transaction.execute(release).await? == 1;
        let job = job?.filter(|job| is_held && can_be_drawn(job)).ok_or(StoreError::LeaseLost)?;
        let artifacts = with_drawings(job.artifacts.clone(), drawn);
        let publish = sql("UPDATE jobs SET artifacts = $1, version = version + 1 WHERE id = $2");
        transaction.execute(publish.bind(to_json(&artifacts)).bind(held.id)).await?;
        transaction.commit().await?;
        self.notify_job(held.id);
        Ok(Job { artifacts, version: job.version + 1, ..job })
    }
}
