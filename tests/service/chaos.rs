//! Kills at random, while clients go on submitting: no accepted job is lost, none ends twice, each one ends.
//!
//! `MESHMEND_KILLS=500 cargo test --features failpoints --test service -- --ignored --nocapture chaos` is the long run; `MESHMEND_KILL_SEED`
//! draws other kills.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use sqlx::PgPool;

use crate::files;
use crate::postgres::Postgres;
use crate::server::{Program, Start, signal};

/// Random numbers by a seed (SplitMix64).
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % sides as u64) as usize
    }
}

/// Who is hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Victim {
    Child,
    Worker,
    Server,
    Database,
    /// A worker that stands still until its leases have run out, and goes on.
    PausedWorker,
    /// All connections to the database, wherever they are in a statement.
    Connections,
}

const VICTIMS: [Victim; 6] =
    [Victim::Child, Victim::Worker, Victim::Server, Victim::Database, Victim::PausedWorker, Victim::Connections];
const WORKERS: usize = 2;
const CLIENTS: usize = 3;
/// How long everything may take to come to its end after the last kill.
const PATIENCE: Duration = Duration::from_secs(120);

/// A whole service of several processes.
struct Service<'a> {
    data: &'a Path,
    cluster: Postgres,
    server: Option<Program>,
    workers: Vec<Option<Program>>,
    address: String,
    url: String,
}

impl<'a> Service<'a> {
    fn start(data: &'a Path) -> Self {
        let cluster = Postgres::start();
        let url = cluster.url();
        let server = Self::serve(data, &url, "127.0.0.1:0").start();
        let address = server.url.trim_start_matches("http://").to_owned();
        let workers = (0..WORKERS).map(|_| Some(Self::work(data, &url).start())).collect();
        Self { data, cluster, server: Some(server), workers, address, url }
    }

