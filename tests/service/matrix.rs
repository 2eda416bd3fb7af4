//! Each fault hits jobs at every stage at once, and no job is lost.
//!
//! The stages: half uploaded, just claimed, in each tier, about to be stored, about to be completed, and ended with a
//! webhook that is not yet answered. `statements.rs` breaks connections to the database.

use std::collections::BTreeSet;
use std::path::PathBuf;

use reqwest::{Body, Response};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::files;
use crate::postgres::Postgres;
use crate::s3::S3;
use crate::server::{Api, Program, Start, files_below, is_alive, mounts_small_disks, signal, until};
use crate::support::FILES_PER_JOB;
use crate::support::audit::Audit;
use crate::support::disk::{disk, fill, has_spool_open};
use crate::support::fake_blender::fake_blender;
use crate::support::receiver::{Receiver, Reply};

/// The failpoint where a worker or its child waits for a gate file, and the model and preset of a job that reaches it.
type Stage = (&'static str, fn() -> Vec<u8>, &'static str);

const STAGES: [Stage; 6] = [
    ("worker-claimed", files::broken_box, "auto"),
    ("child-tier1", files::broken_box, "fill-holes"),
    ("child-tier2", files::boxes_on_an_edge, "auto"),
    ("child-tier3", files::boxes_on_an_edge, "fill-holes"),
    ("worker-publish", files::broken_box, "auto"),
    ("worker-complete", files::broken_box, "auto"),
];
/// Indices of two of these stages.
const CLAIMED: usize = 0;
const COMPLETE: usize = 5;
/// Size of each process's disk, in MiB.
const DISK: u32 = 24;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// `kill -9` of every job's process.
    Child,
    /// `kill -9` of every worker.
    Worker,
    Server,
    Database,
    Bucket,
    /// The disk of every process is full.
    Disk,
    /// Every process is paused until its leases have expired.
    Pause,
}

impl Fault {
    /// The lease of a job. It outlasts short outages, so that the same attempt survives them.
    fn lease(self) -> &'static str {
        match self {
            Self::Database | Self::Bucket | Self::Disk => "20",
            Self::Child | Self::Worker | Self::Server | Self::Pause => "2",
        }
    }
}

/// What the processes share: a database and a bucket.
struct Environment {
    folder: TempDir,
    lease: &'static str,
    small_disks: bool,
    cluster: Postgres,
    bucket: S3,
    receiver: Receiver,
}

impl Environment {
    /// The data folder of a process if it has no small disk.
    fn data(&self, name: &str) -> PathBuf {
        let data = self.folder.path().join(name);
        std::fs::create_dir_all(&data).expect("a folder");
        data
    }

    fn serve(&self, name: &str, address: &str) -> Program {
        let data = self.data(name);
        let start = Start::serve_on(address, &data)
            .env("MESHMEND_NO_WORKERS", "true")
            .env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true")
            .arg("--webhook-timeout-s", "1")
            .arg("--webhook-retry-s", ["0.2"; 40].join(","));
        self.start(start)
    }

    /// Starts a worker for one job at a time, which waits at a stage if one is given.
    fn work(&self, name: &str, stage: Option<&str>) -> Program {
        // A sandboxed child sees only its own folder.
        let gate = |stage: &str| if stage.starts_with("child") { PathBuf::from("gate") } else { self.gate() };
        let waits = stage.map(|stage| format!("{stage}=return({})", gate(stage).display())).unwrap_or_default();
        let data = self.data(name);
        let start = Start::work(&data).blender(&self.folder.path().join("blender"));
        self.start(start.arg("--workers", "1").env("FAILPOINTS", &waits))
    }

    fn start(&self, start: Start<'_>) -> Program {
        let start = self.bucket.store_files_of(start).env("MESHMEND_DATABASE_URL", &self.cluster.url());
        let start = start.env("MESHMEND_LEASE_S", self.lease).arg("--min-free-mib", "0");
        if self.small_disks { start.on_small_disk(DISK).expect("a small disk") } else { start.start() }
    }

    fn gate(&self) -> PathBuf {
        self.folder.path().join("gate")
    }
}

/// An upload of which half has been sent.
struct Upload {
    rest: mpsc::Sender<Result<Vec<u8>, std::io::Error>>,
    response: JoinHandle<reqwest::Result<Response>>,
}

/// Jobs at all stages.
struct JobsAtStages {
    environment: Environment,
    audit: Audit,
    api: Api,
    server: Program,
    /// One for each stage.
    workers: Vec<Program>,
    accepted: Vec<String>,
    upload: Upload,
}

