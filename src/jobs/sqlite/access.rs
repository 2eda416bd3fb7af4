use async_trait::async_trait;
use uuid::Uuid;

use super::SqliteStore;
use crate::access::{AccessKey, KeyQuery, NewKey, Tenant, TenantChange, TenantClass, TenantLimits, TenantName, Token};
use crate::jobs::access::{
    AccessStore, key_columns, limit_columns, read_key, read_limits, read_tenant, tenants_and_key_holders,
};
use crate::jobs::{Page, StoreError};

#[async_trait]
impl AccessStore for SqliteStore {
    async fn create_key(&self, key: NewKey, token: &Token) -> Result<AccessKey, StoreError> {
        let rows = sqlx::query(concat!(
            "INSERT INTO access_keys (id, secret_hash, tenant, kind, label, scopes, origin, max_bytes, parent, created_at, \
                                      expires_at) \
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?10 + ?11) RETURNING ",
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
        .bind(self.clock.now_ms())
        .bind(key.life_s.map(|seconds| i64::try_from(seconds.saturating_mul(1000)).unwrap_or(i64::MAX / 4)))
        .fetch_all(&self.writer)
        .await?;
        read_key(rows.first().ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn find_key(&self, token: &Token) -> Result<Option<(AccessKey, TenantLimits)>, StoreError> {
        let row = sqlx::query(concat!(
            "SELECT ",
            key_columns!(),
            ", ",
            limit_columns!(),
            " FROM access_keys k LEFT JOIN tenants t ON t.name = k.tenant WHERE secret_hash = ?1 AND revoked_at IS NULL AND (expires_at IS NULL OR expires_at > ?2) \
              AND NOT EXISTS (SELECT 1 FROM access_keys p WHERE p.id = k.parent \
                              AND (p.revoked_at IS NOT NULL OR p.expires_at <= ?2))"
        ))
        .bind(token.as_str())
        .bind(self.clock.now_ms())
        .fetch_optional(&self.reader)
        .await?;
        row.map(|row| Ok((read_key(&row)?, read_limits(&row)?))).transpose()
    }

    async fn touch_key(&self, id: &str) -> Result<(), StoreError> {
        sqlx::query("UPDATE access_keys SET last_used_at = ?1 WHERE id = ?2")
            .bind(self.clock.now_ms())
            .bind(id)
            .execute(&self.writer)
            .await?;
        Ok(())
    }

    async fn keys(&self, query: KeyQuery) -> Result<Page<AccessKey, String>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            key_columns!(),
            " FROM access_keys WHERE kind = 'api' AND (?1 IS NULL OR tenant = ?1) AND (?2 IS NULL OR id = ?2) \
              AND (?3 IS NULL OR id < ?3) ORDER BY id DESC LIMIT ?4"
        ))
        .bind(query.tenant.as_ref().map(TenantName::as_str))
        .bind(&query.id)
        .bind(&query.before)
        .bind(i64::from(query.limit) + 1)
        .fetch_all(&self.reader)
        .await?;
        let keys = rows.iter().map(read_key).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(keys, query.limit, |key| key.id.clone()))
    }

    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError> {
        let revoked = sqlx::query("UPDATE access_keys SET revoked_at = ?1 WHERE id = ?2 AND revoked_at IS NULL")
            .bind(self.clock.now_ms())
            .bind(id)
            .execute(&self.writer)
            .await?;
        Ok(revoked.rows_affected() == 1)
    }

    async fn forget_tokens(&self) -> Result<u64, StoreError> {
        let gone = sqlx::query("DELETE FROM access_keys WHERE kind = 'browser' AND expires_at <= ?1")
            .bind(self.clock.now_ms())
            .execute(&self.writer)
            .await?;
        Ok(gone.rows_affected())
    }

    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError> {
        let row = sqlx::query(concat!("SELECT ", limit_columns!(), " FROM tenants WHERE name = ?1"))
            .bind(tenant)
            .fetch_optional(&self.reader)
            .await?;
        Ok(row.as_ref().map(read_limits).transpose()?.unwrap_or_default())
    }

    async fn change_tenant(&self, tenant: &TenantName, change: TenantChange) -> Result<Tenant, StoreError> {
        let number = |value: Option<Option<u32>>| value.flatten().map(i64::from);
        let rows = sqlx::query(concat!(
            "INSERT INTO tenants (name, class, max_queued, max_running, requests_per_minute) VALUES (?1, ?2, ?3, ?4, ?5) \
             ON CONFLICT (name) DO UPDATE SET \
                 class = CASE WHEN ?6 THEN excluded.class ELSE tenants.class END, \
                 max_queued = CASE WHEN ?7 THEN excluded.max_queued ELSE tenants.max_queued END, \
                 max_running = CASE WHEN ?8 THEN excluded.max_running ELSE tenants.max_running END, \
                 requests_per_minute = CASE WHEN ?9 THEN excluded.requests_per_minute ELSE tenants.requests_per_minute END \
             RETURNING name AS id, class, ",
            limit_columns!()
        ))
        .bind(tenant.as_str())
        .bind(change.class.as_ref().and_then(|class| class.as_ref().map(TenantClass::as_str)))
        .bind(number(change.max_queued))
        .bind(number(change.max_running))
        .bind(number(change.requests_per_minute))
        .bind(change.class.is_some())
        .bind(change.max_queued.is_some())
        .bind(change.max_running.is_some())
        .bind(change.requests_per_minute.is_some())
        .fetch_all(&self.writer)
        .await?;
        read_tenant(rows.first().ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn tenants(&self, after: Option<&str>, limit: u32) -> Result<Page<Tenant, String>, StoreError> {
        let rows = sqlx::query(concat!(
            tenants_and_key_holders!("tenant"),
            " WHERE ?1 IS NULL OR names.name > ?1 ORDER BY names.name LIMIT ?2"
        ))
        .bind(after)
        .bind(i64::from(limit) + 1)
        .fetch_all(&self.reader)
        .await?;
        let tenants = rows.iter().map(read_tenant).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(tenants, limit, |tenant| tenant.name.clone()))
    }

    async fn tenant(&self, name: &str) -> Result<Option<Tenant>, StoreError> {
        let row = sqlx::query(concat!(tenants_and_key_holders!("tenant"), " WHERE names.name = ?1"))
            .bind(name)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(read_tenant).transpose()
    }
}
