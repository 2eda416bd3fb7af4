//! What PostgreSQL wrote, from its statistics ("The Cumulative Statistics System" in its manual), and what its tables hold.

use sqlx::{PgPool, Row};

use crate::postgres::Postgres;

/// What a cluster has done since its start.
#[derive(Clone, Copy)]
pub struct Usage {
    wal_bytes: f64,
    wal_syncs: f64,
    commits: f64,
}

impl Usage {
    /// The usage of a cluster; none for SQLite.
    pub async fn of(cluster: Option<&Postgres>) -> Option<Self> {
        let pool = PgPool::connect(&cluster?.url()).await.expect("a connection");
        // PostgreSQL 18 counts the syncs of the log in pg_stat_io.
        let row = sqlx::query(
            "SELECT pg_wal_lsn_diff(pg_current_wal_insert_lsn(), '0/0')::float8, wal_sync::float8, \
             (SELECT sum(xact_commit) FROM pg_stat_database)::float8 FROM pg_stat_wal",
        );
        let row = row.fetch_one(&pool).await.ok()?;
        Some(Self { wal_bytes: row.get(0), wal_syncs: row.get(1), commits: row.get(2) })
    }

    pub fn since(self, before: &Self) -> Self {
        Self {
            wal_bytes: self.wal_bytes - before.wal_bytes,
            wal_syncs: self.wal_syncs - before.wal_syncs,
            commits: self.commits - before.commits,
        }
    }

    /// The shares of one of `jobs`, as text.
    pub fn per_job(self, jobs: usize) -> String {
        let share = |sum: f64| sum / jobs as f64;
        format!(
            "{:.2} transactions, {:.1} KiB of log, {:.2} syncs of the log",
            share(self.commits),
            share(self.wal_bytes) / 1024.0,
            share(self.wal_syncs)
        )
    }
}

/// Rows of all tables, and bytes of all tables with their indexes.
pub async fn size(cluster: &Postgres) -> (i64, i64) {
    let pool = PgPool::connect(&cluster.url()).await.expect("a connection");
    let tables = "SELECT relname::text, pg_total_relation_size(relid) FROM pg_stat_user_tables";
    let tables = sqlx::query(tables).fetch_all(&pool).await.expect("tables");
    let (mut rows, mut bytes) = (0, 0);
    for table in tables {
        let name: String = table.get(0);
        let count = sqlx::query(sqlx::AssertSqlSafe(format!("SELECT count(*) FROM \"{name}\"")));
        rows += count.fetch_one(&pool).await.expect("a count").get::<i64, _>(0);
        bytes += table.get::<i64, _>(1);
    }
    (rows, bytes)
}
