//! Uploads that come before their job: announced here, sent to an address that is good for a while, and taken by `POST /v1/jobs`.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::submission::clean_name;
use crate::access::{Token, random_hex};
use crate::api::authenticate::MayWrite;
use crate::api::extract::{
    ApiPath, ApiQuery, RawModel, UploadBudget, parse, read_small, text_header, too_large, whole, with_idle_limit,
};
use crate::api::problem::{Problem, ProblemCode, shown};
use crate::api::state::{ApiState, busy};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{NewUpload, PendingUpload, UPLOAD_LIFE, UPLOAD_OPEN, UploadId};

/// What is known of a file before it is sent.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct UploadRequest {
    /// The file's name.
    #[schema(example = "bracket.stl")]
    name: Option<String>,
    /// Its size. One that is too large is refused before it is sent.
    #[serde(deserialize_with = "whole")]
    bytes: Option<u64>,
}

/// Where to send a file.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Upload)]
pub struct UploadView {
    /// The upload's name, for the `source` of a job.
    #[schema(example = "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The request that sends the file.
    put: PutView,
    /// Most bytes that it may have.
    max_bytes: u64,
    /// Until when a job may be made of it.
    #[serde(with = "crate::jobs::timestamp")]
    expires_at: OffsetDateTime,
}

/// A request to send.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = UploadPut)]
pub struct PutView {
    /// Its method.
    #[schema(example = "PUT")]
    method: &'static str,
    /// Its address; one without a host is of this service. Whoever has it may send the file, so keep it from others.
    url: String,
    /// Headers that it must have.
    headers: BTreeMap<String, String>,
    /// Until when it may begin.
    #[serde(with = "crate::jobs::timestamp")]
    expires_at: OffsetDateTime,
}

/// Announce a file, and learn where to send it.
///
/// For large files and for browsers: the bytes go straight to the store where there is one, and a job is made of them afterwards, by
/// `POST /v1/jobs` with JSON. Send the file as the whole body of the request that `put` describes.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    request_body(content = Option<UploadRequest>, content_type = "application/json"),
    responses(
        (status = 201, description = "Where to send it", body = UploadView),
        (status = 400, description = "A body that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body stopped coming", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The file is too large", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "A body that is not JSON", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "As many uploads wait for a job as may", body = Problem, content_type = "application/problem+json",
            headers(("Retry-After" = u32, description = "Seconds to wait before sending it again"))),
        (status = 503, description = "The database or the file store does not answer now, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn announce_upload(
    State(state): State<ApiState>,
    MayWrite(caller): MayWrite,
    request: Request,
) -> Result<Response, Problem> {
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default();
    let is_json = media_type.split(';').next().is_some_and(|it| it.trim().eq_ignore_ascii_case("application/json"));
    let asked: UploadRequest = match read_small(&state, request).await?.as_slice() {
        [] => UploadRequest::default(),
        text if is_json => parse(text)?,
        _ => {
            let detail = "Send JSON, as application/json. The file itself goes to the address that the answer names.";
            return Err(Problem::new(ProblemCode::UnsupportedMediaType, detail));
        }
    };
    let max_bytes = caller.max_bytes(state.config.limits.max_bytes);
    if asked.bytes.is_some_and(|bytes| bytes > max_bytes) {
        return Err(too_large(max_bytes));
    }
    state.check_free_space(asked.bytes.unwrap_or(0))?;
    let id = UploadId::new();
    let signed = match state.config.presigned_uploads {
        true => state.blobs.presigned_put(&Blobs::incoming_key(id), UPLOAD_OPEN).await?,
        false => None,
    };
    let token = random_hex();
    let upload = NewUpload {
        id,
        tenant: caller.tenant.to_string(),
        name: asked.name.map(|name| clean_name(Some(&name))),
        token_sha256: signed.is_none().then(|| Token::of(&token).into()),
    };
    let Some(noted) = state.store.add_upload(upload, state.config.max_queued).await? else {
        let detail = format!(
            "{} uploads wait for a job to be made of them, which is as many as may. Send this again later.",
            state.config.max_queued
        );
        return Err(busy(ProblemCode::QueueFull, detail));
    };
    let put = PutView {
        method: "PUT",
        url: signed.unwrap_or_else(|| format!("/v1/uploads/{id}/content?token={token}")),
        headers: BTreeMap::new(),
        expires_at: noted.created_at + UPLOAD_OPEN,
    };
    let expires_at = noted.created_at + UPLOAD_LIFE;
    let view = UploadView { id: id.to_string(), put, max_bytes, expires_at };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(view)).into_response())
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct TokenQuery {
    /// As the upload's address has it.
    token: String,
}

/// Send an announced file.
///
/// The address is in the answer to `POST /v1/uploads`, and takes one file, for an hour. One that broke off may be sent again.
#[utoipa::path(
    put, path = "/v1/uploads/{id}/content", tag = "uploads",
    params(("id" = String, Path, description = "The upload's id"), TokenQuery),
    request_body(content = RawModel, content_type = "application/octet-stream"),
    responses(
        (status = 204, description = "The file is stored"),
        (status = 400, description = "An address that can't be understood, or an upload that broke off", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such upload, or its time is over", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The upload stopped coming", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The file was sent before", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The file is too large", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "A fault of the service", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database or the file store does not answer now, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn put_upload(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<TokenQuery>,
    request: Request,
) -> Result<Response, Problem> {
    state.accept_work()?;
    let PendingUpload { upload, is_open, job, .. } = find_upload(&state, &id).await?;
    if upload.token_sha256.as_deref() != Some(Token::of(&query.token).as_str()) {
        return Err(no_upload(&id));
    }
    let key = Blobs::incoming_key(upload.id);
    if job.is_some() || sent_bytes(&state, &key).await?.is_some() {
        return Err(Problem::new(ProblemCode::UploadUsed, "This upload has its file already. Announce another one."));
    }
    if !is_open {
        return Err(no_upload(&id));
    }
    let limit = state.config.limits.max_bytes;
    let declared = text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse().ok());
    if declared.is_some_and(|length: u64| length > limit) {
        return Err(too_large(limit));
    }
    state.check_free_space(declared.unwrap_or(0))?;
    let source = with_idle_limit(request.into_body().into_data_stream(), state.config.upload_idle);
    UploadBudget::new(limit).store(&state.blobs, &key, source).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// The upload of that id, if it is there and may still be used.
pub async fn find_upload(state: &ApiState, id: &str) -> Result<PendingUpload, Problem> {
    let known: UploadId = id.parse().map_err(|_| no_upload(id))?;
    state.store.upload(known).await?.ok_or_else(|| no_upload(id))
}

pub fn no_upload(id: &str) -> Problem {
    Problem::new(ProblemCode::UploadNotFound, format!("There is no upload '{}', or its time is over.", shown(id)))
}

/// How many bytes were sent to the address of an upload; none if none were.
pub async fn sent_bytes(state: &ApiState, key: &str) -> Result<Option<u64>, Problem> {
    match state.blobs.bytes(key).await {
        Ok(bytes) => Ok(Some(bytes)),
        Err(BlobError::NotFound) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
