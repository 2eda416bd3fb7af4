//! The settings of tenants: their API keys and limits, their webhook endpoints, and the secrets of their callbacks.

use std::time::Duration;

use async_trait::async_trait;

use super::statement::{Columns, Reader, SqlConnection, corrupt, millis, sql};
use super::store::{Dialect, SqlStore};
use crate::access::{
    AccessKey, KeyQuery, NewKey, SecretHash, Tenant, TenantChange, TenantClass, TenantLimits, TenantName,
};
use crate::jobs::error::StoreError;
use crate::jobs::store::{AccessStore, EndpointStore, Page};
use crate::jobs::webhooks::{Endpoint, EndpointChange, JobEvent, NewEndpoint, Secrets, SigningSecret};

/// The columns of a key, for `SELECT` and `RETURNING`.
macro_rules! key_columns {
    () => {
        "id, tenant, kind, label, scopes, origin, max_bytes, created_at, expires_at, revoked_at, last_used_at"
    };
}

/// The columns of a tenant's limits, for `SELECT`.
macro_rules! limit_columns {
    () => {
        "max_queued, max_running, requests_per_minute"
    };
}

/// Selects every tenant that has settings or an API key, for [`read_tenant`].
macro_rules! tenants_and_key_holders {
    () => {
        "SELECT names.name AS id, t.class, t.max_queued, t.max_running, t.requests_per_minute \
         FROM (SELECT name FROM tenants UNION SELECT tenant COLLATE \"C\" FROM access_keys WHERE kind = 'api') AS names \
         LEFT JOIN tenants t ON t.name = names.name"
    };
}

/// The columns of an endpoint, for `SELECT` and `RETURNING`.
macro_rules! endpoint_columns {
    () => {
        "id, url, description, events, secret, old_secret, old_secret_until, created_at, failing_since, disabled_at, \
         disabled_reason"
    };
}

