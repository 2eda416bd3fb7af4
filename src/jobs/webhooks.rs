//! Webhooks: the endpoints that are notified when jobs end, the messages to them, and the states of the deliveries.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::id::JobId;
use super::job::{Artifact, Job, JobOutcome, Metadata, ProblemKind, Status, StoredReport};
use crate::repair::{AssumptionKind, RedFlagCode};

/// An endpoint is disabled after all its deliveries have failed for this long.
pub const FAILING: Duration = Duration::from_secs(5 * 24 * 3600);
/// How many of a delivery's last attempts are kept.
pub const ATTEMPTS_KEPT: usize = 20;

/// An event that endpoints can subscribe to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub enum JobEvent {
    /// A job succeeded and has its result.
    #[serde(rename = "job.succeeded")]
    Succeeded,
    /// A job ended without a result.
    #[serde(rename = "job.failed")]
    Failed,
    /// A job was canceled on request.
    #[serde(rename = "job.canceled")]
    Canceled,
}

impl JobEvent {
    /// Every event.
    pub const ALL: [Self; 3] = [Self::Succeeded, Self::Failed, Self::Canceled];

    /// The name in messages and in the store.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Succeeded => "job.succeeded",
            Self::Failed => "job.failed",
            Self::Canceled => "job.canceled",
        }
    }

    /// The event of a job that now has this status; `None` if the job has not ended.
    pub(super) fn of(status: Status) -> Option<Self> {
        match status {
            Status::Succeeded => Some(Self::Succeeded),
            Status::Failed => Some(Self::Failed),
            Status::Canceled => Some(Self::Canceled),
            Status::Queued | Status::Running | Status::Expired => None,
        }
    }
}

impl FromStr for JobEvent {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|event| event.as_str() == text).ok_or(())
    }
}

/// A secret that signs messages: `whsec_` and base64.
#[derive(Clone, PartialEq, Eq)]
pub struct SigningSecret(String);

impl SigningSecret {
    /// A secret from its text.
    #[must_use]
    pub fn new(text: String) -> Self {
        Self(text)
    }

    /// The text of the secret.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for SigningSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningSecret(hidden)")
    }
}

/// A secret and, after a rotation, the previous secret while it still signs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Secrets {
    /// The current secret.
    pub current: SigningSecret,
    /// The previous secret and its end.
    pub previous: Option<(SigningSecret, OffsetDateTime)>,
}

/// A webhook endpoint to create.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewEndpoint {
    /// The tenant that owns it.
    pub tenant: String,
    /// The address that receives messages.
    pub url: String,
    /// The tenant's description.
    pub description: String,
    /// The events to which it subscribes.
    pub events: Vec<JobEvent>,
    /// The secret that signs its messages.
    pub secret: SigningSecret,
}

/// The changes to an endpoint; `None` leaves a value unchanged.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct EndpointChange {
    /// The address that receives messages.
    pub url: Option<String>,
    /// The tenant's description.
    pub description: Option<String>,
    /// The events to which it subscribes.
    pub events: Option<Vec<JobEvent>>,
    /// Whether it receives messages.
    pub enabled: Option<bool>,
}

/// A webhook endpoint: an address that is notified of a tenant's jobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Its id: `we_` and a UUID.
    pub id: String,
    /// The address that receives messages.
    pub url: String,
    /// The tenant's description.
    pub description: String,
    /// The events to which it subscribes.
    pub events: Vec<JobEvent>,
    /// The secrets that sign its messages.
    pub secrets: Secrets,
    /// When it was created.
    pub created_at: OffsetDateTime,
    /// When its deliveries began to fail; `None` if the last delivery succeeded.
    pub failing_since: Option<OffsetDateTime>,
    /// When and why it was disabled.
    pub disabled: Option<(OffsetDateTime, String)>,
}

/// The status of a delivery.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryStatus {
    /// The delivery waits for its next attempt, or an attempt is under way.
    Pending,
    /// The receiver accepted the message.
    Delivered,
    /// The delivery failed and is not retried.
    Failed,
}

impl DeliveryStatus {
    const ALL: [Self; 3] = [Self::Pending, Self::Delivered, Self::Failed];

    /// The name in JSON and in the store.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Delivered => "delivered",
            Self::Failed => "failed",
        }
    }
}

