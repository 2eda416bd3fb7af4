//! The narrow band of cells along the surface, and the samples taken in it.

use glam::DVec3;
use rayon::prelude::*;

use super::field::{Field, Stop, evaluate};
use super::grid::{Grid, GridIndex, SIDE, Samples, along, around_edge, by_block, corner};
use super::region::Region;
use crate::context::Context;
use crate::math::{Box3, winding_exact};

/// Triangles between two checks for cancellation.
const CHECK_INTERVAL: usize = 1 << 14;

/// Distance around a block, in cells, within which triangles count as near.
const NEAR_CELLS: f64 = 4.0;
/// Number of nodes along each axis of a block at which far triangles are evaluated.
const NODES: usize = 3;
/// Cost of an exact triangle relative to a visited box.
const EXACT_COST: u64 = 2;

/// The remaining budget of an attempt.
#[derive(Debug, Clone, Copy)]
pub(super) struct SamplingLimits {
    /// Boxes and triangles that may still be visited.
    pub steps: u64,
    /// Maximum number of sample blocks.
    pub blocks: usize,
}

impl SamplingLimits {
    fn check(&self, samples: &Samples) -> Result<(), Stop> {
        if samples.blocks() > self.blocks { Err(Stop::Budget) } else { Ok(()) }
    }
}

/// The samples of a grid around the inside, with the region, limits and context to take more.
pub(super) struct Sampling<'a, R> {
    /// The region that is sampled.
    pub field: &'a R,
    /// The grid of the samples.
    pub grid: Grid,
    /// The samples taken so far.
    pub samples: Samples,
    /// The remaining budget.
    pub limits: SamplingLimits,
    /// Cancellation and deadline.
    pub context: &'a Context<'a>,
}

