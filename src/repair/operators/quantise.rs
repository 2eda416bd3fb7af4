//! Rounding to f32, as an STL file will.

use glam::DVec3;

use crate::inspect::joined_by_decimals;
use crate::math::to_single;
use crate::mesh::{Surface, weld_exactly};

/// Rounds every position to the nearest f32 and merges what then coincides, so that every operator after it works on
/// the coordinates that an STL file will hold. Answers how many vertices moved.
///
/// Leaves coordinates that do not fit an f32 as they are: the writer refuses them with their index.
pub fn quantise(surface: &mut Surface) -> u64 {
    let mut moved = 0;
    for p in &mut surface.positions {
        let rounded = to_single(*p);
        if rounded != *p {
            *p = rounded;
            moved += 1;
        }
    }
    if moved > 0 {
        weld_exactly(surface);
    }
    moved
}

/// The farthest that a vertex is moved to be joined with another.
const NEAR: f64 = 2e-8;

/// Merges vertices that readers take for one, since they round positions to eight decimals, so that no reader meets edges without
/// length. Each group becomes the vertex of it that the first face uses. Nothing is done where vertices may not move so far. Answers
/// how many vertices went.
pub fn join_near_coincident(surface: &mut Surface, most: f64) -> u64 {
    let Some(joined) = joined_by_decimals(surface).filter(|_| most >= NEAR) else { return 0 };
    let mut first = vec![u32::MAX; joined.positions.len()];
    for (face, new) in surface.faces.iter_mut().zip(&joined.faces) {
        for (v, &new) in face.iter_mut().zip(new) {
            let first = &mut first[new as usize];
            if *first == u32::MAX {
                *first = *v;
            }
            *v = *first;
        }
    }
    surface.drop_unreferenced()
}

/// A position as the result's file will say it: in f32 where `to_f32` says so.
pub(super) fn written(p: DVec3, to_f32: bool) -> DVec3 {
    if to_f32 { to_single(p) } else { p }
}
