use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use meshmend::access::TenantLimits;
use meshmend::api::{ApiConfig, ApiState, Capabilities, Health, Rates, probes, router};
use meshmend::blender::BlenderRemesher;
use meshmend::blobs::Blobs;
use meshmend::jobs::{PostgresStore, RetryPolicy, SqliteStore, Store, SystemClock};
use meshmend::repair::{Remesher, RemesherInfo};
use meshmend::webhooks::Courier;
use meshmend::worker::{Pool, Shutdown, WorkerConfig};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::engine::BlenderArgs;
use super::exit;
use super::listen::listen;
use super::settings::{DataArgs, MigrateArgs, ServeArgs, WorkArgs};
use super::telemetry::install_metrics;

/// How long to wait before looking for what no bell told of.
const POLL: Duration = Duration::from_millis(500);

/// Why a service could not start or go on.
#[derive(Debug, thiserror::Error)]
pub(super) enum ServiceError {
    #[error("{0}: {1}")]
    Io(String, io::Error),
    #[error(transparent)]
    Store(#[from] meshmend::jobs::StoreError),
    #[error(transparent)]
    Blobs(#[from] meshmend::blobs::BlobError),
    #[error(transparent)]
    Pool(#[from] meshmend::worker::PoolError),
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
        let blender = find_blender(&args.blender).await;
        let pool = room.pool(&args, args.workers, blender.clone().ok()).await?;
        let shutdown = Shutdown::default();
        watch(&args, room.health(&args, &blender, shutdown.drain.clone())?).await?;
        let stopping =
            tokio::spawn(stop_on_signal(shutdown.clone(), CancellationToken::new(), seconds(args.shutdown_grace_s)));
        pool.run(shutdown).await;
        stopping.abort();
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
    // Begins before the runtime and ends after it, since it waits for what it sends.
    let _telemetry = match data.telemetry.start() {
        Ok(telemetry) => telemetry,
        Err(message) => return exit::fail(exit::BAD_INPUT, message),
    };
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
        let blobs = args.blobs.open(&data_dir)?;
        Ok(Self { data_dir, store, blobs })
    }

    fn scratch(&self) -> PathBuf {
        self.data_dir.join("scratch")
    }

    fn health(
        &self,
        args: &WorkArgs,
        blender: &Result<RemesherInfo, String>,
        stopping: CancellationToken,
    ) -> Result<Health, ServiceError> {
        let blender = blender.as_ref().map_or_else(|why| format!("missing: {why}"), |_| "ok".to_owned());
        Ok(Health {
            store: self.store.clone(),
            blobs: self.blobs.clone(),
            scratch: self.scratch(),
            min_free: args.min_free_mib << 20,
            found: BTreeMap::from([("blender", blender)]),
            stopping,
            metrics: install_metrics()?,
            classes: Arc::default(),
        })
    }

    async fn pool(
        &self,
        args: &WorkArgs,
        slots: Option<usize>,
        remesher: Option<RemesherInfo>,
    ) -> Result<Pool, ServiceError> {
        let program = std::env::current_exe().map_err(io_error("this program's own path"))?;
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let config = WorkerConfig {
            program,
            private: self.data_dir.clone(),
            scratch: self.scratch(),
            slots: slots.unwrap_or(processors),
            max_running: args.tenant_max_running.unwrap_or(u32::MAX),
            retention: args.retention(),
            min_free: args.min_free_mib << 20,
            lease: seconds(args.lease_s),
            poll: POLL,
            job_memory: args.job_memory_mib << 20,
            job_file: args.job_file_mib << 20,
            job_scratch: args.job_scratch_mib << 20,
            job_processes: args.job_processes,
            sandbox: args.sandbox.into(),
            readable: args.sandbox_read.clone(),
            deadline_grace: seconds(args.deadline_grace_s),
            limits: args.limits.limits(),
            remesher,
            blender: args.blender.config(),
            blender_warm_up: args.blender_warm_up,
        };
        Ok(Pool::new(Arc::clone(&self.store), self.blobs.clone(), config).await?)
    }
}

async fn serve_until_stopped(args: &ServeArgs) -> Result<(), ServiceError> {
    let room = Room::open(&args.work.data).await?;
    let blender = find_blender(&args.work.blender).await;
    let slots = if args.no_workers { Some(0) } else { args.work.workers };
    let pool = room.pool(&args.work, slots, blender.clone().ok()).await?;
    let delivery = args.webhooks.delivery(POLL)?;
    let (limits, max_files) = (args.work.limits.limits(), usize::from(args.max_files));
    let stopping = CancellationToken::new();
    let health = room.health(&args.work, &blender, stopping.clone())?;
    watch(&args.work, health.clone()).await?;
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
            retention: args.work.retention().results,
            min_free: args.work.min_free_mib << 20,
            webhook_reach: args.webhooks.reach(),
            upload_idle: Duration::from_secs(args.upload_idle_s),
            presigned_uploads: args.presigned_uploads,
            presigned_downloads: args.presigned_downloads,
            poll: POLL,
        },
        capabilities: Arc::new(Capabilities::new(limits, max_files, blender, pool.sandbox().cloned())),
        health,
        stopping: stopping.clone(),
    };
    let listener =
        tokio::net::TcpListener::bind(args.listen).await.map_err(io_error(format!("listen on {}", args.listen)))?;
    let address = listener.local_addr().map_err(io_error("the address to listen on"))?;
    tracing::info!("listening on http://{address}, documentation at http://{address}/docs/");
    let shutdown = Shutdown::default();
    let grace = seconds(args.work.shutdown_grace_s);
    tokio::spawn(stop_on_signal(shutdown.clone(), stopping.clone(), grace));
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

/// Opens the listener for operators, if there is to be one. It answers until the process ends, while it drains too.
async fn watch(args: &WorkArgs, health: Health) -> Result<(), ServiceError> {
    let Some(address) = args.metrics_listen else { return Ok(()) };
    let listener = tokio::net::TcpListener::bind(address).await.map_err(io_error(format!("listen on {address}")))?;
    let address = listener.local_addr().map_err(io_error("the address to listen on"))?;
    tracing::info!("probes and metrics on http://{address}");
    tokio::spawn(listen(listener, probes(health), CancellationToken::new()));
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