impl JobsAtStages {
    async fn set(fault: Fault) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        // A Blender whose every run fails.
        fake_blender(folder.path(), "exit 1");
        let environment = Environment {
            folder,
            lease: fault.lease(),
            small_disks: fault == Fault::Disk,
            cluster: Postgres::start(),
            bucket: S3::start(),
            receiver: Receiver::start(&[Reply::Hang, Reply::Status(204)]).await,
        };
        let server = environment.serve("server", "127.0.0.1:0");
        let (api, audit) = (Api::new(&server), Audit::begin(&environment.cluster.url()).await);
        let endpoint = api.post("/v1/webhook-endpoints").json(&json!({"url": environment.receiver.url}));
        assert_eq!(endpoint.send().await.expect("a response").status(), 201);
        let (mut workers, mut accepted) = (Vec::new(), Vec::new());
        for (stage, model, preset) in STAGES {
            let worker = environment.work(stage, Some(stage));
            let options = json!({"preset": preset, "max_tier": 3, "pictures": false});
            let id = api.submit(model(), options).await;
            until("the job has reached its stage", async || {
                is_at(stage, &environment, &api, &worker, &id).await.then_some(())
            })
            .await;
            workers.push(worker);
            accepted.push(id);
        }
        // No worker is free to claim it.
        let canceled = api.submit(files::whole_box(), json!({})).await;
        let response = api.post(&format!("/v1/jobs/{canceled}/cancel")).send().await.expect("a response");
        assert_eq!(response.status(), 200);
        accepted.push(canceled);
        environment.receiver.got(1).await;
        let upload = half_an_upload(&api, &server).await;
        Self { environment, audit, api, server, workers, accepted, upload }
    }

    fn open_gates(&self) {
        for worker in &self.workers {
            for child in worker.job_children() {
                // The child may have ended.
                let _ = std::fs::write(format!("/proc/{child}/cwd/gate"), "");
            }
        }
        std::fs::write(self.environment.gate(), "").expect("a file");
    }

    /// The processes of all jobs.
    fn of_jobs(&self) -> Vec<u32> {
        self.workers.iter().flat_map(Program::job_processes).collect()
    }

    /// Sends the rest of the upload, and repeats the whole upload until it is accepted.
    async fn finish_upload(&mut self) {
        let model = files::whole_box();
        let _ = self.upload.rest.send(Ok(model[model.len() / 2..].to_vec())).await;
        let (closed, _) = mpsc::channel(1);
        self.upload.rest = closed;
        let response = (&mut self.upload.response).await.expect("no panic");
        let accepted = match response {
            Ok(response) if response.status() == 202 => response,
            _ => {
                until("the model is accepted", async || {
                    let sent = self.api.post("/v1/jobs").body(files::whole_box()).send().await.ok()?;
                    assert!([202, 503].contains(&sent.status().as_u16()), "{sent:?}");
                    (sent.status() == 202).then_some(sent)
                })
                .await
            }
        };
        let job: Value = accepted.json().await.expect("a job");
        self.accepted.push(job["id"].as_str().expect("an id").to_owned());
    }
}

async fn is_at(stage: &str, environment: &Environment, api: &Api, worker: &Program, id: &str) -> bool {
    let job = api.job(id).await;
    let files_of_attempt =
        || environment.bucket.files().iter().filter(|key| key.starts_with("jobs/") && key.contains(id)).count();
    let has_report = || {
        let data = disk(worker, &environment.data(stage));
        files_below(&data.join("scratch")).iter().any(|file| file.ends_with("report-full.json"))
    };
    match stage {
        "worker-claimed" => job["status"] == "running",
        "worker-publish" => worker.job_children().is_empty() && has_report(),
        "worker-complete" => files_of_attempt() == FILES_PER_JOB - 1,
        tier => {
            let tier = tier.trim_start_matches("child-tier").parse::<u64>().expect("a tier");
            job["progress"]["stage"] == "repair" && job["progress"]["tier"] == tier
        }
    }
}

/// Sends half of a model, and waits until the server has begun to store it.
async fn half_an_upload(api: &Api, server: &Program) -> Upload {
    let (rest, receiver) = mpsc::channel(1);
    let body =
        futures::stream::unfold(receiver, |mut r: mpsc::Receiver<_>| async { r.recv().await.map(|chunk| (chunk, r)) });
    let response = tokio::spawn(api.post("/v1/jobs").body(Body::wrap_stream(body)).send());
    let model = files::whole_box();
    rest.send(Ok(model[..model.len() / 2].to_vec())).await.expect("the upload listens");
    until("the upload has begun", async || has_spool_open(server).then_some(())).await;
    Upload { rest, response }
}

async fn tries_again(worker: &Program, words: &str) {
    until(words, async || worker.log().contains(words).then_some(())).await;
}

async fn every_job_ends_once(fault: Fault) {
    let mut scene = JobsAtStages::set(fault).await;
    let processes = scene.of_jobs();
    assert!(processes.len() >= 3, "one in each tier");
    let others = inject_fault(&mut scene, fault, &processes).await;
    scene.finish_upload().await;
    scene.audit.at_rest().await;
    assert_all_ended(&scene, fault).await;
    until("no process is left", async || processes.iter().all(|pid| !is_alive(*pid)).then_some(())).await;
    for program in scene.workers.iter().chain(&others).chain([&scene.server]) {
        assert!(!program.log().contains("panicked"), "{}", program.log());
    }
}

