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

use super::authenticate::{MayRead, MayWrite};
use super::extract::{ApiQuery, names_etag, page_limit, text_header, unknown_cursor};
use super::job::{JobView, PathJobId, ProgressView, Watch, answer, answer_view, etag, find_job};
use super::problem::{FieldError, Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::jobs::{CancelResult, Job, JobOutcome, ListQuery, Metadata, Status};

/// Longest time a request is held, in seconds.
const LONGEST_WAIT: u64 = 60;

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct WaitQuery {
    /// Hold the answer until the job's status changes or so many seconds have passed; more than 60 is taken as 60. The
    /// header `Prefer: wait=20` asks for the same.
    #[param(minimum = 0, example = 20)]
    wait: Option<u64>,
    /// What to answer beside the job.
    #[param(inline)]
    include: Option<Include>,
}

/// What a job's answer may include.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Include {
    /// The report.
    Report,
}

/// One job.
///
/// Answers 304 where If-None-Match names the state that the client has. Retry-After says when to ask again.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "The job's id"), WaitQuery),
    responses(
        (status = 200, description = "The job", body = JobView),
        (status = 304, description = "Nothing has changed"),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_job(
    State(state): State<ApiState>,
    MayRead(caller): MayRead,
    PathJobId(id): PathJobId,
    ApiQuery(query): ApiQuery<WaitQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let asked = query.wait;
    let mut watch = Watch::new(&state, id);
    let mut job = find_job(&state, &caller, id).await?;
    if let Some(seconds) = asked.or_else(|| preferred_wait(&headers)) {
        let longest = Duration::from_secs(seconds.min(LONGEST_WAIT));
        job = watch.status_change(job, longest).await?;
        if job.purged {
            return Err(Problem::new(ProblemCode::JobDeleted, format!("The job '{id}' was deleted.")));
        }
    }
    let position = state.store.queue_position(&job).await?;
    let report = query.include.and_then(|Include::Report| job.report.clone());
    let etag = etag(&job, position);
    if text_header(&headers, &header::IF_NONE_MATCH).is_some_and(|known| names_etag(known, &etag)) {
        let headers = [(header::ETAG, etag), (header::CACHE_CONTROL, "no-cache".to_owned())];
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let view = JobView::new(job, position, state.config.retention).with_report(report);
    Ok(answer_view(StatusCode::OK, view, [(header::ETAG, etag)]))
}

/// The seconds of `Prefer: wait=N` (RFC 7240).
fn preferred_wait(headers: &HeaderMap) -> Option<u64> {
    let prefer = text_header(headers, &HeaderName::from_static("prefer"))?;
    prefer.split([',', ';']).find_map(|part| part.trim().strip_prefix("wait=")?.trim().parse().ok())
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct JobsQuery {
    /// Only jobs of these statuses, with commas between, such as `queued,running`.
    #[param(style = Form, explode = false)]
    status: Option<Vec<Status>>,
    /// Only jobs of these outcomes, with commas between.
    #[param(style = Form, explode = false)]
    outcome: Option<Vec<JobOutcome>>,
    /// Only jobs accepted at this time or later (RFC 3339).
    #[param(format = DateTime, example = "2026-01-31T00:00:00Z")]
    created_from: Option<String>,
    /// Only jobs accepted before this time (RFC 3339).
    #[param(format = DateTime)]
    created_before: Option<String>,
    /// Only jobs whose metadata has these entries, perhaps among others: a JSON object of texts.
    #[param(example = r#"{"order":"17"}"#)]
    metadata: Option<String>,
    /// Where to go on: `next` of the page before.
    cursor: Option<String>,
    /// Jobs on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// A page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct JobPage {
    /// The jobs, newest first, without their reports and queue positions.
    jobs: Vec<JobView>,
    /// The cursor of the next page; none on the last.
    #[schema(required)]
    next: Option<String>,
}

/// Jobs, newest first.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(JobsQuery),
    responses(
        (status = 200, description = "A page of jobs", body = JobPage),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_jobs(
    State(state): State<ApiState>,
    MayRead(caller): MayRead,
    ApiQuery(query): ApiQuery<JobsQuery>,
) -> Result<Json<JobPage>, Problem> {
    let limit = page_limit(query.limit)?;
    let before = query.cursor.map(|cursor| cursor.parse()).transpose().map_err(|_| unknown_cursor())?;
    let (tenant, made_by) = (caller.tenant.to_string(), caller.only_made_by());
    let query = ListQuery {
        tenant,
        made_by,
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

/// The milliseconds since the Unix epoch of a time in a query.
fn read_time(field: &str, text: &str) -> Result<i64, Problem> {
    let time = OffsetDateTime::parse(text, &Rfc3339).map_err(|_| {
        let message = format!("`{field}` must be a time such as 2026-01-31T00:00:00Z; got \"{}\".", shown(text));
        Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new(field, message)])
    })?;
    i64::try_from(time.unix_timestamp_nanos() / 1_000_000).map_err(|error| Problem::internal(&error))
}

fn read_metadata(text: &str) -> Result<Metadata, Problem> {
    serde_json::from_str(text).map_err(|_| {
        let message = r#"`metadata` must be a JSON object of texts, such as {"order":"17"}."#;
        Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new("metadata", message)])
    })
}

/// Stop a job.
///
/// A job that runs is stopped with all its processes. Canceling a canceled job changes nothing.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs",
    params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 200, description = "The job is canceled", body = JobView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has ended", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn cancel_job(
    State(state): State<ApiState>,
    MayWrite(caller): MayWrite,
    PathJobId(id): PathJobId,
) -> Result<Response, Problem> {
    let job = find_job(&state, &caller, id).await?;
    match state.store.cancel(job.id).await? {
        Some(CancelResult::Canceled(job)) => {
            let etag = etag(&job, None);
            Ok(answer(&state, StatusCode::OK, *job, None, [(header::ETAG, etag)]))
        }
        Some(CancelResult::AlreadyEnded(job)) => {
            let detail = format!("The job '{}' has {}; it can't be canceled any more.", job.id, job.status.as_str());
            Err(Problem::new(ProblemCode::JobFinished, detail))
        }
        None => Err(Problem::new(ProblemCode::JobNotFound, format!("There is no job '{}'.", job.id))),
    }
}

/// Delete a job and its files.
///
/// A job that has not ended is canceled first. The upload, the results and the report are deleted, and so is what webhooks have told
/// of it or still had to tell.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 204, description = "The job and its files are gone"),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted before", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database or the file store does not answer now", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_job(
    State(state): State<ApiState>,
    MayWrite(caller): MayWrite,
    PathJobId(id): PathJobId,
) -> Result<StatusCode, Problem> {
    let found = find_job(&state, &caller, id).await.map(drop);
    if found.as_ref().is_err_and(|problem| problem.code != ProblemCode::JobDeleted) {
        return found.map(|()| StatusCode::NO_CONTENT);
    }
    // A client that hangs up must not stop this half way, and asking again finishes what was stopped otherwise.
    let deleting = async move {
        state.store.purge(id).await?;
        state.blobs.delete_job(id).await?;
        tracing::info!(job_id = %id, "deleted");
        Ok::<(), Problem>(())
    };
    tokio::spawn(deleting.in_current_span()).await.map_err(|error| Problem::internal(&error))??;
    found.map(|()| StatusCode::NO_CONTENT)
}