impl<R: Region> Sampling<'_, R> {
    /// Samples the corners of cells. Continues with the cells around every edge at which the inside ends, until no such
    /// edge leaves the sampled region. The surface in between is therefore closed, even where the input has a hole.
    ///
    /// # Errors
    /// [`Stop`] if a limit is exceeded or the work is cancelled.
    pub fn sample_around(&mut self, mut cells: Vec<GridIndex>) -> Result<(), Stop> {
        while !cells.is_empty() {
            cells.retain(|&cell| self.samples.mark_seen(cell));
            let (mut missing, mut border) = (Vec::new(), Vec::new());
            for &cell in &cells {
                for c in 0..8 {
                    let index = corner(cell, c);
                    if self.samples.value(index).is_none() {
                        // Marks the sample, so that it is taken only once. Samples of the outermost layer keep this
                        // value.
                        self.samples.set(index, 0.0);
                        if self.grid.is_limit(index) { &mut border } else { &mut missing }.push(index);
                    }
                }
            }
            self.limits.check(&self.samples)?;
            let blocks = by_block(missing);
            let depths = evaluate(&blocks, &mut self.limits.steps, self.context, |indices, steps| {
                self.field.depths_of(&self.grid, indices, steps)
            })?;
            for (&index, &depth) in blocks.iter().flatten().zip(depths.iter().flatten()) {
                #[expect(clippy::cast_possible_truncation, reason = "only compared with the level")]
                self.samples.set(index, depth.clamp(-1e6, 1e6) as f32);
            }
            cells.clear();
            for &index in blocks.iter().flatten().chain(&border) {
                let inside = self.samples.inside(index);
                for axis in 0..3 {
                    let mut below = index;
                    below[axis] = below[axis].saturating_sub(1);
                    for (low, other) in [(index, along(index, axis)), (below, below)] {
                        if other != index && self.samples.inside(other).is_some_and(|other| Some(other) != inside) {
                            cells.extend(around_edge(low, axis).into_iter().flatten());
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// The cells that triangles meet, each once, in a fixed order. `most` limits the estimated number of cells met by all
/// triangles together.
///
/// # Errors
/// [`Stop::Budget`] if the triangles meet more cells, [`Stop::Cancelled`] if the work is cancelled.
pub(super) fn cells_met(
    field: &Field<'_>,
    grid: &Grid,
    most: usize,
    context: &Context<'_>,
) -> Result<Vec<GridIndex>, Stop> {
    let mut keys: Vec<u64> = Vec::new();
    let (mut met, mut next) = (0usize, 1 << 23);
    for (batch, first) in field.faces().chunks(CHECK_INTERVAL).zip((0u32..).step_by(CHECK_INTERVAL)) {
        context.check()?;
        let triangle = |i: usize| {
            #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
            let [a, b, c] = field.corners(first + i as u32);
            [a, b, c].map(|p| DVec3::new(grid.in_cells(0, p.x), grid.in_cells(1, p.y), grid.in_cells(2, p.z)))
        };
        // Estimates first, so that a few triangles across the whole grid take no memory.
        met += (0..batch.len()).map(|i| estimate(triangle(i))).fold(0usize, usize::saturating_add);
        if met > most {
            return Err(Stop::Budget);
        }
        let found: Vec<Vec<u64>> = (0..batch.len())
            .into_par_iter()
            .fold(Vec::new, |mut cells, i| {
                triangle_cells(triangle(i), |cell| cells.push(key(cell)));
                cells
            })
            .collect();
        for cells in found {
            keys.extend(cells);
        }
        if keys.len() > next {
            keys.par_sort_unstable();
            keys.dedup();
            next = next.max(2 * keys.len());
        }
    }
    keys.par_sort_unstable();
    keys.dedup();
    Ok(keys.into_iter().map(cell_of).collect())
}

/// A sort key that groups cells in blocks of 8 by 8 by 8, so that neighbours in the order are neighbours in the tree.
fn key(cell: GridIndex) -> u64 {
    let [x, y, z] = cell.map(u64::from);
    let high = (z >> 3) << 36 | (y >> 3) << 18 | x >> 3;
    high << 9 | (z & 7) << 6 | (y & 7) << 3 | x & 7
}

#[expect(clippy::cast_possible_truncation, reason = "fields of 18 bits")]
fn cell_of(key: u64) -> GridIndex {
    let (high, low) = (key >> 9, key & 511);
    let part = |shift: u32, within: u32| ((high >> shift & 0x3_ffff) << 3 | low >> within & 7) as u32;
    [part(0, 0), part(18, 3), part(36, 6)]
}

/// Estimates how many cells a triangle meets. Coordinates are in cells.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a saturating estimate")]
fn estimate([a, b, c]: [DVec3; 3]) -> usize {
    let area = (b - a).cross(c - a).length() / 2.0;
    let around = a.distance(b) + b.distance(c) + c.distance(a);
    (2.0 * area + 2.0 * around + 1.0) as usize
}

/// Calls `visit` with the cells that a triangle meets; coordinates are in cells. Scans rows along two axes, and
/// computes the depth of the plane along the third axis, in which the normal is longest.
fn triangle_cells([a, b, c]: [DVec3; 3], mut visit: impl FnMut(GridIndex)) {
    let normal = (b - a).cross(c - a);
    let size = normal.abs();
    let depth = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let (u, v) = ((depth + 1) % 3, (depth + 2) % 3);
    let corners = [a, b, c];
    let bounds = |axis: usize| {
        let of = corners.map(|p| p[axis]);
        (of.into_iter().fold(f64::INFINITY, f64::min), of.into_iter().fold(f64::NEG_INFINITY, f64::max))
    };
    let (row_low, row_high) = bounds(v);
    let (deep_low, deep_high) = bounds(depth);
    let slope = |axis: usize| if size[depth] > 0.0 { -normal[axis] / normal[depth] } else { 0.0 };
    let (slope_u, slope_v) = (slope(u), slope(v));
    for row in floor(row_low)..=floor(row_high) {
        let (below, above) = (f64::from(row).max(row_low), f64::from(row + 1).min(row_high));
        // The extent of the triangle within the row.
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..3 {
            let (p, q) = (corners[i], corners[(i + 1) % 3]);
            let mut add = |x: f64| (left, right) = (left.min(x), right.max(x));
            if p[v] >= below && p[v] <= above {
                add(p[u]);
            }
            for level in [below, above] {
                if (p[v] < level) != (q[v] < level) {
                    add(p[u] + (q[u] - p[u]) * ((level - p[v]) / (q[v] - p[v])).clamp(0.0, 1.0));
                }
            }
        }
        if left > right {
            continue;
        }
        for column in floor(left)..=floor(right) {
            let (mut low, mut high) = (deep_low, deep_high);
            if size[depth] > 0.0 {
                let middle = [f64::from(column) + 0.5, f64::from(row) + 0.5];
                let at = a[depth] + slope_u * (middle[0] - a[u]) + slope_v * (middle[1] - a[v]);
                let half = 0.5 * (slope_u.abs() + slope_v.abs());
                (low, high) = (low.max(at - half), high.min(at + half));
            }
            for layer in floor(low)..=floor(high) {
                let mut cell = [0; 3];
                (cell[u], cell[v], cell[depth]) = (column, row, layer);
                visit(cell);
            }
        }
    }
}

/// The cell that contains a coordinate. The grid extends beyond the model, so no index is negative.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
fn floor(x: f64) -> u32 {
    x.floor() as u32
}

/// The depth inside of each of some samples of one block.
///
/// The winding number of all triangles except those near the block is a harmonic function that is smooth in the block.
/// It is evaluated at 27 nodes and interpolated quadratically along each axis. Like the fast sum, the interpolation
/// errs by at most a few hundredths. Near triangles are summed exactly. If this would cost more, each sample is
/// evaluated separately.
pub(super) fn depths(field: &Field<'_>, grid: &Grid, indices: &[GridIndex], steps: &mut u64) -> Vec<f64> {
    let Some(&first) = indices.first() else { return Vec::new() };
    let start = *steps;
    let separately = |index: &GridIndex, steps: &mut u64| field.winding(grid.point(*index), steps);
    let mut found = vec![separately(&first, steps)];
    let each = start - *steps;
    let block = first.map(|c| c / SIDE * SIDE);
    let bounds = Box3 { min: grid.point(block), max: grid.point(block.map(|c| c + SIDE - 1)) };
    let count = indices.len() as u64;
    let nodes = (NODES * NODES * NODES) as u64;
    // The number of near triangles up to which the interpolation pays off.
    let most = (count * each).saturating_sub(nodes * each) / (EXACT_COST * (count + nodes));
    let near_triangles = (most > 0).then(|| near_triangles(field, grid, &bounds, most, steps)).flatten();
    let Some(near_triangles) = near_triangles else {
        found.extend(indices[1..].iter().map(|index| separately(index, steps)));
        return found.into_iter().map(|w| field.depth_of_winding(w)).collect();
    };
    let exact_sum = |p: DVec3, steps: &mut u64| {
        *steps = steps.saturating_sub(EXACT_COST * near_triangles.len() as u64);
        winding_exact(p, near_triangles.iter().copied())
    };
    let mut far = [0.0; NODES * NODES * NODES];
    for (i, value) in far.iter_mut().enumerate() {
        let share = DVec3::new((i % NODES) as f64, (i / NODES % NODES) as f64, (i / (NODES * NODES)) as f64)
            / (NODES - 1) as f64;
        let p = bounds.min + (bounds.max - bounds.min) * share;
        *value = field.winding(p, steps) - exact_sum(p, steps);
    }
    let all = indices.iter().map(|&index| {
        let p = grid.point(index);
        let share = (p - bounds.min) / (bounds.max - bounds.min);
        field.depth_of_winding(interpolated(&far, share) + exact_sum(p, steps))
    });
    all.collect()
}

/// The triangles near a block; none if there are more than `most`.
fn near_triangles(
    field: &Field<'_>,
    grid: &Grid,
    bounds: &Box3,
    most: u64,
    steps: &mut u64,
) -> Option<Vec<[DVec3; 3]>> {
    let around = bounds.grown(NEAR_CELLS * grid.cell);
    let mut faces = Vec::new();
    field.tree().overlapping(&around, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        faces.len() as u64 <= most
    });
    // Sorted, so that the order does not depend on the tree.
    faces.sort_unstable();
    (faces.len() as u64 <= most).then(|| faces.into_iter().map(|face| field.corners(face)).collect())
}

/// Interpolates quadratically along each axis between values at three nodes along each.
fn interpolated(values: &[f64; NODES * NODES * NODES], share: DVec3) -> f64 {
    // Lagrange's polynomials for the nodes 0, 1/2 and 1.
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
