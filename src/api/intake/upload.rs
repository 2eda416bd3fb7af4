//! Uploads that precede their job: `POST /v1/uploads` creates one, a PUT to its URL sends the file, and `POST /v1/jobs` uses it.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::submission::clean_name;
use crate::access::{SecretHash, random_bytes};
use crate::api::authenticate::RequireJobsWrite;
use crate::api::extract::{
    ApiPath, ApiQuery, RawModel, UploadBudget, parse, read_small, text_header, too_large, whole, with_idle_limit,
};
use crate::api::problem::{Problem, ProblemCode, truncated};
use crate::api::state::{ApiState, busy};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{NewUpload, PendingUpload, UPLOAD_LIFE, UPLOAD_OPEN, UploadId};

/// A file that is going to be uploaded.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct UploadRequest {
    /// The file's name.
    #[schema(example = "bracket.stl")]
    name: Option<String>,
    /// The file's size in bytes. A size above the limit is rejected before any bytes are sent.
    #[serde(deserialize_with = "whole")]
    bytes: Option<u64>,
}

/// An upload: where to send its file, and until when.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Upload)]
pub struct UploadView {
    /// The upload's id, for the `source` of a job.
    #[schema(example = "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The request that sends the file.
    put: PutView,
    /// The largest file that this upload accepts, in bytes.
    max_bytes: u64,
    /// When the upload expires. A job must use it before then.
    #[serde(with = "crate::jobs::timestamp")]
    expires_at: OffsetDateTime,
}

/// An HTTP request to send.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = UploadPut)]
pub struct PutView {
    /// The HTTP method.
    #[schema(example = "PUT")]
    method: &'static str,
    /// The URL. A URL without a host is relative to this service. Keep it secret: anyone who has it can send the file.
    url: String,
    /// The headers that the request must have.
    headers: BTreeMap<String, String>,
    /// When the URL expires. The request must begin before then.
    #[serde(with = "crate::jobs::timestamp")]
    expires_at: OffsetDateTime,
}

/// Create an upload.
///
/// For large files and for browsers. The file goes directly to the file store if the operator allows it. Send the file as the whole body
/// of the request that `put` describes. Then create a job from the upload with `POST /v1/jobs` and a JSON body.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    request_body(content = Option<UploadRequest>, content_type = "application/json"),
    responses(
        (status = 201, description = "The created upload", body = UploadView),
        (status = 400, description = "The body is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body timed out", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The file is too large", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "The body is not JSON", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "Too many uploads are waiting for a job", body = Problem, content_type = "application/problem+json",
            headers(("Retry-After" = u32, description = "Seconds to wait before retrying"))),
        (status = 503, description = "The database or the file store is unavailable, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn announce_upload(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    request: Request,
) -> Result<Response, Problem> {
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default();
    let is_json =
        media_type.split(';').next().is_some_and(|essence| essence.trim().eq_ignore_ascii_case("application/json"));
    let requested: UploadRequest = match read_small(&state, request).await?.as_slice() {
        [] => UploadRequest::default(),
        text if is_json => parse(text)?,
        _ => {
            let detail = "`Content-Type` must be application/json. Send the file itself to the URL in the response.";
            return Err(Problem::new(ProblemCode::UnsupportedMediaType, detail));
        }
    };
    let max_bytes = caller.max_bytes(state.config.limits.max_bytes);
    if requested.bytes.is_some_and(|bytes| bytes > max_bytes) {
        return Err(too_large(max_bytes));
    }
    state.check_free_space(requested.bytes.unwrap_or(0))?;
    let id = UploadId::new(state.ids.as_ref());
    let signed = match state.config.presigned_uploads {
        true => state.blobs.presigned_put(&Blobs::incoming_key(id), UPLOAD_OPEN).await?,
        false => None,
    };
    let token = hex::encode(random_bytes(state.ids.as_ref()));
    let upload = NewUpload {
        id,
        tenant: caller.tenant.to_string(),
        name: requested.name.map(|name| clean_name(Some(&name))),
        token_sha256: signed.is_none().then(|| SecretHash::of(&token).into()),
    };
    let Some(recorded) = state.store.add_upload(upload, state.config.max_queued).await? else {
        let detail = format!(
            "The service already has {} uploads without a job, the maximum. Retry later.",
            state.config.max_queued
        );
        return Err(busy(ProblemCode::QueueFull, detail));
    };
    let put = PutView {
        method: "PUT",
        url: signed.unwrap_or_else(|| format!("/v1/uploads/{id}/content?token={token}")),
        headers: BTreeMap::new(),
        expires_at: recorded.created_at + UPLOAD_OPEN,
    };
    let expires_at = recorded.created_at + UPLOAD_LIFE;
    let view = UploadView { id: id.to_string(), put, max_bytes, expires_at };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(view)).into_response())
}

/// Query parameters of an upload's URL.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct TokenQuery {
    /// The token in the upload's URL.
    token: String,
}

/// Send the file of an upload.
///
/// The response to `POST /v1/uploads` contains this URL. The URL accepts one file, for one hour. After an interrupted upload, send the file
/// again.
#[utoipa::path(
    put, path = "/v1/uploads/{id}/content", tag = "uploads",
    params(("id" = String, Path, description = "The upload's id"), TokenQuery),
    request_body(content = RawModel, content_type = "application/octet-stream"),
    responses(
        (status = 204, description = "The file is stored"),
        (status = 400, description = "The request is malformed, or the upload was interrupted", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Upload not found or expired", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The upload timed out", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The file has already been sent", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The file is too large", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "Internal error", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database or the file store is unavailable, or the disk is full", body = Problem, content_type = "application/problem+json"),
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
    if upload.token_sha256.as_deref() != Some(SecretHash::of(&query.token).as_str()) {
        return Err(upload_not_found(&id));
    }
    let key = Blobs::incoming_key(upload.id);
    if job.is_some() || sent_bytes(&state, &key).await?.is_some() {
        return Err(Problem::new(ProblemCode::UploadUsed, "This upload already has a file. Create a new upload."));
    }
    if !is_open {
        return Err(upload_not_found(&id));
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

/// Returns the upload with this id.
///
/// # Errors
/// `upload_not_found` if no upload has this id, or if it has expired.
pub async fn find_upload(state: &ApiState, id: &str) -> Result<PendingUpload, Problem> {
    let upload_id: UploadId = id.parse().map_err(|_| upload_not_found(id))?;
    state.store.upload(upload_id).await?.ok_or_else(|| upload_not_found(id))
}

/// Creates the problem for an upload that does not exist or has expired.
pub fn upload_not_found(id: &str) -> Problem {
    Problem::new(ProblemCode::UploadNotFound, format!("There is no upload '{}', or it has expired.", truncated(id)))
}

/// Returns the size of the file sent to an upload, in bytes, or `None` if none was sent.
pub async fn sent_bytes(state: &ApiState, key: &str) -> Result<Option<u64>, Problem> {
    match state.blobs.bytes(key).await {
        Ok(bytes) => Ok(Some(bytes)),
        Err(BlobError::NotFound) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