#[async_trait]
impl<D: Dialect> AccessStore for SqlStore<D> {
    async fn create_key(&self, key: NewKey, hash: &SecretHash) -> Result<AccessKey, StoreError> {
        let statement = sql(concat!(
            "INSERT INTO access_keys (id, secret_hash, tenant, kind, label, scopes, origin, max_bytes, parent, created_at, \
                                      expires_at) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, meshmend_now($10), meshmend_now($10) + $11) RETURNING ",
            key_columns!()
        ))
        .bind(self.new_id("key"))
        .bind(hash.as_str())
        .bind(key.tenant.as_str())
        .bind(key.kind.as_str())
        .bind(&key.label)
        .bind(key.scopes.to_string())
        .bind(&key.origin)
.bind(key.max_bytes.map(|max| i64::try_from(max).unwrap_or(i64::MAX)))
        .bind(&key.parent)
        .bind(self.now())
        .bind(key.life_s.map(|seconds| i64::try_from(seconds.saturating_mul(1000)).unwrap_or(i64::MAX / 4)));
        Ok(self.write_one(statement, read_key).await?.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn find_key(&self, hash: &SecretHash) -> Result<Option<(AccessKey, TenantLimits)>, StoreError> {
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
        let statement = statement.bind(hash.as_str()).bind(self.now());
        self.read_one(statement, |row| Ok((read_key(row)?, read_limits(row)?))).await
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
        Ok(Page::of(self.read_all(statement, read_key).await?, query.limit, |key| key.id.clone()))
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
        Ok(self.read_one(statement.bind(tenant), read_limits).await?.unwrap_or_default())
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
        Ok(self.write_one(statement, read_tenant).await?.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn tenants(&self, after: Option<&str>, limit: u32) -> Result<Page<Tenant, String>, StoreError> {
        let statement = sql(concat!(
            tenants_and_key_holders!(),
            " WHERE $1 IS NULL OR names.name > $1 ORDER BY names.name LIMIT $2"
        ));
        let tenants = self.read_all(statement.bind(after).bind(i64::from(limit) + 1), read_tenant).await?;
        Ok(Page::of(tenants, limit, |tenant| tenant.name.clone()))
    }

    async fn tenant(&self, name: &str) -> Result<Option<Tenant>, StoreError> {
        let statement = sql(concat!(tenants_and_key_holders!(), " WHERE names.name = $1"));
        self.read_one(statement.bind(name), read_tenant).await
    }
}

#[async_trait]
impl<D: Dialect> EndpointStore for SqlStore<D> {
    async fn create_endpoint(&self, new: NewEndpoint, max: u32) -> Result<Option<Endpoint>, StoreError> {
        let statement = sql(concat!(
            "INSERT INTO webhook_endpoints (id, tenant, url, description, events, secret, created_at) \
             SELECT $2, $3, $4, $5, $6, $7, meshmend_now($1) \
             WHERE (SELECT count(*) FROM webhook_endpoints WHERE tenant = $3) < $8 RETURNING ",
            endpoint_columns!()
        ))
        .bind(self.now())
        .bind(self.new_id("we"))
        .bind(&new.tenant)
        .bind(&new.url)
        .bind(&new.description)
        .bind(event_names(&new.events))
        .bind(new.secret.reveal())
        .bind(max);
        self.write_one(statement, read_endpoint).await
    }

    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError> {
        let statement =
            sql(concat!("SELECT ", endpoint_columns!(), " FROM webhook_endpoints WHERE tenant = $1 ORDER BY id"));
        self.read_all(statement.bind(tenant), read_endpoint).await
    }

    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError> {
        let statement =
            sql(concat!("SELECT ", endpoint_columns!(), " FROM webhook_endpoints WHERE tenant = $1 AND id = $2"));
        self.read_one(statement.bind(tenant).bind(id), read_endpoint).await
    }

    async fn change_endpoint(
        &self,
        tenant: &str,
        id: &str,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreError> {
        let mut transaction = self.begin().await?;
        // Enabling an endpoint clears its record of failures.
        let statement = sql(concat!(
            "UPDATE webhook_endpoints SET url = coalesce($1, url), description = coalesce($2, description), \
                 events = coalesce($3, events), failing_since = CASE WHEN $4 THEN NULL ELSE failing_since END, \
                 disabled_at = CASE $4 WHEN TRUE THEN NULL WHEN FALSE THEN coalesce(disabled_at, meshmend_now($5)) ELSE disabled_at END, \
                 disabled_reason = CASE $4 WHEN TRUE THEN NULL WHEN FALSE THEN coalesce(disabled_reason, $6) ELSE disabled_reason END \
             WHERE tenant = $7 AND id = $8 RETURNING ",
            endpoint_columns!()
        ))
        .bind(&change.url)
        .bind(&change.description)
        .bind(change.events.as_deref().map(event_names))
        .bind(change.enabled)
        .bind(self.now())
.bind("The tenant disabled the endpoint.")
        .bind(tenant)
        .bind(id);
        let Some(row) = transaction.query_row(statement).await? else { return Ok(None) };
        if change.enabled == Some(false) {
            fail_pending(&mut *transaction, id).await?;
        }
        transaction.commit().await?;
        read_endpoint(&row).map(Some)
    }

    async fn rotate_endpoint(
        &self,
        tenant: &str,
        id: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Option<Endpoint>, StoreError> {
        let statement = sql(concat!(
            "UPDATE webhook_endpoints SET old_secret = secret, old_secret_until = meshmend_now($1) + $5, secret = $2 \
             WHERE tenant = $3 AND id = $4 RETURNING ",
            endpoint_columns!()
        ))
        .bind(self.now())
        .bind(secret.reveal())
        .bind(tenant)
        .bind(id)
        .bind(millis(keep));
        self.write_one(statement, read_endpoint).await
    }

    async fn delete_endpoint(&self, tenant: &str, id: &str) -> Result<bool, StoreError> {
        let statement = sql("DELETE FROM webhook_endpoints WHERE tenant = $1 AND id = $2");
        Ok(self.writer().await?.execute(statement.bind(tenant).bind(id)).await? == 1)
    }

    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError> {
        // The update changes nothing; it makes the statement return the existing row.
        let statement = sql("INSERT INTO callback_secrets (tenant, secret) VALUES ($1, $2) \
             ON CONFLICT (tenant) DO UPDATE SET tenant = callback_secrets.tenant \
             RETURNING tenant AS id, secret, old_secret, old_secret_until");
        let statement = statement.bind(tenant).bind(fresh.reveal());
        Ok(self.write_one(statement, read_secrets).await?.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn rotate_callback_secret(
        &self,
        tenant: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Secrets, StoreError> {
        let statement = sql(
            "INSERT INTO callback_secrets (tenant, secret) VALUES ($1, $2) ON CONFLICT (tenant) DO UPDATE SET \
                 old_secret = callback_secrets.secret, old_secret_until = meshmend_now($3) + $4, secret = excluded.secret \
             RETURNING tenant AS id, secret, old_secret, old_secret_until",
        )
        .bind(tenant)
        .bind(secret.reveal())
        .bind(self.now())
        .bind(millis(keep));
        Ok(self.write_one(statement, read_secrets).await?.ok_or(sqlx::Error::RowNotFound)?)
    }
}

/// Disables an endpoint and fails its pending deliveries. Returns `false` if the endpoint was disabled before.
pub(super) async fn disable(
    connection: &mut impl SqlConnection,
    id: &str,
    reason: &str,
    now: Option<i64>,
) -> Result<bool, StoreError> {
    let statement = sql(
        "UPDATE webhook_endpoints SET disabled_at = meshmend_now($1), disabled_reason = $2 WHERE id = $3 AND disabled_at IS NULL",
    );
    let disabled = connection.execute(statement.bind(now).bind(reason).bind(id)).await?;
    fail_pending(connection, id).await?;
    Ok(disabled == 1)
}

/// Fails an endpoint's pending deliveries.
async fn fail_pending(connection: &mut impl SqlConnection, endpoint: &str) -> Result<(), StoreError> {
    let statement = sql(
        "UPDATE webhook_deliveries SET status = 'failed', lease_token = NULL WHERE endpoint_id = $1 AND status = 'pending'",
    );
    connection.execute(statement.bind(endpoint)).await?;
    Ok(())
}

/// Reads a key from a row of [`key_columns`].
fn read_key(row: &impl Columns) -> Result<AccessKey, StoreError> {
    let from = Reader::new(row)?;
    Ok(AccessKey {
        tenant: from.parsed("tenant")?,
        kind: from.parsed("kind")?,
        label: from.text("label")?,
        scopes: from.parsed("scopes")?,
        origin: from.some_text("origin")?,
        max_bytes: from.some_number("max_bytes")?.map(i64::unsigned_abs),
        created_at: from.time("created_at")?,
        expires_at: from.some_time("expires_at")?,
        revoked_at: from.some_time("revoked_at")?,
        last_used_at: from.some_time("last_used_at")?,
        id: from.id,
    })
}

/// Reads a tenant's limits from a row of [`limit_columns`].
fn read_limits(row: &impl Columns) -> Result<TenantLimits, StoreError> {
    let number = |column| -> Result<Option<u32>, StoreError> {
        Ok(row.number(column)?.map(|stored| u32::try_from(stored).unwrap_or(u32::MAX)))
    };
    Ok(TenantLimits {
        max_queued: number("max_queued")?,
        max_running: number("max_running")?,
        requests_per_minute: number("requests_per_minute")?,
    })
}

/// Reads a tenant from its name, as `id`, its class and its limits.
fn read_tenant(row: &impl Columns) -> Result<Tenant, StoreError> {
    let from = Reader::new(row)?;
    Ok(Tenant { class: from.some_text("class")?, limits: read_limits(row)?, name: from.id })
}

/// Reads the current and the previous secret; `None` if there is no secret.
pub(super) fn read_signing_secrets(from: &Reader<'_, impl Columns>) -> Result<Option<Secrets>, StoreError> {
    let Some(current) = from.some_text("secret")? else { return Ok(None) };
    let previous = from.some_text("old_secret")?.map(SigningSecret::new).zip(from.some_time("old_secret_until")?);
    Ok(Some(Secrets { current: SigningSecret::new(current), previous }))
}

/// Reads the secrets of a tenant's callbacks. The row has the tenant's name as `id`.
fn read_secrets(row: &impl Columns) -> Result<Secrets, StoreError> {
    let from = Reader::new(row)?;
    read_signing_secrets(&from)?.ok_or_else(|| corrupt(&from.id, "secret", "unexpected null"))
}

/// Reads an endpoint from a row of [`endpoint_columns`].
fn read_endpoint(row: &impl Columns) -> Result<Endpoint, StoreError> {
    let from = Reader::new(row)?;
    Ok(Endpoint {
        url: from.text("url")?,
        description: from.text("description")?,
        events: read_events(&from.text("events")?).collect(),
        secrets: read_signing_secrets(&from)?.ok_or_else(|| corrupt(&from.id, "secret", "unexpected null"))?,
        created_at: from.time("created_at")?,
        failing_since: from.some_time("failing_since")?,
        disabled: from.some_time("disabled_at")?.zip(from.some_text("disabled_reason")?),
        id: from.id,
    })
}

/// The text of events in a column.
fn event_names(events: &[JobEvent]) -> String {
    events.iter().map(|event| event.as_str()).collect::<Vec<_>>().join(",")
}

/// The events of a column's text; unknown events of a later version are skipped.
pub(super) fn read_events(column: &str) -> impl Iterator<Item = JobEvent> + '_ {
    column.split(',').filter_map(|name| name.parse().ok())
}
