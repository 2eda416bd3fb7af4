use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::jobs::ProblemKind;

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
    /// No upload of that name, or its time is over.
    UploadNotFound,
    /// The upload's file was not sent yet.
    UploadMissing,
    /// The upload has its file already, or a job was made of it.
    UploadUsed,
    /// No job of that name.
    JobNotFound,
    /// The job was deleted on request.
    JobDeleted,
    /// The job's results were kept as long as they are, and are gone.
    JobExpired,
    /// The job has ended, so it can't be canceled.
    JobFinished,
    /// The job has no such file, or not yet.
    ArtifactNotFound,
    /// The job's pictures are still being drawn.
    NotDrawnYet,
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
    /// No API key of that id.
    KeyNotFound,
    /// No tenant of that name has a key or settings.
    TenantNotFound,
    /// As many jobs wait as may.
    QueueFull,
    /// The disk has no room for more files.
    StorageFull,
    /// The database or the file store does not answer now.
    Unavailable,
    /// A fault of the service.
    Internal,
}

impl ProblemCode {
    /// Every code.
    pub const ALL: [Self; 36] = [
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
        Self::UploadNotFound,
        Self::UploadMissing,
        Self::UploadUsed,
        Self::JobNotFound,
        Self::JobDeleted,
        Self::JobExpired,
        Self::JobFinished,
        Self::ArtifactNotFound,
        Self::NotDrawnYet,
        Self::RangeNotSatisfiable,
        Self::IdempotencyKeyInUse,
        Self::IdempotencyKeyReused,
        Self::WebhookNotFound,
        Self::WebhookDisabled,
        Self::TooManyWebhooks,
        Self::KeyNotFound,
        Self::TenantNotFound,
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
                "Send what the detail names; for a job, a form, the model's bytes, or JSON that names an upload.",
            ),
            Self::UnsupportedModel => (
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "Not a model that can be read",
                "Send a format that /v1/capabilities lists; the detail says what was found.",
            ),
            Self::UploadTimeout => (StatusCode::REQUEST_TIMEOUT, "Upload stopped coming", "Send it again."),
            Self::UploadInterrupted => (StatusCode::BAD_REQUEST, "Upload broke off", "Send it again."),
            Self::UploadNotFound => {
                (StatusCode::NOT_FOUND, "No such upload", "Announce it anew: POST /v1/uploads, then send the file.")
            }
            Self::UploadMissing => (
                StatusCode::CONFLICT,
                "Upload not sent yet",
                "Send the file as the upload's 'put' says, then ask again.",
            ),
            Self::UploadUsed => (
                StatusCode::CONFLICT,
                "Upload used before",
                "Announce another one: POST /v1/uploads, then send the file.",
            ),
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
            Self::NotDrawnYet => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Pictures still being drawn",
                "Ask again after the seconds that the Retry-After header names.",
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
            Self::KeyNotFound => (StatusCode::NOT_FOUND, "No such API key", "GET /v1/keys lists the keys."),
            Self::TenantNotFound => (
                StatusCode::NOT_FOUND,
                "No such tenant",
                "GET /v1/tenants lists the tenants; PATCH /v1/tenants/{id} or a first key makes one.",
            ),
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

/// The name of a code in JSON.
fn code_name<T: Serialize>(code: &T) -> String {
    match serde_json::to_value(code) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// A code with its meaning, for the documentation.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProblemDoc {
    /// The code.
    pub code: String,
    /// The title.
    pub title: &'static str,
    /// The HTTP status of a response with it; none for a problem of a job.
    pub status: Option<u16>,
    /// What to do.
    pub advice: &'static str,
}

/// The title of a job's problem, and what to do.
#[must_use]
pub fn describe_job_problem(kind: ProblemKind) -> (&'static str, &'static str) {
    match kind {
        ProblemKind::BadInput => ("The file can't be read", "Export the model again; the detail names what and where."),
        ProblemKind::BadOutput => ("The result can't be written", "Ask for another output format."),
        ProblemKind::NotPrintable => (
            "Not printable",
            "The report says what is left: repair that where the model was made, or send it with require=any for the best result there is.",
        ),
        ProblemKind::DeadlineExceeded => {
            ("Out of time", "Raise deadline_s, lower max_tier or level, or send fewer faces.")
        }
        ProblemKind::OutOfMemory => ("Out of memory", "Send fewer faces, or raise the service's --job-memory."),
        ProblemKind::CpuLimit => ("Out of processor time", "Send fewer faces, or lower max_tier or level."),
        ProblemKind::FileLimit => ("Result too large", "Ask for less: a smaller voxel_resolution, or fewer places."),
        ProblemKind::Crashed => ("The job crashed", "A fault of the service: report it with the job's log."),
        ProblemKind::WorkerLost => ("Set aside", "Workers were lost with this job: report it with the model."),
        ProblemKind::Internal => ("Internal error", "Try again later; if it stays, report it with the job's id."),
    }
}

/// Every problem of requests and of jobs.
#[must_use]
pub fn catalogue() -> Vec<ProblemDoc> {
    const KINDS: [ProblemKind; 10] = [
        ProblemKind::BadInput,
        ProblemKind::BadOutput,
        ProblemKind::NotPrintable,
        ProblemKind::DeadlineExceeded,
        ProblemKind::OutOfMemory,
        ProblemKind::CpuLimit,
        ProblemKind::FileLimit,
        ProblemKind::Crashed,
        ProblemKind::WorkerLost,
        ProblemKind::Internal,
    ];
    let mut docs: Vec<ProblemDoc> = ProblemCode::ALL
        .into_iter()
        .map(|code| {
            let (status, title, advice) = code.describe();
            ProblemDoc { code: code.name(), title, status: Some(status.as_u16()), advice }
        })
        .collect();
    for kind in KINDS {
        let code = code_name(&kind);
        if docs.iter().all(|doc| doc.code != code) {
            let (title, advice) = describe_job_problem(kind);
            docs.push(ProblemDoc { code, title, status: None, advice });
        }
    }
    docs
}
