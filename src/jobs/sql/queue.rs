//! The queue: claims, heartbeats and the ends of attempts. Also the drawings of ended jobs, which are claimed in the same way.

use std::time::Duration;

use async_trait::async_trait;
use sqlx::Transaction;

use super::jobs::{job_columns, read_job};
use super::statement::{Columns, Reader, SqlConnection, Statement, count, elapsed, millis, sql, to_json, to_millis};
use super::store::{Dialect, SqlStore, unsynced};
use crate::jobs::error::StoreError;
use crate::jobs::id::JobId;
use crate::jobs::job::{Artifact, Artifacts, Job, JobProblem, JobProgress, Status, StoredReport};
use crate::jobs::queue::{Claim, ClassLoad, Completion, Failure, FailureKind, Lease, QueuedCounts};
use crate::jobs::report::JobReport;
use crate::jobs::store::{DrawingStore, JobStore, QueueStore};

#[async_trait]
impl<D: Dialect> QueueStore for SqlStore<D> {
    async fn queued_counts(&self, tenant: &str) -> Result<QueuedCounts, StoreError> {
        let statement = sql("SELECT (SELECT count(*) FROM jobs WHERE status = 'queued') AS of_all, \
                    (SELECT count(*) FROM jobs WHERE status = 'queued' AND tenant = $1) AS of_tenant");
        let row = self.reader().await?.query_row(statement.bind(tenant)).await?.ok_or(sqlx::Error::RowNotFound)?;
        let number = |column| Ok::<_, StoreError>(row.number(column)?.unwrap_or(0).unsigned_abs());
        Ok(QueuedCounts { all: number("of_all")?, of_tenant: number("of_tenant")? })
    }

    async fn queue_position(&self, job: &Job) -> Result<Option<u64>, StoreError> {
        if job.status != Status::Queued {
            return Ok(None);
        }
        let statement = sql(D::QUEUE_POSITION).bind(&job.tenant).bind(to_millis(job.run_at)).bind(job.id);
        let row = self.reader().await?.query_row(statement).await?.ok_or(sqlx::Error::RowNotFound)?;
        Ok(row.number("ahead")?.map(i64::unsigned_abs))
    }

    async fn longest_wait(&self) -> Result<Duration, StoreError> {
        let row = self.reader().await?.query_row(sql(D::LONGEST_WAIT).bind(self.now())).await?;
        let waited = row.map(|row| row.number("waited")).transpose()?.flatten();
        Ok(waited.map_or(Duration::ZERO, elapsed))
    }

    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError> {
        // Grouped by tenant first, as the indexes are: only queued and running jobs are read.
        let statement = sql("WITH loads AS ( \
                 SELECT tenant, count(*) AS queued, 0 AS running, min(run_at) AS due FROM jobs WHERE status = 'queued' GROUP BY tenant \
                 UNION ALL SELECT tenant, 0, count(*), NULL FROM jobs WHERE status = 'running' GROUP BY tenant) \
             SELECT coalesce(class, 'standard') AS id, CAST(sum(queued) AS BIGINT) AS queued, \
                    CAST(sum(running) AS BIGINT) AS running, meshmend_now($1) - min(due) AS waited \
             FROM loads LEFT JOIN tenants ON name = tenant GROUP BY 1 ORDER BY 1");
        self.read_all(statement.bind(self.now()), read_load).await
    }

