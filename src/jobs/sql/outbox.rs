//! The outbox: the messages about a job's end, written in the transaction that ends it, and their deliveries.

use std::time::Duration;

use async_trait::async_trait;
use serde::Serialize;
use time::OffsetDateTime;

use super::statement::{Columns, Reader, SqlConnection, corrupt, millis, sql, time, to_json};
use super::store::{Dialect, SqlStore};
use super::tenants::{disable, read_events, read_signing_secrets};
use crate::jobs::error::StoreError;
use crate::jobs::id::JobId;
use crate::jobs::job::Job;
use crate::jobs::store::{DeliveryStore, Page, RedeliveryResult};
use crate::jobs::webhooks::{
    Backlog, Delivery, DeliveryAttempt, DeliveryQuery, DeliveryResult, DueDelivery, FAILING, JobEvent, JobMessage,
};

/// The type of a test message.
const PING: &str = "ping";

/// The columns of a delivery `d` of a message `m`, for `SELECT`.
macro_rules! delivery_columns {
    () => {
        "d.id, d.message_id, m.type AS kind, m.job_id, d.endpoint_id, d.url, d.status, d.attempts, m.created_at, d.next_at"
    };
}

/// A webhook message to store.
struct Message<'a> {
    /// The message's id: `msg_` and a UUID.
    id: String,
    tenant: &'a str,
    /// The job that the message is about.
    job: Option<JobId>,
    /// The message's type.
    kind: &'static str,
    /// The body, to send byte for byte.
    payload: String,
}

/// The receiver of a message: an endpoint, or a job's callback address.
struct Receiver<'a> {
    endpoint: Option<&'a str>,
    url: Option<&'a str>,
}

impl<'a> Receiver<'a> {
    /// The receivers of an event of `job`. `endpoints` are the ids of the tenant's endpoints, each with its events.
    fn of_job(event: JobEvent, job: &'a Job, endpoints: &'a [(String, String)]) -> Vec<Self> {
        let subscribers =
            endpoints.iter().filter(|(_, events)| read_events(events).any(|subscribed| subscribed == event));
        let subscribers = subscribers.map(|(id, _)| Self { endpoint: Some(id), url: None });
        subscribers.chain(job.callback_url.as_deref().map(|url| Self { endpoint: None, url: Some(url) })).collect()
    }
}

/// A test message.
#[derive(Serialize)]
struct Ping<'a> {
    r#type: &'static str,
    #[serde(with = "crate::jobs::timestamp")]
    timestamp: OffsetDateTime,
    data: PingData<'a>,
}

