//! Reads a submission whose file is already stored: an upload, or a file of an earlier job. The file is copied to the new job.

use axum::extract::Request;
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::options::SubmittedOptions;
use super::submission::{Extras, ReceivedFile, Submission, SubmissionContext, clean_name, inputs};
use super::upload::{find_upload, sent_bytes, upload_not_found};
use crate::access::Scope;
use crate::api::extract::{UploadBudget, object, parse, read_small, too_large};
use crate::api::idempotency::{self, IdempotencyState};
use crate::api::job::{find_job, job_id};
use crate::api::problem::{Problem, ProblemCode};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Input, JobId, JobOptions, Metadata, Mode, Status, UploadId};

/// A job to create from a file that is already stored.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SubmitUpload {
    /// The stored file to use.
    #[serde(deserialize_with = "object")]
    source: Source,
    /// The job's options. `mode` defaults to `repair`.
    #[schema(value_type = Option<JobOptions>)]
    options: Option<Map<String, Value>>,
    /// The file's name. Defaults to the name of the upload or of the earlier job's file.
    name: Option<String>,
    /// Your own metadata for the job: at most 50 text values and 8 KiB.
    #[serde(default)]
    #[schema(value_type = BTreeMap<String, String>)]
    metadata: Metadata,
    /// An https URL to notify when the job ends.
    #[schema(format = "uri", max_length = 2048)]
    callback_url: Option<String>,
}

/// The stored file to use: exactly one of `upload_id` and `job_id`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// An upload created with `POST /v1/uploads` whose file has been sent.
    #[schema(example = "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    upload_id: Option<String>,
    /// An earlier job of yours whose files have not expired.
    #[schema(example = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    job_id: Option<String>,
    /// The file of the earlier job to use. Defaults to `input`. Valid with `job_id` only.
    file: Option<JobFile>,
}

/// Which file of an earlier job to use.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum JobFile {
    /// The submitted file; for an analysis, all submitted files.
    #[default]
    Input,
    /// The repaired model.
    Model,
}

/// Reads the JSON body, and copies the files to the new job's keys.
pub async fn read(
    context: SubmissionContext<'_>,
    request: Request,
    key: &IdempotencyState,
) -> Result<Submission, Problem> {
    let text = read_small(context.state, request).await?;
    let SubmitUpload { source, options, name, metadata, callback_url } = parse(&text)?;
    let options = SubmittedOptions::read(context.state, context.caller, options.unwrap_or_default()).await?;
    let mut extras = Extras::default();
    let targets = context.state.config.webhook_targets;
    extras.set("metadata", &serde_json::to_string(&metadata).unwrap_or_default(), targets)?;
    if let Some(address) = &callback_url {
        extras.set("callback_url", address, targets)?;
    }
    let name = name.as_deref();
    let (inputs, upload) = match source {
        Source { upload_id: Some(upload), job_id: None, file: None } => {
            from_upload(context, &upload, name, key).await?
        }
        Source { upload_id: None, job_id: Some(job), file } => {
            (from_job(context, &job, file.unwrap_or_default(), name, options.options.mode()).await?, None)
        }
        _ => {
            let message =
                "`source` must have exactly one of `upload_id` and `job_id`; `file` is valid with `job_id` only.";
            return Err(Problem::invalid_field("source", message));
        }
    };
    Ok(Submission { inputs, options, extras, upload })
}

