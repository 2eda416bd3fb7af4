use std::io::{self, IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, ValueEnum};
use meshmend::access::TenantLimits;
use meshmend::api::{ApiConfig, ApiState, Capabilities, Rates, router};
use meshmend::blender::{BlenderRemesher, Warmth, warm_up};
use meshmend::blobs::Blobs;
use meshmend::jobs::{PostgresStore, RetryPolicy, SqliteStore, Store, SystemClock};
use meshmend::repair::{Remesher, RemesherInfo};
use meshmend::webhooks::Courier;
use meshmend::worker::{Pool, Retention, Shutdown, WorkerConfig};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::auth::AuthMode;
use super::engine::{BlenderArgs, LimitArgs};
use super::exit;
use super::listen::listen;
use super::webhooks::WebhookArgs;

/// How long to wait before looking for what no bell told of.
const POLL: Duration = Duration::from_millis(500);

/// Arguments of `meshmend serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Address to listen on.
    #[arg(long, env = "MESHMEND_LISTEN", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Whether requests need a key (`meshmend keys create`): `open` for none, `keys` for one, `auto` for one unless the service
    /// listens on this machine only.
    #[arg(long, env = "MESHMEND_AUTH", value_enum, default_value_t)]
    auth: AuthMode,
    /// Most jobs of one tenant that may wait, unless `meshmend tenants set` says otherwise; without it, as many as may wait in all.
    #[arg(long, env = "MESHMEND_TENANT_MAX_QUEUED")]
    tenant_max_queued: Option<u32>,
    /// Most requests of one tenant in a minute, on this process, unless `meshmend tenants set` says otherwise; further ones are refused
    /// with 429. Without it there is no limit.
    #[arg(long, env = "MESHMEND_TENANT_REQUESTS_PER_MINUTE")]
    tenant_requests_per_minute: Option<u32>,
    /// Seconds of silence in the middle of an upload after which it is given up.
    #[arg(long, env = "MESHMEND_UPLOAD_IDLE_S", default_value_t = 30)]
    upload_idle_s: u64,
    /// Most files that one job may analyse.
    #[arg(long, env = "MESHMEND_MAX_FILES", default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=1000))]
    max_files: u16,
    /// Most jobs that may wait; further ones are refused with 429.
    #[arg(long, env = "MESHMEND_MAX_QUEUED", default_value_t = 10_000)]
    max_queued: u64,
    /// Room that must stay free on the disk of the files, in MiB; jobs that would take it are refused with 503.
    #[arg(long, env = "MESHMEND_MIN_FREE_MIB", default_value_t = 512)]
    min_free_mib: u64,
    /// Take jobs and answer for them, and leave the work to other processes (`meshmend work`).
    #[arg(long, env = "MESHMEND_NO_WORKERS", conflicts_with = "workers")]
    no_workers: bool,
    #[command(flatten)]
    webhooks: WebhookArgs,
    #[command(flatten)]
    work: WorkArgs,
}

/// Arguments of `meshmend work`.
#[derive(Debug, Args)]
pub struct WorkArgs {
    #[command(flatten)]
    data: DataArgs,
    /// Jobs that run at the same time; without it, one a processor.
    #[arg(long, env = "MESHMEND_WORKERS")]
    workers: Option<usize>,
    /// Most jobs of one tenant that run at the same time, on all workers together, unless `meshmend tenants set` says otherwise;
    /// without it, as many as there are workers.
    #[arg(long, env = "MESHMEND_TENANT_MAX_RUNNING")]
    tenant_max_running: Option<u32>,
    /// Memory (address space) that one job may use, in MiB.
    #[arg(long, env = "MESHMEND_JOB_MEMORY_MIB", default_value_t = 8192)]
    job_memory_mib: u64,
    /// Largest file that a job may write, in MiB.
    #[arg(long, env = "MESHMEND_JOB_FILE_MIB", default_value_t = 2048)]
    job_file_mib: u64,
    /// Seconds that a worker holds a job without a sign of life.
    #[arg(long, env = "MESHMEND_LEASE_S", default_value_t = 15.0)]
    lease_s: f64,
    /// Seconds beyond a job's deadline_s after which its processes are killed.
    #[arg(long, env = "MESHMEND_DEADLINE_GRACE_S", default_value_t = 5.0)]
    deadline_grace_s: f64,
    /// Seconds that running jobs get to finish when the service is told to stop.
    #[arg(long, env = "MESHMEND_SHUTDOWN_GRACE_S", default_value_t = 20.0)]
    shutdown_grace_s: f64,
    /// Run Blender once on a small model when the worker starts, so that the first job does not wait for what it loads, and so
    /// that the log says whether it works.
    #[arg(long, env = "MESHMEND_BLENDER_WARM_UP", default_value_t = true, action = clap::ArgAction::Set)]
    blender_warm_up: bool,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    blender: BlenderArgs,
}

