//! What a request carries: path, query, headers and body. Bodies are bounded in size, in silence and in memory.

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

use super::check::{object_errors, unknown_field, value_errors};
use super::problem::{FieldError, Problem, ProblemCode};
use super::state::ApiState;
use crate::blobs::{BlobError, Blobs, Stored, UploadError};
use crate::jobs::whole_number;

/// The fields of a query, each compared with its documented schema.
pub(super) struct ApiQuery<T>(pub T);

impl<T: DeserializeOwned + IntoParams, S: Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let pairs: Vec<(String, String)> = serde_urlencoded::from_str(parts.uri.query().unwrap_or_default())
            .map_err(|_| Problem::invalid_request("The query is not valid: what is written with `%` must be UTF-8."))?;
        let known: BTreeMap<String, Value> = T::into_params(|| None)
            .into_iter()
            .map(|parameter| (parameter.name, serde_json::to_value(parameter.schema).unwrap_or_default()))
            .collect();
        let (mut fields, mut errors) = (Map::new(), Vec::new());
        for (name, text) in pairs {
            let Some(schema) = known.get(&name) else {
                errors.push(unknown_field(&name, known.keys().map(String::as_str), "query parameter"));
                continue;
            };
            let value = query_value(schema, text);
            errors.extend(value_errors(&name, schema, &value));
            if fields.insert(name.clone(), value).is_some() {
                errors.push(FieldError::new(&name, format!("`{name}` is given twice; send it once.")));
            }
        }
        if errors.is_empty()
            && let Ok(query) = serde_json::from_value(Value::Object(fields))
        {
            return Ok(Self(query));
        }
        Err(Problem::of_fields(ProblemCode::InvalidRequest, errors))
    }
}

/// A value of a query by what its schema asks for: text, a number, or a list whose items stand between commas.
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

/// Axum's path extractor with a problem for a rejection.
#[derive(FromRequestParts)]
#[from_request(via(Path), rejection(Problem))]
pub(super) struct ApiPath<T>(pub T);

/// Largest body that is read as JSON, in bytes.
const JSON_BYTES: usize = 64 << 10;

/// A body of JSON, of bounded size, with a problem for a rejection.
pub(super) struct ApiJson<T>(pub T);

impl<T: DeserializeOwned + ToSchema> FromRequest<ApiState> for ApiJson<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &ApiState) -> Result<Self, Problem> {
        parse(&read_small(state, request).await?).map(Self)
    }
}

/// A body of bounded size that does not stop coming.
pub(super) async fn read_small(state: &ApiState, request: Request) -> Result<Vec<u8>, Problem> {
    let source = with_idle_limit(request.into_body().into_data_stream(), state.config.upload_idle);
    let mut source = std::pin::pin!(source);
    let mut text = Vec::new();
    while let Some(chunk) = source.next().await {
        text.extend_from_slice(&chunk.map_err(|error| source_problem(&error))?);
        if text.len() > JSON_BYTES {
            let detail = format!("The body is larger than the {} KiB that this address takes.", JSON_BYTES >> 10);
            return Err(Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close"));
        }
    }
    Ok(text)
}

/// What a body of JSON says, which must be an object of the schema of its type.
pub(super) fn parse<T: DeserializeOwned + ToSchema>(text: &[u8]) -> Result<T, Problem> {
    let fields = json_object("The body", text)?;
    let errors = object_errors(&T::name(), &fields);
    match (serde_json::from_value(Value::Object(fields)), errors.is_empty()) {
        (Ok(body), true) => Ok(body),
        (Ok(_), false) => Err(Problem::of_fields(ProblemCode::InvalidOptions, errors)),
        (Err(_), false) => Err(Problem::of_fields(ProblemCode::InvalidRequest, errors)),
        (Err(_), true) => {
            let detail = format!("The body must have the form of `{}`, which /docs/api/ describes.", T::name());
            Err(Problem::invalid_request(detail))
        }
    }
}

/// The object that a text of JSON is. `what` begins the sentence of what is wrong.
pub(super) fn json_object(what: &str, text: &[u8]) -> Result<Map<String, Value>, Problem> {
    if text.trim_ascii().is_empty() {
        return Err(Problem::invalid_request(format!("{what} is empty; send JSON such as `{{}}`.")));
    }
    match serde_json::from_slice(text) {
        Ok(Value::Object(fields)) => Ok(fields),
        Ok(_) => Err(Problem::invalid_request(format!("{what} must be a JSON object, such as `{{}}`."))),
        Err(error) => {
            let place = format!("line {}, column {}", error.line(), error.column());
            Err(Problem::invalid_request(format!("{what} is not valid JSON: look at {place}.")))
        }
    }
}

/// A field that is an object, and not an array of its values either.
pub(super) fn object<'de, D: Deserializer<'de>, T: DeserializeOwned>(from: D) -> Result<T, D::Error> {
    let fields = Map::<String, Value>::deserialize(from)?;
    T::deserialize(Value::Object(fields)).map_err(D::Error::custom)
}

/// A field that is a whole number of the format `int64`, and not below zero, or nothing.
pub(super) fn whole<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    let Some(number) = Option::<Number>::deserialize(from)? else { return Ok(None) };
    let found = whole_number(&number).filter(|&it| i64::try_from(it).is_ok());
    found.map(Some).ok_or_else(|| D::Error::custom(format!("{number} is not a whole number from 0 to {}", i64::MAX)))
}

