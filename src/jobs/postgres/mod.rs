mod access;
mod drawings;
mod keys;
mod listen;
mod outbox;
mod queue;
mod retention;
mod uploads;
mod webhooks;

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use sqlx::query::Query;
use sqlx::{Connection, Database, PgConnection, Postgres};
use tokio::task::JoinHandle;
use uuid::Uuid;

use super::row::{corrupt, count, elapsed, job_columns, millis, read_job, to_json};
use super::store::{
    Cancelled, Claim, ClassLoad, Completion, Connections, Failure, FailureKind, JobStore, Lease, ListQuery, NewJob,
    Page, StatusCount, StoreError, Waiting,
};
use super::{Bell, Clock, Job, JobId, JobProblem, JobProgress, JobReport, KeyState, RetryPolicy, Status};

/// How long a statement, a lock, and a transaction in which nothing happens may take, for the server to end them.
const LIMITS: [(&str, &str); 3] =
    [("statement_timeout", "15s"), ("lock_timeout", "10s"), ("idle_in_transaction_session_timeout", "30s")];
/// A connection that answered within this time is not asked whether it is still there before it is used again: less than a database needs
/// to come back, so that what finds it broken would have found no database either.
const FRESH: Duration = Duration::from_millis(10);
/// How long to wait for a connection.
const ACQUIRE: Duration = Duration::from_secs(3);

/// In a statement's `WHERE`: its commit does not wait for the disk. For claims and their heartbeats, which the next synced commit takes
/// along: when the database's machine is lost before, the job waits again, and whoever held it learns that it is no longer theirs.
macro_rules! unsynced {
    () => {
        "set_config('synchronous_commit', 'off', true) = 'off'"
    };
}
use unsynced;

/// Jobs in a PostgreSQL database that any number of processes on any number of machines share.
///
/// Times are the database's, so that leases do not depend on the clocks of the machines. Claims skip rows that others hold
/// (`FOR UPDATE SKIP LOCKED`). Triggers tell every process of changes (`LISTEN`, `NOTIFY`), and whoever misses that looks by itself
/// now and then. Connections that broke are replaced; what was under way on them is an error to the caller.
pub struct PostgresStore {
    pool: PgPool,
    /// A clock in the database's place, for tests.
    clock: Option<Arc<dyn Clock>>,
    retry: RetryPolicy,
    bell: Arc<Bell>,
    listener: JoinHandle<()>,
}

impl Drop for PostgresStore {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

impl PostgresStore {
    /// Connects, at most `connections` times at once, and brings the tables up to date. `clock` takes the place of the
    /// database's, for tests.
    ///
    /// # Errors
    /// When the address can't be read or reached, or the tables were made by a newer version.
    pub async fn open(
        url: &str,
        connections: u32,
        clock: Option<Arc<dyn Clock>>,
        retry: RetryPolicy,
    ) -> Result<Self, StoreError> {
        let options = PgConnectOptions::from_str(url)?.application_name("meshmend").options(LIMITS);
        let pool = PgPoolOptions::new()
            .acquire_timeout(ACQUIRE)
            .max_connections(connections.max(2))
            .test_before_acquire(false)
            .before_acquire(|connection, used| {
                Box::pin(async move { Ok(used.idle_for < FRESH || connection.ping().await.is_ok()) })
            });
        let pool = match pool.connect_with(options.clone()).await {
            // A pool tries again until its time is over, and does not say why. A connection of its own does.
            Err(sqlx::Error::PoolTimedOut) => return Err(why_unreachable(&options).await.into()),
            pool => pool?,
        };
        sqlx::migrate!("migrations/postgres").run(&pool).await?;
        let bell = Arc::new(Bell::default());
        let listener = tokio::spawn(listen::ring(pool.clone(), Arc::clone(&bell)));
        Ok(Self { pool, clock, retry, bell, listener })
    }

    /// The time where it is not the database's.
    fn now(&self) -> Option<i64> {
        self.clock.as_ref().map(|clock| clock.now_ms())
    }

