//! SQL statements with the values of their parameters, the connections that run them, and the rows that they return.

use std::borrow::Cow;
use std::str::FromStr;
use std::time::Duration;

use futures::future::BoxFuture;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::query::Query;
use sqlx::{Arguments, AssertSqlSafe, ColumnIndex, Database, Decode, Encode, IntoArguments, Row, Type};
use time::OffsetDateTime;

use crate::jobs::error::StoreError;
use crate::jobs::id::JobId;

/// A connection to either database, in a transaction or not.
pub trait SqlConnection: Send {
    /// The database's rows.
    type Row: Columns + Send + Sync;

    /// Runs a statement to its end and returns its rows. SQLite commits a statement outside a transaction only at its end, and only
    /// there reports a full disk.
    fn query<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<Vec<Self::Row>, StoreError>>;

    /// Runs a statement and returns how many rows it changed.
    fn execute<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<u64, StoreError>>;

    /// Runs a statement that returns at most one row.
    fn query_row<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<Option<Self::Row>, StoreError>> {
        let rows = self.query(statement);
        Box::pin(async move { Ok(rows.await?.pop()) })
    }
}

/// A statement and the values of its parameters `$1`, `$2` and so on.
pub struct Statement<'a> {
    text: &'static str,
    values: Vec<Value<'a>>,
}

/// A statement in PostgreSQL's SQL. SQLite's dialect omits the phrases that SQLite lacks.
pub(super) fn sql<'a>(text: &'static str) -> Statement<'a> {
    Statement { text, values: Vec::new() }
}

impl<'a> Statement<'a> {
    /// Adds the value of the next parameter.
    pub(super) fn bind(mut self, value: impl Into<Value<'a>>) -> Self {
        self.values.push(value.into());
        self
    }

    /// The query for a database, with the statement's text in its dialect. The text consists of constants only.
    pub(super) fn prepare<D>(
        self,
        dialect: impl FnOnce(&'static str) -> Cow<'static, str>,
    ) -> Result<Query<'static, D, D::Arguments>, sqlx::Error>
    where
        D: Database<Arguments: IntoArguments<D>>,
        for<'t> Option<&'t str>: Encode<'t, D> + Type<D>,
        for<'t> Option<i64>: Encode<'t, D> + Type<D>,
        for<'t> Option<bool>: Encode<'t, D> + Type<D>,
    {
        let mut arguments = D::Arguments::default();
        for value in &self.values {
            match value {
                Value::Text(text) => arguments.add(text.as_deref()),
                Value::Integer(number) => arguments.add(*number),
                Value::Boolean(flag) => arguments.add(*flag),
            }
            .map_err(sqlx::Error::Encode)?;
        }
        Ok(sqlx::query_with(AssertSqlSafe(dialect(self.text)), arguments))
    }
}

/// The value of a parameter, or null.
pub enum Value<'a> {
    /// A text.
    Text(Option<Cow<'a, str>>),
    /// A whole number.
    Integer(Option<i64>),
    /// A truth value.
    Boolean(Option<bool>),
}

impl<'a> From<&'a str> for Value<'a> {
    fn from(text: &'a str) -> Self {
        Self::Text(Some(text.into()))
    }
}

impl<'a> From<&'a String> for Value<'a> {
    fn from(text: &'a String) -> Self {
        Self::Text(Some(text.into()))
    }
}

impl From<String> for Value<'_> {
    fn from(text: String) -> Self {
        Self::Text(Some(text.into()))
    }
}

impl<'a> From<Option<&'a str>> for Value<'a> {
    fn from(text: Option<&'a str>) -> Self {
        Self::Text(text.map(Cow::from))
    }
}

impl<'a> From<&'a Option<String>> for Value<'a> {
    fn from(text: &'a Option<String>) -> Self {
        text.as_deref().into()
    }
}

impl From<Option<String>> for Value<'_> {
    fn from(text: Option<String>) -> Self {
        Self::Text(text.map(Cow::from))
    }
}

impl From<JobId> for Value<'_> {
    fn from(id: JobId) -> Self {
        id.to_string().into()
    }
}

impl From<Option<JobId>> for Value<'_> {
    fn from(id: Option<JobId>) -> Self {
        id.map(|id| id.to_string()).into()
    }
}

impl From<i64> for Value<'_> {
    fn from(number: i64) -> Self {
        Self::Integer(Some(number))
    }
}

impl From<u32> for Value<'_> {
    fn from(number: u32) -> Self {
        i64::from(number).into()
    }
}

impl From<Option<i64>> for Value<'_> {
    fn from(number: Option<i64>) -> Self {
        Self::Integer(number)
    }
}

impl From<bool> for Value<'_> {
    fn from(flag: bool) -> Self {
        Self::Boolean(Some(flag))
    }
}

