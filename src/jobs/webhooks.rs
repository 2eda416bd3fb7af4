//! Who is told of jobs that end: endpoints, the messages for them, and how their deliveries fare.

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

/// How long an endpoint's deliveries may all fail before it is disabled.
pub const FAILING: Duration = Duration::from_secs(5 * 24 * 3600);
/// How many attempts of a delivery are kept, the last ones.
pub const ATTEMPTS_KEPT: usize = 20;

/// What endpoints can be told of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub enum JobEvent {
    /// A job has its result.
    #[serde(rename = "job.succeeded")]
    Succeeded,
    /// A job ended without a result.
    #[serde(rename = "job.failed")]
    Failed,
    /// A job was stopped on request.
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

    /// What happened to a job that is of this status now; none if it has not ended.
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

/// What messages are signed with: `whsec_` and base64.
#[derive(Clone, PartialEq, Eq)]
pub struct SigningSecret(String);

impl SigningSecret {
    /// A secret in its own form.
    #[must_use]
    pub fn new(text: String) -> Self {
        Self(text)
    }

    /// The text, for its owner and for signing.
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

/// A secret, and the one that it took the place of as long as that still signs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Secrets {
    /// The one in force.
    pub current: SigningSecret,
    /// The one before, and when it ends.
    pub previous: Option<(SigningSecret, OffsetDateTime)>,
}

/// An endpoint to make.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewEndpoint {
    /// Whose it is.
    pub tenant: String,
    /// Where it is.
    pub url: String,
    /// What it is for, in its owner's words.
    pub description: String,
    /// What it is told of.
    pub events: Vec<JobEvent>,
    /// What its messages are signed with.
    pub secret: SigningSecret,
}

/// What to change of an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct EndpointChange {
    /// Where it is.
    pub url: Option<String>,
    /// What it is for.
    pub description: Option<String>,
    /// What it is told of.
    pub events: Option<Vec<JobEvent>>,
    /// Whether it is told of anything.
    pub enabled: Option<bool>,
}

/// Somebody who is told of a tenant's jobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Its name: `we_` and a UUID.
    pub id: String,
    /// Where it is.
    pub url: String,
    /// What it is for.
    pub description: String,
    /// What it is told of.
    pub events: Vec<JobEvent>,
    /// What its messages are signed with.
    pub secrets: Secrets,
    /// When it was made.
    pub created_at: OffsetDateTime,
    /// When its deliveries began to fail; none where the last one succeeded.
    pub failing_since: Option<OffsetDateTime>,
    /// When and why it was disabled.
    pub disabled: Option<(OffsetDateTime, String)>,
}

/// How a delivery stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryStatus {
    /// It waits for its next try, or is under way.
    Pending,
    /// The receiver took it.
    Delivered,
    /// It was given up.
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

/// One try to deliver a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DeliveryAttempt {
    /// When it began.
    #[serde(with = "crate::jobs::timestamp")]
    pub at: OffsetDateTime,
    /// The HTTP status that the receiver answered; none if it did not answer.
    pub status: Option<u16>,
    /// Why it was no success.
    pub error: Option<String>,
    /// How long it took, in milliseconds.
    pub milliseconds: u64,
}

/// A message on its way to one receiver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivery {
    /// Its name: `whd_` and a UUID.
    pub id: String,
    /// The message, which is the receiver's `webhook-id`.
    pub message: String,
    /// What the message tells.
    pub kind: String,
    /// The job that it tells of.
    pub job: Option<JobId>,
    /// The endpoint; none where the job named its own address.
    pub endpoint: Option<String>,
    /// The address that the job named.
    pub url: Option<String>,
    /// How it stands.
    pub status: DeliveryStatus,
    /// The last tries, oldest first.
    pub attempts: Vec<DeliveryAttempt>,
    /// When the message was made.
    pub created_at: OffsetDateTime,
    /// When it is tried next, while it waits.
    pub next_at: OffsetDateTime,
}

/// Which deliveries of a tenant to list, newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DeliveryQuery {
    /// Whose.
    pub tenant: String,
    /// Only this one.
    pub id: Option<String>,
    /// Only to this endpoint.
    pub endpoint: Option<String>,
    /// Only of this job.
    pub job: Option<JobId>,
    /// Only older than this one.
    pub before: Option<String>,
    /// At most so many.
    pub limit: u32,
}

/// A delivery to make now, under a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DueDelivery {
    /// Its name.
    pub id: String,
    /// Of this claim alone.
    pub token: String,
    /// Whose it is.
    pub tenant: String,
    /// The endpoint; none where the job named its own address.
    pub endpoint: Option<String>,
    /// Where it goes.
    pub url: String,
    /// The message.
    pub message: String,
    /// The very bytes to send.
    pub payload: String,
    /// What to sign with; none where the tenant has no secret for callbacks yet.
    pub secrets: Option<Secrets>,
    /// Tries since it was made or last asked for again, this one among them.
    pub tries: u32,
    /// The last tries before this one.
    pub attempts: Vec<DeliveryAttempt>,
}

