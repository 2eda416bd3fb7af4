//! Removes surface inside solids that bounds no volume: internal faces and open internal sheets.

use std::sync::Arc;

use super::face_pairs::{AroundEdge, around_edge, without_inner_sheets};
use super::operator::{Applied, Counter, Operation, Scope, as_shared};
use super::ray_caster::RayCaster;
use crate::inspect::Analysis;
use crate::math::{ray_direction, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The most faces of a sheet that are sampled.
const MAX_SAMPLES: usize = 16;
/// The number of rays from all samples together, and the least number from each.
const TOTAL_RAYS: usize = 48;
const MIN_RAYS: usize = 8;
/// The distance from its face at which a ray starts, where the model's size is about 1.
const RAY_OFFSET: f64 = 1e-6;
/// The most faces that all rays together may test.
const BUDGET: u64 = 5_000_000;

/// Removes internal faces: single-layer sheets that divide a solid or a cavity in two.
///
/// ```text
///    ____________               ____________
///   |      |inner|             |            |
///   |      |face |     ->      |            |
///   |______|_____|             |____________|
/// ```
///
/// Along the border of such a sheet an odd number of faces meet. Turning around the edge through the solid, two neighbouring
/// faces both close the solid, or both open it; the inner of the two is surplus. A patch (faces joined across edges with two
/// faces) that is surplus along its whole border is an internal face. Removing the inner patch keeps the enclosed volume.
///
/// Precondition: faces wind outward as far as possible. Result: no vertex moves and no boundary appears; edges where the
/// internal face was have one face less. Leaves: internal faces that meet open surface; sheets with a free border, such as
/// fins, which [`super::split_non_manifold`] splits off; double internal faces, which [`super::duplicates`] removes.
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
    let mut is_inner = vec![false; patches.count];
    let mut is_other = vec![false; patches.count];
    for (e, half_edges) in edges.iter().enumerate() {
        if half_edges.len() == 2 {
            continue;
        }
        context.check()?;
        let mut inner = Vec::new();
        // Next to open surface the inside is undefined.
        let enclosed = !half_edges.iter().any(|&h| is_open[patch_of(h)]);
        if enclosed && half_edges.len() > 2 && half_edges.len() % 2 == 1 {
            let AroundEdge { order, closes } = around_edge(faces, &unit, &edges, e);
            let kept = without_inner_sheets(&order, &closes);
            inner = (0..half_edges.len()).filter(|i| !order.is_empty() && !kept.contains(i)).collect();
        }
        for (i, &h) in half_edges.iter().enumerate() {
            let flags = if inner.contains(&i) { &mut is_inner } else { &mut is_other };
            flags[patch_of(h)] = true;
        }
    }
    let is_removed: Vec<bool> = is_inner.iter().zip(&is_other).map(|(&inner, &other)| inner && !other).collect();
    let patch_count = is_removed.iter().filter(|&&is_removed| is_removed).count() as u64;
    let face_count = patches.remove(&is_removed, surface);
    Ok(Change::list([
        (ChangeKind::InternalPatchesRemoved, patch_count),
        (ChangeKind::InternalFacesRemoved, face_count),
    ])
    .into())
}

/// Removes single-layer internal faces from solids.
#[derive(Debug, Clone, Copy)]
pub struct RemoveInternalFaces;

impl Operation<'_> for RemoveInternalFaces {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    // Faces that the internal face separated may wind inconsistently.
    const MAY_RAISE: &'static [Counter] = &[Counter::MisorientedEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::NonManifoldEdges];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        remove_internal_faces(surface, context)
    }
}

/// Removes open internal sheets: sheets inside a solid that separate nothing. They may be attached to the solid's surface along
/// a part of their border or float.
///
/// ```text
///    ____________               ____________
///   |      |     |             |            |
///   |  /   |     |      ->     |            |
///   |____________|             |____________|
/// ```
///
/// Such a sheet is a patch (faces joined across edges with two faces) with a boundary that is one face too many at its other
/// edges. Nearly all rays from the sheet cross an odd number of other faces; a few may fail, so that a hole in the solid does
/// not matter. Other surface stays: from a solid's own surface only every second ray crosses the solid. A cavity's rays cross
/// the cavity. A patch that touches the outer surface in an edge has two faces there.
///
/// Precondition: none. Result: no vertex moves, and no boundary appears. Leaves: sheets that reach out of the solid or whose
/// rays cross the sheet itself; for those see [`super::debris`].
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_internal_sheets(surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
    let edges = Edges::new(&surface.faces);
    as_shared(surface, |surface| remove_sheets(surface, &edges, None, context))
}

