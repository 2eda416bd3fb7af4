//! Errors of the store, and the reasons why a database can't be opened.

use std::io;

use sqlx::error::DatabaseError;
use sqlx::migrate::MigrateError;
use sqlx::sqlite::SqliteError;

use crate::telemetry;

/// An error of the store: of its database, or of a condition that a write requires.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database refused a statement or could not be reached.
    #[error("database: {0}")]
    Database(#[source] sqlx::Error),
    /// The migrations could not be run.
    #[error("migration: {0}")]
    Migration(#[from] MigrateError),
    /// A row has a value that this version can't read.
    #[error("job {id}: column {column} can't be read: {reason}")]
    Corrupt {
        /// The row's id.
        id: String,
        /// The column.
        column: &'static str,
        /// Why the value can't be read.
        reason: String,
    },
    /// The idempotency key went to another request, because this one took too long.
    #[error("the idempotency key now belongs to another request")]
    KeyLost,
    /// Another job uses the upload, or the upload has expired.
    #[error("the upload has expired or belongs to another job")]
    UploadTaken,
    /// The worker lost its lease: the lease expired, or the job was canceled or deleted.
    #[error("the worker lost its lease on this job")]
    LeaseLost,
}

impl StoreError {
    /// Whether a retry may succeed: the database is unavailable or not ready, or the connection broke. The failed request may
    /// have taken effect all the same.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        use sqlx::Error as E;
        let Self::Database(error) = self else { return false };
        if let Some(code) = sqlite_code(error) {
            return SQLITE_TRANSIENT.contains(&code);
        }
        match error {
            E::Io(_) | E::Tls(_) | E::Protocol(_) | E::PoolTimedOut | E::WorkerCrashed => true,
            // Classes of connection errors, insufficient resources, operator intervention, and lock timeouts (PostgreSQL manual,
            // appendix A, "PostgreSQL Error Codes").
            E::Database(error) => error.code().is_some_and(|code| {
                code.len() == 5 && ["08", "53", "57", "55P03"].iter().any(|class| code.starts_with(class))
            }),
            _ => false,
        }
    }

    /// Whether the failed request may yet take effect: the connection broke while the database may still execute it.
    #[must_use]
    pub fn may_take_effect(&self) -> bool {
        use sqlx::Error as E;
        matches!(self, Self::Database(E::Io(_) | E::Tls(_) | E::Protocol(_) | E::WorkerCrashed))
    }

    /// Whether the database's disk is full.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let Self::Database(error) = self else { return false };
        match sqlite_code(error) {
            Some(code) => code == SQLITE_FULL,
            None => error.as_database_error().is_some_and(|error| error.code().as_deref() == Some("53100")),
        }
    }

    /// The reason why opening the database failed with this error.
    #[must_use]
    pub fn open_failure(&self) -> OpenFailure {
        match self {
            Self::Database(error) => open_failure(error),
            Self::Migration(MigrateError::VersionMissing(_) | MigrateError::VersionTooNew(..)) => OpenFailure::Newer,
            Self::Migration(MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _)) => {
                open_failure(error)
            }
            _ => OpenFailure::Other,
        }
    }

    /// The message of the database or the operating system, without added context.
    #[must_use]
    pub fn database_message(&self) -> String {
        match self {
            Self::Database(sqlx::Error::Io(error)) => error.to_string(),
            Self::Database(sqlx::Error::Configuration(error)) => error.to_string(),
            Self::Database(error) => {
                error.as_database_error().map_or(error.to_string(), |refusal| refusal.message().to_owned())
            }
            other => other.to_string(),
        }
    }
}

/// Why a database could not be opened. Each variant calls for another action of the operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OpenFailure {
    /// The address can't be read.
    Address,
    /// No server answers at the address.
    Unreachable,
    /// The server refuses the user or the password.
    Credentials,
    /// The server has no database of that name.
    NoDatabase,
    /// The user may not use the database, or this process may not use the file.
    Permission,
    /// The file is not a SQLite database, or is damaged.
    NotADatabase,
    /// A newer version of this program created the tables.
    Newer,
    /// Another cause; the database's message gives it.
    Other,
}

// SQLite's result codes (SQLite documentation, "Result and Error Codes").
const PERM: u32 = 3;
const READONLY: u32 = 8;
const CORRUPT: u32 = 11;
const CANTOPEN: u32 = 14;
const NOTADB: u32 = 26;
const SQLITE_FULL: u32 = 13;
/// SQLite's transient errors: busy, locked, read-only, a failed read or write, and a full disk.
const SQLITE_TRANSIENT: [u32; 5] = [5, 6, 8, 10, SQLITE_FULL];

/// The primary result code of a SQLite error.
fn sqlite_code(error: &sqlx::Error) -> Option<u32> {
    let error = error.as_database_error()?.try_downcast_ref::<SqliteError>()?;
    error.code()?.parse::<u32>().ok().map(|extended| extended & 0xff)
}

/// Also counts the error in the metrics: every database error passes this conversion.
impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        let error = Self::Database(error);
        let kind = if error.is_transient() { "transient" } else { "other" };
        metrics::counter!(telemetry::STORE_ERRORS, "kind" => kind).increment(1);
        error
    }
}

fn open_failure(error: &sqlx::Error) -> OpenFailure {
    use sqlx::Error as E;
    if let Some(code) = sqlite_code(error) {
        return match code {
            PERM | READONLY | CANTOPEN => OpenFailure::Permission,
            CORRUPT | NOTADB => OpenFailure::NotADatabase,
            _ => OpenFailure::Other,
        };
    }
    match error {
        E::Configuration(_) => OpenFailure::Address,
        E::Io(error) if error.kind() == io::ErrorKind::PermissionDenied => OpenFailure::Permission,
        // A server that is not PostgreSQL breaks the protocol.
        E::Io(_) | E::PoolTimedOut | E::Protocol(_) => OpenFailure::Unreachable,
        // PostgreSQL manual, appendix A, "PostgreSQL Error Codes".
        E::Database(error) => match error.code().as_deref() {
            Some("28P01" | "28000") => OpenFailure::Credentials,
            Some("3D000") => OpenFailure::NoDatabase,
            Some("42501") => OpenFailure::Permission,
            _ => OpenFailure::Other,
        },
        _ => OpenFailure::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_on_a_broken_connection_may_yet_take_effect_and_an_unsent_one_may_not() {
        let may_take_effect = |error: sqlx::Error| StoreError::from(error).may_take_effect();
        assert!(may_take_effect(io::Error::from(io::ErrorKind::ConnectionReset).into()));
        assert!(!may_take_effect(sqlx::Error::PoolTimedOut));
        assert!(!StoreError::LeaseLost.may_take_effect());
    }
}
