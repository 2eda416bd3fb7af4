use serde::de::DeserializeOwned;
use sqlx::{ColumnIndex, Decode, Row, Type};
use time::OffsetDateTime;

use super::{Delivery, DueDelivery, Endpoint, JobEvent, Secrets, SigningSecret};
use crate::jobs::StoreError;
use crate::jobs::row::{corrupt, count, time};

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

/// Reads columns of one row, and says which one can't be read.
struct Reader<'a, R> {
    row: &'a R,
    id: String,
}

impl<'a, R: Row> Reader<'a, R>
where
    for<'b> &'b str: ColumnIndex<R>,
    for<'b> String: Decode<'b, R::Database> + Type<R::Database>,
    for<'b> i64: Decode<'b, R::Database> + Type<R::Database>,
{
    fn new(row: &'a R) -> Result<Self, StoreError> {
        Ok(Self { row, id: row.try_get("id")? })
    }

    fn text(&self, column: &'static str) -> Result<String, StoreError> {
        Ok(self.row.try_get(column)?)
    }

    fn some_text(&self, column: &'static str) -> Result<Option<String>, StoreError> {
        Ok(self.row.try_get(column)?)
    }

    fn some_time(&self, column: &'static str) -> Result<Option<OffsetDateTime>, StoreError> {
        let stored: Option<i64> = self.row.try_get(column)?;
        stored.map(|stored| time(&self.id, column, stored)).transpose()
    }

    fn time(&self, column: &'static str) -> Result<OffsetDateTime, StoreError> {
        self.some_time(column)?.ok_or_else(|| corrupt(&self.id, column, "no time"))
    }

    fn json<T: DeserializeOwned>(&self, column: &'static str) -> Result<T, StoreError> {
        serde_json::from_str(&self.text(column)?).map_err(|e| corrupt(&self.id, column, e))
    }

    fn secrets(&self) -> Result<Option<Secrets>, StoreError> {
        let Some(current) = self.some_text("secret")? else { return Ok(None) };
        let previous = self.some_text("old_secret")?.map(SigningSecret::new).zip(self.some_time("old_secret_until")?);
        Ok(Some(Secrets { current: SigningSecret::new(current), previous }))
    }
}

/// Reads the secrets of a tenant's callbacks, its name as `id`.
pub(in crate::jobs) fn read_secrets<R: Row>(row: &R) -> Result<Secrets, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let from = Reader::new(row)?;
    from.secrets()?.ok_or_else(|| corrupt(&from.id, "secret", "none"))
}

/// Reads an endpoint from a row of [`endpoint_columns`].
pub(in crate::jobs) fn read_endpoint<R: Row>(row: &R) -> Result<Endpoint, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let from = Reader::new(row)?;
    Ok(Endpoint {
        url: from.text("url")?,
        description: from.text("description")?,
        events: read_events(&from.text("events")?).collect(),
        secrets: from.secrets()?.ok_or_else(|| corrupt(&from.id, "secret", "none"))?,
        created_at: from.time("created_at")?,
        failing_since: from.some_time("failing_since")?,
        disabled: from.some_time("disabled_at")?.zip(from.some_text("disabled_reason")?),
        id: from.id,
    })
}

/// Reads a delivery from a row of [`delivery_columns`].
pub(in crate::jobs) fn read_delivery<R: Row>(row: &R) -> Result<Delivery, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let from = Reader::new(row)?;
    let job = from.some_text("job_id")?.map(|id| id.parse().map_err(|e| corrupt(&from.id, "job_id", e)));
    Ok(Delivery {
        message: from.text("message_id")?,
        kind: from.text("kind")?,
        job: job.transpose()?,
        endpoint: from.some_text("endpoint_id")?,
        url: from.some_text("url")?,
        status: from.text("status")?.parse().map_err(|()| corrupt(&from.id, "status", "unknown"))?,
        attempts: from.json("attempts")?,
        created_at: from.time("created_at")?,
        next_at: from.time("next_at")?,
        id: from.id,
    })
}

/// Reads a delivery that was claimed with this token.
pub(in crate::jobs) fn read_due<R: Row>(row: &R, token: String) -> Result<DueDelivery, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let from = Reader::new(row)?;
    Ok(DueDelivery {
        token,
        tenant: from.text("tenant")?,
        endpoint: from.some_text("endpoint_id")?,
        url: from.text("url")?,
        message: from.text("message_id")?,
        payload: from.text("payload")?,
        secrets: from.secrets()?,
        tries: count(row.try_get("tries")?),
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
