//! One job: how requests find it and wait for its changes, and its JSON representation.

use std::collections::BTreeMap;
use std::time::Duration;

use axum::Json;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Map, Value};
use time::OffsetDateTime;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use utoipa::ToSchema;

use super::authenticate::Caller;
use super::extract::ApiPath;
use super::problem::{Problem, ProblemCode, truncated};
use super::problem_code::describe_job_problem;
use super::state::ApiState;
use crate::context::{Estimate, Stage};
use crate::format::{FileLocation, Format};
use crate::jobs::{
    Artifact, Input, Job, JobId, JobOptions, JobOutcome, JobReport, Metadata, ProblemKind, Quote, Status, StoreError,
    StoredReport,
};
use crate::repair::Alternatives;
use crate::scene::{LengthUnit, Unit, UnitSource};

/// Parses the id of a job in a path or query. A malformed id is answered like an unknown one.
pub(super) fn job_id(text: &str) -> Result<JobId, Problem> {
    text.parse().map_err(|error| {
        Problem::new(ProblemCode::JobNotFound, format!("There is no job '{}': {error}.", truncated(text)))
    })
}

/// Returns the job with this id.
///
/// # Errors
/// `job_not_found` if the job does not exist or is not visible to the caller; `job_deleted` if it was deleted.
pub(super) async fn find_job(state: &ApiState, caller: &Caller, id: JobId) -> Result<Job, Problem> {
    match state.store.get(id).await?.filter(|job| caller.sees(job)) {
        None => Err(Problem::new(ProblemCode::JobNotFound, format!("There is no job '{id}'."))),
        Some(job) if job.purged => Err(Problem::new(ProblemCode::JobDeleted, format!("The job '{id}' was deleted."))),
        Some(job) => Ok(job),
    }
}

/// Axum's path extractor for the id of a job.
pub(super) struct PathJobId(pub JobId);

impl FromRequestParts<ApiState> for PathJobId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ApiState) -> Result<Self, Problem> {
        let ApiPath(id) = ApiPath::<String>::from_request_parts(parts, state).await?;
        job_id(&id).map(Self)
    }
}

/// Waits for changes of one job. The notifier reports changes; polling covers changes by other processes that the notifier misses.
pub(super) struct JobWatcher {
    state: ApiState,
    id: JobId,
    changes: Receiver<JobId>,
}

impl JobWatcher {
    /// Starts to listen. Read the job afterwards, so that no change is missed.
    pub fn new(state: &ApiState, id: JobId) -> Self {
        Self { state: state.clone(), id, changes: state.store.notifier().listen() }
    }

    /// Waits for a version of the job newer than `version`. Returns `None` if the service stops or the job no longer exists.
    pub async fn newer_than(&mut self, version: i64) -> Result<Option<Job>, StoreError> {
        loop {
            match self.state.store.get(self.id).await? {
                None => return Ok(None),
                Some(job) if job.version > version => return Ok(Some(job)),
                Some(_) => {}
            }
            tokio::select! {
                () = changed(&mut self.changes, self.id) => {}
                () = tokio::time::sleep(self.state.config.poll) => {}
                () = self.state.stopping.cancelled() => return Ok(None),
            }
        }
    }

    /// Waits until the job's status differs from that of `job`. After `timeout`, returns the job's latest state.
    pub async fn status_change(&mut self, job: Job, timeout: Duration) -> Result<Job, StoreError> {
        let status = job.status;
        self.wait_until(job, timeout, |job| job.status != status || status.is_final()).await
    }

    /// Waits until `is_done` accepts the job. After `timeout`, or if the service stops or the job no longer exists, returns the
    /// job's latest state.
    pub async fn wait_until(
        &mut self,
        mut job: Job,
        timeout: Duration,
        is_done: impl Fn(&Job) -> bool,
    ) -> Result<Job, StoreError> {
        let waiting = async {
            while !is_done(&job) {
                match self.newer_than(job.version).await? {
                    Some(newer) => job = newer,
                    None => break,
                }
            }
            Ok::<(), StoreError>(())
        };
        match tokio::time::timeout(timeout, waiting).await {
            Ok(Err(error)) => Err(error),
            Ok(Ok(())) | Err(_) => Ok(job),
        }
    }
}

