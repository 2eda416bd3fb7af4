use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::jobs::ProblemKind;

/// Defines the codes with their HTTP status, their title, and what to do.
macro_rules! problem_codes {
    ($($(#[$doc:meta])* $code:ident: $status:ident, $title:literal, $advice:literal;)*) => {
        /// Every problem that a request can meet, for programs.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum ProblemCode {
            $($(#[$doc])* $code,)*
        }

        impl ProblemCode {
            /// Every code.
            pub const ALL: [Self; 36] = [$(Self::$code,)*];

            /// The HTTP status, the title, and what to do.
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
    /// No key, or one that is worth nothing.
    Unauthorized: UNAUTHORIZED, "No valid key",
        "Send 'Authorization: Bearer KEY'; the operator makes keys with 'meshmend keys create'.";
    /// The key does not allow this.
    Forbidden: FORBIDDEN, "Not allowed",
        "Use a key with the scope that the detail names; the operator makes them with 'meshmend keys create'.";
    /// A page of an origin that may not ask.
    OriginNotAllowed: FORBIDDEN, "Origin not allowed",
        "Ask with a token that was made for this page's origin, by POST /v1/browser-tokens.";
    /// The tenant asked too often.
    RateLimited: TOO_MANY_REQUESTS, "Too many requests",
        "Ask again after the seconds that the Retry-After header names, and wait for jobs with ?wait= or events.";
    /// No such address.
    RouteNotFound: NOT_FOUND, "No such address", "See /docs for the addresses that exist.";
    /// The address exists, but not for this method.
    MethodNotAllowed: METHOD_NOT_ALLOWED, "Method not allowed", "Use a method that the Allow header names.";
    /// A path, query or form that can't be understood.
    InvalidRequest: BAD_REQUEST, "Invalid request", "Correct what the detail names and send it again.";
    /// An option that is unknown or out of its range.
    InvalidOptions: UNPROCESSABLE_ENTITY, "Invalid options",
        "Correct the option that the detail names; /docs lists every option with its range.";
    /// No file, or an empty one.
    MissingFile: BAD_REQUEST, "No file", "Send the model as the form part 'file', or as the whole body of the request.";
    /// The file, or all files of a job together, are larger than the service takes.
    PayloadTooLarge: PAYLOAD_TOO_LARGE, "File too large",
        "Send a smaller file, or files that are smaller together; /v1/capabilities tells the limit.";
    /// The upload has more files than one job may have.
    TooManyFiles: PAYLOAD_TOO_LARGE, "Too many files", "Send them as several jobs; /v1/capabilities tells the limit.";
    /// The body's media type is not one that this address takes.
    UnsupportedMediaType: UNSUPPORTED_MEDIA_TYPE, "Unsupported media type",
        "Send what the detail names; for a job, a form, the model's bytes, or JSON that names an upload.";
    /// The file's bytes are of no format that can be read.
    UnsupportedModel: UNSUPPORTED_MEDIA_TYPE, "Not a model that can be read",
        "Send a format that /v1/capabilities lists; the detail says what was found.";
    /// The upload stopped coming.
    UploadTimeout: REQUEST_TIMEOUT, "Upload stopped coming", "Send it again.";
    /// The upload broke off.
    UploadInterrupted: BAD_REQUEST, "Upload broke off", "Send it again.";
    /// No upload of that name, or its time is over.
    UploadNotFound: NOT_FOUND, "No such upload", "Announce it anew: POST /v1/uploads, then send the file.";
    /// The upload's file was not sent yet.
    UploadMissing: CONFLICT, "Upload not sent yet", "Send the file as the upload's 'put' says, then ask again.";
    /// The upload has its file already, or a job was made of it.
    UploadUsed: CONFLICT, "Upload used before", "Announce another one: POST /v1/uploads, then send the file.";
    /// No job of that name.
    JobNotFound: NOT_FOUND, "No such job", "Check the id; it is in the answer to POST /v1/jobs.";
    /// The job was deleted on request.
    JobDeleted: GONE, "Job deleted", "Its files are gone; send the model again.";
    /// The job's results were kept as long as they are, and are gone.
    JobExpired: GONE, "Results expired", "Download results before the job's expires_at; send the model again.";
    /// The job has ended, so it can't be canceled.
    JobFinished: CONFLICT, "Job has ended", "Nothing is left to cancel.";
    /// The job has no such file, or not yet.
    ArtifactNotFound: NOT_FOUND, "No such file",
        "The job's 'artifacts' list its files; a job that has not ended has none yet.";
    /// The job's pictures are still being drawn.
    NotDrawnYet: SERVICE_UNAVAILABLE, "Pictures still being drawn",
        "Ask again after the seconds that the Retry-After header names.";
    /// The range lies outside the file.
    RangeNotSatisfiable: RANGE_NOT_SATISFIABLE, "Range not satisfiable",
        "The Content-Range header tells the file's size.";
    /// A request with the same Idempotency-Key is under way.
    IdempotencyKeyInUse: CONFLICT, "Request under way",
        "Ask again after the seconds that the Retry-After header names.";
    /// The Idempotency-Key came with another request before.
    IdempotencyKeyReused: UNPROCESSABLE_ENTITY, "Idempotency-Key used before",
        "Send a new key with each new request, and the same one only with the same request.";
    /// No webhook endpoint or delivery of that name.
    WebhookNotFound: NOT_FOUND, "No such webhook", "GET /v1/webhook-endpoints lists yours.";
    /// The webhook endpoint is disabled.
    WebhookDisabled: CONFLICT, "Webhook endpoint disabled",
        "Enable it: PATCH /v1/webhook-endpoints/{id} with {\"enabled\": true}.";
    /// The tenant has as many webhook endpoints as it may.
    TooManyWebhooks: CONFLICT, "Too many webhook endpoints", "Delete one that is not needed any more.";
    /// No API key of that id.
    KeyNotFound: NOT_FOUND, "No such API key", "GET /v1/keys lists the keys.";
    /// No tenant of that name has a key or settings.
    TenantNotFound: NOT_FOUND, "No such tenant",
        "GET /v1/tenants lists the tenants; PATCH /v1/tenants/{id} or a first key makes one.";
    /// As many jobs wait as may.
    QueueFull: TOO_MANY_REQUESTS, "Queue full",
        "Send the model again after the seconds that the Retry-After header names.";
    /// The disk has no room for more files.
    StorageFull: SERVICE_UNAVAILABLE, "Storage full",
        "Send the model again later; the operator has to make room, or to lower --min-free-mib.";
    /// The database or the file store does not answer now.
    Unavailable: SERVICE_UNAVAILABLE, "Not available now",
        "Ask again after the seconds that the Retry-After header names.";
    /// A fault of the service.
    Internal: INTERNAL_SERVER_ERROR, "Internal error", "Try again later; if it stays, report it with the request_id.";
}

impl ProblemCode {
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
