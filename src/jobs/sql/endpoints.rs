use std::time::Duration;

use async_trait::async_trait;

use super::{Dialect, SqlConnection, SqlStore, sql};
use crate::jobs::StoreError;
use crate::jobs::row::millis;
use crate::jobs::webhooks::{
    Endpoint, EndpointChange, EndpointStore, NewEndpoint, Secrets, SigningSecret, endpoint_columns, names, new_id,
    read_endpoint, read_secrets,
};

#[async_trait]
impl<D: Dialect> EndpointStore for SqlStore<D> {
    async fn create_endpoint(&self, new: NewEndpoint, most: u32) -> Result<Option<Endpoint>, StoreError> {
        let statement = sql(concat!(
            "INSERT INTO webhook_endpoints (id, tenant, url, description, events, secret, created_at) \
             SELECT $2, $3, $4, $5, $6, $7, meshmend_now($1) \
             WHERE (SELECT count(*) FROM webhook_endpoints WHERE tenant = $3) < $8 RETURNING ",
            endpoint_columns!()
        ))
        .bind(self.now())
        .bind(new_id("we"))
        .bind(&new.tenant)
        .bind(&new.url)
        .bind(&new.description)
        .bind(names(&new.events))
        .bind(new.secret.reveal())
        .bind(most);
        self.writer().await?.query_row(statement).await?.as_ref().map(read_endpoint).transpose()
    }

    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError> {
        let statement =
            sql(concat!("SELECT ", endpoint_columns!(), " FROM webhook_endpoints WHERE tenant = $1 ORDER BY id"));
        self.reader().await?.query(statement.bind(tenant)).await?.iter().map(read_endpoint).collect()
    }

    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError> {
        let statement =
            sql(concat!("SELECT ", endpoint_columns!(), " FROM webhook_endpoints WHERE tenant = $1 AND id = $2"));
        let row = self.reader().await?.query_row(statement.bind(tenant).bind(id)).await?;
        row.as_ref().map(read_endpoint).transpose()
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
        .bind(change.events.as_deref().map(names))
        .bind(change.enabled)
        .bind(self.now())
        .bind("It was disabled on request.")
        .bind(tenant)
        .bind(id);
        let Some(row) = transaction.query_row(statement).await? else { return Ok(None) };
        if change.enabled == Some(false) {
            give_up(&mut *transaction, id).await?;
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
        self.writer().await?.query_row(statement).await?.as_ref().map(read_endpoint).transpose()
    }

    async fn delete_endpoint(&self, tenant: &str, id: &str) -> Result<bool, StoreError> {
        let statement = sql("DELETE FROM webhook_endpoints WHERE tenant = $1 AND id = $2");
        Ok(self.writer().await?.execute(statement.bind(tenant).bind(id)).await? == 1)
    }

    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError> {
        // The update changes nothing; it makes the statement return the row that is there.
        let statement = sql("INSERT INTO callback_secrets (tenant, secret) VALUES ($1, $2) \
             ON CONFLICT (tenant) DO UPDATE SET tenant = callback_secrets.tenant \
             RETURNING tenant AS id, secret, old_secret, old_secret_until");
        let row = self.writer().await?.query_row(statement.bind(tenant).bind(fresh.reveal())).await?;
        read_secrets(&row.ok_or(sqlx::Error::RowNotFound)?)
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
        let row = self.writer().await?.query_row(statement).await?;
        read_secrets(&row.ok_or(sqlx::Error::RowNotFound)?)
    }
}

/// Disables an endpoint and gives up its pending deliveries. False if the endpoint was disabled before.
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
    give_up(connection, id).await?;
    Ok(disabled == 1)
}

/// Gives up an endpoint's pending deliveries.
async fn give_up(connection: &mut impl SqlConnection, endpoint: &str) -> Result<(), StoreError> {
    let statement = sql(
        "UPDATE webhook_deliveries SET status = 'failed', lease_token = NULL WHERE endpoint_id = $1 AND status = 'pending'",
    );
    connection.execute(statement.bind(endpoint)).await?;
    Ok(())
}
