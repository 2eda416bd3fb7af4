use std::time::Duration;

use super::apart::{ApartRepair, keeps_apart};
use super::assumed::assumptions;
use super::climb::Climb;
use super::dress::{carrier, dress_one};
use super::input::{Input, inspect_input, read_own};
use super::limited_options::limited_options;
use super::options_not_applied::{Ending, of_file, options_not_applied};
use super::plan::{make_plan, name};
use super::requests::ask_of_printable;
use super::settled::{analyse_settled, settle_orientation};
use super::tiers::Runner;
use super::time_budget::with_overrun;
use super::verdict::{Judged, rank_of_input};
use super::{
    Assumption, AssumptionKind, Cancelled, Candidate, Category, Context, FileSummary, LeftOut, OptionNotApplied,
    Options, OptionsError, Outcome, Preset, Remesher, Report, Stage, Verdict, categorise, summary,
};
use crate::analyze::subject;
use crate::format::{self, Format, Limits, ReadError, ReadOptions, WriteError};
use crate::inspect::{Analysis, CompareOptions, Original};
use crate::scene::UnitSource;

/// A repaired file and its account.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// The file that is handed out; empty only where the report's `output` is none.
    pub bytes: Vec<u8>,
    /// Its format.
    pub format: Format,
    /// The account.
    pub report: Report,
}

/// Why there is no result at all. A model that can't be repaired is no error: see [`Outcome::Unrepairable`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RepairError {
    /// The input is not a mesh that can be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// An option is out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The job was canceled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The deadline came before there was anything to hand out: not even the input could be verified in the output's format.
    #[error(
        "the time was over before the model was inspected, so there is no result: deadline_s is {0}; raise it, or send fewer faces"
    )]
    OutOfTime(f64),
    /// Neither a result nor the input can be said in the output format.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// What was written is not what was judged, which would be a mistake of ours.
    #[error("the written file does not hold the model that was judged; ask for another output format, and report this")]
    Unfaithful,
}

