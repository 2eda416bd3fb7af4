//! Extractors for the parts of a request: path, query, headers and body. Bodies are limited in size, idle time and memory.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::{self, ErrorKind};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::multipart::MultipartError;
use axum::extract::{FromRequest, FromRequestParts, Path, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, header};
use futures::{Stream, StreamExt};
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Number, Value};
use utoipa::{IntoParams, ToSchema};

use super::problem::{FieldError, Problem, ProblemCode};
use super::state::ApiState;
use super::validation::{object_errors, unknown_field, value_errors};
use crate::blobs::{BlobError, Blobs, Stored, UploadError};
use crate::options::whole_number;

/// Query parameters, each validated against its documented schema.
pub(super) struct ApiQuery<T>(pub T);

impl<T: DeserializeOwned + IntoParams, S: Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let pairs: Vec<(String, String)> =
            serde_urlencoded::from_str(parts.uri.query().unwrap_or_default()).map_err(|_| {
                Problem::invalid_request("The query is invalid: its percent-encoded characters must be UTF-8.")
            })?;
        let schemas: BTreeMap<String, Value> = T::into_params(|| None)
            .into_iter()
            .map(|parameter| (parameter.name, serde_json::to_value(parameter.schema).unwrap_or_default()))
            .collect();
        let (mut fields, mut errors) = (Map::new(), Vec::new());
        for (name, text) in pairs {
            let Some(schema) = schemas.get(&name) else {
                errors.push(unknown_field(&name, schemas.keys().map(String::as_str), "query parameter"));
                continue;
            };
            let value = query_value(schema, text);
            errors.extend(value_errors(&name, schema, &value));
            if fields.insert(name.clone(), value).is_some() {
                errors.push(FieldError::new(&name, format!("`{name}` occurs twice; send it once.")));
            }
        }
        if !errors.is_empty() {
            return Err(Problem::of_fields(ProblemCode::InvalidRequest, errors));
        }
        let query = serde_json::from_value(Value::Object(fields));
        query
            .map(Self)
            .map_err(|_| Problem::invalid_request("The query is invalid; see /docs/api/ for its parameters."))
    }
}

/// Converts a query value to the JSON type of its schema: text, a number, or a list with commas between its items.
pub(super) fn query_value(schema: &Value, text: String) -> Value {
    match schema.get("type") {
        Some(Value::String(kind)) if kind == "array" => text.split(',').map(str::to_owned).collect(),
        Some(Value::String(kind)) if kind == "string" => text.into(),
        Some(Value::Array(kinds)) if kinds.iter().any(|kind| kind == "string") => text.into(),
        Some(Value::Array(kinds)) if kinds.iter().any(|kind| kind == "array") => {
            text.split(',').map(str::to_owned).collect()
        }
        Some(_) => serde_json::from_str(&text).ok().filter(Value::is_number).unwrap_or(Value::String(text)),
        None => text.into(),
    }
}

/// Axum's path extractor, which rejects with a [`Problem`].
#[derive(FromRequestParts)]
#[from_request(via(Path), rejection(Problem))]
pub(super) struct ApiPath<T>(pub T);

/// Largest JSON body, in bytes.
const JSON_BYTES: usize = 64 << 10;

/// A JSON body of at most [`JSON_BYTES`], validated against its documented schema.
pub(super) struct ApiJson<T>(pub T);

impl<T: DeserializeOwned + ToSchema> FromRequest<ApiState> for ApiJson<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &ApiState) -> Result<Self, Problem> {
        parse(&read_small(state, request).await?).map(Self)
    }
}