/// One event of a job's stream.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the events in the OpenAPI document")]
pub(super) struct StreamEvent {
    /// `progress`, or at the end `done`.
    event: String,
    /// JSON: of `progress` the status, stage, tier, percent and queue position, of `done` the job.
    data: String,
    /// The job's version.
    id: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct IncludeQuery {
    /// What the job of `done` is to include.
    #[param(inline)]
    include: Option<Include>,
}

/// Listen to a job.
///
/// Server-sent events: `progress` with stage, tier, percent and queue position each time the job changes, and at the end
/// `done` with the job. A client that reconnects hears the present state first.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(("id" = String, Path, description = "The job's id"), IncludeQuery),
    responses(
        (status = 200, description = "The events", body = StreamEvent, content_type = "text/event-stream"),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn job_events(
    State(state): State<ApiState>,
    MayRead(caller): MayRead,
    PathJobId(id): PathJobId,
    ApiQuery(IncludeQuery { include }): ApiQuery<IncludeQuery>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    find_job(&state, &caller, id).await?;
    let watch = Watch::new(&state, id);
    let stream = futures::stream::unfold((watch, 0, false), move |(mut watch, seen, done)| {
        let state = state.clone();
        async move {
            if done {
                return None;
            }
            let job = match watch.past(seen).await {
                Ok(job) => job?,
                Err(error) => {
                    tracing::error!(%error, "a listener was lost");
                    return None;
                }
            };
            let (seen, done) = (job.version, job.status.is_final() || job.purged);
            Some((Ok(event(&state, job, include).await), (watch, seen, done)))
        }
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

async fn event(state: &ApiState, job: Job, include: Option<Include>) -> Event {
    let position = state.store.queue_position(&job).await.unwrap_or(None);
    let id = job.version.to_string();
    let (status, done) = (job.status, job.status.is_final());
    let report = include.and_then(|Include::Report| job.report.clone());
    let view = JobView::new(job, position, state.config.retention).with_report(report);
    let event = if done {
        Event::default().event("done").json_data(view)
    } else {
        let ProgressView { stage, tier, percent, queue_position } =
            view.progress.unwrap_or(ProgressView { stage: None, tier: None, percent: 0, queue_position: None });
        let data = serde_json::json!({
            "status": status, "stage": stage, "tier": tier, "percent": percent, "queue_position": queue_position,
        });
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
