use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::body::{Body, Bytes};
use axum::extract::multipart::Field;
use axum::extract::{FromRequest, Multipart, Request, State};
use axum::http::{StatusCode, header};
use axum::response::Response;
use futures::StreamExt;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::extract::text_header;
use super::file_name::{clean_name, disposition_name};
use super::from_upload::{SubmitUpload, from_upload};
use super::idempotency::{self, Asked, REPLAYED};
use super::jobs::{answer, etag};
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use super::upload::{Room, SourceError, Unclaimed, one_at_a_time, source_problem, too_large, with_patience};
use crate::blobs::{Blobs, Stored};
use crate::format::{ReadErrorKind, sniff};
use crate::inspect::InspectOptions;
use crate::jobs::{Input, Job, JobId, JobOptions, JobStore, Mode, NewJob, UploadId};
use crate::repair::Options;

/// Largest `options` part of a form.
const OPTIONS_BYTES: usize = 64 << 10;
/// Most bytes of a form between its parts: headers, boundaries, what comes before the first part, and what of a part
/// comes in the same chunk.
const FORM_BYTES: u64 = 1 << 20;
/// Seconds after which a client may try again where there was no room.
const BUSY_S: u32 = 30;

/// The form that a job is submitted with.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the form in the OpenAPI document; the parts are read as they come")]
pub(super) struct SubmitForm {
    /// The model: STL, OBJ, PLY, OFF or Vertex/Face text. A repair takes one; an analysis as many parts `file` as `limits.max_files` of
    /// the capabilities says.
    #[schema(min_items = 1)]
    file: Vec<RawModel>,
    /// What to do, as JSON. Where `mode` is left out it is `repair`.
    options: Option<JobOptions>,
}

/// A model's bytes.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes the body in the OpenAPI document")]
pub(super) struct RawModel(Vec<u8>);

