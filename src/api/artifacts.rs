//! Downloads of a job's files: byte ranges, conditional requests, redirects to the bucket, and images rendered on the first request.
use std::ops::Range;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::StartPosition;
use serde::Deserialize;
use utoipa::IntoParams;

use super::authenticate::RequireJobsRead;
use super::extract::{ApiPath, ApiQuery, RawModel, contains_etag, text_header};
use super::job::{JobWatcher, find_job, job_id};
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::blobs::BlobError;
use crate::jobs::{Artifact, Job, JobId, JobReport, Status, StoredFile};
use crate::repair::{ALTERNATIVE_DRAWINGS, DEFAULT_CHOICE, name_for_choice};

/// How long a request waits for images that are rendered on demand.
const RENDER_TIMEOUT: Duration = Duration::from_secs(30);
/// How long a presigned download URL is valid.
const REDIRECT_LIFE: Duration = Duration::from_secs(300);

/// Query parameters of a download.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ArtifactQuery {
    /// Id of one of the job's `alternatives`. The response is the `model`, `report-full.json`, `after.png` or `change.glb` of that result,
    /// without another repair. Default: `default`, the result that the job's report describes.
    #[param(example = "interior-keep")]
    choice: Option<String>,
}

/// The job, the name and the choice that a download asks for.
pub(super) struct ArtifactAddress {
    job: JobId,
    name: String,
    choice: Option<String>,
}

impl FromRequestParts<ApiState> for ArtifactAddress {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ApiState) -> Result<Self, Problem> {
        let ApiPath((id, name)) = ApiPath::<(String, String)>::from_request_parts(parts, state).await?;
        let ApiQuery(ArtifactQuery { choice }) = ApiQuery::from_request_parts(parts, state).await?;
        Ok(Self { job: job_id(&id)?, name, choice })
    }
}

