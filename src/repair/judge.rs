//! The judging of results: by their own bytes, read back, and by whether methods of different kind agree on them.

use super::options::{Operator, Options, OutputFormat};
use super::part_accounting::{part_accounting, parts_dropped, standing};
use super::presets::remesh_of;
use super::red_flags::{Compared, Invented, part_lost, red_flags, surface_invented};
use super::report::{Assumption, AssumptionKind, Candidate, RedFlag, RedFlagCode, Strategy};
use crate::analyze::subject;
use crate::context::{Cancelled, Context};
use crate::format::{self, Format, Limits, ReadError, ReadMesh, WriteError};
use crate::inspect::{
    Analysis, Changes, ComparedMesh, Findings, InspectOptions, Inspection, Level, Measures, Original, PartAccounting,
    SurfaceShares, inspect_analysis, measure_analysis,
};
use crate::mesh::{OPENED_SKIN_SOURCE, Surface, is_generated};
use crate::scene::{LengthUnit, UnitSource};

/// Share of the visible surface, in percent, whose loss makes even a printable result worse than the input.
const MOST_LOST_PCT: f64 = 25.0;

/// A result as bytes, and what those bytes say.
pub(super) struct Judged {
    pub bytes: Vec<u8>,
    pub dialect: String,
    pub measures: Measures,
    pub changes: Changes,
    pub red_flags: Vec<RedFlag>,
    /// What was taken for granted in place of a flag.
    pub assumptions: Vec<Assumption>,
    /// For each face of it the input's face that it was cut from; empty for the input itself.
    pub source: Vec<u32>,
    /// What became of the input's parts; none of the input itself.
    pub part_accounting: Option<PartAccounting>,
    /// Volume and centre of each sealed cavity.
    pub cavities: Vec<(f64, [f64; 3])>,
    /// What of its surface was invented.
    pub invented: Invented,
    pub details: Details,
}

/// What is known of a result beside its measures.
#[derive(Default)]
pub(super) struct Details {
    /// Its inspection, where it is good: then nothing better will come, and what its bytes say is at hand.
    pub inspection: Option<Inspection>,
    /// What was counted of it, where there is no inspection: what is told of it if there is no time for one.
    pub counts: Option<Inspection>,
    /// What became of the input's surface, where it is good and there was time to ask.
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

/// Which faces of a result are the patches of holes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Patches {
    /// Those that no face of the input gave.
    BySource,
    /// None: all of it was made anew.
    None,
}

/// What results are judged by.
#[derive(Clone, Copy)]
pub(super) struct Judging<'a, 'i> {
    /// The format in which they are written.
    pub format: Format,
    /// The input that they are compared with.
    pub input: &'a Original<'i>,
    pub options: &'a Options,
    pub context: &'a Context<'a>,
}

