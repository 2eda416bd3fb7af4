//! Searches for all kinds of defects except self-intersections, modelled on Parasolid's `PK_MESH_find_defects` and
//! extended.

mod chains;
mod elements;
mod folds;
mod parts;
mod scan;
mod seams;
mod sheets;

use super::{Analysis, Findings, Level, Tolerances};
use crate::context::{Cancelled, Context};
use crate::mesh::Parts;
use scan::Scan;

/// Finds all defects of a mesh except self-intersections.
///
/// Level `none` finds nothing. Level `basic` omits spatial searches: slits, cracks, T-junctions, inner shells, and
/// sheets whose two sides have different faces. A search stops early if it exceeds its budget, or if no ray decides
/// whether a part is inside another; [`Findings::incomplete`] then lists its kind. O(n log n) in the number of faces.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn find_defects(
    analysis: &Analysis<'_>,
    tolerances: &Tolerances,
    level: Level,
    findings: &mut Findings,
    context: &Context<'_>,
) -> Result<(), Cancelled> {
    if level == Level::None {
        return Ok(());
    }
    let scan = &mut Scan::new(analysis, tolerances, findings, context);
    elements::find_corrupt(scan)?;
    if analysis.surface.faces.is_empty() {
        return Ok(());
    }
    let flat = elements::find_flat(scan)?;
    elements::find_edges(scan)?;
    elements::find_vertices(scan)?;
    elements::find_bad_normals(scan, &flat)?;
    elements::find_holes(scan)?;
    let opposed = elements::find_duplicates(scan)?;
    let sizes = parts::sizes(scan);
    let thin = parts::find_thin_parts(scan, &sizes);
    let in_thin_part: Vec<bool> =
        analysis.parts.of_face.iter().map(|&p| p != Parts::NONE && thin[p as usize].is_some()).collect();
    let folded = folds::find(scan, &flat, &in_thin_part)?;
    let known = sheets::EarlierResults { opposed: &opposed, flat: &flat, thin: &thin, folded: &folded };
    sheets::find(scan, level, &known)?;
    parts::find_parts(scan, level, &sizes, &thin)?;
    if level >= Level::Full {
        seams::find(scan)?;
    }
    Ok(())
}
