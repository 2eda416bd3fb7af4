use std::ops::Range;
use std::time::Duration;

use super::plan::{make_plan, name};
use super::presets::remesh_action;
use super::sheets::open_sheet_share;
use super::tiers::{End, Runner};
use super::verdict::{JudgeError, Judged, judge, rank_of_input};
use super::{
    Action, Cancelled, Candidate, Category, Context, FileSummary, Options, OptionsError, Outcome, Plan, Preset,
    REPORT_VERSION, Remesher, Report, Rung, Stage, Step, StepStatus, categorise, compare, summary,
};
use crate::format::{self, Format, Limits, ReadError, ReadMesh, WriteError};
use crate::inspect::{Measures, measure};
use crate::mesh::{Soup, Surface};

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
    /// The job was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// Neither a result nor the input can be said in the output format.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Repairs a file: reads it, measures it, makes a plan, and climbs the plan's rungs until a result is printable with
/// no red flag; the best result so far is handed out.
///
/// Each result is judged on its own bytes, read back and welded by position. A file that is printable already comes
/// back byte for byte, or converted face by face where another format is asked for. When time runs out the best so
/// far is handed out, which may be the input.
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
    let ReadMesh { soup, format: input_format, dialect, mut warnings } = format::read(bytes, limits)?;
    let format = options.output.resolve(input_format);
    context.report(Stage::Inspect, None, 3);
    let before = measure(&soup, patient)?;
    context.log(&format!(
        "read {dialect}: {} faces, {} parts, {} defects",
        before.faces,
        before.parts,
        before.defects()
    ));
    if before.nonfinite_faces > 0 {
        warnings.push(format!(
            "{} faces have a corner that is not a finite number; they were left out",
            before.nonfinite_faces
        ));
    }
    if !before.self_intersections.complete {
        warnings.push("so many faces overlap that they were not all counted".to_owned());
    }
    let input = Input { bytes, soup: &soup, dialect: &dialect, format: input_format, before: &before };
    let (mut surface, _) = Surface::from_soup(&soup);
    let mut report = empty_report(&input, options, warnings);

    // What is to be beaten: the input, or what the output's format makes of it.
    let mut as_is = before.clone();
    if before.printable() {
        match unchanged_or_converted(&input, &surface, format, options, patient) {
            Ok(Some(untouched)) if untouched.measures.printable() => {
                report.plan.reason = "the input is printable already, so nothing was run".to_owned();
                report.candidates.push(candidate(None, &untouched, true));
                return Ok(finish(report, Outcome::AlreadyPrintable, Some(untouched), format, start, context));
            }
            Ok(Some(broken)) => as_is = broken.measures,
            Ok(None) | Err(RepairError::Write(_)) => {}
            Err(error) => return Err(error),
        }
        report.warnings.push("the input is printable, but not with the numbers of the output's format".to_owned());
    }

    // Every recipe begins with the same two actions; what they leave is what tells a sheet from a solid with holes.
    let opening =
        Rung { tier: 1, preset: Preset::BasicCleanup, actions: vec![Action::BasicCleanup, Action::FixNormals] };
    let mut runner = Runner { options, format, remesher, context, steps: Vec::new() };
    let opened = runner.run(0, &opening, 0, &(5..15), &mut surface)?;
    let opening_steps = runner.steps.clone();
    let category = categorise(&as_is, if as_is.boundary_edges > 0 { open_sheet_share(&surface) } else { 0.0 });
    report.plan = make_plan(&as_is, category, options);
    context.log(&format!("plan: {} because {}", name(report.plan.preset), report.plan.reason));

    let mut best: Option<(usize, Judged)> = None;
    for (index, rung) in (0u32..).zip(&report.plan.rungs) {
        if let Some(step) = not_runnable(index, rung, remesher, context) {
            runner.log(&step);
            runner.steps.push(step);
            continue;
        }
        let mut result = surface.clone();
        let span = span(index);
        if index > 0 {
            runner.steps.extend(opening_steps.iter().cloned().map(|s| taken_over(s, index)));
        }
        let end = match opened {
            End::Finished => runner.run(index, rung, opening.actions.len(), &span, &mut result)?,
            End::Nothing => End::Nothing,
            End::OutOfTime => End::OutOfTime,
        };
        if matches!(end, End::Nothing) || result.faces.is_empty() {
            continue;
        }
        context.report(Stage::Verify, Some(rung.tier), span.end);
        let judging = context.now();
        let verdict = judge(&result, format, &soup, &before, options, patient);
        let mut step = validation(index, judging, context);
        match verdict {
            Ok(judged) => {
                step.note = Some(summary::verdict_in_words(&judged));
                report.candidates.push(candidate(Some(index), &judged, false));
                let good = judged.is_good();
                if best.as_ref().is_none_or(|(_, b)| judged.rank() < b.rank()) {
                    best = Some((report.candidates.len() - 1, judged));
                }
                runner.log(&step);
                runner.steps.push(step);
                if good {
                    break;
                }
            }
            Err(JudgeError::Cancelled(stop)) => return Err(stop.into()),
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
                runner.log(&step);
                runner.steps.push(step);
            }
        }
    }
    report.steps = runner.steps;

    let best = best.filter(|(_, judged)| judged.rank() < rank_of_input(&as_is));
    if let Some((index, judged)) = best {
        report.candidates[index].chosen = true;
        let outcome = if judged.is_good() { Outcome::Repaired } else { Outcome::PartiallyRepaired };
        return Ok(finish(report, outcome, Some(judged), format, start, context));
    }
    let (original, _) = Surface::from_soup(&soup);
    let handed = unchanged_or_converted(&input, &original, format, options, patient)?;
    if let Some(judged) = &handed {
        report.candidates.push(candidate(None, judged, true));
    }
    Ok(finish(report, Outcome::Unrepairable, handed, format, start, context))
}

