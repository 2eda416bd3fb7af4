use std::time::Duration;

use async_trait::async_trait;
use uuid::Uuid;

use super::endpoints::disable;
use super::{Dialect, SqlConnection, SqlStore, outbox, sql};
use crate::jobs::row::{Columns, corrupt, millis, time, to_json};
use crate::jobs::webhooks::{
    Attempt, Backlog, Delivery, DeliveryQuery, DeliveryStore, DueDelivery, FAILING, Message, Receiver, Redelivered,
    Verdict, delivery_columns, read_delivery, read_due,
};
use crate::jobs::{Page, StoreError};

#[async_trait]
impl<D: Dialect> DeliveryStore for SqlStore<D> {
    async fn send_ping(&self, tenant: &str, endpoint: &str) -> Result<Option<String>, StoreError> {
        let now = self.now();
        let mut transaction = self.begin().await?;
        // Locked, so that the endpoint is not deleted before its delivery is written.
        let enabled = sql("SELECT meshmend_now($3) AS now FROM webhook_endpoints \
             WHERE tenant = $1 AND id = $2 AND disabled_at IS NULL FOR KEY SHARE");
        let row = transaction.query_row(enabled.bind(tenant).bind(endpoint).bind(now)).await?;
        let Some(row) = row else { return Ok(None) };
        let at = row.number("now")?.ok_or_else(|| corrupt(endpoint, "now", "null"))?;
        let message = Message::ping(endpoint, time(endpoint, "created_at", at)?);
        outbox::add_message(&mut *transaction, &message, now).await?;
        let receiver = Receiver { endpoint: Some(endpoint), url: None };
        let id = outbox::add_delivery(&mut *transaction, tenant, &message, &receiver, now).await?;
        transaction.commit().await?;
        self.notify_deliveries();
        Ok(Some(id))
    }

