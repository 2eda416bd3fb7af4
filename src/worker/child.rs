//! The child process of a job: reads its task, enters its sandbox and runs the engine.

use std::fs;
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use rustix::process::{Signal, getpgrp, kill_process_group};
use serde::de::DeserializeOwned;

use super::reporter::Reporter;
use super::task::{ChildSetup, ProcessLimits, Task, pause_at};
use crate::analyze::{self, Analyst, AnalyzeError, AnalyzeOptions};
use crate::blender::{BlenderConfig, BlenderRemesher};
use crate::context::{Context, monotonic_clock};
use crate::format::{ReadError, ReadErrorKind};
use crate::jobs::{Artifact, JobOptions, JobProblem, JobReport, ProblemKind};
use crate::render::Drawing;
use crate::repair::{
    self, AlternativeRequest, AlternativeRuns, OfferedFile, Options, Remesher, RepairError, Repaired,
    RepairedAlternative, draw_alternative, name_for_choice, repair,
};

/// The time between two progress lines that no step of the engine reports.
const TICK: Duration = Duration::from_secs(1);

/// The entry point of a job's child process: reads its task, enters its sandbox, does the work, and writes its files to
/// `folder`. A hostile file's memory use, or a crash that it causes, is confined to this process.
pub(super) fn run_job(folder: &Path) -> ExitCode {
    match try_run(folder) {
        Ok(code) => code,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

fn try_run(folder: &Path) -> io::Result<ExitCode> {
    read_request::<ChildSetup>()?.enter(folder)?;
    let Some(task) = read_line::<Task>()? else { return Ok(ExitCode::SUCCESS) };
    ProcessLimits::limit_cpu(task.cpu)?;
    apply_failpoints(task.first_attempt);
    end_with_worker()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(task.threads);
    // A single thread is this one, which saves starting another.
    let pool = if task.threads == 1 { pool.use_current_thread() } else { pool };
    pool.build_global().map_err(io::Error::other)?;
    let clock = monotonic_clock();
    let progress = Reporter::new(folder, &clock)?;
    let cancel = AtomicBool::new(false);
    let deadline = task.deadline();
    let context = Context::new(&progress, &cancel, &clock, deadline);
    match with_ticks(&progress, || work(folder, &task, &context)) {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(Failed::Io(error)) => Err(error),
        Err(Failed::Problem(problem)) => {
            context.log(&format!("failed: {}", problem.detail));
            fs::write(folder.join(Task::PROBLEM), serde_json::to_vec(&problem)?)?;
            Ok(ExitCode::from(Task::EXIT_PROBLEM))
        }
    }
}

/// Does work, and reports progress by the time meanwhile.
fn with_ticks<T>(progress: &Reporter<'_>, work: impl FnOnce() -> T) -> T {
    let (end, ends) = mpsc::channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            while ends.recv_timeout(TICK) == Err(mpsc::RecvTimeoutError::Timeout) {
                progress.tick();
            }
        });
        let done = work();
        drop(end);
        done
    })
}

/// Removes tests' failpoints from this process, except in a first attempt.
fn apply_failpoints(_first_attempt: bool) {
    #[cfg(feature = "failpoints")]
    if !_first_attempt {
        fail::list().into_iter().for_each(|(name, _)| fail::remove(name));
    }
}

/// Reads the worker's request: the first line on standard input.
///
/// # Errors
/// When there is no line, or it is not the expected JSON.
pub(super) fn read_request<T: DeserializeOwned>() -> io::Result<T> {
    read_line()?.ok_or_else(|| io::Error::other("the worker sent no request"))
}

/// Reads the next line on standard input; `None` if the worker closed the pipe.
fn read_line<T: DeserializeOwned>() -> io::Result<Option<T>> {
    let mut line = String::new();
    let bytes = io::stdin().read_line(&mut line)?;
    Ok(if bytes == 0 { None } else { Some(serde_json::from_str(&line)?) })
}

/// Starts a thread that watches the lifeline and kills the process group when the worker has ended. Nobody needs this job's
/// result then, and another worker may run the job again.
///
/// # Errors
/// When the thread can't be started.
pub(super) fn end_with_worker() -> io::Result<()> {
    thread::Builder::new().name("lifeline".to_owned()).stack_size(64 << 10).spawn(|| {
        let mut byte = [0];
        while matches!(io::stdin().read(&mut byte), Ok(n) if n > 0) {}
        let _ = kill_process_group(getpgrp(), Signal::KILL);
    })?;
    Ok(())
}

/// Why a task has no result.
enum Failed {
    /// The job's environment failed, so a retry may succeed.
    Io(io::Error),
    /// The job itself is to blame, so a retry would fail too.
    Problem(Box<JobProblem>),
}

/// Does the work of a task whose files lie in `folder`, and writes the result there: first the model, if there is one, then the
/// report, whose presence means that the work is done. A task with `draw` writes pictures instead.
fn work(folder: &Path, task: &Task, context: &Context<'_>) -> Result<(), Failed> {
    match (&task.options, task.draw) {
        (JobOptions::Repair(options), None) => run_repair(folder, task, options, context),
        (JobOptions::Analyze(options), None) => run_analysis(folder, task, options, context),
        (JobOptions::Repair(options), Some(offered_file)) => draw_repair(folder, task, options, offered_file, context),
        (JobOptions::Analyze(options), Some(_)) => draw_files(folder, task, options, context),
    }
}

