use async_trait::async_trait;

use super::row::{Columns, Reader};
use super::{Page, StoreError};
use crate::access::{AccessKey, KeyQuery, NewKey, Tenant, TenantChange, TenantLimits, TenantName, Token};

/// Where keys and tenants' limits are kept.
#[async_trait]
pub trait AccessStore: Send + Sync {
    /// Makes a key that is found by `token` from now on.
    async fn create_key(&self, key: NewKey, token: &Token) -> Result<AccessKey, StoreError>;

    /// The key of that token and the limits of its tenant; none if the key is unknown, revoked or expired, or if its parent key is.
    async fn find_key(&self, token: &Token) -> Result<Option<(AccessKey, TenantLimits)>, StoreError>;

    /// Records that a key was used.
    async fn touch_key(&self, id: &str) -> Result<(), StoreError>;

    /// One page of API keys, newest first, revoked ones too. Browser tokens are not listed.
    async fn keys(&self, query: KeyQuery) -> Result<Page<AccessKey, String>, StoreError>;

    /// Revokes a key, and with it the tokens made with it. False if there is no such key or it was revoked before.
    async fn revoke_key(&self, id: &str) -> Result<bool, StoreError>;

    /// Deletes expired browser tokens. Returns how many.
    async fn forget_tokens(&self) -> Result<u64, StoreError>;

    /// The limits that are set for a tenant.
    async fn limits(&self, tenant: &str) -> Result<TenantLimits, StoreError>;

    /// Changes the settings of a tenant that `change` names, and returns all of them. A tenant without settings gets its first.
    async fn change_tenant(&self, tenant: &TenantName, change: TenantChange) -> Result<Tenant, StoreError>;

    /// One page of the tenants that have settings or an API key, by name, beginning behind `after`.
    async fn tenants(&self, after: Option<&str>, limit: u32) -> Result<Page<Tenant, String>, StoreError>;

    /// One tenant; none if it has neither settings nor an API key.
    async fn tenant(&self, name: &str) -> Result<Option<Tenant>, StoreError>;
}

/// The columns of a key, for `SELECT` and `RETURNING`.
macro_rules! key_columns {
    () => {
        "id, tenant, kind, label, scopes, origin, max_bytes, created_at, expires_at, revoked_at, last_used_at"
    };
}
pub(super) use key_columns;

/// Reads a key from a row of [`key_columns`].
pub(super) fn read_key(row: &impl Columns) -> Result<AccessKey, StoreError> {
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

/// The columns of a tenant's limits, for `SELECT`.
macro_rules! limit_columns {
    () => {
        "max_queued, max_running, requests_per_minute"
    };
}
pub(super) use limit_columns;

/// Reads a tenant's limits from a row of [`limit_columns`].
pub(super) fn read_limits(row: &impl Columns) -> Result<TenantLimits, StoreError> {
    let number = |column| -> Result<Option<u32>, StoreError> {
        Ok(row.number(column)?.map(|stored| u32::try_from(stored).unwrap_or(u32::MAX)))
    };
    Ok(TenantLimits {
        max_queued: number("max_queued")?,
        max_running: number("max_running")?,
        requests_per_minute: number("requests_per_minute")?,
    })
}

/// Reads a tenant's name, as `id`, its class and its limits.
pub(super) fn read_tenant(row: &impl Columns) -> Result<Tenant, StoreError> {
    let from = Reader::new(row)?;
    Ok(Tenant { class: from.some_text("class")?, limits: read_limits(row)?, name: from.id })
}