/// Waits until the notifier reports a change of the job.
async fn changed(changes: &mut Receiver<JobId>, id: JobId) {
    loop {
        match changes.recv().await {
            Ok(other) if other != id => {}
            Ok(_) | Err(RecvError::Lagged(_)) => return,
            Err(RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// A job.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Job)]
pub(super) struct JobView {
    /// The job's id.
    #[schema(value_type = String, example = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    pub id: String,
    /// The job's status.
    pub status: Status,
    /// The quality of the result, if the job succeeded, or if it failed only because the result misses the `require` option.
    #[schema(required)]
    pub outcome: Option<JobOutcome>,
    /// The job's progress. `null` once the job has ended.
    #[schema(required)]
    pub progress: Option<ProgressView>,
    /// Number of attempts that count, including the current one.
    pub attempt: u32,
    /// When the job was accepted.
    #[serde(with = "crate::jobs::timestamp")]
    pub created_at: OffsetDateTime,
    /// When a worker first started the job.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub started_at: Option<OffsetDateTime>,
    /// When the job ended.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub finished_at: Option<OffsetDateTime>,
    /// When the job's files and report expire or expired.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub expires_at: Option<OffsetDateTime>,
    /// The submitted file. With several files, the first one.
    pub input: InputView,
    /// All submitted files in the order of submission. Only present if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<InputView>,
    /// The options that differ from their defaults. The report lists all options.
    #[schema(value_type = JobOptions)]
    pub options: Map<String, Value>,
    /// Your own metadata, unchanged.
    #[schema(value_type = BTreeMap<String, String>)]
    pub metadata: Metadata,
    /// The earlier job whose result was reused, because it had the same bytes, options and engine.
    #[schema(value_type = Option<String>, required)]
    pub reused_from: Option<JobId>,
    /// Data for pricing the model. Present once the job has a report of a single file; omitted in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quote: Option<Quote>,
    /// The results to choose from, where the file leaves the model's intent open. Present if the job has the option `alternatives`, once it
    /// has a report; omitted in lists. The artifacts `model-ID`, `report-ID.json`, `after-ID.png` and `change-ID.glb` are the files of an
    /// alternative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<Alternatives>,
    /// The report, if requested with `include=report`. Its lists are shortened as in the artifact `report.json`. The artifact
    /// `report-full.json` contains everything.
    #[schema(value_type = Option<JobReport>)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub report: Option<StoredReport>,
    /// The files to download, by name.
    pub artifacts: BTreeMap<String, ArtifactView>,
    /// Why the job failed.
    #[schema(required)]
    pub problem: Option<JobProblemView>,
}

/// A submitted file.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Input)]
pub(super) struct InputView {
    /// The file name as submitted, without folders.
    pub name: String,
    /// The file's size in bytes.
    pub bytes: u64,
    /// The SHA-256 hash of the file's bytes, in hexadecimal.
    pub sha256: String,
    /// The file format, detected from the bytes.
    pub format: Format,
    /// The length unit, once the file has been read. Omitted in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<UnitView>,
}

/// The length unit of a file.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[schema(as = InputUnit)]
pub(super) struct UnitView {
    /// The unit of all lengths in the report and in the result.
    pub used: Unit,
    /// How the unit was determined.
    pub source: UnitSource,
}

/// The progress of a job.
#[derive(Debug, Default, Serialize, ToSchema)]
#[schema(as = Progress)]
pub(super) struct ProgressView {
    /// The current stage. `null` while the job is queued.
    #[schema(required)]
    pub stage: Option<Stage>,
    /// The tier that is running, 1 to 3.
    #[schema(required)]
    pub tier: Option<u8>,
    /// Percentage of the work that is done, 0 to 100.
    pub percent: u8,
    /// Expected effort of a repair: its duration on one idle core, and its memory. Omitted until the file is inspected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate: Option<Estimate>,
    /// Number of your jobs ahead of this one, while the job is queued.
    #[schema(required)]
    pub queue_position: Option<u64>,
}

/// A file to download.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ArtifactLink)]
pub(super) struct ArtifactView {
    /// The file's URL, relative to the service.
    pub href: String,
    /// The file name to save under.
    pub filename: String,
    /// The file's media type.
    pub media_type: String,
    /// The file's size in bytes. Omitted for an image that is rendered on the first request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// The SHA-256 hash of the file's bytes, in hexadecimal. Omitted for images and coloured meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// Why a job failed, in the format of a problem.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = JobProblem)]
pub(super) struct JobProblemView {
    /// The path of the code's documentation.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code's title: a short description of the error.
    pub title: &'static str,
    /// The error code, for programs.
    pub code: ProblemKind,
    /// What went wrong, and what to do.
    pub detail: String,
    /// Where in the input file the error is, if it has a location.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<FileLocation>,
    /// The index in `inputs` of the file that caused the error, from 0. Only present if there are several files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<u32>,
}

impl JobView {
    /// Creates the view without a report. `retention` is how long results are kept after a job ends.
    pub fn new(job: Job, queue_position: Option<u64>, retention: Duration) -> Self {
        let progress = (!job.status.is_final()).then(|| ProgressView {
            stage: job.progress.map(|p| p.stage),
            tier: job.progress.and_then(|p| p.tier),
            percent: job.progress.map_or(0, |p| p.percent),
            estimate: job.progress.and_then(|p| p.estimate),
            queue_position,
        });
        let link = |(name, artifact): (String, Artifact)| {
            let href = format!("/v1/jobs/{}/artifacts/{name}", job.id);
            let Artifact { filename, media_type, file } = artifact;
            let bytes = file.as_ref().map(|file| file.bytes);
            let sha256 = file.map(|file| file.sha256).filter(|_| !is_rendered(&name));
            (name, ArtifactView { href, filename, media_type, bytes, sha256 })
        };
        let problem = job.problem.map(|problem| JobProblemView {
            kind: format!("/problems/{}", serde_json::to_string(&problem.code).unwrap_or_default().trim_matches('"')),
            title: describe_job_problem(problem.code).0,
            code: problem.code,
            detail: problem.detail,
            place: problem.place,
            file: problem.file,
        });
        let mut units = job.report.as_ref().map(StoredReport::units).unwrap_or_default().into_iter();
        let view = |Input { name, bytes, sha256, format, .. }| {
            let unit = units.next().map(|LengthUnit { used, source, .. }| UnitView { used, source });
            InputView { name, bytes, sha256, format, unit }
        };
        let inputs: Vec<InputView> = job.inputs.into_iter().map(view).collect();
        Self {
            id: job.id.to_string(),
            status: job.status,
            outcome: job.outcome,
            progress,
            attempt: job.attempt,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: job.finished_at.and_then(|end| end.checked_add(retention.try_into().ok()?)),
            input: inputs[0].clone(),
            inputs: if inputs.len() > 1 { inputs } else { Vec::new() },
            options: job.options.to_changed_fields(),
            metadata: job.metadata,
            reused_from: job.reused_from,
            quote: job.report.as_ref().and_then(Quote::of),
            alternatives: job.report.as_ref().and_then(StoredReport::alternatives),
            report: None,
            artifacts: job.artifacts.into_iter().map(link).collect(),
            problem,
        }
    }

    /// Adds the report.
    pub fn with_report(self, report: Option<StoredReport>) -> Self {
        Self { report, ..self }
    }
}

/// Whether an artifact is an image or a coloured mesh.
fn is_rendered(name: &str) -> bool {
    let is_model = matches!(name, "model" | "original") || Artifact::choice_of_model(name).is_some();
    !is_model && !name.ends_with(".json") && !name.ends_with(".txt")
}

/// Responds with a job. `Retry-After` is set while the job has not ended.
pub(super) fn answer<const N: usize>(
    state: &ApiState,
    status: StatusCode,
    job: Job,
    position: Option<u64>,
    headers: [(HeaderName, String); N],
) -> Response {
    answer_view(status, JobView::new(job, position, state.config.retention), headers)
}

/// Responds with a job's view. `Retry-After` is set while the job has not ended.
pub(super) fn answer_view<const N: usize>(
    status: StatusCode,
    view: JobView,
    headers: [(HeaderName, String); N],
) -> Response {
    let retry_after = (!view.status.is_final()).then_some([(header::RETRY_AFTER, "1")]);
    (status, headers, [(header::CACHE_CONTROL, "no-cache")], retry_after, Json(view)).into_response()
}

/// Returns the entity tag of a job in its current state.
pub(super) fn etag(job: &Job, position: Option<u64>) -> String {
    match position {
        Some(position) => format!("W/\"{}-{position}\"", job.version),
        None => format!("W/\"{}\"", job.version),
    }
}
