use std::time::Duration;

use super::account::{Ended, FileAccount, RepairedBody};
use super::apart::{ApartRepair, RepairedObjects, keeps_apart};
use super::body::repair_body;
use super::dress::{carrier, dress_one};
use super::input::{Input, Source, inspected};
use super::options_not_applied::of_file;
use super::time_budget::with_overrun;
use super::{Assumption, Cancelled, Context, FileSummary, LeftOut, Options, OptionsError, Remesher, Report, Stage};
use crate::format::{self, Format, Limits, ReadError, ReadFile, ReadOptions, WriteError};

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
    let opened = Opened::read(bytes, options, limits)?;
    context.report(Stage::Inspect, None, 3);
    let file = &opened.file;
    let returnable = opened.as_it_is.then_some(bytes);
    let source = Source { bytes: returnable, mesh: &file.mesh, unit: file.unit.as_ref() };
    let (bytes, mut report) = inspected(&source, options, context, |input| {
        context.log(&format!("read {}: {}", file.mesh.dialect, input.before.measures.in_short()));
        let repaired = opened.repair(bytes, &input, options, remesher, context)?;
        let output = FileSummary::of(opened.format, &repaired.dialect, &repaired.bytes);
        let scene = file.scene.as_ref();
        let report = repaired.account.into_report(FileAccount {
            input: &input,
            bytes: bytes.len() as u64,
            options,
            output,
            objects: repaired.sections,
            assumptions: file.unit.as_ref().and_then(Assumption::of_unit).into_iter().collect(),
            options_not_applied: of_file(options, file.has_objects(), opened.apart),
            warnings: scene.and_then(|scene| format::losses_in_words(scene, opened.format)).into_iter().collect(),
        });
        Ok((repaired.bytes, report))
    })?;
    report.milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    context.log(&report.summary);
    context.report(Stage::Finish, None, 100);
    Ok(Repaired { bytes, format: opened.format, report })
}

/// A file that was read, and how its repair goes.
struct Opened {
    file: ReadFile,
    /// The format of the result.
    format: Format,
    /// Whether its objects are repaired apart.
    apart: bool,
    /// Whether it may come back byte for byte.
    as_it_is: bool,
}

impl Opened {
    fn read(bytes: &[u8], options: &Options, limits: &Limits) -> Result<Self, RepairError> {
        let reading = ReadOptions { limits: *limits, twist_angle_deg: options.twist_angle_deg };
        let mut file = format::read_file(bytes, &reading)?;
        let unit = file.settle_unit(options.unit, options.scale_to);
        let format = options.output.resolve(&file);
        let apart = keeps_apart(&mut file, format, options);
        // An archive is not handed out for the model in it.
        let is_alone = format::sniff(bytes, Some(bytes.len() as u64)).is_ok_and(|it| it == format);
        let as_it_is =
            format == file.mesh.format && is_alone && unit.scaled_from.is_none() && (apart || !file.has_objects());
        Ok(Self { file, format, apart, as_it_is })
    }

    /// Repairs the file's bodies: its objects where they are kept apart, and otherwise all of it as one.
    fn repair(
        &self,
        bytes: &[u8],
        input: &Input<'_>,
        options: &Options,
        remesher: Option<&dyn Remesher>,
        context: &Context<'_>,
    ) -> Result<RepairedObjects, RepairError> {
        let &Self { ref file, format, as_it_is, .. } = self;
        let Some(scene) = file.scene.as_ref().filter(|_| self.apart) else {
            let body = repair_body(input, carrier(format), options, remesher, context)?;
            return Ok(dress_one(body, input, file, format, context)?.into());
        };
        // What is made of all objects is verified once more as a whole.
        let until = &context.ending_before(input.time.verification(input.analysis.surface.faces.len()));
        let apart = ApartRepair { file, input, format, as_it_is, options, remesher, context: until, whole: context };
        match apart.run(scene, bytes) {
            Err(RepairError::Cancelled(_)) if !context.is_cancelled() && input.bytes.is_some() => {
                input.time.leave_out(LeftOut::Repair);
                input.time.leave_out(LeftOut::Verification);
                let untouched = input.handed_back(format, options, context)?;
                let ended = Ended { candidates: Vec::new(), ..Ended::with_input(untouched, "") };
                Ok(RepairedBody::of(ended, input, options, context)?.into())
            }
            repaired => repaired,
        }
    }
}
