//! Gaps near balls: which balls bridge a wide gap, and balls that close the narrow gaps, to tell apart which through holes are wide.
//!
//! Balls of nearly half the least gap, around points of the surface in front of which there is a narrow gap, close most narrow
//! gaps and no wide one. What they leave open must stay open when walls grow.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, centre_and_radius, longest_side_first};
use crate::mesh::Surface;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::bodies::{Filler, MAX_BALLS, STEPS, cell_of};
use super::outcome::Thickening;
use super::sampling::TriangleBudget;
use super::walls::{noise_of, trusted_normal};

/// The radius of a ball, as a share of the least gap: half of what the cells of the surface of many balls leave of it.
const RADIUS: f64 = (1.0 - CELL) / 2.0;
/// The edge length of those cells, as a share of the least gap.
pub const CELL: f64 = 0.2;
/// The radius of a sample of the surface, as a share of the least gap.
const SAMPLE: f64 = 0.15;
/// The least cosine of the angle between the normal at one side of a gap and the direction to its other side: 60 degrees.
const OPPOSITE: f64 = 0.5;
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
    let sizes = Sizes { gap: settings.min_gap, sample: SAMPLE * settings.min_gap };
    let samples = Samples::new((surface, tree), balls, sizes, context);
    let radius = RADIUS * settings.min_gap;
    // Faces that are smaller than a sample would give far more balls than needed.
    let mut filled = FxHashSet::default();
    let mut is_first = |centre: &DVec3| filled.insert(cell_of(*centre, SAMPLE * settings.min_gap));
    let mut over = Vec::new();
    for batch in faces_of(surface).chunks(BATCH) {
        let found: Vec<Vec<Sample>> = batch.par_iter().map(|&face| samples.of(face)).collect();
        context.check()?;
        let first = found.into_iter().flatten().map(|sample| sample.point).filter(&mut is_first);
        over.extend(first.map(|centre| Filler { centre, radius, is_limited: false }));
        if over.len() > MAX_BALLS || samples.budget.is_exceeded() {
            return Ok(None);
        }
    }
    Ok(Some(over))
}

/// For each ball whether it covers the middle of a gap of a surface, as far as samples tell, if the gap is as wide as `narrowest`
/// and narrower than `widest`. Only such balls can close a wide hole, or join solids.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn bridging(
    (surface, tree): (&Surface, &Tree),
    balls: &[Filler],
    [narrowest, widest]: [f64; 2],
    context: &Context<'_>,
) -> Result<Vec<bool>, Cancelled> {
    let samples = Samples::new((surface, tree), balls, Sizes { gap: widest, sample: SAMPLE * widest }, context);
    let is_wide = |gap: &Sample| 2.0 * gap.point.distance(gap.middle) >= narrowest && gap.is_between_opposite_sides();
    let mut is_bridging = vec![false; balls.len()];
    for batch in faces_of(surface).chunks(BATCH) {
        let of_face = |&face: &u32| {
            let gaps = samples.of(face).into_iter().filter(is_wide);
            gaps.flat_map(|gap| samples.balls_around(gap.middle)).collect::<Vec<u32>>()
        };
        let found: Vec<Vec<u32>> = batch.par_iter().map(of_face).collect();
        context.check()?;
        found.into_iter().flatten().for_each(|ball| is_bridging[ball as usize] = true);
    }
    Ok(is_bridging)
}

fn faces_of(surface: &Surface) -> Vec<u32> {
    (0u32..).take(surface.faces.len()).collect()
}

/// The sizes of a search for samples.
#[derive(Clone, Copy)]
struct Sizes {
    /// The width from which a gap does not count.
    gap: f64,
    /// The radius of a sample of the surface.
    sample: f64,
}

/// A point of a surface in front of which there is a gap.
struct Sample {
    point: DVec3,
    normal: DVec3,
    /// The middle of the largest ball of air that touches the point.
    middle: DVec3,
    /// Another point that this ball touches.
    opposite: DVec3,
}