    async fn claim(&self, worker: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError> {
        let token = self.new_token();
        let statement = sql(D::CLAIM).bind(worker).bind(&token).bind(self.now()).bind(millis(lease)).bind(max_running);
        let Some(job) = self.write_one(statement, read_job).await? else { return Ok(None) };
        self.notify_job(job.id);
        // Another job may be due, and another worker idle.
        self.notifier.notify_work();
        Ok(Some(Claim { lease: Lease { id: job.id, attempt: job.attempt, token }, job }))
    }

    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError> {
        let has_progress = progress.is_some();
        // The version grows only with progress, so that other heartbeats do not wake requests that wait for a change.
        let statement = sql(concat!(
            "UPDATE jobs SET lease_expires_at = meshmend_now($1) + $2, progress = coalesce($3, progress), \
             version = version + CASE WHEN $3 IS NOT NULL AND $3 IS DISTINCT FROM progress THEN 1 ELSE 0 END \
             WHERE id = $4 AND attempt = $5 AND lease_token = $6 AND status = 'running'",
            unsynced!()
        ))
        .bind(self.now())
        .bind(millis(lease))
        .bind(progress.as_ref().map(to_json));
        self.fenced(statement, held).await?;
        if has_progress {
            self.notify_job(held.id);
        }
        Ok(())
    }

    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError> {
        let now = self.now();
        // Most jobs have no receivers: one statement is enough.
        let job = complete(&mut *self.writer().await?, held, &completion, Receivers::None, now).await?;
        if let Some(job) = job {
            self.notify_job(job.id);
            return Ok(job);
        }
        let mut transaction = self.begin().await?;
        let Some(job) = complete(&mut *transaction, held, &completion, Receivers::Any, now).await? else {
            drop(transaction);
            return self.ended_by(held).await;
        };
        self.end(transaction, job, now).await
    }

    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError> {
        let mut transaction = self.begin().await?;
        let statement = sql("SELECT id, attempt, crashes FROM jobs \
             WHERE id = $1 AND attempt = $2 AND lease_token = $3 AND status = 'running' FOR UPDATE");
        let row = transaction.query_row(statement.bind(held.id).bind(held.attempt).bind(&held.token)).await?;
        let Some(row) = row else {
            drop(transaction);
            return self.ended_by(held).await;
        };
        let from = Reader::new(&row)?;
        let (attempt, crashed) = (from.count("attempt")?, u32::from(failure.kind == FailureKind::Crash));
        let crashes = from.count("crashes")? + crashed;
        let is_final = self.retry.ends(failure.kind, attempt, crashes);
        let end = AttemptEnd {
            id: held.id,
            token: Some(&held.token),
            crashes,
            retry_in: (!is_final).then(|| self.retry.delay(attempt, self.ids.random().as_u64_pair().0)),
            problem: &failure.problem,
            artifacts: &to_json(&failure.artifacts),
            report: failure.report.as_ref(),
            now: self.now(),
        };
        let job = end_attempt(&mut *transaction, &end).await?;
        self.end(transaction, job, end.now).await
    }

    async fn release(&self, held: &Lease) -> Result<(), StoreError> {
        let statement =
            sql("UPDATE jobs SET status = 'queued', attempt = attempt - 1, progress = NULL, worker = NULL, \
             lease_token = NULL, lease_expires_at = NULL, version = version + 1 \
             WHERE id = $1 AND attempt = $2 AND lease_token = $3 AND status = 'running'");
        match self.fenced(statement, held).await {
            Err(StoreError::LeaseLost) => return self.ended_by(held).await.map(drop),
            released => released?,
        }
        self.notify_job(held.id);
        self.notify_work();
        Ok(())
    }

    async fn requeue_expired(&self) -> Result<Vec<Job>, StoreError> {
        let now = self.now();
        let expired = "SELECT id FROM jobs WHERE status = 'running' AND lease_expires_at <= meshmend_now($1) LIMIT 1";
        if self.is_idle(sql(expired).bind(now)).await? {
            return Ok(Vec::new());
        }
        let mut transaction = self.begin().await?;
        let expired = sql("SELECT id, crashes, artifacts FROM jobs \
             WHERE status = 'running' AND lease_expires_at <= meshmend_now($1) ORDER BY id FOR UPDATE SKIP LOCKED");
        let (mut requeued, mut has_receivers) = (Vec::new(), false);
        for row in transaction.query(expired.bind(now)).await? {
            let from = Reader::new(&row)?;
            let (id, artifacts, crashes) = (from.parsed("id")?, from.text("artifacts")?, from.count("crashes")? + 1);
            let (problem, artifacts) = (&JobProblem::worker_lost(crashes), artifacts.as_str());
            let retry_in = (crashes < self.retry.max_crashes).then_some(Duration::ZERO);
            let end = AttemptEnd { id, token: None, crashes, retry_in, problem, artifacts, report: None, now };
            let job = end_attempt(&mut *transaction, &end).await?;
            has_receivers |= self.record_end(&mut *transaction, &job, now).await?;
            requeued.push(job);
        }
        transaction.commit().await?;
        if has_receivers {
            self.notify_deliveries();
        }
        for job in &requeued {
            self.notify_job(job.id);
            self.notify_work();
        }
        Ok(requeued)
    }
}

impl<D: Dialect> SqlStore<D> {
    /// Commits the end of an attempt or a job, with the messages about it, and notifies of both.
    pub(super) async fn end(
        &self,
        mut transaction: Transaction<'static, D>,
        job: Job,
        now: Option<i64>,
    ) -> Result<Job, StoreError> {
        let has_receivers = self.record_end(&mut *transaction, &job, now).await?;
        transaction.commit().await?;
        self.notify_job(job.id);
        if has_receivers {
            self.notify_deliveries();
        }
        Ok(job)
    }

    /// Runs a statement whose last three parameters identify the lease.
    ///
    /// # Errors
    /// [`StoreError::LeaseLost`] when no row has this lease.
    async fn fenced(&self, statement: Statement<'_>, held: &Lease) -> Result<(), StoreError> {
        let statement = statement.bind(held.id).bind(held.attempt).bind(held.token.as_str());
        if self.writer().await?.execute(statement).await? == 1 { Ok(()) } else { Err(StoreError::LeaseLost) }
    }