impl Judging<'_, '_> {
    /// Writes a mesh, reads the written bytes back, and measures those, so that the verdict is on what is handed out. The verdict
    /// may go on after the deadline, until the end of verification; details of a good result are left out when the deadline has passed.
    pub fn judge(
        &self,
        surface: &Surface,
        patches: Patches,
        before_remesh: Option<&Invented>,
    ) -> Result<Judged, JudgeError> {
        let &Self { format, input, options, context } = self;
        let verification = &context.for_verification();
        verification.check()?;
        let bytes = format::write(&surface.to_soup(), format)?;
        let read = read_own(&bytes)?;
        let unit = input.analysis().subject.unit.map(|unit| unit_for_readers(unit, options.output));
        let analysis = Analysis::new(subject(&read, unit.as_ref()), verification)?;
        let measures = measure_analysis(&analysis, verification)?;
        let part_accounting = part_accounting(input, &analysis, options, verification)?;
        // Faces are written and read in their order.
        let patches: Vec<bool> = match patches {
            Patches::BySource => surface.source.iter().map(|&source| is_generated(source)).collect(),
            Patches::None => Vec::new(),
        };
        let dropped = parts_dropped(&part_accounting, input.analysis().parts.count);
        let after = ComparedMesh { analysis: &analysis, measures: &measures, patches: Some(&patches), gone: &dropped };
        let mut changes = input.changes_but_for(&after, verification)?;
        // What was taken for inside was opened on purpose: it can be seen through a hole.
        if !input.measures().closed && surface.source.contains(&OPENED_SKIN_SOURCE) {
            changes.volume_overlap_pct = None;
        }
        let invented = before_remesh.map_or_else(|| Invented::of(surface), |it| it.in_remesh(measures.area));
        let standing = standing(surface, input.analysis(), &part_accounting);
        let compared = Compared {
            before: input.measures(),
            settled: input.settled_volume(verification)?,
            after: &measures,
            changes: &changes,
            standing,
        };
        let mut red_flags = red_flags(&compared, options);
        red_flags.extend(part_lost(&part_accounting, context));
        red_flags.extend(surface_invented(&invented, options));
        let details = self.details(&analysis, is_final(&measures, &red_flags))?;
        let mut judged = Judged {
            cavities: cavities(&analysis, &measures),
            bytes,
            dialect: read.dialect,
            measures,
            changes,
            red_flags,
            assumptions: Vec::new(),
            source: surface.source.clone(),
            part_accounting: Some(part_accounting),
            invented,
            details,
        };
        judged.assumptions.extend(same_inside(&judged, options.max_volume_change_pct));
        Ok(judged)
    }

    /// The details of a final result; of others they are found out when they are handed out, if there is time.
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
    let cavities = analysis.solids.iter().filter(|it| measures.printable() && it.closed && it.volume < 0.0);
    cavities.map(|it| (it.volume.abs(), it.bounds.centre().to_array())).collect()
}

/// A verdict in words, for a validation step.
pub(super) fn verdict_in_words(judged: &Judged) -> String {
    let mut text = match judged.measures.faults().join(", ") {
        fine if fine.is_empty() => "printable".to_owned(),
        left => format!("not printable: {left}"),
    };
    for flag in &judged.red_flags {
        text.push_str("; ");
        text.push_str(&flag.detail);
    }
    text
}

/// The unit of a result as its readers learn it: a format without units doesn't say what the input's file said.
fn unit_for_readers(unit: &LengthUnit, output: OutputFormat) -> LengthUnit {
    let is_kept = matches!(output, OutputFormat::Auto | OutputFormat::Same | OutputFormat::Glb | OutputFormat::ThreeMf);
    let source = if is_kept { unit.source } else { UnitSource::Declared };
    LengthUnit { source, ..unit.clone() }
}

/// Printable with no sign of destruction.
fn is_good(measures: &Measures, red_flags: &[RedFlag]) -> bool {
    measures.printable() && red_flags.is_empty()
}

/// Whether no other way can do better: printable, and no flag but that the input leaves much to invention.
fn is_final(measures: &Measures, red_flags: &[RedFlag]) -> bool {
    measures.printable() && red_flags.iter().all(|flag| flag.code == RedFlagCode::SurfaceInvented)
}

impl Judged {
    /// Whether no other way can do better.
    pub fn is_final(&self) -> bool {
        is_final(&self.measures, &self.red_flags)
    }

    /// Printable with no sign of destruction.
    pub fn is_good(&self) -> bool {
        is_good(&self.measures, &self.red_flags)
    }

    /// Whether it is printable with nothing destroyed, or at least closed with nothing lost.
    pub fn is_whole(&self) -> bool {
        self.rank().0 <= Class::Crossing
    }

