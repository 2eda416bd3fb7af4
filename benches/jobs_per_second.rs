//! Jobs per second through the whole service: submits small models over HTTP to the built program, waits until all are
//! done, and says where the time goes.
//!
//! `cargo bench --bench jobs_per_second -- [JOBS] [CLIENTS]`

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

#[path = "../tests/support/files.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod files;
#[path = "../tests/support/server.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod server;

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use server::{Api, Start};

#[tokio::main]
async fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let jobs = numbers.first().copied().unwrap_or(1000);
    let clients = numbers.get(1).copied().unwrap_or(8);
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--log", "warn,meshmend::cli=info,meshmend::worker::pool=info").start();
    let api = Api::new(&program);

    let started = Instant::now();
    let submitting: Vec<_> = (0..clients)
        .map(|client| {
            let api = api.clone();
            tokio::spawn(async move {
                let mut ids = Vec::new();
                let mut spent = Duration::ZERO;
                for _ in (client..jobs).step_by(clients) {
                    let begin = Instant::now();
                    ids.push(api.submit(files::broken_box(), json!({"max_tier": 1})).await);
                    spent += begin.elapsed();
                }
                (ids, spent)
            })
        })
        .collect();
    let mut ids = Vec::new();
    let mut submitting_time = Duration::ZERO;
    for client in submitting {
        let (mine, spent) = client.await.expect("no panic");
        ids.extend(mine);
        submitting_time += spent;
    }
    let submitted = started.elapsed();
    let mut engine = 0.0;
    let mut service = 0.0;
    for id in &ids {
        let job = loop {
            let answer = api.get(&format!("/v1/jobs/{id}?wait=60")).send().await.expect("an answer");
            let job: Value = answer.json().await.expect("a job");
            if !job["finished_at"].is_null() {
                break job;
            }
        };
        assert_eq!(job["outcome"], "repaired", "{job}");
        engine += job["report"]["milliseconds"].as_f64().expect("a number");
        service += milliseconds(&job, "finished_at") - milliseconds(&job, "started_at");
    }
    let all = started.elapsed();
    let count = jobs as f64;
    println!(
        "{jobs} jobs, {clients} clients: {:.1} jobs per second, {:.2} s in all",
        count / all.as_secs_f64(),
        all.as_secs_f64()
    );
    println!("  submitted after              {:8.2} s", submitted.as_secs_f64());
    println!("  a POST takes                 {:8.2} ms", submitting_time.as_secs_f64() * 1e3 / count);
    println!("  claim to completion          {:8.2} ms", service / count);
    println!("  of which in the engine       {:8.2} ms", engine / count);
}

/// A time of a job, in milliseconds of its day.
fn milliseconds(job: &Value, field: &str) -> f64 {
    let text = job[field].as_str().expect("a time");
    let clock = text.split_once('T').expect("a time").1.trim_end_matches('Z');
    clock.split(':').fold(0.0, |sum, part| sum * 60.0 + part.parse::<f64>().expect("a number")) * 1e3
}
