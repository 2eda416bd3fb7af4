//! A job: its status, its files, its outcome, and the reason of a failure.

use std::collections::BTreeMap;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::id::JobId;
use super::options::JobOptions;
use crate::context::{Estimate, Stage};
use crate::format::{FileLocation, Format};
use crate::repair::{Alternatives, AssumptionKind, RedFlagCode};
use crate::scene::LengthUnit;

/// The status of a job.
///
/// ```text
/// queued -> running -> succeeded | failed | canceled -> expired
///    ^         |
///    +---------+  released, retried, or requeued after its lease expired
/// queued -> canceled
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// The job waits for a worker; after a failed attempt also until its retry is due.
    Queued,
    /// A worker runs the job under a lease.
    Running,
    /// The job finished; `outcome` gives the result.
    Succeeded,
    /// The job ended without a result; `problem` gives the reason.
    Failed,
    /// The job was canceled on request.
    Canceled,
    /// The job ended, and its files and its report were deleted after the retention time.
    Expired,
}

impl Status {
    /// Every status.
    pub const ALL: [Self; 6] =
        [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Canceled, Self::Expired];

    /// The name used in JSON and in the store.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Canceled => "canceled",
            Self::Expired => "expired",
        }
    }

    /// Whether the job has ended.
    #[must_use]
    pub fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Canceled | Self::Expired)
    }
}

impl FromStr for Status {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|s| s.as_str() == text).ok_or(())
    }
}

/// An uploaded file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// Key in the blob store.
    pub key: String,
    /// The file name that the client sent, without folders.
    pub name: String,
    /// The size in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes, in hexadecimal.
    pub sha256: String,
    /// The format that the bytes have.
    pub format: Format,
}

impl Input {
    /// The name without its extension. The names of result files begin with it.
    #[must_use]
    pub fn stem(&self) -> &str {
        let stem = self.name.rsplit_once('.').map_or(self.name.as_str(), |(stem, _)| stem);
        if stem.is_empty() { "model" } else { stem }
    }
}

/// The progress of a running job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobProgress {
    /// The current stage.
    pub stage: Stage,
    /// The current tier, 1 to 3, while one runs.
    pub tier: Option<u8>,
    /// The share of the work that is done, 0 to 100.
    pub percent: u8,
    /// The expected effort of a repair, once its input is inspected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimate: Option<Estimate>,
}

/// A result file of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artifact {
    /// The file name for the download.
    pub filename: String,
    /// The media type.
    pub media_type: String,
    /// The stored file; `None` for a picture that is not drawn yet. Pictures are drawn at the first request.
    #[serde(flatten)]
    pub file: Option<StoredFile>,
}

impl Artifact {
    /// The name of the repaired model.
    pub const MODEL: &str = "model";
    /// What the names of the alternatives' models begin with. The rest is the value of `choice` that selects the alternative.
    const MODEL_OF: &str = "model-";

    /// The name of an alternative's model.
    #[must_use]
    pub fn model_of(choice: &str) -> String {
        format!("{}{choice}", Self::MODEL_OF)
    }

    /// The name of an alternative's full report.
    #[must_use]
    pub fn report_of(choice: &str) -> String {
        format!("report-{choice}.json")
    }

    /// The value of `choice` that selects the alternative whose model has this name; `None` for any other name.
    #[must_use]
    pub fn choice_of_model(name: &str) -> Option<&str> {
        name.strip_prefix(Self::MODEL_OF)
    }
}

/// A file in the blob store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredFile {
    /// The file's key in the blob store.
    pub key: String,
    /// The size in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes, in hexadecimal.
    pub sha256: String,
}

/// Result files by artifact name (`model` or `original`, `report.json`, `log.txt`, pictures).
pub type Artifacts = BTreeMap<String, Artifact>;

/// The client's metadata of a job, returned unchanged: names and texts.
pub type Metadata = BTreeMap<String, String>;