    /// Smaller is better: by class, and within a class by what was lost, or by defects where that is nothing. The input itself
    /// stands among the unprintable (see [`rank_of_input`]), so a result that is not printable must have fewer defects and the
    /// whole model, and one that destroyed is never preferred.
    pub fn rank(&self) -> Rank {
        let raised = |code| self.red_flags.iter().find(|flag| flag.code == code).map(|flag| flag.value);
        let lost = raised(RedFlagCode::SurfaceLost);
        let parts_lost = raised(RedFlagCode::PartLost).is_some();
        let destroyed =
            raised(RedFlagCode::BoundingBoxChange).is_some() || lost.is_some_and(|lost| lost > MOST_LOST_PCT);
        let class = match self.measures.printable() {
            _ if destroyed => Class::Destroyed,
            true if self.red_flags.is_empty() => Class::Good,
            true if is_final(&self.measures, &self.red_flags) => Class::Invented,
            true if parts_lost => Class::PartLost,
            true if lost.is_some() => Class::SurfaceLost,
            true => Class::Flagged,
            false if lost.is_some() || parts_lost => Class::Destroyed,
            false => class_of_unprintable(&self.measures),
        };
        let lost = self.changes.surface_lost_pct.unwrap_or(0.0);
        // Tenths of a percent: sampling tells no less.
        let tenths = (lost * 10.0).round() as u64;
        let defects = self.measures.defects();
        let uncounted = !self.measures.self_intersections.complete;
        match class {
            Class::Crossing | Class::Broken => (class, uncounted, defects, tenths),
            _ => (class, uncounted, tenths, defects),
        }
    }
}

/// How good a result is, the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Class {
    /// Printable, and no red flag.
    Good,
    /// Printable with more of its surface invented than the options allow, and no other red flag.
    Invented,
    /// Printable with another red flag than the classes below have.
    Flagged,
    /// Printable with some of the surface lost that can be seen.
    SurfaceLost,
    /// Printable with a part lost.
    PartLost,
    /// Closed, with faces that intersect or look inward, and nothing lost.
    Crossing,
    /// Not closed, and nothing lost.
    Broken,
    /// More was destroyed than mended, whether it is printable or not.
    Destroyed,
}

/// The class of a result, whether there were too many intersections to count, and what tells two of a class apart.
pub(super) type Rank = (Class, bool, u64, u64);

/// The rank of the input itself, which any result must beat.
pub(super) fn rank_of_input(before: &Measures) -> Rank {
    let class = if before.printable() { Class::Good } else { class_of_unprintable(before) };
    (class, !before.self_intersections.complete, before.defects(), 0)
}

/// A hole is worse than faces that intersect or look inward: a slicer can unite what overlaps, but not guess what is missing.
fn class_of_unprintable(m: &Measures) -> Class {
    if m.closed && m.manifold && m.consistent { Class::Crossing } else { Class::Broken }
}

impl Candidate {
    /// A result, and the index of the strategy that made it.
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

/// The assumption for a volume that would raise a flag by its figure, while winding numbers find the same inside before and after.
pub(super) fn same_inside(judged: &Judged, most_pct: f64) -> Option<Assumption> {
    let change = judged.changes.volume_change_pct.filter(|change| change.abs() > most_pct)?;
    let overlap = judged.changes.volume_overlap_pct?;
    let flagged = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::VolumeChange);
    (!flagged).then(|| {
        let detail = format!(
            "the volume by its faces changed by {change:.1} %, since it counts space twice where parts overlap; by winding numbers \
             {overlap:.1} % of the inside is the same"
        );
        Assumption::new(AssumptionKind::MethodsAgree, 1, detail).with_amount(change)
    })
}

/// By how many percentage points two results may differ in the surface that they lost, or in the volume, and still agree.
const SAME_LOSS: f64 = 0.3;
const SAME_VOLUME: f64 = 1.0;

/// The kinds of method that tell inside from outside, each by its own means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    /// The exact arrangement, on the input's own faces.
    Arrangement,
    /// Winding numbers on a grid.
    Grid,
    /// Blender.
    Blender,
}

impl Method {
    /// The method of a strategy; none where it decides nothing of the kind.
    pub fn of(strategy: &Strategy) -> Option<Self> {
        let runs = |operator| strategy.actions.iter().any(|planned| planned.operators.contains(&operator));
        if remesh_of(strategy).is_some() {
            Some(Self::Blender)
        } else if runs(Operator::Remesh) {
            Some(Self::Grid)
        } else {
            runs(Operator::SelfUnion).then_some(Self::Arrangement)
        }
    }
}

