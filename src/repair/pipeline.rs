//! The repair pipeline: read and inspect a file, repair its bodies, assemble their results, and report.
//!
//! A body is the whole file, or one of its objects if objects are kept separate.

use std::borrow::Cow;
use std::time::Duration;

use super::body::repair_body;
use super::conclusion::{Conclusion, RepairedBody};
use super::export::{export_one, judging_format};
use super::input::{Input, MeshSource, RepairError, RepairRequest, with_inspected_input};
use super::objects::{AssembledFile, SceneRepair, keeps_objects_separate};
use super::options::Options;
use super::options_not_applied::merge_not_applied;
use super::remesher::Remesher;
use super::report::{Assumption, FileSummary, OmittedSection, Report};
use super::report_draft::FileDetails;
use super::size::{other_units, settle_size};
use super::time_budget::with_overrun;
use crate::analyze::subject;
use crate::context::{Context, Stage};
use crate::format::{self, Format, Limits, ReadFile, ReadOptions};
use crate::inspect::{Analysis, measure_analysis};
use crate::printing::readiness::{AssessedFile, PrintReadiness, assess};
use crate::printing::unit_candidates::FileEvidence;
use crate::scene::{LengthUnit, Scene, Unit};

/// A repaired file and its report.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// The returned file; empty only if the report's `output` is none.
    pub bytes: Vec<u8>,
    /// The file's format.
    pub format: Format,
    /// The report of the repair.
    pub report: Report,
}