    /// Runs a statement that names the hold by its last three parameters, and sees whether that still stood.
    async fn fenced(
        &self,
        statement: Query<'_, Postgres, <Postgres as Database>::Arguments>,
        held: &Lease,
    ) -> Result<(), StoreError> {
        let statement = statement.bind(held.id.to_string()).bind(i64::from(held.attempt)).bind(held.token.clone());
        let done = statement.execute(&self.pool).await?;
        if done.rows_affected() == 1 { Ok(()) } else { Err(StoreError::LeaseLost) }
    }

    /// The job where this hold's own last write had arrived, though its worker did not hear of that.
    async fn ended_by(&self, held: &Lease) -> Result<Job, StoreError> {
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1 AND ended_token = $2"))
            .bind(held.id.to_string())
            .bind(&held.token)
            .fetch_optional(&self.pool)
            .await?;
        read_job(&row.ok_or(StoreError::LeaseLost)?)
    }
}

/// Why no connection can be made.
async fn why_unreachable(options: &PgConnectOptions) -> sqlx::Error {
    match tokio::time::timeout(ACQUIRE, PgConnection::connect_with(options)).await {
        Ok(Err(error)) => error,
        Ok(Ok(_)) | Err(_) => sqlx::Error::PoolTimedOut,
    }
}

#[async_trait]
impl JobStore for PostgresStore {
    async fn hold_key(&self, tenant: &str, key: &str, job: JobId) -> Result<KeyState, StoreError> {
        keys::hold(&mut *self.pool.acquire().await?, tenant, key, job, self.now()).await
    }

    async fn release_key(&self, tenant: &str, key: &str, job: JobId) -> Result<(), StoreError> {
        keys::release(&mut *self.pool.acquire().await?, tenant, key, job).await
    }

    async fn forget_keys(&self) -> Result<u64, StoreError> {
        keys::forget(&mut *self.pool.acquire().await?, self.now()).await
    }

    async fn submit(&self, job: NewJob) -> Result<Job, StoreError> {
        // Mostly it has nothing but its row to write: one statement does.
        if job.key.is_none() && job.upload.is_none() && job.result.is_none() {
            return queue::insert(&mut *self.pool.acquire().await?, &job, self.now()).await;
        }
        let mut transaction = self.pool.begin().await?;
        if let Some(key) = &job.key {
            keys::settle(&mut transaction, &job.tenant, key, job.id, self.now()).await?;
        }
        if let Some(upload) = job.upload {
            uploads::take(&mut transaction, upload, job.id, self.now()).await?;
        }
        let job = queue::insert(&mut transaction, &job, self.now()).await?;
        outbox::note(&mut transaction, &job, self.now()).await?;
        transaction.commit().await?;
        Ok(job)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        let row = sqlx::query(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1"))
            .bind(id.to_string())
            .fetch_optional(&self.pool)
            .await?;
        row.as_ref().map(read_job).transpose()
    }

    async fn list(&self, query: ListQuery) -> Result<Page<Job, JobId>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            job_columns!("NULL::text AS report"),
            " FROM jobs WHERE tenant = $1 AND purged_at IS NULL AND ($2::text IS NULL OR made_by = $2) \
              AND ($3::jsonb = '[]' OR $3::jsonb ? status) AND ($4::text IS NULL OR id < $4) \
              AND ($6::jsonb = '[]' OR $6::jsonb @> outcome::jsonb) \
              AND ($7::bigint IS NULL OR created_at >= $7) AND ($8::bigint IS NULL OR created_at < $8) \
              AND ($9::jsonb = '{}' OR metadata::jsonb @> $9::jsonb) ORDER BY id DESC LIMIT $5"
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
        .fetch_all(&self.pool)
        .await?;
        let jobs = rows.iter().map(read_job).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(jobs, query.limit, |job| job.id))
    }

