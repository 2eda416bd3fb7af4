//! The repair of one body. A body is a whole file, or one of its objects.
//!
//! The repair makes a plan, runs the plan's strategies, and keeps the best result if it is better than the input.

use super::conclusion::{Conclusion, RepairedBody, why_no_face_was_removed};
use super::escalation::{Attempts, Escalation};
use super::export::{judged_soup, judging_format};
use super::input::{Input, MeshSource, RepairError, RepairRequest, with_inspected_input};
use super::judge::{Judged, rank_of_input, read_own, verdict_text};
use super::options::{Category, Interior, Options, Preset};
use super::options_not_applied::{Ending, options_not_applied};
use super::plan::{categorise, make_plan};
use super::prefix_cache::PrefixCache;
use super::presets::changes_printable;
use super::report::{Candidate, ObjectReport, OmittedSection, Outcome, Plan};
use super::report_draft::{ObjectPlace, ReportDraft};
use super::runner::Runner;
use crate::context::{Cancelled, Context, Progress, Stage};
use crate::format::{Format, ReadFile};
use crate::inspect::Measures;
use crate::mesh::{Soup, Surface};
use crate::printing::skin::recognise_double_shell;
use crate::scene::Object;
use std::borrow::Cow;
use std::time::Duration;

/// Least share of the area in the two largest parts of a double shell: its skins, or both skins joined.
const MAIN_SHARE: f64 = 0.8;

/// Repairs one body: makes a plan, runs its strategies, and inspects the best result. Results are judged in `format`.
///
/// # Errors
/// [`RepairError`] if the job was canceled, or if nothing can be written in `format`.
pub(super) fn repair_body(
    input: &Input<'_>,
    format: Format,
    request: &RepairRequest<'_>,
) -> Result<RepairedBody, RepairError> {
    let &RepairRequest { options, remesher, context, .. } = request;
    let baseline = Baseline::of(input, format, options, context)?;
    let is_double_shell = !baseline.is_enough(options) && is_double_shell(input, options, context)?;
    let conclusion = if baseline.is_enough(options) {
        let mut conclusion =
            Conclusion::with_input(baseline.printable, "the input is already printable, so no strategy was run");
        conclusion.draft.outcome = Outcome::AlreadyPrintable;
        conclusion.draft.options_not_applied = options_not_applied(options, &[], &Ending::Untouched);
        conclusion
    } else if context.is_late() {
        input.time.omit(OmittedSection::Repair);
        let judged = input.unchanged_input(format, options, context)?;
        let mut conclusion = Conclusion::with_input(judged, "the deadline passed before a plan could be made");
        conclusion.draft.warnings = baseline.warnings;
        conclusion
    } else {
        let cache = if request.reuses_prefixes { PrefixCache::default() } else { PrefixCache::disabled() };
        let unit = input.analysis.facts.unit.cloned().unwrap_or_default();
        let runner =
            Runner { options, input: input.analysis, format, remesher, context, time: input.time, unit: &unit };
        attempt(input, baseline, runner, cache, is_double_shell)?
    };
    RepairedBody::of(conclusion, input, options, context)
}

/// Whether the options leave it to the repair to fill an interior, and the input is a double shell. A passed deadline counts as no.
///
/// A printable input is not asked about: whoever made a clean, sealed cavity most likely meant it.
fn is_double_shell(input: &Input<'_>, options: &Options, context: &Context<'_>) -> Result<bool, Cancelled> {
    if options.preset != Preset::Auto || options.print.interior != Interior::Auto || options.max_tier < 2 {
        return Ok(false);
    }
    let analysis = input.analysis;
    let mut areas: Vec<f64> = analysis.solids.iter().map(|solid| solid.area).collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    if areas.iter().take(2).sum::<f64>() < MAIN_SHARE * areas.iter().sum::<f64>() {
        return Ok(false);
    }
    let shell = recognise_double_shell(analysis.unit(), &analysis.surface.faces, analysis.tree(), context);
    Ok(context.unless_late(shell)?.flatten().is_some())
}