/// What a method found wrong with its own printable result, by the flags and their values.
#[derive(Debug, Clone)]
pub(super) struct Finding {
    method: Method,
    flags: Vec<(RedFlagCode, f64)>,
}

impl Finding {
    /// The flags of a result, where it is printable and they are of a kind on which methods may agree.
    pub fn of(strategy: &Strategy, judged: &Judged) -> Option<Self> {
        let flags = measured(judged);
        let comparable = !flags.is_empty() && flags.iter().all(|&(code, _)| tolerance(code).is_some());
        let method = Method::of(strategy).filter(|_| comparable && judged.measures.printable())?;
        Some(Self { method, flags })
    }

    /// Whether a method of another kind came to the same measures.
    pub fn agrees_with(&self, other: &Self) -> bool {
        self.method != other.method && self.flags_agree(&other.flags)
    }

    /// Whether another result has the same flags with the same values, within what sampling tells.
    pub fn is_of(&self, judged: &Judged) -> bool {
        self.flags_agree(&measured(judged))
    }

    fn flags_agree(&self, other: &[(RedFlagCode, f64)]) -> bool {
        let same = |(a, b): (&(RedFlagCode, f64), &(RedFlagCode, f64))| {
            a.0 == b.0 && tolerance(a.0).is_some_and(|most| (a.1 - b.1).abs() <= most)
        };
        self.flags.len() == other.len() && self.flags.iter().zip(other).all(same)
    }
}

/// The flags with their values, but for invented surface, on which methods need not agree.
fn measured(judged: &Judged) -> Vec<(RedFlagCode, f64)> {
    let flags = judged.red_flags.iter().filter(|flag| flag.code != RedFlagCode::SurfaceInvented);
    flags.map(|flag| (flag.code, flag.value)).collect()
}

fn tolerance(code: RedFlagCode) -> Option<f64> {
    match code {
        RedFlagCode::SurfaceLost => Some(SAME_LOSS),
        RedFlagCode::VolumeChange => Some(SAME_VOLUME),
        _ => None,
    }
}

/// Makes an assumption of the flag for lost surface, on which methods of different kind agree, where the surface still stands and is
/// only enclosed now. Any other flag stays: surface that is gone, or volume that changed, is for a person to look at.
pub(super) fn explain_by_agreement(judged: &mut Judged) {
    let (invented, flags): (Vec<RedFlag>, Vec<RedFlag>) =
        judged.red_flags.iter().cloned().partition(|flag| flag.code == RedFlagCode::SurfaceInvented);
    let encloses_only = |flag: &RedFlag| flag.code == RedFlagCode::SurfaceLost;
    if !judged.changes.keeps_visible_surface() || !flags.iter().all(encloses_only) {
        return;
    }
    judged.red_flags = invented;
    for flag in flags {
        let detail = format!(
            "{:.1} % of the surface lies within the result: methods of different kind agree that closing the input encloses it",
            flag.value
        );
        judged.assumptions.push(
            Assumption::new(AssumptionKind::MethodsAgree, 1, detail)
                .with_amount(flag.value)
                .unless(&format!("max_surface_lost_pct={}", flag.threshold)),
        );
    }
}

/// What became of the input's surface; none where the time was over.
pub(super) fn surface_shares(
    input: &Original<'_>,
    result: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Option<SurfaceShares>, Cancelled> {
    Ok(context.unless_late(input.provenance(result, context))?.map(|provenance| provenance.shares))
}

/// Reads what we have written, however large it is.
pub(super) fn read_own(bytes: &[u8]) -> Result<ReadMesh, ReadError> {
    format::read(bytes, &Limits::NONE)
}

/// Inspects a mesh that was measured. When the deadline has passed, nothing but what results are judged by is there.
pub(super) fn inspect_measured(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_in_time(analysis, &InspectOptions::default(), context)
}

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
    let (counted, findings) = inspect_counts(analysis, verification)?;
    Ok((Inspection { measures, ..counted }, findings))
}

/// Counts what is counted of every mesh, whatever the time.
pub(super) fn inspect_counts(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_analysis(analysis, &InspectOptions { level: Level::None, ..InspectOptions::default() }, context)
}
