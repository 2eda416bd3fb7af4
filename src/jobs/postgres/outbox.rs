//! What is told of a job's end, written in the transaction that ends it.

use sqlx::PgConnection;

use crate::jobs::webhooks::{JobEvent, Message, Receiver, new_id};
use crate::jobs::{Job, StoreError};

/// Notes a message for everybody who is to be told that the job has ended, if it has.
pub(super) async fn note(connection: &mut PgConnection, job: &Job, now: Option<i64>) -> Result<(), StoreError> {
    let Some(event) = JobEvent::of(job.status) else { return Ok(()) };
    // Held, so that none is deleted before its delivery is noted.
    let endpoints: Vec<(String, String)> = sqlx::query_as(
        "SELECT id, events FROM webhook_endpoints WHERE tenant = $1 AND disabled_at IS NULL ORDER BY id FOR KEY SHARE",
    )
    .bind(&job.tenant)
    .fetch_all(&mut *connection)
    .await?;
    let receivers = Receiver::of_job(event, job, &endpoints);
    if receivers.is_empty() {
        return Ok(());
    }
    let message = Message::of_job(event, job);
    write(connection, &message, now).await?;
    for receiver in receivers {
        address(connection, &job.tenant, &message, &receiver, now).await?;
    }
    Ok(())
}

/// Writes a message that nobody gets yet.
pub(super) async fn write(
    connection: &mut PgConnection,
    message: &Message,
    now: Option<i64>,
) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO webhook_messages (id, job_id, type, payload, created_at) VALUES ($1, $2, $3, $4, meshmend_now($5))")
        .bind(&message.id)
        .bind(message.job.map(|id| id.to_string()))
        .bind(message.kind)
        .bind(&message.payload)
        .bind(now)
        .execute(connection)
        .await?;
    Ok(())
}

/// Puts a message in the outbox for one receiver, due at once. Gives the delivery's name.
pub(super) async fn address(
    connection: &mut PgConnection,
    tenant: &str,
    message: &Message,
    receiver: &Receiver<'_>,
    now: Option<i64>,
) -> Result<String, StoreError> {
    let id = new_id("whd");
    sqlx::query(
        "INSERT INTO webhook_deliveries (id, message_id, tenant, endpoint_id, url, status, next_at) \
         VALUES ($1, $2, $3, $4, $5, 'pending', meshmend_now($6))",
    )
    .bind(&id)
    .bind(&message.id)
    .bind(tenant)
    .bind(receiver.endpoint)
    .bind(receiver.url)
    .bind(now)
    .execute(connection)
    .await?;
    Ok(id)
}

/// Forgets what is told of a job, whether it was delivered or not.
pub(super) async fn forget(connection: &mut PgConnection, job: &str) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM webhook_messages WHERE job_id = $1").bind(job).execute(connection).await?;
    Ok(())
}