/// The input as the baseline that a result must improve on.
struct Baseline {
    /// The measures of the input, or of the input as written in the output format if that breaks it.
    measures: Measures,
    /// The unchanged input as a result; none if the input is not printable.
    printable: Option<Judged>,
    /// Whether the result must have fewer faces.
    fewer: bool,
    /// Warnings about the baseline.
    warnings: Vec<String>,
}

impl Baseline {
    fn of(input: &Input<'_>, format: Format, options: &Options, context: &Context<'_>) -> Result<Self, RepairError> {
        let mut measures = input.before.measures.clone();
        let fewer = options.asks_for_fewer_faces_than(measures.faces);
        let (mut printable, mut warnings) = (None, Vec::new());
        if measures.printable() {
            match input.unchanged_input(format, options, context) {
                Ok(Some(untouched)) if untouched.measures.printable() => printable = Some(untouched),
                Ok(Some(broken)) => measures = broken.measures,
                Ok(None) | Err(RepairError::Write(_)) => {}
                Err(error) => return Err(error),
            }
            if printable.is_none() {
                warnings.push(
                    "The input is printable, but not after rounding to the number precision of the output format."
                        .to_owned(),
                );
            }
        }
        Ok(Self { measures, printable, fewer, warnings })
    }

    /// Whether the input is printable and the options ask for nothing more.
    fn is_enough(&self, options: &Options) -> bool {
        self.printable.is_some() && !self.fewer && !changes_printable(options)
    }
}

/// Makes a plan, runs its strategies, and decides whether the best result replaces the input.
fn attempt(
    input: &Input<'_>,
    baseline: Baseline,
    runner: Runner<'_>,
    cache: PrefixCache,
    is_double_shell: bool,
) -> Result<Conclusion, RepairError> {
    let Runner { options, format, context, .. } = runner;
    let Baseline { measures, printable, fewer, mut warnings } = baseline;
    let escalation = Escalation::start(input, runner, cache)?;
    let sheets = if measures.boundary_edges > 0 { escalation.sheet_share()? } else { 0.0 };
    let damage = if printable.is_some() { Category::Clean } else { categorise(&measures, sheets) };
    let category = options.category.filter(|_| options.preset == Preset::Auto).unwrap_or(damage);
    let plan = make_plan(&measures, category, is_double_shell, options);
    context.log(&format!("plan: {} ({})", plan.preset.as_str(), plan.reason));
    let Attempts { steps, mut candidates, best } = escalation.run(&plan.strategies)?;

    let is_better = |best: &Judged| match &printable {
        Some(_) if fewer && best.measures.printable() && best.measures.faces < measures.faces => true,
        Some(untouched) => best.is_good() && !have_same_faces(best, untouched),
        None => best.rank() < rank_of_input(&measures),
    };
    let best = best.map(|(index, judged)| BestResult {
        index,
        strategy: candidates[index].strategy.unwrap_or_default(),
        is_result: is_better(&judged),
        judged,
    });
    let options_not_applied = match &best {
        Some(best) => options_not_applied(options, &steps, &best.ending(&plan, &verdict_text(&best.judged))),
        None => options_not_applied(
            options,
            &steps,
            &Ending::InputKept { best: None, why: "no strategy produced a result" },
        ),
    };
    let steps = steps.into_iter().map(|executed| executed.step).collect();
    let mut draft = ReportDraft { steps, options_not_applied, ..ReportDraft::of_plan(plan) };
    let (judged, strategy) = match (best.filter(|best| best.is_result), printable) {
        (Some(best), _) => {
            candidates[best.index].chosen = true;
            draft.outcome = if best.judged.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
            (Some(best.judged), Some(best.strategy))
        }
        (None, Some(untouched)) => {
            if fewer {
                warnings.extend(why_no_face_was_removed(&draft.steps));
            }
            candidates.push(Candidate::new(None, &untouched, true));
            draft.outcome = Outcome::AlreadyPrintable;
            (Some(untouched), None)
        }
        (None, None) => {
            let judged = input.unchanged_input(format, options, context)?;
            candidates.extend(judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
            (judged, None)
        }
    };
    Ok(Conclusion { draft: ReportDraft { candidates, warnings, ..draft }, judged, strategy })
}

/// The best result of a plan's strategies.
struct BestResult {
    /// Index among the candidates.
    index: usize,
    /// Index of the strategy that made the result.
    strategy: u32,
    judged: Judged,
    /// Whether the result replaces the input.
    is_result: bool,
}

impl BestResult {
    /// The ending of the repair with this result, for the check of the options.
    fn ending<'a>(&self, plan: &Plan, why: &'a str) -> Ending<'a> {
        let (strategy, preset) = (self.strategy, plan.strategies[self.strategy as usize].preset);
        if self.is_result {
            Ending::Result { strategy, preset }
        } else if self.judged.is_good() {
            Ending::Unchanged { strategy, preset }
        } else {
            Ending::InputKept { best: Some(strategy), why }
        }
    }
}

