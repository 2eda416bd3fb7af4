use glam::DVec3;
use rayon::prelude::*;

use super::Stop;
use super::field::Field;
use super::grid::{Grid, Place};
use crate::context::Context;

/// Triangles between two looks at the clock.
const TOGETHER: usize = 1 << 14;

/// The cells that triangles meet and some beside them, each once, in a fixed order. `most` is how many cells all triangles
/// together may meet.
///
/// # Errors
/// [`Stop::Budget`] where they meet more.
pub(super) fn cells(field: &Field<'_>, grid: &Grid, most: usize, context: &Context<'_>) -> Result<Vec<Place>, Stop> {
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
    Ok(keys.into_iter().map(place).collect())
}

/// Blocks of eight cells first, so that neighbours in the order are neighbours in the tree.
fn key(cell: Place) -> u64 {
    let [x, y, z] = cell.map(u64::from);
    let high = (z >> 3) << 36 | (y >> 3) << 18 | x >> 3;
    high << 9 | (z & 7) << 6 | (y & 7) << 3 | x & 7
}

#[expect(clippy::cast_possible_truncation, reason = "fields of 18 bits")]
fn place(key: u64) -> Place {
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
