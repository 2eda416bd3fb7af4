//! The judging of results: each result is written, read back, measured and compared with the input, and gets a rank.

use super::options::{Options, OutputFormat, Verify};
use super::part_accounting::{IntendedChanges, part_accounting, parts_dropped, surviving_input};
use super::red_flags::{AddedSurface, Comparison, part_lost, pinhole_patches, red_flags, surface_invented};
use super::report::{Assumption, AssumptionKind, Candidate, RedFlag, RedFlagCode};
use super::tasks::SurfaceState;
use crate::analyze::subject_taken;
use crate::context::{Cancelled, Context};
use crate::format::{self, Format, Limits, ReadError, ReadMesh, WriteError};
use crate::inspect::{
    Analysis, Changes, ComparedMesh, Findings, InspectOptions, Inspection, Level, Measures, Original, PartAccounting,
    SearchedMesh, SurfaceShares, inspect_analysis, measure_analysis,
};
use crate::mesh::{OPENED_SKIN_SOURCE, Surface, is_generated};
use crate::scene::{LengthUnit, UnitSource};

/// Loss of visible surface, in percent, that makes even a printable result worse than the input.
const MAX_LOST_PCT: f64 = 25.0;

/// A result as bytes, with the findings on those bytes.
pub(super) struct Judged {
    /// The result in the judging format.
    pub bytes: Vec<u8>,
    /// The dialect of the format.
    pub dialect: String,
    /// The measures of the bytes, read back.
    pub measures: Measures,
    /// The changes from the input.
    pub changes: Changes,
    /// The red flags of the result.
    pub red_flags: Vec<RedFlag>,
    /// Assumptions that replace red flags.
    pub assumptions: Vec<Assumption>,
    /// For each face, the input face that it comes from; empty for the input itself.
    pub source: Vec<u32>,
    /// The whereabouts of the input's parts; none for the input itself.
    pub part_accounting: Option<PartAccounting>,
    /// Volume and centre of each sealed cavity.
    pub cavities: Vec<(f64, [f64; 3])>,
    /// The new surface of the result.
    pub added_surface: AddedSurface,
    /// Details for the report.
    pub details: Details,
}

/// Details of a result for the report.
#[derive(Default)]
pub(super) struct Details {
    /// The inspection of a final result, made at once because no better result will follow.
    pub inspection: Option<Inspection>,
    /// The counts of any other result. The report uses them if there is no time for a full inspection.
    pub counts: Option<Inspection>,
    /// The shares of the input's surface that are kept or lost, for a final result if there was time.
    pub surface: Option<SurfaceShares>,
}

/// Why a result could not be judged.
#[derive(Debug, thiserror::Error)]
pub(super) enum JudgeError {
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error("the written file could not be read back: {0}")]
    Read(#[from] ReadError),
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Which faces of a result are patches of holes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Patches {
    /// Faces that do not come from an input face.
    BySource,
    /// None, because the surface was remeshed.
    None,
}

impl Patches {
    /// For each face whether it is a patch; empty if none is.
    fn marks(self, surface: &Surface) -> Vec<bool> {
        match self {
            Self::BySource => surface.source.iter().map(|&source| is_generated(source)).collect(),
            Self::None => Vec::new(),
        }
    }
}

/// What made a result differ from the input.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cause<'a> {
    /// The surface added before a remesh.
    pub before_remesh: Option<&'a AddedSurface>,
    /// The changes to what is solid that were made on purpose.
    pub intended: IntendedChanges,
}

/// The criteria for judging results.
#[derive(Clone, Copy)]
pub(super) struct Judging<'a, 'i> {
    /// The format in which results are written.
    pub format: Format,
    /// The input that results are compared with.
    pub input: &'a Original<'i>,
    /// The options, with the thresholds of red flags.
    pub options: &'a Options,
    /// The context, with the deadline and the end of verification.
    pub context: &'a Context<'a>,
}

