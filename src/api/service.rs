//! How the service is and what it can do: probes, metrics, capabilities, and the problem codes.

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

use super::authenticate::MayReadMetrics;
use super::extract::ApiPath;
use super::problem::{Problem, ProblemCode};
use super::problem_code::{ProblemDoc, catalogue};
use super::state::{ApiState, Capabilities, Health};
use crate::blobs::free_bytes;
use crate::jobs::Status;
use crate::telemetry;

/// Longest time one check may take.
const CHECK_TIME: Duration = Duration::from_secs(5);

/// Probes and metrics alone, for a listener that only operators reach.
pub fn probes(health: Health) -> Router {
    let router = Router::new()
        .route("/livez", get(livez))
        .route("/readyz", get(|State(health): State<Health>| async move { health.readiness().await }))
        .route("/metrics", get(|State(health): State<Health>| async move { health.metrics().await }));
    router.with_state(health)
}

/// Whether the process runs.
#[utoipa::path(get, path = "/livez", tag = "service", responses((status = 200, description = "It runs", body = String)))]
pub(super) async fn livez() -> &'static str {
    "ok\n"
}

/// Whether the service can do its work.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Readiness {
    /// Whether all that is needed works.
    ready: bool,
    /// Each check: `ok`, or what is wrong. A missing Blender does not make the service unready.
    checks: BTreeMap<&'static str, String>,
}

impl IntoResponse for Readiness {
    fn into_response(self) -> Response {
        let status = if self.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
        (status, [(header::CACHE_CONTROL, "no-store")], Json(self)).into_response()
    }
}

impl Health {
    /// Tries all that the process needs.
    async fn readiness(&self) -> Readiness {
        let store = check(self.store.ping()).await;
        let blobs = check(self.blobs.probe()).await;
        let disk = self.blobs.free_bytes().map_err(|error| error.to_string()).and_then(|free| self.check_free(free));
        let scratch = self.scratch_works().await.and_then(|free| self.check_free(Some(free)));
        let needed = [("store", store), ("blobs", blobs), ("disk", disk), ("scratch", scratch)];
        let draining = self.draining.is_cancelled();
        let ready = !draining && needed.iter().all(|(_, result)| result.is_ok());
        let mut checks = self.found.clone();
        checks.extend(needed.map(|(name, result)| (name, result.err().unwrap_or_else(|| "ok".to_owned()))));
        if draining {
            checks.insert("service", "stopping".to_owned());
        }
        Readiness { ready, checks }
    }

    fn check_free(&self, free: Option<u64>) -> Result<(), String> {
        match free {
            Some(free) if free < self.min_free => {
                Err(format!("no room: {} MiB are free, and {} must be", free >> 20, self.min_free >> 20))
            }
            _ => Ok(()),
        }
    }

    /// Writes a file where jobs work, and tells how much room there is.
    async fn scratch_works(&self) -> Result<u64, String> {
        let scratch = self.scratch.clone();
        let tried = tokio::task::spawn_blocking(move || {
            tempfile::tempfile_in(&scratch)?.write_all(b"probe")?;
            free_bytes(&scratch)
        });
        tried.await.map_err(std::io::Error::from).flatten().map_err(|error| error.to_string())
    }

    /// What waits and runs of each class of tenants. One that was told of stays in the metrics when nothing of it waits any more.
    async fn measure_classes(&self) {
        let loads = check(self.store.class_loads()).await;
        let mut classes = self.classes.lock().unwrap_or_else(PoisonError::into_inner);
        let none = if loads.is_ok() { 0.0 } else { f64::NAN };
        classes.iter().for_each(|class| record_class(class, none, none, none));
        for load in loads.unwrap_or_default() {
            record_class(&load.class, load.queued as f64, load.running as f64, load.wait.as_secs_f64());
            classes.insert(load.class);
        }
    }

