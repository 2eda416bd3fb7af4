mod access;
mod backup;
mod drawings;
mod keys;
mod outbox;
mod queue;
mod retention;
mod uploads;
mod webhooks;

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use rustix::fs::{FlockOperation, flock};
use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use uuid::Uuid;

pub use backup::BackupError;

use super::row::{corrupt, count, elapsed, job_columns, millis, read_job, to_json};
use super::store::{
    Cancelled, Claim, ClassLoad, Completion, Connections, Failure, FailureKind, JobStore, Lease, ListQuery, NewJob,
    Page, StatusCount, StoreError, Waiting,
};
use super::{Bell, Clock, Job, JobId, JobProblem, JobProgress, KeyState, RetryPolicy, Status, StoredReport};

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
    /// Opens the file, makes it if it is missing, and brings its tables up to date. Only this user may read a file that is made.
    ///
    /// # Errors
    /// When the file can't be opened or was made by a newer version.
    pub async fn open(path: &Path, clock: Arc<dyn Clock>, retry: RetryPolicy) -> Result<Self, StoreError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10))
            .foreign_keys(true);
        // Migrations take no lock of their own, and a server and a worker may start together.
        let lock = create_private(&path.with_extension("lock")).map_err(sqlx::Error::Io)?;
        // SQLite gives the files beside it the same permissions.
        create_private(path).map_err(sqlx::Error::Io)?;
        let lock = tokio::task::spawn_blocking(move || flock(&lock, FlockOperation::LockExclusive).map(|()| lock));
        let lock = lock.await.map_err(|e| sqlx::Error::Io(e.into()))?.map_err(|e| sqlx::Error::Io(e.into()))?;
        // Where the disk is full SQLite ends a transaction by itself, which sqlx does not see: it would refuse the next one for ever.
        // Nothing can come between this process and a file of its own, so that connections need not be tried before each use.
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .test_before_acquire(false)
            .before_acquire(|connection, _| Box::pin(async move { Ok(!connection.is_in_transaction()) }))
            .connect_with(options.clone())
            .await?;
        sqlx::migrate!("migrations/sqlite").run(&writer).await?;
        drop(lock);
        let reader = SqlitePoolOptions::new().max_connections(4).test_before_acquire(false);
        let reader = reader.connect_with(options.read_only(true)).await?;
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

    /// Tells who delivers webhooks, if there is anybody to be told of something.
    fn ring_if(&self, told: bool) {
        if told {
            self.bell.ring_for_deliveries();
        }
    }

    fn due_after(&self, tries: u32) -> i64 {
        let random = Uuid::new_v4().as_u64_pair().0;
        self.clock.now_ms() + millis(self.retry.delay(tries, random))
    }
}

/// Opens a file for writing. One that is made is for this user alone, since the database holds what clients sent and hashes of keys.
fn create_private(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create(true).truncate(false).mode(0o600).open(path)
}

