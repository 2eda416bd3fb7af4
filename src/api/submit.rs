//! A new job: its submission is read, its place in the queue held, the result of an earlier job taken where there is one, and it is recorded.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::Response;
use sha2::{Digest, Sha256};
use tracing::{Instrument, Span};

use super::authenticate::{Caller, MayWrite};
use super::extract::{RawModel, text_header, too_large};
use super::idempotency::{self, KeyUse, REPLAYED};
use super::intake::{self, FORM_BYTES, Intake, Submission, SubmitForm, SubmitUpload};
use super::job::{answer, etag};
use super::problem::{Problem, ProblemCode};
use super::state::{ApiState, busy};
use crate::access::Scope;
use crate::blobs::{BlobError, Blobs};
use crate::inspect::InspectOptions;
use crate::jobs::{Artifacts, Input, Job, JobId, JobOptions, JobOutcome, JobStore, Mode, NewJob, Reused};
use crate::repair::Options;
use crate::telemetry;

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
        (status = 202, description = "The job was accepted", body = super::job::JobView,
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
    let bytes = declared_bytes(&state, &caller, &request)?;
    state.check_free_space(bytes)?;
    let id = JobId::new();
    let key = idempotency::hold(&state.store, &caller.tenant, request.headers(), id).await?;
    // A request that made its job already takes no place in the queue.
    if !matches!(key, KeyUse::Before { .. }) {
        has_place(&state, &caller).await?;
    }
    let files = UnclaimedFiles::new(&state.blobs, id);
    let may_reuse = !refuses_reuse(request.headers());
    let submission = intake::read(Intake { state: &state, caller: &caller, id }, request, &key).await;
    let traceparent = telemetry::traceparent(&Span::current());
    let acceptance = Acceptance { state: state.clone(), caller: caller.clone(), id, key, may_reuse, traceparent };
    // From here on a client that hangs up changes nothing: the job is accepted, or its files go.
    let accepting = acceptance.run(submission, files).in_current_span();
    let job = tokio::spawn(accepting).await.map_err(|error| Problem::internal(&error))??;
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
    record_accepted(&job);
    Ok(answer(&state, StatusCode::ACCEPTED, job, position, [location, tag]))
}

