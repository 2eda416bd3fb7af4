//! What waits, and whose turn it is.

use sqlx::{PgConnection, PgPool};

use super::unsynced;
use crate::jobs::row::{job_columns, read_job, to_json, to_millis};
use crate::jobs::store::ClassLoad;
use crate::jobs::{Completion, Job, Lease, NewJob, StoreError, StoredReport, Waiting};

/// Adds a job; one that was given a result has ended already.
pub(super) async fn insert(connection: &mut PgConnection, job: &NewJob, now: Option<i64>) -> Result<Job, StoreError> {
    let result = job.result.as_ref();
    let row = sqlx::query(concat!(
        "INSERT INTO jobs (id, tenant, made_by, status, outcome, created_at, run_at, started_at, finished_at, inputs, options, \
                           metadata, callback_url, fingerprint, reused_from, report, artifacts, traceparent) \
         VALUES ($1, $2, $3, CASE WHEN $6 THEN 'succeeded' ELSE 'queued' END, $4, meshmend_now($5), meshmend_now($5), \
                 CASE WHEN $6 THEN meshmend_now($5) END, CASE WHEN $6 THEN meshmend_now($5) END, $7, $8, \
                 $9, $10, $11, $12, $13, coalesce($14, '{}'), $15) RETURNING ",
        job_columns!()
    ))
    .bind(job.id.to_string())
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
    .bind(result.map(|result| result.from.to_string()))
    .bind(result.map(|result| to_json(&result.report)))
    .bind(result.map(|result| to_json(&result.artifacts)))
    .bind(&job.traceparent)
    .fetch_one(connection)
    .await?;
    read_job(&row)
}

pub(super) async fn find_result(pool: &PgPool, tenant: &str, fingerprint: &str) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(concat!(
        "SELECT ",
        job_columns!(),
        " FROM jobs WHERE tenant = $1 AND fingerprint = $2 AND status = 'succeeded' AND purged_at IS NULL \
          ORDER BY id DESC LIMIT 1"
    ))
    .bind(tenant)
    .bind(fingerprint)
    .fetch_optional(pool)
    .await?;
    row.as_ref().map(read_job).transpose()
}

pub(super) async fn waiting(pool: &PgPool, tenant: &str) -> Result<Waiting, StoreError> {
    let (all, own): (i64, i64) = sqlx::query_as(
        "SELECT (SELECT count(*) FROM jobs WHERE status = 'queued'), \
                (SELECT count(*) FROM jobs WHERE status = 'queued' AND tenant = $1)",
    )
    .bind(tenant)
    .fetch_one(pool)
    .await?;
    Ok(Waiting { all: all.unsigned_abs(), of_tenant: own.unsigned_abs() })
}

pub(super) async fn position(pool: &PgPool, job: &Job) -> Result<u64, StoreError> {
    let ahead: i64 = sqlx::query_scalar(
        "SELECT count(*) FROM jobs \
         WHERE status = 'queued' AND tenant = $1 AND (run_at < $2 OR (run_at = $2 AND id < $3))",
    )
    .bind(&job.tenant)
    .bind(to_millis(job.run_at))
    .bind(job.id.to_string())
    .fetch_one(pool)
    .await?;
    Ok(ahead.unsigned_abs())
}

