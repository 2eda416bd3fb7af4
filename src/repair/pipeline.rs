use std::time::Duration;

use super::apart::{keeps_apart, repair_apart};
use super::climb::Climb;
use super::dress::{carrier, dress_one};
use super::input::{Input, Told, look, subject};
use super::plan::{make_plan, name};
use super::sheets::open_sheet_share;
use super::tiers::Runner;
use super::verdict::{Judged, rank_of_input};
use super::{
    Cancelled, Candidate, Category, Context, FileSummary, Options, OptionsError, Outcome, Remesher, Report, Stage,
    categorise, summary,
};
use crate::format::{self, Format, Limits, ReadError, ReadOptions, WriteError};
use crate::inspect::{Analysis, CompareOptions, Fates, Findings, Original, measure_analysis};

/// A repaired file and its account.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// The file that is handed out; empty only where the report's `output` is none.
    pub bytes: Vec<u8>,
    /// Its format.
    pub format: Format,
    /// The account.
    pub report: Report,
    /// What was found on the input.
    pub found_before: Findings,
    /// What was found on the result, where there is one that is not the input.
    pub found_after: Option<Findings>,
    /// What became of every piece of surface, where there is a result and there was time to ask.
    pub fates: Option<Fates>,
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
    /// The job was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
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
/// far is handed out, which may be the input. Where fewer faces are asked for than a printable file has, they are removed.
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
    let start = context.now();
    let context = &context.limited_to(Duration::from_secs_f64(options.deadline_s));
    let patient = &context.without_deadline();
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
    let analysis = Analysis::new(subject(&file.mesh, file.unit.as_ref()), patient)?;
    let (before, found_before) = look(&analysis, || measure_analysis(&analysis, patient), context)?;
    context.log(&format!("read {}: {}", file.mesh.dialect, before.measures.in_short()));
    let original = Original::new(&analysis, &before.measures, CompareOptions::BRIEF);
    let returnable = as_it_is.then_some(bytes);
    let input =
        &Input { bytes: returnable, mesh: &file.mesh, analysis: &analysis, original: &original, before: &before };
    let mut report = input.report(options, bytes.len() as u64);
    report.warnings.extend(file.scene.as_ref().and_then(|scene| format::losses_in_words(scene, format)));
    let result = match file.scene.as_ref().filter(|_| apart) {
        Some(scene) => {
            let made = repair_apart(&file, scene, format, as_it_is, options, remesher, context)?;
            made.tell(input, bytes, &mut report, context)?
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
    report.milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    context.log(&report.summary);
    context.report(Stage::Finish, None, 100);
    let Told { bytes, found: found_after, fates, .. } = result;
    Ok(Repaired { bytes, format, report, found_before, found_after, fates })
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
    let mut printable = None;
    if as_is.printable() {
        match input.handed_back(format, options, context) {
            // What is handed back where no face can go.
            Ok(Some(untouched)) if untouched.measures.printable() && fewer => printable = Some(untouched),
            Ok(Some(untouched)) if untouched.measures.printable() => {
                report.plan.reason = "the input is printable already, so nothing was run".to_owned();
                report.candidates.push(Candidate::new(None, &untouched, true));
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

    let climb = Climb::open(input, Runner { options, format, remesher, context })?;
    let sheets = if as_is.boundary_edges > 0 { open_sheet_share(climb.surface()) } else { 0.0 };
    let category = if printable.is_some() { Category::Clean } else { categorise(&as_is, sheets) };
    report.plan = make_plan(&as_is, category, options);
    context.log(&format!("plan: {} because {}", name(report.plan.preset), report.plan.reason));
    let climbed = climb.run(&report.plan.rungs)?;
    (report.steps, report.candidates) = (climbed.steps, climbed.candidates);

    let better = |best: &Judged| match &printable {
        Some(_) => best.measures.printable() && best.measures.faces < as_is.faces,
        None => best.rank() < rank_of_input(&as_is),
    };
    if let Some((index, best)) = climbed.best.filter(|(_, best)| better(best)) {
        report.candidates[index].chosen = true;
        report.warnings.extend(summary::liberties(&report.steps, report.candidates[index].rung));
        let outcome = if best.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
        return Ok(Mended { outcome, judged: Some(best) });
    }
    if let Some(untouched) = printable {
        report.warnings.extend(summary::why_no_face_went(&report.steps));
        report.candidates.push(Candidate::new(None, &untouched, true));
        return Ok(Mended { outcome: Outcome::AlreadyPrintable, judged: Some(untouched) });
    }
    let judged = input.handed_back(format, options, context)?;
    report.candidates.extend(judged.as_ref().map(|judged| Candidate::new(None, judged, true)));
    Ok(Mended { outcome: Outcome::Unrepairable, judged })
}
