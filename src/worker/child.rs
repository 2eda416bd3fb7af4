use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use rustix::process::{Signal, getpgrp, kill_process_group};

use super::pause_at;
use super::task::Task;
use crate::blender::{BlenderConfig, BlenderRemesher};
use crate::format::ReadErrorKind;
use crate::jobs::{JobProblem, JobProgress, ProblemKind};
use crate::render::Drawing;
use crate::repair::{Context, DrawError, Progress, Remesher, RepairError, Stage, draw, monotonic_clock, repair};

/// Most bytes of a job's log.
const LOG_BYTES: u64 = 1 << 20;

/// The inside of a job's child process: reads the task in `folder`, repairs, and leaves its files there. The memory that
/// a hostile file makes it use, and a crash that it causes, stay in this process.
#[must_use]
pub fn run_child(folder: &Path) -> ExitCode {
    match try_run(folder) {
        Ok(code) => code,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

fn try_run(folder: &Path) -> io::Result<ExitCode> {
    let task: Task = serde_json::from_slice(&fs::read(folder.join(Task::TASK))?)?;
    task.process.apply()?;
    end_with_the_worker()?;
    let progress = Reporter::new(folder)?;
    let cancel = AtomicBool::new(false);
    let clock = monotonic_clock();
    let deadline = Duration::from_secs_f64(task.options.deadline_s.clamp(1.0, 3600.0));
    let context = Context::new(&progress, &cancel, &clock, deadline);
    let remesher = task.remesher.map(|info| {
        BlenderRemesher::new(info, BlenderConfig { scratch: Some(folder.to_owned()), ..BlenderConfig::default() })
    });
    let remesher = remesher.as_ref().map(|r| -> &dyn Remesher { r });
    let bytes = fs::read(folder.join(Task::INPUT))?;
    match repair(&bytes, &task.options, &task.limits, remesher, &context) {
        Ok(repaired) => {
            fs::write(folder.join(Task::MODEL), &repaired.bytes)?;
            write_whole(folder, Task::REPORT, &serde_json::to_vec_pretty(&repaired.report)?)?;
            if task.options.pictures {
                pause_at("child-draw");
                leave_drawings(folder, || draw(&bytes, &repaired, &task.limits, &context), &context);
            }
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => {
            context.log(&format!("failed: {error}"));
            fs::write(folder.join(Task::PROBLEM), serde_json::to_vec(&explain(&error))?)?;
            Ok(ExitCode::from(Task::EXIT_PROBLEM))
        }
    }
}

/// Leaves pictures beside the result. The job has its result already, so that nothing that goes wrong here, be it a
/// panic, is more than a line in the log.
fn leave_drawings(folder: &Path, draw: impl FnOnce() -> Result<Vec<Drawing>, DrawError>, context: &Context<'_>) {
    let why = match catch_unwind(AssertUnwindSafe(draw)) {
        Ok(Ok(drawings)) => {
            let written = drawings.iter().try_for_each(|drawing| write_whole(folder, drawing.name, &drawing.bytes));
            written.err().map(|error| error.to_string())
        }
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("the drawing crashed".to_owned()),
    };
    if let Some(why) = why {
        context.log(&format!("without all pictures: {why}"));
    }
}

/// Writes a file so that it is there as a whole or not at all, should the process end meanwhile.
fn write_whole(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<()> {
    let half = folder.join(format!("{name}.half"));
    fs::write(&half, bytes)?;
    fs::rename(&half, folder.join(name))
}

/// Watches the lifeline: when the worker is gone, however it went, nobody wants this job's result any more, and another
/// worker may run the job again, so the whole process group ends.
fn end_with_the_worker() -> io::Result<()> {
    std::thread::Builder::new().name("lifeline".to_owned()).stack_size(64 << 10).spawn(|| {
        let mut byte = [0];
        while matches!(io::stdin().read(&mut byte), Ok(n) if n > 0) {}
        let _ = kill_process_group(getpgrp(), Signal::KILL);
    })?;
    Ok(())
}

fn explain(error: &RepairError) -> JobProblem {
    let (code, place) = match error {
        RepairError::Read(read) => (ProblemKind::BadInput, read.place),
        RepairError::Options(_) => (ProblemKind::BadInput, None),
        RepairError::Write(_) => (ProblemKind::BadOutput, None),
        RepairError::Cancelled(_) => (ProblemKind::DeadlineExceeded, None),
    };
    let mut detail = error.to_string();
    if matches!(error, RepairError::Read(read) if read.kind == ReadErrorKind::TooLarge) {
        detail.push_str(". Send the model with fewer faces");
    }
    JobProblem { code, detail, place }
}

/// Progress as lines on standard output, and the log as a file of bounded size.
struct Reporter {
    log: Mutex<Log>,
}

struct Log {
    file: File,
    left: u64,
}

impl Reporter {
    fn new(folder: &Path) -> io::Result<Self> {
        let file = File::options().create(true).append(true).open(folder.join(Task::LOG))?;
        Ok(Self { log: Mutex::new(Log { file, left: LOG_BYTES }) })
    }
}

impl Progress for Reporter {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        if let Ok(line) = serde_json::to_string(&JobProgress { stage, tier, percent }) {
            // A worker that stopped listening is about to end this process.
            let _ = writeln!(io::stdout(), "{line}");
            let _ = io::stdout().flush();
        }
        match (stage, tier) {
            (Stage::Read, _) => pause_at("child-read"),
            (Stage::Inspect, _) => pause_at("child-inspect"),
            (Stage::Repair, Some(1)) => pause_at("child-tier1"),
            (Stage::Repair, Some(3)) => pause_at("child-tier3"),
            (Stage::Verify, _) => pause_at("child-verify"),
            (Stage::Finish, _) => pause_at("child-finish"),
            (Stage::Repair, _) => {}
        }
    }

    fn log(&self, line: &str) {
        let Ok(mut log) = self.log.lock() else { return };
        let bytes = line.len() as u64 + 1;
        if log.left == 0 {
            return;
        }
        let left = log.left.saturating_sub(bytes);
        let line = if left == 0 { "the log is cut here" } else { line };
        if writeln!(log.file, "{line}").is_ok() {
            log.left = left;
        }
    }
}
