//! A job as the service tells of it: what is read here, and no more.

use std::collections::BTreeMap;

use meshmend::context::Stage;
use meshmend::jobs::{JobId, JobOutcome, Mode, ProblemKind, Status};
use serde::Deserialize;

use crate::cli::engine::remarks;
use crate::cli::exit;

/// A job.
#[derive(Debug, Deserialize)]
pub struct RemoteJob {
    pub id: JobId,
    pub status: Status,
    pub outcome: Option<JobOutcome>,
    pub progress: Option<RemoteProgress>,
    pub input: RemoteInput,
    pub reused_from: Option<JobId>,
    report: Option<RemoteReport>,
    pub artifacts: BTreeMap<String, RemoteFile>,
    problem: Option<RemoteProblem>,
}

/// What was sent.
#[derive(Debug, Deserialize)]
pub struct RemoteInput {
    pub name: String,
}

/// How far a job is.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct RemoteProgress {
    pub stage: Option<Stage>,
    pub tier: Option<u8>,
    pub percent: u8,
    pub queue_position: Option<u64>,
}

/// A file to download.
#[derive(Debug, Deserialize)]
pub struct RemoteFile {
    pub filename: String,
    /// None of pictures that are not drawn yet.
    pub bytes: Option<u64>,
    /// None of pictures.
    pub sha256: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct RemoteReport {
    mode: Mode,
    summary: Option<String>,
    red_flags: Vec<RedFlag>,
    assumptions: Vec<Assumption>,
    warnings: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct RedFlag {
    detail: String,
}

#[derive(Debug, Deserialize)]
struct Assumption {
    detail: String,
    option: Option<String>,
}

#[derive(Debug, Deserialize)]
struct RemoteProblem {
    title: String,
    detail: String,
    code: ProblemKind,
}

impl RemoteReport {
    /// What a person should know.
    fn remarks(&self) -> impl Iterator<Item = String> {
        let flags = self.red_flags.iter().map(|flag| flag.detail.as_str());
        let assumptions = self.assumptions.iter().map(|it| (it.detail.as_str(), it.option.as_deref()));
        remarks(flags, assumptions, &self.warnings)
    }
}

impl RemoteJob {
    /// The file that the job was for: the model, or of an analysis the report. None where a repair made no model.
    pub fn result(&self) -> Option<&'static str> {
        let name = match self.report.as_ref()?.mode {
            Mode::Repair => MODEL,
            Mode::Analyze => REPORT,
        };
        self.artifacts.contains_key(name).then_some(name)
    }

    /// What became of it, in words, and then what a person should know.
    pub fn tale(&self) -> Vec<String> {
        let report = self.report.as_ref();
        let head = match (&self.problem, self.status) {
            (Some(problem), _) => format!("{}: {}", problem.title, problem.detail),
            (None, Status::Canceled) => "the job was canceled".to_owned(),
            (None, Status::Expired) => "the job ended so long ago that its files are deleted".to_owned(),
            (None, _) => match (report.and_then(|report| report.summary.clone()), self.outcome) {
                (Some(summary), _) => summary,
                (None, Some(JobOutcome::Printable)) => "printable as it is".to_owned(),
                (None, Some(JobOutcome::NotPrintable)) => "not printable; the report says why".to_owned(),
                (None, Some(JobOutcome::Undecided)) => {
                    "nothing is wrong that was looked for, and not everything was".to_owned()
                }
                (None, _) => self.status.as_str().to_owned(),
            },
        };
        let remarks = report.into_iter().flat_map(RemoteReport::remarks);
        let unchanged = self.artifacts.contains_key(ORIGINAL).then(|| "  note: no model was made".to_owned());
        std::iter::once(head).chain(remarks).chain(unchanged).collect()
    }

    /// The exit code that says so.
    pub fn code(&self) -> u8 {
        if let Some(problem) = &self.problem {
            return match problem.code {
                ProblemKind::BadInput | ProblemKind::BadOutput => exit::BAD_INPUT,
                ProblemKind::NotPrintable => exit::NOT_PRINTABLE,
                _ => exit::INTERNAL,
            };
        }
        // What an analysis did not look for is not held against the file.
        let printable = self.outcome.is_some_and(|outcome| outcome.is_printable() != Some(false));
        if printable { exit::PRINTABLE } else { exit::PARTIAL }
    }
}

/// The name of a repair's result among a job's files.
const MODEL: &str = "model";
/// The name of the upload, where nothing made it better.
const ORIGINAL: &str = "original";
/// The name of a job's whole report among its files.
pub const REPORT: &str = "report-full.json";
