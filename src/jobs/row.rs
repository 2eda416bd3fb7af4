use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::{ColumnIndex, Decode, Row, Type};
use time::OffsetDateTime;

use super::{Input, Job, StoreError};

pub(super) fn millis(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX / 4)
}

pub(super) fn to_millis(time: OffsetDateTime) -> i64 {
    i64::try_from(time.unix_timestamp_nanos() / 1_000_000).unwrap_or(i64::MAX)
}

/// Time that has passed, none where it is to come.
pub(super) fn elapsed(millis: i64) -> Duration {
    Duration::from_millis(u64::try_from(millis).unwrap_or(0))
}

pub(super) fn from_millis(stored: i64) -> Result<OffsetDateTime, time::error::ComponentRange> {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(stored) * 1_000_000)
}

pub(super) fn count(stored: i64) -> u32 {
    u32::try_from(stored).unwrap_or(0)
}

/// The moment that so many milliseconds since the Unix epoch are, of a row's column.
pub(super) fn time(id: &str, column: &'static str, stored: i64) -> Result<OffsetDateTime, StoreError> {
    from_millis(stored).map_err(|e| corrupt(id, column, e))
}

/// JSON of a type of this crate, none of which can fail to be written.
pub(super) fn to_json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

pub(super) fn corrupt(id: &str, column: &'static str, reason: impl ToString) -> StoreError {
    StoreError::Corrupt { id: id.to_owned(), column, reason: reason.to_string() }
}

/// The columns of a job in the order that does not matter, for `SELECT` and `RETURNING`; with something else in place of its
/// report where that is not wanted.
macro_rules! job_columns {
    () => {
        job_columns!("report")
    };
    ($report:literal) => {
        concat!(
            "id, tenant, made_by, status, outcome, attempt, crashes, created_at, run_at, started_at, finished_at, progress, inputs, \
             options, metadata, callback_url, reused_from, ",
            $report,
            ", artifacts, problem, traceparent, version, purged_at"
        )
    };
}
pub(super) use job_columns;

/// Reads a job from a row of [`job_columns`].
pub(super) fn read_job<R: Row>(row: &R) -> Result<Job, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    let id: String = row.try_get("id")?;
    let time = |column: &'static str| -> Result<Option<OffsetDateTime>, StoreError> {
        let stored: Option<i64> = row.try_get(column)?;
        stored.map(|stored| self::time(&id, column, stored)).transpose()
    };
    let moment = |column| time(column)?.ok_or_else(|| corrupt(&id, column, "no time"));
    let status: String = row.try_get("status")?;
    Ok(Job {
        status: status.parse().map_err(|()| corrupt(&id, "status", &status))?,
        outcome: json(row, &id, "outcome")?,
        progress: json(row, &id, "progress")?,
        attempt: count(row.try_get("attempt")?),
        crashes: count(row.try_get("crashes")?),
        created_at: moment("created_at")?,
        run_at: moment("run_at")?,
        started_at: time("started_at")?,
        finished_at: time("finished_at")?,
        inputs: json::<Vec<Input>, R>(row, &id, "inputs")?
            .filter(|inputs| !inputs.is_empty())
            .ok_or_else(|| corrupt(&id, "inputs", "no file"))?,
        options: json(row, &id, "options")?.ok_or_else(|| corrupt(&id, "options", "null"))?,
        tenant: row.try_get("tenant")?,
        made_by: row.try_get("made_by")?,
        metadata: json(row, &id, "metadata")?.unwrap_or_default(),
        callback_url: row.try_get("callback_url")?,
        reused_from: row
            .try_get::<Option<String>, _>("reused_from")?
            .map(|from| from.parse().map_err(|_| corrupt(&id, "reused_from", "no job id")))
            .transpose()?,
        report: json(row, &id, "report")?,
        artifacts: json(row, &id, "artifacts")?.unwrap_or_default(),
        problem: json(row, &id, "problem")?,
        traceparent: row.try_get("traceparent")?,
        version: row.try_get("version")?,
        purged: row.try_get::<Option<i64>, _>("purged_at")?.is_some(),
        id: id.parse().map_err(|_| corrupt(&id, "id", "no job id"))?,
    })
}

fn json<T: DeserializeOwned, R: Row>(row: &R, id: &str, column: &'static str) -> Result<Option<T>, StoreError>
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
{
    let text: Option<String> = row.try_get(column)?;
    text.map(|text| serde_json::from_str(&text).map_err(|e| corrupt(id, column, e))).transpose()
}