    fn serve(data: &'a Path, url: &str, address: &str) -> Start<'a> {
        Start::serve_on(address, data).env("MESHMEND_DATABASE_URL", url).env("MESHMEND_NO_WORKERS", "true")
    }

    /// Each stage takes a moment, so that there is something to hit.
    fn work(data: &'a Path, url: &str) -> Start<'a> {
        let slow = ["child-read", "child-tier1", "child-verify", "worker-claimed", "worker-publish", "worker-complete"];
        let slow = slow.map(|stage| format!("{stage}=sleep(15)")).join(";");
        Start::work(data).env("MESHMEND_DATABASE_URL", url).env("FAILPOINTS", &slow)
    }

    async fn hit(&mut self, victim: Victim, dice: &mut Dice) {
        let which = dice.roll(WORKERS);
        match victim {
            Victim::Child => {
                let children = self.workers[which].as_ref().expect("it runs").job_children();
                if !children.is_empty() {
                    // It may have ended by now.
                    let pid = children[dice.roll(children.len())].to_string();
                    let _ = std::process::Command::new("kill")
                        .args(["-KILL", &pid])
                        .stderr(std::process::Stdio::null())
                        .status();
                }
            }
            Victim::Worker => {
                self.workers[which].take().expect("it runs").kill();
                self.workers[which] = Some(Self::work(self.data, &self.url).start());
            }
            Victim::Server => {
                self.server.take().expect("it runs").kill();
                self.server = Some(Self::serve(self.data, &self.url, &self.address).start());
            }
            Victim::Database => {
                self.cluster.kill();
                tokio::time::sleep(Duration::from_millis(dice.roll(500) as u64)).await;
                self.cluster.restart();
            }
            Victim::PausedWorker => {
                let pid = self.workers[which].as_ref().expect("it runs").pid();
                signal(pid, "STOP");
                tokio::time::sleep(Duration::from_millis(2000)).await;
                signal(pid, "CONT");
            }
            Victim::Connections => {
                let Ok(pool) = PgPool::connect(&self.url).await else { return };
                let _ = sqlx::query(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'meshmend'",
                )
                .execute(&pool)
                .await;
                pool.close().await;
            }
        }
    }

    /// Notes every end of a job, beside what the program itself knows of it.
    async fn audit(&self) -> PgPool {
        let pool = PgPool::connect(&self.url).await.expect("a connection");
        for statement in [
            "CREATE TABLE audit (id TEXT NOT NULL, status TEXT NOT NULL)",
            "CREATE FUNCTION note_end() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN \
                 INSERT INTO audit VALUES (NEW.id, NEW.status); RETURN NULL; END $$",
            "CREATE TRIGGER ends AFTER UPDATE ON jobs FOR EACH ROW \
                 WHEN (NEW.finished_at IS NOT NULL AND OLD.status IS DISTINCT FROM NEW.status) EXECUTE FUNCTION note_end()",
        ] {
            sqlx::query(statement).execute(&pool).await.expect("made");
        }
        pool
    }
}

/// What the clients share.
struct Load {
    address: String,
    stop: AtomicBool,
    accepted: Mutex<Vec<String>>,
    refused: AtomicUsize,
    /// Answers that no client should get: anything but 202, 409 of its own key, 503.
    wrong: Mutex<Vec<String>>,
}

/// Submits one job after the other, each with a key under which it is sent until the answer comes.
async fn client(load: Arc<Load>, number: usize) {
    meshmend::tls::use_ring();
    let http = Client::builder().timeout(Duration::from_secs(20)).build().expect("a client");
    let url = format!("http://{}/v1/jobs?max_tier=1&pictures=false", load.address);
    for turn in 0.. {
        let key = format!("client-{number}-{turn}");
        loop {
            if load.stop.load(Ordering::Relaxed) {
                return;
            }
            let request = http.post(&url).header("idempotency-key", &key).header("cache-control", "no-cache");
            match request.body(files::broken_box()).send().await {
                Ok(answer) if answer.status() == 202 => {
                    let Ok(job) = answer.json::<Value>().await else { continue };
                    load.accepted.lock().expect("a list").push(job["id"].as_str().expect("an id").to_owned());
                    break;
                }
                Ok(answer) if [409, 429, 503].contains(&answer.status().as_u16()) => {
                    load.refused.fetch_add(1, Ordering::Relaxed);
                }
                Ok(answer) => {
                    let text = format!("{} {}", answer.status(), answer.text().await.unwrap_or_default());
                    load.wrong.lock().expect("a list").push(text);
                }
                // The server is being killed.
                Err(_) => {}
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        tokio::time::sleep(Duration::from_millis(150)).await;
    }
}

async fn get(http: &Client, url: String) -> Option<reqwest::Response> {
    http.get(url).timeout(Duration::from_secs(10)).send().await.ok().filter(|answer| answer.status() == 200)
}

/// Processes that run a job of this data folder.
fn orphans(data: &Path) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").expect("/proc").flatten();
    let lines = processes.filter_map(|process| std::fs::read(process.path().join("cmdline")).ok());
    let lines = lines.map(|line| String::from_utf8_lossy(&line).replace('\0', " "));
    lines.filter(|line| line.contains("job-child") && line.contains(&*data.to_string_lossy())).collect()
}

async fn survive(kills: usize, seed: u64) {
    let data = tempfile::tempdir().expect("a folder");
    let mut service = Service::start(data.path());
    let audit = service.audit().await;
    let load = Arc::new(Load {
        address: service.address.clone(),
        stop: AtomicBool::new(false),
        accepted: Mutex::new(Vec::new()),
        refused: AtomicUsize::new(0),
        wrong: Mutex::new(Vec::new()),
    });
    let clients: Vec<_> = (0..CLIENTS).map(|number| tokio::spawn(client(Arc::clone(&load), number))).collect();
    let (mut dice, mut hits) = (Dice(seed), BTreeMap::new());
    for _ in 0..kills {
        tokio::time::sleep(Duration::from_millis(50 + dice.roll(350) as u64)).await;
        let victim = VICTIMS[dice.roll(VICTIMS.len())];
        *hits.entry(victim).or_insert(0) += 1;
        service.hit(victim, &mut dice).await;
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    load.stop.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.expect("a client's end");
    }
    let accepted = load.accepted.lock().expect("a list").clone();
    assert_eq!(*load.wrong.lock().expect("a list"), [""; 0]);
    assert!(accepted.len() > kills / 4, "only {} jobs were accepted", accepted.len());

    // Everything ends.
    meshmend::tls::use_ring();
    let (http, base) = (Client::new(), format!("http://{}", service.address));
    let until = Instant::now() + PATIENCE;
    loop {
        let open: Result<i64, _> =
            sqlx::query_scalar("SELECT count(*) FROM jobs WHERE finished_at IS NULL").fetch_one(&audit).await;
        if open.as_ref().is_ok_and(|open| *open == 0) {
            break;
        }
        assert!(Instant::now() < until, "{open:?} jobs have not ended");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut outcomes: BTreeMap<String, usize> = BTreeMap::new();
    for id in &accepted {
        let job: Value =
            get(&http, format!("{base}/v1/jobs/{id}")).await.expect("the job").json().await.expect("a job");
        let code = job["problem"]["code"].as_str().unwrap_or_default();
        *outcomes.entry(format!("{} {code}", job["status"].as_str().expect("text"))).or_default() += 1;
        if job["status"] == "succeeded" {
            for (name, artifact) in job["artifacts"].as_object().expect("files") {
                let file = get(&http, format!("{base}/v1/jobs/{id}/artifacts/{name}")).await.expect("the file");
                let hash = hex::encode(Sha256::digest(file.bytes().await.expect("bytes")));
                assert_eq!(artifact["sha256"], json!(hash), "{id} {name}");
            }
            assert!(job["artifacts"]["model"].is_object(), "{job}");
        } else {
            // Killed with its worker or child three times over.
            assert!(["crashed", "worker_lost"].contains(&code), "{job}");
        }
    }
    // Each job ended once, and there is none that nobody was told of but those whose answer was lost.
    let ends: Vec<(String, i64)> =
        sqlx::query_as("SELECT id, count(*) FROM audit GROUP BY id").fetch_all(&audit).await.expect("the audit");
    let twice: Vec<_> = ends.iter().filter(|(_, count)| *count != 1).collect();
    assert!(twice.is_empty(), "{twice:?}");
    let ends: BTreeMap<_, _> = ends.into_iter().collect();
    assert!(accepted.iter().all(|id| ends.contains_key(id)));
    let unique: std::collections::BTreeSet<_> = accepted.iter().collect();
    assert_eq!(unique.len(), accepted.len(), "each key made its own job");
    for program in service.workers.iter_mut().chain([&mut service.server]) {
        let mut program = program.take().expect("it runs");
        assert!(!program.log().contains("panicked"), "{}", program.log());
        program.terminate();
        program.wait();
    }
    assert_eq!(orphans(data.path()), [""; 0]);
    let refused = load.refused.load(Ordering::Relaxed);
    let line =
        format!("{kills} kills (seed {seed}) {hits:?}: {} accepted, {outcomes:?}, {refused} refused", accepted.len());
    let _ = writeln!(std::io::stderr(), "{line}");
}

#[tokio::test(flavor = "multi_thread")]
async fn no_job_is_lost_or_done_twice_by_a_dozen_kills() {
    survive(12, 7).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes"]
async fn no_job_is_lost_or_done_twice_by_hundreds_of_kills() {
    let number =
        |name: &str, otherwise: u64| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(otherwise);
    let kills = usize::try_from(number("MESHMEND_KILLS", 500)).expect("a number");
    survive(kills, number("MESHMEND_KILL_SEED", 1)).await;
}
