//! Reads a submission whose body is one file, with the options and all other fields in the query.

use axum::extract::Request;
use axum::http::{HeaderMap, header};
use serde_json::{Map, Value};

use super::options::SubmittedOptions;
use super::submission::{Extras, ReceivedFile, Submission, SubmissionContext, clean_name, inputs};
use crate::api::extract::{query_value, text_header, with_idle_limit};
use crate::api::problem::Problem;
use crate::api::validation::field_schema;
use crate::blobs::Blobs;

/// Reads the options from the query, then stores the body as the file.
pub async fn read(context: SubmissionContext<'_>, request: Request) -> Result<Submission, Problem> {
    let SubmissionContext { state, caller, id } = context;
    let query = request.uri().query().unwrap_or_default();
    let pairs: Vec<(String, String)> = serde_urlencoded::from_str(query)
        .map_err(|_| Problem::invalid_request("The query is invalid: its percent-encoded characters must be UTF-8."))?;
    let (names, pairs): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| key == "name");
    let (extra_pairs, options): (Vec<_>, Vec<_>) =
        pairs.into_iter().partition(|(key, _)| Extras::NAMES.contains(&key.as_str()));
    let mut extras = Extras::default();
    for (key, text) in &extra_pairs {
        extras.set(key, text, state.config.webhook_targets)?;
    }
    // Options are checked before the body is read, so that a mistake does not cost an upload.
    let options = SubmittedOptions::read(state, caller, query_fields(options)?).await?;
    let name = names.into_iter().next().map(|(_, name)| name);
    let name = clean_name(name.as_deref().or(disposition_name(request.headers())));
    let source = with_idle_limit(request.into_body().into_data_stream(), state.config.upload_idle);
    let stored = context.budget().store(&state.blobs, &Blobs::input_key(id, 0), source).await?;
    let inputs = inputs(id, vec![ReceivedFile { name, stored }])?;
    Ok(Submission { inputs, options, extras, upload: None })
}

/// Converts query pairs to fields: a list or text if the option is one, otherwise JSON if the value parses, otherwise text.
fn query_fields(pairs: Vec<(String, String)>) -> Result<Map<String, Value>, Problem> {
    let mut fields = Map::new();
    for (key, text) in pairs {
        let schema = ["Options", "AnalyzeOptions"].into_iter().find_map(|options| field_schema(options, &key));
        let is_list = |schema: &Value| schema["type"] == "array" && !text.starts_with('[');
        let value = match schema {
            Some(schema) if is_list(schema) || is_text(schema) => query_value(schema, text),
            _ => serde_json::from_str(&text).unwrap_or(Value::String(text)),
        };
        if fields.insert(key.clone(), value).is_some() {
            return Err(Problem::invalid_field(&key, format!("`{key}` occurs twice; send it once.")));
        }
    }
    Ok(fields)
}

/// Whether a schema is that of a text, which may be null but has no other type.
fn is_text(schema: &Value) -> bool {
    let is_nullable_text = |kinds: &Vec<Value>| kinds.iter().all(|kind| kind == "string" || kind == "null");
    schema["type"] == "string" || schema["type"].as_array().is_some_and(is_nullable_text)
}

/// Returns the file name in the Content-Disposition header.
fn disposition_name(headers: &HeaderMap) -> Option<&str> {
    let value = text_header(headers, &header::CONTENT_DISPOSITION)?;
    value.split(';').find_map(|part| Some(part.trim().strip_prefix("filename=")?.trim_matches('"')))
}
