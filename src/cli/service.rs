//! `meshmend serve`, `work` and `migrate`: opening the data, starting and stopping the service.

use std::collections::BTreeMap;
use std::fs::DirBuilder;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use meshmend::access::{SystemIds, TenantLimits};
use meshmend::api::{ApiConfig, ApiState, Auth, Capabilities, Health, Rates, probes, router};
use meshmend::blender::BlenderRemesher;
use meshmend::blobs::Blobs;
use meshmend::jobs::{PostgresStore, RetryPolicy, SqliteStore, Store, SystemClock};
use meshmend::repair::{Remesher, RemesherInfo};
use meshmend::webhooks::Dispatcher;
use meshmend::worker::{Pool, Shutdown, WorkerConfig};
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tower_http::metrics::InFlightRequestsLayer;
use tower_http::metrics::in_flight_requests::InFlightRequestsCounter;

use super::engine::BlenderArgs;
use super::exit;
use super::listen::{are_loopback, serve_connections};
use super::service_error::{ServiceError, io_error, postgres_error, sqlite_error};
use super::settings::{DataArgs, MigrateArgs, ServeArgs, WorkArgs, database_file, default_workers, seconds};
use super::telemetry::install_metrics;

/// Interval of polling the database, for changes whose notification was lost.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Interval of checking for open requests while the process stops.
const IDLE_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Runs `meshmend serve`.
pub fn serve(args: ServeArgs) -> ExitCode {
    start(&args.work.data, async { serve_until_stopped(&args).await })
}

/// Runs `meshmend work`.
pub fn work(args: WorkArgs) -> ExitCode {
    start(&args.data, async {
        let data = ServiceData::open(&args.data).await?;
        let blender = find_blender(&args.blender).await;
        let pool = data.pool(&args, args.workers, blender.clone().ok()).await?;
        let shutdown = Shutdown::default();
        serve_probes(&args, data.health(&args, &blender, shutdown.drain.clone())?).await?;
        let stopping = tokio::spawn(stop_on_signal(shutdown.clone(), seconds(args.shutdown_grace_s)));
        pool.run(shutdown).await;
        stopping.abort();
        Ok(())
    })
}

/// Runs `meshmend migrate`.
pub fn migrate(args: &MigrateArgs) -> ExitCode {
    start(&args.data, async {
        ServiceData::open(&args.data).await?;
        tracing::info!("database is up to date");
        Ok(())
    })
}

/// Opens the data of the service and runs a command on it. The service itself may run meanwhile.
pub(super) fn run<F: Future<Output = Result<(), ServiceError>>>(
    data: &DataArgs,
    command: impl FnOnce(ServiceData) -> F,
) -> ExitCode {
    start(data, async { command(ServiceData::open(data).await?).await })
}

/// Prints a line on standard output.
pub(super) fn to_stdout(line: &str) -> Result<(), ServiceError> {
    writeln!(io::stdout(), "{line}").map_err(io_error("standard output"))
}

