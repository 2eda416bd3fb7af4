//! Parts that are too small: open bits that enclose nothing and that no printer could make, and closed parts that the options drop.

use super::operator::{Applied, Counter, Operation, Scope};
use super::ray_caster::RayCaster;
use crate::inspect::{Solid, nesting, solids};
use crate::math::{Box3, ray_direction};
use crate::mesh::{Edges, Parts, Surface, position_key};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// An open part no larger than this share of the model's diagonal is debris: on a print of 200 mm less than half the width of a
/// nozzle.
const SMALL: f64 = 1e-3;
/// So is one with at most so many faces and this share of the model's area, ...
const FEW_FACES: usize = 10;
const LITTLE_AREA: f64 = 1e-3;
/// ... or this share where it is a fin: an open part that stood on an edge of a closed one.
const FIN_AREA: f64 = 1e-2;

/// What reaches out of the box of all else by more than this share of the diagonal is none.
const BOX: f64 = 8e-3;

/// Faces of an open part that are asked whether they lie inside a solid, and rays tried from each.
const ASKED: usize = 64;
const RAYS: u32 = 8;
/// Faces that all rays together may look at.
const BUDGET: u64 = 5_000_000;

/// Removes open parts that are too small to print, and those that lie inside a closed part. An open part has no volume,
/// so nothing that could be printed is lost.
///
/// Precondition: holes that can be closed are closed, and what is not one surface was cut apart. Result: what is left is
/// as it was; the parts and faces that went are counted. Leaves: closed parts of any size, larger open sheets, and
/// everything where nothing but debris is there.
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
    let (mut goes, mut hidden) = (vec![false; parts.count], vec![false; parts.count]);
    for (part, faces) in parts.faces().iter().enumerate().filter(|&(part, _)| open[part]) {
        context.check()?;
        let little = if fins[part] { FIN_AREA } else { LITTLE_AREA };
        goes[part] = is_small(&solids[part], faces.len(), little * area, diagonal);
        if !goes[part] && hold(&mut closed, surface, faces) {
            (goes[part], hidden[part]) = (true, true);
        }
    }
    keep_the_box(&mut goes, &solids, BOX * diagonal);
    let count = goes.iter().filter(|&&d| d).count();
    let hidden = goes.iter().zip(&hidden).filter(|&(&goes, &hidden)| goes && hidden).count() as u64;
    if count == 0 || count == parts.count {
        return Ok(Vec::new());
    }
    let faces = parts.remove(&goes, surface);
    Ok(Change::list([
        (ChangeKind::DebrisPartsRemoved, count as u64 - hidden),
        (ChangeKind::SheetsInsideSolidsRemoved, hidden),
        (ChangeKind::DebrisFacesRemoved, faces),
    ]))
}

/// Whether an open part is too small to print: by its own size, or by few faces of no more than the area `little`.
fn is_small(part: &Solid, faces: usize, little: f64, diagonal: f64) -> bool {
    (faces <= FEW_FACES && part.area <= little) || part.bounds.diagonal() <= SMALL * diagonal
}

/// The same of a part of a model with so much area.
pub(crate) fn is_debris(part: &Solid, faces: usize, area: f64, diagonal: f64) -> bool {
    is_small(part, faces, LITTLE_AREA * area, diagonal)
}

/// Takes back what reaches farther than `most` out of the box of the rest: who put it there meant it to be seen.
fn keep_the_box(goes: &mut [bool], solids: &[Solid], most: f64) {
    let mut rest = Box3::EMPTY;
    for (solid, _) in solids.iter().zip(&*goes).filter(|(_, goes)| !**goes) {
        rest.extend(solid.bounds.min);
        rest.extend(solid.bounds.max);
    }
    for (solid, goes) in solids.iter().zip(goes).filter(|(_, goes)| **goes) {
        let out = (rest.min - solid.bounds.min).max(solid.bounds.max - rest.max).max_element();
        if out > most {
            *goes = false;
            rest.extend(solid.bounds.min);
            rest.extend(solid.bounds.max);
        }
    }
}

/// Of each part, whether it has an edge at the same two positions as an edge of a closed part.
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

/// The closed parts' faces.
fn closed_parts(surface: &Surface, parts: &Parts, solids: &[Solid]) -> RayCaster {
    let closed = |p: u32| p != Parts::NONE && solids[p as usize].closed;
    let of_closed = surface.faces.iter().zip(&parts.of_face).filter(|&(_, &p)| closed(p));
    RayCaster::new(surface, of_closed.map(|(&face, _)| face).collect(), BUDGET)
}

/// Whether the middle of each face that is asked is inside closed parts.
fn hold(closed: &mut RayCaster, surface: &Surface, faces: &[u32]) -> bool {
    let stride = faces.len().div_ceil(ASKED);
    faces.iter().step_by(stride).all(|&f| {
        let from = closed.centroid(surface.faces[f as usize]);
        let count = (0..RAYS).find_map(|ray| closed.crossings(from, from + ray_direction(ray) * 8.0, None));
        count.is_some_and(|n| n % 2 == 1)
    })
}

/// Removes open bits that enclose nothing and that no printer could make.
#[derive(Debug, Clone, Copy)]
pub struct RemoveDebris;

impl Operation for RemoveDebris {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(remove_debris(surface, context)?.into())
    }
}

/// Drops small parts.
#[derive(Debug, Clone, Copy)]
pub struct DropSmallParts {
    /// A part with a smaller share of the volume of all parts goes, in percent.
    pub min_volume_pct: f64,
}

impl DropSmallParts {
    /// Drops the closed parts with less than a share of the volume of all parts, and what lies in them. The cavities of a part that
    /// stays are no parts of their own and stay with it.
    ///
    /// Precondition: consistent and outward winding; what overlaps is united. Result: what is left is as it was. Leaves: open parts of
    /// any size, and the largest part.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let solids = solids(surface, &edges, &parts);
        let is_solid = |part: usize| solids[part].closed && solids[part].volume > 0.0;
        let total: f64 = solids.iter().filter(|it| it.closed).map(|it| it.volume).sum();
        let largest = solids.iter().map(|it| it.volume).fold(0.0, f64::max);
        let least = (self.min_volume_pct / 100.0 * total).min(largest);
        let mut goes: Vec<bool> = (0..parts.count).map(|part| is_solid(part) && solids[part].volume < least).collect();
        if !goes.contains(&true) {
            return Ok(Applied::default());
        }
        let wanted: Vec<bool> = solids.iter().map(|it| it.volume < 0.0).collect();
        let containers = nesting(surface, &parts, &solids, &wanted, context)?;
        let within = |part: usize| containers[part].iter().flatten().any(|&around| goes[around as usize]);
        let cavities: Vec<usize> = (0..parts.count).filter(|&part| wanted[part] && within(part)).collect();
        for part in cavities {
            goes[part] = true;
        }
        let count = (0..parts.count).filter(|&part| goes[part] && is_solid(part)).count() as u64;
        let faces = parts.remove(&goes, surface);
        surface.drop_unreferenced();
        Ok(Change::list([(ChangeKind::SmallPartsDropped, count), (ChangeKind::SmallPartFacesDropped, faces)]).into())
    }
}

impl Operation for DropSmallParts {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { min_volume_pct: scope.options.min_part_volume_pct }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
