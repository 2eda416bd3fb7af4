//! Walls of one sheet within a solid.

use super::cut::{Turn, turn, without_inner_sheets};
use super::{Applied, Counter, Operation, Scope};
use crate::math::to_unit_range;
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Removes sheets that part a solid, or a cavity, in two without having a thickness.
///
/// ```text
///    ____________               ____________
///   |      |     |             |            |
///   |      |wall |     ->      |            |
///   |______|_____|             |____________|
/// ```
///
/// Along the border of such a sheet an odd number of faces meet, and it lies between the others: of two neighbours around
/// the edge, seen along the way through the solid, that both close it, the inner one is one face too many, and so of two that both
/// open it. A patch (faces joined across edges of two faces) that is too many along all of its border is a wall. Taking
/// the inner sheet keeps all that is enclosed.
///
/// Precondition: faces wind outward as far as that goes. Result: no vertex moves, nothing opens: the edges where the wall
/// was have one face less. Leaves: walls that meet open surface, sheets with a free border, such as fins, which [`super::cut`] cuts off, and walls of two
/// sheets, which [`super::duplicates`] removes.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_membranes(surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
    let edges = Edges::new(&surface.faces);
    if !edges.iter().any(|h| h.len() > 2 && h.len() % 2 == 1) {
        return Ok(Applied::default());
    }
    let (faces, unit) = (&surface.faces, to_unit_range(&surface.positions));
    let patches = Parts::patches(surface, &edges);
    let patch_of = |h: u32| patches.of_face[h as usize / 3] as usize;
    let is_open = patches.open(&edges);
    let mut is_wall = vec![false; patches.count];
    let mut is_other = vec![false; patches.count];
    for (e, half_edges) in edges.iter().enumerate() {
        if half_edges.len() == 2 {
            continue;
        }
        context.check()?;
        let mut inner = Vec::new();
        // Beside open surface nothing says which side is within.
        let enclosed = !half_edges.iter().any(|&h| is_open[patch_of(h)]);
        if enclosed && half_edges.len() > 2 && half_edges.len() % 2 == 1 {
            let Turn { order, closes } = turn(faces, &unit, &edges, e);
            let kept = without_inner_sheets(&order, &closes);
            inner = (0..half_edges.len()).filter(|i| !order.is_empty() && !kept.contains(i)).collect();
        }
        for (i, &h) in half_edges.iter().enumerate() {
            let it = if inner.contains(&i) { &mut is_wall } else { &mut is_other };
            it[patch_of(h)] = true;
        }
    }
    let goes: Vec<bool> = is_wall.iter().zip(&is_other).map(|(&wall, &other)| wall && !other).collect();
    let walls = goes.iter().filter(|&&goes| goes).count() as u64;
    let gone = patches.remove(&goes, surface);
    Ok(Change::list([(ChangeKind::MembranesRemoved, walls), (ChangeKind::MembraneFacesRemoved, gone)]).into())
}

/// Removes walls of one sheet within solids.
#[derive(Debug, Clone, Copy)]
pub struct RemoveMembranes;

impl Operation for RemoveMembranes {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges];
    // Faces that the wall kept apart may wind against one another.
    const MAY_RAISE: &'static [Counter] = &[Counter::MisorientedEdges, Counter::PinchedVertices];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        remove_membranes(surface, context)
    }
}
