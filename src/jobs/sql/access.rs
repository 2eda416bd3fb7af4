use async_trait::async_trait;
use uuid::Uuid;

use super::{Dialect, SqlConnection, SqlStore, sql};
use crate::access::{AccessKey, KeyQuery, NewKey, Tenant, TenantChange, TenantClass, TenantLimits, TenantName, Token};
use crate::jobs::access::{AccessStore, key_columns, limit_columns, read_key, read_limits, read_tenant};
use crate::jobs::{Page, StoreError};

/// Selects every tenant that has settings or an API key, for [`read_tenant`].
macro_rules! tenants_and_key_holders {
    () => {
        "SELECT names.name AS id, t.class, t.max_queued, t.max_running, t.requests_per_minute \
         FROM (SELECT name FROM tenants UNION SELECT tenant COLLATE \"C\" FROM access_keys WHERE kind = 'api') AS names \
         LEFT JOIN tenants t ON t.name = names.name"
    };
}

#[async_trait]
impl<D: Dialect> AccessStore for SqlStore<D> {
    async fn create_key(&self, key: NewKey, token: &Token) -> Result<AccessKey, StoreError> {
        let statement = sql(concat!(
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
        .bind(key.life_s.map(|seconds| i64::try_from(seconds.saturating_mul(1000)).unwrap_or(i64::MAX / 4)));
        let row = self.writer().await?.query_row(statement).await?;
        read_key(&row.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn find_key(&self, token: &Token) -> Result<Option<(AccessKey, TenantLimits)>, StoreError> {
        let statement = sql(concat!(
            "SELECT ",
            key_columns!(),
            ", ",
            limit_columns!(),
            " FROM access_keys k LEFT JOIN tenants t ON t.name = k.tenant \
              WHERE secret_hash = $1 AND revoked_at IS NULL AND (expires_at IS NULL OR expires_at > meshmend_now($2)) \
              AND NOT EXISTS (SELECT 1 FROM access_keys p WHERE p.id = k.parent \
                              AND (p.revoked_at IS NOT NULL OR p.expires_at <= meshmend_now($2)))"
        ));
        let row = self.reader().await?.query_row(statement.bind(token.as_str()).bind(self.now())).await?;
        row.map(|row| Ok((read_key(&row)?, read_limits(&row)?))).transpose()
    }

    async fn touch_key(&self, id: &str) -> Result<(), StoreError> {
        let statement = sql("UPDATE access_keys SET last_used_at = meshmend_now($1) WHERE id = $2");
        self.writer().await?.execute(statement.bind(self.now()).bind(id)).await?;
        Ok(())
    }

    async fn keys(&self, query: KeyQuery) -> Result<Page<AccessKey, String>, StoreError> {
        let statement = sql(concat!(
            "SELECT ",
            key_columns!(),
            " FROM access_keys WHERE kind = 'api' AND ($1 IS NULL OR tenant = $1) AND ($2 IS NULL OR id = $2) \
              AND ($3 IS NULL OR id < $3) ORDER BY id DESC LIMIT $4"
        ))
        .bind(query.tenant.as_ref().map(TenantName::as_str))
        .bind(&query.id)
        .bind(&query.before)
        .bind(i64::from(query.limit) + 1);
        let rows = self.reader().await?.query(statement).await?;
        let keys = rows.iter().map(read_key).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(keys, query.limit, |key| key.id.clone()))
    }

    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError> {
        let statement =
            sql("UPDATE access_keys SET revoked_at = meshmend_now($1) WHERE id = $2 AND revoked_at IS NULL");
        Ok(self.writer().await?.execute(statement.bind(self.now()).bind(id)).await? == 1)
    }

    async fn forget_tokens(&self) -> Result<u64, StoreError> {
        let statement = sql("DELETE FROM access_keys WHERE kind = 'browser' AND expires_at <= meshmend_now($1)");
        self.writer().await?.execute(statement.bind(self.now())).await
    }

    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError> {
        let statement = sql(concat!("SELECT ", limit_columns!(), " FROM tenants WHERE name = $1"));
        let row = self.reader().await?.query_row(statement.bind(tenant)).await?;
        Ok(row.as_ref().map(read_limits).transpose()?.unwrap_or_default())
    }

    async fn change_tenant(&self, tenant: &TenantName, change: TenantChange) -> Result<Tenant, StoreError> {
        let number = |value: Option<Option<u32>>| value.flatten().map(i64::from);
        let statement = sql(concat!(
            "INSERT INTO tenants (name, class, max_queued, max_running, requests_per_minute) VALUES ($1, $2, $3, $4, $5) \
             ON CONFLICT (name) DO UPDATE SET \
                 class = CASE WHEN $6 THEN excluded.class ELSE tenants.class END, \
                 max_queued = CASE WHEN $7 THEN excluded.max_queued ELSE tenants.max_queued END, \
                 max_running = CASE WHEN $8 THEN excluded.max_running ELSE tenants.max_running END, \
                 requests_per_minute = CASE WHEN $9 THEN excluded.requests_per_minute ELSE tenants.requests_per_minute END \
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
        .bind(change.requests_per_minute.is_some());
        let row = self.writer().await?.query_row(statement).await?;
        read_tenant(&row.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn tenants(&self, after: Option<&str>, limit: u32) -> Result<Page<Tenant, String>, StoreError> {
        let statement = sql(concat!(
            tenants_and_key_holders!(),
            " WHERE $1 IS NULL OR names.name > $1 ORDER BY names.name LIMIT $2"
        ));
        let rows = self.reader().await?.query(statement.bind(after).bind(i64::from(limit) + 1)).await?;
        let tenants = rows.iter().map(read_tenant).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(tenants, limit, |tenant| tenant.name.clone()))
    }

    async fn tenant(&self, name: &str) -> Result<Option<Tenant>, StoreError> {
        let statement = sql(concat!(tenants_and_key_holders!(), " WHERE names.name = $1"));
        self.reader().await?.query_row(statement.bind(name)).await?.as_ref().map(read_tenant).transpose()
    }
}
