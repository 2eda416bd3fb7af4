//! A whole service of several processes with what they stand on, and how each of them is hit.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use sqlx::PgPool;
use tempfile::TempDir;

use super::random::Random;
use crate::postgres::Postgres;
use crate::s3::S3;
use crate::server::{Program, Start, files_below, make_old, mounts_small_disks, signal};
use crate::support::disk::{disk, fill};
use crate::support::receiver::{Receiver, Reply};

/// Who is hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Victim {
    Child,
    Worker,
    Server,
    Database,
    /// The S3 server.
    Bucket,
    /// The disk on which a process has its scratch folders, and what is on its way into the bucket: full for a moment.
    Disk,
    /// A process that stands still until its leases have run out, and goes on.
    Paused,
    /// All connections to the database, wherever they are in a statement.
    Connections,
    /// Who is told of jobs: away for a moment.
    Receiver,
}

/// Where files are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Files {
    /// In a folder that all processes share.
    Folder,
    /// In a bucket, and each process has a small disk of its own, where the machine allows that.
    Bucket,
}

const SERVERS: usize = 2;
const WORKERS: usize = 2;
/// Room on a process's own disk, and how much of it must be free, in MiB.
const DISK: u32 = 24;
const FREE: &str = "4";

/// A process: where it keeps its data, where it listens if it serves, and itself.
struct Seat {
    data: PathBuf,
    address: Option<String>,
    program: Option<Program>,
}

pub struct Service {
    folder: TempDir,
    pub cluster: Postgres,
    bucket: Option<S3>,
    small_disks: bool,
    pub receiver: Receiver,
    servers: Vec<Seat>,
    workers: Vec<Seat>,
}

