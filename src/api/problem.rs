use axum::Json;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::blobs::BlobError;
use crate::jobs::StoreError;

/// Every problem that a request can meet, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProblemCode {
    /// No key, or one that is worth nothing.
    Unauthorized,
    /// The key does not allow this.
    Forbidden,
    /// A page of an origin that may not ask.
    OriginNotAllowed,
    /// The tenant asked too often.
    RateLimited,
    /// No such address.
    RouteNotFound,
    /// The address exists, but not for this method.
    MethodNotAllowed,
    /// A path, query or form that can't be understood.
    InvalidRequest,
    /// An option that is unknown or out of its range.
    InvalidOptions,
    /// No file, or an empty one.
    MissingFile,
    /// The file, or all files of a job together, are larger than the service takes.
    PayloadTooLarge,
    /// The upload has more files than one job may have.
    TooManyFiles,
    /// The body's media type is not one that this address takes.
    UnsupportedMediaType,
    /// The file's bytes are of no format that can be read.
    UnsupportedModel,
    /// The upload stopped coming.
    UploadTimeout,
    /// The upload broke off.
    UploadInterrupted,
    /// No job of that name.
    JobNotFound,
    /// The job was deleted on request.
    JobDeleted,
    /// The job's results were kept as long as they are, and are gone.
    JobExpired,
    /// The job has ended, so it can't be cancelled.
    JobFinished,
    /// The job has no such file, or not yet.
    ArtifactNotFound,
    /// The range lies outside the file.
    RangeNotSatisfiable,
    /// A request with the same Idempotency-Key is under way.
    IdempotencyKeyInUse,
    /// The Idempotency-Key came with another request before.
    IdempotencyKeyReused,
    /// No webhook endpoint or delivery of that name.
    WebhookNotFound,
    /// The webhook endpoint is disabled.
    WebhookDisabled,
    /// The tenant has as many webhook endpoints as it may.
    TooManyWebhooks,
    /// As many jobs wait as may.
    QueueFull,
    /// The disk has no room for more files.
    StorageFull,
    /// The database does not answer now.
    Unavailable,
    /// A fault of the service.
    Internal,
}

impl ProblemCode {
    /// Every code.
    pub const ALL: [Self; 30] = [
        Self::Unauthorized,
        Self::Forbidden,
        Self::OriginNotAllowed,
        Self::RateLimited,
        Self::RouteNotFound,
        Self::MethodNotAllowed,
        Self::InvalidRequest,
        Self::InvalidOptions,
        Self::MissingFile,
        Self::PayloadTooLarge,
        Self::TooManyFiles,
        Self::UnsupportedMediaType,
        Self::UnsupportedModel,
        Self::UploadTimeout,
        Self::UploadInterrupted,
        Self::JobNotFound,
        Self::JobDeleted,
        Self::JobExpired,
        Self::JobFinished,
        Self::ArtifactNotFound,
        Self::RangeNotSatisfiable,
        Self::IdempotencyKeyInUse,
        Self::IdempotencyKeyReused,
        Self::WebhookNotFound,
        Self::WebhookDisabled,
        Self::TooManyWebhooks,
        Self::QueueFull,
        Self::StorageFull,
        Self::Unavailable,
        Self::Internal,
    ];

