use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::Poll;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::Response;
use futures::{Stream, StreamExt};
use utoipa::ToSchema;

use super::extract::text_header;
use super::jobs::{answer, etag};
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use crate::blobs::{Blobs, Stored, UploadError};
use crate::format::{ReadError, ReadErrorKind, sniff};
use crate::jobs::{Input, Job, JobId, JobOptions, NewJob};
use crate::repair::Options;

/// Largest `options` part of a form.
const OPTIONS_BYTES: usize = 64 << 10;
/// Most bytes of a form between its parts: headers, boundaries, what comes before the first part, and what of a part
/// comes in the same chunk.
const FORM_BYTES: u64 = 1 << 20;
/// Longest file name that is kept, in characters.
const NAME_CHARS: usize = 200;

/// The form that a job is submitted with.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the form in the OpenAPI document; the parts are read as they come")]
pub(super) struct SubmitForm {
    /// The model: STL, OBJ, PLY, OFF or Vertex/Face text.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// How to repair, as JSON.
    options: Option<Options>,
}

/// A model's bytes.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes the body in the OpenAPI document")]
pub(super) struct RawModel(Vec<u8>);

/// Submit a model for repair.
///
/// Send a form with the parts `file` and, if wanted, `options`; or the model's bytes as the whole body, with the options
/// in the query and the file's name as `name`. The answer comes as soon as the file is stored: poll the job, or listen
/// to its events.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    params(
        ("name" = Option<String>, Query, description = "For a raw body: the file's name"),
        Options,
    ),
    request_body(content(
        (SubmitForm = "multipart/form-data"),
        (RawModel = "application/octet-stream"),
    )),
    responses(
        (status = 202, description = "The job was accepted", body = super::job_view::JobView,
            headers(("Location" = String, description = "The job's address"), ("Retry-After" = u32, description = "Seconds to wait before asking"))),
        (status = 400, description = "No file, or a form that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The upload stopped coming", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The file is too large", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Not a model that can be read", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "An option that is unknown or out of its range", body = Problem, content_type = "application/problem+json"),
        (status = 500, description = "A fault of the service", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn submit_job(State(state): State<ApiState>, request: Request) -> Result<Response, Problem> {
    let limit = state.config.limits.max_bytes;
    let declared =
        text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if declared.is_some_and(|length| length > limit.saturating_add(FORM_BYTES)) {
        return Err(too_large(limit));
    }
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default().trim().to_owned();
    let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let id = JobId::new();
    let mut unclaimed = Unclaimed { blobs: Some(state.blobs.clone()), id };
    let upload = match essence.as_str() {
        "multipart/form-data" => from_form(&state, id, request).await,
        "application/json" => {
            let detail = "JSON is not a model. Send multipart/form-data with the parts 'file' and 'options', or the \
                          model's bytes as application/octet-stream.";
            Err(Problem::new(ProblemCode::UnsupportedMediaType, detail))
        }
        _ => from_body(&state, id, request).await,
    };
    let upload = upload?;
    let store = Arc::clone(&state.store);
    // From here on a client that hangs up changes nothing: the job is accepted, or its file goes.
    let accepting = tokio::spawn(async move {
        let (input, options) = upload.accept()?;
        let new = NewJob { id, input, input_key: Blobs::input_key(id), options: JobOptions { repair: options } };
        let job = store.submit(new).await?;
        unclaimed.keep();
        Ok::<Job, Problem>(job)
    });
    let job = accepting.await.map_err(|error| Problem::internal(&error))??;
    metrics::counter!("meshmend_jobs_submitted_total").increment(1);
    metrics::histogram!("meshmend_upload_bytes").record(u32::try_from(job.input.bytes).unwrap_or(u32::MAX));
    tracing::info!(id = %job.id, bytes = job.input.bytes, format = ?job.input.format, "accepted");
    let position = state.store.queue_position(&job).await?;
    let headers = [(header::LOCATION, format!("/v1/jobs/{id}")), (header::ETAG, etag(&job, position))];
    Ok(answer(StatusCode::ACCEPTED, job, position, headers))
}

/// The files of a job that does not exist yet; removed unless it comes to be.
struct Unclaimed {
    blobs: Option<Blobs>,
    id: JobId,
}

impl Unclaimed {
    fn keep(&mut self) {
        self.blobs = None;
    }
}

impl Drop for Unclaimed {
    fn drop(&mut self) {
        let (Some(blobs), id) = (self.blobs.take(), self.id) else { return };
        tokio::spawn(async move {
            if let Err(error) = blobs.delete_job(id).await {
                tracing::warn!(%error, "a refused upload was left");
            }
        });
    }
}

/// What came with a request, its file stored already.
struct Upload {
    name: String,
    stored: Stored,
    options: Options,
}

impl Upload {
    /// Sees whether it can become a job.
    fn accept(self) -> Result<(Input, Options), Problem> {
        if self.stored.bytes == 0 {
            return Err(Problem::new(
                ProblemCode::MissingFile,
                "The file is empty. Send a model with at least one face.",
            ));
        }
        let format = sniff(&self.stored.head, Some(self.stored.bytes)).map_err(unsupported)?;
        self.options.validate().map_err(|error| Problem::new(ProblemCode::InvalidOptions, format!("{error}.")))?;
        let Stored { bytes, sha256, .. } = self.stored;
        Ok((Input { name: self.name, bytes, sha256, format }, self.options))
    }
}

fn unsupported(error: ReadError) -> Problem {
    match error.kind {
        ReadErrorKind::Empty => Problem::new(ProblemCode::MissingFile, error.to_string()),
        _ => Problem::new(ProblemCode::UnsupportedModel, error.to_string()),
    }
}

fn too_large(limit: u64) -> Problem {
    let detail = format!("The file is larger than the {} MiB that this service takes.", limit >> 20);
    // The rest of the body is not read, so the connection can't be used again.
    Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close")
}

async fn from_body(state: &ApiState, id: JobId, request: Request) -> Result<Upload, Problem> {
    let query = request.uri().query().unwrap_or_default();
    let pairs: Vec<(String, String)> = serde_urlencoded::from_str(query)
        .map_err(|e| Problem::new(ProblemCode::InvalidRequest, format!("The query can't be read: {e}.")))?;
    let (names, options): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| key == "name");
    let options: Options = serde_urlencoded::to_string(options)
        .map_err(|e| e.to_string())
        .and_then(|query| serde_urlencoded::from_str(&query).map_err(|e| e.to_string()))
        .map_err(|e| {
            Problem::new(ProblemCode::InvalidOptions, format!("The options in the query can't be read: {e}."))
        })?;
    // Options are checked before the body is read, so that a mistake does not cost an upload.
    options.validate().map_err(|error| Problem::new(ProblemCode::InvalidOptions, format!("{error}.")))?;
    let name = names.into_iter().next().map(|(_, name)| name);
    let name = clean_name(name.as_deref().or(disposition_name(request.headers())));
    let source = with_patience(request.into_body().into_data_stream(), state.config.upload_idle);
    let stored = store(state, id, source).await?;
    Ok(Upload { name, stored, options })
}

async fn from_form(state: &ApiState, id: JobId, request: Request) -> Result<Upload, Problem> {
    // A reader of forms keeps all bytes before the next part in memory, so those are counted here.
    let allowance = Arc::new(AtomicU64::new(FORM_BYTES));
    let (parts, body) = request.into_parts();
    let left = Arc::clone(&allowance);
    let body = with_patience(body.into_data_stream(), state.config.upload_idle).map(move |chunk| {
        let chunk = chunk?;
        let bytes = chunk.len() as u64;
        left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes))
            .map_err(|_| SourceError::Form)?;
        Ok::<Bytes, SourceError>(chunk)
    });
    let request = Request::from_parts(parts, Body::from_stream(one_at_a_time(body)));
    let mut form = Multipart::from_request(request, &())
        .await
        .map_err(|e| Problem::new(ProblemCode::InvalidRequest, e.body_text()))?;
    let mut file: Option<(String, Stored)> = None;
    let mut options: Option<Options> = None;
    loop {
        allowance.store(FORM_BYTES, Ordering::Relaxed);
        let Some(field) = form.next_field().await.map_err(|e| source_problem(&e))? else { break };
        match field.name() {
            Some("file") if file.is_none() => {
                let name = clean_name(field.file_name());
                allowance.store(u64::MAX, Ordering::Relaxed);
                file = Some((name, store(state, id, field).await?));
            }
            Some("options") if options.is_none() => options = Some(read_options(field).await?),
            Some(name @ ("file" | "options")) => {
                let detail = format!("The form has two parts '{name}'. Send one model a job.");
                return Err(Problem::new(ProblemCode::InvalidRequest, detail));
            }
            name => {
                let shown: String = name.unwrap_or_default().chars().take(64).collect();
                let detail = format!("The form has a part '{shown}'. The parts are 'file' and 'options'.");
                return Err(Problem::new(ProblemCode::InvalidRequest, detail));
            }
        }
    }
    let Some((name, stored)) = file else {
        return Err(Problem::new(
            ProblemCode::MissingFile,
            "The form has no part 'file'. Send the model as that part.",
        ));
    };
    Ok(Upload { name, stored, options: options.unwrap_or_default() })
}

