//! The context of a piece of work in the engine: progress, cancellation, deadline and clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Items between two checks in [`Context::map_in_parallel`].
const BATCH: usize = 1 << 12;

/// The current stage of a repair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Reading the file.
    Read,
    /// Inspecting the mesh for defects.
    Inspect,
    /// Running a tier's operators.
    Repair,
    /// Waiting for a slot to run Blender; the machine's memory limits how many run at once.
    Wait,
    /// Writing, reading back and checking a result.
    Verify,
    /// Returning the best result.
    Finish,
}

/// The expected effort of a repair, from the counts of its inspection. An estimate is not a promise: repairs with equal counts differ widely.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Expected duration of the whole repair in milliseconds, on one idle core. A step that takes most of the time may
    /// correct it.
    pub milliseconds: u64,
    /// Expected peak memory in bytes.
    pub memory_bytes: u64,
}

/// Receives the progress of a repair.
pub trait Progress: Sync {
    /// Reports the stage. `tier` is set while a tier runs. `percent` (0 to 100) counts the whole repair and never decreases.
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8);
    /// Adds a line of text to the job's log.
    fn log(&self, line: &str);
    /// Receives the expected effort of the repair, once the input is inspected. By default it is ignored.
    fn estimate(&self, _estimate: Estimate) {}
    /// Receives how long the repair is expected to go on, from a step that takes most of the time. By default it is ignored.
    fn expect_remaining(&self, _remaining: Duration) {}
}

/// Discards all progress.
#[derive(Debug, Clone, Copy)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn report(&self, _stage: Stage, _tier: Option<u8>, _percent: u8) {}
    fn log(&self, _line: &str) {}
}

/// The work was cancelled, or its deadline passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the work was stopped before it finished")]
pub struct Cancelled;

/// The context of a repair: progress, cancellation, deadline and clock. The engine gets these only from the context, never from the
/// operating system.
pub struct Context<'a> {
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
    clock: &'a (dyn Fn() -> Duration + Sync),
    deadline: Duration,
    /// When verification ends; never before the deadline.
    end: Duration,
}

impl<'a> Context<'a> {
    /// A context whose `clock` returns the time since any fixed moment; `deadline` is a time on that clock.
    pub fn new(
        progress: &'a dyn Progress,
        cancel: &'a AtomicBool,
        clock: &'a (dyn Fn() -> Duration + Sync),
        deadline: Duration,
    ) -> Self {
        Self { progress, cancel, clock, deadline, end: deadline }
    }

    /// The current time on the clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        (self.clock)()
    }

    /// The time until the deadline; zero if it has passed.
    #[must_use]
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_sub(self.now())
    }

    /// Checks whether to continue. Long loops call this every few thousand steps.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled or the deadline has passed.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.load(Ordering::Relaxed) || self.remaining().is_zero() { Err(Cancelled) } else { Ok(()) }
    }

    /// Applies a function to each item in parallel, with a check before each batch of items.
    ///
    /// # Errors
    /// As for [`Context::check`].
    pub fn map_in_parallel<I: Sync, T: Send>(
        &self,
        items: &[I],
        function: impl Fn(&I) -> T + Sync,
    ) -> Result<Vec<T>, Cancelled> {
        let mut results = Vec::with_capacity(items.len());
        for batch in items.chunks(BATCH) {
            self.check()?;
            results.par_extend(batch.par_iter().map(&function));
        }
        Ok(results)
    }

    /// Whether the work was cancelled, whatever the deadline.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Whether the deadline has passed without a cancellation.
    #[must_use]
    pub fn is_late(&self) -> bool {
        !self.is_cancelled() && self.remaining().is_zero()
    }

    /// The result of optional work; `None` if the deadline ended it.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled.
    pub fn unless_late<T>(&self, result: Result<T, Cancelled>) -> Result<Option<T>, Cancelled> {
        match result {
            Err(Cancelled) if !self.is_cancelled() => Ok(None),
            result => result.map(Some),
        }
    }

    /// The same context, in which verification may continue for `time` after the deadline.
    #[must_use]
    pub fn with_overrun(&self, time: Duration) -> Context<'a> {
        Context { end: self.deadline.saturating_add(time), ..*self }
    }

    /// The same context for the verification of the offered result, which may end later than other work.
    #[must_use]
    pub fn for_verification(&self) -> Context<'a> {
        Context { deadline: self.end, ..*self }
    }

    /// The same context with a deadline that leaves `time` for verification. The plan uses two fifths of the time after the
    /// deadline; the rest is a reserve for estimates that were too short.
    #[must_use]
    pub fn leaving(&self, time: Duration) -> Context<'a> {
        let planned_end = self.deadline.saturating_add(self.end.saturating_sub(self.deadline) * 2 / 5);
        Context { deadline: self.deadline.min(planned_end.saturating_sub(time)), ..*self }
    }

    /// The same context with a deadline and an end of verification that are earlier by `time`.
    #[must_use]
    pub fn ending_before(&self, time: Duration) -> Context<'a> {
        Context { deadline: self.deadline.saturating_sub(time), end: self.end.saturating_sub(time), ..*self }
    }

    /// The same context with a deadline at most `time` from now.
    #[must_use]
    pub fn limited_to(&self, time: Duration) -> Context<'a> {
        let deadline = self.deadline.min(self.now().saturating_add(time));
        Context { deadline, ..*self }
    }

    /// The same context with another receiver of progress.
    #[must_use]
    pub fn with_progress<'b>(&'b self, progress: &'b dyn Progress) -> Context<'b> {
        Context { progress, ..*self }
    }

    /// Reports the repair's progress.
    pub fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.progress.report(stage, tier, percent);
    }

    /// Adds a line of text to the job's log.
    pub fn log(&self, line: &str) {
        self.progress.log(line);
    }

    /// Reports the expected effort of the repair.
    pub fn estimate(&self, estimate: Estimate) {
        self.progress.estimate(estimate);
    }

    /// Reports how long the repair is expected to go on, at most until the deadline. Called by steps that take most of the time.
    pub fn expect_remaining(&self, remaining: Duration) {
        self.progress.expect_remaining(remaining.min(self.remaining()));
    }
}

/// A monotonic clock that starts now, for [`Context::new`].
pub fn monotonic_clock() -> impl Fn() -> Duration {
    let start = Instant::now();
    move || start.elapsed()
}
