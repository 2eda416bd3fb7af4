//! What waits, and whose turn it is.

use sqlx::{SqliteConnection, SqlitePool};

use crate::jobs::row::{job_columns, read_job, to_json, to_millis};
use crate::jobs::store::ClassLoad;
use crate::jobs::{Job, JobId, JobProblem, JobReport, NewJob, StoreError, Waiting};

/// Adds a job; one that was given a result has ended already.
pub(super) async fn insert(connection: &mut SqliteConnection, job: &NewJob, now: i64) -> Result<Job, StoreError> {
    let result = job.result.as_ref();
    let ended = result.map(|_| now);
    let row = sqlx::query(concat!(
        "INSERT INTO jobs (id, tenant, made_by, status, outcome, created_at, run_at, started_at, finished_at, inputs, options, \
                           metadata, callback_url, fingerprint, reused_from, report, artifacts, traceparent) \
         VALUES (?1, ?2, ?3, CASE WHEN ?6 IS NULL THEN 'queued' ELSE 'succeeded' END, ?4, ?5, ?5, ?6, ?6, ?7, ?8, \
                 ?9, ?10, ?11, ?12, ?13, coalesce(?14, '{}'), ?15) RETURNING ",
        job_columns!()
    ))
    .bind(job.id.to_string())
    .bind(&job.tenant)
    .bind(&job.made_by)
    .bind(result.map(|result| to_json(&result.outcome)))
    .bind(now)
    .bind(ended)
    .bind(to_json(&job.inputs))
    .bind(to_json(&job.options))
    .bind(to_json(&job.metadata))
    .bind(&job.callback_url)
    .bind(&job.fingerprint)
    .bind(result.map(|result| result.from.to_string()))
    .bind(result.map(|result| to_json(&result.report)))
    .bind(result.map(|result| to_json(&result.artifacts)))
    .bind(&job.traceparent)
    .fetch_one(connection)
    .await?;
    read_job(&row)
}

pub(super) async fn find_result(
    reader: &SqlitePool,
    tenant: &str,
    fingerprint: &str,
) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(concat!(
        "SELECT ",
        job_columns!(),
        " FROM jobs WHERE tenant = ? AND fingerprint = ? AND status = 'succeeded' AND purged_at IS NULL \
          ORDER BY id DESC LIMIT 1"
    ))
    .bind(tenant)
    .bind(fingerprint)
    .fetch_optional(reader)
    .await?;
    row.as_ref().map(read_job).transpose()
}

pub(super) async fn waiting(reader: &SqlitePool, tenant: &str) -> Result<Waiting, StoreError> {
    let (all, own): (i64, i64) = sqlx::query_as(
        "SELECT (SELECT count(*) FROM jobs WHERE status = 'queued'), \
                (SELECT count(*) FROM jobs WHERE status = 'queued' AND tenant = ?)",
    )
    .bind(tenant)
    .fetch_one(reader)
    .await?;
    Ok(Waiting { all: all.unsigned_abs(), of_tenant: own.unsigned_abs() })
}

pub(super) async fn position(reader: &SqlitePool, job: &Job) -> Result<u64, StoreError> {
    let ahead: i64 = sqlx::query_scalar(
        "SELECT count(*) FROM jobs INDEXED BY jobs_due \
         WHERE status = 'queued' AND tenant = ?1 AND (run_at < ?2 OR (run_at = ?2 AND id < ?3))",
    )
    .bind(&job.tenant)
    .bind(to_millis(job.run_at))
    .bind(job.id.to_string())
    .fetch_one(reader)
    .await?;
    Ok(ahead.unsigned_abs())
}

/// What waits and runs of each class of tenants.
pub(super) async fn class_loads(pool: &SqlitePool, now: i64) -> Result<Vec<ClassLoad>, StoreError> {
    // Tenant by tenant, as the indexes have them: only jobs that wait or run are looked at.
    let rows = sqlx::query_as(
        "WITH loads AS ( \
             SELECT tenant, count(*) AS queued, 0 AS running, min(run_at) AS due FROM jobs WHERE status = 'queued' GROUP BY tenant \
             UNION ALL SELECT tenant, 0, count(*), NULL FROM jobs WHERE status = 'running' GROUP BY tenant) \
         SELECT coalesce(class, 'standard'), sum(queued), sum(running), ?1 - min(due) \
         FROM loads LEFT JOIN tenants ON name = tenant GROUP BY 1 ORDER BY 1",
    )
    .bind(now)
    .fetch_all(pool)
    .await?;
    Ok(rows.into_iter().map(ClassLoad::of_row).collect())
}

