use std::fs;
use std::io;
use std::path::Path;

use super::task::Task;
use crate::analyze::{Analyst, AnalyzeError, AnalyzeOptions};
use crate::blender::{BlenderConfig, BlenderRemesher};
use crate::context::Context;
use crate::format::{ReadError, ReadErrorKind};
use crate::jobs::{JobOptions, JobProblem, JobReport, ProblemKind};
use crate::repair::{Options, Remesher, RepairError, repair};

/// What a job makes of its files, whatever its mode.
pub(super) struct Made {
    /// The model's bytes, from a repair.
    pub model: Option<Vec<u8>>,
    pub report: JobReport,
}

/// Why it makes nothing.
pub(super) enum Failed {
    /// Something around the job failed, so it may be tried again.
    Io(io::Error),
    /// The job itself is to blame.
    Problem(Box<JobProblem>),
}

/// Does the work of a task whose files lie in `folder`.
pub(super) fn work(folder: &Path, task: &Task, context: &Context<'_>) -> Result<Made, Failed> {
    match &task.options {
        JobOptions::Repair(options) => run_repair(folder, task, options, context),
        JobOptions::Analyze(options) => run_analysis(folder, task, options, context),
    }
}

fn run_repair(folder: &Path, task: &Task, options: &Options, context: &Context<'_>) -> Result<Made, Failed> {
    let remesher = task.remesher.clone().map(|info| {
        BlenderRemesher::new(info, BlenderConfig { scratch: Some(folder.to_owned()), ..BlenderConfig::default() })
    });
    let remesher = remesher.as_ref().map(|r| -> &dyn Remesher { r });
    let bytes = fs::read(folder.join(Task::input(0)))?;
    let repaired = repair(&bytes, options, &task.limits, remesher, context)?;
    Ok(Made { model: Some(repaired.bytes), report: JobReport::Repair(Box::new(repaired.report)) })
}

fn run_analysis(folder: &Path, task: &Task, options: &AnalyzeOptions, context: &Context<'_>) -> Result<Made, Failed> {
    let mut analyst = Analyst::new(options, &task.limits, task.inputs.len(), context)?;
    for (number, input) in task.inputs.iter().enumerate() {
        analyst.add(&input.name, Some(&input.sha256), &fs::read(folder.join(Task::input(number)))?)?;
    }
    Ok(Made { model: None, report: JobReport::Analyze(analyst.finish()) })
}

impl Made {
    /// Writes the files into `folder`.
    pub fn write(&self, folder: &Path) -> Result<(), Failed> {
        let report = serde_json::to_vec_pretty(&self.report).map_err(io::Error::from)?;
        if report.len() > Task::REPORT_BYTES {
            let most = Task::REPORT_BYTES >> 20;
            let detail =
                format!("The report would be larger than {most} MiB. Ask for fewer places, or send fewer files.");
            return Err(problem(ProblemKind::FileLimit, detail, None).into());
        }
        if let Some(model) = &self.model {
            fs::write(folder.join(Task::MODEL), model)?;
        }
        Ok(fs::write(folder.join(Task::REPORT), report)?)
    }
}

impl From<io::Error> for Failed {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<JobProblem> for Failed {
    fn from(problem: JobProblem) -> Self {
        Self::Problem(Box::new(problem))
    }
}

impl From<RepairError> for Failed {
    fn from(error: RepairError) -> Self {
        let (code, read) = match &error {
            RepairError::Read(read) => (ProblemKind::BadInput, Some(read)),
            RepairError::Options(_) => (ProblemKind::BadInput, None),
            RepairError::Write(_) => (ProblemKind::BadOutput, None),
            RepairError::Cancelled(_) => (ProblemKind::DeadlineExceeded, None),
        };
        problem(code, error.to_string(), read).into()
    }
}

impl From<AnalyzeError> for Failed {
    fn from(error: AnalyzeError) -> Self {
        let detail = error.to_string();
        match error {
            AnalyzeError::Read { index, of, error, .. } => {
                let file = u32::try_from(index).ok().filter(|_| of > 1);
                JobProblem { file, ..problem(ProblemKind::BadInput, detail, Some(&error)) }
            }
            AnalyzeError::Options(_) => problem(ProblemKind::BadInput, detail, None),
            AnalyzeError::Cancelled(_) => {
                let detail = "The time was over before everything was looked at. Raise deadline_s, lower the level, or \
                              send fewer files or faces.";
                problem(ProblemKind::DeadlineExceeded, detail.to_owned(), None)
            }
        }
        .into()
    }
}

fn problem(code: ProblemKind, mut detail: String, read: Option<&ReadError>) -> JobProblem {
    if read.is_some_and(|read| read.kind == ReadErrorKind::TooLarge) {
        detail.push_str(". Send the model with fewer faces");
    }
    JobProblem { code, detail, place: read.and_then(|read| read.place), file: None }
}