impl Service {
    pub async fn start(files: Files, random: &mut Random) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let in_bucket = files == Files::Bucket;
        // A third of all messages meet somebody who is not well, and none for ever.
        let replies: Vec<_> = (0..2000)
            .map(|_| match random.below(9) {
                0 => Reply::Status(500),
                1 => Reply::Status(503),
                2 => Reply::Hang,
                _ => Reply::Status(204),
            })
            .chain([Reply::Status(204)])
            .collect();
        let mut service = Self {
            cluster: Postgres::start(),
            bucket: in_bucket.then(S3::start),
            small_disks: in_bucket && mounts_small_disks(),
            receiver: Receiver::start(&replies).await,
            servers: Vec::new(),
            workers: Vec::new(),
            folder,
        };
        for number in 0..SERVERS {
            let mut seat = service.seat(&format!("server-{number}"), Some("127.0.0.1:0"));
            service.fill_seat(&mut seat);
            let url = &seat.program.as_ref().expect("it runs").url;
            seat.address = Some(url.trim_start_matches("http://").to_owned());
            service.servers.push(seat);
        }
        for number in 0..WORKERS {
            let mut seat = service.seat(&format!("worker-{number}"), None);
            service.fill_seat(&mut seat);
            service.workers.push(seat);
        }
        service
    }

    fn seat(&self, name: &str, address: Option<&str>) -> Seat {
        let name = if self.bucket.is_some() { name } else { "shared" };
        let data = self.folder.path().join(name);
        std::fs::create_dir_all(&data).expect("a folder");
        Seat { data, address: address.map(str::to_owned), program: None }
    }

    /// Starts the process that belongs there.
    fn fill_seat(&self, seat: &mut Seat) {
        let start = match &seat.address {
            Some(address) => Start::serve_on(address, &seat.data)
                .env("MESHMEND_NO_WORKERS", "true")
                .env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true")
                .arg("--webhook-timeout-s", "0.5")
                .arg("--webhook-retry-s", [["0.1"; 10].join(","), ["1"; 30].join(",")].join(",")),
            // Each stage takes a moment, so that there is something to hit.
            None => {
                let stages = [
                    "child-read",
                    "child-tier1",
                    "child-verify",
                    "worker-claimed",
                    "worker-publish",
                    "worker-complete",
                ];
                let slow = stages.map(|stage| format!("{stage}=sleep(15)")).join(";");
                Start::work(&seat.data).env("FAILPOINTS", &slow)
            }
        };
        let start = start.env("MESHMEND_DATABASE_URL", &self.cluster.url());
        let start = match &self.bucket {
            Some(bucket) => bucket.keeps_files_of(start).arg("--min-free-mib", FREE),
            None => start,
        };
        seat.program = if self.small_disks { start.on_small_disk(DISK) } else { Some(start.start()) };
    }

    /// The addresses of its servers.
    pub fn addresses(&self) -> Vec<String> {
        self.servers.iter().filter_map(|seat| seat.address.clone()).collect()
    }

    /// Who can be hit.
    pub fn victims(&self) -> Vec<Victim> {
        use Victim as V;
        let mut victims = vec![V::Child, V::Worker, V::Server, V::Database, V::Paused, V::Connections, V::Receiver];
        victims.extend(self.bucket.is_some().then_some(V::Bucket));
        victims.extend(self.small_disks.then_some(V::Disk));
        victims
    }

    #[expect(clippy::too_many_lines, reason = "one arm for each victim")]
    pub async fn hit(&mut self, victim: Victim, random: &mut Random) {
        let moment = Duration::from_millis(random.below(700) as u64);
        let (server, worker) = (random.below(SERVERS), random.below(WORKERS));
        match victim {
            Victim::Child => {
                let children = self.workers[worker].program.as_ref().expect("it runs").job_children();
                if !children.is_empty() {
                    // It may have ended by now.
                    let pid = children[random.below(children.len())].to_string();
                    let _ = Command::new("kill").args(["-KILL", &pid]).stderr(Stdio::null()).status();
                }
            }
            Victim::Worker => {
                let mut seat = self.workers.swap_remove(worker);
                seat.program.take().expect("it runs").kill();
                self.fill_seat(&mut seat);
                self.workers.push(seat);
            }
            Victim::Server => {
                let mut seat = self.servers.swap_remove(server);
                seat.program.take().expect("it runs").kill();
                self.fill_seat(&mut seat);
                self.servers.push(seat);
            }
            Victim::Database => {
                self.cluster.kill();
                tokio::time::sleep(moment).await;
                self.cluster.restart();
            }
            Victim::Bucket => {
                let bucket = self.bucket.as_mut().expect("a bucket");
                bucket.kill();
                tokio::time::sleep(moment).await;
                bucket.restart();
            }
            Victim::Disk => {
                let seat = self.any(random);
                let filler = fill(&disk(seat.program.as_ref().expect("it runs"), &seat.data), 0);
                tokio::time::sleep(moment).await;
                std::fs::remove_file(filler).expect("removed");
            }
            Victim::Paused => {
                let pid = self.any(random).program.as_ref().expect("it runs").pid();
                signal(pid, "STOP");
                tokio::time::sleep(Duration::from_millis(2200)).await;
                signal(pid, "CONT");
            }
            Victim::Connections => {
                let Ok(pool) = PgPool::connect(&self.cluster.url()).await else { return };
                let _ = sqlx::query(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'meshmend'",
                )
                .execute(&pool)
                .await;
                pool.close().await;
            }
            Victim::Receiver => {
                self.receiver.set_away(true);
                tokio::time::sleep(moment).await;
                self.receiver.set_away(false);
            }
        }
    }

    fn any(&self, random: &mut Random) -> &Seat {
        let all: Vec<_> = self.servers.iter().chain(&self.workers).collect();
        all[random.below(all.len())]
    }

    /// Stops all processes as a service manager does, and sees that none panicked and none of a job is left.
    pub fn stop(&mut self) {
        for seat in self.servers.iter_mut().chain(&mut self.workers) {
            let mut program = seat.program.take().expect("it runs");
            assert!(!program.log().contains("panicked"), "{}", program.log());
            program.terminate();
            program.wait();
        }
        assert_eq!(orphans(self.folder.path()), [""; 0]);
    }

    /// The keys of all stored files.
    pub fn files(&self) -> Vec<String> {
        let root = self.root();
        let key = |path: PathBuf| path.strip_prefix(&root).expect("inside").to_string_lossy().into_owned();
        files_below(&root).into_iter().map(key).collect()
    }

    fn root(&self) -> PathBuf {
        self.bucket.as_ref().map_or_else(|| self.folder.path().join("shared/files"), S3::objects)
    }

    /// Makes all files old, and starts a worker, which begins with a sweep.
    pub fn sweep(&mut self) {
        make_old(&self.root());
        let mut seat = self.seat("sweeper", None);
        self.fill_seat(&mut seat);
        self.workers.push(seat);
    }
}

/// Processes that run a job in this folder.
fn orphans(folder: &Path) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").expect("/proc").flatten();
    let lines = processes.filter_map(|process| std::fs::read(process.path().join("cmdline")).ok());
    let lines = lines.map(|line| String::from_utf8_lossy(&line).replace('\0', " "));
    lines.filter(|line| line.contains("job-child") && line.contains(&*folder.to_string_lossy())).collect()
}