/// Download an artifact.
///
/// `model` is the result. If no repair step improved the model, `original` is the submitted file instead. `report.json` is the report, and
/// `log.txt` is the log of all tiers.
///
/// Unless the option `pictures` is false, there are images, rendered when one of them is first requested. `before.png` and `after.png`
/// show the input and the result with the defects in colour. `defects.glb` and `defects.ply` are the input as coloured meshes with a
/// legend. `change.png`, `change.glb` and `change.ply` show which surface was kept, moved, added and removed. `remaining.glb` shows the
/// remaining defects of a result that is not printable. Models of more than 400,000 faces also have the coarse previews
/// `defects-preview.glb` and `change-preview.glb`. A printable result of a job with `process` or `min_wall` also has `thickness.png`,
/// `thickness.glb` and `thickness.ply`, which show its wall thickness in colours.
///
/// If the job has the option `alternatives`, the job's `alternatives` list further results. Each has the artifacts `model-ID`,
/// `report-ID.json` and, unless `pictures` is false, `after-ID.png` and `change-ID.glb`, which is coarse for models of more than 400,000
/// faces. With the query parameter `choice=ID`, the names `model`, `report-full.json`, `after.png` and `change.glb` return these files.
///
/// Single ranges, `If-Range` and `If-None-Match` are supported. The entity tag is the file's SHA-256 hash.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id"),
        ("name" = String, Path, description = "The name of one of the job's artifacts, such as model or before.png"),
        ArtifactQuery,
    ),
    responses(
        (status = 200, description = "The file", content(
            (RawModel = "application/octet-stream"),
            (RawModel = "model/stl"),
            (RawModel = "model/obj"),
            (RawModel = "model/gltf-binary"),
            (RawModel = "image/png"),
            (JobReport = "application/json"),
            (String = "text/plain"),
        )),
        (status = 206, description = "The requested range of the file", content(
            (RawModel = "application/octet-stream"),
            (RawModel = "model/stl"),
            (RawModel = "model/obj"),
            (RawModel = "model/gltf-binary"),
            (RawModel = "image/png"),
            (String = "application/json"),
            (String = "text/plain"),
        )),
        (status = 304, description = "The client has the current file"),
        (status = 307, description = "Temporary redirect to the file in the bucket, if the operator enabled presigned downloads",
            headers(("Location" = String, description = "The presigned URL, valid for a few minutes"))),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "The job does not exist, or has no such artifact yet", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted, or its results have expired", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "The range lies outside the file", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The images are still being rendered, or the database or the file store is unavailable", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_artifact(
    State(state): State<ApiState>,
    RequireJobsRead(caller): RequireJobsRead,
    address: ArtifactAddress,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let ArtifactAddress { job: id, name, choice } = address;
    let job = find_job(&state, &caller, id).await?;
    if job.status == Status::Expired {
        return Err(Problem::new(ProblemCode::JobExpired, format!("The files of the job '{}' have expired.", job.id)));
    }
    let name = match choice.filter(|choice| choice != DEFAULT_CHOICE) {
        Some(choice) => name_of_alternative(&job, &name, &choice)?,
        None => name,
    };
    let is_unrendered = |job: &Job| job.artifacts.get(&name).is_some_and(|artifact| artifact.file.is_none());
    let job = if is_unrendered(&job) { render(&state, job, is_unrendered).await? } else { job };
    let (artifact, file) = job
        .artifacts
        .get(&name)
        .and_then(|artifact| Some((artifact, artifact.file.as_ref()?)))
        .ok_or_else(|| artifact_not_found(&job, &name))?;
    let etag = format!("\"{}\"", file.sha256);
    let tagged = [(header::ETAG, etag.clone()), (header::CACHE_CONTROL, "private, no-cache".to_owned())];
    if text_header(&headers, &header::IF_NONE_MATCH).is_some_and(|list| contains_etag(list, &etag)) {
        return Ok((StatusCode::NOT_MODIFIED, tagged).into_response());
    }
    // Ranges are defined for GET only (RFC 9110, 14.2).
    let requested =
        if method == Method::GET { requested_range(&headers, &etag, file.bytes) } else { RequestedRange::Whole };
    let range = match requested {
        RequestedRange::Whole => None,
        RequestedRange::Part(range) => Some(range),
        RequestedRange::Outside => {
            let detail = format!("The range lies outside the file of {} bytes.", file.bytes);
            return Err(Problem::new(ProblemCode::RangeNotSatisfiable, detail)
                .with_header(header::CONTENT_RANGE, format!("bytes */{}", file.bytes)));
        }
    };
    // The bucket does not see this request's conditions or method, so only plain downloads are redirected.
    if method == Method::GET
        && let Some(redirect) = redirect(&state, artifact, file).await?
    {
        return Ok(redirect);
    }
    let body = body(&state, file, range.as_ref()).await?;
    let length = range.as_ref().map_or(file.bytes, |r| r.end - r.start);
    let mut response = (StatusCode::OK, tagged, body).into_response();
    describe(response.headers_mut(), artifact, length);
    if let Some(range) = range {
        *response.status_mut() = StatusCode::PARTIAL_CONTENT;
        let value = format!("bytes {}-{}/{}", range.start, range.end - 1, file.bytes);
        insert(response.headers_mut(), header::CONTENT_RANGE, &value);
    }
    Ok(response)
}

/// The name of the artifact that holds an alternative's file.
fn name_of_alternative(job: &Job, name: &str, choice: &str) -> Result<String, Problem> {
    let artifact = match name {
        "model" | "original" => Artifact::model_of(choice),
        "report.json" | "report-full.json" => Artifact::report_of(choice),
        name if ALTERNATIVE_DRAWINGS.contains(&name) => name_for_choice(name, choice),
        _ => {
            let detail = format!(
                "An alternative has no artifact '{}'. Its artifacts are: model, report-full.json, after.png, change.glb.",
                truncated(name)
            );
            return Err(Problem::new(ProblemCode::ArtifactNotFound, detail));
        }
    };
    if job.artifacts.contains_key(&artifact) || !job.status.is_final() {
        return Ok(artifact);
    }
    let choices: Vec<&str> = job.artifacts.keys().filter_map(|name| Artifact::choice_of_model(name)).collect();
    let choices = if choices.is_empty() { String::new() } else { format!(", {}", choices.join(", ")) };
    let detail = format!("The job has no alternative '{}'. Its choices are: default{choices}.", truncated(choice));
    Err(Problem::new(ProblemCode::ArtifactNotFound, detail))
}

/// Creates the problem for a file that the job does not have, or not yet.
fn artifact_not_found(job: &Job, name: &str) -> Problem {
    let detail = if job.status.is_final() {
        let names: Vec<&str> = job.artifacts.keys().map(String::as_str).collect();
        format!(
            "The job has no artifact '{}'. Its artifacts are: {}.",
            truncated(name),
            if names.is_empty() { "none".into() } else { names.join(", ") }
        )
    } else {
        format!("The job is {}; it has no artifacts until it has finished.", job.status.as_str())
    };
    Problem::new(ProblemCode::ArtifactNotFound, detail)
}

/// Redirects a download to the bucket, if the operator enabled presigned downloads and the file store is a bucket.
async fn redirect(state: &ApiState, artifact: &Artifact, file: &StoredFile) -> Result<Option<Response>, Problem> {
    if !state.config.presigned_downloads {
        return Ok(None);
    }
    let (disposition, media_type) = (disposition(&artifact.filename), &artifact.media_type);
    let address = state.blobs.presigned_get(&file.key, REDIRECT_LIFE, &disposition, media_type).await?;
    Ok(address.map(|address| {
        let headers = [(header::LOCATION, address), (header::CACHE_CONTROL, "no-store".to_owned())];
        (StatusCode::TEMPORARY_REDIRECT, headers).into_response()
    }))
}

/// Streams a file or a range of it.
async fn body(state: &ApiState, file: &StoredFile, range: Option<&Range<u64>>) -> Result<Body, Problem> {
    let body = match range {
        Some(range) => state.blobs.get(&file.key, Some(range.clone())).await,
        // Withholds the last bytes if the content differs from what was stored: the download of a damaged file fails.
        None => state.blobs.get_whole(&file.key, &file.sha256).await,
    };
    let body = body.map_err(|error| match error {
        BlobError::NotFound => Problem::new(ProblemCode::ArtifactNotFound, "The file has just been deleted."),
        other => other.into(),
    })?;
    Ok(Body::from_stream(body))
}

/// Requests the rendering of a job's images, and waits until `is_unrendered` no longer holds.
async fn render(state: &ApiState, job: Job, is_unrendered: impl Fn(&Job) -> bool) -> Result<Job, Problem> {
    let mut watcher = JobWatcher::new(state, job.id);
    state.store.request_drawings(job.id).await?;
    let job = watcher.wait_until(job, RENDER_TIMEOUT, |job| !is_unrendered(job)).await?;
    if is_unrendered(&job) {
        let detail = "The job's images are still being rendered. Retry in a few seconds.";
        return Err(Problem::new(ProblemCode::NotDrawnYet, detail).retry_after(3));
    }
    Ok(job)
}

/// Sets the headers that describe the file.
fn describe(headers: &mut HeaderMap, artifact: &Artifact, length: u64) {
    insert(headers, header::CONTENT_TYPE, &artifact.media_type);
    insert(headers, header::CONTENT_LENGTH, &length.to_string());
    insert(headers, header::ACCEPT_RANGES, "bytes");
    insert(headers, header::CONTENT_DISPOSITION, &disposition(&artifact.filename));
}

fn insert(headers: &mut HeaderMap, name: header::HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        headers.insert(name, value);
    }
}