    async fn deliveries(&self, query: DeliveryQuery) -> Result<Page<Delivery, String>, StoreError> {
        let statement = sql(concat!(
            "SELECT ",
            delivery_columns!(),
            " FROM webhook_deliveries d JOIN webhook_messages m ON m.id = d.message_id \
             WHERE d.tenant = $1 AND ($2 IS NULL OR d.id = $2) AND ($3 IS NULL OR d.endpoint_id = $3) \
               AND ($4 IS NULL OR m.job_id = $4) AND ($5 IS NULL OR d.id < $5) ORDER BY d.id DESC LIMIT $6"
        ))
        .bind(&query.tenant)
        .bind(&query.id)
        .bind(&query.endpoint)
        .bind(query.job)
        .bind(&query.before)
        .bind(i64::from(query.limit) + 1);
        let rows = self.reader().await?.query(statement).await?;
        let deliveries = rows.iter().map(read_delivery).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(deliveries, query.limit, |delivery| delivery.id.clone()))
    }

    async fn redeliver(&self, tenant: &str, id: &str) -> Result<Redelivered, StoreError> {
        let mut transaction = self.begin().await?;
        let endpoint = sql(
            "SELECT e.disabled_at FROM webhook_deliveries d LEFT JOIN webhook_endpoints e ON e.id = d.endpoint_id \
             WHERE d.tenant = $1 AND d.id = $2",
        );
        let row = transaction.query_row(endpoint.bind(tenant).bind(id)).await?;
        let Some(row) = row else { return Ok(Redelivered::Unknown) };
        if row.number("disabled_at")?.is_some() {
            return Ok(Redelivered::Disabled);
        }
        // A courier that holds the delivery loses it, because the request is newer.
        let statement = sql(
            "UPDATE webhook_deliveries SET tries = CASE WHEN status = 'pending' THEN tries ELSE 0 END, status = 'pending', \
             next_at = meshmend_now($1), lease_token = NULL WHERE id = $2",
        );
        transaction.execute(statement.bind(self.now()).bind(id)).await?;
        transaction.commit().await?;
        self.notify_deliveries();
        Ok(Redelivered::Yes)
    }

    async fn claim_delivery(&self, lease: Duration, most: u32) -> Result<Option<DueDelivery>, StoreError> {
        // Recursion finds the tenants with pending deliveries by steps through the index, without reading every delivery.
        let turns = sql("WITH RECURSIVE waiting (tenant) AS ( \
                 SELECT min(tenant) FROM webhook_deliveries WHERE status = 'pending' \
                 UNION ALL \
                 SELECT (SELECT min(tenant) FROM webhook_deliveries WHERE status = 'pending' AND tenant > waiting.tenant) \
                 FROM waiting WHERE tenant IS NOT NULL), \
             turns AS ( \
                 SELECT tenant, \
                        (SELECT count(*) FROM webhook_deliveries d \
                         WHERE lease_token IS NOT NULL AND d.tenant = waiting.tenant AND next_at > meshmend_now($1)) AS under_way, \
                        (SELECT id FROM webhook_deliveries d \
                         WHERE status = 'pending' AND d.tenant = waiting.tenant AND next_at <= meshmend_now($1) \
                         ORDER BY next_at, id LIMIT 1) AS next \
                 FROM waiting WHERE tenant IS NOT NULL) \
             SELECT tenant FROM turns WHERE next IS NOT NULL AND under_way < $2 ORDER BY under_way, next");
        let turns = self.reader().await?.query(turns.bind(self.now()).bind(most)).await?;
        for turn in turns {
            // Counted again, since another claim may have come between.
            let token = Uuid::new_v4().simple().to_string();
            let claim = sql(
                "UPDATE webhook_deliveries SET tries = tries + 1, lease_token = $1, next_at = meshmend_now($2) + $3 \
                 WHERE id = (SELECT id FROM webhook_deliveries \
                             WHERE status = 'pending' AND tenant = $4 AND next_at <= meshmend_now($2) \
                             ORDER BY next_at, id LIMIT 1 FOR UPDATE SKIP LOCKED) \
                   AND (SELECT count(*) FROM webhook_deliveries \
                        WHERE lease_token IS NOT NULL AND tenant = $4 AND next_at > meshmend_now($2)) < $5 \
                 RETURNING id",
            )
            .bind(&token)
            .bind(self.now())
            .bind(millis(lease))
            .bind(turn.text("tenant")?)
            .bind(most);
            let claimed = self.writer().await?.query_row(claim).await?;
            if let Some(claimed) = claimed {
                return self.claimed_delivery(claimed.text("id")?, token).await;
            }
        }
        Ok(None)
    }

    async fn settle_delivery(&self, due: &DueDelivery, attempt: Attempt, verdict: Verdict) -> Result<bool, StoreError> {
        let now = self.now();
        let retry_in = if let Verdict::Again(after) = verdict { Some(millis(after)) } else { None };
        let mut transaction = self.begin().await?;
        // The endpoint is always locked before its deliveries, which prevents deadlocks.
        let endpoint = sql(
            "UPDATE webhook_endpoints SET failing_since = CASE WHEN $2 THEN NULL ELSE coalesce(failing_since, meshmend_now($1)) END \
             WHERE id = $3 AND EXISTS (SELECT 1 FROM webhook_deliveries WHERE id = $4 AND lease_token = $5) \
             RETURNING meshmend_now($1) - failing_since AS failing",
        )
        .bind(now)
        .bind(verdict == Verdict::Delivered)
        .bind(&due.endpoint)
        .bind(&due.id)
        .bind(&due.token);
        let row = transaction.query_row(endpoint).await?;
        let failing = row.map(|row| row.number("failing")).transpose()?.flatten();
        let delivery = sql(
            "UPDATE webhook_deliveries SET status = $1, next_at = coalesce(meshmend_now($2) + $3, next_at), attempts = $4, \
             lease_token = NULL WHERE id = $5 AND lease_token = $6",
        )
        .bind(verdict.status().as_str())
        .bind(now)
        .bind(retry_in)
        .bind(to_json(&due.attempts_with(attempt)))
        .bind(&due.id)
        .bind(&due.token);
        let is_settled = transaction.execute(delivery).await? == 1;
        let is_failing_long = failing.is_some_and(|failing| failing >= millis(FAILING));
        let endpoint = due.endpoint.as_ref().filter(|_| is_settled);
        let disabled = match endpoint.zip(verdict.ends_endpoint(is_failing_long)) {
            Some((endpoint, reason)) => disable(&mut *transaction, endpoint, reason, now).await?,
            None => false,
        };
        transaction.commit().await?;
        Ok(disabled)
    }

    async fn backlog(&self) -> Result<Backlog, StoreError> {
        let statement = sql(
            "SELECT count(*) AS pending, meshmend_now($1) - min(next_at) AS overdue FROM webhook_deliveries WHERE status = 'pending'",
        );
        let row = self.reader().await?.query_row(statement.bind(self.now())).await?;
        let row = row.ok_or(sqlx::Error::RowNotFound)?;
        Ok(Backlog::of(row.number("pending")?.unwrap_or(0), row.number("overdue")?))
    }

    async fn forget_messages(&self, age: Duration) -> Result<u64, StoreError> {
        let statement = sql("DELETE FROM webhook_messages WHERE created_at <= meshmend_now($1) - $2");
        self.writer().await?.execute(statement.bind(self.now()).bind(millis(age))).await
    }
}

impl<D: Dialect> SqlStore<D> {
    /// The delivery that was claimed with this token, unless it was deleted meanwhile.
    async fn claimed_delivery(&self, id: Option<String>, token: String) -> Result<Option<DueDelivery>, StoreError> {
        let statement = sql(
            "SELECT d.id, d.tenant, d.endpoint_id, coalesce(e.url, d.url) AS url, d.message_id, m.payload, d.tries, d.attempts, \
                    coalesce(e.secret, s.secret) AS secret, coalesce(e.old_secret, s.old_secret) AS old_secret, \
                    coalesce(e.old_secret_until, s.old_secret_until) AS old_secret_until \
             FROM webhook_deliveries d JOIN webhook_messages m ON m.id = d.message_id \
                  LEFT JOIN webhook_endpoints e ON e.id = d.endpoint_id \
                  LEFT JOIN callback_secrets s ON s.tenant = d.tenant AND d.endpoint_id IS NULL \
             WHERE d.id = $1 AND d.lease_token = $2",
        );
        let row = self.reader().await?.query_row(statement.bind(id).bind(&token)).await?;
        row.as_ref().map(|row| read_due(row, token)).transpose()
    }
}
