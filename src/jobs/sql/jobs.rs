//! Jobs from their acceptance to the deletion of their rows, with the idempotency keys and uploads of their requests.

use std::time::Duration;

use async_trait::async_trait;

use super::outbox::delete_messages;
use super::statement::{Columns, Reader, SqlConnection, corrupt, millis, sql, to_json};
use super::store::{Dialect, SqlStore};
use crate::jobs::error::StoreError;
use crate::jobs::id::{JobId, UploadId};
use crate::jobs::job::{Input, Job};
use crate::jobs::queue::{
    KEY_HOLD, KEY_LIFE, KeyState, NewJob, NewUpload, PendingUpload, RequestKey, UPLOAD_LIFE, UPLOAD_OPEN,
};
use crate::jobs::store::{
    CancelResult, IdempotencyStore, JobStore, ListQuery, Page, RetentionStore, StatusCount, UploadStore,
};

/// The columns of a job, for `SELECT` and `RETURNING`. The argument replaces the report where a caller does not need it.
macro_rules! job_columns {
    () => {
        job_columns!("report")
    };
    ($report:literal) => {
        concat!(
            "id, tenant, made_by, status, outcome, attempt, crashes, created_at, run_at, started_at, finished_at, progress, inputs, \
             options, metadata, callback_url, reused_from, ",
            $report,
            ", artifacts, problem, traceparent, version, purged_at"
        )
    };
}
pub(super) use job_columns;

/// Selects the last job that succeeded and whose result can be reused: tenant, fingerprint.
pub(super) const FIND_RESULT: &str = concat!(
    "SELECT ",
    job_columns!(),
    " FROM jobs WHERE tenant = $1 AND fingerprint = $2 AND status = 'succeeded' AND purged_at IS NULL \
      ORDER BY id DESC LIMIT 1"
);

/// Reads a job from a row of [`job_columns`].
pub(super) fn read_job(row: &impl Columns) -> Result<Job, StoreError> {
    let from = Reader::new(row)?;
    let inputs: Vec<Input> = from.json("inputs")?;
    if inputs.is_empty() {
        return Err(corrupt(&from.id, "inputs", "the list is empty"));
    }
    Ok(Job {
        id: from.parsed("id")?,
        tenant: from.text("tenant")?,
        api_key_id: from.some_text("made_by")?,
        status: from.parsed("status")?,
        outcome: from.some_json("outcome")?,
        progress: from.some_json("progress")?,
        attempt: from.count("attempt")?,
        crashes: from.count("crashes")?,
        created_at: from.time("created_at")?,
        run_at: from.time("run_at")?,
        started_at: from.some_time("started_at")?,
        finished_at: from.some_time("finished_at")?,
        inputs,
        options: from.json("options")?,
        metadata: from.some_json("metadata")?.unwrap_or_default(),
        callback_url: from.some_text("callback_url")?,
        reused_from: from.some_parsed("reused_from")?,
        report: from.some_json("report")?,
        artifacts: from.some_json("artifacts")?.unwrap_or_default(),
        problem: from.some_json("problem")?,
        traceparent: from.some_text("traceparent")?,
        version: from.number("version")?,
        purged: from.some_number("purged_at")?.is_some(),
    })
}

/// The assignments that empty a row's content, except its inputs.
macro_rules! emptied {
    () => {
        "worker = NULL, lease_token = NULL, lease_expires_at = NULL, progress = NULL, report = NULL, artifacts = '{}', \
         metadata = '{}', callback_url = NULL, fingerprint = NULL, version = version + 1"
    };
}

