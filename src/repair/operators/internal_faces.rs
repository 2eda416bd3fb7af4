//! Surface within a solid that bounds nothing: faces that part it in two, and open sheets.

use super::inside::{AroundEdge, RayCaster, around_edge, without_inner_sheets};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::{ray_direction, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Faces of a sheet that are asked whether they are within a solid.
const ASKED: usize = 16;
/// Rays that all of them cast, and each at least.
const RAYS: usize = 48;
const LEAST_RAYS: usize = 8;
/// How far from its face a ray begins, where the model's size is about 1.
const BESIDE: f64 = 1e-6;
/// Faces that all rays together may look at.
const BUDGET: u64 = 5_000_000;

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
pub fn remove_internal_faces(surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
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
            let AroundEdge { order, closes } = around_edge(faces, &unit, &edges, e);
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
    Ok(Change::list([(ChangeKind::InternalWallsRemoved, walls), (ChangeKind::InternalFacesRemoved, gone)]).into())
}

/// Removes walls of one sheet within solids.
#[derive(Debug, Clone, Copy)]
pub struct RemoveInternalFaces;

impl Operation for RemoveInternalFaces {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    // Faces that the wall kept apart may wind against one another.
    const MAY_RAISE: &'static [Counter] = &[Counter::MisorientedEdges, Counter::PinchedVertices];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        remove_internal_faces(surface, context)
    }
}

/// Removes what is left of walls within a solid: open sheets that part nothing, whether they hang on its surface by one part
/// of their border or float.
///
/// ```text
///    ____________               ____________
///   |      |     |             |            |
///   |  /   |     |      ->     |            |
///   |____________|             |____________|
/// ```
///
/// Such a sheet is a patch (faces joined across edges of two faces) with a boundary that is one face too many at its other
/// edges. Nearly all rays from it go through an odd number of other faces; some may miss, so that a hole in the solid does
/// not matter. Surface that bounds the solid sees the rest of it in every second direction only, a cavity sees itself, and one
/// that touches the outer wall in an edge has two faces there; so all of these stay.
///
/// Precondition: none. Result: no vertex moves, and no edge opens. Leaves: sheets that reach out of the solid or are bent so
/// that they see themselves, for which see [`super::debris`].
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_internal_sheets(surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
    let edges = Edges::new(&surface.faces);
    if !edges.iter().any(|h| h.len() == 1) {
        return Ok(Applied::default());
    }
    let patches = Parts::patches(surface, &edges);
    if patches.count < 2 {
        return Ok(Applied::default());
    }
    let mut hangs = one_too_many(&edges, &patches, None);
    if !hangs.contains(&true) {
        return Ok(Applied::default());
    }
    let mut caster = RayCaster::new(surface, surface.faces.clone(), BUDGET);
    for (hangs, faces) in hangs.iter_mut().zip(patches.faces()).filter(|(hangs, _)| **hangs) {
        context.check()?;
        *hangs = is_within(&mut caster, surface, &patches.of_face, &faces);
    }
    // Where several hang on one edge, what goes must go together.
    let goes = one_too_many(&edges, &patches, Some(&hangs));
    let count = goes.iter().filter(|&&goes| goes).count() as u64;
    if count == 0 {
        return Ok(Applied::default());
    }
    let faces = patches.remove(&goes, surface);
    Ok(Change::list([(ChangeKind::InternalSheetsRemoved, count), (ChangeKind::SheetFacesRemoved, faces)]).into())
}

/// The patches with a boundary that have one face at each other edge where several meet, if any; where some are to go, those of
/// them without which such edges have an even number.
fn one_too_many(edges: &Edges, patches: &Parts, goes: Option<&[bool]>) -> Vec<bool> {
    let patch = |h: &u32| patches.of_face[*h as usize / 3];
    let goes = |p: u32| goes.is_none_or(|goes| goes[p as usize]);
    let (mut ends, mut stays) = (vec![false; patches.count], vec![false; patches.count]);
    for half_edges in edges.iter().filter(|h| h.len() != 2) {
        if let [h] = half_edges {
            ends[patch(h) as usize] = true;
            continue;
        }
        let mut here: Vec<u32> = half_edges.iter().map(patch).collect();
        here.sort_unstable();
        let left = here.iter().filter(|&&p| !goes(p)).count();
        let even = left >= 2 && left % 2 == 0;
        for of_patch in here.chunk_by(|x, y| x == y) {
            stays[of_patch[0] as usize] |= of_patch.len() > 1 || !even && left > 0;
        }
    }
    let too_many = |(p, at): (u32, usize)| goes(p) && ends[at] && !stays[at];
    (0u32..).zip(0..patches.count).map(too_many).collect()
}

/// Whether nearly all rays from the faces of a patch, and of each of them most, go through an odd number of other faces, and
/// hardly any through an odd number of its own.
fn is_within(caster: &mut RayCaster, surface: &Surface, of_face: &[u32], faces: &[u32]) -> bool {
    let asked: Vec<u32> = faces.iter().step_by(faces.len().div_ceil(ASKED)).copied().collect();
    let rays = (RAYS / asked.len()).max(LEAST_RAYS);
    let (mut missed, mut own) = (0, 0);
    for &f in &asked {
        let middle = caster.middle(surface.faces[f as usize]);
        let mut missed_here = 0;
        for ray in (0u32..).take(rays) {
            // From beside the face, so that what lies on it is not touched.
            let direction = ray_direction(ray);
            let (mut odd, mut odd_own) = (false, false);
            let clear = caster.each_crossing(middle + direction * BESIDE, middle + direction * 8.0, Some(f), |g| {
                if of_face[g as usize] == of_face[f as usize] {
                    odd_own = !odd_own;
                } else {
                    odd = !odd;
                }
            });
            own += usize::from(odd_own);
            missed_here += usize::from(!clear || !odd);
            let all = rays * asked.len();
            if 2 * missed_here >= rays || 4 * (missed + missed_here) > all || 8 * own > all {
                return false;
            }
        }
        missed += missed_here;
    }
    true
}

/// Removes open sheets within solids that part nothing.
#[derive(Debug, Clone, Copy)]
pub struct RemoveInternalSheets;

impl Operation for RemoveInternalSheets {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonManifoldEdges];
    // Faces that the wall kept apart may wind against one another.
    const MAY_RAISE: &'static [Counter] = &[Counter::MisorientedEdges, Counter::PinchedVertices];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        remove_internal_sheets(surface, context)
    }
}