/// How many items a page is to have: as many as were asked for, 50 where nothing was said, at most 200.
pub(super) fn page_limit(asked: Option<u32>) -> Result<u32, Problem> {
    match asked.unwrap_or(50) {
        limit @ 1..=200 => Ok(limit),
        limit => {
            let error = FieldError::new("limit", format!("`limit` must be a whole number from 1 to 200; got {limit}."));
            Err(Problem::of_fields(ProblemCode::InvalidRequest, vec![error]))
        }
    }
}

/// That a page can't begin at a cursor.
pub(super) fn unknown_cursor() -> Problem {
    let message = "`cursor` must be the `next` of the page before.";
    Problem::of_fields(ProblemCode::InvalidRequest, vec![FieldError::new("cursor", message)])
}

/// A header as text, if it is there and is text.
pub(super) fn text_header<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Whether a text has the form of an id: `prefix`, an underscore and a UUID in hexadecimal.
pub(super) fn is_name(text: &str, prefix: &str) -> bool {
    let digits = text.strip_prefix(prefix).and_then(|rest| rest.strip_prefix('_'));
    digits.is_some_and(|digits| digits.len() == 32 && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Whether a list of entity tags names this one, compared weakly (RFC 9110, 8.8.3.2).
pub(super) fn names_etag(list: &str, etag: &str) -> bool {
    let bare = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    list.trim() == "*" || list.split(',').any(|tag| bare(tag) == bare(etag))
}

/// A model's bytes.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "it describes the body in the OpenAPI document")]
pub(super) struct RawModel(Vec<u8>);

/// The bytes that one upload may have, all its files together.
pub(super) struct UploadBudget {
    most: u64,
    left: u64,
}

impl UploadBudget {
    pub fn new(most: u64) -> Self {
        Self { most, left: most }
    }

    /// Stores a file of at most the bytes that are left.
    pub async fn store<E: Error + 'static>(
        &mut self,
        blobs: &Blobs,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
    ) -> Result<Stored, Problem> {
        let stored = blobs.put_stream(key, source, self.left).await.map_err(|error| match error {
            UploadError::TooLarge(_) => too_large(self.most),
            UploadError::Source(error) => source_problem(&error),
            UploadError::Store(error) => error.into(),
        })?;
        self.left -= stored.bytes;
        Ok(stored)
    }
}

pub(super) fn too_large(limit: u64) -> Problem {
    let detail = format!("The upload is larger than the {} MiB that this service takes.", limit >> 20);
    // The rest of the body is not read, so the connection can't be used again.
    Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close")
}

/// What can go wrong while bytes come in.
#[derive(Debug, thiserror::Error)]
pub(super) enum SourceError {
    #[error("no bytes came for too long")]
    Idle,
    #[error("the form's headers are too long")]
    Form,
    #[error(transparent)]
    Body(#[from] axum::Error),
}

/// The stream, but ended by an error when nothing comes for `longest`.
pub(super) fn with_idle_limit(
    source: impl Stream<Item = Result<Bytes, axum::Error>> + Send + 'static,
    longest: Duration,
) -> impl Stream<Item = Result<Bytes, SourceError>> + Send + 'static {
    futures::stream::unfold(Some(Box::pin(source)), move |source| async move {
        let mut source = source?;
        match tokio::time::timeout(longest, source.next()).await {
            Err(_) => Some((Err(SourceError::Idle), None)),
            Ok(None) => None,
            Ok(Some(Err(error))) => Some((Err(error.into()), None)),
            Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some(source))),
        }
    })
}

/// The problem behind an error of the incoming bytes, however deep libraries wrapped it.
pub(super) fn source_problem(error: &(dyn Error + 'static)) -> Problem {
    let mut cause = Some(error);
    let mut is_form = false;
    while let Some(e) = cause {
        match e.downcast_ref() {
            Some(SourceError::Idle) => {
                let detail = "No bytes came for too long, so the upload was given up.";
                return Problem::new(ProblemCode::UploadTimeout, detail).with_header(header::CONNECTION, "close");
            }
            Some(SourceError::Form) => {
                return Problem::invalid_request("The form's headers are too long.")
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
                "The body can't be decoded as its `Content-Encoding` says. Send it again.",
            )
            .with_header(header::CONNECTION, "close");
        }
        if e.is::<MultipartError>() {
            is_form = true;
        }
        cause = e.source();
    }
    if is_form {
        let detail = "The form can't be read: it ends too early, or a part is not formed as RFC 7578 says.";
        return Problem::invalid_request(detail);
    }
    Problem::new(ProblemCode::UploadInterrupted, "The upload broke off before its end. Send it again.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entity_tags_are_compared_weakly_and_one_by_one() {
        assert!(names_etag("W/\"3\"", "W/\"3\""));
        assert!(names_etag("\"1\", \"3\"", "W/\"3\""));
        assert!(names_etag("*", "W/\"3\""));
        assert!(!names_etag("W/\"33\"", "W/\"3\""));
        assert!(!names_etag("", "W/\"3\""));
    }
}