async fn read_options(mut field: Field<'_>) -> Result<Options, Problem> {
    let mut text = Vec::new();
    while let Some(chunk) = field.chunk().await.map_err(|e| source_problem(&e))? {
        text.extend_from_slice(&chunk);
        if text.len() > OPTIONS_BYTES {
            let detail = format!("The part 'options' is larger than {} KiB.", OPTIONS_BYTES >> 10);
            return Err(Problem::new(ProblemCode::InvalidOptions, detail));
        }
    }
    let options: Options = serde_json::from_slice(&text)
        .map_err(|e| Problem::new(ProblemCode::InvalidOptions, format!("The part 'options' can't be read: {e}.")))?;
    options.validate().map_err(|error| Problem::new(ProblemCode::InvalidOptions, format!("{error}.")))?;
    Ok(options)
}

async fn store<E: Error + 'static>(
    state: &ApiState,
    id: JobId,
    source: impl Stream<Item = Result<Bytes, E>>,
) -> Result<Stored, Problem> {
    let limit = state.config.limits.max_bytes;
    state.blobs.put_stream(&Blobs::input_key(id), source, limit).await.map_err(|error| match error {
        UploadError::TooLarge(limit) => too_large(limit),
        UploadError::Source(error) => source_problem(&error),
        UploadError::Store(error) => error.into(),
    })
}

