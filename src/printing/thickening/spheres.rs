//! Fits a contour around balls to their spheres: vertices spread evenly, and lie on the nearest sphere.

use glam::DVec3;
use rayon::prelude::*;
use smallvec::SmallVec;

use crate::math::{Precision, Rounding};
use crate::mesh::Surface;
use crate::remesh::BallGrid;

/// Times that vertices move towards the mean of their neighbours and back onto a sphere.
const ROUNDS: usize = 6;
/// Share of the way to the mean of the neighbours.
const STEP: f64 = 0.5;
/// The largest distance from a sphere at which a vertex moves onto it, in cells.
const REACH: f64 = 0.5;
/// The distance, in cells, that a vertex may move before its balls are searched again.
const KNOWN_WITHIN: f64 = 1.0;

/// The spheres of balls, for a contour around them.
pub struct Spheres<'a> {
    balls: BallGrid<'a>,
    cell: f64,
    rounding: Rounding,
}

/// The balls in which points near a place may lie deepest.
#[derive(Clone, Default)]
struct Nearby {
    /// None if no balls were searched yet.
    place: Option<DVec3>,
    balls: SmallVec<[(DVec3, f64); 2]>,
}

impl<'a> Spheres<'a> {
    /// Prepares the balls, each with its centre and its radius, for a contour with cells of the edge length `cell`.
    pub fn new(balls: &'a [(DVec3, f64)], cell: f64, precision: Precision) -> Self {
        Self { balls: BallGrid::new(balls, cell), cell, rounding: Rounding { scale: 1.0, precision } }
    }

    /// Moves the vertices of a contour. Long thin faces become better shaped; those give wrong normals to a sphere.
    pub fn fit(&self, surface: &mut Surface) {
        let mut nearby = vec![Nearby::default(); surface.positions.len()];
        for _ in 0..ROUNDS {
            let mut sums = vec![(DVec3::ZERO, 0.0); surface.positions.len()];
            for &[a, b, c] in &surface.faces {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    let (sum, count) = &mut sums[from as usize];
                    *sum += surface.positions[to as usize];
                    *count += 1.0;
                }
            }
            surface.positions.par_iter_mut().zip(&sums).zip(&mut nearby).for_each(|((p, &(sum, count)), nearby)| {
                if count > 0.0 {
                    *p = self.rounding.of(self.onto_sphere(p.lerp(sum / count, STEP), nearby));
                }
            });
        }
    }

    /// The point of the sphere in which `p` lies deepest; `p` itself if it is far from that sphere.
    fn onto_sphere(&self, p: DVec3, nearby: &mut Nearby) -> DVec3 {
        if nearby.place.is_none_or(|place| p.distance(place) > KNOWN_WITHIN * self.cell) {
            self.search(p, nearby);
        }
        let deepest = nearby.balls.iter().max_by(|a, b| depth(p, a).total_cmp(&depth(p, b)));
        match deepest {
            Some(ball) if (0.0..REACH * self.cell).contains(&depth(p, ball)) => {
                p + (p - ball.0).normalize_or_zero() * depth(p, ball)
            }
            _ => p,
        }
    }

    /// Finds the balls in which `p`, or a point that is up to [`KNOWN_WITHIN`] from it, may lie deepest. A move changes the depth
    /// in a ball by its length at most.
    fn search(&self, p: DVec3, nearby: &mut Nearby) {
        let deepest = self.balls.around(p).map(|ball| depth(p, &ball)).fold(f64::NEG_INFINITY, f64::max);
        let least = (deepest - 2.0 * KNOWN_WITHIN * self.cell).max(-KNOWN_WITHIN * self.cell);
        nearby.balls.clear();
        nearby.balls.extend(self.balls.around(p).filter(|ball| depth(p, ball) >= least));
        nearby.place = Some(p);
    }
}

/// The depth of a point in a ball; negative outside.
fn depth(p: DVec3, &(centre, radius): &(DVec3, f64)) -> f64 {
    radius - p.distance(centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::context::{Context, NoProgress, monotonic_clock};
    use crate::math::Box3;
    use crate::remesh::BallUnion;
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    const CELL: f64 = 0.2;

    /// The contour of balls, fitted, with the least and the largest depth of its vertices in the balls.
    fn fitted(balls: &[(DVec3, f64)]) -> [f64; 2] {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let precision = Precision::F32;
        let bounds = Box3::of(balls.iter().flat_map(|&(centre, radius)| [centre - radius, centre + radius]));
        let union = BallUnion { balls, bounds, cell: CELL, max_faces: 100_000, max_memory: 1 << 28, precision };
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        let mut surface = union.surface(&context).unwrap();
        Spheres::new(balls, CELL, precision).fit(&mut surface);
        let depth = |p: &DVec3| balls.iter().map(|&(c, r)| r - p.distance(c)).fold(f64::MIN, f64::max);
        let depths = || surface.positions.iter().map(depth);
        [depths().fold(f64::MAX, f64::min), depths().fold(f64::MIN, f64::max)]
    }

    #[test]
    fn the_vertices_of_a_ball_lie_on_its_sphere() {
        let [least, most] = fitted(&[(DVec3::new(1.0, 2.0, 3.0), 1.0)]);
        assert!(least > -1e-6 && most < 1e-6, "{least} to {most}");
    }

    #[test]
    fn a_crease_between_balls_is_filled_and_nothing_is_removed() {
        let [least, most] = fitted(&[(DVec3::ZERO, 1.0), (DVec3::X * 1.4, 1.0)]);
        assert!(least < -0.01, "vertices in the crease stay outside: {least}");
        assert!(most < 1e-6, "no vertex lies inside: {most}");
    }
}
