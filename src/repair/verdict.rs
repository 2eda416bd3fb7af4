use super::input::{look, read_own, subject};
use super::ledger::ledger;
use super::red_flags::part_lost;
use super::{Cancelled, Changes, Context, Options, RedFlag, RedFlagCode, Standing, red_flags};
use crate::format::{self, Format, ReadError, WriteError};
use crate::inspect::{Analysis, Fates, Findings, Inspection, Ledger, Measures, Original, measure_analysis};
use crate::mesh::{NO_SOURCE, Parts, Surface};

/// Share of the visible surface, in percent, whose loss makes even a printable result worse than the input.
const MOST_LOST_PCT: f64 = 25.0;

/// A result as bytes, and what those bytes say.
pub(super) struct Judged {
    pub bytes: Vec<u8>,
    pub dialect: String,
    pub measures: Measures,
    pub changes: Changes,
    pub red_flags: Vec<RedFlag>,
    /// For each face of it the input's face that it was cut from; empty for the input itself.
    pub source: Vec<u32>,
    /// What became of the input's parts; none of the input itself.
    pub ledger: Option<Ledger>,
    /// All that is told of it, where it is good: then nothing better will come, and what its bytes say is at hand.
    pub looked: Option<(Inspection, Findings)>,
    /// What became of every piece of surface, where it is good and there was time to ask.
    pub fates: Option<Fates>,
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
/// does not wait for the end of the time that `context` gives.
pub(super) fn judge(
    surface: &Surface,
    patches: Patches,
    format: Format,
    input: &Original<'_>,
    options: &Options,
    context: &Context<'_>,
) -> Result<Judged, JudgeError> {
    let patient = &context.without_deadline();
    let bytes = format::write(&surface.to_soup(), format)?;
    let read = read_own(&bytes)?;
    let analysis = Analysis::new(subject(&read, input.analysis().subject.unit), patient)?;
    let measures = measure_analysis(&analysis, patient)?;
    // Faces are written and read in their order.
    let patches: Vec<bool> = match patches {
        Patches::BySource => surface.source.iter().map(|&source| source == NO_SOURCE).collect(),
        Patches::None => Vec::new(),
    };
    let changes = input.changes(&analysis, &measures, Some(&patches), patient)?;
    let ledger = ledger(input, &analysis, options, patient)?;
    let standing = standing(surface, input.analysis(), &ledger);
    let mut red_flags = red_flags(input.measures(), &measures, &changes, standing, options);
    red_flags.extend(part_lost(&ledger, context));
    let good = is_good(&measures, &red_flags);
    let looked = if good { Some(look(&analysis, || Ok(measures.clone()), context)?) } else { None };
    let fates = if good { fates(input, &analysis, context)? } else { None };
    Ok(Judged {
        bytes,
        dialect: read.dialect,
        measures,
        changes,
        red_flags,
        source: surface.source.clone(),
        ledger: Some(ledger),
        looked,
        fates,
    })
}

/// What became of every piece of surface; none where the time was over.
pub(super) fn fates(
    input: &Original<'_>,
    result: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Option<Fates>, Cancelled> {
    match input.fates(result, context) {
        Err(Cancelled) if !context.is_cancelled() => Ok(None),
        found => found.map(Some),
    }
}

/// What of the input is in a surface. Where every part is accounted for, none is gone by becoming one with others.
fn standing(surface: &Surface, input: &Analysis<'_>, ledger: &Ledger) -> Standing {
    let mut stands = vec![false; input.subject.soup.faces.len()];
    for &source in surface.source.iter().filter(|&&source| source != NO_SOURCE) {
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
    Standing { faces: count(&stands), parts_gone: if ledger.lost == 0 { 0 } else { count(&gone) } }
}

/// Printable with no sign of destruction.
fn is_good(measures: &Measures, red_flags: &[RedFlag]) -> bool {
    measures.printable() && red_flags.is_empty()
}

impl Judged {
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
