//! Alternatives to a result: the same request run again with one option changed, where the file leaves the model's intent open.
//!
//! [`AlternativeRuns`] finds the open questions of a finished repair, and then makes one alternative at a time. Each one is a whole
//! repair with its own verification and report. An alternative is not offered if its repair fails, or if its result is not printable or
//! has the same bytes as another.

mod questions;

use std::collections::VecDeque;
use std::time::Duration;

use self::questions::{Answer, open_questions};
use super::input::RepairError;
use super::options::Options;
use super::pipeline::{Repaired, repair};
use super::remesher::Remesher;
use super::report::{
    Alternative, Alternatives, NotOffered, NotOfferedCause, OfferedFile, Outcome, RedFlagCode, Report,
};
use crate::context::{Context, Progress, Stage};
use crate::format::Limits;

/// Most results to choose from, including the default.
const MAX_RESULTS: usize = 3;
/// The id of the default result.
pub const DEFAULT_CHOICE: &str = "default";

/// A result that the caller may choose instead of the default.
#[derive(Debug, Clone, PartialEq)]
pub struct RepairedAlternative {
    /// The id to choose the result by, such as `interior-keep`.
    pub id: String,
    /// The result, with its whole report.
    pub repaired: Repaired,
}

/// The request of a repair, as input for its alternatives.
#[derive(Clone, Copy)]
pub struct AlternativeRequest<'a> {
    /// The bytes of the input.
    pub input: &'a [u8],
    /// The options of the repair.
    pub options: &'a Options,
    /// Limits of the file readers.
    pub limits: &'a Limits,
    /// Blender, if it is available.
    pub remesher: Option<&'a dyn Remesher>,
    /// Progress, cancellation, and the deadline that all alternatives share.
    pub context: &'a Context<'a>,
}

/// The alternatives of one repair, made one at a time.
pub struct AlternativeRuns<'a> {
    request: AlternativeRequest<'a>,
    /// The duration of the repair that made the default.
    default_time: Duration,
    /// The answers that were not tried yet.
    untried: VecDeque<Answer>,
    /// The bytes of all results that are offered so far.
    results: Vec<Vec<u8>>,
    summary: Alternatives,
}

impl<'a> AlternativeRuns<'a> {
    /// Finds the open questions of a repair whose result is `default`.
    ///
    /// # Errors
    /// [`RepairError`] if the job was canceled, or the result cannot be read back.
    pub fn new(request: AlternativeRequest<'a>, default: &Repaired) -> Result<Self, RepairError> {
        let answers = open_questions(default, request.context)?;
        let is_offered = default.report.verdict.file != OfferedFile::None;
        let first = is_offered.then(|| {
            let detail = "The result with the requested options.".to_owned();
            summary_of(None, detail, &default.report)
        });
        let summary = Alternatives { offered: first.into_iter().flatten().collect(), not_offered: Vec::new() };
        Ok(Self {
            request,
            default_time: Duration::from_secs_f64(default.report.milliseconds.max(0.0) / 1e3),
            untried: answers.into(),
            results: vec![default.bytes.clone()],
            summary,
        })
    }

    /// The results that are offered so far. Answers that were not tried yet count as not offered.
    #[must_use]
    pub fn summary(&self) -> Alternatives {
        let mut summary = self.summary.clone();
        let untried = self.untried.iter().map(|answer| answer.not_offered(NotOfferedCause::NoTime, NO_TIME.to_owned()));
        summary.not_offered.extend(untried);
        summary
    }

    /// Makes the next alternative that can be offered; `None` if no answer is left to try.
    ///
    /// # Errors
    /// [`RepairError::Cancelled`] if the job was canceled.
    pub fn make_next(&mut self) -> Result<Option<RepairedAlternative>, RepairError> {
        while let Some(answer) = self.untried.pop_front() {
            match self.run(&answer)? {
                Ok(repaired) => {
                    self.summary.offered.extend(summary_of(Some(&answer), answer.detail.to_owned(), &repaired.report));
                    self.results.push(repaired.bytes.clone());
                    return Ok(Some(RepairedAlternative { id: answer.id(), repaired }));
                }
                Err((cause, reason)) => self.summary.not_offered.push(answer.not_offered(cause, reason)),
            }
        }
        Ok(None)
    }

