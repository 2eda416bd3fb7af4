//! The store in PostgreSQL.

use std::borrow::Cow;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use sqlx::postgres::{PgConnectOptions, PgListener, PgPool, PgPoolOptions, PgRow};
use sqlx::{Connection, PgConnection, Postgres};
use tokio::task::JoinSet;

use super::jobs::job_columns;
use super::statement::{SqlConnection, Statement};
use super::store::{Dialect, SqlStore, unsynced};
use crate::access::SystemIds;
use crate::jobs::error::StoreError;
use crate::jobs::job::Status;
use crate::jobs::queue::{Notifier, RetryPolicy};
use crate::jobs::timestamp::Clock;

/// The channel on which the triggers of `migrations/postgres` notify.
const CHANNEL: &str = "meshmend_jobs";
/// The notification that a delivery may be due.
const DELIVERIES: &str = "webhooks";
/// The notification that drawings were requested.
const DRAWINGS: &str = "drawings";
/// The delay before listening again after the connection was lost.
const LISTEN_AGAIN: Duration = Duration::from_secs(1);
/// The server's time limits on a statement, on the wait for a lock, and on an idle transaction.
const LIMITS: [(&str, &str); 3] =
    [("statement_timeout", "15s"), ("lock_timeout", "10s"), ("idle_in_transaction_session_timeout", "30s")];
/// A connection that answered within this time is reused without a test. A restart of the database takes longer, so a statement
/// on a broken connection of this age would also have failed on a new one.
const FRESH: Duration = Duration::from_millis(10);
/// The longest time to wait for a connection.
const ACQUIRE: Duration = Duration::from_secs(3);

/// The store in a PostgreSQL database, shared by any number of processes on any number of machines.
///
/// Times are the database's, so that leases do not depend on the machines' clocks. Claims skip rows that other transactions lock
/// (`FOR UPDATE SKIP LOCKED`). Triggers notify every process of changes (`LISTEN`, `NOTIFY`); a process that misses a notification
/// polls. The pool replaces broken connections, but a statement that ran on one fails.
pub type PostgresStore = SqlStore<Postgres>;

impl PostgresStore {
    /// Connects with at most `connections` connections and migrates the tables. `clock` replaces the database's clock in tests.
    ///
    /// # Errors
    /// When the address can't be read or reached, or a newer version created the tables.
    pub async fn open(
        url: &str,
        connections: u32,
        clock: Option<Arc<dyn Clock>>,
        retry: RetryPolicy,
    ) -> Result<Self, StoreError> {
        let options = PgConnectOptions::from_str(url)?.application_name("meshmend").options(LIMITS);
        let pool = PgPoolOptions::new()
            .acquire_timeout(ACQUIRE)
            .max_connections(connections.max(2))
            .test_before_acquire(false)
            .before_acquire(|connection, used| {
                Box::pin(async move { Ok(used.idle_for < FRESH || connection.ping().await.is_ok()) })
            });
        let pool = match pool.connect_with(options.clone()).await {
            // A pool retries until its timeout and does not report the cause. A single connection does.
            Err(sqlx::Error::PoolTimedOut) => return Err(connection_error(&options).await.into()),
            pool => pool?,
        };
        sqlx::migrate!("migrations/postgres").run(&pool).await?;
        let (notifier, mut listener) = (Arc::new(Notifier::default()), JoinSet::new());
        listener.spawn(notify(pool.clone(), Arc::clone(&notifier)));
        Ok(Self { pool, writer: None, clock, ids: Arc::new(SystemIds), retry, notifier, listener })
    }
}

/// The reason why no connection can be made.
async fn connection_error(options: &PgConnectOptions) -> sqlx::Error {
    match tokio::time::timeout(ACQUIRE, PgConnection::connect_with(options)).await {
        Ok(Err(error)) => error,
        Ok(Ok(_)) | Err(_) => sqlx::Error::PoolTimedOut,
    }
}

impl SqlConnection for PgConnection {
    type Row = PgRow;

    fn query<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<Vec<PgRow>, StoreError>> {
        let query = statement.prepare::<Postgres>(Cow::Borrowed);
        Box::pin(async move { Ok(query?.fetch_all(self).await?) })
    }

    fn execute<'c>(&'c mut self, statement: Statement<'_>) -> BoxFuture<'c, Result<u64, StoreError>> {
        let query = statement.prepare::<Postgres>(Cow::Borrowed);
        Box::pin(async move { Ok(query?.execute(self).await?.rows_affected()) })
    }
}

