use async_trait::async_trait;

use super::{Dialect, SqlConnection, SqlStore, keys, outbox, sql, uploads};
use crate::jobs::row::{Columns, job_columns, read_job, to_json};
use crate::jobs::{Cancelled, Job, JobId, JobStore, ListQuery, NewJob, Page, StatusCount, StoreError};

#[async_trait]
impl<D: Dialect> JobStore for SqlStore<D> {
    async fn submit(&self, job: NewJob) -> Result<Job, StoreError> {
        // Most jobs write nothing but their row: one statement is enough.
        if job.key.is_none() && job.upload.is_none() && job.result.is_none() {
            let job = insert(&mut *self.writer().await?, &job, self.now()).await?;
            self.notify_work();
            return Ok(job);
        }
        let now = self.now();
        let mut transaction = self.begin().await?;
        if let Some(key) = &job.key {
            keys::record_use(&mut *transaction, &job.tenant, key, job.id, now).await?;
        }
        if let Some(upload) = job.upload {
            uploads::assign(&mut *transaction, upload, job.id, now).await?;
        }
        let job = insert(&mut *transaction, &job, now).await?;
        let has_receivers = outbox::record_end(&mut *transaction, &job, now).await?;
        transaction.commit().await?;
        self.notify_work();
        if has_receivers {
            self.notify_deliveries();
        }
        Ok(job)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        let statement = sql(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1")).bind(id);
        self.reader().await?.query_row(statement).await?.as_ref().map(read_job).transpose()
    }

    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError> {
        let statement = sql(D::LIST)
            .bind(&query.tenant)
            .bind(&query.made_by)
            .bind(to_json(&query.statuses))
            .bind(query.before)
            .bind(i64::from(query.limit) + 1)
            .bind(to_json(&query.outcomes))
            .bind(query.created_from)
            .bind(query.created_before)
            .bind(to_json(&query.metadata));
        let rows = self.reader().await?.query(statement).await?;
        let jobs = rows.iter().map(read_job).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(jobs, query.limit, |job| job.id))
    }

    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError> {
        let statement = sql(concat!(
            "SELECT ",
            job_columns!(),
            " FROM jobs WHERE tenant = $1 AND fingerprint = $2 AND status = 'succeeded' AND purged_at IS NULL \
              ORDER BY id DESC LIMIT 1"
        ));
        let row = self.reader().await?.query_row(statement.bind(tenant).bind(fingerprint)).await?;
        row.as_ref().map(read_job).transpose()
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        let statement = sql("SELECT status, count(*) AS jobs FROM jobs WHERE purged_at IS NULL GROUP BY status");
        let mut counts = Vec::new();
        for row in self.reader().await?.query(statement).await? {
            counts.extend(row.text("status")?.zip(row.number("jobs")?));
        }
        Ok(StatusCount::of_all(&counts))
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError> {
        let now = self.now();
        let mut transaction = self.begin().await?;
        let statement = sql(concat!(
            "UPDATE jobs SET status = 'canceled', finished_at = meshmend_now($1), progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = $2 AND status IN ('queued', 'running') RETURNING ",
            job_columns!()
        ));
        if let Some(row) = transaction.query_row(statement.bind(now).bind(id)).await? {
            let job = self.end(transaction, read_job(&row)?, now).await?;
            return Ok(Some(Cancelled::Yes(Box::new(job))));
        }
        drop(transaction);
        Ok(self.get(id).await?.map(Cancelled::of_ended))
    }
}

/// Adds a job. A job with a result has ended already.
async fn insert(connection: &mut impl SqlConnection, job: &NewJob, now: Option<i64>) -> Result<Job, StoreError> {
    let result = job.result.as_ref();
    let statement = sql(concat!(
        "INSERT INTO jobs (id, tenant, made_by, status, outcome, created_at, run_at, started_at, finished_at, inputs, options, \
                           metadata, callback_url, fingerprint, reused_from, report, artifacts, traceparent) \
         VALUES ($1, $2, $3, CASE WHEN $6 THEN 'succeeded' ELSE 'queued' END, $4, meshmend_now($5), meshmend_now($5), \
                 CASE WHEN $6 THEN meshmend_now($5) END, CASE WHEN $6 THEN meshmend_now($5) END, $7, $8, \
                 $9, $10, $11, $12, $13, coalesce($14, '{}'), $15) RETURNING ",
        job_columns!()
    ))
    .bind(job.id)
    .bind(&job.tenant)
    .bind(&job.made_by)
    .bind(result.map(|result| to_json(&result.outcome)))
    .bind(now)
    .bind(result.is_some())
    .bind(to_json(&job.inputs))
    .bind(to_json(&job.options))
    .bind(to_json(&job.metadata))
    .bind(&job.callback_url)
    .bind(&job.fingerprint)
    .bind(result.map(|result| result.from))
    .bind(result.map(|result| to_json(&result.report)))
    .bind(result.map(|result| to_json(&result.artifacts)))
    .bind(&job.traceparent);
    read_job(&connection.query_row(statement).await?.ok_or(sqlx::Error::RowNotFound)?)
}
