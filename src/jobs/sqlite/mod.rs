mod keys;
mod uploads;

use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use rustix::fs::{FlockOperation, flock};
use sqlx::SqliteConnection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use uuid::Uuid;

use super::row::{corrupt, count, job_columns, millis, read_job, to_json, to_millis};
use super::store::{
    Cancelled, Claim, Completion, Failure, FailureKind, JobStore, Lease, ListQuery, NewJob, Page, StatusCount,
    StoreError,
};
use super::{Bell, Clock, Job, JobId, JobProblem, JobProgress, KeyState, RetryPolicy, Status};

/// Jobs in one SQLite file: the default, which needs nothing installed.
///
/// Writing goes through a single connection, since SQLite has one writer anyway and waiting in a pool is fairer than
/// waiting for a lock; reading has connections of its own (write-ahead logging lets both go on). Commits are synced to
/// disk: what was accepted survives a power cut.
///
/// A statement outside a transaction is committed when it has been stepped to its end, and only then can it fail for a
/// full disk; so statements with `RETURNING` are read to their end, never only to their first row.
pub struct SqliteStore {
    writer: SqlitePool,
    reader: SqlitePool,
    clock: Arc<dyn Clock>,
    retry: RetryPolicy,
    bell: Bell,
}

impl SqliteStore {
    /// Opens the file, makes it if it is missing, and brings its tables up to date.
    ///
    /// # Errors
    /// When the file can't be opened or was made by a newer version.
    pub async fn open(path: &Path, clock: Arc<dyn Clock>, retry: RetryPolicy) -> Result<Self, StoreError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10))
            .foreign_keys(true);
        // Migrations take no lock of their own, and a server and a worker may start together.
        let lock = File::create(path.with_extension("lock")).map_err(sqlx::Error::Io)?;
        let lock = tokio::task::spawn_blocking(move || flock(&lock, FlockOperation::LockExclusive).map(|()| lock));
        let lock = lock.await.map_err(|e| sqlx::Error::Io(e.into()))?.map_err(|e| sqlx::Error::Io(e.into()))?;
        let writer = SqlitePoolOptions::new().max_connections(1).connect_with(options.clone()).await?;
        sqlx::migrate!("migrations/sqlite").run(&writer).await?;
        drop(lock);
        let reader = SqlitePoolOptions::new().max_connections(4).connect_with(options.read_only(true)).await?;
        Ok(Self { writer, reader, clock, retry, bell: Bell::default() })
    }

    /// A write transaction that holds SQLite's write lock from its start, so that it never fails half way for a lock.
    async fn begin(&self) -> Result<sqlx::Transaction<'_, sqlx::Sqlite>, StoreError> {
        Ok(self.writer.begin_with("BEGIN IMMEDIATE").await?)
    }

    /// The job where this hold's own last write had arrived, though its worker did not hear of that.
    async fn ended_by(&self, held: &Lease) -> Result<Job, StoreError> {
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = ? AND ended_token = ?"))
            .bind(held.id.to_string())
            .bind(&held.token)
            .fetch_optional(&self.reader)
            .await?;
        read_job(&row.ok_or(StoreError::LeaseLost)?)
    }

    fn due_after(&self, tries: u32) -> i64 {
        let random = Uuid::new_v4().as_u64_pair().0;
        self.clock.now_ms() + millis(self.retry.delay(tries, random))
    }
}

#[async_trait]
impl JobStore for SqliteStore {
    async fn hold_key(&self, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        keys::hold(&mut *self.writer.acquire().await?, key, job, self.clock.now_ms()).await
    }

    async fn release_key(&self, key: &str, job: JobId) -> Result<(), StoreError> {
        keys::release(&mut *self.writer.acquire().await?, key, job).await
    }

    async fn forget_keys(&self) -> Result<u64, StoreError> {
        keys::forget(&mut *self.writer.acquire().await?, self.clock.now_ms()).await
    }

