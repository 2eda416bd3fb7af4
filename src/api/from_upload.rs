//! A job made of a file that was sent before.

use axum::extract::Request;
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{object, parse, read_small};
use super::file_name::clean_name;
use super::idempotency::Asked;
use super::incoming::{File, Notes, Upload, inputs, job_options};
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use super::upload::{Room, too_large};
use super::uploads::{find_upload, no_upload, sent_bytes};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Input, JobId, JobOptions, Metadata};

/// A job to make of an upload.
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
    metadata: Metadata,
    /// An address to tell of the job's end.
    #[schema(format = "uri", max_length = 2048)]
    callback_url: Option<String>,
}

/// Where a job's file is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Source {
    /// An upload that was announced with `POST /v1/uploads`, and sent.
    #[schema(example = "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    upload_id: String,
}

/// Copies an upload to where its job keeps it, and sees on the way what it is.
pub(super) async fn from_upload(
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
    let found = find_upload(state, &source.upload_id).await?;
    if found.upload.tenant != caller.tenant.as_str() {
        return Err(no_upload(&source.upload_id));
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
