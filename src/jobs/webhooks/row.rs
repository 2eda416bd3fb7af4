use super::{Delivery, DueDelivery, Endpoint, JobEvent, Secrets, SigningSecret};
use crate::jobs::StoreError;
use crate::jobs::row::{Columns, Reader, corrupt};

/// The columns of an endpoint, for `SELECT` and `RETURNING`.
macro_rules! endpoint_columns {
    () => {
        "id, url, description, events, secret, old_secret, old_secret_until, created_at, failing_since, disabled_at, \
         disabled_reason"
    };
}
pub(in crate::jobs) use endpoint_columns;

/// The columns of a delivery `d` of a message `m`, for `SELECT`.
macro_rules! delivery_columns {
    () => {
        "d.id, d.message_id, m.type AS kind, m.job_id, d.endpoint_id, d.url, d.status, d.attempts, m.created_at, d.next_at"
    };
}
pub(in crate::jobs) use delivery_columns;

fn secrets(from: &Reader<'_, impl Columns>) -> Result<Option<Secrets>, StoreError> {
    let Some(current) = from.some_text("secret")? else { return Ok(None) };
    let previous = from.some_text("old_secret")?.map(SigningSecret::new).zip(from.some_time("old_secret_until")?);
    Ok(Some(Secrets { current: SigningSecret::new(current), previous }))
}

/// Reads the secrets of a tenant's callbacks, its name as `id`.
pub(in crate::jobs) fn read_secrets(row: &impl Columns) -> Result<Secrets, StoreError> {
    let from = Reader::new(row)?;
    secrets(&from)?.ok_or_else(|| corrupt(&from.id, "secret", "none"))
}

/// Reads an endpoint from a row of [`endpoint_columns`].
pub(in crate::jobs) fn read_endpoint(row: &impl Columns) -> Result<Endpoint, StoreError> {
    let from = Reader::new(row)?;
    Ok(Endpoint {
        url: from.text("url")?,
        description: from.text("description")?,
        events: read_events(&from.text("events")?).collect(),
        secrets: secrets(&from)?.ok_or_else(|| corrupt(&from.id, "secret", "none"))?,
        created_at: from.time("created_at")?,
        failing_since: from.some_time("failing_since")?,
        disabled: from.some_time("disabled_at")?.zip(from.some_text("disabled_reason")?),
        id: from.id,
    })
}

/// Reads a delivery from a row of [`delivery_columns`].
pub(in crate::jobs) fn read_delivery(row: &impl Columns) -> Result<Delivery, StoreError> {
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

/// Reads a delivery that was claimed with this token.
pub(in crate::jobs) fn read_due(row: &impl Columns, token: String) -> Result<DueDelivery, StoreError> {
    let from = Reader::new(row)?;
    Ok(DueDelivery {
        token,
        tenant: from.text("tenant")?,
        endpoint: from.some_text("endpoint_id")?,
        url: from.text("url")?,
        message: from.text("message_id")?,
        payload: from.text("payload")?,
        secrets: secrets(&from)?,
        tries: from.count("tries")?,
        attempts: from.json("attempts")?,
        id: from.id,
    })
}

/// Events as a column keeps them.
pub(in crate::jobs) fn names(events: &[JobEvent]) -> String {
    events.iter().map(|event| event.as_str()).collect::<Vec<_>>().join(",")
}

/// The events in a column of them; those of a later version are passed over.
pub(super) fn read_events(column: &str) -> impl Iterator<Item = JobEvent> + '_ {
    column.split(',').filter_map(|name| name.parse().ok())
}
