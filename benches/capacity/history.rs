//! Statements on a PostgreSQL database with many finished jobs.

use std::time::{Duration, Instant};

use meshmend::jobs::{JobStore, PostgresStore, RetryPolicy};
use sqlx::{Connection, PgConnection};

use crate::postgres::Postgres;
use crate::queue;

/// Jobs that are claimed and completed in each measurement.
const JOBS: usize = 400;
/// More time than they need.
const TIME: Duration = Duration::from_secs(60);
const FINISHED: u32 = 300_000;
/// Copies one finished job, and lets autovacuum's work be done.
const COPIES: [&str; 3] = [
    "SET session_replication_role = replica",
    "INSERT INTO jobs SELECT copy.* FROM jobs AS job, generate_series(1, 300000) AS number, \
     LATERAL jsonb_populate_record(job, jsonb_build_object('id', 'job_' || lpad(to_hex(number), 32, '0'))) AS copy \
     WHERE job.id = (SELECT id FROM jobs WHERE status = 'succeeded' LIMIT 1)",
    "VACUUM ANALYZE jobs",
];

/// Prints how long the statements take that could depend on the number of finished jobs.
pub async fn print() {
    let cluster = Postgres::start_with(true);
    let store = PostgresStore::open(&cluster.url(), 10, None, RetryPolicy::default()).await.expect("a store");
    queue::submit(&store, JOBS).await;
    let (claims, ends) = queue::rates(&store, TIME).await;
    queue::submit(&store, JOBS).await;
    let mut connection = PgConnection::connect(&cluster.url()).await.expect("a connection");
    for statement in COPIES {
        sqlx::raw_sql(statement).execute(&mut connection).await.expect("done");
    }
    let (claims_later, ends_later) = queue::rates(&store, TIME).await;
    println!("\n{:44} {:>9} {:>9}", "PostgreSQL, finished jobs in the table", JOBS, FINISHED);
    println!("{:44} {claims:9.0} {claims_later:9.0}", "  claims per second");
    println!("{:44} {ends:9.0} {ends_later:9.0}", "  completions per second");
    println!("{:44} {:>9} {:9.1}", "  counting the jobs for /metrics, ms", "", counting(&store).await);
}

/// The fastest of three counts, in milliseconds.
async fn counting(store: &PostgresStore) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let started = Instant::now();
        store.counts().await.expect("counts");
        best = best.min(started.elapsed().as_secs_f64() * 1e3);
    }
    best
}
