//! A closed surface around a union of balls.

use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::band::{Sampling, SamplingLimits};
use super::contour;
use super::field::{LEVEL, RemeshError, Stop};
use super::grid::{Grid, GridIndex, Samples};
use super::region::{MixedEdge, Region};
use crate::context::Context;
use crate::math::{Box3, Precision, Rounding, unit_scale};
use crate::mesh::{NO_SOURCE, Surface};

/// Maximum distances to centres that are computed.
const STEPS: u64 = 20_000_000_000;
/// Directions in which the boundary is searched from each centre.
const DIRECTIONS: [DVec3; 6] = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];

/// A ball: its centre and its radius.
type Ball = (DVec3, f64);

/// A union of balls, whose boundary [`BallUnion::surface`] builds.
#[derive(Debug, Clone, Copy)]
pub struct BallUnion<'a> {
    /// The balls, each with its centre and its radius, in the model's unit.
    pub balls: &'a [(DVec3, f64)],
    /// A box that contains all balls. It decides where the grid lies: with the same box and cell, the boundary stays the same
    /// where the balls stay.
    pub bounds: Box3,
    /// Edge length of a grid cell, in the model's unit.
    pub cell: f64,
    /// Maximum number of faces of the surface.
    pub max_faces: u64,
    /// Maximum memory of the samples, in bytes.
    pub max_memory: u64,
    /// The precision to which positions are rounded.
    pub precision: Precision,
}

impl BallUnion<'_> {
    /// The boundary of the union: closed, manifold, oriented outward and free of self-intersections. It is off by a share
    /// of a cell. Cavities that no ball's boundary faces are filled.
    ///
    /// # Errors
    /// [`RemeshError::Limits`] if a limit is exceeded, [`RemeshError::Empty`] without balls, and
    /// [`RemeshError::Cancelled`].
    pub fn surface(&self, context: &Context<'_>) -> Result<Surface, RemeshError> {
        let bounds = self.bounds;
        if self.balls.is_empty() || !(self.cell > 0.0 && bounds.diagonal() > 0.0) {
            return Err(RemeshError::Empty);
        }
        let scale = unit_scale(&[bounds.min, bounds.max]);
        let balls: Vec<Ball> = self.balls.iter().map(|&(centre, radius)| (centre * scale, radius * scale)).collect();
        let bounds = Box3 { min: bounds.min * scale, max: bounds.max * scale };
        match self.contour(&Balls::new(&balls, self.cell * scale), &bounds, scale, context) {
            Ok(surface) => Ok(surface),
            Err(Stop::Cancelled(cancelled)) => Err(cancelled.into()),
            Err(Stop::Budget | Stop::Faces(_)) => Err(RemeshError::Limits),
        }
    }

    fn contour(&self, balls: &Balls<'_>, bounds: &Box3, scale: f64, context: &Context<'_>) -> Result<Surface, Stop> {
        let rounding = Rounding { scale, precision: self.precision };
        let grid = Grid::around(bounds, self.cell * scale);
        let directory = grid.size.iter().map(|&n| u64::from(n / super::grid::SIDE + 1)).product::<u64>();
        if directory * 4 > self.max_memory {
            return Err(Stop::Budget);
        }
        let blocks = usize::try_from(self.max_memory / Samples::BLOCK_BYTES).unwrap_or(usize::MAX);
        let samples = Samples::new(&grid);
        let limits = SamplingLimits { steps: STEPS, blocks };
        let seeds = balls.seeds(&grid);
        let mut sampling = Sampling { field: balls, grid, samples, limits, context };
        sampling.sample_around(seeds)?;
        sampling.compose()?;
        let cells = sampling.samples.mixed_cells();
        let (vertices, mut contour) = contour::unmoved_contour(&mut sampling, &cells, self.max_faces, rounding)?;
        contour::move_out(&sampling, &vertices, &mut contour, rounding)?;
        let source = vec![NO_SOURCE; contour.faces.len()];
        let positions = contour.points.into_iter().map(|p| p / scale).collect();
        let mut surface = Surface { positions, faces: contour.faces, source };
        surface.drop_unreferenced();
        Ok(surface)
    }
}