/// The code of a failed job's problem, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// The file can't be read as a mesh, or the options don't suit the file.
    BadInput,
    /// The result can't be written in the requested format.
    BadOutput,
    /// The result is not printable, but `require` demands it. The report lists the remaining defects.
    NotPrintable,
    /// The result does not meet every rule of the process, but `require` demands it. The report lists the failed rules.
    NotPrintReady,
    /// The time of `deadline_s` ran out before there was a result.
    DeadlineExceeded,
    /// The job needed more memory than a job may use.
    OutOfMemory,
    /// The job needed more CPU time than a job may use.
    CpuLimit,
    /// The job wrote a larger file, or more bytes, than a job may write.
    FileLimit,
    /// The job's process crashed repeatedly.
    Crashed,
    /// Several workers were lost while they ran the job, so it is not retried.
    WorkerLost,
    /// The service failed repeatedly for a reason outside the job.
    Internal,
}

/// Why a job failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobProblem {
    /// The problem's code, for programs.
    pub code: ProblemKind,
    /// What happened and what to do, as text.
    pub detail: String,
    /// The place in the input file, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<FileLocation>,
    /// The number of the file at fault, counted from 0, if the job has several files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<u32>,
}

impl JobProblem {
    /// A problem without a place and without a file.
    #[must_use]
    pub fn new(code: ProblemKind, detail: String) -> Self {
        Self { code, detail, place: None, file: None }
    }

    /// The problem of a job during which `workers` workers were lost.
    #[must_use]
    pub fn worker_lost(workers: u32) -> Self {
        let detail = format!(
            "The job failed because {workers} workers were lost while they ran it. Unless the service was stopped or killed meanwhile, \
             this model may crash workers: please report it."
        );
        Self::new(ProblemKind::WorkerLost, detail)
    }
}

/// The outcome of a job: what its result is worth, apart from whether the job ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobOutcome {
    /// Repair: the input is printable, and the job returns its geometry unchanged.
    AlreadyPrintable,
    /// Repair: the result passes every check, without a red flag.
    Repaired,
    /// Repair: the result is better than the input, but fails a check or has a red flag.
    PartiallyRepaired,
    /// Repair: no repair step improved the model; the report gives the reason.
    Unrepairable,
    /// Analysis: every file is printable, as far as the inspection level can tell.
    Printable,
    /// Analysis: at least one file is not printable.
    NotPrintable,
    /// Analysis: the inspection found no defect, but intersecting faces were not requested at this level, or could not all be
    /// counted.
    Undecided,
}

impl JobOutcome {
    /// Whether the job's file is printable: the offered file of a repair, or every file of an analysis. `None` if unknown.
    #[must_use]
    pub fn is_printable(self) -> Option<bool> {
        match self {
            Self::AlreadyPrintable | Self::Repaired | Self::Printable => Some(true),
            Self::PartiallyRepaired | Self::Unrepairable | Self::NotPrintable => Some(false),
            Self::Undecided => None,
        }
    }
}

/// A report as JSON text, stored as it was written. Its own `version` defines its structure, so that reports of earlier
/// versions of this program stay readable.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StoredReport(pub(super) Box<RawValue>);

impl StoredReport {
    /// The report's JSON text.
    pub(super) fn json(&self) -> &str {
        self.0.get()
    }

    /// The codes of a repair's red flags and the kinds of its assumptions, each once.
    #[must_use]
    pub fn remarks(&self) -> (Vec<RedFlagCode>, Vec<AssumptionKind>) {
        #[derive(Deserialize)]
        struct Flag {
            code: RedFlagCode,
        }
        #[derive(Deserialize)]
        struct Assumption {
            kind: AssumptionKind,
        }
        #[derive(Deserialize)]
        struct Remarks {
            #[serde(default)]
            red_flags: Vec<Flag>,
            #[serde(default)]
            assumptions: Vec<Assumption>,
        }
        let Ok(Remarks { red_flags, assumptions }) = serde_json::from_str(self.json()) else {
            return Default::default();
        };
        let mut codes = Vec::new();
        for flag in red_flags {
            if !codes.contains(&flag.code) {
                codes.push(flag.code);
            }
        }
        let mut kinds: Vec<_> = assumptions.into_iter().map(|assumed| assumed.kind).collect();
        kinds.sort_unstable();
        kinds.dedup();
        (codes, kinds)
    }

