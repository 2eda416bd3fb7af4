//! Where the surface passes the edges of the grid, and the vertex of each cell that it passes.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::band::Sampling;
use super::field::{Field, Hit, LEVEL, Stop, ask};
use super::grid::{Grid, Place, Samples, along, around_edge};
use crate::math::{Box3, Rounding};

/// Triangles closer together than this share of an edge are one.
const SAME: f64 = 1e-9;

/// Share of the largest eigenvalue below which a quadric says nothing along a direction. At an edge of angle `a` between
/// normals the second is `tan(a / 2)^2` of the first where both sides count alike: 0.01 is 11 degrees.
const LEAST: f64 = 0.01;
/// How far beyond its cell a vertex may be wanted, in cells.
pub(super) const BEYOND: f64 = 0.5;

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

/// An edge from a sample outside to one inside.
struct MixedEdge {
    from: DVec3,
    to: DVec3,
    /// How much each end is inside.
    depths: [f64; 2],
    /// Whether the end inside was put there.
    made: bool,
}

impl Sampling<'_> {
    /// Finds where the surface passes the edges that have one end inside: at a triangle, or where the inside ends without one.
    ///
    /// # Errors
    /// [`Stop`] where a limit is met.
    pub fn crossings(&mut self) -> Result<Vec<Crossing>, Stop> {
        let (grid, samples) = (&self.grid, &self.samples);
        let edges = samples.mixed_edges();
        ask(&edges, &mut self.limits.steps, self.context, |&(place, axis), steps| {
            let inside_below = samples.inside(place) == Some(true);
            let ends = [place, along(place, axis)];
            let [outer, inner] = if inside_below { [ends[1], ends[0]] } else { ends };
            let [from, to] = [outer, inner].map(|place| grid.point(place));
            let depths = [outer, inner].map(|place| samples.value(place).map_or(0.0, f64::from));
            let edge = MixedEdge { from, to, depths, made: samples.is_made(inner) };
            let (at, normal) = crossing(self.field, &edge, steps);
            let least = grid.clearance() / grid.cell;
            Crossing { place, axis, inside_below, point: from.lerp(to, at.clamp(least, 1.0 - least)), normal }
        })
    }
}

/// Where the way from outside to inside first passes into it, as a share of it, and the normal of the triangle there.
fn crossing(field: &Field<'_>, edge: &MixedEdge, steps: &mut u64) -> (f64, Option<DVec3>) {
    let &MixedEdge { from, to, depths, made } = edge;
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

/// The vertex of a cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Where it is: within its cell.
    pub point: DVec3,
    /// Where it would be best: within [`BEYOND`] of its cell.
    pub wanted: DVec3,
}

/// The sum of squared distances to planes (Garland and Heckbert 1997), and the mean of the points that gave them.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric {
    /// The upper half of the matrix: xx, xy, xz, yy, yz, zz.
    matrix: [f64; 6],
    right: DVec3,
    sum: DVec3,
    count: u32,
}

/// Numbers the cells that the surface passes, and places a vertex in each: where the planes of the triangles on its edges
/// meet (Ju et al. 2002), so that it stands on an edge or a corner of the input where there is one.
pub(super) fn place(
    grid: &Grid,
    samples: &mut Samples,
    cells: &[Place],
    crossings: &[Crossing],
    rounding: Rounding,
) -> Vec<Vertex> {
    for (&cell, number) in cells.iter().zip(0u32..) {
        samples.number(cell, number);
    }
    let middle = |cell: Place| grid.bounds(cell).centre();
    let mut quadrics = vec![Quadric::default(); cells.len()];
    for crossing in crossings {
        for cell in around_edge(crossing.place, crossing.axis).into_iter().flatten() {
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
            let wanted = quadric.best(|p| reach.holds(p + centre));
            let wanted = rounding.of((wanted + centre).clamp(reach.min, reach.max));
            let point = rounding.of(wanted.clamp(bounds.min + clearance, bounds.max - clearance));
            Vertex { point, wanted }
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

    /// The point nearest to the mean that is on as many of the planes as say something, while it `suits`.
    fn best(&self, suits: impl Fn(DVec3) -> bool) -> DVec3 {
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
            if value < LEAST * values[0] {
                break;
            }
            steps += vector * (vector.dot(rest) / value);
            if suits(mean + steps) {
                best = mean + steps;
            }
        }
        best
    }
}

/// Eigenvalues, the largest first, and eigenvectors of a symmetric matrix, by Jacobi's rotations.
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
    fn the_best_point_of_three_planes_is_their_corner_and_of_two_is_on_their_edge() {
        let mut quadric = Quadric::default();
        quadric.add(DVec3::new(0.3, 0.5, 0.2), Some(DVec3::X));
        quadric.add(DVec3::new(0.1, 0.1, 0.4), Some(DVec3::Y));
        let edge = quadric.best(|_| true);
        assert!((edge - DVec3::new(0.3, 0.1, 0.3)).length() < 1e-12, "{edge}");
        quadric.add(DVec3::new(0.1, 0.6, 0.7), Some(DVec3::Z));
        assert!((quadric.best(|_| true) - DVec3::new(0.3, 0.1, 0.7)).length() < 1e-12);
    }
}
