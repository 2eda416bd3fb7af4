//! The store over SQL: its connections, and what each database does in its own way ([`Dialect`]).

use std::sync::Arc;

use async_trait::async_trait;
use sqlx::pool::PoolConnection;
use sqlx::{Database, Pool, Transaction};
use tokio::task::JoinSet;

use super::statement::{SqlConnection, Statement, sql};
use crate::jobs::error::StoreError;
use crate::jobs::id::{IdSource, JobId};
use crate::jobs::queue::{Notifier, RetryPolicy};
use crate::jobs::store::{Connections, Store};
use crate::jobs::timestamp::Clock;

/// The end of a `WHERE` clause: the commit does not wait for the disk. For claims and heartbeats, which the next synced commit writes out.
/// If the database's machine is lost before, the job is queued again and its worker learns that its lease is lost.
macro_rules! unsynced {
    () => {
        " AND set_config('synchronous_commit', 'off', true) = 'off'"
    };
}
pub(super) use unsynced;

/// A database that the store runs on.
///
/// Shared statements are written for PostgreSQL. `meshmend_now($n)` is the database's time, or the parameter where that is not null;
/// rows are locked as PostgreSQL's concurrent transactions need it.
pub trait Dialect: Database<Connection: SqlConnection> {
    /// Begins a transaction that writes.
    const BEGIN: &'static str;
    /// Whether triggers notify every process of changes, so that the store has no need to.
    const NOTIFIES: bool;
    /// Claims the job whose turn it is: worker, token, now, milliseconds of the lease, most running jobs of a tenant.
    const CLAIM: &'static str;
    /// Selects a page of jobs: tenant, key, statuses, id of the page before, most rows, outcomes, time from, time before, metadata.
    /// Statuses, outcomes and metadata are JSON.
    const LIST: &'static str;
    /// Counts the jobs `ahead` of one: tenant, time when it is due, id.
    const QUEUE_POSITION: &'static str;
    /// Selects the milliseconds that the next job has `waited` since it was due: now.
    const LONGEST_WAIT: &'static str;
}

/// The rows of a database.
type RowOf<D> = <<D as Database>::Connection as SqlConnection>::Row;

/// Jobs, and all else that the service keeps, in a SQL database.
pub struct SqlStore<D: Dialect> {
    /// Connections for reading, and for writing where `writer` is none.
    pub(super) pool: Pool<D>,
    /// A single connection for writing, where a write locks the whole database.
    pub(super) writer: Option<Pool<D>>,
    /// The clock; none where the database's own is used.
    pub(super) clock: Option<Arc<dyn Clock>>,
    /// Where names, tokens and the jitter of retries come from.
    pub(super) ids: Arc<dyn IdSource>,
    pub(super) retry: RetryPolicy,
    pub(super) notifier: Arc<Notifier>,
    /// Listens to the database's notifications until the store is dropped.
    #[expect(dead_code, reason = "a set of tasks aborts them when it is dropped")]
    pub(super) listener: JoinSet<()>,
}

impl<D: Dialect> SqlStore<D> {
    /// The same store with names and tokens from `ids`, in place of the operating system's.
    #[must_use]
    pub fn with_ids(self, ids: Arc<dyn IdSource>) -> Self {
        Self { ids, ..self }
    }

    /// A new name that sorts by time: the prefix, `_` and a UUID of version 7.
    pub(super) fn new_id(&self, prefix: &str) -> String {
        format!("{prefix}_{}", self.ids.sortable().simple())
    }

    /// A new token of a claim.
    pub(super) fn new_token(&self) -> String {
        self.ids.random().simple().to_string()
    }

    /// The time, where it is not the database's.
    pub(super) fn now(&self) -> Option<i64> {
        self.clock.as_ref().map(|clock| clock.now_ms())
    }

    pub(super) async fn reader(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.pool.acquire().await?)
    }

    pub(super) async fn writer(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).acquire().await?)
    }

    pub(super) async fn begin(&self) -> Result<Transaction<'static, D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).begin_with(D::BEGIN).await?)
    }

    /// Runs a statement that reads, and reads its rows.
    pub(super) async fn read_all<T>(
        &self,
        statement: Statement<'_>,
        read: impl Fn(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Vec<T>, StoreError> {
        self.reader().await?.query(statement).await?.iter().map(read).collect()
    }

    /// Runs a statement that reads, and reads its row, if there is one.
    pub(super) async fn read_one<T>(
        &self,
        statement: Statement<'_>,
        read: impl FnOnce(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Option<T>, StoreError> {
        self.reader().await?.query_row(statement).await?.as_ref().map(read).transpose()
    }

    /// Runs a statement that writes, and reads the row that it returns, if there is one.
    pub(super) async fn write_one<T>(
        &self,
        statement: Statement<'_>,
        read: impl FnOnce(&RowOf<D>) -> Result<T, StoreError> + Send,
    ) -> Result<Option<T>, StoreError> {
        self.writer().await?.query_row(statement).await?.as_ref().map(read).transpose()
    }

    /// Whether a statement finds nothing to write. Asked only where a write would lock the whole database; most rounds find nothing.
    pub(super) async fn is_idle(&self, statement: Statement<'_>) -> Result<bool, StoreError> {
        Ok(self.writer.is_some() && self.reader().await?.query(statement).await?.is_empty())
    }

    pub(super) fn notify_job(&self, id: JobId) {
        if !D::NOTIFIES {
            self.notifier.notify_job(id);
        }
    }

    pub(super) fn notify_work(&self) {
        if !D::NOTIFIES {
            self.notifier.notify_work();
        }
    }

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
