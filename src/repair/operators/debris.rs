//! Removes parts that are too small: open fragments without volume, and closed parts below the limit in the options.

use super::operator::{Applied, Counter, Operation, Scope};
use super::ray_caster::RayCaster;
use crate::inspect::{Solid, nesting, solids};
use crate::math::{Box3, ray_direction};
use crate::mesh::{Edges, Parts, Surface, position_key};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// An open part is debris if its diagonal is at most this share of the model's: less than half a nozzle's width on a print of
/// 200 mm.
const MAX_SHARE_OF_DIAGONAL: f64 = 1e-3;
/// An open part is also debris with at most this many faces and this share of the model's area.
const MAX_FACES: usize = 10;
const MAX_SHARE_OF_AREA: f64 = 1e-3;
/// The share of the area for a fin: an open part with an edge on an edge of a closed part.
const MAX_SHARE_OF_AREA_FIN: f64 = 1e-2;

/// A part that protrudes from the box of all other parts by more than this share of the diagonal is not debris.
const MAX_PROTRUSION: f64 = 8e-3;

/// The most faces of an open part that are sampled, and the rays tried from each.
const MAX_SAMPLES: usize = 64;
const RAYS: u32 = 8;
/// The most faces that all rays together may test.
const BUDGET: u64 = 5_000_000;

/// Removes open parts that are too small to print, and open parts inside closed parts. An open part has no volume, so nothing
/// printable is lost.
///
/// Precondition: holes are filled where possible, and non-manifold edges are split. Result: the other parts are unchanged;
/// removed parts and faces are counted. Leaves: closed parts of any size, larger open sheets, and every part where all parts
/// are debris.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_debris(surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let open = parts.open(&edges);
    if !open.contains(&true) {
        return Ok(Vec::new());
    }
    let solids = solids(surface, &edges, &parts);
    let diagonal = surface.bounds().diagonal();
    let area: f64 = solids.iter().map(|s| s.area).sum();
    let fins = fins(surface, &edges, &parts, &solids);
    let mut closed = closed_parts(surface, &parts, &solids);
    let (mut is_removed, mut hidden) = (vec![false; parts.count], vec![false; parts.count]);
    for (part, faces) in parts.faces().iter().enumerate().filter(|&(part, _)| open[part]) {
        context.check()?;
        let max_area = if fins[part] { MAX_SHARE_OF_AREA_FIN } else { MAX_SHARE_OF_AREA };
        is_removed[part] = is_small(&solids[part], faces.len(), max_area * area, diagonal);
        if !is_removed[part] && is_enclosed(&mut closed, surface, faces) {
            (is_removed[part], hidden[part]) = (true, true);
        }
    }
    keep_protruding(&mut is_removed, &solids, MAX_PROTRUSION * diagonal);
    let count = is_removed.iter().filter(|&&d| d).count();
    let hidden = is_removed.iter().zip(&hidden).filter(|&(&is_removed, &hidden)| is_removed && hidden).count() as u64;
    if count == 0 || count == parts.count {
        return Ok(Vec::new());
    }
    let faces = parts.remove(&is_removed, surface);
    Ok(Change::list([
        (ChangeKind::DebrisPartsRemoved, count as u64 - hidden),
        (ChangeKind::SheetsInsideSolidsRemoved, hidden),
        (ChangeKind::DebrisFacesRemoved, faces),
    ]))
}

/// Whether an open part is too small to print: by its diagonal, or by few faces with at most `max_area`.
fn is_small(part: &Solid, faces: usize, max_area: f64, diagonal: f64) -> bool {
    (faces <= MAX_FACES && part.area <= max_area) || part.bounds.diagonal() <= MAX_SHARE_OF_DIAGONAL * diagonal
}

/// Whether an open part of a model with the given area and diagonal is debris. All lengths are in the model's unit.
pub(crate) fn is_debris(part: &Solid, faces: usize, area: f64, diagonal: f64) -> bool {
    is_small(part, faces, MAX_SHARE_OF_AREA * area, diagonal)
}

/// Keeps parts that protrude by more than `max_protrusion` from the box of the rest: they are visible on purpose.
fn keep_protruding(is_removed: &mut [bool], solids: &[Solid], max_protrusion: f64) {
    let mut rest = Box3::EMPTY;
    for (solid, _) in solids.iter().zip(&*is_removed).filter(|(_, is_removed)| !**is_removed) {
        rest = rest.joined(&solid.bounds);
    }
    for (solid, is_removed) in solids.iter().zip(is_removed).filter(|(_, is_removed)| **is_removed) {
        let out = (rest.min - solid.bounds.min).max(solid.bounds.max - rest.max).max_element();
        if out > max_protrusion {
            *is_removed = false;
            rest = rest.joined(&solid.bounds);
        }
    }
}