/// Where the service keeps its data, and how it logs.
#[derive(Debug, Args)]
pub struct DataArgs {
    /// Folder of the database, the files and the scratch space; made if it is missing.
    #[arg(long, env = "MESHMEND_DATA_DIR", default_value = "meshmend-data")]
    data_dir: PathBuf,
    /// Address of a PostgreSQL database that keeps the jobs, as postgres://user:password@host/name; without it, a SQLite file in the
    /// data folder. Any number of processes may share one.
    #[arg(long, env = "MESHMEND_DATABASE_URL", hide_env_values = true)]
    database_url: Option<String>,
    /// Most connections to PostgreSQL that this process holds.
    #[arg(long, env = "MESHMEND_DATABASE_CONNECTIONS", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=1000))]
    database_connections: u32,
    /// Hours after its end that a job's files and report are kept.
    #[arg(long, env = "MESHMEND_RETAIN_RESULTS_H", default_value_t = 168)]
    retain_results_h: u32,
    /// Days after its end that it is known that there was a job.
    #[arg(long, env = "MESHMEND_RETAIN_JOBS_D", default_value_t = 90)]
    retain_jobs_d: u32,
    /// What to log, as `level` or `target=level,...`.
    #[arg(long, env = "MESHMEND_LOG", default_value = "info")]
    log: String,
    /// How log lines look.
    #[arg(long, env = "MESHMEND_LOG_FORMAT", value_enum, default_value_t)]
    log_format: LogFormat,
}

/// Arguments of `meshmend migrate`.
#[derive(Debug, Args)]
pub struct MigrateArgs {
    #[command(flatten)]
    data: DataArgs,
}

impl DataArgs {
    fn retention(&self) -> Retention {
        Retention {
            results: Duration::from_secs(u64::from(self.retain_results_h) * 3600),
            jobs: Duration::from_secs(u64::from(self.retain_jobs_d) * 24 * 3600),
        }
    }
}

/// How log lines look.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// Why a service could not start or go on.
#[derive(Debug, thiserror::Error)]
pub(super) enum ServiceError {
    #[error("{0}: {1}")]
    Io(String, io::Error),
    #[error(transparent)]
    Store(#[from] meshmend::jobs::StoreError),
    #[error(transparent)]
    Blobs(#[from] meshmend::blobs::BlobError),
    #[error("{0}")]
    Refused(String),
    #[error(transparent)]
    Webhooks(#[from] meshmend::webhooks::PosterError),
    #[error("metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
}

fn io_error(what: impl Into<String>) -> impl FnOnce(io::Error) -> ServiceError {
    move |error| ServiceError::Io(what.into(), error)
}

/// Runs `meshmend serve`.
pub fn serve(args: ServeArgs) -> ExitCode {
    start(&args.work.data, async { serve_until_stopped(&args).await })
}

/// Runs `meshmend work`.
pub fn work(args: WorkArgs) -> ExitCode {
    start(&args.data, async {
        let room = Room::open(&args.data).await?;
        let metrics = install_metrics()?;
        let blender = find_blender(&args.blender).await.ok();
        let pool = room.pool(&args, args.workers, blender.clone())?;
        let shutdown = Shutdown::default();
        warm_blender_up(&args, blender, &shutdown);
        let stopping =
            tokio::spawn(stop_on_signal(shutdown.clone(), CancellationToken::new(), seconds(args.shutdown_grace_s)));
        pool.run(shutdown).await;
        stopping.abort();
        drop(metrics);
        Ok(())
    })
}

/// Runs `meshmend migrate`.
pub fn migrate(args: &MigrateArgs) -> ExitCode {
    start(&args.data, async {
        Room::open(&args.data).await?;
        tracing::info!("the database is up to date");
        Ok(())
    })
}

/// Does something with what the service keeps, beside it or without it.
pub(super) fn run<F: Future<Output = Result<(), ServiceError>>>(
    data: &DataArgs,
    work: impl FnOnce(Room) -> F,
) -> ExitCode {
    start(data, async { work(Room::open(data).await?).await })
}

/// Prints a line for people or scripts.
pub(super) fn to_stdout(line: &str) -> Result<(), ServiceError> {
    writeln!(io::stdout(), "{line}").map_err(io_error("standard output"))
}

fn start(data: &DataArgs, service: impl Future<Output = Result<(), ServiceError>>) -> ExitCode {
    if let Err(message) = start_logging(data) {
        return exit::fail(exit::BAD_INPUT, message);
    }
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return exit::fail(exit::INTERNAL, error),
    };
    match runtime.block_on(service) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error @ ServiceError::Refused(_)) => exit::fail(exit::BAD_INPUT, error),
        Err(error) => exit::fail(exit::INTERNAL, error),
    }
}

