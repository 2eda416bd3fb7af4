//! Jobs per second through the whole service: the same client has the same small models repaired by the built program on SQLite
//! and on PostgreSQL, which both sync what they accept to disk, and by a plain service of FastAPI and pymeshfix (benches/peers),
//! where `MESHMEND_PEER_PYTHON` names a Python that has its requirements. Then what the queue itself costs on each store.
//!
//! `cargo bench --features service --bench jobs_per_second -- [JOBS] [CLIENTS] [ROUNDS]`; of several rounds each figure is the median. With the word `queue`
//! only what the queue costs.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

mod cpu;
mod drive;
#[path = "../../tests/support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod meshes;
mod models;
mod peer;
#[path = "../../tests/support/postgres.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod postgres;
mod queue;
#[path = "../../tests/support/server.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod server;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use drive::{Figures, Service, drive};
use meshmend::analyze::{Analyst, AnalyzeOptions};
use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::format::Limits;
use meshmend::jobs::{JobReport, PostgresStore, RetryPolicy, SqliteStore, Store, SystemClock};
use meshmend::repair::{Options, repair};
use models::Model;
use peer::Peer;
use postgres::Postgres;
use serde_json::{Value, json};
use server::{Program, Start};

#[tokio::main]
async fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let number = |at: usize, otherwise| numbers.get(at).copied().unwrap_or(otherwise).max(1);
    let (jobs, clients, rounds) = (number(0, 1000), number(1, 8), number(2, 1));
    meshmend::tls::use_ring();
    let data = tempfile::tempdir().expect("a folder");
    let cluster = Postgres::start_with(true);
    if !std::env::args().any(|argument| argument == "queue") {
        services(data.path(), &cluster, jobs, clients, rounds).await;
    }
    queues(data.path(), &cluster, jobs).await;
}

async fn services(data: &Path, cluster: &Postgres, jobs: usize, clients: usize, rounds: usize) {
    let folders = ["sqlite", "postgres"].map(|name| data.join(name));
    let [sqlite, postgres] = folders.each_ref().map(|data| Start::serve(data).arg("--log", "warn,meshmend::cli=info"));
    let (sqlite, postgres) = (sqlite.start(), postgres.arg("--database-url", cluster.url()).start());
    let python = std::env::var("MESHMEND_PEER_PYTHON").ok();
    let peers: Vec<(&str, Peer)> = python
        .iter()
        .flat_map(|python| {
            let limit = Some(Duration::from_secs(60));
            [
                ("FastAPI + pymeshfix, threads", 0, None),
                ("FastAPI + pymeshfix, 2 processes", 2, None),
                ("FastAPI + pymeshfix, a process a job", 2, limit),
            ]
            .map(|(name, processes, limit)| (name, Peer::start(python, processes, limit)))
        })
        .collect();
    let mut services = Vec::new();
    for (name, program, more) in [("SQLite", &sqlite, None), ("PostgreSQL", &postgres, Some(cluster.server.id()))] {
        services.push(meshmend(format!("meshmend, {name}"), program, more, json!({"pictures": false})));
        services.push(meshmend(format!("meshmend, {name}, with pictures"), program, more, json!({})));
    }
    services.extend(peers.iter().map(|(name, peer)| peer.service((*name).to_owned())));

    println!("{jobs} jobs, {clients} clients, {rounds} rounds");
    for model in Model::ALL {
        // All services in each round, so that other work on the machine meets all of them.
        let mut runs: Vec<Vec<Figures>> = services.iter().map(|_| Vec::new()).collect();
        for round in 0..rounds {
            for (service, runs) in services.iter().zip(&mut runs) {
                runs.push(drive(service, model, round * jobs..(round + 1) * jobs, clients).await);
            }
        }
        println!("\n{}", model.name());
        println!(
            "{:40} {:>8} {:>8} {:>14} {:>14} {:>10} {:>10}",
            "", "jobs/s", "total s", "submit p50 ms", "submit p99 ms", "CPU ms/job", "printable"
        );
        for (service, runs) in services.iter().zip(&runs) {
            println!(
                "{:40} {:8.1} {:8.2} {:14.2} {:14.2} {:10.2} {:>10}",
                service.name,
                median(runs, Figures::per_second),
                median(runs, |run| run.all.as_secs_f64()),
                median(runs, |run| run.submit(0.5)),
                median(runs, |run| run.submit(0.99)),
                median(runs, Figures::cpu_per_job),
                if runs.iter().all(|run| is_printable(&run.result)) { "yes" } else { "no" },
            );
        }
    }
}

/// One of meshmend's programs, to be driven with these options.
fn meshmend(name: String, program: &Program, database: Option<u32>, options: Value) -> Service {
    let processes = [program.pid()].into_iter().chain(database).collect();
    let jobs = format!("{}/v1/jobs", program.url);
    Service { name, jobs, result: "artifacts/model", options: Some(options), processes }
}

async fn queues(data: &Path, cluster: &Postgres, jobs: usize) {
    let policy = RetryPolicy::default();
    let sqlite = SqliteStore::open(&data.join("queue.db"), Arc::new(SystemClock), policy).await.expect("a store");
    let postgres = PostgresStore::open(&cluster.url(), 10, None, policy).await.expect("a store");
    let report = report();
    println!(
        "\nthe queue itself: submit, claim, progress and end of {jobs} jobs, one after the other, each synced to disk"
    );
    println!("{:40} {:>8} {:>8} {:>10}", "", "p50 ms", "p99 ms", "CPU ms/job");
    for (name, store) in [("SQLite", &sqlite as &dyn Store), ("PostgreSQL", &postgres)] {
        // With its children, of which the database's server is one.
        let before = cpu::used(&[std::process::id()]);
        let times = queue::times(store, jobs, &report).await;
        let cpu = (cpu::used(&[std::process::id()]) - before) / u32::try_from(jobs).expect("few");
        let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
        let [half, most] = [jobs / 2, jobs * 99 / 100].map(|at| milliseconds(times[at]));
        println!("{name:40} {half:8.2} {most:8.2} {:10.2}", milliseconds(cpu));
    }
}

/// The account of a repair.
fn report() -> JobReport {
    let repaired = with_context(|context| {
        repair(&Model::Box.bytes(0), &Options::default(), &Limits::default(), None, context).expect("a result")
    });
    JobReport::Repair(Box::new(repaired.report))
}

/// What our own inspection says of a result, whoever made it.
fn is_printable(result: &[u8]) -> bool {
    let (options, limits) = (AnalyzeOptions::default(), Limits::default());
    with_context(|context| {
        let mut analyst = Analyst::new(&options, &limits, 1, context).expect("it can begin");
        analyst.add("result", None, result).expect("a model");
        analyst.finish().expect("a report").printable == Some(true)
    })
}

fn with_context<T>(work: impl FnOnce(&Context<'_>) -> T) -> T {
    let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
    work(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60)))
}

fn median(runs: &[Figures], figure: impl Fn(&Figures) -> f64) -> f64 {
    let mut figures: Vec<f64> = runs.iter().map(figure).collect();
    figures.sort_by(f64::total_cmp);
    figures[figures.len() / 2]
}
