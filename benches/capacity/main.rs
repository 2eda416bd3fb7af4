//! Capacity: what one API process, one worker core, one PostgreSQL and one bucket carry, and what a job leaves in them.
//!
//! `cargo bench --features service --bench capacity -- [SECONDS]`; each measurement of requests takes that long, three times, and the fastest
//! counts. CPU times depend less on other work on the machine than rates do. docs/capacity.md plans machines from these figures.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

mod bucket;
#[path = "../jobs_per_second/cpu.rs"]
mod cpu;
mod database;
#[path = "../jobs_per_second/drive.rs"]
#[allow(dead_code, reason = "shared with another benchmark")]
mod drive;
mod history;
mod memory;
#[path = "../../tests/support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod meshes;
#[path = "../jobs_per_second/models.rs"]
#[allow(dead_code, reason = "shared with another benchmark")]
mod models;
#[path = "../../tests/support/postgres.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod postgres;
mod queue;
mod requests;
#[path = "../../tests/support/s3.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod s3;
#[path = "../../tests/support/server.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod server;
mod work;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use meshmend::jobs::{PostgresStore, RetryPolicy, SqliteStore, Store, SystemClock};
use models::Model;
use postgres::Postgres;
use requests::{Rate, Request};
use server::{Program, Start};

/// Rounds of each measurement, of which the fastest counts.
const ROUNDS: usize = 3;
/// A line of settings for programs that must not log each request.
const LOG: &str = "warn,meshmend::cli=info";

#[tokio::main]
async fn main() {
    let seconds = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(2.0);
    let time = Duration::from_secs_f64(seconds);
    meshmend::tls::use_ring();
    let data = tempfile::tempdir().expect("a folder");
    println!("this disk: {:.0} fdatasync per second of one 4 KiB file", syncs_per_second(data.path()));
    let cluster = Postgres::start_with(true);
    println!(
        "\n{:44} {:>9} {:>8} {:>8} {:>12} {:>12}",
        "one API process", "per s", "p50 ms", "p99 ms", "API CPU ms", "DB CPU ms"
    );
    api(&data.path().join("sqlite"), None, time).await;
    api(&data.path().join("postgres"), Some(&cluster), time).await;
    work::print(data.path()).await;
    bucket::print(data.path()).await;
    history::print().await;
}

/// Measures requests to one API process, and the claims and ends of the jobs that the requests leave behind.
async fn api(data: &Path, cluster: Option<&Postgres>, time: Duration) {
    let name = cluster.map_or("SQLite", |_| "PostgreSQL");
    let before = database::Usage::of(cluster).await;
    let program = start(data, cluster);
    let (submits, count) = best(&program, cluster, Request::Submit(Model::Box.bytes(0).into()), time).await;
    print_rate(&format!("{name}: submissions of 1 KB, 16 clients"), &submits);
    let peak = memory::peak_mib(program.pid());
    end(program);
    if let (Some(before), Some(after)) = (before, database::Usage::of(cluster).await) {
        println!("{:44} {}", "  the database, per submission", after.since(&before).per_job(count));
    }
    let program = start(data, cluster);
    let large = Request::Submit(Model::Ring(100_000).bytes(0).into());
    let (large, _) = best(&program, cluster, large, time).await;
    print_rate(&format!("{name}: submissions of 5 MB, 16 clients"), &large);
    let ids = requests::some_ids(&program).await;
    let (polls, _) = best(&program, cluster, Request::Poll(ids.into()), time).await;
    print_rate(&format!("{name}: status requests, 16 clients"), &polls);
    println!(
        "{:44} {peak:.0} MiB at most while files arrive, {:.0} MiB after the status requests",
        "  memory of the API process",
        memory::peak_mib(program.pid())
    );
    drop(program);
    let policy = RetryPolicy::default();
    let store: Box<dyn Store> = match cluster {
        None => Box::new(
            SqliteStore::open(&data.join("meshmend.db"), Arc::new(SystemClock), policy).await.expect("a store"),
        ),
        Some(cluster) => Box::new(PostgresStore::open(&cluster.url(), 10, None, policy).await.expect("a store")),
    };
    let (claims, ends) = queue::rates(store.as_ref(), time).await;
    println!("{:44} {claims:9.0}", format!("{name}: claims, 4 at once"));
    println!("{:44} {ends:9.0}", format!("{name}: completions, 4 at once"));
}

/// An API process without workers that accepts any number of jobs.
fn start(data: &Path, cluster: Option<&Postgres>) -> Program {
    let start =
        Start::serve(data).arg("--log", LOG).arg("--max-queued", "100000000").env("MESHMEND_NO_WORKERS", "true");
    match cluster {
        None => start.start(),
        Some(cluster) => start.arg("--database-url", cluster.url()).start(),
    }
}

/// Ends the program as an operator does, so that PostgreSQL counts all of its work.
fn end(mut program: Program) {
    program.terminate();
    program.wait();
    std::thread::sleep(Duration::from_millis(500));
}

/// The fastest of some rounds, and the number of requests in all of them.
async fn best(program: &Program, cluster: Option<&Postgres>, request: Request, time: Duration) -> (Rate, usize) {
    let mut rates = Vec::new();
    for round in 0..ROUNDS {
        rates.push(requests::rate(program, cluster, &request, round, time).await);
    }
    let count = rates.iter().map(|rate| rate.count).sum();
    (rates.into_iter().max_by(|a, b| a.per_second().total_cmp(&b.per_second())).expect("a round"), count)
}

fn print_rate(name: &str, rate: &Rate) {
    println!(
        "{name:44} {:9.0} {:8.2} {:8.2} {:12.3} {:12.3}",
        rate.per_second(),
        rate.millis(0.5),
        rate.millis(0.99),
        rate.cpu_millis(rate.api_cpu),
        rate.cpu_millis(rate.database_cpu)
    );
}

/// How often a second this disk keeps a block of one file.
fn syncs_per_second(folder: &Path) -> f64 {
    let mut file = std::fs::File::create(folder.join("synced")).expect("a file");
    let (started, mut count) = (Instant::now(), 0);
    while started.elapsed() < Duration::from_secs(1) {
        file.write_all(&[0; 4096]).and_then(|()| file.sync_data()).expect("written");
        count += 1;
    }
    f64::from(count) / started.elapsed().as_secs_f64()
}
