use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use rustix::process::{Signal, getpgrp, kill_process_group};
use serde::de::DeserializeOwned;

use super::pause_at;
use super::task::{Confinement, Task};
use super::work::{Failed, work};
use crate::blender::BlenderConfig;
use crate::context::{Context, Progress, Stage, monotonic_clock};
use crate::jobs::JobProgress;

/// Most bytes of a job's log.
const LOG_BYTES: u64 = 1 << 20;
/// Bytes of its files up to which a job is done by one thread: to wake others for so little costs more than they do.
const FOR_ONE_THREAD: u64 = 256 << 10;
/// Progress within a stage is told no more often than this, since whoever reads it wakes up for every line.
const TELL_EVERY: Duration = Duration::from_millis(50);

/// The inside of a job's child process: hears its task, enters its sandbox, does the work, and leaves its files in `folder`. The memory that
/// a hostile file makes it use, and a crash that it causes, stay in this process.
pub(super) fn run_child(folder: &Path) -> ExitCode {
    match try_run(folder) {
        Ok(code) => code,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

fn try_run(folder: &Path) -> io::Result<ExitCode> {
    let task: Task = told()?;
    shut_in(folder, &task.confinement, task.remesher.as_ref().map(|_| &task.blender))?;
    end_with_the_worker()?;
    if task.inputs.iter().map(|input| input.bytes).sum::<u64>() <= FOR_ONE_THREAD {
        let this_one = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
        this_one.build_global().map_err(io::Error::other)?;
    }
    let clock = monotonic_clock();
    let progress = Reporter::new(folder, &clock)?;
    let cancel = AtomicBool::new(false);
    let deadline = Duration::from_secs_f64(task.options.deadline_s().clamp(1.0, 3600.0));
    let context = Context::new(&progress, &cancel, &clock, deadline);
    match work(folder, &task, &context) {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(Failed::Io(error)) => Err(error),
        Err(Failed::Problem(problem)) => {
            context.log(&format!("failed: {}", problem.detail));
            fs::write(folder.join(Task::PROBLEM), serde_json::to_vec(&problem)?)?;
            Ok(ExitCode::from(Task::EXIT_PROBLEM))
        }
    }
}

/// Puts the limits on this process and enters the sandbox: first of all, while there is one thread and no byte of a stranger has
/// been read. Where there is a Blender to run, its locks can be reached from within.
pub(super) fn shut_in(folder: &Path, confinement: &Confinement, blender: Option<&BlenderConfig>) -> io::Result<()> {
    confinement.limits.apply()?;
    let mut sandbox = confinement.sandbox.clone();
    if let Some(blender) = blender {
        sandbox.readable.push(blender.prepare_slots()?);
    }
    sandbox.enter(folder)
}

/// What the worker wants done: the first line on standard input.
pub(super) fn told<T: DeserializeOwned>() -> io::Result<T> {
    let mut line = String::new();
    io::stdin().read_line(&mut line)?;
    Ok(serde_json::from_str(&line)?)
}

/// Watches the lifeline: when the worker is gone, however it went, nobody wants this job's result any more, and another
/// worker may run the job again, so the whole process group ends.
pub(super) fn end_with_the_worker() -> io::Result<()> {
    std::thread::Builder::new().name("lifeline".to_owned()).stack_size(64 << 10).spawn(|| {
        let mut byte = [0];
        while matches!(io::stdin().read(&mut byte), Ok(n) if n > 0) {}
        let _ = kill_process_group(getpgrp(), Signal::KILL);
    })?;
    Ok(())
}

/// Progress as lines on standard output, and the log as a file of bounded size.
struct Reporter<'a> {
    clock: &'a (dyn Fn() -> Duration + Sync),
    /// What was told last, and when.
    told: Mutex<Option<(Stage, Option<u8>, Duration)>>,
    log: Mutex<Log>,
}

struct Log {
    file: File,
    left: u64,
}

impl<'a> Reporter<'a> {
    fn new(folder: &Path, clock: &'a (dyn Fn() -> Duration + Sync)) -> io::Result<Self> {
        let file = File::options().create(true).append(true).open(folder.join(Task::LOG))?;
        Ok(Self { clock, told: Mutex::new(None), log: Mutex::new(Log { file, left: LOG_BYTES }) })
    }

    /// Whether it is time to tell of this, which then counts as told.
    fn is_due(&self, stage: Stage, tier: Option<u8>) -> bool {
        let now = (self.clock)();
        let Ok(mut told) = self.told.lock() else { return false };
        let lately = |&(s, t, at): &(_, _, Duration)| (s, t) == (stage, tier) && now < at + TELL_EVERY;
        let due = !told.as_ref().is_some_and(lately);
        if due {
            *told = Some((stage, tier, now));
        }
        due
    }
}

impl Progress for Reporter<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        let line = serde_json::to_string(&JobProgress { stage, tier, percent });
        if let Some(line) = line.ok().filter(|_| self.is_due(stage, tier)) {
            // A worker that stopped listening is about to end this process.
            let _ = writeln!(io::stdout(), "{line}");
            let _ = io::stdout().flush();
        }
        match (stage, tier) {
            (Stage::Read, _) => pause_at("child-read"),
            (Stage::Inspect, _) => pause_at("child-inspect"),
            (Stage::Repair, Some(1)) => pause_at("child-tier1"),
            (Stage::Repair, Some(2)) => pause_at("child-tier2"),
            (Stage::Repair, Some(3)) => pause_at("child-tier3"),
            (Stage::Verify, _) => pause_at("child-verify"),
            (Stage::Finish, _) => pause_at("child-finish"),
            (Stage::Repair | Stage::Wait, _) => {}
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
        // In one call of the operating system.
        if log.file.write_all(format!("{line}\n").as_bytes()).is_ok() {
            log.left = left;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn every_stage_is_told_and_what_comes_within_one_now_and_then() {
        let folder = tempfile::tempdir().expect("a folder");
        let now = AtomicU64::new(0);
        let clock = || Duration::from_millis(now.load(Ordering::Relaxed));
        let reporter = Reporter::new(folder.path(), &clock).expect("a log");
        let at = |milliseconds, stage, tier| {
            now.store(milliseconds, Ordering::Relaxed);
            reporter.is_due(stage, tier)
        };
        assert!(at(0, Stage::Read, None));
        assert!(at(1, Stage::Repair, Some(1)));
        assert!(!at(2, Stage::Repair, Some(1)));
        assert!(at(3, Stage::Repair, Some(2)));
        assert!(!at(52, Stage::Repair, Some(2)));
        assert!(at(53, Stage::Repair, Some(2)));
        assert!(!at(54, Stage::Repair, Some(2)));
        assert!(at(54, Stage::Verify, None));
    }

    #[test]
    fn a_log_ends_where_it_has_its_size() {
        let folder = tempfile::tempdir().expect("a folder");
        let reporter = Reporter::new(folder.path(), &|| Duration::ZERO).expect("a log");
        let line = "x".repeat(1000);
        (0..2000).for_each(|_| reporter.log(&line));
        let log = fs::read_to_string(folder.path().join(Task::LOG)).expect("a log");
        assert!(log.len() as u64 <= LOG_BYTES && log.len() > 1_000_000, "{}", log.len());
        assert!(log.ends_with("x\nthe log is cut here\n"));
    }
}
