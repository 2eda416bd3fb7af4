//! The store over SQL: the statements that both databases share, and what each database does in its own way ([`Dialect`]).

mod access;
mod deliveries;
mod drawings;
mod endpoints;
mod jobs;
mod keys;
mod outbox;
mod queue;
mod retention;
mod statement;
mod uploads;

use std::sync::Arc;

use async_trait::async_trait;
use sqlx::pool::PoolConnection;
use sqlx::{Database, Pool, Transaction};
use tokio::task::JoinSet;

pub(super) use statement::{SqlConnection, Statement};

use statement::sql;

use super::{Bell, Clock, Connections, JobId, RetryPolicy, Store, StoreError};

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

/// Jobs, and all else that the service keeps, in a SQL database.
pub struct SqlStore<D: Dialect> {
    /// Connections for reading, and for writing where `writer` is none.
    pub(super) pool: Pool<D>,
    /// A single connection for writing, where a write locks the whole database.
    pub(super) writer: Option<Pool<D>>,
    /// The clock; none where the database's own is used.
    pub(super) clock: Option<Arc<dyn Clock>>,
    pub(super) retry: RetryPolicy,
    pub(super) bell: Arc<Bell>,
    /// Listens to the database's notifications until the store is dropped.
    #[expect(dead_code, reason = "a set of tasks aborts them when it is dropped")]
    pub(super) listener: JoinSet<()>,
}

impl<D: Dialect> SqlStore<D> {
    /// The time, where it is not the database's.
    fn now(&self) -> Option<i64> {
        self.clock.as_ref().map(|clock| clock.now_ms())
    }

    async fn reader(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.pool.acquire().await?)
    }

    async fn writer(&self) -> Result<PoolConnection<D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).acquire().await?)
    }

    async fn begin(&self) -> Result<Transaction<'static, D>, StoreError> {
        Ok(self.writer.as_ref().unwrap_or(&self.pool).begin_with(D::BEGIN).await?)
    }

    /// Whether a statement finds nothing to write. Asked only where a write would lock the whole database; most rounds find nothing.
    async fn is_idle(&self, statement: Statement<'_>) -> Result<bool, StoreError> {
        Ok(self.writer.is_some() && self.reader().await?.query(statement).await?.is_empty())
    }

    fn notify_job(&self, id: JobId) {
        if !D::NOTIFIES {
            self.bell.ring(id);
        }
    }

    fn notify_work(&self) {
        if !D::NOTIFIES {
            self.bell.ring_for_work();
        }
    }

    fn notify_deliveries(&self) {
        if !D::NOTIFIES {
            self.bell.ring_for_deliveries();
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

    fn bell(&self) -> &Bell {
        &self.bell
    }
}