/// Repairs a file: reads it, measures it, makes a plan, and climbs the plan's rungs until a result is printable with
/// no red flag; the best result so far is handed out.
///
/// Each result is judged on its own bytes, read back and welded by position. A file that is printable already comes
/// back byte for byte, or converted face by face where another format is asked for. When time runs out the best so
/// far is handed out, which may be the input. Where the options ask a printable file for more, such as fewer faces, the plan runs, and its
/// result replaces the input where it is no worse. Options that the result does not follow are in the report.
///
/// In a format that has objects each of them is repaired apart, unless `merge` says otherwise. Where colours and objects are written beside
/// the triangles, results are judged without them, and the file that is handed out is read back and has just the faces that were judged.
///
/// # Errors
/// [`RepairError`]; never because a model can't be repaired or time ran out.
pub fn repair(
    bytes: &[u8],
    options: &Options,
    limits: &Limits,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<Repaired, RepairError> {
    options.validate()?;
    let context = &with_overrun(&context.limited_to(Duration::from_secs_f64(options.deadline_s)));
    match repair_in_time(bytes, options, limits, remesher, context) {
        Err(RepairError::Cancelled(_)) if !context.is_cancelled() => Err(RepairError::OutOfTime(options.deadline_s)),
        repaired => repaired,
    }
}

/// Repairs a file until the deadline of the context, and verifies until the end of its verification.
fn repair_in_time(
    bytes: &[u8],
    options: &Options,
    limits: &Limits,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<Repaired, RepairError> {
    let start = context.now();
    context.report(Stage::Read, None, 0);
    let reading = ReadOptions { limits: *limits, twist_angle_deg: options.twist_angle_deg };
    let mut file = format::read_file(bytes, &reading)?;
    let unit = file.settle_unit(options.unit, options.scale_to);
    let format = options.output.resolve(&file);
    let apart = keeps_apart(&mut file, format, options);
    // An archive is not handed out for the model in it.
    let is_alone = format::sniff(bytes, Some(bytes.len() as u64)).is_ok_and(|it| it == format);
    let as_it_is =
        format == file.mesh.format && is_alone && unit.scaled_from.is_none() && (apart || !file.has_objects());
    context.report(Stage::Inspect, None, 3);
    let began = context.now();
    let analysis = Analysis::new(subject(&file.mesh, file.unit.as_ref()), &context.for_verification())?;
    let (before, time) = inspect_input(&analysis, began, context)?;
    context.log(&format!("read {}: {}", file.mesh.dialect, before.measures.in_short()));
    let settled = settle_orientation(&analysis, &before.measures, options, context)?;
    let settled = analyse_settled(settled.as_ref(), context)?;
    let original = Original::new(&analysis, &before.measures, CompareOptions::BRIEF).with_settled(settled.as_ref());
    let returnable = as_it_is.then_some(bytes);
    let input = &Input {
        bytes: returnable,
        mesh: &file.mesh,
        analysis: &analysis,
        original: &original,
        before: &before,
        time: &time,
    };
    let mut report = input.report(options, bytes.len() as u64);
    report.warnings.extend(file.scene.as_ref().and_then(|scene| format::losses_in_words(scene, format)));
    if unit.source == UnitSource::Assumed {
        let detail = "The file names no unit; lengths were taken to be millimetres.";
        report.assumptions.push(Assumption::new(AssumptionKind::Unit, 1, detail).unless("unit=in"));
    }
    let result = match file.scene.as_ref().filter(|_| apart) {
        Some(scene) => {
            // What is made of all objects is verified once more as a whole.
            let until = &context.ending_before(time.verification(analysis.surface.faces.len()));
            let apart =
                ApartRepair { file: &file, input, format, as_it_is, options, remesher, context: until, whole: context };
            match apart.run(scene, bytes, &mut report) {
                Err(RepairError::Cancelled(_)) if !context.is_cancelled() && returnable.is_some() => {
                    time.leave_out(LeftOut::Repair);
                    time.leave_out(LeftOut::Verification);
                    let untouched = input.handed_back(format, options, context)?;
                    input.tell(&mut report, Outcome::Unrepairable, untouched, context)?
                }
                told => told?,
            }
        }
        None => {
            let Mended { outcome, judged } = mend(input, carrier(format), &mut report, options, remesher, context)?;
            let told = input.tell(&mut report, outcome, judged, context)?;
            dress_one(told, input, &file, format, report.unit.used, context)?
        }
    };
    if report.after.is_some() {
        report.output = Some(FileSummary { format, dialect: result.dialect, bytes: result.bytes.len() as u64 });
    }
    report.options_not_applied.splice(0..0, of_file(options, file.has_objects(), apart));
    let limited = limited_options(&report);
    report.options_not_applied.extend(limited);
    report.warnings.extend(report.options_not_applied.iter().map(OptionNotApplied::in_words));
    report.verdict = Verdict::of(&report);
    report.milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    context.log(&report.summary);
    context.report(Stage::Finish, None, 100);
    Ok(Repaired { bytes: result.bytes, format, report })
}

/// How the repair of one mesh ended.
pub(super) struct Mended {
    pub outcome: Outcome,
    /// What is to be handed out; none where there is nothing.
    pub judged: Option<Judged>,
}

/// Mends one mesh: makes a plan, and climbs its rungs. What was planned and done is put down in the report. Results are judged in `format`.
pub(super) fn mend(
    input: &Input<'_>,
    format: Format,
    report: &mut Report,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<Mended, RepairError> {
    // What is to be beaten: the input, or what the output's format makes of it.
    let mut as_is = input.before.measures.clone();
    let fewer = options.asks_for_fewer_faces_than(as_is.faces);
    let more = fewer || ask_of_printable(options);
    let mut printable = None;
    if as_is.printable() {
        match input.handed_back(format, options, context) {
            // What is handed back where nothing better comes of what is asked for.
            Ok(Some(untouched)) if untouched.measures.printable() && more => printable = Some(untouched),
            Ok(Some(untouched)) if untouched.measures.printable() => {
                report.plan.reason = "the input is printable already, so nothing was run".to_owned();
                report.candidates.push(Candidate::new(None, &untouched, true));
                report.options_not_applied = options_not_applied(options, &[], &Ending::Untouched);
                return Ok(Mended { outcome: Outcome::AlreadyPrintable, judged: Some(untouched) });
            }
            Ok(Some(broken)) => as_is = broken.measures,
            Ok(None) | Err(RepairError::Write(_)) => {}
            Err(error) => return Err(error),
        }
        if printable.is_none() {
            report.warnings.push("the input is printable, but not with the numbers of the output's format".to_owned());
        }
    }

    if context.is_late() {
        return out_of_time(input, format, report, options, context);
    }
    let climb = Climb::open(input, Runner { options, format, remesher, context, time: input.time })?;
    let sheets = if as_is.boundary_edges > 0 { climb.sheet_share()? } else { 0.0 };
    let found = if printable.is_some() { Category::Clean } else { categorise(&as_is, sheets) };
    let category = options.category.filter(|_| options.preset == Preset::Auto).unwrap_or(found);
    report.plan = make_plan(&as_is, category, options);
    context.log(&format!("plan: {} because {}", name(report.plan.preset), report.plan.reason));
    let climbed = climb.run(&report.plan.rungs)?;
    (report.steps, report.candidates) = (climbed.steps, climbed.candidates);

    let is_better = |best: &Judged| match &printable {
        Some(_) if fewer && best.measures.printable() && best.measures.faces < as_is.faces => true,
        Some(untouched) => best.is_good() && !have_same_faces(best, untouched),
        None => best.rank() < rank_of_input(&as_is),
    };
    let rung_of = |index: usize| report.candidates[index].rung;
    let ending = Ended::new(climbed.best.as_ref().map(|(index, best)| (rung_of(*index), best)), &is_better);
    let preset_of = |rung: u32| report.plan.rungs[rung as usize].preset;
    report.options_not_applied = options_not_applied(options, &report.steps, &ending.in_terms_of(preset_of));
    if let Some((index, best)) = climbed.best.filter(|_| ending.is_result) {
        report.candidates[index].chosen = true;
        report.assumptions.extend(best.assumptions.iter().cloned());
        let rung = report.candidates[index].rung;
        report.assumptions.extend(assumptions(report, &best, rung, input.analysis));
        let outcome = if best.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
        return Ok(Mended { outcome, judged: Some(best) });
    }
    if let Some(untouched) = printable {
        if fewer {
            report.warnings.extend(summary::why_no_face_went(&report.steps));
        }
        report.candidates.push(Candidate::new(None, &untouched, true));
        return Ok(Mended { outcome: Outcome::AlreadyPrintable, judged: Some(untouched) });
    }
    let judged = input.handed_back(format, options, context)?;
    report.candidates.extend(judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
    Ok(Mended { outcome: Outcome::Unrepairable, judged })
}

/// Hands the input back where the inspection took all the time.
fn out_of_time(
    input: &Input<'_>,
    format: Format,
    report: &mut Report,
    options: &Options,
    context: &Context<'_>,
) -> Result<Mended, RepairError> {
    input.time.leave_out(LeftOut::Repair);
    report.plan.reason = "the time was over before a plan could be made".to_owned();
    let judged = input.handed_back(format, options, context)?;
    report.candidates.extend(judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
    Ok(Mended { outcome: Outcome::Unrepairable, judged })
}

/// How the climb ended: which strategy made the best result, and whether it replaces the input.
struct Ended {
    rung: Option<u32>,
    is_result: bool,
    /// Whether the best result is good, and so no other than the input where it does not replace it.
    is_good: bool,
    why: String,
}

impl Ended {
    fn new(best: Option<(Option<u32>, &Judged)>, is_better: &dyn Fn(&Judged) -> bool) -> Self {
        let Some((rung, best)) = best else {
            let why = "no strategy made a result".to_owned();
            return Self { rung: None, is_result: false, is_good: false, why };
        };
        Self { rung, is_result: is_better(best), is_good: best.is_good(), why: summary::verdict_in_words(best) }
    }

    fn in_terms_of(&self, preset_of: impl Fn(u32) -> Preset) -> Ending<'_> {
        match self.rung {
            Some(rung) if self.is_result => Ending::Result { rung, preset: preset_of(rung) },
            Some(rung) if self.is_good => Ending::Unchanged { rung, preset: preset_of(rung) },
            best => Ending::InputKept { best, why: &self.why },
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
