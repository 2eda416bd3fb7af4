//! The division of a repair's time: the estimated duration of a verification, its overrun of the deadline, and the omitted work.
//!
//! A repair overruns its deadline by at most 2 s plus 10 % and returns a verified result. So operators end early enough for a
//! verification, and the verification itself stops at a hard end. Its duration is estimated per face, from the first inspection of the
//! input and then from earlier verifications.

use std::cell::{Cell, RefCell};
use std::time::Duration;

use super::report::OmittedSection;
use crate::context::Context;

/// Seconds, and share of the time limit, by which verification may overrun the deadline. Both are below the promised 2 s plus 10 %: the
/// rest is for writing the result and its report.
const OVERRUN_S: f64 = 1.25;
const OVERRUN_SHARE: f64 = 0.06;
/// Seconds, and share of the time limit, by which a whole repair may overrun the deadline.
const PROMISED_S: f64 = 2.0;
const PROMISED_SHARE: f64 = 0.1;

/// Ratio of a verification's duration to that of measuring a mesh: a verification also writes, reads and compares the mesh.
const VERIFICATION_PER_MEASURING: f64 = 2.5;
/// Safety factor on the duration of the last verification.
const MARGIN: f64 = 1.2;
/// Share of the remaining time that the details of the input's inspection may take.
const DETAILS_SHARE: f64 = 0.25;
/// Share of the estimated duration that must remain for a verification to start.
const MIN_SHARE_TO_START: f64 = 0.6;

/// The longest time by which a repair with this deadline may overrun it.
#[must_use]
pub fn promised_overrun(deadline: Duration) -> Duration {
    Duration::from_secs_f64(PROMISED_S) + deadline.mul_f64(PROMISED_SHARE)
}

/// The context of a repair that begins now, with the overrun for verification.
pub(super) fn with_overrun<'a>(context: &Context<'a>) -> Context<'a> {
    let whole = context.remaining().min(Duration::from_secs(3600));
    context.with_overrun(Duration::from_secs_f64(OVERRUN_S) + whole.mul_f64(OVERRUN_SHARE))
}

/// The estimated duration of verifications, and the work omitted for lack of time.
#[derive(Debug, Default)]
pub(super) struct TimeBudget {
    /// Seconds of a verification per face of the input and of the result.
    seconds_per_face: Cell<f64>,
    input_faces: usize,
    omitted: RefCell<Vec<OmittedSection>>,
}

impl TimeBudget {
    /// Makes a budget from the time that analysing and measuring the input took.
    pub fn new(input_faces: usize, measuring: Duration) -> Self {
        let seconds = VERIFICATION_PER_MEASURING * measuring.as_secs_f64();
        let seconds_per_face = Cell::new(seconds / (2 * input_faces).max(1) as f64);
        Self { seconds_per_face, input_faces, omitted: RefCell::default() }
    }

    /// The estimated duration of verifying a result with `faces` faces.
    pub fn verification(&self, faces: usize) -> Duration {
        let seconds = self.seconds_per_face.get() * (self.input_faces + faces) as f64;
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
    }

    /// Records how long the verification of a result with `faces` faces took.
    pub fn record_verification(&self, faces: usize, took: Duration) {
        let per_face = MARGIN * took.as_secs_f64() / (self.input_faces + faces).max(1) as f64;
        self.seconds_per_face.set(per_face);
    }

    /// Whether there is probably enough time to verify a result with `faces` faces.
    pub fn can_verify(&self, faces: usize, context: &Context<'_>) -> bool {
        context.for_verification().remaining() >= self.verification(faces).mul_f64(MIN_SHARE_TO_START)
    }

    /// The context of an operator, with a deadline that leaves time to verify a result with `faces` faces.
    pub fn for_operators<'a>(&self, faces: usize, context: &Context<'a>) -> Context<'a> {
        context.leaving(self.verification(faces))
    }

    /// Records work that was omitted for lack of time.
    pub fn omit(&self, section: OmittedSection) {
        let mut all = self.omitted.borrow_mut();
        if let Err(at) = all.binary_search(&section) {
            all.insert(at, section);
        }
    }

    /// The work that was omitted for lack of time, in the order of a repair.
    pub fn omitted(&self) -> Vec<OmittedSection> {
        self.omitted.borrow().clone()
    }
}

/// The context of the details of the input's inspection, with a deadline that leaves most of the time to the repair.
pub(super) fn for_details<'a>(context: &Context<'a>) -> Context<'a> {
    context.limited_to(context.remaining().mul_f64(DETAILS_SHARE))
}