/// [`remove_internal_sheets`] from a surface with these `edges`, faster if it has the triangles of a `known` mesh.
fn remove_sheets(
    surface: &mut Arc<Surface>,
    edges: &Edges,
    known: Option<&Analysis<'_>>,
    context: &Context<'_>,
) -> Result<Applied, Cancelled> {
    if !edges.iter().any(|h| h.len() == 1) {
        return Ok(Applied::default());
    }
    let patches = Parts::patches(surface, edges);
    if patches.count < 2 {
        return Ok(Applied::default());
    }
    let mut is_candidate = surplus_patches(edges, &patches, None);
    if !is_candidate.contains(&true) {
        return Ok(Applied::default());
    }
    let mut caster = RayCaster::of_whole(surface, known, BUDGET);
    for (is_candidate, faces) in is_candidate.iter_mut().zip(patches.faces()).filter(|(is_candidate, _)| **is_candidate)
    {
        context.check()?;
        *is_candidate = is_inside(&mut caster, surface, &patches.of_face, &faces);
    }
    // Where several sheets share an edge, they must be removed together.
    let is_removed = surplus_patches(edges, &patches, Some(&is_candidate));
    let count = is_removed.iter().filter(|&&is_removed| is_removed).count() as u64;
    if count == 0 {
        return Ok(Applied::default());
    }
    let faces = patches.remove(&is_removed, Arc::make_mut(surface));
    Ok(Change::list([(ChangeKind::InternalSheetsRemoved, count), (ChangeKind::SheetFacesRemoved, faces)]).into())
}

/// The patches with a boundary that are surplus: at each non-manifold edge on their border they have one face. With `is_removed`,
/// only marked patches, and only where the edge keeps an even number of faces.
fn surplus_patches(edges: &Edges, patches: &Parts, is_removed: Option<&[bool]>) -> Vec<bool> {
    let patch = |h: &u32| patches.of_face[*h as usize / 3];
    let is_removed = |p: u32| is_removed.is_none_or(|is_removed| is_removed[p as usize]);
    let (mut ends, mut stays) = (vec![false; patches.count], vec![false; patches.count]);
    for half_edges in edges.iter().filter(|h| h.len() != 2) {
        if let [h] = half_edges {
            ends[patch(h) as usize] = true;
            continue;
        }
        let mut here: Vec<u32> = half_edges.iter().map(patch).collect();
        here.sort_unstable();
        let left = here.iter().filter(|&&p| !is_removed(p)).count();
        let even = left >= 2 && left % 2 == 0;
        for of_patch in here.chunk_by(|x, y| x == y) {
            stays[of_patch[0] as usize] |= of_patch.len() > 1 || !even && left > 0;
        }
    }
    let is_surplus = |(p, at): (u32, usize)| is_removed(p) && ends[at] && !stays[at];
    (0u32..).zip(0..patches.count).map(is_surplus).collect()
}

/// Whether a patch lies inside other surface. Nearly all rays from the patch, and most from each sample, must cross an odd
/// number of other faces. Hardly any may cross an odd number of the patch's own faces.
fn is_inside(caster: &mut RayCaster<'_>, surface: &Surface, of_face: &[u32], faces: &[u32]) -> bool {
    let samples: Vec<u32> = faces.iter().step_by(faces.len().div_ceil(MAX_SAMPLES)).copied().collect();
    let rays = (TOTAL_RAYS / samples.len()).max(MIN_RAYS);
    let (mut missed, mut own) = (0, 0);
    for &f in &samples {
        let centroid = caster.centroid(surface.faces[f as usize]);
        let mut missed_here = 0;
        for ray in (0u32..).take(rays) {
            // The ray starts off the face, so that it does not touch coplanar faces.
            let direction = ray_direction(ray);
            let (mut odd, mut odd_own) = (false, false);
            let clear =
                caster.each_crossing(centroid + direction * RAY_OFFSET, centroid + direction * 8.0, Some(f), |g| {
                    if of_face[g as usize] == of_face[f as usize] {
                        odd_own = !odd_own;
                    } else {
                        odd = !odd;
                    }
                });
            own += usize::from(odd_own);
            missed_here += usize::from(!clear || !odd);
            let all = rays * samples.len();
            if 2 * missed_here >= rays || 4 * (missed + missed_here) > all || 8 * own > all {
                return false;
            }
        }
        missed += missed_here;
    }
    true
}

/// Removes open internal sheets from solids.
pub(super) struct RemoveInternalSheets<'a> {
    input: &'a Analysis<'a>,
}

impl<'a> Operation<'a> for RemoveInternalSheets<'a> {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonManifoldEdges];
    // Faces that the sheet separated may wind inconsistently.
    const MAY_RAISE: &'static [Counter] = &[Counter::MisorientedEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonManifoldEdges];

    fn with_scope(scope: &Scope<'a>, _surface: &Surface) -> Self {
        Self { input: scope.input }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        remove_sheets(surface, &edges, Some(self.input), context)
    }
}
