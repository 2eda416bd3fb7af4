//! The messages about a job's end, written in the transaction that ends it.

use super::{SqlConnection, sql};
use crate::jobs::row::Columns;
use crate::jobs::webhooks::{JobEvent, Message, Receiver, new_id};
use crate::jobs::{Job, JobId, StoreError};

/// Writes a message and its deliveries if the job has ended and has receivers. Returns whether it has.
pub(super) async fn record_end(
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
    let message = Message::of_job(event, job);
    add_message(connection, &message, now).await?;
    for receiver in receivers {
        add_delivery(connection, &job.tenant, &message, &receiver, now).await?;
    }
    Ok(true)
}

/// Writes a message that has no delivery yet.
pub(super) async fn add_message(
    connection: &mut impl SqlConnection,
    message: &Message,
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

/// Writes the delivery of a message to one receiver, due at once. Returns the delivery's name.
pub(super) async fn add_delivery(
    connection: &mut impl SqlConnection,
    tenant: &str,
    message: &Message,
    receiver: &Receiver<'_>,
    now: Option<i64>,
) -> Result<String, StoreError> {
    let id = new_id("whd");
    let statement = sql("INSERT INTO webhook_deliveries (id, message_id, tenant, endpoint_id, url, status, next_at) \
         VALUES ($1, $2, $3, $4, $5, 'pending', meshmend_now($6))")
    .bind(&id)
    .bind(&message.id)
    .bind(tenant)
    .bind(receiver.endpoint)
    .bind(receiver.url)
    .bind(now);
    connection.execute(statement).await?;
    Ok(id)
}

/// Deletes the messages about a job, delivered or not.
pub(super) async fn delete_messages(connection: &mut impl SqlConnection, job: JobId) -> Result<(), StoreError> {
    connection.execute(sql("DELETE FROM webhook_messages WHERE job_id = $1").bind(job)).await?;
    Ok(())
}
