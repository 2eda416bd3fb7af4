//! A submission of a file that is here already, which is copied: of an upload that was sent before, or of an earlier job.

use axum::extract::Request;
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::submission::{File, Intake, Notes, Submission, clean_name, inputs, job_options};
use super::upload::{find_upload, no_upload, sent_bytes};
use crate::access::Scope;
use crate::api::extract::{UploadBudget, object, parse, read_small, too_large};
use crate::api::idempotency::{self, KeyUse};
use crate::api::job::{find_job, job_id};
use crate::api::problem::{Problem, ProblemCode};
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Input, JobId, JobOptions, Metadata, Mode, Status, UploadId};

/// A job to make of a file that is here already.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SubmitUpload {
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
pub struct Source {
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
pub enum JobFile {
    /// What it was sent; for an analysis all its files.
    #[default]
    Input,
    /// Its result.
    Model,
}

/// Reads it, and copies the files to where the new job keeps them.
pub async fn read(intake: Intake<'_>, request: Request, key: &KeyUse) -> Result<Submission, Problem> {
    let text = read_small(intake.state, request).await?;
    let SubmitUpload { source, options, name, metadata, callback_url } = parse(&text)?;
    let options = job_options(options.unwrap_or_default())?;
    let mut notes = Notes::default();
    let reach = intake.state.config.webhook_targets;
    notes.take("metadata", &serde_json::to_string(&metadata).unwrap_or_default(), reach)?;
    if let Some(address) = &callback_url {
        notes.take("callback_url", address, reach)?;
    }
    let name = name.as_deref();
    let (inputs, upload) = match source {
        Source { upload_id: Some(upload), job_id: None, file: None } => from_upload(intake, &upload, name, key).await?,
        Source { upload_id: None, job_id: Some(job), file } => {
            (from_job(intake, &job, file.unwrap_or_default(), name, options.mode()).await?, None)
        }
        _ => {
            let message = "`source` must have either `upload_id`, or `job_id` and perhaps `file`.";
            return Err(Problem::invalid_field("source", message));
        }
    };
    Ok(Submission { inputs, options, notes, upload })
}

/// Copies the file of an upload. Of one that a job was made of by the same request before, gives what that job has.
async fn from_upload(
    intake: Intake<'_>,
    upload: &str,
    name: Option<&str>,
    key: &KeyUse,
) -> Result<(Vec<Input>, Option<UploadId>), Problem> {
    let Intake { state, caller, id } = intake;
    let found = find_upload(state, upload).await?;
    if found.upload.tenant != caller.tenant.as_str() {
        return Err(no_upload(upload));
    }
    let name = clean_name(name.or(found.upload.name.as_deref()));
    if let Some(job) = found.job {
        // The same request may come again because its answer was lost. The upload is gone then, and its job knows what it was.
        return match key {
            KeyUse::Before { job: before, .. } if *before == job => {
                let job = idempotency::job_of_key(state.store.as_ref(), job).await?;
                Ok((job.inputs.into_iter().map(|input| Input { name: name.clone(), ..input }).collect(), None))
            }
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
    let stored = UploadBudget::new(limit).store(&state.blobs, &Blobs::input_key(id, 0), sent).await?;
    Ok((inputs(id, vec![File { name, stored }])?, Some(found.upload.id)))
}

fn nothing_sent() -> Problem {
    Problem::new(
        ProblemCode::UploadMissing,
        "The upload's file was not sent yet. Send it as its 'put' says, then ask again.",
    )
}

/// Copies the files of an earlier job, which are still kept: to try other options, or to have the result in another format.
async fn from_job(
    intake: Intake<'_>,
    earlier: &str,
    file: JobFile,
    name: Option<&str>,
    mode: Mode,
) -> Result<Vec<Input>, Problem> {
    let Intake { state, caller, id } = intake;
    if !caller.may(Scope::JobsRead) {
        return Err(Problem::new(
            ProblemCode::Forbidden,
            "The key can't read jobs, so it can't make one of another's files.",
        ));
    }
    let job = find_job(state, caller, job_id(earlier)?).await?;
    if job.status == Status::Expired {
        return Err(gone(&job.id));
    }
    let given = |own: &str| clean_name(name.or(Some(own)));
    let files: Vec<(String, String, String)> = match file {
        JobFile::Input => {
            let one = job.inputs.len() == 1;
            job.inputs.into_iter().map(|it| (it.key, it.sha256, if one { given(&it.name) } else { it.name })).collect()
        }
        JobFile::Model => {
            let model = job.artifacts.get("model").and_then(|model| Some((model.file.as_ref()?, &model.filename)));
            let (file, filename) = model.ok_or_else(|| {
                let detail = format!("The job '{}' has no result to make a job of.", job.id);
                Problem::new(ProblemCode::ArtifactNotFound, detail)
            })?;
            vec![(file.key.clone(), file.sha256.clone(), given(filename))]
        }
    };
    if mode == Mode::Repair && files.len() > 1 {
        let detail = format!("A repair takes one file, and the job '{}' has {}.", job.id, files.len());
        return Err(Problem::new(ProblemCode::TooManyFiles, detail));
    }
    let mut budget = intake.budget();
    let mut copies = Vec::with_capacity(files.len());
    for (number, (key, sha256, name)) in files.into_iter().enumerate() {
        let bytes = state.blobs.get_whole(&key, &sha256).await.map_err(|error| match error {
            BlobError::NotFound => gone(&job.id),
            error => error.into(),
        })?;
        let stored = budget.store(&state.blobs, &Blobs::input_key(id, number), bytes).await?;
        copies.push(File { name, stored });
    }
    inputs(id, copies)
}

fn gone(job: &JobId) -> Problem {
    Problem::new(ProblemCode::JobExpired, format!("The files of the job '{job}' were kept as long as they are."))
}
