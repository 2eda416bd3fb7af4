//! A service of several processes, with its database, bucket and webhook receiver, and a fault for each.

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

/// The target of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Victim {
    Child,
    Worker,
    Server,
    Database,
    /// The S3 server.
    Bucket,
    /// A process's disk, which is full for a moment. It holds scratch folders and files on their way to the bucket.
    Disk,
    /// A process that is paused until its leases have expired.
    Paused,
    /// All connections to the database, in the middle of any statement.
    Connections,
    /// The webhook receiver, which is unreachable for a moment.
    Receiver,
}

/// Where files are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Files {
    /// In a folder that all processes share.
    Folder,
    /// In a bucket, and each process has its own small disk if the machine allows mounting one.
    Bucket,
}

const SERVERS: usize = 2;
const WORKERS: usize = 2;
/// Size of a process's disk, and the free space that it requires, in MiB.
const DISK: u32 = 24;
const FREE: &str = "4";

/// A process with its data folder, and its address if it serves.
struct Slot {
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
    servers: Vec<Slot>,
    workers: Vec<Slot>,
}

impl Service {
    pub async fn start(files: Files, random: &mut Random) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let in_bucket = files == Files::Bucket;
        // The receiver fails a third of all messages, but none of them forever.
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
            let mut slot = service.slot(&format!("server-{number}"), Some("127.0.0.1:0"));
            service.start_process(&mut slot);
            let url = &slot.program.as_ref().expect("it runs").url;
            slot.address = Some(url.trim_start_matches("http://").to_owned());
            service.servers.push(slot);
        }
        for number in 0..WORKERS {
            let mut slot = service.slot(&format!("worker-{number}"), None);
            service.start_process(&mut slot);
            service.workers.push(slot);
        }
        service
    }

    fn slot(&self, name: &str, address: Option<&str>) -> Slot {
        let name = if self.bucket.is_some() { name } else { "shared" };
        let data = self.folder.path().join(name);
        std::fs::create_dir_all(&data).expect("a folder");
        Slot { data, address: address.map(str::to_owned), program: None }
    }

    /// Starts the process.
    fn start_process(&self, slot: &mut Slot) {
        let start = match &slot.address {
            Some(address) => Start::serve_on(address, &slot.data)
                .env("MESHMEND_NO_WORKERS", "true")
                .env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true")
                .arg("--webhook-timeout-s", "0.5")
                .arg("--webhook-retry-s", [["0.1"; 10].join(","), ["1"; 30].join(",")].join(",")),
            // Each stage takes a moment, so that faults hit running jobs.
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
                Start::work(&slot.data).env("FAILPOINTS", &slow)
            }
        };
        let start = start.env("MESHMEND_DATABASE_URL", &self.cluster.url());
        let start = match &self.bucket {
            Some(bucket) => bucket.store_files_of(start).arg("--min-free-mib", FREE),
            None => start,
        };
        slot.program = if self.small_disks { start.on_small_disk(DISK) } else { Some(start.start()) };
    }

    pub fn addresses(&self) -> Vec<String> {
        self.servers.iter().filter_map(|slot| slot.address.clone()).collect()
    }

    /// The targets that this service has.
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
                    // The child may have ended by now.
                    let pid = children[random.below(children.len())].to_string();
                    let _ = Command::new("kill").args(["-KILL", &pid]).stderr(Stdio::null()).status();
                }
            }
            Victim::Worker => {
                let mut slot = self.workers.swap_remove(worker);
                slot.program.take().expect("it runs").kill();
                self.start_process(&mut slot);
                self.workers.push(slot);
            }
            Victim::Server => {
                let mut slot = self.servers.swap_remove(server);
                slot.program.take().expect("it runs").kill();
                self.start_process(&mut slot);
                self.servers.push(slot);
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
                let slot = self.any(random);
                let filler = fill(&disk(slot.program.as_ref().expect("it runs"), &slot.data), 0);
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

    fn any(&self, random: &mut Random) -> &Slot {
        let all: Vec<_> = self.servers.iter().chain(&self.workers).collect();
        all[random.below(all.len())]
    }

    /// Stops all processes as a service manager does, and asserts that none panicked and no job's process is left.
    pub fn stop(&mut self) {
        for slot in self.servers.iter_mut().chain(&mut self.workers) {
            let mut program = slot.program.take().expect("it runs");
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

    /// Makes all files old and starts a worker, which begins with a sweep.
    pub fn sweep(&mut self) {
        make_old(&self.root());
        let mut slot = self.slot("sweeper", None);
        self.start_process(&mut slot);
        self.workers.push(slot);
    }
}

/// Processes that still run a job in this folder.
fn orphans(folder: &Path) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").expect("/proc").flatten();
    let lines = processes.filter_map(|process| std::fs::read(process.path().join("cmdline")).ok());
    let lines = lines.map(|line| String::from_utf8_lossy(&line).replace('\0', " "));
    lines.filter(|line| line.contains("job-child") && line.contains(&*folder.to_string_lossy())).collect()
}
