//! A submission as a form, whose parts are read as they come.

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

use super::submission::{File, Intake, Notes, Submission, clean_name, inputs, job_options};
use crate::api::extract::{RawModel, SourceError, UploadBudget, json_object, source_problem, with_idle_limit};
use crate::api::problem::{Problem, ProblemCode, shown};
use crate::blobs::Blobs;
use crate::jobs::{JobOptions, Metadata, Mode};

/// Largest `options` part of a form.
const OPTIONS_BYTES: usize = 64 << 10;
/// Most bytes of a form between its parts: headers, boundaries, what comes before the first part, and what of a part
/// comes in the same chunk.
pub const FORM_BYTES: u64 = 1 << 20;

/// The form that a job is submitted with.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the form in the OpenAPI document; the parts are read as they come")]
pub struct SubmitForm {
    /// The model, in a format that the capabilities list. A repair takes one; an analysis as many parts `file` as their `limits.max_files`
    /// says.
    #[schema(min_items = 1)]
    file: Vec<RawModel>,
    /// What to do, as JSON. Where `mode` is left out it is `repair`.
    options: Option<JobOptions>,
    /// Your own notes on the job as JSON, an object of texts: at most 50 and 8 KiB. They come back with the job.
    #[schema(value_type = Option<BTreeMap<String, String>>)]
    metadata: Option<Metadata>,
    /// An https address to tell of the job's end, beside the webhook endpoints. What comes there is signed with the secret of
    /// `GET /v1/webhook-secret`.
    #[schema(format = "uri", max_length = 2048)]
    callback_url: Option<String>,
}

/// The parts that have come.
struct Parts<'a> {
    intake: Intake<'a>,
    budget: UploadBudget,
    files: Vec<File>,
    options: Option<JobOptions>,
    notes: Notes,
}

/// Reads it.
pub async fn read(intake: Intake<'_>, request: Request) -> Result<Submission, Problem> {
    // A reader of forms keeps all bytes before the next part in memory, so those are counted here.
    let allowance = Arc::new(AtomicU64::new(FORM_BYTES));
    let mut form = open(request, Arc::clone(&allowance), intake.state.config.upload_idle).await?;
    let mut parts =
        Parts { intake, budget: intake.budget(), files: Vec::new(), options: None, notes: Notes::default() };
    loop {
        allowance.store(FORM_BYTES, Ordering::Relaxed);
        let Some(field) = form.next_field().await.map_err(|e| source_problem(&e))? else { break };
        parts.take(field, &allowance).await?;
    }
    parts.finish()
}

async fn open(request: Request, allowance: Arc<AtomicU64>, longest: Duration) -> Result<Multipart, Problem> {
    let (parts, body) = request.into_parts();
    let body = with_idle_limit(body.into_data_stream(), longest).map(move |chunk| {
        let chunk = chunk?;
        let bytes = chunk.len() as u64;
        allowance
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes))
            .map_err(|_| SourceError::Form)?;
        Ok::<Bytes, SourceError>(chunk)
    });
    let request = Request::from_parts(parts, Body::from_stream(one_at_a_time(body)));
    Multipart::from_request(request, &()).await.map_err(|_| {
        Problem::invalid_request(
            "The form can't be read: its `Content-Type` must name the `boundary` between its parts.",
        )
    })
}

impl Parts<'_> {
    async fn take(&mut self, field: Field<'_>, allowance: &AtomicU64) -> Result<(), Problem> {
        let Intake { state, id, .. } = self.intake;
        match field.name() {
            Some("file") => {
                // Where the options came first, a file too many is refused before its bytes are read.
                may_have(self.files.len() + 1, self.options.as_ref(), state.config.max_files)?;
                let name = clean_name(field.file_name());
                allowance.store(u64::MAX, Ordering::Relaxed);
                let key = Blobs::input_key(id, self.files.len());
                let stored = self.budget.store(&state.blobs, &key, field).await?;
                self.files.push(File { name, stored });
            }
            Some("options") if self.options.is_none() => {
                let text = read_text(field, "options").await?;
                let fields = json_object("`options`", &text)
                    .map_err(|problem| Problem::invalid_field("options", problem.detail))?;
                self.options = Some(job_options(fields)?);
            }
            Some(name) if Notes::NAMES.contains(&name) => {
                let name = name.to_owned();
                let text = read_text(field, &name).await?;
                self.notes.take(&name, &String::from_utf8_lossy(&text), state.config.webhook_targets)?;
            }
            Some("options") => {
                let detail = "The form has two parts `options`. Send one for all files.";
                return Err(Problem::invalid_request(detail));
            }
            name => {
                let name = shown(name.unwrap_or_default());
                return Err(Problem::invalid_request(format!(
                    "The form has a part `{name}`. Its parts must be `file`, `options`, `metadata` or `callback_url`."
                )));
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Submission, Problem> {
        let Self { intake, files, options, notes, .. } = self;
        if files.is_empty() {
            let detail = "The form has no part `file`. Send the model as that part.";
            return Err(Problem::new(ProblemCode::MissingFile, detail));
        }
        let options = options.unwrap_or_default();
        may_have(files.len(), Some(&options), intake.state.config.max_files)?;
        Ok(Submission { inputs: inputs(intake.id, files)?, options, notes, upload: None })
    }
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

/// Whether a job may have so many files; as long as its options have not come, as many as any job.
fn may_have(files: usize, options: Option<&JobOptions>, most: usize) -> Result<(), Problem> {
    if files > 1 && options.is_some_and(|options| options.mode() == Mode::Repair) {
        let detail = "The form has two parts `file`, and a repair takes one model. Send one model a job, or set `mode` \
                      to `analyze`.";
        return Err(Problem::invalid_request(detail));
    }
    if files > most {
        let detail =
            format!("The form has more than the {most} files that one job may have. Send the rest as another.");
        return Err(Problem::new(ProblemCode::TooManyFiles, detail).with_header(header::CONNECTION, "close"));
    }
    Ok(())
}

/// The bytes of a small part.
async fn read_text(mut field: Field<'_>, name: &str) -> Result<Vec<u8>, Problem> {
    let mut text = Vec::new();
    while let Some(chunk) = field.chunk().await.map_err(|e| source_problem(&e))? {
        text.extend_from_slice(&chunk);
        if text.len() > OPTIONS_BYTES {
            let message = format!("`{name}` must be at most {} KiB long.", OPTIONS_BYTES >> 10);
            return Err(Problem::invalid_field(name, message));
        }
    }
    Ok(text)
}