/// For each part whether it is open and has an edge at the same two positions as an edge of a closed part.
fn fins(surface: &Surface, edges: &Edges, parts: &Parts, solids: &[Solid]) -> Vec<bool> {
    let key = |v: u32| position_key(surface.positions[v as usize]);
    let mut ends: Vec<([[u64; 3]; 2], bool, u32)> = (0..edges.len())
        .map(|e| {
            let mut ends = edges.vertices(e).map(key);
            ends.sort_unstable();
            let part = parts.of_face[edges.half_edges(e)[0] as usize / 3];
            (ends, solids[part as usize].closed, part)
        })
        .collect();
    ends.sort_unstable();
    let mut fins = vec![false; parts.count];
    for at_one_place in ends.chunk_by(|x, y| x.0 == y.0) {
        if at_one_place.iter().any(|&(_, closed, _)| closed) {
            for &(_, closed, part) in at_one_place {
                fins[part as usize] |= !closed;
            }
        }
    }
    fins
}

/// Prepares ray queries against the faces of the closed parts.
fn closed_parts(surface: &Surface, parts: &Parts, solids: &[Solid]) -> RayCaster<'static> {
    let closed = |p: u32| p != Parts::NONE && solids[p as usize].closed;
    let of_closed = surface.faces.iter().zip(&parts.of_face).filter(|&(_, &p)| closed(p));
    RayCaster::new(surface, of_closed.map(|(&face, _)| face).collect(), BUDGET)
}

/// Whether the centroids of all sampled faces lie inside closed parts.
fn is_enclosed(closed: &mut RayCaster<'_>, surface: &Surface, faces: &[u32]) -> bool {
    let stride = faces.len().div_ceil(MAX_SAMPLES);
    faces.iter().step_by(stride).all(|&f| {
        let from = closed.centroid(surface.faces[f as usize]);
        let count = (0..RAYS).find_map(|ray| closed.crossings(from, from + ray_direction(ray) * 8.0, None));
        count.is_some_and(|n| n % 2 == 1)
    })
}

/// Removes open fragments that enclose no volume and are too small to print.
#[derive(Debug, Clone, Copy)]
pub struct RemoveDebris;

impl Operation<'_> for RemoveDebris {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(remove_debris(surface, context)?.into())
    }
}

/// Removes small closed parts.
#[derive(Debug, Clone, Copy)]
pub struct DropSmallParts {
    /// The least share of a part's volume in the volume of all parts, in percent.
    pub min_volume_pct: f64,
}

impl DropSmallParts {
    /// Removes the closed parts below the least volume, together with the cavities inside them. A cavity of a part that stays
    /// is not a part of its own and stays.
    ///
    /// Precondition: consistent, outward winding; overlapping volumes are united. Result: the other parts are unchanged.
    /// Leaves: open parts of any size, and the largest part.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let solids = solids(surface, &edges, &parts);
        let is_solid = |part: usize| solids[part].closed && solids[part].volume > 0.0;
        let total: f64 = solids.iter().filter(|solid| solid.closed).map(|solid| solid.volume).sum();
        let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
        let least = (self.min_volume_pct / 100.0 * total).min(largest);
        let mut is_removed: Vec<bool> =
            (0..parts.count).map(|part| is_solid(part) && solids[part].volume < least).collect();
        if !is_removed.contains(&true) {
            return Ok(Applied::default());
        }
        let is_cavity: Vec<bool> = solids.iter().map(|solid| solid.volume < 0.0).collect();
        let containers = nesting(surface, &parts, &solids, &is_cavity, context)?;
        let is_in_dropped_part =
            |part: usize| containers[part].iter().flatten().any(|&around| is_removed[around as usize]);
        let cavities: Vec<usize> =
            (0..parts.count).filter(|&part| is_cavity[part] && is_in_dropped_part(part)).collect();
        for part in cavities {
            is_removed[part] = true;
        }
        let count = (0..parts.count).filter(|&part| is_removed[part] && is_solid(part)).count() as u64;
        let faces = parts.remove(&is_removed, surface);
        surface.drop_unreferenced();
        Ok(Change::list([(ChangeKind::SmallPartsDropped, count), (ChangeKind::SmallPartFacesDropped, faces)]).into())
    }
}

impl Operation<'_> for DropSmallParts {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { min_volume_pct: scope.options.min_part_volume_pct }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
