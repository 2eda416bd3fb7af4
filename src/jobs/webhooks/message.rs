use std::collections::BTreeMap;

use serde::Serialize;
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::row::read_events;
use super::{JobEvent, new_id};
use crate::jobs::row::to_json;
use crate::jobs::{Job, JobId, JobOutcome, Metadata, ProblemKind, Status, StoredReport};
use crate::repair::{AssumptionKind, RedFlagCode};

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

/// A message that only asks whether it arrives.
#[derive(Serialize)]
struct Ping<'a> {
    r#type: &'static str,
    #[serde(with = "crate::jobs::timestamp")]
    timestamp: OffsetDateTime,
    data: PingData<'a>,
}

#[derive(Serialize)]
struct PingData<'a> {
    endpoint: &'a str,
}

impl JobMessage {
    fn new(event: JobEvent, job: &Job) -> Self {
        let input = job.inputs.first();
        let input = input.map(|input| FileMessage { name: input.name.clone(), sha256: input.sha256.clone() });
        let link = |(name, artifact): (&String, &crate::jobs::Artifact)| {
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

/// What receivers are told, as it is kept.
pub(in crate::jobs) struct Message {
    /// Its name: `msg_` and a UUID.
    pub id: String,
    /// The job that it tells of.
    pub job: Option<JobId>,
    /// What it tells.
    pub kind: &'static str,
    /// The very bytes to send.
    pub payload: String,
}

impl Message {
    /// That a job has ended.
    pub fn of_job(event: JobEvent, job: &Job) -> Self {
        let payload = to_json(&JobMessage::new(event, job));
        Self { id: new_id("msg"), job: Some(job.id), kind: event.as_str(), payload }
    }

    /// A test of an endpoint.
    pub fn ping(endpoint: &str, now: OffsetDateTime) -> Self {
        let kind = "ping";
        let payload = to_json(&Ping { r#type: kind, timestamp: now, data: PingData { endpoint } });
        Self { id: new_id("msg"), job: None, kind, payload }
    }
}

/// Who gets a message: an endpoint, or an address that a job named.
#[derive(Default)]
pub(in crate::jobs) struct Receiver<'a> {
    pub endpoint: Option<&'a str>,
    pub url: Option<&'a str>,
}

impl<'a> Receiver<'a> {
    /// Everybody who is to be told of a job, of the tenant's endpoints with the events they are told of.
    pub fn of_job(event: JobEvent, job: &'a Job, endpoints: &'a [(String, String)]) -> Vec<Self> {
        let told = endpoints.iter().filter(|(_, events)| read_events(events).any(|it| it == event));
        let told = told.map(|(id, _)| Self { endpoint: Some(id), url: None });
        told.chain(job.callback_url.as_deref().map(|url| Self { endpoint: None, url: Some(url) })).collect()
    }
}