    /// The job, if this lease's own earlier write ended the attempt: the worker lost the response and retries.
    async fn ended_by(&self, held: &Lease) -> Result<Job, StoreError> {
        let statement = sql(concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1 AND ended_token = $2"));
        self.read_one(statement.bind(held.id).bind(&held.token), read_job).await?.ok_or(StoreError::LeaseLost)
    }
}

fn read_load(row: &impl Columns) -> Result<ClassLoad, StoreError> {
    let from = Reader::new(row)?;
    let number = |column| Ok::<_, StoreError>(from.number(column)?.unsigned_abs());
    let (queued, running) = (number("queued")?, number("running")?);
    let wait = from.some_number("waited")?.map_or(Duration::ZERO, elapsed);
    Ok(ClassLoad { class: from.id, queued, running, wait })
}

/// Whether a job to complete may have webhook receivers; messages to them need a transaction.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Receivers {
    /// The statement must fail to match a job that has receivers.
    None,
    /// The job may have receivers.
    Any,
}

/// Ends a job with its result, if the lease is held and the job's receivers are as expected; `None` otherwise.
async fn complete(
    connection: &mut impl SqlConnection,
    held: &Lease,
    completion: &Completion,
    receivers: Receivers,
    now: Option<i64>,
) -> Result<Option<Job>, StoreError> {
    let report = StoredReport::of(&completion.report);
    let statement = sql(concat!(
        "UPDATE jobs SET status = 'succeeded', outcome = $1, report = $2, artifacts = $3, problem = NULL, \
             progress = NULL, finished_at = meshmend_now($4), worker = NULL, lease_token = NULL, \
             lease_expires_at = NULL, ended_token = $7, version = version + 1 \
         WHERE id = $5 AND attempt = $6 AND lease_token = $7 AND status = 'running' \
           AND NOT ($8 AND (callback_url IS NOT NULL OR EXISTS ( \
                   SELECT 1 FROM webhook_endpoints e WHERE e.tenant = jobs.tenant AND e.disabled_at IS NULL))) \
         RETURNING ",
        job_columns!("CAST(NULL AS TEXT) AS report")
    ))
    .bind(to_json(&completion.report.outcome()))
    .bind(report.json())
    .bind(to_json(&completion.artifacts))
    .bind(now)
    .bind(held.id)
    .bind(held.attempt)
    .bind(&held.token)
    .bind(receivers == Receivers::None);
    let job = connection.query_row(statement).await?.as_ref().map(read_job).transpose()?;
    Ok(job.map(|job| Job { report: Some(report), ..job }))
}

/// The end of an attempt that did not succeed.
struct AttemptEnd<'a> {
    id: JobId,
    /// The lease's token; `None` if the worker was lost.
    token: Option<&'a str>,
    crashes: u32,
    /// The delay of the retry; `None` to fail the job.
    retry_in: Option<Duration>,
    problem: &'a JobProblem,
    artifacts: &'a str,
    report: Option<&'a JobReport>,
    now: Option<i64>,
}

/// Records the end of an attempt. The caller has locked the row and checked that the attempt may end.
async fn end_attempt(connection: &mut impl SqlConnection, end: &AttemptEnd<'_>) -> Result<Job, StoreError> {
    let statement = sql(concat!(
        "UPDATE jobs SET status = CASE WHEN $1 IS NULL THEN 'failed' ELSE 'queued' END, \
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
    .bind(end.crashes)
    .bind(end.id)
    .bind(end.token)
    .bind(end.report.map(to_json))
    .bind(end.report.map(|report| to_json(&report.outcome())));
    read_job(&connection.query_row(statement).await?.ok_or(sqlx::Error::RowNotFound)?)
}

#[async_trait]
impl<D: Dialect> DrawingStore for SqlStore<D> {
    async fn request_drawings(&self, job: JobId) -> Result<(), StoreError> {
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
        let token = self.new_token();
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
        self.notifier.notify_work();
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

/// Whether a job's pictures may still be drawn.
fn can_be_drawn(job: &Job) -> bool {
    job.finished_at.is_some() && job.status != Status::Expired && !job.purged
}

/// A job's artifacts after its pictures were drawn: pictures that could not be drawn are removed.
fn with_drawings(artifacts: Artifacts, mut drawn: Artifacts) -> Artifacts {
    let resolve = |(name, artifact): (String, Artifact)| {
        let artifact = if artifact.file.is_some() { artifact } else { drawn.remove(&name)? };
        Some((name, artifact))
    };
    artifacts.into_iter().filter_map(resolve).collect()
}