/// Copies the file of an upload. If this request is a retry that already used the upload, returns the inputs of its job.
async fn from_upload(
    context: SubmissionContext<'_>,
    upload: &str,
    name: Option<&str>,
    key: &IdempotencyState,
) -> Result<(Vec<Input>, Option<UploadId>), Problem> {
    let SubmissionContext { state, caller, id } = context;
    let pending = find_upload(state, upload).await?;
    if pending.upload.tenant != caller.tenant.as_str() {
        return Err(upload_not_found(upload));
    }
    let name = clean_name(name.or(pending.upload.name.as_deref()));
    if let Some(job) = pending.job {
        // A client retries when the response was lost. The upload is gone by then, but its job still knows the inputs.
        return match key {
            IdempotencyState::Used { job: before, .. } if *before == job => {
                let job = idempotency::job_of_key(state.store.as_ref(), job).await?;
                Ok((job.inputs.into_iter().map(|input| Input { name: name.clone(), ..input }).collect(), None))
            }
            _ => {
                let detail =
                    format!("The job '{job}' already used this upload. Create a new upload and send the file again.");
                Err(Problem::new(ProblemCode::UploadUsed, detail))
            }
        };
    }
    let key = Blobs::incoming_key(pending.upload.id);
    let limit = caller.max_bytes(state.config.limits.max_bytes);
    let bytes = sent_bytes(state, &key).await?.ok_or_else(file_not_sent)?;
    if bytes > limit {
        return Err(too_large(limit));
    }
    let sent = state.blobs.get(&key, None).await.map_err(|error| match error {
        BlobError::NotFound => file_not_sent(),
        error => error.into(),
    })?;
    let stored = UploadBudget::new(limit).store(&state.blobs, &Blobs::input_key(id, 0), sent).await?;
    Ok((inputs(id, vec![ReceivedFile { name, stored }])?, Some(pending.upload.id)))
}

fn file_not_sent() -> Problem {
    Problem::new(
        ProblemCode::UploadMissing,
        "The upload's file has not been sent yet. Send it as `put` describes, then repeat this request.",
    )
}

/// Copies the files of an earlier job, for example to try other options or another output format.
async fn from_job(
    context: SubmissionContext<'_>,
    earlier: &str,
    file: JobFile,
    name: Option<&str>,
    mode: Mode,
) -> Result<Vec<Input>, Problem> {
    let SubmissionContext { state, caller, id } = context;
    if !caller.has_scope(Scope::JobsRead) {
        return Err(Problem::new(
            ProblemCode::Forbidden,
            "The key lacks the scope 'jobs:read', so it can't submit another job's files.",
        ));
    }
    let job = find_job(state, caller, job_id(earlier)?).await?;
    if job.status == Status::Expired {
        return Err(files_expired(&job.id));
    }
    let new_name = |own: &str| clean_name(name.or(Some(own)));
    let files: Vec<(String, String, String)> = match file {
        JobFile::Input => {
            let is_single = job.inputs.len() == 1;
            let parts = |input: Input| {
                let name = if is_single { new_name(&input.name) } else { input.name };
                (input.key, input.sha256, name)
            };
            job.inputs.into_iter().map(parts).collect()
        }
        JobFile::Model => {
            let model = job.artifacts.get("model").and_then(|model| Some((model.file.as_ref()?, &model.filename)));
            let (file, filename) = model.ok_or_else(|| {
                let detail = format!("The job '{}' has no result to submit.", job.id);
                Problem::new(ProblemCode::ArtifactNotFound, detail)
            })?;
            vec![(file.key.clone(), file.sha256.clone(), new_name(filename))]
        }
    };
    if mode == Mode::Repair && files.len() > 1 {
        let detail = format!("A repair takes one file, but the job '{}' has {}.", job.id, files.len());
        return Err(Problem::new(ProblemCode::TooManyFiles, detail));
    }
    let mut budget = context.budget();
    let mut copies = Vec::with_capacity(files.len());
    for (number, (key, sha256, name)) in files.into_iter().enumerate() {
        let bytes = state.blobs.get_whole(&key, &sha256).await.map_err(|error| match error {
            BlobError::NotFound => files_expired(&job.id),
            error => error.into(),
        })?;
        let stored = budget.store(&state.blobs, &Blobs::input_key(id, number), bytes).await?;
        copies.push(ReceivedFile { name, stored });
    }
    inputs(id, copies)
}

fn files_expired(job: &JobId) -> Problem {
    Problem::new(ProblemCode::JobExpired, format!("The files of the job '{job}' have expired."))
}