    async fn find_result(&self, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError> {
        queue::find_result(&self.pool, tenant, fingerprint).await
    }

    async fn waiting(&self, tenant: &str) -> Result<Waiting, StoreError> {
        queue::waiting(&self.pool, tenant).await
    }

    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError> {
        if job.status != Status::Queued {
            return Ok(None);
        }
        queue::position(&self.pool, job).await.map(Some)
    }

    async fn longest_wait(&self) -> Result<Duration, StoreError> {
        let waits: Option<i64> = sqlx::query_scalar(
            "SELECT meshmend_now($1) - run_at FROM jobs WHERE status = 'queued' ORDER BY run_at, id LIMIT 1",
        )
        .bind(self.now())
        .fetch_optional(&self.pool)
        .await?;
        Ok(waits.map_or(Duration::ZERO, elapsed))
    }

    async fn counts(&self) -> Result<Vec<StatusCount>, StoreError> {
        let rows: Vec<(String, i64)> =
            sqlx::query_as("SELECT status, count(*) FROM jobs WHERE purged_at IS NULL GROUP BY status")
                .fetch_all(&self.pool)
                .await?;
        Ok(StatusCount::of_all(&rows))
    }

    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError> {
        queue::class_loads(&self.pool, self.now()).await
    }

    async fn claim(&self, worker: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError> {
        let (now, token) = (self.now(), Uuid::new_v4().simple().to_string());
        let claiming = queue::Claiming { worker, token: &token, now, lease: millis(lease), max_running };
        let Some(job) = queue::claim(&self.pool, &claiming).await? else { return Ok(None) };
        // Another one may be due for another idle worker.
        self.bell.ring_for_work();
        Ok(Some(Claim { lease: Lease { id: job.id, attempt: job.attempt, token }, job }))
    }

    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError> {
        // The version grows only with news, so that a quiet heartbeat does not wake those who wait for a change.
        let statement = sqlx::query(concat!(
            "UPDATE jobs SET lease_expires_at = meshmend_now($1) + $2, progress = coalesce($3, progress), \
             version = version + CASE WHEN $3 IS NOT NULL AND $3 IS DISTINCT FROM progress THEN 1 ELSE 0 END \
             WHERE id = $4 AND attempt = $5 AND lease_token = $6 AND status = 'running' AND ",
            unsynced!()
        ))
        .bind(self.now())
        .bind(millis(lease))
        .bind(progress.as_ref().map(to_json));
        self.fenced(statement, held).await
    }

    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError> {
        // Mostly nobody is to be told, and one statement does.
        if let Some(job) =
            queue::complete(&mut *self.pool.acquire().await?, held, &completion, true, self.now()).await?
        {
            return Ok(job);
        }
        let mut transaction = self.pool.begin().await?;
        let Some(job) = queue::complete(&mut transaction, held, &completion, false, self.now()).await? else {
            drop(transaction);
            return self.ended_by(held).await;
        };
        outbox::note(&mut transaction, &job, self.now()).await?;
        transaction.commit().await?;
        Ok(job)
    }

    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError> {
        let mut transaction = self.pool.begin().await?;
        let counted: Option<(i64, i64)> = sqlx::query_as(
            "SELECT attempt, crashes FROM jobs \
             WHERE id = $1 AND attempt = $2 AND lease_token = $3 AND status = 'running' FOR UPDATE",
        )
        .bind(held.id.to_string())
        .bind(i64::from(held.attempt))
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
            retry_in: (!ended).then(|| self.retry.delay(attempt, Uuid::new_v4().as_u64_pair().0)),
            problem: &failure.problem,
            artifacts: &to_json(&failure.artifacts),
            report: failure.report.as_ref(),
            now: self.now(),
        };
        let job = end_attempt(&mut transaction, &end).await?;
        outbox::note(&mut transaction, &job, end.now).await?;
        transaction.commit().await?;
        Ok(job)
    }

    async fn hand_back(&self, held: &Lease) -> Result<(), StoreError> {
        let statement = sqlx::query(
            "UPDATE jobs SET status = 'queued', attempt = attempt - 1, progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = $1 AND attempt = $2 AND lease_token = $3 AND status = 'running'",
        );
        self.fenced(statement, held).await
    }

    async fn rescue(&self) -> Result<Vec<Job>, StoreError> {
        let mut transaction = self.pool.begin().await?;
        let lost: Vec<(String, i64, String)> = sqlx::query_as(
            "SELECT id, crashes, artifacts FROM jobs \
             WHERE status = 'running' AND lease_expires_at <= meshmend_now($1) ORDER BY id FOR UPDATE SKIP LOCKED",
        )
        .bind(self.now())
        .fetch_all(&mut *transaction)
        .await?;
        let mut rescued = Vec::with_capacity(lost.len());
        for (id, crashes, artifacts) in lost {
            let id = id.parse().map_err(|_| corrupt(&id, "id", "no job id"))?;
            let crashes = count(crashes) + 1;
            let problem = JobProblem::worker_lost(crashes);
            let retry_in = (crashes < self.retry.max_crashes).then_some(Duration::ZERO);
            let (now, artifacts) = (self.now(), artifacts.as_str());
            let end = End { id, token: None, crashes, retry_in, problem: &problem, artifacts, report: None, now };
            let job = end_attempt(&mut transaction, &end).await?;
            outbox::note(&mut transaction, &job, now).await?;
            rescued.push(job);
        }
        transaction.commit().await?;
        Ok(rescued)
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Cancelled>, StoreError> {
        let mut transaction = self.pool.begin().await?;
        let row = sqlx::query(concat!(
            "UPDATE jobs SET status = 'canceled', finished_at = meshmend_now($1), progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = $2 AND status IN ('queued', 'running') RETURNING ",
            job_columns!()
        ))
        .bind(self.now())
        .bind(id.to_string())
        .fetch_optional(&mut *transaction)
        .await?;
        if let Some(row) = row {
            let job = read_job(&row)?;
            outbox::note(&mut transaction, &job, self.now()).await?;
            transaction.commit().await?;
            return Ok(Some(Cancelled::Yes(Box::new(job))));
        }
        drop(transaction);
        Ok(self.get(id).await?.map(Cancelled::of_ended))
    }

    async fn expire(&self, age: Duration, most: u32) -> Result<Vec<JobId>, StoreError> {
        retention::expire(&self.pool, millis(age), most, self.now()).await
    }

    async fn forget_jobs(&self, age: Duration) -> Result<u64, StoreError> {
        retention::forget(&mut *self.pool.acquire().await?, millis(age), self.now()).await
    }

    async fn purge(&self, id: JobId) -> Result<bool, StoreError> {
        retention::purge(&self.pool, id, self.now()).await
    }

    async fn ping(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1").execute(&self.pool).await?;
        Ok(())
    }

    fn connections(&self) -> Connections {
        Connections::of(&self.pool)
    }

    fn bell(&self) -> &Bell {
        &self.bell
    }
}

/// How an attempt ends that does not succeed.
struct End<'a> {
    id: JobId,
    /// Of the worker that ends it; none where the worker is lost.
    token: Option<&'a str>,
    crashes: u32,
    /// When to try again; none to fail for good.
    retry_in: Option<Duration>,
    problem: &'a JobProblem,
    artifacts: &'a str,
    report: Option<&'a JobReport>,
    now: Option<i64>,
}

/// Writes the end of an attempt. The caller holds the row, and has checked that the attempt may be ended.
async fn end_attempt(connection: &mut PgConnection, end: &End<'_>) -> Result<Job, StoreError> {
    let row = sqlx::query(concat!(
        "UPDATE jobs SET status = CASE WHEN $1::bigint IS NULL THEN 'failed' ELSE 'queued' END, \
         run_at = coalesce(meshmend_now($4) + $1, run_at), problem = CASE WHEN $1 IS NULL THEN $2 END, \
         artifacts = CASE WHEN $1 IS NULL THEN $3 ELSE artifacts END, \
         finished_at = CASE WHEN $1 IS NULL THEN meshmend_now($4) END, crashes = $5, progress = NULL, worker = NULL, \
         lease_token = NULL, lease_expires_at = NULL, ended_token = coalesce($7, ended_token), \
         report = CASE WHEN $1 IS NULL THEN $8 ELSE report END, \
         outcome = CASE WHEN $1 IS NULL THEN $9 ELSE outcome END, version = version + 1 \
         WHERE id = $6 RETURNING ",
        job_columns!()
    ))
    .bind(end.retry_in.map(millis))
    .bind(to_json(end.problem))
    .bind(end.artifacts)
    .bind(end.now)
    .bind(i64::from(end.crashes))
    .bind(end.id.to_string())
    .bind(end.token)
    .bind(end.report.map(to_json))
    .bind(end.report.map(|report| to_json(&report.outcome())))
    .fetch_one(connection)
    .await?;
    read_job(&row)
}
