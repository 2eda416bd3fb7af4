//! The flags of `serve`, `work` and `migrate`, and their conversion to the settings of the library.

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
    /// Whether requests need a key (see `meshmend keys create`): `open` never, `keys` always, `auto` always unless
    /// the service listens on this machine only.
    #[arg(long, env = "MESHMEND_AUTH", value_enum, default_value_t)]
    pub(super) auth: AuthMode,
    /// Maximum number of queued jobs of one tenant, unless `meshmend tenants set` gives the tenant another limit.
    /// Default: `--max-queued`.
    #[arg(long, env = "MESHMEND_TENANT_MAX_QUEUED")]
    pub(super) tenant_max_queued: Option<u32>,
    /// Maximum number of requests of one tenant per minute and serving process, unless `meshmend tenants set` gives
    /// the tenant another limit. Further requests get status 429. Default: no limit.
    #[arg(long, env = "MESHMEND_TENANT_REQUESTS_PER_MINUTE")]
    pub(super) tenant_requests_per_minute: Option<u32>,
    /// Seconds without data after which an upload is aborted.
    #[arg(long, env = "MESHMEND_UPLOAD_IDLE_S", default_value_t = 30)]
    pub(super) upload_idle_s: u64,
    /// Maximum number of files that one job may analyse.
    #[arg(long, env = "MESHMEND_MAX_FILES", default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(super) max_files: u16,
    /// Maximum number of queued jobs, and of announced uploads that have no job yet. Further ones get status 429.
    #[arg(long, env = "MESHMEND_MAX_QUEUED", default_value_t = 10_000)]
    pub(super) max_queued: u64,
    /// Let clients send announced files directly to the S3 store. With `false`, or with a local folder, uploads pass
    /// through this service.
    #[arg(long, env = "MESHMEND_PRESIGNED_UPLOADS", default_value_t = true, action = ArgAction::Set)]
    pub(super) presigned_uploads: bool,
    /// Redirect downloads to the S3 store with addresses that are valid for a few minutes. With `false`, or with a
    /// local folder, downloads pass through this service, which verifies their integrity.
    #[arg(long, env = "MESHMEND_PRESIGNED_DOWNLOADS", default_value_t = false, action = ArgAction::Set)]
    pub(super) presigned_downloads: bool,
    /// Serve the API only; other processes run the jobs (`meshmend work`).
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
    /// Jobs to run at the same time, at least 1. Default: one per processor.
    #[arg(long, env = "MESHMEND_WORKERS", value_parser = workers)]
    pub(super) workers: Option<usize>,
    /// Maximum number of jobs of one tenant that run at the same time, on all workers together, unless `meshmend
    /// tenants set` gives the tenant another limit. Default: as many as there are workers.
    #[arg(long, env = "MESHMEND_TENANT_MAX_RUNNING")]
    pub(super) tenant_max_running: Option<u32>,
    /// Memory limit of one job, as address space in MiB.
    #[arg(long, env = "MESHMEND_JOB_MEMORY_MIB", default_value_t = 8192)]
    pub(super) job_memory_mib: u64,
    /// Largest file that a job may write, in MiB.
    #[arg(long, env = "MESHMEND_JOB_FILE_MIB", default_value_t = 2048)]
    pub(super) job_file_mib: u64,
    /// Disk space that one job may use in addition to its input files, in MiB.
    #[arg(long, env = "MESHMEND_JOB_SCRATCH_MIB", default_value_t = 8192)]
    pub(super) job_scratch_mib: u64,
    /// Maximum number of processes and threads of one job.
    #[arg(long, env = "MESHMEND_JOB_PROCESSES", default_value_t = 1024, value_parser = clap::value_parser!(u64).range(16..))]
    pub(super) job_processes: u64,
    /// Sandbox jobs, without network and without other files: `auto` uses what the kernel offers, `require` fails
    /// without it, `off` disables it.
    #[arg(long, env = "MESHMEND_SANDBOX", value_enum, default_value_t)]
    pub(super) sandbox: SandboxChoice,
    /// Additional files and folders that sandboxed jobs may read, comma-separated. Jobs can always read the system's
    /// files and the folder of Blender; a Blender that is installed in several places needs more.
    #[arg(long, env = "MESHMEND_SANDBOX_READ", value_delimiter = ',', value_name = "PATHS")]
    pub(super) sandbox_read: Vec<PathBuf>,
    /// Seconds without a heartbeat after which a job is taken from its worker.
    #[arg(long, env = "MESHMEND_LEASE_S", default_value_t = 15.0)]
    pub(super) lease_s: f64,
    /// Seconds by which a job may miss its deadline before its processes are killed. The deadline is `deadline_s` plus
    /// 2 s and 10 %.
    #[arg(long, env = "MESHMEND_DEADLINE_GRACE_S", default_value_t = 5.0)]
    pub(super) deadline_grace_s: f64,
    /// Seconds that running jobs have to finish when the service is stopped.
    #[arg(long, env = "MESHMEND_SHUTDOWN_GRACE_S", default_value_t = 20.0)]
    pub(super) shutdown_grace_s: f64,
    /// Space to keep free on the disks of the files and of the scratch folders, in MiB. With less space, jobs are
    /// refused with status 503, no job starts, and the process reports that it is not ready.
    #[arg(long, env = "MESHMEND_MIN_FREE_MIB", default_value_t = 512)]
    pub(super) min_free_mib: u64,
    /// Hours to keep a finished job's files and report.
    #[arg(long, env = "MESHMEND_RETAIN_RESULTS_H", default_value_t = 168)]
    pub(super) retain_results_h: u32,
    /// Days to keep a finished job's record.
    #[arg(long, env = "MESHMEND_RETAIN_JOBS_D", default_value_t = 90)]
    pub(super) retain_jobs_d: u32,
    /// Separate address for operators, with only /livez, /readyz and /metrics. Requests there need no key.
    #[arg(long, env = "MESHMEND_METRICS_LISTEN")]
    pub(super) metrics_listen: Option<ListenAddress>,
    /// Keep one child process for each idle worker, waiting in its sandbox, so that jobs start sooner. With `false`, each
    /// job starts its own child process.
    #[arg(long, env = "MESHMEND_PREPARED_CHILDREN", default_value_t = true, action = ArgAction::Set)]
    pub(super) prepared_children: bool,
    /// Run Blender once on a small model when the worker starts. The first job then starts faster, and the log shows
    /// whether Blender works.
    #[arg(long, env = "MESHMEND_BLENDER_WARM_UP", default_value_t = true, action = ArgAction::Set)]
    pub(super) blender_warm_up: bool,
    #[command(flatten)]
    pub(super) limits: LimitArgs,
    #[command(flatten)]
    pub(super) blender: BlenderArgs,
}

