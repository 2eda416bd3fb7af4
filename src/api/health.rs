use std::collections::BTreeMap;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::caller::MayReadMetrics;
use super::catalogue::{ProblemDoc, catalogue};
use super::extract::ApiPath;
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use super::submit::has_room;

/// Longest time one check may take.
const CHECK_TIME: Duration = Duration::from_secs(5);

/// Whether the process runs.
#[utoipa::path(get, path = "/livez", tag = "service", responses((status = 200, description = "It runs", body = String)))]
pub(super) async fn livez() -> &'static str {
    "ok\n"
}

/// Whether the service can take jobs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Readiness {
    /// Whether all that is needed works.
    ready: bool,
    /// Each check: `ok`, or what is wrong. A missing Blender does not make the service unready.
    checks: BTreeMap<&'static str, String>,
}

/// Whether the service can take jobs.
///
/// Asks the database, writes and reads a file, looks how much room the disk has, and tells whether Blender is there.
#[utoipa::path(
    get, path = "/readyz", tag = "service",
    responses(
        (status = 200, description = "It can", body = Readiness),
        (status = 503, description = "It can't", body = Readiness),
    )
)]
pub(super) async fn readyz(State(state): State<ApiState>) -> Response {
    let store = check(state.store.ping()).await;
    let blobs = check(state.blobs.probe()).await;
    let disk = has_room(&state, 0).map_err(|problem| problem.detail);
    let stopping = state.stopping.is_cancelled();
    let ready = store.is_ok() && blobs.is_ok() && disk.is_ok() && !stopping;
    let word = |result: Result<(), String>| result.err().unwrap_or_else(|| "ok".to_owned());
    let mut checks = BTreeMap::from([("store", word(store)), ("blobs", word(blobs)), ("disk", word(disk))]);
    if stopping {
        checks.insert("service", "stopping".to_owned());
    }
    if let Some(tier) = state.capabilities.tiers.iter().find(|tier| tier.tier == 3) {
        let blender = if tier.available { None } else { Some(tier.detail.clone().unwrap_or_default()) };
        checks.insert("blender", blender.map_or_else(|| "ok".to_owned(), |why| format!("missing: {why}")));
    }
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(Readiness { ready, checks })).into_response()
}

async fn check<E: std::fmt::Display>(result: impl Future<Output = Result<(), E>>) -> Result<(), String> {
    match tokio::time::timeout(CHECK_TIME, result).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err(format!("no answer within {} s", CHECK_TIME.as_secs())),
    }
}

/// Metrics for Prometheus.
///
/// Where the service asks for keys, one with the scope `metrics`.
#[utoipa::path(
    get, path = "/metrics", tag = "service",
    responses(
        (status = 200, description = "Metrics in Prometheus' text format", body = String),
        (status = 500, description = "A fault of the service", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database does not answer now", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_metrics(
    State(state): State<ApiState>,
    MayReadMetrics(_caller): MayReadMetrics,
) -> Result<Response, Problem> {
    for count in state.store.counts().await? {
        metrics::gauge!("meshmend_jobs", "status" => count.status.as_str())
            .set(u32::try_from(count.count).unwrap_or(u32::MAX));
    }
    let backlog = state.store.backlog().await?;
    metrics::gauge!("meshmend_webhook_backlog").set(u32::try_from(backlog.pending).unwrap_or(u32::MAX));
    metrics::gauge!("meshmend_webhook_overdue_seconds").set(backlog.overdue.as_secs_f64());
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], state.metrics.render()).into_response())
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
