use glam::DVec3;

use super::Stop;
use super::field::{Field, Hit, LEVEL, ask};
use super::grid::{Grid, Place};
use super::samples::{Samples, along};
use crate::context::Context;

/// Triangles closer together than this share of an edge are one.
const SAME: f64 = 1e-9;

/// Where the surface passes an edge of the grid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// The lower end of the edge.
    pub place: Place,
    pub axis: usize,
    /// Whether the lower end is inside.
    pub inside_below: bool,
    /// Where it passes.
    pub point: DVec3,
    /// The normal of the triangle that is there, turned any way; none where the input is open.
    pub normal: Option<DVec3>,
}

/// Finds where the surface passes the edges that have one end inside: at a triangle, or where the inside ends without one.
///
/// # Errors
/// [`Stop`] where a limit is met.
pub(super) fn crossings(
    field: &Field<'_>,
    grid: &Grid,
    samples: &Samples,
    steps: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Crossing>, Stop> {
    let edges = samples.mixed_edges();
    ask(&edges, steps, context, |&(place, axis), steps| {
        let inside_below = samples.inside(place) == Some(true);
        let ends = [place, along(place, axis)];
        let [outer, inner] = if inside_below { [ends[1], ends[0]] } else { ends };
        let [from, to] = [outer, inner].map(|place| grid.point(place));
        let depths = [outer, inner].map(|place| samples.value(place).map_or(0.0, f64::from));
        let (at, normal) = crossing(field, from, to, depths, samples.is_made(inner), steps);
        let least = grid.clearance() / grid.cell;
        Crossing { place, axis, inside_below, point: from.lerp(to, at.clamp(least, 1.0 - least)), normal }
    })
}

/// Where the way from outside to inside first passes into it, as a share of it, and the normal of the triangle there.
fn crossing(
    field: &Field<'_>,
    from: DVec3,
    to: DVec3,
    depths: [f64; 2],
    made: bool,
    steps: &mut u64,
) -> (f64, Option<DVec3>) {
    let hits = field.hits(from, to, steps);
    let inside = |at: f64, steps: &mut u64| field.depth(from.lerp(to, at), steps) > LEVEL;
    let found = |hit: &Hit| (hit.at, Some(field.normal(hit.face)));
    match hits.as_slice() {
        [] => {}
        // One sheet, perhaps of several faces on one another or where faces meet.
        [first, .., last] if last.at - first.at > SAME => {
            for pair in hits.windows(2) {
                if pair[1].at - pair[0].at > SAME && inside(0.5 * (pair[0].at + pair[1].at), steps) {
                    return found(&pair[0]);
                }
            }
            // Its own end is the first place inside, unless that was put there.
            return if made { found(first) } else { found(last) };
        }
        [first, ..] => return found(first),
    }
    // It changes evenly where no triangle is; what was put inside is as little as possible.
    (if made { 1.0 } else { ((LEVEL - depths[0]) / (depths[1] - depths[0])).clamp(0.0, 1.0) }, None)
}
