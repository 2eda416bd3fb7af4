//! The progress and the log of a child process: progress lines on standard output, and a log file of bounded size.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use super::task::{Task, pause_at};
use crate::context::{Estimate, Progress, Stage};
use crate::jobs::JobProgress;

/// The largest size of a job's log, in bytes.
const LOG_BYTES: u64 = 1 << 20;
/// The least time between two progress lines of the same stage: the worker wakes up for every line.
const REPORT_EVERY: Duration = Duration::from_millis(50);
/// The share of the estimated time from which progress slows down, in case the estimate is too short.
const ON_TIME: f64 = 0.8;
/// The most that time alone makes of the percentage where a step gave the estimate.
const MOST_OF_STEP: f64 = 95.0;

/// Writes progress as lines on standard output, and the log to a file of bounded size.
pub(super) struct Reporter<'a> {
    clock: &'a (dyn Fn() -> Duration + Sync),
    last: Mutex<Option<Reported>>,
    expected: Mutex<Option<Expected>>,
    log: Mutex<Log>,
}

/// The expected effort.
#[derive(Clone, Copy)]
struct Expected {
    estimate: Estimate,
    /// The time on the clock at which the first estimate became known.
    since: Duration,
    /// Whether a step said how long it takes. Otherwise the estimate is from the counts of the inspection.
    is_by_step: bool,
}

/// The last progress line.
#[derive(Clone, Copy)]
struct Reported {
    stage: Stage,
    tier: Option<u8>,
    /// The engine's own percentage.
    engine: u8,
    percent: u8,
    at: Duration,
}

struct Log {
    file: File,
    /// Bytes that may still be written.
    remaining: u64,
}

impl<'a> Reporter<'a> {
    /// Opens the log in a job's folder.
    ///
    /// # Errors
    /// When the log can't be opened.
    pub fn new(folder: &Path, clock: &'a (dyn Fn() -> Duration + Sync)) -> io::Result<Self> {
        let file = File::options().create(true).append(true).open(folder.join(Task::LOG))?;
        let log = Mutex::new(Log { file, remaining: LOG_BYTES });
        Ok(Self { clock, last: Mutex::new(None), expected: Mutex::new(None), log })
    }

    /// Reports progress by the time that passed since the last line, since one step of the engine can take most of the time.
    pub fn tick(&self) {
        self.write(self.line_by_time());
    }

    /// The progress line between two reports of the engine; `None` if it would say the same as the last one.
    fn line_by_time(&self) -> Option<JobProgress> {
        let last = (*self.last.lock().ok()?)?;
        self.line(last.stage, last.tier, last.engine).filter(|line| line.percent > last.percent)
    }

    fn write(&self, line: Option<JobProgress>) {
        if let Some(line) = line.and_then(|line| serde_json::to_string(&line).ok()) {
            // A worker that closed the pipe is about to kill this process.
            let _ = writeln!(io::stdout(), "{line}");
            let _ = io::stdout().flush();
        }
    }

    /// The progress line of a report of the engine; `None` if no line is due.
    fn line(&self, stage: Stage, tier: Option<u8>, engine: u8) -> Option<JobProgress> {
        let now = (self.clock)();
        let mut last = self.last.lock().ok()?;
        let is_recent = |last: &Reported| (last.stage, last.tier) == (stage, tier) && now < last.at + REPORT_EVERY;
        if last.as_ref().is_some_and(is_recent) {
            return None;
        }
        let expected = *self.expected.lock().ok()?;
        let percent = expected.map_or(engine, |Expected { estimate, since, is_by_step }| {
            let passed = now.saturating_sub(since);
            timed_percent((engine, is_by_step), passed, Duration::from_millis(estimate.milliseconds))
        });
        let percent = percent.max(last.map_or(0, |last| last.percent));
        *last = Some(Reported { stage, tier, engine, percent, at: now });
        Some(JobProgress { stage, tier, percent, estimate: expected.map(|expected| expected.estimate) })
    }
}

/// The percentage of the work that is done, by the engine's own percentage and by the time that passed of an estimated duration.
///
/// The engine counts steps, whose durations differ a thousandfold, so the time decides. The steps limit the error of a wrong
/// estimate: progress stays between half of the engine's percentage and the middle of what the engine has left. The estimate of a step
/// itself is better, so then time may go on further.
fn timed_percent((engine, is_by_step): (u8, bool), passed: Duration, expected: Duration) -> u8 {
    let engine = f64::from(engine.min(100));
    if engine >= 100.0 {
        return 100;
    }
    let share = passed.as_secs_f64() / expected.as_secs_f64().max(1e-3);
    let most = f64::midpoint(engine, 100.0);
    let most = if is_by_step { most.max(MOST_OF_STEP) } else { most };
    let share = if share <= ON_TIME { share } else { 1.0 - ON_TIME * (1.0 - ON_TIME) / share };
    (100.0 * share).clamp(engine / 2.0, most) as u8
}

