//! Points spread over a mesh, and questions about points that are asked within a budget: what sees the outside, and what is inside.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::Analysis;
use crate::context::{Cancelled, Context};
use crate::math::{Dipoles, hit, r2, ray_direction};

/// Share of a budget that one question may take.
pub(super) const SHARE: u64 = 16;
/// Questions asked at once before anything is known of what they cost, at least, and at most.
const BLOCK: [usize; 3] = [64, 16, 4096];
/// Directions in which a point may see the outside.
const DIRECTIONS: u32 = 32;
/// How far in front of its face a ray starts, as a share of the diagonal.
const LIFT: f64 = 1e-5;
/// Faces that all rays together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 500;

/// What many questions to a tree were answered.
pub(super) struct Answers<T> {
    /// The answer to each question; none to those that were not asked or had too few steps for any.
    pub values: Vec<Option<T>>,
    /// Whether every question was asked and had all the steps that it wanted.
    pub complete: bool,
}

/// Asks questions 0 to `count` in parallel until `budget` steps are spent, so that a mesh made to be slow, such as a fan of
/// needles whose boxes all overlap, costs no more. `question` gets a number of steps to count down.
///
/// The questions are asked in an order of which every beginning is spread evenly over all of them. Blocks and their sizes
/// follow from the steps alone, so the answers are the same for any number of threads.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn ask<T: Send>(
    count: usize,
    budget: u64,
    context: &Context<'_>,
    question: impl Fn(usize, &mut u64) -> Option<T> + Sync,
) -> Result<Answers<T>, Cancelled> {
    let mut answers = Answers { values: (0..count).map(|_| None).collect(), complete: true };
    let (order, most) = (Spread::over(count), (budget / SHARE).max(1));
    let (mut asked, mut spent) = (0, 0u64);
    let mut block = BLOCK[0];
    while asked < count {
        context.check()?;
        if spent >= budget {
            answers.complete = false;
            break;
        }
        let end = count.min(asked + block);
        for (number, answer, left) in ask_each(order.numbers(asked..end), BLOCK[1], most, &question) {
            answers.values[number] = answer;
            answers.complete &= left > 0;
            spent += most - left;
        }
        asked = end;
        let mean = (spent / asked as u64).max(1);
        block = usize::try_from((budget.saturating_sub(spent) / mean / 2).max(1)).unwrap_or(BLOCK[2]);
        block = block.clamp(BLOCK[1], BLOCK[2]);
    }
    Ok(answers)
}

/// Asks questions in parallel, each with so many steps, `task` or more of them on one thread. Answers for each its number, its answer
/// and the steps that it left.
pub(super) fn ask_each<T: Send>(
    numbers: impl IndexedParallelIterator<Item = usize>,
    task: usize,
    steps: u64,
    question: impl Fn(usize, &mut u64) -> Option<T> + Sync,
) -> Vec<(usize, Option<T>, u64)> {
    let ask = |number| {
        let mut left = steps;
        let answer = question(number, &mut left);
        (number, answer, left)
    };
    numbers.with_min_len(task).map(ask).collect()
}

/// An order of the numbers below `count` of which every beginning is spread evenly over all of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spread {
    count: usize,
    stride: usize,
}

impl Spread {
    pub fn over(count: usize) -> Self {
        Self { count, stride: stride(count) }
    }

    /// The numbers at some places of the order.
    pub fn numbers(self, places: Range<usize>) -> impl IndexedParallelIterator<Item = usize> {
        places.into_par_iter().map(move |i| (i as u128 * self.stride as u128 % self.count as u128) as usize)
    }
}

/// A step that leads to every number below `count` once, about a golden section of it.
fn stride(count: usize) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let start = (count as f64 * 0.618_033_988_749_895) as usize;
    (start.max(1)..).find(|&stride| coprime(stride, count)).unwrap_or(1)
}

fn coprime(mut a: usize, mut b: usize) -> bool {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a == 1
}

/// A point on a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// The face of the analysis's surface.
    pub face: u32,
    /// Where it is, in the coordinates of [`Analysis::unit`].
    pub point: DVec3,
    /// The face's unit normal.
    pub normal: DVec3,
}

/// Points spread by area, in order of their faces. None where the mesh has no area. The same for the same mesh.
pub(super) fn samples(analysis: &Analysis<'_>, count: u32) -> Vec<Sample> {
    let faces = (0u32..).take(analysis.surface.faces.len());
    let spread = spread_by_area(analysis, faces, count, |face| analysis.unit_area_vector(face).length());
    let sample = |(face, point)| Sample { face, point, normal: analysis.unit_normal(face) };
    spread.into_iter().map(sample).collect()
}