/// Where the service keeps its data, and how it logs and traces.
#[derive(Debug, Args)]
pub struct DataArgs {
    /// Folder of the database, the files and the scratch space. A missing folder is created with access for the
    /// current user only.
    #[arg(long, env = "MESHMEND_DATA_DIR", default_value = "meshmend-data")]
    pub(super) data_dir: PathBuf,
    /// PostgreSQL database for the jobs, as postgres://user:password@host/name. Several processes may share it.
    /// Default: a SQLite file in the data folder.
    #[arg(long, env = "MESHMEND_DATABASE_URL", hide_env_values = true)]
    pub(super) database_url: Option<String>,
    /// Maximum number of PostgreSQL connections of this process.
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

/// Parses the value of `--workers`.
fn workers(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("expected at least 1; to serve without workers, use `meshmend serve --no-workers`".to_owned()),
        Ok(count) => Ok(count),
        Err(_) => Err("expected a whole number of at least 1".to_owned()),
    }
}

/// Default of `--workers`: one job per processor.
pub(super) fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

impl WorkArgs {
    /// How long finished jobs and their files are kept.
    pub(super) fn retention(&self) -> Retention {
        Retention {
            results: Duration::from_secs(u64::from(self.retain_results_h) * 3600),
            jobs: Duration::from_secs(u64::from(self.retain_jobs_d) * 24 * 3600),
        }
    }
}

/// Whether jobs run in a sandbox.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
pub enum SandboxChoice {
    /// Use the kernel's sandbox features; the log and the capabilities list them.
    #[default]
    Auto,
    /// Fail at start unless network and files can be isolated.
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

/// Converts seconds to a duration of at least 10 ms. A number that is no duration, such as NaN, gives 10 ms.
pub(super) fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default().max(Duration::from_millis(10))
}

/// The file of the SQLite database in the data folder.
pub(super) fn database_file(data_dir: &Path) -> PathBuf {
    data_dir.join("meshmend.db")
}

