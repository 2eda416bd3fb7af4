use std::fs;
use std::io;
use std::path::Path;

use super::files::of_file;
use super::pause_at;
use super::task::Task;
use crate::analyze::{self, Analyst, AnalyzeError, AnalyzeOptions};
use crate::blender::{BlenderConfig, BlenderRemesher};
use crate::context::Context;
use crate::format::{ReadError, ReadErrorKind};
use crate::jobs::{JobOptions, JobProblem, JobReport, ProblemKind};
use crate::render::Drawing;
use crate::repair::{self, HandedOut, Options, Remesher, RepairError, repair};

/// Why it makes nothing.
pub(super) enum Failed {
    /// Something around the job failed, so it may be tried again.
    Io(io::Error),
    /// The job itself is to blame.
    Problem(Box<JobProblem>),
}

/// Does the work of a task whose files lie in `folder`, and leaves the result there: the model if one is handed out, then the report,
/// which says that the work is done; or pictures, where those are the task.
pub(super) fn work(folder: &Path, task: &Task, context: &Context<'_>) -> Result<(), Failed> {
    match (&task.options, task.draw) {
        (JobOptions::Repair(options), None) => run_repair(folder, task, options, context),
        (JobOptions::Analyze(options), None) => run_analysis(folder, task, options, context),
        (JobOptions::Repair(options), Some(handed_out)) => draw_repair(folder, task, options, handed_out, context),
        (JobOptions::Analyze(options), Some(_)) => draw_files(folder, task, options, context),
    }
}

fn run_repair(folder: &Path, task: &Task, options: &Options, context: &Context<'_>) -> Result<(), Failed> {
    let remesher = task.remesher.clone().map(|info| {
        BlenderRemesher::new(info, BlenderConfig { scratch: Some(folder.to_owned()), ..task.blender.clone() })
    });
    let remesher = remesher.as_ref().map(|r| -> &dyn Remesher { r });
    let bytes = fs::read(folder.join(Task::input(0)))?;
    let repaired = repair(&bytes, options, &task.limits, remesher, context)?;
    if repaired.report.verdict.file == HandedOut::Model {
        fs::write(folder.join(Task::MODEL), &repaired.bytes)?;
    }
    write_report(folder, &JobReport::Repair(Box::new(repaired.report)))
}

fn run_analysis(folder: &Path, task: &Task, options: &AnalyzeOptions, context: &Context<'_>) -> Result<(), Failed> {
    let mut analyst = Analyst::new(options, &task.limits, task.inputs.len(), context)?;
    for (number, input) in task.inputs.iter().enumerate() {
        analyst.add(&input.name, Some(&input.sha256), &fs::read(folder.join(Task::input(number)))?)?;
    }
    write_report(folder, &JobReport::Analyze(Box::new(analyst.finish()?)))
}

fn draw_repair(
    folder: &Path,
    task: &Task,
    options: &Options,
    handed_out: HandedOut,
    context: &Context<'_>,
) -> Result<(), Failed> {
    pause_at("child-draw");
    let input = fs::read(folder.join(Task::input(0)))?;
    let model;
    let repaired = match handed_out {
        HandedOut::None => None,
        HandedOut::Original => Some(input.as_slice()),
        HandedOut::Model => {
            model = fs::read(folder.join(Task::MODEL))?;
            Some(model.as_slice())
        }
    };
    let drawings = repair::draw(&input, repaired, options, &task.limits, context);
    leave_drawings(folder, 0, drawings.map_err(io::Error::other)?)
}

fn draw_files(folder: &Path, task: &Task, options: &AnalyzeOptions, context: &Context<'_>) -> Result<(), Failed> {
    pause_at("child-draw");
    for number in 0..task.inputs.len() {
        let bytes = fs::read(folder.join(Task::input(number)))?;
        let drawings = analyze::draw(&bytes, options, &task.limits, context);
        leave_drawings(folder, number, drawings.map_err(io::Error::other)?)?;
    }
    Ok(())
}

/// Leaves pictures of the job's file `number`.
fn leave_drawings(folder: &Path, number: usize, drawings: Vec<Drawing>) -> Result<(), Failed> {
    let write = |drawing: &Drawing| write_whole(folder, &of_file(number, drawing.name), &drawing.bytes);
    Ok(drawings.iter().try_for_each(write)?)
}

fn write_report(folder: &Path, report: &JobReport) -> Result<(), Failed> {
    let report = serde_json::to_vec_pretty(report).map_err(io::Error::from)?;
    if report.len() > Task::REPORT_BYTES {
        let most = Task::REPORT_BYTES >> 20;
        let detail = format!("The report would be larger than {most} MiB. Ask for fewer places, or send fewer files.");
        return Err(problem(ProblemKind::FileLimit, detail, None).into());
    }
    Ok(write_whole(folder, Task::FULL_REPORT, &report)?)
}

/// Writes a file so that it is there as a whole or not at all, should the process end meanwhile.
fn write_whole(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<()> {
    let half = folder.join(format!("{name}.half"));
    fs::write(&half, bytes)?;
    fs::rename(&half, folder.join(name))
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
            RepairError::Write(_) | RepairError::Unfaithful => (ProblemKind::BadOutput, None),
            RepairError::Cancelled(_) | RepairError::OutOfTime(_) => (ProblemKind::DeadlineExceeded, None),
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
