//! How jobs lose their content, and are forgotten.

use sqlx::{PgConnection, PgPool};

use super::outbox;
use crate::jobs::row::{corrupt, to_json};
use crate::jobs::{Input, JobId, StoreError};

/// What is left of a row's content, but for its inputs.
macro_rules! emptied {
    () => {
        "worker = NULL, lease_token = NULL, lease_expires_at = NULL, progress = NULL, report = NULL, artifacts = '{}', \
         metadata = '{}', callback_url = NULL, fingerprint = NULL, version = version + 1"
    };
}

/// Inputs without what they were called and what was in them.
fn without_content(id: &str, inputs: &str) -> Result<String, StoreError> {
    let mut inputs: Vec<Input> = serde_json::from_str(inputs).map_err(|error| corrupt(id, "inputs", error))?;
    for input in &mut inputs {
        input.name.clear();
        input.sha256.clear();
    }
    Ok(to_json(&inputs))
}

pub(super) async fn purge(pool: &PgPool, id: JobId, now: Option<i64>) -> Result<bool, StoreError> {
    let mut transaction = pool.begin().await?;
    let id = id.to_string();
    let inputs: Option<String> = sqlx::query_scalar("SELECT inputs FROM jobs WHERE id = $1 FOR UPDATE")
        .bind(&id)
        .fetch_optional(&mut *transaction)
        .await?;
    let Some(inputs) = inputs else { return Ok(false) };
    sqlx::query(concat!(
        "UPDATE jobs SET purged_at = coalesce(purged_at, meshmend_now($1)), \
         status = CASE WHEN status IN ('queued', 'running') THEN 'canceled' ELSE status END, \
         finished_at = coalesce(finished_at, meshmend_now($1)), problem = NULL, inputs = $2, ",
        emptied!(),
        " WHERE id = $3"
    ))
    .bind(now)
    .bind(without_content(&id, &inputs)?)
    .bind(&id)
    .execute(&mut *transaction)
    .await?;
    outbox::forget(&mut transaction, &id).await?;
    transaction.commit().await?;
    Ok(true)
}

/// Empties what ended `age` milliseconds ago, the oldest first. Several processes may do so at once.
pub(super) async fn expire(pool: &PgPool, age: i64, most: u32, now: Option<i64>) -> Result<Vec<JobId>, StoreError> {
    let mut transaction = pool.begin().await?;
    let old: Vec<(String, String)> = sqlx::query_as(
        "SELECT id, inputs FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND status <> 'expired' AND purged_at IS NULL \
         ORDER BY finished_at, id LIMIT $3 FOR UPDATE SKIP LOCKED",
    )
    .bind(now)
    .bind(age)
    .bind(i64::from(most))
    .fetch_all(&mut *transaction)
    .await?;
    let mut expired = Vec::with_capacity(old.len());
    for (id, inputs) in old {
        sqlx::query(concat!("UPDATE jobs SET status = 'expired', inputs = $1, ", emptied!(), " WHERE id = $2"))
            .bind(without_content(&id, &inputs)?)
            .bind(&id)
            .execute(&mut *transaction)
            .await?;
        expired.push(id.parse().map_err(|_| corrupt(&id, "id", "no job id"))?);
    }
    transaction.commit().await?;
    Ok(expired)
}

/// Removes the rows of what ended `age` milliseconds ago and has no content any more.
pub(super) async fn forget(connection: &mut PgConnection, age: i64, now: Option<i64>) -> Result<u64, StoreError> {
    let gone = sqlx::query(
        "DELETE FROM jobs WHERE finished_at <= meshmend_now($1) - $2 AND (status = 'expired' OR purged_at IS NOT NULL)",
    )
    .bind(now)
    .bind(age)
    .execute(connection)
    .await?;
    Ok(gone.rows_affected())
}