/// What waits and runs of each class of tenants.
pub(super) async fn class_loads(pool: &PgPool, now: Option<i64>) -> Result<Vec<ClassLoad>, StoreError> {
    // Tenant by tenant, as the indexes have them: only jobs that wait or run are looked at.
    let rows = sqlx::query_as(
        "WITH loads AS ( \
             SELECT tenant, count(*) AS queued, 0 AS running, min(run_at) AS due FROM jobs WHERE status = 'queued' GROUP BY tenant \
             UNION ALL SELECT tenant, 0, count(*), NULL FROM jobs WHERE status = 'running' GROUP BY tenant) \
         SELECT coalesce(class, 'standard'), sum(queued)::bigint, sum(running)::bigint, meshmend_now($1) - min(due) \
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
    pub now: Option<i64>,
    pub lease: i64,
    pub max_running: u32,
}

/// Takes the job whose turn it is. Two claims at once may see the same turn; each takes a job that the other has not.
pub(super) async fn claim(pool: &PgPool, claiming: &Claiming<'_>) -> Result<Option<Job>, StoreError> {
    // The tenants that wait are found by leaps through the index, not by a look at every job. Where all that is due of one is just being
    // taken by others it is the next one's turn.
    let row = sqlx::query(concat!(
        "WITH RECURSIVE waiting (tenant) AS ( \
             SELECT min(tenant) FROM jobs WHERE status = 'queued' \
             UNION ALL \
             SELECT (SELECT min(tenant) FROM jobs WHERE status = 'queued' AND tenant > waiting.tenant) \
             FROM waiting WHERE tenant IS NOT NULL), \
         turns AS ( \
             SELECT tenant, \
                    (SELECT count(*) FROM jobs WHERE status = 'running' AND jobs.tenant = waiting.tenant) AS running, \
                    (SELECT max(started_at) FROM jobs WHERE jobs.tenant = waiting.tenant) AS served, \
                    coalesce((SELECT max_running FROM tenants WHERE name = waiting.tenant), $5) AS most, \
                    (SELECT id FROM jobs WHERE status = 'queued' AND jobs.tenant = waiting.tenant AND run_at <= meshmend_now($3) \
                     ORDER BY run_at, id LIMIT 1) AS next \
             FROM waiting WHERE tenant IS NOT NULL), \
         turn AS MATERIALIZED ( \
             SELECT tenant FROM turns WHERE next IS NOT NULL AND running < most ORDER BY running, served NULLS FIRST, next) \
         UPDATE jobs SET status = 'running', attempt = attempt + 1, worker = $1, lease_token = $2, \
             lease_expires_at = meshmend_now($3) + $4, started_at = coalesce(started_at, meshmend_now($3)), \
             progress = NULL, version = version + 1 \
         WHERE id = (SELECT free.id FROM turn CROSS JOIN LATERAL ( \
                         SELECT id FROM jobs WHERE status = 'queued' AND jobs.tenant = turn.tenant AND run_at <= meshmend_now($3) \
                         ORDER BY run_at, id LIMIT 1 FOR UPDATE SKIP LOCKED) AS free LIMIT 1) \
           AND ",
        unsynced!(),
        " RETURNING ",
        job_columns!()
    ))
    .bind(claiming.worker)
    .bind(claiming.token)
    .bind(claiming.now)
    .bind(claiming.lease)
    .bind(i64::from(claiming.max_running))
    .fetch_optional(pool)
    .await?;
    row.as_ref().map(read_job).transpose()
}

/// Ends a job with its result, if the hold on it still stands. Where `untold` is set only if nobody is to be told of it, so that no
/// transaction is needed.
pub(super) async fn complete(
    connection: &mut PgConnection,
    held: &Lease,
    completion: &Completion,
    untold: bool,
    now: Option<i64>,
) -> Result<Option<Job>, StoreError> {
    let report = StoredReport::of(&completion.report);
    let row = sqlx::query(concat!(
        "UPDATE jobs SET status = 'succeeded', outcome = $1, report = $2, artifacts = $3, problem = NULL, \
             progress = NULL, finished_at = meshmend_now($4), worker = NULL, lease_token = NULL, \
             lease_expires_at = NULL, ended_token = $7, version = version + 1 \
         WHERE id = $5 AND attempt = $6 AND lease_token = $7 AND status = 'running' \
           AND NOT ($8 AND (callback_url IS NOT NULL OR EXISTS ( \
                   SELECT 1 FROM webhook_endpoints e WHERE e.tenant = jobs.tenant AND e.disabled_at IS NULL))) \
         RETURNING ",
        job_columns!("NULL::text AS report")
    ))
    .bind(to_json(&completion.report.outcome()))
    .bind(report.json())
    .bind(to_json(&completion.artifacts))
    .bind(now)
    .bind(held.id.to_string())
    .bind(i64::from(held.attempt))
    .bind(&held.token)
    .bind(untold)
    .fetch_optional(connection)
    .await?;
    let job = row.as_ref().map(read_job).transpose()?;
    Ok(job.map(|job| Job { report: Some(report), ..job }))
}