impl FromStr for DeliveryStatus {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|status| status.as_str() == text).ok_or(())
    }
}

/// One attempt at a delivery.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DeliveryAttempt {
    /// When the attempt began.
    #[serde(with = "crate::jobs::timestamp")]
    pub at: OffsetDateTime,
    /// The HTTP status of the receiver's response; null without a response.
    pub status: Option<u16>,
    /// Why the attempt failed.
    pub error: Option<String>,
    /// How long the attempt took, in milliseconds.
    pub milliseconds: u64,
}

/// The delivery of a message to one receiver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivery {
    /// Its id: `whd_` and a UUID.
    pub id: String,
    /// The message's id, which the receiver gets as the header `webhook-id`.
    pub message: String,
    /// The message's type: an event or `ping`.
    pub kind: String,
    /// The job that the message is about.
    pub job: Option<JobId>,
    /// The endpoint; `None` for a job's callback address.
    pub endpoint: Option<String>,
    /// The job's callback address; `None` for an endpoint.
    pub url: Option<String>,
    /// The status.
    pub status: DeliveryStatus,
    /// The last attempts, oldest first.
    pub attempts: Vec<DeliveryAttempt>,
    /// When the message was created.
    pub created_at: OffsetDateTime,
    /// When the next attempt is due, while the delivery is pending.
    pub next_at: OffsetDateTime,
}

/// The deliveries of a tenant to list, newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DeliveryQuery {
    /// The tenant.
    pub tenant: String,
    /// Only the delivery with this id.
    pub id: Option<String>,
    /// Only deliveries to this endpoint.
    pub endpoint: Option<String>,
    /// Only deliveries about this job.
    pub job: Option<JobId>,
    /// Only deliveries older than this one.
    pub before: Option<String>,
    /// The most deliveries to list.
    pub limit: u32,
}

/// A claimed delivery, to attempt now under a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DueDelivery {
    /// The delivery's id.
    pub id: String,
    /// The claim's token.
    pub token: String,
    /// The tenant.
    pub tenant: String,
    /// The endpoint; `None` for a job's callback address.
    pub endpoint: Option<String>,
    /// The address to send to.
    pub url: String,
    /// The message's id.
    pub message: String,
    /// The message's body, to send byte for byte.
    pub payload: String,
    /// The secrets that sign the message; `None` if the tenant has no callback secret yet.
    pub secrets: Option<Secrets>,
    /// The number of attempts since the delivery was created or last requested again, with this one.
    pub tries: u32,
    /// The last attempts before this one.
    pub attempts: Vec<DeliveryAttempt>,
}

impl DueDelivery {
    /// The last attempts, with this one.
    pub(super) fn attempts_with(&self, attempt: DeliveryAttempt) -> Vec<DeliveryAttempt> {
        let mut attempts = self.attempts.clone();
        attempts.push(attempt);
        attempts.split_off(attempts.len().saturating_sub(ATTEMPTS_KEPT))
    }
}

/// The result of an attempt at a delivery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeliveryResult {
    /// The receiver accepted the message.
    Delivered,
    /// The attempt failed; the next one is due after this time.
    RetryAfter(Duration),
    /// The attempt failed, and the delivery is not retried.
    Failed,
    /// The receiver is gone: the delivery is not retried, and the endpoint is disabled.
    Gone,
}

impl DeliveryResult {
    /// The delivery's status after this result.
    #[must_use]
    pub fn status(self) -> DeliveryStatus {
        match self {
            Self::Delivered => DeliveryStatus::Delivered,
            Self::RetryAfter(_) => DeliveryStatus::Pending,
            Self::Failed | Self::Gone => DeliveryStatus::Failed,
        }
    }

    /// The reason to disable the endpoint after this result, if any. `is_failing_long` says that no delivery to the endpoint has
    /// succeeded for [`FAILING`].
    pub(super) fn disable_reason(self, is_failing_long: bool) -> Option<&'static str> {
        match self {
            Self::Gone => Some("The receiver responded with status 410 (Gone)."),
            Self::RetryAfter(_) | Self::Failed if is_failing_long => Some("All deliveries failed for 5 days."),
            Self::Delivered | Self::RetryAfter(_) | Self::Failed => None,
        }
    }
}

/// The pending deliveries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Backlog {
    /// The number of pending deliveries.
    pub pending: u64,
    /// How long the oldest of them has been due.
    pub overdue: Duration,
}

