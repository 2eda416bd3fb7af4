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

/// How many other closed parts each closed part lies in, where `wanted` asks for it; none where it is not asked for,
/// not closed, or can't be told (it touches another part at all tried vertices, or the budget is spent).
///
/// Counts exact crossings of a ray from two extreme vertices of the part with every part whose box holds its box:
/// an odd number means inside. Both vertices must agree, so that parts that merely overlap are not taken for nested.
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
    let mut depths: Vec<Option<u32>> = solids.iter().zip(wanted).map(|(s, &w)| (s.closed && w).then_some(0)).collect();
    if solids.iter().filter(|s| s.closed).count() < 2 || depths.iter().all(Option::is_none) {
        return Ok(depths);
    }
    let unit = to_unit_range(&surface.positions);
    let in_solid: Vec<u32> = (0u32..)
        .zip(&parts.of_face)
        .filter(|&(_, &p)| p != Parts::NONE && solids[p as usize].closed)
        .map(|(f, _)| f)
        .collect();
    let faces: Vec<[u32; 3]> = in_solid.iter().map(|&f| surface.faces[f as usize]).collect();
    let mut extremes: Vec<Option<[u32; 2]>> = vec![None; solids.len()];
    for (&f, face) in in_solid.iter().zip(&faces) {
        let slot = &mut extremes[parts.of_face[f as usize] as usize];
        for &v in face {
            let [low, high] = slot.get_or_insert([v, v]);
            if before(unit[v as usize], unit[*low as usize]) {
                *low = v;
            }
            if before(unit[*high as usize], unit[v as usize]) {
                *high = v;
            }
        }
    }
    let tree = Tree::new(&unit, &faces);
    // `unit` is inside the cube of side 4, so that a ray of this length ends outside.
    let reach = 8.0;
    let budget = BUDGET + BUDGET_A_FACE * faces.len() as u64;
    let mut spent = 0u64;
    for part in 0..solids.len() {
        context.check()?;
        let (Some(_), Some(ends)) = (depths[part], extremes[part]) else { continue };
        if spent >= budget {
            depths[part] = None;
            continue;
        }
        let mut containers: Option<Vec<u32>> = None;
        for v in ends {
            let from = unit[v as usize];
            let mut hits = Vec::new();
            let told = (0..ATTEMPTS).any(|attempt| {
                hits.clear();
                let to = from + ray_direction(attempt) * reach;
                let mut clear = true;
                tree.along(from, to, |i| {
                    spent += 1;
                    let other = parts.of_face[in_solid[i as usize] as usize];
                    if other as usize == part || !holds(&solids[other as usize].bounds, &solids[part].bounds) {
                        return spent < budget;
                    }
                    match crossing(from, to, faces[i as usize].map(|v| unit[v as usize])) {
                        Crossing::Miss => {}
                        Crossing::Enters | Crossing::Leaves => hits.push(other),
                        Crossing::Touches => clear = false,
                    }
                    clear && spent < budget
                });
                clear && spent < budget
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
        #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
        {
            depths[part] = containers.map(|c| c.len() as u32);
        }
    }
    Ok(depths)
}

fn holds(outer: &Box3, inner: &Box3) -> bool {
    outer.contains(inner)
}

fn before(a: DVec3, b: DVec3) -> bool {
    a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Less)
}
