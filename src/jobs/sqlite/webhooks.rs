use std::time::Duration;

use async_trait::async_trait;
use sqlx::SqliteConnection;
use uuid::Uuid;

use super::{SqliteStore, outbox};
use crate::jobs::row::{millis, time, to_json};
use crate::jobs::webhooks::{
    Attempt, Backlog, Delivery, DeliveryQuery, DueDelivery, Endpoint, EndpointChange, FAILING, Message, NewEndpoint,
    Receiver, Redelivered, Secrets, SigningSecret, Verdict, WebhookStore, delivery_columns, endpoint_columns, names,
    new_id, read_delivery, read_due, read_endpoint, read_secrets,
};
use crate::jobs::{Page, StoreError};

#[async_trait]
impl WebhookStore for SqliteStore {
    async fn create_endpoint(&self, new: NewEndpoint, most: u32) -> Result<Option<Endpoint>, StoreError> {
        let row = sqlx::query(concat!(
            "INSERT INTO webhook_endpoints (id, tenant, url, description, events, secret, created_at) \
             SELECT ?2, ?3, ?4, ?5, ?6, ?7, ?1 WHERE (SELECT count(*) FROM webhook_endpoints WHERE tenant = ?3) < ?8 RETURNING ",
            endpoint_columns!()
        ))
        .bind(self.clock.now_ms())
        .bind(new_id("we"))
        .bind(&new.tenant)
        .bind(&new.url)
        .bind(&new.description)
        .bind(names(&new.events))
        .bind(new.secret.reveal())
        .bind(most)
        .fetch_all(&self.writer)
        .await?
        .pop();
        row.as_ref().map(read_endpoint).transpose()
    }