    async fn submit(&self, job: NewJob) -> Result<Job, StoreError> {
        let now = self.clock.now_ms();
        let mut transaction = self.begin().await?;
        if let Some(key) = &job.key {
            keys::settle(&mut transaction, key, job.id, now).await?;
        }
        if let Some(upload) = job.upload {
            uploads::take(&mut transaction, upload, job.id, now).await?;
        }
        let row = sqlx::query(concat!(
            "INSERT INTO jobs (id, status, created_at, run_at, inputs, options) \
             VALUES (?, 'queued', ?, ?, ?, ?) RETURNING ",
            job_columns!()
        ))
        .bind(job.id.to_string())
        .bind(now)
        .bind(now)
        .bind(to_json(&job.inputs))
        .bind(to_json(&job.options))
        .fetch_one(&mut *transaction)
        .await?;
        transaction.commit().await?;
        self.bell.ring_for_work();
        read_job(&row)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = ?"))
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(read_job).transpose()
    }

    async fn list(&self, query: ListQuery) -> Result<Page, StoreError> {
        let rows = sqlx::query(
            "SELECT id, status, outcome, attempt, crashes, created_at, run_at, started_at, finished_at, progress, \
                    inputs, options, NULL AS report, artifacts, problem, version, purged_at \
             FROM jobs WHERE purged_at IS NULL AND (?1 IS NULL OR status = ?1) AND (?2 IS NULL OR id < ?2) \
             ORDER BY id DESC LIMIT ?3",
        )
        .bind(query.status.map(Status::as_str))
        .bind(query.before.map(|id| id.to_string()))
        .bind(i64::from(query.limit) + 1)
        .fetch_all(&self.reader)
        .await?;
        let jobs = rows.iter().map(read_job).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(jobs, query.limit))
    }

    async fn queued(&self) -> Result<u64, StoreError> {
        let count: i64 =
            sqlx::query_scalar("SELECT count(*) FROM jobs WHERE status = 'queued'").fetch_one(&self.reader).await?;
        Ok(count.unsigned_abs())
    }

    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError> {
        if job.status != Status::Queued {
            return Ok(None);
        }
        let due = to_millis(job.run_at);
        let ahead: i64 = sqlx::query_scalar(
            "SELECT count(*) FROM jobs WHERE status = 'queued' AND (run_at < ?1 OR (run_at = ?1 AND id < ?2))",
        )
        .bind(due)
        .bind(job.id.to_string())
        .fetch_one(&self.reader)
        .await?;
        Ok(Some(ahead.unsigned_abs()))
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        let rows: Vec<(String, i64)> =
            sqlx::query_as("SELECT status, count(*) FROM jobs WHERE purged_at IS NULL GROUP BY status")
                .fetch_all(&self.reader)
                .await?;
        Ok(StatusCount::of_all(&rows))
    }

    async fn claim(&self, worker: &str, lease: Duration) -> Result<Option<Claim>, StoreError> {
        let now = self.clock.now_ms();
        let token = Uuid::new_v4().simple().to_string();
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'running', attempt = attempt + 1, worker = ?1, lease_token = ?2, \
             lease_expires_at = ?3, started_at = coalesce(started_at, ?4), progress = NULL, version = version + 1 \
             WHERE id = (SELECT id FROM jobs WHERE status = 'queued' AND run_at <= ?4 ORDER BY run_at, id LIMIT 1) \
             RETURNING ",
            job_columns!()
        ))
        .bind(worker)
        .bind(&token)
        .bind(now + millis(lease))
        .bind(now)
        .fetch_all(&self.writer)
        .await?
        .pop();
        let Some(row) = row else { return Ok(None) };
        let job = read_job(&row)?;
        self.bell.ring(job.id);
        // Another one may be due for another idle worker.
        self.bell.ring_for_work();
        Ok(Some(Claim { lease: Lease { id: job.id, attempt: job.attempt, token }, job }))
    }

    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError> {
        let progress = progress.as_ref().map(to_json);
        // The version grows only with news, so that a quiet heartbeat does not wake those who wait for a change.
        let row = sqlx::query(
            "UPDATE jobs SET lease_expires_at = ?1, version = version + (?2 IS NOT NULL AND ?2 IS NOT progress), \
             progress = coalesce(?2, progress) \
             WHERE id = ?3 AND attempt = ?4 AND lease_token = ?5 AND status = 'running' RETURNING id",
        )
        .bind(self.clock.now_ms() + millis(lease))
        .bind(&progress)
        .bind(held.id.to_string())
        .bind(held.attempt)
        .bind(&held.token)
        .fetch_all(&self.writer)
        .await?
        .pop();
        row.ok_or(StoreError::LeaseLost)?;
        if progress.is_some() {
            self.bell.ring(held.id);
        }
        Ok(())
    }

    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError> {
        let now = self.clock.now_ms();
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'succeeded', outcome = ?1, report = ?2, artifacts = ?3, problem = NULL, \
             progress = NULL, finished_at = ?4, worker = NULL, lease_token = NULL, lease_expires_at = NULL, \
             ended_token = ?7, version = version + 1 \
             WHERE id = ?5 AND attempt = ?6 AND lease_token = ?7 AND status = 'running' RETURNING ",
            job_columns!()
        ))
        .bind(to_json(&completion.report.outcome()))
        .bind(to_json(&completion.report))
        .bind(to_json(&completion.artifacts))
        .bind(now)
        .bind(held.id.to_string())
        .bind(held.attempt)
        .bind(&held.token)
        .fetch_all(&self.writer)
        .await?
        .pop();
        let Some(row) = row else { return self.ended_by(held).await };
        let job = read_job(&row)?;
        self.bell.ring(job.id);
        Ok(job)
    }

    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError> {
        let mut transaction = self.begin().await?;
        let counted: Option<(i64, i64)> = sqlx::query_as(
            "SELECT attempt, crashes FROM jobs \
             WHERE id = ? AND attempt = ? AND lease_token = ? AND status = 'running'",
        )
        .bind(held.id.to_string())
        .bind(held.attempt)
        .bind(&held.token)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some((attempt, crashes)) = counted else {
            drop(transaction);
            return self.ended_by(held).await;
        };
        let (attempt, crashes) = (count(attempt), count(crashes) + u32::from(failure.kind == FailureKind::Crash));
        let ended = self.retry.ends(failure.kind, attempt, crashes);
        let end = End {
            id: held.id,
            token: Some(&held.token),
            crashes,
            retry_at: (!ended).then(|| self.due_after(attempt)),
            problem: &failure.problem,
            artifacts: &to_json(&failure.artifacts),
            now: self.clock.now_ms(),
        };
        let job = end_attempt(&mut transaction, &end).await?;
        transaction.commit().await?;
        self.bell.ring(job.id);
        Ok(job)
    }

    async fn hand_back(&self, held: &Lease) -> Result<(), StoreError> {
        let row = sqlx::query(
            "UPDATE jobs SET status = 'queued', attempt = attempt - 1, progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = ? AND attempt = ? AND lease_token = ? AND status = 'running' RETURNING id",
        )
        .bind(held.id.to_string())
        .bind(held.attempt)
        .bind(&held.token)
        .fetch_all(&self.writer)
        .await?
        .pop();
        row.ok_or(StoreError::LeaseLost)?;
        self.bell.ring(held.id);
        self.bell.ring_for_work();
        Ok(())
    }

    async fn rescue(&self) -> Result<Vec<Job>, StoreError> {
        let now = self.clock.now_ms();
        // Most rounds find nothing, and need not take the write lock to see that.
        let waiting: bool =
            sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM jobs WHERE status = 'running' AND lease_expires_at <= ?)")
                .bind(now)
                .fetch_one(&self.reader)
                .await?;
        if !waiting {
            return Ok(Vec::new());
        }
        let mut transaction = self.begin().await?;
        let lost: Vec<(String, i64, String)> = sqlx::query_as(
            "SELECT id, crashes, artifacts FROM jobs WHERE status = 'running' AND lease_expires_at <= ? ORDER BY id",
        )
        .bind(now)
        .fetch_all(&mut *transaction)
        .await?;
        let mut rescued = Vec::with_capacity(lost.len());
        for (id, crashes, artifacts) in lost {
            let id = id.parse().map_err(|_| corrupt(&id, "id", "no job id"))?;
            let crashes = count(crashes) + 1;
            let problem = JobProblem::worker_lost(crashes);
            let retry_at = (crashes < self.retry.max_crashes).then_some(now);
            let end = End { id, token: None, crashes, retry_at, problem: &problem, artifacts: &artifacts, now };
            rescued.push(end_attempt(&mut transaction, &end).await?);
        }
        transaction.commit().await?;
        for job in &rescued {
            self.bell.ring(job.id);
            self.bell.ring_for_work();
        }
        Ok(rescued)
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError> {
        let mut transaction = self.begin().await?;
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'canceled', finished_at = ?1, progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = ?2 AND status IN ('queued', 'running') RETURNING ",
            job_columns!()
        ))
        .bind(self.clock.now_ms())
        .bind(id.to_string())
        .fetch_optional(&mut *transaction)
        .await?;
        if let Some(row) = row {
            let job = read_job(&row)?;
            transaction.commit().await?;
            self.bell.ring(id);
            return Ok(Some(Cancelled::Yes(Box::new(job))));
        }
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = ?"))
            .bind(id.to_string())
            .fetch_optional(&mut *transaction)
            .await?;
        Ok(row.as_ref().map(read_job).transpose()?.map(Cancelled::of_ended))
    }

    async fn purge(&self, id: JobId) -> Result<bool, StoreError> {
        let now = self.clock.now_ms();
        let row = sqlx::query(
            "UPDATE jobs SET purged_at = coalesce(purged_at, ?1), \
             status = CASE WHEN status IN ('queued', 'running') THEN 'canceled' ELSE status END, \
             finished_at = coalesce(finished_at, ?1), worker = NULL, lease_token = NULL, lease_expires_at = NULL, \
             progress = NULL, report = NULL, problem = NULL, artifacts = '{}', \
             inputs = (SELECT json_group_array(json_set(value, '$.name', '', '$.sha256', '')) FROM json_each(inputs)), \
             version = version + 1 \
             WHERE id = ?2 RETURNING id",
        )
        .bind(now)
        .bind(id.to_string())
        .fetch_all(&self.writer)
        .await?
        .pop();
        self.bell.ring(id);
        Ok(row.is_some())
    }

    async fn ping(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1").execute(&self.reader).await?;
        Ok(())
    }

    fn bell(&self) -> &Bell {
        &self.bell
    }
}

