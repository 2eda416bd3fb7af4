//! Balls on a solid that close its narrow gaps, to tell apart which through holes are wide.
//!
//! Balls of nearly half the least gap, around points of the surface in front of which there is a narrow gap, close most narrow
//! gaps and no wide one. What they leave open must stay open when walls grow.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, centre_and_radius, longest_side_first};
use crate::mesh::Surface;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::bodies::{Filler, MAX_BALLS, STEPS, TriangleBudget, cell_of};
use super::outcome::Thickening;
use super::walls::{noise_of, trusted_normal};

/// The radius of a ball, as a share of the least gap: half of what the cells of the surface of many balls leave of it.
const RADIUS: f64 = (1.0 - CELL) / 2.0;
/// The edge length of those cells, as a share of the least gap.
pub const CELL: f64 = 0.2;
/// The radius of a sample of the surface, as a share of the least gap.
const SAMPLE: f64 = 0.15;
/// The narrowest least gap for which samples are few enough, as a share of the least wall.
const MIN_GAP: f64 = 0.1;
/// The most triangles that faces are split into.
const MAX_TRIANGLES: u64 = 1 << 23;
/// Faces between two checks for cancellation.
const BATCH: usize = 1 << 12;

/// Balls that close the narrow gaps of a surface, where it is inside some other balls. None if there are too many.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn balls_over_gaps(
    (surface, tree): (&Surface, &Tree),
    balls: &[Filler],
    settings: &Thickening,
    context: &Context<'_>,
) -> Result<Option<Vec<Filler>>, Cancelled> {
    if settings.min_gap < MIN_GAP * settings.min_wall {
        return Ok(None);
    }
    let boxes: Vec<Box3> = balls.iter().map(|ball| Box3::of([ball.centre]).grown(ball.radius)).collect();
    let samples = Samples {
        surface,
        balls,
        tree_of_balls: Tree::of_boxes(&boxes),
        tree,
        noise: noise_of(&surface.positions),
        least_gap: settings.min_gap,
        budget: TriangleBudget::new(MAX_TRIANGLES, context),
    };
    let radius = RADIUS * settings.min_gap;
    let faces: Vec<u32> = (0u32..).take(surface.faces.len()).collect();
    // Faces that are smaller than a sample would give far more balls than needed.
    let mut filled = FxHashSet::default();
    let mut is_first = |centre: &DVec3| filled.insert(cell_of(*centre, SAMPLE * settings.min_gap));
    let mut over = Vec::new();
    for batch in faces.chunks(BATCH) {
        let found: Vec<Vec<DVec3>> = batch.par_iter().map(|&face| samples.of(face)).collect();
        context.check()?;
        let first = found.into_iter().flatten().filter(&mut is_first);
        over.extend(first.map(|centre| Filler { centre, radius, is_limited: false }));
        if over.len() > MAX_BALLS || samples.budget.is_exceeded() {
            return Ok(None);
        }
    }
    Ok(Some(over))
}

/// The search for samples of a surface near balls.
struct Samples<'a> {
    surface: &'a Surface,
    balls: &'a [Filler],
    /// A tree over the boxes of the balls.
    tree_of_balls: Tree,
    /// A tree over the faces.
    tree: &'a Tree,
    /// Height of a triangle below which rounding decides its normal.
    noise: f64,
    least_gap: f64,
    budget: TriangleBudget<'a>,
}

impl Samples<'_> {
    /// The centres of the samples of a face that meet a ball, and in front of which there is a narrow gap.
    fn of(&self, face: u32) -> Vec<DVec3> {
        let corners = self.surface.corners(face as usize);
        let normal = trusted_normal(corners, self.noise);
        let mut samples = Vec::new();
        let mut open = if normal == DVec3::ZERO { Vec::new() } else { vec![corners] };
        while let Some(corners) = open.pop().filter(|_| !self.budget.should_stop()) {
            let (centre, size) = centre_and_radius(corners);
            let mut is_near = false;
            self.tree_of_balls.overlapping(&Box3::of(corners), |ball| {
                let ball = self.balls[ball as usize];
                is_near = ball.radius > 0.0 && ball.centre.distance(centre) < ball.radius + size;
                !is_near
            });
            if is_near && size <= SAMPLE * self.least_gap {
                samples.extend(Some(centre).filter(|_| self.is_before_gap(centre, normal)));
            } else if is_near {
                let [a, b, c] = longest_side_first(corners);
                let middle = (a + b) / 2.0;
                open.extend([[a, middle, c], [middle, b, c]]);
            }
        }
        samples
    }

    /// Whether a ball of air as wide as the least gap does not fit in front of a point.
    fn is_before_gap(&self, point: DVec3, normal: DVec3) -> bool {
        let corners = |face: u32| self.surface.corners(face as usize);
        let ball = self.tree.shrunk_ball([point, normal], self.least_gap / 2.0, &mut STEPS.clone(), corners);
        ball.is_some_and(|ball| ball.touches.is_some())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use crate::math::Precision;
    use crate::printing::shapes::cuboid;
    use crate::printing::thickening::Growth;

    /// The balls over the gap between two plates, near one ball. The least gap is 0.5.
    fn over(gap: f64) -> Vec<Filler> {
        let mut surface = cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 0.6));
        surface.append(cuboid(DVec3::Z * (0.6 + gap), DVec3::new(10.0, 10.0, 1.2 + gap)));
        let tree = Tree::new(&surface.positions, &surface.faces);
        let settings = Thickening { min_wall: 1.0, growth: Growth::Both, min_gap: 0.5, precision: Precision::F32 };
        let ball = Filler { centre: DVec3::new(5.0, 5.0, 0.6), radius: 1.0, is_limited: false };
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        balls_over_gaps((&surface, &tree), &[ball], &settings, &context).unwrap().unwrap()
    }

    #[test]
    fn balls_fill_a_narrow_gap_near_other_balls() {
        let balls = over(0.3);
        let is_filled = |p: DVec3| balls.iter().any(|ball| ball.centre.distance(p) < ball.radius);
        for (x, y) in (0..15).flat_map(|i| (0..15).map(move |j| (f64::from(i), f64::from(j)))) {
            let p = DVec3::new(4.3 + x * 0.1, 4.3 + y * 0.1, 0.75);
            assert!(is_filled(p) || p.distance(DVec3::new(5.0, 5.0, 0.75)) > 0.9, "{p}");
        }
        assert!(!is_filled(DVec3::new(2.0, 5.0, 0.75)));
    }

    #[test]
    fn a_gap_as_wide_as_the_least_gap_has_no_balls_over_it() {
        assert_eq!(over(0.5), []);
        assert_eq!(over(0.51), []);
    }
}
