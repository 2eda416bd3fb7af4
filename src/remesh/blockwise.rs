use glam::DVec3;

use super::field::Field;
use super::grid::{Grid, Place};
use super::samples::SIDE;
use crate::math::{Box3, winding_exact};

/// How far around a block, in cells, triangles count as near.
const NEAR: f64 = 4.0;
/// Places along each axis of a block at which far triangles are asked for.
const NODES: usize = 3;
/// What an exact triangle costs against a box that is looked at.
const EXACT: u64 = 2;

/// How much each of some samples of one block is inside.
///
/// All triangles but those near the block wind around its places as a harmonic function does that is smooth there, so they are
/// asked for at 27 places of it and interpolated by polynomials of degree 2 along each axis: off by a few hundredths at
/// most, as the sum itself is. Near triangles are summed exactly. Where that would cost more, each sample is asked alone.
pub(super) fn depths(field: &Field<'_>, grid: &Grid, places: &[Place], steps: &mut u64) -> Vec<f64> {
    let Some(&first) = places.first() else { return Vec::new() };
    let start = *steps;
    let alone = |place: &Place, steps: &mut u64| field.winding(grid.point(*place), steps);
    let mut found = vec![alone(&first, steps)];
    let each = start - *steps;
    let block = first.map(|c| c / SIDE * SIDE);
    let bounds = Box3 { min: grid.point(block), max: grid.point(block.map(|c| c + SIDE - 1)) };
    let count = places.len() as u64;
    let nodes = (NODES * NODES * NODES) as u64;
    // The most near triangles with which it is worth it.
    let most = (count * each).saturating_sub(nodes * each) / (EXACT * (count + nodes));
    let near = (most > 0).then(|| near(field, grid, &bounds, most, steps)).flatten();
    let Some(near) = near else {
        found.extend(places[1..].iter().map(|place| alone(place, steps)));
        return found.into_iter().map(|w| field.read(w)).collect();
    };
    let exactly = |p: DVec3, steps: &mut u64| {
        *steps = steps.saturating_sub(EXACT * near.len() as u64);
        winding_exact(p, near.iter().copied())
    };
    let mut far = [0.0; NODES * NODES * NODES];
    for (i, value) in far.iter_mut().enumerate() {
        let share = DVec3::new((i % NODES) as f64, (i / NODES % NODES) as f64, (i / (NODES * NODES)) as f64)
            / (NODES - 1) as f64;
        let p = bounds.min + (bounds.max - bounds.min) * share;
        *value = field.winding(p, steps) - exactly(p, steps);
    }
    let all = places.iter().map(|&place| {
        let p = grid.point(place);
        let share = (p - bounds.min) / (bounds.max - bounds.min);
        field.read(interpolated(&far, share) + exactly(p, steps))
    });
    all.collect()
}

/// The triangles near a block, unless they are more than `most`.
fn near(field: &Field<'_>, grid: &Grid, bounds: &Box3, most: u64, steps: &mut u64) -> Option<Vec<[DVec3; 3]>> {
    let around = Box3 { min: bounds.min - NEAR * grid.cell, max: bounds.max + NEAR * grid.cell };
    let mut faces = Vec::new();
    field.tree().overlapping(&around, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        faces.len() as u64 <= most
    });
    // In an order that is not the tree's, though that is fixed as well.
    faces.sort_unstable();
    (faces.len() as u64 <= most).then(|| faces.into_iter().map(|face| field.corners(face)).collect())
}

/// The polynomial of degree 2 along each axis through values at three places along each.
fn interpolated(values: &[f64; NODES * NODES * NODES], share: DVec3) -> f64 {
    // Lagrange's polynomials for 0, 1/2 and 1.
    let weights = |t: f64| [(2.0 * t - 1.0) * (t - 1.0), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)];
    let [x, y, z] = share.to_array().map(weights);
    (0..values.len()).map(|i| values[i] * x[i % NODES] * y[i / NODES % NODES] * z[i / (NODES * NODES)]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_of_degree_two_are_interpolated_exactly() {
        let f = |p: DVec3| 1.0 + p.x * p.y - 2.0 * p.z * p.z * p.x + p.y * p.y;
        let mut values = [0.0; 27];
        for (i, value) in values.iter_mut().enumerate() {
            *value = f(DVec3::new((i % 3) as f64, (i / 3 % 3) as f64, (i / 9) as f64) * 0.5);
        }
        for p in [DVec3::new(0.3, 0.9, 0.1), DVec3::ONE, DVec3::new(0.71, 0.2, 0.5)] {
            assert!((interpolated(&values, p) - f(p)).abs() < 1e-12);
        }
    }
}