/// A claim to write.
pub(super) struct Claiming<'a> {
    pub worker: &'a str,
    pub token: &'a str,
    pub now: i64,
    pub until: i64,
    pub max_running: u32,
}

/// Takes the job whose turn it is. The tenants that wait are found by leaps through the index, not by a look at every job; left to
/// itself, SQLite would take an index by status and sort all that wait.
pub(super) async fn claim(writer: &SqlitePool, claiming: &Claiming<'_>) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(concat!(
        "UPDATE jobs SET status = 'running', attempt = attempt + 1, worker = ?1, lease_token = ?2, lease_expires_at = ?3, \
             started_at = coalesce(started_at, ?4), progress = NULL, version = version + 1 \
         WHERE id = ( \
             WITH RECURSIVE waiting (tenant) AS ( \
                 SELECT min(tenant) FROM jobs INDEXED BY jobs_due WHERE status = 'queued' \
                 UNION ALL \
                 SELECT (SELECT min(tenant) FROM jobs INDEXED BY jobs_due WHERE status = 'queued' AND tenant > waiting.tenant) \
                 FROM waiting WHERE tenant IS NOT NULL), \
             turns AS ( \
                 SELECT (SELECT count(*) FROM jobs WHERE status = 'running' AND jobs.tenant = waiting.tenant) AS running, \
                        (SELECT max(started_at) FROM jobs WHERE jobs.tenant = waiting.tenant) AS served, \
                        coalesce((SELECT max_running FROM tenants WHERE name = waiting.tenant), ?5) AS most, \
                        (SELECT id FROM jobs INDEXED BY jobs_due WHERE status = 'queued' AND jobs.tenant = waiting.tenant AND run_at <= ?4 \
                         ORDER BY run_at, id LIMIT 1) AS next \
                 FROM waiting WHERE tenant IS NOT NULL) \
             SELECT next FROM turns WHERE next IS NOT NULL AND running < most \
             ORDER BY running, served NULLS FIRST, next LIMIT 1) \
         RETURNING ",
        job_columns!()
    ))
    .bind(claiming.worker)
    .bind(claiming.token)
    .bind(claiming.until)
    .bind(claiming.now)
    .bind(claiming.max_running)
    .fetch_all(writer)
    .await?
    .pop();
    row.as_ref().map(read_job).transpose()
}

/// How an attempt ends that does not succeed.
pub(super) struct End<'a> {
    pub id: JobId,
    /// Of the worker that ends it; none where the worker is lost.
    pub token: Option<&'a str>,
    pub crashes: u32,
    /// When to try again; none to fail for good.
    pub retry_at: Option<i64>,
    pub problem: &'a JobProblem,
    pub artifacts: &'a str,
    pub report: Option<&'a JobReport>,
    pub now: i64,
}

/// Writes the end of an attempt. The caller has checked, in the same transaction, that the attempt may be ended.
pub(super) async fn end_attempt(connection: &mut SqliteConnection, end: &End<'_>) -> Result<Job, StoreError> {
    let row = sqlx::query(concat!(
        "UPDATE jobs SET status = CASE WHEN ?1 IS NULL THEN 'failed' ELSE 'queued' END, run_at = coalesce(?1, run_at), \
         problem = CASE WHEN ?1 IS NULL THEN ?2 END, artifacts = CASE WHEN ?1 IS NULL THEN ?3 ELSE artifacts END, \
         finished_at = CASE WHEN ?1 IS NULL THEN ?4 END, crashes = ?5, progress = NULL, worker = NULL, \
         lease_token = NULL, lease_expires_at = NULL, ended_token = coalesce(?7, ended_token), \
         report = CASE WHEN ?1 IS NULL THEN ?8 ELSE report END, \
         outcome = CASE WHEN ?1 IS NULL THEN ?9 ELSE outcome END, version = version + 1 \
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
    .bind(end.report.map(to_json))
    .bind(end.report.map(|report| to_json(&report.outcome())))
    .fetch_one(connection)
    .await?;
    read_job(&row)
}