impl Judging<'_, '_> {
    /// Writes a mesh, reads the written bytes back and judges them, so that the verdict covers exactly the file that may be returned.
    /// `searched` is a mesh with most faces of the surface whose intersections are known; without one, the input is taken.
    ///
    /// Judging may continue after the deadline until the end of verification. Details of a final result are left out after the deadline.
    ///
    /// # Errors
    /// [`JudgeError`] if the mesh cannot be written or read back, or the job was canceled or ran out of time.
    pub fn judge(
        &self,
        surface: &Surface,
        searched: Option<&SearchedMesh>,
        patches: Patches,
        Cause { before_remesh, intended }: Cause<'_>,
    ) -> Result<Judged, JudgeError> {
        let &Self { format, input, options, context } = self;
        let verification = &context.for_verification();
        verification.check()?;
        let bytes = format::write(&surface.to_soup(), format)?;
        let mut read = read_own(&bytes)?;
        let dialect = std::mem::take(&mut read.dialect);
        let unit = input.analysis().facts.unit.map(|unit| unit_for_readers(unit, options.output));
        let mut analysis = Analysis::new(subject_taken(&mut read, unit.as_ref()), verification)?;
        if options.verify == Verify::Changed {
            let of_input = || input.analysis().known_intersections();
            analysis.reuse_intersections(searched.map_or_else(of_input, SearchedMesh::known_intersections));
        }
        let measures = measure_analysis(&analysis, verification)?;
        let part_accounting = part_accounting(input, &analysis, options, intended, verification)?;
        // The format keeps the order of faces, so `patches` fits the faces that were read back.
        let patches = patches.marks(surface);
        let dropped = parts_dropped(&part_accounting, input.analysis().parts.count);
        let after = ComparedMesh {
            analysis: &analysis,
            measures: &measures,
            patches: Some(&patches),
            gone: &dropped,
            opaque: &|| if intended.is_interior_filled { patches.clone() } else { pinhole_patches(surface) },
        };
        let mut changes = input.changes_but_for(&after, verification)?;
        // Regions visible through holes were opened on purpose, so the enclosed space differs.
        if input.is_open() && surface.source.contains(&OPENED_SKIN_SOURCE) {
            changes.volume_overlap_pct = None;
        }
        let added_surface =
            before_remesh.map_or_else(|| AddedSurface::of(surface), |before| before.in_remesh(measures.area));
        let surviving = surviving_input(surface, input.analysis(), &part_accounting);
        let comparison = Comparison {
            before: input.measures(),
            was_open: input.is_open(),
            settled: input.settled_volume(verification)?,
            after: &measures,
            changes: &changes,
            surviving,
            is_interior_filled: intended.is_interior_filled,
        };
        let mut red_flags = red_flags(&comparison, options);
        red_flags.extend(part_lost(&part_accounting, context));
        red_flags.extend(surface_invented(&added_surface, options));
        let details = self.details(&analysis, is_final(&measures, &red_flags))?;
        let mut judged = Judged {
            cavities: cavities(&analysis, &measures),
            bytes,
            dialect,
            measures,
            changes,
            red_flags,
            assumptions: Vec::new(),
            source: surface.source.clone(),
            part_accounting: Some(part_accounting),
            added_surface,
            details,
        };
        judged.assumptions.extend(same_inside(&judged, options.max_volume_change_pct));
        Ok(judged)
    }

    /// Judges a strategy's result. If the options asked for changes to a sound model, such as thicker walls, the signs of damage are
    /// those of the surface before these changes.
    ///
    /// # Errors
    /// As [`Judging::judge`].
    pub fn judge_with_requests(&self, result: &SurfaceState, patches: Patches) -> Result<Judged, JudgeError> {
        let cause = Cause { before_remesh: result.added_surface.as_ref(), intended: result.intended };
        let mut judged = self.judge(&result.surface, result.searched.as_deref(), patches, cause)?;
        if let Some(before) = &result.before_requests {
            let sound = self.judge(before, result.searched.as_deref(), patches, cause)?;
            let of_whole = [RedFlagCode::PartLost, RedFlagCode::Deviation];
            judged.red_flags.retain(|flag| of_whole.contains(&flag.code));
            judged.red_flags.extend(sound.red_flags.into_iter().filter(|flag| !of_whole.contains(&flag.code)));
            (judged.assumptions, judged.added_surface) = (sound.assumptions, sound.added_surface);
        }
        Ok(judged)
    }

