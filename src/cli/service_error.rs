use std::path::{Path, PathBuf};

use meshmend::jobs::{OpenFailure, StoreError};

use super::config::shown;
use super::service::ServiceError;

/// The file of the SQLite database in a data folder.
pub(super) fn file(data_dir: &Path) -> PathBuf {
    data_dir.join("meshmend.db")
}

/// Why the PostgreSQL database at `url` can't be opened, with the setting and what to do.
pub(super) fn postgres_error(url: &str, error: &StoreError) -> ServiceError {
    let failure = error.open_failure();
    let (what, hint) = match failure {
        OpenFailure::Address => (
            "the address can't be read",
            "Write it as postgres://user:password@host:5432/name, with special characters percent-encoded.",
        ),
        OpenFailure::Unreachable => (
            "no PostgreSQL server answers there",
            "Check the host and the port, and that the server runs and lets this machine in.",
        ),
        OpenFailure::Credentials => {
            ("the server refuses the user or the password", "Correct the user and the password.")
        }
        OpenFailure::NoDatabase => {
            ("the server has no such database", "Correct the name, or create the database with `createdb`.")
        }
        OpenFailure::Permission => (
            "the user may not do this in the database",
            "Make the user the owner of the database, or grant it CREATE on the schema public.",
        ),
        OpenFailure::Newer => NEWER,
        OpenFailure::NotADatabase | OpenFailure::Other => ("it can't be used", "Correct what the database says."),
    };
    let message = format!(
        "--database-url (MESHMEND_DATABASE_URL) {}: {what}: {}. {hint}",
        shown(url, true),
        database_message(error)
    );
    of(failure, message)
}

/// Why the SQLite database in the data folder can't be opened, with the setting and what to do.
pub(super) fn sqlite_error(path: &Path, error: &StoreError) -> ServiceError {
    let failure = error.open_failure();
    let (what, hint) = match failure {
        OpenFailure::Permission => (
            "this user may not read and write it",
            "Change the owner or the permissions of the file and its folder, or name another folder.",
        ),
        OpenFailure::NotADatabase => {
            ("it is not a SQLite database, or it is damaged", "Put a backup in its place, or name another folder.")
        }
        OpenFailure::Newer => NEWER,
        _ => ("it can't be used", "Correct what the database says, or name another folder."),
    };
    let message = format!(
        "--data-dir (MESHMEND_DATA_DIR): the database {}: {what}: {}. {hint}",
        path.display(),
        database_message(error)
    );
    of(failure, message)
}

const NEWER: (&str, &str) = (
    "a newer version of meshmend has changed its tables",
    "Run that version or a later one, or restore a backup from before.",
);

/// The database's own message, as a part of a sentence.
fn database_message(error: &StoreError) -> String {
    error.database_message().trim_end_matches('.').to_owned()
}

/// A setting to correct, or a server to wait for.
fn of(failure: OpenFailure, message: String) -> ServiceError {
    match failure {
        OpenFailure::Unreachable | OpenFailure::Other => ServiceError::Unavailable(message),
        _ => ServiceError::Refused(message),
    }
}