/// Whether the bytes of two results hold the same faces in the same order.
fn have_same_faces(one: &Judged, other: &Judged) -> bool {
    if one.bytes == other.bytes {
        return true;
    }
    let (Ok(one), Ok(other)) = (read_own(&one.bytes), read_own(&other.bytes)) else { return false };
    let (one, other) = (one.soup, other.soup);
    one.faces.len() == other.faces.len() && (0..one.faces.len()).all(|f| one.corners(f) == other.corners(f))
}

/// A repaired object, before its colours and materials are restored.
pub(super) struct RepairedObject {
    /// The object's report.
    pub report: ObjectReport,
    /// The object before the repair, welded.
    pub before: Surface,
    /// The resulting mesh; none if it has no face that can be written.
    pub soup: Option<Soup>,
    /// For each face of the result, the object's face that it comes from.
    pub source: Vec<u32>,
    /// Whether the file stores vertices of the same position separately, so that its object cannot stay as it is.
    pub welded: bool,
}

/// The repair of single objects of a file, with the file and the output format that they share.
pub(super) struct ObjectRepair<'a> {
    /// The file that was read.
    pub file: &'a ReadFile,
    /// The output format.
    pub format: Format,
}

impl ObjectRepair<'_> {
    /// Repairs one object as a separate mesh.
    ///
    /// # Errors
    /// [`RepairError`], as for [`repair_body`].
    pub fn run(
        &self,
        object: &Object,
        place: ObjectPlace,
        request: &RepairRequest<'_>,
    ) -> Result<RepairedObject, RepairError> {
        let context = request.context;
        let start = context.now();
        let soup = object.mesh().map_or_else(|| Cow::Owned(Soup::default()), |mesh| Cow::Borrowed(&mesh.soup));
        let mesh = self.file.mesh.of_same_file(Soup::default());
        let source = MeshSource { bytes: None, soup, mesh: &mesh, unit: self.file.unit.as_ref() };
        with_inspected_input(source, request, |input| {
            let body = repair_body(&input, judging_format(self.format), request)?;
            let soup = if body.bytes.is_empty() { None } else { Some(judged_soup(&body.bytes)?) };
            let welded = input.analysis.ingest.merged_vertices > 0 && self.format == Format::ThreeMf;
            let time = context.now().saturating_sub(start);
            let report = ObjectReport::new(place, &input, body.draft, time);
            Ok(RepairedObject { report, before: input.analysis.surface.clone(), soup, source: body.source, welded })
        })
    }
}

/// Maps the progress of one object's repair to a range of the whole repair's progress.
pub(super) struct ObjectProgress<'a> {
    /// The context of the whole repair.
    pub context: &'a Context<'a>,
    /// Start of the range, in percent of the whole repair.
    pub from: f64,
    /// End of the range, in percent of the whole repair.
    pub to: f64,
    /// The object's name, for the log.
    pub name: &'a str,
}

impl Progress for ObjectProgress<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        let percent = self.from + (self.to - self.from) * f64::from(percent) / 100.0;
        // A finished object does not finish the whole repair.
        let stage = if stage == Stage::Finish { Stage::Verify } else { stage };
        self.context.report(stage, tier, percent as u8);
    }

    fn log(&self, line: &str) {
        self.context.log(&format!("{}: {line}", self.name));
    }

    fn expect_remaining(&self, remaining: Duration) {
        self.context.expect_remaining(remaining);
    }
}
