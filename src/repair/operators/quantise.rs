//! Rounding to f32, as an STL file will.

use crate::math::Precision;
use crate::mesh::{Surface, weld_exactly};

/// Rounds every position to the nearest f32 and merges what then coincides, so that every operator after it works on
/// the coordinates that an STL file will hold. Answers how many vertices moved.
///
/// Leaves coordinates that do not fit an f32 as they are: the writer refuses them with their index.
pub fn quantise(surface: &mut Surface) -> u64 {
    let mut moved = 0;
    for p in &mut surface.positions {
        let rounded = Precision::F32.round(*p);
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
