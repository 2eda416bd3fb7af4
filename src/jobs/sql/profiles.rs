//! The process profiles of tenants.

use async_trait::async_trait;

use super::statement::{Columns, Reader, SqlConnection, sql, to_json, to_millis};
use super::store::{Dialect, SqlStore};
use crate::jobs::error::StoreError;
use crate::jobs::profiles::{NewProfile, TenantProfile};
use crate::jobs::store::ProfileStore;

/// The columns of a profile, for `SELECT` and `RETURNING`.
macro_rules! profile_columns {
    () => {
        "name AS id, limits, version, created_at, updated_at"
    };
}

#[async_trait]
impl<D: Dialect> ProfileStore for SqlStore<D> {
    async fn profiles(&self, tenant: &str) -> Result<Vec<TenantProfile>, StoreError> {
        let statement =
            sql(concat!("SELECT ", profile_columns!(), " FROM process_profiles WHERE tenant = $1 ORDER BY name"));
        self.read_all(statement.bind(tenant), read_profile).await
    }

    async fn profile(&self, tenant: &str, name: &str) -> Result<Option<TenantProfile>, StoreError> {
        let statement =
            sql(concat!("SELECT ", profile_columns!(), " FROM process_profiles WHERE tenant = $1 AND name = $2"));
        self.read_one(statement.bind(tenant).bind(name), read_profile).await
    }

    async fn add_profile(&self, tenant: &str, new: &NewProfile, max: u32) -> Result<Option<TenantProfile>, StoreError> {
        let statement = sql(concat!(
            "INSERT INTO process_profiles (tenant, name, limits, version, created_at, updated_at) \
             SELECT $2, $3, $4, 1, meshmend_now($1), meshmend_now($1) \
             WHERE (SELECT count(*) FROM process_profiles WHERE tenant = $2) < $5 \
             ON CONFLICT (tenant, name) DO NOTHING RETURNING ",
            profile_columns!()
        ))
        .bind(self.now())
        .bind(tenant)
        .bind(new.name.as_str())
        .bind(to_json(&new.limits))
        .bind(max);
        self.write_one(statement, read_profile).await
    }

    async fn replace_profile(
        &self,
        tenant: &str,
        new: &NewProfile,
        expected: Option<&TenantProfile>,
    ) -> Result<Option<TenantProfile>, StoreError> {
        let statement = sql(concat!(
            "UPDATE process_profiles SET limits = $2, version = version + 1, updated_at = meshmend_now($1) \
             WHERE tenant = $3 AND name = $4 AND ($5 IS NULL OR (version = $5 AND created_at = $6)) RETURNING ",
            profile_columns!()
        ))
        .bind(self.now())
        .bind(to_json(&new.limits))
        .bind(tenant)
        .bind(new.name.as_str())
        .bind(expected.map(|profile| i64::from(profile.version)))
        .bind(expected.map(|profile| to_millis(profile.created_at)));
        self.write_one(statement, read_profile).await
    }

    async fn delete_profile(
        &self,
        tenant: &str,
        name: &str,
        expected: Option<&TenantProfile>,
    ) -> Result<bool, StoreError> {
        let statement = sql("DELETE FROM process_profiles \
             WHERE tenant = $1 AND name = $2 AND ($3 IS NULL OR (version = $3 AND created_at = $4))")
        .bind(tenant)
        .bind(name)
        .bind(expected.map(|profile| i64::from(profile.version)))
        .bind(expected.map(|profile| to_millis(profile.created_at)));
        Ok(self.writer().await?.execute(statement).await? == 1)
    }
}

/// Reads a profile from a row of [`profile_columns`].
fn read_profile(row: &impl Columns) -> Result<TenantProfile, StoreError> {
    let from = Reader::new(row)?;
    Ok(TenantProfile {
        limits: from.json("limits")?,
        version: from.count("version")?,
        created_at: from.time("created_at")?,
        updated_at: from.time("updated_at")?,
        name: from.id,
    })
}
