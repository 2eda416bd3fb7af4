use async_trait::async_trait;
use uuid::Uuid;

use super::PostgresStore;
use crate::access::{AccessKey, NewKey, Tenant, TenantClass, TenantLimits, TenantName, Token};
use crate::jobs::StoreError;
use crate::jobs::access::{AccessStore, key_columns, limit_columns, read_key, read_limits, read_tenant};

#[async_trait]
impl AccessStore for PostgresStore {
    async fn create_key(&self, key: NewKey, token: &Token) -> Result<AccessKey, StoreError> {
        let row = sqlx::query(concat!(
            "INSERT INTO access_keys (id, secret_hash, tenant, kind, label, scopes, origin, max_bytes, parent, created_at, \
                                      expires_at) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, meshmend_now($10), meshmend_now($10) + $11) RETURNING ",
            key_columns!()
        ))
        .bind(format!("key_{}", Uuid::now_v7().simple()))
        .bind(token.as_str())
        .bind(key.tenant.as_str())
        .bind(key.kind.as_str())
        .bind(&key.label)
        .bind(key.scopes.to_string())
        .bind(&key.origin)
        .bind(key.max_bytes.map(|most| i64::try_from(most).unwrap_or(i64::MAX)))
        .bind(&key.parent)
        .bind(self.now())
        .bind(key.life_s.map(|seconds| i64::try_from(seconds.saturating_mul(1000)).unwrap_or(i64::MAX / 4)))
        .fetch_one(&self.pool)
        .await?;
        read_key(&row)
    }

    async fn find_key(&self, token: &Token) -> Result<Option<(AccessKey, TenantLimits)>, StoreError> {
        let row = sqlx::query(concat!(
            "SELECT ",
            key_columns!(),
            ", ",
            limit_columns!(),
            " FROM access_keys k LEFT JOIN tenants t ON t.name = k.tenant WHERE secret_hash = $1 AND revoked_at IS NULL AND (expires_at IS NULL OR expires_at > meshmend_now($2)) \
              AND NOT EXISTS (SELECT 1 FROM access_keys p WHERE p.id = k.parent \
                              AND (p.revoked_at IS NOT NULL OR p.expires_at <= meshmend_now($2)))"
        ))
        .bind(token.as_str())
        .bind(self.now())
        .fetch_optional(&self.pool)
        .await?;
        row.map(|row| Ok((read_key(&row)?, read_limits(&row)?))).transpose()
    }

    async fn touch_key(&self, id: &str) -> Result<(), StoreError> {
        sqlx::query("UPDATE access_keys SET last_used_at = meshmend_now($1) WHERE id = $2")
            .bind(self.now())
            .bind(id)
            .execute(&self.pool)
            .await?;
        Ok(())
    }

    async fn keys(&self, tenant: Option<&TenantName>) -> Result<Vec<AccessKey>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            key_columns!(),
            " FROM access_keys WHERE kind = 'api' AND ($1::text IS NULL OR tenant = $1) ORDER BY id"
        ))
        .bind(tenant.map(TenantName::as_str))
        .fetch_all(&self.pool)
        .await?;
        rows.iter().map(read_key).collect()
    }

    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError> {
        let revoked =
            sqlx::query("UPDATE access_keys SET revoked_at = meshmend_now($1) WHERE id = $2 AND revoked_at IS NULL")
                .bind(self.now())
                .bind(id)
                .execute(&self.pool)
                .await?;
        Ok(revoked.rows_affected() == 1)
    }

    async fn forget_tokens(&self) -> Result<u64, StoreError> {
        let gone = sqlx::query("DELETE FROM access_keys WHERE kind = 'browser' AND expires_at <= meshmend_now($1)")
            .bind(self.now())
            .execute(&self.pool)
            .await?;
        Ok(gone.rows_affected())
    }

    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError> {
        let row = sqlx::query(concat!("SELECT ", limit_columns!(), " FROM tenants WHERE name = $1"))
            .bind(tenant)
            .fetch_optional(&self.pool)
            .await?;
        Ok(row.as_ref().map(read_limits).transpose()?.unwrap_or_default())
    }

    async fn set_tenant(
        &self,
        tenant: &TenantName,
        class: Option<&TenantClass>,
        limits: TenantLimits,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO tenants (name, class, max_queued, max_running, requests_per_minute) VALUES ($1, $2, $3, $4, $5) \
             ON CONFLICT (name) DO UPDATE SET class = excluded.class, max_queued = excluded.max_queued, \
                 max_running = excluded.max_running, requests_per_minute = excluded.requests_per_minute",
        )
        .bind(tenant.as_str())
        .bind(class.map(TenantClass::as_str))
        .bind(limits.max_queued.map(i64::from))
        .bind(limits.max_running.map(i64::from))
        .bind(limits.requests_per_minute.map(i64::from))
        .execute(&self.pool)
        .await?;
        Ok(())
    }

    async fn tenants(&self) -> Result<Vec<Tenant>, StoreError> {
        let rows = sqlx::query(concat!("SELECT name AS id, class, ", limit_columns!(), " FROM tenants ORDER BY name"))
            .fetch_all(&self.pool)
            .await?;
        rows.iter().map(read_tenant).collect()
    }
}
