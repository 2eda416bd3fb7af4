//! The error codes of the API: HTTP status, title and advice of each, and the catalogue behind `/problems`.
//!
//! `docs/problems.md` and the OpenAPI document are made from this table.
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::jobs::ProblemKind;

/// Defines [`ProblemCode`] with each code's HTTP status, title and advice.
macro_rules! problem_codes {
    ($($(#[$doc:meta])* $code:ident: $status:ident, $title:literal, $advice:literal;)*) => {
        /// The code of a failed request, for programs.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum ProblemCode {
            $($(#[$doc])* $code,)*
        }

        impl ProblemCode {
            /// Every code.
            pub const ALL: [Self; 39] = [$(Self::$code,)*];

            /// Returns the HTTP status, the title and the advice on what to do.
            #[must_use]
            pub fn describe(self) -> (StatusCode, &'static str, &'static str) {
                match self {
                    $(Self::$code => (StatusCode::$status, $title, $advice),)*
                }
            }
        }
    };
}

problem_codes! {
    /// The API key is missing or invalid.
    Unauthorized: UNAUTHORIZED, "Missing or invalid API key",
        "Send 'Authorization: Bearer KEY' with a valid key. The operator creates keys with 'meshmend keys create'.";
    /// The API key lacks the scope that this request needs.
    Forbidden: FORBIDDEN, "Missing scope",
        "Use a key with the scope that the detail names. The operator creates keys with 'meshmend keys create'.";
    /// A web page of this origin may not send the request.
    OriginNotAllowed: FORBIDDEN, "Origin not allowed",
        "Send a token created for this page's origin with POST /v1/browser-tokens.";
    /// The tenant sent too many requests.
    RateLimited: TOO_MANY_REQUESTS, "Too many requests",
        "Retry after the number of seconds in the Retry-After header. Wait for jobs with ?wait= or events instead of polling.";
    /// No route has this path.
    RouteNotFound: NOT_FOUND, "Path not found", "See /docs for the paths that exist.";
    /// The path does not support this method.
    MethodNotAllowed: METHOD_NOT_ALLOWED, "Method not allowed", "Use a method listed in the Allow header.";
    /// The path, query, headers or body are malformed.
    InvalidRequest: BAD_REQUEST, "Invalid request", "Correct what the detail names, then send the request again.";
    /// An option or field is unknown or out of range.
    InvalidOptions: UNPROCESSABLE_ENTITY, "Invalid options",
        "Correct the option that the detail names. /docs/options lists every option with its range.";
    /// The request has no file, or the file is empty.
    MissingFile: BAD_REQUEST, "No file",
        "Send the model as the form part 'file', or as the whole request body.";
    /// The file, or all files of the job together, exceed the size limit.
    PayloadTooLarge: PAYLOAD_TOO_LARGE, "File too large",
        "Send smaller files. GET /v1/capabilities returns the limit, which applies to all files of a job together.";
    /// The upload has more files than one job may have.
    TooManyFiles: PAYLOAD_TOO_LARGE, "Too many files",
        "Send the files as several jobs. GET /v1/capabilities returns the limit.";
    /// The body's media type is not supported at this path.
    UnsupportedMediaType: UNSUPPORTED_MEDIA_TYPE, "Unsupported media type",
        "Send a media type that the detail names. For a job, send a form, the model's bytes, or JSON that names an upload.";
    /// The file's format is not recognised.
    UnsupportedModel: UNSUPPORTED_MEDIA_TYPE, "Unsupported model format",
        "Send a format listed by GET /v1/capabilities. The detail says what the file contains.";
    /// No bytes of the upload arrived for too long.
    UploadTimeout: REQUEST_TIMEOUT, "Upload timed out", "Send the upload again.";
    /// The connection broke before the upload was complete.
    UploadInterrupted: BAD_REQUEST, "Upload interrupted", "Send the upload again.";
    /// No upload has this id, or the upload has expired.
    UploadNotFound: NOT_FOUND, "Upload not found", "Create an upload with POST /v1/uploads, then send the file.";
    /// The upload's file has not been sent yet.
    UploadMissing: CONFLICT, "Upload has no file yet",
        "Send the file as the upload's 'put' describes, then repeat this request.";
    /// The upload already has a file, or a job already used it.
    UploadUsed: CONFLICT, "Upload already used", "Create a new upload with POST /v1/uploads, then send the file.";
    /// No job has this id.
    JobNotFound: NOT_FOUND, "Job not found", "Check the id. The response to POST /v1/jobs contains it.";
    /// The job was deleted on request.
    JobDeleted: GONE, "Job deleted", "The job's files are gone. Send the model again.";
    /// The job's files have expired.
    JobExpired: GONE, "Results expired", "Download results before the job's `expires_at`. Send the model again.";
    /// The job has already ended, so it can't be canceled.
    JobFinished: CONFLICT, "Job already finished", "No action is needed: a finished job can't be canceled.";
    /// The job has no file of this name, or not yet.
    ArtifactNotFound: NOT_FOUND, "Artifact not found",
        "The job's 'artifacts' lists its files. A job has none until it has finished.";
    /// The job's images are still being rendered.
    NotDrawnYet: SERVICE_UNAVAILABLE, "Images not ready yet",
        "Retry after the number of seconds in the Retry-After header.";
    /// The requested range lies outside the file.
    RangeNotSatisfiable: RANGE_NOT_SATISFIABLE, "Range not satisfiable",
        "Request a range within the file. The Content-Range header gives the file's size.";
    /// Another request with the same Idempotency-Key is in progress.
    IdempotencyKeyInUse: CONFLICT, "Request in progress",
        "Retry after the number of seconds in the Retry-After header.";
    /// The Idempotency-Key was already used with a different request.
    IdempotencyKeyReused: UNPROCESSABLE_ENTITY, "Idempotency-Key already used",
        "Use a new key for each new request. Reuse a key only to retry the same request.";
    /// No webhook endpoint or delivery has this id.
    WebhookNotFound: NOT_FOUND, "Webhook not found", "GET /v1/webhook-endpoints lists your endpoints.";
    /// The webhook endpoint is disabled.
    WebhookDisabled: CONFLICT, "Webhook endpoint disabled",
        "Enable the endpoint: PATCH /v1/webhook-endpoints/{id} with {\"enabled\": true}.";
    /// The tenant has the maximum number of webhook endpoints.
    TooManyWebhooks: CONFLICT, "Too many webhook endpoints", "Delete an endpoint that is no longer needed.";
    /// No process profile has this name.
    ProfileNotFound: NOT_FOUND, "Process profile not found", "GET /v1/profiles lists the profiles.";
    /// The tenant has the maximum number of process profiles.
    TooManyProfiles: CONFLICT, "Too many process profiles", "Delete a profile that is no longer needed.";
    /// The resource does not match If-Match or If-None-Match.
    PreconditionFailed: PRECONDITION_FAILED, "Precondition failed",
        "Get the resource again, and repeat the change with its new ETag.";
    /// No API key has this id.
    KeyNotFound: NOT_FOUND, "API key not found", "GET /v1/keys lists the keys.";
    /// No tenant of this name has a key or settings.
    TenantNotFound: NOT_FOUND, "Tenant not found",
        "GET /v1/tenants lists the tenants. PATCH /v1/tenants/{id} or a first key creates one.";
    /// The queue has the maximum number of waiting jobs.
    QueueFull: TOO_MANY_REQUESTS, "Queue full",
        "Send the model again after the number of seconds in the Retry-After header.";
    /// The disk is full.
    StorageFull: SERVICE_UNAVAILABLE, "Storage full",
        "Send the model again later. The operator must free disk space or lower --min-free-mib.";
    /// The database or the file store is temporarily unavailable.
    Unavailable: SERVICE_UNAVAILABLE, "Service unavailable",
        "Retry after the number of seconds in the Retry-After header.";
    /// The service failed unexpectedly.
    Internal: INTERNAL_SERVER_ERROR, "Internal error", "Retry later. If the error persists, report it with the `request_id`.";
}

impl ProblemCode {
    /// Returns the code as it appears in JSON.
    #[must_use]
    pub fn name(self) -> String {
        code_name(&self)
    }
}

/// Returns a code as it appears in JSON.
fn code_name<T: Serialize>(code: &T) -> String {
    match serde_json::to_value(code) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// An error code with its meaning, for the documentation.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProblemDoc {
    /// The code, as in a problem's `code`.
    pub code: String,
    /// The title: a short description of the error.
    pub title: &'static str,
    /// The HTTP status of a response with this code. `null` for a code that only jobs have.
    pub status: Option<u16>,
    /// What the caller should do.
    pub advice: &'static str,
}

/// Returns the title of a failed job's problem, and the advice on what to do.
#[must_use]
pub fn describe_job_problem(kind: ProblemKind) -> (&'static str, &'static str) {
    match kind {
        ProblemKind::BadInput => {
            ("Unreadable file", "Export the model again. The detail says what is wrong and where.")
        }
        ProblemKind::BadOutput => ("Result can't be written", "Choose another output format."),
        ProblemKind::NotPrintable => (
            "Not printable",
            "The report lists the remaining defects. Fix them in the modelling program, or submit with require=any for the best result.",
        ),
        ProblemKind::NotPrintReady => (
            "Not print ready",
            "The report's `print_ready` lists the failed rules with their remedies. Mend the model, choose another process, or submit with require=any.",
        ),
        ProblemKind::DeadlineExceeded => {
            ("Deadline exceeded", "Raise `deadline_s`, lower `max_tier` or `level`, or send fewer faces.")
        }
        ProblemKind::OutOfMemory => ("Out of memory", "Send fewer faces, or raise the service's `--job-memory-mib`."),
        ProblemKind::CpuLimit => ("CPU limit exceeded", "Send fewer faces, or lower `max_tier` or `level`."),
        ProblemKind::FileLimit => ("Result too large", "Lower `voxel_resolution` or `places`."),
        ProblemKind::Crashed => {
            ("Job crashed", "The fault lies with the service, not the model. Report it with the job's log.")
        }
        ProblemKind::WorkerLost => {
            ("Job abandoned", "Several workers were lost while they ran this job. Report it with the model.")
        }
        ProblemKind::Internal => ("Internal error", "Retry later. If the error persists, report it with the job's id."),
    }
}

/// Returns the codes of failed requests and of failed jobs, each once.
#[must_use]
pub fn catalogue() -> Vec<ProblemDoc> {
    const KINDS: [ProblemKind; 11] = [
        ProblemKind::BadInput,
        ProblemKind::BadOutput,
        ProblemKind::NotPrintable,
        ProblemKind::NotPrintReady,
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
