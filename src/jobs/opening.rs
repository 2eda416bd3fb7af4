use std::io;

use sqlx::migrate::MigrateError;

use super::error::{StoreError, sqlite_code};

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

impl StoreError {
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
