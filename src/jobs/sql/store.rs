//! The store over SQL: its connections, and the differences between the databases ([`Dialect`]).

use std::sync::Arc;

use async_trait::async_trait;
use sqlx::pool::PoolConnection;
use sqlx::{Database, Pool, Transaction};
use tokio::task::JoinSet;

use super::statement::{SqlConnection, Statement, sql};
use crate::access::IdSource;
use crate::jobs::error::StoreError;
use crate::jobs::id::JobId;
use crate::jobs::queue::{Notifier, RetryPolicy};
use crate::jobs::store::{Connections, Store};
use crate::jobs::timestamp::Clock;

/// A condition at the end of a `WHERE` clause that lets the commit return before it is on disk. Claims and heartbeats use it. If
/// the database's machine fails before the next synced commit, the job is queued again, and its worker finds its lease lost.
macro_rules! unsynced {
    () => {
        " AND set_config('synchronous_commit', 'off', true) = 'off'"
    };
}
pub(super) use unsynced;

/// A database in which the store can be kept.
///
/// Shared statements are written for PostgreSQL. `meshmend_now($n)` is the parameter if it is not null, or else the database's
/// time. Statements lock rows as PostgreSQL's concurrent transactions require.
pub trait Dialect: Database<Connection: SqlConnection> {
    /// The statement that begins a writing transaction.
    const BEGIN: &'static str;
    /// Whether triggers notify every process of changes, so that the store need not.
    const NOTIFIES: bool;
    /// Claims the next job: worker, token, now, duration of the lease in milliseconds, maximum of running jobs of a tenant.
    const CLAIM: &'static str;
    /// Selects a page of jobs: tenant, key, statuses, last id of the previous page, maximum of rows, outcomes, created from, created
    /// before, metadata. Statuses, outcomes and metadata are JSON.
    const LIST: &'static str;
    /// The same for a list of one status, without reading the jobs of others.
    const LIST_OF_STATUS: &'static str;
    /// Counts the jobs `ahead` of a job: tenant, time when the job is due, id.
    const QUEUE_POSITION: &'static str;
    /// Selects the milliseconds for which the next job has `waited` since it was due: now.
    const LONGEST_WAIT: &'static str;
}

/// The row type of a database.
type RowOf<D> = <<D as Database>::Connection as SqlConnection>::Row;

/// The store in a SQL database: jobs, keys, tenants, uploads and webhooks.
pub struct SqlStore<D: Dialect> {
    /// Connections for reading, and also for writing if `writer` is `None`.
    pub(super) pool: Pool<D>,
    /// A single connection for writing, for a database in which a write locks everything.
    pub(super) writer: Option<Pool<D>>,
    /// The clock; `None` to use the database's clock.
    pub(super) clock: Option<Arc<dyn Clock>>,
    /// The source of ids, tokens and the jitter of retries.
    pub(super) ids: Arc<dyn IdSource>,
    /// When failed attempts are retried.
    pub(super) retry: RetryPolicy,
    /// Notifies listeners in this process.
    pub(super) notifier: Arc<Notifier>,
    /// The task that listens to the database's notifications until the store is dropped.
    #[expect(dead_code, reason = "a set of tasks aborts them when it is dropped")]
    pub(super) listener: JoinSet<()>,
}

impl<D: Dialect> SqlStore<D> {
    /// The same store with ids and tokens from `ids` instead of the operating system.
    #[must_use]
    pub fn with_ids(self, ids: Arc<dyn IdSource>) -> Self {
        Self { ids, ..self }
    }

    /// A new id that sorts by time: the prefix, `_` and a UUID of version 7.
    pub(super) fn new_id(&self, prefix: &str) -> String {
        format!("{prefix}_{}", self.ids.sortable().simple())
    }

    /// A new token of a lease.
    pub(super) fn new_token(&self) -> String {
        self.ids.random().simple().to_string()
    }

    /// The current time in milliseconds since the Unix epoch; `None` to use the database's time.
    pub(super) fn now(&self) -> Option<i64> {
        self.clock.as_ref().map(|clock| clock.now_ms())
    }

    /// A connection for reading.
    pub(super) async fn reader(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.pool.acquire().await?)
    }

    /// A connection for writing.
    pub(super) async fn writer(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).acquire().await?)
    }

    /// Begins a writing transaction.
    pub(super) async fn begin(&self) -> Result<Transaction<'static, D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).begin_with(D::BEGIN).await?)
    }

    /// Runs a reading statement and converts its rows.
    pub(super) async fn read_all<T>(
        &self,
        statement: Statement<'_>,
        read: impl Fn(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Vec<T>, StoreError> {
        self.reader().await?.query(statement).await?.iter().map(read).collect()
    }

    /// Runs a reading statement and converts its row, if there is one.
    pub(super) async fn read_one<T>(
        &self,
        statement: Statement<'_>,
        read: impl FnOnce(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Option<T>, StoreError> {
        self.reader().await?.query_row(statement).await?.as_ref().map(read).transpose()
    }

    /// Runs a writing statement and converts the row that it returns, if there is one.
    pub(super) async fn write_one<T>(
        &self,
        statement: Statement<'_>,
        read: impl FnOnce(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Option<T>, StoreError> {
        self.writer().await?.query_row(statement).await?.as_ref().map(read).transpose()
    }

    /// Whether `statement` finds no row to write. Only asks where a write would lock the whole database, to avoid needless locks.
    pub(super) async fn is_idle(&self, statement: Statement<'_>) -> Result<bool, StoreError> {
        Ok(self.writer.is_some() && self.reader().await?.query(statement).await?.is_empty())
    }

    /// Notifies of a change to a job, unless the database does.
    pub(super) fn notify_job(&self, id: JobId) {
        if !D::NOTIFIES {
            self.notifier.notify_job(id);
        }
    }

    /// Notifies of work to claim, unless the database does.
    pub(super) fn notify_work(&self) {
        if !D::NOTIFIES {
            self.notifier.notify_work();
        }
    }

    /// Notifies of deliveries to claim, unless the database does.
    pub(super) fn notify_deliveries(&self) {
        if !D::NOTIFIES {
            self.notifier.notify_deliveries();
        }
    }
}

#[async_trait]
impl<D: Dialect> Store for SqlStore<D> {
    async fn ping(&self) -> Result<(), StoreError> {
        self.reader().await?.execute(sql("SELECT 1")).await?;
        Ok(())
    }

    fn connections(&self) -> Connections {
        let pools = [Some(&self.pool), self.writer.as_ref()];
        pools.into_iter().flatten().map(Connections::of).fold(Connections::default(), |sum, of| Connections {
            busy: sum.busy + of.busy,
            idle: sum.idle + of.idle,
            most: sum.most + of.most,
        })
    }

    fn notifier(&self) -> &Notifier {
        &self.notifier
    }
}