fn start_logging(data: &DataArgs) -> Result<(), String> {
    let filter = tracing_subscriber::EnvFilter::try_new(format!("sqlx=warn,{}", data.log))
        .map_err(|e| format!("--log '{}': {e}", data.log))?;
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr);
    match data.log_format {
        LogFormat::Text => builder.with_ansi(io::stderr().is_terminal()).init(),
        LogFormat::Json => builder.json().init(),
    }
    Ok(())
}

/// The data folder, opened.
pub(super) struct Room {
    data_dir: PathBuf,
    pub store: Arc<dyn Store>,
    blobs: Blobs,
}

impl Room {
    async fn open(args: &DataArgs) -> Result<Self, ServiceError> {
        std::fs::create_dir_all(&args.data_dir).map_err(io_error(args.data_dir.display().to_string()))?;
        let data_dir = args.data_dir.canonicalize().map_err(io_error(args.data_dir.display().to_string()))?;
        let retry = RetryPolicy::default();
        let store: Arc<dyn Store> = match &args.database_url {
            Some(url) => Arc::new(PostgresStore::open(url, args.database_connections, None, retry).await?),
            None => {
                let database = data_dir.join("meshmend.db");
                Arc::new(SqliteStore::open(&database, Arc::new(SystemClock), retry).await?)
            }
        };
        let blobs = Blobs::local(&data_dir.join("files"))?;
        Ok(Self { data_dir, store, blobs })
    }

    fn pool(
        &self,
        args: &WorkArgs,
        slots: Option<usize>,
        remesher: Option<RemesherInfo>,
    ) -> Result<Pool, ServiceError> {
        let program = std::env::current_exe().map_err(io_error("this program's own path"))?;
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let config = WorkerConfig {
            program,
            scratch: self.data_dir.join("scratch"),
            slots: slots.unwrap_or(processors),
            max_running: args.tenant_max_running.unwrap_or(u32::MAX),
            retention: args.data.retention(),
            lease: seconds(args.lease_s),
            poll: POLL,
            job_memory: args.job_memory_mib << 20,
            job_file: args.job_file_mib << 20,
            deadline_grace: seconds(args.deadline_grace_s),
            limits: args.limits.limits(),
            remesher,
            blender: args.blender.config(),
        };
        Pool::new(Arc::clone(&self.store), self.blobs.clone(), config).map_err(io_error("the scratch folder"))
    }
}

async fn serve_until_stopped(args: &ServeArgs) -> Result<(), ServiceError> {
    let room = Room::open(&args.work.data).await?;
    let metrics = install_metrics()?;
    let blender = find_blender(&args.work.blender).await;
    let for_warmth = blender.clone().ok();
    let slots = if args.no_workers { Some(0) } else { args.work.workers };
    let pool = room.pool(&args.work, slots, for_warmth.clone())?;
    let delivery = args.webhooks.delivery(POLL)?;
    let (limits, max_files) = (args.work.limits.limits(), usize::from(args.max_files));
    let stopping = CancellationToken::new();
    let state = ApiState {
        store: Arc::clone(&room.store),
        blobs: room.blobs.clone(),
        auth: args.auth.on(args.listen),
        rates: Arc::new(Rates::default()),
        config: ApiConfig {
            limits,
            max_files,
            max_queued: args.max_queued,
            tenant_limits: TenantLimits {
                max_queued: args.tenant_max_queued,
                max_running: args.work.tenant_max_running,
                requests_per_minute: args.tenant_requests_per_minute,
            },
            retention: args.work.data.retention().results,
            min_free: args.min_free_mib << 20,
            webhook_reach: args.webhooks.reach(),
            upload_idle: Duration::from_secs(args.upload_idle_s),
            poll: POLL,
        },
        capabilities: Arc::new(Capabilities::new(limits, max_files, blender)),
        metrics,
        stopping: stopping.clone(),
    };
    let listener =
        tokio::net::TcpListener::bind(args.listen).await.map_err(io_error(format!("listen on {}", args.listen)))?;
    let address = listener.local_addr().map_err(io_error("the address to listen on"))?;
    tracing::info!("listening on http://{address}, documentation at http://{address}/docs/");
    let shutdown = Shutdown::default();
    let grace = seconds(args.work.shutdown_grace_s);
    tokio::spawn(stop_on_signal(shutdown.clone(), stopping.clone(), grace));
    warm_blender_up(&args.work, for_warmth, &shutdown);
    let courier = delivery.map(|(poster, config)| {
        let courier = Courier::new(Arc::clone(&room.store), poster, config);
        tokio::spawn(courier.run(shutdown.drain.clone(), shutdown.now.clone()))
    });
    let workers = tokio::spawn(pool.run(shutdown.clone()));
    let served = tokio::spawn(listen(listener, router(state), stopping));
    if let Err(error) = workers.await {
        tracing::error!(%error, "the workers ended");
    }
    if let Some(Err(error)) = futures::future::OptionFuture::from(courier).await {
        tracing::error!(%error, "the delivery of webhooks ended");
    }
    // Connections that are still open, such as a slow download, get the rest of the grace and no more.
    tokio::select! {
        served = served => {
            if let Err(error) = served {
                tracing::error!(%error, "serving ended");
            }
        }
        () = async { shutdown.now.cancelled().await; tokio::time::sleep(Duration::from_secs(1)).await } => {
            tracing::warn!("connections were still open");
        }
    }
    tracing::info!("stopped");
    Ok(())
}

