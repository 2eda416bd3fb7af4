use async_trait::async_trait;

use super::{Dialect, SqlConnection, SqlStore, sql};
use crate::jobs::row::millis;
use crate::jobs::{IdempotencyStore, JobId, KEY_HOLD, KEY_LIFE, KeyState, RequestKey, StoreError};

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
        KeyState::of_another(connection.query_row(holder.bind(tenant).bind(key)).await?.as_ref())
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
pub(super) async fn record_use(
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