#[async_trait]
impl<D: Dialect> JobStore for SqlStore<D> {
    async fn submit(&self, job: NewJob) -> Result<Job, StoreError> {
        // Most jobs write only their row, for which one statement is enough.
        if job.key.is_none() && job.upload.is_none() && job.result.is_none() {
            let job = insert(&mut *self.writer().await?, &job, self.now()).await?;
            self.notify_work();
            return Ok(job);
        }
        let now = self.now();
        let mut transaction = self.begin().await?;
        if let Some(key) = &job.key {
            record_use(&mut *transaction, &job.tenant, key, job.id, now).await?;
        }
        if let Some(upload) = job.upload {
            assign(&mut *transaction, upload, job.id, now).await?;
        }
        let job = insert(&mut *transaction, &job, now).await?;
        let has_receivers = self.record_end(&mut *transaction, &job, now).await?;
        transaction.commit().await?;
        self.notify_work();
        if has_receivers {
            self.notify_deliveries();
        }
        Ok(job)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        let statement = sql(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1")).bind(id);
        self.read_one(statement, read_job).await
    }

    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError> {
        let statement = sql(if query.statuses.len() == 1 { D::LIST_OF_STATUS } else { D::LIST })
            .bind(&query.tenant)
            .bind(&query.api_key_id)
            .bind(to_json(&query.statuses))
            .bind(query.before)
            .bind(i64::from(query.limit) + 1)
            .bind(to_json(&query.outcomes))
            .bind(query.created_from)
            .bind(query.created_before)
            .bind(to_json(&query.metadata));
        Ok(Page::of(self.read_all(statement, read_job).await?, query.limit, |job| job.id))
    }

    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError> {
        let statement = sql(FIND_RESULT).bind(tenant).bind(fingerprint);
        self.read_one(statement, read_job).await
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        let statement = sql("SELECT status, count(*) AS jobs FROM jobs WHERE purged_at IS NULL GROUP BY status");
        let mut counts = Vec::new();
        for row in self.reader().await?.query(statement).await? {
            counts.extend(row.text("status")?.zip(row.number("jobs")?));
        }
        Ok(StatusCount::of_all(&counts))
    }

    async fn cancel(&self, id: JobId) -> Result<Option<CancelResult>, StoreError> {
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
            return Ok(Some(CancelResult::Canceled(Box::new(job))));
        }
        drop(transaction);
        Ok(self.get(id).await?.map(CancelResult::of_ended))
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
    .bind(&job.api_key_id)
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

#[async_trait]
impl<D: Dialect> RetentionStore for SqlStore<D> {
    async fn expire(&self, age: Duration, max: u32) -> Result<Vec<JobId>, StoreError> {
        let mut transaction = self.begin().await?;
        // Oldest first. Several processes may expire jobs at the same time.
        let old = sql(
            "SELECT id, inputs FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND status <> 'expired' AND purged_at IS NULL \
             ORDER BY finished_at, id LIMIT $3 FOR UPDATE SKIP LOCKED",
        )
        .bind(self.now())
        .bind(millis(age))
.bind(max);
        let mut expired = Vec::new();
        for row in transaction.query(old).await? {
            let from = Reader::new(&row)?;
            let (id, inputs) = (from.parsed("id")?, without_content(&from.id, &from.text("inputs")?)?);
            let empty = sql(concat!("UPDATE jobs SET status = 'expired', inputs = $1, ", emptied!(), " WHERE id = $2"));
            transaction.execute(empty.bind(inputs).bind(id)).await?;
            expired.push(id);
        }
        transaction.commit().await?;
        expired.iter().for_each(|id| self.notify_job(*id));
        Ok(expired)
    }

    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError> {
        let statement = sql(
            "DELETE FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND (status = 'expired' OR purged_at IS NOT NULL)",
        );
        self.writer().await?.execute(statement.bind(self.now()).bind(millis(age))).await
    }

    async fn purge(&self, id: JobId) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let row = transaction.query_row(sql("SELECT id, inputs FROM jobs WHERE id = $1 FOR UPDATE").bind(id)).await?;
        let Some(row) = row else { return Ok(false) };
        let from = Reader::new(&row)?;
        let empty = sql(concat!(
            "UPDATE jobs SET purged_at = coalesce(purged_at, meshmend_now($1)), \
             status = CASE WHEN status IN ('queued', 'running') THEN 'canceled' ELSE status END, \
             finished_at = coalesce(finished_at, meshmend_now($1)), problem = NULL, inputs = $2, ",
            emptied!(),
            " WHERE id = $3"
        ))
        .bind(self.now())
        .bind(without_content(&from.id, &from.text("inputs")?)?)
        .bind(id);
        transaction.execute(empty).await?;
        delete_messages(&mut *transaction, id).await?;
        transaction.commit().await?;
        self.notify_job(id);
        Ok(true)
    }
}

/// Inputs without their names and checksums.
fn without_content(id: &str, inputs: &str) -> Result<String, StoreError> {
    let mut inputs: Vec<Input> = serde_json::from_str(inputs).map_err(|error| corrupt(id, "inputs", error))?;
    for input in &mut inputs {
        input.name.clear();
        input.sha256.clear();
    }
    Ok(to_json(&inputs))
}

#[async_trait]
impl<D: Dialect> IdempotencyStore for SqlStore<D> {
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        let mut connection = self.writer().await?;
        let hold = sql(
            "INSERT INTO idempotency_keys (tenant, key, job_id, expires_at) VALUES ($5, $1, $2, meshmend_now($3) + $4) \
             ON CONFLICT (tenant, key) DO UPDATE SET job_id = excluded.job_id, fingerprint = NULL, expires_at = excluded.expires_at \
             WHERE idempotency_keys.expires_at <= meshmend_now($3) \
                OR (idempotency_keys.job_id = excluded.job_id AND idempotency_keys.fingerprint IS NULL)",
        )
        .bind(key)
        .bind(job)
        .bind(self.now())
        .bind(millis(KEY_HOLD))
        .bind(tenant);
        if connection.execute(hold).await? == 1 {
            return Ok(KeyState::Held);
        }
        let holder = sql("SELECT fingerprint, job_id FROM idempotency_keys WHERE tenant = $1 AND key = $2");
        state_of_another(connection.query_row(holder.bind(tenant).bind(key)).await?.as_ref())
    }

    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError> {
        let statement =
            sql("DELETE FROM idempotency_keys WHERE tenant = $1 AND key = $2 AND job_id = $3 AND fingerprint IS NULL");
        self.writer().await?.execute(statement.bind(tenant).bind(key).bind(job)).await?;
        Ok(())
    }