/// Repairs a file: reads and measures the file, makes a plan, and runs the plan's strategies until a result is printable and has no red
/// flag. If no result is, returns the best one.
///
/// Each result is judged on its own bytes, read back and welded by position. A file that is already printable is returned byte for byte,
/// or converted face by face if the options ask for another format. When time runs out, the best verified result is returned; it may be
/// the input. If the options ask more of a printable file, such as fewer faces, the plan runs, and its result replaces the input unless
/// it is worse. The report lists options that the result does not follow. The alternatives of the option `alternatives` are made by
/// [`AlternativeRuns`](super::AlternativeRuns).
///
/// In a format with objects, each object is repaired separately unless the option `merge` decides otherwise. Results are judged without
/// colours and objects. The returned file is read back and must have exactly the faces that were judged.
///
/// # Errors
/// [`RepairError`] if the input cannot be read or an option is out of range, the job was canceled, the deadline passed before the
/// inspection, or nothing can be written. A model that cannot be repaired is not an error.
pub fn repair(
    bytes: &[u8],
    options: &Options,
    limits: &Limits,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<Repaired, RepairError> {
    repair_as(bytes, limits, RepairRequest { options, remesher, context, reuses_prefixes: true })
}

fn repair_as(bytes: &[u8], limits: &Limits, request: RepairRequest<'_>) -> Result<Repaired, RepairError> {
    let RepairRequest { options, context, .. } = request;
    options.validate()?;
    let context = &with_overrun(&context.limited_to(Duration::from_secs_f64(options.deadline_s)));
    match repair_in_time(bytes, limits, &RepairRequest { context, ..request }) {
        // Checks of the context fail in the same way after a cancellation and after the deadline.
        Err(RepairError::Cancelled(_)) if !context.is_cancelled() => Err(RepairError::OutOfTime(options.deadline_s)),
        repaired => repaired,
    }
}

/// Repairs a file. Repairs stop at the context's deadline; the verification of a result may continue until the context's later end.
fn repair_in_time(bytes: &[u8], limits: &Limits, request: &RepairRequest<'_>) -> Result<Repaired, RepairError> {
    let &RepairRequest { options, context, .. } = request;
    let start = context.now();
    context.report(Stage::Read, None, 0);
    let mut opened = OpenedFile::read(bytes, options, limits)?;
    let soup = Cow::Owned(std::mem::take(&mut opened.file.mesh.soup));
    context.report(Stage::Inspect, None, 3);
    let file = &opened.file;
    let returnable = opened.may_return_input.then_some(bytes);
    let source = MeshSource { bytes: returnable, soup, mesh: &file.mesh, unit: file.unit.as_ref() };
    let (bytes, report) = with_inspected_input(source, request, |input| {
        context.log(&format!("read {}: {}", file.mesh.dialect, input.before.measures.in_short()));
        let mut repaired = opened.repair(bytes, &input, request)?;
        let unit = input.analysis.facts.unit.cloned().unwrap_or_default();
        let evidence = FileEvidence::of(input.analysis, &unit, format::program_of(bytes, file.mesh.format));
        let unit_candidates =
            other_units(repaired.draft.after.as_ref().unwrap_or(input.before), &unit, options, &evidence);
        let print_ready = assess_returned(&mut repaired, &unit, request)?;
        let scene = file.scene.as_ref();
        let report = repaired.draft.into_report(FileDetails {
            input: &input,
            bytes: bytes.len() as u64,
            options,
            unit,
            scaled_by: (opened.scaled_by != 1.0).then_some(opened.scaled_by),
            unit_candidates,
            print_ready,
            output: FileSummary::of(opened.format, &repaired.dialect, &repaired.bytes),
            objects: repaired.sections,
            assumptions: file.unit.as_ref().and_then(Assumption::of_unit).into_iter().collect(),
            options_not_applied: merge_not_applied(options, file.has_objects(), opened.separate_objects),
            warnings: scene.and_then(|scene| format::losses_in_words(scene, opened.format)).into_iter().collect(),
            time: context.now().saturating_sub(start),
        });
        Ok((repaired.bytes, report))
    })?;
    context.log(&report.summary);
    context.report(Stage::Finish, None, 100);
    Ok(Repaired { bytes, format: opened.format, report })
}

/// Reads the returned file back and assesses it against the process that the options name. Lengths are in `unit`. Notes the assessment as
/// omitted if there is no time left.
///
/// # Errors
/// [`RepairError`] if the job was canceled or the file cannot be read back.
fn assess_returned(
    repaired: &mut AssembledFile,
    unit: &LengthUnit,
    &RepairRequest { options, context, .. }: &RepairRequest<'_>,
) -> Result<Option<PrintReadiness>, RepairError> {
    let profile = options.print.profile().filter(|_| repaired.draft.after.is_some());
    let Some(profile) = profile else { return Ok(None) };
    let context = &context.for_verification();
    let mut file = format::read_shape(&repaired.bytes, &ReadOptions::within(Limits::NONE))?;
    let names_no_unit = file.own_unit().is_none();
    let lost_unit = names_no_unit && unit.used != Unit::Millimetre;
    file.settle_unit(names_no_unit.then_some(unit.used), Some(unit.used));
    let assessed = || {
        let analysis = Analysis::new(subject(&file.mesh, Some(unit)), context)?;
        let measures = measure_analysis(&analysis, context)?;
        assess(
            AssessedFile { analysis: &analysis, measures: &measures, bytes: repaired.bytes.len() as u64, lost_unit },
            &profile,
            context,
        )
    };
    let readiness = context.unless_late(assessed())?;
    if readiness.is_none() {
        repaired.draft.omitted.push(OmittedSection::PrintReadiness);
    }
    Ok(readiness)
}

/// A file that was read, with the decisions that follow from its contents and the options.
struct OpenedFile {
    file: ReadFile,
    /// The format of the result.
    format: Format,
    /// Factor by which the model was scaled to the size that the options ask for; 1 without such a request.
    scaled_by: f64,
    /// Whether objects are repaired separately.
    separate_objects: bool,
    /// Whether the file may be returned byte for byte.
    may_return_input: bool,
}

impl OpenedFile {
    fn read(bytes: &[u8], options: &Options, limits: &Limits) -> Result<Self, RepairError> {
        let read_options = ReadOptions { limits: *limits, twist_angle_deg: options.twist_angle_deg };
        let mut file = format::read_file(bytes, &read_options)?;
        let (unit, scaled_by) = settle_size(&mut file, options)?;
        let format = options.output.resolve(&file);
        let separate_objects = keeps_objects_separate(&mut file, format, options);
        // An archive cannot be returned in place of the model inside it.
        let is_not_in_archive = format::sniff(bytes, Some(bytes.len() as u64)).is_ok_and(|sniffed| sniffed == format);
        let may_return_input = format == file.mesh.format
            && is_not_in_archive
            && unit.scaled_from.is_none()
            && scaled_by == 1.0
            && (separate_objects || !file.has_objects());
        Ok(Self { file, format, scaled_by, separate_objects, may_return_input })
    }

    /// Repairs the file's bodies and assembles their results.
    fn repair(
        &self,
        bytes: &[u8],
        input: &Input<'_>,
        request: &RepairRequest<'_>,
    ) -> Result<AssembledFile, RepairError> {
        match self.file.scene.as_ref().filter(|_| self.separate_objects) {
            None => {
                let body = repair_body(input, judging_format(self.format), request)?;
                Ok(export_one(body, input, &self.file, self.format, request.context)?.into())
            }
            Some(scene) => self.repair_objects(scene, bytes, input, request),
        }
    }

    fn repair_objects(
        &self,
        scene: &Scene,
        bytes: &[u8],
        input: &Input<'_>,
        request: &RepairRequest<'_>,
    ) -> Result<AssembledFile, RepairError> {
        let &Self { ref file, format, may_return_input, .. } = self;
        let &RepairRequest { options, context: file_context, .. } = request;
        // The assembled file is verified as a whole at the end, so the objects' repairs must leave time for that.
        let objects_context = &file_context.ending_before(input.time.verification(input.analysis.surface.faces.len()));
        let request = RepairRequest { context: objects_context, ..*request };
        match (SceneRepair { file, input, format, may_return_input, request, file_context }).run(scene, bytes) {
            Err(RepairError::Cancelled(_)) if !file_context.is_cancelled() && input.bytes.is_some() => {
                input.time.omit(OmittedSection::Repair);
                input.time.omit(OmittedSection::Verification);
                let unchanged = input.unchanged_input(format, options, file_context)?;
                let mut conclusion = Conclusion::with_input(unchanged, "");
                conclusion.draft.candidates.clear();
                Ok(RepairedBody::of(conclusion, input, options, file_context)?.into())
            }
            repaired => repaired,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use glam::DVec3;

    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use crate::mesh::Soup;
    use crate::repair::{Action, Operator, Step};

    /// Adds a unit cube at a corner, with its faces outward or inward.
    fn add_cube(soup: &mut Soup, corner: DVec3, is_outward: bool) {
        const SIDES: [[u32; 4]; 6] =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let first = u32::try_from(soup.positions.len()).expect("few vertices");
        let bit = |vertex: u32, axis: u32| f64::from(vertex >> axis & 1);
        soup.positions.extend((0..8).map(|v| corner + DVec3::new(bit(v, 0), bit(v, 1), bit(v, 2))));
        for [a, b, c, d] in SIDES.map(|side| side.map(|v| first + v)) {
            soup.faces.extend(if is_outward { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }

    /// Adds a flat square sheet of `cells` by `cells` cells.
    fn add_sheet(soup: &mut Soup, corner: DVec3, cells: u32) {
        let first = u32::try_from(soup.positions.len()).expect("few vertices");
        let at = |x: u32, y: u32| first + x * (cells + 1) + y;
        for x in 0..=cells {
            soup.positions.extend((0..=cells).map(|y| corner + DVec3::new(x.into(), y.into(), 0.0) / f64::from(cells)));
        }
        for (x, y) in (0..cells).flat_map(|x| (0..cells).map(move |y| (x, y))) {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            soup.faces.extend([[a, b, c], [a, c, d]]);
        }
    }

    fn repaired(bytes: &[u8], reuses_prefixes: bool) -> Repaired {
        let options = &Options { max_tier: 2, ..Options::default() };
        let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
        let context = &Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let request = RepairRequest { options, remesher: None, context, reuses_prefixes };
        repair_as(bytes, &Limits::default(), request).expect("a result")
    }

    #[test]
    fn results_are_the_same_with_and_without_the_prefix_cache() {
        let mut soup = Soup { positions: Vec::new(), faces: Vec::new() };
        add_cube(&mut soup, DVec3::ZERO, true);
        add_cube(&mut soup, DVec3::new(0.5, 0.3, 0.2), true);
        add_cube(&mut soup, DVec3::new(4.0, 0.0, 0.0), true);
        add_cube(&mut soup, DVec3::new(4.5, 0.2, 0.3), false);
        add_sheet(&mut soup, DVec3::new(20.0, 0.0, 0.0), 8);
        let bytes = format::write(&soup, Format::Stl).expect("written");
        let [with, without] = [true, false].map(|reuses_prefixes| repaired(&bytes, reuses_prefixes));
        assert!(with.report.candidates.len() > 2, "{:#?}", with.report.plan);
        assert_eq!(with.bytes, without.bytes);
        assert_eq!(with.report.candidates, without.report.candidates);
        let facts = |repaired: &Repaired| -> Vec<_> {
            let fact = |step: &Step| {
                (step.strategy, step.action, step.operator, step.status, step.changed.clone(), step.moved)
            };
            repaired.report.steps.iter().map(fact).collect()
        };
        assert_eq!(facts(&with), facts(&without));
        // All strategies share the steps of the common start in any case; they share later steps only through the cache.
        let reused = |repaired: &Repaired| {
            let later = repaired.report.steps.iter().filter(|step| step.strategy > 0 && step.milliseconds == 0.0);
            later.filter(|step| step.operator == Some(Operator::FillHoles)).count()
        };
        assert!(reused(&with) > 0 && reused(&without) == 0, "{} and {}", reused(&with), reused(&without));
        let is_judged_again = |step: &Step| step.action != Action::Validate || step.milliseconds > 0.0;
        assert!(without.report.steps.iter().all(is_judged_again));
    }
}
