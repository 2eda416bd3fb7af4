//! The client, the same for every service: it submits models by form, looks whether they are done, and downloads the results.

use std::ops::Range;
use std::time::{Duration, Instant};

use reqwest::Client;
use reqwest::multipart::{Form, Part};
use serde_json::Value;

use crate::cpu;
use crate::models::Model;

/// How long a client waits before it asks again about a job that is not done.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Longest wait for one job.
const PATIENCE: Duration = Duration::from_secs(300);

/// A running service.
#[derive(Clone)]
pub struct Service {
    pub name: String,
    /// Where jobs are submitted, and found by their id.
    pub jobs: String,
    /// The result's address after a job's own.
    pub result: &'static str,
    /// What is sent as the form's `options`.
    pub options: Option<Value>,
    /// The processes that do the work, with all they start.
    pub processes: Vec<u32>,
}

/// What a run took.
pub struct Figures {
    pub jobs: usize,
    pub all: Duration,
    /// Of each request that submits, sorted.
    submits: Vec<Duration>,
    /// Processor time of the service.
    cpu: Duration,
    /// One of the results.
    pub result: Vec<u8>,
}

impl Figures {
    pub fn per_second(&self) -> f64 {
        self.jobs as f64 / self.all.as_secs_f64()
    }

    /// Processor time of the service, in milliseconds.
    pub fn cpu_per_job(&self) -> f64 {
        self.cpu.as_secs_f64() * 1e3 / self.jobs as f64
    }

    /// Milliseconds that this share of the submitting requests stayed below.
    pub fn submit(&self, share: f64) -> f64 {
        let last = self.submits.len() - 1;
        self.submits[(share * last as f64) as usize].as_secs_f64() * 1e3
    }
}

/// Has these jobs done for so many clients at once. Each submits its share, then takes its results in the same order.
pub async fn drive(service: &Service, model: Model, jobs: Range<usize>, clients: usize) -> Figures {
    let share = |client: usize| jobs.clone().skip(client).step_by(clients).map(|job| model.bytes(job)).collect();
    let shares: Vec<Vec<Vec<u8>>> = (0..clients).map(share).collect();
    let jobs = jobs.len();
    let before = cpu::used(&service.processes);
    let started = Instant::now();
    let running: Vec<_> = shares.into_iter().map(|models| tokio::spawn(client(service.clone(), models))).collect();
    let (mut submits, mut result) = (Vec::with_capacity(jobs), Vec::new());
    for client in running {
        let done = client.await.expect("no panic");
        submits.extend(done.submits);
        result = done.result;
    }
    let all = started.elapsed();
    submits.sort_unstable();
    let cpu = cpu::used(&service.processes).saturating_sub(before);
    Figures { jobs, all, submits, cpu, result }
}

struct Done {
    submits: Vec<Duration>,
    result: Vec<u8>,
}

async fn client(service: Service, models: Vec<Vec<u8>>) -> Done {
    let http = Client::new();
    let (mut ids, mut submits) = (Vec::with_capacity(models.len()), Vec::with_capacity(models.len()));
    for model in models {
        let begin = Instant::now();
        ids.push(submit(&http, &service, model).await);
        submits.push(begin.elapsed());
    }
    let mut result = Vec::new();
    for id in ids {
        let job = format!("{}/{id}", service.jobs);
        let begin = Instant::now();
        loop {
            let answer: Value = get(&http, &job).await.json().await.expect("a job");
            match answer["status"].as_str() {
                Some("succeeded") => break,
                Some("queued" | "running") => assert!(begin.elapsed() < PATIENCE, "{} does not end", service.name),
                _ => panic!("{}: {answer}", service.name),
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
        let file = get(&http, &format!("{job}/{}", service.result)).await;
        result = file.bytes().await.expect("a model").to_vec();
    }
    Done { submits, result }
}

pub async fn submit(http: &Client, service: &Service, model: Vec<u8>) -> String {
    let mut form = Form::new().part("file", Part::bytes(model).file_name("model.stl"));
    if let Some(options) = &service.options {
        form = form.text("options", options.to_string());
    }
    let answer = http.post(&service.jobs).multipart(form).send().await.expect("an answer");
    assert_eq!(answer.status(), 202, "{}", service.name);
    let job: Value = answer.json().await.expect("a job");
    job["id"].as_str().expect("an id").to_owned()
}

pub async fn get(http: &Client, url: &str) -> reqwest::Response {
    let answer = http.get(url).send().await.expect("an answer");
    assert_eq!(answer.status(), 200, "{url}");
    answer
}
