//! A job: where it stands, its files, what became of its model, and why it failed.

use std::collections::BTreeMap;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::id::JobId;
use super::options::JobOptions;
use crate::context::Stage;
use crate::format::{Format, Place};
use crate::repair::{AssumptionKind, RedFlagCode};
use crate::scene::LengthUnit;

/// Where a job stands.
///
/// ```text
/// queued -> running -> succeeded | failed | canceled -> expired
///    ^         |
///    +---------+  handed back, retried, or rescued after its lease ran out
/// queued -> canceled
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Waiting for a worker, perhaps until a retry is due.
    Queued,
    /// A worker has it under a lease.
    Running,
    /// Done; the result's `outcome` says how good it is.
    Succeeded,
    /// Ended without a result; `problem` says why.
    Failed,
    /// Stopped on request.
    Canceled,
    /// Ended so long ago that its files and its report were deleted.
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

    /// Whether nothing more will happen.
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
    /// The name it was sent with, without folders.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
    /// The format found in its bytes.
    pub format: Format,
}

impl Input {
    /// Its name without the ending, as the names of results begin.
    #[must_use]
    pub fn stem(&self) -> &str {
        let stem = self.name.rsplit_once('.').map_or(self.name.as_str(), |(stem, _)| stem);
        if stem.is_empty() { "model" } else { stem }
    }
}

/// How far a job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobProgress {
    /// What is being done.
    pub stage: Stage,
    /// The tier that runs, 1 to 3.
    pub tier: Option<u8>,
    /// Share of the work that is done, 0 to 100.
    pub percent: u8,
}

/// A result file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artifact {
    /// The name to save it under.
    pub filename: String,
    /// Its media type.
    pub media_type: String,
    /// What is stored; none of a picture that is drawn when somebody asks for it.
    #[serde(flatten)]
    pub file: Option<StoredFile>,
}

/// A file in the blob store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredFile {
    /// Its key there.
    pub key: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
}

/// Result files by artifact name (`model` or `original`, `report.json`, `log.txt`, pictures).
pub type Artifacts = BTreeMap<String, Artifact>;

/// A client's own notes on a job, handed back as they came: names and texts.
pub type Metadata = BTreeMap<String, String>;

/// Why a job failed, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// The file can't be read as a mesh.
    BadInput,
    /// The result can't be written in the format that was asked for.
    BadOutput,
    /// The result is not printable, which `require` asks for. The report says what is left.
    NotPrintable,
    /// The time given by `deadline_s` ran out before there was any result.
    DeadlineExceeded,
    /// The job needed more memory than a job may have.
    OutOfMemory,
    /// The job needed more processor time than a job may have.
    CpuLimit,
    /// The job wrote a larger file than a job may write.
    FileLimit,
    /// The job's process ended by itself, again and again.
    Crashed,
    /// Workers went away while they had this job, again and again; it is set aside.
    WorkerLost,
    /// Something in the service failed, again and again.
    Internal,
}

/// Why a job failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobProblem {
    /// Which problem.
    pub code: ProblemKind,
    /// What happened and what to do, in words.
    pub detail: String,
    /// Where in the input file, if it has a place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
    /// Of several files, the one that is to blame, counted from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<u32>,
}

impl JobProblem {
    /// A problem that has no place and concerns no single file.
    #[must_use]
    pub fn new(code: ProblemKind, detail: String) -> Self {
        Self { code, detail, place: None, file: None }
    }

    /// That so many workers went away while they had a job.
    #[must_use]
    pub fn worker_lost(workers: u32) -> Self {
        let detail = format!(
            "{workers} workers went away while they had this job, so it was set aside. If the service was not being \
             killed by hand, this model may be what takes workers down: please report it."
        );
        Self::new(ProblemKind::WorkerLost, detail)
    }
}

