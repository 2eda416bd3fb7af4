//! Why the service could not start or go on, with the setting that is to blame and what to do.

use std::io;
use std::path::Path;

use meshmend::jobs::{OpenFailure, StoreError};
use url::Url;

/// What stands for what is not shown.
const HIDDEN: &str = "***";

/// Why a service could not start or go on.
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
    /// A setting that can't be used.
    #[error("{0}")]
    Refused(String),
    /// Something that the service needs and that does not answer.
    #[error("{0}")]
    Unavailable(String),
    #[error(transparent)]
    Webhooks(#[from] meshmend::webhooks::PosterError),
    #[error("metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
}

/// An input or output error, with what it concerns.
pub(super) fn io_error(what: impl Into<String>) -> impl FnOnce(io::Error) -> ServiceError {
    move |error| ServiceError::Io(what.into(), error)
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

/// A value as it may be seen. Of a secret, only where it leads to, if it is an address; of any other address, all but
/// who asks there and with what.
pub(super) fn shown(value: &str, secret: bool) -> String {
    let Some(mut url) = Url::parse(value).ok().filter(Url::has_host) else {
        return if secret { HIDDEN.to_owned() } else { value.to_owned() };
    };
    if secret {
        let port = url.port().map(|port| format!(":{port}")).unwrap_or_default();
        return format!("{}://{HIDDEN}@{}{port}/{HIDDEN}", url.scheme(), url.host_str().unwrap_or_default());
    }
    let asks_as = !url.username().is_empty() || url.password().is_some();
    if !asks_as && url.query().is_none() {
        return value.to_owned();
    }
    if asks_as && (url.set_username(HIDDEN).is_err() || url.set_password(None).is_err()) {
        return HIDDEN.to_owned();
    }
    url.set_query(url.query().map(|_| HIDDEN));
    url.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_never_shown_and_an_address_without_who_asks_there() {
        for (value, secret, seen) in [
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
            assert_eq!(shown(value, secret), seen, "{value}");
        }
    }
}
