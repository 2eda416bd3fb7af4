//! What surrounds a piece of work in the engine: progress, cancellation, deadline, clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a repair is doing now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
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
pub trait Progress {
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
    clock: &'a dyn Fn() -> Duration,
    deadline: Duration,
}

impl<'a> Context<'a> {
    /// `clock` gives the time since any fixed moment; `deadline` is on the same clock.
    pub fn new(
        progress: &'a dyn Progress,
        cancel: &'a AtomicBool,
        clock: &'a dyn Fn() -> Duration,
        deadline: Duration,
    ) -> Self {
        Self { progress, cancel, clock, deadline }
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

    /// The same surroundings with no deadline, for work that must be done even when the time is over, such as
    /// judging the last result. It can still be cancelled.
    #[must_use]
    pub fn without_deadline(&self) -> Context<'a> {
        Context { progress: self.progress, cancel: self.cancel, clock: self.clock, deadline: Duration::MAX }
    }

    /// The same surroundings with a deadline no later than `time` from now.
    #[must_use]
    pub fn limited_to(&self, time: Duration) -> Context<'a> {
        let deadline = self.deadline.min(self.now().saturating_add(time));
        Context { progress: self.progress, cancel: self.cancel, clock: self.clock, deadline }
    }

    /// The same surroundings, but for where it tells how far it is.
    #[must_use]
    pub fn with_progress<'b>(&'b self, progress: &'b dyn Progress) -> Context<'b> {
        Context { progress, cancel: self.cancel, clock: self.clock, deadline: self.deadline }
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
