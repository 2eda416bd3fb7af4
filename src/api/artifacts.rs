use std::ops::Range;
use std::time::Duration;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::StartPosition;

use super::authenticate::MayRead;
use super::extract::{ApiPath, RawModel, names_etag, text_header};
use super::job::{Watch, find_job, job_id};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::blobs::BlobError;
use crate::jobs::{Artifact, Job, JobReport, Status, StoredFile};

/// How long a request waits for pictures that are drawn for it.
const DRAWING_WAIT: Duration = Duration::from_secs(30);
/// How long the address is good to which a download is sent on.
const REDIRECT_LIFE: Duration = Duration::from_secs(300);

/// Download a file of a job.
///
/// `model` is the result, or where nothing made the model better `original` is the upload. `report.json` is the account, `log.txt` what
/// the tiers said. Unless `pictures` is false there are pictures, which are drawn when one of them is asked for first: `before.png` and
/// `after.png` show the input and the result with what is wrong in colour, and `defects.glb` and `defects.ply` are the input as coloured
/// meshes with a legend. `change.png`, `change.glb` and `change.ply` show the surface that was kept, moved, added and removed. What is
/// still wrong with a result that is not printable is in `remaining.glb`; models of more than 400,000 faces have coarse previews,
/// `defects-preview.glb` and `change-preview.glb`. Single ranges, If-Range and If-None-Match are honoured; the entity tag is the file's
/// SHA-256.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id"),
        ("name" = String, Path, description = "One of the job's artifacts, such as model or before.png"),
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
        (status = 206, description = "The range of the file", content(
            (RawModel = "application/octet-stream"),
            (RawModel = "model/stl"),
            (RawModel = "model/obj"),
            (RawModel = "model/gltf-binary"),
            (RawModel = "image/png"),
            (String = "application/json"),
            (String = "text/plain"),
        )),
        (status = 304, description = "The client has it already"),
        (status = 307, description = "The file is at another address for the next minutes, where the operator wants that",
            headers(("Location" = String, description = "That address"))),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job, or no such file of it yet", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job was deleted, or its results have expired", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "The range lies outside the file", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The pictures are still being drawn, or the database or the file store does not answer now", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_artifact(
    State(state): State<ApiState>,
    MayRead(caller): MayRead,
    ApiPath((id, name)): ApiPath<(String, String)>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = find_job(&state, &caller, job_id(&id)?).await?;
    if job.status == Status::Expired {
        return Err(Problem::new(
            ProblemCode::JobExpired,
            format!("The files of the job '{}' were kept as long as they are.", job.id),
        ));
    }
    let is_waiting = |job: &Job| job.artifacts.get(&name).is_some_and(|artifact| artifact.file.is_none());
    let job = if is_waiting(&job) { drawn(&state, job, is_waiting).await? } else { job };
    let (artifact, file) = job
        .artifacts
        .get(&name)
        .and_then(|artifact| Some((artifact, artifact.file.as_ref()?)))
        .ok_or_else(|| no_artifact(&job, &name))?;
    let etag = format!("\"{}\"", file.sha256);
    let tagged = [(header::ETAG, etag.clone()), (header::CACHE_CONTROL, "private, no-cache".to_owned())];
    if text_header(&headers, &header::IF_NONE_MATCH).is_some_and(|known| names_etag(known, &etag)) {
        return Ok((StatusCode::NOT_MODIFIED, tagged).into_response());
    }
    // Ranges are defined for GET only (RFC 9110, 14.2).
    let asked = if method == Method::GET { asked_range(&headers, &etag, file.bytes) } else { Asked::Whole };
    let range = match asked {
        Asked::Whole => None,
        Asked::Part(range) => Some(range),
        Asked::Outside => {
            let detail = format!("The range lies outside the file of {} bytes.", file.bytes);
            return Err(Problem::new(ProblemCode::RangeNotSatisfiable, detail)
                .with_header(header::CONTENT_RANGE, format!("bytes */{}", file.bytes)));
        }
    };
    // A bucket knows only what it is asked with, so that all but plain downloads are answered here.
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

/// The problem that a job has no file of that name, or not yet.
fn no_artifact(job: &Job, name: &str) -> Problem {
    let detail = if job.status.is_final() {
        let known: Vec<&str> = job.artifacts.keys().map(String::as_str).collect();
        format!(
            "The job has no file '{}'. It has: {}.",
            shown(name),
            if known.is_empty() { "none".into() } else { known.join(", ") }
        )
    } else {
        format!("The job is {}; its files come when it has ended.", job.status.as_str())
    };
    Problem::new(ProblemCode::ArtifactNotFound, detail)
}

