use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::row::read_events;
use super::{JobEvent, new_id};
use crate::jobs::{Job, JobId};

/// What receivers are told.
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
    /// That a job has ended. Its addresses are relative to the service's, as everywhere.
    pub fn of_job(event: JobEvent, job: &Job) -> Self {
        let input = job.inputs.first().map(|input| json!({"name": input.name, "sha256": input.sha256}));
        let link = |(name, file): (&String, &crate::jobs::Artifact)| {
            let href = format!("/v1/jobs/{}/artifacts/{name}", job.id);
            (name.clone(), json!({"href": href, "bytes": file.bytes, "sha256": file.sha256}))
        };
        let problem = job.problem.as_ref().map(|problem| json!({"code": problem.code, "detail": problem.detail}));
        let data = json!({
            "id": job.id,
            "status": job.status,
            "outcome": job.outcome,
            "created_at": text(Some(job.created_at)),
            "finished_at": text(job.finished_at),
            "input": input,
            "metadata": job.metadata,
            "artifacts": job.artifacts.iter().map(link).collect::<serde_json::Map<_, _>>(),
            "problem": problem,
        });
        Self::new(event.as_str(), Some(job.id), job.finished_at, &data)
    }

    /// A message that only asks whether it arrives.
    pub fn ping(endpoint: &str, now: OffsetDateTime) -> Self {
        Self::new("ping", None, Some(now), &json!({"endpoint": endpoint}))
    }

    fn new(kind: &'static str, job: Option<JobId>, at: Option<OffsetDateTime>, data: &Value) -> Self {
        let payload = json!({"type": kind, "timestamp": text(at), "data": data}).to_string();
        Self { id: new_id("msg"), job, kind, payload }
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

fn text(time: Option<OffsetDateTime>) -> Option<String> {
    time.and_then(|time| time.format(&Rfc3339).ok())
}