    /// The result for one answer, or the reason why it is not offered.
    fn run(&self, answer: &Answer) -> Result<Result<Repaired, (NotOfferedCause, String)>, RepairError> {
        if self.results.len() >= MAX_RESULTS {
            return Ok(Err((NotOfferedCause::OverLimit, format!("A job offers at most {MAX_RESULTS} results."))));
        }
        let AlternativeRequest { input, options, limits, remesher, context } = self.request;
        if context.remaining() < self.default_time {
            return Ok(Err((NotOfferedCause::NoTime, NO_TIME.to_owned())));
        }
        let Some(options) = with_answer(options, answer) else {
            return Ok(Err((NotOfferedCause::Failed, format!("`{}` is not a valid option.", answer.option()))));
        };
        let progress = AlternativeLog { id: answer.id(), context };
        let context = &context.with_progress(&progress);
        match repair(input, &options, limits, remesher, context) {
            Ok(repaired) => Ok(self.refusal(&repaired).map_or(Ok(repaired), Err)),
            Err(RepairError::Cancelled(stop)) => Err(stop.into()),
            Err(RepairError::OutOfTime(_)) => Ok(Err((NotOfferedCause::NoTime, NO_TIME.to_owned()))),
            Err(error) => Ok(Err((NotOfferedCause::Failed, error.to_string()))),
        }
    }

    /// The reason why a result is not offered; `None` if it is offered.
    fn refusal(&self, repaired: &Repaired) -> Option<(NotOfferedCause, String)> {
        let report = &repaired.report;
        if self.results.contains(&repaired.bytes) {
            return Some((
                NotOfferedCause::SameResult,
                "The result is identical to one that is already offered.".to_owned(),
            ));
        }
        if let Some(refusal) = report.refusal() {
            return Some((NotOfferedCause::RequirementMissed, refusal));
        }
        (!is_worth_offering(report)).then(|| (NotOfferedCause::NotPrintable, report.summary.clone()))
    }
}

const NO_TIME: &str = "The deadline left no time for this repair: raise `deadline_s`.";

/// Whether a result is printable, or at least each of its objects is printable by itself.
fn is_worth_offering(report: &Report) -> bool {
    let only_objects_intersect = report.outcome == Outcome::PartiallyRepaired
        && !report.objects.is_empty()
        && report.objects.iter().all(|object| object.outcome.is_printable())
        && report.red_flags.iter().all(|flag| flag.code == RedFlagCode::ObjectsIntersect);
    report.outcome.is_printable() || only_objects_intersect
}

/// The options with one answer, without further alternatives; `None` if an option is out of range.
fn with_answer(options: &Options, answer: &Answer) -> Option<Options> {
    let mut fields = serde_json::to_value(options).ok()?;
    fields[answer.name] = answer.value.into();
    let options: Options = serde_json::from_value(fields).ok()?;
    let options = Options { alternatives: false, ..options };
    options.validate().is_ok().then_some(options)
}

/// The summary of one result; `None` if the repair wrote no file.
fn summary_of(answer: Option<&Answer>, detail: String, report: &Report) -> Option<Alternative> {
    let (file, after) = (report.output.clone()?, report.after.as_ref()?);
    let measures = &after.measures;
    let mm = report.unit.used.millimetres();
    let density =
        report.options.print.profile().and_then(|profile| profile.material_density).map(|density| density.g_cm3);
    let volume_mm3 = Some(measures.volume.value * mm.powi(3)).filter(|_| measures.volume.reliable);
    Some(Alternative {
        id: answer.map_or_else(|| DEFAULT_CHOICE.to_owned(), Answer::id),
        is_default: answer.is_none(),
        question: answer.map(|answer| answer.question),
        option: answer.map(Answer::option),
        detail,
        outcome: report.outcome,
        printable: report.verdict.printable,
        print_ready: report.verdict.print_ready,
        file,
        size_mm: measures.bounding_box.as_ref().map(|bounds| [0, 1, 2].map(|k| (bounds.max[k] - bounds.min[k]) * mm)),
        volume_mm3,
        area_mm2: measures.area * mm * mm,
        thinnest_wall_mm: after
            .print
            .as_ref()
            .and_then(|print| print.thinnest_wall.as_ref())
            .map(|wall| wall.thickness * mm),
        weight_g: volume_mm3.zip(density).map(|(volume, density)| volume / 1e3 * density),
        faces: measures.faces,
        parts: measures.parts,
    })
}

/// Passes on an alternative's log lines, each with the alternative's id in front, and drops its progress: the job has its own.
struct AlternativeLog<'a> {
    id: String,
    context: &'a Context<'a>,
}

impl Progress for AlternativeLog<'_> {
    fn report(&self, _stage: Stage, _tier: Option<u8>, _percent: u8) {}

    fn log(&self, line: &str) {
        self.context.log(&format!("{}: {line}", self.id));
    }

    fn expect_remaining(&self, remaining: Duration) {
        self.context.expect_remaining(remaining);
    }
}

impl Answer {
    fn not_offered(&self, cause: NotOfferedCause, reason: String) -> NotOffered {
        NotOffered { id: self.id(), question: self.question, option: self.option(), cause, reason }
    }
}
