//! One job, as requests find it, wait for it and show it.

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
use super::problem::{Problem, ProblemCode, shown};
use super::problem_code::describe_job_problem;
use super::state::ApiState;
use crate::context::Stage;
use crate::format::{Format, Place};
use crate::jobs::{
    Input, Job, JobId, JobOptions, JobOutcome, JobReport, Metadata, ProblemKind, Quote, Status, StoreError,
    StoredReport,
};
use crate::scene::{LengthUnit, Unit, UnitSource};

/// The id of a job in a path. A text that is no id names no job.
pub(super) fn job_id(text: &str) -> Result<JobId, Problem> {
    text.parse()
        .map_err(|error| Problem::new(ProblemCode::JobNotFound, format!("There is no job '{}': {error}.", shown(text))))
}

/// The job of that id, if it is there for the caller and not deleted.
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

/// Sees every change of one job: woken by the notifier, and polling now and then in case another process made it.
pub(super) struct Watch {
    state: ApiState,
    id: JobId,
    changes: Receiver<JobId>,
}

impl Watch {
    /// Begins to listen. Read the job after this, so that no change falls between.
    pub fn new(state: &ApiState, id: JobId) -> Self {
        Self { state: state.clone(), id, changes: state.store.notifier().listen() }
    }

    /// The job once its version is past `version`; none when the service stops or the job is gone.
    pub async fn past(&mut self, version: i64) -> Result<Option<Job>, StoreError> {
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

    /// The job once its status is another than that of `job`, or as it is when `longest` has passed.
    pub async fn status_change(&mut self, job: Job, longest: Duration) -> Result<Job, StoreError> {
        let status = job.status;
        self.until(job, longest, |job| job.status != status || status.is_final()).await
    }

    /// The job once `is_done` says so of it, or as it is when `longest` has passed, the service stops or the job is gone.
    pub async fn until(
        &mut self,
        mut job: Job,
        longest: Duration,
        is_done: impl Fn(&Job) -> bool,
    ) -> Result<Job, StoreError> {
        let waiting = async {
            while !is_done(&job) {
                match self.past(job.version).await? {
                    Some(newer) => job = newer,
                    None => break,
                }
            }
            Ok::<(), StoreError>(())
        };
        match tokio::time::timeout(longest, waiting).await {
            Ok(Err(error)) => Err(error),
            Ok(Ok(())) | Err(_) => Ok(job),
        }
    }
}

/// Waits until the notifier names the job.
async fn changed(changes: &mut Receiver<JobId>, id: JobId) {
    loop {
        match changes.recv().await {
            Ok(other) if other != id => {}
            Ok(_) | Err(RecvError::Lagged(_)) => return,
            Err(RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// A job as clients see it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Job)]
pub(super) struct JobView {
    /// Its name.
    #[schema(value_type = String, example = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    pub id: String,
    /// Where it stands.
    pub status: Status,
    /// What became of the model, once the job succeeded, or failed since its result is not what `require` asks for.
    #[schema(required)]
    pub outcome: Option<JobOutcome>,
    /// How far it is; none once it has ended.
    #[schema(required)]
    pub progress: Option<ProgressView>,
    /// Tries that count, the running one among them.
    pub attempt: u32,
    /// When it was accepted.
    #[serde(with = "crate::jobs::timestamp")]
    pub created_at: OffsetDateTime,
    /// When a worker first took it.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub started_at: Option<OffsetDateTime>,
    /// When it ended.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub finished_at: Option<OffsetDateTime>,
    /// When its files and its report will be deleted, or were.
    #[schema(required)]
    #[serde(with = "crate::jobs::timestamp::option")]
    pub expires_at: Option<OffsetDateTime>,
    /// The uploaded file; of several the first.
    pub input: InputView,
    /// All uploaded files in the order they were sent, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<InputView>,
    /// The options that differ from their defaults. The report lists all of them.
    #[schema(value_type = JobOptions)]
    pub options: Map<String, Value>,
    /// Your own notes, as you sent them.
    #[schema(value_type = BTreeMap<String, String>)]
    pub metadata: Metadata,
    /// The earlier job whose result this one was given, since it had the same bytes, options and engine.
    #[schema(value_type = Option<String>, required)]
    pub reused_from: Option<JobId>,
    /// What a shop needs to price the model, once the job has a report of one file; left out of lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quote: Option<Quote>,
    /// The report, where `include=report` asks for it: with short lists, as the artifact `report.json` has it. The artifact
    /// `report-full.json` has everything.
    #[schema(value_type = Option<JobReport>)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub report: Option<StoredReport>,
    /// The files to download, by name.
    pub artifacts: BTreeMap<String, ArtifactView>,
    /// Why it failed.
    #[schema(required)]
    pub problem: Option<JobProblemView>,
}

/// An uploaded file.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Input)]
pub(super) struct InputView {
    /// The name it was sent with, without folders.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
    /// The format found in its bytes.
    pub format: Format,
    /// The unit of its lengths, once it was read; left out of lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<UnitView>,
}

/// What a file's lengths are in.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[schema(as = InputUnit)]
pub(super) struct UnitView {
    /// The unit that the report and the result are in.
    pub used: Unit,
    /// How it is known what the file's lengths are in.
    pub source: UnitSource,
}

/// How far a job is.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Progress)]
pub(super) struct ProgressView {
    /// What is being done; none while it waits.
    #[schema(required)]
    pub stage: Option<Stage>,
    /// The tier that runs, 1 to 3.
    #[schema(required)]
    pub tier: Option<u8>,
    /// Share of the work that is done, 0 to 100.
    pub percent: u8,
    /// Jobs of yours that will be taken before this one, while it waits.
    #[schema(required)]
    pub queue_position: Option<u64>,
}

/// A file to download.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ArtifactLink)]
pub(super) struct ArtifactView {
    /// Its address, relative to the service's.
    pub href: String,
    /// The name to save it under.
    pub filename: String,
    /// Its media type.
    pub media_type: String,
    /// Its size; left out of a picture that is drawn when it is first asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// SHA-256 of its bytes, in hexadecimal; left out of pictures and coloured meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// Why a job failed, in the shape of a problem.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = JobProblem)]
pub(super) struct JobProblemView {
    /// Where the code is documented.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code's title.
    pub title: &'static str,
    /// The code, for programs.
    pub code: ProblemKind,
    /// What happened and what to do.
    pub detail: String,
    /// Where in the input file, if it has a place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
    /// Of several files, the one that is to blame, as its place in `inputs`, counted from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<u32>,
}

impl JobView {
    /// `retention` is how long results are kept. The report is left out; [`JobView::with_report`] puts it in.
    pub fn new(job: Job, queue_position: Option<u64>, retention: Duration) -> Self {
        let progress = (!job.status.is_final()).then(|| ProgressView {
            stage: job.progress.map(|p| p.stage),
            tier: job.progress.and_then(|p| p.tier),
            percent: job.progress.map_or(0, |p| p.percent),
            queue_position,
        });
        let link = |(name, artifact): (String, crate::jobs::Artifact)| {
            let href = format!("/v1/jobs/{}/artifacts/{name}", job.id);
            let crate::jobs::Artifact { filename, media_type, file } = artifact;
            let bytes = file.as_ref().map(|file| file.bytes);
            let sha256 = file.map(|file| file.sha256).filter(|_| !is_picture(&name));
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
            report: None,
            artifacts: job.artifacts.into_iter().map(link).collect(),
            problem,
        }
    }

    /// The same with the report.
    pub fn with_report(self, report: Option<StoredReport>) -> Self {
        Self { report, ..self }
    }
}

/// Whether an artifact shows a result: a picture or a coloured mesh.
fn is_picture(name: &str) -> bool {
    !matches!(name, "model" | "original") && !name.ends_with(".json") && !name.ends_with(".txt")
}

/// The answer with a job in it, and when to ask again.
pub(super) fn answer<const N: usize>(
    state: &ApiState,
    status: StatusCode,
    job: Job,
    position: Option<u64>,
    headers: [(HeaderName, String); N],
) -> Response {
    answer_view(status, JobView::new(job, position, state.config.retention), headers)
}

pub(super) fn answer_view<const N: usize>(
    status: StatusCode,
    view: JobView,
    headers: [(HeaderName, String); N],
) -> Response {
    let more = (!view.status.is_final()).then_some([(header::RETRY_AFTER, "1")]);
    (status, headers, [(header::CACHE_CONTROL, "no-cache")], more, Json(view)).into_response()
}

/// The entity tag of a job in its present state.
pub(super) fn etag(job: &Job, position: Option<u64>) -> String {
    match position {
        Some(position) => format!("W/\"{}-{position}\"", job.version),
        None => format!("W/\"{}\"", job.version),
    }
}
