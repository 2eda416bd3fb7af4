//! A job of a service: the parts of the API's JSON that `submit` and `watch` read, its summary and its exit code.

use std::collections::BTreeMap;

use meshmend::context::Stage;
use meshmend::jobs::{Artifact, JobId, JobOutcome, Mode, ProblemKind, Status};
use meshmend::printing::readiness::PrintReadiness;
use meshmend::repair::Alternatives;
use serde::Deserialize;

use crate::cli::engine::remark_lines;
use crate::cli::exit;

/// A job, as the API returns it.
#[derive(Debug, Deserialize)]
pub struct RemoteJob {
    /// The id.
    pub id: JobId,
    /// The status.
    pub status: Status,
    /// The outcome, once the job has succeeded.
    pub outcome: Option<JobOutcome>,
    /// The progress, until the job ends.
    pub progress: Option<RemoteProgress>,
    /// The uploaded file.
    pub input: RemoteInput,
    /// The earlier job whose result was reused.
    pub reused_from: Option<JobId>,
    report: Option<RemoteReport>,
    /// The other results, if the job asked for them.
    #[serde(default)]
    pub alternatives: Option<Alternatives>,
    /// The files to download, by name.
    pub artifacts: BTreeMap<String, RemoteFile>,
    problem: Option<RemoteProblem>,
}

/// The uploaded file.
#[derive(Debug, Deserialize)]
pub struct RemoteInput {
    /// Its name.
    pub name: String,
}

/// The progress of a job.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct RemoteProgress {
    /// The current stage, while the job runs.
    pub stage: Option<Stage>,
    /// The tier that runs, if any.
    pub tier: Option<u8>,
    /// The progress, 0 to 100.
    pub percent: u8,
    /// The number of jobs ahead in the queue.
    pub queue_position: Option<u64>,
}

/// A file of a job.
#[derive(Debug, Deserialize)]
pub struct RemoteFile {
    /// The file name for the download.
    pub filename: String,
    /// The size; `None` for pictures, which are drawn on request.
    pub bytes: Option<u64>,
    /// The checksum as hex digits; `None` for pictures.
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
    print_ready: Option<PrintReadiness>,
    files: Vec<AnalyzedFile>,
}

/// A file of an analysis.
#[derive(Debug, Deserialize)]
struct AnalyzedFile {
    print_ready: Option<PrintReadiness>,
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
    /// The remark_lines below the summary.
    fn remark_lines(&self) -> impl Iterator<Item = String> {
        let flags = self.red_flags.iter().map(|flag| flag.detail.as_str());
        let assumptions =
            self.assumptions.iter().map(|assumption| (assumption.detail.as_str(), assumption.option.as_deref()));
        remark_lines(flags, assumptions, &self.warnings)
    }

    /// Whether each file meets the rules of the process; empty without a process.
    fn readiness(&self) -> impl Iterator<Item = &PrintReadiness> {
        self.print_ready.iter().chain(self.files.iter().filter_map(|file| file.print_ready.as_ref()))
    }
}

impl RemoteJob {
    /// The name of the main file: the model, or the report of an analysis. `None` if the repair gave no model.
    pub fn result(&self) -> Option<&'static str> {
        let name = match self.report.as_ref()?.mode {
            Mode::Repair => Artifact::MODEL,
            Mode::Analyze => REPORT,
        };
        self.artifacts.contains_key(name).then_some(name)
    }

    /// The names of the alternatives' models among the files, each with the alternative's id. An id becomes part of a path, so a name
    /// of a hostile service that could lead elsewhere does not count.
    pub fn alternative_models(&self) -> impl Iterator<Item = (&str, &str)> {
        let is_plain = |id: &str| id.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte));
        let ids = self.artifacts.keys().map(|name| (name.as_str(), Artifact::choice_of_model(name)));
        ids.filter_map(move |(name, id)| Some((name, id.filter(|id| is_plain(id))?)))
    }

    /// The outcome, then the remarks below it.
    pub fn summary_lines(&self) -> Vec<String> {
        let report = self.report.as_ref();
        let headline = match (&self.problem, self.status) {
            (Some(problem), _) => format!("{}: {}", problem.title, problem.detail),
            (None, Status::Canceled) => "the job was canceled".to_owned(),
            (None, Status::Expired) => "the files of the job have expired".to_owned(),
            (None, _) => match (report.and_then(|report| report.summary.clone()), self.outcome) {
                (Some(summary), _) => summary,
                (None, Some(JobOutcome::Printable)) => "printable without changes".to_owned(),
                (None, Some(JobOutcome::NotPrintable)) => "not printable; the report lists the defects".to_owned(),
                (None, Some(JobOutcome::Undecided)) => {
                    "undecided: the checks that ran found no defects, but some checks did not run".to_owned()
                }
                (None, _) => self.status.as_str().to_owned(),
            },
        };
        let readiness = report.into_iter().flat_map(RemoteReport::readiness);
        let readiness = readiness.map(|readiness| format!("  {}", readiness.in_words()));
        let remark_lines = report.into_iter().flat_map(RemoteReport::remark_lines);
        let unchanged = self.artifacts.contains_key(ORIGINAL).then(|| "  note: the repair made no model".to_owned());
        std::iter::once(headline).chain(readiness).chain(remark_lines).chain(unchanged).collect()
    }

    /// The exit code for the outcome.
    pub fn code(&self) -> u8 {
        if let Some(problem) = &self.problem {
            return match problem.code {
                ProblemKind::BadInput | ProblemKind::BadOutput => exit::BAD_INPUT,
                ProblemKind::NotPrintable | ProblemKind::NotPrintReady => exit::NOT_PRINTABLE,
                _ => exit::INTERNAL,
            };
        }
        // An undecided analysis counts as printable: checks that did not run find no defects.
        let printable = self.outcome.is_some_and(|outcome| outcome.is_printable() != Some(false));
        // Of a repair, `require` decides whether the rules count. An analysis has no such option.
        let analyzed = self.report.as_ref().filter(|report| report.mode == Mode::Analyze);
        let is_ready = analyzed.into_iter().flat_map(RemoteReport::readiness).all(|readiness| readiness.ready);
        if printable && is_ready { exit::PRINTABLE } else { exit::PARTIAL }
    }
}

/// The name of the uploaded file among the files of a job, if the repair gave nothing better.
const ORIGINAL: &str = "original";
/// The name of the full report among the files of a job.
pub const REPORT: &str = "report-full.json";

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn only_plain_ids_of_alternatives_become_part_of_a_path() {
        let file = json!({"filename": "a.stl"});
        let job = json!({
            "id": "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a", "status": "succeeded", "outcome": "repaired", "input": {"name": "a.stl"},
            "artifacts": {"model": file, "model-voids-fill": file, "model-../../x": file, "model-a.b": file},
        });
        let job: RemoteJob = serde_json::from_value(job).expect("a job");
        assert_eq!(job.alternative_models().collect::<Vec<_>>(), [("model-voids-fill", "voids-fill")]);
    }
}
