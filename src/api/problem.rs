use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use super::problem_code::ProblemCode;
use crate::blobs::BlobError;
use crate::jobs::StoreError;

/// An error answer after RFC 9457, `application/problem+json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// Where the code is documented.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code's title.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// What happened and what to do.
    pub detail: String,
    /// The address that was asked for.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instance: String,
    /// The code, for programs.
    pub code: ProblemCode,
    /// The request's id, as in the service's log and in the X-Request-Id header.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub request_id: String,
    /// What is wrong with each field, where fields are wrong.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldError>,
    /// Headers of the answer.
    #[serde(skip)]
    pub(super) headers: Vec<(HeaderName, String)>,
}

/// What is wrong with one field of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FieldError {
    /// The field, an option for example; one within another by its path, such as `tolerances.slit` or `file[1]`.
    pub field: String,
    /// What is wrong, and what to send instead.
    pub message: String,
}

impl FieldError {
    /// An error of a field.
    #[must_use]
    pub fn new(field: &str, message: impl Into<String>) -> Self {
        Self { field: field.to_owned(), message: message.into() }
    }
}

/// What a client said as an answer repeats it: its beginning.
pub(super) fn shown(text: &str) -> &str {
    text.char_indices().nth(64).map_or(text, |(end, _)| &text[..end])
}

/// Seconds to wait while the database or the file store does not answer.
const RETRY_AFTER_S: u32 = 5;
/// Seconds to wait for a request with the same Idempotency-Key.
const KEY_RETRY_AFTER_S: u32 = 2;

/// The media type of a [`Problem`].
pub(super) const PROBLEM_JSON: HeaderValue = HeaderValue::from_static("application/problem+json");

impl Problem {
    /// A problem with a detail of its own.
    #[must_use]
    pub fn new(code: ProblemCode, detail: impl Into<String>) -> Self {
        let (status, title, _) = code.describe();
        Self {
            kind: format!("/problems/{}", code.name()),
            title: title.to_owned(),
            status: status.as_u16(),
            detail: detail.into(),
            instance: String::new(),
            code,
            request_id: String::new(),
            errors: Vec::new(),
            headers: Vec::new(),
        }
    }

    /// A request that can't be understood.
    pub(super) fn invalid_request(detail: impl Into<String>) -> Self {
        Self::new(ProblemCode::InvalidRequest, detail)
    }

    /// A request that is understood, with a value that is out of its range.
    pub(super) fn invalid_value(detail: impl Into<String>) -> Self {
        Self::new(ProblemCode::InvalidOptions, detail)
    }

    /// A request whose fields are wrong. The detail is that of the first.
    pub(super) fn of_fields(code: ProblemCode, errors: Vec<FieldError>) -> Self {
        let first = errors.first().map(|error| error.message.clone()).unwrap_or_default();
        let detail = match errors.len() {
            0 | 1 => first,
            2 => format!("{first} One more field is wrong; `errors` lists both."),
            count => format!("{first} {} more fields are wrong; `errors` lists all.", count - 1),
        };
        Self { errors, ..Self::new(code, detail) }
    }

    /// A request with one wrong value of an option or field.
    pub(super) fn invalid_field(field: &str, message: impl Into<String>) -> Self {
        Self::of_fields(ProblemCode::InvalidOptions, vec![FieldError::new(field, message)])
    }

    /// A request with the same Idempotency-Key is under way.
    pub(super) fn key_in_use() -> Self {
        let detail = "A request with this Idempotency-Key is under way. Ask again when it may have ended.";
        Self::new(ProblemCode::IdempotencyKeyInUse, detail).retry_after(KEY_RETRY_AFTER_S)
    }

    /// Adds a header to the answer.
    #[must_use]
    pub fn with_header(mut self, name: HeaderName, value: impl Into<String>) -> Self {
        self.headers.push((name, value.into()));
        self
    }

    /// The same, and when to ask again.
    #[must_use]
    pub(super) fn retry_after(self, seconds: u32) -> Self {
        self.with_header(header::RETRY_AFTER, seconds.to_string())
    }

    /// A fault of the service: the cause goes to the log, not to the client.
    #[must_use]
    pub fn internal(error: &dyn std::error::Error) -> Self {
        tracing::error!(%error, "request failed");
        Self::new(ProblemCode::Internal, "The service could not do this. Try again later.")
    }
}

/// The body is rendered by the outermost layer, which knows the request's id and address; until then the problem rides
/// in the response's extensions.
impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = status.into_response();
        for (name, value) in &self.headers {
            if let Ok(value) = HeaderValue::from_str(value) {
                response.headers_mut().insert(name, value);
            }
        }
        response.extensions_mut().insert(self);
        response
    }
}

impl Problem {
    /// The finished answer: status and headers of `response`, and this problem as its body.
    pub(super) fn render(self, response: Response) -> Response {
        let (mut parts, _) = response.into_parts();
        let body = Json(self).into_response().into_body();
        parts.headers.remove(header::CONTENT_LENGTH);
        parts.headers.insert(header::CONTENT_TYPE, PROBLEM_JSON);
        parts.headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        Response::from_parts(parts, body)
    }
}

/// That a disk of the service is full.
fn storage_full(error: &dyn std::error::Error) -> Problem {
    tracing::error!(%error, "a disk is full, or can't be written to");
    Problem::new(ProblemCode::StorageFull, "The service has no room for this now. Send it again later.")
        .retry_after(RETRY_AFTER_S)
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        if matches!(error, StoreError::KeyLost) {
            return Self::key_in_use();
        }
        if matches!(error, StoreError::UploadTaken) {
            return Self::new(ProblemCode::UploadUsed, "Another job was made of this upload meanwhile.");
        }
        if error.is_full() {
            return storage_full(&error);
        }
        if !error.is_transient() {
            return Self::internal(&error);
        }
        tracing::error!(%error, "the database does not answer");
        Self::new(ProblemCode::Unavailable, "The service's database does not answer now. Ask again soon.")
            .retry_after(RETRY_AFTER_S)
    }
}

impl From<BlobError> for Problem {
    fn from(error: BlobError) -> Self {
        Self::from(&error)
    }
}

impl From<&BlobError> for Problem {
    fn from(error: &BlobError) -> Self {
        if error.is_full() {
            return storage_full(error);
        }
        if !error.is_transient() {
            return Self::internal(error);
        }
        tracing::error!(%error, "the file store does not answer");
        Self::new(ProblemCode::Unavailable, "The service's file store does not answer now. Ask again soon.")
            .retry_after(RETRY_AFTER_S)
    }
}

impl From<PathRejection> for Problem {
    fn from(_: PathRejection) -> Self {
        Self::invalid_request("The path is not valid: what is written with `%` must be UTF-8.")
    }
}
