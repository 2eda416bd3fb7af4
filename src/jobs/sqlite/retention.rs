//! How jobs lose their content, and are forgotten.

use sqlx::{SqliteConnection, SqlitePool};

use crate::jobs::row::corrupt;
use crate::jobs::{JobId, StoreError};

/// What is left of a row's content.
macro_rules! emptied {
    () => {
        "worker = NULL, lease_token = NULL, lease_expires_at = NULL, progress = NULL, report = NULL, artifacts = '{}', \
         metadata = '{}', callback_url = NULL, fingerprint = NULL, \
         inputs = (SELECT json_group_array(json_set(value, '$.name', '', '$.sha256', '')) FROM json_each(inputs)), \
         version = version + 1"
    };
}

pub(super) async fn purge(connection: &mut SqliteConnection, id: JobId, now: i64) -> Result<bool, StoreError> {
    let row = sqlx::query(concat!(
        "UPDATE jobs SET purged_at = coalesce(purged_at, ?1), \
         status = CASE WHEN status IN ('queued', 'running') THEN 'canceled' ELSE status END, \
         finished_at = coalesce(finished_at, ?1), problem = NULL, ",
        emptied!(),
        " WHERE id = ?2 RETURNING id"
    ))
    .bind(now)
    .bind(id.to_string())
    .fetch_optional(connection)
    .await?;
    Ok(row.is_some())
}

/// Empties what ended before `before`, the oldest first.
pub(super) async fn expire(writer: &SqlitePool, before: i64, most: u32) -> Result<Vec<JobId>, StoreError> {
    let ids: Vec<String> = sqlx::query_scalar(concat!(
        "UPDATE jobs SET status = 'expired', ",
        emptied!(),
        " WHERE id IN (SELECT id FROM jobs WHERE finished_at <= ?1 AND status <> 'expired' AND purged_at IS NULL \
                       ORDER BY finished_at, id LIMIT ?2) RETURNING id"
    ))
    .bind(before)
    .bind(most)
    .fetch_all(writer)
    .await?;
    ids.into_iter().map(|id| id.parse().map_err(|_| corrupt(&id, "id", "no job id"))).collect()
}

/// Removes the rows of what ended before `before` and has no content any more.
pub(super) async fn forget(connection: &mut SqliteConnection, before: i64) -> Result<u64, StoreError> {
    let gone =
        sqlx::query("DELETE FROM jobs WHERE finished_at <= ?1 AND (status = 'expired' OR purged_at IS NOT NULL)")
            .bind(before)
            .execute(connection)
            .await?;
    Ok(gone.rows_affected())
}
