//! The narrow band of cells along the surface, in which samples are taken.

use glam::DVec3;
use rayon::prelude::*;

use super::field::{Field, Stop, ask};
use super::grid::{Grid, Place, SIDE, Samples, along, around_edge, by_block, corner};
use crate::context::Context;
use crate::math::{Box3, winding_exact};

/// Triangles between two looks at the clock.
const TOGETHER: usize = 1 << 14;

/// How far around a block, in cells, triangles count as near.
const NEAR: f64 = 4.0;
/// Places along each axis of a block at which far triangles are asked for.
const NODES: usize = 3;
/// What an exact triangle costs against a box that is looked at.
const EXACT: u64 = 2;

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

/// The samples of a grid around the inside, and what they are taken from.
pub(super) struct Sampling<'a> {
    pub field: &'a Field<'a>,
    pub grid: Grid,
    pub samples: Samples,
    pub limits: Limits,
    pub context: &'a Context<'a>,
}

impl Sampling<'_> {
    /// Makes cells known: asks for their corners, and goes on to the cells around every edge at which the inside ends, until
    /// no such edge leaves what is known. So the surface between is closed, also where the input has a hole.
    ///
    /// # Errors
    /// [`Stop`] where a limit is met.
    pub fn reach(&mut self, mut cells: Vec<Place>) -> Result<(), Stop> {
        while !cells.is_empty() {
            cells.retain(|&cell| self.samples.reach(cell));
            let (mut wanted, mut outermost) = (Vec::new(), Vec::new());
            for &cell in &cells {
                for c in 0..8 {
                    let place = corner(cell, c);
                    if self.samples.value(place).is_none() {
                        // Known from here on, so that it is asked for once; the limit's samples stay so.
                        self.samples.set(place, 0.0);
                        if self.grid.is_limit(place) { &mut outermost } else { &mut wanted }.push(place);
                    }
                }
            }
            self.limits.check(&self.samples)?;
            let blocks = by_block(wanted);
            let depths = ask(&blocks, &mut self.limits.steps, self.context, |places, steps| {
                depths(self.field, &self.grid, places, steps)
            })?;
            for (&place, &depth) in blocks.iter().flatten().zip(depths.iter().flatten()) {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a winding number is asked for being above a half"
                )]
                self.samples.set(place, depth.clamp(-1e6, 1e6) as f32);
            }
            cells.clear();
            for &place in blocks.iter().flatten().chain(&outermost) {
                let inside = self.samples.inside(place);
                for axis in 0..3 {
                    let mut below = place;
                    below[axis] = below[axis].saturating_sub(1);
                    for (low, other) in [(place, along(place, axis)), (below, below)] {
                        if other != place && self.samples.inside(other).is_some_and(|it| Some(it) != inside) {
                            cells.extend(around_edge(low, axis).into_iter().flatten());
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// The cells that triangles meet and some beside them, each once, in a fixed order. `most` is how many cells all triangles
/// together may meet.
///
/// # Errors
/// [`Stop::Budget`] where they meet more.
pub(super) fn cells_met(
    field: &Field<'_>,
    grid: &Grid,
    most: usize,
    context: &Context<'_>,
) -> Result<Vec<Place>, Stop> {
    let mut keys: Vec<u64> = Vec::new();
    let (mut met, mut next) = (0usize, 1 << 23);
    for (some, first) in field.faces().chunks(TOGETHER).zip((0u32..).step_by(TOGETHER)) {
        context.check()?;
        let triangle = |i: usize| {
            #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
            let [a, b, c] = field.corners(first + i as u32);
            [a, b, c].map(|p| DVec3::new(grid.in_cells(0, p.x), grid.in_cells(1, p.y), grid.in_cells(2, p.z)))
        };
        // Estimated first, so that a few triangles across everything take no memory.
        met += (0..some.len()).map(|i| estimate(triangle(i))).fold(0usize, usize::saturating_add);
        if met > most {
            return Err(Stop::Budget);
        }
        let found: Vec<Vec<u64>> = (0..some.len())
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

/// Blocks of eight cells first, so that neighbours in the order are neighbours in the tree.
fn key(cell: Place) -> u64 {
    let [x, y, z] = cell.map(u64::from);
    let high = (z >> 3) << 36 | (y >> 3) << 18 | x >> 3;
    high << 9 | (z & 7) << 6 | (y & 7) << 3 | x & 7
}

#[expect(clippy::cast_possible_truncation, reason = "fields of 18 bits")]
fn cell_of(key: u64) -> Place {
    let (high, low) = (key >> 9, key & 511);
    let part = |shift: u32, within: u32| ((high >> shift & 0x3_ffff) << 3 | low >> within & 7) as u32;
    [part(0, 0), part(18, 3), part(36, 6)]
}

/// About how many cells a triangle meets, in coordinates of cells.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an estimate, and it saturates")]
fn estimate([a, b, c]: [DVec3; 3]) -> usize {
    let area = (b - a).cross(c - a).length() / 2.0;
    let around = a.distance(b) + b.distance(c) + c.distance(a);
    (2.0 * area + 2.0 * around + 1.0) as usize
}

/// Calls `visit` with the cells that a triangle meets, in coordinates of cells: rows along two axes first, then the depth of
/// its plane along the third, in which its normal is longest.
fn triangle_cells([a, b, c]: [DVec3; 3], mut visit: impl FnMut(Place)) {
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
        // Where the triangle's border passes the row.
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

/// The cell that a coordinate is in. The grid reaches beyond the model, so none is below zero.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
fn floor(x: f64) -> u32 {
    x.floor() as u32
}

/// How much each of some samples of one block is inside.
///
/// All triangles but those near the block wind around its places as a harmonic function does that is smooth there, so they are
/// asked for at 27 places of it and interpolated by polynomials of degree 2 along each axis: off by a few hundredths at
/// most, as the sum itself is. Near triangles are summed exactly. Where that would cost more, each sample is asked alone.
fn depths(field: &Field<'_>, grid: &Grid, places: &[Place], steps: &mut u64) -> Vec<f64> {
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
