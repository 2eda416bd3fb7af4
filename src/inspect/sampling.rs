//! Sample points on a mesh, and budgeted parallel queries about points: visibility from outside, and winding numbers.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::Analysis;
use super::analysis::Pair;
use crate::context::{Cancelled, Context};
use crate::math::{Dipoles, hit, r2, ray_direction, threads};

/// Divisor of the budget for a single query: no query may use more than a sixteenth of the budget.
pub(super) const QUERY_BUDGET_DIVISOR: u64 = 16;
/// Number of queries in the first block, and the minimum and maximum for later blocks.
const BLOCK: [usize; 3] = [64, 16, 4096];
/// Number of queries that one thread runs first, to learn how long queries take.
const FIRST: usize = 4;
/// Minimum number of queries per thread.
const MIN_PER_THREAD: usize = 16;
/// Expected number of steps of queries below which one thread runs them: to wake others would take longer.
const SERIAL_STEPS: u64 = 20_000;
/// Number of ray directions in which visibility from outside is tested.
const DIRECTIONS: u32 = 32;
/// Offset of a ray's start from its face, as a fraction of the diagonal.
const LIFT: f64 = 1e-5;
/// Budget of all rays: faces visited, plus an allowance per point.
const BUDGET: u64 = 10_000_000;
const BUDGET_PER_POINT: u64 = 500;

/// Results of a batch of queries.
pub(super) struct Answers<T> {
    /// Result of each query; `None` if the query did not run or ran out of its steps.
    pub values: Vec<Option<T>>,
    /// Whether every query ran to its end.
    pub complete: bool,
}

/// Runs queries 0 to `count` in parallel until `budget` steps are spent. The budget bounds the time on adversarial
/// meshes, such as a fan of needles with overlapping boxes. `query` receives a number of steps to count down.
///
/// Queries run in an order whose every prefix is spread evenly over all of them. Block sizes depend on the steps
/// only, so that the results are the same for any number of threads.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn run_queries<T: Send>(
    count: usize,
    budget: u64,
    context: &Context<'_>,
    query: impl Fn(usize, &mut u64) -> Option<T> + Sync,
) -> Result<Answers<T>, Cancelled> {
    let mut answers = Answers { values: (0..count).map(|_| None).collect(), complete: true };
    let (order, most) = (SpreadOrder::over(count), (budget / QUERY_BUDGET_DIVISOR).max(1));
    let (mut done, mut spent) = (0, 0u64);
    let mut block = BLOCK[0];
    while done < count {
        context.check()?;
        if spent >= budget {
            answers.complete = false;
            break;
        }
        let end = count.min(done + block);
        let first = if done == 0 { FIRST.min(end) } else { end };
        for end in [first, end] {
            if end == done {
                break;
            }
            let is_small = done == 0 || spent / done as u64 * ((end - done) as u64) < SERIAL_STEPS;
            let task = if is_small { end - done } else { MIN_PER_THREAD };
            for (number, answer, left) in run_each(order, done..end, (task, most), &query) {
                answers.values[number] = answer;
                answers.complete &= left > 0;
                spent += most - left;
            }
            done = end;
        }
        let mean = (spent / done as u64).max(1);
        block = usize::try_from((budget.saturating_sub(spent) / mean / 2).max(1)).unwrap_or(BLOCK[2]);
        block = block.clamp(BLOCK[1], BLOCK[2]);
    }
    Ok(answers)
}

/// Number of consecutive queries that share a memory.
const CHUNK: usize = 16;

/// Runs queries as [`run_queries`] does, in chunks of consecutive numbers. `query` also receives what it remembers from the queries of its
/// chunk before. The answers must not depend on the memory, only the number of steps may.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn run_coherent_queries<T: Send, M: Default>(
    count: usize,
    budget: u64,
    context: &Context<'_>,
    query: impl Fn(usize, &mut M, &mut u64) -> Option<T> + Sync,
) -> Result<Answers<T>, Cancelled> {
    let chunks = run_queries(count.div_ceil(CHUNK), budget, context, |chunk, steps| {
        let mut memory = M::default();
        let numbers = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
        let answers = numbers.map(|number| if *steps > 0 { query(number, &mut memory, steps) } else { None });
        Some(answers.collect::<Vec<Option<T>>>())
    })?;
    let mut answers = Answers { values: Vec::with_capacity(count), complete: chunks.complete };
    for (chunk, values) in chunks.values.into_iter().enumerate() {
        let end = count.min((chunk + 1) * CHUNK);
        answers.values.extend(values.into_iter().flatten());
        answers.values.resize_with(end, || None);
    }
    Ok(answers)
}

