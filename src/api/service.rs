//! Routes about the service itself: probes, metrics, capabilities, and the problem codes.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::PoisonError;
use std::time::Duration;

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Serialize;
use utoipa::ToSchema;

use super::authenticate::RequireMetrics;
use super::extract::ApiPath;
use super::problem::{Problem, ProblemCode};
use super::problem_code::{ProblemDoc, catalogue};
use super::state::{ApiState, Capabilities, Health};
use crate::blobs::free_bytes;
use crate::jobs::Status;
use crate::telemetry;

/// Timeout of one readiness check.
const CHECK_TIME: Duration = Duration::from_secs(5);

/// Builds a router of the probes and metrics only, for a listener that only operators can reach.
pub fn probes(health: Health) -> Router {
    let router = Router::new()
        .route("/livez", get(livez))
        .route("/readyz", get(|State(health): State<Health>| async move { health.readiness().await }))
        .route("/metrics", get(|State(health): State<Health>| async move { health.metrics().await }));
    router.with_state(health)
}

/// Liveness probe.
///
/// Returns 200 while the process runs.
#[utoipa::path(get, path = "/livez", tag = "service", responses((status = 200, description = "The process runs", body = String)))]
pub(super) async fn livez() -> &'static str {
    "ok\n"
}

/// The readiness of the service.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Readiness {
    /// Whether all required checks passed.
    ready: bool,
    /// The result of each check: `ok`, or what is wrong. A missing Blender does not affect readiness.
    checks: BTreeMap<&'static str, String>,
}

impl IntoResponse for Readiness {
    fn into_response(self) -> Response {
        let status = if self.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
        (status, [(header::CACHE_CONTROL, "no-store")], Json(self)).into_response()
    }
}

impl Health {
    /// Runs all readiness checks.
    async fn readiness(&self) -> Readiness {
        let store = check(self.store.ping()).await;
        let blobs = check(self.blobs.probe(self.ids.as_ref())).await;
        let disk = self.blobs.free_bytes().map_err(|error| error.to_string()).and_then(|free| self.check_free(free));
        let scratch = self.probe_scratch().await.and_then(|free| self.check_free(Some(free)));
        let required = [("store", store), ("blobs", blobs), ("disk", disk), ("scratch", scratch)];
        let draining = self.draining.is_cancelled();
        let ready = !draining && required.iter().all(|(_, result)| result.is_ok());
        let mut checks = self.startup_checks.clone();
        checks.extend(required.map(|(name, result)| (name, result.err().unwrap_or_else(|| "ok".to_owned()))));
        if draining {
            checks.insert("service", "stopping".to_owned());
        }
        Readiness { ready, checks }
    }

    /// Checks that enough disk space is free.
    fn check_free(&self, free: Option<u64>) -> Result<(), String> {
        match free {
            Some(free) if free < self.min_free => {
                Err(format!("disk full: {} MiB free, {} MiB required", free >> 20, self.min_free >> 20))
            }
            _ => Ok(()),
        }
    }

    /// Writes a file in the scratch folder, and returns the free bytes of its disk.
    async fn probe_scratch(&self) -> Result<u64, String> {
        let scratch = self.scratch.clone();
        let probe = tokio::task::spawn_blocking(move || {
            tempfile::tempfile_in(&scratch)?.write_all(b"probe")?;
            free_bytes(&scratch)
        });
        probe.await.map_err(std::io::Error::from).flatten().map_err(|error| error.to_string())
    }

    /// Updates the metrics of each tenant class. A class reported once stays in the metrics, with zeros if it has no jobs.
    async fn update_class_metrics(&self) {
        let loads = check(self.store.class_loads()).await;
        let mut classes = self.classes.lock().unwrap_or_else(PoisonError::into_inner);
        let fallback = if loads.is_ok() { 0.0 } else { f64::NAN };
        classes.iter().for_each(|class| record_class(class, fallback, fallback, fallback));
        for load in loads.unwrap_or_default() {
            record_class(&load.class, load.queued as f64, load.running as f64, load.wait.as_secs_f64());
            classes.insert(load.class);
        }
    }

