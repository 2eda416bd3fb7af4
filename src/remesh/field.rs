//! The winding number field of the input, and the distances between the input and the result.

use glam::DVec3;
use rayon::prelude::*;

use crate::context::{Cancelled, Context};
use crate::math::{Dipoles, Tree, WindingRule, hit, nearest_on_triangle, r2};

/// Evaluations between two checks for cancellation.
const BATCH: usize = 1 << 12;

/// Depth above which a point is inside. Beside a flat open sheet, which has no inside, the depth is one half.
pub(super) const LEVEL: f64 = 0.505;

/// Number of sample points on each surface.
const SAMPLE_POINTS: u32 = 10_000;
/// Offset from the input, in cells, at which both sides are sampled.
const SIDE_OFFSET: f64 = 1.0 / 256.0;
/// Maximum boxes and triangles visited to measure the deviation.
const STEPS: u64 = 2_000_000_000;

/// Why no new surface could be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RemeshError {
    /// Nothing is inside.
    #[error("the surface has no inside at any cell size tried")]
    Empty,
    /// The limits allow only cells that are too large to resolve the model.
    #[error("the limits on faces, memory and work are too low for a remesh")]
    Limits,
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Why an attempt ended without a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stop {
    /// The attempt exceeded its work or memory.
    Budget,
    /// The attempt would give too many faces: this many, at least.
    Faces(u64),
    /// The work was cancelled.
    Cancelled(Cancelled),
}

impl From<Cancelled> for Stop {
    fn from(canceled: Cancelled) -> Self {
        Self::Cancelled(canceled)
    }
}

/// The winding number field of triangles, with a tree to locate them.
pub(super) struct Field<'a> {
    points: &'a [DVec3],
    faces: &'a [[u32; 3]],
    tree: Tree,
    dipoles: Dipoles,
    winding_rule: WindingRule,
}

/// An intersection of a triangle with a segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// Parameter along the segment, from 0 to 1.
    pub at: f64,
    /// The triangle.
    pub face: u32,
}

impl<'a> Field<'a> {
    /// Builds the field of triangles in scaled coordinates.
    pub fn new(points: &'a [DVec3], faces: &'a [[u32; 3]], winding_rule: WindingRule) -> Self {
        let tree = Tree::new(points, faces);
        let dipoles = tree.dipoles(|f| faces[f as usize].map(|v| points[v as usize]));
        Self { points, faces, tree, dipoles, winding_rule }
    }

    /// The corners of a triangle.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        let [a, b, c] = self.faces[face as usize];
        [self.points[a as usize], self.points[b as usize], self.points[c as usize]]
    }

    /// The unit normal of a triangle; zero if it has no area.
    pub fn normal(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// The tree over the triangles.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// All triangles, as indices of points.
    pub fn faces(&self) -> &[[u32; 3]] {
        self.faces
    }

    /// The depth of a point: above [`LEVEL`] if it is inside.
    pub fn depth(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.depth_of_winding(self.winding(point, steps))
    }

    /// The winding number of a point.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.tree.winding(&self.dipoles, point, steps, |f| self.corners(f))
    }

    /// The depths at `point + offset` and `point - offset`.
    pub fn depths(&self, point: DVec3, offset: DVec3, steps: &mut u64) -> [f64; 2] {
        self.tree.windings(&self.dipoles, [point, offset], steps, |f| self.corners(f)).map(|w| self.depth_of_winding(w))
    }

    /// The depth that belongs to a winding number.
    pub fn depth_of_winding(&self, winding: f64) -> f64 {
        match self.winding_rule {
            WindingRule::Positive => winding,
            WindingRule::Nonzero => winding.abs(),
            // 0 at even numbers, 1 at odd ones.
            WindingRule::Odd => 1.0 - (winding.abs().rem_euclid(2.0) - 1.0).abs(),
        }
    }

    /// The triangles that the segment from `from` to `to` meets, in order.
    pub fn hits(&self, from: DVec3, to: DVec3, steps: &mut u64) -> Vec<Hit> {
        let mut hits = Vec::new();
        self.tree.along(from, to, |face| {
            *steps = steps.saturating_sub(1);
            hits.extend(hit(from, to - from, self.corners(face)).map(|at| Hit { at, face }));
            *steps > 0
        });
        hits.sort_unstable_by(|a, b| a.at.total_cmp(&b.at).then(a.face.cmp(&b.face)));
        hits
    }

    /// The distance from a point to the nearest triangle.
    pub fn distance(&self, point: DVec3, steps: &mut u64) -> Option<f64> {
        self.tree.nearest(point, f64::INFINITY, steps, |f| self.corners(f)).map(|nearest| nearest.distance)
    }

    /// The point of one triangle nearest to `point`.
    pub fn nearest_on(&self, face: u32, point: DVec3) -> DVec3 {
        nearest_on_triangle(point, self.corners(face))
    }
}