/// What became of a job's model, apart from whether the job ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobOutcome {
    /// Repair: the input is printable; its geometry comes back untouched.
    AlreadyPrintable,
    /// Repair: the result passes every check, and no red flag is up.
    Repaired,
    /// Repair: the result is better than the input, but fails a check, or passes all of them with a red flag up.
    PartiallyRepaired,
    /// Repair: nothing that ran made the model better; the reason is in the report.
    Unrepairable,
    /// Analysis: every file can be printed as it is, as far as the level of inspection tells.
    Printable,
    /// Analysis: at least one file can't be printed as it is.
    NotPrintable,
    /// Analysis: nothing is wrong that was looked for, but the level did not ask for faces that intersect, or they could
    /// not all be counted.
    Undecided,
}

impl JobOutcome {
    /// Whether what the job hands out, or of an analysis every file, can be printed as it is; none where that is not known.
    #[must_use]
    pub fn is_printable(self) -> Option<bool> {
        match self {
            Self::AlreadyPrintable | Self::Repaired | Self::Printable => Some(true),
            Self::PartiallyRepaired | Self::Unrepairable | Self::NotPrintable => Some(false),
            Self::Undecided => None,
        }
    }
}

/// A report as JSON, as it was written: its own `version` says how to read it, and rows of earlier versions of this
/// program stay readable.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StoredReport(pub(super) Box<RawValue>);

impl StoredReport {
    /// Its JSON.
    pub(super) fn json(&self) -> &str {
        self.0.get()
    }

    /// The codes of a repair's red flags, and the kinds of its assumptions, each once.
    #[must_use]
    pub fn remarks(&self) -> (Vec<RedFlagCode>, Vec<AssumptionKind>) {
        #[derive(Deserialize)]
        struct Flag {
            code: RedFlagCode,
        }
        #[derive(Deserialize)]
        struct Assumed {
            kind: AssumptionKind,
        }
        #[derive(Deserialize)]
        struct Remarks {
            #[serde(default)]
            red_flags: Vec<Flag>,
            #[serde(default)]
            assumptions: Vec<Assumed>,
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

    /// The unit of each file's lengths, in their order; none in reports of before there were units.
    #[must_use]
    pub fn units(&self) -> Vec<LengthUnit> {
        #[derive(Deserialize)]
        struct File {
            unit: LengthUnit,
        }
        // An analysis has files; a repair has one unit. The rest is passed over as it is read.
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

/// One job as the store keeps it.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Its name.
    pub id: JobId,
    /// Whose it is.
    pub tenant: String,
    /// The key it was submitted with; none where the service asks for none.
    pub made_by: Option<String>,
    /// Where it stands.
    pub status: Status,
    /// What became of the model, where the work was done to its end.
    pub outcome: Option<JobOutcome>,
    /// How far it is, while it runs.
    pub progress: Option<JobProgress>,
    /// Claims that count, the running one among them.
    pub attempt: u32,
    /// Times it took its worker or child process down.
    pub crashes: u32,
    /// When it was accepted.
    pub created_at: OffsetDateTime,
    /// When a worker first took it.
    pub started_at: Option<OffsetDateTime>,
    /// When it ended.
    pub finished_at: Option<OffsetDateTime>,
    /// When it is due, for a job that waits.
    pub run_at: OffsetDateTime,
    /// The uploaded files, at least one, in the order they were sent.
    pub inputs: Vec<Input>,
    /// What to do.
    pub options: JobOptions,
    /// The client's own notes.
    pub metadata: Metadata,
    /// Where to tell of its end.
    pub callback_url: Option<String>,
    /// The job whose result it was given, where nothing had to be done again.
    pub reused_from: Option<JobId>,
    /// The account of what was done.
    pub report: Option<StoredReport>,
    /// The result files.
    pub artifacts: Artifacts,
    /// Why it failed.
    pub problem: Option<JobProblem>,
    /// Where the request that made it stands in a trace.
    pub traceparent: Option<String>,
    /// Grows with every change of the row.
    pub version: i64,
    /// Whether its files and content were deleted on request.
    pub purged: bool,
}
