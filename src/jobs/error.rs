//! Errors of the store, and why a database could not be opened.

use std::io;

use sqlx::error::DatabaseError;
use sqlx::migrate::MigrateError;
use sqlx::sqlite::SqliteError;

use crate::telemetry;

/// An error of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database refused a statement or could not be reached.
    #[error("database: {0}")]
    Database(#[source] sqlx::Error),
    /// The migrations could not be run.
    #[error("migration: {0}")]
    Migration(#[from] MigrateError),
    /// A row holds what this version can't read.
    #[error("job {id}: column {column} can't be read: {reason}")]
    Corrupt {
        /// The row's id.
        id: String,
        /// The column.
        column: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The request took so long that its idempotency key went to another one.
    #[error("the idempotency key is another request's now")]
    KeyLost,
    /// Another job uses the upload, or the upload has expired.
    #[error("the upload is another job's now, or gone")]
    UploadTaken,
    /// The lease is no longer this worker's: it expired, or the job was canceled or deleted.
    #[error("the lease on this job was lost")]
    LeaseLost,
}

impl StoreError {
    /// Whether the same may succeed in a while: the database is away or not ready, or the connection broke. What was asked may
    /// have been done all the same.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        use sqlx::Error as E;
        let Self::Database(error) = self else { return false };
        if let Some(code) = sqlite_code(error) {
            return SQLITE_PASSES.contains(&code);
        }
        match error {
            E::Io(_) | E::Tls(_) | E::Protocol(_) | E::PoolTimedOut | E::WorkerCrashed => true,
            // Connection exceptions, the server's resources, its operator, and timeouts (PostgreSQL, appendix A).
            E::Database(error) => error.code().is_some_and(|code| {
                code.len() == 5 && ["08", "53", "57", "55P03"].iter().any(|class| code.starts_with(class))
            }),
            _ => false,
        }
    }

    /// Whether it is for want of room on the database's disk.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let Self::Database(error) = self else { return false };
        match sqlite_code(error) {
            Some(code) => code == SQLITE_FULL,
            None => error.as_database_error().is_some_and(|error| error.code().as_deref() == Some("53100")),
        }
    }

    /// Why opening the database failed with this error.
    #[must_use]
    pub fn open_failure(&self) -> OpenFailure {
        match self {
            Self::Database(error) => of_database(error),
            Self::Migration(MigrateError::VersionMissing(_) | MigrateError::VersionTooNew(..)) => OpenFailure::Newer,
            Self::Migration(MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _)) => {
                of_database(error)
            }
            _ => OpenFailure::Other,
        }
    }

    /// The message of the database or the operating system.
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

/// Why a database could not be opened, told apart by what its operator has to do.
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
    /// A newer version of this program has changed the tables.
    Newer,
    /// Another cause, which the database's own words tell.
    Other,
}

/// SQLite's result codes (its documentation, "Result and Error Codes").
const PERM: u32 = 3;
const READONLY: u32 = 8;
const CORRUPT: u32 = 11;
const CANTOPEN: u32 = 14;
const NOTADB: u32 = 26;
const SQLITE_FULL: u32 = 13;
/// SQLite's results that another time may be others: busy, locked, read-only, a failed read or write, full.
const SQLITE_PASSES: [u32; 5] = [5, 6, 8, 10, SQLITE_FULL];

/// The primary result code of an error of SQLite's (its documentation, "Result and Error Codes").
fn sqlite_code(error: &sqlx::Error) -> Option<u32> {
    let error = error.as_database_error()?.try_downcast_ref::<SqliteError>()?;
    error.code()?.parse::<u32>().ok().map(|extended| extended & 0xff)
}

/// Counted here, where every error of a database passes.
impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        let error = Self::Database(error);
        let kind = if error.is_transient() { "away" } else { "other" };
        metrics::counter!(telemetry::STORE_ERRORS, "kind" => kind).increment(1);
        error
    }
}

fn of_database(error: &sqlx::Error) -> OpenFailure {
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
        // Something that is no PostgreSQL server breaks the protocol.
        E::Io(_) | E::PoolTimedOut | E::Protocol(_) => OpenFailure::Unreachable,
        // PostgreSQL, appendix A.
        E::Database(error) => match error.code().as_deref() {
            Some("28P01" | "28000") => OpenFailure::Credentials,
            Some("3D000") => OpenFailure::NoDatabase,
            Some("42501") => OpenFailure::Permission,
            _ => OpenFailure::Other,
        },
        _ => OpenFailure::Other,
    }
}