#[async_trait]
impl JobStore for SqliteStore {
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        keys::hold(&mut *self.writer.acquire().await?, tenant, key, job, self.clock.now_ms()).await
    }

    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError> {
        keys::release(&mut *self.writer.acquire().await?, tenant, key, job).await
    }

    async fn forget_keys(&self) -> Result<u64, StoreError> {
        keys::forget(&mut *self.writer.acquire().await?, self.clock.now_ms()).await
    }

    async fn submit(&self, job: NewJob) -> Result<Job, StoreError> {
        let now = self.clock.now_ms();
        let mut transaction = self.begin().await?;
        if let Some(key) = &job.key {
            keys::settle(&mut transaction, &job.tenant, key, job.id, now).await?;
        }
        if let Some(upload) = job.upload {
            uploads::take(&mut transaction, upload, job.id, now).await?;
        }
        let job = queue::insert(&mut transaction, &job, now).await?;
        let told = outbox::note(&mut transaction, &job, now).await?;
        transaction.commit().await?;
        self.bell.ring_for_work();
        self.ring_if(told);
        Ok(job)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = ?"))
            .bind(id.to_string())
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(read_job).transpose()
    }

    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            job_columns!("NULL AS report"),
            " FROM jobs WHERE tenant = ?1 AND purged_at IS NULL AND (?2 IS NULL OR made_by = ?2) \
              AND (?3 = '[]' OR status IN (SELECT value FROM json_each(?3))) AND (?4 IS NULL OR id < ?4) \
              AND (?6 = '[]' OR outcome IN (SELECT json_quote(value) FROM json_each(?6))) \
              AND (?7 IS NULL OR created_at >= ?7) AND (?8 IS NULL OR created_at < ?8) \
              AND NOT EXISTS (SELECT 1 FROM json_each(?9) AS wanted WHERE NOT EXISTS (SELECT 1 FROM json_each(metadata) AS noted \
                  WHERE noted.key = wanted.key AND noted.value = wanted.value)) \
              ORDER BY id DESC LIMIT ?5"
        ))
        .bind(&query.tenant)
        .bind(&query.made_by)
        .bind(sqlx::types::Json(&query.statuses))
        .bind(query.before.map(|id| id.to_string()))
        .bind(i64::from(query.limit) + 1)
        .bind(sqlx::types::Json(&query.outcomes))
        .bind(query.created_from)
        .bind(query.created_before)
        .bind(sqlx::types::Json(&query.metadata))
        .fetch_all(&self.reader)
        .await?;
        let jobs = rows.iter().map(read_job).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(jobs, query.limit, |job| job.id))
    }

    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError> {
        queue::find_result(&self.reader, tenant, fingerprint).await
    }

    async fn waiting(&self, tenant: &str) -> Result<Waiting, StoreError> {
        queue::waiting(&self.reader, tenant).await
    }

    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError> {
        if job.status != Status::Queued {
            return Ok(None);
        }
        queue::position(&self.reader, job).await.map(Some)
    }

    async fn longest_wait(&self) -> Result<Duration, StoreError> {
        // Left to itself, SQLite would sort all that wait.
        let due: Option<i64> = sqlx::query_scalar(
            "SELECT run_at FROM jobs INDEXED BY jobs_due WHERE status = 'queued' ORDER BY run_at, id LIMIT 1",
        )
        .fetch_optional(&self.reader)
        .await?;
        Ok(due.map_or(Duration::ZERO, |due| elapsed(self.clock.now_ms() - due)))
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        let rows: Vec<(String, i64)> =
            sqlx::query_as("SELECT status, count(*) FROM jobs WHERE purged_at IS NULL GROUP BY status")
                .fetch_all(&self.reader)
                .await?;
        Ok(StatusCount::of_all(&rows))
    }

    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError> {
        queue::class_loads(&self.reader, self.clock.now_ms()).await
    }

    async fn claim(&self, worker: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError> {
        let (now, token) = (self.clock.now_ms(), Uuid::new_v4().simple().to_string());
        let claiming = queue::Claiming { worker, token: &token, now, until: now + millis(lease), max_running };
        let Some(job) = queue::claim(&self.writer, &claiming).await? else { return Ok(None) };
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
        let (now, report) = (self.clock.now_ms(), StoredReport::of(&completion.report));
        let mut transaction = self.begin().await?;
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'succeeded', outcome = ?1, report = ?2, artifacts = ?3, problem = NULL, \
             progress = NULL, finished_at = ?4, worker = NULL, lease_token = NULL, lease_expires_at = NULL, \
             ended_token = ?7, version = version + 1 \
             WHERE id = ?5 AND attempt = ?6 AND lease_token = ?7 AND status = 'running' RETURNING ",
            job_columns!("NULL AS report")
        ))
        .bind(to_json(&completion.report.outcome()))
        .bind(report.json())
        .bind(to_json(&completion.artifacts))
        .bind(now)
        .bind(held.id.to_string())
        .bind(held.attempt)
        .bind(&held.token)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else {
            drop(transaction);
            return self.ended_by(held).await;
        };
        let job = Job { report: Some(report), ..read_job(&row)? };
        let told = outbox::note(&mut transaction, &job, now).await?;
        transaction.commit().await?;
        self.bell.ring(job.id);
        self.ring_if(told);
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
        let end = queue::End {
            id: held.id,
            token: Some(&held.token),
            crashes,
            retry_at: (!ended).then(|| self.due_after(attempt)),
            problem: &failure.problem,
            artifacts: &to_json(&failure.artifacts),
            report: failure.report.as_ref(),
            now: self.clock.now_ms(),
        };
        let job = queue::end_attempt(&mut transaction, &end).await?;
        let told = outbox::note(&mut transaction, &job, end.now).await?;
        transaction.commit().await?;
        self.bell.ring(job.id);
        self.ring_if(told);
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
        let (mut rescued, mut told) = (Vec::with_capacity(lost.len()), false);
        for (id, crashes, artifacts) in lost {
            let id = id.parse().map_err(|_| corrupt(&id, "id", "no job id"))?;
            let crashes = count(crashes) + 1;
            let problem = JobProblem::worker_lost(crashes);
            let retry_at = (crashes < self.retry.max_crashes).then_some(now);
            let (problem, artifacts) = (&problem, artifacts.as_str());
            let end = queue::End { id, token: None, crashes, retry_at, problem, artifacts, report: None, now };
            let job = queue::end_attempt(&mut transaction, &end).await?;
            told |= outbox::note(&mut transaction, &job, now).await?;
            rescued.push(job);
        }
        transaction.commit().await?;
        self.ring_if(told);
        for job in &rescued {
            self.bell.ring(job.id);
            self.bell.ring_for_work();
        }
        Ok(rescued)
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError> {
        let now = self.clock.now_ms();
        let mut transaction = self.begin().await?;
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'canceled', finished_at = ?1, progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = ?2 AND status IN ('queued', 'running') RETURNING ",
            job_columns!()
        ))
        .bind(now)
        .bind(id.to_string())
        .fetch_optional(&mut *transaction)
        .await?;
        if let Some(row) = row {
            let job = read_job(&row)?;
            let told = outbox::note(&mut transaction, &job, now).await?;
            transaction.commit().await?;
            self.bell.ring(id);
            self.ring_if(told);
            return Ok(Some(Cancelled::Yes(Box::new(job))));
        }
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = ?"))
            .bind(id.to_string())
            .fetch_optional(&mut *transaction)
            .await?;
        Ok(row.as_ref().map(read_job).transpose()?.map(Cancelled::of_ended))
    }

    async fn expire(&self, age: Duration, most: u32) -> Result<Vec<JobId>, StoreError> {
        let expired = retention::expire(&self.writer, self.clock.now_ms() - millis(age), most).await?;
        expired.iter().for_each(|id| self.bell.ring(*id));
        Ok(expired)
    }

    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError> {
        retention::forget(&mut *self.writer.acquire().await?, self.clock.now_ms() - millis(age)).await
    }

    async fn purge(&self, id: JobId) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let found = retention::purge(&mut transaction, id, self.clock.now_ms()).await?;
        outbox::forget(&mut transaction, id).await?;
        transaction.commit().await?;
        self.bell.ring(id);
        Ok(found)
    }

    async fn ping(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1").execute(&self.reader).await?;
        Ok(())
    }

    fn connections(&self) -> Connections {
        let [writer, reader] = [&self.writer, &self.reader].map(Connections::of);
        let most = writer.most + reader.most;
        Connections { busy: writer.busy + reader.busy, idle: writer.idle + reader.idle, most }
    }

    fn bell(&self) -> &Bell {
        &self.bell
    }
}
