use super::Stop;
use super::blockwise::depths;
use super::field::{Field, ask};
use super::grid::{Grid, Place};
use super::samples::{Samples, along, around_edge, by_block, corner};
use crate::context::Context;

/// Makes cells known: asks for their corners, and goes on to the cells around every edge at which the inside ends, until
/// no such edge leaves what is known. So the surface between is closed, also where the input has a hole.
///
/// # Errors
/// [`Stop`] where a limit is met.
pub(super) fn reach(
    field: &Field<'_>,
    grid: &Grid,
    samples: &mut Samples,
    mut cells: Vec<Place>,
    limits: &mut Limits,
    context: &Context<'_>,
) -> Result<(), Stop> {
    while !cells.is_empty() {
        cells.retain(|&cell| samples.reach(cell));
        let (mut wanted, mut outermost) = (Vec::new(), Vec::new());
        for &cell in &cells {
            for c in 0..8 {
                let place = corner(cell, c);
                if samples.value(place).is_none() {
                    // Known from here on, so that it is asked for once; the limit's samples stay so.
                    samples.set(place, 0.0);
                    if grid.is_limit(place) { &mut outermost } else { &mut wanted }.push(place);
                }
            }
        }
        limits.check(samples)?;
        let blocks = by_block(wanted);
        let depths = ask(&blocks, &mut limits.steps, context, |places, steps| depths(field, grid, places, steps))?;
        for (&place, &depth) in blocks.iter().flatten().zip(depths.iter().flatten()) {
            #[expect(clippy::cast_possible_truncation, reason = "a winding number is asked for being above a half")]
            samples.set(place, depth.clamp(-1e6, 1e6) as f32);
        }
        cells.clear();
        for &place in blocks.iter().flatten().chain(&outermost) {
            let inside = samples.inside(place);
            for axis in 0..3 {
                let mut below = place;
                below[axis] = below[axis].saturating_sub(1);
                for (low, other) in [(place, along(place, axis)), (below, below)] {
                    if other != place && samples.inside(other).is_some_and(|it| Some(it) != inside) {
                        cells.extend(around_edge(low, axis).into_iter().flatten());
                    }
                }
            }
        }
    }
    Ok(())
}

/// What a remesh may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Boxes and triangles that may still be looked at.
    pub steps: u64,
    /// Blocks of samples that may be kept.
    pub blocks: usize,
}

impl Limits {
    fn check(&self, samples: &Samples) -> Result<(), Stop> {
        if samples.blocks() > self.blocks { Err(Stop::Budget) } else { Ok(()) }
    }
}
