use serde::Serialize;
use utoipa::ToSchema;

use super::problem::{ProblemCode, code_name};
use crate::jobs::ProblemKind;

/// A code with its meaning, for the documentation.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProblemDoc {
    /// The code.
    pub code: String,
    /// The title.
    pub title: &'static str,
    /// The HTTP status of a response with it; none for a problem of a job.
    pub status: Option<u16>,
    /// What to do.
    pub advice: &'static str,
}

/// The title of a job's problem, and what to do.
#[must_use]
pub fn describe_job_problem(kind: ProblemKind) -> (&'static str, &'static str) {
    match kind {
        ProblemKind::BadInput => ("The file can't be read", "Export the model again; the detail names what and where."),
        ProblemKind::BadOutput => ("The result can't be written", "Ask for another output format."),
        ProblemKind::NotPrintable => (
            "Not printable",
            "The report says what is left: repair that where the model was made, or send it with require=any for the best result there is.",
        ),
        ProblemKind::DeadlineExceeded => {
            ("Out of time", "Raise deadline_s, lower max_tier or level, or send fewer faces.")
        }
        ProblemKind::OutOfMemory => ("Out of memory", "Send fewer faces, or raise the service's --job-memory."),
        ProblemKind::CpuLimit => ("Out of processor time", "Send fewer faces, or lower max_tier or level."),
        ProblemKind::FileLimit => ("Result too large", "Ask for less: a smaller voxel_resolution, or fewer places."),
        ProblemKind::Crashed => ("The job crashed", "A fault of the service: report it with the job's log."),
        ProblemKind::WorkerLost => ("Set aside", "Workers were lost with this job: report it with the model."),
        ProblemKind::Internal => ("Internal error", "Try again later; if it stays, report it with the job's id."),
    }
}

/// Every problem of requests and of jobs.
#[must_use]
pub fn catalogue() -> Vec<ProblemDoc> {
    const KINDS: [ProblemKind; 10] = [
        ProblemKind::BadInput,
        ProblemKind::BadOutput,
        ProblemKind::NotPrintable,
        ProblemKind::DeadlineExceeded,
        ProblemKind::OutOfMemory,
        ProblemKind::CpuLimit,
        ProblemKind::FileLimit,
        ProblemKind::Crashed,
        ProblemKind::WorkerLost,
        ProblemKind::Internal,
    ];
    let mut docs: Vec<ProblemDoc> = ProblemCode::ALL
        .into_iter()
        .map(|code| {
            let (status, title, advice) = code.describe();
            ProblemDoc { code: code.name(), title, status: Some(status.as_u16()), advice }
        })
        .collect();
    for kind in KINDS {
        let code = code_name(&kind);
        if docs.iter().all(|doc| doc.code != code) {
            let (title, advice) = describe_job_problem(kind);
            docs.push(ProblemDoc { code, title, status: None, advice });
        }
    }
    docs
}