    /// All metrics, with what has to be asked for. What can't be learnt now is no number.
    async fn metrics(&self) -> Response {
        for status in Status::ALL {
            metrics::gauge!(telemetry::JOBS, "status" => status.as_str()).set(f64::NAN);
        }
        for count in check(self.store.counts()).await.unwrap_or_default() {
            metrics::gauge!(telemetry::JOBS, "status" => count.status.as_str()).set(count.count as f64);
        }
        let wait = check(self.store.longest_wait()).await;
        metrics::gauge!(telemetry::QUEUE_WAIT).set(wait.map_or(f64::NAN, |wait| wait.as_secs_f64()));
        self.measure_classes().await;
        let backlog = check(self.store.backlog()).await;
        let (pending, overdue) =
            backlog.map_or((f64::NAN, f64::NAN), |it| (it.pending as f64, it.overdue.as_secs_f64()));
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

/// One class of tenants, in the metrics.
fn record_class(class: &str, queued: f64, running: f64, wait: f64) {
    metrics::gauge!(telemetry::CLASS_JOBS, "class" => class.to_owned(), "status" => "queued").set(queued);
    metrics::gauge!(telemetry::CLASS_JOBS, "class" => class.to_owned(), "status" => "running").set(running);
    metrics::gauge!(telemetry::CLASS_QUEUE_WAIT, "class" => class.to_owned()).set(wait);
}

async fn check<T, E: std::fmt::Display>(result: impl Future<Output = Result<T, E>>) -> Result<T, String> {
    match tokio::time::timeout(CHECK_TIME, result).await {
        Ok(result) => result.map_err(|error| error.to_string()),
        Err(_) => Err(format!("no answer within {} s", CHECK_TIME.as_secs())),
    }
}

/// Whether the service can take jobs.
///
/// Asks the database, writes and reads a file, looks how much room the disks have, and tells whether Blender is there.
#[utoipa::path(
    get, path = "/readyz", tag = "service",
    responses(
        (status = 200, description = "It can", body = Readiness),
        (status = 503, description = "It can't", body = Readiness),
    )
)]
pub(super) async fn readyz(State(state): State<ApiState>) -> Response {
    state.health.readiness().await.into_response()
}

/// Metrics for Prometheus.
///
/// Where the service asks for keys, one with the scope `metrics`.
#[utoipa::path(
    get, path = "/metrics", tag = "service",
    responses((status = 200, description = "Metrics in Prometheus' text format", body = String))
)]
pub(super) async fn get_metrics(State(state): State<ApiState>, MayReadMetrics(_caller): MayReadMetrics) -> Response {
    state.health.metrics().await
}

/// Every problem code, and what to do about it.
#[utoipa::path(
    get, path = "/problems", tag = "service",
    responses((status = 200, description = "The codes", body = Vec<ProblemDoc>))
)]
pub(super) async fn list_problems() -> Json<Vec<ProblemDoc>> {
    Json(catalogue())
}

/// One problem code, and what to do about it.
#[utoipa::path(
    get, path = "/problems/{code}", tag = "service",
    params(("code" = String, Path, description = "The code")),
    responses(
        (status = 200, description = "The code", body = ProblemDoc),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such code", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_problem(ApiPath(code): ApiPath<String>) -> Result<Json<ProblemDoc>, Problem> {
    let found = catalogue().into_iter().find(|doc| doc.code == code);
    found.map(Json).ok_or_else(|| Problem::new(ProblemCode::RouteNotFound, "There is no such problem code."))
}

/// What this service can do.
///
/// Formats, modes, presets, levels, limits, every option with its default, the tiers that work right now with Blender's version, and
/// the sandbox that jobs run in.
#[utoipa::path(
    get, path = "/v1/capabilities", tag = "service",
    responses((status = 200, description = "What can be asked for", body = Capabilities))
)]
pub(super) async fn get_capabilities(State(state): State<ApiState>) -> Json<Capabilities> {
    Json(state.capabilities.as_ref().clone())
}
