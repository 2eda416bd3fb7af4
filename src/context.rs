//! What surrounds a piece of work in the engine: progress, cancellation, deadline, clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// What a repair is doing now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Reading the file.
    Read,
    /// Measuring what is wrong.
    Inspect,
    /// Running a tier's operators.
    Repair,
    /// Waiting for a Blender, since as many run on the machine as memory allows.
    Wait,
    /// Writing, reading back and judging a result.
    Verify,
    /// Handing over the best result.
    Finish,
}

/// Where a repair tells how far it is.
pub trait Progress: Sync {
    /// `tier` is set while a tier runs; `percent` (0 to 100) is of the whole repair and never falls.
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8);
    /// A line for the job's log, in words.
    fn log(&self, line: &str);
}

/// Progress that goes nowhere.
#[derive(Debug, Clone, Copy)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn report(&self, _stage: Stage, _tier: Option<u8>, _percent: u8) {}
    fn log(&self, _line: &str) {}
}

/// The work was asked to stop, or its time ran out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("stopped before it was finished")]
pub struct Cancelled;

/// What surrounds one repair: progress, cancellation, the deadline and the clock. Nothing in the engine asks the
/// operating system for these.
pub struct Context<'a> {
    progress: &'a dyn Progress,
    cancel: &'a AtomicBool,
    clock: &'a (dyn Fn() -> Duration + Sync),
    deadline: Duration,
    /// When verification ends; never before the deadline.
    end: Duration,
}

impl<'a> Context<'a> {
    /// `clock` gives the time since any fixed moment; `deadline` is on the same clock.
    pub fn new(
        progress: &'a dyn Progress,
        cancel: &'a AtomicBool,
        clock: &'a (dyn Fn() -> Duration + Sync),
        deadline: Duration,
    ) -> Self {
        Self { progress, cancel, clock, deadline, end: deadline }
    }

    /// The time on the clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        (self.clock)()
    }

    /// Time left to the deadline, zero when it has passed.
    #[must_use]
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_sub(self.now())
    }

    /// Asked by long loops every few thousand steps.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.load(Ordering::Relaxed) || self.remaining().is_zero() { Err(Cancelled) } else { Ok(()) }
    }

    /// Whether the work was asked to stop, apart from the deadline.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Whether the deadline has passed and nobody asked the work to stop.
    #[must_use]
    pub fn is_late(&self) -> bool {
        !self.is_cancelled() && self.remaining().is_zero()
    }

    /// The result of work that may be left out: none where the deadline ended it.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was asked to stop.
    pub fn unless_late<T>(&self, result: Result<T, Cancelled>) -> Result<Option<T>, Cancelled> {
        match result {
            Err(Cancelled) if !self.is_cancelled() => Ok(None),
            result => result.map(Some),
        }
    }

    /// The same surroundings, in which verification may go on for `time` after the deadline.
    #[must_use]
    pub fn with_overrun(&self, time: Duration) -> Context<'a> {
        Context { end: self.deadline.saturating_add(time), ..*self }
    }

    /// The same surroundings for the verification of what is handed out, which ends later than other work.
    #[must_use]
    pub fn for_verification(&self) -> Context<'a> {
        Context { deadline: self.end, ..*self }
    }

    /// The same surroundings with a deadline that leaves `time` for verification. Two fifths of the time after the deadline are
    /// planned for it; the rest is for estimates that were too short.
    #[must_use]
    pub fn leaving(&self, time: Duration) -> Context<'a> {
        let planned_end = self.deadline.saturating_add(self.end.saturating_sub(self.deadline) * 2 / 5);
        Context { deadline: self.deadline.min(planned_end.saturating_sub(time)), ..*self }
    }

    /// The same surroundings with a deadline, and an end of verification, that are earlier by `time`.
    #[must_use]
    pub fn ending_before(&self, time: Duration) -> Context<'a> {
        Context { deadline: self.deadline.saturating_sub(time), end: self.end.saturating_sub(time), ..*self }
    }

    /// The same surroundings with a deadline no later than `time` from now.
    #[must_use]
    pub fn limited_to(&self, time: Duration) -> Context<'a> {
        let deadline = self.deadline.min(self.now().saturating_add(time));
        Context { deadline, ..*self }
    }

    /// The same surroundings, but for where it tells how far it is.
    #[must_use]
    pub fn with_progress<'b>(&'b self, progress: &'b dyn Progress) -> Context<'b> {
        Context { progress, ..*self }
    }

    /// Tells how far the repair is.
    pub fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.progress.report(stage, tier, percent);
    }

    /// Writes a line to the job's log.
    pub fn log(&self, line: &str) {
        self.progress.log(line);
    }
}

/// A monotonic clock that starts now, for [`Context::new`].
pub fn monotonic_clock() -> impl Fn() -> Duration {
    let start = Instant::now();
    move || start.elapsed()
}