    /// The HTTP status, the title, and what to do.
    #[must_use]
    pub fn describe(self) -> (StatusCode, &'static str, &'static str) {
        match self {
            Self::Unauthorized => (
                StatusCode::UNAUTHORIZED,
                "No valid key",
                "Send 'Authorization: Bearer KEY'; the operator makes keys with 'meshmend keys create'.",
            ),
            Self::Forbidden => (
                StatusCode::FORBIDDEN,
                "Not allowed",
                "Use a key with the scope that the detail names; the operator makes them with 'meshmend keys create'.",
            ),
            Self::OriginNotAllowed => (
                StatusCode::FORBIDDEN,
                "Origin not allowed",
                "Ask with a token that was made for this page's origin, by POST /v1/browser-tokens.",
            ),
            Self::RateLimited => (
                StatusCode::TOO_MANY_REQUESTS,
                "Too many requests",
                "Ask again after the seconds that the Retry-After header names, and wait for jobs with ?wait= or events.",
            ),
            Self::RouteNotFound => {
                (StatusCode::NOT_FOUND, "No such address", "See /docs for the addresses that exist.")
            }
            Self::MethodNotAllowed => {
                (StatusCode::METHOD_NOT_ALLOWED, "Method not allowed", "Use a method that the Allow header names.")
            }
            Self::InvalidRequest => {
                (StatusCode::BAD_REQUEST, "Invalid request", "Correct what the detail names and send it again.")
            }
            Self::InvalidOptions => (
                StatusCode::UNPROCESSABLE_ENTITY,
                "Invalid options",
                "Correct the option that the detail names; /docs lists every option with its range.",
            ),
            Self::MissingFile => (
                StatusCode::BAD_REQUEST,
                "No file",
                "Send the model as the form part 'file', or as the whole body of the request.",
            ),
            Self::PayloadTooLarge => (
                StatusCode::PAYLOAD_TOO_LARGE,
                "File too large",
                "Send a smaller file, or files that are smaller together; /v1/capabilities tells the limit.",
            ),
            Self::TooManyFiles => (
                StatusCode::PAYLOAD_TOO_LARGE,
                "Too many files",
                "Send them as several jobs; /v1/capabilities tells the limit.",
            ),
            Self::UnsupportedMediaType => (
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "Unsupported media type",
                "Send multipart/form-data, or the model's bytes with a media type such as application/octet-stream.",
            ),
            Self::UnsupportedModel => (
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "Not a model that can be read",
                "Send STL, OBJ, PLY or OFF; /v1/capabilities lists the formats.",
            ),
            Self::UploadTimeout => (StatusCode::REQUEST_TIMEOUT, "Upload stopped coming", "Send it again."),
            Self::UploadInterrupted => (StatusCode::BAD_REQUEST, "Upload broke off", "Send it again."),
            Self::JobNotFound => {
                (StatusCode::NOT_FOUND, "No such job", "Check the id; it is in the answer to POST /v1/jobs.")
            }
            Self::JobDeleted => (StatusCode::GONE, "Job deleted", "Its files are gone; send the model again."),
            Self::JobExpired => (
                StatusCode::GONE,
                "Results expired",
                "Download results before the job's expires_at; send the model again.",
            ),
            Self::JobFinished => (StatusCode::CONFLICT, "Job has ended", "Nothing is left to cancel."),
            Self::ArtifactNotFound => (
                StatusCode::NOT_FOUND,
                "No such file",
                "The job's 'artifacts' list its files; a job that has not ended has none yet.",
            ),
            Self::RangeNotSatisfiable => (
                StatusCode::RANGE_NOT_SATISFIABLE,
                "Range not satisfiable",
                "The Content-Range header tells the file's size.",
            ),
            Self::IdempotencyKeyInUse => (
                StatusCode::CONFLICT,
                "Request under way",
                "Ask again after the seconds that the Retry-After header names.",
            ),
            Self::IdempotencyKeyReused => (
                StatusCode::UNPROCESSABLE_ENTITY,
                "Idempotency-Key used before",
                "Send a new key with each new request, and the same one only with the same request.",
            ),
            Self::WebhookNotFound => {
                (StatusCode::NOT_FOUND, "No such webhook", "GET /v1/webhook-endpoints lists yours.")
            }
            Self::WebhookDisabled => (
                StatusCode::CONFLICT,
                "Webhook endpoint disabled",
                "Enable it: PATCH /v1/webhook-endpoints/{id} with {\"enabled\": true}.",
            ),
            Self::TooManyWebhooks => {
                (StatusCode::CONFLICT, "Too many webhook endpoints", "Delete one that is not needed any more.")
            }
            Self::QueueFull => (
                StatusCode::TOO_MANY_REQUESTS,
                "Queue full",
                "Send the model again after the seconds that the Retry-After header names.",
            ),
            Self::StorageFull => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Storage full",
                "Send the model again later; the operator has to make room, or to lower --min-free-mib.",
            ),
            Self::Unavailable => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Not available now",
                "Ask again after the seconds that the Retry-After header names.",
            ),
            Self::Internal => (
                StatusCode::INTERNAL_SERVER_ERROR,
                "Internal error",
                "Try again later; if it stays, report it with the request_id.",
            ),
        }
    }

    /// The name in JSON.
    #[must_use]
    pub fn name(self) -> String {
        code_name(&self)
    }
}

pub(super) fn code_name<T: Serialize>(code: &T) -> String {
    match serde_json::to_value(code) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

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
    /// Single errors, where there are several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<String>,
    /// Headers of the answer.
    #[serde(skip)]
    pub(super) headers: Vec<(HeaderName, String)>,
}

/// Seconds to wait while the database does not answer.
const RETRY_AFTER_S: u32 = 5;

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

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        if matches!(error, StoreError::KeyLost) {
            return super::idempotency::in_use();
        }
        if !error.may_pass() {
            return Self::internal(&error);
        }
        tracing::error!(%error, "the database does not answer");
        Self::new(ProblemCode::Unavailable, "The service's database does not answer now. Ask again soon.")
            .retry_after(RETRY_AFTER_S)
    }
}

impl From<BlobError> for Problem {
    fn from(error: BlobError) -> Self {
        Self::internal(&error)
    }
}

impl From<PathRejection> for Problem {
    fn from(rejection: PathRejection) -> Self {
        Self::new(ProblemCode::InvalidRequest, rejection.body_text())
    }
}

impl From<QueryRejection> for Problem {
    fn from(rejection: QueryRejection) -> Self {
        Self::new(ProblemCode::InvalidRequest, rejection.body_text())
    }
}