/// Submit a model for repair, or files for analysis.
///
/// Send a form with the part `file` (for an analysis several, if wanted) and, if wanted, `options`; or one model's bytes
/// as the whole body, with the options in the query and the file's name as `name`; or, for a file that was sent to an address of
/// `POST /v1/uploads` before, JSON that names it. The answer comes as soon as the files are stored: poll the job, or listen to its events.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    params(
        ("name" = Option<String>, Query, description = "For a raw body: the file's name"),
        ("mode" = Option<Mode>, Query, description = "For a raw body: what to do, `repair` where it is left out. An option of the other mode is refused"),
        ("Idempotency-Key" = Option<String>, Header, description = "Any text of your own, such as a UUID. The same request sent again within a day is answered with the job that it made (header `Idempotency-Replayed: true`), and makes no other"),
        Options,
        InspectOptions,
    ),
    request_body(content(
        (SubmitForm = "multipart/form-data"),
        (RawModel = "application/octet-stream"),
        (SubmitUpload = "application/json"),
    )),
    responses(
        (status = 202, description = "The job was accepted", body = super::job_view::JobView,
            headers(("Location" = String, description = "The job's address"), ("Retry-After" = u32, description = "Seconds to wait before asking"))),
        (status = 400, description = "No file, a second file for a repair, or a form or JSON that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The upload stopped coming", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such upload, or its time is over", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "A request with the same Idempotency-Key is under way; or the upload was not sent yet, or is another job's", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job that the same request made before was deleted", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The upload is too large, or has too many files", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Not a model that can be read; of several files, `errors` names each", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "An option that is unknown, out of its range, or of another mode; or an Idempotency-Key of another request", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "As many jobs wait as may", body = Problem, content_type = "application/problem+json",
            headers(("Retry-After" = u32, description = "Seconds to wait before sending it again"))),
        (status = 500, description = "A fault of the service", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The database or the file store does not answer now, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn submit_job(State(state): State<ApiState>, request: Request) -> Result<Response, Problem> {
    let limit = state.config.limits.max_bytes;
    let declared =
        text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if declared.is_some_and(|length| length > limit.saturating_add(FORM_BYTES)) {
        return Err(too_large(limit));
    }
    has_room(&state, declared.unwrap_or(0))?;
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default().trim().to_owned();
    let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let id = JobId::new();
    let asked = idempotency::ask(&state.store, request.headers(), id).await?;
    // A request that made its job already takes no place in the queue.
    if !matches!(asked, Asked::Before { .. }) && state.store.queued().await? >= state.config.max_queued {
        let detail =
            format!("{} jobs wait, which is as many as may. Send the model again later.", state.config.max_queued);
        return Err(busy(ProblemCode::QueueFull, detail));
    }
    let unclaimed = Unclaimed::new(&state.blobs, id);
    let upload = match essence.as_str() {
        "multipart/form-data" => from_form(&state, id, request).await,
        "application/json" => from_upload(&state, id, request, &asked).await,
        _ => from_body(&state, id, request).await,
    };
    let (store, blobs) = (Arc::clone(&state.store), state.blobs.clone());
    let taken = upload.as_ref().ok().and_then(|upload| upload.taken);
    // From here on a client that hangs up changes nothing: the job is accepted, or its files go.
    let accepting = tokio::spawn(async move {
        let accepted = accept(store.as_ref(), id, upload, asked).await;
        let has_files = match &accepted {
            Ok(job) => job.id == id,
            // Where it is not known whether the job was noted, its files stay until the sweep, which knows.
            Err(refused) => !refused.is_certain,
        };
        unclaimed.settle(has_files).await;
        if let (Ok(_), Some(taken)) = (&accepted, taken)
            && let Err(error) = blobs.delete(&Blobs::incoming_key(taken)).await
        {
            tracing::warn!(%error, "an upload that became a job's was left");
        }
        accepted.map_err(|refused| refused.problem)
    });
    let job = accepting.await.map_err(|error| Problem::internal(&error))??;
    if job.id != id {
        let position = state.store.queue_position(&job).await?;
        let location = format!("/v1/jobs/{}", job.id);
        let headers =
            [(header::LOCATION, location), (header::ETAG, etag(&job, position)), (REPLAYED, "true".to_owned())];
        return Ok(answer(StatusCode::ACCEPTED, job, position, headers));
    }
    let bytes: u64 = job.inputs.iter().map(|input| input.bytes).sum();
    metrics::counter!("meshmend_jobs_submitted_total").increment(1);
    metrics::histogram!("meshmend_upload_bytes").record(u32::try_from(bytes).unwrap_or(u32::MAX));
    tracing::info!(id = %job.id, mode = job.options.mode().as_str(), files = job.inputs.len(), bytes, "accepted");
    let position = state.store.queue_position(&job).await?;
    let headers = [(header::LOCATION, format!("/v1/jobs/{id}")), (header::ETAG, etag(&job, position))];
    Ok(answer(StatusCode::ACCEPTED, job, position, headers))
}

/// Whether the disk has room for so many bytes more.
pub(super) fn has_room(state: &ApiState, bytes: u64) -> Result<(), Problem> {
    let free = state.blobs.free_bytes().map_err(|error| Problem::internal(&error))?;
    if free.is_some_and(|free| free < state.config.min_free.saturating_add(bytes)) {
        let detail = "The service has no room for more files now. Send the model again later.";
        return Err(busy(ProblemCode::StorageFull, detail));
    }
    Ok(())
}

/// That a job may be taken later. The upload is not read.
pub(super) fn busy(code: ProblemCode, detail: impl Into<String>) -> Problem {
    Problem::new(code, detail).retry_after(BUSY_S).with_header(header::CONNECTION, "close")
}

/// Makes a job of an upload that is whole and of models.
async fn accept(
    store: &dyn JobStore,
    id: JobId,
    upload: Result<Upload, Problem>,
    asked: Asked,
) -> Result<Job, Refused> {
    let refused = |problem| Refused { problem, is_certain: true };
    let Upload { inputs, options, taken } = upload.map_err(refused)?;
    let now = idempotency::fingerprint(&inputs, &options);
    let key = match asked {
        Asked::NoKey => None,
        Asked::Held(held) => held.settle(now),
        Asked::Before { fingerprint, job } if fingerprint == now => {
            return made_before(store, job).await.map_err(refused);
        }
        Asked::Before { .. } => return Err(refused(idempotency::reused())),
    };
    match store.submit(NewJob { id, inputs, options, key, upload: taken }).await {
        // The connection may have broken after the job was noted.
        Err(error) if error.may_pass() => match store.get(id).await {
            Ok(Some(job)) => Ok(job),
            noted => Err(Refused { problem: error.into(), is_certain: noted.is_ok() }),
        },
        submitted => submitted.map_err(|error| refused(error.into())),
    }
}

/// The job that the same request made before.
async fn made_before(store: &dyn JobStore, id: JobId) -> Result<Job, Problem> {
    match store.get(id).await? {
        Some(job) if !job.purged => Ok(job),
        _ => Err(deleted(id)),
    }
}

/// That a request made a job before, which is gone.
pub(super) fn deleted(id: JobId) -> Problem {
    Problem::new(ProblemCode::JobDeleted, format!("The job {id}, which this request made, was deleted."))
}

/// Why a job was not accepted.
struct Refused {
    problem: Problem,
    /// Whether it is known that the store has nothing of it.
    is_certain: bool,
}

/// What came with a request, its files stored already.
pub(super) struct Upload {
    pub inputs: Vec<Input>,
    pub options: JobOptions,
    /// The upload that was copied, where the file was sent before the request.
    pub taken: Option<UploadId>,
}

/// A file of an upload.
pub(super) struct File {
    pub name: String,
    pub stored: Stored,
}

/// Sees whether every file is a model by its first bytes. Of several, each that is none is named.
pub(super) fn inputs(id: JobId, files: Vec<File>) -> Result<Vec<Input>, Problem> {
    let of = files.len();
    let mut inputs = Vec::with_capacity(of);
    let mut problems: Vec<Problem> = Vec::new();
    for (number, File { name, stored }) in files.into_iter().enumerate() {
        match sniff(&stored.head, Some(stored.bytes)) {
            Ok(format) => {
                let Stored { bytes, sha256, .. } = stored;
                inputs.push(Input { key: Blobs::input_key(id, number), name, bytes, sha256, format });
            }
            Err(error) => {
                let (code, detail) = match error.kind {
                    _ if stored.bytes == 0 => {
                        (ProblemCode::MissingFile, "The file is empty. Send a model with at least one face.".to_owned())
                    }
                    ReadErrorKind::Empty => (ProblemCode::MissingFile, error.to_string()),
                    _ => (ProblemCode::UnsupportedModel, error.to_string()),
                };
                let which = if of > 1 { format!("file {} of {of}, '{name}': ", number + 1) } else { String::new() };
                problems.push(Problem::new(code, format!("{which}{detail}")));
            }
        }
    }
    let errors = if of > 1 { problems.iter().map(|problem| problem.detail.clone()).collect() } else { Vec::new() };
    match problems.into_iter().next() {
        Some(first) => Err(Problem { errors, ..first }),
        None => Ok(inputs),
    }
}

async fn from_body(state: &ApiState, id: JobId, request: Request) -> Result<Upload, Problem> {
    let query = request.uri().query().unwrap_or_default();
    let pairs: Vec<(String, String)> = serde_urlencoded::from_str(query)
        .map_err(|e| Problem::new(ProblemCode::InvalidRequest, format!("The query can't be read: {e}.")))?;
    let (names, options): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| key == "name");
    // Options are checked before the body is read, so that a mistake does not cost an upload.
    let options = job_options(query_fields(options)?)?;
    let name = names.into_iter().next().map(|(_, name)| name);
    let name = clean_name(name.as_deref().or(disposition_name(request.headers())));
    let source = with_patience(request.into_body().into_data_stream(), state.config.upload_idle);
    let mut room = Room::new(state.config.limits.max_bytes);
    let stored = room.store(&state.blobs, &Blobs::input_key(id, 0), source).await?;
    Ok(Upload { inputs: inputs(id, vec![File { name, stored }])?, options, taken: None })
}

/// The fields of a query: numbers and other JSON as what they are, anything else as text.
fn query_fields(pairs: Vec<(String, String)>) -> Result<Map<String, Value>, Problem> {
    let mut fields = Map::new();
    for (key, text) in pairs {
        let value = serde_json::from_str(&text).unwrap_or(Value::String(text));
        if fields.insert(key.clone(), value).is_some() {
            return Err(Problem::new(ProblemCode::InvalidOptions, format!("The option '{key}' is given twice.")));
        }
    }
    Ok(fields)
}

pub(super) fn job_options(fields: Map<String, Value>) -> Result<JobOptions, Problem> {
    JobOptions::from_fields(fields).map_err(|error| Problem::new(ProblemCode::InvalidOptions, format!("{error}.")))
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
    let mut room = Room::new(state.config.limits.max_bytes);
    let mut files: Vec<File> = Vec::new();
    let mut options: Option<JobOptions> = None;
    loop {
        allowance.store(FORM_BYTES, Ordering::Relaxed);
        let Some(field) = form.next_field().await.map_err(|e| source_problem(&e))? else { break };
        match field.name() {
            Some("file") => {
                // Where the options came first, a file too many is refused before its bytes are read.
                may_have(files.len() + 1, options.as_ref(), state.config.max_files)?;
                let name = clean_name(field.file_name());
                allowance.store(u64::MAX, Ordering::Relaxed);
                let stored = room.store(&state.blobs, &Blobs::input_key(id, files.len()), field).await?;
                files.push(File { name, stored });
            }
            Some("options") if options.is_none() => options = Some(read_options(field).await?),
            Some("options") => {
                let detail = "The form has two parts 'options'. Send one for all files.";
                return Err(Problem::new(ProblemCode::InvalidRequest, detail));
            }
            name => {
                let shown: String = name.unwrap_or_default().chars().take(64).collect();
                let detail = format!("The form has a part '{shown}'. The parts are 'file' and 'options'.");
                return Err(Problem::new(ProblemCode::InvalidRequest, detail));
            }
        }
    }
    if files.is_empty() {
        let detail = "The form has no part 'file'. Send the model as that part.";
        return Err(Problem::new(ProblemCode::MissingFile, detail));
    }
    let options = options.unwrap_or_default();
    may_have(files.len(), Some(&options), state.config.max_files)?;
    Ok(Upload { inputs: inputs(id, files)?, options, taken: None })
}

/// Whether a job may have so many files; as long as its options have not come, as many as any job.
fn may_have(files: usize, options: Option<&JobOptions>, most: usize) -> Result<(), Problem> {
    if files > 1 && options.is_some_and(|options| options.mode() == Mode::Repair) {
        let detail = "The form has two parts 'file', and a repair takes one model. Send one model a job, or ask for \
                      the mode 'analyze'.";
        return Err(Problem::new(ProblemCode::InvalidRequest, detail));
    }
    if files > most {
        let detail =
            format!("The form has more than the {most} files that one job may have. Send the rest as another.");
        return Err(Problem::new(ProblemCode::TooManyFiles, detail).with_header(header::CONNECTION, "close"));
    }
    Ok(())
}

async fn read_options(mut field: Field<'_>) -> Result<JobOptions, Problem> {
    let mut text = Vec::new();
    while let Some(chunk) = field.chunk().await.map_err(|e| source_problem(&e))? {
        text.extend_from_slice(&chunk);
        if text.len() > OPTIONS_BYTES {
            let detail = format!("The part 'options' is larger than {} KiB.", OPTIONS_BYTES >> 10);
            return Err(Problem::new(ProblemCode::InvalidOptions, detail));
        }
    }
    let fields = serde_json::from_slice(&text)
        .map_err(|e| Problem::new(ProblemCode::InvalidOptions, format!("The part 'options' can't be read: {e}.")))?;
    job_options(fields)
}