/// Where the service keeps files.
#[derive(Debug, Args)]
pub struct BlobArgs {
    /// S3-compatible bucket for the files, as s3://bucket or s3://bucket/prefix. Several processes may share it.
    /// Default: the data folder.
    #[arg(long, env = "MESHMEND_BLOB_URL")]
    blob_url: Option<String>,
    /// Address of the store if it is not AWS, such as https://s3.example.com.
    #[arg(long, env = "MESHMEND_S3_ENDPOINT", requires = "blob_url")]
    s3_endpoint: Option<String>,
    /// Address of the store for clients, if it differs from the address for this service.
    #[arg(long, env = "MESHMEND_S3_PUBLIC_ENDPOINT", requires = "blob_url")]
    s3_public_endpoint: Option<String>,
    /// Region of the bucket. Default: AWS_REGION, or us-east-1.
    #[arg(long, env = "MESHMEND_S3_REGION", requires = "blob_url")]
    s3_region: Option<String>,
    /// Access key id. Default: the credentials from the environment, as the AWS tools find them.
    #[arg(long, env = "MESHMEND_S3_ACCESS_KEY_ID", hide_env_values = true, requires = "s3_secret_access_key")]
    s3_access_key_id: Option<String>,
    /// Secret of the access key.
    #[arg(long, env = "MESHMEND_S3_SECRET_ACCESS_KEY", hide_env_values = true, requires = "s3_access_key_id")]
    s3_secret_access_key: Option<String>,
    /// Allow plain HTTP to a store whose address starts with http:. Use it in trusted networks only.
    #[arg(long, env = "MESHMEND_S3_ALLOW_HTTP", default_value_t = false, action = ArgAction::Set)]
    s3_allow_http: bool,
}

/// The folder of the files when no bucket is set.
pub fn files_folder(data_dir: &Path) -> PathBuf {
    data_dir.join("files")
}

impl BlobArgs {
    /// Opens the file store: the bucket, or the data folder.
    ///
    /// # Errors
    /// An unusable address or folder.
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

/// Permitted webhook targets, and the delivery schedule.
#[derive(Debug, Args)]
pub struct WebhookArgs {
    /// Leave the delivery of webhooks to other serving processes.
    #[arg(long, env = "MESHMEND_NO_WEBHOOKS")]
    no_webhooks: bool,
    /// Allow webhooks to this machine and to private networks, with plain HTTP and on any port. Use it only if every
    /// tenant is trusted.
    #[arg(long, env = "MESHMEND_WEBHOOK_ALLOW_PRIVATE")]
    webhook_allow_private: bool,
    /// Seconds that a receiver has to answer a webhook.
    #[arg(long, env = "MESHMEND_WEBHOOK_TIMEOUT_S", default_value_t = 15.0)]
    webhook_timeout_s: f64,
    /// Seconds to wait before each retry of a webhook, comma-separated. After the last retry the delivery fails for
    /// good.
    #[arg(long, env = "MESHMEND_WEBHOOK_RETRY_S", default_value = "5,300,1800,7200,18000,36000,50400,72000,86400")]
    webhook_retry_s: Schedule,
}

impl WebhookArgs {
    /// The addresses that webhooks may use.
    pub fn target_policy(&self) -> TargetPolicy {
        if self.webhook_allow_private { TargetPolicy::Anything } else { TargetPolicy::Public }
    }

    /// The sender of webhooks and its settings; `None` with `--no-webhooks`.
    ///
    /// # Errors
    /// The HTTP client cannot be created.
    pub fn delivery(&self, poll: Duration) -> Result<Option<(Poster, DispatcherConfig)>, PosterError> {
        if self.no_webhooks {
            return Ok(None);
        }
        let timeout = seconds(self.webhook_timeout_s);
        // The lease outlasts the request, so that the outcome can still be recorded.
        let lease = 2 * timeout + Duration::from_secs(1);
        let config = DispatcherConfig { lease, schedule: self.webhook_retry_s.clone(), poll };
        Ok(Some((Poster::new(self.target_policy(), timeout)?, config)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_workers_are_refused_with_a_hint_to_no_workers() {
        assert_eq!(workers("2"), Ok(2));
        assert!(workers("0").is_err_and(|error| error.contains("--no-workers")));
        assert!(workers("-1").is_err_and(|error| error.contains("at least 1")));
    }
}
