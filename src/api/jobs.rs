//! Routes of jobs: get, list, cancel, delete, and the event stream.
use std::convert::Infallible;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::Stream;
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use tracing::Instrument;
use utoipa::{IntoParams, ToSchema};

use super::authenticate::{RequireJobsRead, RequireJobsWrite};
use super::extract::{ApiQuery, contains_etag, invalid_cursor, page_limit, text_header};
use super::job::{JobView, JobWatcher, PathJobId, ProgressView, answer, answer_view, etag, find_job};
use super::problem::{FieldError, Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::jobs::{CancelResult, Job, JobOutcome, ListQuery, Metadata, Status};

/// Longest time for which a request is held, in seconds.
const LONGEST_WAIT: u64 = 60;

/// Query parameters of a single job.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct WaitQuery {
    /// Hold the response until the job's status changes, for at most this many seconds. Values above 60 count as 60. The
    /// header `Prefer: wait=20` has the same effect.
    #[param(minimum = 0, example = 20)]
    wait: Option<u64>,
    /// Additional content of the response.
    #[param(inline)]
    include: Option<Include>,
}

/// Additional content of a job's response.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Include {
    /// The report.
    Report,
}

/// Get a job.
///
/// Returns 304 if `If-None-Match` contains the job's current entity tag. `Retry-After` says when to poll again.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "The job's id"), WaitQuery),
    responses(
        (status = 200, description = "The job", body = JobView),
        (status = 304, description = "The job has not changed"),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Job not found", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_job(
    State(state): State<ApiState>,
    RequireJobsRead(caller): RequireJobsRead,
    PathJobId(id): PathJobId,
    ApiQuery(query): ApiQuery<WaitQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut watcher = JobWatcher::new(&state, id);
    let mut job = find_job(&state, &caller, id).await?;
    if let Some(seconds) = query.wait.or_else(|| preferred_wait(&headers)) {
        let timeout = Duration::from_secs(seconds.min(LONGEST_WAIT));
        job = watcher.status_change(job, timeout).await?;
        if job.purged {
            return Err(Problem::new(ProblemCode::JobDeleted, format!("The job '{id}' was deleted.")));
        }
    }
    let position = state.store.queue_position(&job).await?;
    let report = query.include.and_then(|Include::Report| job.report.clone());
    let etag = etag(&job, position);
    if text_header(&headers, &header::IF_NONE_MATCH).is_some_and(|list| contains_etag(list, &etag)) {
        let headers = [(header::ETAG, etag), (header::CACHE_CONTROL, "no-cache".to_owned())];
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let view = JobView::new(job, position, state.config.retention).with_report(report);
    Ok(answer_view(StatusCode::OK, view, [(header::ETAG, etag)]))
}

/// Returns the seconds in `Prefer: wait=N` (RFC 7240).
fn preferred_wait(headers: &HeaderMap) -> Option<u64> {
    let prefer = text_header(headers, &HeaderName::from_static("prefer"))?;
    prefer.split([',', ';']).find_map(|part| part.trim().strip_prefix("wait=")?.trim().parse().ok())
}

/// Query parameters of the list of jobs.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct JobsQuery {
    /// Only jobs with these statuses, separated by commas, such as `queued,running`.
    #[param(style = Form, explode = false)]
    status: Option<Vec<Status>>,
    /// Only jobs with these outcomes, separated by commas.
    #[param(style = Form, explode = false)]
    outcome: Option<Vec<JobOutcome>>,
    /// Only jobs created at or after this time (RFC 3339).
    #[param(format = DateTime, example = "2026-01-31T00:00:00Z")]
    created_from: Option<String>,
    /// Only jobs created before this time (RFC 3339).
    #[param(format = DateTime)]
    created_before: Option<String>,
    /// Only jobs whose metadata contains these entries: a JSON object of text values.
    #[param(example = r#"{"order":"17"}"#)]
    metadata: Option<String>,
    /// The `next` value of the previous page.
    cursor: Option<String>,
    /// Number of jobs per page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// One page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct JobPage {
    /// The jobs, newest first, without reports and queue positions.
    jobs: Vec<JobView>,
    /// The cursor of the next page, or `null` on the last page.
    #[schema(required)]
    next: Option<String>,
}

/// List jobs, newest first.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(JobsQuery),
    responses(
        (status = 200, description = "A page of jobs", body = JobPage),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_jobs(
    State(state): State<ApiState>,
    RequireJobsRead(caller): RequireJobsRead,
    ApiQuery(query): ApiQuery<JobsQuery>,
) -> Result<Json<JobPage>, Problem> {
    let limit = page_limit(query.limit)?;
    let before = query.cursor.map(|cursor| cursor.parse()).transpose().map_err(|_| invalid_cursor())?;
    let (tenant, api_key_id) = (caller.tenant.to_string(), caller.token_id());
    let query = ListQuery {
        tenant,
        api_key_id,
        statuses: query.status.unwrap_or_default(),
        outcomes: query.outcome.unwrap_or_default(),
        created_from: query.created_from.map(|text| read_time("created_from", &text)).transpose()?,
        created_before: query.created_before.map(|text| read_time("created_before", &text)).transpose()?,
        metadata: query.metadata.map(|text| read_metadata(&text)).transpose()?.unwrap_or_default(),
        before,
        limit,
    };
    let page = state.store.list(query).await?;
    let jobs = page.items.into_iter().map(|job| JobView::new(job, None, state.config.retention)).collect();
    Ok(Json(JobPage { jobs, next: page.next.map(|id| id.to_string()) }))
}

/// Parses a time in a query, and returns milliseconds since the Unix epoch.
fn read_time(field: &str, text: &str) -> Result<i64, Problem> {
    let time = OffsetDateTime::parse(text, &Rfc3339).map_err(|_| {
        let message = format!("`{field}` must be a time such as 2026-01-31T00:00:00Z; got \"{}\".", truncated(text));
        Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new(field, message)])
    })?;
    i64::try_from(time.unix_timestamp_nanos() / 1_000_000).map_err(|error| Problem::internal(&error))
}

