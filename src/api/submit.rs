use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::Response;
use tracing::{Instrument, Span};

use super::caller::{Caller, MayWrite};
use super::extract::text_header;
use super::from_upload::SubmitUpload;
use super::idempotency::{self, Asked, REPLAYED};
use super::incoming::{self, FORM_BYTES, RawModel, SubmitForm, Upload};
use super::jobs::{answer, etag};
use super::problem::{Problem, ProblemCode};
use super::reuse;
use super::state::ApiState;
use super::upload::{Unclaimed, too_large};
use crate::access::Scope;
use crate::blobs::Blobs;
use crate::inspect::InspectOptions;
use crate::jobs::{Job, JobId, JobStore, Mode, NewJob};
use crate::repair::Options;
use crate::telemetry;

/// Seconds after which a client may try again where there was no room.
const BUSY_S: u32 = 30;

/// Submit a model for repair, or files for analysis.
///
/// Send a form with the part `file` (for an analysis several, if wanted) and, if wanted, `options`; or one model's bytes
/// as the whole body, with the options in the query and the file's name as `name`; or, for a file that was sent to an address of
/// `POST /v1/uploads` before, JSON that names it. The answer comes as soon as the files are stored: poll the job, or listen to its events.
/// Where an earlier job of yours repaired the same bytes with the same options and engine, its result is taken, and the job has ended
/// at once (`reused_from`).
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    params(
        ("name" = Option<String>, Query, description = "For a raw body: the file's name"),
        ("mode" = Option<Mode>, Query, description = "For a raw body: what to do, `repair` where it is left out. An option of the other mode is refused"),
        ("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "Any text of your own, such as a UUID. The same request sent again within a day is answered with the job that it made (header `Idempotency-Replayed: true`), and makes no other"),
        ("metadata" = Option<String>, Query, description = "For a raw body: your own notes on the job, a JSON object of texts"),
        ("callback_url" = Option<String>, Query, description = "For a raw body: an https address to tell of the job's end"),
        ("Cache-Control" = Option<String>, Header, description = "`no-cache` to have the work done even where an earlier job of yours has the result"),
        Options,
        InspectOptions,
    ),
    request_body(content(
        (SubmitForm = "multipart/form-data", encoding(
            ("file" = (content_type = "application/octet-stream")),
            ("options" = (content_type = "application/json")),
            ("metadata" = (content_type = "application/json")),
        )),
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
        (status = 429, description = "As many jobs wait as may, or too many requests came", body = Problem, content_type = "application/problem+json",
            headers(("Retry-After" = u32, description = "Seconds to wait before sending it again"))),
        (status = 503, description = "The database or the file store does not answer now, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn submit_job(
    State(state): State<ApiState>,
    MayWrite(caller): MayWrite,
    request: Request,
) -> Result<Response, Problem> {
    let limit = caller.max_bytes(state.config.limits.max_bytes);
    let declared =
        text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if declared.is_some_and(|length| length > limit.saturating_add(FORM_BYTES)) {
        return Err(too_large(limit));
    }
    has_room(&state, declared.unwrap_or(0))?;
    let id = JobId::new();
    let asked = idempotency::ask(&state.store, &caller.tenant, request.headers(), id).await?;
    // A request that made its job already takes no place in the queue.
    if !matches!(asked, Asked::Before { .. }) {
        has_place(&state, &caller).await?;
    }
    let unclaimed = Unclaimed::new(&state.blobs, id);
    let again = reuse::is_refused(request.headers());
    let upload = incoming::read(&state, &caller, id, request, &asked).await;
    let traceparent = telemetry::traceparent(&Span::current());
    let taken = upload.as_ref().ok().and_then(|upload| upload.taken);
    let blobs = state.blobs.clone();
    let accepting = Accepting { state: state.clone(), caller: caller.clone(), id, asked, again, traceparent };
    // From here on a client that hangs up changes nothing: the job is accepted, or its files go.
    let accepting = async move {
        let accepted = accepting.accept(upload).await;
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
    };
    let job = tokio::spawn(accepting.in_current_span()).await.map_err(|error| Problem::internal(&error))??;
    let position = state.store.queue_position(&job).await?;
    let location = format!("/v1/jobs/{}", job.id);
    let (location, tag) = ((header::LOCATION, location), (header::ETAG, etag(&job, position)));
    if job.id != id {
        if !caller.sees(&job) || !caller.may(Scope::JobsRead) {
            return Err(Problem::new(ProblemCode::JobNotFound, "The job that this request made is not yours to see."));
        }
        let headers = [location, tag, (REPLAYED, "true".to_owned())];
        return Ok(answer(&state, StatusCode::ACCEPTED, job, position, headers));
    }
    let bytes: u64 = job.inputs.iter().map(|input| input.bytes).sum();
    let (reused, mode) = (job.reused_from.is_some(), job.options.mode().as_str());
    metrics::counter!(telemetry::JOBS_SUBMITTED, "reused" => if reused { "true" } else { "false" }).increment(1);
    metrics::histogram!(telemetry::UPLOAD_BYTES).record(u32::try_from(bytes).unwrap_or(u32::MAX));
    tracing::info!(job_id = %job.id, mode, files = job.inputs.len(), bytes, reused, "accepted");
    Ok(answer(&state, StatusCode::ACCEPTED, job, position, [location, tag]))
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

/// Whether one job more may wait, of all and of the caller's.
async fn has_place(state: &ApiState, caller: &Caller) -> Result<(), Problem> {
    let waiting = state.store.waiting(caller.tenant.as_str()).await?;
    let own = u64::from(caller.limits.max_queued.unwrap_or(u32::MAX));
    let full = |most: u64, whose: &str| {
        let detail = format!("{most} {whose} wait, which is as many as may. Send the model again later.");
        Err(busy(ProblemCode::QueueFull, detail))
    };
    if waiting.all >= state.config.max_queued {
        full(state.config.max_queued, "jobs")
    } else if waiting.of_tenant >= own {
        full(own, "jobs of yours")
    } else {
        Ok(())
    }
}

/// That a job may be taken later. The upload is not read.
pub(super) fn busy(code: ProblemCode, detail: impl Into<String>) -> Problem {
    Problem::new(code, detail).retry_after(BUSY_S).with_header(header::CONNECTION, "close")
}

/// A request whose files have come, about to be a job.
struct Accepting {
    state: ApiState,
    caller: Caller,
    id: JobId,
    asked: Asked,
    /// Whether the work is to be done even where there is a result.
    again: bool,
    /// Where the request stands in a trace.
    traceparent: Option<String>,
}

impl Accepting {
    /// Makes a job of an upload that is whole and of models.
    async fn accept(self, upload: Result<Upload, Problem>) -> Result<Job, Refused> {
        let refused = |problem| Refused { problem, is_certain: true };
        let Self { state, caller, id, asked, again, traceparent } = self;
        let store = state.store.as_ref();
        let upload = match upload {
            Ok(upload) => upload,
            Err(problem) => {
                if let Asked::Held(held) = asked {
                    held.give_back().await;
                }
                return Err(refused(problem));
            }
        };
        let now = idempotency::fingerprint(&upload);
        let held = match asked {
            Asked::NoKey => None,
            Asked::Held(held) => Some(held),
            Asked::Before { fingerprint, job } if fingerprint == now => {
                return made_before(store, job).await.map_err(refused);
            }
            Asked::Before { .. } => return Err(refused(idempotency::reused())),
        };
        let tenant = caller.tenant.to_string();
        let fingerprint = reuse::fingerprint(&upload.inputs, &upload.options);
        let result = match again {
            true => None,
            false => reuse::find(store, &state.blobs, id, &tenant, &fingerprint, &upload.inputs).await,
        };
        let key = held.as_ref().and_then(|held| held.with(now));
        let made_by = caller.key.map(|key| key.id);
        let Upload { inputs, options, notes, taken } = upload;
        let (metadata, callback_url) = (notes.metadata, notes.callback_url);
        let new = NewJob {
            id,
            tenant,
            made_by,
            inputs,
            options,
            metadata,
            callback_url,
            fingerprint,
            result,
            key,
            upload: taken,
            traceparent,
        };
        let submitted = match store.submit(new).await {
            // The connection may have broken after the job was noted.
            Err(error) if error.may_pass() => match store.get(id).await {
                Ok(Some(job)) => Ok(job),
                noted => Err(Refused { problem: error.into(), is_certain: noted.is_ok() }),
            },
            submitted => submitted.map_err(|error| refused(error.into())),
        };
        if let (Ok(_), Some(held)) = (&submitted, held) {
            held.leave();
        }
        submitted
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
