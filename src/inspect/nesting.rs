use glam::DVec3;

use super::Solid;
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Crossing, Tree, crossing, ray_direction, to_unit_range};
use crate::mesh::{Parts, Surface};

/// Rays tried from one vertex before another is taken.
const ATTEMPTS: u32 = 8;
/// Faces that all rays together may look at, and as many again for each face, so that thousands of nested shells, of
/// which each ray meets them all, do not take for ever.
const BUDGET: u64 = 5_000_000;
const BUDGET_A_FACE: u64 = 8;

/// How many other closed parts each closed part lies in, as [`nesting`] tells of it.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn nesting_depths(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    wanted: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<u32>>, Cancelled> {
    Ok(depths_of(&nesting(surface, parts, solids, wanted, context)?))
}

/// The count of each part's containers.
pub(super) fn depths_of(containers: &[Option<Vec<u32>>]) -> Vec<Option<u32>> {
    #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
    containers.iter().map(|of_part| of_part.as_ref().map(|of_part| of_part.len() as u32)).collect()
}

/// The other closed parts that each closed part lies in, in order, where `wanted` asks for it; none where it is not asked
/// for, not closed, or can't be told (it touches another part at all tried vertices, or the budget is spent).
///
/// Counts exact crossings of a ray from two extreme vertices of the part with every part whose box holds its box:
/// an odd number means inside. Both vertices must agree, so that parts that merely overlap are not taken for nested.
/// Where no box holds another no ray is cast, and rays end where the boxes do, so that many parts side by side cost
/// n log n.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn nesting(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    wanted: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let mut all: Vec<Option<Vec<u32>>> =
        solids.iter().zip(wanted).map(|(s, &w)| (s.closed && w).then(Vec::new)).collect();
    if solids.iter().filter(|s| s.closed).count() < 2 || all.iter().all(Option::is_none) {
        return Ok(all);
    }
    let mut budget = BUDGET + BUDGET_A_FACE * surface.faces.len() as u64;
    let around = boxes_around(solids, &all, &mut budget, context)?;
    if around.iter().all(|boxes| boxes.as_ref().is_some_and(Vec::is_empty)) {
        return Ok(all);
    }
    let unit = to_unit_range(&surface.positions);
    let extents = extents(surface, parts, solids, &unit);
    let mut holds_any = vec![false; solids.len()];
    for &part in around.iter().flatten().flatten() {
        holds_any[part as usize] = true;
    }
    let walls: Vec<u32> = (0u32..)
        .zip(&parts.of_face)
        .filter(|&(_, &p)| p != Parts::NONE && holds_any[p as usize])
        .map(|(f, _)| f)
        .collect();
    let faces: Vec<[u32; 3]> = walls.iter().map(|&f| surface.faces[f as usize]).collect();
    let tree = Tree::new(&unit, &faces);
    for (part, (of_part, boxes)) in all.iter_mut().zip(around).enumerate() {
        if part % 256 == 0 {
            context.check()?;
        }
        let (true, Some(Extent { ends, .. })) = (of_part.is_some(), extents[part]) else { continue };
        let Some(boxes) = boxes.filter(|_| budget > 0) else {
            *of_part = None;
            continue;
        };
        if boxes.is_empty() {
            continue;
        }
        let mut whole = Box3::EMPTY;
        for it in boxes.iter().filter_map(|&b| extents[b as usize]) {
            whole.extend(it.bounds.min);
            whole.extend(it.bounds.max);
        }
        // From within a box a ray of its diagonal's length ends outside.
        let reach = (whole.diagonal() * 1.001).clamp(f64::MIN_POSITIVE, 8.0);
        let mut containers: Option<Vec<u32>> = None;
        for v in ends {
            let from = unit[v as usize];
            let mut hits = Vec::new();
            let told = (0..ATTEMPTS).any(|attempt| {
                hits.clear();
                let to = from + ray_direction(attempt) * reach;
                let mut clear = true;
                tree.along(from, to, |i| {
                    budget = budget.saturating_sub(1);
                    let other = parts.of_face[walls[i as usize] as usize];
                    if boxes.binary_search(&other).is_ok() {
                        match crossing(from, to, faces[i as usize].map(|v| unit[v as usize])) {
                            Crossing::Miss => {}
                            Crossing::Enters | Crossing::Leaves => hits.push(other),
                            Crossing::Touches => clear = false,
                        }
                    }
                    clear && budget > 0
                });
                clear && budget > 0
            });
            if !told {
                continue;
            }
            hits.sort_unstable();
            let odd: Vec<u32> = hits.chunk_by(|a, b| a == b).filter(|c| c.len() % 2 == 1).map(|c| c[0]).collect();
            containers = Some(match containers {
                None => odd,
                Some(first) => first.into_iter().filter(|p| odd.binary_search(p).is_ok()).collect(),
            });
        }
        *of_part = containers;
    }
    Ok(all)
}

/// For each part that is asked for the other closed parts whose boxes hold its box, in order; none where the budget was
/// spent before.
fn boxes_around(
    solids: &[Solid],
    asked: &[Option<Vec<u32>>],
    budget: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let closed: Vec<u32> = (0u32..).zip(solids).filter(|(_, s)| s.closed).map(|(p, _)| p).collect();
    // A triangle between two opposite corners of a box has the same box.
    let corners: Vec<DVec3> =
        closed.iter().flat_map(|&p| [solids[p as usize].bounds.min, solids[p as usize].bounds.max]).collect();
    let diagonals: Vec<[u32; 3]> = (0u32..).step_by(2).zip(&closed).map(|(i, _)| [i, i + 1, i]).collect();
    let tree = Tree::new(&corners, &diagonals);
    let mut around = vec![Some(Vec::new()); solids.len()];
    for (part, boxes) in around.iter_mut().enumerate().filter(|(part, _)| asked[*part].is_some()) {
        if part % 256 == 0 {
            context.check()?;
        }
        let bounds = &solids[part].bounds;
        let mut found = Vec::new();
        tree.around(bounds.min, 0.0, |i| {
            *budget = budget.saturating_sub(1);
            let other = closed[i as usize];
            if other as usize != part && holds(&solids[other as usize].bounds, bounds) {
                found.push(other);
            }
            *budget > 0
        });
        found.sort_unstable();
        *boxes = (*budget > 0).then_some(found);
    }
    Ok(around)
}

/// Where a part is, on the unit scale.
#[derive(Debug, Clone, Copy)]
struct Extent {
    /// Its lowest and its highest vertex.
    ends: [u32; 2],
    bounds: Box3,
}

/// The extent of each closed part.
fn extents(surface: &Surface, parts: &Parts, solids: &[Solid], unit: &[DVec3]) -> Vec<Option<Extent>> {
    let mut extents: Vec<Option<Extent>> = vec![None; solids.len()];
    for (face, &part) in surface.faces.iter().zip(&parts.of_face) {
        if part == Parts::NONE || !solids[part as usize].closed {
            continue;
        }
        for &v in face {
            let p = unit[v as usize];
            let it = extents[part as usize].get_or_insert(Extent { ends: [v, v], bounds: Box3::EMPTY });
            it.bounds.extend(p);
            if before(p, unit[it.ends[0] as usize]) {
                it.ends[0] = v;
            }
            if before(unit[it.ends[1] as usize], p) {
                it.ends[1] = v;
            }
        }
    }
    extents
}

fn holds(outer: &Box3, inner: &Box3) -> bool {
    outer.contains(inner)
}

fn before(a: DVec3, b: DVec3) -> bool {
    a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Less)
}
