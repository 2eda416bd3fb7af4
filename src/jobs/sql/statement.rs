//! Statements, the values of their parameters, and the connections that run them.

use std::borrow::Cow;

use futures::future::BoxFuture;
use sqlx::query::Query;
use sqlx::{Arguments, AssertSqlSafe, Database, Encode, IntoArguments, Type};

use crate::jobs::row::Columns;
use crate::jobs::{JobId, StoreError};

/// A connection to either database, in a transaction or not.
pub trait SqlConnection: Send {
    /// The database's rows.
    type Row: Columns + Send + Sync;

    /// Runs a statement to its end and returns its rows. SQLite commits a statement outside a transaction only at its end, and only
    /// there reports a full disk.
    fn query<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<Vec<Self::Row>, StoreError>>;

    /// Runs a statement and returns how many rows it changed.
    fn execute<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<u64, StoreError>>;

    /// Runs a statement that gives at most one row.
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

/// A statement in PostgreSQL's words. SQLite's dialect omits those that SQLite lacks.
pub(in crate::jobs) fn sql<'a>(text: &'static str) -> Statement<'a> {
    Statement { text, values: Vec::new() }
}

impl<'a> Statement<'a> {
    /// Adds the value of the next parameter.
    pub(in crate::jobs) fn bind(mut self, value: impl Into<Value<'a>>) -> Self {
        self.values.push(value.into());
        self
    }

    /// The query of a database, with the statement's text in its dialect. The text is made of constants only.
    pub(in crate::jobs) fn prepare<D>(
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
                Value::Boolean(is) => arguments.add(*is),
            }
            .map_err(sqlx::Error::Encode)?;
        }
        Ok(sqlx::query_with(AssertSqlSafe(dialect(self.text)), arguments))
    }
}

/// The value of a parameter, or null.
pub enum Value<'a> {
    Text(Option<Cow<'a, str>>),
    Integer(Option<i64>),
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
    fn from(is: bool) -> Self {
        Self::Boolean(Some(is))
    }
}

impl From<Option<bool>> for Value<'_> {
    fn from(is: Option<bool>) -> Self {
        Self::Boolean(is)
    }
}