/// The size of the body as the client declares it, 0 where it does not. One that is too large is refused.
fn declared_bytes(state: &ApiState, caller: &Caller, request: &Request) -> Result<u64, Problem> {
    let limit = caller.max_bytes(state.config.limits.max_bytes);
    let declared =
        text_header(request.headers(), &header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if declared.is_some_and(|length| length > limit.saturating_add(FORM_BYTES)) {
        return Err(too_large(limit));
    }
    Ok(declared.unwrap_or(0))
}

/// Counts and logs a job that was accepted.
fn record_accepted(job: &Job) {
    let bytes: u64 = job.inputs.iter().map(|input| input.bytes).sum();
    let (reused, mode) = (job.reused_from.is_some(), job.options.mode().as_str());
    metrics::counter!(telemetry::JOBS_SUBMITTED, "reused" => if reused { "true" } else { "false" }).increment(1);
    metrics::histogram!(telemetry::UPLOAD_BYTES).record(u32::try_from(bytes).unwrap_or(u32::MAX));
    tracing::info!(job_id = %job.id, mode, files = job.inputs.len(), bytes, reused, "accepted");
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

/// The files of a job that does not exist yet; removed unless it comes to be.
pub(super) struct UnclaimedFiles {
    blobs: Option<Blobs>,
    id: JobId,
}

impl UnclaimedFiles {
    pub fn new(blobs: &Blobs, id: JobId) -> Self {
        Self { blobs: Some(blobs.clone()), id }
    }

    /// Lets the job have its files, or removes them.
    pub async fn settle(mut self, accepted: bool) {
        if let Some(blobs) = self.blobs.take().filter(|_| !accepted) {
            remove(blobs, self.id).await;
        }
    }
}

/// A client that hangs up drops the request, wherever it is.
impl Drop for UnclaimedFiles {
    fn drop(&mut self) {
        if let Some(blobs) = self.blobs.take() {
            tokio::spawn(remove(blobs, self.id).in_current_span());
        }
    }
}

async fn remove(blobs: Blobs, id: JobId) {
    if let Err(error) = blobs.delete_job(id).await {
        tracing::warn!(%error, "a refused upload was left");
    }
}

/// A request whose files have come, about to be a job.
struct Acceptance {
    state: ApiState,
    caller: Caller,
    id: JobId,
    key: KeyUse,
    /// Whether the result of an earlier job may be taken.
    may_reuse: bool,
    /// Where the request stands in a trace.
    traceparent: Option<String>,
}

impl Acceptance {
    /// Accepts the job and lets it have its files, or removes them.
    async fn run(self, submission: Result<Submission, Problem>, files: UnclaimedFiles) -> Result<Job, Problem> {
        let (id, blobs) = (self.id, self.state.blobs.clone());
        let upload = submission.as_ref().ok().and_then(|submission| submission.upload);
        let accepted = self.accept(submission).await;
        let has_files = match &accepted {
            Ok(job) => job.id == id,
            // Where it is not known whether the job was recorded, its files stay until the sweep, which knows.
            Err(refused) => !refused.is_certain,
        };
        files.settle(has_files).await;
        if let (Ok(_), Some(upload)) = (&accepted, upload)
            && let Err(error) = blobs.delete(&Blobs::incoming_key(upload)).await
        {
            tracing::warn!(%error, "an upload that became a job's was left");
        }
        accepted.map_err(|refused| refused.problem)
    }

    /// Makes a job of a submission that is whole and of models.
    async fn accept(self, submission: Result<Submission, Problem>) -> Result<Job, Refused> {
        let refused = |problem| Refused { problem, is_certain: true };
        let Self { state, caller, id, key, may_reuse, traceparent } = self;
        let store = state.store.as_ref();
        let submission = match submission {
            Ok(submission) => submission,
            Err(problem) => {
                if let KeyUse::Held(held) = key {
                    held.release().await;
                }
                return Err(refused(problem));
            }
        };
        let now = submission.fingerprint();
        let held = match key {
            KeyUse::NoKey => None,
            KeyUse::Held(held) => Some(held),
            KeyUse::Before { fingerprint, job } if fingerprint == now => {
                return idempotency::job_of_key(store, job).await.map_err(refused);
            }
            KeyUse::Before { .. } => return Err(refused(idempotency::reused())),
        };
        let Submission { inputs, options, notes, upload } = submission;
        let mut new = NewJob {
            id,
            tenant: caller.tenant.to_string(),
            made_by: caller.key.map(|key| key.id),
            fingerprint: work_fingerprint(&inputs, &options),
            inputs,
            options,
            metadata: notes.metadata,
            callback_url: notes.callback_url,
            result: None,
            key: held.as_ref().and_then(|held| held.with(now)),
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

/// Records a job in the store.
async fn record(store: &dyn JobStore, new: NewJob) -> Result<Job, Refused> {
    let id = new.id;
    match store.submit(new).await {
        // The connection may have broken after the job was recorded.
        Err(error) if error.is_transient() => match store.get(id).await {
            Ok(Some(job)) => Ok(job),
            found => Err(Refused { problem: error.into(), is_certain: found.is_ok() }),
        },
        submitted => submitted.map_err(|error| Refused { problem: error.into(), is_certain: true }),
    }
}

/// Why a job was not accepted.
struct Refused {
    problem: Problem,
    /// Whether it is known that the store has nothing of it.
    is_certain: bool,
}

/// What stands for an attempt's token in the keys of files that no attempt made.
const COPIED: &str = "reused";

/// A hash of all that a job's result depends on. The reports of analyses name their files.
fn work_fingerprint(inputs: &[Input], options: &JobOptions) -> String {
    let named = options.mode() == Mode::Analyze;
    let files: Vec<_> =
        inputs.iter().map(|input| (input.format, input.bytes, &input.sha256, named.then_some(&input.name))).collect();
    let bytes = serde_json::to_vec(&(crate::ENGINE, files, options)).unwrap_or_default();
    hex::encode(Sha256::digest(&bytes))
}

/// Whether the client wants the work done again (RFC 9111, 5.2.1.4).
fn refuses_reuse(headers: &HeaderMap) -> bool {
    text_header(headers, &header::CACHE_CONTROL)
        .is_some_and(|value| value.split(',').any(|word| ["no-cache", "no-store"].contains(&word.trim())))
}

/// The result of an earlier job for the new job, its files copied. None where there is none that will do; the job is then
/// done as if there were none.
async fn find_result(store: &dyn JobStore, blobs: &Blobs, new: &NewJob) -> Option<Reused> {
    let NewJob { id, inputs, .. } = new;
    let earlier = match store.find_result(&new.tenant, &new.fingerprint).await {
        Ok(earlier) => earlier?,
        Err(error) => {
            tracing::warn!(%error, "earlier results could not be looked up");
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
            tracing::info!(%error, from = %earlier.id, "an earlier result is gone; doing the work again");
            if let Err(error) = blobs.delete_attempts(*id, None).await {
                tracing::warn!(%error, "copies of an earlier result were left");
            }
            None
        }
    }
}

/// Whether another try would give the same: less than a whole repair may have been for want of time, or of a Blender that is there now.
fn is_final(outcome: JobOutcome) -> bool {
    match outcome {
        JobOutcome::AlreadyPrintable | JobOutcome::Repaired | JobOutcome::Printable | JobOutcome::NotPrintable => true,
        JobOutcome::PartiallyRepaired | JobOutcome::Unrepairable | JobOutcome::Undecided => false,
    }
}

/// Copies the files of a job for another one, under names that fit its inputs.
async fn copy_artifacts(blobs: &Blobs, id: JobId, earlier: &Job, inputs: &[Input]) -> Result<Artifacts, BlobError> {
    let (old, new) = (stem(&earlier.inputs), stem(inputs));
    let mut artifacts = Artifacts::new();
    for (name, artifact) in &earlier.artifacts {
        let mut artifact = artifact.clone();
        if let Some(file) = &mut artifact.file {
            let key = Blobs::artifact_key(id, COPIED, name);
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

/// What the names of a repair's files begin with.
fn stem(inputs: &[Input]) -> &str {
    inputs.first().map_or("model", Input::stem)
}
