//! The widest ball that fits into a region, found by branch and bound over cubes.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::DVec3;

use super::regions::Regions;
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Crossing, Tree, crossing, ray_direction};
use crate::mesh::Surface;

/// The search ends when no ball can be wider than the best by more than this fraction.
const TOLERANCE: f64 = 0.01;
/// Faces from which balls are grown first.
const SEEDS: usize = 24;
/// Cubes along the longest side of the region's box at most, at the start; fewer where the budget is small.
const START_CUBES: f64 = 16.0;
/// Rays tried to decide whether a point is inside.
const ATTEMPTS: u32 = 8;
/// Steps of one query of the tree.
const STEPS: u64 = 200_000;

/// A ball within a region, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WidestBall {
    /// Centre; inside the region.
    pub centre: DVec3,
    /// Radius: this ball fits.
    pub radius: f64,
    /// No ball of a larger radius fits.
    pub radius_at_most: f64,
}

/// A cube that may hold the centre of a wider ball.
struct Cube {
    centre: DVec3,
    half: f64,
    /// Upper bound of the radius of a ball with its centre in the cube.
    bound: f64,
}

impl PartialEq for Cube {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cube {}

impl PartialOrd for Cube {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cube {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |cube: &Self| cube.centre.to_array();
        self.bound.total_cmp(&other.bound).then_with(|| {
            let (a, b) = (key(self), key(other));
            a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
        })
    }
}

/// The faces of a region, on the unit scale.
pub struct RegionFaces<'a> {
    unit: &'a [DVec3],
    faces: Vec<[u32; 3]>,
    /// For each face whether its normal points into the region.
    inward: Vec<bool>,
    tree: Tree,
    bounds: Box3,
}

