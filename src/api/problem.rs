//! The error response of the API: `application/problem+json` (RFC 9457), with conversions from storage errors.
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use super::problem_code::ProblemCode;
use crate::blobs::BlobError;
use crate::jobs::StoreError;

/// An error response in the format of RFC 9457, `application/problem+json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// The path of the code's documentation.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code's title: a short description of the error.
    pub title: String,
    /// The HTTP status of the response.
    pub status: u16,
    /// The fault of this request, and the remedy.
    pub detail: String,
    /// The path of the request.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instance: String,
    /// The error code, for programs.
    pub code: ProblemCode,
    /// The request's id, as in the X-Request-Id header and in the service's log.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub request_id: String,
    /// One error for each invalid field.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldError>,
    /// Additional headers of the response.
    #[serde(skip)]
    pub(super) headers: Vec<(HeaderName, String)>,
}

/// An error in one field of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FieldError {
    /// The field, such as `max_tier`. A nested field is named by its path, such as `tolerances.slit` or `file[1]`.
    pub field: String,
    /// The fault of the field, and the value to send instead.
    pub message: String,
}

impl FieldError {
    /// Creates an error for `field`.
    #[must_use]
    pub fn new(field: &str, message: impl Into<String>) -> Self {
        Self { field: field.to_owned(), message: message.into() }
    }
}

/// Returns at most the first 64 characters of client text, for quoting in a response.
pub(super) fn truncated(text: &str) -> &str {
    text.char_indices().nth(64).map_or(text, |(end, _)| &text[..end])
}

/// Seconds to wait while the database or the file store is unavailable.
const RETRY_AFTER_S: u32 = 5;
/// Seconds to wait for another request with the same Idempotency-Key.
const KEY_RETRY_AFTER_S: u32 = 2;

/// The media type of a [`Problem`].
pub(super) const PROBLEM_JSON: HeaderValue = HeaderValue::from_static("application/problem+json");

impl Problem {
    /// Creates a problem with the code's title and status, and the given detail.
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

    /// Creates a problem for a malformed request.
    pub(super) fn invalid_request(detail: impl Into<String>) -> Self {
        Self::new(ProblemCode::InvalidRequest, detail)
    }

    /// Creates a problem for a well-formed request with a value that is out of range.
    pub(super) fn invalid_value(detail: impl Into<String>) -> Self {
        Self::new(ProblemCode::InvalidOptions, detail)
    }

    /// Creates a problem for invalid fields. The detail is the first field's message.
    pub(super) fn of_fields(code: ProblemCode, errors: Vec<FieldError>) -> Self {
        let first = errors.first().map(|error| error.message.clone()).unwrap_or_default();
        let detail = match errors.len() {
            0 | 1 => first,
            2 => format!("{first} One more field is invalid; `errors` lists both."),
            count => format!("{first} {} more fields are invalid; `errors` lists all of them.", count - 1),
        };
        Self { errors, ..Self::new(code, detail) }
    }

    /// Creates a problem for one invalid option or field.
    pub(super) fn invalid_field(field: &str, message: impl Into<String>) -> Self {
        Self::of_fields(ProblemCode::InvalidOptions, vec![FieldError::new(field, message)])
    }

    /// Creates a problem for an Idempotency-Key that another request is using.
    pub(super) fn key_in_use() -> Self {
        let detail = "Another request with this Idempotency-Key is in progress. Retry in a few seconds.";
        Self::new(ProblemCode::IdempotencyKeyInUse, detail).retry_after(KEY_RETRY_AFTER_S)
    }

    /// Adds a header to the response.
    #[must_use]
    pub fn with_header(mut self, name: HeaderName, value: impl Into<String>) -> Self {
        self.headers.push((name, value.into()));
        self
    }

    /// Adds a Retry-After header of this many seconds.
    #[must_use]
    pub(super) fn retry_after(self, seconds: u32) -> Self {
        self.with_header(header::RETRY_AFTER, seconds.to_string())
    }

    /// Creates a problem for a fault of the service. The cause goes to the log, not to the client.
    #[must_use]
    pub fn internal(error: &dyn std::error::Error) -> Self {
        tracing::error!(%error, "request failed");
        Self::new(ProblemCode::Internal, "The service failed to handle the request. Retry later.")
    }
}

/// Stores the problem in the response's extensions. The outermost layer renders the body, since that layer knows the
/// request's id and path.
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
    /// Replaces the body of `response` with this problem, and keeps its status and headers.
    pub(super) fn render(self, response: Response) -> Response {
        let (mut parts, _) = response.into_parts();
        let body = Json(self).into_response().into_body();
        parts.headers.remove(header::CONTENT_LENGTH);
        parts.headers.insert(header::CONTENT_TYPE, PROBLEM_JSON);
        parts.headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        Response::from_parts(parts, body)
    }
}

/// Logs that a disk is full, and creates the problem for the client.
fn storage_full(error: &dyn std::error::Error) -> Problem {
    tracing::error!(%error, "disk full or read-only");
    Problem::new(ProblemCode::StorageFull, "The service's disk is full. Retry later.").retry_after(RETRY_AFTER_S)
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        if matches!(error, StoreError::KeyLost) {
            return Self::key_in_use();
        }
        if matches!(error, StoreError::UploadTaken) {
            return Self::new(
                ProblemCode::UploadUsed,
                "Another job has used this upload in the meantime. Create a new upload.",
            );
        }
        if error.is_full() {
            return storage_full(&error);
        }
        if !error.is_transient() {
            return Self::internal(&error);
        }
        tracing::error!(%error, "database unavailable");
        Self::new(ProblemCode::Unavailable, "The service's database is temporarily unavailable. Retry soon.")
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
        tracing::error!(%error, "file store unavailable");
        Self::new(ProblemCode::Unavailable, "The service's file store is temporarily unavailable. Retry soon.")
            .retry_after(RETRY_AFTER_S)
    }
}

impl From<PathRejection> for Problem {
    fn from(_: PathRejection) -> Self {
        Self::invalid_request("The path is invalid: its percent-encoded characters must be UTF-8.")
    }
}