    async fn forget_keys(&self) -> Result<u64, StoreError> {
        let statement = sql("DELETE FROM idempotency_keys WHERE expires_at <= meshmend_now($1)");
        self.writer().await?.execute(statement.bind(self.now())).await
    }
}

/// Records that a request was accepted, in the transaction that accepts it.
async fn record_use(
    connection: &mut impl SqlConnection,
    tenant: &str,
    request: &RequestKey,
    job: JobId,
    now: Option<i64>,
) -> Result<(), StoreError> {
    let statement = sql("UPDATE idempotency_keys SET fingerprint = $1, expires_at = meshmend_now($2) + $3 \
         WHERE tenant = $4 AND key = $5 AND job_id = $6")
    .bind(&request.fingerprint)
    .bind(now)
    .bind(millis(KEY_LIFE))
    .bind(tenant)
    .bind(&request.key)
    .bind(job);
    if connection.execute(statement).await? == 1 { Ok(()) } else { Err(StoreError::KeyLost) }
}

/// The state of a key that another request holds or used, from the columns `fingerprint` and `job_id` of the key's row.
fn state_of_another(row: Option<&impl Columns>) -> Result<KeyState, StoreError> {
    let Some(row) = row else { return Ok(KeyState::InUse) };
    let Some(fingerprint) = row.text("fingerprint")? else { return Ok(KeyState::InUse) };
    let id = row.text("job_id")?.unwrap_or_default();
    let job = id.parse().map_err(|_| corrupt(&id, "job_id", "not a job id"))?;
    Ok(KeyState::Used { fingerprint, job })
}

#[async_trait]
impl<D: Dialect> UploadStore for SqlStore<D> {
    async fn add_upload(&self, upload: NewUpload, max: u64) -> Result<Option<PendingUpload>, StoreError> {
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
        .bind(i64::try_from(max).unwrap_or(i64::MAX));
        self.write_one(statement, read_upload).await
    }

    async fn upload(&self, id: UploadId) -> Result<Option<PendingUpload>, StoreError> {
        let statement = sql(
            "SELECT id, tenant, name, token_sha256, created_at, meshmend_now($2) - created_at AS age, job_id FROM uploads \
             WHERE id = $1 AND (job_id IS NOT NULL OR created_at > meshmend_now($2) - $3)",
        )
        .bind(id.to_string())
        .bind(self.now())
        .bind(millis(UPLOAD_LIFE));
        self.read_one(statement, read_upload).await
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
async fn assign(
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

/// Reads an upload from a row of its columns and its `age` in milliseconds.
fn read_upload(row: &impl Columns) -> Result<PendingUpload, StoreError> {
    let from = Reader::new(row)?;
    let job: Option<JobId> = from.some_parsed("job_id")?;
    let is_open = u128::try_from(from.number("age")?).is_ok_and(|age| age < UPLOAD_OPEN.as_millis()) && job.is_none();
    let upload = NewUpload {
        id: from.parsed("id")?,
        tenant: from.text("tenant")?,
        name: from.some_text("name")?,
        token_sha256: from.some_text("token_sha256")?,
    };
    Ok(PendingUpload { upload, created_at: from.time("created_at")?, is_open, job })
}
