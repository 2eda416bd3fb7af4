//! Reads a submission from a multipart form, part by part as the bytes arrive.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::Poll;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::multipart::Field;
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::header;
use futures::{Stream, StreamExt};
use utoipa::ToSchema;

use super::options::SubmittedOptions;
use super::submission::{Extras, ReceivedFile, Submission, SubmissionContext, clean_name, inputs};
use crate::api::extract::{RawModel, SourceError, UploadBudget, json_object, source_problem, with_idle_limit};
use crate::api::problem::{Problem, ProblemCode, truncated};
use crate::blobs::Blobs;
use crate::jobs::{JobOptions, Metadata, Mode};

/// Largest text part of a form, such as `options`, in bytes.
const TEXT_PART_BYTES: usize = 64 << 10;
/// Most bytes of a form between two files: headers, boundaries, the preamble, and the part of a file that arrives in the
/// same chunk as its headers.
pub const FORM_BYTES: u64 = 1 << 20;

/// The form that submits a job.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the form in the OpenAPI document; the parts are read one by one")]
pub struct SubmitForm {
    /// The model, in a format that `GET /v1/capabilities` lists. A repair takes one file. An analysis takes one part `file` for each
    /// file, at most `limits.max_files`.
    #[schema(min_items = 1)]
    file: Vec<RawModel>,
    /// The job's options as JSON. `mode` defaults to `repair`.
    options: Option<JobOptions>,
    /// Your own metadata as JSON: an object of at most 50 text values and 8 KiB. The job returns it unchanged.
    #[schema(value_type = Option<BTreeMap<String, String>>)]
    metadata: Option<Metadata>,
    /// An https URL to notify when the job ends, in addition to the webhook endpoints. Messages are signed with the secret from
    /// `GET /v1/webhook-secret`.
    #[schema(format = "uri", max_length = 2048)]
    callback_url: Option<String>,
}

/// The parts received so far.
struct ReceivedParts<'a> {
    context: SubmissionContext<'a>,
    budget: UploadBudget,
    files: Vec<ReceivedFile>,
    options: Option<SubmittedOptions>,
    extras: Extras,
}

/// Reads all parts of the form, and stores the files.
pub async fn read(context: SubmissionContext<'_>, request: Request) -> Result<Submission, Problem> {
    // The form parser buffers all bytes before the next part, so their number is limited here.
    let allowance = Arc::new(AtomicU64::new(FORM_BYTES));
    let mut form = open(request, Arc::clone(&allowance), context.state.config.upload_idle).await?;
    let mut parts = ReceivedParts {
        context,
        budget: context.budget(),
        files: Vec::new(),
        options: None,
        extras: Extras::default(),
    };
    loop {
        allowance.store(FORM_BYTES, Ordering::Relaxed);
        let Some(field) = form.next_field().await.map_err(|e| source_problem(&e))? else { break };
        parts.take(field, &allowance).await?;
    }
    parts.finish()
}

async fn open(request: Request, allowance: Arc<AtomicU64>, idle_limit: Duration) -> Result<Multipart, Problem> {
    let (parts, body) = request.into_parts();
    let body = with_idle_limit(body.into_data_stream(), idle_limit).map(move |chunk| {
        let chunk = chunk?;
        let bytes = chunk.len() as u64;
        allowance
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes))
            .map_err(|_| SourceError::Form)?;
        Ok::<Bytes, SourceError>(chunk)
    });
    let request = Request::from_parts(parts, Body::from_stream(with_pauses(body)));
    Multipart::from_request(request, &()).await.map_err(|_| {
        Problem::invalid_request("The form is invalid: its `Content-Type` must give the `boundary` between its parts.")
    })
}

impl ReceivedParts<'_> {
    async fn take(&mut self, field: Field<'_>, allowance: &AtomicU64) -> Result<(), Problem> {
        let SubmissionContext { state, caller, id } = self.context;
        match field.name() {
            Some("file") => {
                // With the options first, a surplus file is rejected before its bytes are read.
                let options = self.options.as_ref().map(|submitted| &submitted.options);
                check_file_count(self.files.len() + 1, options, state.config.max_files)?;
                let name = clean_name(field.file_name());
                allowance.store(u64::MAX, Ordering::Relaxed);
                let key = Blobs::input_key(id, self.files.len());
                let stored = self.budget.store(&state.blobs, &key, field).await?;
                self.files.push(ReceivedFile { name, stored });
            }
            Some("options") if self.options.is_none() => {
                let text = read_text(field, "options").await?;
                let fields = json_object("`options`", &text)
                    .map_err(|problem| Problem::invalid_field("options", problem.detail))?;
                self.options = Some(SubmittedOptions::read(state, caller, fields).await?);
            }
            Some(name) if Extras::NAMES.contains(&name) => {
                let name = name.to_owned();
                let text = read_text(field, &name).await?;
                self.extras.set(&name, &String::from_utf8_lossy(&text), state.config.webhook_targets)?;
            }
            Some("options") => {
                let detail = "The form has two parts `options`; send one, which applies to all files.";
                return Err(Problem::invalid_request(detail));
            }
            name => {
                let name = truncated(name.unwrap_or_default());
                return Err(Problem::invalid_request(format!(
                    "The form has an unknown part `{name}`; its parts must be `file`, `options`, `metadata` or `callback_url`."
                )));
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Submission, Problem> {
        let Self { context, files, options, extras, .. } = self;
        if files.is_empty() {
            let detail = "The form has no part `file`; send the model as that part.";
            return Err(Problem::new(ProblemCode::MissingFile, detail));
        }
        let options = options.unwrap_or_default();
        check_file_count(files.len(), Some(&options.options), context.state.config.max_files)?;
        Ok(Submission { inputs: inputs(context.id, files)?, options, extras, upload: None })
    }
}

/// Pauses after each chunk. Without the pauses the form parser buffers every chunk that is ready before parsing, which could
/// be the whole file of a fast sender.
fn with_pauses<T>(source: impl Stream<Item = T> + Send + 'static) -> impl Stream<Item = T> + Send + 'static {
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

/// Checks the number of files against the mode and the limit. Before the options arrive, only the limit applies.
fn check_file_count(files: usize, options: Option<&JobOptions>, max_files: usize) -> Result<(), Problem> {
    if files > 1 && options.is_some_and(|options| options.mode() == Mode::Repair) {
        let detail = "The form has two parts `file`, but a repair takes one model. Submit one job per model, or set `mode` \
                      to `analyze`.";
        return Err(Problem::invalid_request(detail));
    }
    if files > max_files {
        let detail =
            format!("The form exceeds the limit of {max_files} files per job. Submit the rest as another job.");
        return Err(Problem::new(ProblemCode::TooManyFiles, detail).with_header(header::CONNECTION, "close"));
    }
    Ok(())
}

/// Reads a text part of at most [`TEXT_PART_BYTES`].
async fn read_text(mut field: Field<'_>, name: &str) -> Result<Vec<u8>, Problem> {
    let mut text = Vec::new();
    while let Some(chunk) = field.chunk().await.map_err(|e| source_problem(&e))? {
        text.extend_from_slice(&chunk);
        if text.len() > TEXT_PART_BYTES {
            let message = format!("`{name}` must be at most {} KiB long.", TEXT_PART_BYTES >> 10);
            return Err(Problem::invalid_field(name, message));
        }
    }
    Ok(text)
}
