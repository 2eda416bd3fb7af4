//! The repair of one body: a plan, its strategies, and the best of their results.

use super::account::{Ended, RepairedBody};
use super::climb::Climb;
use super::input::{Input, read_own};
use super::options_not_applied::{Ending, options_not_applied};
use super::plan::{make_plan, name};
use super::requests::ask_of_printable;
use super::tiers::Runner;
use super::verdict::{Judged, rank_of_input};
use super::{
    Candidate, Category, Context, LeftOut, Options, Outcome, Plan, Preset, Remesher, RepairError, categorise, summary,
};
use crate::format::Format;
use crate::inspect::Measures;

/// Repairs one body: makes a plan, runs its strategies, and inspects the best result. Results are judged in `format`.
pub(super) fn repair_body(
    input: &Input<'_>,
    format: Format,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<RepairedBody, RepairError> {
    let to_beat = ToBeat::of(input, format, options, context)?;
    let ended = if to_beat.is_enough(options) {
        let ended = Ended::with_input(to_beat.printable, "the input is printable already, so nothing was run");
        Ended {
            outcome: Outcome::AlreadyPrintable,
            options_not_applied: options_not_applied(options, &[], &Ending::Untouched),
            ..ended
        }
    } else if context.is_late() {
        input.time.leave_out(LeftOut::Repair);
        let judged = input.handed_back(format, options, context)?;
        let ended = Ended::with_input(judged, "the time was over before a plan could be made");
        Ended { warnings: to_beat.warnings, ..ended }
    } else {
        attempt(input, to_beat, Runner { options, format, remesher, context, time: input.time })?
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
fn attempt(input: &Input<'_>, to_beat: ToBeat, runner: Runner<'_>) -> Result<Ended, RepairError> {
    let Runner { options, format, context, .. } = runner;
    let ToBeat { measures, printable, fewer, mut warnings } = to_beat;
    let climb = Climb::open(input, runner)?;
    let sheets = if measures.boundary_edges > 0 { climb.sheet_share()? } else { 0.0 };
    let found = if printable.is_some() { Category::Clean } else { categorise(&measures, sheets) };
    let category = options.category.filter(|_| options.preset == Preset::Auto).unwrap_or(found);
    let plan = make_plan(&measures, category, options);
    context.log(&format!("plan: {} because {}", name(plan.preset), plan.reason));
    let climbed = climb.run(&plan.rungs)?;
    let (steps, mut candidates) = (climbed.steps, climbed.candidates);

    let is_better = |best: &Judged| match &printable {
        Some(_) if fewer && best.measures.printable() && best.measures.faces < measures.faces => true,
        Some(untouched) => best.is_good() && !have_same_faces(best, untouched),
        None => best.rank() < rank_of_input(&measures),
    };
    let best = climbed.best.map(|(index, judged)| Best {
        index,
        strategy: candidates[index].rung.unwrap_or_default(),
        is_result: is_better(&judged),
        judged,
    });
    let options_not_applied = match &best {
        Some(best) => {
            options_not_applied(options, &steps, &best.ending(&plan, &summary::verdict_in_words(&best.judged)))
        }
        None => {
            options_not_applied(options, &steps, &Ending::InputKept { best: None, why: "no strategy made a result" })
        }
    };
    let mut ended = Ended {
        outcome: Outcome::Unrepairable,
        judged: None,
        plan,
        steps,
        candidates: Vec::new(),
        strategy: None,
        options_not_applied,
        warnings: Vec::new(),
    };
    if let Some(best) = best.filter(|best| best.is_result) {
        candidates[best.index].chosen = true;
        ended.outcome = if best.judged.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
        (ended.judged, ended.strategy) = (Some(best.judged), Some(best.strategy));
    } else if let Some(untouched) = printable {
        if fewer {
            warnings.extend(summary::why_no_face_went(&ended.steps));
        }
        candidates.push(Candidate::new(None, &untouched, true));
        (ended.outcome, ended.judged) = (Outcome::AlreadyPrintable, Some(untouched));
    } else {
        ended.judged = input.handed_back(format, options, context)?;
        candidates.extend(ended.judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
    }
    Ok(Ended { candidates, warnings, ..ended })
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
        let (rung, preset) = (self.strategy, plan.rungs[self.strategy as usize].preset);
        if self.is_result {
            Ending::Result { rung, preset }
        } else if self.judged.is_good() {
            Ending::Unchanged { rung, preset }
        } else {
            Ending::InputKept { best: Some(rung), why }
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