#[derive(Serialize)]
struct PingData<'a> {
    endpoint: &'a str,
}

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
        let data = PingData { endpoint };
        let payload = to_json(&Ping { r#type: PING, timestamp: time(endpoint, "created_at", at)?, data });
        let message = Message { id: self.new_id("msg"), tenant, job: None, kind: PING, payload };
        add_message(&mut *transaction, &message, now).await?;
        let receiver = Receiver { endpoint: Some(endpoint), url: None };
        let id = self.add_delivery(&mut *transaction, &message, &receiver, now).await?;
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
        let deliveries = self.read_all(statement, read_delivery).await?;
        Ok(Page::of(deliveries, query.limit, |delivery| delivery.id.clone()))
    }

    async fn redeliver(&self, tenant: &str, id: &str) -> Result<RedeliveryResult, StoreError> {
        let mut transaction = self.begin().await?;
        let endpoint = sql(
            "SELECT e.disabled_at FROM webhook_deliveries d LEFT JOIN webhook_endpoints e ON e.id = d.endpoint_id \
             WHERE d.tenant = $1 AND d.id = $2",
        );
        let row = transaction.query_row(endpoint.bind(tenant).bind(id)).await?;
        let Some(row) = row else { return Ok(RedeliveryResult::Unknown) };
        if row.number("disabled_at")?.is_some() {
            return Ok(RedeliveryResult::Disabled);
        }
        // A dispatcher that holds the delivery loses its lease, because this request is newer.
        let statement = sql(
            "UPDATE webhook_deliveries SET tries = CASE WHEN status = 'pending' THEN tries ELSE 0 END, status = 'pending', \
             next_at = meshmend_now($1), lease_token = NULL WHERE id = $2",
        );
        transaction.execute(statement.bind(self.now()).bind(id)).await?;
        transaction.commit().await?;
        self.notify_deliveries();
        Ok(RedeliveryResult::Due)
    }

    async fn claim_delivery(&self, lease: Duration, max: u32) -> Result<Option<DueDelivery>, StoreError> {
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
        let turns = self.reader().await?.query(turns.bind(self.now()).bind(max)).await?;
        for turn in turns {
            // The claim counts again, since another claim may have come first.
            let token = self.new_token();
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
            .bind(max);
            let claimed = self.writer().await?.query_row(claim).await?;
            if let Some(claimed) = claimed {
                return self.claimed_delivery(claimed.text("id")?, token).await;
            }
        }
        Ok(None)
    }

    async fn settle_delivery(
        &self,
        due: &DueDelivery,
        attempt: DeliveryAttempt,
        result: DeliveryResult,
    ) -> Result<bool, StoreError> {
        let now = self.now();
        let retry_in = if let DeliveryResult::RetryAfter(after) = result { Some(millis(after)) } else { None };
        let mut transaction = self.begin().await?;
        // The endpoint is always locked before its deliveries, which prevents deadlocks.
        let endpoint = sql(
            "UPDATE webhook_endpoints SET failing_since = CASE WHEN $2 THEN NULL ELSE coalesce(failing_since, meshmend_now($1)) END \
             WHERE id = $3 AND EXISTS (SELECT 1 FROM webhook_deliveries WHERE id = $4 AND lease_token = $5) \
             RETURNING meshmend_now($1) - failing_since AS failing",
        )
        .bind(now)
        .bind(result == DeliveryResult::Delivered)
        .bind(&due.endpoint)
        .bind(&due.id)
        .bind(&due.token);
        let row = transaction.query_row(endpoint).await?;
        let failing = row.map(|row| row.number("failing")).transpose()?.flatten();
        let delivery = sql(
            "UPDATE webhook_deliveries SET status = $1, next_at = coalesce(meshmend_now($2) + $3, next_at), attempts = $4, \
             lease_token = NULL WHERE id = $5 AND lease_token = $6",
        )
        .bind(result.status().as_str())
        .bind(now)
        .bind(retry_in)
        .bind(to_json(&due.attempts_with(attempt)))
        .bind(&due.id)
        .bind(&due.token);
        let is_settled = transaction.execute(delivery).await? == 1;
        let is_failing_long = failing.is_some_and(|failing| failing >= millis(FAILING));
        let endpoint = due.endpoint.as_ref().filter(|_| is_settled);
        let disabled = match endpoint.zip(result.disable_reason(is_failing_long)) {
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
    /// Writes a message and its deliveries if the job has ended and has receivers. Returns whether it has.
    pub(super) async fn record_end(
        &self,
        connection: &mut impl SqlConnection,
        job: &Job,
        now: Option<i64>,
    ) -> Result<bool, StoreError> {
        let Some(event) = JobEvent::of(job.status) else { return Ok(false) };
        // Locked, so that no endpoint is deleted before its delivery is written.
        let endpoints = sql(
            "SELECT id, events FROM webhook_endpoints WHERE tenant = $1 AND disabled_at IS NULL ORDER BY id FOR KEY SHARE",
        );
        let mut subscribed = Vec::new();
        for row in connection.query(endpoints.bind(&job.tenant)).await? {
            subscribed.extend(row.text("id")?.zip(row.text("events")?));
        }
        let receivers = Receiver::of_job(event, job, &subscribed);
        if receivers.is_empty() {
            return Ok(false);
        }
        let (id, payload) = (self.new_id("msg"), to_json(&JobMessage::new(event, job)));
        let message = Message { id, tenant: &job.tenant, job: Some(job.id), kind: event.as_str(), payload };
        add_message(connection, &message, now).await?;
        for receiver in receivers {
            self.add_delivery(connection, &message, &receiver, now).await?;
        }
        Ok(true)
    }

    /// Adds the delivery of a message to one receiver, due at once. Returns the delivery's id.
    async fn add_delivery(
        &self,
        connection: &mut impl SqlConnection,
        message: &Message<'_>,
        receiver: &Receiver<'_>,
        now: Option<i64>,
    ) -> Result<String, StoreError> {
        let id = self.new_id("whd");
        let statement =
            sql("INSERT INTO webhook_deliveries (id, message_id, tenant, endpoint_id, url, status, next_at) \
             VALUES ($1, $2, $3, $4, $5, 'pending', meshmend_now($6))")
            .bind(&id)
            .bind(&message.id)
            .bind(message.tenant)
            .bind(receiver.endpoint)
            .bind(receiver.url)
            .bind(now);
        connection.execute(statement).await?;
        Ok(id)
    }

    /// The delivery that was claimed with this token; `None` if it was deleted since.
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
        self.read_one(statement.bind(id).bind(&token), |row| read_due(row, token.clone())).await
    }
}

/// Adds a message without deliveries.
async fn add_message(
    connection: &mut impl SqlConnection,
    message: &Message<'_>,
    now: Option<i64>,
) -> Result<(), StoreError> {
    let statement = sql(
        "INSERT INTO webhook_messages (id, job_id, type, payload, created_at) VALUES ($1, $2, $3, $4, meshmend_now($5))",
    )
    .bind(&message.id)
    .bind(message.job)
    .bind(message.kind)
    .bind(&message.payload)
    .bind(now);
    connection.execute(statement).await?;
    Ok(())
}

/// Deletes the messages about a job, delivered or not.
pub(super) async fn delete_messages(connection: &mut impl SqlConnection, job: JobId) -> Result<(), StoreError> {
    connection.execute(sql("DELETE FROM webhook_messages WHERE job_id = $1").bind(job)).await?;
    Ok(())
}

/// Reads a delivery from a row of [`delivery_columns`].
fn read_delivery(row: &impl Columns) -> Result<Delivery, StoreError> {
    let from = Reader::new(row)?;
    Ok(Delivery {
        message: from.text("message_id")?,
        kind: from.text("kind")?,
        job: from.some_parsed("job_id")?,
        endpoint: from.some_text("endpoint_id")?,
        url: from.some_text("url")?,
        status: from.parsed("status")?,
        attempts: from.json("attempts")?,
        created_at: from.time("created_at")?,
        next_at: from.time("next_at")?,
        id: from.id,
    })
}

/// Reads a claimed delivery; `token` is the claim's token.
fn read_due(row: &impl Columns, token: String) -> Result<DueDelivery, StoreError> {
    let from = Reader::new(row)?;
    Ok(DueDelivery {
        token,
        tenant: from.text("tenant")?,
        endpoint: from.some_text("endpoint_id")?,
        url: from.text("url")?,
        message: from.text("message_id")?,
        payload: from.text("payload")?,
        secrets: read_signing_secrets(&from)?,
        tries: from.count("tries")?,
        attempts: from.json("attempts")?,
        id: from.id,
    })
}
