//! The store in one SQLite file.

use std::borrow::Cow;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use rustix::fs::{FlockOperation, flock};
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePoolOptions, SqliteRow, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, Sqlite};
use tokio::task::JoinSet;

use super::jobs::job_columns;
use super::statement::{SqlConnection, Statement};
use super::store::{Dialect, SqlStore, unsynced};
use crate::access::SystemIds;
use crate::jobs::error::StoreError;
use crate::jobs::queue::{Notifier, RetryPolicy};
use crate::jobs::timestamp::Clock;

/// The store in one SQLite file: the default, which needs no other software.
///
/// Writes use a single connection: SQLite has one writer at a time, and a queue for a connection is fairer than a queue for a
/// lock. Reads have their own connections, and write-ahead logging lets reads and writes run at the same time. Commits are synced
/// to disk, so accepted jobs survive a power failure.
pub type SqliteStore = SqlStore<Sqlite>;

impl SqliteStore {
    /// Opens the file, creates it if it is missing, and migrates its tables. Only this user may read a created file.
    ///
    /// # Errors
    /// When the file can't be opened, or a newer version created the tables.
    pub async fn open(path: &Path, clock: Arc<dyn Clock>, retry: RetryPolicy) -> Result<Self, StoreError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10))
            .foreign_keys(true);
        // Migrations take no lock of their own, and a server and a worker may start at the same time.
        let lock = create_private(&path.with_extension("lock")).map_err(sqlx::Error::Io)?;
        // SQLite gives its journal files the permissions of the database file.
        create_private(path).map_err(sqlx::Error::Io)?;
        let lock = tokio::task::spawn_blocking(move || flock(&lock, FlockOperation::LockExclusive).map(|()| lock));
        let lock = lock.await.map_err(|e| sqlx::Error::Io(e.into()))?.map_err(|e| sqlx::Error::Io(e.into()))?;
        // SQLite rolls back a transaction by itself when the disk is full. sqlx does not notice that, and would refuse every later
        // transaction on the connection. A local file needs no test before each use, since no network can break the connection.
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .test_before_acquire(false)
            .before_acquire(|connection, _| Box::pin(async move { Ok(!connection.is_in_transaction()) }))
            .connect_with(options.clone())
            .await?;
        sqlx::migrate!("migrations/sqlite").run(&writer).await?;
        drop(lock);
        let reader = SqlitePoolOptions::new().max_connections(4).test_before_acquire(false);
        let reader = reader.connect_with(options.read_only(true)).await?;
        let (notifier, listener) = (Arc::new(Notifier::default()), JoinSet::new());
        let (clock, ids) = (Some(clock), Arc::new(SystemIds));
        Ok(Self { pool: reader, writer: Some(writer), clock, ids, retry, notifier, listener })
    }

    /// Copies the database file `source` to the new file `target`, which only this user may read. Other processes may continue to
    /// write: the copy holds what was committed when it began. The tables are not migrated, so that an older database can be saved
    /// before an upgrade.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] when `target` exists; it is left unchanged.
    pub async fn back_up(source: &Path, target: &Path) -> Result<(), BackupError> {
        if target.try_exists()? {
            return Err(io::Error::from(io::ErrorKind::AlreadyExists).into());
        }
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // No other program sees an incomplete copy. The file is private from its creation, and SQLite accepts an empty file.
        let copy = tempfile::Builder::new().prefix(".meshmend-backup-").tempfile_in(folder)?;
        let options = SqliteConnectOptions::new().filename(source).read_only(true);
        let mut connection: SqliteConnection = options.connect().await.map_err(StoreError::from)?;
        let path = copy.path().to_string_lossy().into_owned();
        let copied = sqlx::query("VACUUM INTO ?").bind(path).execute(&mut connection).await;
        copied.map_err(StoreError::from)?;
        connection.close().await.map_err(StoreError::from)?;
        // `VACUUM INTO` does not wait for the disk.
        copy.as_file().sync_all()?;
        copy.persist_noclobber(target).map_err(|error| error.error)?;
        File::open(folder)?.sync_all()?;
        Ok(())
    }
}

