use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::header;
use axum::http::request::Parts;
use futures::StreamExt;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Number, Value};

use super::caller::Caller;
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use super::upload::{source_problem, with_patience};
use crate::jobs::{Job, JobId, whole_number};

/// Axum's query extractor with a problem for a rejection.
#[derive(FromRequestParts)]
#[from_request(via(Query), rejection(Problem))]
pub(super) struct ApiQuery<T>(pub T);

/// Axum's path extractor with a problem for a rejection.
#[derive(FromRequestParts)]
#[from_request(via(Path), rejection(Problem))]
pub(super) struct ApiPath<T>(pub T);

/// Largest body that is read as JSON, in bytes.
const JSON_BYTES: usize = 64 << 10;

/// A body of JSON, of bounded size, with a problem for a rejection.
pub(super) struct ApiJson<T>(pub T);

impl<T: DeserializeOwned> FromRequest<ApiState> for ApiJson<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &ApiState) -> Result<Self, Problem> {
        parse(&read_small(state, request).await?).map(Self)
    }
}

/// A body of bounded size that does not stop coming.
pub(super) async fn read_small(state: &ApiState, request: Request) -> Result<Vec<u8>, Problem> {
    let source = with_patience(request.into_body().into_data_stream(), state.config.upload_idle);
    let mut source = std::pin::pin!(source);
    let mut text = Vec::new();
    while let Some(chunk) = source.next().await {
        text.extend_from_slice(&chunk.map_err(|error| source_problem(&error))?);
        if text.len() > JSON_BYTES {
            let detail = format!("The body is larger than the {} KiB that this address takes.", JSON_BYTES >> 10);
            return Err(Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close"));
        }
    }
    Ok(text)
}

/// What a body of JSON says, which must be an object: to serde an array of its values would be the same.
pub(super) fn parse<'a, T: Deserialize<'a>>(text: &'a [u8]) -> Result<T, Problem> {
    if !text.trim_ascii_start().starts_with(b"{") {
        return Err(Problem::invalid_request("The body must be a JSON object."));
    }
    serde_json::from_slice(text).map_err(|error| Problem::invalid_request(format!("The body can't be read: {error}.")))
}

/// A field that is an object, and not an array of its values either.
pub(super) fn object<'de, D: Deserializer<'de>, T: DeserializeOwned>(from: D) -> Result<T, D::Error> {
    let fields = Map::<String, Value>::deserialize(from)?;
    T::deserialize(Value::Object(fields)).map_err(D::Error::custom)
}

/// A field that is a whole number of the format `int64`, and not below zero, or nothing.
pub(super) fn whole<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    let Some(number) = Option::<Number>::deserialize(from)? else { return Ok(None) };
    let found = whole_number(&number).filter(|&it| i64::try_from(it).is_ok());
    found.map(Some).ok_or_else(|| D::Error::custom(format!("{number} is not a whole number from 0 to {}", i64::MAX)))
}

/// The id of a job in a path. A text that is no id names no job.
pub(super) fn job_id(text: &str) -> Result<JobId, Problem> {
    text.parse()
        .map_err(|error| Problem::new(ProblemCode::JobNotFound, format!("There is no job '{}': {error}.", shown(text))))
}

/// The job of that id, if it is there for the caller and not deleted.
pub(super) async fn find_job(state: &ApiState, caller: &Caller, id: JobId) -> Result<Job, Problem> {
    match state.store.get(id).await?.filter(|job| caller.sees(job)) {
        None => Err(Problem::new(ProblemCode::JobNotFound, format!("There is no job '{id}'."))),
        Some(job) if job.purged => Err(Problem::new(ProblemCode::JobDeleted, format!("The job '{id}' was deleted."))),
        Some(job) => Ok(job),
    }
}

/// How many items a page is to have: as many as were asked for, 50 where nothing was said, at most 200.
pub(super) fn page_limit(asked: Option<u32>) -> Result<u32, Problem> {
    match asked.unwrap_or(50) {
        limit @ 1..=200 => Ok(limit),
        limit => Err(Problem::invalid_request(format!("limit is {limit}; it must be between 1 and 200."))),
    }
}

/// That a page can't begin at a cursor.
pub(super) fn unknown_cursor() -> Problem {
    Problem::invalid_request("cursor is not one that this service gave; take 'next' of the page before.")
}

/// A header as text, if it is there and is text.
pub(super) fn text_header<'a>(parts: &'a axum::http::HeaderMap, name: &axum::http::HeaderName) -> Option<&'a str> {
    parts.get(name).and_then(|value| value.to_str().ok())
}

/// Axum's path extractor for the id of a job.
pub(super) struct PathJobId(pub JobId);

impl FromRequestParts<ApiState> for PathJobId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ApiState) -> Result<Self, Problem> {
        let ApiPath(id) = ApiPath::<String>::from_request_parts(parts, state).await?;
        job_id(&id).map(Self)
    }
}
