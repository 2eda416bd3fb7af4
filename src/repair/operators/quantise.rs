//! Rounding to f32, as an STL file will.

use glam::DVec3;

use crate::mesh::{Surface, weld_exactly};

/// Rounds every position to the nearest f32 and merges what then coincides, so that every operator after it works on
/// the coordinates that an STL file will hold. Answers how many vertices moved.
///
/// Leaves positions that do not fit an f32 as they are: the writer refuses them with their index.
pub fn quantise(surface: &mut Surface) -> u64 {
    let mut moved = 0;
    for p in &mut surface.positions {
        let rounded = rounded(*p);
        if rounded.is_finite() && rounded != *p {
            *p = rounded;
            moved += 1;
        }
    }
    if moved > 0 {
        weld_exactly(surface);
    }
    moved
}

/// A position as the result's file will say it: in f32 where `to_f32` says so.
pub(super) fn written(p: DVec3, to_f32: bool) -> DVec3 {
    if to_f32 { rounded(p) } else { p }
}

/// A position as an STL file says it.
#[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
pub(super) fn rounded(p: DVec3) -> DVec3 {
    DVec3::new(f64::from(p.x as f32), f64::from(p.y as f32), f64::from(p.z as f32))
}