impl Progress for Reporter<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.write(self.line(stage, tier, percent));
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
        if log.remaining == 0 {
            return;
        }
        let remaining = log.remaining.saturating_sub(bytes);
        let line = if remaining == 0 { "log truncated: size limit reached" } else { line };
        // One system call for the whole line.
        if log.file.write_all(format!("{line}\n").as_bytes()).is_ok() {
            log.remaining = remaining;
        }
    }

    fn estimate(&self, estimate: Estimate) {
        if let Ok(mut expected) = self.expected.lock() {
            *expected = Some(Expected { estimate, since: (self.clock)(), is_by_step: false });
        }
    }

    fn expect_remaining(&self, remaining: Duration) {
        if let Ok(Some(expected)) = self.expected.lock().as_deref_mut() {
            let end = (self.clock)().saturating_sub(expected.since) + remaining;
            expected.estimate.milliseconds = u64::try_from(end.as_millis()).unwrap_or(u64::MAX);
            expected.is_by_step = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// Runs a test with a reporter whose clock shows some milliseconds.
    fn with_reporter(test: impl FnOnce(&Reporter<'_>, &AtomicU64)) {
        let folder = tempfile::tempdir().expect("a folder");
        let now = AtomicU64::new(0);
        let clock = || Duration::from_millis(now.load(Ordering::Relaxed));
        let reporter = Reporter::new(folder.path(), &clock).expect("a log");
        test(&reporter, &now);
    }

    #[test]
    fn progress_is_due_at_each_new_stage_and_then_at_intervals() {
        with_reporter(|reporter, now| {
            let at = |milliseconds, stage, tier| {
                now.store(milliseconds, Ordering::Relaxed);
                reporter.line(stage, tier, 0).is_some()
            };
            assert!(at(0, Stage::Read, None));
            assert!(at(1, Stage::Repair, Some(1)));
            assert!(!at(2, Stage::Repair, Some(1)));
            assert!(at(3, Stage::Repair, Some(2)));
            assert!(!at(52, Stage::Repair, Some(2)));
            assert!(at(53, Stage::Repair, Some(2)));
            assert!(!at(54, Stage::Repair, Some(2)));
            assert!(at(54, Stage::Verify, None));
        });
    }

    #[test]
    fn a_log_is_truncated_at_its_size_limit() {
        let folder = tempfile::tempdir().expect("a folder");
        let reporter = Reporter::new(folder.path(), &|| Duration::ZERO).expect("a log");
        let line = "x".repeat(1000);
        (0..2000).for_each(|_| reporter.log(&line));
        let log = fs::read_to_string(folder.path().join(Task::LOG)).expect("a log");
        assert!(log.len() as u64 <= LOG_BYTES && log.len() > 1_000_000, "{}", log.len());
        assert!(log.ends_with("x\nlog truncated: size limit reached\n"));
    }

    #[test]
    fn progress_follows_what_a_step_expects_to_take() {
        with_reporter(|reporter, now| {
            reporter.expect_remaining(Duration::from_secs(100));
            reporter.estimate(Estimate { milliseconds: 1_000, memory_bytes: 0 });
            now.store(400, Ordering::Relaxed);
            reporter.expect_remaining(Duration::from_millis(9_600));
            let at = |milliseconds| {
                now.store(milliseconds, Ordering::Relaxed);
                let line = reporter.line(Stage::Repair, Some(1), 15).expect("a line is due");
                (line.percent, line.estimate.map(|estimate| estimate.milliseconds))
            };
            assert_eq!(at(4_000), (40, Some(10_000)));
            assert_eq!(at(7_000), (70, Some(10_000)), "beyond the middle of what the engine has left");
            reporter.expect_remaining(Duration::from_secs(1));
            assert_eq!(at(40_000), (95, Some(8_000)));
        });
    }

    #[test]
    fn progress_follows_the_estimate_and_never_decreases() {
        with_reporter(|reporter, now| {
            let at = |milliseconds, tier, percent| {
                now.store(milliseconds, Ordering::Relaxed);
                reporter.line(Stage::Repair, Some(tier), percent).map(|line| line.percent)
            };
            assert_eq!(at(0, 1, 15), Some(15));
            reporter.estimate(Estimate { milliseconds: 10_000, memory_bytes: 0 });
            assert_eq!(at(3000, 2, 20), Some(30));
            let between = |milliseconds| {
                now.store(milliseconds, Ordering::Relaxed);
                reporter.line_by_time().map(|line| (line.stage, line.tier, line.percent))
            };
            assert_eq!(between(5000), Some((Stage::Repair, Some(2), 50)));
            assert_eq!(between(5060), None, "the same percentage");
            assert_eq!(at(8000, 2, 65), Some(80));
            assert_eq!(at(40_000, 2, 66), Some(83), "half of what the engine has left");
            assert_eq!(at(40_100, 2, 10), Some(83));
            assert_eq!(at(40_200, 2, 100), Some(100));
            assert_eq!(timed_percent((90, false), Duration::from_secs(1), Duration::from_secs(600)), 45);
            assert_eq!(timed_percent((90, false), Duration::ZERO, Duration::ZERO), 45);
        });
    }
}