/// The part of a file that a request asks for.
#[derive(Debug, PartialEq, Eq)]
enum RequestedRange {
    Whole,
    Part(Range<u64>),
    Outside,
}

/// Parses the header Range (RFC 9110, 14). The whole file is sent for an invalid Range and for several ranges, as the RFC
/// allows, and if If-Range names another version.
fn requested_range(headers: &HeaderMap, etag: &str, bytes: u64) -> RequestedRange {
    let Some(range) = text_header(headers, &header::RANGE) else { return RequestedRange::Whole };
    if text_header(headers, &header::IF_RANGE).is_some_and(|known| known.trim() != etag) {
        return RequestedRange::Whole;
    }
    let Ok(ranges) = http_range_header::parse_range_header(range) else { return RequestedRange::Whole };
    if ranges.ranges.len() != 1 {
        return RequestedRange::Whole;
    }
    match ranges.validate(bytes) {
        Ok(valid) => valid.first().map_or(RequestedRange::Whole, |r| RequestedRange::Part(*r.start()..r.end() + 1)),
        // A suffix longer than the file selects the whole file (RFC 9110, 14.1.2).
        Err(_) => match ranges.ranges[0].start {
            StartPosition::FromLast(suffix) if suffix > bytes && bytes > 0 => RequestedRange::Part(0..bytes),
            _ => RequestedRange::Outside,
        },
    }
}

/// Builds Content-Disposition with an ASCII name for old clients and the full name in UTF-8 (RFC 6266, RFC 8187).
fn disposition(name: &str) -> String {
    let plain: String = name
        .chars()
        .map(|c| if c.is_ascii() && !c.is_ascii_control() && !matches!(c, '"' | '\\' | '%') { c } else { '_' })
        .collect();
    let encoded: String = name
        .bytes()
        .map(|b| {
            if b.is_ascii_alphanumeric() || b"-._~".contains(&b) {
                char::from(b).to_string()
            } else {
                format!("%{b:02X}")
            }
        })
        .collect();
    format!("attachment; filename=\"{plain}\"; filename*=UTF-8''{encoded}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requested(range: &str, if_range: Option<&str>) -> RequestedRange {
        let mut headers = HeaderMap::new();
        insert(&mut headers, header::RANGE, range);
        if let Some(tag) = if_range {
            insert(&mut headers, header::IF_RANGE, tag);
        }
        requested_range(&headers, "\"abc\"", 100)
    }

    #[test]
    fn ranges_are_interpreted_as_rfc_9110_says() {
        assert_eq!(requested("bytes=0-9", None), RequestedRange::Part(0..10));
        assert_eq!(requested("bytes=90-", None), RequestedRange::Part(90..100));
        assert_eq!(requested("bytes=-5", None), RequestedRange::Part(95..100));
        assert_eq!(requested("bytes=-5000", None), RequestedRange::Part(0..100));
        assert_eq!(requested("bytes=50-1000", None), RequestedRange::Part(50..100));
        assert_eq!(requested("bytes=100-", None), RequestedRange::Outside);
        assert_eq!(requested("bytes=0-1,5-6", None), RequestedRange::Whole);
        assert_eq!(requested("lines=0-1", None), RequestedRange::Whole);
        assert_eq!(requested("bytes=0-9", Some("\"abc\"")), RequestedRange::Part(0..10));
        assert_eq!(requested("bytes=0-9", Some("\"old\"")), RequestedRange::Whole);
    }

    #[test]
    fn a_file_name_in_any_script_is_sent_without_breaking_the_header() {
        assert_eq!(disposition("a.stl"), "attachment; filename=\"a.stl\"; filename*=UTF-8''a.stl");
        assert_eq!(disposition("ö\"x.stl"), "attachment; filename=\"__x.stl\"; filename*=UTF-8''%C3%B6%22x.stl");
    }
}
