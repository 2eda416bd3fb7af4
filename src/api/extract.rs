use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;

use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use crate::jobs::{Job, JobId};

/// Axum's query extractor with a problem for a rejection.
#[derive(FromRequestParts)]
#[from_request(via(Query), rejection(Problem))]
pub(super) struct ApiQuery<T>(pub T);

/// Axum's path extractor with a problem for a rejection.
#[derive(FromRequestParts)]
#[from_request(via(Path), rejection(Problem))]
pub(super) struct ApiPath<T>(pub T);

/// The id of a job in a path. A text that is no id names no job.
pub(super) fn job_id(text: &str) -> Result<JobId, Problem> {
    text.parse().map_err(|error| {
        let shown: String = text.chars().take(64).collect();
        Problem::new(ProblemCode::JobNotFound, format!("There is no job '{shown}': {error}."))
    })
}

/// The job of that id, if it is there and not deleted.
pub(super) async fn find_job(state: &ApiState, id: JobId) -> Result<Job, Problem> {
    match state.store.get(id).await? {
        None => Err(Problem::new(ProblemCode::JobNotFound, format!("There is no job '{id}'."))),
        Some(job) if job.purged => Err(Problem::new(ProblemCode::JobDeleted, format!("The job '{id}' was deleted."))),
        Some(job) => Ok(job),
    }
}

/// A header as text, if it is there and is text.
pub(super) fn text_header<'a>(parts: &'a axum::http::HeaderMap, name: &axum::http::HeaderName) -> Option<&'a str> {
    parts.get(name).and_then(|value| value.to_str().ok())
}

/// The job that the path names, for handlers that need nothing else of it.
pub(super) struct PathJob(pub Job);

impl FromRequestParts<ApiState> for PathJob {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ApiState) -> Result<Self, Problem> {
        let ApiPath(id) = ApiPath::<String>::from_request_parts(parts, state).await?;
        find_job(state, job_id(&id)?).await.map(Self)
    }
}
