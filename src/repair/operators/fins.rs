//! Sheets that hang within a solid by a part of their border.

use super::Applied;
use super::walls::Walls;
use crate::math::ray_direction;
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, Context};

/// Faces of a sheet that are asked whether they are within a solid.
const ASKED: usize = 16;
/// Rays that all of them cast, and each at least.
const RAYS: usize = 48;
const LEAST_RAYS: usize = 8;
/// Faces that all rays together may look at.
const BUDGET: u64 = 5_000_000;

/// Removes what is left of walls within a solid: sheets that hang on its surface by one part of their border and end with the
/// rest of it inside.
///
/// ```text
///    ____________               ____________
///   |      |     |             |            |
///   |      |     |      ->     |            |
///   |____________|             |____________|
/// ```
///
/// Such a sheet is a patch (faces joined across edges of two faces) with a boundary that is one face too many at its other
/// edges, and from nearly all of which most rays go through an odd number of other faces. Rays may miss in part, so that a
/// hole elsewhere does not matter. Surface that bounds the solid sees the rest of it in every second direction only, and a
/// cavity that touches the outer wall in an edge has two faces there; so both stay.
///
/// Precondition: none. Result: no vertex moves, and no edge opens. Leaves: sheets that reach out of the solid, and sheets
/// within it that touch nothing, which [`super::debris`] removes.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn remove_fins_within(surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
    let edges = Edges::new(&surface.faces);
    if !edges.iter().any(|h| h.len() == 1) || !edges.iter().any(|h| h.len() > 2) {
        return Ok(Applied::default());
    }
    let patches = Parts::patches(surface, &edges);
    let mut hangs = one_too_many(&edges, &patches, None);
    if !hangs.contains(&true) {
        return Ok(Applied::default());
    }
    let mut walls = Walls::new(surface, surface.faces.clone(), BUDGET);
    for (hangs, faces) in hangs.iter_mut().zip(patches.faces()).filter(|(hangs, _)| **hangs) {
        context.check()?;
        *hangs = is_within(&mut walls, surface, &patches.of_face, &faces);
    }
    // Where several hang on one edge, what goes must go together.
    let goes = one_too_many(&edges, &patches, Some(&hangs));
    let count = goes.iter().filter(|&&goes| goes).count() as u64;
    if count == 0 {
        return Ok(Applied::default());
    }
    let keep: Vec<bool> = patches.of_face.iter().map(|&p| p == Parts::NONE || !goes[p as usize]).collect();
    let faces = surface.retain_faces(&keep);
    surface.drop_unreferenced();
    Ok(Change::list([("fins_within_removed", count), ("fin_faces_removed", faces)]).into())
}

/// The patches with a boundary of which each other edge has one face; where some are to go, those of them without which
/// their edges have an even number.
fn one_too_many(edges: &Edges, patches: &Parts, goes: Option<&[bool]>) -> Vec<bool> {
    let patch = |h: &u32| patches.of_face[*h as usize / 3];
    let goes = |p: u32| goes.is_none_or(|goes| goes[p as usize]);
    let (mut ends, mut hangs, mut stays) =
        (vec![false; patches.count], vec![false; patches.count], vec![false; patches.count]);
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
            let fits = of_patch.len() == 1 && (even || left == 0);
            let it = if fits { &mut hangs } else { &mut stays };
            it[of_patch[0] as usize] = true;
        }
    }
    let too_many = |(p, at): (u32, usize)| goes(p) && ends[at] && hangs[at] && !stays[at];
    (0u32..).zip(0..patches.count).map(too_many).collect()
}

/// Whether nearly all rays from the faces of a patch, and of each of them most, go through an odd number of others.
fn is_within(walls: &mut Walls, surface: &Surface, of_face: &[u32], faces: &[u32]) -> bool {
    let asked: Vec<u32> = faces.iter().step_by(faces.len().div_ceil(ASKED)).copied().collect();
    let rays = (RAYS / asked.len()).max(LEAST_RAYS);
    let mut all = 0;
    for &f in &asked {
        let [a, b, c] = surface.faces[f as usize].map(|v| walls.unit[v as usize]);
        let from = (a + b + c) / 3.0;
        let odd = (0u32..).take(rays).filter(|&ray| {
            let mut odd = false;
            let to = from + ray_direction(ray) * 8.0;
            let clear = walls.each_crossing(from, to, Some(f), |g| odd ^= of_face[g as usize] != of_face[f as usize]);
            clear && odd
        });
        let odd = odd.count();
        if 2 * odd <= rays {
            return false;
        }
        all += odd;
    }
    4 * all >= 3 * rays * asked.len()
}
