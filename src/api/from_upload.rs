//! A job made of a file that is here already: sent to an address before, or of an earlier job.

use axum::extract::Request;
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{object, parse, read_small};
use super::file_name::clean_name;
use super::from_job::from_job;
use super::idempotency::Asked;
use super::incoming::{File, Notes, Upload, inputs, job_options};
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use super::upload::{Room, too_large};
use super::uploads::{find_upload, no_upload, sent_bytes};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Input, JobId, JobOptions, Metadata};

/// A job to make of a file that is here already.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SubmitUpload {
    /// Where the file is.
    #[serde(deserialize_with = "object")]
    source: Source,
    /// What to do. Where `mode` is left out it is `repair`.
    #[schema(value_type = Option<JobOptions>)]
    options: Option<Map<String, Value>>,
    /// The file's name; without it that of the upload.
    name: Option<String>,
    /// Your own notes on the job, at most 50 texts and 8 KiB.
    #[serde(default)]
    #[schema(value_type = BTreeMap<String, String>)]
    metadata: Metadata,
    /// An address to tell of the job's end.
    #[schema(format = "uri", max_length = 2048)]
    callback_url: Option<String>,
}

/// Where a job's file is: an upload or an earlier job, one of them.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Source {
    /// An upload that was announced with `POST /v1/uploads`, and sent.
    #[schema(example = "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    upload_id: Option<String>,
    /// An earlier job of yours whose files are still kept.
    #[schema(example = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    job_id: Option<String>,
    /// Of an earlier job, which file.
    file: Option<JobFile>,
}

/// A file of an earlier job.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum JobFile {
    /// What it was sent; for an analysis all its files.
    #[default]
    Input,
    /// Its result.
    Model,
}

/// Copies the file to where its job keeps it, and sees on the way what it is.
pub(super) async fn from_source(
    state: &ApiState,
    caller: &Caller,
    id: JobId,
    request: Request,
    asked: &Asked,
) -> Result<Upload, Problem> {
    let text = read_small(state, request).await?;
    let SubmitUpload { source, options, name, metadata, callback_url } = parse(&text)?;
    let options = job_options(options.unwrap_or_default())?;
    let mut notes = Notes::default();
    notes.take("metadata", &serde_json::to_string(&metadata).unwrap_or_default(), state.config.webhook_reach)?;
    if let Some(address) = &callback_url {
        notes.take("callback_url", address, state.config.webhook_reach)?;
    }
    let upload_id = match source {
        Source { upload_id: Some(upload), job_id: None, file: None } => upload,
        Source { upload_id: None, job_id: Some(job), file } => {
            let mode = options.mode();
            let inputs = from_job(state, caller, id, &job, file.unwrap_or_default(), name.as_deref(), mode).await?;
            return Ok(Upload { inputs, options, notes, taken: None });
        }
        _ => {
            let message = "`source` must have either `upload_id`, or `job_id` and perhaps `file`.";
            return Err(Problem::invalid_field("source", message));
        }
    };
    let found = find_upload(state, &upload_id).await?;
    if found.upload.tenant != caller.tenant.as_str() {
        return Err(no_upload(&upload_id));
    }
    let name = clean_name(name.as_deref().or(found.upload.name.as_deref()));
    if let Some(job) = found.job {
        // The same request may come again because its answer was lost. The upload is gone then, and its job knows what it was.
        return match asked {
            Asked::Before { job: before, .. } if *before == job => made_before(state, job, name, options, notes).await,
            _ => {
                let detail =
                    format!("The job '{job}' was made of this upload. Announce another one and send the file again.");
                Err(Problem::new(ProblemCode::UploadUsed, detail))
            }
        };
    }
    let key = Blobs::incoming_key(found.upload.id);
    let limit = caller.max_bytes(state.config.limits.max_bytes);
    let bytes = sent_bytes(state, &key).await?.ok_or_else(nothing_sent)?;
    if bytes > limit {
        return Err(too_large(limit));
    }
    let sent = state.blobs.get(&key, None).await.map_err(|error| match error {
        BlobError::NotFound => nothing_sent(),
        error => error.into(),
    })?;
    let stored = Room::new(limit).store(&state.blobs, &Blobs::input_key(id, 0), sent).await?;
    let inputs = inputs(id, vec![File { name, stored }])?;
    Ok(Upload { inputs, options, notes, taken: Some(found.upload.id) })
}

fn nothing_sent() -> Problem {
    Problem::new(
        ProblemCode::UploadMissing,
        "The upload's file was not sent yet. Send it as its 'put' says, then ask again.",
    )
}

async fn made_before(
    state: &ApiState,
    job: JobId,
    name: String,
    options: JobOptions,
    notes: Notes,
) -> Result<Upload, Problem> {
    let inputs = match state.store.get(job).await? {
        Some(job) if !job.purged => job.inputs.into_iter().map(|input| Input { name: name.clone(), ..input }).collect(),
        _ => return Err(super::submit::deleted(job)),
    };
    Ok(Upload { inputs, options, notes, taken: None })
}
