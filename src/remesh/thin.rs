use super::Stop;
use super::field::{Field, LEVEL, ask};
use super::grid::{Grid, Place};
use super::samples::{Samples, corner};
use crate::context::Context;

/// How far on each side of a face it is asked what is there, in cells.
const ASIDE: f64 = 1.0 / 64.0;
/// How much a point must be inside on one side of a face: next to an open sheet, which has no inside, it is a half.
const SOLID: f64 = 0.6;
/// Triangles of a cell that are asked.
const MOST: usize = 64;

/// The samples to put inside so that parts thinner than a cell, such as walls and wires, do not vanish: of every cell without
/// a corner inside that a border of the inside passes, the corner nearest to it. `cells` are those that triangles meet.
///
/// Where there is some inside next to a cell, what is in it is a tip of that, and the surface is bent out to it later.
///
/// # Errors
/// [`Stop`] where a limit is met.
pub(super) fn thin_parts(
    field: &Field<'_>,
    grid: &Grid,
    samples: &Samples,
    cells: &[Place],
    steps: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Place>, Stop> {
    let empty = |cell: Place| samples.mask(cell) == 0;
    let alone: Vec<Place> = cells.iter().copied().filter(|&cell| empty(cell) && !near_inside(samples, cell)).collect();
    let found = ask(&alone, steps, context, |&cell, steps| thin(field, grid, cell, steps))?;
    let mut places: Vec<Place> = found.into_iter().flatten().collect();
    places.sort_unstable();
    places.dedup();
    Ok(places)
}

/// Whether a sample is inside within a cell of this cell.
fn near_inside(samples: &Samples, cell: Place) -> bool {
    let low = cell.map(|c| c.saturating_sub(1));
    (0..64u32).any(|i| samples.inside([low[0] + i % 4, low[1] + i / 4 % 4, low[2] + i / 16]) == Some(true))
}

/// The corner of a cell nearest to a border of the inside in it.
fn thin(field: &Field<'_>, grid: &Grid, cell: Place, steps: &mut u64) -> Option<Place> {
    let bounds = grid.bounds(cell);
    let mut faces = Vec::new();
    field.tree().overlapping(&bounds, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        *steps > 0 && faces.len() < 16 * MOST
    });
    faces.sort_unstable();
    faces.truncate(MOST);
    let centre = bounds.centre();
    let slack = grid.cell * 0.1;
    for face in faces {
        let p = field.nearest_on(face, centre);
        if (p - centre).abs().max_element() > grid.cell / 2.0 + slack {
            continue;
        }
        let depths = field.depths(p, field.normal(face) * (ASIDE * grid.cell), steps);
        let [low, high] = if depths[0] < depths[1] { depths } else { [depths[1], depths[0]] };
        if low < LEVEL && high > SOLID {
            let nearest = (0..8).map(|c| corner(cell, c)).filter(|&place| !grid.is_limit(place));
            return nearest.min_by(|&a, &b| {
                grid.point(a).distance_squared(p).total_cmp(&grid.point(b).distance_squared(p)).then(a.cmp(&b))
            });
        }
    }
    None
}
