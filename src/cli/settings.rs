//! What `serve`, `work` and `migrate` can be told.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{ArgAction, Args, ValueEnum};
use meshmend::blobs::{BlobError, Blobs, S3Config};
use meshmend::sandbox::SandboxMode;
use meshmend::webhooks::{DispatcherConfig, Poster, PosterError, Schedule, TargetPolicy};
use meshmend::worker::Retention;

use super::engine::{BlenderArgs, LimitArgs};
use super::listen::{AuthMode, ListenAddress};
use super::telemetry::TelemetryArgs;

/// Arguments of `meshmend serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Address to listen on, as host:port. The host may be a name, such as localhost.
    #[arg(long, env = "MESHMEND_LISTEN", default_value = "127.0.0.1:8080")]
    pub(super) listen: ListenAddress,
    /// Whether requests need a key (`meshmend keys create`): `open` for none, `keys` for one, `auto` for one unless the service
    /// listens on this machine only.
    #[arg(long, env = "MESHMEND_AUTH", value_enum, default_value_t)]
    pub(super) auth: AuthMode,
    /// Most jobs of one tenant that may wait, unless `meshmend tenants set` says otherwise; without it, as many as may wait in all.
    #[arg(long, env = "MESHMEND_TENANT_MAX_QUEUED")]
    pub(super) tenant_max_queued: Option<u32>,
    /// Most requests of one tenant in a minute, on this process, unless `meshmend tenants set` says otherwise; further ones are refused
    /// with 429. Without it there is no limit.
    #[arg(long, env = "MESHMEND_TENANT_REQUESTS_PER_MINUTE")]
    pub(super) tenant_requests_per_minute: Option<u32>,
    /// Seconds of silence in the middle of an upload after which it is given up.
    #[arg(long, env = "MESHMEND_UPLOAD_IDLE_S", default_value_t = 30)]
    pub(super) upload_idle_s: u64,
    /// Most files that one job may analyse.
    #[arg(long, env = "MESHMEND_MAX_FILES", default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(super) max_files: u16,
    /// Most jobs that may wait, and most uploads that wait for a job; further ones are refused with 429.
    #[arg(long, env = "MESHMEND_MAX_QUEUED", default_value_t = 10_000)]
    pub(super) max_queued: u64,
    /// Let clients send files that they announce straight to the S3 store; without, or with a folder, they pass through this service.
    #[arg(long, env = "MESHMEND_PRESIGNED_UPLOADS", default_value_t = true, action = ArgAction::Set)]
    pub(super) presigned_uploads: bool,
    /// Send clients on to the S3 store for their downloads, by addresses that are good for minutes; without, or with a folder, they
    /// pass through this service, which sees that they are sound.
    #[arg(long, env = "MESHMEND_PRESIGNED_DOWNLOADS", default_value_t = false, action = ArgAction::Set)]
    pub(super) presigned_downloads: bool,
    /// Take jobs and answer for them, and leave the work to other processes (`meshmend work`).
    #[arg(long, env = "MESHMEND_NO_WORKERS", conflicts_with = "workers")]
    pub(super) no_workers: bool,
    #[command(flatten)]
    pub(super) webhooks: WebhookArgs,
    #[command(flatten)]
    pub(super) work: WorkArgs,
}

