//! The questions about a model's intent that a repair had to decide, each with the answers that the repair did not choose.

use crate::analyze::subject;
use crate::context::{Cancelled, Context};
use crate::format::{self, Limits, ReadOptions};
use crate::inspect::{Analysis, Solid};
use crate::printing::skin::recognise_double_shell;
use crate::repair::input::RepairError;
use crate::repair::options::{Interior, Islands, Merge, Options, Preset, Voids};
use crate::repair::pipeline::Repaired;
use crate::repair::report::{Assumption, AssumptionKind, OfferedFile, OpenQuestion, Report};

/// An answer to an open question that differs from the answer of the default.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Answer {
    /// The question.
    pub question: OpenQuestion,
    /// The name of the option that gives this answer.
    pub name: &'static str,
    /// The option's value.
    pub value: &'static str,
    /// Description of the result, as text.
    pub detail: &'static str,
}

impl Answer {
    /// The id of the alternative.
    pub fn id(&self) -> String {
        format!("{}-{}", self.name, self.value)
    }

    /// The option, as `name=value`.
    pub fn option(&self) -> String {
        format!("{}={}", self.name, self.value)
    }
}

/// The answers that a repair did not choose, to the questions that the file leaves open, the most important first.
///
/// Most questions follow from the assumptions in the report. A model that needed no repair has no assumptions, so its surface is examined
/// too. A question is not open if an option of the request answers it.
///
/// # Errors
/// [`RepairError`] if the job was canceled, or the result cannot be read back.
pub(super) fn open_questions(repaired: &Repaired, context: &Context<'_>) -> Result<Vec<Answer>, RepairError> {
    let report = &repaired.report;
    if report.verdict.file == OfferedFile::None {
        return Ok(Vec::new());
    }
    let shape = context.unless_late(Shape::of(repaired, context)?)?.unwrap_or_default();
    let options: &Options = &report.options;
    let mut answers = Vec::new();
    answers.extend(interior(report, options, &shape));
    if answers.is_empty() {
        answers.extend(cavities(report, options, &shape));
    }
    answers.extend(objects(report, options));
    answers.extend(islands(report, options, &shape));
    Ok(answers)
}

/// A separate solid with less than this share of the largest solid's volume may be a loose piece of the largest solid.
const LOOSE_SHARE: f64 = 0.05;

/// The findings in a result's surface that open a question.
#[derive(Debug, Clone, Copy, Default)]
struct Shape {
    /// Whether the surface is a double shell.
    is_double_shell: bool,
    /// Whether closed surfaces enclose air.
    has_cavities: bool,
    /// Whether a separate solid has less than the least volume of an island by the options.
    has_islands: bool,
    /// Whether a separate solid has at least that volume, but less than [`LOOSE_SHARE`] of the largest solid's.
    has_loose_solids: bool,
}

impl Shape {
    /// Examines the written bytes of a result.
    ///
    /// # Errors
    /// Outer: [`RepairError`] if the bytes cannot be read back. Inner: [`Cancelled`] if the job was canceled or the deadline passed.
    fn of(repaired: &Repaired, context: &Context<'_>) -> Result<Result<Self, Cancelled>, RepairError> {
        let report = &repaired.report;
        let mut file = format::read_shape(&repaired.bytes, &ReadOptions::within(Limits::NONE))?;
        let unit = report.unit.used;
        file.settle_unit(file.own_unit().is_none().then_some(unit), Some(unit));
        let examined = || {
            let analysis = Analysis::new(subject(&file.mesh, Some(&report.unit)), context)?;
            let solids = || analysis.solids.iter().filter(|solid| solid.closed);
            let whole = || solids().map(|solid| solid.volume).sum();
            let least = report.options.print.min_island_volume(unit.millimetres(), whole);
            let largest = solids().map(|solid| solid.volume).fold(0.0, f64::max);
            let is_island = |solid: &Solid| solid.volume > 0.0 && solid.volume < least.min(largest);
            let is_loose = |solid: &Solid| (least..LOOSE_SHARE * largest).contains(&solid.volume);
            let faces = &analysis.surface.faces;
            Ok(Self {
                is_double_shell: recognise_double_shell(analysis.unit(), faces, analysis.tree(), context)?.is_some(),
                has_cavities: solids().any(|solid| solid.volume < 0.0),
                has_islands: solids().any(is_island),
                has_loose_solids: solids().any(is_loose),
            })
        };
        Ok(examined())
    }
}