impl Sample {
    /// Whether the gap lies between two sides that face each other, rather than in a corner.
    fn is_between_opposite_sides(&self) -> bool {
        (self.opposite - self.middle).normalize_or_zero().dot(self.normal) >= OPPOSITE
    }
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
    sizes: Sizes,
    budget: TriangleBudget<'a>,
}

impl<'a> Samples<'a> {
    fn new(
        (surface, tree): (&'a Surface, &'a Tree),
        balls: &'a [Filler],
        sizes: Sizes,
        context: &'a Context<'a>,
    ) -> Self {
        let boxes: Vec<Box3> = balls.iter().map(|ball| Box3::of([ball.centre]).grown(ball.radius)).collect();
        let (tree_of_balls, noise) = (Tree::of_boxes(&boxes), noise_of(&surface.positions));
        Self { surface, balls, tree_of_balls, tree, noise, sizes, budget: TriangleBudget::new(MAX_TRIANGLES, context) }
    }

    /// The samples of a face that meet a ball, and in front of which there is a narrow gap.
    fn of(&self, face: u32) -> Vec<Sample> {
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
            if is_near && size <= self.sizes.sample {
                samples.extend(self.before_gap(centre, normal));
            } else if is_near {
                let [a, b, c] = longest_side_first(corners);
                let middle = (a + b) / 2.0;
                open.extend([[a, middle, c], [middle, b, c]]);
            }
        }
        samples
    }

    /// The sample at a point, if no ball of air as wide as the gap fits in front of it.
    fn before_gap(&self, point: DVec3, normal: DVec3) -> Option<Sample> {
        let corners = |face: u32| self.surface.corners(face as usize);
        let ball = self.tree.shrunk_ball([point, normal], self.sizes.gap / 2.0, &mut STEPS.clone(), corners)?;
        let opposite = ball.touches?.point;
        Some(Sample { point, normal, middle: point + normal * ball.radius, opposite })
    }

    /// The balls that contain a point.
    fn balls_around(&self, point: DVec3) -> Vec<u32> {
        let mut around = Vec::new();
        self.tree_of_balls.overlapping(&Box3::of([point]), |number| {
            let ball = &self.balls[number as usize];
            around.extend((ball.centre.distance(point) < ball.radius).then_some(number));
            true
        });
        around
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

    /// Two plates of 10 by 10 with the thickness 0.6 and a gap, the lower one on the ground.
    fn plates(gap: f64) -> Surface {
        let mut surface = cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 0.6));
        surface.append(cuboid(DVec3::Z * (0.6 + gap), DVec3::new(10.0, 10.0, 1.2 + gap)));
        surface
    }

    /// The balls over the gap between two plates, near one ball. The least gap is 0.5.
    fn over(gap: f64) -> Vec<Filler> {
        let surface = plates(gap);
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

    #[test]
    fn a_ball_bridges_a_wide_gap_if_it_covers_its_middle() {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        let ball = |z: f64, radius: f64| Filler { centre: DVec3::new(5.0, 5.0, z), radius, is_limited: false };
        // Below the gap, in the lower plate up to its middle, and hardly out of it.
        let balls = [ball(-0.3, 0.5), ball(0.3, 0.9), ball(0.3, 0.4)];
        let bridging = |surface: &Surface, widths: [f64; 2]| {
            let tree = Tree::new(&surface.positions, &surface.faces);
            bridging((surface, &tree), &balls, widths, &context).unwrap()
        };
        assert_eq!(bridging(&plates(0.8), [0.5, 2.0]), [false, true, false]);
        assert_eq!(bridging(&plates(0.8), [0.9, 2.0]), [false; 3], "the gap is narrow");
        assert_eq!(bridging(&plates(0.8), [0.5, 0.7]), [false; 3], "the gap is too wide to be closed");
        // In the corner between two walls there is no gap.
        let corner = cuboid(DVec3::splat(4.0), DVec3::new(6.0, 6.0, 0.0));
        assert_eq!(bridging(&corner, [0.0, 2.0]), [false; 3]);
    }
}
