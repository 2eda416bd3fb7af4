//! Bodies of different materials that overlap. The later body keeps the space, as it does in slicers: PrusaSlicer since 2.4 lets the
//! volume win that is lower in the list, and so do those made of it.

use super::operators::resolve::Resolve;
use super::repaint::repaint;
use super::{Cancelled, Context};
use crate::arrange::{Exact, Inside};
use crate::inspect::{Analysis, Solid, measure_analysis, solids};
use crate::math::Box3;
use crate::mesh::{Edges, NO_SOURCE, Parts, Soup, Surface};
use crate::scene::{PaintedMesh, Palette};

/// A body without the space of others.
pub(super) struct CutBody {
    pub mesh: PaintedMesh,
    /// The volume that went, in cubic units.
    pub removed: f64,
}

/// Removes from a body what others fill, where they stand: its surface within them goes, and theirs within it becomes its wall.
///
/// None where that leaves nothing, or nothing that is printable; bodies must be closed.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn cut_body(
    body: &PaintedMesh,
    others: &[Soup],
    palettes: &mut [Palette],
    context: &Context<'_>,
) -> Result<Option<CutBody>, Cancelled> {
    let own = Surface::from_soup(&body.soup).0;
    let bounds = own.bounds();
    let mut whole = body.soup.clone();
    let first_other = whole.faces.len();
    for other in others {
        add_turned_over(&near_parts(other, &bounds), &mut whole);
    }
    let mut surface = Surface::from_soup(&whole).0;
    // The turned bodies count against this one, so that only what is in no other counts as inside.
    let resolve = Resolve { inside: Inside::Positive, max_deviation: f64::INFINITY, sheets: None, always: true };
    let resolved = resolve.apply(&mut surface, &Exact, context)?;
    if resolved.error.is_some() || resolved.pairs_left > 0 || surface.faces.is_empty() {
        return Ok(None);
    }
    let soup = surface.to_soup();
    let measures = measure_analysis(&Analysis::new((&soup).into(), context)?, context)?;
    if !measures.printable() {
        return Ok(None);
    }
    let source: Vec<u32> =
        surface.source.iter().map(|&face| if (face as usize) < first_other { face } else { NO_SOURCE }).collect();
    let paint = repaint(&own, &body.paint, &soup, &source, palettes, context)?;
    let volume: f64 = parts_of(&own).1.iter().map(|solid| solid.volume).sum();
    let removed = volume - measures.volume.value;
    Ok(Some(CutBody { mesh: PaintedMesh { soup, paint }, removed }))
}

/// The parts of a body whose boxes meet a box.
fn near_parts(body: &Soup, bounds: &Box3) -> Soup {
    let surface = Surface::from_soup(body).0;
    let (parts, solids) = parts_of(&surface);
    let is_near: Vec<bool> = solids.iter().map(|solid| solid.bounds.meets(bounds)).collect();
    let near = |part: u32| part != Parts::NONE && is_near[part as usize];
    let faces = surface.faces.iter().zip(&parts.of_face).filter(|(_, part)| near(**part)).map(|(face, _)| *face);
    Soup { faces: faces.collect(), positions: surface.positions.clone() }
}

fn parts_of(surface: &Surface) -> (Parts, Vec<Solid>) {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    (parts, solids)
}

fn add_turned_over(body: &Soup, whole: &mut Soup) {
    #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
    let first = whole.positions.len() as u32;
    whole.positions.extend(&body.positions);
    whole.faces.extend(body.faces.iter().map(|&[a, b, c]| [a + first, c + first, b + first]));
}