impl<'a> RegionFaces<'a> {
    /// Collects the faces of a region other than the outside. `unit` holds the positions on the unit scale.
    #[must_use]
    pub fn new(surface: &Surface, unit: &'a [DVec3], regions: &Regions, region: u32, faces: &[u32]) -> Self {
        let inward = faces.iter().map(|&f| regions.out_of(f, region) < 0.0).collect();
        let faces: Vec<[u32; 3]> = faces.iter().map(|&f| surface.faces[f as usize]).collect();
        let tree = Tree::new(unit, &faces);
        let bounds = Box3::of_faces(unit, &faces);
        Self { unit, faces, inward, tree, bounds }
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.unit[v as usize])
    }

    /// The distance of a point from the region's boundary, on the unit scale.
    #[must_use]
    pub fn distance(&self, point: DVec3) -> f64 {
        self.tree
            .nearest(point, f64::INFINITY, &mut STEPS.clone(), |f| self.corners(f))
            .map_or(0.0, |near| near.distance)
    }

    /// Whether a point on the unit scale lies in the region, exactly; `None` if every ray touches an edge.
    #[must_use]
    pub fn holds(&self, point: DVec3) -> Option<bool> {
        if !self.bounds.holds(point) {
            return Some(false);
        }
        let length = 1.1 * self.bounds.diagonal().max(f64::MIN_POSITIVE);
        (0..ATTEMPTS).find_map(|attempt| {
            let to = point + ray_direction(attempt) * length;
            let (mut clear, mut odd) = (true, false);
            self.tree.along(point, to, |f| {
                match crossing(point, to, self.corners(f)) {
                    Crossing::Miss => {}
                    Crossing::Touches => clear = false,
                    Crossing::Enters | Crossing::Leaves => odd = !odd,
                }
                clear
            });
            clear.then_some(odd)
        })
    }

    /// The widest of a few balls that touch large faces, on the unit scale.
    fn seed(&self) -> Option<(DVec3, f64)> {
        let area = |f: u32| {
            let [a, b, c] = self.corners(f);
            (b - a).cross(c - a).length_squared()
        };
        let mut largest: Vec<u32> = (0u32..).take(self.faces.len()).collect();
        largest.sort_by(|&f, &g| area(g).total_cmp(&area(f)).then(f.cmp(&g)));
        let step = (largest.len() / (2 * SEEDS)).max(1);
        let chosen = largest.iter().take(SEEDS / 2).chain(largest.iter().step_by(step));
        let balls = chosen.take(2 * SEEDS).filter_map(|&f| {
            let [a, b, c] = self.corners(f);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let direction = if self.inward[f as usize] { normal } else { -normal };
            let start = [(a + b + c) / 3.0, direction];
            let ball = self.tree.shrunk_ball(start, self.bounds.diagonal(), &mut STEPS.clone(), |f| self.corners(f))?;
            let centre = start[0] + direction * ball.radius;
            (direction != DVec3::ZERO && self.holds(centre)?).then(|| (centre, self.distance(centre)))
        });
        balls.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Bounds the radius of balls with their centres in a cube, and takes its centre where that is the best so far.
    fn bound(&self, mut cube: Cube, best: &mut (DVec3, f64)) -> Cube {
        let distance = self.distance(cube.centre);
        let is_inside = self.holds(cube.centre);
        if is_inside == Some(true) && distance > best.1 {
            *best = (cube.centre, distance);
        }
        // The distance, negative outside, changes by no more than the way.
        let signed = if is_inside == Some(false) { -distance } else { distance };
        cube.bound = signed + cube.half * 3f64.sqrt();
        cube
    }

    /// The widest ball in the region, within 1 % unless more than `cubes` would have to be split. `None` if no place
    /// inside was found. `scale` is the factor from the model's unit to the unit scale.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn widest_ball(
        &self,
        scale: f64,
        cubes: usize,
        context: &Context<'_>,
    ) -> Result<Option<WidestBall>, Cancelled> {
        let mut best = self.seed().unwrap_or((DVec3::ZERO, 0.0));
        let size = self.bounds.max - self.bounds.min;
        #[expect(clippy::cast_precision_loss, reason = "a budget")]
        let along = (cubes as f64).cbrt().clamp(1.0, START_CUBES);
        let half = (size.min_element() / 2.0).max(size.max_element() / (2.0 * along));
        let mut heap = BinaryHeap::new();
        for (at, centre) in grid(&self.bounds, half).into_iter().enumerate() {
            if at % 64 == 0 {
                context.check()?;
            }
            heap.push(self.bound(Cube { centre, half, bound: 0.0 }, &mut best));
        }
        let mut left = cubes;
        while let Some(cube) = heap.peek() {
            if cube.bound <= best.1 * (1.0 + TOLERANCE) || left == 0 {
                break;
            }
            if left.is_multiple_of(256) {
                context.check()?;
            }
            let Some(cube) = heap.pop() else { break };
            let half = cube.half / 2.0;
            for corner in 0..8u32 {
                let sign = |bit: u32| if corner >> bit & 1 == 1 { half } else { -half };
                let centre = cube.centre + DVec3::new(sign(0), sign(1), sign(2));
                let child = self.bound(Cube { centre, half, bound: 0.0 }, &mut best);
                if child.bound > best.1 {
                    heap.push(child);
                }
            }
            left -= 1;
        }
        let at_most = heap.peek().map_or(best.1, |cube| cube.bound.max(best.1));
        let ball = WidestBall { centre: best.0 / scale, radius: best.1 / scale, radius_at_most: at_most / scale };
        Ok((best.1 > 0.0).then_some(ball))
    }
}

/// The centres of cubes of half side `half` that cover a box.
fn grid(bounds: &Box3, half: f64) -> Vec<DVec3> {
    let counts = ((bounds.max - bounds.min) / (2.0 * half)).to_array().map(|count| count.ceil().clamp(1.0, 64.0));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 1..=64")]
    let [x, y, z] = counts.map(|count| count as u32);
    let mut centres = Vec::new();
    for i in 0..x {
        for j in 0..y {
            for k in 0..z {
                let at = DVec3::new(f64::from(i), f64::from(j), f64::from(k));
                centres.push(bounds.min + (at * 2.0 + 1.0) * half);
            }
        }
    }
    centres
}
