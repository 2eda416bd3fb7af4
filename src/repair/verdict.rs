use super::{Cancelled, Changes, Context, Options, RedFlag, RedFlagCode, compare, red_flags};
use crate::format::{self, Format, Limits, ReadError, WriteError};
use crate::inspect::{Measures, measure};
use crate::mesh::{NO_SOURCE, Soup, Surface};

/// Share of the visible surface, in percent, whose loss makes even a printable result worse than the input.
const MOST_LOST_PCT: f64 = 25.0;

/// A result as bytes, and what those bytes say.
pub(super) struct Judged {
    pub bytes: Vec<u8>,
    pub dialect: String,
    pub measures: Measures,
    pub changes: Changes,
    pub red_flags: Vec<RedFlag>,
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

/// Writes a mesh, reads the written bytes back, and measures those, so that the verdict is on what is handed out.
pub(super) fn judge(
    surface: &Surface,
    format: Format,
    input: &Soup,
    before: &Measures,
    options: &Options,
    context: &Context<'_>,
) -> Result<Judged, JudgeError> {
    let bytes = format::write(&surface.to_soup(), format)?;
    // What we have written may be read however large it is.
    let limits = Limits { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX };
    let read = format::read(&bytes, &limits)?;
    let measures = measure(&read.soup, context)?;
    let changes = compare(before, &measures, input, &read.soup, context)?;
    let red_flags = red_flags(before, &measures, &changes, standing(surface), options);
    Ok(Judged { bytes, dialect: read.dialect, measures, changes, red_flags })
}

/// How many faces of the input are in a surface, whole or cut.
fn standing(surface: &Surface) -> u64 {
    let mut sources: Vec<u32> = surface.source.iter().copied().filter(|&s| s != NO_SOURCE).collect();
    sources.sort_unstable();
    sources.dedup();
    sources.len() as u64
}

impl Judged {
    /// Printable with no sign of destruction.
    pub fn is_good(&self) -> bool {
        self.measures.printable() && self.red_flags.is_empty()
    }

    /// Smaller is better: first good results, then printable ones that kept most of the model, then solids whose faces
    /// intersect, then the rest, and last those that lost a part of the model's extent or much of its visible surface;
    /// among equals by defects.
    pub fn rank(&self) -> Rank {
        let lost = self.red_flags.iter().any(|f| match f.code {
            RedFlagCode::BoxChange => true,
            RedFlagCode::SurfaceLost => f.value > MOST_LOST_PCT,
            _ => false,
        });
        let class = match (self.measures.printable(), self.red_flags.is_empty(), lost) {
            (true, true, _) => 0,
            (true, false, false) => 1,
            (false, _, false) => class_of_unprintable(&self.measures),
            (_, _, true) => 4,
        };
        (class, !self.measures.self_intersections.complete, self.measures.defects())
    }
}

/// A class, whether there were too many intersections to count, and the defects.
pub(super) type Rank = (u8, bool, u64);

/// The rank of the input itself, which any result must beat.
pub(super) fn rank_of_input(before: &Measures) -> Rank {
    let class = if before.printable() { 0 } else { class_of_unprintable(before) };
    (class, !before.self_intersections.complete, before.defects())
}

/// A hole is worse than faces that intersect: a slicer can unite what overlaps, but not guess what is missing.
fn class_of_unprintable(m: &Measures) -> u8 {
    if m.printable_but_for_intersections() { 2 } else { 3 }
}