/// Balls, found by the box of a coarse grid that their centres lie in.
pub struct BallGrid<'a> {
    balls: &'a [Ball],
    /// Edge length of a box; a ball reaches at most one box far.
    side: f64,
    boxes: FxHashMap<[i64; 3], Vec<u32>>,
}

impl<'a> BallGrid<'a> {
    /// Sorts balls into boxes that are longer than the largest radius by `margin`. Balls are a centre and a radius.
    #[must_use]
    pub fn new(balls: &'a [(DVec3, f64)], margin: f64) -> Self {
        let side = balls.iter().map(|ball| ball.1).fold(0.0, f64::max) + margin;
        let mut grid = Self { balls, side, boxes: FxHashMap::default() };
        for (ball, number) in balls.iter().zip(0u32..) {
            grid.boxes.entry(grid.box_of(ball.0)).or_default().push(number);
        }
        grid
    }

    /// The balls whose boxes are at most one box from that of a point: all that reach within the margin of the point.
    pub fn around(&self, p: DVec3) -> impl Iterator<Item = Ball> {
        let [x, y, z] = self.box_of(p);
        self.of_boxes((0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]))
    }

    /// The balls whose boxes are at most one box from a box in space.
    fn around_box(&self, bounds: &Box3) -> impl Iterator<Item = Ball> {
        let [low, high] = [self.box_of(bounds.min - self.side), self.box_of(bounds.max + self.side)];
        let range = move |axis: usize| low[axis]..=high[axis];
        self.of_boxes(range(2).flat_map(move |z| range(1).flat_map(move |y| range(0).map(move |x| [x, y, z]))))
    }

    fn of_boxes(&self, keys: impl Iterator<Item = [i64; 3]>) -> impl Iterator<Item = Ball> {
        keys.filter_map(|key| self.boxes.get(&key)).flatten().map(|&number| self.balls[number as usize])
    }

    #[expect(clippy::cast_possible_truncation, reason = "saturates far away from every ball")]
    fn box_of(&self, p: DVec3) -> [i64; 3] {
        (p / self.side).floor().to_array().map(|x| x as i64)
    }
}

/// Balls in scaled coordinates.
struct Balls<'a> {
    grid: BallGrid<'a>,
    /// The edge length of a sampling cell: the unit of depths.
    cell: f64,
}

impl<'a> Balls<'a> {
    fn new(balls: &'a [Ball], cell: f64) -> Self {
        Self { grid: BallGrid::new(balls, 2.0 * cell), cell }
    }

    /// Whether a point lies deeper than a cell inside a ball.
    fn is_deep(&self, p: DVec3) -> bool {
        self.grid.around(p).any(|(centre, radius)| radius - p.distance(centre) >= self.cell)
    }

    /// The balls near a box.
    fn near(&self, bounds: &Box3, steps: &mut u64) -> Vec<Ball> {
        let is_near =
            |&(centre, radius): &Ball| centre.distance(centre.clamp(bounds.min, bounds.max)) < radius + 2.0 * self.cell;
        self.grid.around_box(bounds).inspect(|_| *steps = steps.saturating_sub(1)).filter(is_near).collect()
    }

    /// Cells near the boundary, in some directions from every centre.
    fn seeds(&self, grid: &Grid) -> Vec<GridIndex> {
        let of_ball = |&(centre, radius): &Ball| {
            DIRECTIONS.into_iter().map(move |direction| centre + direction * radius).filter(|&p| !self.is_deep(p))
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the grid")]
        let cell_of = |p: DVec3| [0, 1, 2].map(|axis| grid.in_cells(axis, p[axis]).max(0.0) as u32);
        let mut seeds: Vec<GridIndex> = self.grid.balls.par_iter().flat_map_iter(of_ball).map(cell_of).collect();
        seeds.par_sort_unstable();
        seeds.dedup();
        seeds
    }
}

impl Region for Balls<'_> {
    fn depths_of(&self, grid: &Grid, indices: &[GridIndex], steps: &mut u64) -> Vec<f64> {
        let near = self.near(&Box3::of(indices.iter().map(|&index| grid.point(index))), steps);
        *steps = steps.saturating_sub((near.len() * indices.len()) as u64);
        let depth = |&index: &GridIndex| {
            let p = grid.point(index);
            let depths = near.iter().map(|&(centre, radius)| radius - p.distance(centre));
            LEVEL + depths.fold(-2.0 * self.cell, f64::max) / self.cell
        };
        indices.iter().map(depth).collect()
    }