/// The statement [`Dialect::LIST`] with a condition for the status.
macro_rules! list {
    ($has_status:literal) => {
        concat!(
            "SELECT ",
            job_columns!("NULL::text AS report"),
            " FROM jobs WHERE tenant = $1 AND purged_at IS NULL AND ($2 IS NULL OR made_by = $2) AND ",
            $has_status,
            " AND ($4 IS NULL OR id < $4) AND ($6::jsonb = '[]' OR $6::jsonb @> outcome::jsonb) \
              AND ($7 IS NULL OR created_at >= $7) AND ($8 IS NULL OR created_at < $8) \
              AND ($9::jsonb = '{}' OR metadata::jsonb @> $9::jsonb) ORDER BY id DESC LIMIT $5"
        )
    };
}

impl Dialect for Postgres {
    const BEGIN: &'static str = "BEGIN";
    const NOTIFIES: bool = true;

    /// Recursion finds the tenants with queued jobs by steps through the index, without reading every job. Concurrent claims may
    /// choose the same tenant. Each then takes a job that the others have not locked; if all due jobs of the tenant are locked, the
    /// next tenant's turn comes.
    const CLAIM: &'static str = concat!(
        "WITH RECURSIVE waiting (tenant) AS ( \
             SELECT min(tenant) FROM jobs WHERE status = 'queued' \
             UNION ALL \
             SELECT (SELECT min(tenant) FROM jobs WHERE status = 'queued' AND tenant > waiting.tenant) \
             FROM waiting WHERE tenant IS NOT NULL), \
         turns AS ( \
             SELECT tenant, \
                    (SELECT count(*) FROM jobs WHERE status = 'running' AND jobs.tenant = waiting.tenant) AS running, \
                    (SELECT max(claimed_at) FROM jobs WHERE jobs.tenant = waiting.tenant) AS served, \
                    coalesce((SELECT max_running FROM tenants WHERE name = waiting.tenant), $5) AS most, \
                    (SELECT id FROM jobs WHERE status = 'queued' AND jobs.tenant = waiting.tenant AND run_at <= meshmend_now($3) \
                     ORDER BY run_at, id LIMIT 1) AS next \
             FROM waiting WHERE tenant IS NOT NULL), \
         turn AS MATERIALIZED ( \
             SELECT tenant FROM turns WHERE next IS NOT NULL AND running < most ORDER BY running, served NULLS FIRST, next) \
         UPDATE jobs SET status = 'running', attempt = attempt + 1, worker = $1, lease_token = $2, \
             lease_expires_at = meshmend_now($3) + $4, started_at = coalesce(started_at, meshmend_now($3)), \
             claimed_at = meshmend_now($3), progress = NULL, version = version + 1 \
         WHERE id = (SELECT free.id FROM turn CROSS JOIN LATERAL ( \
                         SELECT id FROM jobs WHERE status = 'queued' AND jobs.tenant = turn.tenant AND run_at <= meshmend_now($3) \
                         ORDER BY run_at, id LIMIT 1 FOR UPDATE SKIP LOCKED) AS free LIMIT 1)",
        unsynced!(),
        " RETURNING ",
        job_columns!()
    );

    const LIST: &'static str = list!("($3::jsonb = '[]' OR $3::jsonb ? status)");
    const LIST_OF_STATUS: &'static str = list!("status = $3::jsonb ->> 0");

    const QUEUE_POSITION: &'static str = "SELECT count(*) AS ahead FROM jobs \
         WHERE status = 'queued' AND tenant = $1 AND (run_at < $2 OR (run_at = $2 AND id < $3))";

    const LONGEST_WAIT: &'static str = "SELECT meshmend_now($1) - run_at AS waited FROM jobs WHERE status = 'queued' \
         ORDER BY run_at, id LIMIT 1";
}

/// Notifies listeners of all changes in the database, from any process, until the task is aborted.
async fn notify(pool: PgPool, notifier: Arc<Notifier>) {
    loop {
        if let Err(error) = listen(&pool, &notifier).await {
            tracing::warn!(%error, "could not listen to the database; polling instead");
        }
        tokio::time::sleep(LISTEN_AGAIN).await;
    }
}

async fn listen(pool: &PgPool, notifier: &Notifier) -> Result<(), sqlx::Error> {
    let mut listener = PgListener::connect_with(pool).await?;
    listener.listen(CHANNEL).await?;
    // Changes may have come before this connection listened.
    notifier.notify_work();
    notifier.notify_deliveries();
    // Returns `None` when the connection is lost.
    while let Some(notification) = listener.try_recv().await? {
        match notification.payload() {
            DELIVERIES => notifier.notify_deliveries(),
            DRAWINGS => notifier.notify_work(),
            _ => {}
        }
        let Some((id, status)) = notification.payload().split_once(' ') else { continue };
        if let Ok(id) = id.parse() {
            notifier.notify_job(id);
        }
        if status == Status::Queued.as_str() {
            notifier.notify_work();
        }
    }
    Ok(())
}