/// Reads a body of at most [`JSON_BYTES`].
///
/// # Errors
/// A problem if the body is too large, or if no bytes arrive for `upload_idle`.
pub(super) async fn read_small(state: &ApiState, request: Request) -> Result<Vec<u8>, Problem> {
    let source = with_idle_limit(request.into_body().into_data_stream(), state.config.upload_idle);
    let mut source = std::pin::pin!(source);
    let mut text = Vec::new();
    while let Some(chunk) = source.next().await {
        text.extend_from_slice(&chunk.map_err(|error| source_problem(&error))?);
        if text.len() > JSON_BYTES {
            let detail = format!("The body exceeds the limit of {} KiB for this path.", JSON_BYTES >> 10);
            return Err(Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close"));
        }
    }
    Ok(text)
}

/// Parses a JSON body, which must be an object of `T`'s documented schema.
pub(super) fn parse<T: DeserializeOwned + ToSchema>(text: &[u8]) -> Result<T, Problem> {
    let fields = json_object("The body", text)?;
    let errors = object_errors(&T::name(), &fields);
    match (serde_json::from_value(Value::Object(fields)), errors.is_empty()) {
        (Ok(body), true) => Ok(body),
        (Ok(_), false) => Err(Problem::of_fields(ProblemCode::InvalidOptions, errors)),
        (Err(_), false) => Err(Problem::of_fields(ProblemCode::InvalidRequest, errors)),
        (Err(_), true) => {
            let detail = format!("The body must match the schema `{}`; see /docs/api/.", T::name());
            Err(Problem::invalid_request(detail))
        }
    }
}

/// Parses JSON text that must be an object. `subject` begins the error's sentence, such as "The body".
pub(super) fn json_object(subject: &str, text: &[u8]) -> Result<Map<String, Value>, Problem> {
    if text.trim_ascii().is_empty() {
        return Err(Problem::invalid_request(format!("{subject} is empty; send JSON such as `{{}}`.")));
    }
    match serde_json::from_slice(text) {
        Ok(Value::Object(fields)) => Ok(fields),
        Ok(_) => Err(Problem::invalid_request(format!("{subject} must be a JSON object, such as `{{}}`."))),
        Err(error) => {
            let place = format!("line {}, column {}", error.line(), error.column());
            Err(Problem::invalid_request(format!("{subject} is not valid JSON; check {place}.")))
        }
    }
}

/// Deserializes a struct from a JSON object only. Serde would also accept an array of the struct's values.
pub(super) fn object<'de, D: Deserializer<'de>, T: DeserializeOwned>(from: D) -> Result<T, D::Error> {
    let fields = Map::<String, Value>::deserialize(from)?;
    T::deserialize(Value::Object(fields)).map_err(D::Error::custom)
}

/// Deserializes an optional whole number from 0 to `i64::MAX`, as the schema's format `int64` demands.
pub(super) fn whole<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    let Some(number) = Option::<Number>::deserialize(from)? else { return Ok(None) };
    let whole = whole_number(&number).filter(|&value| i64::try_from(value).is_ok());
    whole.map(Some).ok_or_else(|| D::Error::custom(format!("{number} is not a whole number from 0 to {}", i64::MAX)))
}

/// Returns the number of items on a page: 50 by default, at most 200.
pub(super) fn page_limit(requested: Option<u32>) -> Result<u32, Problem> {
    match requested.unwrap_or(50) {
        limit @ 1..=200 => Ok(limit),
        limit => {
            let error = FieldError::new("limit", format!("`limit` must be a whole number from 1 to 200; got {limit}."));
            Err(Problem::of_fields(ProblemCode::InvalidRequest, vec![error]))
        }
    }
}

/// Creates the problem for a `cursor` that no page returned.
pub(super) fn invalid_cursor() -> Problem {
    let message = "`cursor` must be the `next` value of the previous page.";
    Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new("cursor", message)])
}

/// Returns a header's value if the header is present and is visible ASCII text.
pub(super) fn text_header<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Whether a text has the form of an id: `prefix`, an underscore and a UUID in hexadecimal.
pub(super) fn is_id(text: &str, prefix: &str) -> bool {
    let digits = text.strip_prefix(prefix).and_then(|rest| rest.strip_prefix('_'));
    digits.is_some_and(|digits| digits.len() == 32 && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Whether a list of entity tags contains `etag`, by weak comparison (RFC 9110, 8.8.3.2).
pub(super) fn contains_etag(list: &str, etag: &str) -> bool {
    let bare = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    list.trim() == "*" || list.split(',').any(|tag| bare(tag) == bare(etag))
}

/// The bytes of a model file.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes the body in the OpenAPI document")]
pub(super) struct RawModel(Vec<u8>);

/// The size limit of one upload, shared by all its files.
pub(super) struct UploadBudget {
    limit: u64,
    remaining: u64,
}

impl UploadBudget {
    /// Creates a budget of `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self { limit, remaining: limit }
    }

    /// Stores a file of at most the remaining bytes, and subtracts its size.
    pub async fn store<E: Error + 'static>(
        &mut self,
        blobs: &Blobs,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
    ) -> Result<Stored, Problem> {
        let stored = blobs.put_stream(key, source, self.remaining).await.map_err(|error| match error {
            UploadError::TooLarge(_) => too_large(self.limit),
            UploadError::Source(error) => source_problem(&error),
            UploadError::Store(error) => error.into(),
        })?;
        self.remaining -= stored.bytes;
        Ok(stored)
    }
}