/// What can go wrong while bytes come in.
#[derive(Debug, thiserror::Error)]
enum SourceError {
    #[error("no bytes came for too long")]
    Idle,
    #[error("the form's headers are too long")]
    Form,
    #[error(transparent)]
    Body(#[from] axum::Error),
}

/// The stream, but ended by an error when nothing comes for `longest`.
fn with_patience(
    source: impl Stream<Item = Result<Bytes, axum::Error>> + Send + 'static,
    longest: Duration,
) -> impl Stream<Item = Result<Bytes, SourceError>> + Send + 'static {
    futures::stream::unfold(Some(Box::pin(source)), move |source| async move {
        let mut source = source?;
        match tokio::time::timeout(longest, source.next()).await {
            Err(_) => Some((Err(SourceError::Idle), None)),
            Ok(None) => None,
            Ok(Some(Err(error))) => Some((Err(error.into()), None)),
            Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some(source))),
        }
    })
}

/// The stream, but never two chunks without a pause between: a reader of forms takes in all that is ready before it
/// looks at any of it, which from a fast sender would be the whole file.
fn one_at_a_time<T>(source: impl Stream<Item = T> + Send + 'static) -> impl Stream<Item = T> + Send + 'static {
    let mut source = Box::pin(source);
    let mut pause = false;
    futures::stream::poll_fn(move |context| {
        if std::mem::take(&mut pause) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let next = source.as_mut().poll_next(context);
        pause = next.is_ready();
        next
    })
}

/// The problem behind an error of the incoming bytes, however deep libraries wrapped it.
fn source_problem(error: &(dyn Error + 'static)) -> Problem {
    let mut cause = Some(error);
    let mut form = None;
    while let Some(e) = cause {
        match e.downcast_ref() {
            Some(SourceError::Idle) => {
                let detail = "No bytes came for too long, so the upload was given up.";
                return Problem::new(ProblemCode::UploadTimeout, detail).with_header(header::CONNECTION, "close");
            }
            Some(SourceError::Form) => {
                return Problem::new(ProblemCode::InvalidRequest, "The form's headers are too long.")
                    .with_header(header::CONNECTION, "close");
            }
            _ => {}
        }
        if let Some(multipart) = e.downcast_ref::<MultipartError>() {
            form = Some(multipart.body_text());
        }
        cause = e.source();
    }
    match form {
        Some(text) => Problem::new(ProblemCode::InvalidRequest, format!("The form can't be read: {text}.")),
        None => Problem::new(ProblemCode::UploadInterrupted, format!("The upload broke off: {error}.")),
    }
}

/// The file name of a raw body's Content-Disposition.
fn disposition_name(headers: &HeaderMap) -> Option<&str> {
    let value = text_header(headers, &header::CONTENT_DISPOSITION)?;
    value.split(';').find_map(|part| Some(part.trim().strip_prefix("filename=")?.trim_matches('"')))
}

/// A file name without folders and control characters; it is shown and handed back, never opened.
fn clean_name(name: Option<&str>) -> String {
    let name = name.unwrap_or_default();
    let name = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let name: String = name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
    let name = name.trim();
    if name.is_empty() || name.chars().all(|c| c == '.') { "model".to_owned() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_keeps_nothing_that_could_lead_elsewhere() {
        for (given, kept) in [
            (Some("bracket.stl"), "bracket.stl"),
            (Some("../../etc/passwd"), "passwd"),
            (Some("C:\\models\\a b.obj"), "a b.obj"),
            (Some("nul\0l\r\nX: y.stl"), "nullX: y.stl"),
            (Some(".."), "model"),
            (Some(""), "model"),
            (None, "model"),
            (Some("größe 日本.ply"), "größe 日本.ply"),
        ] {
            assert_eq!(clean_name(given), kept);
        }
        assert_eq!(clean_name(Some(&"x".repeat(1000))).len(), NAME_CHARS);
    }
}
