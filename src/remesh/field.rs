use glam::DVec3;
use rayon::prelude::*;

use super::{Inside, Stop};
use crate::context::Context;
use crate::math::{Dipoles, Tree, hit, nearest_on_triangle};

/// Questions asked between two looks at the clock.
const TOGETHER: usize = 1 << 12;

/// How much a point must be inside to count so. Next to a flat open sheet, which has no inside, it is a half.
pub(super) const LEVEL: f64 = 0.505;

/// What is inside of triangles, and where they are.
pub(super) struct Field<'a> {
    points: &'a [DVec3],
    faces: &'a [[u32; 3]],
    tree: Tree,
    dipoles: Dipoles,
    inside: Inside,
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
    pub fn new(points: &'a [DVec3], faces: &'a [[u32; 3]], inside: Inside) -> Self {
        let tree = Tree::new(points, faces);
        let dipoles = tree.dipoles(|f| faces[f as usize].map(|v| points[v as usize]));
        Self { points, faces, tree, dipoles, inside }
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
        self.tree.windings(&self.dipoles, point, aside, steps, |f| self.corners(f)).map(|w| self.read(w))
    }

    /// How much a point is inside that the triangles wind around so often.
    pub fn read(&self, winding: f64) -> f64 {
        match self.inside {
            Inside::Outward => winding,
            Inside::EitherWay => winding.abs(),
            // 0 at even numbers and 1 at odd ones.
            Inside::Odd => 1.0 - (winding.abs().rem_euclid(2.0) - 1.0).abs(),
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
