use super::agreement::same_inside;
use super::input::{inspect_counts, inspect_measured, read_own};
use super::invented::{Invented, surface_invented};
use super::ledger::ledger;
use super::red_flags::part_lost;
use super::{
    Assumption, Cancelled, Changes, Context, Options, OutputFormat, RedFlag, RedFlagCode, Standing, red_flags,
};
use crate::analyze::subject;
use crate::format::{self, Format, ReadError, WriteError};
use crate::inspect::{Analysis, Certificate, Inspection, Ledger, Measures, Original, SurfaceShares, measure_analysis};
use crate::mesh::{OPENED_SKIN_SOURCE, Parts, Surface, is_made};
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
    pub ledger: Option<Ledger>,
    /// Volume and centre of each sealed cavity.
    pub cavities: Vec<(f64, [f64; 3])>,
    /// What of its surface was invented.
    pub invented: Invented,
    /// Its inspection, where it is good: then nothing better will come, and what its bytes say is at hand.
    pub looked: Option<Inspection>,
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

/// Writes a mesh, reads the written bytes back, and measures those, so that the verdict is on what is handed out. The verdict
/// may go on after the deadline, until the end of verification; details of a good result are left out when the deadline has passed.
pub(super) fn judge(
    surface: &Surface,
    patches: Patches,
    before_remesh: Option<&Invented>,
    format: Format,
    input: &Original<'_>,
    options: &Options,
    context: &Context<'_>,
) -> Result<Judged, JudgeError> {
    let verification = &context.for_verification();
    verification.check()?;
    let bytes = format::write(&surface.to_soup(), format)?;
    let read = read_own(&bytes)?;
    let unit = input.analysis().subject.unit.map(|unit| unit_for_readers(unit, options.output));
    let analysis = Analysis::new(subject(&read, unit.as_ref()), verification)?;
    let measures = measure_analysis(&analysis, verification)?;
    // Faces are written and read in their order.
    let patches: Vec<bool> = match patches {
        Patches::BySource => surface.source.iter().map(|&source| is_made(source)).collect(),
        Patches::None => Vec::new(),
    };
    let ledger = ledger(input, &analysis, options, verification)?;
    let dropped = parts_dropped(&ledger, input.analysis().parts.count);
    let mut changes = input.changes_but_for(&analysis, &measures, Some(&patches), &dropped, verification)?;
    // What was taken for inside was opened on purpose: it can be seen through a hole.
    if !input.measures().closed && surface.source.contains(&OPENED_SKIN_SOURCE) {
        changes.inside_overlap_pct = None;
    }
    let invented = before_remesh.map_or_else(|| Invented::of(surface), |it| it.in_remesh(measures.area));
    let standing = standing(surface, input.analysis(), &ledger);
    let mut red_flags =
        red_flags(input.measures(), input.settled_volume(verification)?, &measures, &changes, standing, options);
    red_flags.extend(part_lost(&ledger, context));
    red_flags.extend(surface_invented(&invented, options));
    let good = is_final(&measures, &red_flags);
    // Of other results it is found out when they are handed out, if there is time.
    let looked = if good { Some(inspect_measured(&analysis, context)?.0) } else { None };
    let counts = if good { None } else { Some(inspect_counts(&analysis, verification)?.0) };
    let shares = if good { surface_shares(input, &analysis, context)? } else { None };
    let cavities = analysis.solids.iter().filter(|it| measures.printable() && it.closed && it.volume < 0.0);
    let cavities = cavities.map(|it| (it.volume.abs(), it.bounds.centre().to_array())).collect();
    let mut judged = Judged {
        bytes,
        dialect: read.dialect,
        measures,
        changes,
        red_flags,
        assumptions: Vec::new(),
        source: surface.source.clone(),
        ledger: Some(ledger),
        cavities,
        invented,
        looked,
        counts,
        surface: shares,
    };
    judged.assumptions.extend(same_inside(&judged, options.max_volume_change_pct));
    Ok(judged)
}

/// The unit of a result as its readers learn it: a format without units doesn't say what the input's file said.
fn unit_for_readers(unit: &LengthUnit, output: OutputFormat) -> LengthUnit {
    let is_kept = matches!(output, OutputFormat::Auto | OutputFormat::Same | OutputFormat::Glb | OutputFormat::ThreeMf);
    let source = if is_kept { unit.source } else { UnitSource::Declared };
    LengthUnit { source, ..unit.clone() }
}

/// What became of the input's surface; none where the time was over.
pub(super) fn surface_shares(
    input: &Original<'_>,
    result: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Option<SurfaceShares>, Cancelled> {
    Ok(context.unless_late(input.fates(result, context))?.map(|fates| fates.shares))
}

/// What of the input is in a surface. Where every part is accounted for, none is gone by becoming one with others.
fn standing(surface: &Surface, input: &Analysis<'_>, ledger: &Ledger) -> Standing {
    let mut stands = vec![false; input.subject.soup.faces.len()];
    for &source in surface.source.iter().filter(|&&source| !is_made(source)) {
        if let Some(stands) = stands.get_mut(source as usize) {
            *stands = true;
        }
    }
    let mut gone = vec![true; input.parts.count];
    for (&part, &source) in input.parts.of_face.iter().zip(&input.surface.source) {
        if part != Parts::NONE && stands[source as usize] {
            gone[part as usize] = false;
        }
    }
    let count = |them: &[bool]| them.iter().filter(|&&it| it).count() as u64;
    let parts_gone = if ledger.lost == 0 { 0 } else { count(&gone) };
    let [vertices, vertices_before] = vertices_standing(input, &stands, ledger);
    let dropped = parts_dropped(ledger, input.parts.count);
    let is_dropped = |part: &&u32| dropped.get(**part as usize) == Some(&true);
    let faces_dropped = input.parts.of_face.iter().filter(is_dropped).count() as u64;
    Standing { faces: count(&stands), parts_gone, vertices, vertices_before, faces_dropped }
}

/// Of each part whether it was dropped as the options ask; empty where none was.
fn parts_dropped(ledger: &Ledger, parts: usize) -> Vec<bool> {
    if ledger.dropped == 0 {
        return Vec::new();
    }
    let mut dropped = vec![false; parts];
    for (part, _) in ledger.certified.iter().filter(|(_, certificate)| *certificate == Certificate::Dropped) {
        dropped[*part as usize] = true;
    }
    dropped
}

/// The vertices at faces that stand, and those at any face that has an area and is no part that may go.
fn vertices_standing(input: &Analysis<'_>, stands: &[bool], ledger: &Ledger) -> [u64; 2] {
    let mut may_go = vec![false; input.parts.count];
    ledger.certified.iter().for_each(|(part, _)| may_go[*part as usize] = true);
    let mut vertices = vec![[false; 2]; input.surface.positions.len()];
    let faces = input.surface.faces.iter().zip(&input.surface.source).zip(&input.parts.of_face).zip(input.flat());
    for (((face, &source), &part), &flat) in faces {
        if !flat && part != Parts::NONE && !may_go[part as usize] {
            for &v in face {
                let [of_standing, of_any] = &mut vertices[v as usize];
                *of_standing |= stands[source as usize];
                *of_any = true;
            }
        }
    }
    [0, 1].map(|k| vertices.iter().filter(|marks| marks[k]).count() as u64)
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
        let destroyed = raised(RedFlagCode::BoxChange).is_some() || lost.is_some_and(|lost| lost > MOST_LOST_PCT);
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