/// Whether a repair reports an assumption of a kind, for the file or for one of its objects.
fn assumed(report: &Report, kind: AssumptionKind) -> bool {
    let is_of_kind = |assumption: &Assumption| assumption.kind == kind;
    report.assumptions.iter().any(is_of_kind)
        || report.objects.iter().any(|object| object.assumptions.iter().any(is_of_kind))
}

/// The question whether a double shell is solid or hollow: the answer that the repair did not choose.
fn interior(report: &Report, options: &Options, shape: &Shape) -> Option<Answer> {
    let answer = |value, detail| Answer { question: OpenQuestion::Interior, name: "interior", value, detail };
    if assumed(report, AssumptionKind::InteriorFilled) {
        return Some(answer("keep", "The model is hollow: the inner skin and the space inside stay as they are."));
    }
    let is_open = options.preset == Preset::Auto && options.print.interior == Interior::Auto && options.max_tier > 1;
    (is_open && shape.is_double_shell)
        .then(|| answer("fill", "The model is solid: all space that cannot be reached from outside is filled."))
}

/// The question whether sealed cavities are hollow or solid.
fn cavities(report: &Report, options: &Options, shape: &Shape) -> Option<Answer> {
    let answer = |name, value, detail| Answer { question: OpenQuestion::Cavities, name, value, detail };
    if assumed(report, AssumptionKind::CavitiesFilled) {
        return Some(answer("winding_rule", "odd", "Solids inside other solids become cavities."));
    }
    let print = &options.print;
    let is_open = print.voids == Voids::Keep && !print.fills_cavities() && print.interior != Interior::Fill;
    (is_open && shape.has_cavities).then(|| answer("voids", "fill", "Sealed cavities are solid."))
}

/// The question whether overlapping objects are one solid or several.
fn objects(report: &Report, options: &Options) -> Option<Answer> {
    let answer = |value, detail| Answer { question: OpenQuestion::Objects, name: "merge", value, detail };
    if options.merge != Merge::Auto {
        None
    } else if assumed(report, AssumptionKind::ObjectsUnited) {
        Some(answer("none", "Objects that intersect stay separate solids. Print each one by itself."))
    } else if assumed(report, AssumptionKind::OverlapRemoved) {
        Some(answer("objects", "All objects are one solid of one material."))
    } else {
        None
    }
}

/// The question whether small separate solids belong to the model.
fn islands(report: &Report, options: &Options, shape: &Shape) -> Vec<Answer> {
    let answer = |value, detail| Answer { question: OpenQuestion::Islands, name: "islands", value, detail };
    let were_dropped = || {
        let reverses = |assumption: &Assumption| assumption.option.as_deref() == Some(Islands::KEEP_SETTING);
        report.assumptions.iter().any(reverses)
            || report.objects.iter().any(|object| object.assumptions.iter().any(reverses))
    };
    if options.print.islands != Islands::Auto {
        return Vec::new();
    }
    let mut answers = Vec::new();
    if were_dropped() {
        answers.push(answer("keep", "Small separate solids stay."));
    } else if shape.has_islands {
        answers.push(answer("drop", "Small separate solids are removed."));
    }
    if shape.has_loose_solids && report.objects.len() < 2 {
        let detail =
            "Separate solids are joined to the largest solid by struts; solids too small to print are removed.";
        answers.push(answer("attach", detail));
    }
    answers
}
