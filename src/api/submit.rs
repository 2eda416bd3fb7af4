//! `POST /v1/jobs`: reads a submission, checks the queue limit, reuses the result of an identical earlier job, and records the job.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::Response;
use sha2::{Digest, Sha256};
use tracing::{Instrument, Span};

use super::authenticate::{Caller, RequireJobsWrite};
use super::extract::{RawModel, text_header, too_large};
use super::idempotency::{self, IdempotencyState, REPLAYED};
use super::intake::{self, FORM_BYTES, Submission, SubmissionContext, SubmitForm, SubmitUpload};
use super::job::{answer, etag};
use super::problem::{Problem, ProblemCode};
use super::state::{ApiState, busy};
use crate::access::Scope;
use crate::blobs::{BlobError, Blobs};
use crate::inspect::InspectOptions;
use crate::jobs::{Artifacts, Input, Job, JobId, JobOptions, JobOutcome, JobStore, Mode, NewJob, Reused};
use crate::repair::{Options, PrintOptions};
use crate::telemetry;

/// Submit a job.
///
/// Repairs one model, or analyses one or several. Send one of three bodies: a form with `file` and optionally `options`; one model's
/// bytes, with the options in the query and the file's name as `name`; or JSON that names an upload or an earlier job.
/// The response comes as soon as the files are stored. Then poll the job or listen to its events.
/// If an earlier job of yours processed the same bytes with the same options and engine, its result is reused and the new job has
/// already ended (`reused_from`).
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    params(
        ("name" = Option<String>, Query, description = "For a raw body: the file's name"),
        ("mode" = Option<Mode>, Query, description = "For a raw body: the job's mode, by default `repair`. An option of the other mode is rejected"),
        ("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "A unique text of your choice, such as a UUID. A retry with the same key within a day creates no second job: it returns the first request's job, with the header `Idempotency-Replayed: true`"),
        ("metadata" = Option<String>, Query, description = "For a raw body: your own metadata for the job, a JSON object of text values"),
        ("callback_url" = Option<String>, Query, description = "For a raw body: an https URL to notify when the job ends"),
        ("Cache-Control" = Option<String>, Header, description = "`no-cache` runs the job even if an earlier job of yours has the result"),
        Options,
        PrintOptions,
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
        (status = 202, description = "The job was accepted", body = super::job::JobView,
            headers(("Location" = String, description = "The job's path"), ("Retry-After" = u32, description = "Seconds to wait before polling the job"))),
        (status = 400, description = "No file, a second file for a repair, or a malformed form or JSON body", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The upload timed out", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Upload or earlier job not found or expired", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Another request with this Idempotency-Key is in progress, or the upload has no file yet, or another job already used the upload", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "The job that the first request with this Idempotency-Key created was deleted, or the earlier job's files have expired", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "The upload is too large or has too many files", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Unsupported model format; with several files, `errors` names each one", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "An option is unknown, out of range or of the other mode, or the Idempotency-Key was used with another request", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "The queue is full, or the caller sent too many requests", body = Problem, content_type = "application/problem+json",
            headers(("Retry-After" = u32, description = "Seconds to wait before retrying"))),
        (status = 503, description = "The database or the file store is unavailable, or the disk is full", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn submit_job(
    State(state): State<ApiState>,
    RequireJobsWrite(caller): RequireJobsWrite,
    request: Request,
) -> Result<Response, Problem> {
    let bytes = declared_bytes(&state, &caller, &request)?;
    state.check_free_space(bytes)?;
    let id = JobId::new(state.ids.as_ref());
    let key = idempotency::hold(&state.store, &caller.tenant, request.headers(), id).await?;
    // A retry whose job already exists needs no place in the queue.
    if !matches!(key, IdempotencyState::Used { .. }) {
        check_queue_limit(&state, &caller).await?;
    }
    let files = UnclaimedFiles::new(&state.blobs, id);
    let may_reuse = !forbids_reuse(request.headers());
    let context = SubmissionContext { state: &state, caller: &caller, id };
    let submission = intake::read(context, request, &key).await;
    let traceparent = telemetry::traceparent(&Span::current());
    let pending = PendingJob { state: state.clone(), caller: caller.clone(), id, key, may_reuse, traceparent };
    // A task of its own: if the client disconnects now, the job is still either accepted or its files removed.
    let accepting = pending.run(submission, files).in_current_span();
    let job = tokio::spawn(accepting).await.map_err(|error| Problem::internal(&error))??;
    let position = state.store.queue_position(&job).await?;
    let location = format!("/v1/jobs/{}", job.id);
    let (location, tag) = ((header::LOCATION, location), (header::ETAG, etag(&job, position)));
    if job.id != id {
        if !caller.sees(&job) || !caller.has_scope(Scope::JobsRead) {
            return Err(Problem::new(ProblemCode::JobNotFound, "The first request's job is not visible to this key."));
        }
        let headers = [location, tag, (REPLAYED, "true".to_owned())];
        return Ok(answer(&state, StatusCode::ACCEPTED, job, position, headers));
    }
    record_accepted(&job);
    Ok(answer(&state, StatusCode::ACCEPTED, job, position, [location, tag]))
}

/// Returns the body's size in bytes from Content-Length, or 0 without that header.
///
/// # Errors
/// `payload_too_large` if the size exceeds the caller's limit.
fn declared_bytes(state: &ApiState, caller: &Caller, request: &Request) -> Result<u64, Problem> {
    let limit = caller.max_bytes(state.config.limits.max_bytes);
    let declared =
        text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if declared.is_some_and(|length| length > limit.saturating_add(FORM_BYTES)) {
        return Err(too_large(limit));
    }
    Ok(declared.unwrap_or(0))
}

/// Counts and logs an accepted job.
fn record_accepted(job: &Job) {
    let bytes: u64 = job.inputs.iter().map(|input| input.bytes).sum();
    let (reused, mode) = (job.reused_from.is_some(), job.options.mode().as_str());
    metrics::counter!(telemetry::JOBS_SUBMITTED, "reused" => if reused { "true" } else { "false" }).increment(1);
    metrics::histogram!(telemetry::UPLOAD_BYTES).record(u32::try_from(bytes).unwrap_or(u32::MAX));
    tracing::info!(job_id = %job.id, mode, files = job.inputs.len(), bytes, reused, "accepted job");
}

/// Checks that neither the whole queue nor the caller's share of the queue is full.
async fn check_queue_limit(state: &ApiState, caller: &Caller) -> Result<(), Problem> {
    let queued = state.store.queued_counts(caller.tenant.as_str()).await?;
    let own_limit = u64::from(caller.limits.max_queued.unwrap_or(u32::MAX));
    let full = |detail: String| Err(busy(ProblemCode::QueueFull, detail));
    if queued.all >= state.config.max_queued {
        full(format!("The service already has {} queued jobs, the maximum. Retry later.", state.config.max_queued))
    } else if queued.of_tenant >= own_limit {
        full(format!("You already have {own_limit} queued jobs, the maximum. Retry later."))
    } else {
        Ok(())
    }
}

/// The files of a job that is not recorded yet. They are removed unless the job is accepted.
pub(super) struct UnclaimedFiles {
    blobs: Option<Blobs>,
    id: JobId,
}

impl UnclaimedFiles {
    /// Takes charge of the files under the keys of job `id`.
    pub fn new(blobs: &Blobs, id: JobId) -> Self {
        Self { blobs: Some(blobs.clone()), id }
    }

    /// Leaves the files to the job if it was accepted, and otherwise removes them.
    pub async fn finish(mut self, accepted: bool) {
        if let Some(blobs) = self.blobs.take().filter(|_| !accepted) {
            remove(blobs, self.id).await;
        }
    }
}

/// Removes the files if the request is dropped, as when the client disconnects.
impl Drop for UnclaimedFiles {
    fn drop(&mut self) {
        if let Some(blobs) = self.blobs.take() {
            tokio::spawn(remove(blobs, self.id).in_current_span());
        }
    }
}

async fn remove(blobs: Blobs, id: JobId) {
    if let Err(error) = blobs.delete_job(id).await {
        tracing::warn!(%error, "failed to remove rejected upload");
    }
}

/// A job whose files are stored, but which is not recorded yet.
struct PendingJob {
    state: ApiState,
    caller: Caller,
    id: JobId,
    key: IdempotencyState,
    /// Whether the result of an earlier job may be reused.
    may_reuse: bool,
    /// The request's position in its trace (W3C Trace Context).
    traceparent: Option<String>,
}

impl PendingJob {
    /// Records the job and leaves its files in place, or removes the files.
    async fn run(self, submission: Result<Submission, Problem>, files: UnclaimedFiles) -> Result<Job, Problem> {
        let (id, blobs) = (self.id, self.state.blobs.clone());
        let upload = submission.as_ref().ok().and_then(|submission| submission.upload);
        let accepted = self.accept(submission).await;
        let has_files = match &accepted {
            Ok(job) => job.id == id,
            // If the outcome of the insert is unknown, the files stay. The sweep removes them if the job does not exist.
            Err(rejection) => !rejection.is_certain,
        };
        files.finish(has_files).await;
        if let (Ok(_), Some(upload)) = (&accepted, upload)
            && let Err(error) = blobs.delete(&Blobs::incoming_key(upload)).await
        {
            tracing::warn!(%error, "failed to remove used upload");
        }
        accepted.map_err(|rejection| rejection.problem)
    }

    /// Creates the job from a valid submission, or returns the job of an earlier request with the same idempotency key.
    async fn accept(self, submission: Result<Submission, Problem>) -> Result<Job, Rejection> {
        let rejected = |problem| Rejection { problem, is_certain: true };
        let Self { state, caller, id, key, may_reuse, traceparent } = self;
        let store = state.store.as_ref();
        let submission = match submission {
            Ok(submission) => submission,
            Err(problem) => {
                if let IdempotencyState::Held(held) = key {
                    held.release().await;
                }
                return Err(rejected(problem));
            }
        };
        let request_fingerprint = submission.fingerprint();
        let held = match key {
            IdempotencyState::NoKey => None,
            IdempotencyState::Held(held) => Some(held),
            IdempotencyState::Used { fingerprint, job } if fingerprint == request_fingerprint => {
                return idempotency::job_of_key(store, job).await.map_err(rejected);
            }
            IdempotencyState::Used { .. } => return Err(rejected(idempotency::reused())),
        };
        let Submission { inputs, options, extras, upload } = submission;
        let options = options.options;
        let mut new = NewJob {
            id,
            tenant: caller.tenant.to_string(),
            api_key_id: caller.key.map(|key| key.id),
            fingerprint: work_fingerprint(&inputs, &options),
            inputs,
            options,
            metadata: extras.metadata,
            callback_url: extras.callback_url,
            result: None,
            key: held.as_ref().and_then(|held| held.with_fingerprint(request_fingerprint)),
            upload,
            traceparent,
        };
        if may_reuse {
            new.result = find_result(store, &state.blobs, &new).await;
        }
        let submitted = record(store, new).await;
        if let (Ok(_), Some(held)) = (&submitted, held) {
            held.forget();
        }
        submitted
    }
}

/// Inserts a job into the store.
async fn record(store: &dyn JobStore, new: NewJob) -> Result<Job, Rejection> {
    let id = new.id;
    match store.submit(new).await {
        // The connection may have broken after the insert was committed, or before: the database may still execute it.
        Err(error) if error.is_transient() => match store.get(id).await {
            Ok(Some(job)) => Ok(job),
            found => {
                let is_certain = found.is_ok() && !error.may_take_effect();
                Err(Rejection { problem: error.into(), is_certain })
            }
        },
        submitted => submitted.map_err(|error| Rejection { problem: error.into(), is_certain: true }),
    }
}

/// The reason why a job was not accepted.
struct Rejection {
    problem: Problem,
    /// Whether the store certainly has no record of the job.
    is_certain: bool,
}

/// Replaces the attempt's token in the keys of copied artifacts, which no attempt produced.
const REUSED: &str = "reused";

/// Hashes everything that determines a job's result. Reports of analyses contain the file names, so the names count there.
fn work_fingerprint(inputs: &[Input], options: &JobOptions) -> String {
    let with_names = options.mode() == Mode::Analyze;
    let files: Vec<_> = inputs
        .iter()
        .map(|input| (input.format, input.bytes, &input.sha256, with_names.then_some(&input.name)))
        .collect();
    let bytes = serde_json::to_vec(&(crate::ENGINE, files, options)).unwrap_or_default();
    hex::encode(Sha256::digest(&bytes))
}

/// Whether the client forbids reuse of an earlier result (RFC 9111, 5.2.1.4).
fn forbids_reuse(headers: &HeaderMap) -> bool {
    text_header(headers, &header::CACHE_CONTROL)
        .is_some_and(|value| value.split(',').any(|word| ["no-cache", "no-store"].contains(&word.trim())))
}

/// Finds a reusable result of an earlier job, and copies its files to the new job. Failures are logged; the job then runs
/// normally.
async fn find_result(store: &dyn JobStore, blobs: &Blobs, new: &NewJob) -> Option<Reused> {
    let NewJob { id, inputs, .. } = new;
    let earlier = match store.find_result(&new.tenant, &new.fingerprint).await {
        Ok(earlier) => earlier?,
        Err(error) => {
            tracing::warn!(%error, "failed to look up earlier results");
            return None;
        }
    };
    let (outcome, report) = (earlier.outcome?, earlier.report.clone()?);
    if !is_final(outcome) {
        return None;
    }
    match copy_artifacts(blobs, *id, &earlier, inputs).await {
        Ok(artifacts) => Some(Reused { from: earlier.id, outcome, report, artifacts }),
        Err(error) => {
            tracing::info!(%error, from = %earlier.id, "earlier result unavailable; running job");
            if let Err(error) = blobs.delete_attempts(*id, None).await {
                tracing::warn!(%error, "failed to remove copies of earlier result");
            }
            None
        }
    }
}

/// Whether repeating the job would give the same outcome. A partial repair may have lacked time, or Blender, which may be
/// available now.
fn is_final(outcome: JobOutcome) -> bool {
    match outcome {
        JobOutcome::AlreadyPrintable | JobOutcome::Repaired | JobOutcome::Printable | JobOutcome::NotPrintable => true,
        JobOutcome::PartiallyRepaired | JobOutcome::Unrepairable | JobOutcome::Undecided => false,
    }
}

/// Copies the artifacts of an earlier job to job `id`, and renames them to match its inputs.
async fn copy_artifacts(blobs: &Blobs, id: JobId, earlier: &Job, inputs: &[Input]) -> Result<Artifacts, BlobError> {
    let (old, new) = (stem(&earlier.inputs), stem(inputs));
    let mut artifacts = Artifacts::new();
    for (name, artifact) in &earlier.artifacts {
        let mut artifact = artifact.clone();
        if let Some(file) = &mut artifact.file {
            let key = Blobs::artifact_key(id, REUSED, name);
            blobs.copy(&file.key, &key).await?;
            file.key = key;
        }
        if let Some(rest) = artifact.filename.strip_prefix(old) {
            artifact.filename = format!("{new}{rest}");
        }
        artifacts.insert(name.clone(), artifact);
    }
    Ok(artifacts)
}

/// Returns the common prefix of the file names of a repair's artifacts.
fn stem(inputs: &[Input]) -> &str {
    inputs.first().map_or("model", Input::stem)
}