    /// Renders all metrics, after querying the database for current values. A value that can't be queried is NaN.
    async fn metrics(&self) -> Response {
        for status in Status::ALL {
            metrics::gauge!(telemetry::JOBS, "status" => status.as_str()).set(f64::NAN);
        }
        for count in check(self.store.counts()).await.unwrap_or_default() {
            metrics::gauge!(telemetry::JOBS, "status" => count.status.as_str()).set(count.count as f64);
        }
        let wait = check(self.store.longest_wait()).await;
        metrics::gauge!(telemetry::QUEUE_WAIT).set(wait.map_or(f64::NAN, |wait| wait.as_secs_f64()));
        self.update_class_metrics().await;
        let backlog = check(self.store.backlog()).await;
        let (pending, overdue) =
            backlog.map_or((f64::NAN, f64::NAN), |backlog| (backlog.pending as f64, backlog.overdue.as_secs_f64()));
        metrics::gauge!(telemetry::WEBHOOK_BACKLOG).set(pending);
        metrics::gauge!(telemetry::WEBHOOK_OVERDUE).set(overdue);
        metrics_process::Collector::default().collect();
        let connections = self.store.connections();
        metrics::gauge!(telemetry::DATABASE_CONNECTIONS, "state" => "busy").set(connections.busy);
        metrics::gauge!(telemetry::DATABASE_CONNECTIONS, "state" => "idle").set(connections.idle);
        metrics::gauge!(telemetry::DATABASE_CONNECTIONS_MAX).set(connections.most);
        let free = [("files", self.blobs.free_bytes().ok().flatten()), ("scratch", free_bytes(&self.scratch).ok())];
        for (folder, free) in free {
            if let Some(free) = free {
                metrics::gauge!(telemetry::DISK_FREE, "folder" => folder).set(free as f64);
            }
        }
        ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], self.metrics.render()).into_response()
    }
}

/// Sets the metrics of one tenant class.
fn record_class(class: &str, queued: f64, running: f64, wait: f64) {
    metrics::gauge!(telemetry::CLASS_JOBS, "class" => class.to_owned(), "status" => "queued").set(queued);
    metrics::gauge!(telemetry::CLASS_JOBS, "class" => class.to_owned(), "status" => "running").set(running);
    metrics::gauge!(telemetry::CLASS_QUEUE_WAIT, "class" => class.to_owned()).set(wait);
}

/// Runs one check with a timeout of [`CHECK_TIME`].
async fn check<T, E: std::fmt::Display>(result: impl Future<Output = Result<T, E>>) -> Result<T, String> {
    match tokio::time::timeout(CHECK_TIME, result).await {
        Ok(result) => result.map_err(|error| error.to_string()),
        Err(_) => Err(format!("no answer within {} s", CHECK_TIME.as_secs())),
    }
}

/// Readiness probe.
///
/// Queries the database, writes and reads a file in the file store, and checks free disk space and Blender.
#[utoipa::path(
    get, path = "/readyz", tag = "service",
    responses(
        (status = 200, description = "The service accepts jobs", body = Readiness),
        (status = 503, description = "The service does not accept jobs", body = Readiness),
    )
)]
pub(super) async fn readyz(State(state): State<ApiState>) -> Response {
    state.health.readiness().await.into_response()
}

/// Metrics for Prometheus.
///
/// Requires a key with the scope `metrics` if the service requires keys.
#[utoipa::path(
    get, path = "/metrics", tag = "service",
    responses((status = 200, description = "Metrics in the Prometheus text format", body = String))
)]
pub(super) async fn get_metrics(State(state): State<ApiState>, RequireMetrics(_caller): RequireMetrics) -> Response {
    state.health.metrics().await
}

/// List the problem codes.
///
/// Returns every code with its title, HTTP status and advice.
#[utoipa::path(
    get, path = "/problems", tag = "service",
    responses((status = 200, description = "The problem codes", body = Vec<ProblemDoc>))
)]
pub(super) async fn list_problems() -> Json<Vec<ProblemDoc>> {
    Json(catalogue())
}

/// Get a problem code.
///
/// Returns the code's title, HTTP status and advice.
#[utoipa::path(
    get, path = "/problems/{code}", tag = "service",
    params(("code" = String, Path, description = "The problem code")),
    responses(
        (status = 200, description = "The problem code", body = ProblemDoc),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Problem code not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_problem(ApiPath(code): ApiPath<String>) -> Result<Json<ProblemDoc>, Problem> {
    let doc = catalogue().into_iter().find(|doc| doc.code == code);
    doc.map(Json).ok_or_else(|| {
        Problem::new(ProblemCode::RouteNotFound, "There is no such problem code. GET /problems lists all codes.")
    })
}

/// Get the service's capabilities.
///
/// Returns the supported formats, modes, presets, levels and limits, every option with its default, the available tiers with Blender's
/// version, and the sandbox of the jobs.
#[utoipa::path(
    get, path = "/v1/capabilities", tag = "service",
    responses((status = 200, description = "The capabilities", body = Capabilities))
)]
pub(super) async fn get_capabilities(State(state): State<ApiState>) -> Json<Capabilities> {
    Json(state.capabilities.as_ref().clone())
}