/// Starts telemetry and the runtime, runs `service`, and returns the exit code.
pub(super) fn start(data: &DataArgs, service: impl Future<Output = Result<(), ServiceError>>) -> ExitCode {
    // Starts before the runtime and is dropped after it, because dropping waits for the last export.
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

/// Creates the data folder if it is missing, for the current user only, and returns its absolute path.
fn open_data_dir(path: &Path) -> Result<PathBuf, ServiceError> {
    let opened = DirBuilder::new().recursive(true).mode(0o700).create(path).and_then(|()| path.canonicalize());
    // A test file finds a folder without write permission here, where the message can name its setting.
    let opened = opened.and_then(|folder| tempfile::tempfile_in(&folder).map(|_| folder));
    opened.map_err(|error| {
        ServiceError::Refused(format!(
            "--data-dir (MESHMEND_DATA_DIR) {}: the folder cannot be created or written to: {error}. Use a folder that the current \
             user may write to.",
            path.display()
        ))
    })
}

/// The opened data of the service: folder, database and file store.
pub(super) struct ServiceData {
    data_dir: PathBuf,
    /// The database.
    pub store: Arc<dyn Store>,
    blobs: Blobs,
}

impl ServiceData {
    async fn open(args: &DataArgs) -> Result<Self, ServiceError> {
        let data_dir = open_data_dir(&args.data_dir)?;
        let retry = RetryPolicy::default();
        let store: Arc<dyn Store> = match &args.database_url {
            Some(url) => {
                let opened = PostgresStore::open(url, args.database_connections, None, retry).await;
                Arc::new(opened.map_err(|error| postgres_error(url, &error))?)
            }
            None => {
                let path = database_file(&data_dir);
                let opened = SqliteStore::open(&path, Arc::new(SystemClock), retry).await;
                Arc::new(opened.map_err(|error| sqlite_error(&path, &error))?)
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
        draining: CancellationToken,
    ) -> Result<Health, ServiceError> {
        let blender = blender.as_ref().map_or_else(|reason| format!("missing: {reason}"), |_| "ok".to_owned());
        Ok(Health {
            store: self.store.clone(),
            blobs: self.blobs.clone(),
            scratch: self.scratch(),
            min_free: args.min_free_mib << 20,
            startup_checks: BTreeMap::from([("blender", blender)]),
            draining,
            ids: Arc::new(SystemIds),
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
        let program = std::env::current_exe().map_err(io_error("path of this program"))?;
        let config = WorkerConfig {
            program,
            private: self.data_dir.clone(),
            scratch: self.scratch(),
            slots: slots.unwrap_or_else(default_workers),
            max_running: args.tenant_max_running.unwrap_or(u32::MAX),
            retention: args.retention(),
            min_free: args.min_free_mib << 20,
            lease: seconds(args.lease_s),
            poll: POLL_INTERVAL,
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
            prepared_children: args.prepared_children,
            blender_warm_up: args.blender_warm_up,
        };
        Ok(Pool::new(Arc::clone(&self.store), self.blobs.clone(), config, Arc::new(SystemClock), &SystemIds).await?)
    }

    fn api_state(&self, args: &ServeArgs, auth: Auth, capabilities: Capabilities, health: Health) -> ApiState {
        ApiState {
            store: Arc::clone(&self.store),
            blobs: self.blobs.clone(),
            auth,
            rates: Arc::new(Rates::default()),
            config: ApiConfig {
                limits: args.work.limits.limits(),
                max_files: usize::from(args.max_files),
                max_queued: args.max_queued,
                tenant_limits: TenantLimits {
                    max_queued: args.tenant_max_queued,
                    max_running: args.work.tenant_max_running,
                    requests_per_minute: args.tenant_requests_per_minute,
                },
                retention: args.work.retention().results,
                min_free: args.work.min_free_mib << 20,
                webhook_targets: args.webhooks.target_policy(),
                upload_idle: Duration::from_secs(args.upload_idle_s),
                presigned_uploads: args.presigned_uploads,
                presigned_downloads: args.presigned_downloads,
                poll: POLL_INTERVAL,
            },
            capabilities: Arc::new(capabilities),
            health,
            clock: Arc::new(SystemClock),
            ids: Arc::new(SystemIds),
            stopping: CancellationToken::new(),
        }
    }
}

async fn serve_until_stopped(args: &ServeArgs) -> Result<(), ServiceError> {
    let addresses = args.listen.resolve("--listen").await?;
    let auth = args.auth.for_addresses(&addresses);
    let data = ServiceData::open(&args.work.data).await?;
    let blender = find_blender(&args.work.blender).await;
    let slots = if args.no_workers { Some(0) } else { args.work.workers };
    let pool = data.pool(&args.work, slots, blender.clone().ok()).await?;
    let delivery = args.webhooks.delivery(POLL_INTERVAL)?;
    let shutdown = Shutdown::default();
    let health = data.health(&args.work, &blender, shutdown.drain.clone())?;
    serve_probes(&args.work, health.clone()).await?;
    let (limits, max_files) = (args.work.limits.limits(), usize::from(args.max_files));
    let capabilities = Capabilities::new(limits, max_files, blender, pool.sandbox().cloned());
    let state = data.api_state(args, auth, capabilities, health);
    // Long polls (`stopping`) and the listener (`closing`) end only after the running jobs.
    let (stopping, closing) = (state.stopping.clone(), CancellationToken::new());
    let listener = args.listen.bind("--listen", &addresses).await?;
    let address = listener.local_addr().map_err(io_error("the address to listen on"))?;
    announce(address, auth);
    let grace = seconds(args.work.shutdown_grace_s);
    tokio::spawn(stop_on_signal(shutdown.clone(), grace));
    let dispatcher = delivery.map(|(poster, config)| {
        let (clock, ids) = (Arc::new(SystemClock), Arc::new(SystemIds));
        let dispatcher = Dispatcher::new(Arc::clone(&data.store), poster, config, clock, ids);
        tokio::spawn(dispatcher.run(shutdown.drain.clone(), shutdown.now.clone()))
    });
    let workers = tokio::spawn(pool.run(shutdown.clone()));
    let (counted, in_flight) = InFlightRequestsLayer::pair();
    let served = tokio::spawn(serve_connections(listener, router(state).layer(counted), closing.clone()));
    if let Err(error) = workers.await {
        tracing::error!(%error, "workers failed");
    }
    if let Some(Err(error)) = futures::future::OptionFuture::from(dispatcher).await {
        tracing::error!(%error, "webhook delivery failed");
    }
    // Reads are served until the jobs have ended. Then long polls end, and the remaining requests are finished.
    shutdown.drain.cancelled().await;
    stopping.cancel();
    tokio::select! {
        () = until_idle(&in_flight) => {}
        () = shutdown.now.cancelled() => {}
    }
    closing.cancel();
    finish_connections(served, &shutdown).await;
    tracing::info!("stopped");
    Ok(())
}

/// Logs the address, and warns if other machines can use the service without a key.
fn announce(address: SocketAddr, auth: Auth) {
    let keys = if auth == Auth::Open { "no key required" } else { "key required" };
    tracing::info!("listening on http://{address}, documentation at http://{address}/docs/, {keys}");
    if auth == Auth::Open && !are_loopback(&[address]) {
        tracing::warn!(
            "--auth is open and other machines can reach {address}: anyone there may submit, read and delete jobs. Use --auth keys, or \
             listen on 127.0.0.1"
        );
    }
}

/// Waits for connections that are still open, such as a slow download, until the shutdown grace ends.
async fn finish_connections(served: JoinHandle<()>, shutdown: &Shutdown) {
    tokio::select! {
        served = served => {
            if let Err(error) = served {
                tracing::error!(%error, "server failed");
            }
        }
        () = async { shutdown.now.cancelled().await; tokio::time::sleep(Duration::from_secs(1)).await } => {
            tracing::warn!("connections still open at exit");
        }
    }
}

/// Starts the listener for probes and metrics, if `--metrics-listen` is set. It answers until the process ends, also
/// while jobs drain.
async fn serve_probes(args: &WorkArgs, health: Health) -> Result<(), ServiceError> {
    let Some(address) = &args.metrics_listen else { return Ok(()) };
    let addresses = address.resolve("--metrics-listen").await?;
    let listener = address.bind("--metrics-listen", &addresses).await?;
    let address = listener.local_addr().map_err(io_error("the address to listen on"))?;
    tracing::info!("probes and metrics at http://{address}");
    tokio::spawn(serve_connections(listener, probes(health), CancellationToken::new()));
    Ok(())
}

/// Finds Blender for tier 3, or the reason why tier 3 is unavailable.
async fn find_blender(args: &BlenderArgs) -> Result<RemesherInfo, String> {
    let config = args.config();
    let found = tokio::task::spawn_blocking(move || BlenderRemesher::find(config)).await;
    let found = found.map_err(|e| e.to_string()).and_then(|found| found.map_err(|e| e.to_string()));
    match found {
        Ok(remesher) => {
            let info = remesher.info().map_err(String::from)?.clone();
            tracing::info!(kind = info.kind, version = info.version, program = info.program, "tier 3 ready");
            Ok(info)
        }
        Err(reason) => {
            tracing::warn!(reason, "tier 3 unavailable: models that need Blender will be repaired only in part");
            Err(reason)
        }
    }
}

/// Waits until no request is in flight.
async fn until_idle(in_flight: &InFlightRequestsCounter) {
    while in_flight.get() > 0 {
        tokio::time::sleep(IDLE_POLL_INTERVAL).await;
    }
}

/// Stops the service on signals. The first signal drains: no job is accepted or started, and running jobs have
/// `grace` to finish. A second signal, or the end of the grace, stops these jobs and releases them.
async fn stop_on_signal(shutdown: Shutdown, grace: Duration) {
    let (Ok(mut terminate), Ok(mut interrupt)) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()))
    else {
        tracing::error!("cannot handle signals; only SIGKILL stops the service");
        return;
    };
    let mut next = async || {
        tokio::select! { _ = terminate.recv() => {}, _ = interrupt.recv() => {} }
    };
    next().await;
    tracing::info!(
        grace_s = grace.as_secs_f64(),
        "stopping: running jobs may finish; send the signal again to release them now"
    );
    shutdown.drain.cancel();
    tokio::select! { () = next() => {}, () = tokio::time::sleep(grace) => {} }
    shutdown.now.cancel();
}