/// Points on some faces, each with its face: one in each of `count` equal shares of their area, placed in its face by the R2 sequence.
/// `area` may be any multiple of a face's area. None where there is no area.
pub(super) fn spread_by_area(
    analysis: &Analysis<'_>,
    faces: impl Iterator<Item = u32> + Clone,
    count: u32,
    area: impl Fn(u32) -> f64,
) -> Vec<(u32, DVec3)> {
    let total: f64 = faces.clone().map(&area).sum();
    let mut points = Vec::with_capacity(count as usize);
    let (mut passed, mut number) = (0.0, 0);
    for face in faces {
        passed += area(face);
        while number < count && (f64::from(number) + 0.5) / f64::from(count) * total < passed {
            let [u, v] = r2(f64::from(number));
            let (u, [a, b, c]) = (u.sqrt(), analysis.unit_corners(face));
            points.push((face, a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)));
            number += 1;
        }
    }
    points
}

/// Which of the points can be seen from outside, in one of some fixed directions and from either side of their face, so
/// that inner walls, which a union removes, are told from the rest. None for points that the budget did not reach.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn visible(
    analysis: &Analysis<'_>,
    samples: &[Sample],
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let (unit, faces, tree) = (analysis.unit(), &analysis.surface.faces, analysis.tree());
    let diagonal = analysis.extent().diagonal();
    let sees_outside = |sample: &Sample, steps: &mut u64| {
        for number in 0..DIRECTIONS {
            let direction = ray_direction(number);
            let from = sample.point + sample.normal * sample.normal.dot(direction).signum() * (LIFT * diagonal);
            let ray = direction * (2.0 * diagonal);
            let mut free = true;
            tree.along(from, from + ray, |face| {
                *steps = steps.saturating_sub(1);
                free = hit(from, ray, faces[face as usize].map(|v| unit[v as usize])).is_none();
                free && *steps > 0
            });
            if *steps == 0 {
                return None;
            }
            if free {
                return Some(true);
            }
        }
        Some(false)
    };
    let budget = BUDGET + BUDGET_A_POINT * samples.len() as u64;
    Ok(ask(samples.len(), budget, context, |i, steps| sees_outside(&samples[i], steps))?.values)
}

/// Tells what is inside a mesh.
pub(super) struct InsideTest<'a> {
    analysis: &'a Analysis<'a>,
    dipoles: &'a Dipoles,
}

impl<'a> InsideTest<'a> {
    /// Sums the faces, unless that was done for the same mesh before.
    pub fn new(analysis: &'a Analysis<'a>) -> Self {
        Self { analysis, dipoles: analysis.dipoles() }
    }

    /// The size of the winding number at a point in unit coordinates, whichever way the mesh is turned.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.analysis.tree().winding(self.dipoles, point, steps, |f| self.analysis.unit_corners(f)).abs()
    }

    /// The same on both sides of a point.
    pub fn windings(&self, point: DVec3, aside: DVec3, steps: &mut u64) -> [f64; 2] {
        let tree = self.analysis.tree();
        tree.windings(self.dipoles, [point, aside], steps, |f| self.analysis.unit_corners(f)).map(f64::abs)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;

    fn costly(count: usize, budget: u64, cost: u64) -> Answers<usize> {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
        ask(count, budget, &context, |i, steps| {
            *steps = steps.saturating_sub(cost);
            Some(i)
        })
        .unwrap()
    }

    #[test]
    fn every_question_is_asked_once_while_there_are_steps() {
        for count in [0, 1, 2, 7, 1000, 5001] {
            let answers = costly(count, u64::MAX, 3);
            assert!(answers.complete);
            assert!(answers.values.iter().enumerate().all(|(i, &answer)| answer == Some(i)));
        }
    }

    #[test]
    fn a_spent_budget_leaves_answers_that_are_spread_evenly() {
        let answers = costly(10_000, 200_000, 100);
        assert!(!answers.complete);
        for tenth in answers.values.chunks(1000) {
            let asked = tenth.iter().flatten().count();
            assert!((150..350).contains(&asked), "{asked}");
        }
        assert_eq!(answers.values, costly(10_000, 200_000, 100).values);
    }

    #[test]
    fn no_question_takes_more_than_its_share() {
        let answers = costly(1000, 1600, 1_000_000);
        assert!(!answers.complete);
        assert_eq!(answers.values.iter().flatten().count(), BLOCK[0]);
    }
}