impl Backlog {
    /// From the number of pending deliveries, and the milliseconds since the oldest was due.
    pub(super) fn of(pending: i64, overdue: Option<i64>) -> Self {
        let overdue = overdue.and_then(|overdue| u64::try_from(overdue).ok()).unwrap_or_default();
        Self { pending: pending.unsigned_abs(), overdue: Duration::from_millis(overdue) }
    }
}

/// The webhook message that receivers get when a job has ended.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookMessage)]
pub struct JobMessage {
    /// The event.
    r#type: JobEvent,
    /// When the event happened.
    #[serde(with = "crate::jobs::timestamp::option")]
    timestamp: Option<OffsetDateTime>,
    /// The job.
    data: JobMessageData,
}

/// A job in a webhook message.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookJob)]
struct JobMessageData {
    /// The job's id.
    #[schema(value_type = String)]
    id: JobId,
    /// The job's status at its end.
    status: Status,
    /// The job's outcome, if it succeeded, or if it failed because the result lacks what `require` demands.
    outcome: Option<JobOutcome>,
    /// Whether the offered file, or every file of an analysis, is printable; null if unknown.
    printable: Option<bool>,
    /// Whether the returned file, or every file of an analysis, meets the rules of the process; null without the option `process`.
    print_ready: Option<bool>,
    /// Codes of the red flags: signs that the repair destroyed something. The report has their measures.
    red_flags: Vec<RedFlagCode>,
    /// Kinds of the assumptions that the file does not prove. The report has the amount and the places of each.
    assumptions: Vec<AssumptionKind>,
    /// When the job was accepted.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// When the job ended.
    #[serde(with = "crate::jobs::timestamp::option")]
    finished_at: Option<OffsetDateTime>,
    /// The uploaded file, or the first of several.
    input: Option<FileMessage>,
    /// Your metadata, unchanged.
    #[schema(value_type = BTreeMap<String, String>)]
    metadata: Metadata,
    /// The result files, by name.
    artifacts: BTreeMap<String, ArtifactMessage>,
    /// Why the job failed.
    problem: Option<ProblemMessage>,
}

/// An uploaded file in a webhook message.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookInput)]
struct FileMessage {
    /// The file name that the client sent.
    name: String,
    /// SHA-256 of the bytes, in hexadecimal.
    sha256: String,
}

/// A result file in a webhook message.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookArtifact)]
struct ArtifactMessage {
    /// The download address, relative to the service's address.
    href: String,
    /// The size in bytes; absent for a picture, which is drawn at the first request.
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<u64>,
    /// SHA-256 of the bytes, in hexadecimal; absent for a picture that is not drawn yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
}

/// Why a job failed, in a webhook message.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookProblem)]
struct ProblemMessage {
    /// The problem's code, for programs.
    code: ProblemKind,
    /// What happened and what to do, as text.
    detail: String,
}

impl JobMessage {
    /// The message about this event of `job`.
    pub(super) fn new(event: JobEvent, job: &Job) -> Self {
        let input = job.inputs.first();
        let input = input.map(|input| FileMessage { name: input.name.clone(), sha256: input.sha256.clone() });
        let link = |(name, artifact): (&String, &Artifact)| {
            let href = format!("/v1/jobs/{}/artifacts/{name}", job.id);
            let file = artifact.file.as_ref();
            let (bytes, sha256) = (file.map(|file| file.bytes), file.map(|file| file.sha256.clone()));
            (name.clone(), ArtifactMessage { href, bytes, sha256 })
        };
        let problem = job.problem.as_ref();
        let (red_flags, assumptions) = job.report.as_ref().map(StoredReport::remarks).unwrap_or_default();
        let data = JobMessageData {
            id: job.id,
            status: job.status,
            outcome: job.outcome,
            printable: job.outcome.and_then(JobOutcome::is_printable),
            print_ready: job.report.as_ref().and_then(StoredReport::print_ready),
            red_flags,
            assumptions,
            created_at: job.created_at,
            finished_at: job.finished_at,
            input,
            metadata: job.metadata.clone(),
            artifacts: job.artifacts.iter().map(link).collect(),
            problem: problem.map(|problem| ProblemMessage { code: problem.code, detail: problem.detail.clone() }),
        };
        Self { r#type: event, timestamp: job.finished_at, data }
    }
}