fn run_repair(folder: &Path, task: &Task, options: &Options, context: &Context<'_>) -> Result<(), Failed> {
    let remesher = task.remesher.clone().map(|info| {
        BlenderRemesher::new(info, BlenderConfig { scratch: Some(folder.to_owned()), ..task.blender.clone() })
    });
    let remesher = remesher.as_ref().map(|r| -> &dyn Remesher { r });
    let bytes = fs::read(folder.join(Task::input(0)))?;
    let context = &context.limited_to(Duration::from_secs_f64(options.deadline_s));
    let mut repaired = repair(&bytes, options, &task.limits, remesher, context)?;
    if repaired.report.verdict.file == OfferedFile::Model {
        fs::write(folder.join(Task::MODEL), &repaired.bytes)?;
    }
    if options.alternatives {
        let request = AlternativeRequest { input: &bytes, options, limits: &task.limits, remesher, context };
        write_alternatives(folder, request, &mut repaired)?;
    }
    write_report(folder, Task::FULL_REPORT, &JobReport::Repair(Box::new(repaired.report)))
}

/// Makes the alternatives of a repair, writes the files of each, and lists them in the report. The report is written before the first
/// alternative, so an alternative that exceeds a limit does not cost the job its default result.
fn write_alternatives(folder: &Path, request: AlternativeRequest<'_>, default: &mut Repaired) -> Result<(), Failed> {
    let mut runs = AlternativeRuns::new(request, default)?;
    default.report.alternatives = Some(runs.summary());
    write_report(folder, Task::FULL_REPORT, &JobReport::Repair(Box::new(default.report.clone())))?;
    while let Some(RepairedAlternative { id, repaired }) = runs.make_next()? {
        pause_at("child-alternative");
        write_whole(folder, &Artifact::model_of(&id), &repaired.bytes)?;
        if request.options.pictures {
            let AlternativeRequest { input, limits, context, .. } = request;
            match draw_alternative(input, &repaired.bytes, &repaired.report, limits, context) {
                Ok(drawings) => drawings
                    .iter()
                    .try_for_each(|drawing| write_whole(folder, &name_for_choice(drawing.name, &id), &drawing.bytes))?,
                Err(error) => context.log(&format!("{id}: no picture was drawn: {error}")),
            }
        }
        write_report(folder, &Artifact::report_of(&id), &JobReport::Repair(Box::new(repaired.report)))?;
    }
    default.report.alternatives = Some(runs.summary());
    Ok(())
}

fn run_analysis(folder: &Path, task: &Task, options: &AnalyzeOptions, context: &Context<'_>) -> Result<(), Failed> {
    let mut analyst = Analyst::new(options, &task.limits, task.inputs.len(), context)?;
    for (number, input) in task.inputs.iter().enumerate() {
        analyst.add(&input.name, Some(&input.sha256), &fs::read(folder.join(Task::input(number)))?)?;
    }
    write_report(folder, Task::FULL_REPORT, &JobReport::Analyze(Box::new(analyst.finish()?)))
}

fn draw_repair(
    folder: &Path,
    task: &Task,
    options: &Options,
    offered_file: OfferedFile,
    context: &Context<'_>,
) -> Result<(), Failed> {
    pause_at("child-draw");
    let input = fs::read(folder.join(Task::input(0)))?;
    let model;
    let repaired = match offered_file {
        OfferedFile::None => None,
        OfferedFile::Original => Some(input.as_slice()),
        OfferedFile::Model => {
            model = fs::read(folder.join(Task::MODEL))?;
            Some(model.as_slice())
        }
    };
    let drawings = repair::draw(&input, repaired, options, &task.limits, context);
    write_drawings(folder, 0, drawings.map_err(io::Error::other)?)
}

fn draw_files(folder: &Path, task: &Task, options: &AnalyzeOptions, context: &Context<'_>) -> Result<(), Failed> {
    pause_at("child-draw");
    for number in 0..task.inputs.len() {
        let bytes = fs::read(folder.join(Task::input(number)))?;
        let drawings = analyze::draw(&bytes, options, &task.limits, context);
        write_drawings(folder, number, drawings.map_err(io::Error::other)?)?;
    }
    Ok(())
}

/// Writes the pictures of the job's file `number`, counted from 0.
fn write_drawings(folder: &Path, number: usize, drawings: Vec<Drawing>) -> Result<(), Failed> {
    let write = |drawing: &Drawing| write_whole(folder, &Task::drawing(number, drawing.name), &drawing.bytes);
    Ok(drawings.iter().try_for_each(write)?)
}

fn write_report(folder: &Path, name: &str, report: &JobReport) -> Result<(), Failed> {
    let report = serde_json::to_vec_pretty(report).map_err(io::Error::from)?;
    if report.len() > Task::REPORT_BYTES {
        let max = Task::REPORT_BYTES >> 20;
        let detail =
            format!("The report is larger than the maximum of {max} MiB. Request fewer places, or send fewer files.");
        return Err(problem(ProblemKind::FileLimit, detail, None).into());
    }
    Ok(write_whole(folder, name, &report)?)
}

/// Writes a file by renaming a temporary file, so that an interrupted process leaves either the whole file or none.
fn write_whole(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<()> {
    let temporary = folder.join(format!("{name}.half"));
    fs::write(&temporary, bytes)?;
    fs::rename(&temporary, folder.join(name))
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
let detail = "The time of `deadline_s` ran out before the analysis was complete. Set a larger `deadline_s` or a lower \
              `level`, or send fewer files or faces.";
                problem(ProblemKind::DeadlineExceeded, detail.to_owned(), None)
            }
        }
        .into()
    }
}

/// A problem with the place of the read error, if any. A file that is too large gets advice.
fn problem(code: ProblemKind, mut detail: String, read: Option<&ReadError>) -> JobProblem {
    if read.is_some_and(|read| read.kind == ReadErrorKind::TooLarge) {
        detail = format!("{}. Send the model with fewer faces.", detail.trim_end_matches('.'));
    }
    JobProblem { place: read.and_then(|read| read.place), ..JobProblem::new(code, detail) }
}