    async fn endpoints(&self, tenant: &str) -> Result<Vec<Endpoint>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            endpoint_columns!(),
            " FROM webhook_endpoints WHERE tenant = ? ORDER BY id"
        ))
        .bind(tenant)
        .fetch_all(&self.reader)
        .await?;
        rows.iter().map(read_endpoint).collect()
    }

    async fn endpoint(&self, tenant: &str, id: &str) -> Result<Option<Endpoint>, StoreError> {
        let row =
            sqlx::query(concat!("SELECT ", endpoint_columns!(), " FROM webhook_endpoints WHERE tenant = ? AND id = ?"))
                .bind(tenant)
                .bind(id)
                .fetch_optional(&self.reader)
                .await?;
        row.as_ref().map(read_endpoint).transpose()
    }

    async fn change_endpoint(
        &self,
        tenant: &str,
        id: &str,
        change: EndpointChange,
    ) -> Result<Option<Endpoint>, StoreError> {
        let mut transaction = self.begin().await?;
        // Whoever is enabled again begins with a clean sheet.
        let row = sqlx::query(concat!(
            "UPDATE webhook_endpoints SET url = coalesce(?1, url), description = coalesce(?2, description), \
                 events = coalesce(?3, events), failing_since = CASE WHEN ?4 THEN NULL ELSE failing_since END, \
                 disabled_at = CASE ?4 WHEN TRUE THEN NULL WHEN FALSE THEN coalesce(disabled_at, ?5) ELSE disabled_at END, \
                 disabled_reason = CASE ?4 WHEN TRUE THEN NULL WHEN FALSE THEN coalesce(disabled_reason, ?6) ELSE disabled_reason END \
             WHERE tenant = ?7 AND id = ?8 RETURNING ",
            endpoint_columns!()
        ))
        .bind(&change.url)
        .bind(&change.description)
        .bind(change.events.as_deref().map(names))
        .bind(change.enabled)
        .bind(self.clock.now_ms())
        .bind("It was disabled on request.")
        .bind(tenant)
        .bind(id)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else { return Ok(None) };
        if change.enabled == Some(false) {
            give_up(&mut transaction, id).await?;
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
        let row = sqlx::query(concat!(
            "UPDATE webhook_endpoints SET old_secret = secret, old_secret_until = ?1, secret = ?2 \
             WHERE tenant = ?3 AND id = ?4 RETURNING ",
            endpoint_columns!()
        ))
        .bind(self.clock.now_ms() + millis(keep))
        .bind(secret.reveal())
        .bind(tenant)
        .bind(id)
        .fetch_all(&self.writer)
        .await?
        .pop();
        row.as_ref().map(read_endpoint).transpose()
    }

    async fn delete_endpoint(&self, tenant: &str, id: &str) -> Result<bool, StoreError> {
        let gone = sqlx::query("DELETE FROM webhook_endpoints WHERE tenant = ? AND id = ?")
            .bind(tenant)
            .bind(id)
            .execute(&self.writer)
            .await?;
        Ok(gone.rows_affected() == 1)
    }

    async fn callback_secrets(&self, tenant: &str, fresh: &SigningSecret) -> Result<Secrets, StoreError> {
        let row = sqlx::query(
            "INSERT INTO callback_secrets (tenant, secret) VALUES (?, ?) ON CONFLICT (tenant) DO UPDATE SET tenant = callback_secrets.tenant \
             RETURNING tenant AS id, secret, old_secret, old_secret_until",
        )
        .bind(tenant)
        .bind(fresh.reveal())
        .fetch_all(&self.writer)
        .await?
        .pop();
        read_secrets(&row.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn rotate_callback_secret(
        &self,
        tenant: &str,
        secret: &SigningSecret,
        keep: Duration,
    ) -> Result<Secrets, StoreError> {
        let row = sqlx::query(
            "INSERT INTO callback_secrets (tenant, secret) VALUES (?1, ?2) ON CONFLICT (tenant) \
             DO UPDATE SET old_secret = callback_secrets.secret, old_secret_until = ?3, secret = excluded.secret \
             RETURNING tenant AS id, secret, old_secret, old_secret_until",
        )
        .bind(tenant)
        .bind(secret.reveal())
        .bind(self.clock.now_ms() + millis(keep))
        .fetch_all(&self.writer)
        .await?
        .pop();
        read_secrets(&row.ok_or(sqlx::Error::RowNotFound)?)
    }

    async fn send_ping(&self, tenant: &str, endpoint: &str) -> Result<Option<String>, StoreError> {
        let now = self.clock.now_ms();
        let mut transaction = self.begin().await?;
        let is_there: Option<i64> =
            sqlx::query_scalar("SELECT 1 FROM webhook_endpoints WHERE tenant = ? AND id = ? AND disabled_at IS NULL")
                .bind(tenant)
                .bind(endpoint)
                .fetch_optional(&mut *transaction)
                .await?;
        if is_there.is_none() {
            return Ok(None);
        }
        let message = Message::ping(endpoint, time(endpoint, "created_at", now)?);
        outbox::write(&mut transaction, &message, now).await?;
        let receiver = Receiver { endpoint: Some(endpoint), url: None };
        let id = outbox::address(&mut transaction, tenant, &message, &receiver, now).await?;
        transaction.commit().await?;
        self.bell.ring_for_deliveries();
        Ok(Some(id))
    }

    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            delivery_columns!(),
            " FROM webhook_deliveries d JOIN webhook_messages m ON m.id = d.message_id \
             WHERE d.tenant = ?1 AND (?2 IS NULL OR d.id = ?2) AND (?3 IS NULL OR d.endpoint_id = ?3) \
               AND (?4 IS NULL OR m.job_id = ?4) AND (?5 IS NULL OR d.id < ?5) ORDER BY d.id DESC LIMIT ?6"
        ))
        .bind(&query.tenant)
        .bind(&query.id)
        .bind(&query.endpoint)
        .bind(query.job.map(|id| id.to_string()))
        .bind(&query.before)
        .bind(i64::from(query.limit) + 1)
        .fetch_all(&self.reader)
        .await?;
        let deliveries = rows.iter().map(read_delivery).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(deliveries, query.limit, |delivery| delivery.id.clone()))
    }

    async fn redeliver(&self, tenant: &str, id: &str) -> Result<Redelivered, StoreError> {
        let mut transaction = self.begin().await?;
        let disabled: Option<bool> = sqlx::query_scalar(
            "SELECT e.disabled_at IS NOT NULL FROM webhook_deliveries d LEFT JOIN webhook_endpoints e ON e.id = d.endpoint_id \
             WHERE d.tenant = ? AND d.id = ?",
        )
        .bind(tenant)
        .bind(id)
        .fetch_optional(&mut *transaction)
        .await?;
        match disabled {
            None => return Ok(Redelivered::Unknown),
            Some(true) => return Ok(Redelivered::Disabled),
            Some(false) => {}
        }
        // Whoever has it under way loses it: what was asked for came after that.
        sqlx::query(
            "UPDATE webhook_deliveries SET tries = CASE WHEN status = 'pending' THEN tries ELSE 0 END, status = 'pending', \
             next_at = ?, lease_token = NULL WHERE id = ?",
        )
        .bind(self.clock.now_ms())
        .bind(id)
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        self.bell.ring_for_deliveries();
        Ok(Redelivered::Yes)
    }

    async fn claim_delivery(&self, lease: Duration, most: u32) -> Result<Option<DueDelivery>, StoreError> {
        let now = self.clock.now_ms();
        // Most rounds find nothing, and need not take the write lock to see that.
        let waiting: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM webhook_deliveries WHERE status = 'pending' AND next_at <= ?)",
        )
        .bind(now)
        .fetch_one(&self.reader)
        .await?;
        if !waiting {
            return Ok(None);
        }
        let token = Uuid::new_v4().simple().to_string();
        // The tenants that wait are found by leaps through the index, not by a look at every delivery.
        let claimed: Option<String> = sqlx::query_scalar(
            "UPDATE webhook_deliveries SET tries = tries + 1, lease_token = ?2, next_at = ?1 + ?3 \
             WHERE id = ( \
                 WITH RECURSIVE waiting (tenant) AS ( \
                     SELECT min(tenant) FROM webhook_deliveries WHERE status = 'pending' \
                     UNION ALL \
                     SELECT (SELECT min(tenant) FROM webhook_deliveries WHERE status = 'pending' AND tenant > waiting.tenant) \
                     FROM waiting WHERE tenant IS NOT NULL), \
                 turns AS ( \
                     SELECT (SELECT count(*) FROM webhook_deliveries d \
                             WHERE lease_token IS NOT NULL AND d.tenant = waiting.tenant AND next_at > ?1) AS under_way, \
                            (SELECT id FROM webhook_deliveries d \
                             WHERE status = 'pending' AND d.tenant = waiting.tenant AND next_at <= ?1 \
                             ORDER BY next_at, id LIMIT 1) AS next \
                     FROM waiting WHERE tenant IS NOT NULL) \
                 SELECT next FROM turns WHERE next IS NOT NULL AND under_way < ?4 ORDER BY under_way, next LIMIT 1) \
             RETURNING id",
        )
        .bind(now)
        .bind(&token)
        .bind(millis(lease))
        .bind(most)
        .fetch_all(&self.writer)
        .await?
        .pop();
        let Some(id) = claimed else { return Ok(None) };
        let row = sqlx::query(
            "SELECT d.id, d.tenant, d.endpoint_id, coalesce(e.url, d.url) AS url, d.message_id, m.payload, d.tries, d.attempts, \
                    coalesce(e.secret, s.secret) AS secret, coalesce(e.old_secret, s.old_secret) AS old_secret, \
                    coalesce(e.old_secret_until, s.old_secret_until) AS old_secret_until \
             FROM webhook_deliveries d JOIN webhook_messages m ON m.id = d.message_id \
                  LEFT JOIN webhook_endpoints e ON e.id = d.endpoint_id \
                  LEFT JOIN callback_secrets s ON s.tenant = d.tenant AND d.endpoint_id IS NULL \
             WHERE d.id = ? AND d.lease_token = ?",
        )
        .bind(id)
        .bind(&token)
        .fetch_optional(&self.reader)
        .await?;
        row.as_ref().map(|row| read_due(row, token)).transpose()
    }

    async fn settle_delivery(&self, due: &DueDelivery, attempt: Attempt, verdict: Verdict) -> Result<bool, StoreError> {
        let now = self.clock.now_ms();
        let retry_at = if let Verdict::Again(after) = verdict { Some(now + millis(after)) } else { None };
        let mut transaction = self.begin().await?;
        let settled = sqlx::query(
            "UPDATE webhook_deliveries SET status = ?, next_at = coalesce(?, next_at), attempts = ?, lease_token = NULL \
             WHERE id = ? AND lease_token = ?",
        )
        .bind(verdict.status().as_str())
        .bind(retry_at)
        .bind(to_json(&due.attempts_with(attempt)))
        .bind(&due.id)
        .bind(&due.token)
        .execute(&mut *transaction)
        .await?;
        let Some(endpoint) = due.endpoint.as_ref().filter(|_| settled.rows_affected() == 1) else {
            transaction.commit().await?;
            return Ok(false);
        };
        let failing_since: Option<i64> = sqlx::query_scalar(
            "UPDATE webhook_endpoints SET failing_since = CASE WHEN ?2 THEN NULL ELSE coalesce(failing_since, ?1) END \
             WHERE id = ?3 RETURNING failing_since",
        )
        .bind(now)
        .bind(verdict == Verdict::Delivered)
        .bind(endpoint)
        .fetch_optional(&mut *transaction)
        .await?
        .flatten();
        let long = failing_since.is_some_and(|since| since <= now - millis(FAILING));
        let disabled = match verdict.ends_endpoint(long) {
            Some(reason) => disable(&mut transaction, endpoint, reason, now).await?,
            None => false,
        };
        transaction.commit().await?;
        Ok(disabled)
    }

    async fn backlog(&self) -> Result<Backlog, StoreError> {
        let (pending, oldest): (i64, Option<i64>) =
            sqlx::query_as("SELECT count(*), min(next_at) FROM webhook_deliveries WHERE status = 'pending'")
                .fetch_one(&self.reader)
                .await?;
        Ok(Backlog::of(pending, oldest.map(|oldest| self.clock.now_ms() - oldest)))
    }

    async fn forget_messages(&self, age: Duration) -> Result<u64, StoreError> {
        let gone = sqlx::query("DELETE FROM webhook_messages WHERE created_at <= ?")
            .bind(self.clock.now_ms() - millis(age))
            .execute(&self.writer)
            .await?;
        Ok(gone.rows_affected())
    }
}

/// Disables an endpoint and gives up what waits for it. False if it was disabled before.
async fn disable(connection: &mut SqliteConnection, id: &str, reason: &str, now: i64) -> Result<bool, StoreError> {
    let disabled = sqlx::query(
        "UPDATE webhook_endpoints SET disabled_at = ?, disabled_reason = ? WHERE id = ? AND disabled_at IS NULL",
    )
    .bind(now)
    .bind(reason)
    .bind(id)
    .execute(&mut *connection)
    .await?;
    give_up(connection, id).await?;
    Ok(disabled.rows_affected() == 1)
}

/// Gives up what waits for an endpoint.
async fn give_up(connection: &mut SqliteConnection, endpoint: &str) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE webhook_deliveries SET status = 'failed', lease_token = NULL WHERE endpoint_id = ? AND status = 'pending'",
    )
    .bind(endpoint)
    .execute(connection)
    .await?;
    Ok(())
}
