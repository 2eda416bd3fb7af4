use sqlx::SqliteConnection;

use crate::jobs::row::millis;
use crate::jobs::{JobId, KEY_HOLD, KEY_LIFE, KeyState, RequestKey, StoreError};

pub(super) async fn hold(
    connection: &mut SqliteConnection,
    tenant: &str,
    key: &str,
    job: JobId,
    now: i64,
) -> Result<KeyState, StoreError> {
    let held = sqlx::query(
        "INSERT INTO idempotency_keys (tenant, key, job_id, expires_at) VALUES (?5, ?1, ?2, ?3 + ?4) \
         ON CONFLICT (tenant, key) DO UPDATE SET job_id = excluded.job_id, fingerprint = NULL, expires_at = excluded.expires_at \
         WHERE idempotency_keys.expires_at <= ?3 \
            OR (idempotency_keys.job_id = excluded.job_id AND idempotency_keys.fingerprint IS NULL)",
    )
    .bind(key)
    .bind(job.to_string())
    .bind(now)
    .bind(millis(KEY_HOLD))
    .bind(tenant)
    .execute(&mut *connection)
    .await?;
    if held.rows_affected() == 1 {
        return Ok(KeyState::Held);
    }
    let known = sqlx::query_as("SELECT fingerprint, job_id FROM idempotency_keys WHERE tenant = ? AND key = ?")
        .bind(tenant)
        .bind(key)
        .fetch_optional(connection)
        .await?;
    KeyState::of_another(known)
}

pub(super) async fn release(
    connection: &mut SqliteConnection,
    tenant: &str,
    key: &str,
    job: JobId,
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM idempotency_keys WHERE tenant = ? AND key = ? AND job_id = ? AND fingerprint IS NULL")
        .bind(tenant)
        .bind(key)
        .bind(job.to_string())
        .execute(connection)
        .await?;
    Ok(())
}

/// Notes that a request was accepted, in the transaction that accepts it.
pub(super) async fn settle(
    connection: &mut SqliteConnection,
    tenant: &str,
    request: &RequestKey,
    job: JobId,
    now: i64,
) -> Result<(), StoreError> {
    let settled = sqlx::query(
        "UPDATE idempotency_keys SET fingerprint = ?, expires_at = ? WHERE tenant = ? AND key = ? AND job_id = ?",
    )
    .bind(&request.fingerprint)
    .bind(now + millis(KEY_LIFE))
    .bind(tenant)
    .bind(&request.key)
    .bind(job.to_string())
    .execute(connection)
    .await?;
    if settled.rows_affected() == 1 { Ok(()) } else { Err(StoreError::KeyLost) }
}

pub(super) async fn forget(connection: &mut SqliteConnection, now: i64) -> Result<u64, StoreError> {
    let gone = sqlx::query("DELETE FROM idempotency_keys WHERE expires_at <= ?").bind(now).execute(connection).await?;
    Ok(gone.rows_affected())
}