    /// The details of a final result. Other results get them only if they are returned and there is time.
    fn details(&self, result: &Analysis<'_>, is_final: bool) -> Result<Details, Cancelled> {
        let context = self.context;
        if !is_final {
            let counts = Some(inspect_counts(result, &context.for_verification())?.0);
            return Ok(Details { inspection: None, counts, surface: None });
        }
        let inspection = Some(inspect_measured(result, context)?.0);
        Ok(Details { inspection, counts: None, surface: surface_shares(self.input, result, context)? })
    }
}

/// Volume and centre of each sealed cavity of a printable result.
fn cavities(analysis: &Analysis<'_>, measures: &Measures) -> Vec<(f64, [f64; 3])> {
    let cavities = analysis.solids.iter().filter(|solid| measures.printable() && solid.closed && solid.volume < 0.0);
    cavities.map(|solid| (solid.volume.abs(), solid.bounds.centre().to_array())).collect()
}

/// The verdict on a result as text, for the note of a validation step.
pub(super) fn verdict_text(judged: &Judged) -> String {
    let mut text = match judged.measures.faults().join(", ") {
        none if none.is_empty() => "printable".to_owned(),
        faults => format!("not printable: {faults}"),
    };
    for flag in &judged.red_flags {
        text.push_str("; ");
        text.push_str(&flag.detail);
    }
    text
}

/// The unit of a result as its readers see it: a format without units cannot pass on that the input's file stated the unit.
fn unit_for_readers(unit: &LengthUnit, output: OutputFormat) -> LengthUnit {
    let is_kept = matches!(output, OutputFormat::Auto | OutputFormat::Same | OutputFormat::Glb | OutputFormat::ThreeMf);
    let source = if is_kept { unit.source } else { UnitSource::Declared };
    LengthUnit { source, ..unit.clone() }
}

/// Whether a result is printable and has no red flag.
fn is_good(measures: &Measures, red_flags: &[RedFlag]) -> bool {
    measures.printable() && red_flags.is_empty()
}

/// Whether no other strategy can do better: the result is printable, and its only red flag may be new surface, which the input forces.
fn is_final(measures: &Measures, red_flags: &[RedFlag]) -> bool {
    measures.printable() && red_flags.iter().all(|flag| flag.code == RedFlagCode::SurfaceInvented)
}

impl Judged {
    /// Whether no other strategy can do better.
    pub fn is_final(&self) -> bool {
        is_final(&self.measures, &self.red_flags)
    }

    /// Whether the result is printable and has no red flag.
    pub fn is_good(&self) -> bool {
        is_good(&self.measures, &self.red_flags)
    }

    /// Whether the result is printable without severe damage, or at least closed without loss.
    pub fn is_whole(&self) -> bool {
        self.rank().0 <= ResultClass::Crossing
    }

    /// The rank of the result; a smaller rank is better. Results compare by class, then by lost surface and defects.
    ///
    /// The input itself ranks among the unprintable results (see [`rank_of_input`]). So an unprintable result replaces the input only with
    /// fewer defects and the complete model, and a result that destroyed surface never does.
    pub fn rank(&self) -> ResultRank {
        let is_loss = |flag: &RedFlag| matches!(flag.code, RedFlagCode::SurfaceLost | RedFlagCode::PartLost);
        let class = match (self.measures.printable(), class_of_printable(&self.red_flags)) {
            (_, ResultClass::Destroyed) => ResultClass::Destroyed,
            (true, class) => class,
            (false, _) if self.red_flags.iter().any(is_loss) => ResultClass::Destroyed,
            (false, _) => class_of_unprintable(&self.measures),
        };
        let lost = self.changes.surface_lost_pct.unwrap_or(0.0);
        // Tenths of a percent: sampling is not more precise.
        let tenths = (lost * 10.0).round() as u64;
        let defects = self.measures.defects();
        let uncounted = !self.measures.self_intersections.complete;
        match class {
            ResultClass::Crossing | ResultClass::Broken => (class, uncounted, defects, tenths),
            _ => (class, uncounted, tenths, defects),
        }
    }
}

/// The class of a result, the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ResultClass {
    /// Printable without red flags.
    Good,
    /// Printable; the only red flag is more new surface than the options allow.
    AddedSurface,
    /// Printable with a red flag that the classes below do not cover.
    Flagged,
    /// Printable, but visible surface was lost.
    SurfaceLost,
    /// Printable, but a part was lost.
    PartLost,
    /// Closed without loss, but with intersecting or inward faces.
    Crossing,
    /// Not closed; nothing was lost.
    Broken,
    /// Printable or not, the repair destroyed more than it fixed.
    Destroyed,
}

