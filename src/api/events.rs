use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures::Stream;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::caller::MayRead;
use super::extract::{ApiQuery, PathJobId, find_job};
use super::job_view::{JobView, ProgressView};
use super::jobs::Include;
use super::problem::Problem;
use super::state::ApiState;
use super::wait::Watch;
use crate::jobs::Job;

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