/// Injects a fault into all jobs at once, and lets them continue. Returns the programs that replace killed ones.
#[expect(clippy::too_many_lines, reason = "one arm for each fault")]
async fn inject_fault(scene: &mut JobsAtStages, fault: Fault, processes: &[u32]) -> Vec<Program> {
    let mut others = Vec::new();
    match fault {
        Fault::Child => {
            processes.iter().for_each(|pid| signal(*pid, "KILL"));
            scene.open_gates();
        }
        Fault::Worker => {
            scene.workers.drain(..).for_each(Program::kill);
            others.push(scene.environment.work("other", None));
        }
        Fault::Server => {
            let address = scene.api.url.trim_start_matches("http://").to_owned();
            signal(scene.server.pid(), "KILL");
            scene.server.wait();
            scene.open_gates();
            let of_workers = async || {
                let open = "SELECT count(*) FROM jobs WHERE finished_at IS NULL";
                let open: i64 = sqlx::query_scalar(open).fetch_one(&scene.audit.pool).await.expect("a count");
                (open == 0).then_some(())
            };
            until("all jobs finish without it", of_workers).await;
            scene.server = scene.environment.serve("server", &address);
        }
        Fault::Database => {
            scene.environment.cluster.kill();
            scene.open_gates();
            tries_again(&scene.workers[COMPLETE], "transient failure; retrying").await;
            scene.environment.cluster.restart();
        }
        Fault::Bucket => {
            scene.environment.bucket.kill();
            scene.open_gates();
            tries_again(&scene.workers[CLAIMED], "transient failure; retrying").await;
            scene.environment.bucket.restart();
        }
        Fault::Disk => {
            let full = scene
                .workers
                .iter()
                .zip(STAGES)
                .map(|(worker, (stage, ..))| disk(worker, &scene.environment.data(stage)));
            let full = full.chain([disk(&scene.server, &scene.environment.data("server"))]);
            let fillers: Vec<_> = full.map(|disk| fill(&disk, 0)).collect();
            scene.open_gates();
            tries_again(&scene.workers[CLAIMED], "No space left on device").await;
            for filler in fillers {
                std::fs::remove_file(filler).expect("removed");
            }
        }
        Fault::Pause => {
            let still: Vec<_> = scene.workers.iter().chain([&scene.server]).map(Program::pid).collect();
            still.iter().for_each(|pid| signal(*pid, "STOP"));
            others.extend([scene.environment.work("other", None), scene.environment.serve("another", "127.0.0.1:0")]);
            scene.audit.at_rest().await;
            still.iter().for_each(|pid| signal(*pid, "CONT"));
            scene.open_gates();
            for worker in &scene.workers {
                tries_again(worker, "lease lost; result dropped").await;
            }
        }
    }
    others
}

async fn assert_all_ended(scene: &JobsAtStages, fault: Fault) {
    let JobsAtStages { environment, audit, accepted, .. } = scene;
    assert_eq!(audit.ended_once(accepted).await, accepted.len(), "no other jobs");
    audit.delivered_once(&environment.receiver).await;
    let ends: Vec<(String, i64)> =
        sqlx::query_as("SELECT status, attempt FROM jobs ORDER BY id").fetch_all(&audit.pool).await.expect("jobs");
    assert_eq!(ends.iter().filter(|(status, _)| status == "canceled").count(), 1, "{ends:?}");
    assert_eq!(ends.iter().filter(|(status, _)| status == "succeeded").count(), STAGES.len() + 1, "{ends:?}");
    if matches!(fault, Fault::Server | Fault::Database | Fault::Bucket) {
        assert!(ends.iter().all(|(_, attempt)| *attempt <= 1), "the fault costs no attempt: {ends:?}");
    }
    let owned = audit.owned().await;
    until("the jobs' files are there and no others", async || {
        (environment.bucket.files().into_iter().collect::<BTreeSet<_>>() == owned).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_their_processes_are_killed_at_every_stage() {
    every_job_ends_once(Fault::Child).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_the_workers_are_killed_at_every_stage() {
    every_job_ends_once(Fault::Worker).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_the_server_is_killed_and_the_next_one_sends_their_webhooks() {
    every_job_ends_once(Fault::Server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_the_database_is_killed_at_every_stage() {
    every_job_ends_once(Fault::Database).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_the_bucket_is_down_at_every_stage() {
    every_job_ends_once(Fault::Bucket).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_disks_are_full_at_every_stage() {
    if mounts_small_disks() {
        every_job_ends_once(Fault::Disk).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_if_all_processes_pause_beyond_their_leases_at_every_stage() {
    every_job_ends_once(Fault::Pause).await;
}
