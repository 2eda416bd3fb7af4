//! How the time of a repair is divided: what a verification takes, how far it may go beyond the deadline, and what was left out.
//!
//! A repair keeps its deadline within 2 s and 10 %, with a result that was verified. So operators end early enough for
//! their result to be verified, and verification itself is stopped at a hard end. What a verification takes follows from how long
//! the first inspection of the input took, face by face, and then from the verifications before it.

use std::cell::{Cell, RefCell};
use std::time::Duration;

use super::report::OmittedSection;
use crate::context::Context;

/// How far verification may go beyond the deadline: so many seconds, and such a share of the time there is. Both are below the
/// 2 s and 10 % that are promised: the rest is for writing the result and its report.
const OVERRUN_S: f64 = 1.25;
const OVERRUN_SHARE: f64 = 0.06;
/// What is promised.
const PROMISED_S: f64 = 2.0;
const PROMISED_SHARE: f64 = 0.1;

/// A verification in terms of the structure and the measures of a mesh: it also writes and reads the mesh and compares it with the
/// input.
const TIMES_MEASURING: f64 = 2.5;
/// How much longer than the last verification the next one may take.
const MARGIN: f64 = 1.2;
/// Share of the time left that details of the input's inspection may take.
const DETAILS_SHARE: f64 = 0.25;
/// Share of an estimate that must be left for a verification to be begun.
const WORTH_BEGINNING: f64 = 0.6;

/// The time after a deadline of `deadline_s` seconds by which a repair has ended.
#[must_use]
pub fn promised_overrun(deadline: Duration) -> Duration {
    Duration::from_secs_f64(PROMISED_S) + deadline.mul_f64(PROMISED_SHARE)
}

/// The surroundings of a repair that begins now.
pub(super) fn with_overrun<'a>(context: &Context<'a>) -> Context<'a> {
    let whole = context.remaining().min(Duration::from_secs(3600));
    context.with_overrun(Duration::from_secs_f64(OVERRUN_S) + whole.mul_f64(OVERRUN_SHARE))
}

/// What is known of the time that things take, and what there was no time for.
#[derive(Debug, Default)]
pub(super) struct TimeBudget {
    /// Seconds that a verification takes for each face of the input and of the result together.
    seconds_per_face: Cell<f64>,
    input_faces: usize,
    omitted: RefCell<Vec<OmittedSection>>,
}

impl TimeBudget {
    /// From how long the structure and the measures of the input took.
    pub fn new(input_faces: usize, measuring: Duration) -> Self {
        let seconds = TIMES_MEASURING * measuring.as_secs_f64();
        let seconds_per_face = Cell::new(seconds / (2 * input_faces).max(1) as f64);
        Self { seconds_per_face, input_faces, omitted: RefCell::default() }
    }

    /// How long the verification of a result of so many faces takes, about.
    pub fn verification(&self, faces: usize) -> Duration {
        let seconds = self.seconds_per_face.get() * (self.input_faces + faces) as f64;
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
    }

    /// Notes how long the verification of a result of so many faces took.
    pub fn note_verification(&self, faces: usize, took: Duration) {
        let per_face = MARGIN * took.as_secs_f64() / (self.input_faces + faces).max(1) as f64;
        self.seconds_per_face.set(per_face);
    }

    /// Whether there is about the time to verify a result of so many faces.
    pub fn can_verify(&self, faces: usize, context: &Context<'_>) -> bool {
        context.for_verification().remaining() >= self.verification(faces).mul_f64(WORTH_BEGINNING)
    }

    /// The surroundings of an operator, which leave time to verify a result of so many faces.
    pub fn for_operators<'a>(&self, faces: usize, context: &Context<'a>) -> Context<'a> {
        context.leaving(self.verification(faces))
    }

    /// Notes what there was no time for.
    pub fn leave_out(&self, what: OmittedSection) {
        let mut all = self.omitted.borrow_mut();
        if let Err(at) = all.binary_search(&what) {
            all.insert(at, what);
        }
    }

    /// What there was no time for.
    pub fn omitted(&self) -> Vec<OmittedSection> {
        self.omitted.borrow().clone()
    }
}

/// The surroundings of the details of the input's inspection, which leave most of the time to the repair.
pub(super) fn for_details<'a>(context: &Context<'a>) -> Context<'a> {
    context.limited_to(context.remaining().mul_f64(DETAILS_SHARE))
}
