//! How a job's files, options and notes come in: as a form, or as one file with the rest in the query.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::body::{Body, Bytes};
use axum::extract::multipart::Field;
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::header;
use futures::StreamExt;
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::caller::Caller;
use super::check::{field_schema, unknown_field, value_errors};
use super::extract::{json_object, query_value, text_header};
use super::file_name::{clean_name, disposition_name};
use super::from_upload::from_source;
use super::idempotency::Asked;
use super::problem::{FieldError, Problem, ProblemCode, shown};
use super::state::ApiState;
use super::upload::{Room, SourceError, one_at_a_time, source_problem, with_patience};
use crate::blobs::{Blobs, Stored};
use crate::format::{ReadErrorKind, sniff};
use crate::jobs::{Input, JobId, JobOptions, Metadata, Mode, UploadId};
use crate::webhooks::Reach;

/// Largest `options` part of a form.
const OPTIONS_BYTES: usize = 64 << 10;
/// Most bytes of a form between its parts: headers, boundaries, what comes before the first part, and what of a part
/// comes in the same chunk.
pub(super) const FORM_BYTES: u64 = 1 << 20;
/// Largest notes of a client, in bytes, and most of them.
const METADATA_BYTES: usize = 8 << 10;
const METADATA_ENTRIES: usize = 50;

/// The form that a job is submitted with.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the form in the OpenAPI document; the parts are read as they come")]
pub(super) struct SubmitForm {
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

/// A model's bytes.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes the body in the OpenAPI document")]
pub(super) struct RawModel(Vec<u8>);

/// What came with a request, its files stored already.
pub(super) struct Upload {
    /// Its files, models all of them.
    pub inputs: Vec<Input>,
    /// What to do.
    pub options: JobOptions,
    /// What else the client said.
    pub notes: Notes,
    /// The upload that was copied, where the file was sent before the request.
    pub taken: Option<UploadId>,
}

/// What a client says of a job beside its options.
#[derive(Default, Serialize)]
pub(super) struct Notes {
    /// Its own notes.
    pub metadata: Metadata,
    /// Where to tell of the job's end.
    pub callback_url: Option<String>,
}

impl Notes {
    /// The names of the parts, or fields of a query, that they come as.
    const NAMES: [&str; 2] = ["metadata", "callback_url"];

    /// Notes one of them.
    pub fn take(&mut self, name: &str, text: &str, reach: Reach) -> Result<(), Problem> {
        if name == "callback_url" {
            let url =
                reach.read(text).map_err(|error| Problem::invalid_field(name, format!("`callback_url` {error}.")))?;
            self.callback_url = Some(url.into());
            return Ok(());
        }
        let metadata = serde_json::from_str(text)
            .ok()
            .filter(|metadata: &Metadata| text.len() <= METADATA_BYTES && metadata.len() <= METADATA_ENTRIES);
        self.metadata = metadata.ok_or_else(|| {
            let kib = METADATA_BYTES >> 10;
            let message =
                format!("`metadata` must be a JSON object of at most {METADATA_ENTRIES} texts and {kib} KiB.");
            Problem::invalid_field(name, message)
        })?;
        Ok(())
    }
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
    let (mut problems, mut errors): (Vec<Problem>, Vec<FieldError>) = Default::default();
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
                if of > 1 {
                    errors.push(FieldError::new(&format!("file[{number}]"), format!("{which}{detail}")));
                }
                problems.push(Problem::new(code, format!("{which}{detail}")));
            }
        }
    }
    match problems.into_iter().next() {
        Some(first) => Err(Problem { errors, ..first }),
        None => Ok(inputs),
    }
}

/// Reads a request's files, as many bytes as the caller may send, into the store under the job's keys.
pub(super) async fn read(
    state: &ApiState,
    caller: &Caller,
    id: JobId,
    request: Request,
    asked: &Asked,
) -> Result<Upload, Problem> {
    let most = caller.max_bytes(state.config.limits.max_bytes);
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default().trim().to_owned();
    let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "multipart/form-data" => from_form(state, id, most, request).await,
        "application/json" => from_source(state, caller, id, request, asked).await,
        _ => from_body(state, id, most, request).await,
    }
}

async fn from_body(state: &ApiState, id: JobId, most: u64, request: Request) -> Result<Upload, Problem> {
    let query = request.uri().query().unwrap_or_default();
    let pairs: Vec<(String, String)> = serde_urlencoded::from_str(query)
        .map_err(|_| Problem::invalid_request("The query is not valid: what is written with `%` must be UTF-8."))?;
    let (names, pairs): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| key == "name");
    let (said, options): (Vec<_>, Vec<_>) =
        pairs.into_iter().partition(|(key, _)| Notes::NAMES.contains(&key.as_str()));
    let mut notes = Notes::default();
    for (key, text) in &said {
        notes.take(key, text, state.config.webhook_reach)?;
    }
    // Options are checked before the body is read, so that a mistake does not cost an upload.
    let options = job_options(query_fields(options)?)?;
    let name = names.into_iter().next().map(|(_, name)| name);
    let name = clean_name(name.as_deref().or(disposition_name(request.headers())));
    let source = with_patience(request.into_body().into_data_stream(), state.config.upload_idle);
    let mut room = Room::new(most);
    let stored = room.store(&state.blobs, &Blobs::input_key(id, 0), source).await?;
    let inputs = inputs(id, vec![File { name, stored }])?;
    Ok(Upload { inputs, options, notes, taken: None })
}