impl From<Option<bool>> for Value<'_> {
    fn from(flag: Option<bool>) -> Self {
        Self::Boolean(flag)
    }
}

/// A duration in milliseconds.
pub(super) fn millis(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX / 4)
}

/// A time in milliseconds since the Unix epoch.
pub(super) fn to_millis(time: OffsetDateTime) -> i64 {
    i64::try_from(time.unix_timestamp_nanos() / 1_000_000).unwrap_or(i64::MAX)
}

/// A duration from milliseconds; zero if the number is negative.
pub(super) fn elapsed(millis: i64) -> Duration {
    Duration::from_millis(u64::try_from(millis).unwrap_or(0))
}

/// A count from a column; zero if out of range.
pub(super) fn count(stored: i64) -> u32 {
    u32::try_from(stored).unwrap_or(0)
}

/// The time from a column's milliseconds since the Unix epoch. `id` and `column` are for the error.
pub(super) fn time(id: &str, column: &'static str, stored: i64) -> Result<OffsetDateTime, StoreError> {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(stored) * 1_000_000).map_err(|e| corrupt(id, column, e))
}

/// JSON of a type of this crate; serialization of these types can't fail.
pub(super) fn to_json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// The error of a value that can't be read.
pub(super) fn corrupt(id: &str, column: &'static str, reason: impl ToString) -> StoreError {
    StoreError::Corrupt { id: id.to_owned(), column, reason: reason.to_string() }
}

/// A row of either database. Columns that are null are `None`.
pub trait Columns {
    /// The text of a column.
    fn text(&self, column: &str) -> Result<Option<String>, sqlx::Error>;
    /// The number of a column.
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

/// Reads the columns of a row; its errors name the row's id and the column. Methods with `some_` accept null.
pub(super) struct Reader<'a, R> {
    row: &'a R,
    /// The value of the row's column `id`.
    pub id: String,
}

impl<'a, R: Columns> Reader<'a, R> {
    /// A reader of `row`, which must have a column `id`.
    pub fn new(row: &'a R) -> Result<Self, StoreError> {
        let id = row.text("id")?.ok_or_else(|| corrupt("", "id", "null"))?;
        Ok(Self { row, id })
    }

    /// A text or null.
    pub fn some_text(&self, column: &'static str) -> Result<Option<String>, StoreError> {
        Ok(self.row.text(column)?)
    }

    /// A text.
    pub fn text(&self, column: &'static str) -> Result<String, StoreError> {
        self.require(column, self.row.text(column)?)
    }

    /// A number or null.
    pub fn some_number(&self, column: &'static str) -> Result<Option<i64>, StoreError> {
        Ok(self.row.number(column)?)
    }

    /// A number.
    pub fn number(&self, column: &'static str) -> Result<i64, StoreError> {
        self.require(column, self.row.number(column)?)
    }

    /// A count.
    pub fn count(&self, column: &'static str) -> Result<u32, StoreError> {
        self.number(column).map(count)
    }

    /// A time, from milliseconds since the Unix epoch, or null.
    pub fn some_time(&self, column: &'static str) -> Result<Option<OffsetDateTime>, StoreError> {
        self.row.number(column)?.map(|stored| time(&self.id, column, stored)).transpose()
    }

    /// A time, from milliseconds since the Unix epoch.
    pub fn time(&self, column: &'static str) -> Result<OffsetDateTime, StoreError> {
        self.require(column, self.some_time(column)?)
    }

    /// A value parsed from its text, or null.
    pub fn some_parsed<T: FromStr>(&self, column: &'static str) -> Result<Option<T>, StoreError> {
        let read =
            |text: String| text.parse().map_err(|_| corrupt(&self.id, column, format!("unknown value '{text}'")));
        self.row.text(column)?.map(read).transpose()
    }

    /// A value parsed from its text.
    pub fn parsed<T: FromStr>(&self, column: &'static str) -> Result<T, StoreError> {
        self.require(column, self.some_parsed(column)?)
    }

    /// A value read from JSON, or null.
    pub fn some_json<T: DeserializeOwned>(&self, column: &'static str) -> Result<Option<T>, StoreError> {
        let read = |text: String| serde_json::from_str(&text).map_err(|e| corrupt(&self.id, column, e));
        self.row.text(column)?.map(read).transpose()
    }

    /// A value read from JSON.
    pub fn json<T: DeserializeOwned>(&self, column: &'static str) -> Result<T, StoreError> {
        self.require(column, self.some_json(column)?)
    }

    fn require<T>(&self, column: &'static str, value: Option<T>) -> Result<T, StoreError> {
        value.ok_or_else(|| corrupt(&self.id, column, "unexpected null"))
    }
}
