use async_trait::async_trait;
use sqlx::{ColumnIndex, Decode, Row, Type};
use time::OffsetDateTime;

use super::StoreError;
use super::row::corrupt;
use crate::access::{AccessKey, NewKey, TenantLimits, TenantName, Token};

/// Where keys and tenants' limits are kept.
#[async_trait]
pub trait AccessStore: Send + Sync {
    /// Makes a key that is found by `token` from now on.
    async fn create_key(&self, key: NewKey, token: &Token) -> Result<AccessKey, StoreError>;

    /// The key of that token, if it is worth something: known, neither revoked nor expired, and nor is the one it was made with.
    async fn find_key(&self, token: &Token) -> Result<Option<AccessKey>, StoreError>;

    /// Notes that a key was used.
    async fn touch_key(&self, id: &str) -> Result<(), StoreError>;

    /// All API keys, of one tenant or of all, oldest first, revoked ones too.
    async fn keys(&self, tenant: Option<&TenantName>) -> Result<Vec<AccessKey>, StoreError>;

    /// Revokes a key, and with it the tokens made with it. False if there is none that was worth something.
    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError>;

    /// Forgets browser tokens that expired. Answers how many.
    async fn forget_tokens(&self) -> Result<u64, StoreError>;

    /// What is set for a tenant.
    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError>;

    /// Sets a tenant's limits.
    async fn set_limits(&self, tenant: &TenantName, limits: TenantLimits) -> Result<(), StoreError>;

    /// Tenants for whom something is set.
    async fn tenants(&self) -> Result<Vec<(String, TenantLimits)>, StoreError>;
}

/// The columns of a key, for `SELECT` and `RETURNING`.
macro_rules! key_columns {
    () => {
        "id, tenant, kind, label, scopes, origin, max_bytes, created_at, expires_at, revoked_at, last_used_at"
    };
}
pub(super) use key_columns;

/// Reads a key from a row of [`key_columns`].
pub(super) fn read_key<R: Row>(row: &R) -> Result<AccessKey, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let id: String = row.try_get("id")?;
    let text = |column: &'static str| -> Result<String, StoreError> { Ok(row.try_get(column)?) };
    let time = |column: &'static str| -> Result<Option<OffsetDateTime>, StoreError> {
        let Some(stored) = row.try_get::<Option<i64>, _>(column)? else { return Ok(None) };
        let time = OffsetDateTime::from_unix_timestamp_nanos(i128::from(stored) * 1_000_000);
        time.map(Some).map_err(|e| corrupt(&id, column, e))
    };
    Ok(AccessKey {
        tenant: text("tenant")?.parse().map_err(|e| corrupt(&id, "tenant", e))?,
        kind: text("kind")?.parse().map_err(|()| corrupt(&id, "kind", "unknown"))?,
        label: text("label")?,
        scopes: text("scopes")?.parse().map_err(|e| corrupt(&id, "scopes", e))?,
        origin: row.try_get("origin")?,
        max_bytes: row.try_get::<Option<i64>, _>("max_bytes")?.map(i64::unsigned_abs),
        created_at: time("created_at")?.ok_or_else(|| corrupt(&id, "created_at", "no time"))?,
        expires_at: time("expires_at")?,
        revoked_at: time("revoked_at")?,
        last_used_at: time("last_used_at")?,
        id,
    })
}

/// A row of the table of tenants: name, jobs that may wait, jobs that may run, requests in a minute.
pub(super) type TenantRow = (String, Option<i64>, Option<i64>, Option<i64>);

/// The limits in a row.
pub(super) fn read_limits((name, queued, running, requests): TenantRow) -> (String, TenantLimits) {
    let number = |stored: Option<i64>| stored.map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    let limits = TenantLimits {
        max_queued: number(queued),
        max_running: number(running),
        requests_per_minute: number(requests),
    };
    (name, limits)
}