impl DueDelivery {
    /// The last tries with this one.
    pub(super) fn attempts_with(&self, attempt: DeliveryAttempt) -> Vec<DeliveryAttempt> {
        let mut attempts = self.attempts.clone();
        attempts.push(attempt);
        attempts.split_off(attempts.len().saturating_sub(ATTEMPTS_KEPT))
    }
}

/// What follows from a try.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeliveryResult {
    /// The receiver took the message.
    Delivered,
    /// It is to be tried again after this time.
    RetryAfter(Duration),
    /// It is given up.
    Failed,
    /// It is given up, and so is the endpoint: the receiver wants no more.
    Gone,
}

impl DeliveryResult {
    /// How the delivery stands then.
    #[must_use]
    pub fn status(self) -> DeliveryStatus {
        match self {
            Self::Delivered => DeliveryStatus::Delivered,
            Self::RetryAfter(_) => DeliveryStatus::Pending,
            Self::Failed | Self::Gone => DeliveryStatus::Failed,
        }
    }

    /// Why the endpoint is disabled after it, where it is; `long` if nothing was delivered to it for [`FAILING`].
    pub(super) fn ends_endpoint(self, long: bool) -> Option<&'static str> {
        match self {
            Self::Gone => Some("The receiver answered 410: it wants no more."),
            Self::RetryAfter(_) | Self::Failed if long => Some("Every delivery failed for 5 days."),
            Self::Delivered | Self::RetryAfter(_) | Self::Failed => None,
        }
    }
}

/// What waits to be delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Backlog {
    /// Deliveries that are not at their end.
    pub pending: u64,
    /// How long ago the oldest of them was due.
    pub overdue: Duration,
}

impl Backlog {
    /// Of so many deliveries, the oldest due so many milliseconds ago.
    pub(super) fn of(pending: i64, overdue: Option<i64>) -> Self {
        let overdue = overdue.and_then(|overdue| u64::try_from(overdue).ok()).unwrap_or_default();
        Self { pending: pending.unsigned_abs(), overdue: Duration::from_millis(overdue) }
    }
}

/// What is posted to receivers when a job has ended.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookMessage)]
pub struct JobMessage {
    /// What happened.
    r#type: JobEvent,
    /// When it happened.
    #[serde(with = "crate::jobs::timestamp::option")]
    timestamp: Option<OffsetDateTime>,
    /// The job.
    data: JobMessageData,
}

/// A job as receivers are told of it.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookJob)]
struct JobMessageData {
    /// Its name.
    #[schema(value_type = String)]
    id: JobId,
    /// How it ended.
    status: Status,
    /// What became of the model, if the job succeeded, or failed since its result is not what `require` asks for.
    outcome: Option<JobOutcome>,
    /// Whether the result can be printed as it is, or of an analysis every file; none where that is not known.
    printable: Option<bool>,
    /// Signs that the repair destroyed something; the report has them with their measures.
    red_flags: Vec<RedFlagCode>,
    /// Kinds of decisions that the file does not prove; the report has each with its amount and places.
    assumptions: Vec<AssumptionKind>,
    /// When it was accepted.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// When it ended.
    #[serde(with = "crate::jobs::timestamp::option")]
    finished_at: Option<OffsetDateTime>,
    /// The uploaded file; of several the first.
    input: Option<FileMessage>,
    /// Your own notes, as you sent them.
    #[schema(value_type = BTreeMap<String, String>)]
    metadata: Metadata,
    /// The files to download, by name.
    artifacts: BTreeMap<String, ArtifactMessage>,
    /// Why it failed.
    problem: Option<ProblemMessage>,
}

/// An uploaded file as receivers are told of it.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookInput)]
struct FileMessage {
    /// The name it was sent with.
    name: String,
    /// SHA-256 of its bytes, in hexadecimal.
    sha256: String,
}

/// A file to download as receivers are told of it.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookArtifact)]
struct ArtifactMessage {
    /// Its address, relative to the service's.
    href: String,
    /// Its size; left out of a picture that is drawn when it is first asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<u64>,
    /// SHA-256 of its bytes, in hexadecimal; left out of such a picture too.
    #[serde(skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
}

/// Why a job failed as receivers are told of it.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = WebhookProblem)]
struct ProblemMessage {
    /// The code, for programs.
    code: ProblemKind,
    /// What happened and what to do.
    detail: String,
}

impl JobMessage {
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