/// What came in.
struct Input<'a> {
    bytes: &'a [u8],
    soup: &'a Soup,
    dialect: &'a str,
    format: Format,
    before: &'a Measures,
}

/// The input's own bytes, or its faces in order in another format; none where no face is left to write.
fn unchanged_or_converted(
    input: &Input<'_>,
    surface: &Surface,
    format: Format,
    options: &Options,
    context: &Context<'_>,
) -> Result<Option<Judged>, RepairError> {
    if format == input.format {
        return Ok(Some(Judged {
            bytes: input.bytes.to_vec(),
            dialect: input.dialect.to_owned(),
            measures: input.before.clone(),
            changes: compare(input.before, input.before, input.soup, input.soup, context)?,
            red_flags: Vec::new(),
        }));
    }
    if surface.faces.is_empty() {
        return Ok(None);
    }
    match judge(surface, format, input.soup, input.before, options, context) {
        Ok(judged) => Ok(Some(judged)),
        Err(JudgeError::Write(error)) => Err(error.into()),
        Err(JudgeError::Read(error)) => Err(error.into()),
        Err(JudgeError::Cancelled(stop)) => Err(stop.into()),
    }
}

/// The step that says why a rung is passed over, if it is.
fn not_runnable(index: u32, rung: &Rung, remesher: Option<&dyn Remesher>, context: &Context<'_>) -> Option<Step> {
    let action = *rung.actions.iter().find(|&&a| remesh_action(a).is_some())?;
    let why = if context.remaining().is_zero() {
        "the time was over before it could start".to_owned()
    } else {
        let missing = remesher.map_or(Err("Blender is not installed on this server"), |r| r.info().map(drop)).err()?;
        format!("{missing}; the best result without tier 3 is handed out")
    };
    Some(Step {
        rung: index,
        tier: 3,
        action,
        status: StepStatus::Skipped,
        milliseconds: 0.0,
        changed: Vec::new(),
        note: Some(why),
        program: None,
        voxel_size: None,
    })
}

fn taken_over(step: Step, rung: u32) -> Step {
    let note = step.note.unwrap_or_else(|| "its result was taken over from the first rung".to_owned());
    Step { rung, milliseconds: 0.0, note: Some(note), ..step }
}

fn validation(rung: u32, start: Duration, context: &Context<'_>) -> Step {
    Step {
        rung,
        tier: 0,
        action: Action::Validate,
        status: StepStatus::Done,
        milliseconds: context.now().saturating_sub(start).as_secs_f64() * 1e3,
        changed: Vec::new(),
        note: None,
        program: None,
        voxel_size: None,
    }
}

fn candidate(rung: Option<u32>, judged: &Judged, chosen: bool) -> Candidate {
    Candidate {
        rung,
        printable: judged.measures.printable(),
        defects: judged.measures.defects(),
        faces: judged.measures.faces,
        red_flags: judged.red_flags.clone(),
        chosen,
    }
}

/// The share of the whole repair, in percent, that a rung is taken to be: each is half of what is left, since later ones
/// seldom run.
fn span(rung: u32) -> Range<u8> {
    let begin = |rung: u32| 95 - (80 >> rung.min(7));
    begin(rung)..begin(rung + 1)
}

fn empty_report(input: &Input<'_>, options: &Options, warnings: Vec<String>) -> Report {
    Report {
        version: REPORT_VERSION,
        engine: crate::ENGINE.to_owned(),
        outcome: Outcome::Unrepairable,
        summary: String::new(),
        input: FileSummary { format: input.format, dialect: input.dialect.to_owned(), bytes: input.bytes.len() as u64 },
        output: None,
        options: options.clone(),
        before: input.before.clone(),
        after: None,
        verified_from_output_bytes: false,
        changes: None,
        plan: Plan {
            category: Category::Clean,
            preset: Preset::BasicCleanup,
            reason: String::new(),
            rungs: Vec::new(),
        },
        steps: Vec::new(),
        candidates: Vec::new(),
        red_flags: Vec::new(),
        warnings,
        milliseconds: 0.0,
    }
}

/// Fills in what is known at the end.
fn finish(
    mut report: Report,
    outcome: Outcome,
    judged: Option<Judged>,
    format: Format,
    start: Duration,
    context: &Context<'_>,
) -> Repaired {
    report.outcome = outcome;
    report.summary = summary::in_words(outcome, &report, judged.as_ref().map(|j| &j.measures), context);
    let mut bytes = Vec::new();
    if let Some(judged) = judged {
        report.output = Some(FileSummary { format, dialect: judged.dialect, bytes: judged.bytes.len() as u64 });
        report.after = Some(judged.measures);
        report.changes = Some(judged.changes);
        report.red_flags = judged.red_flags;
        report.verified_from_output_bytes = true;
        bytes = judged.bytes;
    }
    report.milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    context.log(&report.summary);
    context.report(Stage::Finish, None, 100);
    Repaired { bytes, format, report }
}