/// Why a database could not be copied.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The database could not be read, or the copy could not be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The copy could not be moved to its target, which may exist.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// Opens a file for writing, and creates it if it is missing. Only this user may read a new file, since the database holds
/// clients' data and hashes of keys.
fn create_private(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create(true).truncate(false).mode(0o600).open(path)
}

/// Phrases of PostgreSQL that SQLite lacks and does not need: the time is always a parameter, a write locks the whole database, every
/// commit is synced, and texts compare by their bytes.
const OMITTED: [&str; 6] =
    ["meshmend_now", " FOR UPDATE SKIP LOCKED", " FOR UPDATE", " FOR KEY SHARE", unsynced!(), " COLLATE \"C\""];

/// A shared statement without the phrases that SQLite lacks. `meshmend_now($1)` becomes `($1)`.
fn in_sqlite(text: &'static str) -> Cow<'static, str> {
    let omit = |text: Cow<'static, str>, phrase| {
        if text.contains(phrase) { Cow::Owned(text.replace(phrase, "")) } else { text }
    };
    OMITTED.into_iter().fold(Cow::Borrowed(text), omit)
}

impl SqlConnection for SqliteConnection {
    type Row = SqliteRow;

    fn query<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<Vec<SqliteRow>, StoreError>> {
        let query = statement.prepare::<Sqlite>(in_sqlite);
        Box::pin(async move { Ok(query?.fetch_all(self).await?) })
    }

    fn execute<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<u64, StoreError>> {
        let query = statement.prepare::<Sqlite>(in_sqlite);
        Box::pin(async move { Ok(query?.execute(self).await?.rows_affected()) })
    }
}

/// The statement [`Dialect::LIST`] with a condition for the status.
macro_rules! list {
    ($has_status:literal) => {
        concat!(
            "SELECT ",
            job_columns!("NULL AS report"),
            " FROM jobs WHERE tenant = $1 AND purged_at IS NULL AND ($2 IS NULL OR made_by = $2) AND ",
            $has_status,
            " AND ($4 IS NULL OR id < $4) AND ($6 = '[]' OR outcome IN (SELECT json_quote(value) FROM json_each($6))) \
              AND ($7 IS NULL OR created_at >= $7) AND ($8 IS NULL OR created_at < $8) \
              AND NOT EXISTS (SELECT 1 FROM json_each($9) AS wanted WHERE NOT EXISTS (SELECT 1 FROM json_each(metadata) AS noted \
                  WHERE noted.key = wanted.key AND noted.value = wanted.value)) \
              ORDER BY id DESC LIMIT $5"
        )
    };
}

impl Dialect for Sqlite {
    /// Takes SQLite's write lock at once, so that a transaction does not fail midway for the lock.
    const BEGIN: &'static str = "BEGIN IMMEDIATE";
    const NOTIFIES: bool = false;

