//! Consistent and outward winding.

use super::outside;
use crate::inspect::{doubled_areas, nesting_depths, solids};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, Context};

const NONE: u32 = u32::MAX;

/// Turns faces so that neighbours agree and solids look outward.
///
/// 1. Within each patch (faces joined across edges of two faces) the winding is carried from face to face; the side
///    that holds more area as it was stays, and the rest is turned.
/// 2. A closed patch at even nesting depth is turned to positive volume. Where the depth can't be told it stays. At odd depth it may be a cavity or a part
///    within a part, which no count can tell, so it stays as the majority had it.
/// 3. An open patch is turned when most of the area of its largest faces sees the outside, by crossings of a ray, at
///    its back; a sheet alone stays as it is.
///
/// Precondition: none. Result: every edge of two faces is crossed once in each direction, unless the patch is
/// one-sided like a Möbius band. No vertex moves and no face goes. Leaves: edges of more than two faces as they are,
/// and the conflicts of one-sided patches, which are counted in the changes as `orientation_conflicts_left`.
///
/// # Errors
/// [`Cancelled`] when the work should stop; whole stages that are done stay done.
pub fn orient(surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let areas = doubled_areas(surface);
    let (turn, conflicts) = agree(surface, &edges, &areas, context)?;
    let turned = apply(surface, &turn);
    let edges = if turned > 0 { Edges::new(&surface.faces) } else { edges };
    let patches = Parts::patches(surface, &edges);
    let solids = solids(surface, &edges, &patches);
    let all = vec![true; solids.len()];
    let depths = nesting_depths(surface, &patches, &solids, &all, context)?;
    let mut turn_patch: Vec<bool> =
        solids.iter().zip(&depths).map(|(s, d)| s.closed && s.volume < 0.0 && d.is_some_and(|d| d % 2 == 0)).collect();
    let solids_turned = turn_patch.iter().filter(|&&t| t).count() as u64;
    let open: Vec<bool> = solids.iter().map(|s| !s.closed).collect();
    let mut open_turned = 0u64;
    if open.contains(&true) {
        for (patch, inward) in outside::looks_inward(surface, &patches, &open, &areas, context)?.into_iter().enumerate()
        {
            turn_patch[patch] |= inward;
            open_turned += u64::from(inward);
        }
    }
    let turn: Vec<bool> = patches.of_face.iter().map(|&p| p != Parts::NONE && turn_patch[p as usize]).collect();
    apply(surface, &turn);
    Ok(Change::list([
        ("faces_turned", turned),
        ("closed_parts_turned", solids_turned),
        ("open_parts_turned", open_turned),
        ("orientation_conflicts_left", conflicts),
    ]))
}

/// Which faces to turn so that each patch agrees with the larger area, and the edges where that can't be.
fn agree(
    surface: &Surface,
    edges: &Edges,
    areas: &[f64],
    context: &Context<'_>,
) -> Result<(Vec<bool>, u64), Cancelled> {
    let faces = &surface.faces;
    // For each half-edge the face across and whether the two run the same way, packed as 2 * face + same.
    let mut across = vec![NONE; faces.len() * 3];
    for half_edges in edges.iter() {
        if let &[x, y] = half_edges {
            let same = u32::from(Edges::is_forward(faces, x) == Edges::is_forward(faces, y));
            across[x as usize] = (y / 3) << 1 | same;
            across[y as usize] = (x / 3) << 1 | same;
        }
    }
    let mut turn = vec![false; faces.len()];
    let mut seen = vec![false; faces.len()];
    let mut conflicts = 0u64;
    let mut patch = Vec::new();
    for first in 0..faces.len() {
        if seen[first] {
            continue;
        }
        if first % 4096 == 0 {
            context.check()?;
        }
        seen[first] = true;
        patch.clear();
        patch.push(first);
        let (mut at, mut as_was, mut turned) = (0, 0.0, 0.0);
        while at < patch.len() {
            let f = patch[at];
            at += 1;
            *(if turn[f] { &mut turned } else { &mut as_was }) += areas[f];
            for packed in &across[3 * f..3 * f + 3] {
                if *packed == NONE {
                    continue;
                }
                let (g, same) = ((packed >> 1) as usize, packed & 1 == 1);
                if !seen[g] {
                    seen[g] = true;
                    turn[g] = turn[f] ^ same;
                    patch.push(g);
                } else if turn[g] != (turn[f] ^ same) {
                    conflicts += 1;
                }
            }
        }
        if turned > as_was {
            for &f in &patch {
                turn[f] = !turn[f];
            }
        }
    }
    // Each conflict was met from both sides.
    Ok((turn, conflicts / 2))
}

fn apply(surface: &mut Surface, turn: &[bool]) -> u64 {
    let mut turned = 0;
    for (face, _) in surface.faces.iter_mut().zip(turn).filter(|(_, t)| **t) {
        face.swap(1, 2);
        turned += 1;
    }
    turned
}