    fn crossing_of(&self, edge: &MixedEdge, steps: &mut u64) -> (f64, Option<DVec3>) {
        let mut first = (1.0, None);
        if edge.is_forced {
            return first;
        }
        let step = edge.to - edge.from;
        for (centre, radius) in self.grid.around(edge.from.midpoint(edge.to)) {
            *steps = steps.saturating_sub(1);
            // The smaller root of |from + at * step - centre| = radius.
            let offset = edge.from - centre;
            let (a, b, c) = (step.length_squared(), offset.dot(step), offset.length_squared() - radius * radius);
            let root = b * b - a * c;
            let at = (-b - root.max(0.0).sqrt()) / a;
            if root >= 0.0 && (0.0..first.0).contains(&at) {
                first = (at, None);
            }
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use crate::mesh::ClosedSurface;
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    fn bounds(balls: &[Ball]) -> Box3 {
        Box3::of(balls.iter().flat_map(|&(centre, radius)| [centre - radius, centre + radius]))
    }

    fn boundary(balls: &[Ball], cell: f64) -> Result<Surface, RemeshError> {
        boundary_in(bounds(balls), balls, cell)
    }

    fn boundary_in(bounds: Box3, balls: &[Ball], cell: f64) -> Result<Surface, RemeshError> {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let union =
            BallUnion { balls, bounds, cell, max_faces: 100_000, max_memory: 1 << 28, precision: Precision::F32 };
        union.surface(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60)))
    }

    #[test]
    fn the_boundary_of_balls_is_closed_and_near_the_balls() {
        let balls = [(DVec3::new(10.0, 2.0, 3.0), 1.0), (DVec3::new(10.9, 2.0, 3.0), 0.8), (DVec3::splat(5.0), 0.7)];
        let surface = boundary(&balls, 0.1).unwrap();
        assert!(ClosedSurface::try_from(&surface).is_ok());
        for p in &surface.positions {
            let depth = balls.iter().map(|&(centre, radius)| radius - p.distance(centre)).fold(f64::MIN, f64::max);
            assert!(depth.abs() < 0.02, "{depth}");
        }
        let volume: f64 = (0..surface.faces.len())
            .map(|face| surface.corners(face).map(|p| p - balls[0].0))
            .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
            .sum();
        // The balls have 4.189, 2.145 and 1.437, and the first two share 0.926. The surface is inscribed.
        assert!((6.70..6.845).contains(&volume), "two overlapping balls and a ball apart, not {volume}");
    }

    #[test]
    fn a_ring_of_balls_keeps_its_hole() {
        let at = |i: u32| f64::from(i) / 64.0 * std::f64::consts::TAU;
        let balls: Vec<Ball> = (0..64).map(|i| (DVec3::new(at(i).cos(), at(i).sin(), 0.0), 0.3)).collect();
        let surface = boundary(&balls, 0.06).unwrap();
        let edges = surface.faces.len() * 3 / 2;
        assert_eq!(surface.positions.len() + surface.faces.len(), edges, "the Euler characteristic of a torus is 0");
    }

    #[test]
    fn the_boundary_stays_the_same_where_the_balls_stay() {
        let balls = [(DVec3::new(0.1, 0.2, 0.3), 1.0), (DVec3::new(7.0, 0.7, 0.0), 0.9)];
        let corners = |balls| {
            let surface = boundary_in(bounds(&[(DVec3::ZERO, 9.0)]), balls, 0.1).unwrap();
            (0..surface.faces.len()).map(|face| surface.corners(face)).collect::<Vec<_>>()
        };
        let both = corners(&balls);
        let of_first = corners(&balls[..1]);
        assert!(of_first.iter().all(|face| both.contains(face)) && both.len() > of_first.len() + 100);
    }

    #[test]
    fn limits_end_the_contour_before_it_is_built() {
        assert_eq!(boundary(&[(DVec3::ZERO, 1.0)], 0.001), Err(RemeshError::Limits));
        assert_eq!(boundary(&[], 0.1), Err(RemeshError::Empty));
    }
}