/// Arguments of `meshmend work`.
#[derive(Debug, Args)]
pub struct WorkArgs {
    #[command(flatten)]
    pub(super) data: DataArgs,
    /// Jobs that run at the same time, at least 1; without it, one a processor.
    #[arg(long, env = "MESHMEND_WORKERS", value_parser = workers)]
    pub(super) workers: Option<usize>,
    /// Most jobs of one tenant that run at the same time, on all workers together, unless `meshmend tenants set` says otherwise;
    /// without it, as many as there are workers.
    #[arg(long, env = "MESHMEND_TENANT_MAX_RUNNING")]
    pub(super) tenant_max_running: Option<u32>,
    /// Memory (address space) that one job may use, in MiB.
    #[arg(long, env = "MESHMEND_JOB_MEMORY_MIB", default_value_t = 8192)]
    pub(super) job_memory_mib: u64,
    /// Largest file that a job may write, in MiB.
    #[arg(long, env = "MESHMEND_JOB_FILE_MIB", default_value_t = 2048)]
    pub(super) job_file_mib: u64,
    /// Disk that one job may take beside the files that it was sent with, in MiB.
    #[arg(long, env = "MESHMEND_JOB_SCRATCH_MIB", default_value_t = 8192)]
    pub(super) job_scratch_mib: u64,
    /// Most processes and threads that one job may have.
    #[arg(long, env = "MESHMEND_JOB_PROCESSES", default_value_t = 1024, value_parser = clap::value_parser!(u64).range(16..))]
    pub(super) job_processes: u64,
    /// Whether jobs run without network and without other files than their own: as far as the kernel allows it, always or not at all,
    /// or never.
    #[arg(long, env = "MESHMEND_SANDBOX", value_enum, default_value_t)]
    pub(super) sandbox: SandboxChoice,
    /// Files and folders that jobs may read beside those of the system and the folder of Blender, with commas between: what a Blender
    /// needs that is installed in more than one place.
    #[arg(long, env = "MESHMEND_SANDBOX_READ", value_delimiter = ',', value_name = "PATHS")]
    pub(super) sandbox_read: Vec<PathBuf>,
    /// Seconds that a worker holds a job without a sign of life.
    #[arg(long, env = "MESHMEND_LEASE_S", default_value_t = 15.0)]
    pub(super) lease_s: f64,
    /// Seconds after which a job's processes are killed, beyond its deadline_s and the 2 s and 10 % within which a repair keeps that.
    #[arg(long, env = "MESHMEND_DEADLINE_GRACE_S", default_value_t = 5.0)]
    pub(super) deadline_grace_s: f64,
    /// Seconds that running jobs get to finish when the service is told to stop.
    #[arg(long, env = "MESHMEND_SHUTDOWN_GRACE_S", default_value_t = 20.0)]
    pub(super) shutdown_grace_s: f64,
    /// Room that must stay free on the disks of the files and the scratch folders, in MiB; jobs that would take it are refused with
    /// 503, none is begun, and a process that has less says that it is not ready.
    #[arg(long, env = "MESHMEND_MIN_FREE_MIB", default_value_t = 512)]
    pub(super) min_free_mib: u64,
    /// Hours after its end that a job's files and report are kept.
    #[arg(long, env = "MESHMEND_RETAIN_RESULTS_H", default_value_t = 168)]
    pub(super) retain_results_h: u32,
    /// Days after its end that it is known that there was a job.
    #[arg(long, env = "MESHMEND_RETAIN_JOBS_D", default_value_t = 90)]
    pub(super) retain_jobs_d: u32,
    /// Address of a listener for operators, with /livez, /readyz and /metrics and nothing else; no key is asked for there.
    #[arg(long, env = "MESHMEND_METRICS_LISTEN")]
    pub(super) metrics_listen: Option<ListenAddress>,
    /// Run Blender once on a small model when the worker starts, so that the first job does not wait for what it loads, and so
    /// that the log says whether it works.
    #[arg(long, env = "MESHMEND_BLENDER_WARM_UP", default_value_t = true, action = ArgAction::Set)]
    pub(super) blender_warm_up: bool,
    #[command(flatten)]
    pub(super) limits: LimitArgs,
    #[command(flatten)]
    pub(super) blender: BlenderArgs,
}

/// Where the service keeps its data, and how it tells of itself.
#[derive(Debug, Args)]
pub struct DataArgs {
    /// Folder of the database, the files and the scratch space; made for this user alone if it is missing.
    #[arg(long, env = "MESHMEND_DATA_DIR", default_value = "meshmend-data")]
    pub(super) data_dir: PathBuf,
    /// Address of a PostgreSQL database that keeps the jobs, as postgres://user:password@host/name; without it, a SQLite file in the
    /// data folder. Any number of processes may share one.
    #[arg(long, env = "MESHMEND_DATABASE_URL", hide_env_values = true)]
    pub(super) database_url: Option<String>,
    /// Most connections to PostgreSQL that this process holds.
    #[arg(long, env = "MESHMEND_DATABASE_CONNECTIONS", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub(super) database_connections: u32,
    #[command(flatten)]
    pub(super) blobs: BlobArgs,
    #[command(flatten)]
    pub(super) telemetry: TelemetryArgs,
}

/// Arguments of `meshmend migrate`.
#[derive(Debug, Args)]
pub struct MigrateArgs {
    #[command(flatten)]
    pub(super) data: DataArgs,
}

fn workers(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("it must be at least 1; to serve without workers, use `meshmend serve --no-workers`".to_owned()),
        Ok(count) => Ok(count),
        Err(_) => Err("expected a whole number of at least 1".to_owned()),
    }
}

/// How many jobs run at the same time where nothing is set.
pub(super) fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

impl WorkArgs {
    pub(super) fn retention(&self) -> Retention {
        Retention {
            results: Duration::from_secs(u64::from(self.retain_results_h) * 3600),
            jobs: Duration::from_secs(u64::from(self.retain_jobs_d) * 24 * 3600),
        }
    }
}

/// What to do where the kernel can't wall jobs off.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
pub enum SandboxChoice {
    /// Use what there is; the log and the capabilities say what it is.
    #[default]
    Auto,
    /// Start only where the network and the files are walled off.
    Require,
    /// No sandbox; for debugging.
    Off,
}

impl From<SandboxChoice> for SandboxMode {
    fn from(choice: SandboxChoice) -> Self {
        match choice {
            SandboxChoice::Auto => Self::Auto,
            SandboxChoice::Require => Self::Require,
            SandboxChoice::Off => Self::Off,
        }
    }
}

