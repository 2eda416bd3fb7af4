//! The repair of one body, which is a whole file or an object of it: a plan, its strategies, and the best of their results.

use super::account::{Account, ObjectPlace};
use super::ended::{Ended, RepairedBody, why_no_face_went};
use super::escalation::{Attempts, Escalation};
use super::export::{judged_soup, judging_format};
use super::input::{Input, RepairError, Request, Source, inspected};
use super::judge::{Judged, rank_of_input, read_own, verdict_in_words};
use super::options::{Category, Options, Preset};
use super::options_not_applied::{Ending, options_not_applied};
use super::plan::{categorise, make_plan};
use super::prefix_cache::PrefixCache;
use super::presets::ask_of_printable;
use super::report::{Candidate, ObjectReport, OmittedSection, Outcome, Plan};
use super::runner::Runner;
use crate::context::{Context, Progress, Stage};
use crate::format::{Format, ReadFile};
use crate::inspect::Measures;
use crate::mesh::{Soup, Surface};
use crate::scene::Object;

/// Repairs one body: makes a plan, runs its strategies, and inspects the best result. Results are judged in `format`.
pub(super) fn repair_body(
    input: &Input<'_>,
    format: Format,
    request: &Request<'_>,
) -> Result<RepairedBody, RepairError> {
    let &Request { options, remesher, context, .. } = request;
    let to_beat = ToBeat::of(input, format, options, context)?;
    let ended = if to_beat.is_enough(options) {
        let mut ended = Ended::with_input(to_beat.printable, "the input is printable already, so nothing was run");
        ended.account.outcome = Outcome::AlreadyPrintable;
        ended.account.options_not_applied = options_not_applied(options, &[], &Ending::Untouched);
        ended
    } else if context.is_late() {
        input.time.leave_out(OmittedSection::Repair);
        let judged = input.handed_back(format, options, context)?;
        let mut ended = Ended::with_input(judged, "the time was over before a plan could be made");
        ended.account.warnings = to_beat.warnings;
        ended
    } else {
        let cache = if request.reuses_prefixes { PrefixCache::default() } else { PrefixCache::disabled() };
        attempt(input, to_beat, Runner { options, format, remesher, context, time: input.time }, cache)?
    };
    RepairedBody::of(ended, input, options, context)
}

/// What a result must surpass.
struct ToBeat {
    /// The measures of the input, or of what the output's format makes of it.
    measures: Measures,
    /// The input as it is handed back where no result surpasses it; none where it is not printable.
    printable: Option<Judged>,
    /// Whether the result is to have fewer faces.
    fewer: bool,
    warnings: Vec<String>,
}

impl ToBeat {
    fn of(input: &Input<'_>, format: Format, options: &Options, context: &Context<'_>) -> Result<Self, RepairError> {
        let mut measures = input.before.measures.clone();
        let fewer = options.asks_for_fewer_faces_than(measures.faces);
        let (mut printable, mut warnings) = (None, Vec::new());
        if measures.printable() {
            match input.handed_back(format, options, context) {
                Ok(Some(untouched)) if untouched.measures.printable() => printable = Some(untouched),
                Ok(Some(broken)) => measures = broken.measures,
                Ok(None) | Err(RepairError::Write(_)) => {}
                Err(error) => return Err(error),
            }
            if printable.is_none() {
                warnings.push("the input is printable, but not with the numbers of the output's format".to_owned());
            }
        }
        Ok(Self { measures, printable, fewer, warnings })
    }

    /// Whether the input is printable and the options ask for nothing more.
    fn is_enough(&self, options: &Options) -> bool {
        self.printable.is_some() && !self.fewer && !ask_of_printable(options)
    }
}