    /// Whether the returned file, or every file of an analysis, meets the rules of the process; `None` without a process.
    #[must_use]
    pub fn print_ready(&self) -> Option<bool> {
        #[derive(Deserialize)]
        struct StoredVerdict {
            print_ready: Option<bool>,
        }
        #[derive(Deserialize)]
        struct Readiness {
            ready: bool,
        }
        #[derive(Deserialize)]
        struct File {
            print_ready: Option<Readiness>,
        }
        #[derive(Deserialize)]
        struct Read {
            verdict: Option<StoredVerdict>,
            files: Option<Vec<File>>,
        }
        match serde_json::from_str(self.json()).ok()? {
            Read { files: Some(files), .. } => {
                let ready: Option<Vec<bool>> = files.into_iter().map(|file| Some(file.print_ready?.ready)).collect();
                ready.map(|ready| ready.into_iter().all(|ready| ready))
            }
            Read { verdict, .. } => verdict?.print_ready,
        }
    }

    /// The results of a repair to choose from; `None` without the option `alternatives`.
    #[must_use]
    pub fn alternatives(&self) -> Option<Alternatives> {
        #[derive(Deserialize)]
        struct Read {
            alternatives: Option<Alternatives>,
        }
        serde_json::from_str::<Read>(self.json()).ok()?.alternatives
    }

    /// The unit of each file's lengths, in the order of the files; empty for reports that predate units.
    #[must_use]
    pub fn units(&self) -> Vec<LengthUnit> {
        #[derive(Deserialize)]
        struct File {
            unit: LengthUnit,
        }
        // An analysis has files; a repair has a single unit. Other fields are skipped while parsing.
        #[derive(Deserialize)]
        struct Units {
            files: Option<Vec<File>>,
            unit: Option<LengthUnit>,
        }
        match serde_json::from_str(self.json()) {
            Ok(Units { files: Some(files), .. }) => files.into_iter().map(|file| file.unit).collect(),
            Ok(Units { unit, .. }) => unit.into_iter().collect(),
            Err(_) => Vec::new(),
        }
    }
}

impl PartialEq for StoredReport {
    fn eq(&self, other: &Self) -> bool {
        self.0.get() == other.0.get()
    }
}

/// A job as the store keeps it.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    /// The tenant that owns it.
    pub tenant: String,
    /// The id of the API key that submitted it; `None` if the service requires no keys.
    pub api_key_id: Option<String>,
    /// Its status.
    pub status: Status,
    /// The outcome, if the work was finished.
    pub outcome: Option<JobOutcome>,
    /// The progress, while the job runs.
    pub progress: Option<JobProgress>,
    /// The number of attempts so far, with the running one.
    pub attempt: u32,
    /// How often the job crashed its worker or its child process.
    pub crashes: u32,
    /// When it was accepted.
    pub created_at: OffsetDateTime,
    /// When a worker first claimed it.
    pub started_at: Option<OffsetDateTime>,
    /// When it ended.
    pub finished_at: Option<OffsetDateTime>,
    /// When it is due, while it is queued.
    pub run_at: OffsetDateTime,
    /// The uploaded files, at least one, in the order they were sent.
    pub inputs: Vec<Input>,
    /// The mode and its options.
    pub options: JobOptions,
    /// The client's metadata.
    pub metadata: Metadata,
    /// The address that is notified of the job's end.
    pub callback_url: Option<String>,
    /// The earlier job whose result this job reused.
    pub reused_from: Option<JobId>,
    /// The report on the result.
    pub report: Option<StoredReport>,
    /// The result files.
    pub artifacts: Artifacts,
    /// Why the job failed.
    pub problem: Option<JobProblem>,
    /// The W3C trace context of the request that submitted the job.
    pub traceparent: Option<String>,
    /// Grows with every change of the row.
    pub version: i64,
    /// Whether its files and its content were deleted on request.
    pub purged: bool,
}