/// How an attempt ends without a result.
struct End<'a> {
    id: JobId,
    /// Of the worker that ends it; none where the worker is lost.
    token: Option<&'a str>,
    crashes: u32,
    /// When to try again; none to fail for good.
    retry_at: Option<i64>,
    problem: &'a JobProblem,
    artifacts: &'a str,
    now: i64,
}

/// Writes the end of an attempt. The caller has checked, in the same transaction, that the attempt may be ended.
async fn end_attempt(connection: &mut SqliteConnection, end: &End<'_>) -> Result<Job, StoreError> {
    let row = sqlx::query(concat!(
        "UPDATE jobs SET status = CASE WHEN ?1 IS NULL THEN 'failed' ELSE 'queued' END, run_at = coalesce(?1, run_at), \
         problem = CASE WHEN ?1 IS NULL THEN ?2 END, artifacts = CASE WHEN ?1 IS NULL THEN ?3 ELSE artifacts END, \
         finished_at = CASE WHEN ?1 IS NULL THEN ?4 END, crashes = ?5, progress = NULL, worker = NULL, \
         lease_token = NULL, lease_expires_at = NULL, ended_token = coalesce(?7, ended_token), version = version + 1 \
         WHERE id = ?6 RETURNING ",
        job_columns!()
    ))
    .bind(end.retry_at)
    .bind(to_json(end.problem))
    .bind(end.artifacts)
    .bind(end.now)
    .bind(end.crashes)
    .bind(end.id.to_string())
    .bind(end.token)
    .fetch_one(connection)
    .await?;
    read_job(&row)
}