pub(super) fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default().max(Duration::from_millis(10))
}

/// Tier 3, or why there is none.
async fn find_blender(args: &BlenderArgs) -> Result<RemesherInfo, String> {
    let config = args.config();
    let found = tokio::task::spawn_blocking(move || BlenderRemesher::find(config)).await;
    let found = found.map_err(|e| e.to_string()).and_then(|found| found.map_err(|e| e.to_string()));
    match found {
        Ok(remesher) => {
            let info = remesher.info().map_err(String::from)?.clone();
            tracing::info!(kind = info.kind, version = info.version, program = info.program, "tier 3 is ready");
            Ok(info)
        }
        Err(reason) => {
            tracing::warn!(reason, "tier 3 is missing: models that need Blender will be repaired only in part");
            Err(reason)
        }
    }
}

/// Runs Blender once beside everything else; what comes of it is a line in the log. It ends when the service drains.
fn warm_blender_up(args: &WorkArgs, info: Option<RemesherInfo>, shutdown: &Shutdown) {
    let Some(info) = info.filter(|_| args.blender_warm_up) else { return };
    let (config, drain) = (args.blender.config(), shutdown.drain.clone());
    std::thread::spawn(move || match warm_up(info, config, &|| drain.is_cancelled()) {
        Warmth::Warm(time) => tracing::info!(seconds = time.as_secs_f64(), "tier 3 is warm"),
        Warmth::Failed(reason) => tracing::warn!(reason, "tier 3 was found but failed on a small model"),
        Warmth::Stopped => {}
    });
}

/// The first signal drains: no new connection, no new job, `grace` for what runs. The second, or the end of the grace,
/// stops what runs and hands it back.
async fn stop_on_signal(shutdown: Shutdown, stopping: CancellationToken, grace: Duration) {
    let (Ok(mut terminate), Ok(mut interrupt)) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()))
    else {
        tracing::error!("signals can't be caught; the service stops only when killed");
        return;
    };
    let mut next = async || {
        tokio::select! { _ = terminate.recv() => {}, _ = interrupt.recv() => {} }
    };
    next().await;
    tracing::info!(
        grace_s = grace.as_secs_f64(),
        "stopping: running jobs may finish; signal again to hand them back now"
    );
    stopping.cancel();
    shutdown.drain.cancel();
    tokio::select! { () = next() => {}, () = tokio::time::sleep(grace) => {} }
    shutdown.now.cancel();
}

fn install_metrics() -> Result<PrometheusHandle, ServiceError> {
    const SECONDS: [f64; 12] = [0.001, 0.005, 0.01, 0.025, 0.1, 0.25, 1.0, 2.5, 10.0, 30.0, 120.0, 600.0];
    const BYTES: [f64; 6] = [1e4, 1e5, 1e6, 1e7, 1e8, 1e9];
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &SECONDS)?
        .set_buckets_for_metric(Matcher::Suffix("_bytes".to_owned()), &BYTES)?
        .install_recorder()?;
    let upkeep = handle.clone();
    tokio::spawn(async move {
        loop {
            tokio::time::sleep(Duration::from_secs(5)).await;
            upkeep.run_upkeep();
        }
    });
    Ok(handle)
}