/// Runs the queries at some positions of an order in parallel, with at least `task` queries per thread, and each with the
/// given number of steps. Returns for each its index, its result and its remaining steps.
pub(super) fn run_each<T: Send>(
    order: SpreadOrder,
    positions: Range<usize>,
    (task, steps): (usize, u64),
    query: impl Fn(usize, &mut u64) -> Option<T> + Sync,
) -> Vec<(usize, Option<T>, u64)> {
    let run = |position| {
        let (number, mut left) = (order.number(position), steps);
        let answer = query(number, &mut left);
        (number, answer, left)
    };
    if positions.len() <= task {
        return positions.map(run).collect();
    }
    positions.into_par_iter().with_min_len(task).map(run).collect()
}

/// A permutation of the numbers below `count` whose every prefix is spread evenly over the range.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpreadOrder {
    count: usize,
    stride: usize,
}

impl SpreadOrder {
    /// The permutation of the numbers below `count`.
    pub fn over(count: usize) -> Self {
        Self { count, stride: stride(count) }
    }

    /// The number at a position of the permutation.
    pub fn number(self, position: usize) -> usize {
        (position as u128 * self.stride as u128 % self.count as u128) as usize
    }
}

/// A stride that is coprime to `count`, close to its golden section.
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

/// A sample point on a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Index of the face in the analysed surface.
    pub face: u32,
    /// Position, in coordinates of [`Analysis::unit`].
    pub point: DVec3,
    /// Unit normal of the face.
    pub normal: DVec3,
}

/// Samples spread evenly by area, in the order of their faces. Deterministic. Empty if the mesh has no area.
pub(super) fn samples(analysis: &Analysis<'_>, count: u32) -> Vec<Sample> {
    let faces = (0u32..).take(analysis.surface.faces.len());
    let area = |face| analysis.unit_area_vector(face).length();
    let spread = spread_by_area(faces, count, area, |face| analysis.unit_corners(face));
    // Samples of a face follow each other, and share its normal.
    let mut last = (u32::MAX, DVec3::ZERO);
    let sample = |(face, point)| {
        if last.0 != face {
            last = (face, analysis.unit_normal(face));
        }
        Sample { face, point, normal: last.1 }
    };
    spread.into_iter().map(sample).collect()
}

/// Points spread evenly by area over some faces, each with its face. The area is divided into `count` equal shares,
/// with one point per share. The R2 sequence (Roberts 2018) places the point within its face. `area` may return any
/// constant multiple of a face's area. Empty if the area is 0.
pub(crate) fn spread_by_area(
    faces: impl Iterator<Item = u32>,
    count: u32,
    area: impl Fn(u32) -> f64 + Sync,
    corners: impl Fn(u32) -> [DVec3; 3],
) -> Vec<(u32, DVec3)> {
    let listed: Vec<u32> = faces.collect();
    let areas = threads::map_cheap(listed.len(), |at| area(listed[at]));
    let total: f64 = areas.iter().sum();
    let mut points = Vec::with_capacity(count as usize);
    let area_before = |number: u32| (f64::from(number) + 0.5) / f64::from(count) * total;
    let (mut passed, mut number, mut next) = (0.0, 0, area_before(0));
    for (&face, area) in listed.iter().zip(areas) {
        passed += area;
        while number < count && next < passed {
            let [u, v] = r2(f64::from(number));
            let (u, [a, b, c]) = (u.sqrt(), corners(face));
            points.push((face, a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)));
            number += 1;
            next = area_before(number);
        }
    }
    points
}

/// The patches of a result that close openings of the mesh that is sampled.
pub(super) struct Patches<'a> {
    /// The sampled mesh, and the result.
    pub meshes: Pair<'a>,
    /// For each face of the result's soup, whether it is a patch.
    pub is_patch: &'a [bool],
}

impl Patches<'_> {
    /// Whether a ray in unit coordinates of the sampled mesh meets no patch.
    fn let_pass(&self, from: DVec3, ray: DVec3, steps: &mut u64) -> bool {
        let (result, ratio) = (self.meshes.to, self.meshes.ratio);
        let (from, ray) = (from * ratio, ray * ratio);
        let mut free = true;
        result.tree().along(from, from + ray, |face| {
            *steps = steps.saturating_sub(1);
            let is_patch = self.is_patch.get(result.surface.source[face as usize] as usize) == Some(&true);
            free = !is_patch || hit(from, ray, result.unit_corners(face)).is_none();
            free && *steps > 0
        });
        free
    }
}