/// Plans, runs the strategies of the plan, and decides whether the best result replaces the input.
fn attempt(input: &Input<'_>, to_beat: ToBeat, runner: Runner<'_>, cache: PrefixCache) -> Result<Ended, RepairError> {
    let Runner { options, format, context, .. } = runner;
    let ToBeat { measures, printable, fewer, mut warnings } = to_beat;
    let escalation = Escalation::open(input, runner, cache)?;
    let sheets = if measures.boundary_edges > 0 { escalation.sheet_share()? } else { 0.0 };
    let found = if printable.is_some() { Category::Clean } else { categorise(&measures, sheets) };
    let category = options.category.filter(|_| options.preset == Preset::Auto).unwrap_or(found);
    let plan = make_plan(&measures, category, options);
    context.log(&format!("plan: {} because {}", plan.preset.as_str(), plan.reason));
    let Attempts { steps, mut candidates, best } = escalation.run(&plan.strategies)?;

    let is_better = |best: &Judged| match &printable {
        Some(_) if fewer && best.measures.printable() && best.measures.faces < measures.faces => true,
        Some(untouched) => best.is_good() && !have_same_faces(best, untouched),
        None => best.rank() < rank_of_input(&measures),
    };
    let best = best.map(|(index, judged)| Best {
        index,
        strategy: candidates[index].strategy.unwrap_or_default(),
        is_result: is_better(&judged),
        judged,
    });
    let options_not_applied = match &best {
        Some(best) => options_not_applied(options, &steps, &best.ending(&plan, &verdict_in_words(&best.judged))),
        None => {
            options_not_applied(options, &steps, &Ending::InputKept { best: None, why: "no strategy made a result" })
        }
    };
    let steps = steps.into_iter().map(|it| it.step).collect();
    let mut account = Account { steps, options_not_applied, ..Account::of_plan(plan) };
    let (judged, strategy) = match (best.filter(|best| best.is_result), printable) {
        (Some(best), _) => {
            candidates[best.index].chosen = true;
            account.outcome = if best.judged.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
            (Some(best.judged), Some(best.strategy))
        }
        (None, Some(untouched)) => {
            if fewer {
                warnings.extend(why_no_face_went(&account.steps));
            }
            candidates.push(Candidate::new(None, &untouched, true));
            account.outcome = Outcome::AlreadyPrintable;
            (Some(untouched), None)
        }
        (None, None) => {
            let judged = input.handed_back(format, options, context)?;
            candidates.extend(judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
            (judged, None)
        }
    };
    Ok(Ended { account: Account { candidates, warnings, ..account }, judged, strategy })
}

/// The best result of a plan's strategies.
struct Best {
    /// Its place among the candidates.
    index: usize,
    strategy: u32,
    judged: Judged,
    /// Whether it replaces the input.
    is_result: bool,
}

impl Best {
    /// How the repair ends by this result, for the account of the options.
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

/// Whether two results have the same faces in the same order, as their bytes say.
fn have_same_faces(one: &Judged, other: &Judged) -> bool {
    if one.bytes == other.bytes {
        return true;
    }
    let (Ok(one), Ok(other)) = (read_own(&one.bytes), read_own(&other.bytes)) else { return false };
    let (one, other) = (one.soup, other.soup);
    one.faces.len() == other.faces.len() && (0..one.faces.len()).all(|f| one.corners(f) == other.corners(f))
}

/// A repaired object, before it is painted.
pub(super) struct RepairedObject {
    pub report: ObjectReport,
    /// The object as it was, welded.
    pub before: Surface,
    /// Its result; none where it has nothing that can be written.
    pub soup: Option<Soup>,
    /// For each face of the result the object's face that it was cut from.
    pub source: Vec<u32>,
    /// Whether the object has vertices that are one only by their positions.
    pub welded: bool,
}

/// What the repairs of a file's objects have in common.
pub(super) struct ObjectRepair<'a> {
    pub file: &'a ReadFile,
    pub format: Format,
}

impl ObjectRepair<'_> {
    /// Repairs one object as a mesh of its own.
    pub fn run(
        &self,
        object: &Object,
        place: ObjectPlace,
        request: &Request<'_>,
    ) -> Result<RepairedObject, RepairError> {
        let context = request.context;
        let start = context.now();
        let mesh = self.file.mesh.of_same_file(object.mesh().map(|mesh| mesh.soup.clone()).unwrap_or_default());
        let source = Source { bytes: None, mesh: &mesh, unit: self.file.unit.as_ref() };
        inspected(&source, request, |input| {
            let body = repair_body(&input, judging_format(self.format), request)?;
            let soup = if body.bytes.is_empty() { None } else { Some(judged_soup(&body.bytes)?) };
            let welded = input.analysis.ingest.merged_vertices > 0 && self.format == Format::ThreeMf;
            let time = context.now().saturating_sub(start);
            let report = ObjectReport::new(place, &input, body.account, time);
            Ok(RepairedObject { report, before: input.analysis.surface.clone(), soup, source: body.source, welded })
        })
    }
}

/// The progress of one object as a part of the whole.
pub(super) struct Share<'a> {
    pub context: &'a Context<'a>,
    pub from: f64,
    pub to: f64,
    pub name: &'a str,
}

impl Progress for Share<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        let percent = self.from + (self.to - self.from) * f64::from(percent) / 100.0;
        // What an object is finished with the whole is not.
        let stage = if stage == Stage::Finish { Stage::Verify } else { stage };
        self.context.report(stage, tier, percent as u8);
    }

    fn log(&self, line: &str) {
        self.context.log(&format!("{}: {line}", self.name));
    }
}
