//! Rounds many vertices at once. Most can move to the nearest position without making faces meet, and one search for
//! intersecting faces finds the others much faster than a test of each vertex.

use glam::DVec3;

use super::free_positions::first_at_position;
use crate::math::{ChangedTriangles, area_vanishes, collinear, contact, unit_scale};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Context};

/// The most searches. Each puts back the vertices of faces that meet, which can make them meet faces that moved.
const MAX_SEARCHES: usize = 4;
/// The budget of a search: pairs of boxes compared, a constant plus a number for each face.
const BUDGET: u64 = 10_000_000;
const BUDGET_PER_FACE: u64 = 200;

/// Moves `vertices` to the positions that `nearest` returns, except those where a face then vanishes, where vertices
/// from different positions coincide, or where faces come to meet. Returns these in the given order, at their old
/// positions.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn round_at_once(
    surface: &mut Surface,
    vertices: Vec<u32>,
    nearest: impl Fn(DVec3) -> DVec3,
    context: &Context<'_>,
) -> Result<Vec<u32>, Cancelled> {
    let old = surface.positions.clone();
    let mut is_moved = vec![false; old.len()];
    for &v in &vertices {
        surface.positions[v as usize] = nearest(old[v as usize]);
        is_moved[v as usize] = true;
    }
    let mut last = is_moved.clone();
    for _ in 0..MAX_SEARCHES {
        context.check()?;
        let Some(blocked) = Moved { surface, old: &old, last: &last }.find_blocked(context)? else { break };
        last = (0..old.len()).map(|v| blocked[v] && is_moved[v]).collect();
        if !last.contains(&true) {
            return Ok(vertices.into_iter().filter(|&v| !is_moved[v as usize]).collect());
        }
        for v in (0..old.len()).filter(|&v| last[v]) {
            surface.positions[v] = old[v];
            is_moved[v] = false;
        }
    }
    surface.positions = old;
    Ok(vertices)
}

/// A surface after a step in which some vertices moved.
struct Moved<'a> {
    surface: &'a Surface,
    /// The positions before the first step.
    old: &'a [DVec3],
    /// The vertices that the last step moved.
    last: &'a [bool],
}

impl Moved<'_> {
    /// Marks the vertices of faces that the last step made vanish or meet, and vertices from different positions that now
    /// coincide. `None` where the search exceeds its budget.
    fn find_blocked(&self, context: &Context<'_>) -> Result<Option<Vec<bool>>, Cancelled> {
        let Surface { positions, faces, .. } = self.surface;
        let mut blocked = vec![false; positions.len()];
        // Vertices at one position count as one.
        let slots = first_at_position(positions);
        for (v, slot) in slots.iter().map(|&slot| slot as usize).enumerate() {
            if self.old[slot] != self.old[v] {
                (blocked[slot], blocked[v]) = (true, true);
            }
        }
        let faces_by_slot: Vec<[u32; 3]> = faces.iter().map(|face| face.map(|v| slots[v as usize])).collect();
        let scale = unit_scale(positions);
        let unit: Vec<DVec3> = positions.iter().map(|&p| p * scale).collect();
        let changed: Vec<bool> = faces.iter().map(|face| face.iter().any(|&v| self.last[v as usize])).collect();
        let mut block = |f: u32| faces[f as usize].iter().for_each(|&v| blocked[v as usize] = true);
        let is_flat: Vec<bool> = faces_by_slot
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|v| unit[v as usize]);
                area_vanishes(a, b, c) || collinear(a, b, c)
            })
            .collect();
        (0u32..).zip(changed.iter().zip(&is_flat)).filter(|(_, (c, flat))| **c && **flat).for_each(|(f, _)| block(f));
        context.check()?;
        let look = |f: u32, g: u32, _: &mut u64| {
            let [a, b] = [f, g].map(|f| faces_by_slot[f as usize]);
            let is_exempt = is_flat[f as usize] || is_flat[g as usize] || contact(&unit, a, b, &mut 0).is_apart();
            (!is_exempt).then_some(())
        };
        let budget = BUDGET + BUDGET_PER_FACE * faces.len() as u64;
        let is_complete = ChangedTriangles::new(&unit, &faces_by_slot, &changed).search(look, budget, |hits| {
            hits.into_iter().flat_map(|(pair, ())| pair).for_each(&mut block);
            context.check()
        })?;
        Ok(is_complete.then_some(blocked))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;
    use crate::math::Precision;

    fn rounded(surface: &mut Surface, vertices: Vec<u32>) -> Vec<u32> {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        round_at_once(surface, vertices, |p| Precision::F32.round(p), &context).expect("not cancelled")
    }

    /// A tetrahedron and a triangle `gap` above its top.
    fn tetrahedron_below_triangle(gap: f64) -> Surface {
        let top = 1.0 / 3.0;
        let tetrahedron = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.1, 0.1, top]];
        let triangle = [[-1.0, -1.0, top + gap], [2.0, -1.0, top + gap], [-1.0, 2.0, top + gap]];
        Surface {
            positions: tetrahedron.into_iter().chain(triangle).map(DVec3::from).collect(),
            faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [4, 5, 6]],
            source: (0..5).collect(),
        }
    }

    #[test]
    fn vertices_with_room_around_them_are_rounded_together() {
        let mut surface = tetrahedron_below_triangle(0.1);
        assert!(rounded(&mut surface, (0..7).collect()).is_empty());
        assert!(surface.positions.iter().all(|&p| Precision::F32.round(p) == p));
    }

    #[test]
    fn vertices_whose_faces_would_meet_stay_and_the_others_are_rounded() {
        // In f32 the top of the tetrahedron and the triangle are at one height.
        let before = tetrahedron_below_triangle(1e-12);
        let mut surface = before.clone();
        surface.append(Surface { positions: vec![DVec3::splat(0.7); 3], faces: vec![], source: vec![] });
        surface.positions[8].x = 1.7;
        surface.positions[9].y = 1.7;
        surface.faces.push([7, 8, 9]);
        surface.source.push(5);
        let left = rounded(&mut surface, (0..10).collect());
        assert!(left.contains(&3) && left.contains(&4), "{left:?}");
        assert!(!left.contains(&7), "{left:?}");
        for &v in &left {
            assert_eq!(surface.positions[v as usize], before.positions[v as usize]);
        }
        assert!((7..10).all(|v: usize| Precision::F32.round(surface.positions[v]) == surface.positions[v]));
    }

    #[test]
    fn different_vertices_that_round_to_one_position_stay() {
        let mut surface = tetrahedron_below_triangle(0.1);
        surface.positions.push(surface.positions[3] + DVec3::X * 1e-13);
        surface.faces.push([4, 5, 7]);
        surface.source.push(5);
        let left = rounded(&mut surface, vec![3, 7]);
        assert_eq!(left, [3, 7]);
    }
}