/// A length of time of at least 10 ms; the shortest where it is no number.
pub(super) fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default().max(Duration::from_millis(10))
}

/// The file of the SQLite database in a data folder.
pub(super) fn database_file(data_dir: &Path) -> PathBuf {
    data_dir.join("meshmend.db")
}

/// Where the service keeps files.
#[derive(Debug, Args)]
pub struct BlobArgs {
    /// Bucket of an S3-compatible store that keeps the files, as s3://bucket or s3://bucket/prefix; without it, the data folder. Any
    /// number of processes may share one.
    #[arg(long, env = "MESHMEND_BLOB_URL")]
    blob_url: Option<String>,
    /// Address of a store that is not AWS, such as https://s3.example.com.
    #[arg(long, env = "MESHMEND_S3_ENDPOINT", requires = "blob_url")]
    s3_endpoint: Option<String>,
    /// Address at which clients reach the store, where it is not the one at which this service does.
    #[arg(long, env = "MESHMEND_S3_PUBLIC_ENDPOINT", requires = "blob_url")]
    s3_public_endpoint: Option<String>,
    /// Region of the bucket; without it AWS_REGION, or us-east-1.
    #[arg(long, env = "MESHMEND_S3_REGION", requires = "blob_url")]
    s3_region: Option<String>,
    /// Access key id; without it, whatever credentials the environment offers in AWS' ways.
    #[arg(long, env = "MESHMEND_S3_ACCESS_KEY_ID", hide_env_values = true, requires = "s3_secret_access_key")]
    s3_access_key_id: Option<String>,
    /// Secret of the access key.
    #[arg(long, env = "MESHMEND_S3_SECRET_ACCESS_KEY", hide_env_values = true, requires = "s3_access_key_id")]
    s3_secret_access_key: Option<String>,
    /// Talk to the store without TLS, where its address says http and the network can be trusted.
    #[arg(long, env = "MESHMEND_S3_ALLOW_HTTP", default_value_t = false, action = ArgAction::Set)]
    s3_allow_http: bool,
}

/// The folder of the files where no bucket keeps them.
pub fn files_folder(data_dir: &Path) -> PathBuf {
    data_dir.join("files")
}

impl BlobArgs {
    pub fn open(&self, data_dir: &Path) -> Result<Blobs, BlobError> {
        let Some(url) = &self.blob_url else { return Blobs::local(&files_folder(data_dir)) };
        Blobs::s3(&S3Config {
            url: url.clone(),
            endpoint: self.s3_endpoint.clone(),
            public_endpoint: self.s3_public_endpoint.clone(),
            region: self.s3_region.clone(),
            credentials: self.s3_access_key_id.clone().zip(self.s3_secret_access_key.clone()),
            allow_http: self.s3_allow_http,
            spool: data_dir.join("spool"),
        })
    }
}

/// Whom the service may tell of jobs, and how often it tries.
#[derive(Debug, Args)]
pub struct WebhookArgs {
    /// Leave the delivery of webhooks to other processes that serve.
    #[arg(long, env = "MESHMEND_NO_WEBHOOKS")]
    no_webhooks: bool,
    /// Let webhooks go to this machine and to private networks, by http too, at any port. Only where every tenant is trusted.
    #[arg(long, env = "MESHMEND_WEBHOOK_ALLOW_PRIVATE")]
    webhook_allow_private: bool,
    /// Seconds that a receiver has to answer a webhook.
    #[arg(long, env = "MESHMEND_WEBHOOK_TIMEOUT_S", default_value_t = 15.0)]
    webhook_timeout_s: f64,
    /// Seconds to wait before each further try to deliver a webhook, with commas between; after the last it is given up.
    #[arg(long, env = "MESHMEND_WEBHOOK_RETRY_S", default_value = "5,300,1800,7200,18000,36000,50400,72000,86400")]
    webhook_retry_s: Schedule,
}

impl WebhookArgs {
    /// Which addresses may be named and reached.
    pub fn reach(&self) -> TargetPolicy {
        if self.webhook_allow_private { TargetPolicy::Anything } else { TargetPolicy::Public }
    }

    /// How to deliver; none where that is left to others.
    pub fn delivery(&self, poll: Duration) -> Result<Option<(Poster, DispatcherConfig)>, PosterError> {
        if self.no_webhooks {
            return Ok(None);
        }
        let timeout = seconds(self.webhook_timeout_s);
        // Time enough to note how it went.
        let lease = 2 * timeout + Duration::from_secs(1);
        let config = DispatcherConfig { lease, schedule: self.webhook_retry_s.clone(), poll };
        Ok(Some((Poster::new(self.reach(), timeout)?, config)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_workers_at_all_are_asked_for_by_a_flag_of_their_own() {
        assert_eq!(workers("2"), Ok(2));
        assert!(workers("0").is_err_and(|error| error.contains("--no-workers")));
        assert!(workers("-1").is_err_and(|error| error.contains("at least 1")));
    }
}
