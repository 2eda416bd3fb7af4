use glam::DVec3;
use rayon::prelude::*;

use crate::context::{Cancelled, Context};
use crate::math::{Dipoles, Tree, hit, nearest_on_triangle, r2};

/// Questions asked between two looks at the clock.
const TOGETHER: usize = 1 << 12;

/// How much a point must be inside to count so. Next to a flat open sheet, which has no inside, it is a half.
pub(super) const LEVEL: f64 = 0.505;

/// Points that are measured on either surface.
const POINTS: u32 = 10_000;
/// How far on each side of the input it is asked what is there, in cells.
const ASIDE: f64 = 1.0 / 256.0;
/// Boxes and triangles that may be looked at.
const STEPS: u64 = 2_000_000_000;

/// What of the space is inside, by its winding number `w`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum WindingRule {
    /// `w > 1/2`: what the surface winds around outward.
    #[default]
    Positive,
    /// `|w| > 1/2`: parts that are inside out are solid as well.
    Nonzero,
    /// `|w|` nearer to an odd number than to an even one: what is wound around twice is outside again.
    Odd,
}

/// Why one try ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stop {
    /// Too much work or memory.
    Budget,
    /// Too many faces: so many.
    Faces(u64),
    Cancelled(Cancelled),
}

impl From<Cancelled> for Stop {
    fn from(canceled: Cancelled) -> Self {
        Self::Cancelled(canceled)
    }
}

/// What is inside of triangles, and where they are.
pub(super) struct Field<'a> {
    points: &'a [DVec3],
    faces: &'a [[u32; 3]],
    tree: Tree,
    dipoles: Dipoles,
    winding_rule: WindingRule,
}

/// A triangle on a segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// How far along, from 0 to 1.
    pub at: f64,
    pub face: u32,
}

impl<'a> Field<'a> {
    /// Builds the tree over triangles in unit coordinates.
    pub fn new(points: &'a [DVec3], faces: &'a [[u32; 3]], winding_rule: WindingRule) -> Self {
        let tree = Tree::new(points, faces);
        let dipoles = tree.dipoles(|f| faces[f as usize].map(|v| points[v as usize]));
        Self { points, faces, tree, dipoles, winding_rule }
    }

    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.points[v as usize])
    }

    pub fn normal(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a).normalize_or_zero()
    }

    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    pub fn faces(&self) -> &[[u32; 3]] {
        self.faces
    }

    /// How much a point is inside: more than [`LEVEL`] where it is.
    pub fn depth(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.read(self.winding(point, steps))
    }

    /// How often the triangles wind around a point.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.tree.winding(&self.dipoles, point, steps, |f| self.corners(f))
    }

    /// The same on both sides of a point.
    pub fn depths(&self, point: DVec3, aside: DVec3, steps: &mut u64) -> [f64; 2] {
        self.tree.windings(&self.dipoles, [point, aside], steps, |f| self.corners(f)).map(|w| self.read(w))
    }

    /// How much a point is inside that the triangles wind around so often.
    pub fn read(&self, winding: f64) -> f64 {
        match self.winding_rule {
            WindingRule::Positive => winding,
            WindingRule::Nonzero => winding.abs(),
            // 0 at even numbers and 1 at odd ones.
            WindingRule::Odd => 1.0 - (winding.abs().rem_euclid(2.0) - 1.0).abs(),
        }
    }

    /// The triangles on the segment from `from` to `to`, in order.
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

    /// The triangle nearest to a point.
    pub fn distance(&self, point: DVec3, steps: &mut u64) -> Option<f64> {
        self.tree.nearest(point, f64::INFINITY, steps, |f| self.corners(f)).map(|nearest| nearest.distance)
    }

    /// The nearest point of one triangle.
    pub fn nearest_on(&self, face: u32, point: DVec3) -> DVec3 {
        nearest_on_triangle(point, self.corners(face))
    }
}

/// Asks a question about each of `items` in parallel. `budget` is what all of them together may cost in steps, and is
/// counted down after each round of fixed size, so that the answers do not depend on threads.
///
/// # Errors
/// [`Stop::Budget`] where that is spent, [`Stop::Cancelled`] when the context says stop.
pub(super) fn ask<I: Sync, T: Send>(
    items: &[I],
    budget: &mut u64,
    context: &Context<'_>,
    question: impl Fn(&I, &mut u64) -> T + Sync,
) -> Result<Vec<T>, Stop> {
    let mut answers = Vec::with_capacity(items.len());
    for some in items.chunks(TOGETHER) {
        context.check()?;
        let most = *budget;
        let found: Vec<(T, u64)> = some
            .par_iter()
            .with_min_len(8)
            .map(|item| {
                let mut left = most;
                let answer = question(item, &mut left);
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

/// How far the result is from the input, at points spread evenly by area, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviation {
    /// From the input's surface, where that is a border of the inside, to the result: what was lost.
    pub lost: Distances,
    /// From the result to the input's surface: what was made, such as patches over holes.
    pub made: Distances,
}

/// Distances in figures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distances {
    /// The largest.
    pub max: f64,
    /// Not exceeded by 99 % of the area.
    pub p99: f64,
}

/// Measures both ways, in the coordinates that both are given in.
///
/// # Errors
/// [`Stop`] where a limit is met.
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
    let wanted = spread(count(field.faces()), |face| field.corners(face));
    let lost = ask(&wanted, &mut steps, context, |&(face, point), steps| {
        let depths = field.depths(point, field.normal(face) * (ASIDE * cell), steps);
        let is_border = (depths[0] > LEVEL) != (depths[1] > LEVEL);
        is_border.then(|| tree.nearest(point, f64::INFINITY, steps, corners).map(|nearest| nearest.distance))
    })?;
    let made = ask(&spread(count(faces), corners), &mut steps, context, |&(_, point), steps| {
        Some(field.distance(point, steps))
    })?;
    Ok(Deviation { lost: Distances::of(lost), made: Distances::of(made) })
}

impl Distances {
    fn of(found: Vec<Option<Option<f64>>>) -> Self {
        let mut sorted: Vec<f64> = found.into_iter().flatten().flatten().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let p99 = sorted.get(sorted.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0);
        Self { max: sorted.last().copied().unwrap_or(0.0), p99 }
    }

    /// The same in another unit.
    pub(super) fn scaled(self, scale: f64) -> Self {
        Self { max: self.max * scale, p99: self.p99 * scale }
    }
}

/// Points spread by area, one in each of equal shares of it, each with its face.
fn spread(count: u32, corners: impl Fn(u32) -> [DVec3; 3]) -> Vec<(u32, DVec3)> {
    let area = |face: u32| {
        let [a, b, c] = corners(face);
        (b - a).cross(c - a).length()
    };
    let total: f64 = (0..count).map(area).sum();
    let (mut points, mut passed, mut number) = (Vec::new(), 0.0, 0);
    for face in 0..count {
        passed += area(face);
        while number < POINTS && (f64::from(number) + 0.5) / f64::from(POINTS) * total < passed {
            let [u, v] = r2(f64::from(number));
            let u = u.sqrt();
            let [a, b, c] = corners(face);
            points.push((face, a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)));
            number += 1;
        }
    }
    points
}