/// Creates the problem for an upload above `limit` bytes.
pub(super) fn too_large(limit: u64) -> Problem {
    let detail = format!("The upload exceeds the limit of {} MiB.", limit >> 20);
    // The rest of the body is not read, so the connection can't be reused.
    Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close")
}

/// An error while a body is being received.
#[derive(Debug, thiserror::Error)]
pub(super) enum SourceError {
    /// No bytes arrived within the idle limit.
    #[error("no bytes came for too long")]
    Idle,
    /// The form has too many bytes between its parts.
    #[error("the form's headers are too long")]
    Form,
    /// The connection or the body's framing failed.
    #[error(transparent)]
    Body(#[from] axum::Error),
}

/// Ends the stream with [`SourceError::Idle`] if no chunk arrives for `idle_limit`.
pub(super) fn with_idle_limit(
    source: impl Stream<Item = Result<Bytes, axum::Error>> + Send + 'static,
    idle_limit: Duration,
) -> impl Stream<Item = Result<Bytes, SourceError>> + Send + 'static {
    futures::stream::unfold(Some(Box::pin(source)), move |source| async move {
        let mut source = source?;
        match tokio::time::timeout(idle_limit, source.next()).await {
            Err(_) => Some((Err(SourceError::Idle), None)),
            Ok(None) => None,
            Ok(Some(Err(error))) => Some((Err(error.into()), None)),
            Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some(source))),
        }
    })
}

/// Finds the problem behind an error of the incoming bytes, through all layers that wrapped the error.
pub(super) fn source_problem(error: &(dyn Error + 'static)) -> Problem {
    let mut cause = Some(error);
    let mut is_form = false;
    while let Some(e) = cause {
        match e.downcast_ref() {
            Some(SourceError::Idle) => {
                let detail = "The upload timed out: no bytes arrived for too long. Send it again.";
                return Problem::new(ProblemCode::UploadTimeout, detail).with_header(header::CONNECTION, "close");
            }
            Some(SourceError::Form) => {
                return Problem::invalid_request("The form's part headers are too long.")
                    .with_header(header::CONNECTION, "close");
            }
            _ => {}
        }
        if let Some(error) = e.downcast_ref::<BlobError>() {
            return error.into();
        }
        if e.downcast_ref::<io::Error>()
            .is_some_and(|e| matches!(e.kind(), ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::Other))
        {
            return Problem::invalid_request(
                "The body can't be decoded as its `Content-Encoding` says. Check the encoding and send it again.",
            )
            .with_header(header::CONNECTION, "close");
        }
        if e.is::<MultipartError>() {
            is_form = true;
        }
        cause = e.source();
    }
    if is_form {
        let detail = "The form is invalid: it ends too early, or a part does not conform to RFC 7578.";
        return Problem::invalid_request(detail);
    }
    Problem::new(ProblemCode::UploadInterrupted, "The upload was interrupted before its end. Send it again.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entity_tags_are_compared_weakly_and_one_by_one() {
        assert!(contains_etag("W/\"3\"", "W/\"3\""));
        assert!(contains_etag("\"1\", \"3\"", "W/\"3\""));
        assert!(contains_etag("*", "W/\"3\""));
        assert!(!contains_etag("W/\"33\"", "W/\"3\""));
        assert!(!contains_etag("", "W/\"3\""));
    }
}