/// Evaluates a function for each of `items` in parallel. `budget` is the total number of steps for all of them. It is
/// reduced after each batch of fixed size, so that results do not depend on the number of threads.
///
/// # Errors
/// [`Stop::Budget`] if the budget is spent, [`Stop::Cancelled`] if the work is cancelled.
pub(super) fn evaluate<I: Sync, T: Send>(
    items: &[I],
    budget: &mut u64,
    context: &Context<'_>,
    function: impl Fn(&I, &mut u64) -> T + Sync,
) -> Result<Vec<T>, Stop> {
    let mut answers = Vec::with_capacity(items.len());
    for batch in items.chunks(BATCH) {
        context.check()?;
        let most = *budget;
        let found: Vec<(T, u64)> = batch
            .par_iter()
            .with_min_len(8)
            .map(|item| {
                let mut left = most;
                let answer = function(item, &mut left);
                (answer, most - left)
            })
            .collect();
        for (answer, spent) in found {
            answers.push(answer);
            *budget = budget.saturating_sub(spent);
        }
        if *budget == 0 {
            return Err(Stop::Budget);
        }
    }
    Ok(answers)
}

/// Distances between the result and the input, at points spread evenly by area, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviation {
    /// From the input's surface, where it borders the inside, to the result: what was lost.
    pub lost: Distances,
    /// From the result to the input's surface: what was added, such as patches over holes.
    pub added: Distances,
}

/// Statistics of distances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distances {
    /// Largest distance.
    pub max: f64,
    /// 99th percentile: 99 % of the area is not farther away.
    pub p99: f64,
}

/// Measures the deviation in both directions, in the coordinates of the input and the result.
///
/// # Errors
/// [`Stop`] if the budget is spent or the work is cancelled.
pub(super) fn deviation(
    field: &Field<'_>,
    cell: f64,
    points: &[DVec3],
    faces: &[[u32; 3]],
    context: &Context<'_>,
) -> Result<Deviation, Stop> {
    let mut steps = STEPS;
    let tree = Tree::new(points, faces);
    context.check()?;
    let corners = |face: u32| faces[face as usize].map(|v| points[v as usize]);
    let count = |faces: &[[u32; 3]]| u32::try_from(faces.len()).unwrap_or(u32::MAX);
    let samples = area_samples(count(field.faces()), |face| field.corners(face));
    let lost = evaluate(&samples, &mut steps, context, |&(face, point), steps| {
        let depths = field.depths(point, field.normal(face) * (SIDE_OFFSET * cell), steps);
        let is_border = (depths[0] > LEVEL) != (depths[1] > LEVEL);
        is_border.then(|| tree.nearest(point, f64::INFINITY, steps, corners).map(|nearest| nearest.distance))
    })?;
    let added = evaluate(&area_samples(count(faces), corners), &mut steps, context, |&(_, point), steps| {
        Some(field.distance(point, steps))
    })?;
    Ok(Deviation { lost: Distances::of(lost), added: Distances::of(added) })
}

impl Distances {
    fn of(found: Vec<Option<Option<f64>>>) -> Self {
        let mut sorted: Vec<f64> = found.into_iter().flatten().flatten().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let p99 = sorted.get(sorted.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0);
        Self { max: sorted.last().copied().unwrap_or(0.0), p99 }
    }

    /// The distances multiplied by `scale`.
    pub(super) fn scaled(self, scale: f64) -> Self {
        Self { max: self.max * scale, p99: self.p99 * scale }
    }
}

/// Points spread by area, one in each of equal shares of the area, each with its face.
fn area_samples(count: u32, corners: impl Fn(u32) -> [DVec3; 3]) -> Vec<(u32, DVec3)> {
    let area = |face: u32| {
        let [a, b, c] = corners(face);
        (b - a).cross(c - a).length()
    };
    let total: f64 = (0..count).map(area).sum();
    let (mut points, mut passed, mut number) = (Vec::new(), 0.0, 0);
    for face in 0..count {
        passed += area(face);
        while number < SAMPLE_POINTS && (f64::from(number) + 0.5) / f64::from(SAMPLE_POINTS) * total < passed {
            let [u, v] = r2(f64::from(number));
            let u = u.sqrt();
            let [a, b, c] = corners(face);
            points.push((face, a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)));
            number += 1;
        }
    }
    points
}