/// Sends a download on to the bucket, where the operator wants that and there is one.
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

/// The bytes of a file, or of a range of it.
async fn body(state: &ApiState, file: &StoredFile, range: Option<&Range<u64>>) -> Result<Body, Problem> {
    let body = match range {
        Some(range) => state.blobs.get(&file.key, Some(range.clone())).await,
        // The last bytes come only if all are what was stored, so that a damaged file is a download that breaks off.
        None => state.blobs.get_whole(&file.key, &file.sha256).await,
    };
    let body = body.map_err(|error| match error {
        BlobError::NotFound => Problem::new(ProblemCode::ArtifactNotFound, "The file was deleted meanwhile."),
        other => other.into(),
    })?;
    Ok(Body::from_stream(body))
}

/// Has a job's pictures drawn, and answers the job when none `is_waiting` any more.
async fn drawn(state: &ApiState, job: Job, is_waiting: impl Fn(&Job) -> bool) -> Result<Job, Problem> {
    let mut watch = Watch::new(state, job.id);
    state.store.request_drawings(job.id).await?;
    let job = watch.until(job, DRAWING_WAIT, |job| !is_waiting(job)).await?;
    if is_waiting(&job) {
        let detail = "The pictures of this job are still being drawn. Ask again in a few seconds.";
        return Err(Problem::new(ProblemCode::NotDrawnYet, detail).retry_after(3));
    }
    Ok(job)
}

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

/// What part of a file a request asks for.
#[derive(Debug, PartialEq, Eq)]
enum Asked {
    Whole,
    Part(Range<u64>),
    Outside,
}

/// The range asked for (RFC 9110, 14). A Range that can't be understood, or names several ranges, asks for the whole
/// file, as the RFC allows; so does one under an If-Range that names another version.
fn asked_range(headers: &HeaderMap, etag: &str, bytes: u64) -> Asked {
    let Some(range) = text_header(headers, &header::RANGE) else { return Asked::Whole };
    if text_header(headers, &header::IF_RANGE).is_some_and(|known| known.trim() != etag) {
        return Asked::Whole;
    }
    let Ok(ranges) = http_range_header::parse_range_header(range) else { return Asked::Whole };
    if ranges.ranges.len() != 1 {
        return Asked::Whole;
    }
    match ranges.validate(bytes) {
        Ok(valid) => valid.first().map_or(Asked::Whole, |r| Asked::Part(*r.start()..r.end() + 1)),
        // A suffix longer than the file is the whole of it (RFC 9110, 14.1.2).
        Err(_) => match ranges.ranges[0].start {
            StartPosition::FromLast(suffix) if suffix > bytes && bytes > 0 => Asked::Part(0..bytes),
            _ => Asked::Outside,
        },
    }
}

/// Content-Disposition with a plain name for old clients and the true one in UTF-8 (RFC 6266, RFC 8187).
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

    fn asked(range: &str, if_range: Option<&str>) -> Asked {
        let mut headers = HeaderMap::new();
        insert(&mut headers, header::RANGE, range);
        if let Some(tag) = if_range {
            insert(&mut headers, header::IF_RANGE, tag);
        }
        asked_range(&headers, "\"abc\"", 100)
    }

    #[test]
    fn ranges_are_understood_as_the_rfc_says() {
        assert_eq!(asked("bytes=0-9", None), Asked::Part(0..10));
        assert_eq!(asked("bytes=90-", None), Asked::Part(90..100));
        assert_eq!(asked("bytes=-5", None), Asked::Part(95..100));
        assert_eq!(asked("bytes=-5000", None), Asked::Part(0..100));
        assert_eq!(asked("bytes=50-1000", None), Asked::Part(50..100));
        assert_eq!(asked("bytes=100-", None), Asked::Outside);
        assert_eq!(asked("bytes=0-1,5-6", None), Asked::Whole);
        assert_eq!(asked("lines=0-1", None), Asked::Whole);
        assert_eq!(asked("bytes=0-9", Some("\"abc\"")), Asked::Part(0..10));
        assert_eq!(asked("bytes=0-9", Some("\"old\"")), Asked::Whole);
    }

    #[test]
    fn a_file_name_in_any_script_is_offered_and_can_break_no_header() {
        assert_eq!(disposition("a.stl"), "attachment; filename=\"a.stl\"; filename*=UTF-8''a.stl");
        assert_eq!(disposition("ö\"x.stl"), "attachment; filename=\"__x.stl\"; filename*=UTF-8''%C3%B6%22x.stl");
    }
}
