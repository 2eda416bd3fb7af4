use glam::DVec3;

use super::Stop;
use super::field::{Field, LEVEL, ask};
use super::grid::{Grid, Place};
use super::samples::{Samples, corner};
use crate::context::Context;

/// How far on each side of a face it is asked what is there, in cells, one after another: parts may be thinner.
const ASIDE: [f64; 3] = [1.0 / 64.0, 1.0 / 1024.0, 1.0 / 16384.0];
/// How much a point must be inside on one side of a face: next to an open sheet, which has no inside, it is a half.
const SOLID: f64 = 0.6;
/// How far from the edges of a face, in cells, or in shares of the way to its middle where that is shorter.
const OFF_EDGE: f64 = 0.1;
/// Triangles of a cell that are asked.
const MOST: usize = 64;

/// The samples to put inside so that parts thinner than a cell, such as walls and wires, do not vanish: of every cell without
/// a corner inside that a border of the inside passes, the corners nearest to it. `cells` are those that triangles meet.
///
/// Where there is some inside next to a cell, what is in it is a tip of that, and the surface is bent out to it later; but
/// `beside_made`, next to samples that were put inside, thin parts are filled up to what they are joined to.
///
/// # Errors
/// [`Stop`] where a limit is met.
pub(super) fn thin_parts(
    field: &Field<'_>,
    grid: &Grid,
    samples: &Samples,
    cells: &[Place],
    beside_made: bool,
    steps: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Place>, Stop> {
    let wanted = |cell: Place| {
        samples.mask(cell) == 0
            && if beside_made { around(cell, 3).any(|p| samples.is_made(p)) } else { !is_tip(samples, cell) }
    };
    let alone: Vec<Place> = cells.iter().copied().filter(|&cell| wanted(cell)).collect();
    let found = ask(&alone, steps, context, |&cell, steps| thin(field, grid, cell, steps))?;
    let mut places: Vec<Place> = found.into_iter().flatten().collect();
    places.sort_unstable();
    places.dedup();
    Ok(places)
}

/// Whether a sample is inside in a cell that has a side in common with this one.
fn is_tip(samples: &Samples, cell: Place) -> bool {
    around(cell, 1).any(|place| samples.inside(place) == Some(true))
}

/// The samples up to one step from a cell's corners, along at most so many axes.
fn around(cell: Place, axes: usize) -> impl Iterator<Item = Place> {
    let low = cell.map(|c| c.saturating_sub(1));
    let steps = (0..64u32).map(|i| [i % 4, i / 4 % 4, i / 16]);
    let near = steps.filter(move |step| step.iter().filter(|s| [0, 3].contains(s)).count() <= axes);
    near.map(move |step| [0, 1, 2].map(|k| low[k] + step[k]))
}

/// The corners of a cell that a border of the inside in it is nearest to: those around which it comes within half a cell along
/// each axis, so that the corners of neighbouring cells are joined.
fn thin(field: &Field<'_>, grid: &Grid, cell: Place, steps: &mut u64) -> Vec<Place> {
    let bounds = grid.bounds(cell);
    let mut faces = Vec::new();
    field.tree().overlapping(&bounds, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        *steps > 0 && faces.len() < 16 * MOST
    });
    faces.sort_unstable();
    faces.truncate(MOST);
    let (centre, half) = (bounds.centre(), grid.cell / 2.0);
    let mut places = Vec::new();
    for face in faces {
        let p = field.nearest_on(face, centre);
        if (p - centre).abs().max_element() > half || !is_border(field, grid, face, p, steps) {
            continue;
        }
        for place in (0..8).map(|c| corner(cell, c)).filter(|&place| !grid.is_limit(place)) {
            let at = grid.point(place);
            if (field.nearest_on(face, at) - at).abs().max_element() <= half {
                places.push(place);
            }
        }
    }
    places
}

/// Whether what is inside ends at a point of a face. What is asked for is a bit off its edges, where other faces may begin.
fn is_border(field: &Field<'_>, grid: &Grid, face: u32, point: DVec3, steps: &mut u64) -> bool {
    let [a, b, c] = field.corners(face);
    let inward = (a + b + c) / 3.0 - point;
    let point = point + inward * (OFF_EDGE * grid.cell / inward.length().max(grid.cell));
    ASIDE.into_iter().any(|aside| {
        let [a, b] = field.depths(point, field.normal(face) * (aside * grid.cell), steps);
        a.min(b) < LEVEL && a.max(b) > SOLID
    })
}