    /// Recursion finds the tenants with queued jobs by steps through the index, without reading every job. Without `INDEXED BY`,
    /// SQLite would choose an index by status and sort all queued jobs.
    const CLAIM: &'static str = concat!(
        "UPDATE jobs SET status = 'running', attempt = attempt + 1, worker = $1, lease_token = $2, lease_expires_at = $3 + $4, \
             started_at = coalesce(started_at, $3), claimed_at = $3, progress = NULL, version = version + 1 \
         WHERE id = ( \
             WITH RECURSIVE waiting (tenant) AS ( \
                 SELECT min(tenant) FROM jobs INDEXED BY jobs_due WHERE status = 'queued' \
                 UNION ALL \
                 SELECT (SELECT min(tenant) FROM jobs INDEXED BY jobs_due WHERE status = 'queued' AND tenant > waiting.tenant) \
                 FROM waiting WHERE tenant IS NOT NULL), \
             turns AS ( \
                 SELECT (SELECT count(*) FROM jobs WHERE status = 'running' AND jobs.tenant = waiting.tenant) AS running, \
                        (SELECT max(claimed_at) FROM jobs WHERE jobs.tenant = waiting.tenant) AS served, \
                        coalesce((SELECT max_running FROM tenants WHERE name = waiting.tenant), $5) AS most, \
                        (SELECT id FROM jobs INDEXED BY jobs_due WHERE status = 'queued' AND jobs.tenant = waiting.tenant AND run_at <= $3 \
                         ORDER BY run_at, id LIMIT 1) AS next \
                 FROM waiting WHERE tenant IS NOT NULL) \
             SELECT next FROM turns WHERE next IS NOT NULL AND running < most \
             ORDER BY running, served NULLS FIRST, next LIMIT 1) \
         RETURNING ",
        job_columns!()
    );

    const LIST: &'static str = list!("($3 = '[]' OR status IN (SELECT value FROM json_each($3)))");
    const LIST_OF_STATUS: &'static str = list!("status = json_extract($3, '$[0]')");

    const QUEUE_POSITION: &'static str = "SELECT count(*) AS ahead FROM jobs INDEXED BY jobs_due \
         WHERE status = 'queued' AND tenant = $1 AND (run_at < $2 OR (run_at = $2 AND id < $3))";

    /// The index holds the queued jobs only.
    const LONGEST_WAIT: &'static str = "SELECT $1 - run_at AS waited FROM jobs INDEXED BY jobs_due WHERE status = 'queued' \
         ORDER BY run_at, id LIMIT 1";
}

#[cfg(test)]
mod tests {
    use uuid::Uuid;

    use super::super::jobs::FIND_RESULT;
    use super::*;
    use crate::access::IdSource;
    use crate::jobs::timestamp::SystemClock;

    struct Fixed;

    impl IdSource for Fixed {
        fn sortable(&self) -> Uuid {
            Uuid::from_u128(1)
        }

        fn random(&self) -> Uuid {
            Uuid::from_u128(2)
        }
    }

    #[tokio::test]
    async fn ids_and_tokens_come_from_the_given_source() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, clock) = (folder.path().join("jobs.db"), Arc::new(SystemClock));
        let store = SqliteStore::open(&path, clock, RetryPolicy::default()).await.expect("a store");
        let store = store.with_ids(Arc::new(Fixed));
        assert_eq!(store.new_id("we"), format!("we_{:032x}", 1));
        assert_eq!(store.new_token(), format!("{:032x}", 2));
    }

    #[tokio::test]
    async fn frequent_statements_find_their_rows_by_an_index() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, clock) = (folder.path().join("jobs.db"), Arc::new(SystemClock));
        let store = SqliteStore::open(&path, clock, RetryPolicy::default()).await.expect("a store");
        let mut connection = store.writer().await.expect("a connection");
        let by_index = [
            (FIND_RESULT, "INDEX jobs_reusable (tenant=? AND fingerprint=?)"),
            (Sqlite::LIST_OF_STATUS, "INDEX jobs_by_status (tenant=? AND status=?)"),
            (Sqlite::QUEUE_POSITION, "INDEX jobs_due (tenant=? AND run_at<?)"),
        ];
        for (statement, expected) in by_index {
            let explain = sqlx::query(sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}")));
            let rows = explain.fetch_all(&mut *connection).await.expect("a plan");
            let steps: Vec<String> = rows.iter().map(|row| sqlx::Row::get(row, "detail")).collect();
            assert!(steps[0].starts_with("SEARCH") && steps[0].ends_with(expected), "{steps:?}");
            assert!(steps.iter().all(|step| !step.contains("ORDER BY")), "sorted: {steps:?}");
        }
    }

    #[test]
    fn postgresql_phrases_are_omitted_and_other_statements_are_unchanged() {
        let shared =
            "SELECT id FROM jobs WHERE run_at <= meshmend_now($1) - $2 ORDER BY id LIMIT 1 FOR UPDATE SKIP LOCKED";
        assert_eq!(in_sqlite(shared), "SELECT id FROM jobs WHERE run_at <= ($1) - $2 ORDER BY id LIMIT 1");
        assert!(matches!(in_sqlite("SELECT 1"), Cow::Borrowed("SELECT 1")));
    }
}
