//! Finds where the surface crosses the edges of the grid, and places a vertex in each cell that it passes through.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::band::{Sampling, depths};
use super::field::{Field, Hit, LEVEL, Stop, evaluate};
use super::grid::{Grid, GridIndex, Samples, along, around_edge};
use super::region::{MixedEdge, Region};
use crate::math::{Box3, Rounding};

/// Triangles closer together than this share of an edge count as one.
const MIN_SEPARATION: f64 = 1e-9;

/// Share of the largest eigenvalue below which a quadric does not constrain a direction. At an edge with angle `a`
/// between its normals, the second eigenvalue is `tan(a / 2)^2` of the first if both sides count equally: 0.01 is 11
/// degrees.
const MIN_EIGENVALUE: f64 = 0.01;
/// How far a vertex's optimal position may lie beyond its cell, in cells.
pub(super) const BEYOND: f64 = 0.5;

/// A crossing of the surface with an edge of the grid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// The lower end of the edge.
    pub index: GridIndex,
    /// The axis of the edge.
    pub axis: usize,
    /// Whether the lower end is inside.
    pub inside_below: bool,
    /// The crossing point.
    pub point: DVec3,
    /// The normal of the triangle at the crossing, with arbitrary orientation; none if the input is open there.
    pub normal: Option<DVec3>,
}

impl<R: Region> Sampling<'_, R> {
    /// Finds where the surface crosses the edges with one end inside: at a triangle, or where the inside ends without
    /// one.
    ///
    /// # Errors
    /// [`Stop`] if a limit is exceeded or the work is cancelled.
    pub fn crossings(&mut self) -> Result<Vec<Crossing>, Stop> {
        let (grid, samples) = (&self.grid, &self.samples);
        let edges = samples.mixed_edges();
        evaluate(&edges, &mut self.limits.steps, self.context, |&(index, axis), steps| {
            let inside_below = samples.inside(index) == Some(true);
            let ends = [index, along(index, axis)];
            let [outer, inner] = if inside_below { [ends[1], ends[0]] } else { ends };
            let [from, to] = [outer, inner].map(|index| grid.point(index));
            let depths = [outer, inner].map(|index| samples.value(index).map_or(0.0, f64::from));
            let edge = MixedEdge { from, to, depths, is_forced: samples.is_forced(inner) };
            let (at, normal) = self.field.crossing_of(&edge, steps);
            let least = grid.clearance() / grid.cell;
            Crossing { index, axis, inside_below, point: from.lerp(to, at.clamp(least, 1.0 - least)), normal }
        })
    }
}

impl Region for Field<'_> {
    fn depths_of(&self, grid: &Grid, indices: &[GridIndex], steps: &mut u64) -> Vec<f64> {
        depths(self, grid, indices, steps)
    }

    fn crossing_of(&self, edge: &MixedEdge, steps: &mut u64) -> (f64, Option<DVec3>) {
        crossing(self, edge, steps)
    }
}

/// The parameter at which the edge, from outside to inside, first enters the inside, and the normal of the triangle
/// there.
fn crossing(field: &Field<'_>, edge: &MixedEdge, steps: &mut u64) -> (f64, Option<DVec3>) {
    let &MixedEdge { from, to, depths, is_forced } = edge;
    let hits = field.hits(from, to, steps);
    let inside = |at: f64, steps: &mut u64| field.depth(from.lerp(to, at), steps) > LEVEL;
    let hit_at = |hit: &Hit| (hit.at, Some(field.normal(hit.face)));
    match hits.as_slice() {
        [] => {}
        // One sheet: possibly several coincident faces, or a place where faces meet.
        [first, .., last] if last.at - first.at > MIN_SEPARATION => {
            for pair in hits.windows(2) {
                if pair[1].at - pair[0].at > MIN_SEPARATION && inside(0.5 * (pair[0].at + pair[1].at), steps) {
                    return hit_at(&pair[0]);
                }
            }
            // Only the inner end is inside, unless it was forced.
            return if is_forced { hit_at(first) } else { hit_at(last) };
        }
        [first, ..] => return hit_at(first),
    }
    // Without a triangle the depth is interpolated linearly; a forced sample adds as little inside as possible.
    (if is_forced { 1.0 } else { ((LEVEL - depths[0]) / (depths[1] - depths[0])).clamp(0.0, 1.0) }, None)
}

/// The vertex of a cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Position, within the cell.
    pub point: DVec3,
    /// Optimal position, within [`BEYOND`] of the cell.
    pub optimal: DVec3,
}

/// The sum of squared distances to planes (Garland and Heckbert 1997), and the mean of the points on them.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric {
    /// The upper triangle of the matrix: xx, xy, xz, yy, yz, zz.
    matrix: [f64; 6],
    right: DVec3,
    sum: DVec3,
    count: u32,
}