/// The fields of a query: numbers and other JSON as what they are, anything else as text.
fn query_fields(pairs: Vec<(String, String)>) -> Result<Map<String, Value>, Problem> {
    let mut fields = Map::new();
    for (key, text) in pairs {
        let is_list = |schema: &&Value| schema["type"] == "array" && !text.starts_with('[');
        let list =
            ["Options", "AnalyzeOptions"].into_iter().find_map(|options| field_schema(options, &key)).filter(is_list);
        let value = match list {
            Some(schema) => query_value(schema, text),
            None => serde_json::from_str(&text).unwrap_or(Value::String(text)),
        };
        if fields.insert(key.clone(), value).is_some() {
            return Err(Problem::invalid_field(&key, format!("`{key}` is given twice; send it once.")));
        }
    }
    Ok(fields)
}

/// Reads the options of a job. Every option that is wrong is named.
pub(super) fn job_options(fields: Map<String, Value>) -> Result<JobOptions, Problem> {
    let mode = match fields.get("mode") {
        None => Mode::default(),
        Some(given) => match Mode::ALL.into_iter().find(|mode| given == mode.as_str()) {
            Some(mode) => mode,
            None => return Err(Problem::of_fields(ProblemCode::InvalidOptions, vec![unknown_mode(given)])),
        },
    };
    let errors: Vec<_> = fields.iter().flat_map(|(option, value)| option_errors(mode, option, value)).collect();
    if !errors.is_empty() {
        return Err(Problem::of_fields(ProblemCode::InvalidOptions, errors));
    }
    JobOptions::from_fields(fields).map_err(|error| match error.option() {
        Some(option) => Problem::invalid_field(option, error.to_string()),
        None => Problem::invalid_value(error.to_string()),
    })
}

fn unknown_mode(given: &Value) -> FieldError {
    let names = Mode::ALL.map(|mode| format!("`{}`", mode.as_str())).join(" or ");
    FieldError::new("mode", format!("`mode` must be {names}; got {}.", shown(&given.to_string())))
}

fn option_errors(mode: Mode, option: &str, value: &Value) -> Vec<FieldError> {
    let schema = match mode {
        Mode::Repair => "Options",
        Mode::Analyze => "AnalyzeOptions",
    };
    if option == "mode" {
        return Vec::new();
    }
    if let Some(schema) = field_schema(schema, option) {
        return value_errors(option, schema, value);
    }
    let other = Mode::ALL.into_iter().find(|of| of.option_names().iter().any(|name| name == option));
    vec![match other {
        Some(of) => {
            let (of, mode) = (of.as_str(), mode.as_str());
            let message = format!("`{option}` is an option of mode `{of}`; this job's mode is `{mode}`.");
            FieldError::new(option, message)
        }
        None => unknown_field(option, mode.option_names().iter().map(String::as_str), "option"),
    }]
}

async fn from_form(state: &ApiState, id: JobId, most: u64, request: Request) -> Result<Upload, Problem> {
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
    let mut form = Multipart::from_request(request, &()).await.map_err(|_| {
        Problem::invalid_request(
            "The form can't be read: its `Content-Type` must name the `boundary` between its parts.",
        )
    })?;
    let mut room = Room::new(most);
    let mut files: Vec<File> = Vec::new();
    let mut options: Option<JobOptions> = None;
    let mut notes = Notes::default();
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
            Some("options") if options.is_none() => {
                let text = read_text(field, "options").await?;
                let fields = json_object("`options`", &text)
                    .map_err(|problem| Problem::invalid_field("options", problem.detail))?;
                options = Some(job_options(fields)?);
            }
            Some(name) if Notes::NAMES.contains(&name) => {
                let name = name.to_owned();
                let text = read_text(field, &name).await?;
                notes.take(&name, &String::from_utf8_lossy(&text), state.config.webhook_reach)?;
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
    }
    if files.is_empty() {
        let detail = "The form has no part `file`. Send the model as that part.";
        return Err(Problem::new(ProblemCode::MissingFile, detail));
    }
    let options = options.unwrap_or_default();
    may_have(files.len(), Some(&options), state.config.max_files)?;
    Ok(Upload { inputs: inputs(id, files)?, options, notes, taken: None })
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
