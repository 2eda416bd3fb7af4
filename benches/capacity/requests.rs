//! Requests to one API process, from many clients at once for a given time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::Value;

use crate::cpu;
use crate::drive::{Service, get, submit};
use crate::postgres::Postgres;
use crate::server::Program;

const CLIENTS: usize = 16;
/// More jobs than a client submits in one round.
const MAX_JOBS: usize = 100_000;

/// What each client sends, again and again.
#[derive(Clone)]
pub enum Request {
    /// This binary STL, each time with another header, so that no result can be used twice.
    Submit(Arc<[u8]>),
    /// The status of one of these jobs.
    Poll(Arc<[String]>),
}

/// How many requests were answered in some time, and what they took.
pub struct Rate {
    pub count: usize,
    pub api_cpu: Duration,
    pub database_cpu: Duration,
    time: Duration,
    /// Sorted.
    times: Vec<Duration>,
}

impl Rate {
    pub fn per_second(&self) -> f64 {
        self.count as f64 / self.time.as_secs_f64()
    }

    /// Milliseconds that this share of the requests stayed below.
    pub fn millis(&self, share: f64) -> f64 {
        let last = self.times.len() - 1;
        self.times[(share * last as f64) as usize].as_secs_f64() * 1e3
    }

    /// Milliseconds of processor time for each request.
    pub fn cpu_millis(&self, cpu: Duration) -> f64 {
        cpu.as_secs_f64() * 1e3 / self.count as f64
    }
}

/// Sends requests of one kind for some time. Rounds with different numbers submit different models.
pub async fn rate(
    program: &Program,
    cluster: Option<&Postgres>,
    request: &Request,
    round: usize,
    time: Duration,
) -> Rate {
    let api = [program.pid()];
    let database: Vec<u32> = cluster.iter().map(|cluster| cluster.server.id()).collect();
    let (api_before, database_before) = (cpu::used(&api), cpu::used(&database));
    let started = Instant::now();
    let clients = (0..CLIENTS).map(|client| {
        let first = (round * CLIENTS + client) * MAX_JOBS;
        tokio::spawn(send(service(program), request.clone(), first, started + time))
    });
    let clients: Vec<_> = clients.collect();
    let mut times = Vec::new();
    for client in clients {
        times.extend(client.await.expect("no panic"));
    }
    let time = started.elapsed();
    times.sort_unstable();
    Rate {
        count: times.len(),
        api_cpu: cpu::used(&api).saturating_sub(api_before),
        database_cpu: cpu::used(&database).saturating_sub(database_before),
        time,
        times,
    }
}

/// Sends requests until the given time, and returns what each took.
async fn send(service: Service, request: Request, first: usize, until: Instant) -> Vec<Duration> {
    let http = Client::new();
    let mut times = Vec::new();
    while Instant::now() < until {
        let job = first + times.len();
        match &request {
            Request::Submit(model) => {
                let mut model = model.to_vec();
                model[..8].copy_from_slice(&job.to_le_bytes());
                let begin = Instant::now();
                submit(&http, &service, model).await;
                times.push(begin.elapsed());
            }
            Request::Poll(ids) => {
                let begin = Instant::now();
                let answer = get(&http, &format!("{}/{}", service.jobs, ids[job % ids.len()])).await;
                answer.bytes().await.expect("a job");
                times.push(begin.elapsed());
            }
        }
    }
    times
}

/// The ids of some jobs.
pub async fn some_ids(program: &Program) -> Vec<String> {
    let page: Value =
        get(&Client::new(), &format!("{}?limit=100", service(program).jobs)).await.json().await.expect("a list");
    let jobs = page["jobs"].as_array().expect("jobs");
    jobs.iter().map(|job| job["id"].as_str().expect("an id").to_owned()).collect()
}

/// The service of a program.
pub fn service(program: &Program) -> Service {
    Service {
        name: "meshmend".to_owned(),
        jobs: format!("{}/v1/jobs", program.url),
        result: "artifacts/model",
        options: None,
        processes: vec![program.pid()],
    }
}