/// Whether each point is visible from outside along one of several fixed directions, from either side of its face.
/// Distinguishes outer surface from internal faces, which a union removes. `None` for points beyond the budget.
///
/// With `patches` of another mesh, a point behind a patch is not visible, although the opening it closes is in this mesh.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn visible(
    analysis: &Analysis<'_>,
    samples: &[Sample],
    patches: Option<&Patches<'_>>,
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let tree = analysis.tree();
    // Computed here, before several threads need it.
    if let Some(patches) = patches {
        patches.meshes.to.tree();
    }
    let diagonal = analysis.extent().diagonal();
    let directions: Vec<(usize, DVec3)> = (0..DIRECTIONS).map(ray_direction).enumerate().collect();
    // Remembers for each direction the last face that blocked a ray: it mostly blocks the rays from neighbouring samples too.
    let sees_outside = |sample: &Sample, blockers: &mut [Option<u32>; DIRECTIONS as usize], steps: &mut u64| {
        // Most rays on the outer side of a face are free, so they come first.
        let of_side = |is_front: bool| {
            directions.iter().filter(move |(_, direction)| (sample.normal.dot(*direction) > 0.0) == is_front)
        };
        for &(number, direction) in of_side(true).chain(of_side(false)) {
            let from = sample.point + sample.normal * sample.normal.dot(direction).signum() * (LIFT * diagonal);
            let ray = direction * (2.0 * diagonal);
            let blocks = |face: u32| hit(from, ray, analysis.unit_corners(face)).is_some();
            let mut blocker = blockers[number].filter(|&face| blocks(face));
            *steps = steps.saturating_sub(u64::from(blocker.is_some()));
            if blocker.is_none() {
                tree.along(from, from + ray, |face| {
                    *steps = steps.saturating_sub(1);
                    blocker = Some(face).filter(|&face| blocks(face));
                    blocker.is_none() && *steps > 0
                });
            }
            let is_free = blocker.is_none() && patches.is_none_or(|patches| patches.let_pass(from, ray, steps));
            if *steps == 0 {
                return None;
            }
            if is_free {
                return Some(true);
            }
            blockers[number] = blocker;
        }
        Some(false)
    };
    let budget = BUDGET + BUDGET_PER_POINT * samples.len() as u64;
    let answers = run_coherent_queries(samples.len(), budget, context, |i, blockers, steps| {
        sees_outside(&samples[i], blockers, steps)
    })?;
    Ok(answers.values)
}

/// Winding number queries on one mesh.
pub(super) struct InsideTest<'a> {
    analysis: &'a Analysis<'a>,
    dipoles: &'a Dipoles,
}

impl<'a> InsideTest<'a> {
    /// Prepares the queries. Reuses the mesh's cached dipoles.
    pub fn new(analysis: &'a Analysis<'a>) -> Self {
        Self { analysis, dipoles: analysis.dipoles() }
    }

    /// Absolute value of the winding number at a point in unit coordinates, independent of the mesh's orientation.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.analysis.tree().winding(self.dipoles, point, steps, |f| self.analysis.unit_corners(f)).abs()
    }

    /// Absolute winding numbers at `point + aside` and `point - aside`.
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
        run_queries(count, budget, &context, |i, steps| {
            *steps = steps.saturating_sub(cost);
            Some(i)
        })
        .unwrap()
    }

    #[test]
    fn every_query_runs_once_within_the_budget() {
        for count in [0, 1, 2, 7, 1000, 5001] {
            let answers = costly(count, u64::MAX, 3);
            assert!(answers.complete);
            assert!(answers.values.iter().enumerate().all(|(i, &answer)| answer == Some(i)));
        }
    }

    #[test]
    fn an_exhausted_budget_leaves_evenly_spread_results() {
        let answers = costly(10_000, 200_000, 100);
        assert!(!answers.complete);
        for tenth in answers.values.chunks(1000) {
            let done = tenth.iter().flatten().count();
            assert!((150..350).contains(&done), "{done}");
        }
        assert_eq!(answers.values, costly(10_000, 200_000, 100).values);
    }

    #[test]
    fn no_query_takes_more_than_its_share_of_the_budget() {
        let answers = costly(1000, 1600, 1_000_000);
        assert!(!answers.complete);
        assert_eq!(answers.values.iter().flatten().count(), BLOCK[0]);
    }

    #[test]
    fn coherent_queries_answer_each_number_in_its_place() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
        for count in [0, 1, CHUNK, 1000] {
            let answers = run_coherent_queries(count, u64::MAX, &context, |i, last: &mut usize, _| {
                assert!(i % CHUNK == 0 || *last == i - 1);
                *last = i;
                (i % 3 > 0).then_some(i)
            })
            .unwrap();
            assert!(answers.complete);
            assert_eq!(answers.values, (0..count).map(|i| (i % 3 > 0).then_some(i)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn coherent_queries_beyond_the_budget_have_no_answer() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
        let answers = run_coherent_queries(10_000, 20_000, &context, |i, (): &mut (), steps| {
            *steps = steps.saturating_sub(100);
            Some(i)
        })
        .unwrap();
        assert!(!answers.complete);
        assert_eq!(answers.values.len(), 10_000);
        assert!(answers.values.iter().enumerate().all(|(i, answer)| answer.is_none_or(|answer| answer == i)));
    }
}
