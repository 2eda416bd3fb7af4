use std::str::FromStr;
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

pub(super) fn count(stored: i64) -> u32 {
    u32::try_from(stored).unwrap_or(0)
}

/// The moment that so many milliseconds since the Unix epoch are, of a row's column.
pub(super) fn time(id: &str, column: &'static str, stored: i64) -> Result<OffsetDateTime, StoreError> {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(stored) * 1_000_000).map_err(|e| corrupt(id, column, e))
}

/// JSON of a type of this crate, none of which can fail to be written.
pub(super) fn to_json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

pub(super) fn corrupt(id: &str, column: &'static str, reason: impl ToString) -> StoreError {
    StoreError::Corrupt { id: id.to_owned(), column, reason: reason.to_string() }
}

/// The columns of a row of either database; none where a column is null.
pub trait Columns {
    fn text(&self, column: &str) -> Result<Option<String>, sqlx::Error>;
    fn number(&self, column: &str) -> Result<Option<i64>, sqlx::Error>;
}

impl<R: Row> Columns for R
where
    for<'a> &'a str: ColumnIndex<R>,
    for<'a> String: Decode<'a, R::Database> + Type<R::Database>,
    for<'a> i64: Decode<'a, R::Database> + Type<R::Database>,
{
    fn text(&self, column: &str) -> Result<Option<String>, sqlx::Error> {
        self.try_get(column)
    }

    fn number(&self, column: &str) -> Result<Option<i64>, sqlx::Error> {
        self.try_get(column)
    }
}

/// Reads the columns of one row, and names a column that can't be read in its error.
pub(super) struct Reader<'a, R> {
    row: &'a R,
    /// The value of the row's column `id`.
    pub id: String,
}

impl<'a, R: Columns> Reader<'a, R> {
    pub fn new(row: &'a R) -> Result<Self, StoreError> {
        let id = row.text("id")?.ok_or_else(|| corrupt("", "id", "null"))?;
        Ok(Self { row, id })
    }

    pub fn some_text(&self, column: &'static str) -> Result<Option<String>, StoreError> {
        Ok(self.row.text(column)?)
    }

    pub fn text(&self, column: &'static str) -> Result<String, StoreError> {
        self.there(column, self.row.text(column)?)
    }

    pub fn some_number(&self, column: &'static str) -> Result<Option<i64>, StoreError> {
        Ok(self.row.number(column)?)
    }

    pub fn number(&self, column: &'static str) -> Result<i64, StoreError> {
        self.there(column, self.row.number(column)?)
    }

    pub fn count(&self, column: &'static str) -> Result<u32, StoreError> {
        self.number(column).map(count)
    }

    pub fn some_time(&self, column: &'static str) -> Result<Option<OffsetDateTime>, StoreError> {
        self.row.number(column)?.map(|stored| time(&self.id, column, stored)).transpose()
    }

    pub fn time(&self, column: &'static str) -> Result<OffsetDateTime, StoreError> {
        self.there(column, self.some_time(column)?)
    }

    pub fn some_parsed<T: FromStr>(&self, column: &'static str) -> Result<Option<T>, StoreError> {
        let read = |text: String| text.parse().map_err(|_| corrupt(&self.id, column, format!("'{text}' is none")));
        self.row.text(column)?.map(read).transpose()
    }

    pub fn parsed<T: FromStr>(&self, column: &'static str) -> Result<T, StoreError> {
        self.there(column, self.some_parsed(column)?)
    }

    pub fn some_json<T: DeserializeOwned>(&self, column: &'static str) -> Result<Option<T>, StoreError> {
        let read = |text: String| serde_json::from_str(&text).map_err(|e| corrupt(&self.id, column, e));
        self.row.text(column)?.map(read).transpose()
    }

    pub fn json<T: DeserializeOwned>(&self, column: &'static str) -> Result<T, StoreError> {
        self.there(column, self.some_json(column)?)
    }

    fn there<T>(&self, column: &'static str, value: Option<T>) -> Result<T, StoreError> {
        value.ok_or_else(|| corrupt(&self.id, column, "null"))
    }
}

/// The columns of a job, for `SELECT` and `RETURNING`; with another expression in place of the report where a caller does not need it.
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
pub(super) fn read_job(row: &impl Columns) -> Result<Job, StoreError> {
    let from = Reader::new(row)?;
    let inputs: Vec<Input> = from.json("inputs")?;
    if inputs.is_empty() {
        return Err(corrupt(&from.id, "inputs", "no file"));
    }
    Ok(Job {
        id: from.parsed("id")?,
        tenant: from.text("tenant")?,
        made_by: from.some_text("made_by")?,
        status: from.parsed("status")?,
        outcome: from.some_json("outcome")?,
        progress: from.some_json("progress")?,
        attempt: from.count("attempt")?,
        crashes: from.count("crashes")?,
        created_at: from.time("created_at")?,
        run_at: from.time("run_at")?,
        started_at: from.some_time("started_at")?,
        finished_at: from.some_time("finished_at")?,
        inputs,
        options: from.json("options")?,
        metadata: from.some_json("metadata")?.unwrap_or_default(),
        callback_url: from.some_text("callback_url")?,
        reused_from: from.some_parsed("reused_from")?,
        report: from.some_json("report")?,
        artifacts: from.some_json("artifacts")?.unwrap_or_default(),
        problem: from.some_json("problem")?,
        traceparent: from.some_text("traceparent")?,
        version: from.number("version")?,
        purged: from.some_number("purged_at")?.is_some(),
    })
}