/// Parses the `metadata` filter of a query.
fn read_metadata(text: &str) -> Result<Metadata, Problem> {
    serde_json::from_str(text).map_err(|_| {
        let message = r#"`metadata` must be a JSON object of text values, such as {"order":"17"}."#;
        Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new("metadata", message)])
    })
}

/// Cancel a job.
///
/// Stops a running job and all its processes. Canceling a canceled job has no effect.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs",
    params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 200, description = "The job is canceled", body = JobView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Job not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has already finished", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn cancel_job(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    PathJobId(id): PathJobId,
) -> Result<Response, Problem> {
    let job = find_job(&state, &caller, id).await?;
    match state.store.cancel(job.id).await? {
        Some(CancelResult::Canceled(job)) => {
            let etag = etag(&job, None);
            Ok(answer(&state, StatusCode::OK, *job, None, [(header::ETAG, etag)]))
        }
        Some(CancelResult::AlreadyEnded(job)) => {
            let detail = format!("The job '{}' has already {}, so it can't be canceled.", job.id, job.status.as_str());
            Err(Problem::new(ProblemCode::JobFinished, detail))
        }
        None => Err(Problem::new(ProblemCode::JobNotFound, format!("There is no job '{}'.", job.id))),
    }
}

/// Delete a job and its files.
///
/// Cancels the job first if it has not ended. Deletes the upload, the results and the report. Also deletes the job's webhook messages,
/// delivered or pending.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 204, description = "The job and its files were deleted"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Job not found", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was already deleted", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database or the file store is unavailable", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_job(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    PathJobId(id): PathJobId,
) -> Result<StatusCode, Problem> {
    let visible = find_job(&state, &caller, id).await.map(drop);
    if visible.as_ref().is_err_and(|problem| problem.code != ProblemCode::JobDeleted) {
        return visible.map(|()| StatusCode::NO_CONTENT);
    }
    // A task of its own, so that a client disconnect does not interrupt the deletion. A retry completes an interrupted deletion.
    let deleting = async move {
        state.store.purge(id).await?;
        state.blobs.delete_job(id).await?;
        tracing::info!(job_id = %id, "deleted job");
        Ok::<(), Problem>(())
    };
    tokio::spawn(deleting.in_current_span()).await.map_err(|error| Problem::internal(&error))??;
    visible.map(|()| StatusCode::NO_CONTENT)
}

/// One event of a job's event stream.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the events in the OpenAPI document")]
pub(super) struct StreamEvent {
    /// `progress`, or `done` as the last event.
    event: String,
    /// JSON. For `progress`: the status, stage, tier, percent, queue position and estimate. For `done`: the job.
    data: String,
    /// The job's version, a number that grows with each change.
    id: String,
}

/// Query parameters of a job's event stream.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct IncludeQuery {
    /// Additional content of the job in the event `done`.
    #[param(inline)]
    include: Option<Include>,
}

/// Stream a job's events.
///
/// Server-sent events: `progress` with stage, tier, percent and queue position after each change of the job, then `done` with the job.
/// A client that reconnects first receives the current state.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(("id" = String, Path, description = "The job's id"), IncludeQuery),
    responses(
        (status = 200, description = "The event stream", body = StreamEvent, content_type = "text/event-stream"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Job not found", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn job_events(
    State(state): State<ApiState>,
    RequireJobsRead(caller): RequireJobsRead,
    PathJobId(id): PathJobId,
    ApiQuery(IncludeQuery { include }): ApiQuery<IncludeQuery>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    find_job(&state, &caller, id).await?;
    let watcher = JobWatcher::new(&state, id);
    let stream = futures::stream::unfold((watcher, 0, false), move |(mut watcher, seen, done)| {
        let state = state.clone();
        async move {
            if done {
                return None;
            }
            let job = match watcher.newer_than(seen).await {
                Ok(job) => job?,
                Err(error) => {
                    tracing::error!(%error, "ended event stream: failed to read job");
                    return None;
                }
            };
            let (seen, done) = (job.version, job.status.is_final() || job.purged);
            Some((Ok(event(&state, job, include).await), (watcher, seen, done)))
        }
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

/// Builds the event for the job's current state: `progress`, or `done` if the job has ended.
async fn event(state: &ApiState, job: Job, include: Option<Include>) -> Event {
    let position = state.store.queue_position(&job).await.unwrap_or(None);
    let id = job.version.to_string();
    let (status, done) = (job.status, job.status.is_final());
    let report = include.and_then(|Include::Report| job.report.clone());
    let view = JobView::new(job, position, state.config.retention).with_report(report);
    let event = if done {
        Event::default().event("done").json_data(view)
    } else {
        let ProgressView { stage, tier, percent, estimate, queue_position } = view.progress.unwrap_or_default();
        let mut data = serde_json::json!({
            "status": status, "stage": stage, "tier": tier, "percent": percent, "queue_position": queue_position,
        });
        if let Some(estimate) = estimate {
            data["estimate"] = serde_json::json!(estimate);
        }
        Event::default().event("progress").json_data(data)
    };
    event.unwrap_or_default().id(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_prefer_header_gives_the_seconds_to_wait() {
        let mut headers = HeaderMap::new();
        headers.insert("prefer", "respond-async, wait=7".parse().expect("a header"));
        assert_eq!(preferred_wait(&headers), Some(7));
        headers.insert("prefer", "wait=x".parse().expect("a header"));
        assert_eq!(preferred_wait(&headers), None);
    }
}