/// Numbers the cells that the surface passes through, and places a vertex in each. The vertex lies at the intersection
/// of the planes of the triangles on the cell's edges (Ju et al. 2002). It therefore lies on an edge or corner of the
/// input if there is one.
pub(super) fn place_vertices(
    grid: &Grid,
    samples: &mut Samples,
    cells: &[GridIndex],
    crossings: &[Crossing],
    rounding: Rounding,
) -> Vec<Vertex> {
    for (&cell, number) in cells.iter().zip(0u32..) {
        samples.number(cell, number);
    }
    let middle = |cell: GridIndex| grid.bounds(cell).centre();
    let mut quadrics = vec![Quadric::default(); cells.len()];
    for crossing in crossings {
        for cell in around_edge(crossing.index, crossing.axis).into_iter().flatten() {
            if let Some(number) = samples.vertex(cell) {
                quadrics[number as usize].add(crossing.point - middle(cell), crossing.normal);
            }
        }
    }
    let clearance = DVec3::splat(grid.clearance());
    cells
        .par_iter()
        .zip(&quadrics)
        .map(|(&cell, quadric)| {
            let bounds = grid.bounds(cell);
            let reach = Box3 {
                min: bounds.min - BEYOND * grid.cell + clearance,
                max: bounds.max + BEYOND * grid.cell - clearance,
            };
            let centre = middle(cell);
            let optimal = quadric.best(|p| reach.holds(p + centre));
            let optimal = rounding.of((optimal + centre).clamp(reach.min, reach.max));
            let point = rounding.of(optimal.clamp(bounds.min + clearance, bounds.max - clearance));
            Vertex { point, optimal }
        })
        .collect()
}

impl Quadric {
    fn add(&mut self, point: DVec3, normal: Option<DVec3>) {
        self.sum += point;
        self.count += 1;
        if let Some(n) = normal {
            let part = [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z];
            for (total, x) in self.matrix.iter_mut().zip(part) {
                *total += x;
            }
            self.right += n * n.dot(point);
        }
    }

    /// The point nearest to the mean that lies on as many of the constraining planes as possible and satisfies
    /// `is_allowed`.
    fn best(&self, is_allowed: impl Fn(DVec3) -> bool) -> DVec3 {
        let mean = self.sum / f64::from(self.count.max(1));
        let [xx, xy, xz, yy, yz, zz] = self.matrix;
        let matrix = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
        let (values, vectors) = eigen(matrix);
        if values[0] <= 0.0 {
            return mean;
        }
        let rest = self.right - matrix * mean;
        let mut best = mean;
        let mut steps = DVec3::ZERO;
        for (value, vector) in values.into_iter().zip(vectors) {
            if value < MIN_EIGENVALUE * values[0] {
                break;
            }
            steps += vector * (vector.dot(rest) / value);
            if is_allowed(mean + steps) {
                best = mean + steps;
            }
        }
        best
    }
}

/// Eigenvalues in descending order, and eigenvectors, of a symmetric matrix, by Jacobi rotations.
fn eigen(matrix: DMat3) -> ([f64; 3], [DVec3; 3]) {
    let (mut a, mut vectors) = (matrix.to_cols_array_2d(), [DVec3::X, DVec3::Y, DVec3::Z]);
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q].abs() <= f64::MIN_POSITIVE {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            for row in &mut a {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            let (x, y) = (DVec3::from(a[p]), DVec3::from(a[q]));
            (a[p], a[q]) = ((x * c - y * s).to_array(), (x * s + y * c).to_array());
            let (x, y) = (vectors[p], vectors[q]);
            (vectors[p], vectors[q]) = (x * c - y * s, x * s + y * c);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[j][j].total_cmp(&a[i][i]));
    (order.map(|i| a[i][i]), order.map(|i| vectors[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_are_stretched_by_their_eigenvalues() {
        let columns = [DVec3::new(4.0, 1.0, -2.0), DVec3::new(1.0, 3.0, 0.5), DVec3::new(-2.0, 0.5, 7.0)];
        let matrix = DMat3::from_cols(columns[0], columns[1], columns[2]);
        let (values, vectors) = eigen(matrix);
        assert!(values[0] >= values[1] && values[1] >= values[2]);
        for (value, vector) in values.into_iter().zip(vectors) {
            assert!((matrix * vector - vector * value).length() < 1e-12);
        }
    }

    #[test]
    fn the_best_point_lies_on_the_corner_of_three_planes_and_edge_of_two() {
        let mut quadric = Quadric::default();
        quadric.add(DVec3::new(0.3, 0.5, 0.2), Some(DVec3::X));
        quadric.add(DVec3::new(0.1, 0.1, 0.4), Some(DVec3::Y));
        let edge = quadric.best(|_| true);
        assert!((edge - DVec3::new(0.3, 0.1, 0.3)).length() < 1e-12, "{edge}");
        quadric.add(DVec3::new(0.1, 0.6, 0.7), Some(DVec3::Z));
        assert!((quadric.best(|_| true) - DVec3::new(0.3, 0.1, 0.7)).length() < 1e-12);
    }
}