/// The class of a result, whether there were too many intersections to count, and two numbers that order results of one class.
pub(super) type ResultRank = (ResultClass, bool, u64, u64);

/// The rank of the input itself, which a result must beat to replace the input.
pub(super) fn rank_of_input(before: &Measures) -> ResultRank {
    let class = if before.printable() { ResultClass::Good } else { class_of_unprintable(before) };
    (class, !before.self_intersections.complete, before.defects(), 0)
}

/// The class of a printable result with these red flags.
pub(super) fn class_of_printable(red_flags: &[RedFlag]) -> ResultClass {
    let raised = |code| red_flags.iter().find(|flag| flag.code == code).map(|flag| flag.value);
    let lost = raised(RedFlagCode::SurfaceLost);
    if raised(RedFlagCode::BoundingBoxChange).is_some() || lost.is_some_and(|lost| lost > MAX_LOST_PCT) {
        ResultClass::Destroyed
    } else if red_flags.is_empty() {
        ResultClass::Good
    } else if red_flags.iter().all(|flag| flag.code == RedFlagCode::SurfaceInvented) {
        ResultClass::AddedSurface
    } else if raised(RedFlagCode::PartLost).is_some() {
        ResultClass::PartLost
    } else if lost.is_some() {
        ResultClass::SurfaceLost
    } else {
        ResultClass::Flagged
    }
}

/// The class of an unprintable mesh. Holes are worse than intersecting or inward faces: a slicer can unite overlaps, but it cannot guess
/// missing surface.
fn class_of_unprintable(m: &Measures) -> ResultClass {
    if m.closed && m.manifold && m.consistent { ResultClass::Crossing } else { ResultClass::Broken }
}

impl Candidate {
    /// Makes a candidate from a judged result and the index of its strategy.
    pub(super) fn new(strategy: Option<u32>, judged: &Judged, chosen: bool) -> Self {
        Self {
            strategy,
            printable: judged.measures.printable(),
            defects: judged.measures.defects(),
            faces: judged.measures.faces,
            red_flags: judged.red_flags.clone(),
            chosen,
        }
    }
}

/// The assumption for a volume change over the threshold that raised no red flag, because winding numbers find the same enclosed space.
pub(super) fn same_inside(judged: &Judged, most_pct: f64) -> Option<Assumption> {
    let change = judged.changes.volume_change_pct.filter(|change| change.abs() > most_pct)?;
    let overlap = judged.changes.volume_overlap_pct?;
    let flagged = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::VolumeChange);
    (!flagged).then(|| {
        let detail = format!(
            "The volume computed from the faces changed by {change:.1} %, because it counts space twice where parts overlap. By winding \
             number, {overlap:.1} % of the enclosed space is the same."
        );
        Assumption::new(AssumptionKind::MethodsAgree, 1, detail).with_amount(change)
    })
}

/// The shares of the input's surface that are kept, moved, added or removed; none if the deadline passed.
pub(super) fn surface_shares(
    input: &Original<'_>,
    result: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Option<SurfaceShares>, Cancelled> {
    context.unless_late(input.surface_shares(result, context))
}

/// Reads a file that this program wrote, without limits.
pub(super) fn read_own(bytes: &[u8]) -> Result<ReadMesh, ReadError> {
    format::read(bytes, &Limits::NONE)
}

/// Inspects a mesh with the default options. After the deadline, the inspection holds only the measures and counts.
pub(super) fn inspect_measured(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_in_time(analysis, &InspectOptions::default(), context)
}

/// Inspects a mesh. After the deadline, the inspection holds only the measures and counts.
pub(super) fn inspect_in_time(
    analysis: &Analysis<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    if let Some(whole) = context.unless_late(inspect_analysis(analysis, options, context))? {
        return Ok(whole);
    }
    let verification = &context.for_verification();
    let measures = measure_analysis(analysis, verification)?;
    let (counts, findings) = inspect_counts(analysis, verification)?;
    Ok((Inspection { measures, ..counts }, findings))
}

/// Inspects a mesh at the level `none`, which only counts.
pub(super) fn inspect_counts(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_analysis(analysis, &InspectOptions { level: Level::None, ..InspectOptions::default() }, context)
}
