//! Errors that stop a service command. Each message names the setting at fault and what to do.

use std::io;
use std::path::Path;

use meshmend::jobs::{OpenFailure, StoreError};
use url::Url;

/// Replaces secrets in printed values.
const HIDDEN: &str = "***";

/// Why a service command failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum ServiceError {
    #[error("{0}: {1}")]
    Io(String, io::Error),
    #[error(transparent)]
    Store(#[from] meshmend::jobs::StoreError),
    #[error(transparent)]
    Blobs(#[from] meshmend::blobs::BlobError),
    #[error(transparent)]
    Pool(#[from] meshmend::worker::PoolError),
    /// A setting or an argument is unusable.
    #[error("{0}")]
    Refused(String),
    /// Another server that this service needs does not answer.
    #[error("{0}")]
    Unavailable(String),
    #[error(transparent)]
    Webhooks(#[from] meshmend::webhooks::PosterError),
    #[error("metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
}

/// Adds the subject, such as a path, to an I/O error.
pub(super) fn io_error(subject: impl Into<String>) -> impl FnOnce(io::Error) -> ServiceError {
    move |error| ServiceError::Io(subject.into(), error)
}

/// Describes why the PostgreSQL database at `url` cannot be opened.
pub(super) fn postgres_error(url: &str, error: &StoreError) -> ServiceError {
    let failure = error.open_failure();
    let (reason, hint) = match failure {
        OpenFailure::Address => (
            "the address is invalid",
            "Use the form postgres://user:password@host:5432/name, with special characters percent-encoded.",
        ),
        OpenFailure::Unreachable => (
            "no PostgreSQL server answers at this address",
            "Check the host and the port, and that the server runs and accepts connections from this machine.",
        ),
        OpenFailure::Credentials => {
            ("the server rejects the user or the password", "Correct the user and the password.")
        }
        OpenFailure::NoDatabase => {
            ("the server has no database of this name", "Correct the name, or create the database with `createdb`.")
        }
        OpenFailure::Permission => (
            "the user lacks a permission in the database",
            "Make the user the owner of the database, or grant the user CREATE on the schema public.",
        ),
        OpenFailure::Newer => NEWER,
        OpenFailure::NotADatabase | OpenFailure::Other => {
            ("the database is unusable", "Fix what the database reports.")
        }
    };
    let message = format!(
        "--database-url (MESHMEND_DATABASE_URL) {}: {reason}: {}. {hint}",
        masked(url, true),
        database_message(error)
    );
    classified(failure, message)
}

/// Describes why the SQLite database at `path` cannot be opened.
pub(super) fn sqlite_error(path: &Path, error: &StoreError) -> ServiceError {
    let failure = error.open_failure();
    let (reason, hint) = match failure {
        OpenFailure::Permission => (
            "the current user may not read and write the file",
            "Change the owner or the permissions of the file and its folder, or choose another folder.",
        ),
        OpenFailure::NotADatabase => {
            ("the file is damaged, or is not a SQLite database", "Replace it with a backup, or choose another folder.")
        }
        OpenFailure::Newer => NEWER,
        _ => ("the database is unusable", "Fix what the database reports, or choose another folder."),
    };
    let message = format!(
        "--data-dir (MESHMEND_DATA_DIR): the database {}: {reason}: {}. {hint}",
        path.display(),
        database_message(error)
    );
    classified(failure, message)
}

const NEWER: (&str, &str) = (
    "a newer version of meshmend has upgraded its tables",
    "Run that version or a later one, or restore an older backup.",
);

/// The database's own message, without its final period.
fn database_message(error: &StoreError) -> String {
    error.database_message().trim_end_matches('.').to_owned()
}

/// Sorts failures: an unreachable server may come back, other failures need a corrected setting.
fn classified(failure: OpenFailure, message: String) -> ServiceError {
    match failure {
        OpenFailure::Unreachable | OpenFailure::Other => ServiceError::Unavailable(message),
        _ => ServiceError::Refused(message),
    }
}

/// Masks a value for printing. Of a secret URL only scheme, host and port stay, of another secret nothing. Of a URL that is no
/// secret, user, password and query are masked.
pub(super) fn masked(value: &str, secret: bool) -> String {
    let Some(mut url) = Url::parse(value).ok().filter(Url::has_host) else {
        return if secret { HIDDEN.to_owned() } else { value.to_owned() };
    };
    if secret {
        let port = url.port().map(|port| format!(":{port}")).unwrap_or_default();
        return format!("{}://{HIDDEN}@{}{port}/{HIDDEN}", url.scheme(), url.host_str().unwrap_or_default());
    }
    let has_credentials = !url.username().is_empty() || url.password().is_some();
    if !has_credentials && url.query().is_none() {
        return value.to_owned();
    }
    if has_credentials && (url.set_username(HIDDEN).is_err() || url.set_password(None).is_err()) {
        return HIDDEN.to_owned();
    }
    url.set_query(url.query().map(|_| HIDDEN));
    url.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_masked_and_so_are_credentials_and_queries_of_urls() {
        for (value, secret, expected) in [
            ("plain", false, "plain"),
            ("plain", true, "***"),
            ("127.0.0.1:8080", false, "127.0.0.1:8080"),
            ("key:with:colons", true, "***"),
            ("postgres://me:pass@db:5432/jobs?password=pass", true, "postgres://***@db:5432/***"),
            ("postgres://me:p%40ss@db/jobs", true, "postgres://***@db/***"),
            ("http://collector:4318", false, "http://collector:4318"),
            ("http://token@collector:4318/x", false, "http://***@collector:4318/x"),
            ("http://collector:4318/x?key=token", false, "http://collector:4318/x?***"),
            ("s3://bucket/prefix", false, "s3://bucket/prefix"),
        ] {
            assert_eq!(masked(value, secret), expected, "{value}");
        }
    }
}
